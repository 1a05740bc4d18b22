# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders that make light of the lattice visible, and the settings they need.

Volumes: the node group `LB Volume Light` on the baked Volume object. "REPLACE" stands in
for the source object: it absorbs, and emits all light scattered towards the eye; nothing
in it scatters, so Cycles has nothing left to sample. "ADD" lies over the source and only
emits, for camera rays alone, because Cycles would scatter the emission once more and
count it twice.

Surfaces: the node group `LB Ambient`, put between the user's surface shader and the
material's output, again for camera rays alone.
"""

import bpy

from ..errors import OutputError
from .groups import AMBIENT_GROUP, VOLUME_GROUP, ambient_group, volume_group
from .ours import TAG, find_ours, give_back, is_ours, override

MODES = {"REPLACE": True, "ADD": False}  # the value of the group's socket "Replace"

# The shaders that say themselves what share of diffuse light they reflect.
COLOR_INPUTS = {"BSDF_PRINCIPLED": "Base Color", "BSDF_DIFFUSE": "Color"}


def prepare_scene(scene):
    """Make Cycles march through volumes, which renders "REPLACE" fast and without noise."""
    if hasattr(scene, "cycles"):  # Cycles is an add-on, which may be off
        override(scene, "cycles.volume_biased", True)


def restore_scene(scene):
    """Give back what `prepare_scene` changed."""
    give_back(scene)


def hide_source(ob):
    """Hide the object that a baked volume replaces, from viewport and render."""
    override(ob, "hide_viewport", True)
    override(ob, "hide_render", True)


def show_source(ob):
    """Give the object the visibility it had before `hide_source`."""
    give_back(ob)


def shade_volume(ob, mode, sigma_s, sigma_a, strength=1.0):
    """Give the baked Volume object `ob` the material that shows its light.

    mode              "REPLACE" or "ADD"
    sigma_s, sigma_a  scattering and absorption coefficient at density 1, 1/m, scalar or (3,)
    strength          factor on the light, dimensionless
    """
    material = _volume_material(ob.data)
    nodes = material.node_tree.nodes
    inputs = next(node for node in nodes if node.type == "GROUP").inputs
    inputs["Strength"].default_value = strength
    inputs["Sigma S"].default_value = _triple(sigma_s)
    inputs["Sigma A"].default_value = _triple(sigma_a)
    inputs["Replace"].default_value = MODES[mode]


def wire_ambient(material, color=(0.8, 0.8, 0.8), strength=1.0):
    """Add ambient light to what `material` shows; a second call updates it.

    color     diffuse reflectance, (3,), for surfaces that are not one Principled or Diffuse
              BSDF; those give their own
    strength  factor on the light, dimensionless

    Outputs without a surface stay as they are. Raises OutputError for a material that
    cannot be edited.
    """
    _refuse_linked(material)
    for output in _active_outputs(material.node_tree):
        shader = _source(output.inputs["Surface"])
        if shader and not is_ours(shader.node):
            _insert_ambient(material.node_tree, shader, output)
    for node in _ambient_nodes(material):
        _link_color(material.node_tree, node, color)
        node.inputs["Strength"].default_value = strength
    if _ambient_nodes(material) and hasattr(material, "cycles"):
        override(material, "cycles.emission_sampling", "NONE")


def unwire_ambient(material):
    """Take ambient light out of `material` and leave it as it was before `wire_ambient`."""
    tree = material.node_tree
    for node in _ambient_nodes(material):
        shader = _source(node.inputs["Shader"])
        for target in [link.to_socket for link in node.outputs[0].links]:
            if shader:
                tree.links.new(shader, target)
        tree.nodes.remove(node)
    give_back(material)


def refuse_unwritable(objects):
    """Raise OutputError for the first object with a material that cannot be wired."""
    for ob in objects:
        for slot in ob.material_slots:
            if slot.material is not None:
                _refuse_linked(slot.material)


def light_surface(ob, albedo, strength=1.0):
    """Wire every material of `ob`, and one of ours where it has none; see `wire_ambient`.

    albedo  function of a material that gives its colour, (3,), for `wire_ambient`
    """
    if not ob.material_slots:
        ob.data.materials.append(None)
        ob.data[TAG] = "material slot"
    for slot in ob.material_slots:
        if slot.material is None:
            slot.material = _plain_material()
        wire_ambient(slot.material, albedo(slot.material), strength)


def unlight_surface(ob):
    """Undo `light_surface`."""
    for slot in ob.material_slots:
        if slot.material is None:
            continue
        unwire_ambient(slot.material)
        if is_ours(slot.material):
            slot.material = None
    if is_ours(ob.data):
        del ob.data[TAG]
        if not any(ob.data.materials):
            ob.data.materials.clear()


def remove_unused():
    """Remove our materials and node groups that nothing uses."""
    for blocks in (bpy.data.materials, bpy.data.node_groups):
        bpy.data.batch_remove([block for block in blocks if is_ours(block) and not block.users])


def _refuse_linked(material):
    if not material.is_editable:
        raise OutputError(
            f"The material {material.name} is linked from another file; make it local."
        )


def _triple(value):
    """A spectral value as three bands."""
    value = list(value) if hasattr(value, "__len__") else [value]
    return value * 3 if len(value) == 1 else value


def _active_outputs(tree):
    """The output nodes that render engines use: one, or one for each engine."""
    outputs = dict.fromkeys(tree.get_output_node(engine) for engine in ("CYCLES", "EEVEE"))
    return [output for output in outputs if output]


def _ambient_nodes(material):
    return [node for node in material.node_tree.nodes if is_ours(node)]


def _source(socket):
    """The output socket that feeds `socket`, or None."""
    return next((link.from_socket for link in socket.links if not link.is_muted), None)


def _insert_ambient(tree, shader, output):
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = ambient_group()
    node.name = node.label = AMBIENT_GROUP
    node[TAG] = AMBIENT_GROUP
    node.parent = output.parent
    node.location = output.location.x - 40, output.location.y + 200
    tree.links.new(shader, node.inputs["Shader"])
    tree.links.new(node.outputs["Shader"], output.inputs["Surface"])


def _link_color(tree, node, color):
    """Give the ambient `node` the colour of the shader it is behind, or else `color`."""
    for link in node.inputs["Color"].links:
        tree.links.remove(link)
    shader = _source(node.inputs["Shader"])
    name = COLOR_INPUTS.get(shader.node.type) if shader else None
    if name is None:
        node.inputs["Color"].default_value = (*color, 1.0)
        return
    node.inputs["Color"].default_value = shader.node.inputs[name].default_value
    texture = _source(shader.node.inputs[name])
    if texture:
        tree.links.new(texture, node.inputs["Color"])


def _plain_material():
    """Our material that looks as Cycles shows a mesh without one."""
    found = find_ours(bpy.data.materials, AMBIENT_GROUP)
    if found:
        return found
    material = _new_material(AMBIENT_GROUP, AMBIENT_GROUP)
    nodes = material.node_tree.nodes
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material


def _volume_material(volume):
    """The material of the Volume datablock `volume`, made if it has none of ours."""
    found = next((m for m in volume.materials if m and is_ours(m)), None)
    if found:
        return found
    material = _new_material(volume.name, VOLUME_GROUP)
    nodes = material.node_tree.nodes
    light = nodes.new("ShaderNodeGroup")
    light.node_tree = volume_group()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(light.outputs["Volume"], output.inputs["Volume"])
    volume.materials.append(material)
    return material


def _new_material(name, tag):
    material = bpy.data.materials.new(name)
    material[TAG] = tag
    material.node_tree.nodes.clear()
    return material
