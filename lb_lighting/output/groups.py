# SPDX-License-Identifier: GPL-3.0-or-later
"""The node groups `LB Volume Light`, `LB Beam` and `LB Ambient`, made once in a file by code."""

import bpy

from .attribute import AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE
from .ours import TAG, find_ours
from .vdb import AXES, DENSITY_GRID, LIGHT_GRID, flux_grid

VOLUME_GROUP = "LB Volume Light"
BEAM_GROUP = "LB Beam"
MADE, VERSION = "lb_lighting_version", 2  # of the groups, raised where one of them changes
AMBIENT_GROUP = "LB Ambient"


def volume_group():
    """Absorption and emission of the baked volume.

    Replace on:  absorption (sigma_s + sigma_a) density, emission sigma_s density (light + Direct)
    Replace off: the same emission, for camera rays alone, and no absorption

    The light is scattered towards the eye as if it came from all sides by the law of Henyey and
    Greenstein with the mean cosine that its net flux tells. Scattering keeps that law and
    multiplies the mean cosines, so an LB Beam does both.
    """
    return _group(VOLUME_GROUP, _build_volume)


def beam_group():
    """Others + Light p: what of one light more, of mean radiance Light, is scattered to the eye.

    p is the phase function of Henyey and Greenstein over that of isotropic scattering, band by
    band: (1 - m^2) / (1 + m^2 - 2 m cos)^1.5, where m is G times the length of the light's mean
    direction (X, Y, Z), and cos that of its angle to the way to the eye.
    """
    return _group(BEAM_GROUP, _build_beam)


def ambient_group():
    """The user's closure and, for camera rays, the emission Color x Alpha x light x Strength.

    The light is that of the side which is seen, or, where Through is on, of the other side.
    """
    return _group(AMBIENT_GROUP, _build_ambient)


def _group(name, build):
    """Our node group of that name, filled by `build` when the file does not have it yet."""
    tree = find_ours(bpy.data.node_groups, name)
    if tree is None:
        tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
        tree[TAG] = name
    if tree.get(MADE) != VERSION:  # a file that an earlier version of ours has lit
        tree.nodes.clear()
        tree.interface.clear()
        build(tree)
        tree[MADE] = VERSION
    return tree


def _build_volume(tree):
    _socket(tree, "Volume", "OUTPUT", "NodeSocketShader", "Connect to the output's Volume")
    _socket(tree, "Strength", "INPUT", "NodeSocketFloat", "Factor on the light", 1.0)
    _socket(tree, "Sigma S", "INPUT", "NodeSocketVector", "Scattering at density 1, in 1/m")
    _socket(tree, "Sigma A", "INPUT", "NodeSocketVector", "Absorption at density 1, in 1/m")
    replace = (
        "On: show the medium and all its light. Off: add light, for camera rays, over the source"
    )
    _socket(tree, "Replace", "INPUT", "NodeSocketBool", replace, True)
    direct = "Light of lamps that is scattered towards the eye once, from LB Beam, in W/(m2 sr)"
    _socket(tree, "Direct", "INPUT", "NodeSocketVector", direct)
    _socket(tree, "G", "INPUT", "NodeSocketVector", "Mean cosine of the scattering angle")
    group = _node(tree, "NodeGroupInput", -800, 0)
    density = _attribute(tree, DENSITY_GRID, -800, 300)
    light = _attribute(tree, LIGHT_GRID, -1200, -200).outputs["Vector"]
    camera = _node(tree, "ShaderNodeLightPath", -800, -400).outputs["Is Camera Ray"]
    strength, sigma_s, sigma_a, replace, direct, g = group.outputs[:6]

    sigma_t = _vector(tree, "ADD", sigma_s, sigma_a, -600, 200)
    matter = _math(tree, "MULTIPLY", density.outputs["Factor"], replace, -600, 400)
    absorption = _vector(tree, "SCALE", sigma_t, matter, -200, 200)

    visible = _math(tree, "MAXIMUM", camera, replace, -600, -400)
    glow = _math(tree, "MULTIPLY", density.outputs["Factor"], strength, -600, 0)
    beam = _node(tree, "ShaderNodeGroup", -600, -200)
    beam.node_tree = beam_group()
    for name, value in (("Others", direct), ("Light", light), ("G", g)):
        tree.links.new(value, beam.inputs[name])
    for number, axis in enumerate(AXES):
        flux = _attribute(tree, flux_grid(axis), -1200, -400 - 200 * number)
        tree.links.new(flux.outputs["Vector"], beam.inputs[axis])
    scattered = _vector(tree, "MULTIPLY", sigma_s, beam.outputs["Radiance"], -400, -200)
    factor = _math(tree, "MULTIPLY", glow, visible, -400, 0)
    emission = _vector(tree, "SCALE", scattered, factor, -200, -100)

    volume = _node(tree, "ShaderNodeVolumeCoefficients", 0, 100)
    volume.inputs["Scatter Coefficients"].default_value = (0, 0, 0)
    tree.links.new(absorption, volume.inputs["Absorption Coefficients"])
    tree.links.new(emission, volume.inputs["Emission Coefficients"])
    output = _node(tree, "NodeGroupOutput", 250, 100)
    tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])


