# SPDX-License-Identifier: GPL-3.0-or-later
"""Nothing here touches Blender."""

import pytest


@pytest.fixture(autouse=True)
def empty_file():
    """In place of the one that empties Blender's file before every test."""
