"""Rings, slices, wedges and exponents: synthetic spectra exactly, samplers within intervals."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CorrelatedFrequenciesWarning, ParameterError
from mcspectra.core.results import dataset
from mcspectra.spectra.transforms import FrequencyGrid


def _made(power_of, dims=2, half_width=8, step=1.0, se=0.01):
    """Make a known spectrum: power power_of(ν) and errors se · power."""
    grid = FrequencyGrid(dims, half_width, step)
    nu = np.stack(np.meshgrid(*[grid.axis.astype(float)] * dims, indexing="ij"), axis=-1)
    power = power_of(nu)
    variables = {"power": (grid.names, power), "power_se": (grid.names, se * power)}
    if step != 1.0:
        variables["mean_coefficient"] = (grid.names, np.zeros(power.shape, complex))
    return dataset(variables, grid.coords, n=100, realizations=10**9)


def _length(nu):
    return np.sqrt((nu**2).sum(axis=-1))


@pytest.mark.parametrize("dims", [2, 3])
def test_rings_by_hand(dims):
    """Power cos² of the angle to the m0 axis: mean and variance over a ring's frequencies."""
    made = _made(lambda nu: nu[..., 0] ** 2 / np.maximum(_length(nu), 1) ** 2, dims, 5)
    rings = mcs.spectra.radial_statistics(made)
    index = np.stack(np.meshgrid(*[np.arange(-5, 6)] * dims, indexing="ij"), axis=-1)
    for ring in range(1, 6):
        members = np.rint(_length(index)) == ring
        power = made["power"].values[members]
        assert rings["radial_power"].values[ring - 1] == pytest.approx(power.mean(), rel=1e-12)
        assert rings["radius"].values[ring - 1] == pytest.approx(_length(index)[members].mean())
        half = len(power) // 2
        variance = power.var() * half / (half - 1)
        anisotropy = variance / power.mean() ** 2
        assert rings["anisotropy"].values[ring - 1] == pytest.approx(anisotropy, rel=1e-12)
        assert rings["anisotropy_db"].values[ring - 1] == pytest.approx(10 * np.log10(anisotropy))
        # ±ν have equal power: half of the squares count, and half of the frequencies
        error = np.sqrt((made["power_se"].values[members] ** 2).sum() / 2) / half
        assert rings["radial_power_se"].values[ring - 1] == pytest.approx(error, rel=1e-12)


def test_anisotropy_of_random_points_is_noise():
    """−10 log10 R within 6 σ; the relative error of a variance of h values is √(8/h).

    |S|² of a random set is exponential; means over R = 100 have kurtosis 3 + 6/100.
    """
    spectrum = mcs.power_spectrum("random", 256, half_width=24, realizations=100, rng=1)
    rings = mcs.spectra.radial_statistics(spectrum)
    independent = np.pi * rings["radius"].values
    allowed = 6 * np.sqrt(2.2 / independent)
    outer = independent > 60
    assert (np.abs(rings["anisotropy"].values * 100 - 1) < allowed)[outer].all()
    assert np.abs(rings["anisotropy_noise_db"].values[outer] + 20).max() < 1


