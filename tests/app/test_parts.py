"""Estimators of several techniques, channels, and coefficients that are computed once."""

from dataclasses import replace

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.app.compute import compute, integrand_specs, make_parts
from mcspectra.app.scene import STRATEGIES, pixel_spec
from mcspectra.app.specs import techniques
from mcspectra.app.state import ExplorerSetup
from mcspectra.core.errors import McspectraError
from mcspectra.integrands import base
from mcspectra.integrands.base import Estimate

SMALL = ExplorerSetup(n=16, half_width=4, realizations=64)
SUM = "technique-sum(integrands=['gaussian', 'disk'])"
COLORS = "environment(values=[[[1, 2, 3], [0, 5, 1]]])"


def test_a_sum_of_techniques_is_an_estimator_in_primary_space():
    parts = make_parts(replace(SMALL, integrand=SUM))
    assert isinstance(parts.estimator, mcs.estimators.TechniqueSum)
    assert parts.space == "primary"
    apart = [mcs.integrand(name, dims=2).integral for name in ("gaussian", "disk")]
    assert parts.estimator.integral == pytest.approx(sum(apart), rel=1e-12)


def test_techniques_have_independent_points_so_that_variances_add():
    whole = compute("terms", replace(SMALL, integrand=SUM), 4096)
    apart = [compute("terms", replace(SMALL, integrand=f), 4096) for f in ("gaussian", "disk")]
    summed = sum(float(each["measured_variance"]) for each in apart)
    # Relative standard error of a variance: sqrt((kurtosis - 1) / R), below sqrt(4 / R) here
    assert float(whole["measured_variance"]) == pytest.approx(summed, rel=4 * 2 * (4 / 4096) ** 0.5)


@pytest.mark.parametrize("changes", [{"density": "linear(slope=1)"}, {"smoothing": 0.1}])
def test_a_sum_takes_no_density_and_no_smoothing(changes):
    with pytest.raises(McspectraError, match="uniform density and no smoothing"):
        make_parts(replace(SMALL, integrand=SUM, **changes))


def test_parts_of_a_sum_have_equal_dims():
    spec = "technique-sum(integrands=['gaussian', 'disk(dims=3)'])"
    with pytest.raises(McspectraError, match="dims"):
        make_parts(replace(SMALL, integrand=spec))


@pytest.mark.parametrize(
    "spec",
    [
        "technique-sum",
        "technique-sum(integrands=[])",
        "technique-sum(integrands=['disk'])",
        f"technique-sum(integrands={['disk'] * 9!r})",
        "technique-sum(integrands='disk')",
        "technique-sum(integrands=['disk', 1])",
        "technique-sum(integrands=['disk', 'disk'], counts=[1, 2])",
        "technique-sum(integrands=['disk', \"image(path='a.png')\"])",
        "technique-sum(integrands=['disk', \"upload(digest='a')\"])",
        "technique-sum(integrands=['disk', ''])",
        "technique-sum(integrands=['disk', 'a|b'])",
        f"technique-sum(integrands={['disk', SUM]!r})",
    ],
)
def test_odd_sums_are_refused(spec):
    with pytest.raises(McspectraError):
        make_parts(replace(SMALL, integrand=spec))


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_of_a_pixel_is_a_state(strategy):
    setup = ExplorerSetup(integrand=pixel_spec(3, 100, strategy))
    combined = strategy in ("balance", "power")
    specs = techniques(setup.integrand)
    assert len(specs) == 1 + combined
    assert all("x=3, y=100" in spec for spec in specs)


@pytest.mark.render
def test_a_pixel_by_both_techniques_has_the_integral_of_either():
    found = {
        strategy: make_parts(replace(SMALL, integrand=pixel_spec(96, 100, strategy))).estimator
        for strategy in ("balance", "power")
    }
    scene = "veach(width=192, height=128)"
    for heuristic, estimator in found.items():
        other = mcs.rendering.pixel_mis(scene, 96, 100, heuristic=heuristic)
        u = np.random.default_rng(1).random((64, 2))
        for t in range(2):
            np.testing.assert_allclose(
                estimator.primary_values(t, u), other.primary_values(t, u), rtol=1e-4, atol=1e-7
            )


@pytest.mark.parametrize("channel", ["0", "1", "2", "luminance"])
def test_one_of_several_channels_is_shown(channel):
    setup = replace(SMALL, integrand=COLORS, channel=channel)
    values = np.array([[1, 2, 3], [0, 5, 1]])
    weights = (
        np.array([0.2126, 0.7152, 0.0722]) if channel == "luminance" else np.eye(3)[int(channel)]
    )
    estimator = make_parts(setup).estimator
    assert estimator.channels == 0
    # The two cells are the left and the right half of the square
    u = np.array([[0.25, 0.5], [0.75, 0.5]])
    sines = mcs.integrand("environment(values=[[1, 1]])", dims=2)(u)
    np.testing.assert_allclose(estimator.primary_values(0, u), values @ weights * sines, rtol=1e-3)


def test_an_explicit_channel_is_kept():
    spec = "environment(values=[[[1, 2, 3]]], channel=1)"
    assert integrand_specs(replace(SMALL, integrand=spec, channel="2")) == (spec,)


@pytest.mark.filterwarnings("ignore:∫1/p diverges")
@pytest.mark.parametrize(
    "changes",
    [
        {"integrand": "formula(expression='x*y')", "smoothing": 0.2},
        {"integrand": "formula(expression='x*y*y')", "density": "power(exponent=1)"},
        {"integrand": "technique-sum(integrands=['disk', \"formula(expression='x*x*y')\"])"},
    ],
    ids=["smoothed", "primary space", "sum"],
)
def test_coefficients_are_computed_once_for_all_rounds_and_samplers(changes, monkeypatch):
    calls = []

    def counted(_, m):
        calls.append(m)
        return Estimate(np.zeros([len(axis) for axis in m], complex), 0.0, "none")

    monkeypatch.setattr(base, "refined_coefficients", counted)
    monkeypatch.setattr(base, "adaptive_integral", lambda *_: Estimate(np.zeros(1), 0.0, "none"))
    setup = replace(SMALL, half_width=3, **changes)
    compute("terms", setup, 4)
    first = len(calls)
    assert first >= 1
    compute("terms", setup, 8)
    compute("terms", replace(setup, sampler="random", seed=1), 4)
    assert len(calls) == first
