# SPDX-License-Identifier: GPL-3.0-or-later
"""The node groups `LB Volume Light`, `LB Beam`, `LB Moments`, `LB Lamp`, `LB Ambient` and
`LB Rest`, made by code, once in a file."""

import bpy

from ..ours import TAG, find_ours
from .ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    WHOLE_ATTRIBUTE,
    ambient_axis,
)
from .nodes import (
    add_attribute,
    add_input,
    add_math,
    add_mix,
    add_node,
    add_output,
    add_vector,
)
from .vdb import (
    AXES,
    DENSITY_GRID,
    EMISSION_GRID,
    LIGHT_GRID,
    flux_grid,
    moment_grid,
)

VOLUME_GROUP = "LB Volume Light"
BEAM_GROUP = "LB Beam"
MOMENTS_GROUP = "LB Moments"
LAMP_GROUP = "LB Lamp"
MADE, VERSION = "lb_lighting_version", 6  # of the groups, raised where one of them changes
AMBIENT_GROUP = "LB Ambient"
REST_GROUP = "LB Rest"

ANY = (0, 3e38)  # of what is not negative
COSINE = (-1, 1)
MEAN_COSINE = "Mean cosine of the scattering angle of red, green and blue: 1 is straight on"


def volume_group():
    """Absorption and emission of the baked volume.

    Replace on:  absorption (sigma_s + sigma_a) density, emission sigma_s density (light + Direct),
                 and what the medium shines with by itself
    Replace off: the same emission but for the last, for rays that the eye sees by (`_seen`) alone,
                 and no absorption

    The light is scattered towards the eye as if it came from all sides by the law of Henyey and
    Greenstein with the mean cosine that its net flux tells. Scattering keeps that law and
    multiplies the mean cosines, so an LB Beam does both. Where it was gathered what light is
    scattered to, the file has no net flux, and LB Moments stands before the beams.
    """
    return our_group(VOLUME_GROUP, _build_volume)


def beam_group():
    """Others + Light p: what of one light more, of mean radiance Light, is scattered to the eye.

    p is the phase function of Henyey and Greenstein over that of isotropic scattering, band by
    band: (1 - m^2) / (1 + m^2 - 2 m cos)^1.5, where m is G times the length of the light's mean
    direction (X, Y, Z), and cos that of its angle to the way to the eye.
    """
    return our_group(BEAM_GROUP, _build_beam)


def moments_group():
    """Others + the sum of each grid `moment_grid` times its polynomial of the way to the eye."""
    return our_group(MOMENTS_GROUP, _build_moments)


def lamp_group():
    """The light of a lamp at the place that is shaded, and the unit vector (X, Y, Z) that it goes.

    That is Intensity times `PointLight.falloff`: with q the distance r or the Core, whichever is
    more, and h the hypotenuse over q and Radius, (1 + (Peak - 1) (1 - r / q)) 2 / (h (h + q)).
    """
    return our_group(LAMP_GROUP, _build_lamp)


def ambient_group():
    """The user's closure and the emission Color x Alpha x (1 - Metallic) x light x Strength, where
    it is `_seen`; what a metal shows, Cycles' own glossy rays find.

    Rays that a translucent surface scattered find neither: bounces from leaf to leaf are in the
    light of the lattice, and where there is glass in a scene Cycles has to follow them.

    The light is that of the side which is seen, or, where Through is on, of the other side. An
    instance may bring its own, see `modifier`: of the mean of both sides, and how it differs
    along each axis, for surfaces of any direction.
    """
    return our_group(AMBIENT_GROUP, _build_ambient)


def rest_group():
    """What of a colour is left for the closure itself, where `LB Ambient` shows all light.

    None where it is `_seen`, `lb_whole` is 1 and there is ambient light, all elsewhere.
    """
    return our_group(REST_GROUP, _build_rest)