def _build_beam(tree):
    _socket(tree, "Radiance", "OUTPUT", "NodeSocketVector", "Connect to the next beam's Others")
    _socket(tree, "Others", "INPUT", "NodeSocketVector", "Radiance of the beams before, W/(m2 sr)")
    _socket(tree, "Light", "INPUT", "NodeSocketVector", "Its mean radiance, in W/(m2 sr)")
    for axis in AXES:
        component = f"{axis} of the mean of its directions, by band; all three are at most 1 long"
        _socket(tree, axis, "INPUT", "NodeSocketVector", component)
    _socket(tree, "G", "INPUT", "NodeSocketVector", "Mean cosine of the scattering angle")
    group = _node(tree, "NodeGroupInput", -1000, 0)
    others, light, *components, g = group.outputs[:6]
    # In a volume this is the way from the place to the eye.
    incoming = _node(tree, "ShaderNodeNewGeometry", -1200, -300).outputs["Incoming"]
    eye = _node(tree, "ShaderNodeSeparateXYZ", -1000, -300)
    tree.links.new(incoming, eye.inputs[0])

    square = forward = (0, 0, 0)  # of G times the mean direction, and of that along the eye's way
    for number, component in enumerate(components):
        y = -200 * number
        kept = _vector(tree, "MULTIPLY", g, component, -800, y)
        own = _vector(tree, "MULTIPLY", kept, kept, -600, y)
        square = _vector(tree, "ADD", square, own, -400, y)
        own = _vector(tree, "SCALE", kept, eye.outputs[number], -600, y - 600)
        forward = _vector(tree, "ADD", forward, own, -400, y - 600)
    straight = _vector(tree, "SUBTRACT", (1, 1, 1), square, -200, 200)
    base = _vector(tree, "ADD", (1, 1, 1), square, -200, 0)
    twice = _vector(tree, "SCALE", forward, 2, -200, -200)
    base = _vector(tree, "SUBTRACT", base, twice, 0, 0)
    peak = _vector(tree, "POWER", base, (-1.5,) * 3, 200, 0)
    phase = _vector(tree, "MULTIPLY", straight, peak, 400, 200)
    scattered = _vector(tree, "MULTIPLY", light, phase, 600, 0)
    total = _vector(tree, "ADD", others, scattered, 800, 0)
    output = _node(tree, "NodeGroupOutput", 1000, 0)
    tree.links.new(total, output.inputs["Radiance"])


