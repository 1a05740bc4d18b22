# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces out, without writing on them: a geometry nodes modifier that reads the baked volume.

`LB Ambient Grid` samples the grids of a baked Volume object at every evaluation, where the plant
is then: what is animated, scattered or instanced is lit anew, and the mesh stays as it is. It
stores on points what `attribute.write_ambient` writes, `lb_ambient` and `lb_ambient_back`. On an
instance it stores what falls on a surface of any direction there: `lb_ambient` of the mean of both
sides, and `lb_ambient_x`, `_y`, `_z`, from which `LB Ambient` finds the light of each side. Where
that is all light, `lb_whole` is 1 on either.

Foliage has it where the user chose so; any mesh has it whose vertices cannot hold its light.
"""

from ..ours import TAG, is_ours
from ..scene.remarks import listed
from . import attribute
from .ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    LEAST_OPEN,
    OPEN_GRID,
    WHOLE_ATTRIBUTE,
    ambient_axis,
)
from .groups import ANY, our_group
from .nodes import (
    add_input,
    add_math,
    add_node,
    add_output,
    add_vector,
)
from .vdb import AXES

GRID_GROUP = "LB Ambient Grid"
WALL_GROUP = "LB Ambient Grid of Walls"
WHOLE, BODY, STAND_OFF = "All Light", "Filled", "Stand Off"  # inputs


def readers(objects, sources, depsgraph, chosen, notes):
    """[number] of those `sources` of the `objects` that are to get their light by the modifier.

    That is foliage where it is `chosen`, and any surface where light on vertices would be that of
    other places, of which the `notes` tell.
    """
    found, misplaced, instancers = [], {}, attribute.instancers(objects, depsgraph)
    sharers = attribute.sharers()
    for number, (ob, source) in enumerate(zip(objects, sources, strict=True)):
        if ob.type != "MESH" or not source.shows_light:
            continue
        if ob in instancers:
            notes.append(
                f"'{instancers[ob].name}' instances '{ob.name}' and shows the light of that; make "
                "its instances real, and select them, to light them where they are."
            )
        reason = attribute.misplaced(ob, depsgraph, sharers)
        if source.lights_instances:
            reason = "geometry nodes make instances, each of which has the light at its origin"
        is_chosen = chosen and source.is_foliage
        if is_chosen or reason:
            found.append(number)
        if reason and not is_chosen:
            misplaced.setdefault(reason, []).append(ob.name)
    notes.extend(
        f"{listed(names)}: {reason}. The modifier {GRID_GROUP} looks the light up there."
        for reason, names in misplaced.items()
    )
    return found


def add_modifier(ob, baked, whole=False, is_body=False, stand_off=0.0):
    """Give the mesh object `ob` the modifier that reads the Volume object `baked`, once, as the
    last of its modifiers; the user's values of its other inputs stay.

    whole      whether what it reads is all light
    is_body    whether both sides show what comes out of it, see `Vertices`
    stand_off  m, how far in front of each side of a wall its light is taken; 0 for what is none
    """
    modifier = _find(ob)
    if modifier is None:
        modifier = ob.modifiers.new(GRID_GROUP, "NODES")
        modifier.use_pin_to_last = True
    # Made anew where an older version of ours left it; the inputs of both groups are the same.
    modifier.node_group = wall_group() if stand_off else grid_group()
    values = {"Volume": baked, WHOLE: whole, BODY: is_body}
    for name, value in (values | ({STAND_OFF: stand_off} if stand_off else {})).items():
        _input(modifier, name).value = value


def is_whole(ob):
    """True for an object that `add_modifier` gave all light."""
    modifier = _find(ob)
    return modifier is not None and bool(_input(modifier, WHOLE).value)


def has_modifier(ob):
    """True for an object that `add_modifier` lit."""
    return _find(ob) is not None


def remove_modifier(ob):
    """Take our modifier off the object `ob`, if it is there."""
    modifier = _find(ob)
    if modifier is not None:
        ob.modifiers.remove(modifier)


def _input(modifier, name):
    socket = modifier.node_group.interface.items_tree[name]
    return getattr(modifier.properties.inputs, socket.identifier)


def _find(ob):
    return next((m for m in ob.modifiers if m.type == "NODES" and _reads_grid(m.node_group)), None)


def _reads_grid(group):
    return group is not None and is_ours(group) and group[TAG] in (GRID_GROUP, WALL_GROUP)


def grid_group():
    """Our geometry node group, made where the file does not have it yet."""
    return our_group(GRID_GROUP, _build, "GeometryNodeTree")


def wall_group():
    """That for walls: each side's light is taken in front of it, so it looks up twice as much."""
    return our_group(WALL_GROUP, lambda tree: _build(tree, is_wall=True), "GeometryNodeTree")