def our_group(name, build, kind="ShaderNodeTree"):
    """Our node group of that name, filled by `build` when the file does not have it yet."""
    tree = find_ours(bpy.data.node_groups, name)
    if tree is None:
        tree = bpy.data.node_groups.new(name, kind)
        tree[TAG] = name
    if tree.get(MADE) != VERSION:  # a file that an earlier version of ours has lit
        tree.nodes.clear()
        old = list(tree.interface.items_tree)
        for socket in old:
            socket.description = ""
        build(tree)
        for socket in [s for s in old if not s.description]:
            tree.interface.remove(socket)
        tree[MADE] = VERSION
    return tree


def _seen(tree, x, y):
    """A socket that is 1 for the rays that the eye sees by, and 0 for all others.

    It sees by rays of the camera, and by what mirrors and clear surfaces, sharp or rough, make of
    them. Rays that a diffuse surface or a volume scattered on their way do not count, since the
    lattice has that light already: these are the bounces that Ray Depth counts besides those of
    gloss and of transmission. What a translucent surface sends on is a diffuse ray; if it meets a
    mirror afterwards, Cycles can no longer tell it from one that came through glass.
    """
    path = add_node(tree, "ShaderNodeLightPath", x, y).outputs
    straight = add_math(tree, "MAXIMUM", path["Is Camera Ray"], path["Is Glossy Ray"], x + 200, y)
    bounces = add_math(tree, "SUBTRACT", path["Ray Depth"], path["Glossy Depth"], x + 200, y - 200)
    bounces = add_math(tree, "SUBTRACT", bounces, path["Transmission Depth"], x + 400, y - 200)
    unscattered = add_math(tree, "LESS_THAN", bounces, 0.5, x + 600, y - 200)
    return add_math(tree, "MULTIPLY", straight, unscattered, x + 800, y)


def _build_volume(tree):
    add_output(tree, "Volume", "Shader", "Connect to the output's Volume")
    strength = "Factor on the light; 1 is as bright as the lamps make it"
    add_input(tree, "Strength", "Float", strength, 1.0, ANY)
    scattering = "Scattering at density 1 of red, green and blue, in 1/m"
    add_input(tree, "Sigma S", "Vector", scattering, (1, 1, 1), ANY)
    absorption = "Absorption at density 1 of red, green and blue, in 1/m"
    add_input(tree, "Sigma A", "Vector", absorption, (0, 0, 0), ANY)
    replace = (
        "On: show the medium and all its light. Off: add light over the source, "
        "as the camera sees it"
    )
    add_input(tree, "Replace", "Bool", replace, True)
    direct = "Light of lamps that is scattered towards the eye once, from LB Beam, in W/(m2 sr)"
    add_input(tree, "Direct", "Vector", direct, limits=ANY, hidden=True)
    add_input(tree, "G", "Vector", MEAN_COSINE, (0, 0, 0), COSINE)
    group = add_node(tree, "NodeGroupInput", -800, 0)
    density = add_attribute(tree, DENSITY_GRID, -800, 300)
    light = add_attribute(tree, LIGHT_GRID, -1200, -200).outputs["Vector"]
    seen = _seen(tree, -1800, -800)
    strength, sigma_s, sigma_a, replace, direct, g = group.outputs[:6]

    sigma_t = add_vector(tree, "ADD", sigma_s, sigma_a, -600, 200)
    matter = add_math(tree, "MULTIPLY", density.outputs["Factor"], replace, -600, 400)
    absorption = add_vector(tree, "SCALE", sigma_t, matter, -200, 200)

    visible = add_math(tree, "MAXIMUM", seen, replace, -600, -400)
    glow = add_math(tree, "MULTIPLY", density.outputs["Factor"], strength, -600, 0)
    beam = add_node(tree, "ShaderNodeGroup", -600, -200)
    beam.node_tree = beam_group()
    for name, value in (("Others", direct), ("Light", light), ("G", g)):
        tree.links.new(value, beam.inputs[name])
    for number, axis in enumerate(AXES):
        flux = add_attribute(tree, flux_grid(axis), -1200, -400 - 200 * number)
        tree.links.new(flux.outputs["Vector"], beam.inputs[axis])
    # A few moments alone may be less than nothing where light hardly goes.
    light = add_vector(tree, "MAXIMUM", beam.outputs["Radiance"], (0, 0, 0), -400, -400)
    scattered = add_vector(tree, "MULTIPLY", sigma_s, light, -400, -200)
    factor = add_math(tree, "MULTIPLY", glow, visible, -400, 0)
    emission = add_vector(tree, "SCALE", scattered, factor, -200, -100)
    fire = add_attribute(tree, EMISSION_GRID, -600, -600).outputs["Vector"]
    fire = add_vector(tree, "SCALE", fire, replace, -400, -600)
    emission = add_vector(tree, "ADD", emission, fire, -200, -300)

    volume = add_node(tree, "ShaderNodeVolumeCoefficients", 0, 100)
    volume.inputs["Scatter Coefficients"].default_value = (0, 0, 0)
    tree.links.new(absorption, volume.inputs["Absorption Coefficients"])
    tree.links.new(emission, volume.inputs["Emission Coefficients"])
    output = add_node(tree, "NodeGroupOutput", 250, 100)
    tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])


