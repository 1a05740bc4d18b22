# SPDX-License-Identifier: GPL-3.0-or-later
"""The node groups of surfaces: `LB Ambient` and `LB Rest`."""

from typing import Any

from .ambient import AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE, WHOLE_ATTRIBUTE, ambient_axis
from .groups import ANY, add_seen, our_group
from .nodes import (
    Node,
    Operand,
    Socket,
    add_attribute,
    add_input,
    add_math,
    add_mix,
    add_node,
    add_output,
    add_vector,
)
from .vdb import AXES

AMBIENT_GROUP = "LB Ambient"
REST_GROUP = "LB Rest"


def ambient_group() -> Any:
    """The user's closure plus the emission Color x Alpha x (1 - Metallic) x light x Strength, on
    rays that the eye sees directly (`add_seen`). Cycles' own glossy rays find what a metal shows.

    Rays that a translucent surface scattered find neither: the lattice contains bounces from leaf
    to leaf, and where a scene has glass, Cycles has to follow these rays.

    The light is that on the side that the eye sees or, with Through on, on the other side. An
    instance can bring its own light, see `modifier`: the mean of both sides, and its difference
    along each axis, for surfaces of any direction.
    """
    return our_group(AMBIENT_GROUP, _build_ambient)


def rest_group() -> Any:
    """The part of a colour that remains for the closure itself when `LB Ambient` shows all light.

    It is none on rays that the eye sees directly (`add_seen`), where `lb_whole` is 1 and there is
    ambient light, and the whole colour elsewhere.
    """
    return our_group(REST_GROUP, _build_rest)


def _build_ambient(tree: Any) -> None:
    _add_ambient_sockets(tree)
    group = add_node(tree, "NodeGroupInput", -1000, 100)
    front = add_attribute(tree, AMBIENT_ATTRIBUTE, -800, -100).outputs["Vector"]
    back = add_attribute(tree, BACK_ATTRIBUTE, -800, -300).outputs["Vector"]
    surface = add_node(tree, "ShaderNodeNewGeometry", -1000, -100)
    seen = add_seen(tree, -1000, -500)
    shader, color, alpha, strength, through, metallic = group.outputs[:6]

    # Choose the light of the side, or of the instance.
    is_front = add_math(tree, "COMPARE", surface.outputs["Backfacing"], through, -800, 100)
    light = add_mix(tree, is_front, back, front, -550, 0)
    mean = add_attribute(tree, AMBIENT_ATTRIBUTE, -1800, -700, of="INSTANCER")
    instance_light = _instance_light(tree, mean, surface.outputs["Normal"], through)
    light = add_mix(tree, mean.outputs["Alpha"], light, instance_light, -450, 0)

    # Emit it.
    emission = add_node(tree, "ShaderNodeEmission", -150, -100)
    shown = add_vector(tree, "MULTIPLY", color, light, -350, 0)
    tree.links.new(shown, emission.inputs["Color"])
    clamp = add_node(tree, "ShaderNodeClamp", -550, -200)  # as the Principled BSDF clamps its alpha
    tree.links.new(alpha, clamp.inputs["Value"])
    opacity = clamp.outputs["Result"]
    dull = add_math(tree, "SUBTRACT", 1.0, metallic, -550, -400)
    dull = add_math(tree, "MAXIMUM", dull, 0.0, -350, -400)
    factor = add_math(tree, "MULTIPLY", opacity, strength, -350, -200)
    factor = add_math(tree, "MULTIPLY", factor, dull, -250, -300)
    tree.links.new(factor, emission.inputs["Strength"])

    # Mix it in for the rays that find it: Cycles skips what has no weight in a mix.
    mix = add_node(tree, "ShaderNodeMixShader", 50, -100)
    tree.links.new(seen, mix.inputs[0])
    tree.links.new(emission.outputs["Emission"], mix.inputs[2])
    closure = _remaining_closure(tree, shader, opacity)
    add = add_node(tree, "ShaderNodeAddShader", 250, 0)
    tree.links.new(closure, add.inputs[0])
    tree.links.new(mix.outputs["Shader"], add.inputs[1])
    output = add_node(tree, "NodeGroupOutput", 450, 0)
    tree.links.new(add.outputs["Shader"], output.inputs["Shader"])


