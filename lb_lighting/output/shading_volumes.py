# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials that show baked light in volumes, by the node group `LB Volume Light`.

"REPLACE" replaces the source object. The baked volume absorbs, and emits all light that scatters
towards the eye. Nothing in it scatters, so Cycles has nothing left to sample. The uncollided light
of each lamp comes from one direction, and a node `LB Beam` computes how much of it scatters towards
the eye.

"ADD" lies over the source and only emits, and only for rays that the eye sees directly. On other
rays Cycles would scatter the emission once more and count it twice.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import bpy

from ..arrays import Spectrum
from ..ours import TAG, is_ours
from .keys import remove_keys, set_values
from .look import Bands, Beam, Look
from .nodes import new_material
from .vdb import AXES, direct_grid, forward_grid
from .volume_groups import (
    BEAM_GROUP,
    MOMENTS_GROUP,
    VOLUME_GROUP,
    beam_group,
    lamp_group,
    moments_group,
    volume_group,
)

type Inputs = dict[str, float | Bands]  # {input: value} of one beam, see `Look.beams`


def shade_volume(
    ob: bpy.types.Object,
    mode: str,
    sigma_s: Spectrum,
    sigma_a: Spectrum,
    g: Spectrum = 0.0,
    beams: Sequence[Beam] = (),
    core: float = 0.0,
    strength: float = 1.0,
    lobes: Spectrum | None = None,
) -> None:
    """Give the baked Volume object `ob` the material that shows its light.

    mode      "REPLACE" or "ADD"
    strength  factor on the light, dimensionless

    See `Look.of` for the others.
    """
    look = Look.of(sigma_s, sigma_a, g, beams, core, lobes)
    shade_frames(ob, mode, {0: look}, strength)


def shade_frames(
    ob: bpy.types.Object, mode: str, looks: Mapping[int, Look], strength: float = 1.0
) -> None:
    """Give the baked Volume object `ob` of a sequence its material, see `shade_volume`.

    looks  {frame: Look}; values that differ get a keyframe in each of these frames, and hold until
           the next
    """
    volume_group()  # updates the group of an older file
    assert isinstance(ob.data, bpy.types.Volume)
    tree = _volume_tree(ob.data)
    # Remove what an earlier bake left.
    remove_keys(tree)
    for node in [node for node in tree.nodes if is_ours(node)]:
        tree.nodes.remove(node)
    # Set the inputs of the medium.
    inputs: Any = next(node for node in tree.nodes if node.type == "GROUP").inputs
    inputs["Strength"].default_value = strength
    inputs["Replace"].default_value = mode == "REPLACE"
    set_values(tree, inputs["Sigma S"], {frame: look.sigma_s for frame, look in looks.items()})
    set_values(tree, inputs["Sigma A"], {frame: look.sigma_a for frame, look in looks.items()})
    set_values(tree, inputs["G"], {frame: look.g for frame, look in looks.items()})
    # Chain the nodes that add light with a direction.
    target = inputs["Direct"]
    if any(look.lobes for look in looks.values()):
        target = _insert_moments(tree, target)
    _insert_beams(tree, target, looks)


def remove_unused() -> None:
    """Remove our materials, node groups and actions that nothing uses."""
    for blocks in (bpy.data.materials, bpy.data.node_groups, bpy.data.actions):
        while unused := [block for block in blocks if is_ours(block) and not block.users]:
            bpy.data.batch_remove(unused)  # may free others that only these used


def _volume_tree(volume: bpy.types.Volume) -> bpy.types.NodeTree:
    """The node tree of our material of the Volume data-block `volume`, made if it has none."""
    material = next((m for m in volume.materials if m and is_ours(m)), None)
    if material is None:
        material = _volume_material(volume.name)
        volume.materials.append(material)
    assert material.node_tree
    return material.node_tree


def _volume_material(name: str) -> bpy.types.Material:
    material = new_material(name, VOLUME_GROUP)
    tree: Any = material.node_tree
    light = tree.nodes.new("ShaderNodeGroup")
    light.node_tree = volume_group()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    tree.links.new(light.outputs["Volume"], output.inputs["Volume"])
    return material


def _insert_moments(tree: bpy.types.NodeTree, target: Any) -> Any:
    """Link the moments of scattered light to the socket `target`; the socket for the beams."""
    node: Any = tree.nodes.new("ShaderNodeGroup")
    node.location = 0, 250
    node.node_tree = moments_group()
    node[TAG] = node.label = MOMENTS_GROUP
    tree.links.new(node.outputs["Radiance"], target)
    return node.inputs["Others"]


