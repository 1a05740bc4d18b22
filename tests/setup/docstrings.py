# SPDX-License-Identifier: GPL-3.0-or-later
"""An extension of Griffe, which reads docstrings for the site: aligned columns become lists.

Docstrings write a parameter as its name, two spaces or more, and its description, which continues
in indented lines. Markdown would join these into one paragraph.
"""

import re

import griffe

NAMES = r"\w+(?:, \w+)*"
ITEM = re.compile(rf"({NAMES})  +(?=\S)")


def listed(text):
    """The docstring with each run of aligned columns as a Markdown list."""
    lines, column = [], 0  # column of the descriptions in the current list, or 0
    for line in text.splitlines():
        item = ITEM.match(line)
        if item or is_longest_item(line, column):
            if not column:
                lines.append("")
            column = item.end() if item else column
            line = f"- `{line[:column].strip()}`: {line[column:]}"
        elif column and line.startswith(" "):
            line = f"  {line.strip()}"
        elif column:
            lines.append("")
            column = 0
        lines.append(line)
    return "\n".join(lines)


def is_longest_item(line, column):
    """Whether only one space separates a name from its description: it fills its column."""
    return bool(column and re.fullmatch(f"{NAMES} ", line[:column]))


class AlignedColumns(griffe.Extension):
    """Rewrites the docstring of every object that Griffe reads."""

    def on_object(self, *, obj, **_):
        if obj.docstring:
            obj.docstring.value = listed(obj.docstring.value)
