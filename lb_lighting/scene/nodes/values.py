# SPDX-License-Identifier: GPL-3.0-or-later
"""The values of a material's sockets: constants, and grids that are multiplied by a number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from .arithmetic import (
    Constant,
    Number,
    Scaled,
    Unread,
    Value,
    at_least,
    at_most,
    evaluate_clamp,
    evaluate_math,
    evaluate_mix,
    is_constant,
    luminance,
    minus,
    over,
    plus,
    times,
)
from .attributes import Attributes
from .black_body import black_body_color
from .links import Circle, Groups, Links, Node, Place, Socket, postorder


def value_of(
    socket: Socket, groups: Groups, links: Links, attributes: Attributes | None = None
) -> Value:
    """The value of a resolved socket: a float, (3,) for a colour or vector, `Scaled` or `Unread`.

    attributes  from `object_attributes`, or None if the object is not known
    """
    values: dict[Place, Value] = {}
    try:
        order = postorder((socket, groups), partial(_operands, links))
    except Circle as circle:
        return Unread(circle.node)
    for place, sources in order.items():
        values[place] = _value(place[0], sources, [values[p] for p in sources], attributes)
    return values[socket, groups]


def as_number[V: Scaled | Unread](value: Constant | V, socket: Socket) -> float | V:
    """The value of `socket` as one number, as Cycles converts it; `Scaled` and `Unread` stay."""
    if isinstance(value, (Scaled, Unread)):
        return value
    if np.ndim(value) and socket.type == "VECTOR":
        return float(np.mean(value))
    return luminance(value)


def held(socket: Socket) -> Constant | Unread:
    """The value that a socket holds itself."""
    if socket.type in {"VALUE", "INT", "BOOLEAN"}:
        return float(socket.default_value)
    if socket.type in {"RGBA", "VECTOR"}:
        return np.array(socket.default_value[:3], float)
    return Unread(socket.node)


def _operands(links: Links, place: Place) -> list[Place]:
    """The places that the value at `place` is computed from."""
    socket, groups = place
    if not socket.is_output or socket.node.type not in _COMPUTED:
        return []
    return [links.resolve(s, groups) for s in socket.node.inputs if s.enabled]


def _value(
    socket: Socket,
    sources: list[Place],
    operands: list[Value],
    attributes: Attributes | None,
) -> Value:
    """The value of a resolved socket; the `operands` are the values of the `sources`."""
    node = socket.node
    if not socket.is_output or node.type in {"RGB", "VALUE"}:
        return held(socket)
    if node.type == "ATTRIBUTE":
        return _attribute(node, socket, attributes)
    if node.type == "VOLUME_INFO" and socket.name != "Color":
        return Scaled(1.0, socket.name.lower())
    if node.type not in _COMPUTED:
        return Unread(node)
    result = _COMPUTED[node.type](node, operands, [source for source, _groups in sources])
    if result is None:
        return next((o for o in operands if isinstance(o, Unread)), Unread(node))
    return result


def _attribute(node: Node, socket: Socket, attributes: Attributes | None) -> Value:
    if node.attribute_type == "GEOMETRY":
        # Alpha is 1 where the mesh or volume has the attribute, and 0 elsewhere.
        is_grid = node.attribute_name and socket.identifier != "Alpha"
        return Scaled(1.0, node.attribute_name) if is_grid else Unread(node)
    if attributes is None:
        return Unread(node)
    *color, alpha = attributes(node.attribute_type, node.attribute_name)
    numbers = {"Fac": float(np.mean(color)), "Alpha": float(alpha)}
    return numbers.get(socket.identifier, np.array(color, float))


def _numbers(values: Sequence[Value], sources: Sequence[Socket]) -> list[Number]:
    return [as_number(*pair) for pair in zip(values, sources, strict=True)]


def _math(node: Node, operands: Sequence[Value], sources: Sequence[Socket]) -> Value | None:
    return evaluate_math(node, _numbers(operands, sources), _OPERATIONS)


def _vector_math(node: Node, operands: Sequence[Value], sources: Sequence[Socket]) -> Value | None:
    if node.operation == "SCALE":
        return times(operands[0], as_number(operands[1], sources[1]))
    if node.operation in {"ADD", "SUBTRACT", "MULTIPLY"}:
        return _OPERATIONS[node.operation](*operands)
    return None


def _clamp(node: Node, operands: Sequence[Value], sources: Sequence[Socket]) -> Value | None:
    return evaluate_clamp(node, *_numbers(operands, sources))


def _mix(node: Node, operands: Sequence[Value], sources: Sequence[Socket]) -> Value | None:
    if node.data_type == "VECTOR" and node.factor_mode == "NON_UNIFORM":
        return None
    factor, first, second = operands
    factor = as_number(factor, sources[0])
    if not is_constant(factor):
        return None
    if node.data_type == "FLOAT":
        first, second = as_number(first, sources[1]), as_number(second, sources[2])
    return evaluate_mix(node, factor, first, second, _blended)


def _blended(blend_type: str, factor: float, first: Value, second: Value) -> Value | None:
    if factor == 0:
        return first
    if blend_type == "MIX":
        return second if factor == 1 else plus(times(first, 1 - factor), times(second, factor))
    if blend_type == "MULTIPLY":
        return plus(times(first, 1 - factor), times(times(first, second), factor))
    return plus(first, times(second, factor)) if blend_type == "ADD" else None


def _black_body(_node: Node, operands: Sequence[Value], sources: Sequence[Socket]) -> Value | None:
    kelvin = as_number(operands[0], sources[0])
    return black_body_color(kelvin) if is_constant(kelvin) else None


_OPERATIONS: dict[str, Callable[..., Value | None]] = {
    "ADD": plus,
    "SUBTRACT": minus,
    "MULTIPLY": times,
    "DIVIDE": over,
    "MINIMUM": at_most,
    "MAXIMUM": at_least,
}
_COMPUTED: dict[str, Callable[[Node, Sequence[Value], Sequence[Socket]], Value | None]] = {
    "MATH": _math,
    "VECT_MATH": _vector_math,
    "CLAMP": _clamp,
    "MIX": _mix,
    "BLACKBODY": _black_body,
}
