"""The verb ``pcf``: the library's g(r) as text and JSON, for specs and for point sets."""

import io
import json
import sys

import numpy as np
import pytest

import mcspectra as mcs


def test_json_equals_the_result_of_the_function(run):
    options = ("-n", 16, "--bins", 7, "-m", 5, "--seed", 3, "--boundary", "border")
    code, out, err = run("pcf", "jittered", *options, "-d", 1, "--max-distance", 0.2, "--json")
    assert code == 0, err
    data = json.loads(out)
    expected = mcs.pair_correlation(
        *(mcs.sampler("jittered", dims=1), 16),
        bins=7,
        realizations=5,
        rng=3,
        boundary="border",
        max_distance=0.2,
    )
    for name in ("r", "pair_correlation", "pair_correlation_se"):
        assert data[name] == expected[name].values.tolist()
    assert data["mean_spacing"] == 1 / 16
    assert (data["boundary"], data["seed"]) == ("border", 3)


def test_text_has_a_row_per_bin(run):
    code, out, _ = run("pcf", "jittered", "-n", 64, "--bins", 4, "-m", 2)
    assert code == 0
    header, _, *rows = out.splitlines()
    assert header.split() == ["r", "r·n^(1/d)", "g(r)", "std.", "error"]
    expected = mcs.pair_correlation("jittered", 64, bins=4, realizations=2)
    shown = np.array([row.split() for row in rows], float)
    assert np.allclose(shown[:, 0], expected["r"], rtol=1e-4)
    assert np.allclose(shown[:, 1], 8 * expected["r"], atol=5e-4)
    assert np.allclose(shown[:, 2], expected["pair_correlation"], rtol=1e-4)
    quiet = run("pcf", "jittered", "-n", 64, "--bins", 4, "-m", 2, "--quiet")
    assert quiet == (0, out, "")


@pytest.mark.parametrize("piped", [True, False])
def test_point_sets_may_replace_a_sampler(run, monkeypatch, tmp_path, piped):
    _, text, _ = run("points", "jittered", "-n", 64, "--seed", 4)
    (tmp_path / "set.dat").write_text(text)
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    given = "-" if piped else f"points(path={str(tmp_path / 'set.dat')!r})"
    code, out, err = run("pcf", given, "-n", 64, "-m", 1, "--json")
    assert code == 0, err
    data = json.loads(out)
    expected = mcs.pair_correlation("jittered", 64, realizations=1, rng=4)
    assert np.allclose(data["pair_correlation"], expected["pair_correlation"])
    assert set(data["pair_correlation_se"]) == {None}  # One realization has no standard error
