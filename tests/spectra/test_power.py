"""Expected power spectra: closed forms against simulation, standard errors, labels."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import (
    CountError,
    InfiniteWeightVarianceWarning,
    NoClosedForm,
    ParameterError,
)
from mcspectra.core.progress import listening

# Šidák: 5e-7 two-sided over a few thousand frequencies of one test is about 6 σ.
SIGMAS = 6.0


def _agrees(spectrum, expected, *, floor=1e-15):
    """All frequencies within SIGMAS standard errors of the closed form."""
    error = np.abs(spectrum["power"].values - expected)
    allowed = SIGMAS * spectrum["power_se"].values + floor
    assert (error <= allowed).all(), float((error / allowed).max())


@pytest.mark.parametrize("step", [1.0, 0.37])
@pytest.mark.parametrize("name", ["random", "jittered"])
def test_1d_closed_spectra_at_integer_and_real_frequencies(name, step):
    """ORACLES: random 1/n + ((n−1)/n) sinc²(πν); jittered (1/n)(1 − sinc²(πν/n)) + sinc²(πν)."""
    n = 16
    sampler = mcs.sampler(name, dims=1)
    spectrum = mcs.power_spectrum(
        sampler, n, half_width=60, frequency_step=step, realizations=4000, rng=11, eps=1e-12
    )
    nu = spectrum["m0"].values.astype(float)
    formula = {
        "random": 1 / n + (n - 1) / n * np.sinc(nu) ** 2,
        "jittered": (1 - np.sinc(nu / n) ** 2) / n + np.sinc(nu) ** 2,
    }[name]
    assert np.allclose(mcs.closed_form_power(sampler, n, nu[:, None]), formula, atol=1e-15)
    _agrees(spectrum, formula, floor=1e-10)


@pytest.mark.parametrize(
    ("spec", "dims", "n"),
    [
        ("random", 2, 16),
        ("jittered", 2, 16),
        ("jittered", 3, 27),
        ("jittered | shift", 2, 16),
        ("random | shift", 2, 9),
        ("uniform-jitter", 2, 16),
        ("regular | shift", 2, 16),
        ("latin-hypercube", 1, 10),
        ("latin-hypercube", 2, 10),
        ("latin-hypercube", 3, 5),
        ("rank1-lattice(vector=[1, 5]) | shift", 2, 13),
    ],
)
def test_closed_forms_agree_with_simulation(spec, dims, n):
    sampler = mcs.sampler(spec, dims=dims)
    spectrum = mcs.power_spectrum(sampler, n, half_width=6, realizations=3000, rng=5, eps=1e-12)
    m = np.stack(np.meshgrid(*[np.arange(-6, 7)] * dims, indexing="ij"), axis=-1)
    _agrees(spectrum, mcs.closed_form_power(sampler, n, m), floor=1e-10)


def test_closed_form_of_latin_hypercube_at_real_frequencies():
    sampler = mcs.sampler("latin-hypercube", dims=2)
    spectrum = mcs.power_spectrum(
        sampler, 8, half_width=10, frequency_step=0.23, realizations=4000, rng=6, eps=1e-12
    )
    axis = 0.23 * np.arange(-10, 11)
    nu = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    _agrees(spectrum, mcs.closed_form_power(sampler, 8, nu), floor=1e-10)


def test_random_points_under_a_density():
    """⟨|S_m|²⟩ = (1/n) ∫1/p + ((n−1)/n) δ_m0; Var(S_0) = (ln 3 − 1)/n for p = ½ + x (ORACLES)."""
    n = 12
    spectrum = mcs.power_spectrum(
        mcs.sampler("random", dims=1),
        n,
        density="linear(slope=1)",
        half_width=20,
        realizations=20_000,
        rng=8,
        eps=1e-12,
    )
    m = np.arange(-20, 21)[:, None]
    expected = mcs.closed_form_power("random", n, m, density="linear(slope=1)")
    assert expected[20] == pytest.approx(1 + (np.log(3) - 1) / n, rel=1e-9)
    assert expected[3] == pytest.approx(np.log(3) / n, rel=1e-9)
    _agrees(spectrum, expected, floor=1e-10)


def test_infinite_power_is_said():
    with pytest.warns(InfiniteWeightVarianceWarning, match="diverges"):
        power = mcs.closed_form_power("random", 4, np.ones((1, 1)), density="linear(slope=2)")
    assert np.isinf(power).all()


@pytest.mark.parametrize(
    ("spec", "n", "density"),
    [("sobol | owen", 16, None), ("jittered", 16, "linear(slope=1)"), ("poisson-disk", 16, None)],
)
def test_unknown_closed_forms_are_refused(spec, n, density):
    with pytest.raises(NoClosedForm, match="power_spectrum"):
        mcs.closed_form_power(mcs.sampler(spec, dims=2), n, np.full((1, 2), 0.5), density=density)


def test_shift_has_no_closed_form_between_integers():
    with pytest.raises(NoClosedForm, match="real frequencies"):
        mcs.closed_form_power(mcs.sampler("jittered | shift", dims=1), 4, [[0.5]])


def test_labels_and_provenance():
    d = mcs.power_spectrum("jittered", 16, half_width=5, realizations=10, rng=3)
    assert d["power"].dims == ("m0", "m1")
    assert d["m0"].values.tolist() == list(range(-5, 6))
    assert d["power"].attrs["units"] == "1"
    assert "⟨|S_m|²⟩" in d["power"].attrs["long_name"]
    assert d.attrs["seed"] == 3
    assert d.attrs["sampler"] == "jittered"
    assert d.attrs["version_mcspectra"]
    assert np.allclose(d["power"].values, d["power"].values[::-1, ::-1])


def test_workers_and_engines_do_not_change_results():
    kwargs = {"half_width": 40, "realizations": 37, "rng": 2}
    one = mcs.power_spectrum("jittered", 1024, workers=1, **kwargs)
    two = mcs.power_spectrum("jittered", 1024, workers=2, **kwargs)
    assert np.array_equal(one["power"], two["power"])
    assert np.array_equal(one["power_se"], two["power_se"])
    direct = mcs.power_spectrum("jittered", 1024, engine="direct", **kwargs)
    assert np.abs(one["power"] - direct["power"]).max() < 1e-8


def test_too_many_points_are_refused_before_they_are_drawn():
    with pytest.raises(ParameterError, match="at most 33554432 of them"):
        mcs.power_spectrum("jittered", 10**8, half_width=8)


def test_progress_is_reported():
    seen = []
    with listening(lambda what, done: seen.append((what, done))):
        mcs.power_spectrum("random", 2**18, half_width=2, realizations=6)
    fractions = [done for what, done in seen if what == "power_spectrum"]
    assert len(fractions) > 1
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_radial_mean_of_random_points_is_flat():
    d = mcs.power_spectrum("random", 64, half_width=16, realizations=400, rng=9)
    # each ring averages about 2π|m| frequencies (half of them independent), 400 realisations each
    independent = np.pi * d["radius"].values * 400
    error = np.abs(64 * d["radial_power"].values - 1)
    assert (error < 5 / np.sqrt(independent)).all()


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (("jittered", 15), CountError, "9 and 16"),
        (("jittered", 0), CountError, "from 1"),
        (("no-such", 16), ParameterError, "no sampler"),
    ],
)
def test_bad_input(arguments, error, words):
    with pytest.raises(error, match=words):
        mcs.power_spectrum(*arguments)


def test_density_of_other_dims_is_refused():
    with pytest.raises(ParameterError, match="dims"):
        mcs.power_spectrum(
            mcs.sampler("random", dims=2), 4, density=mcs.density("linear(slope=1)", dims=1)
        )
