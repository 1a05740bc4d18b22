# SPDX-License-Identifier: GPL-3.0-or-later
"""The node groups `LB Volume Light` and `LB Ambient`, made once in a file by code."""

import bpy

from .attribute import AMBIENT_ATTRIBUTE
from .ours import TAG, find_ours
from .volume import DENSITY_GRID, LIGHT_GRID

VOLUME_GROUP = "LB Volume Light"
AMBIENT_GROUP = "LB Ambient"


def volume_group():
    """Absorption and emission of the baked volume.

    Replace on:  absorption (sigma_s + sigma_a) density, emission sigma_s density light
    Replace off: the same emission, for camera rays alone, and no absorption
    """
    return _group(VOLUME_GROUP, _build_volume)


def ambient_group():
    """The user's closure and, for camera rays, the emission Color x Alpha x light x Strength."""
    return _group(AMBIENT_GROUP, _build_ambient)


def _group(name, build):
    """Our node group of that name, filled by `build` when the file does not have it yet."""
    found = find_ours(bpy.data.node_groups, name)
    if found:
        return found
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    tree[TAG] = name
    build(tree)
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
    group = _node(tree, "NodeGroupInput", -800, 0)
    density = _attribute(tree, DENSITY_GRID, -800, 300)
    light = _attribute(tree, LIGHT_GRID, -800, -200)
    camera = _node(tree, "ShaderNodeLightPath", -800, -400).outputs["Is Camera Ray"]
    strength, sigma_s, sigma_a, replace = group.outputs[:4]

    sigma_t = _vector(tree, "ADD", sigma_s, sigma_a, -600, 200)
    matter = _math(tree, "MULTIPLY", density.outputs["Factor"], replace, -600, 400)
    absorption = _vector(tree, "SCALE", sigma_t, matter, -200, 200)

    visible = _math(tree, "MAXIMUM", camera, replace, -600, -400)
    glow = _math(tree, "MULTIPLY", density.outputs["Factor"], strength, -600, 0)
    scattered = _vector(tree, "MULTIPLY", sigma_s, light.outputs["Vector"], -400, -200)
    factor = _math(tree, "MULTIPLY", glow, visible, -400, 0)
    emission = _vector(tree, "SCALE", scattered, factor, -200, -100)

    volume = _node(tree, "ShaderNodeVolumeCoefficients", 0, 100)
    volume.inputs["Scatter Coefficients"].default_value = (0, 0, 0)
    tree.links.new(absorption, volume.inputs["Absorption Coefficients"])
    tree.links.new(emission, volume.inputs["Emission Coefficients"])
    output = _node(tree, "NodeGroupOutput", 250, 100)
    tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])


def _build_ambient(tree):
    _socket(tree, "Shader", "OUTPUT", "NodeSocketShader", "Connect where the closure was")
    _socket(tree, "Shader", "INPUT", "NodeSocketShader", "The closure to add ambient light to")
    _socket(tree, "Color", "INPUT", "NodeSocketColor", "Diffuse reflectance", (0.8, 0.8, 0.8, 1.0))
    _socket(tree, "Alpha", "INPUT", "NodeSocketFloat", "Share of the closure that is there", 1.0)
    _socket(tree, "Strength", "INPUT", "NodeSocketFloat", "Factor on the light", 1.0)
    group = _node(tree, "NodeGroupInput", -800, 100)
    ambient = _attribute(tree, AMBIENT_ATTRIBUTE, -800, -100)
    camera = _node(tree, "ShaderNodeLightPath", -800, -300).outputs["Is Camera Ray"]
    shader, color, alpha, strength = group.outputs[:4]

    emission = _node(tree, "ShaderNodeEmission", -150, -100)
    reflected = _vector(tree, "MULTIPLY", color, ambient.outputs["Vector"], -350, 0)
    tree.links.new(reflected, emission.inputs["Color"])
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


def _vector(tree, operation, a, b, x, y):
    """A Vector Math node on the sockets `a` and `b`; returns its output socket."""
    node = _node(tree, "ShaderNodeVectorMath", x, y)
    node.operation = operation
    tree.links.new(a, node.inputs["Vector"])
    tree.links.new(b, node.inputs["Scale"] if operation == "SCALE" else node.inputs[1])
    return node.outputs["Vector"]
