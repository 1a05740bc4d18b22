# SPDX-License-Identifier: GPL-3.0-or-later
"""What the shader of a lit volume knows besides its grids. Needs no Blender.

Every frame of a sequence brings its own, in the metadata of its file.
"""

import json
import math
from dataclasses import asdict, dataclass

from ..transport.lights.distant import Sun
from .vdb import AXES


@dataclass(frozen=True)
class Look:
    """Values of the shader's inputs.

    sigma_s, sigma_a  scattering and absorption coefficient at density 1, 1/m, (3,)
    g      mean cosine of the scattering angle, (3,)
    lobes  (3,) mean cosine of what `forward_grid`s are scattered to where that was gathered, or
           None; then the file has each `moment_grid`
    beams  ({input: value}), of each grid `direct_grid(1)` ... and `forward_grid(1)` ...: of a sun
           the inputs of `LB Beam` that are its direction; else those of `LB Lamp`
    """

    sigma_s: tuple
    sigma_a: tuple
    g: tuple
    lobes: tuple | None
    beams: tuple

    @classmethod
    def of(cls, sigma_s, sigma_a, g=0.0, beams=(), core=0.0, lobes=None):
        """That of coefficients and lobes that are scalar or (3,).

        beams  the `Sun`, `PointLight` or `SpotLight` of each grid of unscattered light
        core   m, that of the falloff of points and spots: an edge of a voxel
        """
        return cls(
            *map(_triple, (sigma_s, sigma_a, g)),
            None if lobes is None else _triple(lobes),
            tuple(_inputs(beam, core) for beam in beams),
        )

    @classmethod
    def read(cls, text):
        """What `text` wrote."""
        values = json.loads(text)
        return cls(**{name: v if name == "beams" else v and tuple(v) for name, v in values.items()})

    @property
    def text(self):
        return json.dumps(asdict(self))


def _triple(value):
    """A spectral value as three bands."""
    value = [float(v) for v in value] if hasattr(value, "__len__") else [float(value)]
    return tuple(value * 3 if len(value) == 1 else value)


def _inputs(beam, core):
    if isinstance(beam, Sun):
        length = math.hypot(*beam.direction)
        return {a: _triple(v / length) for a, v in zip(AXES, beam.direction, strict=True)}
    return {
        "Position": _triple(beam.position),
        "Radius": float(beam.radius),
        "Core": float(core),
        "Peak": float(beam.peak(core)),
    }
