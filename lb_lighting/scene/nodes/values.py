# SPDX-License-Identifier: GPL-3.0-or-later
"""What the inputs of shader nodes come to: constants, and grids times a number."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from .black_body import black_body_color
from .links import Circle, Nothing, postorder

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709, as Blender turns colour into a number


@dataclass(frozen=True)
class Scaled:
    """scale * min(attribute, limit), of a grid that is nowhere negative; `scale` without one."""

    scale: float
    attribute: str | None = None
    limit: float = np.inf

    def of(self, values):
        """Its values, (...), where the grids have the `values`, {name: (...)}; 1 for no grid."""
        if self.attribute not in values:
            return self.scale
        return self.scale * np.minimum(values[self.attribute], self.limit)


@dataclass(frozen=True)
class Unread:
    """The value of a node that is neither constant nor `Scaled`."""

    node: object


def value_of(socket, groups, links, attributes=None):
    """What a resolved socket comes to: a float, (3,) of a colour or vector, `Scaled` or `Unread`.

    links       `Links`
    attributes  function that takes the type and the name of an attribute of objects or view layers
                and returns (4,), or None where they are not known
    """
    values = {}
    try:
        order = postorder((socket, groups), partial(_operands, links))
    except Circle as circle:
        return Unread(circle.node)
    for key, operands in order.items():
        values[key] = _value(key[0], operands, [values[k] for k in operands], attributes)
    return values[socket, groups]


def as_number(value, socket):
    """The value of `socket` as one number, as Cycles converts it; `Scaled` and `Unread` stay."""
    if not np.ndim(value):
        return value
    return float(np.mean(value) if socket.type == "VECTOR" else LUMINANCE @ value)


def _operands(links, key):
    """[(socket, groups)] that the value of a (socket, groups) is computed from."""
    socket, groups = key
    if not socket.is_output or socket.node.type not in _COMPUTED:
        return []
    return [links.resolve(s, groups) for s in socket.node.inputs if s.enabled]


def _value(socket, keys, operands, attributes):
    """The value of a resolved socket; `operands` are those of the `keys`, its operands."""
    node = socket.node
    if not socket.is_output or node.type in {"RGB", "VALUE"}:
        return _held(socket)
    if node.type == "ATTRIBUTE":
        return _attribute(node, socket, attributes)
    if node.type == "VOLUME_INFO" and socket.name != "Color":
        return Scaled(1.0, socket.name.lower())
    if node.type not in _COMPUTED:
        return Unread(node)
    result = _COMPUTED[node.type](node, operands, [source for source, _groups in keys])
    if result is None:
        return next((o for o in operands if isinstance(o, Unread)), Unread(node))
    return result


def _held(socket):
    """The value that a socket itself has."""
    if isinstance(socket, Nothing):
        return 0.0
    if socket.type in {"VALUE", "INT", "BOOLEAN"}:
        return float(socket.default_value)
    if socket.type in {"RGBA", "VECTOR"}:
        return np.array(socket.default_value[:3], float)
    return Unread(socket.node)


def _attribute(node, socket, attributes):
    if node.attribute_type == "GEOMETRY":
        # The alpha of a grid is 1, but 0 where there is none.
        is_grid = node.attribute_name and socket.identifier != "Alpha"
        return Scaled(1.0, node.attribute_name) if is_grid else Unread(node)
    if attributes is None:
        return Unread(node)
    *color, alpha = attributes(node.attribute_type, node.attribute_name)
    numbers = {"Fac": float(np.mean(color)), "Alpha": float(alpha)}
    return numbers.get(socket.identifier, np.array(color, float))


def _math(node, operands, sources):
    operands = [as_number(*pair) for pair in zip(operands, sources, strict=True)]
    operation = _OPERATIONS.get(node.operation)
    result = operation(*operands) if operation else None
    return _within(result, 0, 1) if node.use_clamp else result


def _vector_math(node, operands, sources):
    if node.operation == "SCALE":
        return _times(operands[0], as_number(operands[1], sources[1]))
    if node.operation in {"ADD", "SUBTRACT", "MULTIPLY"}:
        return _OPERATIONS[node.operation](*operands)
    return None


def _clamp(node, operands, sources):
    value, low, high = (as_number(*pair) for pair in zip(operands, sources, strict=True))
    if not (_is_constant(low) and _is_constant(high)):
        return None
    if node.clamp_type == "RANGE":
        low, high = min(low, high), max(low, high)
    return _within(value, low, high)


def _mix(node, operands, sources):
    if node.data_type == "VECTOR" and node.factor_mode == "NON_UNIFORM":
        return None
    factor, first, second = operands
    factor = as_number(factor, sources[0])
    if not _is_constant(factor):
        return None
    if node.data_type == "FLOAT":
        first, second = as_number(first, sources[1]), as_number(second, sources[2])
    if node.clamp_factor:
        factor = min(max(factor, 0.0), 1.0)
    result = _blended(factor, first, second, node.blend_type if node.data_type == "RGBA" else "MIX")
    return _within(result, 0, 1) if node.data_type == "RGBA" and node.clamp_result else result


def _black_body(_node, operands, sources):
    kelvin = as_number(operands[0], sources[0])
    return black_body_color(kelvin) if _is_constant(kelvin) else None


def _blended(factor, first, second, how):
    if factor == 0:
        return first
    if how == "MIX":
        return second if factor == 1 else _plus(_times(first, 1 - factor), _times(second, factor))
    if how == "MULTIPLY":
        return _plus(_times(first, 1 - factor), _times(_times(first, second), factor))
    return _plus(first, _times(second, factor)) if how == "ADD" else None


def _is_constant(value):
    return value is not None and not isinstance(value, (Scaled, Unread))


def _times(a, b):
    """a times b, or None for what is not read."""
    if _is_constant(a) and _is_constant(b):
        return a * b
    if isinstance(b, Scaled):
        a, b = b, a
    if not isinstance(a, Scaled) or not _is_constant(b) or np.ptp(b):
        return None
    return replace(a, scale=a.scale * float(np.max(b)))


def _plus(a, b):
    if _is_constant(a) and _is_constant(b):
        return a + b
    for one, other in ((a, b), (b, a)):
        if isinstance(one, Scaled) and _is_constant(other) and not np.any(other):
            return one
    alike = isinstance(a, Scaled) and isinstance(b, Scaled)
    if alike and (a.attribute, a.limit) == (b.attribute, b.limit):
        return replace(a, scale=a.scale + b.scale)
    return None


def _over(a, b):
    if not _is_constant(b):
        return None
    return _times(a, 1 / b if b else 0.0)


def _at_most(a, b):
    """The smaller of two numbers."""
    if _is_constant(a) and _is_constant(b):
        return min(a, b)
    return _within(*((b, -np.inf, a) if isinstance(b, Scaled) else (a, -np.inf, b)))


def _at_least(a, b):
    """The larger of two numbers."""
    if _is_constant(a) and _is_constant(b):
        return max(a, b)
    return _within(*((b, a, np.inf) if isinstance(b, Scaled) else (a, b, np.inf)))


def _within(value, low, high):
    """`value` clamped between two numbers."""
    if _is_constant(value) and _is_constant(low) and _is_constant(high):
        clamped = np.clip(value, low, high)
        return clamped if np.ndim(clamped) else float(clamped)
    if not isinstance(value, Scaled) or not (_is_constant(low) and _is_constant(high)):
        return None
    # From 0 on the grid is known; what is clamped elsewhere has another shape than `Scaled`.
    if value.scale > 0 and low <= 0 <= high:
        return replace(value, limit=min(value.limit, high / value.scale))
    if value.scale <= 0 <= high and low == 0:
        return 0.0
    return value if value.scale <= 0 <= high and low == -np.inf else None


_OPERATIONS = {
    "ADD": _plus,
    "SUBTRACT": lambda a, b: _plus(a, _times(b, -1.0)),
    "MULTIPLY": _times,
    "DIVIDE": _over,
    "MINIMUM": _at_most,
    "MAXIMUM": _at_least,
}
_COMPUTED = {
    "MATH": _math,
    "VECT_MATH": _vector_math,
    "CLAMP": _clamp,
    "MIX": _mix,
    "BLACKBODY": _black_body,
}
