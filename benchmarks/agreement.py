"""Compare the answers of profile, remedies, plan and predict with those of brute force.

The benchmark has sixty estimators with and without importance densities.
The estimators include multiple importance sampling, pixels of scenes, and light paths.
Profile and remedies search for the best set-up with 4,096 evaluations.
Brute force then measures the RMSE of the given and of the recommended set-ups.
Brute force makes 1,000 new estimates for each set-up, but only 200 for pixels and paths.
A function agrees with brute force under these conditions:

* `profile`: for the recommended set-up, its RMSE interval overlaps the interval by brute force;
* `remedies`: the recommended set-up is the same as in the profile.
    A different set-up is accepted if its RMSE intervals by `profile` and `remedies` overlap.
    For example, one function may recommend a preintegration, and the other a regression.
    A different set-up is also accepted if both set-ups have the same RMSE within their intervals;
* `plan`: it gets the RMSE by brute force as its target, and returns an interval of n.
  The interval of n from `plan` overlaps a reference interval around the n of brute force.
  Brute force also gives an interval of the RMSE. Both of its ends are converted to values of n,
  which are the ends of the reference interval of n;
* `predict`: its RMSE interval at 4,096 evaluations overlaps the interval by brute force.

An interval with an unknown end counts as overlapping.
In addition, no recommended set-up may be worse than the given set-up.
No function may use more evaluations than its budget.
"""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtri

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.measure.setup import Setup, affordable_count

BUDGET = 4096
# Brute force draws this many independent estimates: ESTIMATES for a function, RENDERED for a scene
ESTIMATES, RENDERED = 1000, 200
REALIZATIONS = 100  # realizations of each candidate in remedies
KINDS = (
    *("sampler", "unshifted", "mirrored", "regression", "preintegrated", "fitted", "periodized"),
    "techniques",
)
SIGMAS = 1.96


@dataclass(frozen=True)
class Case:
    """A test case of this benchmark: an estimator, and the sampler with which it is used."""

    name: str
    estimator: AbstractEstimator
    sampler: str
    kinds: tuple[str, ...] = KINDS
    estimates: int = ESTIMATES


@dataclass
class Found:
    """Texts about one estimator, in four lists.

    The lists hold disagreements, recommendations with a larger RMSE, exceeded budgets and answers.
    """

    wrong: list[str] = field(default_factory=list)
    worse: list[str] = field(default_factory=list)
    spent: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)


def _normal(x: Array) -> Array:
    return np.asarray(ndtri(np.clip(x, 1e-300, 1.0 - 2.0**-53)))


def _asian(x: Array) -> Array:
    """An arithmetic Asian call with 16 dates."""
    steps = _normal(x) * 0.2 / 4.0
    paths = np.exp(np.cumsum(steps - 0.5 * (0.2 / 4.0) ** 2, axis=-1))
    return np.asarray(np.maximum(100.0 * paths.mean(axis=-1) - 100.0, 0.0))