def _build(tree, is_wall=False):
    tree.is_modifier = True
    add_output(tree, "Geometry", "Geometry", "The plant, with its light on it")
    add_input(tree, "Geometry", "Geometry", "The plant; meshes and instances are lit")
    add_input(tree, "Volume", "Object", "The baked Volume object whose light is read")
    add_input(tree, "Strength", "Float", "Factor on the light of this object", 1.0, ANY)
    realize = (
        "On: make instances real, and light each of their points. "
        "Off: keep them; all of an instance has the light at its origin"
    )
    add_input(tree, "Realize Instances", "Bool", realize, False)
    add_input(tree, WHOLE, "Bool", "On: the baked light is all light, the sky's own, too", False)
    add_input(tree, BODY, "Bool", "On: both sides show the light that comes out", False)
    if is_wall:
        off = "How far in front of each side its light is taken, in m"
        add_input(tree, STAND_OFF, "Float", off, 0.0, ANY)
    group = add_node(tree, "NodeGroupInput", -1800, 0)
    geometry, baked, strength, realize, whole, is_body = group.outputs[:6]

    geometry = _realized(tree, geometry, realize)
    parts = add_node(tree, "GeometryNodeSeparateComponents", -1000, 400)
    tree.links.new(geometry, parts.inputs["Geometry"])
    volume, place, normal = _place(tree, baked)
    if is_wall:
        off = add_vector(tree, "SCALE", normal, group.outputs[STAND_OFF], -800, -900)
        front = add_vector(tree, "ADD", place, off, -600, -900)
        back = add_vector(tree, "SUBTRACT", place, off, -600, -1100)
        front = _light(tree, volume, front, strength, 0)
        back = _light(tree, volume, back, strength, -1200)
    else:
        front = back = _light(tree, volume, place, strength, 0)
    mesh = _store_sides(tree, parts.outputs["Mesh"], front, back, normal, is_body)
    instances = parts.outputs["Instances"]
    for number, (name, value) in enumerate(front.items()):
        x = 600 + 200 * number
        instances = _store(tree, instances, name, value, x, 700, domain="INSTANCE")
    mesh = _store(tree, mesh, WHOLE_ATTRIBUTE, whole, 1200, 300, kind="FLOAT")
    instances = _store(tree, instances, WHOLE_ATTRIBUTE, whole, 1400, 700, "INSTANCE", "FLOAT")

    join = add_node(tree, "GeometryNodeJoinGeometry", 1500, 400)
    others = [s for s in parts.outputs if s.enabled and s.name not in ("Mesh", "Instances")]
    for part in (*others, instances, mesh):
        tree.links.new(part, join.inputs[0])
    output = add_node(tree, "NodeGroupOutput", 1700, 400)
    tree.links.new(join.outputs[0], output.inputs["Geometry"])


def _realized(tree, geometry, realize):
    """The socket of `geometry`, its instances made real where the socket `realize` is on."""
    node = add_node(tree, "GeometryNodeRealizeInstances", -1400, 500)
    switch = add_node(tree, "GeometryNodeSwitch", -1200, 400)
    switch.input_type = "GEOMETRY"
    tree.links.new(geometry, node.inputs["Geometry"])
    tree.links.new(realize, switch.inputs["Switch"])
    tree.links.new(geometry, switch.inputs["False"])
    tree.links.new(node.outputs["Geometry"], switch.inputs["True"])
    return switch.outputs["Output"]


