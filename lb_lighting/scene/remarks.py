# SPDX-License-Identifier: GPL-3.0-or-later
"""Notes for the user that name all the objects they apply to, so that each appears once."""

from collections.abc import Iterable

MOST = 5  # names in a sentence


class Remarks:
    """Sentences, each with a {} for the names of the objects that it applies to, in order."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, None]] = {}

    def add(self, sentence: str, name: str) -> None:
        """Note that `sentence` applies to the object `name`."""
        self._names.setdefault(sentence, {})[name] = None

    @property
    def sentences(self) -> list[str]:
        """[str], each with its names filled in."""
        return [sentence.format(listed(names)) for sentence, names in self._names.items()]


def listed(names: Iterable[str], most: int = MOST) -> str:
    """The names in quotes, the first few of them: 'A', 'B' and 3 more."""
    quoted = [name if name.startswith("'") else f"'{name}'" for name in names]
    hidden = len(quoted) - most
    return ", ".join(quoted[:most]) + (f" and {hidden} more" if hidden > 0 else "")
