"""Grids: every combination occurs once, with values as text or as numbers."""

import itertools

import pytest

from mcspectra.core.errors import ConfigError
from mcspectra.studies.files import MOST_ENTRIES, decode_study, expand_grids
from mcspectra.studies.plan import make_plan


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


def test_tables_at_the_top_are_copied_into_estimators():
    table = _study(integrand="f")
    table["estimators"].append({"name": "b {n}", "terms": {"n": 3}, "integrand": "g(n={n})"})
    table |= {"terms": {"n": "{n}", "bands": "radial"}, "predict": {"counts": [4]}}
    made = expand_grids({**table, "grid": {"n": [4, 8]}})
    assert made["estimators"] == [
        {"name": "a (n=4)", "integrand": "f", "terms": {"n": 4, "bands": "radial"}},
        {"name": "a (n=8)", "integrand": "f", "terms": {"n": 8, "bands": "radial"}},
        {"name": "b 4", "integrand": "g(n=4)", "terms": {"n": 3}},
        {"name": "b 8", "integrand": "g(n=8)", "terms": {"n": 3}},
    ]
    assert "terms" not in made
    assert made["predict"] == {"counts": [4]}
    own = _study(integrand="f", grid={"n": [1]}) | {"terms": {"n": "{n}"}}
    assert [each["terms"] for each in expand_grids(own)["estimators"]] == [{"n": 1}]


def test_values_may_be_lists():
    grid = {"c": [[4, 8, 16], [4, 64]], "k": [[0.1, 0.2]]}
    table = _study(integrand="f(k={k})", convergence={"counts": "{c}"}, samplers=["x(k={k})"])
    made = expand_grids({**table, "grid": grid})["estimators"]
    assert [each["convergence"]["counts"] for each in made] == grid["c"]
    assert {each["integrand"] for each in made} == {"f(k=[0.1, 0.2])"}
    assert [each["samplers"] for each in made] == [["x(k=[0.1, 0.2])"]] * 2
    assert made[0]["name"] == "a (c=[4, 8, 16], k=[0.1, 0.2])"


def test_the_list_of_samplers_may_be_a_value():
    table = _study(integrand="f", samplers="{s}", grid={"s": [["x"], ["x", "y"]]})
    made = expand_grids(table)["estimators"]
    assert [each["samplers"] for each in made] == [["x"], ["x", "y"]]
    top = {**_study(integrand="f"), "samplers": "{s}", "grid": {"s": [["x"], ["x", "y"]]}}
    top["maps"] = [{"name": "m"}, {"name": "own", "samplers": ["z"]}]
    made = expand_grids(top)
    assert [each["samplers"] for each in made["estimators"]] == [["x"], ["x", "y"]]
    assert [each["samplers"] for each in made["maps"]] == [["x"], ["x", "y"], ["z"]]
    assert "samplers" not in made


def test_wrong_types_are_left_for_the_type_check():
    for table in ({"terms": {"n": "{n}"}}, {"samplers": "{s}"}, {"samplers": "{s}", "maps": 3}):
        assert expand_grids(table) == table


def test_a_grid_of_counts_makes_one_estimator_per_count(tmp_path):
    study = """
title = "x"
samplers = ["random"]
grid = { n = [4, 8], c = [[4, 8], [16]] }
[terms]
n = "{n}"
half_width = 2
[predict]
counts = "{c}"
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""
    cells = make_plan(decode_study(study), tmp_path).cells
    found = [(c.estimator_name, getattr(c.analysis, "n", None) or c.analysis.counts) for c in cells]
    assert found == [
        (f"a (n={n}, c={c})", value) for n in (4, 8) for c in ([4, 8], [16]) for value in (n, (*c,))
    ]


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


def test_maps_are_also_repeated():
    made = expand_grids({"maps": [{"name": "m", "scene": "{s}"}], "grid": {"s": ["a", "b"]}})[
        "maps"
    ]
    assert [each["scene"] for each in made] == ["a", "b"]


def test_the_given_table_is_not_modified():
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
        (_study(integrand="f(s={s})", grid={"s": [{"a": 1}]}), "give numbers, strings, or lists"),
        (_study(integrand="f(s={s})", grid={"s": [[{}]]}), "give numbers, strings, or lists"),
        (_study(integrand="f(s={s})", grid={"s": [[1, float("inf")]]}), "holds inf; give finite"),
        (
            _study(integrand="f(width={width})", grid={"width": [1], "wdth": [2]}),
            "nothing uses grid.wdth; .* Did you mean 'width'",
        ),
        (
            {**_study(integrand="f(w={width})"), "grid": {"width": [1], "wdth": [2]}},
            "nothing uses grid.wdth; .* Did you mean 'width'",
        ),
        (
            {**_study(integrand="f"), "seed": "{s}", "grid": {"s": [1]}},
            "seed is '{s}', but a study",
        ),
        ({**_study(integrand="f"), "terms": {"n": "{n}"}}, "needs a grid"),
        ({"terms": {"n": "{n}"}, "grid": {"n": [1]}}, "nothing uses grid.n"),
        (_study(integrand="f(s={s})", grid={"s.t": [1]}), "not a name"),
        (_study(integrand="f(s={withd})", grid={"width": [1]}), "Did you mean 'width'"),
        (_study(integrand="f(s={s})"), "needs a grid"),
        (_study(integrand="f", grid={"s": [1]}), "nothing uses grid.s"),
        ({**_study(integrand="f"), "grid": {"s": [1]}}, "nothing uses grid.s"),
        ({**_study(integrand="f"), "grid": "s"}, "give a table of lists"),
    ],
)
def test_invalid_grids_are_refused(table, words):
    with pytest.raises(ConfigError, match=words):
        expand_grids(table)


def test_a_too_large_grid_is_refused_with_its_size():
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


def test_a_grid_that_makes_too_much_text_is_refused_before_it_is_made():
    values = {"a": ["x" * 15_000] * 100, "b": list(range(100))}
    with pytest.raises(ConfigError, match=r"10,000 entries with .* characters, but at most"):
        expand_grids(_study(integrand="f(a={a}, b={b})", grid=values))