def _insert_beams(tree: bpy.types.NodeTree, target: Any, looks: Mapping[int, Look]) -> None:
    """Chain a node for each grid of a beam, and for each kind of its light, to `target`."""
    once = {frame: look.g for frame, look in looks.items()}
    # Light that has scattered forwards before has the mean cosine g to the beam.
    twice = {n: look.lobes or _squares(look.g) for n, look in looks.items()}
    is_forward = max(map(max, once.values())) > 0
    grids = [(direct_grid, once), *([(forward_grid, twice)] if is_forward else [])]
    count = 0
    for number, beams in enumerate(_by_number(looks), 1):
        for grid, g in grids:
            for beams_of_kind in _by_kind(beams):
                count += 1
                target = _insert_beam(tree, target, count, grid(number), beams_of_kind, g)


def _squares(g: Bands) -> Bands:
    red, green, blue = g
    return red * red, green * green, blue * blue


def _by_number(looks: Mapping[int, Look]) -> list[dict[int, Inputs]]:
    """[{frame: beam}] by the number of the beam, for the frames that have it; see `Look.beams`."""
    most = max(len(look.beams) for look in looks.values())
    return [
        {frame: look.beams[n] for frame, look in looks.items() if n < len(look.beams)}
        for n in range(most)
    ]


def _by_kind(beams: Mapping[int, Inputs]) -> list[dict[int, Inputs | None]]:
    """[{frame: beam or None}], suns and lamps apart; None where a frame has the other kind."""
    kinds = dict.fromkeys("Position" in beam for beam in beams.values())
    return [
        {frame: beam if ("Position" in beam) == kind else None for frame, beam in beams.items()}
        for kind in kinds
    ]


def _insert_beam(
    tree: bpy.types.NodeTree,
    target: Any,
    number: int,
    name: str,
    beams: Mapping[int, Inputs | None],
    g: Mapping[int, Bands],
) -> Any:
    """Link the `number`-th beam, from 1, to the socket `target`; the socket for the next one.

    name   of its grid
    beams  {frame: beam or None}, all of one kind; None where the grid holds light of another kind
    g      {frame: mean cosine of the scattering angle}
    """
    x, y = -250 * number, -300
    # Look up the light, in the frames whose grid holds this kind.
    node = _new_node(tree, "ShaderNodeGroup", x, y)
    node.node_tree = beam_group()
    node.label = name
    set_values(tree, node.inputs["G"], g)
    grid = _new_node(tree, "ShaderNodeAttribute", x - 250, y)
    grid.attribute_name = name
    light = grid.outputs["Vector"]
    known = {frame: beam for frame, beam in beams.items() if beam is not None}
    if len(known) < len(beams):
        share = _new_node(tree, "ShaderNodeVectorMath", x - 250, y - 400)
        share.operation = "SCALE"
        shown = {frame: float(beam is not None) for frame, beam in beams.items()}
        set_values(tree, share.inputs["Scale"], shown)
        tree.links.new(light, share.inputs[0])
        light = share.outputs["Vector"]
    # Set the direction of a sun, or compute that and the falloff of a lamp.
    values = {
        name: {n: beam[name] for n, beam in known.items()} for name in next(iter(known.values()))
    }
    receiver = node
    if "Position" in values:
        receiver = _insert_lamp(tree, node, light, x - 250, y - 200)
        light = receiver.outputs["Light"]
    for name, by_frame in values.items():
        set_values(tree, receiver.inputs[name], by_frame)
    # Link the beam into the chain.
    tree.links.new(light, node.inputs["Light"])
    tree.links.new(node.outputs["Radiance"], target)
    return node.inputs["Others"]


def _insert_lamp(tree: bpy.types.NodeTree, beam: Any, light: Any, x: float, y: float) -> Any:
    """An `LB Lamp` node that gives the node `beam` the direction of the light `light`."""
    node = _new_node(tree, "ShaderNodeGroup", x, y)
    node.node_tree = lamp_group()
    tree.links.new(light, node.inputs["Intensity"])
    for axis in AXES:
        tree.links.new(node.outputs[axis], beam.inputs[axis])
    return node


def _new_node(tree: bpy.types.NodeTree, kind: str, x: float, y: float) -> Any:
    """A node that the next bake replaces."""
    node: Any = tree.nodes.new(kind)
    node.location = x, y
    node[TAG] = BEAM_GROUP
    return node
