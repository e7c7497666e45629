"""Coverage of 95 % intervals: variances, captured parts, spectra, ANOVA shares and integrals.

Run ``python -m benchmarks coverage``. With ``--frames`` it prints only the mean variance of frames.
With ``--answers`` it prints only the intervals of `integrate`, `profile` and `convergence`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri, xlogy

import mcspectra as mcs
from mcspectra.estimators.moments import Moments
from mcspectra.measure.sums import BATCH_SETTINGS, ratio_factors

REPETITIONS = 2_000
COUNTS = (20, 100, 1000)
FRAME_SEEDS = 1_000
_RUNS = 400  # number of analyses; each gives several intervals

# Distributions of estimates: generator, variance and kurtosis
LAWS: dict[str, tuple[Callable[..., np.ndarray], float, float]] = {
    "normal": (lambda rng, s: rng.standard_normal(s), 1.0, 3.0),
    "uniform": (lambda rng, s: rng.random(s), 1 / 12, 1.8),
    "exponential": (lambda rng, s: rng.exponential(size=s), 1.0, 9.0),
    "lognormal(1)": (lambda rng, s: np.exp(rng.standard_normal(s)), np.e * (np.e - 1), 113.9),
    "t(5)": (lambda rng, s: rng.standard_t(5, s), 5 / 3, 9.0),
    "bernoulli(0.1)": (lambda rng, s: 1.0 * (rng.random(s) < 0.1), 0.09, 8.1),
    "bimodal": (lambda rng, s: rng.standard_normal(s) + 4.0 * (rng.random(s) < 0.5), 5.0, 1.7),
    "gumbel": (lambda rng, s: rng.gumbel(size=s), np.pi**2 / 6, 5.4),
    "t(3)": (lambda rng, s: rng.standard_t(3, s), 3.0, np.inf),
    "lognormal(1.5)": (
        lambda rng, s: np.exp(1.5 * rng.standard_normal(s)),
        np.exp(2.25) * (np.exp(2.25) - 1),
        10_078.0,
    ),
}

# Exponent a of the density p ∝ x^a, integrand, and half width of the truncated spectrum
RATIOS: dict[str, tuple[float, Callable[[np.ndarray], np.ndarray], int]] = {
    "p = 1, step": (0.0, lambda x: 1.0 * (x < 0.3), 8),
    "p = 1, exp(−3x)": (0.0, lambda x: np.exp(-3 * x), 2),
    "p ∝ x^0.25, exp(−x)": (0.25, lambda x: np.exp(-x), 2),
    "p ∝ x^0.5, exp(−x)": (0.5, lambda x: np.exp(-x), 2),
    "p ∝ x^0.5, step": (0.5, lambda x: 1.0 * (x < 0.3), 8),
}

# Number of dims, function and integral
INTEGRALS: dict[str, tuple[int, Callable[[np.ndarray], np.ndarray], float]] = {
    "x": (1, lambda x: x[..., 0], 0.5),
    "exponential": (1, lambda x: -np.log1p(-x[..., 0]), 1.0),
    "lognormal(1)": (1, lambda x: np.exp(ndtri(np.maximum(x[..., 0], 1e-300))), np.exp(0.5)),
    "x^-0.3": (1, lambda x: np.maximum(x[..., 0], 1e-300) ** -0.3, 1 / 0.7),
    "exp(x + y)": (2, lambda x: np.exp(x.sum(axis=-1)), (np.e - 1) ** 2),
    "disk": (2, lambda x: 1.0 * (((x - 0.5) ** 2).sum(axis=-1) < 0.09), 0.09 * np.pi),
}
SETS = ("random", "jittered", "sobol | owen")
BUDGETS = (512, 4096, 32_768, 1_048_576)
_SEEDS = 600

# Antiderivatives of f and of f² for the integrands of one dim
ANTIDERIVATIVES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], ...]] = {
    "x": (lambda x: x**2 / 2, lambda x: x**3 / 3),
    "exponential": (
        lambda x: x + xlogy(1 - x, 1 - x),
        lambda x: 2 * xlogy(1 - x, 1 - x) - xlogy(np.sqrt(1 - x), 1 - x) ** 2 + 2 * x,
    ),
    "lognormal(1)": (
        lambda x: np.exp(0.5) * ndtr(ndtri(x) - 1),
        lambda x: np.exp(2.0) * ndtr(ndtri(x) - 2),
    ),
    "x^-0.3": (lambda x: x**0.7 / 0.7, lambda x: x**0.4 / 0.4),
}
REALIZATIONS = (100, 1000)
POINTS = (16, 64, 256)


def _of_variances() -> Iterator[tuple[str, ...]]:
    """Yield the coverage of `Moments.variance_ci`; constant samples count separately."""
    for count in COUNTS:
        for name, (draw, variance, kurtosis) in LAWS.items():
            found = Moments.of(draw(np.random.default_rng(count), (count, REPETITIONS)), tails=True)
            varies = found.m2 > 0
            low, high = found.variance_ci[varies].T
            covered = (low <= variance) & (variance <= high)
            bounded = np.isfinite(high)
            yield (
                str(count), name, f"{kurtosis:.4g}", f"{100 * covered.mean():.1f}",
                f"{100 * (high < variance).mean():.1f}", f"{100 * (low > variance).mean():.1f}",
                f"{100 * (~found.resolved[varies]).mean():.0f}", f"{100 * (~varies).mean():.0f}",
                f"{np.median(high[bounded] / found.variance[varies][bounded]):.2f}",
            )  # fmt: skip


def _weighted(x: np.ndarray, f: Any, power: float, m: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the Fourier sum of f over frequencies m, and f itself, divided by p ∝ x^power."""
    cut = sum((each * np.exp(2j * np.pi * k * x)).real for k, each in zip(m, c, strict=True))
    return np.stack([cut, f(x)]) / ((1 + power) * x**power)


