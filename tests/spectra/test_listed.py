"""Power at listed frequencies, against the definition, closed forms and the grid; lists."""

import tracemalloc

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ConfigError
from mcspectra.spectra import (
    axis_frequencies,
    diagonal_frequencies,
    plane_frequencies,
    subset_frequencies,
    transforms,
)
from mcspectra.spectra._listed_kernels import unit_phases
from mcspectra.spectra.listed import listed_transform
from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum

# Šidák: a two-sided level of 5e-7 over a few thousand frequencies of one test is about 6 σ
SIGMAS = 6.0


def _agrees(spectrum, expected, *, floor=1e-14):
    error = np.abs(spectrum["power"].values - expected)
    allowed = SIGMAS * spectrum["power_se"].values + floor
    assert (error <= allowed).all(), float((error / allowed).max())


def test_phases_are_exact_to_rounding():
    """Two squarings multiply the error of four roundings by four: at most 16 ulps of 1."""
    turns = np.concatenate([np.linspace(-2, 2, 4097), [0.125, 1e-300, -0.375, 2.0**40 + 0.25]])
    real, imag = np.empty_like(turns), np.empty_like(turns)
    unit_phases(turns, real, imag)
    reduced = 2 * np.pi * (turns - np.rint(turns))
    assert np.abs(real - np.cos(reduced)).max() < 16 * 2.0**-53
    assert np.abs(imag + np.sin(reduced)).max() < 16 * 2.0**-53


@pytest.mark.parametrize("dims", [1, 2, 3, 7, 1024])
@pytest.mark.parametrize("kind", ["grid", "real"])
def test_engines_agree_with_the_definition(dims, kind):
    """More points than a block of the kernels, sparse and dense rows, shared factors or not."""
    rng = np.random.default_rng(dims)
    nu = rng.integers(-3, 4, (200, dims)).astype(float)
    if kind == "real":
        nu = rng.uniform(-20, 20, (200, dims)) * (rng.random((200, dims)) < 0.7)
    nu[5] = 0.0
    points, weights = rng.random((700, dims)), rng.standard_normal(700)
    expected = direct_sum(points, nu, weights)
    # 700 phases, each with an error of some ulps of its turns
    allowed = 700 * 1e-15 * (1 + np.abs(nu).sum(axis=1))
    for engine in ("direct", "nufft") if dims <= 3 else ("direct",):
        transform, name = listed_transform(nu, 700, engine=engine, eps=1e-9)
        assert name == engine
        error = np.abs(transform(points, weights) - expected)
        limit = allowed if engine == "direct" else 1e-8 * np.abs(weights).sum()
        assert (error <= limit).all()


@pytest.mark.parametrize(
    ("count", "dims", "n", "engine"),
    [(20_000, 2, 4096, "nufft"), (20, 2, 4096, "direct"), (20_000, 4, 4096, "direct")],
)
def test_auto_chooses_the_cheaper_engine(count, dims, n, engine):
    nu = np.random.default_rng(0).uniform(-64, 64, (count, dims))
    assert listed_transform(nu, n)[1] == engine


def test_widely_spaced_frequencies_use_the_direct_engine():
    """A type 3 transform spans the frequencies with a grid: 2e6 per side would be terabytes."""
    nu = np.random.default_rng(0).uniform(-1e6, 1e6, (50_000, 2))
    assert listed_transform(nu, 4096)[1] == "direct"


@pytest.mark.parametrize(
    ("dims", "n", "engine"),
    [(1, 8, "nufft"), (2, 16, "nufft"), (2, 16, "direct"), (4, 16, "direct"), (4, 16, "nufft")],
)
def test_power_agrees_with_the_grid(dims, n, engine):
    """An odd number of sets gives pairs and a single set; 4-D splits into 2 + 2 axes."""
    given = {"density": "linear(slope=1)"} if dims == 1 else {}
    sampler = mcs.sampler("jittered", dims=dims)
    grid = mcs.power_spectrum(
        sampler,
        n,
        half_width=3,
        realizations=13,
        rng=3,
        eps=1e-12,
        engine=engine,
        mean=True,
        **given,
    )
    nu = plane_frequencies(dims, range(dims), 3)
    listed = mcs.spectra.power_at(sampler, n, nu, realizations=13, rng=3, **given)
    for name in ("power", "power_se", "mean_coefficient", "mean_coefficient_se"):
        # Square root of rounding if nothing varies
        floor = 1e-7 if name.endswith("_se") else 1e-9
        assert np.abs(grid[name].values.ravel() - listed[name].values).max() < floor, name


def test_direct_engine_sums_blocks_of_points(monkeypatch):
    """Blocks of 5 points and a single block give equal sums."""
    grid = FrequencyGrid(4, 2)
    points = np.random.default_rng(1).random((1, 23, 4))
    whole = Transform(grid, 23, engine="direct").coefficients(points)
    monkeypatch.setattr(transforms, "_DIRECT_NUMBERS", 5 * 25)
    blocks = Transform(grid, 23, engine="direct").coefficients(points)
    assert np.abs(whole - blocks).max() < 1e-14
    assert np.abs(whole - direct_sum(points, grid.indices())).max() < 1e-14


