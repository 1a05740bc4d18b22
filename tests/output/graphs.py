# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of users, and everything in them that wiring could change."""

import bpy

from lb_lighting.output.surface_groups import (
    AMBIENT_GROUP,
)


def new_material():
    material = bpy.data.materials.new("user")
    material.node_tree.nodes.clear()
    return material, material.node_tree.nodes, material.node_tree.links


def principled():
    material, nodes, links = new_material()
    shader, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Base Color"].default_value = (0.1, 0.5, 0.2, 1)
    links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def textured():
    material = principled()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture = nodes.new("ShaderNodeTexNoise")
    links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    material.cycles.emission_sampling = "FRONT"
    return material


def mix_shader(material, first, second, factor=0.5):
    """The output socket of a Mix Shader of the output sockets `first` and `second`."""
    mix = material.node_tree.nodes.new("ShaderNodeMixShader")
    mix.inputs[0].default_value = factor
    for socket, shader in enumerate((first, second), 1):
        material.node_tree.links.new(shader, mix.inputs[socket])
    return mix.outputs[0]


def colored(material, kind, color):
    """The output socket of a new closure node."""
    node = material.node_tree.nodes.new(kind)
    node.inputs["Color"].default_value = (*color, 1)
    return node.outputs[0]


def show(material, shader):
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader, output.inputs["Surface"])
    return material


def mixed():
    material = new_material()[0]
    diffuse = colored(material, "ShaderNodeBsdfDiffuse", (0.3, 0.2, 0.1))
    translucent = colored(material, "ShaderNodeBsdfTranslucent", (0.1, 0.4, 0.2))
    return show(material, mix_shader(material, diffuse, translucent, 0.3))


def cut_out():
    """A leaf on a card: a transparent shader, and one whose alpha is a texture, behind reroutes."""
    material = principled()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader, output = nodes["Principled BSDF"], nodes["Material Output"]
    texture, reroute = nodes.new("ShaderNodeTexChecker"), nodes.new("NodeReroute")
    links.new(texture.outputs["Factor"], shader.inputs["Alpha"])
    links.new(shader.outputs[0], reroute.inputs[0])
    transparent = colored(material, "ShaderNodeBsdfTransparent", (1, 1, 1))
    mix = mix_shader(material, transparent, reroute.outputs[0])
    links.new(mix, output.inputs["Surface"])
    return material


def shared():
    """One closure in two mixes of a sum, and in an output that is not rendered."""
    material, nodes, links = new_material()
    diffuse = colored(material, "ShaderNodeBsdfDiffuse", (0.3, 0.2, 0.1))
    glossy = colored(material, "ShaderNodeBsdfGlossy", (1, 1, 1))
    add = nodes.new("ShaderNodeAddShader")
    links.new(mix_shader(material, diffuse, glossy, 0.2), add.inputs[0])
    links.new(mix_shader(material, glossy, diffuse, 0.1), add.inputs[1])
    show(material, add.outputs[0])
    show(material, diffuse)
    return material


def user_group(material, kind):
    """A user's node group around one closure."""
    tree = bpy.data.node_groups.new("user", "ShaderNodeTree")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    closure, output = tree.nodes.new(kind), tree.nodes.new("NodeGroupOutput")
    tree.links.new(closure.outputs[0], output.inputs[0])
    node = material.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = tree
    return node


def muted():
    """A texture whose link is muted."""
    material = textured()
    links = material.node_tree.links
    next(link for link in links if link.to_socket.name == "Base Color").is_muted = True
    return material


def grouped():
    material = new_material()[0]
    return show(material, user_group(material, "ShaderNodeBsdfDiffuse").outputs[0])


def glassy():
    """No diffuse closure, except for a muted one."""
    material, nodes, _links = new_material()
    muted = colored(material, "ShaderNodeBsdfDiffuse", (1, 1, 1))
    muted.node.mute = True
    shader = mix_shader(material, nodes.new("ShaderNodeEmission").outputs[0], muted)
    for kind in ("Holdout", "BsdfTransparent", "BsdfGlass", "BsdfGlossy", "BsdfRefraction"):
        shader = mix_shader(material, shader, nodes.new("ShaderNode" + kind).outputs[0])
    return show(material, shader)


def two_engines():
    material = principled()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes["Material Output"].target = "CYCLES"
    eevee = nodes.new("ShaderNodeOutputMaterial")
    eevee.target = "EEVEE"
    eevee.is_active_output = True
    links.new(nodes.new("ShaderNodeBsdfDiffuse").outputs[0], eevee.inputs["Surface"])
    return material


def framed():
    material = principled()
    nodes = material.node_tree.nodes
    frame = nodes.new("NodeFrame")
    frame.location = (100, 50)
    for name in ("Principled BSDF", "Material Output"):
        nodes[name].parent = frame
    return material


def unlinked_surface():
    material, nodes, links = new_material()
    output = nodes.new("ShaderNodeOutputMaterial")
    scatter = nodes.new("ShaderNodeVolumeScatter")
    links.new(scatter.outputs[0], output.inputs["Volume"])
    return material


def empty():
    return new_material()[0]


def circular():
    """A mix whose input is its own output, which Blender marks as invalid."""
    material = mixed()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    mix = nodes["Mix Shader"]
    add = nodes.new("ShaderNodeAddShader")
    links.new(mix.outputs[0], add.inputs[0])
    links.new(nodes["Diffuse BSDF"].outputs[0], add.inputs[1])
    links.new(add.outputs[0], mix.inputs[1])
    return material


LEFT_ALONE = [glassy, unlinked_surface, empty]


WIRED = [
    principled,
    textured,
    muted,
    mixed,
    cut_out,
    shared,
    grouped,
    two_engines,
    framed,
    circular,
]


def plain(value):
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def properties(block):
    """The editable values of an RNA struct, by name."""
    return {
        p.identifier: plain(getattr(block, p.identifier))
        for p in block.bl_rna.properties
        if not p.is_readonly
        and p.type not in ("POINTER", "COLLECTION")
        and p.identifier != "use_nodes"  # deprecated
    }


def sockets(node):
    return {s.identifier: plain(getattr(s, "default_value", None)) for s in node.inputs}


def ends(link):
    tail, head = link.from_socket, link.to_socket
    return tail.node.name, tail.identifier, head.node.name, head.identifier, link.is_muted


def dump(material):
    """Everything in a material that wiring could change."""
    tree = material.node_tree
    nodes = {
        node.name: (node.bl_idname, properties(node), sockets(node), node.parent, list(node.keys()))
        for node in tree.nodes
    }
    active = tree.nodes.active
    links = sorted(ends(link) for link in tree.links)
    settings = properties(material), properties(material.cycles), list(material.keys())
    return nodes, links, active, settings


def ambient(material):
    (node,) = ambients(material)
    return node


def ambients(material):
    """The group nodes `LB Ambient` of a material."""
    nodes = material.node_tree.nodes
    return [n for n in nodes if n.type == "GROUP" and n.node_tree.name.startswith(AMBIENT_GROUP)]


def behind(material, closure):
    """The group node that the closure node named `closure` feeds."""
    return next(
        n for n in ambients(material) if n.inputs["Shader"].links[0].from_node.name == closure
    )