def _of_captured() -> Iterator[tuple[str, ...]]:
    """Yield the coverage of ``captured_ci``, for means of 8 random points with p ∝ x^a."""
    for count in (100, 1000):
        for name, (power, f, half_width) in RATIOS.items():
            m = np.arange(-half_width, half_width + 1)
            grid = (np.arange(2**14) + 0.5) / 2**14
            c = (f(grid) * np.exp(-2j * np.pi * m[:, None] * grid)).mean(axis=1)

            # Compute variances by quadrature in y, with x = y⁴
            y = (np.arange(2**16) + 0.5) / 2**16
            density = (1 + power) * y ** (4 * power + 3) * 4
            first, second = (
                (_weighted(y**4, f, power, m, c) ** k * density).mean(axis=1) for k in (1, 2)
            )
            truth = np.divide(*(second - first**2))

            rng, inside, widths = np.random.default_rng(count), [], []
            for _ in range(REPETITIONS):
                x = rng.random((count, 8)) ** (1 / (1 + power))
                estimates = _weighted(x, f, power, m, c).mean(axis=-1)
                blocks = estimates.reshape(2, BATCH_SETTINGS.least, -1).var(axis=-1, ddof=1)
                factors = ratio_factors(
                    *blocks, np.full(BATCH_SETTINGS.least, 1 / BATCH_SETTINGS.least)
                )
                low, high = np.divide(*estimates.var(axis=-1, ddof=1)) * factors
                inside.append(low <= truth <= high)
                widths.append(high / low)
            yield str(count), name, f"{100 * np.mean(inside):.1f}", f"{np.median(widths):.2f}"


def _of_spectra() -> Iterator[tuple[str, ...]]:
    """Yield coverages for frequencies, rings, wedges and pair correlations of random points."""
    for count in (4, 10):
        hits: dict[str, list[np.ndarray]] = {}
        for seed in range(_RUNS):
            options = {"realizations": count, "rng": seed}
            d = mcs.power_spectrum("random", 64, half_width=4, wedges=6, **options)
            power, se = 64 * d["power"].values[5:].ravel(), 64 * d["power_se"].values[5:].ravel()
            factor = np.exp(d.attrs["student_t"] * se / power)
            ends = {"frequencies": np.stack([power / factor, power * factor], axis=-1)}
            ends["rings"] = 64 * d["radial_power_ci"].values
            ends["wedges"] = 64 * d["wedge_power_ci"].values
            g = mcs.pair_correlation("random", 256, bins=10, **options)
            ends["pair correlation"] = g["pair_correlation_ci"].values
            for name, each in ends.items():
                hits.setdefault(name, []).append((each[:, 0] <= 1) & (each[:, 1] >= 1))
        for name, own in hits.items():
            yield str(count), name, f"{100 * np.mean(own):.1f}"