@pytest.mark.parametrize(
    ("name", "dims", "n"),
    [("random", 1, 7), ("jittered", 2, 16), ("latin-hypercube", 20, 8), ("random", 1024, 5)],
)
def test_closed_forms_in_any_dims(name, dims, n):
    """Real and integer frequencies along axes, diagonals and in a plane of two axes."""
    nu = np.concatenate(
        [
            axis_frequencies(dims, 2, step=0.7)[-6:],
            diagonal_frequencies(dims, 3),
            subset_frequencies(dims, (0, dims - 1)[: min(dims, 2)], 2),
        ]
    )
    sampler = mcs.sampler(name, dims=dims)
    found = mcs.spectra.power_at(sampler, n, nu, realizations=2000, rng=4)
    _agrees(found, mcs.closed_form_power(sampler, n, nu))


def test_mean_is_zero_at_integers_and_the_bias_of_a_cell_elsewhere():
    """Unbiased: ⟨S_ν⟩ = ∫ exp(−2πiνx) = exp(−πiν) sinc(πν) at every real ν, 0 at integers."""
    nu = np.concatenate([np.arange(1, 20), np.arange(0.25, 8, 0.5)])[:, None]
    found = mcs.spectra.power_at("random", 9, nu, realizations=3000, rng=5)
    expected = (np.exp(-1j * np.pi * nu) * np.sinc(nu))[:, 0]
    error = np.abs(found["mean_coefficient"].values - expected)
    assert (error <= SIGMAS * found["mean_coefficient_se"].values).all()
    # E|error|² = se²: the mean of |error|²/se² over F nearly independent frequencies is near 1
    ratio = np.mean((error / found["mean_coefficient_se"].values) ** 2)
    assert 0.3 < ratio < 2.5


def test_mean_shows_the_bias_of_a_plain_grid():
    """The regular grid has S_m = ±1 at multiples of n in every realization: zero error."""
    found = mcs.spectra.power_at(mcs.sampler("regular", dims=1), 8, [[8.0], [3.0]], realizations=5)
    assert np.allclose(np.abs(found["mean_coefficient"]), [1, 0], atol=1e-14)
    assert found["mean_coefficient_se"].values.max() < 1e-7  # square root of rounding


def test_weighted_points_of_a_density():
    """⟨|S_m|²⟩ = (1/n)∫1/p at m ≠ 0, and ⟨S_m⟩ = 0; p = ½ + x has ∫1/p = ln 3 (ORACLES)."""
    nu = np.arange(1, 30)[:, None]
    found = mcs.spectra.power_at(
        "random", 12, nu, density="linear(slope=1)", realizations=4000, rng=6
    )
    _agrees(found, np.log(3) / 12)
    error = np.abs(found["mean_coefficient"].values)
    assert (error <= SIGMAS * found["mean_coefficient_se"].values).all()


def test_workers_do_not_change_results():
    nu = axis_frequencies(6, 40)
    one = mcs.spectra.power_at("latin-hypercube", 64, nu, realizations=101, rng=2, workers=1)
    two = mcs.spectra.power_at("latin-hypercube", 64, nu, realizations=101, rng=2, workers=2)
    assert np.array_equal(one["power"], two["power"])
    assert np.array_equal(one["mean_coefficient"], two["mean_coefficient"])


def test_memory_does_not_grow_with_realizations():
    """Blocks hold 2^21 numbers, that is 512 of these sets, for any number of realizations."""
    peaks = []
    for realizations in (2048, 6144):
        tracemalloc.start()
        mcs.spectra.power_at("random", 4096, [[1.0]], realizations=realizations, workers=1)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


def test_labels():
    found = mcs.spectra.power_at("jittered", 16, [[1, 0.5], [2, 0]], realizations=1, rng=3)
    assert found["power"].dims == ("frequency",)
    assert found["m_1"].values.tolist() == [0.5, 0.0]
    assert found["m_0"].attrs["units"] == "cycles per unit"
    assert np.isnan(found["power_se"]).all()
    assert found.attrs["engine"] == "direct"
    assert found["mean_coefficient"].attrs["units"] == "1"


def test_lists_of_frequencies():
    assert len(axis_frequencies(3, 5)) == 15
    assert (np.count_nonzero(axis_frequencies(3, 5, step=0.5), axis=1) == 1).all()
    plane = plane_frequencies(4, (3, 1), 2)
    assert plane.shape == (25, 4)
    assert not plane[:, [0, 2]].any()
    assert plane[1].tolist() == [0, -1, 0, -2]  # C order of the given axes
    subset = subset_frequencies(5, (0, 2, 4), 2, step=2.0)
    assert len({tuple(row) for row in subset}) == 4**3
    assert ((subset != 0) == [True, False, True, False, True]).all()
    assert np.abs(subset).max() == 4
    assert np.array_equal(diagonal_frequencies(3, 2), [[1, 1, 1], [2, 2, 2]])


def test_points_that_exceed_the_memory_are_refused_at_once(monkeypatch):
    monkeypatch.setattr("mcspectra.core.memory.available_memory", lambda: 2**30)
    with pytest.raises(ConfigError, match="power_at would take about"):
        mcs.spectra.power_at("random", 2**30, [[1, 0]], realizations=2)
    with pytest.raises(ConfigError, match="power_spectrum would take about"):
        mcs.power_spectrum("random", 4, half_width=2000, realizations=2)