def functions() -> Iterator[tuple[str, Callable[[Array], Array], int]]:
    """Functions of one to sixteen dims, with their number of dims."""
    yield "exp", lambda x: np.exp(x.sum(axis=-1)), 1
    yield "exp", lambda x: np.exp(x.sum(axis=-1)), 2
    yield "exp", lambda x: np.exp(x.sum(axis=-1)), 3
    yield "exp", lambda x: np.exp(0.5 * x.sum(axis=-1)), 6
    yield "oscillatory", lambda x: np.cos(1.0 + x @ np.array([1.0, 0.5, 0.8, 0.3, 0.6])), 5
    yield "product peak", lambda x: (1.0 / (1.0 + (x - 0.4) ** 2)).prod(axis=-1), 4
    yield "corner peak", lambda x: (1.0 + x.sum(axis=-1)) ** -4.0, 3
    yield "periodic", lambda x: (1.0 + 0.5 * np.cos(2.0 * np.pi * x)).prod(axis=-1), 4
    yield "periodic", lambda x: np.exp(np.sin(2.0 * np.pi * x).sum(axis=-1)), 2
    yield "bilinear", lambda x: x[..., 0] * x[..., 1], 2
    yield "weights that fall", lambda x: (1 + (x - 0.5) / np.arange(1, 11) ** 2).prod(axis=-1), 10
    yield "Gaussian peak", lambda x: np.exp(-50.0 * ((x - 0.3) ** 2).sum(axis=-1)), 2
    yield "Gaussian peak", lambda x: np.exp(-20.0 * ((x - 0.3) ** 2).sum(axis=-1)), 4
    yield "disk", lambda x: ((x**2).sum(axis=-1) < 1.0) * 1.0, 2
    yield "half-space", lambda x: (x @ np.array([0.6, 0.8]) < 0.7) * 1.0, 2
    yield "ball", lambda x: ((x**2).sum(axis=-1) < 1.0) * np.exp(x[..., 0]), 3
    yield "simplex", lambda x: (x.sum(axis=-1) < 2.0) * 1.0, 5
    yield "digital option", lambda x: (_normal(x).sum(axis=-1) > 1.0) * 1.0, 16
    yield "step", lambda x: (x[..., 0] < 0.377) * 1.0, 1
    yield "step", lambda x: (x[..., 0] < 0.377) * (1.0 + x[..., 1]), 2
    yield "step", lambda x: (x[..., 0] < 0.377) * (1.0 + x.sum(axis=-1)), 4
    yield "kink", lambda x: np.abs(x.sum(axis=-1) - 0.8), 2
    yield "kink", lambda x: np.abs(x[..., 0] - 0.37) * (1.0 + x[..., 1]), 2
    yield "call", lambda x: np.maximum(np.exp(0.3 * _normal(x).sum(axis=-1)) - 1.0, 0.0), 5
    yield "Asian option", _asian, 16
    yield "cusp", lambda x: np.sqrt(np.abs(x.sum(axis=-1) - 0.9)), 2
    yield "pole", lambda x: x[..., 0] ** -0.3, 1
    yield "pole", lambda x: (x[..., 0] * x[..., 1]) ** -0.2, 2
    yield "waves", lambda x: 1.0 + np.cos(60.0 * x[..., 0]) * x[..., 1], 2
    yield "sum", lambda x: np.exp(x[..., 0]) + x.sum(axis=-1), 8