def _of_anova() -> Iterator[tuple[str, ...]]:
    """Yield the coverage of intervals of ANOVA shares and of effective dimensions.

    The integrand is Π (1 + (x_i − ½) √(12 a_i)) with a = 1, ½, ⅕.
    """
    part = np.array([1.0, 0.5, 0.2])
    variance = np.prod(1 + part) - 1
    truth = {
        "anova_share": np.array([*part, *(part[[0, 0, 1]] * part[[1, 2, 2]])]) / variance,
        "higher_order_share": part.prod() / variance,
        "truncation_share": (np.cumprod(1 + part) - 1)[:2] / variance,
        "mean_dimension": (part / (1 + part)).sum() * (1 + variance) / variance,
        "effective_dimension_truncation": 3.0,
    }
    f = mcs.Integrand.from_function(
        lambda x: np.prod(1 + (x - 0.5) * np.sqrt(12 * part), axis=-1), dims=3
    )
    for count in (100, 1000):
        hits: dict[str, list[np.ndarray]] = {name: [] for name in truth}
        for seed in range(_RUNS):
            found = mcs.anova_variances(mcs.Estimator(f), realizations=count, rng=seed)
            for name, value in truth.items():
                low, high = found[f"{name}_ci"].values.reshape(-1, 2)[: np.size(value)].T
                hits[name].append((low <= value) & (value <= high))
        for name, own in hits.items():
            yield str(count), name, f"{100 * np.mean(own):.1f}"


def _of_integrals() -> Iterator[tuple[str, ...]]:
    """Yield the coverage of `mcspectra.integrate`."""
    for (name, (dims, f, integral)), sampler, budget in product(INTEGRALS.items(), SETS, BUDGETS):
        ends = np.array(
            [
                mcs.integrate(f, dims=dims, budget=budget, sampler=sampler, rng=seed)["interval"]
                for seed in range(_SEEDS)
            ]
        )
        yield name, sampler, str(budget), *_covered(ends, integral)


def _of_profiles() -> Iterator[tuple[str, ...]]:
    """Yield the coverage of the integral's interval in profiles, for integrands of one dim.

    The interval comes from scrambled nets, whichever of these samplers is profiled.
    """
    for name, budget in product(ANTIDERIVATIVES, BUDGETS):
        dims, f, integral = INTEGRALS[name]
        profiles = (mcs.profile(f, dims=dims, budget=budget, rng=k) for k in range(_SEEDS))
        yield name, str(budget), *_covered([each.interval for each in profiles], integral)


def _of_convergence() -> Iterator[tuple[str, ...]]:
    """Yield the coverage of the variances of `mcspectra.convergence` at three counts.

    In one dim, a scrambled Sobol' set of 2^k points has one point in each stratum.
    Its variance is therefore the variance of jittered points, the mean of those in strata over n.
    """
    for (name, antiderivatives), sampler in product(ANTIDERIVATIVES.items(), SETS):
        truth = [_variance(antiderivatives, n, strata=sampler != "random") for n in POINTS]
        for count in REALIZATIONS:
            f = INTEGRALS[name][1]
            ends = np.array(
                [
                    mcs.convergence(f, sampler, POINTS, dims=1, realizations=count, rng=seed)[
                        "variance_ci"
                    ]
                    for seed in range(_SEEDS)
                ]
            )
            for k, n in enumerate(POINTS):
                yield name, sampler, str(count), str(n), *_covered(ends[:, k], truth[k])


