"""Densities, heuristics, mirroring and remedies on the command line."""

import pytest

SMOOTH = "polynomial(coefficients=[0.5, 0, 1])"


def test_heuristics_and_shares_reach_the_estimator(run_json):
    given = [SMOOTH, "-d", "1", "--density", "uniform", "--density", "linear(slope=1)"]
    found = run_json(
        *("variance", *given, "--heuristic", "power(beta=3)", "--shares", "2,1"),
        *("--sampler", "random", "-n", "8", "-m", "200", "--half-width", "8"),
    )
    assert "power(beta=3" in found["estimator"]
    assert "2×uniform" in found["estimator"]


@pytest.mark.parametrize("mode", ["integrand", "random"])
def test_mirroring(run_json, mode):
    found = run_json(
        *("converge", "christensen-gaussian", "--mirror", mode, "--sampler", "jittered | shift"),
        *("--counts", "16,64,256", "-m", "200"),
    )
    assert f"mirrored: {mode}" in found["estimator"]
    (curve,) = found["curves"]
    # Folding or all images make the wrap-around of the shift continuous: the rate tends to −2 (−1.8
    # at these counts) instead of −1.5. Random mirroring has rate −1. The standard error of the
    # slope is 0.04: √(2/200) over ln 16, 0.1 · 1.4/2.8
    rate = curve["rate"]
    assert abs(rate + 1) < 0.2 if mode == "random" else rate < -1.65


def test_remedies_as_table_and_as_json(run, run_json):
    given = ["remedies", "christensen-gaussian", "--sampler", "jittered | shift", "--budget", "256"]
    given += ["-m", "200", "--kind", "unshifted", "--kind", "mirrored"]
    found = run_json(*given)
    names = [row["remedy"] for row in found["remedies"]]
    assert sorted(names) == sorted(
        ["as given", "unshifted", *(f"mirrored: {m}" for m in ("integrand", "random", "uniform"))]
    )
    code, out, err = run(*given)
    assert (code, err) == (0, "")
    # The answer comes first, followed by a table in the same order
    lines = out.splitlines()
    assert found["answer"].startswith(lines[0])
    first = next(k for k, line in enumerate(lines) if line.startswith("---")) + 1
    assert [line.split("  ")[0] for line in lines[first : first + len(names)]] == names
    assert found["best"]["name"] == names[0]
    assert run(*given, "--quiet") == (0, out, "")
