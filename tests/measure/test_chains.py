"""Errors of Markov chains: the exact error of AR(1), a rival estimator, and the named causes."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.core.results import VARIABLES, check_variables

SEEDS = 300
# Smallest allowed share of SEEDS intervals of 95 % that cover: five standard errors below 0.95
LEAST = 0.95 - 5 * np.sqrt(0.95 * 0.05 / SEEDS)


def ar1(rho, shape, seed=1):
    """Return stationary chains x_t = ρ x_{t−1} + e_t."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(shape)
    noise[..., 0] /= np.sqrt(1 - rho * rho)
    return recursive((rho,), noise)


def recursive(phi, noise):
    """Return x_t = Σ_k φ_k x_{t−k} + e_t along the last axis, from 0 before its first element."""
    x = np.moveaxis(noise, -1, 0).copy()
    for k in range(1, len(x)):
        for back, factor in enumerate(phi[:k], start=1):
            x[k] += factor * x[k - back]
    return np.ascontiguousarray(np.moveaxis(x, 0, -1))


def exact_variance(rho, n):
    """Return the variance of the mean of n draws of AR(1) with innovations of variance 1."""
    factor = (1 + rho) / (1 - rho) - 2 * rho * (1 - rho**n) / (n * (1 - rho) ** 2)
    return factor / n / (1 - rho * rho)


def quantities(x):
    """Return the errors for x (seed, chain, draw), with one quantity for each seed."""
    return mcs.measure.chain_error(np.moveaxis(x, 0, -1))


def cause(draws, **options):
    result = mcs.measure.chain_error(draws, **options)
    return str(result["cause"].values), str(result["evidence"].values), result


@pytest.mark.slow
@pytest.mark.parametrize(("rho", "chains"), [(-0.9, 1), (0.0, 1), (0.5, 4), (0.99, 1)])
def test_intervals_cover_the_mean_and_the_exact_error(rho, chains):
    times = 40 // chains  # length of a chain in autocorrelation times
    n = max(200, int(times * (1 + rho) / (1 - rho)))
    result = quantities(ar1(rho, (SEEDS, chains, n)))
    low, high = result["mean_ci"].values.T
    assert ((low <= 0) & (high >= 0)).mean() >= LEAST
    exact = np.sqrt(exact_variance(rho, n) / chains)
    low, high = result["mcse_ci"].values.T
    # The degrees of freedom are asymptotic; short chains may miss in another 5 % of the seeds
    assert ((low <= exact) & (exact <= high)).mean() >= LEAST - 0.05
    named = [text for text in result["cause"].values if text not in ("none", "few-realizations")]
    assert len(named) <= 0.02 * SEEDS


