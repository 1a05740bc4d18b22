# SPDX-License-Identifier: GPL-3.0-or-later
"""Print modules and functions too long to read at once; exit code 1 where there are any.

    python -m tests.setup.sizes [FOLDER...]     default: lb_lighting tests

A module is too long over 400 lines, a function over 60, its docstring and signature included.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULE, FUNCTION = 400, 60  # lines


def long_ones(path):
    """Yields a line for the module and each function in it that is too long."""
    text = path.read_text(encoding="utf-8")
    name, lines = path.relative_to(ROOT), len(text.splitlines())
    if lines > MODULE:
        yield f"{name}: {lines} lines"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = node.end_lineno - node.lineno + 1
            if length > FUNCTION:
                yield f"{name}:{node.lineno}: {node.name}, {length} lines"


def main(folders):
    """Print what is too long in the folders; how many there are."""
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    found = [line for path in paths for line in long_ones(path)]
    print(*found, f"{len(paths)} modules, {len(found)} too long", sep="\n")
    return len(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["lb_lighting", "tests"]) > 0)
