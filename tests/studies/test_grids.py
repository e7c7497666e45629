"""Grids: every combination, once, with its values as text or as numbers."""

import itertools

import pytest

from mcspectra.core.errors import ConfigError
from mcspectra.studies.grids import MOST_ENTRIES, expand_grids


def _study(**estimator):
    return {"title": "t", "samplers": ["random"], "estimators": [{"name": "a", **estimator}]}


def test_all_combinations_in_order():
    grid = {"width": [0.1, 0.2], "center": [0.3, 0.4, 0.5]}
    spec = "gaussian(width={width}, center={center})"
    made = expand_grids(_study(integrand=spec, grid=grid))["estimators"]
    expected = [
        {
            "name": f"a (width={w}, center={c})",
            "integrand": f"gaussian(width={w}, center={c})",
        }
        for w, c in itertools.product(*grid.values())
    ]
    assert made == expected


def test_names_that_mention_a_placeholder_get_its_value():
    made = expand_grids(
        {"estimators": [{"name": "w {w}", "integrand": "f(w={w}, k={k})"}],
         "grid": {"w": [1, 2], "k": ["x"]}}
    )["estimators"]  # fmt: skip
    assert [each["name"] for each in made] == ["w 1 (k=x)", "w 2 (k=x)"]


def test_a_placeholder_alone_is_the_value_itself():
    made = expand_grids(
        _study(terms={"n": "{n}", "space": "{s}"}, grid={"n": [4], "s": ["domain"]})
    )
    assert made["estimators"][0]["terms"] == {"n": 4, "space": "domain"}


def test_samplers_are_repeated_without_estimators():
    table = _study(integrand="linear")
    table["samplers"] = ["random", "gaussian-jitter(sigma={s})"]
    made = expand_grids({**table, "grid": {"s": [0.1, 0.2]}})
    assert made["samplers"] == [
        "random",
        "gaussian-jitter(sigma=0.1)",
        "gaussian-jitter(sigma=0.2)",
    ]
    assert made["estimators"] == table["estimators"]


def test_samplers_of_an_estimator_share_its_values():
    made = expand_grids(
        _study(
            integrand="f(s={s})", samplers=["x(s={s})", "y(k={k})"], grid={"s": [1, 2], "k": [3, 4]}
        )
    )["estimators"]
    assert [each["samplers"] for each in made] == [
        ["x(s=1)", "y(k=3)", "y(k=4)"],
        ["x(s=2)", "y(k=3)", "y(k=4)"],
    ]


def test_an_estimators_grid_comes_before_the_studys():
    table = _study(integrand="f(s={s})", grid={"s": [9]})
    table["estimators"].append({"name": "b", "integrand": "f(s={s})"})
    made = expand_grids({**table, "grid": {"s": [1, 2]}})["estimators"]
    assert [each["integrand"] for each in made] == ["f(s=9)", "f(s=1)", "f(s=2)"]


def test_maps_are_repeated_too():
    made = expand_grids({"maps": [{"name": "m", "scene": "{s}"}], "grid": {"s": ["a", "b"]}})[
        "maps"
    ]
    assert [each["scene"] for each in made] == ["a", "b"]


def test_the_given_table_is_left_alone():
    table = _study(integrand="f(s={s})", grid={"s": [1, 2]})
    before = repr(table)
    expand_grids(table)
    assert repr(table) == before


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (_study(integrand="f(s={s})", grid=3), "give a table of lists"),
        (_study(integrand="f(s={s})", grid={"s": 3}), "give a list of one or more"),
        (_study(integrand="f(s={s})", grid={"s": []}), "give a list of one or more"),
        (_study(integrand="f(s={s})", grid={"s": [[1]]}), "give numbers or strings"),
        (_study(integrand="f(s={s})", grid={"s.t": [1]}), "not a name"),
        (_study(integrand="f(s={withd})", grid={"width": [1]}), "Did you mean 'width'"),
        (_study(integrand="f(s={s})"), "needs a grid"),
        (_study(integrand="f", grid={"s": [1]}), "nothing uses grid.s"),
        ({**_study(integrand="f"), "grid": {"s": [1]}}, "nothing uses grid.s"),
        ({**_study(integrand="f"), "grid": "s"}, "give a table of lists"),
    ],
)
def test_grids_that_are_none(table, words):
    with pytest.raises(ConfigError, match=words):
        expand_grids(table)


def test_a_grid_that_explodes_is_refused_with_its_number():
    grid = {f"k{i}": list(range(100)) for i in range(6)}
    spec = "f(" + ", ".join(f"k{i}={{k{i}}}" for i in range(6)) + ")"
    with pytest.raises(ConfigError, match="1,000,000,000,000 entries"):
        expand_grids(_study(integrand=spec, grid=grid))
    samplers = {
        "samplers": ["x(k={a}, l={b})"],
        "grid": {"a": list(range(1000)), "b": [*range(101)]},
    }
    with pytest.raises(ConfigError, match="101,000 entries"):
        expand_grids(samplers)
    half = {"k": list(range(MOST_ENTRIES // 2 + 1))}
    twice = {
        "estimators": [{"name": f"{i}", "integrand": "f(k={k})"} for i in range(2)],
        "grid": half,
    }
    with pytest.raises(ConfigError, match="100,002 entries"):
        expand_grids(twice)