def _build_beam(tree):
    chain = "Connect to Others of the next beam, or to Direct of LB Volume Light"
    add_output(tree, "Radiance", "Vector", chain)
    others = "Radiance of the beams before, in W/(m2 sr)"
    add_input(tree, "Others", "Vector", others, limits=ANY, hidden=True)
    light = "Mean radiance of this beam: its grid lb_direct_1, lb_direct_2 ..., in W/(m2 sr)"
    add_input(tree, "Light", "Vector", light, limits=ANY, hidden=True)
    for axis in AXES:
        component = f"{axis} of the mean of its directions, by band; all three are at most 1 long"
        # Light that has no direction is scattered evenly.
        add_input(tree, axis, "Vector", component, (0, 0, 0), COSINE)
    add_input(tree, "G", "Vector", MEAN_COSINE, (0, 0, 0), COSINE)
    group = add_node(tree, "NodeGroupInput", -1000, 0)
    others, light, *components, g = group.outputs[:6]
    # In a volume this is the way from the place to the eye.
    incoming = add_node(tree, "ShaderNodeNewGeometry", -1200, -300).outputs["Incoming"]
    eye = add_node(tree, "ShaderNodeSeparateXYZ", -1000, -300)
    tree.links.new(incoming, eye.inputs[0])

    square = forward = (0, 0, 0)  # of G times the mean direction, and of that along the eye's way
    for number, component in enumerate(components):
        y = -200 * number
        kept = add_vector(tree, "MULTIPLY", g, component, -800, y)
        own = add_vector(tree, "MULTIPLY", kept, kept, -600, y)
        square = add_vector(tree, "ADD", square, own, -400, y)
        own = add_vector(tree, "SCALE", kept, eye.outputs[number], -600, y - 600)
        forward = add_vector(tree, "ADD", forward, own, -400, y - 600)
    straight = add_vector(tree, "SUBTRACT", (1, 1, 1), square, -200, 200)
    base = add_vector(tree, "ADD", (1, 1, 1), square, -200, 0)
    twice = add_vector(tree, "SCALE", forward, 2, -200, -200)
    base = add_vector(tree, "SUBTRACT", base, twice, 0, 0)
    peak = add_vector(tree, "POWER", base, (-1.5,) * 3, 200, 0)
    phase = add_vector(tree, "MULTIPLY", straight, peak, 400, 200)
    scattered = add_vector(tree, "MULTIPLY", light, phase, 600, 0)
    total = add_vector(tree, "ADD", others, scattered, 800, 0)
    output = add_node(tree, "NodeGroupOutput", 1000, 0)
    tree.links.new(total, output.inputs["Radiance"])


