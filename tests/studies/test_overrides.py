"""``--set``: values as in TOML, at existing places."""

import pytest

from mcspectra.core.errors import ConfigError
from mcspectra.studies.files import apply_overrides, decode_study

STUDY = """
title = "t"
samplers = ["random"]
[convergence]
counts = [4, 16]
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""


def test_values_keep_their_types():
    config = decode_study(
        STUDY,
        overrides=[
            "convergence.realizations=100",
            "convergence.relative_error = 0.5",
            'estimators[0].density="linear"',
            'samplers=["random", "jittered"]',
            "estimators[0].spectrum={n = 4}",
            "terms.n=8",
            "convergence.counts[1]=64",
        ],
    )
    assert config.analyses["convergence"].realizations == 100
    assert config.analyses["convergence"].relative_error == 0.5
    assert config.analyses["convergence"].counts == (4, 64)
    assert config.estimators[0].density == "linear"
    assert config.samplers == ("random", "jittered")
    assert config.estimators[0].analyses["spectrum"].n == 4
    assert config.analyses["terms"].n == 8


def test_later_changes_win_and_apply_to_grids():
    config = decode_study(
        STUDY, overrides=["seed=1", "seed=2", 'estimators[0].integrand="linear(gradient={g})"',
                          "grid={g = [1, 2]}"],
    )  # fmt: skip
    assert config.seed == 2
    assert [e.name for e in config.estimators] == ["a (g=1)", "a (g=2)"]


def test_the_given_table_is_not_modified():
    table = {"a": {"b": [1, 2]}}
    assert apply_overrides(table, ["a.b[0]=5"]) == {"a": {"b": [5, 2]}}
    assert table == {"a": {"b": [1, 2]}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("convergence.realizations", "has no '='"),
        ("convergance.realizations=100", "Did you mean 'convergence'"),
        ("convergence.realisations=100", "Did you mean 'realizations'"),
        (
            "estimators[1].density='linear'",
            r"there is no \[1\], the list has 1 entry; count from 0\.$",
        ),
        ("samplers[7]='x'", r"there is no \[7\], the list has \d+ entr(y|ies); count"),
        ("title[0]='x'", r"there is no list that could hold \[0\]"),
        ("title.x='x'", "no table that could hold 'x'"),
        ("estimators.name='x'", "no table that could hold 'name'"),
        ("=1", "not a place"),
        ("a..b=1", "not a place"),
        ("__class__.x=1", "not a place"),
        ("estimators[-1].name='x'", "not a place"),
        ("title=plain", "strings need quotes"),
        ("title=", "not a TOML value"),
        ("seed=1\ntitle='two'", "not a TOML value"),
        ("seed=1\n[terms]\nn=3", "not a TOML value"),
        ("seed=" + "[" * 5000, "not a TOML value"),
        ("seed='x'", "seed is 'x'; give a whole number"),
        ("seed=nan", "seed is nan; give a whole number"),
        ("convergence.realizations=" + "9" * 5000, "not a TOML value"),
    ],
)
def test_invalid_changes_are_refused(text, words):
    with pytest.raises(ConfigError, match=words):
        decode_study(STUDY, overrides=[text])