def _add_ambient_sockets(tree: Any) -> None:
    add_output(tree, "Shader", "Shader", "Connect where the shader was connected")
    add_input(tree, "Shader", "Shader", "The shader to add baked light to")
    color = "Share of the light that the shader reflects or transmits"
    add_input(tree, "Color", "Color", color, (0.8, 0.8, 0.8, 1.0))
    add_input(tree, "Alpha", "Float", "Opacity of the shader", 1.0, (0, 1))
    strength = "Factor on the light; 1 is the brightness that the lamps give"
    add_input(tree, "Strength", "Float", strength, 1.0, ANY)
    through = "On: the shader is translucent and shows the light that falls on the far side"
    add_input(tree, "Through", "Bool", through, False)
    metallic = "Share of the shader that is a mirror; Cycles renders its reflections"
    add_input(tree, "Metallic", "Float", metallic, 0.0, (0, 1))


def _instance_light(tree: Any, mean: Node, normal: Socket, through: Socket) -> Socket:
    """The socket of the light on the side that the socket `normal` points to, or on the other.

    mean  Attribute node of the instance: the mean of both sides
    """
    components = add_node(tree, "ShaderNodeSeparateXYZ", -1800, -1000)
    tree.links.new(normal, components.inputs[0])
    along: Operand = (0, 0, 0)
    for number, axis in enumerate(AXES):
        y = -900 - 200 * number
        flux = add_attribute(tree, ambient_axis(axis), -1600, y, of="INSTANCER").outputs["Vector"]
        flux = add_vector(tree, "SCALE", flux, components.outputs[axis], -1400, y)
        along = add_vector(tree, "ADD", along, flux, -1200, y)
    twice = add_math(tree, "MULTIPLY", through, 2.0, -1400, -700)
    sign = add_math(tree, "SUBTRACT", twice, 1.0, -1200, -700)  # light comes against the normal
    along = add_vector(tree, "SCALE", along, sign, -1000, -900)
    light = add_vector(tree, "ADD", mean.outputs["Vector"], along, -800, -900)
    return add_vector(tree, "MAXIMUM", light, (0, 0, 0), -600, -900)


def _remaining_closure(tree: Any, shader: Socket, alpha: Socket) -> Socket:
    """The socket of what remains of the closure `shader` for the rays that find it.

    Holes, where `alpha` is 0, remain without a Transparent BSDF, which slows shadows down.
    """
    path = add_node(tree, "ShaderNodeLightPath", -550, 400).outputs
    rays = path["Is Diffuse Ray"], path["Is Transmission Ray"]
    scattered = add_math(tree, "MULTIPLY", *rays, -350, 400)
    mix = add_node(tree, "ShaderNodeMixShader", 50, 300)
    tree.links.new(add_math(tree, "MULTIPLY", scattered, alpha, -150, 400), mix.inputs[0])
    tree.links.new(shader, mix.inputs[1])
    return mix.outputs["Shader"]


def _build_rest(tree: Any) -> None:
    add_output(tree, "Color", "Color", "Connect where the colour was connected")
    color = "Colour of the shader whose light LB Ambient shows completely"
    add_input(tree, "Color", "Color", color, (0.8, 0.8, 0.8, 1.0))
    color = add_node(tree, "NodeGroupInput", -400, 200).outputs["Color"]
    seen = add_seen(tree, -1000, 200)
    # Find out whether LB Ambient shows all light, of the surface or of the instance.
    hidden: Operand = 0.0
    for of, names, y in (
        ("GEOMETRY", (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE), -200),
        ("INSTANCER", (AMBIENT_ATTRIBUTE,), -900),
    ):
        light: Operand = (0, 0, 0)
        for name in names:
            y -= 200
            side = add_attribute(tree, name, -1000, y, of).outputs["Vector"]
            light = add_vector(tree, "ADD", side, light, -800, y)
        length = add_vector(tree, "LENGTH", light, (0, 0, 0), -600, y)
        is_lit = add_math(tree, "GREATER_THAN", length, 0.0, -400, y)
        all_light = add_attribute(tree, WHOLE_ATTRIBUTE, -400, y + 200, of).outputs["Factor"]
        shows_all = add_math(tree, "MULTIPLY", is_lit, all_light, -200, y)
        hidden = add_math(tree, "MAXIMUM", shows_all, hidden, 0, y)
    # Scale the colour by the share that remains.
    hidden = add_math(tree, "MULTIPLY", seen, hidden, 0, 0)
    share = add_math(tree, "SUBTRACT", 1.0, hidden, 200, 0)
    remaining = add_vector(tree, "SCALE", color, share, 400, 100)
    output = add_node(tree, "NodeGroupOutput", 600, 100)
    tree.links.new(remaining, output.inputs["Color"])
