# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry node groups `LB Ambient Grid` and `LB Ambient Grid of Walls`, see `modifier`."""

from typing import Any

from .ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    LEAST_OPEN,
    OPEN_GRID,
    WHOLE_ATTRIBUTE,
    ambient_axis,
)
from .groups import ANY, our_group
from .nodes import Operand, Socket, add_input, add_math, add_node, add_output, add_vector
from .vdb import AXES

GRID_GROUP = "LB Ambient Grid"
WALL_GROUP = "LB Ambient Grid of Walls"
WHOLE, BODY, STAND_OFF = "All Light", "Filled", "Stand Off"  # inputs


def grid_group() -> Any:
    """Our geometry node group, made if the file does not have it yet."""
    return our_group(GRID_GROUP, _build, "GeometryNodeTree")


def wall_group() -> Any:
    """The group for walls: it samples the light in front of each side, at twice the cost."""
    return our_group(WALL_GROUP, lambda tree: _build(tree, is_wall=True), "GeometryNodeTree")


def _build(tree: Any, is_wall: bool = False) -> None:
    tree.is_modifier = True
    _add_sockets(tree, is_wall)
    group = add_node(tree, "NodeGroupInput", -1800, 0)
    geometry, baked, strength, realize, all_light, is_body = group.outputs[:6]

    geometry = _realized(tree, geometry, realize)
    parts = add_node(tree, "GeometryNodeSeparateComponents", -1000, 400)
    tree.links.new(geometry, parts.inputs["Geometry"])
    # Sample the light, of walls on either side.
    volume, place, normal = _place(tree, baked)
    if is_wall:
        offset = add_vector(tree, "SCALE", normal, group.outputs[STAND_OFF], -800, -900)
        front_place = add_vector(tree, "ADD", place, offset, -600, -900)
        back_place = add_vector(tree, "SUBTRACT", place, offset, -600, -1100)
        front = _light(tree, volume, front_place, strength, 0)
        back = _light(tree, volume, back_place, strength, -1200)
    else:
        front = back = _light(tree, volume, place, strength, 0)
    # Store it on points and on instances.
    mesh = _store_sides(tree, parts.outputs["Mesh"], front, back, normal, is_body)
    instances = parts.outputs["Instances"]
    for number, (name, value) in enumerate(front.items()):
        x = 600 + 200 * number
        instances = _store(tree, instances, name, value, x, 700, domain="INSTANCE")
    mesh = _store(tree, mesh, WHOLE_ATTRIBUTE, all_light, 1200, 300, kind="FLOAT")
    instances = _store(tree, instances, WHOLE_ATTRIBUTE, all_light, 1400, 700, "INSTANCE", "FLOAT")

    # Join all components again.
    join = add_node(tree, "GeometryNodeJoinGeometry", 1500, 400)
    others = [s for s in parts.outputs if s.enabled and s.name not in ("Mesh", "Instances")]
    for part in (*others, instances, mesh):
        tree.links.new(part, join.inputs[0])
    output = add_node(tree, "NodeGroupOutput", 1700, 400)
    tree.links.new(join.outputs[0], output.inputs["Geometry"])


def _add_sockets(tree: Any, is_wall: bool) -> None:
    add_output(tree, "Geometry", "Geometry", "The plant with its light")
    add_input(tree, "Geometry", "Geometry", "The plant; its meshes and instances are lit")
    add_input(tree, "Volume", "Object", "The baked Volume object to read the light from")
    add_input(tree, "Strength", "Float", "Factor on the light of this object", 1.0, ANY)
    realize = (
        "On: make instances real and light each of their points. "
        "Off: keep instances; each has the light at its origin"
    )
    add_input(tree, "Realize Instances", "Bool", realize, False)
    all_light = "On: the baked light includes the direct light of the sky"
    add_input(tree, WHOLE, "Bool", all_light, False)
    add_input(tree, BODY, "Bool", "On: both sides show the light that leaves the body", False)
    if is_wall:
        stand_off = "Distance from each side at which its light is sampled, in m"
        add_input(tree, STAND_OFF, "Float", stand_off, 0.0, ANY)


def _realized(tree: Any, geometry: Socket, realize: Socket) -> Socket:
    """The socket of `geometry`, with real instances where the socket `realize` is on."""
    node = add_node(tree, "GeometryNodeRealizeInstances", -1400, 500)
    switch = add_node(tree, "GeometryNodeSwitch", -1200, 400)
    switch.input_type = "GEOMETRY"
    tree.links.new(geometry, node.inputs["Geometry"])
    tree.links.new(realize, switch.inputs["Switch"])
    tree.links.new(geometry, switch.inputs["False"])
    tree.links.new(node.outputs["Geometry"], switch.inputs["True"])
    return switch.outputs["Output"]


