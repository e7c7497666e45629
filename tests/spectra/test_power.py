"""Expected power spectra: closed forms against simulation, standard errors, labels."""

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.analysis import Subject, compute, compute_chunk
from mcspectra.core.streams import Stream
from mcspectra.spectra.power import Points, Spectrum
from mcspectra.testing import check_analysis

# Šidák: a two-sided level of 5e-7 over a few thousand frequencies of one test is about 6 σ
SIGMAS = 6.0


def _agrees(spectrum, expected, *, floor=1e-15):
    """Assert all frequencies within SIGMAS standard errors of the closed form."""
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
        ("jittered", 2, 16),
        ("uniform-jitter", 2, 16),
        ("latin-hypercube", 3, 5),
        ("rank1-lattice(vector=[1, 5]) | shift", 2, 13),
    ],
)
def test_closed_forms_agree_with_simulation(spec, dims, n):
    sampler = mcs.sampler(spec, dims=dims)
    spectrum = mcs.power_spectrum(sampler, n, half_width=6, realizations=3000, rng=5, eps=1e-12)
    m = np.stack(np.meshgrid(*[np.arange(-6, 7)] * dims, indexing="ij"), axis=-1)
    _agrees(spectrum, mcs.closed_form_power(sampler, n, m), floor=1e-10)


def test_power_of_random_points_with_a_density_agrees_with_the_oracle():
    """⟨|S_m|²⟩ = (1/n) ∫1/p + ((n−1)/n) δ_m0; Var(S_0) = (ln 3 − 1)/n for p = ½ + x (ORACLES)."""
    found = mcs.closed_form_power("random", 12, [[0], [3]], density="linear(slope=1)")
    assert found == pytest.approx([1 + (np.log(3) - 1) / 12, np.log(3) / 12], rel=1e-9)


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


def test_the_points_of_a_spectrum_are_its_first_realization():
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


def test_points_of_an_estimator_have_pictures_of_f_and_p():
    f, p = mcs.integrand("gaussian(width=0.3)", dims=2), mcs.density("linear(slope=1)", dims=2)
    estimator = mcs.Estimator(f, p)
    found = compute(Points(n=16), Subject(estimator, mcs.sampler("jittered", dims=2)), 5)
    x = np.stack(np.meshgrid(found["x0"], found["x1"], indexing="ij"), axis=-1)
    np.testing.assert_array_equal(found["integrand_value"], f(x))
    np.testing.assert_array_equal(found["density_value"], p.pdf(x))


def test_a_function_that_fails_on_the_grid_has_points_without_a_picture():
    def fails(x):
        if x.size > 1000:
            raise ZeroDivisionError("no grid")
        return x[..., 0]

    estimator = mcs.Estimator(mcs.Integrand.from_function(fails, dims=2))
    found = compute(Points(n=16), Subject(estimator, mcs.sampler("jittered", dims=2)), 5)
    assert set(found.data_vars) == {"points"}


def test_sums_count_all_sets():
    """Compare with |S|² of every point set by definition."""
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


def test_intervals_cover_the_power_of_random_points():
    """4 realizations of 64 points: 95 % of 40 · 8 means are covered; 1.96 errors covered 85 %."""
    inside = []
    for seed in range(40):
        d = mcs.power_spectrum("random", 64, half_width=8, realizations=4, wedges=6, rng=seed)
        for name in ("radial_power_ci", "wedge_power_ci"):
            low, high = 64 * d[name].values.T
            inside.extend((low <= 1) & (high >= 1))
        assert d.attrs["student_t"] == pytest.approx(3.182446)
    # 560 numbers: 4 binomial sigma below 94 %
    assert 0.94 - 4 * np.sqrt(0.06 / 560) < np.mean(inside) < 0.99
