# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading the nodes of what shines: constants that nodes compute, as Cycles does for light.

To light that is not seen by the camera, Light Path and Backfacing are constants, too.
"""

import numpy as np

from ...errors import LightError, LightingError
from ..nodes.black_body import black_body_color
from ..nodes.shaders import LUMINANCE, Shader

# What Light Path is for light that comes straight from a world; of lamps, all is 0 in Cycles.
ON_SURFACES = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0}
IN_VOLUMES = {"Is Volume Scatter Ray": 1.0}

_LINEAR = {"MATH", "MIX", "MIX_RGB"}  # whose result for a mean is at least like the mean of results
_MATH = {
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
_BLENDS = {
    "MIX": lambda a, b: b,
    "ADD": np.add,
    "SUBTRACT": np.subtract,
    "MULTIPLY": np.multiply,
    "DARKEN": np.minimum,
    "LIGHTEN": np.maximum,
}


class LightShader(Shader):
    """The nodes of a world, a lamp or a shining material.

    path      {output of a Light Path: its value}; the booleans that are not there are 0
    back      1 where the back of faces is meant, 0 for their front
    tolerant  whether nodes that cannot be read count as 1 (as 0.5 where they mix shaders), and
              those that make no light are left out; otherwise both raise LightError
    patterns  {label of a node: None} of those that were averaged, or not read
    """

    def __init__(self, owner, path=(), back=0.0, tolerant=False):
        super().__init__(owner, LightError)
        self.path, self.back, self.tolerant = dict(path), back, tolerant
        self.patterns = {}
        self._constants = {}  # {(socket, groups): value}, each found once

    def shining(self, output, known):
        """`closures` that have a share in what is seen."""
        return [closure for closure in self.closures(output, known) if closure.weight > 0]

    def _refuse_closure(self, node):
        if not self.tolerant:
            super()._refuse_closure(node)

    def _factor(self, socket, groups):
        """How much of the second shader a Mix Shader takes; None where that is to be refused."""
        socket, groups = self.links.resolve(socket, groups)
        value = self._constant(socket, groups)
        if value is None and self.tolerant:
            value = self._mean(socket, groups, 0.5)
        return None if value is None else float(np.clip(_grey(value), 0, 1))

    def _average(self, socket, groups):
        value = self._constant(socket, groups)
        return self._mean(socket, groups, 1.0) if value is None else value

    def _mean(self, socket, groups, stand_in):
        """What a resolved socket is on average, or `stand_in`."""
        self.patterns[socket.node.bl_label] = None
        try:
            return super()._average(socket, groups)
        except LightError:
            if not self.tolerant:
                raise
            return stand_in * self._own_strength(socket.node, groups)

    def _own_strength(self, node, groups):
        """The constant Strength of an IES Texture or a Light Falloff; 1 for other nodes."""
        strength = node.inputs.get("Strength")
        value = self._constant(*self.links.resolve(strength, groups)) if strength else None
        return 1.0 if value is None else _grey(value)

    def _constant(self, socket, groups):
        """The value of a resolved socket, a number or (3,), where it is one constant, or None."""
        key = socket, groups
        if key not in self._constants:
            self._constants[key] = self._find_constant(socket, groups)
        return self._constants[key]

    def _find_constant(self, socket, groups):
        node = socket.node
        if not socket.is_output or node.type in {"RGB", "VALUE"}:
            value = socket.default_value
            return np.array(value[:3]) if hasattr(value, "__len__") else value
        if node.type == "LIGHT_PATH":
            return self.path.get(socket.name, 0.0) if socket.name.startswith("Is ") else None
        if node.type == "NEW_GEOMETRY":
            return self.back if socket.name == "Backfacing" else None
        read = _READERS.get(node.type)
        if read is None:
            return None
        # Sockets that are not in use are not asked for.
        inputs = [s for s in node.inputs if s.enabled]
        values = [self._constant(*self.links.resolve(s, groups)) for s in inputs]
        if self.tolerant and node.type in _LINEAR:
            values = [
                self._mean(*self.links.resolve(s, groups), 1.0) if value is None else value
                for s, value in zip(inputs, values, strict=True)
            ]
        if any(value is None for value in values):
            return None
        return read(node, socket, values)


def or_else(default, read, owner):
    """read(owner), or `default` for nodes that are broken: groups that are gone, loops and such.

    What is not selected is read by the way, and must not end a bake.
    """
    try:
        return read(owner)
    except (LightingError, AttributeError, LookupError, RuntimeError, StopIteration):
        return default


def _math(node, _socket, values):
    function = _MATH.get(node.operation)
    if function is None:
        return None
    with np.errstate(all="ignore"):
        value = float(function(*map(_grey, values)))
    value = value if np.isfinite(value) else 0.0
    return min(max(value, 0.0), 1.0) if node.use_clamp else value


def _mix(node, _socket, values):
    if node.type == "MIX" and (node.data_type not in {"FLOAT", "RGBA"} or len(values) != 3):
        return None
    is_color = node.type == "MIX_RGB" or node.data_type == "RGBA"
    blend = _BLENDS.get(node.blend_type if is_color else "MIX")
    if blend is None:
        return None
    factor, first, second = values
    factor = _grey(factor)
    if node.type == "MIX_RGB" or node.clamp_factor:
        factor = min(max(factor, 0.0), 1.0)
    mixed = (1 - factor) * np.asarray(first) + factor * blend(np.asarray(first), np.asarray(second))
    clamped = node.use_clamp if node.type == "MIX_RGB" else node.clamp_result
    return np.clip(mixed, 0, 1) if clamped and is_color else mixed


def _falloff(_node, socket, values):
    strength, smooth = map(_grey, values)
    return strength if socket.name == "Quadratic" and smooth == 0 else None


def _clamp(node, _socket, values):
    value, low, high = map(_grey, values)
    if node.clamp_type == "RANGE" and low > high:
        low, high = high, low
    return min(max(value, low), high)


_READERS = {
    "MATH": _math,
    "MIX": _mix,
    "MIX_RGB": _mix,
    "LIGHT_FALLOFF": _falloff,
    "CLAMP": _clamp,
    "BLACKBODY": lambda _n, _s, values: black_body_color(_grey(values[0])),
    "GAMMA": lambda _n, _s, v: np.maximum(v[0], 0) ** _grey(v[1]),
    "RGBTOBW": lambda _n, _s, values: _grey(values[0]),
    "INVERT": lambda _n, _s, v: (1 - _grey(v[0])) * v[1] + _grey(v[0]) * (1 - np.asarray(v[1])),
    "VALTORGB": lambda n, s, v: (
        np.array(n.color_ramp.evaluate(_grey(v[0]))[:3]) if s.name == "Color" else None
    ),
    "COMBINE_COLOR": lambda n, _s, v: np.array([*map(_grey, v)]) if n.mode == "RGB" else None,
}


def _grey(value):
    return float(LUMINANCE @ value if np.ndim(value) else value)
