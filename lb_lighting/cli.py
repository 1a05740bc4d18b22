# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, the same in Blender and with its Python module:

    blender --background X.blend --command lb_lighting bake --objects Cloud --resolution 96
    python -m lb_lighting bake X.blend --objects Cloud --resolution 96

Both save the lit scene, print one sentence on failure and then exit with 1.
"""

import argparse
import os
import sys
from dataclasses import fields
from pathlib import Path

import bpy

from . import bake, job
from .blend_file import save
from .errors import LightingError, OutputError, SceneError
from .output.volume import require_writable
from .sequence import Sequence

_HELP = {
    "resolution": "voxels along the longest edge",
    "padding": "empty voxels around what is lit",
    "domain": "object whose bounds are lit",
    "medium": "MATERIAL, CUSTOM, cloud, plant or pmma",
    "sigma_s": "scattering at density 1 by band in 1/m, for CUSTOM",
    "sigma_a": "absorption at density 1 by band in 1/m, for CUSTOM",
    "g": "mean cosine of the scattering angle by band, for CUSTOM",
    "optical_depth": "of the longest edge at density 1, for presets; 0: CUSTOM as it is",
    "grid": "grid to read from volumes and smoke",
    "model": "physical or paper",
    "quality": "preview, draft, final or reference: 20, 10, 5 or 2 %% of error; or CUSTOM",
    "scattering": "multiple or single, for CUSTOM",
    "rays": "of unscattered light along a voxel's edge, over the usual number, for CUSTOM",
    "merge": "times that voxels are larger in which scattered light is found, for CUSTOM",
    "photons": "how many are traced, 0 for 64 a voxel, for CUSTOM",
    "tolerance": "relative error that the lattice's steps leave, for CUSTOM",
    "handover": "transport optical depths that photons go before the lattice, for CUSTOM",
    "gather": "follow what volumes scatter forwards along rays of many directions at last",
    "mode": "REPLACE or ADD",
    "foliage": "ATTRIBUTE, written on the mesh, or MODIFIER, which reads the baked volume",
    "sky": "bake the world's own light into surfaces, too, where no lamp shines",
    "strength": "factor on the light in the render",
    "keep_absorbed": "emit absorbed light again, in the paper's model",
    "device": "part of a device's name",
    "folder": "where the .vdb is written",
}


def main(arguments, opens_file):
    """Run one command; the exit code.

    opens_file  whether the first argument of bake and clear is the .blend, or Blender has it open
    """
    parsed = _parser(opens_file).parse_args(arguments)
    try:
        parsed.run(parsed)
    except LightingError as error:
        print(f"lb_lighting: {error}", file=sys.stderr)
        return 1
    return 0


def leave(code):
    """End the process with an exit code that holds.

    As a Python module, Blender at times crashes when the interpreter takes it down.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _parser(opens_file):
    parser = argparse.ArgumentParser("lb_lighting", description="Lattice-Boltzmann lighting")
    commands = parser.add_subparsers(required=True, metavar="command")
    baking = commands.add_parser("bake", help="light objects and save the scene")
    baking.set_defaults(run=_bake)
    baking.add_argument("--objects", nargs="+", metavar="NAME", help="default: the selected ones")
    when = baking.add_mutually_exclusive_group()
    when.add_argument("--frame", type=int, help="frame of the scene to light")
    when.add_argument("--frames", type=_frames, metavar="FIRST-LAST", help="bake a sequence")
    baking.add_argument("--overwrite", action="store_true", help="bake frames that are there, too")
    for option in fields(bake.Options):
        # Left out, an option is what the .blend says.
        if option.type is tuple:
            how = {"type": float, "nargs": 3, "metavar": ("R", "G", "B")}
        elif option.type is bool:
            how = {"action": argparse.BooleanOptionalAction}
        else:
            how = {"type": option.type}
        name = f"--{option.name.replace('_', '-')}"
        baking.add_argument(name, default=None, help=_HELP[option.name], **how)
    clearing = commands.add_parser("clear", help="take the light out and save the scene")
    clearing.set_defaults(run=_clear)
    clearing.add_argument("--delete-files", action="store_true", help="delete the .vdb files too")
    for command in (baking, clearing):
        if opens_file:
            command.add_argument("blend", help="the scene")
        command.add_argument("--output", metavar="BLEND", help="save here, not over the scene")
    commands.add_parser("devices", help="list what can solve").set_defaults(run=_list_devices)
    return parser


def _bake(parsed):
    _open(parsed)
    target = _target(parsed)
    scene = bpy.context.scene
    if bpy.context.mode != "OBJECT":  # the file was saved so
        bpy.ops.object.mode_set(mode="OBJECT")
    if parsed.frame is not None:
        scene.frame_set(parsed.frame)
    changes = {f.name: getattr(parsed, f.name) for f in fields(bake.Options)}
    objects, options = _objects(scene, parsed.objects), bake.Options.of(scene, **changes)
    if parsed.frames is None:
        baking = bake.Baking(bpy.context, objects, options)
    else:
        baking = Sequence(bpy.context, objects, options, *parsed.frames, parsed.overwrite)
    outcome = bake.run(baking, bpy.context, _Progress())
    for note in outcome.notes:
        print(note)
    try:
        save(target)
    except OutputError:
        if parsed.frames is None:  # a sequence is too much work to be thrown away
            outcome.path.unlink(missing_ok=True)
        raise
    print(f"{outcome.summary}: {outcome.path}")


def _frames(text):
    """(first, last) of a text like 1-24; ValueError, which argparse tells, for any other."""
    first, last = text.split("-")
    return int(first), int(last)


def _clear(parsed):
    _open(parsed)
    target = _target(parsed)
    cleared = bake.clear(bpy.context)
    save(target)
    print(cleared.summary)
    if parsed.delete_files:  # not before the file that shows them is replaced
        for note in cleared.delete_files():
            print(note)


def _list_devices(_parsed):
    lines, troubles = job.find_devices()
    print(*lines, *troubles, sep="\n")


def _objects(scene, names):
    if not names:
        return [ob for ob in scene.objects if ob.select_get()]
    missing = [name for name in names if name not in scene.objects]
    if missing:
        raise SceneError(f"The scene has no object '{missing[0]}'; check the name.")
    return [scene.objects[name] for name in names]


def _open(parsed):
    if "blend" not in parsed:
        return
    try:
        bpy.ops.wm.open_mainfile(filepath=parsed.blend)
    except RuntimeError as error:
        raise SceneError(f"{parsed.blend} cannot be opened; check the path.") from error


def _target(parsed):
    """The path to save at; OutputError, before the work, where nothing can be saved."""
    path = parsed.output or bpy.data.filepath
    if not path:
        raise OutputError("The scene has no file yet; say where to save it with --output.")
    path = Path(path).absolute()
    require_writable(path.parent)
    return str(path)


class _Progress:
    """Prints a line at every tenth."""

    def __init__(self):
        self.tenths = 0

    def __call__(self, stage, fraction):
        tenths = int(fraction * 10 + 1e-9)
        if tenths > self.tenths:
            self.tenths = tenths
            print(f"{stage}: {10 * tenths} %", flush=True)


def _command(arguments):
    return main(arguments, opens_file=False)


_registered = []


def register():
    _registered.append(bpy.utils.register_cli_command("lb_lighting", _command))


def unregister():
    bpy.utils.unregister_cli_command(_registered.pop())
