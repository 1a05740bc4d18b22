# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation names what there is: public names, files and messages.

`make docs` checks its links.
"""

import ast
import re
from pathlib import Path

import pytest

from lb_lighting import transport

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted(ROOT.glob("docs/**/*.md"))]
FOLDERS = ("", "lb_lighting", "lb_lighting/transport", "lb_lighting/kernels")
EXAMPLES = ("WING/", "tests/...")  # not the names of files


def test_the_page_of_the_interface_lists_every_public_name():
    page = (ROOT / "docs" / "dev" / "api.md").read_text("utf-8")
    listed = re.findall(r"^::: lb_lighting\.transport\.(\w+)$", page, re.MULTILINE)
    assert sorted(listed) == sorted(transport.__all__)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_that_a_page_names_exist(page):
    named = re.findall(r"`((?:[\w.-]+/)+[\w.-]+\.(?:py|cl|npz))`", page.read_text("utf-8"))
    names = [name for name in named if not any(example in name for example in EXAMPLES)]
    missing = [n for n in names if not any((ROOT / folder / n).exists() for folder in FOLDERS)]
    assert not missing


def test_messages_that_the_page_on_troubleshooting_quotes_exist():
    page = (ROOT / "docs" / "user" / "troubleshooting.md").read_text("utf-8")
    quoted = re.findall(r"^\| (.*) \| .* \|$", page, re.MULTILINE)
    parts = {part.strip(" :") for row in quoted for part in re.split("[…;]", row)}
    parts -= {"", "message"}
    sentences = "\n".join(_sentences())
    assert len(parts) > 50
    assert sorted(part for part in parts if part not in sentences) == []


def _sentences():
    """Yield each string of the program, with … for what is put into it."""
    for path in sorted((ROOT / "lb_lighting").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                yield "".join(v.value if isinstance(v, ast.Constant) else "…" for v in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
