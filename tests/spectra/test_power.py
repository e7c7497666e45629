"""Expected power spectra: closed forms against simulation, standard errors, labels."""

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.analysis import Subject, compute, compute_chunk
from mcspectra.core.errors import (
    CountError,
    InfiniteWeightVarianceWarning,
    NoClosedForm,
    ParameterError,
)
from mcspectra.core.progress import listening
from mcspectra.core.streams import Stream
from mcspectra.spectra.power import Points, Spectrum
from mcspectra.testing import check_analysis

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
    close = mcs.power_spectrum("jittered", 1024, engine="nufft", eps=1e-9, **kwargs)
    direct = mcs.power_spectrum("jittered", 1024, engine="direct", **kwargs)
    assert np.abs(close["power"] - direct["power"]).max() < 1e-8


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
        (("jittered", 0), ParameterError, "at least 1"),
        (("no-such", 16), ParameterError, "no sampler"),
    ],
)
def test_bad_input(arguments, error, words):
    with pytest.raises(error, match=words):
        mcs.power_spectrum(*arguments)


@pytest.mark.parametrize(
    "changes",
    [
        {"realizations": 0},
        {"half_width": -1},
        {"half_width": 2**31},
        {"wedges": 0},
        {"eps": 2.0},
        {"eps": 0.5},
        {"n": 2**40},
        {"mean": "yes"},
        {"frequency_step": 1e9},
        {"engine": "fft"},
    ],
)
def test_bad_options_are_refused_before_anything_runs(changes):
    with pytest.raises(ParameterError):
        mcs.power_spectrum("random", **{"n": 4, **changes})


CASES = {
    "plain": ("jittered", None, {}),
    "mean": ("jittered", None, {"mean": True, "engine": "direct"}),
    "density": ("jittered", "linear(slope=1)", {"mean": True}),
    "odd": ("random", None, {"realizations": 33, "wedges": 5}),
    "line": ("jittered(dims=1)", None, {"frequency_step": 0.5}),
}


@pytest.mark.parametrize("case", CASES)
def test_chunks_and_threads_change_nothing(case):
    sampler, density, options = CASES[case]
    settings = {"half_width": 4, "realizations": 40, **options}
    if density is None:
        source = mcs.sampler(sampler)
        estimator = mcs.integrand("gaussian", dims=source.dims)
        check_analysis(Spectrum(n=16, **settings), estimator, source)
    found = [
        mcs.power_spectrum(sampler, 16, density=density, **settings, rng=3, workers=workers)
        for workers in (1, 2)
    ]
    xr.testing.assert_identical(*found)
    assert np.nanmax(found[0]["power_se"]) > 0
    assert ("mean_coefficient" in found[0]) == options.get("mean", False)


def test_the_points_beside_a_spectrum_are_those_of_its_first_realization():
    subject = Subject(mcs.Estimator("gaussian", density="linear(slope=1)"), mcs.sampler("jittered"))
    found = compute(Points(n=16), subject, 5)["points"]
    u = subject.sampler.draw_stream(16, Stream.from_rng(5), 0, 1)[0]
    np.testing.assert_array_equal(found, subject.estimator.density.sample(u))
    assert found.dims == ("point", "axis")
    spectra = [
        compute(Spectrum(n=16, half_width=2), subject, 5),
        mcs.power_spectrum("jittered", 16, density="linear(slope=1)", half_width=2, rng=5),
    ]
    xr.testing.assert_identical(*spectra)


def test_sums_count_all_sets():
    """Against |S|² of every point set, by definition."""
    stream, subject = Stream.from_rng(1), Subject(None, mcs.sampler("jittered", dims=2))
    reduction = Spectrum(n=16, half_width=2, realizations=21).reduction(subject, stream)
    total = compute_chunk(reduction, (0, reduction.blocks))
    assert total.frequencies.power.count == 21
    points = subject.sampler.draw_stream(16, stream, 0, 21)
    m = np.stack(np.unravel_index(np.arange(13), (5, 5)), axis=-1) - 2
    s = np.exp(-2j * np.pi * np.einsum("rkd,hd->rkh", points, m)).mean(axis=1)
    np.testing.assert_allclose(
        total.frequencies.power.total, (np.abs(s) ** 2).sum(axis=0), atol=1e-7
    )


def test_progress_is_told_to_the_end():
    told = []
    with listening(lambda what, done: told.append((what, done))):
        mcs.power_spectrum("random", 4, half_width=2, realizations=16, workers=2)
    assert {what for what, _ in told} == {"power_spectrum"}
    assert [done for _, done in told] == [i / 8 for i in range(1, 9)]


def test_density_of_other_dims_is_refused():
    with pytest.raises(ParameterError, match="dims"):
        mcs.power_spectrum(
            mcs.sampler("random", dims=2), 4, density=mcs.density("linear(slope=1)", dims=1)
        )


@pytest.mark.parametrize(
    ("spec", "n", "dims", "half_width"),
    [
        ("jittered", 4096, 2, 64),
        ("sobol | owen", 4096, 2, 32),
        ("poisson-disk", 300, 2, 50),
        ("jittered", 1000, 3, 12),
    ],
)
def test_single_precision_is_chosen_where_its_error_is_below_a_tenth_of_the_standard_error(
    spec, n, dims, half_width
):
    given = {"half_width": half_width, "realizations": 64, "rng": 3}
    sampler = mcs.sampler(spec, dims=dims)
    chosen = mcs.power_spectrum(sampler, n, density=None, **given)
    exact = mcs.power_spectrum(sampler, n, eps=1e-12, **given)
    assert chosen.attrs["eps"] == 1e-6 and exact.attrs["eps"] == 1e-12
    assert 0 < chosen.attrs["transform_error"] < 0.1
    error = np.abs(chosen["power"] - exact["power"]).values
    centre = (half_width,) * dims
    assert error[centre] < 1e-15  # S_0 is the sum of the weights
    error[centre] = 0.0
    assert (error <= 0.1 * exact["power_se"].values).all()


@pytest.mark.parametrize("spec", ["regular | shift", "fibonacci | shift", "halton | shift"])
def test_sets_of_exactly_known_power_keep_double_precision(spec):
    """All realisations have the same power: no error of a transform is below the statistical one."""
    sampler = mcs.sampler(spec, dims=2)
    spectrum = mcs.power_spectrum(sampler, sampler.nearest_count(1000), half_width=40)
    assert spectrum.attrs["eps"] == 1e-9
    assert "transform_error" not in spectrum.attrs