def test_radial_error_covers_the_known_power():
    """Random points have power 1/n: the mean of z² over rings is 1 within 6 √(2/24)."""
    spectrum = mcs.power_spectrum("random", 256, half_width=24, realizations=200, rng=2)
    rings = mcs.spectra.radial_statistics(spectrum)
    z = (rings["radial_power"].values - 1 / 256) / rings["radial_power_se"].values
    assert abs(np.mean(z**2) - 1) < 6 * np.sqrt(2 / 24)


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_streamed_errors_agree_with_errors_of_ring_means(dims):
    """Each realization is drawn again as a spectrum of one realization."""
    sampler, kept = mcs.sampler("jittered", dims=dims), 5
    given = {"half_width": 4, "density": mcs.density("linear", dims=dims), "eps": 1e-12}
    many = mcs.power_spectrum(sampler, 8 if dims != 2 else 9, realizations=kept, rng=3, **given)
    points = sampler.draw(8 if dims != 2 else 9, realizations=kept, rng=3)
    alone = [
        mcs.power_spectrum(mcs.Sampler.from_points(x[None]), len(x), realizations=1, **given)
        for x in points
    ]
    for name in ("radial_power", "wedge_power")[: 1 + (dims == 2)]:
        of_grid = (
            mcs.spectra.radial_statistics(many)
            if name == "radial_power"
            else mcs.spectra.wedge_means(many)
        )
        np.testing.assert_allclose(many[name], of_grid[name], rtol=1e-9)
        means = np.stack([one[name].values for one in alone])
        np.testing.assert_allclose(many[name], means.mean(axis=0), rtol=1e-9)
        se = means.std(axis=0, ddof=1) / np.sqrt(kept)
        np.testing.assert_allclose(many[f"{name}_se"], se, rtol=1e-6)
        assert np.isnan(alone[0][f"{name}_se"]).all()


def test_other_wedges_have_no_errors_under_a_density():
    spectrum = mcs.power_spectrum("random", 9, density="linear", half_width=8, realizations=4)
    assert np.isnan(mcs.spectra.wedge_means(spectrum, 8)["wedge_power_se"]).all()
    assert np.isfinite(mcs.spectra.wedge_means(spectrum, 12)["wedge_power_se"]).all()
    eight = mcs.power_spectrum(
        "random", 9, density="linear", half_width=8, realizations=4, wedges=8
    )
    assert np.isfinite(mcs.spectra.wedge_means(eight, 8)["wedge_power_se"]).all()


@pytest.mark.parametrize(("dims", "count"), [(1, 1), (2, 4), (3, 13), (4, 40)])
def test_slices_hold_the_power_at_their_frequencies(dims, count):
    made = _made(lambda nu: np.cos(nu @ np.arange(1, dims + 1)), dims, 3, step=0.5)
    cut = mcs.spectra.slices(made)
    assert cut["slice_power"].shape == (count, 3)
    for label, values in zip(cut["slice"].values, cut["slice_power"].values, strict=True):
        direction = np.array([int(part) for part in label.strip("(),").split(",")])
        nu = 0.5 * np.arange(1, 4)[:, None] * direction
        assert np.allclose(values, np.cos(nu @ np.arange(1, dims + 1)), atol=1e-15)
        radius = cut["slice_radius"].sel(slice=label).values
        assert np.allclose(radius, _length(nu))


def test_wedges_by_hand():
    """Power |angle|: the mean of a wedge lies within it; power on an axis fills its wedge only."""
    made = _made(
        lambda nu: np.mod(np.degrees(np.arctan2(nu[..., 1], nu[..., 0])) + 7.5, 180), 2, 40
    )
    found = mcs.spectra.wedge_means(made)
    assert found["angle"].values.tolist() == list(range(0, 180, 15))
    assert np.abs(found["wedge_power"].values - 7.5 - found["angle"].values).max() < 7.5
    # Frequencies are symmetric around the center of a wedge at multiples of 45 degrees
    assert np.allclose(found["wedge_power"].values[[0, 3, 6, 9]], [7.5, 52.5, 97.5, 142.5])
    on_axis = _made(lambda nu: (nu[..., 1] == 0) * 1.0, 2, 16)
    assert np.flatnonzero(mcs.spectra.wedge_means(on_axis, 4)["wedge_power"].values).tolist() == [0]
    assert np.isnan(mcs.spectra.wedge_means(_made(_length, 2, 1), 12)["wedge_power"].values[1])


def test_wedges_ignore_frequencies_beyond_the_circle():
    made = _made(lambda nu: (_length(nu) > 8) * 1.0)
    assert not mcs.spectra.wedge_means(made)["wedge_power"].values.any()


