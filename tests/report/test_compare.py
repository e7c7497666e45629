"""Comparison of two studies: exact ratios and differences, unshared pairs, bad input."""

import html
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError, StoreError
from mcspectra.report import write_comparison
from mcspectra.report.compare import compare_curves, verdict

Make = dict[str, Callable[..., Any]]
Z = 1.959963984540054


def test_power_laws(make):
    """Intervals belong to R = 1000 normal values, so log-variances have se √(2/R)."""
    first = make["curve"]("random", rate=-1.0, half=0.03)
    second = make["curve"]("random", rate=-1.5, half=0.04)
    found = compare_curves(first, second)
    assert found.n == 1024
    assert found.ratio.value == pytest.approx(1024**-0.5, rel=1e-12)
    half = Z * math.sqrt(2 * 2 / 1000)
    assert math.log(found.ratio.high / found.ratio.value) == pytest.approx(half, rel=1e-9)
    assert math.log(found.ratio.value / found.ratio.low) == pytest.approx(half, rel=1e-9)
    assert found.rate.value == pytest.approx(-0.5)
    assert found.rate.high - found.rate.value == pytest.approx(0.05)


def test_swapped_studies_give_inverse_differences(make):
    pair = make["curve"]("random"), make["curve"]("jittered")
    there, back = compare_curves(*pair), compare_curves(*pair[::-1])
    assert there.ratio.value * back.ratio.value == pytest.approx(1.0)
    assert there.ratio.low * back.ratio.high == pytest.approx(1.0)
    assert there.rate.value == -back.rate.value


def test_intervals_have_95_percent_coverage(make):
    """For 500 pairs of sample variances with ratio 2, coverage is 95 % within 4 σ."""
    generator = np.random.default_rng(5)
    size, trials, inside = 200, 500, 0
    factor = math.exp(Z * math.sqrt(2 / size))
    base = make["curve"]("random", counts=(16, 64))
    for pair in generator.chisquare(size - 1, (trials, 2)) / (size - 1) * [1.0, 2.0]:
        given = []
        for variance in pair:
            one = base.copy(deep=True)
            one["variance"].values[:] = variance
            one["variance_ci"].values[:] = [variance / factor, variance * factor]
            given.append(one)
        found = compare_curves(*given)
        inside += found.ratio.low <= 2.0 <= found.ratio.high
    assert abs(inside / trials - 0.95) < 4 * math.sqrt(0.95 * 0.05 / trials)


def test_largest_common_count(make):
    first = make["curve"]("random", counts=(16, 64, 256))
    second = make["curve"]("random", counts=(64, 128))
    assert compare_curves(first, second).n == 64
    none = compare_curves(first, make["curve"]("random", counts=(9,)))
    assert none.n is None
    assert math.isnan(none.ratio.value)


def test_zero_variance_has_no_ratio(make):
    first, second = make["curve"]("random"), make["curve"]("random", zero=(3,))
    assert math.isnan(compare_curves(first, second).ratio.value)
    assert math.isnan(compare_curves(second, first).ratio.high)


def test_channels__only_the_first_is_compared(make):
    found = compare_curves(make["curve"]("random", channels=3), make["curve"]("random"))
    assert found.ratio.value == pytest.approx(1.0)


def test_the_verdict_names_the_largest_gain_and_loss(make):
    curve = make["curve"]
    first = {(name, "random"): curve("random") for name in ("gain", "loss", "same", "open", "none")}
    second = {
        ("gain", "random"): curve("random", rate=-1.25),
        ("loss", "random"): curve("random", rate=-0.75),
        ("same", "random"): curve("random"),
        ("open", "random"): curve("random", rate=-1.001),
        ("none", "random"): curve("random", counts=(9,)),
    }
    found = verdict(first, second)
    assert found.startswith("B has less noise than A for some curves and more for others. ")
    assert "Of 5 common curves: 1 less noise, 1 more noise, 1 no significant difference, " in found
    assert "1 the same variances, 1 no ratio." in found
    assert "gain: the variance of gain with random at n = 1024 is 0.177 times" in found
    assert "loss: the variance of loss with random at n = 1024 is 5.66 times" in found
    # The same change of one curve alone, and of no curve
    one = ("gain", "random")
    assert verdict({one: first[one]}, {one: second[one]}).startswith("B has less noise than A. Of")
    assert verdict({one: second[one]}, {one: first[one]}).startswith("B has more noise than A. Of")
    assert verdict({one: first[one]}, {one: first[one]}).startswith("A and B have the same")
    two = ("open", "random")
    assert verdict({two: first[two]}, {two: second[two]}) == (
        "No difference between the noise of A and B is significant (1 common curve)."
    )


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_equal_noise_is_seldom_called_different(make, seed):
    """Simultaneous intervals of 200 curves without difference hold with a probability of 95 %."""
    generator = np.random.default_rng(seed)
    studies = []
    for _ in "ab":
        curves = {}
        for k in range(200):
            curve = make["curve"]("random", counts=(16,))
            factor = math.exp(generator.normal(0.0, math.sqrt(2 / 1000)))
            names = ["variance", "variance_ci"]
            curves[str(k), "random"] = curve.assign({key: factor * curve[key] for key in names})
        studies.append(curves)
    assert verdict(*studies).startswith("No difference between the noise of A and B is")


@pytest.fixture(name="folders")
def _folders(make, tmp_path):
    """Write two studies that share a pair."""
    curve = make["curve"]
    cells = [
        {
            ("e", "random"): {"convergence": curve("random")},
            ("e <b>", "jittered"): {"convergence": curve("jittered")},
        },
        {
            ("e", "random"): {"convergence": curve("random", rate=-1.25)},
            ("e", "other"): {"convergence": curve("random")},
        },
    ]
    return [make["study"](tmp_path / n, c, title=n) for n, c in zip("ab", cells, strict=True)]


def test_page(folders):
    page = write_comparison(*folders)
    assert page == folders[1] / "comparison.html"
    text = page.read_text(encoding="utf-8")
    assert "0.177" in text  # 1024^(−1/4)
    assert text.index("B has less noise than A.") < text.index("<nav")
    assert "−0.25 ± 0.04" in text
    assert "e &lt;b&gt;, with jittered" in text
    assert "e, with other" in text
    assert "Only in A" in text
    assert text.count('<script type="application/gzip">') == 1
    assert text.count('<img src="data:image/png') == 1
    assert write_comparison(*folders).read_text(encoding="utf-8") == text


@pytest.mark.usefixtures("undrawn")
def test_studies_without_common_pairs(make, tmp_path):
    a, b = (
        make["study"](tmp_path / n, {(n, "random"): {"convergence": make["curve"]("random")}})
        for n in "ab"
    )
    text = write_comparison(a, b, tmp_path / "c.html").read_text(encoding="utf-8")
    assert "The studies share no estimator and sampler with a convergence." in text


@pytest.mark.usefixtures("undrawn")
def test_the_command_quotes_folders(make, tmp_path):
    cells = {("e", "random"): {"points": make["points"](n=4)}}
    a, b = (make["study"](tmp_path / name, cells) for name in ("a b", "c;d"))
    text = html.unescape(write_comparison(a, b).read_text(encoding="utf-8"))
    assert f"mcspectra report '{a}' --compare '{b}'" in text


def test_bad_input(folders, tmp_path):
    with pytest.raises(ParameterError, match="two different"):
        write_comparison(folders[0], folders[0])
    with pytest.raises(StoreError, match="no results"):
        write_comparison(folders[0], tmp_path)
    with pytest.raises(StoreError, match="cannot be written"):
        write_comparison(*folders, tmp_path / "nowhere" / "x.html")
