# SPDX-License-Identifier: GPL-3.0-or-later
"""Problems and fields as files, for the way to the solver's process and back.

Plain arrays and JSON in one .npz: Blender knows our classes under another module name than the
worker does, so nothing that names a class (a pickle) could cross.
"""

import json
from dataclasses import asdict

import numpy as np

from .errors import LightError
from .transport.field import Field, Report
from .transport.lights import PointLight, Sky, Sun
from .transport.medium import Domain, Medium
from .transport.solver import Settings

_LIGHTS = {light.__name__: light for light in (Sun, Sky, PointLight)}
_MEDIUM_ARRAYS = (
    "density",
    "sigma_s",
    "sigma_a",
    "g",
    "emission",
    "occlusion",
    "occlusion_albedo",
    "shift",
)
_FIELD_ARRAYS = ("fluence", "direct", "flux", "variance", "by_light", "direct_flux")


def save_problem(path, medium, lights, settings, device):
    """Write what `solve` takes; device is a label or None."""
    facts = {
        "voxel_size": medium.voxel_size,
        "origin": medium.origin,
        "lights": [_light_facts(light) for light in lights],
        "settings": asdict(settings),
        "device": device,
    }
    shadows = {_shadow(n): getattr(light, "shadow_density", None) for n, light in enumerate(lights)}
    _save(path, facts, {name: getattr(medium, name) for name in _MEDIUM_ARRAYS} | shadows)


def load_problem(path):
    """(medium, lights, settings, device) as `save_problem` took them."""
    facts, arrays = _load(path)
    lights = [
        _light(light, arrays.pop(_shadow(n), None)) for n, light in enumerate(facts["lights"])
    ]
    medium = Medium(voxel_size=facts["voxel_size"], origin=facts["origin"], **arrays)
    return medium, lights, Settings(**facts["settings"]), facts["device"]


def save_field(path, field):
    facts = {"domain": asdict(field.domain), "report": asdict(field.report)}
    _save(path, facts, {name: getattr(field, name) for name in _FIELD_ARRAYS})


def load_field(path):
    facts, arrays = _load(path)
    domain, report = facts["domain"], facts["report"]
    report["energy"] = {where: np.array(power) for where, power in report["energy"].items()}
    return Field(
        domain=Domain(tuple(domain["origin"]), domain["voxel_size"], tuple(domain["shape"])),
        report=Report(**report),
        **arrays,
    )


def _light_facts(light):
    """What JSON can hold of a light: all but its shadow's grid."""
    if isinstance(light, Sky) and callable(light.radiance):
        raise LightError("A sky given as a function can be solved in the same process only.")
    values = {name: value for name, value in vars(light).items() if name != "shadow_density"}
    return {"kind": type(light).__name__, **values}


def _light(facts, shadow):
    kind = _LIGHTS[facts.pop("kind")]
    return kind(**facts) if shadow is None else kind(**facts, shadow_density=shadow)


def _shadow(number):
    return f"shadow_{number}"


def _save(path, facts, arrays):
    present = {name: array for name, array in arrays.items() if array is not None}
    np.savez(path, facts=json.dumps(facts, default=np.ndarray.tolist), **present)


def _load(path):
    with np.load(path) as data:
        return json.loads(str(data["facts"])), {k: data[k] for k in data.files if k != "facts"}
