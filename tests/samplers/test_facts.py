"""Declared dims, counts and sources of samplers are correct and present."""

import re

import pytest

from mcspectra.core.errors import UnknownName
from mcspectra.samplers import SAMPLERS
from mcspectra.samplers.facts import sampler_facts

OWN = {
    "command",
    "points",
    "python",
    "scipy",
    "qmcpy",
    "mitsuba",
    "shared-cells",
}  # samplers without references
YEAR = re.compile(r"\((1[89]|20)\d\d\)|[A-Za-z](1[89]|20)\d\d\]")
BUILT_IN = [name for name, target in SAMPLERS.items() if target.startswith("mcspectra.")]


@pytest.mark.parametrize(
    ("name", "dims", "counts"),
    [
        ("random", "any", "any"),
        ("jittered", "any", "1, 4, 9, 16, 25, 36, …"),
        ("multi-jittered", "2", "1, 2, 4, 6, 8, 9, …"),
        ("sobol", "1–1111", "any; balanced: 1, 2, 4, 8, 16, 32, …"),
        ("points", "as given", "as given"),
    ],
)
def test_dims_and_counts_are_correct(name, dims, counts):
    facts = sampler_facts(name)
    assert (facts.dims, facts.counts) == (dims, counts)


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_sampler_has_a_summary_and_a_source(name):
    facts = sampler_facts(name)
    assert facts.name == name
    assert facts.summary.endswith(".")
    assert name in OWN or YEAR.search(facts.sources), facts.sources


def test_sources_end_with_their_section():
    assert "Attributes" not in sampler_facts("halton").sources
    assert sampler_facts("points").sources == ""


def test_unknown_names():
    with pytest.raises(UnknownName, match="There is no sampler called 'jitterd'"):
        sampler_facts("jitterd")
