# SPDX-License-Identifier: GPL-3.0-or-later
"""An extension of Griffe, which reads docstrings for the site: aligned columns become lists.

Docstrings write a parameter as its name, two spaces or more, and its description, which goes on in
indented lines. Markdown would run these together into one paragraph.
"""

import re

import griffe

ITEM = re.compile(r"(\w+(?:, \w+)*) {2,}(\S.*)")


def listed(text):
    """The docstring with each run of aligned columns as a Markdown list."""
    lines, in_list = [], False
    for line in text.splitlines():
        if item := ITEM.fullmatch(line):
            line = f"- `{item[1]}`: {item[2]}"
            if not in_list:
                lines.append("")
            in_list = True
        elif in_list and line.startswith(" "):
            line = f"  {line.strip()}"
        elif in_list:
            lines.append("")
            in_list = False
        lines.append(line)
    return "\n".join(lines)


class AlignedColumns(griffe.Extension):
    """Rewrites the docstring of every object that Griffe reads."""

    def on_object(self, *, obj, **_):
        if obj.docstring:
            obj.docstring.value = listed(obj.docstring.value)
