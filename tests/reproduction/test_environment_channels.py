"""Gray or all channels: findings, jumps counted by hand, and wrong inputs that must disagree."""

import numpy as np
import pytest
from scipy.integrate import quad

import mcspectra as mcs
from mcspectra.plots.backend_matplotlib import draw, panel_axes
from mcspectra.reproduction import environment_channels as channels
from mcspectra.reproduction.claims import judge
from mcspectra.reproduction.gallery import make_exhibit


def test_all_findings_agree(sound):
    """Theory has two rates, and the curves of the map are within the limits of their panel."""
    made = make_exhibit("environment-channels", quick=True, seed=1)[0]
    sound(made)
    rates = [f.expected.split()[0] for f in made.findings[:14]]
    assert rates[:5] == ["−1.5"] * 2 + ["−2.0"] * 3
    assert rates[5:] == ["−2.0"] * 3 + ["−3.0"] * 3 + ["−2.0"] * 3
    plot = next(p for p in made.plots if p.kind == "one-row")
    for axes in panel_axes(draw(plot)):
        low, high = axes.get_ylim()
        values = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines])
        assert low == 0.0 <= np.nanmin(values)
        assert np.nanmax(values) <= high


def test_the_integral_of_the_map():
    integral = channels.ways()["one"].integral
    for c in range(3):
        parts = [
            quad(lambda x, c=c: channels.radiance(np.array([x]))[c], k / 8, (k + 1) / 8)[0]
            for k in range(8)
        ]
        assert integral[c] == pytest.approx(sum(parts), rel=1e-9)


def test_luminance_leaves_jumps(monkeypatch):
    gray = channels.PIXELS @ channels.LUMINANCE
    right = channels.weighted
    monkeypatch.setattr(channels, "weighted", lambda _, channel, t: right(gray, channel, t))
    assert [judge(channels._continuous(c)).agrees for c in range(3)] == [False] * 3


def test_rates_of_other_densities_disagree():
    ways = channels.ways()
    counts = channels.COUNTS["own"]
    curves = {
        w: mcs.convergence(ways[w], "jittered", counts, realizations=300, rng=1)
        for w in ("one", "own")
    }
    for way, other in (("one", "own"), ("own", "one")):
        exact = np.array(counts, float)[:, None] ** channels.RATES[other] * np.ones(3)
        assert judge(channels._rate_of(other, 1, curves[way], exact)).agrees is False
    swapped = {"one": curves["own"], "own": curves["one"]}
    assert judge(channels._gain(0, swapped)).agrees is False