def initial_monotone_sequence(x):
    """Return the variance of the mean of one chain by [Geyer1992]_."""
    n = x.size
    centred = x - x.mean()
    covariance = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * n)) ** 2)[:n] / n
    pairs = covariance[: n // 2 * 2].reshape(-1, 2).sum(axis=1)
    pairs = np.minimum.accumulate(pairs[: np.argmax(pairs < 0)])
    return max(2 * pairs.sum() - covariance[0], 1e-12) / n


@pytest.mark.parametrize(
    ("phi", "n", "worse"),
    [((-0.9,), 400, 2.0), ((2 * 0.95 * np.cos(0.5), -(0.95**2)), 400, 2.0), ((0.9,), 1900, 0.9)],
    ids=["antithetic", "oscillating", "positive"],
)
def test_errors_are_closer_than_those_of_the_initial_monotone_sequence(phi, n, worse):
    rng = np.random.default_rng(5)
    x = recursive(phi, rng.standard_normal((100, n + 500)))[:, 500:]
    # Exact variance from the autocovariance, computed on a grid that resolves the spectrum
    grid = 1 << 16
    nu = np.fft.rfftfreq(grid)
    waves = np.exp(-2j * np.pi * nu[:, None] * np.arange(1, len(phi) + 1))
    covariance = np.fft.irfft(1 / np.abs(1 - waves @ np.array(phi)) ** 2)[:n]
    exact = (covariance[0] + 2 * ((1 - np.arange(n) / n) * covariance)[1:].sum()) / n
    ours = quantities(x[:, None])["mcse"].values ** 2
    theirs = np.array([initial_monotone_sequence(each) for each in x])
    error, other = (np.sqrt((np.log(v / exact) ** 2).mean()) for v in (ours, theirs))
    assert other > worse * error
    assert error < 0.5


def test_antithetic_chains_have_more_effective_draws_than_draws():
    theta, n = 0.9, 2000
    noise = np.random.default_rng(3).standard_normal((20, 1, n + 1))
    result = quantities(noise[..., 1:] - theta * noise[..., :-1])
    exact = ((1 - theta) ** 2 * n + 2 * theta) / n**2
    ratio = result["mcse"].values ** 2 / exact
    assert (
        0.5 < np.exp(np.log(ratio).mean()) < 2.0
    )  # an AR model of finite order is off by at most 1.5
    assert (result["ess"].values > 50 * n).all()
    assert (result["cause"].values == "none").all()
    # These chains vary at high frequencies, where the Fejér kernel is small
    white = mcs.measure.chain_error(noise[:, 0, 1:])
    assert float(result["error_share"][0, -1]) > 10 * float(white["error_share"][-1])


def test_error_shares_of_white_noise_follow_the_fejer_kernel():
    n = 1000
    result = mcs.measure.chain_error(np.random.default_rng(1).standard_normal((8, n)))
    assert np.ptp(result["fitted_spectrum"].values) < 1e-9  # the chosen model is white noise
    low, high = result["band_low"].values, result["band_high"].values
    fine = (np.arange(2**20) + 0.5) / 2**21
    kernel = (np.sin(np.pi * n * fine) / np.sin(np.pi * fine)) ** 2 / n / 2**20
    expected = [kernel[(fine >= a) & (fine < b)].sum() for a, b in zip(low, high, strict=True)]
    # Bands begin at a frequency of the grid, so either end is off by half a cell of 1/(2n)
    np.testing.assert_allclose(result["error_share"], expected, atol=0.02)
    np.testing.assert_allclose(result["draw_share"], 2 * (high - low))
    assert float(result["error_share"].sum()) == pytest.approx(1.0)


def test_fitted_and_measured_bands_agree_with_the_spectrum():
    rho, n = 0.9, 4096
    result = mcs.measure.chain_error(ar1(rho, (16, n)))
    nu = (np.arange(1, n // 2) / n)[:, None]
    inside = (nu >= result["band_low"].values) & (nu < result["band_high"].values)
    spectrum = 1 / np.abs(1 - rho * np.exp(-2j * np.pi * nu)) ** 2
    expected = (spectrum * inside).sum(axis=0)[1:] / inside.sum(axis=0)[1:]
    np.testing.assert_allclose(result["fitted_spectrum"][1:], expected, rtol=0.1)
    low, high = result["chain_spectrum_ci"].values[1:].T
    # The spectrum is not flat in a band, so widen its interval by half on either side
    assert (
        (low / (high / low) ** 0.25 < expected) & (expected < high * (high / low) ** 0.25)
    ).all()
    assert float(result["spectrum_at_zero"]) == pytest.approx(100, rel=0.25)


def test_variables_are_registered():
    for shape in ((2, 100), (2, 100, 3)):
        draws = np.random.default_rng(1).standard_normal(shape)
        check_variables(mcs.measure.chain_error(draws), list(VARIABLES), "chains")


def test_chains_that_drift_are_named():
    walks = np.cumsum(np.random.default_rng(7).standard_normal((40, 1, 2000)), axis=-1)
    found = quantities(walks)
    stuck = [
        c == "stuck-chain" and "drifts" in e
        for c, e in zip(found["cause"].values, found["evidence"].values, strict=True)
    ]
    assert np.mean(stuck) >= 0.9
    assert np.isinf(found["mcse_ci"].values[stuck, 1]).all()
    trend = np.random.default_rng(8).standard_normal(2000) + np.linspace(0, 1, 2000)
    name, text, result = cause(trend)
    assert name == "stuck-chain"
    assert "moves with time" in text
    assert np.isinf(result["mean_ci"].values).all()


def test_chains_that_stay_in_a_mode_are_named():
    rng = np.random.default_rng(9)
    levels = np.repeat([0.0, 6.0, 0.0, 6.0], 500) + rng.standard_normal(2000)
    name, text, result = cause(levels)
    assert name == "stuck-chain"
    assert "two levels" in text
    assert "never reached" in result.attrs["note"]
    several = ar1(0.5, (4, 1000)) + np.array([[0.0], [0.0], [8.0], [0.0]])
    name, text, result = cause(several)
    assert name == "stuck-chain"
    assert "different parts" in text
    assert float(result["ess"]) < 5
    assert float(result["mcse"]) == pytest.approx(2.0, rel=0.1)  # three chains at 0 and one at 8


def test_chains_that_repeat_a_value_are_named():
    repeated = ar1(0.5, 1000)
    repeated[600:750] = repeated[600]
    assert "repeats one value for 150 of 1000" in cause(repeated)[1]
    one = ar1(0.5, (4, 1000))
    one[2] = one[2, 0]
    assert "repeats one value for 1000 of 1000" in cause(one)[1]
    stuck = np.array([[1.0], [2.0]]).repeat(50, axis=1)
    for still, said in (
        (np.ones(50), "the draws are constant: all are 1"),
        (stuck, "no chain moves"),
    ):
        name, text, result = cause(still)
        assert name == "stuck-chain"
        assert said in text
        assert np.isnan(float(result["mcse"]))
        assert np.isinf(result["mean_ci"]).all()
    rare = (np.random.default_rng(2).random((4, 1000)) < 0.01).astype(float)
    assert cause(rare)[0] == "none"  # a rare event keeps one value for long


@pytest.mark.parametrize(
    ("draw", "named", "least"),
    [
        (lambda rng: rng.standard_cauchy((4, 2000)), "heavy-tail", 38),
        pytest.param(
            *(lambda rng: rng.standard_t(5, (4, 2000)), "none", 38), marks=pytest.mark.slow
        ),
        (lambda rng: rng.exponential(size=(4, 2000)), "none", 38),
    ],
    ids=["cauchy", "t5", "exponential"],
)
def test_heavy_tails_are_named(draw, named, least):
    rng = np.random.default_rng(11)
    found = quantities(np.array([draw(rng) for _ in range(40)]))
    assert (found["cause"].values == named).sum() >= least
    assert np.isinf(found["mean_ci"].values[found["cause"].values == "heavy-tail"]).all()


def test_chains_that_move_together_are_named():
    x = ar1(0.5, (1, 1000))
    name, text, result = cause(np.repeat(x, 4, axis=0))
    assert name == "correlated-replicates"
    assert "4 times as much" in text
    alone = mcs.measure.chain_error(x)
    assert float(result["mcse"]) == pytest.approx(float(alone["mcse"]))
    np.testing.assert_allclose(result["chain_spectrum"], alone["chain_spectrum"])
    partly = ar1(0.5, (4, 1000))
    partly[3] = partly[0]
    assert cause(partly)[0] == "correlated-replicates"


def test_an_antithetic_pair_of_chains_has_a_small_error():
    rng = np.random.default_rng(4)
    x = rng.standard_normal(1000)
    pair = np.stack([x, -x]) + 0.1 * rng.standard_normal((2, 1000))
    name, _, result = cause(pair)
    assert name == "none"
    assert float(result["mcse"]) == pytest.approx(0.1 / np.sqrt(2000), rel=0.3)


@pytest.mark.parametrize(
    "draws",
    [np.arange(1000.0), np.sin(np.arange(1000.0)), np.tile([1.0, -1.0], 500), np.eye(1, 50)[0]],
    ids=["ramp", "sine", "alternating", "spike"],
)
def test_deterministic_draws_give_a_finite_error(draws):
    result = mcs.measure.chain_error(draws)
    assert float(result["mcse"]) > 0
    assert np.isfinite(result["error_share"]).all()
    assert (result["cause"].item() == "stuck-chain") == (draws[-1] == 999)


def test_few_draws_are_named():
    found = quantities(ar1(0.5, (40, 1, 40)))["cause"].values
    assert np.mean(["few-realizations" in each or "stuck" in each for each in found]) > 0.8


def test_weighted_draws_have_the_right_mean_and_error():
    rng = np.random.default_rng(6)
    shape = (100, 1, 1000)
    x, w = rng.standard_normal(shape), np.exp(0.5 * rng.standard_normal(shape))
    found = [mcs.measure.chain_error(a, weights=b) for a, b in zip(x, w, strict=True)]
    mean = np.array([float(each["mean"]) for each in found])
    np.testing.assert_allclose(mean, (w * x).sum(axis=(1, 2)) / w.sum(axis=(1, 2)))
    # ⟨w²⟩/⟨w⟩² = e^{1/4}: the variance exceeds that of equal weights by this factor
    exact = np.sqrt(np.exp(0.25) / 1000)
    mcse = np.array([float(each["mcse"]) for each in found])
    assert mcse.mean() == pytest.approx(exact, rel=0.05)
    inside = [low <= 0 <= high for low, high in (each["mean_ci"].values for each in found)]
    assert np.mean(inside) >= 0.95 - 5 * np.sqrt(0.95 * 0.05 / 100)
    same = mcs.measure.chain_error(x[0], weights=np.full((1, 1000), 3.0))
    assert same["mcse"].item() == pytest.approx(
        mcs.measure.chain_error(x[0])["mcse"].item(), rel=1e-12
    )


def test_structures_of_arviz_are_read():
    x = ar1(0.5, (2, 100, 3)).transpose(0, 2, 1)  # (chain, 3, draw)
    theta = xr.DataArray(x, dims=("chain", "school", "draw"))
    posterior = xr.Dataset({"mu": theta.isel(school=0), "theta": theta})
    whole = mcs.measure.chain_error(xr.DataTree.from_dict({"/posterior": posterior}))
    assert list(whole["quantity"].values) == ["mu", "theta[0]", "theta[1]", "theta[2]"]
    named = mcs.measure.chain_error(posterior.assign_coords(school=["north", "south", "west"]))
    assert list(named["quantity"].values) == ["mu", "theta[north]", "theta[south]", "theta[west]"]
    np.testing.assert_allclose(whole["mean"], [x[:, 0].mean(), *x.mean(axis=(0, 2))], rtol=1e-12)
    for other in (posterior, SimpleNamespace(posterior=posterior)):
        xr.testing.assert_identical(mcs.measure.chain_error(other), whole)
    alone = mcs.measure.chain_error(theta.isel(school=1))
    assert alone["mcse"].dims == ()
    assert alone["mcse"].item() == whole["mcse"].values[2]
    one = mcs.measure.chain_error(theta.isel(school=1, chain=0), weights=np.ones(100))
    assert one.attrs["chains"] == 1


@pytest.mark.parametrize(
    ("draws", "options", "error", "words"),
    [
        ([1.0], {}, ParameterError, "at least 10 draws"),
        (np.zeros((2, 3, 4, 5)), {}, ParameterError, r"shape \(2, 3, 4, 5\)"),
        (np.r_[np.nan, np.arange(20.0)], {}, DomainError, "hold 1 NaN"),
        ("abc", {}, DomainError, "real numbers"),
        (xr.Dataset(), {}, ParameterError, "no variables"),
        (
            xr.Dataset({"a": ("x", np.arange(20.0))}), {},
            ParameterError, "draws of 'a' have the dims x",
        ),
        (np.arange(20.0), {"weights": -np.ones(20)}, DomainError, "weights are negative"),
        (np.arange(20.0), {"weights": np.ones(19)}, ParameterError, r"shape \(1, 20\)"),
        (np.ones((2, 20)), {"weights": np.ones(20)}, ParameterError, r"shape \(2, 20\)"),
        (np.ones((2, 20)), {"weights": np.eye(2)[:, :1] * np.ones(20)}, DomainError, "all zero"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_with_a_sentence(draws, options, error, words):
    with pytest.raises(error, match=words):
        mcs.measure.chain_error(draws, **options)


def transient(lifetime, seeds, rho=0.0):
    """Return chains (seed, chain, draw) that begin 5 above their mean, which is 0."""
    return ar1(rho, (seeds, 4, 1000)) + 5.0 * np.exp(-np.arange(1000) / lifetime)


@pytest.mark.parametrize(
    ("lifetime", "rho"), [(20, 0.0), pytest.param(100, 0.0, marks=pytest.mark.slow), (60, 0.5)]
)
def test_a_start_far_from_the_mean_is_reported_and_excluded(lifetime, rho):
    seeds = 40
    found = quantities(transient(lifetime, seeds, rho))
    names = [str(name) for name in found["cause"].values]
    assert set(names) <= {"burn-in", "stuck-chain"}  # stuck if the start affects half of the draws
    named = np.array(names) == "burn-in"
    assert named.mean() >= 0.7
    assert (found["burn_in"].values[named] >= lifetime).all()
    assert (found["burn_in"].values[~named] == 0).all()
    low, high = found["mean_ci"].values.T
    assert np.isinf(high[~named]).all()
    assert ((low <= 0) & (high >= 0)).mean() >= 0.95 - 5 * np.sqrt(0.95 * 0.05 / seeds)


@pytest.mark.parametrize(
    "rho", [*(pytest.param(r, marks=pytest.mark.slow) for r in (0.0, 0.5)), 0.9]
)
def test_stationary_chains_have_no_burn_in(rho):
    seeds = 100
    found = quantities(ar1(rho, (seeds, 4, 1000), seed=7))
    named = sum("burn-in" in str(name) for name in found["cause"].values)
    assert named <= 0.02 * seeds
    assert not found["burn_in"].values.any()


def test_results_exclude_the_burn_in():
    x = transient(50, 1)[0]
    name, evidence, found = cause(x)
    dropped = int(found["burn_in"])
    assert name == "burn-in"
    assert f"the first {dropped} of 1000 of each chain are excluded" in evidence
    alone = mcs.measure.chain_error(x[:, dropped:])
    for same in ("mean", "mean_ci", "mcse", "ess"):
        np.testing.assert_allclose(found[same], alone[same], rtol=1e-12)
    profiled = mcs.profile(x).causes[0]
    assert (profiled.name, profiled.evidence["burn_in"]) == ("burn-in", dropped)


def test_a_start_that_lasts_longer_than_half_of_the_draws_leaves_no_interval():
    name, _, found = cause(transient(400, 1)[0])
    assert name == "stuck-chain"
    assert np.isinf(found["mean_ci"].values).all()