def _build_moments(tree):
    add_output(tree, "Radiance", "Vector", "Connect to Direct of LB Volume Light")
    others = "Radiance of the beams, in W/(m2 sr)"
    add_input(tree, "Others", "Vector", others, limits=ANY, hidden=True)
    group = add_node(tree, "NodeGroupInput", -1000, 400)
    # In a volume this is the way from the place to the eye.
    incoming = add_node(tree, "ShaderNodeNewGeometry", -1200, 0).outputs["Incoming"]
    eye = add_node(tree, "ShaderNodeSeparateXYZ", -1000, 0)
    tree.links.new(incoming, eye.inputs[0])
    x, y, z = eye.outputs

    def times(a, b, place):
        return add_math(tree, "MULTIPLY", a, b, -800, place)

    mixed = [times(a, b, -200 * n) for n, (a, b) in enumerate(((x, y), (y, z), (z, x)))]
    xx, yy, zz = (times(a, a, -600 - 200 * n) for n, a in enumerate((x, y, z)))
    three = add_math(tree, "SUBTRACT", times(zz, 3.0, -1200), 1.0, -600, -1200)
    difference = add_math(tree, "SUBTRACT", xx, yy, -600, -800)
    total = group.outputs["Others"]
    for number, polynomial in enumerate((x, y, z, *mixed, three, difference), 1):
        down = -200 * number
        grid = add_attribute(tree, moment_grid(number), -400, down).outputs["Vector"]
        own = add_vector(tree, "SCALE", grid, polynomial, -200, down)
        total = add_vector(tree, "ADD", total, own, 0, down)
    output = add_node(tree, "NodeGroupOutput", 200, 0)
    tree.links.new(total, output.inputs["Radiance"])


def _build_lamp(tree):
    add_output(tree, "Light", "Vector", "Connect to Light of LB Beam, in W/(m2 sr)")
    for axis in AXES:
        add_output(tree, axis, "Float", f"Connect to {axis} of LB Beam")
    intensity = "What is left of the lamp's light: its grid lb_direct_1, lb_direct_2 ..., in W/sr"
    add_input(tree, "Intensity", "Vector", intensity, limits=ANY, hidden=True)
    add_input(tree, "Position", "Vector", "Where the lamp stands, in m", (0, 0, 0))
    add_input(tree, "Radius", "Float", "The lamp's radius, in m, which softens it", 0.0, ANY)
    core = "Edge of a voxel, in m; closer to the lamp its light rises in a straight line"
    add_input(tree, "Core", "Float", core, 0.0, ANY)
    peak = "To how much it rises at the lamp, over what it is at the edge of the core"
    add_input(tree, "Peak", "Float", peak, 1.0, ANY)
    group = add_node(tree, "NodeGroupInput", -1000, 0)
    intensity, position, radius, core, peak = group.outputs[:5]
    place = add_node(tree, "ShaderNodeNewGeometry", -1000, -300).outputs["Position"]
    away = add_vector(tree, "SUBTRACT", place, position, -800, -300)
    distance = add_vector(tree, "LENGTH", away, (0, 0, 0), -600, -200)
    toward = add_vector(tree, "NORMALIZE", away, (0, 0, 0), -600, -400)
    parts = add_node(tree, "ShaderNodeSeparateXYZ", 400, -400)
    tree.links.new(toward, parts.inputs[0])

    edge = add_math(tree, "MAXIMUM", distance, core, -400, -200)
    squares = [add_math(tree, "MULTIPLY", v, v, -200, y) for v, y in ((edge, -200), (radius, 0))]
    slant = add_math(tree, "SQRT", add_math(tree, "ADD", *squares, -100, -100), 0.0, 0, -100)
    both = add_math(tree, "MULTIPLY", slant, add_math(tree, "ADD", slant, edge, 0, -300), 200, -200)
    # 1 + (Peak - 1) (1 - r / q) = Peak + (1 - Peak) r / q
    fall = add_math(tree, "SUBTRACT", 1.0, peak, -400, 200)
    share = add_math(tree, "DIVIDE", distance, edge, -200, 200)
    rise = add_math(tree, "ADD", peak, add_math(tree, "MULTIPLY", fall, share, 0, 200), 200, 200)
    twice = add_math(tree, "MULTIPLY", rise, 2.0, 300, 200)
    falloff = add_math(tree, "DIVIDE", twice, both, 400, 0)
    light = add_vector(tree, "SCALE", intensity, falloff, 600, 0)
    output = add_node(tree, "NodeGroupOutput", 800, 0)
    tree.links.new(light, output.inputs["Light"])
    for axis in AXES:
        tree.links.new(parts.outputs[axis], output.inputs[axis])


