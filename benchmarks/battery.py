"""Profiles of estimators with known problems: is the cause found, and is the advice good?

Each case has a function or estimator with a sampler, and its true integral.
A case also lists the causes that the profile may report first.
A profile has a budget of 8,192 evaluations.
The benchmark checks five properties of the profile of each case:

* The interval of the profile contains the integral.
* The error of the recommended set-up at the budget is the measured one within a factor of 1.5.
  The measured error is the root mean square of the errors of 1,000 estimates at the same count.
  If the profile states that the error is "at most" a number, the measured error is at most this.
  The profile's interval of the error contains the measured error.
* The first reported cause is an expected cause.
* The recommended change lowers the variance.
  The variances before and after the change are measured again, at the same counts.
* The rate with scrambled nets has an error of at most 0.1, or its interval contains the true rate.
  The true rate comes from 10,000 realizations at the last counts of the curve.
  The budget is 8,192 or 262,144 evaluations.

No rate is reported for an infinite variance.
If f jumps along an axis, its true rate is measured at 16 to 4,096 points,
because the local rates of the same f vary between −1 and −3.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.explain.samples import Curve

BUDGET, MORE = 8192, 262_144
REALIZATIONS = 1000
FACTOR = 1.5  # largest allowed ratio of a stated error to the measured error
OF_RATES = 10_000  # number of realizations for reference rates
SAW = tuple(2**k for k in range(4, 13))
WITHIN = 0.1


@dataclass(frozen=True)
class Case:
    """A test case: an estimator whose cause of noise is known."""

    name: str
    f: Any
    dims: int
    integral: float
    causes: tuple[str, ...]
    sampler: str = "random"


def _inner(x: Array) -> Array:
    """Move points away from the faces, where normal quantiles are infinite."""
    return np.clip(x, 1e-300, 1.0 - 2.0**-53)


def _normal(x: Array) -> Array:
    return np.asarray(ndtri(_inner(x)))


def _simplex(d: int, t: float) -> float:
    """Return P(x_1 + … + x_d < t) by the Irwin–Hall distribution."""
    return sum(
        (-1) ** k * math.comb(d, k) * (t - k) ** d for k in range(math.floor(t) + 1)
    ) / math.factorial(d)


def _call(spots: Array, strike: float) -> Array:
    return np.maximum(spots - strike, 0.0)


def _black_scholes(sigma: float, strike: float) -> float:
    d1 = (-math.log(strike) + 0.5 * sigma**2) / sigma
    return float(ndtr(d1) - strike * ndtr(d1 - sigma))


def cases() -> Iterator[Case]:
    """Yield all cases, smooth cases first."""
    e = math.e - 1.0

    # Smooth functions, for which no cause of noise is reported
    def none(name: str, f: Callable[[Array], Array], dims: int, integral: float) -> Case:
        return Case(name, f, dims, integral, ("none",))

    yield none("exp, 1-D", lambda x: np.exp(x[:, 0]), 1, e)
    yield none("exp, 3-D", lambda x: np.exp(x.sum(axis=1)), 3, e**3)
    yield none("wave", lambda x: 1.0 + np.cos(6 * np.pi * x[:, 0]), 1, 1.0)
    yield none(
        "Genz product peak",
        lambda x: 1.0 / (0.25 + (x - 0.4) ** 2).prod(axis=1),
        2,
        (2.0 * (math.atan(1.2) + math.atan(0.8))) ** 2,
    )
    yield none(
        "weights that fall",
        lambda x: (1.0 + (x - 0.5) / np.arange(1, 11) ** 2).prod(axis=1),
        10,
        1.0,
    )
    yield none("bilinear", lambda x: x[:, 0] * x[:, 1], 2, 0.25)

    # Jumps in the interior
    inside = ("interior-jump",)
    yield Case("quarter disk", lambda x: ((x**2).sum(axis=1) < 1.0) * 1.0, 2, math.pi / 4, inside)
    yield Case("half-space", lambda x: (x @ (0.6, 0.8) < 0.7) * 1.0, 2, 0.5, inside)
    yield Case("ball", lambda x: ((x**2).sum(axis=1) < 1.0) * np.exp(x[:, 0]), 3, math.nan, inside)
    yield Case("simplex in 5-D", lambda x: (x.sum(axis=1) < 2.0) * 1.0, 5, _simplex(5, 2.0), inside)
    yield Case(
        "digital option in 16-D",
        lambda x: (_normal(x).sum(axis=1) > 1.0) * 1.0,
        16,
        float(ndtr(-0.25)),
        (*inside, "high-dimension"),
    )
    yield Case(
        "diagonal edge on a slope",
        lambda x: np.where(x[:, 0] < x[:, 1], 1.0, 3.0) + x[:, 0],
        2,
        2.5,
        inside,
        "jittered",
    )

    # Jumps along axes
    straight = ("axis-parallel-jump",)
    yield Case("step", lambda x: (x[:, 0] < 0.377) * 1.0, 1, 0.377, straight)
    yield Case("step in 2-D", lambda x: (x[:, 0] < 0.377) * x[:, 1], 2, 0.377 / 2, straight)
    yield Case(
        "box in 3-D",
        lambda x: ((x < 0.7).all(axis=1)) * 1.0,
        3,
        0.343,
        straight,
        "latin-hypercube",
    )
    yield Case(
        "Genz discontinuous",
        lambda x: np.where((x < (0.31, 0.62)).all(axis=1), np.exp(x.sum(axis=1)), 0.0),
        2,
        (math.exp(0.31) - 1) * (math.exp(0.62) - 1),
        straight,
    )

    # Kinks
    kink = ("kink",)
    yield Case("absolute value", lambda x: np.abs(x[:, 0] - 0.3), 1, 0.29, kink)
    yield Case(
        "Genz continuous",
        lambda x: np.exp(-2 * np.abs(x - 0.4).sum(axis=1)),
        2,
        ((2 - math.exp(-0.8) - math.exp(-1.2)) / 2) ** 2,
        kink,
    )
    yield Case(
        "roof", lambda x: np.maximum(x.sum(axis=1) - 1.0, 0.0), 2, 1.0 / 6.0, kink, "jittered"
    )
    yield Case("hinge in 4-D", lambda x: np.maximum(x @ (1, -1, 0.5, 0.2), 0.0), 4, math.nan, kink)

    # f differs between opposite faces of the cube, and shifted points wrap around at the faces
    faces = ("border-jump",)
    yield Case("ramp, shifted", lambda x: x[:, 0], 1, 0.5, faces, "jittered | shift")
    yield Case("ramps, lattice", lambda x: x @ (1.0, 2.0), 2, 1.5, faces, "rank1-lattice | shift")
    yield Case(
        "exp, Halton shifted", lambda x: np.exp(x.sum(axis=1)), 2, e**2, faces, "halton | shift"
    )

    # f grows without bound toward the border of the cube
    grows = ("border-growth",)
    yield Case("root", lambda x: _inner(x[:, 0]) ** -0.3, 1, 1 / 0.7, grows)
    yield Case("root in 2-D", lambda x: _inner(x[:, 1]) ** -0.25 * x[:, 0], 2, 2 / 3, grows)
    yield Case("lognormal", lambda x: np.exp(_normal(x[:, 0])), 1, math.exp(0.5), grows)
    yield Case(
        "lognormal in 2-D", lambda x: np.exp(_normal(x) @ (0.9, 0.4)), 2, math.exp(0.485), grows
    )

    # Infinite variance
    infinite = ("infinite-variance",)
    yield Case("pole", lambda x: 1.0 / (x[:, 0] - 0.5 + 1e-300), 1, math.nan, infinite)
    yield Case("steep edge", lambda x: _inner(x[:, 0]) ** -0.6, 1, 2.5, infinite)
    yield Case("steep edge in 3-D", lambda x: _inner(x[:, 2]) ** -0.7, 3, 1 / 0.3, infinite)
    yield Case(
        "pole inside",
        lambda x: np.abs(x[:, 0] - 0.3) ** -0.7,
        1,
        (0.3**0.3 + 0.7**0.3) / 0.3,
        infinite,
    )

    # Cases in which a few large values make most of the variance
    heavy = ("heavy-tail",)
    yield Case(
        "peak",
        lambda x: np.exp(-((x - 0.4) ** 2).sum(axis=1) / 8e-4),
        3,
        (2 * math.pi * 4e-4) ** 1.5,
        heavy,
    )
    yield Case(
        "ridge of vegas",
        lambda x: np.exp(-100 * ((x - 0.5) ** 2).sum(axis=1)),
        4,
        (math.pi / 100) ** 2 * math.erf(5) ** 4,
        heavy,
    )
    yield Case(
        "peaks of a detector",
        lambda x: 1e-3 / (1e-6 + (x[:, 0] - 0.31) ** 2),
        1,
        math.atan(310.0) + math.atan(690.0),
        heavy,
    )

    # Cases with interactions of many dims
    many = ("high-dimension",)
    yield Case(
        "product of 10", lambda x: (3 * x - 0.5).prod(axis=1), 10, 1.0, (*many, "heavy-tail")
    )
    yield Case(
        "waves of 8 dims",
        lambda x: (1 + 0.9 * np.cos(2 * np.pi * x)).prod(axis=1),
        8,
        1.0,
        many,
    )

    # In these two cases, the sampler draws the same points in every realization
    yield Case("the same set", lambda x: np.exp(x[:, 0]), 1, e, ("deterministic-set",), "regular")
    yield Case(
        "the same set in 2-D",
        lambda x: np.exp(x.sum(axis=1)),
        2,
        e**2,
        ("deterministic-set",),
        "sobol",
    )
    # One of the two techniques misses the peak of the integrand
    yield Case(
        "a technique that does not see the peak",
        mcs.MultipleImportance(
            mcs.integrand("gaussian(width=0.05)", dims=2),
            ["truncated-normal(sigma=0.05)", "uniform"],
            counts=(1, 1),
        ),
        2,
        float(mcs.integrand("gaussian(width=0.05)", dims=2).integral),
        ("slow-technique", "none"),
    )
    # The payoff of a call option has a kink
    yield Case(
        "call option",
        lambda x: _call(np.exp(0.2 * _normal(x[:, 0]) - 0.02), 1.0),
        1,
        _black_scholes(0.2, 1.0),
        kink,
    )


@dataclass(frozen=True)
class Outcome:
    """The profile of a test case, compared with measurements. None marks a missing comparison."""

    case: Case
    found: mcs.Profile
    seconds: float
    covers: bool | None
    rates: tuple[tuple[Curve, float], ...]
    ratio: float
    rmse: float  # measured error of the recommended set-up, at the count of the profile's error

    @property
    def stated(self) -> float:
        """Ratio of the error that the profile states to the measured error."""
        return self.found.answer.rmse / self.rmse

    @property
    def holds_error(self) -> bool:
        """Whether the stated interval of the error contains the measured error.

        The measured error has a relative standard error of about 2 % for normal estimates.
        """
        low, high = self.found.answer.rmse_ci
        return low * 0.96 <= self.rmse <= high * 1.04

    @property
    def names_cause(self) -> bool:
        """Whether the first reported cause is right."""
        return self.found.causes[0].name in self.case.causes


def near(curve: Curve, rate: float) -> bool:
    """Whether the error of a rate is at most 0.1."""
    return abs(curve.rate - rate) <= WITHIN


def near_or_within(curve: Curve, rate: float) -> bool:
    """Whether the error of a rate is at most 0.1, or its interval contains the true rate."""
    low, high = curve.rate_ci
    return near(curve, rate) or low <= rate <= high


def judge(case: Case, seed: int = 0) -> Outcome:
    """Profile a case, and compare the profile with measurements."""
    dims = case.dims if callable(case.f) and not hasattr(case.f, "counts") else None
    start = time.perf_counter()
    found = mcs.profile(case.f, sampler=case.sampler, dims=dims, budget=BUDGET, rng=seed)
    seconds = time.perf_counter() - start
    low, high = found.interval
    covers = None if math.isnan(case.integral) or math.isinf(low) else low <= case.integral <= high
    estimator = (
        case.f
        if dims is None
        else mcs.Estimator(
            mcs.Integrand.from_function(
                lambda x: case.f(x.reshape(-1, dims)).reshape(x.shape[:-1]),
                dims=dims,
                integral=0.0 if math.isnan(case.integral) else case.integral,
            )
        )
    )
    again = mcs.profile(case.f, sampler=case.sampler, dims=dims, budget=MORE, rng=seed)
    rates = []
    for curve in (p.samplers.get("sobol | owen") for p in (found, again)):
        if curve is None or len(curve.counts) <= 3 or not curve.rate_se > 0.0:
            continue
        counts = SAW if "axis-parallel-jump" in case.causes else [int(n) for n in curve.counts[-4:]]
        measured = mcs.convergence(
            estimator, "sobol | owen", counts, realizations=OF_RATES, rng=seed + 1
        )
        rate = float(measured["rate"])
        if math.isfinite(rate):
            rates.append((curve, rate))
    ratio = math.nan
    best, rmse = found.answer.best, math.nan
    if not math.isnan(case.integral) and best.setup is not None and best.rmse > 0.0:
        measured = mcs.convergence(
            best.estimator, best.sampler, [best.n], realizations=REALIZATIONS, rng=seed + 3
        )
        rmse = math.sqrt(float(measured["variance"][0]) or float(measured["mse"][0]))
    if found.answer.changes:
        changed = best.estimator
        n = max(int(c.counts[-1]) for c in found.samplers.values() if len(c.counts))
        pair = []
        for each, name, size in (
            (changed, best.sampler.spec, n // changed.evaluations_per_point),
            (estimator, found.given, n),
        ):
            source = mcs.sampler(name, dims=estimator.dims)
            count = source.nearest_count(max(size, 1))
            measured = mcs.convergence(
                each, source, [count], realizations=REALIZATIONS, rng=seed + 2
            )
            # Deterministic sets have a bias instead of a variance
            pair.append(float(measured["variance"][0]) or float(measured["mse"][0]))
        ratio = pair[0] / max(pair[1], 1e-300)
    return Outcome(case, found, seconds, covers, tuple(rates), ratio, rmse)


def main() -> None:
    """Print a line for each case, and the fractions of right results."""
    outcomes = []
    for case in cases():
        found = judge(case)
        outcomes.append(found)
        first = found.found.causes[0].name
        answer = found.found.answer
        best = answer.best.name if answer.changes else "-"
        rates = ", ".join(f"{c.rate:.2f} ± {c.rate_se:.2f} ({r:.2f})" for c, r in found.rates)
        print(
            f"{case.name:40} {first:20} {'' if found.names_cause else 'WRONG':6}"
            f"rates {rates:44} {best:16} × {found.ratio:8.3g} "
            f"RMSE × {found.stated:.3g} {found.seconds:.2f} s",
            flush=True,
        )

    def share(name: str, values: list[bool]) -> None:
        print(f"{name}: {sum(values)} of {len(values)}")

    share("cause", [o.names_cause for o in outcomes])
    share("interval", [o.covers for o in outcomes if o.covers is not None])
    # An infinite error, which is right for an infinite variance, has no measured value
    known = [o for o in outcomes if math.isfinite(o.stated)]
    exact = [o for o in known if not o.found.answer.best.is_bounded]
    share(
        f"stated error within a factor of {FACTOR}",
        [1.0 / FACTOR <= o.stated <= FACTOR for o in exact],
    )
    share("error stated as a bound", [o.holds_error for o in known if o not in exact])
    share("interval of the error", [o.holds_error for o in known])
    for k, budget in enumerate((BUDGET, MORE)):
        some = [o.rates[k] for o in outcomes if len(o.rates) > k]
        share(f"rate to 0.1 by {budget:,} evaluations", [near(*each) for each in some])
        share("rate to 0.1 or within its interval", [near_or_within(*each) for each in some])
    share(
        "advice lowers the variance", [o.ratio < 1.0 for o in outcomes if not math.isnan(o.ratio)]
    )
    fine = [o for o in outcomes if o.found.causes[0].name == "none"]
    share("no broken case is called fine", ["none" in o.case.causes for o in fine])
