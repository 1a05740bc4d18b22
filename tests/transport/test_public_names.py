# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of the Python interface, docs/dev/api.md, lists exactly the public names."""

import re
from pathlib import Path

from lb_lighting import transport

PAGE = Path(__file__).parents[2] / "docs" / "dev" / "api.md"


def test_the_page_lists_every_public_name():
    listed = re.findall(
        r"^::: lb_lighting\.transport\.(\w+)$", PAGE.read_text("utf-8"), re.MULTILINE
    )
    assert sorted(listed) == sorted(transport.__all__)
