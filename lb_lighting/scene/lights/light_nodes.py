# SPDX-License-Identifier: GPL-3.0-or-later
"""The nodes of lamps, worlds and emissive materials, evaluated as in Cycles.

The outputs of Light Path and the Backfacing output of Geometry are constants here, because the
light goes to the receivers and not straight to the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import LightError, LightingError
from ..nodes.arithmetic import (
    Constant,
    Value,
    evaluate_clamp,
    evaluate_math,
    evaluate_mix,
    is_constant,
    luminance,
)
from ..nodes.black_body import black_body_color
from ..nodes.links import Groups, Node, Place, Socket
from ..nodes.shaders import Closure, Shader
from ..nodes.values import held

if TYPE_CHECKING:
    import bpy

# Light Path for light that arrives directly from a world. For lamps, Cycles sets all of it to 0.
ON_SURFACES = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0}
IN_VOLUMES = {"Is Volume Scatter Ray": 1.0}

# Nodes whose result for the mean of an input is close to the mean of their results.
_LINEAR = {"MATH", "MIX", "MIX_RGB"}


class LightShader(Shader):
    """The nodes of a world, a lamp or an emissive material.

    path      {output of Light Path: value}; outputs that are missing are 0
    back      1 for the back of faces, 0 for their front
    tolerant  if True, unsupported nodes count as 1 (as 0.5 for the factor of a Mix Shader), and
              closures that emit no light are left out; if False, both raise LightError
    patterns  {label of a node: None} for the nodes whose pattern was averaged or ignored
    """

    def __init__(
        self,
        owner: bpy.types.Light | bpy.types.Material | bpy.types.World,
        path: Mapping[str, float] | None = None,
        back: float = 0.0,
        tolerant: bool = False,
    ) -> None:
        super().__init__(owner, LightError)
        self.path, self.back, self.tolerant = path or {}, back, tolerant
        self.patterns: dict[str, None] = {}
        self._constants: dict[Place, Constant | None] = {}

    def contributing(self, output: str, known: set[str]) -> list[Closure]:
        """`closures` with a weight above 0."""
        return [closure for closure in self.closures(output, known) if closure.weight > 0]

    def _refuse_closure(self, node: Node) -> None:
        if not self.tolerant:
            super()._refuse_closure(node)

    def _factor(self, socket: Socket, groups: Groups) -> float | None:
        """The share of a Mix Shader's second shader, or None if the node has to be refused."""
        socket, groups = self.links.resolve(socket, groups)
        value = self._constant(socket, groups)
        if value is None and self.tolerant:
            value = self._mean(socket, groups, 0.5)
        return None if value is None else float(np.clip(luminance(value), 0, 1))

    def _average(self, socket: Socket, groups: Groups) -> Constant:
        value = self._constant(socket, groups)
        return self._mean(socket, groups, 1.0) if value is None else value

    def _mean(self, socket: Socket, groups: Groups, default: float) -> Constant:
        """The mean value of a resolved socket, or `default` if it is not known."""
        self.patterns[socket.node.bl_label] = None
        try:
            return super()._average(socket, groups)
        except LightError:
            if not self.tolerant:
                raise
            return default * self._strength(socket.node, groups)

    def _strength(self, node: Node, groups: Groups) -> float:
        """The constant Strength of an IES Texture or a Light Falloff; 1 for other nodes."""
        strength = node.inputs.get("Strength")
        value = self._constant(*self.links.resolve(strength, groups)) if strength else None
        return 1.0 if value is None else luminance(value)

    def _constant(self, socket: Socket, groups: Groups) -> Constant | None:
        """The value of a resolved socket, or None if it is not constant."""
        place = socket, groups
        if place not in self._constants:
            value = self._value(socket, groups)
            self._constants[place] = value if is_constant(value) else None
        return self._constants[place]

    def _value(self, socket: Socket, groups: Groups) -> Value | None:
        node = socket.node
        if not socket.is_output or node.type in {"RGB", "VALUE"}:
            return held(socket)
        if node.type == "LIGHT_PATH":
            return self.path.get(socket.name, 0.0) if socket.name.startswith("Is ") else None
        if node.type == "NEW_GEOMETRY":
            return self.back if socket.name == "Backfacing" else None
        evaluate = _COMPUTED.get(node.type)
        operands = self._operands(node, groups) if evaluate else None
        return evaluate(node, socket, operands) if evaluate and operands is not None else None

    def _operands(self, node: Node, groups: Groups) -> list[Constant] | None:
        """The values of a node's inputs, or None if one of them is not constant."""
        places = [self.links.resolve(s, groups) for s in node.inputs if s.enabled]
        values = [self._constant(*place) for place in places]
        if self.tolerant and node.type in _LINEAR:
            values = [
                self._mean(*place, 1.0) if value is None else value
                for place, value in zip(places, values, strict=True)
            ]
        constants = [value for value in values if value is not None]
        return constants if len(constants) == len(values) else None


