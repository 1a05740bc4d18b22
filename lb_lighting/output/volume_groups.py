# SPDX-License-Identifier: GPL-3.0-or-later
"""The node groups of volumes: `LB Volume Light`, `LB Beam`, `LB Moments` and `LB Lamp`."""

from typing import Any

from .groups import ANY, COSINE, add_seen, our_group
from .nodes import (
    Operand,
    Socket,
    add_attribute,
    add_input,
    add_math,
    add_node,
    add_output,
    add_vector,
    separate,
)
from .vdb import AXES, DENSITY_GRID, EMISSION_GRID, LIGHT_GRID, flux_grid, moment_grid

VOLUME_GROUP = "LB Volume Light"
BEAM_GROUP = "LB Beam"
MOMENTS_GROUP = "LB Moments"
LAMP_GROUP = "LB Lamp"

MEAN_COSINE = "Mean cosine of the scattering angle of red, green and blue; 1 is straight ahead"


def volume_group() -> Any:
    """Absorption and emission of the baked volume.

    Replace on:  absorption (sigma_s + sigma_a) density, emission sigma_s density (light + Direct),
                 and the medium's own emission
    Replace off: the same emission without the medium's own, for rays that the eye sees directly
                 (`add_seen`), and no absorption

    The light scatters towards the eye as if it came from all sides by the Henyey-Greenstein law
    with the mean cosine of its net flux. Scattering keeps that law and multiplies the mean cosines,
    so an LB Beam does both. If the light comes from a source iteration, the file has no net flux,
    and LB Moments precedes the beams.
    """
    return our_group(VOLUME_GROUP, _build_volume)


def beam_group() -> Any:
    """Others + Light p: adds the light of one beam, of mean radiance Light, that scatters to the
    eye.

    p is the Henyey-Greenstein phase function over that of isotropic scattering, band by band:
    (1 - m^2) / (1 + m^2 - 2 m cos)^1.5, where m is G times the length of the light's mean direction
    (X, Y, Z), and cos is the cosine of its angle to the direction of the eye.
    """
    return our_group(BEAM_GROUP, _build_beam)


def moments_group() -> Any:
    """Others + the sum of each `moment_grid` times its polynomial of the direction of the eye."""
    return our_group(MOMENTS_GROUP, _build_moments)


def lamp_group() -> Any:
    """The light of a lamp at the shading point, and its direction there, the unit vector (X, Y, Z).

    The light is Intensity times `PointLight.falloff`. Let q be the larger of the distance r and the
    Core, and h the hypotenuse over q and Radius: (1 + (Peak - 1) (1 - r / q)) 2 / (h (h + q)).
    """
    return our_group(LAMP_GROUP, _build_lamp)


def _build_volume(tree: Any) -> None:
    _add_volume_sockets(tree)
    group = add_node(tree, "NodeGroupInput", -800, 0)
    density = add_attribute(tree, DENSITY_GRID, -800, 300)
    light = add_attribute(tree, LIGHT_GRID, -1200, -200).outputs["Vector"]
    seen = add_seen(tree, -1800, -800)
    strength, sigma_s, sigma_a, replace, direct, g = group.outputs[:6]

    # Absorb, in "REPLACE" alone.
    sigma_t = add_vector(tree, "ADD", sigma_s, sigma_a, -600, 200)
    matter = add_math(tree, "MULTIPLY", density.outputs["Factor"], replace, -600, 400)
    absorption = add_vector(tree, "SCALE", sigma_t, matter, -200, 200)

    # Scatter the light of many directions towards the eye, and add the beams.
    visible = add_math(tree, "MAXIMUM", seen, replace, -600, -400)
    glow = add_math(tree, "MULTIPLY", density.outputs["Factor"], strength, -600, 0)
    beam = add_node(tree, "ShaderNodeGroup", -600, -200)
    beam.node_tree = beam_group()
    for name, value in (("Others", direct), ("Light", light), ("G", g)):
        tree.links.new(value, beam.inputs[name])
    for number, axis in enumerate(AXES):
        flux = add_attribute(tree, flux_grid(axis), -1200, -400 - 200 * number)
        tree.links.new(flux.outputs["Vector"], beam.inputs[axis])
    # A truncated series of moments can be negative where little light goes.
    light = add_vector(tree, "MAXIMUM", beam.outputs["Radiance"], (0, 0, 0), -400, -400)
    scattered = add_vector(tree, "MULTIPLY", sigma_s, light, -400, -200)
    factor = add_math(tree, "MULTIPLY", glow, visible, -400, 0)
    emission = add_vector(tree, "SCALE", scattered, factor, -200, -100)
    # Add the medium's own emission.
    fire = add_attribute(tree, EMISSION_GRID, -600, -600).outputs["Vector"]
    fire = add_vector(tree, "SCALE", fire, replace, -400, -600)
    emission = add_vector(tree, "ADD", emission, fire, -200, -300)

    # Output a volume that does not scatter.
    volume = add_node(tree, "ShaderNodeVolumeCoefficients", 0, 100)
    volume.inputs["Scatter Coefficients"].default_value = (0, 0, 0)
    tree.links.new(absorption, volume.inputs["Absorption Coefficients"])
    tree.links.new(emission, volume.inputs["Emission Coefficients"])
    output = add_node(tree, "NodeGroupOutput", 250, 100)
    tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])


