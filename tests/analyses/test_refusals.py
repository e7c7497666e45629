"""Invalid input of analyses other than wrong options, which `test_cuts.py` tests."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, DensityError, ParameterError
from mcspectra.densities import AlignedStrata
from mcspectra.measure.views import make_bands
from mcspectra.spectra.bases import make_basis

LINE = mcs.sampler("jittered", dims=1)
STEP = mcs.integrand("step(at=0.3)", dims=1)
F1 = mcs.Estimator("linear", dims=1)
PARTS = mcs.estimators.TechniqueSum(["linear", "step(at=0.3)"], dims=1)
POLE = mcs.Estimator("cosine", "power(exponent=1)", dims=1)
INFINITE = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", "linear(slope=2)")
CORNER = mcs.Integrand.from_function(lambda x: (x.sum(axis=-1) < 0.913).astype(float), dims=2)


def _scan(**given):
    mcs.improve.strata_shift_scan(**{"estimator": STEP, "sampler": LINE, "counts": 8, **given})


def _best(**given):
    mcs.improve.best_alignment(**{"estimator": STEP, "sampler": LINE, "n": 8, **given})


def _bands(bands):
    make_bands(bands, make_basis("fourier", 1, 4))


def _smooth(**given):
    mcs.improve.smoothing_scan(
        "disk", **{"sampler": "jittered", "counts": 16, "widths": [0.1], **given}
    )


def _modes(**given):
    mcs.covariance_modes(F1, "jittered", 8, half_width=4, realizations=4, **given)


def _needed(**given):
    mcs.measure.realizations_needed(**{"estimator": F1, "sampler": LINE, "n": 4, **given})


def _picture(**given):
    mcs.explain.primary_picture("gaussian", **given)


def _spectrum(estimator="gaussian", sampler="random", n=16, **given):
    mcs.measure.anova_spectrum(estimator, sampler, n, **given)


def _exact(sampler, n=16, dims=2, integrand="gaussian"):
    mcs.exact_variance(integrand, mcs.sampler(sampler, dims=dims), n)


def _pairs(sampler, n, dims=2, estimator="gaussian", **given):
    sampler = mcs.sampler(sampler, dims=dims)
    mcs.predict(estimator, sampler, [n], method="pair-correlation", **given)


ROWS = [
    (lambda: _scan(offsets=0), "offsets is 0"),
    (lambda: _scan(offsets=[]), "one or more"),
    (lambda: _scan(offsets=[0.5, 0.1]), "ascending"),
    (lambda: _scan(offsets=[1.0]), "at most 1"),
    (lambda: _scan(offsets=[-0.1]), "at least 0"),
    (lambda: _scan(offsets=10**9), "more than 4096"),
    (lambda: _scan(method="guess"), "method"),
    (lambda: _scan(sampler=mcs.sampler("jittered", dims=2)), "1 dim is needed"),
    (lambda: _best(n=0), "n is 0"),
    (lambda: _best(edges=[[0.1], [0.2]]), "dims"),
    (lambda: _best(method="guess"), "method"),
    (lambda: mcs.aligned(mcs.Estimator(STEP, "linear(slope=1)"), [0.3], 8), "has its own density"),
    (lambda: mcs.aligned("disk", [[0.3], [0.3]], 8), "a power"),
    (lambda: AlignedStrata(edges=0.3), "a list of places"),
    (lambda: AlignedStrata(edges=[0.0]), "greater than 0"),
    (lambda: AlignedStrata(edges=[1.0]), "ascending places"),
    (lambda: AlignedStrata(edges=[0.5, 0.5]), "ascending places"),
    (lambda: AlignedStrata(edges=[np.nan]), "finite"),
    (lambda: AlignedStrata(edges=[[0.5], 0.3]), "one list of places"),
    (lambda: AlignedStrata(edges=[0.5], strata=1), "2 pieces, but strata is 1"),
    (lambda: AlignedStrata(edges=[0.5], strata=0), "strata is 0"),
    (lambda: AlignedStrata(edges=[[0.5], [0.5]], strata=[4]), "one for each of 2 dims"),
    (lambda: AlignedStrata(edges=np.linspace(0.1, 0.9, 5000), strata=10**6), "at most 4096"),
    (lambda: _bands(np.zeros((3, 3), int)), r"shape \(3, 3\)"),
    (lambda: _bands(np.zeros(9)), "type float64"),
    (lambda: _bands(np.arange(9)), "the same for m and −m"),
    (lambda: _bands(np.full(9, -1)), "from 0 to 4095"),
    (lambda: _bands("wedge"), "for 2 dims, not 1"),
    (lambda: _modes(modes=10**4), "modes"),
    (lambda: _modes(channel=-1), "channel"),
    (lambda: _modes(band="99"), "band"),
    (lambda: _modes(band=1), "band is 1; give labels of bands as text, such as '4'"),
    (lambda: _modes(band=["1", 2]), "as text"),
    (lambda: mcs.covariance_modes(INFINITE, "jittered", 9, realizations=4), "primary"),
    (lambda: mcs.prediction.predicted_rate(-2, "jump", 2), "greater than -2"),
    (lambda: mcs.prediction.predicted_rate(True, "jump", 2), "b is True"),
    (lambda: mcs.prediction.predicted_rate(2, float("nan"), 2), "decay is nan"),
    (lambda: _picture(technique=-1), "technique"),
    (lambda: _picture(resolution=2), "resolution"),
    (lambda: _picture(resolution=10**7), "resolution"),
    (lambda: _smooth(widths=[]), "one or more"),
    (lambda: _smooth(widths=[-0.1]), "at least 0"),
    (lambda: _smooth(widths=np.linspace(0, 0.3, 10**6)), "256 at most"),
    (lambda: _smooth(counts=[]), "one or more"),
    (lambda: _smooth(method="blur"), "method"),
    (lambda: _needed(max_realizations=10**12), "from 2 to"),
    (lambda: _needed(n=0), "n is 0"),
    (lambda: _needed(sampler=mcs.sampler("jittered", dims=2)), "2"),
    (lambda: _spectrum(order=4), "order is 4"),
    (lambda: _spectrum(frequencies=31), "frequencies is 31"),
    (lambda: _spectrum(frequencies=2**24), "more than 1.68e"),
    (lambda: mcs.technique_terms(PARTS, "jittered", 4, space="domain"), "primary"),
    (lambda: mcs.technique_terms(PARTS, mcs.sampler("jittered", dims=2), 4), "dims"),
    (
        lambda: mcs.technique_terms(
            mcs.MultipleImportance("gaussian", ["uniform"] * 60, dims=2),
            "jittered",
            4,
            half_width=100,
        ),
        "pairs of techniques",
    ),
    (lambda: mcs.variance_terms(PARTS, "jittered", 16, space="domain"), "space='primary'"),
]
UNKNOWN = [
    (lambda: _spectrum(mcs.Estimator("gaussian", "linear", dims=2)), "anova_variances"),
    (lambda: _spectrum(CORNER), "exact Fourier"),
    (lambda: _spectrum(sampler="jittered"), "add shift"),
    (lambda: _spectrum(sampler="sobol | owen"), "add shift"),
    (lambda: _exact("poisson-disk"), "convergence"),
    (lambda: _exact("halton | shift"), "convergence"),
    (lambda: _exact("sobol | owen | shift"), "No exact variance is known"),
    (lambda: _exact("correlated-multi-jittered"), "No exact variance is known"),
    (lambda: _exact("halton | digital-shift"), "No exact variance is known"),
    (lambda: _exact("jittered", integrand=CORNER), "does not converge"),
    (lambda: _exact("sobol | digital-shift", integrand="disk"), "does not converge"),
    (lambda: _pairs("sobol", 16), "or use another method"),
    (lambda: _pairs("jittered | strata-shift", 16), "or use another method"),
    (lambda: _pairs("regular | shift", 16), "or use another method"),
    (lambda: _pairs("uniform-jitter", 4, 1), "or use another method"),
    (lambda: _pairs("jittered | shift", 27, 3), "or use another method"),
    (lambda: _pairs("latin-hypercube", 16), "or use another method"),
    (lambda: _pairs("jittered | shift", 4, 1, POLE, realizations=4), "diverges"),
]


@pytest.mark.parametrize(("call", "words"), ROWS)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(ParameterError, match=words):
        call()


@pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")
@pytest.mark.parametrize(("call", "words"), UNKNOWN)
def test_unknown_names_are_refused(call, words):
    with pytest.raises(mcs.NoClosedForm, match=words):
        call()


def test_counts_and_densities_have_their_own_error_types():
    with pytest.raises(CountError, match="16 and 25"):
        mcs.convergence("gaussian", "jittered", [16, 20])
    with pytest.raises(DensityError, match="would miss"):
        mcs.explain.primary_picture(mcs.Estimator("constant", "disk", dims=2))