def cases() -> Iterator[Case]:
    """Yield all cases."""
    for number, (name, f, dims) in enumerate(functions()):
        sampler = ("random", "jittered", "sobol | owen")[number % 3]
        sampler = "random" if sampler == "jittered" and dims > 3 else sampler
        yield Case(f"{name}, {dims}-D", as_estimator(f, dims), sampler)
    for spec, density, dims in (
        ("gaussian", "uniform", 2),
        ("gaussian(width=0.1)", "linear", 2),
        ("disk", "linear", 2),
        ("christensen-disk", "uniform", 2),
        ("christensen-gaussian", "uniform", 2),
        ("step(at=0.3)", "linear(slope=0.9)", 1),
        ("polynomial(coefficients=[0.5, 0, 1])", "piecewise-constant(values=[1, 2, 3])", 1),
        ("disk", "uniform", 2),
        ("linear", "uniform", 1),
        ("half-space(normal=[1, 1, 1], offset=1.2)", "uniform", 3),
    ):
        sampler = "jittered | shift" if dims < 3 else "sobol | owen"
        yield Case(f"{spec} by {density}", mcs.Estimator(spec, density, dims=dims), sampler)
    for spec, densities, dims in (
        ("gaussian", ["uniform", "linear"], 2),
        ("polynomial(coefficients=[0.5, 0, 1])", ["uniform", "linear"], 1),
        ("disk", ["uniform", "linear"], 2),
        ("christensen-gaussian", ["uniform", "linear"], 2),
        ("step(at=0.3)", ["uniform", "linear(slope=0.9)"], 1),
        ("gaussian(width=0.1)", ["uniform", "linear"], 2),
    ):
        mis = mcs.MultipleImportance(spec, densities, dims=dims)
        kinds = ("sampler", "heuristic", "techniques")
        yield Case(f"MIS of {spec}", mis, "jittered", kinds)
    try:
        from mcspectra.rendering import PathPixel
    except ImportError:
        print("Pixels and paths are skipped, because Mitsuba is missing.")
        return
    few = ("sampler", "mirrored", "preintegrated")
    for x, y in ((96, 205), (150, 200), (250, 180), (300, 230)):
        pixel = mcs.Estimator(mcs.integrand(f"pixel(scene='figure1', x={x}, y={y})"))
        yield Case(f"pixel ({x}, {y})", pixel, "random", few, RENDERED)
    for x, y in ((32, 36), (20, 30), (40, 40), (50, 20)):
        pixel = mcs.Estimator(
            mcs.integrand(f"pixel(scene='penumbra(width=64, height=48)', x={x}, y={y})")
        )
        yield Case(f"penumbra ({x}, {y})", pixel, "sobol | owen", few, RENDERED)
    for x, y in ((32, 36), (20, 30), (40, 40)):
        scene = "penumbra(width=64, height=48)"
        path = PathPixel(scene=scene, x=x, y=y, integrator="path(max_depth=3)")
        yield Case(f"path ({x}, {y})", mcs.Estimator(path), "random", ("sampler",), RENDERED)
    for x, y in ((96, 205), (300, 300), (500, 400)):
        path = PathPixel(scene="veach", x=x, y=y, integrator="path(max_depth=4)")
        yield Case(
            f"path of plates ({x}, {y})", mcs.Estimator(path), "random", ("sampler",), RENDERED
        )


