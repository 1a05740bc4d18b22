# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences for the user that name all that they hold for, so that each is told once."""

MOST = 5  # names in a sentence


class Remarks:
    """Sentences with a {} each, and the names that go there, in the order in which they came."""

    def __init__(self):
        self._names = {}

    def add(self, sentence, name):
        """Note that `sentence` holds for `name`."""
        self._names.setdefault(sentence, {})[name] = None

    @property
    def sentences(self):
        """[str], each with its names filled in."""
        return [sentence.format(listed(names)) for sentence, names in self._names.items()]


def listed(names, most=MOST):
    """'A', 'B' and 3 more."""
    names = [name if name.startswith("'") else f"'{name}'" for name in names]
    shown, rest = names[:most], len(names) - most
    return ", ".join(shown) + (f" and {rest} more" if rest > 0 else "")