def _variance(
    antiderivatives: tuple[Callable[[np.ndarray], np.ndarray], ...], n: int, *, strata: bool
) -> float:
    """Return the exact variance of an estimate with n independent or n stratified points."""
    edges = np.linspace(0.0, 1.0, n + 1) if strata else np.array([0.0, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, square = (np.diff(each(edges)) * (len(edges) - 1) for each in antiderivatives)
    return float((square - mean**2).mean() / n)


def _covered(ends: Any, truth: float) -> tuple[str, ...]:
    """Return percentages: covered, truth above and below the interval, and infinite intervals.

    An interval without an upper end contains each value above its lower end.
    """
    ends = np.asarray(ends)
    low, high = 100 * (truth < ends[:, 0]).mean(), 100 * (truth > ends[:, 1]).mean()
    opened = 100 * np.isinf(ends).any(axis=1).mean()
    return f"{100 - low - high:.1f}", f"{high:.1f}", f"{low:.1f}", f"{opened:.1f}"


def _print(header: str, rows: Iterator[tuple[str, ...]]) -> None:
    names = header.split(" | ")
    print(f"| {header} |\n|{'---|' * len(names)}")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)
    print()


def _of_frames() -> Iterator[tuple[Any, ...]]:
    """Yield the coverage of the mean variance over the 48 × 64 pixels of a few frames.

    The standard deviation of a pixel grows from 0.22 to 4.5 over the image.
    Intervals without an upper end count as covering.
    For comparison, the error of each variance is also taken from the values of its pixel alone.
    """
    from mcspectra.rendering.frame_statistics import _MISSED, _variance_of_variance

    size = np.exp(np.linspace(-1.5, 1.5, 64)) * np.ones((48, 64))
    z = float(ndtri(0.975))
    laws = {name: LAWS[name][:2] for name in ("normal", "t(5)", "exponential")}
    square = np.exp(0.49)
    laws["lognormal(0.7)"] = (
        lambda rng, s: np.exp(0.7 * rng.standard_normal(s)),
        square * (square - 1),
    )
    for (name, (draw, variance)), count in product(laws.items(), (2, 3, 6, 12)):
        truth = variance * float((size**2).mean())
        covered, opened = np.zeros(2), 0
        for seed in range(FRAME_SEEDS):
            values = draw(np.random.default_rng(10_000 + seed), (count, *size.shape)) * size
            moments = Moments.of(values)
            total = moments.variance.sum()
            alone = float(np.sqrt(((moments.relative_se * moments.variance) ** 2).sum()) / total)
            least = (2 / (count + 1) * moments.variance**2).sum()
            pooled = float(np.sqrt(max(_variance_of_variance(moments).sum(), least)) / total)
            farthest = np.abs(values - moments.mean).max() ** 2
            end = np.inf if farthest > 0.05 * moments.m2.sum() else 1.0
            opened += end > 1.0
            mean = total / size.size
            for k, (error, missed) in enumerate(((alone, 0.0), (pooled, _MISSED))):
                low, high = mean * np.exp(z * error * np.array([-1.0, 1.0 + missed * error]))
                covered[k] += low < truth < high * end
        rates = 100 * np.array([*covered, opened]) / FRAME_SEEDS
        yield (str(count), name, *(f"{rate:.1f}" for rate in rates))


def main(*flags: str) -> None:
    """Print the coverage of each type of interval in percent."""
    if "--answers" in flags:
        _print_answers()
        return
    columns = "frames | law | covered, pixels alone | covered | no upper end"
    _print(columns, _of_frames())
    if "--frames" in flags:
        return
    columns = "values | law | kurtosis | covered | truth above | below"
    _print(f"{columns} | no upper end | all equal | upper end / s² (median)", _of_variances())
    _print("realizations | captured | covered | ends' ratio (median)", _of_captured())
    _print("realizations | interval | covered", _of_spectra())
    _print("pairs | interval | covered", _of_anova())
    _print_answers()


def _print_answers() -> None:
    """Print the coverage of the intervals of `integrate`, `profile` and `convergence`."""
    found = "covered | truth above | below | infinite"
    _print(f"convergence | sampler | realizations | n | {found}", _of_convergence())
    _print(f"integrate | sampler | budget | {found}", _of_integrals())
    _print(f"profile | budget | {found}", _of_profiles())


if __name__ == "__main__":
    main()