def _add_volume_sockets(tree: Any) -> None:
    add_output(tree, "Volume", "Shader", "Connect to Volume of the Material Output")
    strength = "Factor on the light; 1 is the brightness that the lamps give"
    add_input(tree, "Strength", "Float", strength, 1.0, ANY)
    scattering = "Scattering coefficient at density 1 of red, green and blue, in 1/m"
    add_input(tree, "Sigma S", "Vector", scattering, (1, 1, 1), ANY)
    absorption = "Absorption coefficient at density 1 of red, green and blue, in 1/m"
    add_input(tree, "Sigma A", "Vector", absorption, (0, 0, 0), ANY)
    replace = (
        "On: show the medium and all its light. "
        "Off: add light over the source, for what the camera sees"
    )
    add_input(tree, "Replace", "Bool", replace, True)
    direct = "Direct light of lamps that scatters towards the camera, from LB Beam, in W/(m2 sr)"
    add_input(tree, "Direct", "Vector", direct, limits=ANY, hidden=True)
    add_input(tree, "G", "Vector", MEAN_COSINE, (0, 0, 0), COSINE)


def _build_beam(tree: Any) -> None:
    chain = "Connect to Others of the next beam, or to Direct of LB Volume Light"
    add_output(tree, "Radiance", "Vector", chain)
    others = "Radiance of the previous beams, in W/(m2 sr)"
    add_input(tree, "Others", "Vector", others, limits=ANY, hidden=True)
    light = "Mean radiance of this beam: its grid lb_direct_1, lb_direct_2, ..., in W/(m2 sr)"
    add_input(tree, "Light", "Vector", light, limits=ANY, hidden=True)
    for axis in AXES:
        component = (
            f"{axis} of the mean direction of red, green and blue light; each length is 0 to 1"
        )
        # Light without a direction scatters evenly.
        add_input(tree, axis, "Vector", component, (0, 0, 0), COSINE)
    add_input(tree, "G", "Vector", MEAN_COSINE, (0, 0, 0), COSINE)
    group = add_node(tree, "NodeGroupInput", -1000, 0)
    others, light, *components, g = group.outputs[:6]
    # In a volume, Incoming points from the shading point to the eye.
    incoming = add_node(tree, "ShaderNodeNewGeometry", -1200, -300).outputs["Incoming"]
    eye = separate(tree, incoming, -1000, -300)

    # Sum up the square of G times the mean direction, and its component towards the eye.
    square: Operand = (0, 0, 0)
    forward: Operand = (0, 0, 0)
    for number, component in enumerate(components):
        y = -200 * number
        kept = add_vector(tree, "MULTIPLY", g, component, -800, y)
        term = add_vector(tree, "MULTIPLY", kept, kept, -600, y)
        square = add_vector(tree, "ADD", square, term, -400, y)
        term = add_vector(tree, "SCALE", kept, eye[number], -600, y - 600)
        forward = add_vector(tree, "ADD", forward, term, -400, y - 600)
    # Compute the phase function.
    straight = add_vector(tree, "SUBTRACT", (1, 1, 1), square, -200, 200)
    base = add_vector(tree, "ADD", (1, 1, 1), square, -200, 0)
    twice = add_vector(tree, "SCALE", forward, 2, -200, -200)
    base = add_vector(tree, "SUBTRACT", base, twice, 0, 0)
    peak = add_vector(tree, "POWER", base, (-1.5,) * 3, 200, 0)
    phase = add_vector(tree, "MULTIPLY", straight, peak, 400, 200)
    # Add the light to that of the others.
    scattered = add_vector(tree, "MULTIPLY", light, phase, 600, 0)
    total = add_vector(tree, "ADD", others, scattered, 800, 0)
    output = add_node(tree, "NodeGroupOutput", 1000, 0)
    tree.links.new(total, output.inputs["Radiance"])


