"""Predicted rates: the closed formula, sums of it, exact variances and measured rates."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import PreasymptoticWarning

INF = math.inf


@pytest.mark.parametrize(
    ("b", "decay", "dims", "rate"),
    [
        # Pilleboue et al. 2015: random, Poisson disk (b = 0), jittered (2), CCVT (3), step noise
        (0, "smooth", 2, -1.0),
        (0, "jump", 2, -1.0),
        (2, "smooth", 2, -2.0),
        (2, "jump", 2, -1.5),
        (3, "smooth", 2, -2.5),
        (3, "jump", 2, -1.5),
        (INF, "jump", 3, -4 / 3),
        (INF, "smooth", 3, -INF),
        (2, "smooth", 1, -3.0),
        (2, "jump", 1, -2.0),
        (4, "kink", 2, -2.5),
        (1, 2.5, 2, -1.25),
        (-1, "jump", 2, -0.5),  # hyperfluctuating: worse than random
    ],
)
def test_table(b, decay, dims, rate):
    assert mcs.prediction.predicted_rate(b, decay, dims) == pytest.approx(rate)


@pytest.mark.parametrize("dims", [1, 2, 3])
@pytest.mark.parametrize("b", [0.0, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("excess", [0.5, 1.5, 2.6, 6.0])
def test_formula_is_the_exponent_of_the_sum(dims, b, excess):
    """Compare with Σ_ρ ρ^(d − 1 − γ) min(1, (ρ/N)^b)/n over integer shells at large N.

    The other power is smaller by N^-|b − excess|. Its share bends the local slope by at most the
    gap times that share.
    """
    rho = np.arange(1, 2**17, dtype=float)
    ends = np.array([2.0**9, 2.0**11])
    sums = [(rho ** (-1 - excess) * np.minimum(1, (rho / end) ** b)).sum() for end in ends]
    slope = np.diff(np.log(sums))[0] / np.log(4)
    gap = abs(b - excess)
    share = 3 * gap * ends[0] ** -gap / max(1e-9, min(b, excess) or 1.0)
    tail = (2**17 / ends[1]) ** -excess  # The sum ends somewhere
    expected = (mcs.prediction.predicted_rate(b, dims + excess, dims) + 1) * dims
    assert abs(slope - expected) < share + tail


GAUSSIAN, DISK = "christensen-gaussian", "disk(center=[0.463, 0.517], radius=0.27)"


@pytest.mark.parametrize(
    ("integrand", "dims", "excess"),
    [("step(at=0.31)", 1, 1.0), (DISK, 2, 1.0), (GAUSSIAN, 2, 1.0), ("linear", 1, 1.0)],
)
def test_decay_of_jumps(integrand, dims, excess):
    """γ = d + 1. Ripples sin²(π m a) of a shell of M frequencies leave at most ½ M^-1/sin(π a)."""
    f = mcs.integrand(integrand, dims=dims)
    width = 512 if dims == 1 else 64
    assert mcs.prediction.integrand_decay(f, half_width=width) == pytest.approx(
        dims + excess, abs=8 / width
    )


def test_decay_of_a_jump_anywhere_at_the_default_width():
    """γ = 2 for every step; at K = 64 it is 1.5 … 2.3. At most 9 of 48 intervals may miss."""
    places = np.arange(0.03, 0.98, 0.02)
    fits = [
        mcs.prediction.fitted_decay(mcs.integrand(f"step(at={at:.2f})", dims=1)) for at in places
    ]
    decay = np.array([fit.decay for fit in fits])
    assert np.abs(decay - 2.0).max() < 0.06
    assert all(fit.settled and fit.half_width == 512 for fit in fits)
    missed = sum(not fit.interval[0] <= 2.0 <= fit.interval[1] for fit in fits)
    assert missed <= 9  # Binomial(48, 0.05): more has probability 2e-4


@pytest.mark.parametrize(("integrand", "dims"), [(DISK, 2), (GAUSSIAN, 2), ("linear", 1)])
def test_interval_of_the_decay_holds_that_of_a_jump(integrand, dims):
    fit = mcs.prediction.fitted_decay(mcs.integrand(integrand, dims=dims))
    low, high = fit.interval
    assert low <= dims + 1.0 <= high
    assert high - low < 0.5


def test_an_exponent_that_still_grows_is_no_limit():
    """|f_m|² = exp(−4π²w²m²) without a jump above rounding has the local exponent −8π²w²m²."""
    narrow = mcs.integrand("gaussian(center=0.5, width=0.05)", dims=1)
    with pytest.warns(PreasymptoticWarning, match="has not reached a limit"):
        assert mcs.prediction.integrand_decay(narrow, half_width=16) > 4
    assert not mcs.prediction.fitted_decay(narrow, half_width=16).settled
    assert mcs.prediction.integrand_decay(narrow) == INF


def test_zeros_of_the_spectrum_are_no_noise():
    """Two steps half apart: f_m = 0 at odd m, which include the only shell from 4 to 5.7."""
    twice = mcs.Integrand.from_function(lambda x: 1.0 * (2 * x[..., 0] % 1 < 0.5), dims=1)
    assert mcs.prediction.integrand_decay(twice, half_width=32) == pytest.approx(2.0, abs=0.6)


def test_decay_of_kinks_and_smooth():
    kink = mcs.Integrand.from_function(lambda x: np.abs(x[..., 0] - 0.5), dims=1)
    # |f_m|² = 1/(πm)^4 at odd m
    assert mcs.prediction.integrand_decay(kink, half_width=64) == pytest.approx(4.0, abs=0.15)
    assert mcs.prediction.integrand_decay("cosine(frequency=[2, 1])") == INF
    bump = mcs.Integrand.from_function(lambda x: np.exp(np.cos(2 * np.pi * x[..., 0])), dims=1)
    assert mcs.prediction.fitted_decay(bump, half_width=16).decay > 10


def test_decay_of_channels_is_the_least():
    two = mcs.Integrand.from_function(
        lambda x: np.stack([np.cos(2 * np.pi * x[..., 0]), 1.0 * x[..., 0]], axis=-1), dims=1
    )
    assert mcs.prediction.integrand_decay(two, half_width=32) == pytest.approx(2.0, abs=0.15)