@pytest.mark.parametrize("b", [-1.0, 0.0, 2.0, 4.0])
@pytest.mark.parametrize(("dims", "step"), [(1, 1.0), (2, 0.5), (3, 1.0)])
def test_exponent_of_a_power_law_is_exact(b, dims, step):
    made = _made(lambda nu: 0.3 * np.maximum(_length(nu), 0.1) ** b, dims, 8, step)
    found = mcs.spectra.low_frequency_exponent(made)
    assert float(found["low_frequency_exponent"]) == pytest.approx(b, abs=1e-10)
    low, high = found["low_frequency_exponent_ci"].values
    assert low < b < high
    assert float(found["exponent_fit_chi2"]) < 1e-15


def test_exponent_interval_has_its_level():
    """95 % of 400 fits with errors of known size; 6 binomial σ are 6.5 %."""
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(400):
        made = _made(lambda nu: np.maximum(np.abs(nu[..., 0]), 0.1) ** 2, 1, 20, se=0.05)
        noisy = made["power"].values * (1 + 0.05 * rng.standard_normal(41))
        made["power"].values[:20] = noisy[:20]
        made["power"].values[21:] = noisy[:20][::-1]
        low, high = mcs.spectra.low_frequency_exponent(made, up_to=20)[
            "low_frequency_exponent_ci"
        ].values
        inside += low < 2 < high
    # Intervals are widened if χ² is above 1, so coverage may be higher
    assert inside / 400 > 0.95 - 6 * np.sqrt(0.95 * 0.05 / 400)


def test_misfit_widens_the_interval_and_a_large_one_refuses():
    def power(nu):
        return 1 + np.abs(nu[..., 0]) ** 3

    bent, more = (
        mcs.spectra.low_frequency_exponent(_made(power, 1, 20, se=se), up_to=20)
        for se in (0.05, 0.07)
    )
    assert 1 < float(more["exponent_fit_chi2"]) < float(bent["exponent_fit_chi2"]) < 10
    # The scatter about the line determines the interval, not the errors
    assert np.allclose(bent["low_frequency_exponent_ci"], more["low_frequency_exponent_ci"])
    found = mcs.spectra.low_frequency_exponent(_made(power, 1, 20, se=1e-4), up_to=20)
    assert float(found["exponent_fit_chi2"]) > 100
    assert "no power law" in found.attrs["reason"]
    assert np.isnan(float(found["low_frequency_exponent"]))


@pytest.mark.parametrize(
    ("spec", "realizations", "reason"),
    [
        ("halton", 10, "The power is the same in all realizations"),
        ("kronecker | shift", 10, "The power is the same in all realizations"),
        ("sobol | owen", 100, "there is no power law"),
        ("sobol | owen", 4, "is wider than ±0.5: it is not resolved"),
        ("halton | owen", 100, "is wider than ±0.5: it is not resolved"),
        ("jittered", 100, None),
    ],
)
def test_no_exponent_of_one_set_or_of_peaks(spec, realizations, reason):
    """Intervals from -205 to 206 were once reported as results."""
    spectrum = mcs.power_spectrum(
        mcs.sampler(spec, dims=2), 256, half_width=12, realizations=realizations
    )
    found = mcs.spectra.low_frequency_exponent(spectrum)
    assert (reason is None) == ("reason" not in found.attrs)
    assert reason is None or reason in found.attrs["reason"]
    assert found.attrs.get("reason", "").count(". ") == 0


def _exponent(spec, dims, n, *, half_width, up_to, axis=None, realizations=1000):
    """Return b and three half-widths of its 95 % interval: 5.9 σ of a normal distribution."""
    spectrum = mcs.power_spectrum(
        mcs.sampler(spec, dims=dims), n, half_width=half_width, realizations=realizations, rng=7
    )
    found = mcs.spectra.low_frequency_exponent(spectrum, up_to=up_to, axis=axis)
    low, high = found["low_frequency_exponent_ci"].values
    return float(found["low_frequency_exponent"]), 1.5 * (high - low)


@pytest.mark.parametrize("dims", [1, 2])
def test_random_points_have_exponent_0(dims):
    b, allowed = _exponent("random", dims, 256, half_width=8, up_to=8)
    assert abs(b) < allowed < 0.2


