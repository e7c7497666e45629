"""The page of samplers shows every sampler with its current summary, dims and counts."""

import json
import re
from pathlib import Path

import pytest

from mcspectra.report.sampler_cards import all_samplers
from mcspectra.samplers.facts import sampler_facts

FOLDER = Path(__file__).parents[2] / "docs" / "samplers"
PAGE = (FOLDER / "index.md").read_text(encoding="utf-8")
NUMBERS = json.loads((FOLDER / "gallery.json").read_text(encoding="utf-8"))
SECTIONS = dict(re.findall(r"^## `(.+?)`\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))


def test_every_sampler_has_a_section_and_a_picture():
    assert sorted(SECTIONS) == all_samplers()
    for section in SECTIONS.values():
        (picture,) = re.findall(r"\]\((.+?\.png)\)", section)
        assert (FOLDER / picture).is_file()
    assert [card["name"] for card in NUMBERS] == list(SECTIONS)


def test_the_overview_shows_every_sampler_once():
    overview = PAGE.partition("<!-- end of the overview -->")[0]
    named = re.findall(r"!\[Points and spectrum of (.+?)\]\((thumbnails/.+?\.png)\)\]", overview)
    assert sorted(name for name, _ in named) == all_samplers()
    assert all((FOLDER / picture).is_file() for _, picture in named)


@pytest.mark.parametrize("name", [name for name in SECTIONS if re.fullmatch("[a-z0-9-]+", name)])
def test_sections_match_the_facts_of_samplers(name):
    facts = sampler_facts(name)
    section = SECTIONS[name]
    assert facts.summary in section
    assert f"* Dims: {facts.dims}\n" in section
    assert f"* Counts: {facts.counts}\n" in section
    assert facts.sources in re.sub(r"<(https://\S+)>", r"\1", section)
    (card,) = (card for card in NUMBERS if card["name"] == name)
    assert card["facts"] == {key: getattr(facts, key) for key in card["facts"]}
