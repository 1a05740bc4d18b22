# SPDX-License-Identifier: GPL-3.0-or-later
"""python -m lb_lighting: the command line with Blender as a Python module."""

import sys

import bpy

bpy.utils.expose_bundled_modules()

from . import register  # noqa: E402 - needs the exposed OpenVDB
from .cli import leave, main  # noqa: E402

register()
code: int | str | None
try:
    code = main(sys.argv[1:], opens_file=True)
except SystemExit as end:  # argparse: help, or wrong arguments
    code = end.code
leave(code)