@pytest.mark.parametrize(
    ("spec", "dims", "n", "axis"),
    [
        ("jittered", 1, 64, None),
        ("jittered", 2, 1024, None),
        ("sobol | owen", 1, 64, None),
        ("sobol | owen", 2, 64, 0),
    ],
)
def test_stratified_points_have_exponent_2(spec, dims, n, axis):
    """One point per stratum: P = (1 − Π sinc²(πm_i/s))/n, along an axis also for nets (s = n).

    Its slope d ln P / d ln |m| falls from 2 to the value at πm/s = π/8 along an axis, where it is
    least. A fit with positive weights averages slopes, so it lies between.
    """
    s = n if axis is not None else round(n ** (1 / dims))
    up_to = max(s / 8, 3.0)
    x = np.pi * up_to / s
    least = 2 * np.sin(x) / x * (np.sin(x) / x - np.cos(x)) / (1 - (np.sin(x) / x) ** 2)
    assert 1.7 < least < 2
    b, allowed = _exponent(spec, dims, n, half_width=int(up_to) + 1, up_to=up_to, axis=axis)
    assert least - allowed < b < 2 + allowed
    assert allowed < 0.5


@pytest.mark.parametrize(
    ("spec", "n", "b"),
    [
        ("latin-hypercube | shift", 4096, 0.0),
        ("latin-hypercube", 1024, 0.0),
        ("multi-jittered | shift", 4096, 1.9),
    ],
)
def test_the_directions_with_the_largest_power_decide(spec, n, b):
    """Latin hypercubes: 1/n off the axes, m² on them. Multi-jitter: like jittered off the axes.

    1.9 lies between 2 and 1.8, the slope of 1 − sinc² at the end of the window, n^(1/2)/4.
    """
    spectrum = mcs.power_spectrum(spec, n, half_width=16, realizations=200, rng=7)
    found = mcs.spectra.low_frequency_exponent(spectrum)
    low, high = found["low_frequency_exponent_ci"].values
    half = (high - low) / 2
    assert abs(float(found["low_frequency_exponent"]) - b) < 2 * half + 0.1 * (b > 0)
    assert half < 0.5  # distinguishes 0 from 2
    assert found.attrs["directions"].startswith("m0 and m1")
    assert "reason" not in found.attrs
    axis = mcs.spectra.low_frequency_exponent(spectrum, axis=0)
    assert float(axis["low_frequency_exponent"]) > 1.7
    assert axis.attrs["directions"] == "axis 0"


def test_two_exponents_by_hand():
    """|ν|² on the axes and |ν|¹ off them: b = 1, the larger power; with higher axes, b = 2."""
    for factor, b in ((1e-3, 1.0), (1e3, 2.0)):
        made = _made(
            lambda nu, k=factor: np.where((nu == 0).any(-1), k * _length(nu) ** 2, _length(nu)), 2
        )
        found = mcs.spectra.low_frequency_exponent(made, up_to=8)
        assert float(found["low_frequency_exponent"]) == pytest.approx(b, abs=1e-9)


def test_between_integers_the_power_of_the_mean_is_subtracted():
    """Jittered: ⟨|S_ν|²⟩ − sinc²(πν) = (1 − sinc²(πν/n))/n, so b = 2; with sinc², b < 0."""
    sampler = mcs.sampler("jittered", dims=1)
    given = {"half_width": 32, "frequency_step": 0.25, "realizations": 500, "rng": 2}
    spectrum = mcs.power_spectrum(sampler, 64, mean=True, eps=1e-12, **given)
    found = mcs.spectra.low_frequency_exponent(spectrum)
    low, high = found["low_frequency_exponent_ci"].values
    assert abs(float(found["low_frequency_exponent"]) - 1.95) < 1.5 * (high - low) + 0.05
    assert high - low < 0.3
    with pytest.raises(ParameterError, match="frequency step of 0.25"):
        mcs.spectra.low_frequency_exponent(mcs.power_spectrum(sampler, 64, **given))


