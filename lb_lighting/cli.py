# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, the same in Blender and with its Python module:

    blender --background X.blend --command lb_lighting bake --objects Cloud --resolution 96
    python -m lb_lighting bake X.blend --objects Cloud --resolution 96

Both save the lit scene. On failure they print one sentence and exit with code 1.
"""

import argparse
import logging
import os
import sys
from collections.abc import Sequence as List
from pathlib import Path
from typing import Any

import bpy

from . import bake, clearing, job
from .blend_file import save
from .errors import LightingError, OutputError, SceneError
from .options import OPTIONS, OVERWRITE, Option, Options
from .output.volume import require_writable
from .reading import scene_of
from .sequence import Sequence
from .worker import LOG_LEVEL


def main(arguments: List[str], opens_file: bool) -> int:
    """Run one command; the exit code.

    opens_file  True if the first argument of bake and clear is the .blend; False if Blender has
                opened it already
    """
    parsed = _parser(opens_file).parse_args(arguments)
    if parsed.verbose:
        os.environ[LOG_LEVEL] = "INFO"
        logging.basicConfig(level=logging.INFO)
    try:
        parsed.run(parsed)
    except LightingError as error:
        print(f"lb_lighting: {error}", file=sys.stderr)
        return 1
    return 0


def leave(code: int | str | None) -> None:
    """End the process with this exit code.

    As a Python module, Blender sometimes crashes when the interpreter shuts down.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # type: ignore[arg-type] # argparse exits with numbers only


def _parser(opens_file: bool) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("lb_lighting", description="Lattice-Boltzmann lighting")
    parser.add_argument(
        "--verbose",
        action="store_true",
        help="show log messages, and keep the log file of the solver",
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    # Describe bake.
    baking = commands.add_parser("bake", help="bake light into objects and save the scene")
    baking.set_defaults(run=_bake)
    baking.add_argument(
        "--objects",
        nargs="+",
        metavar="NAME",
        help="objects to light (default: the selected objects)",
    )
    when = baking.add_mutually_exclusive_group()
    when.add_argument("--frame", type=int, help="bake this frame (default: the current frame)")
    when.add_argument(
        "--frames", type=_frames, metavar="FIRST-LAST", help="bake a sequence of frames"
    )
    baking.add_argument(OVERWRITE.flag, action="store_true", help=_help(OVERWRITE))
    options = baking.add_argument_group(
        "options", "The options in the panel. Options that are not given come from the .blend file."
    )
    for option in OPTIONS:
        options.add_argument(option.flag, help=_help(option), **_reading(option))
    # Describe clear and devices.
    clear = commands.add_parser("clear", help="remove the baked light and save the scene")
    clear.set_defaults(run=_clear)
    clear.add_argument("--delete-files", action="store_true", help="delete the .vdb files too")
    for command in (baking, clear):
        if opens_file:
            command.add_argument("blend", help="the .blend file to open")
        command.add_argument("--output", metavar="BLEND", help="save to this file instead")
    commands.add_parser("devices", help="list the devices that can compute the light").set_defaults(
        run=_list_devices
    )
    return parser


def _reading(option: Option) -> dict[str, Any]:
    """How argparse reads the values of an option."""
    if isinstance(option.default, tuple):
        return {"type": float, "nargs": 3, "metavar": ("R", "G", "B")}
    if isinstance(option.default, bool):
        return {"action": argparse.BooleanOptionalAction}
    return {"type": type(option.default)}


def _help(option: Option) -> str:
    choices = f". One of: {', '.join(option.identifiers)}" if option.choices else ""
    unit = f", in {option.unit}" if option.unit else ""
    return f"{option.description}{choices}{unit}".replace("%", "%%")


def _bake(parsed: argparse.Namespace) -> None:
    # Set up the scene.
    _open(parsed)
    target = _target(parsed)
    scene = scene_of(bpy.context)
    if bpy.context.mode != "OBJECT":  # the mode in which the file was saved
        bpy.ops.object.mode_set(mode="OBJECT")
    if parsed.frame is not None:
        scene.frame_set(parsed.frame)
    # Bake.
    changes = {option.name: getattr(parsed, option.name) for option in OPTIONS}
    objects, options = _objects(scene, parsed.objects), Options.of(scene, **changes)
    if parsed.frames is None:
        work: bake.Work[bake.Outcome | bake.Kept] = bake.Baking(bpy.context, objects, options)
    else:
        first, last = parsed.frames
        work = Sequence(bpy.context, objects, options, first, last, parsed.overwrite)
    outcome = bake.run(work, bpy.context, _Progress())
    for note in outcome.notes:
        print(note)
    # Save the scene.
    try:
        save(target)
    except OutputError:
        if parsed.frames is None:  # a sequence is too much work to throw away
            outcome.path.unlink(missing_ok=True)
        raise
    print(f"{outcome.summary}: {outcome.path}")


def _frames(text: str) -> tuple[int, int]:
    """(first, last) of a text like 1-24. Raises ValueError, which argparse reports, for others."""
    first, last = text.split("-")
    return int(first), int(last)


def _clear(parsed: argparse.Namespace) -> None:
    _open(parsed)
    target = _target(parsed)
    cleared = clearing.clear(bpy.context)
    save(target)
    print(cleared.summary)
    if parsed.delete_files:  # only once the .blend that shows them is replaced
        for note in cleared.delete_files():
            print(note)


def _list_devices(_parsed: argparse.Namespace) -> None:
    lines, troubles = job.find_devices()
    print(*lines, *troubles, sep="\n")


def _objects(scene: bpy.types.Scene, names: List[str] | None) -> list[bpy.types.Object]:
    if not names:
        return [ob for ob in scene.objects if ob.select_get()]
    missing = [name for name in names if name not in scene.objects]
    if missing:
        raise SceneError(f"The scene has no object '{missing[0]}'; check the name.")
    return [scene.objects[name] for name in names]


def _open(parsed: argparse.Namespace) -> None:
    if "blend" not in parsed:
        return
    try:
        bpy.ops.wm.open_mainfile(filepath=parsed.blend)
    except RuntimeError as error:
        raise SceneError(f"{parsed.blend} cannot be opened; check the path.") from error


def _target(parsed: argparse.Namespace) -> str:
    """The path to save to. Raises OutputError, before the work, if nothing can be saved there."""
    path = parsed.output or bpy.data.filepath
    if not path:
        raise OutputError("The scene has no file yet; choose one with --output.")
    target = Path(path).absolute()
    require_writable(target.parent)
    return str(target)


class _Progress:
    """Prints a line for every 10 %."""

    def __init__(self) -> None:
        self.tenths = 0

    def __call__(self, stage: str, fraction: float) -> None:
        tenths = int(fraction * 10 + 1e-9)
        if tenths > self.tenths:
            self.tenths = tenths
            print(f"{stage}: {10 * tenths} %", flush=True)


def _command(arguments: List[str]) -> int:
    return main(arguments, opens_file=False)


_registered: list[Any] = []


def register() -> None:
    _registered.append(bpy.utils.register_cli_command("lb_lighting", _command))


def unregister() -> None:
    bpy.utils.unregister_cli_command(_registered.pop())
