# SPDX-License-Identifier: GPL-3.0-or-later
"""The values that the shader of a lit volume needs besides its grids. Needs no Blender.

Each frame of a sequence has its own, in the metadata of its file.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np

from ..arrays import Spectrum
from ..transport.lights.distant import Sun
from ..transport.lights.lamps import PointLight, SpotLight
from .vdb import AXES

type Bands = tuple[float, float, float]
type Beam = Sun | PointLight | SpotLight


@dataclass(frozen=True)
class Look:
    """Values of the shader's inputs.

    sigma_s, sigma_a  scattering and absorption coefficient at density 1, 1/m
    g      mean cosine of the scattering angle
    lobes  mean cosine of the light in `forward_grid`, once it has scattered towards the eye, if the
           light comes from a source iteration; else None. With it the file has all `moment_grid`s
    beams  ({input: value}), one for each grid `direct_grid(1)`, … and `forward_grid(1)`, …: the
           direction for `LB Beam` if it is a sun's, else the inputs of `LB Lamp`
    """

    sigma_s: Bands
    sigma_a: Bands
    g: Bands
    lobes: Bands | None
    beams: tuple[dict[str, float | Bands], ...]

    @classmethod
    def of(
        cls,
        sigma_s: Spectrum,
        sigma_a: Spectrum,
        g: Spectrum = 0.0,
        beams: Sequence[Beam] = (),
        core: float = 0.0,
        lobes: Spectrum | None = None,
    ) -> Self:
        """The values for coefficients and lobes that are scalar or (3,).

        beams  the light of each grid of uncollided light
        core   m, core radius of the falloff of points and spots: one voxel
        """
        return cls(
            _bands(sigma_s),
            _bands(sigma_a),
            _bands(g),
            None if lobes is None else _bands(lobes),
            tuple(_inputs(beam, core) for beam in beams),
        )

    @classmethod
    def read(cls, text: str) -> Self:
        """The values that `text` describes; see `Look.text`."""
        values = json.loads(text)
        return cls(**{name: v if name == "beams" else v and tuple(v) for name, v in values.items()})

    @property
    def text(self) -> str:
        """The values as JSON."""
        return json.dumps(asdict(self))


def _bands(value: Spectrum) -> Bands:
    """A value for all bands, or for each, as three bands."""
    bands = [float(v) for v in np.atleast_1d(value)]
    red, green, blue = bands * 3 if len(bands) == 1 else bands
    return red, green, blue


def _inputs(beam: Beam, core: float) -> dict[str, float | Bands]:
    """{input: value} of the node group that shows a beam."""
    if isinstance(beam, Sun):
        length = math.hypot(*beam.direction)
        return {a: _bands(v / length) for a, v in zip(AXES, beam.direction, strict=True)}
    return {
        "Position": _bands(beam.position),
        "Radius": float(beam.radius),
        "Core": float(core),
        "Peak": float(beam.peak(core)),
    }
