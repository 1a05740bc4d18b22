# SPDX-License-Identifier: GPL-3.0-or-later
"""Print modules and functions that are too long; exit code 1 if there are any.

    python -m tests.setup.sizes [FOLDER...]     default: lb_lighting tests

The limit is 400 lines for a module and 60 for a function with its signature and docstring.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULE, FUNCTION = 400, 60  # lines


def long_ones(path):
    """Yields a line for the module and for each of its functions, if too long."""
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
    """Print modules and functions that are too long, and return their number."""
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    found = [line for path in paths for line in long_ones(path)]
    print(*found, f"{len(paths)} modules, {len(found)} too long", sep="\n")
    return len(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["lb_lighting", "tests"]) > 0)