def _build_ambient(tree):
    add_output(tree, "Shader", "Shader", "Connect where the closure was")
    add_input(tree, "Shader", "Shader", "The closure to add ambient light to")
    color = "Share of the light that comes back, or through"
    add_input(tree, "Color", "Color", color, (0.8, 0.8, 0.8, 1.0))
    add_input(tree, "Alpha", "Float", "Share of the closure that is there", 1.0, (0, 1))
    strength = "Factor on the light; 1 is as bright as the lamps make it"
    add_input(tree, "Strength", "Float", strength, 1.0, ANY)
    through = "On: the closure is translucent, and shows the light of the side that is not seen"
    add_input(tree, "Through", "Bool", through, False)
    metallic = "Share of the closure that mirrors, and shows what Cycles finds in it"
    add_input(tree, "Metallic", "Float", metallic, 0.0, (0, 1))
    group = add_node(tree, "NodeGroupInput", -1000, 100)
    front = add_attribute(tree, AMBIENT_ATTRIBUTE, -800, -100).outputs["Vector"]
    back = add_attribute(tree, BACK_ATTRIBUTE, -800, -300).outputs["Vector"]
    surface = add_node(tree, "ShaderNodeNewGeometry", -1000, -100)
    is_seen = _seen(tree, -1000, -500)
    shader, color, alpha, strength, through, metallic = group.outputs[:6]

    is_front = add_math(tree, "COMPARE", surface.outputs["Backfacing"], through, -800, 100)
    light = add_mix(tree, is_front, back, front, -550, 0)
    mean = add_attribute(tree, AMBIENT_ATTRIBUTE, -1800, -700, of="INSTANCER")
    own = _instance_light(tree, mean, surface.outputs["Normal"], through)
    light = add_mix(tree, mean.outputs["Alpha"], light, own, -450, 0)

    emission = add_node(tree, "ShaderNodeEmission", -150, -100)
    shown = add_vector(tree, "MULTIPLY", color, light, -350, 0)
    tree.links.new(shown, emission.inputs["Color"])
    seen = add_node(tree, "ShaderNodeClamp", -550, -200)  # as the Principled BSDF clamps its alpha
    tree.links.new(alpha, seen.inputs["Value"])
    dull = add_math(tree, "SUBTRACT", 1.0, metallic, -550, -400)
    dull = add_math(tree, "MAXIMUM", dull, 0.0, -350, -400)
    factor = add_math(tree, "MULTIPLY", seen.outputs["Result"], strength, -350, -200)
    factor = add_math(tree, "MULTIPLY", factor, dull, -250, -300)
    tree.links.new(factor, emission.inputs["Strength"])
    # Cycles leaves out what has no weight in a mix: other rays need not find the light.
    mix = add_node(tree, "ShaderNodeMixShader", 50, -100)
    tree.links.new(is_seen, mix.inputs[0])
    tree.links.new(emission.outputs["Emission"], mix.inputs[2])
    left = _left(tree, shader, seen.outputs["Result"])
    add = add_node(tree, "ShaderNodeAddShader", 250, 0)
    tree.links.new(left, add.inputs[0])
    tree.links.new(mix.outputs["Shader"], add.inputs[1])
    output = add_node(tree, "NodeGroupOutput", 450, 0)
    tree.links.new(add.outputs["Shader"], output.inputs["Shader"])