def test_lattices_have_no_exponent_and_say_why():
    spectrum = mcs.power_spectrum("fibonacci | shift", 89, half_width=6, realizations=20)
    found = mcs.spectra.low_frequency_exponent(spectrum, up_to=4)
    assert np.isnan(found["low_frequency_exponent"])
    assert np.isnan(found["low_frequency_exponent_ci"]).all()
    assert "no power" in found.attrs["reason"]


@pytest.mark.parametrize(
    "function",
    [
        mcs.spectra.radial_statistics,
        mcs.spectra.slices,
        mcs.spectra.wedge_means,
        mcs.spectra.low_frequency_exponent,
    ],
)
def test_other_data_than_a_grid_spectrum_are_refused(function):
    made = _made(_length)
    listed = mcs.spectra.power_at("random", 4, [[1.0, 0.0]], realizations=3)
    for given in (None, "jittered", np.ones((3, 3)), made.drop_vars("power_se"), listed):
        with pytest.raises(ParameterError, match="power_spectrum"):
            function(given)
    for given in (made.isel(m0=slice(1, None)), made.isel(m0=0), made.isel(m0=[8], m1=[8])):
        with pytest.raises(ParameterError, match="whole grid"):
            function(given)


@pytest.mark.parametrize("wedges", [0, 2.5, 10**9])
def test_bad_wedges(wedges):
    with pytest.raises(ParameterError, match="wedges"):
        mcs.spectra.wedge_means(_made(_length), wedges)


def test_wrong_dims():
    with pytest.raises(ParameterError, match="wedges need two"):
        mcs.spectra.wedge_means(_made(_length, 3, 2))
    with pytest.raises(ParameterError, match="up to 4 dims, not 5"):
        mcs.spectra.slices(_made(_length, 5, 1))


@pytest.mark.parametrize(
    "given",
    [
        {"up_to": 0.5},
        {"up_to": 9.0},
        {"axis": 2},
        {"axis": -1},
    ],
)
def test_bad_windows(given):
    with pytest.raises(ParameterError, match=next(iter(given))):
        mcs.spectra.low_frequency_exponent(_made(_length), **given)


def test_exponents_need_lengths_and_errors():
    with pytest.raises(ParameterError, match="three"):
        mcs.spectra.low_frequency_exponent(_made(_length, 1, 2))
    single = mcs.power_spectrum("random", 16, half_width=4, realizations=1)
    with pytest.raises(ParameterError, match="two or more realizations"):
        mcs.spectra.low_frequency_exponent(single)


@pytest.mark.parametrize(
    "f", [np.ones(3), np.full((17, 17), np.nan), np.full((17, 17), "a"), None, np.ones((17, 15))]
)
def test_bad_coefficients(f):
    with pytest.raises(ParameterError, match="coefficients"):
        mcs.spectra.variance_from_spectrum(_made(_length), f)


def test_predictions_for_sets_that_are_not_homogeneous():
    f = mcs.integrand("gaussian", dims=2).fourier_grid(3)
    weighted = mcs.power_spectrum("random", 9, density="linear", half_width=3, realizations=2)
    with pytest.raises(ParameterError, match="density linear"):
        mcs.spectra.variance_from_spectrum(weighted, f)
    jittered = mcs.power_spectrum("jittered", 9, half_width=3, realizations=2)
    with pytest.warns(CorrelatedFrequenciesWarning, match="add shift"):
        mcs.spectra.variance_from_spectrum(jittered, f)
    for spec in ("jittered | shift", "random", "poisson-disk"):
        mcs.spectra.variance_from_spectrum(
            mcs.power_spectrum(spec, 9, half_width=3, realizations=2), f
        )
    points = mcs.Sampler.from_points(np.random.default_rng(1).random((2, 9, 2)))
    with np.testing.assert_no_warnings():
        mcs.spectra.variance_from_spectrum(
            mcs.power_spectrum(points, 9, half_width=3, realizations=2), f
        )
