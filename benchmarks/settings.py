"""Count correct diagnoses with each setting of an algorithm halved, unchanged and doubled.

Without a flag, the benchmark tests `CauseSettings` and its parts.
Each case has two seeds and 8,192 evaluations.
The cases come from the tests of `profile` and from the benchmark ``battery``.
Only cases with a known cause of noise are used.
The cases of `PoleSettings` are poles |A(x − c)|^−a: the order a and the rank of A are known.
The flag ``--NAME`` measures one setting.

``--rates`` tests `CurveSettings` with five functions whose rate with scrambled nets is known.
The benchmark prints the root mean square error of the rates.
The benchmark also prints the mean half width of the intervals, and how many contain the true rate.

``--chains`` tests `ChainSettings` with chains of 500 to 2,000 draws.
Each chain has one known fault or none.

``--stages`` tests `StageSettings` with 150 searches that stop when a variance is known to 10 %.
The benchmark prints how many realizations and how many stages a search takes on average.
The benchmark also prints the root mean square of the true relative error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np

import mcspectra as mcs
from benchmarks.battery import BUDGET, Case, cases
from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.estimators import as_subject
from mcspectra.estimators.moments import Moments
from mcspectra.explain.causes import CAUSE_SETTINGS, CauseSettings, Evidence, causes_of
from mcspectra.explain.probing import PoleSettings, pole_of
from mcspectra.explain.samples import CURVE_SETTINGS, NETS, Sets
from mcspectra.measure.chains import CHAIN_SETTINGS, ChainSettings, quantity_error
from mcspectra.measure.converge import STAGE_SETTINGS, MomentsCell, StageSettings

SEEDS = 2
NESTED = ("lines", "poles", "curves")
# Settings that change the estimates of `Evidence.of`; other settings change only the diagnosis
EVALUATING = {
    *("nets", "more_from", "lines_share", "check_share", "given_share", "pole_share"),
    *("dimension_share", "again", "same_value", "climbed", "many_dims"),
}
# Settings that limit the range of values; no case reaches these limits
OMITTED = {"smallest", "largest", "pdf_points"}
POLES = (
    (np.eye(1), 0.45, 1, False),
    (np.eye(2), 1.0, 2, False),
    (np.array([[3.0, 1.0], [0.0, 0.5]]), 1.3, 2, False),
    (np.eye(3), 2.0, 3, False),
    (np.array([[1.0, -1.0]]), 0.6, 1, False),
    (np.eye(3)[:2], 0.7, 2, False),
    (np.array([[1.0, 1.0]]), 1.0, 2, True),
    (np.array([[1.0, 1.0, 0.0]]), 0.6, 2, True),
    (np.array([[1.0, 0.0]]), 0.3, 1, True),
)


def all_cases() -> Iterator[tuple[mcs.Estimator, mcs.Sampler, tuple[str, ...]]]:
    """Yield each test case: an estimator, a sampler, and the causes that are correct diagnoses."""
    from tests.profiler.test_profile import FUNCTIONS

    def shaped(case: Case) -> Any:
        """Convert a function of points (k, d) to a function of points (…, d)."""
        return lambda x: np.asarray(case.f(x.reshape(-1, case.dims))).reshape(x.shape[:-1])

    for case in cases():
        plain = not hasattr(case.f, "counts")
        f, dims = (shaped(case), case.dims) if plain else (case.f, None)
        subject = as_subject(f, case.sampler, dims=dims, lists=False)
        yield subject.estimator, subject.sampler, case.causes
    for dims, function, causes in FUNCTIONS.values():
        subject = as_subject(function, "random", dims=dims, lists=False)
        yield subject.estimator, subject.sampler, tuple(causes)


def is_right(seen: Evidence, causes: tuple[str, ...]) -> bool:
    """Whether the cause of noise that is reported first is one of the given causes."""
    return causes_of(seen)[0].name in causes


def poles_right(settings: PoleSettings) -> int:
    """Count the poles for which rank, border and exponent (to 0.02) are recognized."""
    right = 0
    for matrix, order, rank, border in POLES:
        place = np.zeros(matrix.shape[1]) if border else 0.3 + 0.1 * np.arange(matrix.shape[1])

        def function(x: Array, m: Array = matrix, c: Array = place, a: float = order) -> Array:
            distance = np.linalg.norm((x - c) @ m.T, axis=-1)
            return np.asarray(3.0 + np.maximum(distance, 1e-150) ** -a)

        for seed in range(SEEDS):
            rng = np.random.default_rng(seed)
            x = rng.random((3000, len(place)))
            pole = pole_of(function, x, function(x), 1000, rng, settings)
            known = pole is not None and abs(pole.exponent - order) <= 0.02
            right += known and (pole.codimension, pole.border) == (rank, border)
    return right


def changed(settings: Any, name: str, factor: float) -> Any:
    """Return settings with one value times a factor; whole numbers stay whole and at least 1."""
    value = getattr(settings, name)
    if isinstance(value, tuple):
        return replace(settings, **{name: tuple(factor * v for v in value)})
    if isinstance(value, int):
        return replace(settings, **{name: max(1, round(factor * value))})
    return replace(settings, **{name: factor * value})


def variants() -> Iterator[tuple[str, str, list[CauseSettings]]]:
    """Yield for each setting its class, its name and two changed copies of `CauseSettings`.

    In the first copy, the value of this setting is halved; in the second copy, it is doubled.
    """
    for part in ("", *NESTED):
        own = getattr(CAUSE_SETTINGS, part) if part else CAUSE_SETTINGS
        for field in fields(own):
            if field.name in {*NESTED, *OMITTED}:
                continue
            pair = [changed(own, field.name, factor) for factor in (0.5, 2.0)]
            if part:
                pair = [replace(CAUSE_SETTINGS, **{part: each}) for each in pair]
            yield type(own).__name__, field.name, pair


def faulty_chains() -> dict[str, tuple[str, list[Array]]]:
    """Return groups of Markov chains, by the name of their fault; one group has no fault.

    Each group has the cause that should be reported, and arrays of shape (chain, draw).
    """
    rng = np.random.default_rng(5)

    def ar(rho: float, chains: int, n: int) -> Array:
        """Return stationary autoregressions of order 1."""
        z = rng.standard_normal((chains, n + 200))
        for i in range(1, n + 200):
            z[:, i] += rho * z[:, i - 1]
        return z[:, 200:]

    good = [
        ar(rho, chains, n)
        for rho in (0.0, 0.5, 0.9, -0.5)
        for chains in (1, 4)
        for n in (500, 2000)
        for _ in range(25)
    ]
    for _ in range(25):
        good += [rng.exponential(size=(4, 1000)), rng.standard_t(8, size=(4, 1000))]
        good += [rng.uniform(size=(4, 1000))]
    apart, line, time = np.array([0.0, 0.0, 0.0, 1.0])[:, None], np.linspace(-1, 1, 1000), range(50)
    stuck = [ar(0.5, 2, 1000) for _ in time]
    for k, x in enumerate(stuck):
        x[:, 300 : 500 if k < 25 else 410] = x[:, 300:301]
    levels = [8.0 * (np.arange(1000) // rng.integers(150, 400) % 2) for _ in time]
    return {
        "good": ("none", good),
        "walk": ("stuck-chain", [np.cumsum(rng.normal(size=(1, 1000)), axis=1) for _ in time]),
        "slow": ("stuck-chain", [ar(0.99, 1, 1000) for _ in time]),
        "apart": ("stuck-chain", [ar(0.5, 4, 1000) + apart for _ in time]),
        "drift": ("stuck-chain", [ar(0.5, 4, 1000) + 0.6 * line for _ in time]),
        "levels": ("two levels", [rng.normal(size=(2, 1000)) + each for each in levels]),
        "stuck": ("repeats one value", stuck),
        "alike": (
            "correlated-replicates",
            [0.3 * np.repeat(ar(0.5, 1, 1000), 4, 0) + ar(0.5, 4, 1000) for _ in time],
        ),
        "heavy": (
            "heavy-tail",
            [rng.standard_t(nu, size=(4, 2000)) for nu in (1.0, 1.4) for _ in range(25)],
        ),
        "few": ("few-realizations", [rng.normal(size=(1, 12)) for _ in range(25)]),
        "start": (
            "burn-in",
            [ar(0.5, 4, 1000) + 5.0 * np.exp(-np.arange(1000) / 100) for _ in time],
        ),
    }


def chains() -> None:
    """Print a line for each setting of chains."""
    groups = faulty_chains()

    def right(settings: ChainSettings) -> str:
        """Count the chains whose report names the right cause or contains the right evidence."""
        counts = {}
        for name, (wanted, group) in groups.items():
            found = [quantity_error(x, np.ones(x.shape), settings) for x in group]
            counts[name] = sum(wanted in f"{each['cause']} {each['evidence']}" for each in found)
        return ", ".join(f"{name} {count}/{len(groups[name][1])}" for name, count in counts.items())

    print(f"all: {right(CHAIN_SETTINGS)}", flush=True)
    for field in fields(ChainSettings):
        if field.name not in {"smallest", "least_draws"}:
            for factor in (0.5, 2.0):
                settings = changed(CHAIN_SETTINGS, field.name, factor)
                value = getattr(settings, field.name)
                print(f"{field.name} {value:g}: {right(settings)}", flush=True)


def rates() -> None:
    """Print a line for each setting that affects rates."""
    functions: tuple[tuple[Any, int, float], ...] = (
        (lambda x: np.exp(x[..., 0]), 1, -3.0),
        (lambda x: np.abs(x[..., 0] - 0.3), 1, -3.0),
        (lambda x: np.maximum(x[..., 0], 1e-300) ** -0.3, 1, -1.4),
        (lambda x: (x @ np.array([0.6, 0.8]) < 0.7) * 1.0, 2, -1.5),
        (lambda x: x.prod(axis=-1), 2, -3.0 + 1.0 / math.log(256)),
    )
    given = []
    for function, dims, rate in functions:
        estimator = as_subject(function, "random", dims=dims, lists=False).estimator
        given += [(rate, Sets.of(estimator, 256, 20, Stream.from_rng(r))) for r in range(50)]
    usual = CURVE_SETTINGS.drifts
    values = {
        "octaves": (3, 1, 2, 6),
        "drifts": (tuple(0.5 * v for v in usual), tuple(2.0 * v for v in usual), (0.2,)),
        "floor": (0.01, 0.04),
    }
    for name, value in ((name, v) for name, several in values.items() for v in several):
        settings = replace(CURVE_SETTINGS, **{name: value})
        curves = [sets.curves(settings)[NETS] for _, sets in given]
        truth = np.array([rate for rate, _ in given])
        low, high = np.array([curve.rate_ci for curve in curves]).T
        error = math.sqrt(((np.array([curve.rate for curve in curves]) - truth) ** 2).mean())
        held, half = ((low <= truth) & (truth <= high)).mean(), 0.5 * (high - low).mean()
        print(f"{name} {value}: {error:.2f}, {100 * held:.0f} %, {half:.2f}", flush=True)


def stages() -> None:
    """Print a line for each setting of `StageSettings` and each distribution of estimates."""
    estimator = mcs.Estimator("linear", dims=1)
    cell = MomentsCell((estimator,), mcs.sampler("random", dims=1), 1, Stream.from_rng(0))

    def search(values: Array, settings: StageSettings) -> tuple[int, float, int]:
        """Return the number of realizations, the variance and the number of stages of a search."""
        steps, count = cell.until_precise(0, 0.1, len(values), settings), 0
        wanted = next(steps)
        while True:
            count += 1
            # The search receives given random values as estimates; no points are drawn
            _, first, size = map(int, wanted.key.split("-"))
            moments = Moments.of(values[first : first + size, None], tails=True)
            try:
                wanted = steps.send([moments])
            except StopIteration as stop:
                ((moments, _),) = stop.value
                return moments.count, float(moments.variance[0]), count

    variants = [(name, factor) for name in ("first", "leap") for factor in (0.5, 2.0)]
    given = [("all", STAGE_SETTINGS)]
    given += [(f"{n} × {k}", changed(STAGE_SETTINGS, n, k)) for n, k in variants]
    given += [(f"step {s}", replace(STAGE_SETTINGS, step=s)) for s in (1.1, 1.5, 2.0)]
    laws = {"normal": 0.0, "lognormal, σ = 0.7": 0.7}
    for (law, sigma), (name, settings) in ((a, b) for a in laws.items() for b in given):
        truth = math.expm1(sigma**2) * math.exp(sigma**2) if sigma else 1.0
        found = []
        for seed in range(150):
            z = np.random.default_rng(seed).standard_normal(100_000)
            found.append(search(np.exp(sigma * z) if sigma else z, settings))
        count, variance, number = (np.array(each) for each in zip(*found, strict=True))
        error = math.sqrt(((variance / truth - 1.0) ** 2).mean())
        print(f"{law:20} {name:12} {count.mean():6.0f} {error:.3f} {number.mean():.1f}", flush=True)


def main(*only: str) -> None:
    """Print a line for each setting; ``--NAME`` selects one setting."""
    others = {("--rates",): rates, ("--chains",): chains, ("--stages",): stages}
    if only in others:
        others[only]()
        return
    given = [(*case, seed) for case in all_cases() for seed in range(SEEDS)]
    usual = [
        Evidence.of(e, sampler, BUDGET, Stream.from_rng(seed)) for e, sampler, _, seed in given
    ]

    def right(settings: CauseSettings, *, again: bool) -> str:
        """Return the number of cases for which the right cause is found, as text.

        If `PoleSettings` were changed, the text also has the number of correctly recognized poles.
        """
        count = 0
        for (e, sampler, causes, seed), seen in zip(given, usual, strict=True):
            try:
                found = replace(seen, settings=settings)
                if again:
                    found = Evidence.of(e, sampler, BUDGET, Stream.from_rng(seed), settings)
                count += is_right(found, causes)
            except (mcs.McspectraError, ValueError, IndexError, np.linalg.LinAlgError):
                pass
        poles = settings.poles is not CAUSE_SETTINGS.poles
        return f"{count}" + (f" + {poles_right(settings.poles)} poles" if poles else "")

    base = right(CAUSE_SETTINGS, again=False)
    print(
        f"{base} of {len(given)} causes and {poles_right(CAUSE_SETTINGS.poles)} of "
        f"{SEEDS * len(POLES)} poles are right",
        flush=True,
    )
    for kind, name, pair in variants():
        if only and f"--{name}" not in only:
            continue
        again = kind != "CauseSettings" or name in EVALUATING
        half, double = (right(each, again=again) for each in pair)
        print(f"{kind}.{name:16} half {half:16} double {double}", flush=True)