def _place(tree, baked):
    """The sockets of the geometry of the Volume object `baked`, and of the place and the unit
    normal of each element in its space, which a bake puts at the world's origin."""
    info = add_node(tree, "GeometryNodeObjectInfo", -1600, -200)
    here = add_node(tree, "GeometryNodeObjectInfo", -1600, -500)
    info.transform_space, here.transform_space = "ORIGINAL", "RELATIVE"
    for node in (info, here):
        tree.links.new(baked, node.inputs["Object"])
    to_baked = _applied(tree, "FunctionNodeInvertMatrix", here.outputs["Transform"], -1400, -500)
    # Normals turn with the inverse transposed.
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


def _light(tree, volume, place, strength, y):
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


def _applied(tree, kind, socket, x, y):
    node = add_node(tree, kind, x, y)
    tree.links.new(socket, node.inputs[0])
    return node.outputs[0]


def _transformed(tree, kind, name, vector, matrix, x, y):
    node = add_node(tree, kind, x, y)
    tree.links.new(vector, node.inputs[name])
    tree.links.new(matrix, node.inputs["Transform"])
    return node.outputs[0]


def _sample(tree, volume, name, data_type, place, x, y):
    """The socket of the grid `name` of the geometry `volume`, trilinear at the socket `place`."""
    grid, sample = (
        add_node(tree, "GeometryNodeGetNamedGrid", x, y),
        add_node(tree, "GeometryNodeSampleGrid", x + 200, y),
    )
    grid.data_type = sample.data_type = data_type
    grid.inputs["Name"].default_value = name
    tree.links.new(volume, grid.inputs["Volume"])
    tree.links.new(grid.outputs["Grid"], sample.inputs["Grid"])
    tree.links.new(place, sample.inputs["Position"])
    return sample.outputs["Value"]


def _store_sides(tree, mesh, front, back, normal, is_body):
    """Store the light of the front and of the back on the points of the socket `mesh`.

    front, back  {name: socket} of the grids where the light of either side is taken
    is_body      socket: the front, too, shows what comes from behind
    """
    parts = add_node(tree, "ShaderNodeSeparateXYZ", -200, -900)
    tree.links.new(normal, parts.inputs[0])
    twice = add_math(tree, "MULTIPLY", is_body, 2.0, 0, -1100)
    against = add_math(tree, "SUBTRACT", twice, 1.0, 200, -1100)
    sides = ((AMBIENT_ATTRIBUTE, front, against), (BACK_ATTRIBUTE, back, 1.0))
    for number, (name, light, sign) in enumerate(sides):
        mean, *components = light.values()
        along = (0, 0, 0)
        for axis, component in enumerate(components):
            y = -360 - 180 * axis
            own = add_vector(tree, "SCALE", component, parts.outputs[axis], 0, y)
            along = add_vector(tree, "ADD", along, own, 200, y)
        along = add_vector(tree, "SCALE", along, sign, 300, -180 * number)
        side = add_vector(tree, "ADD", mean, along, 400, -180 * number)
        side = add_vector(tree, "MAXIMUM", side, (0, 0, 0), 600, -180 * number)
        mesh = _store(tree, mesh, name, side, 800 + 200 * number, 300)
    return mesh


def _store(tree, geometry, name, value, x, y, domain="POINT", kind="FLOAT_COLOR"):
    node = add_node(tree, "GeometryNodeStoreNamedAttribute", x, y)
    node.data_type, node.domain = kind, domain
    node.inputs["Name"].default_value = name
    tree.links.new(geometry, node.inputs["Geometry"])
    tree.links.new(value, node.inputs["Value"])
    return node.outputs["Geometry"]
