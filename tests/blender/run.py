# SPDX-License-Identifier: GPL-3.0-or-later
"""Run pytest on this folder inside Blender; Blender's exit code is pytest's.

Arguments after `--` are pytest's, to run some of the tests only.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path += [str(HERE), str(ROOT / "build" / "blender" / "python")]
sys.dont_write_bytecode = True

import pytest  # noqa: E402 (it is found through the line above)

# Without `pythonpath`, and with the search for packages cut off here, the checkout's own
# lb_lighting cannot be imported in place of the installed one.
OPTIONS = ["-p", "no:cacheprovider", "-o", "pythonpath=", f"--confcutdir={HERE}"]
chosen = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [str(HERE)]
code = pytest.main([*OPTIONS, *chosen])
sys.stdout.flush()
# Not sys.exit: Blender would turn it into its own code.
os._exit(code)