def or_else[T, Owner](default: T, read: Callable[[Owner], T], owner: Owner) -> T:
    """read(owner), or `default` if its nodes are broken, such as a missing group.

    Objects that are not selected are read this way, because they must not stop a bake.
    """
    try:
        return read(owner)
    except (LightingError, AttributeError, LookupError, RuntimeError, StopIteration):
        return default


def _finite(operation: Callable[..., float]) -> Callable[..., float]:
    """`operation` with 0 for a result that is not finite, as in Cycles."""

    def evaluate(*numbers: float) -> float:
        with np.errstate(all="ignore"):
            result = float(operation(*numbers))
        return result if np.isfinite(result) else 0.0

    return evaluate


def _math(node: Node, _socket: Socket, operands: Sequence[Constant]) -> Value | None:
    return evaluate_math(node, [luminance(value) for value in operands], _OPERATIONS)


def _mix(node: Node, _socket: Socket, operands: Sequence[Constant]) -> Value | None:
    if node.type == "MIX" and (node.data_type not in {"FLOAT", "RGBA"} or len(operands) != 3):
        return None
    factor, first, second = operands
    return evaluate_mix(node, luminance(factor), np.asarray(first), np.asarray(second), _blended)


def _blended(blend_type: str, factor: float, first: Value, second: Value) -> Value | None:
    blend = _BLENDS.get(blend_type)
    if blend is None or not is_constant(first) or not is_constant(second):
        return None
    return (1 - factor) * first + factor * blend(first, second)


def _clamp(node: Node, _socket: Socket, operands: Sequence[Constant]) -> Value | None:
    value, low, high = map(luminance, operands)
    return evaluate_clamp(node, value, low, high)


def _falloff(_node: Node, socket: Socket, operands: Sequence[Constant]) -> Value | None:
    strength, smooth = map(luminance, operands)
    return strength if socket.name == "Quadratic" and smooth == 0 else None


def _invert(_node: Node, _socket: Socket, operands: Sequence[Constant]) -> Value:
    factor, color = luminance(operands[0]), operands[1]
    return (1 - factor) * color + factor * (1 - np.asarray(color))


def _color_ramp(node: Node, socket: Socket, operands: Sequence[Constant]) -> Value | None:
    if socket.name != "Color":
        return None
    return np.array(node.color_ramp.evaluate(luminance(operands[0]))[:3])


def _combine_color(node: Node, _socket: Socket, operands: Sequence[Constant]) -> Value | None:
    return np.array([*map(luminance, operands)]) if node.mode == "RGB" else None


_OPERATIONS = {
    name: _finite(operation)
    for name, operation in dict[str, Callable[..., float]](
        {
            "ADD": np.add,
            "SUBTRACT": np.subtract,
            "MULTIPLY": np.multiply,
            "DIVIDE": np.divide,
            "MULTIPLY_ADD": lambda a, b, c: a * b + c,
            "POWER": np.power,
            "SQRT": np.sqrt,
            "ABSOLUTE": np.abs,
            "EXPONENT": np.exp,
            "LOGARITHM": lambda a, b: np.log(a) / np.log(b),
            "MINIMUM": np.minimum,
            "MAXIMUM": np.maximum,
            "LESS_THAN": lambda a, b: float(a < b),
            "GREATER_THAN": lambda a, b: float(a > b),
            "SIGN": np.sign,
            "ROUND": lambda a: np.floor(a + 0.5),
            "FLOOR": np.floor,
            "CEIL": np.ceil,
            "FRACT": lambda a: a - np.floor(a),
            "SINE": np.sin,
            "COSINE": np.cos,
        }
    ).items()
}
_BLENDS: dict[str, Callable[..., Constant]] = {
    "MIX": lambda first, second: second,
    "ADD": np.add,
    "SUBTRACT": np.subtract,
    "MULTIPLY": np.multiply,
    "DARKEN": np.minimum,
    "LIGHTEN": np.maximum,
}
_COMPUTED: dict[str, Callable[[Node, Socket, Sequence[Constant]], Value | None]] = {
    "MATH": _math,
    "MIX": _mix,
    "MIX_RGB": _mix,
    "CLAMP": _clamp,
    "LIGHT_FALLOFF": _falloff,
    "BLACKBODY": lambda _n, _s, operands: black_body_color(luminance(operands[0])),
    "GAMMA": lambda _n, _s, operands: np.maximum(operands[0], 0) ** luminance(operands[1]),
    "RGBTOBW": lambda _n, _s, operands: luminance(operands[0]),
    "INVERT": _invert,
    "VALTORGB": _color_ramp,
    "COMBINE_COLOR": _combine_color,
}
