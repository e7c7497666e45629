"""Refusals of the functions of spectra: two tables, by the error."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.spectra.transforms import FrequencyGrid, Transform

PLANE = "linear(slope=[1, -0.5])"
LINE = mcs.density("linear(slope=1)", dims=1)
GRID = FrequencyGrid(1, 4)
FOLDED = mcs.Density.from_functions(
    pdf=lambda x: np.ones(x.shape[:-1]), sample=lambda u: (2 * u) % 1.0, dims=1
)


def _at(frequencies=((1.0, 2.0),), n=16, **given):
    mcs.spectra.power_at(mcs.sampler("jittered", dims=2), n, frequencies, **given)


def _spectrum(n=4, **given):
    mcs.power_spectrum("random", n, **given)


def _pairs(n=16, **given):
    mcs.pair_correlation("random", n, **given)


def _covariance(spec, n=4, m=((1, 1),), density=None, others=None):
    """Return a covariance of points in two dims."""
    others = m if others is None else others
    mcs.spectra.closed_form_covariance(mcs.sampler(spec, dims=2), n, m, others, density=density)


def _walsh(indices, spec="sobol | owen"):
    mcs.spectra.closed_form_walsh_power(spec, 8, indices)


WRONG = [
    (lambda: _covariance("random", m=[[1, np.inf]]), "NaN or infinity"),
    (lambda: _covariance("random", others=[[1, 2, 3]]), "shape"),
    (lambda: _covariance("random", m=[["a", "b"]]), "real numbers"),
    (lambda: mcs.spectra.gain_coefficients("sobol", 16, levels=0), "levels is 0"),
    (lambda: mcs.spectra.gain_coefficients("sobol", 16, levels=60), "levels is 60"),
    (lambda: mcs.spectra.gain_coefficients("sobol", 2**16, dims=50), "lower levels"),
    (lambda: mcs.spectra.nested_variances("disk", 23), "half_width"),
    (lambda: _walsh([[1, -1]]), "whole numbers"),
    (lambda: _walsh([[2**32, 0]]), "whole numbers"),
    (lambda: _walsh([[0.5, np.nan]]), "NaN"),
    (lambda: _at([1.0, 2.0]), r"shape \(F, 2\)"),
    (lambda: _at([[np.inf, 1.0]]), "NaN or infinity"),
    (lambda: _at(3.0), "shape"),
    (lambda: _at([[1j, 1.0]]), "real numbers"),
    (lambda: _at([[1.0, 2.0, 3.0]]), "shape"),
    (lambda: _at(n=15), "9 and 16"),
    (lambda: _at(density=LINE), "of 1 dim, "),
    (lambda: _at(engine="fft"), "engine"),
    (
        lambda: mcs.spectra.power_at("random", 4, np.ones((1, 4)), engine="nufft"),
        "1 to 3 dims, not 4",
    ),
    (lambda: mcs.spectra.axis_frequencies(0, 4), "dims"),
    (lambda: mcs.spectra.axis_frequencies(2, 0), "half_width"),
    (lambda: mcs.spectra.axis_frequencies(1024, 10**6), "GiB"),
    (lambda: mcs.spectra.axis_frequencies(2, 3, step=0.0), "step"),
    (lambda: mcs.spectra.axis_frequencies(2, 3, step=np.inf), "step"),
    (lambda: mcs.spectra.diagonal_frequencies(2000, 4), "dims"),
    (lambda: mcs.spectra.diagonal_frequencies(2, 3, signs=(1,)), "signs"),
    (lambda: mcs.spectra.diagonal_frequencies(2, 3, signs=(0, 0)), "signs"),
    (lambda: mcs.spectra.diagonal_frequencies(2, 3, signs=(2, 1)), "signs"),
    (lambda: mcs.spectra.plane_frequencies(3, (0, 3), 4), "axes"),
    (lambda: mcs.spectra.plane_frequencies(3, (1, 1), 4), "once"),
    (lambda: mcs.spectra.plane_frequencies(3, "01", 4), "axes"),
    (lambda: mcs.spectra.plane_frequencies(3, (), 4), "axes"),
    (lambda: mcs.spectra.subset_frequencies(20, tuple(range(20)), 64), "fewer axes"),
    (lambda: mcs.spectra.subset_frequencies(3, (0.5,), 4), "axes"),
    (lambda: _pairs(max_distance=0), "max_distance is 0"),
    (lambda: _pairs(max_distance=0.6), "at most 0.5"),
    (lambda: _pairs(2**20), "give fewer points"),
    (lambda: _spectrum(10**8, half_width=8), "at most 33554432 of them"),
    (lambda: _spectrum(half_width=2**31), "half_width"),
    (lambda: _spectrum(wedges=0), "wedges"),
    (lambda: _spectrum(eps=0.5), "eps"),
    (lambda: _spectrum(2**40), "n|points"),
    (lambda: _spectrum(frequency_step=1e9), "frequency_step"),
    (lambda: mcs.power_spectrum(mcs.sampler("random", dims=2), 4, density=LINE), "dims"),
    (lambda: FrequencyGrid(0, 4), "dims"),
    (lambda: FrequencyGrid(2, -1), "half_width"),
    (lambda: FrequencyGrid(2, 1.5), "half_width"),
    (lambda: FrequencyGrid(2, 4, 0.0), "frequency_step"),
    (lambda: FrequencyGrid(4, 200), "half_width ≤"),
    (lambda: Transform(GRID, 8, engine="fft"), "nufft"),
    (lambda: Transform(FrequencyGrid(5, 2), 8, engine="nufft"), "1 to 4 dims"),
    (lambda: Transform(GRID, 8, eps=1e-30), "eps"),
]
UNKNOWN = [
    *(
        ((lambda s=spec, n=n: _covariance(s, n)), "No closed-form power is known")
        for spec, n in (
            ("poisson-disk", 16),
            ("sobol | lms(shift=False)", 16),
            ("orthogonal-array(jitter='correlated-multi-jittered')", 9),
            ("correlated-multi-jittered", 16),
            ("jittered | random-rotation", 16),
        )
    ),
    (lambda: _covariance("kronecker | shift", 2**30), "ask for fewer"),
    (lambda: _covariance("poisson-disk", density=PLANE), "No covariances are known"),
    (lambda: _covariance("sobol", density=PLANE), "No covariances are known"),
    (lambda: _covariance("latin-hypercube(strength=2)", density=PLANE), "No covariances"),
    (lambda: _covariance("regular", density=PLANE), "the same every time"),
    (lambda: _covariance("sobol | owen", density=PLANE), "No covariances are known"),
    (lambda: _covariance("jittered", m=[[0.5, 1]], density=PLANE), "real frequencies"),
    (lambda: _covariance("random", m=[[0.5, 1]], density=PLANE), "real frequencies"),
    (lambda: _covariance("random", density="linear(slope=2)"), "diverges"),
    (lambda: _covariance("jittered", density="linear(slope=2)"), "diverges"),
    (lambda: _covariance("jittered", m=[[2**40, 1]], density=PLANE), "too fine a quadrature"),
    (
        lambda: _covariance("jittered", 10**8, [[k, 1] for k in range(10**3)], PLANE),
        "ask for fewer",
    ),
    (
        lambda: _covariance("jittered", density="piecewise-constant(values=[[1, 2], [3, 1]])"),
        "products over the axes",
    ),
    (
        lambda: mcs.spectra.closed_form_covariance("jittered", 4, [[1]], [[1]], density=FOLDED),
        "increasing warps",
    ),
    (
        lambda: mcs.spectra.closed_form_pair_correlation("jittered(dims=3)", 8, [0.1]),
        "pair_correlation",
    ),
    (lambda: mcs.spectra.gain_coefficients("jittered", 16), "No gain coefficients"),
    (lambda: mcs.spectra.gain_coefficients("pmj | owen", 16), "the same every"),
    (lambda: mcs.spectra.gain_coefficients("sobol | shift", 16, dims=2), "sobol"),
    (lambda: _walsh([[1, 1]], "halton | owen"), "base 2"),
]


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [(call, ParameterError, words) for call, words in WRONG]
    + [(call, NoClosedForm, words) for call, words in UNKNOWN],
)
def test_impossible_requests_are_refused(call, error, words):
    with pytest.raises(error, match=words):
        call()