def _place(tree: Any, baked: Socket) -> tuple[Socket, Socket, Socket]:
    """The sockets of the geometry of the Volume object `baked`, and of the position and the unit
    normal of each element in its space.

    A bake puts the Volume object at the world's origin.
    """
    info = add_node(tree, "GeometryNodeObjectInfo", -1600, -200)
    here = add_node(tree, "GeometryNodeObjectInfo", -1600, -500)
    info.transform_space, here.transform_space = "ORIGINAL", "RELATIVE"
    for node in (info, here):
        tree.links.new(baked, node.inputs["Object"])
    to_baked = _applied(tree, "FunctionNodeInvertMatrix", here.outputs["Transform"], -1400, -500)
    # The inverse transpose transforms normals.
    turn = _applied(tree, "FunctionNodeTransposeMatrix", here.outputs["Transform"], -1400, -700)

    place = add_node(tree, "GeometryNodeInputPosition", -1400, -350).outputs["Position"]
    place = _transformed(tree, "FunctionNodeTransformPoint", "Vector", place, to_baked, -1200, -350)
    normal = add_node(tree, "GeometryNodeInputNormal", -1400, -900).outputs["True Normal"]
    direction = "FunctionNodeTransformDirection"
    normal = _transformed(tree, direction, "Direction", normal, turn, -1200, -900)
    unit = add_node(tree, "ShaderNodeVectorMath", -1000, -900)
    unit.operation = "NORMALIZE"
    tree.links.new(normal, unit.inputs[0])

    return info.outputs["Geometry"], place, unit.outputs["Vector"]


def _light(tree: Any, volume: Socket, place: Socket, strength: Socket, y: float) -> dict[str, Any]:
    """{name: socket} of the vector grids of the geometry `volume` at the socket `place`."""
    names = (AMBIENT_ATTRIBUTE, *map(ambient_axis, AXES))
    is_open = _sample(tree, volume, OPEN_GRID, "FLOAT", place, -1000, y)
    is_open = add_math(tree, "MAXIMUM", is_open, LEAST_OPEN, -600, y)
    factor = add_math(tree, "DIVIDE", strength, is_open, -400, y)
    light = {}
    for number, name in enumerate(names, 1):
        value = _sample(tree, volume, name, "VECTOR", place, -1000, y - 180 * number)
        light[name] = add_vector(tree, "SCALE", value, factor, -200, y - 180 * number)
    return light


def _applied(tree: Any, kind: str, socket: Socket, x: float, y: float) -> Socket:
    node = add_node(tree, kind, x, y)
    tree.links.new(socket, node.inputs[0])
    return node.outputs[0]


def _transformed(
    tree: Any, kind: str, name: str, vector: Socket, matrix: Socket, x: float, y: float
) -> Socket:
    node = add_node(tree, kind, x, y)
    tree.links.new(vector, node.inputs[name])
    tree.links.new(matrix, node.inputs["Transform"])
    return node.outputs[0]


def _sample(
    tree: Any, volume: Socket, name: str, data_type: str, place: Socket, x: float, y: float
) -> Socket:
    """The socket of the grid `name` of the geometry `volume`, trilinear at the socket `place`."""
    grid = add_node(tree, "GeometryNodeGetNamedGrid", x, y)
    sample = add_node(tree, "GeometryNodeSampleGrid", x + 200, y)
    grid.data_type = sample.data_type = data_type
    grid.inputs["Name"].default_value = name
    tree.links.new(volume, grid.inputs["Volume"])
    tree.links.new(grid.outputs["Grid"], sample.inputs["Grid"])
    tree.links.new(place, sample.inputs["Position"])
    return sample.outputs["Value"]


def _store_sides(
    tree: Any,
    mesh: Socket,
    front: dict[str, Any],
    back: dict[str, Any],
    normal: Socket,
    is_body: Socket,
) -> Socket:
    """Store the light on the front and the back on the points of the socket `mesh`.

    front, back  {name: socket} of the grids where the light of each side is sampled
    is_body      socket: the front, too, shows the light that comes from behind it
    """
    axes = add_node(tree, "ShaderNodeSeparateXYZ", -200, -900)
    tree.links.new(normal, axes.inputs[0])
    twice = add_math(tree, "MULTIPLY", is_body, 2.0, 0, -1100)
    against = add_math(tree, "SUBTRACT", twice, 1.0, 200, -1100)
    sides = ((AMBIENT_ATTRIBUTE, front, against), (BACK_ATTRIBUTE, back, 1.0))
    for number, (name, light, sign) in enumerate(sides):
        mean, *components = light.values()
        along: Operand = (0, 0, 0)
        for axis, component in enumerate(components):
            y = -360 - 180 * axis
            term = add_vector(tree, "SCALE", component, axes.outputs[axis], 0, y)
            along = add_vector(tree, "ADD", along, term, 200, y)
        along = add_vector(tree, "SCALE", along, sign, 300, -180 * number)
        side = add_vector(tree, "ADD", mean, along, 400, -180 * number)
        side = add_vector(tree, "MAXIMUM", side, (0, 0, 0), 600, -180 * number)
        mesh = _store(tree, mesh, name, side, 800 + 200 * number, 300)
    return mesh


def _store(
    tree: Any,
    geometry: Socket,
    name: str,
    value: Socket,
    x: float,
    y: float,
    domain: str = "POINT",
    kind: str = "FLOAT_COLOR",
) -> Socket:
    node = add_node(tree, "GeometryNodeStoreNamedAttribute", x, y)
    node.data_type, node.domain = kind, domain
    node.inputs["Name"].default_value = name
    tree.links.new(geometry, node.inputs["Geometry"])
    tree.links.new(value, node.inputs["Value"])
    return node.outputs["Geometry"]