def _build_ambient(tree):
    _socket(tree, "Shader", "OUTPUT", "NodeSocketShader", "Connect where the closure was")
    _socket(tree, "Shader", "INPUT", "NodeSocketShader", "The closure to add ambient light to")
    color = "Share of the light that comes back, or through"
    _socket(tree, "Color", "INPUT", "NodeSocketColor", color, (0.8, 0.8, 0.8, 1.0))
    _socket(tree, "Alpha", "INPUT", "NodeSocketFloat", "Share of the closure that is there", 1.0)
    _socket(tree, "Strength", "INPUT", "NodeSocketFloat", "Factor on the light", 1.0)
    through = "On: the closure is translucent, and shows the light of the side that is not seen"
    _socket(tree, "Through", "INPUT", "NodeSocketBool", through, False)
    group = _node(tree, "NodeGroupInput", -1000, 100)
    front = _attribute(tree, AMBIENT_ATTRIBUTE, -800, -100).outputs["Vector"]
    back = _attribute(tree, BACK_ATTRIBUTE, -800, -300).outputs["Vector"]
    facing = _node(tree, "ShaderNodeNewGeometry", -1000, -100).outputs["Backfacing"]
    camera = _node(tree, "ShaderNodeLightPath", -800, -500).outputs["Is Camera Ray"]
    shader, color, alpha, strength, through = group.outputs[:5]

    is_front = _math(tree, "COMPARE", facing, through, -800, 100)
    light = _mix(tree, is_front, back, front, -550, 0)

    emission = _node(tree, "ShaderNodeEmission", -150, -100)
    shown = _vector(tree, "MULTIPLY", color, light, -350, 0)
    tree.links.new(shown, emission.inputs["Color"])
    seen = _math(tree, "MULTIPLY", alpha, camera, -550, -200)
    seen.node.use_clamp = True  # as the Principled BSDF clamps its alpha
    factor = _math(tree, "MULTIPLY", seen, strength, -350, -200)
    tree.links.new(factor, emission.inputs["Strength"])
    add = _node(tree, "ShaderNodeAddShader", 50, 0)
    tree.links.new(shader, add.inputs[0])
    tree.links.new(emission.outputs["Emission"], add.inputs[1])
    output = _node(tree, "NodeGroupOutput", 250, 0)
    tree.links.new(add.outputs["Shader"], output.inputs["Shader"])


def _socket(tree, name, in_out, kind, description, default=None):
    socket = tree.interface.new_socket(
        name, description=description, in_out=in_out, socket_type=kind
    )
    if default is not None:
        socket.default_value = default


def _node(tree, kind, x, y):
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node


def _attribute(tree, name, x, y):
    node = _node(tree, "ShaderNodeAttribute", x, y)
    node.attribute_name = name
    return node


def _math(tree, operation, a, b, x, y):
    """A Math node on the sockets `a` and `b`; returns its output socket."""
    node = _node(tree, "ShaderNodeMath", x, y)
    node.operation = operation
    tree.links.new(a, node.inputs[0])
    tree.links.new(b, node.inputs[1])
    return node.outputs["Value"]


def _mix(tree, factor, a, b, x, y):
    """A Mix node of vectors, from the socket `a` to `b` by `factor`; returns its output socket."""
    node = _node(tree, "ShaderNodeMix", x, y)
    node.data_type = "VECTOR"
    # The sockets of all data types are there, under names that repeat.
    inputs = {socket.identifier: socket for socket in node.inputs}
    for source, name in ((factor, "Factor_Float"), (a, "A_Vector"), (b, "B_Vector")):
        tree.links.new(source, inputs[name])
    return next(s for s in node.outputs if s.identifier == "Result_Vector")


def _vector(tree, operation, a, b, x, y):
    """A Vector Math node on `a` and `b`, sockets or values; returns its output socket."""
    node = _node(tree, "ShaderNodeVectorMath", x, y)
    node.operation = operation
    second = node.inputs["Scale"] if operation == "SCALE" else node.inputs[1]
    for value, socket in ((a, node.inputs[0]), (b, second)):
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return node.outputs["Vector"]