def _brute(setup: Setup, n: int, estimates: int, seed: int) -> tuple[float, float, float]:
    """Return the RMSE and the ends of its 95 % interval."""
    found = mcs.convergence(setup.estimator, setup.sampler, [n], realizations=estimates, rng=seed)
    low, high = np.atleast_2d(found["variance_ci"].values.squeeze())[0]
    return tuple(
        math.sqrt(max(float(v), 0.0)) for v in (found["variance"].values.ravel()[0], low, high)
    )


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two intervals overlap up to rounding; an interval with a NaN end overlaps all."""
    if any(math.isnan(v) for v in (*one, *other)):
        return True
    tiny = 1e-13
    return one[0] <= other[1] + tiny and other[0] <= one[1] + tiny


def judge(case: Case, seed: int = 0) -> Found:
    """Run all functions on a case, and compare them with brute force."""
    estimator, found = case.estimator, Found()
    given = Setup(estimator, mcs.sampler(case.sampler, dims=estimator.dims))
    profile = mcs.profile(estimator, sampler=case.sampler, budget=BUDGET, rng=seed)
    answer = profile.answer
    best = Setup(answer.best.estimator, answer.best.sampler)
    if profile.calls > BUDGET:
        found.spent.append(f"profile {profile.calls}")
    n = affordable_count(given, BUDGET) or 1
    before = _brute(given, n, case.estimates, seed + 1)
    after = _brute(best, answer.best.n, case.estimates, seed + 1)
    found.words.append(
        f"profile: {answer.best.name}, RMSE {answer.rmse:.2g}, measured {after[0]:.2g}"
    )
    if not _overlap(answer.rmse_ci, after[1:]):
        low, high = answer.rmse_ci
        found.wrong.append(f"profile {low:.2g} to {high:.2g}")
    if after[1] > before[2] * 1.001:
        found.worse.append(f"profile {after[0] / before[0]:.2g}")

    # Find remedies for the same budget
    try:
        table = mcs.remedies(
            estimator,
            case.sampler,
            BUDGET,
            realizations=REALIZATIONS,
            rng=seed + 2,
            kinds=case.kinds,
        )
        other = json.loads(table.attrs["best"])
        found.words.append(f"remedies: {other['name']}, RMSE {other['rmse']:.2g}")
        same = other["name"] == answer.best.name or (
            other["name"] == "as given" and not answer.changes
        )
        ends, own = other["rmse_ci"], after[1:]
        same |= any(
            each.name.split()[0] == other["name"].split()[0] and _overlap(each.rmse_ci, tuple(ends))
            for each in answer.results
        )
        if other["name"] == "as given" and not _overlap(tuple(ends), before[1:]):
            found.wrong.append(f"remedies {ends[0]:.2g} to {ends[1]:.2g}")
        low, high = answer.rmse_ci
        if not (same or _overlap(tuple(ends), own) or _overlap(tuple(ends), (low, high))):
            found.wrong.append(f"remedies' {other['name']}, not {answer.best.name}")
        if other["rmse"] > before[2] * 1.001:
            found.worse.append(f"remedies {other['rmse'] / before[0]:.2g}")
    except McspectraError as error:
        found.words.append(f"remedies: {error}")

    # Plan for the RMSE of the given set-up, and predict the variance
    slope = profile.rate if profile.rate < 0.0 else -1.0
    if min(before) > 0.0 and max(before) < math.inf:
        low, high = (n * (before[0] / end) ** (2.0 / slope) for end in before[1:])
        # Nets are planned only at powers of their base
        reached = (low, max([high, *(float(n * base) for base in given.sampler.digit_bases)]))
        plan = mcs.plan(estimator, case.sampler, target_error=before[0], rng=seed + 3)
        ends = tuple(np.ravel(plan["planned_n_ci"].values))
        found.words.append(f"plan: {float(plan['planned_n']):.0f} of {n}")
        if not _overlap(ends, reached):
            # The error of strata at a jump oscillates with n, so fewer points can be enough
            there = _brute(given, math.ceil(ends[1]), case.estimates, seed + 1)
            if ends[0] > reached[1] or there[1] > before[2]:
                found.wrong.append(f"plan {ends[0]:.0f} to {ends[1]:.0f}, not {n}")
    predicted = mcs.predict(estimator, case.sampler, [n], rng=seed + 4)
    ends = tuple(np.sqrt(np.maximum(predicted["predicted_variance_ci"].values.ravel(), 0.0)))
    if not _overlap(ends, before[1:]):
        found.wrong.append(f"predict {ends[0]:.3g} to {ends[1]:.3g}, not {before[0]:.3g}")
    return found


def main(*flags: str) -> None:
    """Print a line for each case; ``--only=TEXT`` selects cases whose names contain the text."""
    only = next((flag.split("=", 1)[1] for flag in flags if flag.startswith("--only=")), "")
    warnings.simplefilter("ignore")
    agree, worse, spent, count = 0, 0, 0, 0
    for case in cases():
        if only not in case.name:
            continue
        begun = time.perf_counter()
        try:
            found = judge(case)
        except McspectraError as error:
            found = Found(wrong=[str(error)])
        count += 1
        agree += not found.wrong
        worse += bool(found.worse)
        spent += bool(found.spent)
        marks = [
            *found.wrong,
            *(f"WORSE {w}" for w in found.worse),
            *(f"SPENT {s}" for s in found.spent),
        ]
        print(
            f"{case.name:42} {case.sampler:16} {'; '.join(marks) or 'agree'}  "
            f"[{'; '.join(found.words)}] "
            f"{time.perf_counter() - begun:.0f} s",
            flush=True,
        )
    print(f"agree: {agree} of {count}; worse than given: {worse}; more than the budget: {spent}")


if __name__ == "__main__":
    main()
