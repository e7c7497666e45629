"""Variance of changed estimators relative to plain estimators at equal cost, including pilots.

Each budget is 2^14 evaluations, of which the pilot uses 2^11.
Variances come from new samples, measured by `mcspectra.convergence`.
With nets, the plain and the changed estimator use the largest power of two within the budget.
A pilot is a set of evaluations to which changes are fitted.
Each printed ratio is the median over several pilots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy.special import ndtr, ndtri

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.improve.improved import CHANGES, evaluated, improvements
from mcspectra.measure.setup import Setup

BUDGET, PILOT = 2**14, 2**11
PILOTS, REALIZATIONS = 3, 64
SAMPLERS = ("random", "sobol | owen")
STEPS, VOLATILITY = 16, 0.4

Problem = tuple[str, int, Callable[[Array], Array], float]


def _normal(x: Array) -> Array:
    return np.asarray(ndtri(np.clip(x, 1e-300, 1.0 - 2.0**-53)))


def _asian(x: Array) -> Array:
    """Payoff of a call option on the geometric mean of 16 prices; strike and first price are 1."""
    time = np.arange(1, STEPS + 1) / STEPS
    walk = np.cumsum(_normal(x), axis=-1) / math.sqrt(STEPS)
    mean = (VOLATILITY * walk - 0.5 * VOLATILITY**2 * time).mean(axis=-1)
    return np.asarray(np.maximum(np.exp(mean) - 1.0, 0.0))


def _asian_value() -> float:
    time, weights = np.arange(1, STEPS + 1) / STEPS, np.arange(STEPS, 0, -1) / STEPS
    mean = -0.5 * VOLATILITY**2 * time.mean()
    spread = VOLATILITY * math.sqrt((weights**2).sum() / STEPS)
    d = (mean + spread**2) / spread
    return float(math.exp(mean + 0.5 * spread**2) * ndtr(d) - ndtr(d - spread))


def problems() -> Iterator[Problem]:
    """Yield names, dims, functions and integrals."""
    slopes = np.arange(1.0, 6.0) / 5.0
    yield (
        "peak, 3-D",
        3,
        lambda x: np.exp(-((x - 0.4) ** 2).sum(-1) / 8e-4),
        (8e-4 * math.pi) ** 1.5,
    )
    yield "digital, 16-D", 16, lambda x: (_normal(x).sum(-1) > 1.0) * 1.0, float(ndtr(-0.25))
    yield "rare digital, 16-D", 16, lambda x: (_normal(x).sum(-1) > 8.0) * 1.0, float(ndtr(-2.0))
    yield "Asian, 16-D", STEPS, _asian, _asian_value()
    yield (
        "smooth, 5-D",
        5,
        lambda x: np.exp(x * slopes).prod(-1),
        float((np.expm1(slopes) / slopes).prod()),
    )
    yield "product, 10-D", 10, lambda x: (3.0 * x - 0.5).prod(-1), 1.0
    yield "half-plane, 2-D", 2, lambda x: (x @ (0.6, 0.8) < 0.7) * 1.0, 0.5


def _variance(estimator: AbstractEstimator, sampler: str, seed: int) -> float:
    """Return the variance of an estimate that takes at most BUDGET evaluations.

    Some estimators are fitted to a pilot run, whose evaluations count toward BUDGET.
    """
    n = (BUDGET - estimator.pilot_evaluations) // estimator.evaluations_per_point
    n = n if sampler == "random" else 1 << (n.bit_length() - 1)
    found = mcs.convergence(estimator, sampler, [n], realizations=REALIZATIONS, rng=seed)
    return float(found["variance"][0])


def main() -> None:
    """Print ratios, and the largest deviation of a mean from the integral, in standard errors."""
    for problem, dims, f, integral in problems():
        plain = mcs.Estimator(mcs.Integrand.from_function(f, dims=dims, integral=integral))
        given = Setup(plain, mcs.sampler("random", dims=dims))
        before = {sampler: _variance(plain, sampler, 1) for sampler in SAMPLERS}
        found: dict[str, list[tuple[float, ...]]] = {}
        for seed in range(PILOTS):
            for kind in CHANGES:
                seen = evaluated(plain, PILOT, Stream.from_rng(seed), adapt=kind == "fitted")
                for made in improvements(given, seen, [kind], charged=PILOT):
                    e = made.setup.estimator
                    values = e.primary_values(0, np.random.default_rng(7).random((2**15, dims)))
                    away = (values.mean() - integral) / (values.std() / math.sqrt(len(values)))
                    name = made.name.split(" axis")[0]
                    ratios = [_variance(e, s, 2 + seed) / before[s] for s in SAMPLERS]
                    found.setdefault(name, []).append((made.ratio, *ratios, abs(away)))
        for name, rows in found.items():
            expected, random, nets, _ = np.median(rows, axis=0)
            print(
                f"{problem:20} {name:42} expected × {expected:8.3g}  random × {random:8.3g}  nets "
                "× "
                f"{nets:8.3g}  bias {max(row[-1] for row in rows):.1f} σ",
                flush=True,
            )


if __name__ == "__main__":
    main()