def _build_moments(tree: Any) -> None:
    add_output(tree, "Radiance", "Vector", "Connect to Direct of LB Volume Light")
    others = "Radiance of the beams, in W/(m2 sr)"
    add_input(tree, "Others", "Vector", others, limits=ANY, hidden=True)
    group = add_node(tree, "NodeGroupInput", -1000, 400)
    # In a volume, Incoming points from the shading point to the eye.
    incoming = add_node(tree, "ShaderNodeNewGeometry", -1200, 0).outputs["Incoming"]
    x, y, z = separate(tree, incoming, -1000, 0)

    def times(a: Operand, b: Operand, place: float) -> Socket:
        return add_math(tree, "MULTIPLY", a, b, -800, place)

    # Compute the polynomials.
    mixed = [times(a, b, -200 * n) for n, (a, b) in enumerate(((x, y), (y, z), (z, x)))]
    xx, yy, zz = (times(a, a, -600 - 200 * n) for n, a in enumerate((x, y, z)))
    three = add_math(tree, "SUBTRACT", times(zz, 3.0, -1200), 1.0, -600, -1200)
    difference = add_math(tree, "SUBTRACT", xx, yy, -600, -800)
    # Add each moment times its polynomial.
    total = group.outputs["Others"]
    for number, polynomial in enumerate((x, y, z, *mixed, three, difference), 1):
        down = -200 * number
        grid = add_attribute(tree, moment_grid(number), -400, down).outputs["Vector"]
        term = add_vector(tree, "SCALE", grid, polynomial, -200, down)
        total = add_vector(tree, "ADD", total, term, 0, down)
    output = add_node(tree, "NodeGroupOutput", 200, 0)
    tree.links.new(total, output.inputs["Radiance"])


def _build_lamp(tree: Any) -> None:
    _add_lamp_sockets(tree)
    group = add_node(tree, "NodeGroupInput", -1000, 0)
    intensity, position, radius, core, peak = group.outputs[:5]
    # Find the distance and the direction from the lamp.
    place = add_node(tree, "ShaderNodeNewGeometry", -1000, -300).outputs["Position"]
    away = add_vector(tree, "SUBTRACT", place, position, -800, -300)
    distance = add_vector(tree, "LENGTH", away, (0, 0, 0), -600, -200)
    direction = add_vector(tree, "NORMALIZE", away, (0, 0, 0), -600, -400)
    components = add_node(tree, "ShaderNodeSeparateXYZ", 400, -400)
    tree.links.new(direction, components.inputs[0])

    # Compute the falloff; 1 + (Peak - 1) (1 - r / q) = Peak + (1 - Peak) r / q.
    edge = add_math(tree, "MAXIMUM", distance, core, -400, -200)
    near = add_math(tree, "MULTIPLY", edge, edge, -200, -200)
    wide = add_math(tree, "MULTIPLY", radius, radius, -200, 0)
    slant = add_math(tree, "ADD", near, wide, -100, -100)
    slant = add_math(tree, "SQRT", slant, 0.0, 0, -100)
    both = add_math(tree, "MULTIPLY", slant, add_math(tree, "ADD", slant, edge, 0, -300), 200, -200)
    fall = add_math(tree, "SUBTRACT", 1.0, peak, -400, 200)
    share = add_math(tree, "DIVIDE", distance, edge, -200, 200)
    rise = add_math(tree, "ADD", peak, add_math(tree, "MULTIPLY", fall, share, 0, 200), 200, 200)
    twice = add_math(tree, "MULTIPLY", rise, 2.0, 300, 200)
    falloff = add_math(tree, "DIVIDE", twice, both, 400, 0)
    light = add_vector(tree, "SCALE", intensity, falloff, 600, 0)
    output = add_node(tree, "NodeGroupOutput", 800, 0)
    tree.links.new(light, output.inputs["Light"])
    for axis in AXES:
        tree.links.new(components.outputs[axis], output.inputs[axis])


def _add_lamp_sockets(tree: Any) -> None:
    add_output(tree, "Light", "Vector", "Connect to Light of LB Beam, in W/(m2 sr)")
    for axis in AXES:
        add_output(tree, axis, "Float", f"Connect to {axis} of LB Beam")
    intensity = "Direct light of the lamp: its grid lb_direct_1, lb_direct_2, ..., in W/sr"
    add_input(tree, "Intensity", "Vector", intensity, limits=ANY, hidden=True)
    add_input(tree, "Position", "Vector", "Position of the lamp, in m", (0, 0, 0))
    add_input(tree, "Radius", "Float", "Radius of the lamp, in m, which softens it", 0.0, ANY)
    core = "Size of a voxel, in m; at smaller distances from the lamp its light rises linearly"
    add_input(tree, "Core", "Float", core, 0.0, ANY)
    peak = "Light at the lamp, as a multiple of the light at the distance Core"
    add_input(tree, "Peak", "Float", peak, 1.0, ANY)
