"""Training by VEGAS: against its own map, and what it refuses."""

import math
import sys

import numpy as np
import pytest
import vegas

import mcspectra as mcs
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.densities import vegas_density

U = np.random.default_rng(1).random((500, 2))


def test_the_map_of_vegas_itself():
    p = vegas_density(mcs.integrand("gaussian(width=0.1)"))
    theirs = vegas.AdaptiveMap([np.array(line) for line in p.nodes])
    x, jacobian, back = np.empty_like(U), np.empty(len(U)), np.empty_like(U)
    theirs.map(U, x, jacobian)
    np.testing.assert_allclose(p.sample(U), x, atol=1e-15)
    np.testing.assert_allclose(p.pdf(x), 1 / jacobian, rtol=1e-10)
    theirs.invmap(x, back, jacobian)
    np.testing.assert_allclose(p.invert(x), back, atol=1e-12)


def test_it_adapts():
    """To the product of |f| projected: variance falls, and most where f is a product."""
    f = mcs.integrand("gaussian(center=[0.3, 0.6], width=0.1)")
    u = np.random.default_rng(2).random((4000, 2))
    before, after = (
        mcs.Estimator(f, p).primary_values(0, u) for p in ("uniform", vegas_density(f))
    )
    assert after.mean() == pytest.approx(f.integral, rel=0.05)
    assert after.var() < before.var() / 50
    median = vegas_density(f).sample([0.5, 0.5])
    np.testing.assert_allclose(median, [0.3, 0.6], atol=0.02)


def test_training_is_deterministic():
    f = mcs.integrand("gaussian(width=0.2)", dims=3)
    first, again, other = (vegas_density(f, seed=s).nodes for s in (3, 3, 4))
    assert first == again
    assert first != other
    assert vegas_density(f, iterations=0, increments=4).nodes == ((0, 0.25, 0.5, 0.75, 1),) * 3
    named = mcs.density("vegas(integrand='gaussian(width=0.2)', seed=3)", dims=3)
    assert named.grid.nodes == first


def test_functions_scales_and_channels():
    scaled = [
        vegas_density(lambda x, s=s: s * x[:, 0], dims=1).nodes[0] for s in (1e-200, 1, 1e200)
    ]
    assert scaled[0] == pytest.approx(scaled[1], rel=1e-12)
    assert scaled[2] == pytest.approx(scaled[1], rel=1e-12)
    signed = vegas_density(lambda x: -np.stack([x[:, 0], 0 * x[:, 0]], axis=1), dims=1)
    assert signed.nodes[0] == pytest.approx(scaled[1], rel=1e-12)
    nothing = vegas_density(lambda x: 0 * x[:, 0], dims=2, increments=2)
    assert nothing.nodes == ((0, 0.5, 1),) * 2


def test_needles_stay_a_density():
    """A single spike: bins shrink to it, and none to nothing."""
    p = vegas_density(
        lambda x: (np.abs(x[:, 0] - 0.3) < 1e-3) * 1.0, dims=1, iterations=60, alpha=2
    )
    p.check()
    assert p.pdf([0.3]) > 50


def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "vegas", None)
    with pytest.raises(MissingDependency, match=r"pip install 'mcspectra\[vegas\]'"):
        vegas_density(lambda x: x[:, 0], dims=1)


BAD = {
    "increments": [0, 10**9],
    "iterations": [-1, 10**9],
    "evaluations": [0, 10**12],
    "alpha": [-1, math.nan],
    "seed": [-1, 0.5],
    "dims": [0, 10**6, None],
}


@pytest.mark.parametrize("name", BAD)
def test_bad_training(name):
    for value in BAD[name]:
        with pytest.raises(ParameterError, match=f"^{name} is"):
            vegas_density(lambda x: x[:, 0], **{"dims": 2, name: value})


@pytest.mark.parametrize(
    ("integrand", "says"),
    [
        ("gaussian", "is not an integrand"),
        (lambda x: x[:3, 0], "gave shape"),
        (lambda x: x[:, 0] * np.nan, "NaN or infinite"),
        (lambda x: 1.0, "gave shape"),
        (lambda x: x[:, 0] * 1j, "real numbers"),
    ],
)
def test_bad_integrands(integrand, says):
    with pytest.raises(ParameterError, match=says):
        vegas_density(integrand, dims=2)
