# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel, command line and manual say the same of each option."""

from dataclasses import fields

import pytest

from lb_lighting import cli
from lb_lighting.options import OPTIONS, OVERWRITE, QUALITIES, ROLE, Options
from lb_lighting.scene.medium_choice import CUSTOM
from lb_lighting.transport.planning.planner import TARGETS
from lb_lighting.ui.properties import ObjectProperties, SceneProperties
from tests.setup import reference


def test_every_option_is_in_the_table():
    assert [option.name for option in OPTIONS] == [field.name for field in fields(Options)]


@pytest.mark.parametrize("option", [*OPTIONS, OVERWRITE, ROLE], ids=lambda option: option.name)
def test_properties_are_as_the_table_says(option):
    group = ObjectProperties if option is ROLE else SceneProperties
    rna = group.bl_rna.properties[option.name]
    assert (rna.name, rna.description) == (option.label, option.description)
    if option.choices:
        items = [(item.identifier, item.name, item.description) for item in rna.enum_items]
        assert items == list(option.choices)
    if rna.type != "POINTER":
        is_vector = isinstance(option.default, tuple)
        assert (tuple(rna.default_array) if is_vector else rna.default) == option.default
    for limit, value in (("hard_min", option.lowest), ("hard_max", option.highest)):
        if value is not None:
            assert getattr(rna, limit) == pytest.approx(value)


def test_help_names_every_option(capsys):
    with pytest.raises(SystemExit):
        cli.main(["bake", "--help"], opens_file=True)
    text = " ".join(capsys.readouterr().out.split())
    for option in (*OPTIONS, OVERWRITE):
        assert f"{option.flag} " in text or f"{option.flag}, " in text
        assert all(identifier in text for identifier in option.identifiers)


def test_qualities_are_the_targets_of_plans():
    assert [choice.identifier for choice in QUALITIES] == [*TARGETS, CUSTOM]


def test_the_manual_has_the_table():
    pages = reference.pages()
    assert len(pages) == 1
    text = pages[0].read_text()
    assert text == reference.updated(text)
