# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of all options in the manual: `python -m tests.setup.reference` writes it.

It goes between two marks of a page in docs/user. `lb_lighting.options` has what it says.
"""

from pathlib import Path

from lb_lighting.options import OPTIONS, OVERWRITE, ROLE, Option

BEGIN, END = "<!-- options: begin -->", "<!-- options: end -->"
DOCS = Path(__file__).parents[2] / "docs" / "user"


def table() -> str:
    """The Markdown table."""
    head = "| option | argument | default | range | what it does |\n|---|---|---|---|---|\n"
    return head + "".join(map(_row, (*OPTIONS, OVERWRITE, ROLE)))


def pages() -> list[Path]:
    """The pages of the manual that have the marks."""
    return [path for path in sorted(DOCS.rglob("*.md")) if BEGIN in path.read_text()]


def updated(text: str) -> str:
    """The text of a page with the table as it is now."""
    before, rest = text.split(BEGIN)
    _old, after = rest.split(END)
    return f"{before}{BEGIN}\n{table()}{END}{after}"


def _row(option: Option) -> str:
    flag = "" if option is ROLE else f"`{option.flag}`"
    choices = "".join(
        f"<br>**{choice.label}** (`{choice.identifier}`): {choice.description}."
        for choice in option.choices
    )
    cells = (
        f"**{option.label}**",
        flag,
        _value(option),
        _range(option),
        f"{option.description}.{choices}",
    )
    return f"| {' | '.join(cells)} |\n"


def _value(option: Option) -> str:
    """The default, with its unit."""
    value = option.default
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        labels = {choice.identifier: choice.label for choice in option.choices}
        return labels.get(value, value)
    values = value if isinstance(value, tuple) else (value,)
    return f"{', '.join(f'{number:.2g}' for number in values)} {option.unit}".strip()


def _range(option: Option) -> str:
    if option.lowest is None:
        return ""
    if option.highest is None:
        return f"from {option.lowest:g}"
    return f"{option.lowest:g} to {option.highest:g}"


def main() -> None:
    for path in pages():
        path.write_text(updated(path.read_text()))


if __name__ == "__main__":
    main()