def _left(tree, shader, alpha):
    """The socket of what is left of the closure `shader` for the rays that find it.

    Holes, where `alpha` is 0, stay, and no Transparent BSDF is needed, which slows shadows down.
    """
    path = add_node(tree, "ShaderNodeLightPath", -550, 400).outputs
    rays = path["Is Diffuse Ray"], path["Is Transmission Ray"]
    scattered = add_math(tree, "MULTIPLY", *rays, -350, 400)
    mix = add_node(tree, "ShaderNodeMixShader", 50, 300)
    tree.links.new(add_math(tree, "MULTIPLY", scattered, alpha, -150, 400), mix.inputs[0])
    tree.links.new(shader, mix.inputs[1])
    return mix.outputs["Shader"]


def _build_rest(tree):
    add_output(tree, "Color", "Color", "Connect where the colour was")
    color = "The colour of the closure, which shows all its light by LB Ambient"
    add_input(tree, "Color", "Color", color, (0.8, 0.8, 0.8, 1.0))
    color = add_node(tree, "NodeGroupInput", -400, 200).outputs["Color"]
    seen = _seen(tree, -1000, 200)
    hidden = 0.0
    for of, names, y in (
        ("GEOMETRY", (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE), -200),
        ("INSTANCER", (AMBIENT_ATTRIBUTE,), -900),
    ):
        light = (0, 0, 0)
        for name in names:
            y -= 200
            own = add_attribute(tree, name, -1000, y, of).outputs["Vector"]
            light = add_vector(tree, "ADD", own, light, -800, y)
        length = add_vector(tree, "LENGTH", light, (0, 0, 0), -600, y)
        there = add_math(tree, "GREATER_THAN", length, 0.0, -400, y)
        whole = add_attribute(tree, WHOLE_ATTRIBUTE, -400, y + 200, of).outputs["Factor"]
        there = add_math(tree, "MULTIPLY", there, whole, -200, y)
        hidden = add_math(tree, "MAXIMUM", there, hidden, 0, y)
    shown = add_math(tree, "MULTIPLY", seen, hidden, 0, 0)
    left = add_math(tree, "SUBTRACT", 1.0, shown, 200, 0)
    rest = add_vector(tree, "SCALE", color, left, 400, 100)
    output = add_node(tree, "NodeGroupOutput", 600, 100)
    tree.links.new(rest, output.inputs["Color"])


def _instance_light(tree, mean, normal, through):
    """The socket of the light on the side which the socket `normal` points to, or on the other.

    mean  Attribute node of the instance: the mean of both sides
    """
    parts = add_node(tree, "ShaderNodeSeparateXYZ", -1800, -1000)
    tree.links.new(normal, parts.inputs[0])
    along = (0, 0, 0)
    for number, axis in enumerate(AXES):
        y = -900 - 200 * number
        flux = add_attribute(tree, ambient_axis(axis), -1600, y, of="INSTANCER").outputs["Vector"]
        flux = add_vector(tree, "SCALE", flux, parts.outputs[axis], -1400, y)
        along = add_vector(tree, "ADD", along, flux, -1200, y)
    twice = add_math(tree, "MULTIPLY", through, 2.0, -1400, -700)
    sign = add_math(tree, "SUBTRACT", twice, 1.0, -1200, -700)  # light comes against the normal
    along = add_vector(tree, "SCALE", along, sign, -1000, -900)
    light = add_vector(tree, "ADD", mean.outputs["Vector"], along, -800, -900)
    return add_vector(tree, "MAXIMUM", light, (0, 0, 0), -600, -900)
