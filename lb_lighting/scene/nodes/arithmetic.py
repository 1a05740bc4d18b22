# SPDX-License-Identifier: GPL-3.0-or-later
"""The arithmetic of shader nodes on constants, and on grids that are multiplied by a number.

`evaluate_math`, `evaluate_mix` and `evaluate_clamp` compute the nodes of these names.
Materials (values.py) and lights (lights/light_nodes.py) each bring the operations that they
support. Needs no Blender.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeIs

import numpy as np

from ...arrays import Floats
from .links import Node

type Constant = float | Floats  # a number, or (3,) for a colour or vector
type Number = float | Scaled | Unread
type Value = Constant | Scaled | Unread

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709, as Blender turns colour into a number


@dataclass(frozen=True)
class Scaled:
    """scale * min(attribute, limit) for a grid without negative values; `scale` without a grid."""

    scale: float
    attribute: str | None = None
    limit: float = np.inf

    def of(self, values: Mapping[str, Floats]) -> float | Floats:
        """(...) for grids with the `values` {name: (...)}; a grid that is missing counts as 1."""
        if self.attribute is None or self.attribute not in values:
            return self.scale
        return self.scale * np.minimum(values[self.attribute], self.limit)


@dataclass(frozen=True)
class Unread:
    """The value of a node that is neither constant nor `Scaled`."""

    node: Node


def is_constant(value: Value | None) -> TypeIs[Constant]:
    return value is not None and not isinstance(value, (Scaled, Unread))


def luminance(value: Constant) -> float:
    """A number, or the luminance of a colour (3,)."""
    return float(LUMINANCE @ value if np.ndim(value) else value)


def evaluate_math(
    node: Node, operands: Sequence[Value], operations: Mapping[str, Callable[..., Value | None]]
) -> Value | None:
    """The result of a Math node; None if its operation is not in `operations`, or returns None."""
    operation = operations.get(node.operation)
    result = operation(*operands) if operation else None
    return within(result, 0, 1) if node.use_clamp else result


def evaluate_mix(
    node: Node,
    factor: float,
    first: Value,
    second: Value,
    blend: Callable[[str, float, Value, Value], Value | None],
) -> Value | None:
    """The result of a Mix node, or of a MixRGB node from an older file; None if `blend` returns it.

    blend  computes it from the blend type, the factor and the two values
    """
    is_legacy = node.type == "MIX_RGB"
    is_color = is_legacy or node.data_type == "RGBA"
    if is_legacy or node.clamp_factor:
        factor = min(max(factor, 0.0), 1.0)
    result = blend(node.blend_type if is_color else "MIX", factor, first, second)
    is_clamped = node.use_clamp if is_legacy else node.clamp_result
    return within(result, 0, 1) if is_color and is_clamped else result


def evaluate_clamp(node: Node, value: Number, low: Number, high: Number) -> Value | None:
    """The result of a Clamp node, or None if it is neither constant nor `Scaled`."""
    if not (is_constant(low) and is_constant(high)):
        return None
    if node.clamp_type == "RANGE":
        low, high = min(low, high), max(low, high)
    return within(value, low, high)


def times(a: Value | None, b: Value | None) -> Constant | Scaled | None:
    """a * b; None, as in the functions below, if that is neither constant nor `Scaled`."""
    if is_constant(a) and is_constant(b):
        return a * b
    if isinstance(b, Scaled):
        a, b = b, a
    if not isinstance(a, Scaled) or not is_constant(b) or np.ptp(b):
        return None
    return replace(a, scale=a.scale * float(np.max(b)))


def plus(a: Value | None, b: Value | None) -> Constant | Scaled | None:
    """a + b."""
    if is_constant(a) and is_constant(b):
        return a + b
    for one, other in ((a, b), (b, a)):
        if isinstance(one, Scaled) and is_constant(other) and not np.any(other):
            return one
    if not isinstance(a, Scaled) or not isinstance(b, Scaled):
        return None
    if (a.attribute, a.limit) != (b.attribute, b.limit):
        return None
    return replace(a, scale=a.scale + b.scale)


def minus(a: Value | None, b: Value | None) -> Constant | Scaled | None:
    """a - b."""
    return plus(a, times(b, -1.0))


def over(a: Value, b: Number) -> Constant | Scaled | None:
    """a / b, where b is a number; 0 for a division by 0, as in Cycles."""
    if not is_constant(b):
        return None
    return times(a, 1 / b if b else 0.0)


def at_most(a: Number, b: Number) -> Value | None:
    """The smaller of two numbers."""
    if is_constant(a) and is_constant(b):
        return min(a, b)
    return within(b, -np.inf, a) if isinstance(b, Scaled) else within(a, -np.inf, b)


def at_least(a: Number, b: Number) -> Value | None:
    """The larger of two numbers."""
    if is_constant(a) and is_constant(b):
        return max(a, b)
    return within(b, a, np.inf) if isinstance(b, Scaled) else within(a, b, np.inf)


def within(value: Value | None, low: Number, high: Number) -> Constant | Scaled | None:
    """`value` clamped between two numbers."""
    if not (is_constant(low) and is_constant(high)):
        return None
    if is_constant(value):
        clamped = np.clip(value, low, high)
        return clamped if np.ndim(clamped) else float(clamped)
    if not isinstance(value, Scaled):
        return None
    # A grid is at least 0, and `Scaled` has no lower limit other than 0.
    if value.scale > 0 and low <= 0 <= high:
        return replace(value, limit=min(value.limit, high / value.scale))
    if value.scale <= 0 <= high and low == 0:
        return 0.0
    return value if value.scale <= 0 <= high and low == -np.inf else None
