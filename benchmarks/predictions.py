"""Predicted variances compared with precise measured ones: accuracy and coverage of intervals.

Each row is a sampler in a group of problems. Each cell of a row is a problem at one n.
A cell is right if prediction and measurement agree to 5 %.
A cell is also right if prediction and measurement agree to two standard errors of the measurement.
A cell is covered if prediction and measurement differ by less than their combined interval.
Predictions do not evaluate f at the points of the sampler.
Measurements have at least 1,000 realizations.
The option ``--group=2-D`` selects one group, and ``--group=new`` selects all new groups.
The option ``--sampler=bnot`` selects one sampler.

Groups named ``new`` test every fast sampler with an offset (shift, strata-shift, digital-shift).
Some problems of the new groups have 4 to 8 dims, and some have unbounded integrands.
References are measured with 20,000 realizations.
If the moments of estimates are unbounded, references come from closed-form integrals.
The class `Unbounded` sums closed-form integrals over strata and pairs of points.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor

WITHIN, AT_MOST = 0.05, 0.2
"""Limits of the relative error of a prediction.

A prediction is right if its relative error is at most `WITHIN`; no error may exceed `AT_MOST`.
"""

REALIZATIONS = 10_000
"""Number of realizations; variances of normal estimates get a standard error of about 1.4 %."""

_DEAR = {"bnot": 2000, "poisson-disk": 4000}  # number of realizations for slow samplers


NEW_REALIZATIONS = 20_000
"""Number of realizations for groups named ``new``; variances get relative errors of about 1 %."""

MOST_MISSED = 4.0
"""Largest allowed error of a prediction, in standard errors of reference and prediction."""


@dataclass(frozen=True)
class Group:
    """A group of problems that are tested with the same samplers and counts.

    Attributes
    ----------
    realizations
        Number of realizations of each measurement.
    """

    problems: Sequence[Any]
    samplers: Sequence[str]
    counts: Sequence[int]
    realizations: int = REALIZATIONS


@dataclass(frozen=True)
class Tail:
    """An unbounded function h of one variable, with the integrals of h and h² from 0 to u.

    The flag `even` means h(1 − u) = h(u).
    If h is even, values of h near x = 1 are computed from the precise distance 1 − x.
    """

    h: Callable[[Array], Array]
    integral_to: Callable[[Array], Array]
    square: float
    even: bool = False

    @property
    def mean(self) -> float:
        """∫h."""
        return float(self.integral_to(np.array([1.0]))[0])

    def stratum_means(self, s: int, offset: float = 0.0) -> Array:
        """Return means over s equal strata of the torus; the first stratum starts at `offset`/s."""
        ends = (np.arange(s + 1) + offset % 1.0) / s
        whole = self.integral_to(np.minimum(ends, 1.0)) + self.integral_to(np.maximum(ends - 1, 0))
        return np.asarray(s * np.diff(whole))

    def between(self, s: int, offset: float | None = 0.0) -> float:
        """Compute the mean of h in each of s equal strata, and return the mean of the squares.

        If `offset` is None, the result is averaged over all offsets of the strata.
        """
        if offset is not None:
            return float(np.mean(self.stratum_means(s, offset) ** 2))
        nodes, weights = _ends_rule()
        return float(weights @ [np.mean(self.stratum_means(s, t) ** 2) for t in nodes])

    def grid_variance(self, n: int) -> float:
        """Return the variance of the mean over a grid of n points with a uniform offset."""
        nodes, weights = _ends_rule()
        k, half = np.arange(n)[:, None], n // 2
        if self.even:
            # An even function needs only x below ½: the point 1 − x replaces x in the upper half
            low = nodes[: len(nodes) // 2]
            reflected = np.concatenate([1.0 - low, low])
            x = np.concatenate([k[:half] + nodes, k[: n - half] + reflected]) / n
        else:
            x = (k + nodes) / n
        return float(weights @ self.h(np.clip(x, 1e-300, 1 - 2.0**-53)).mean(axis=0) ** 2) - (
            self.mean**2
        )


def _ends_rule() -> tuple[Array, Array]:
    """Return nodes and weights on [0, 1] for functions with powers above −1 at both ends."""
    u, w = np.polynomial.legendre.leggauss(200)
    t, w = 0.5 * (u + 1.0), 0.5 * w
    low = 0.5 * t**10
    return np.concatenate([low, 1.0 - low]), np.tile(5.0 * t**9 * w, 2)


def _student(u: Array) -> Array:
    """|t|, where t is the quantile of Student's t with 3 degrees of freedom."""
    return np.asarray(np.abs(stdtrit(3.0, u)))


def _student_to(u: Array) -> Array:
    with np.errstate(invalid="ignore"):
        t = np.where((u > 0.0) & (u < 1.0), stdtrit(3.0, np.clip(u, 1e-300, 1.0 - 1e-16)), np.inf)
    part = np.sqrt(3.0) / (np.pi * (1.0 + t**2 / 3.0))
    return np.asarray(np.where(u < 0.5, part, 2.0 * np.sqrt(3.0) / np.pi - part))


def power_tail(a: float) -> Tail:
    """The function u^−a with 0 < a < 1/2."""
    return Tail(lambda u: u**-a, lambda u: u ** (1.0 - a) / (1.0 - a), 1.0 / (1.0 - 2.0 * a))


TAILS = {
    "t3": Tail(_student, _student_to, 3.0, even=True),
    "root": power_tail(0.4),
    "fourth-root": power_tail(0.25),
    "lognormal": Tail(
        lambda u: np.exp(ndtri(u)), lambda u: math.exp(0.5) * ndtr(ndtri(u) - 1.0), math.exp(2.0)
    ),
}


class Unbounded:
    """A sum or product of one unbounded function per axis, whose variances are known."""

    def __init__(self, tail: str, dims: int, *, product: bool = False) -> None:
        self.tail, self.dims, self.product, h = TAILS[tail], dims, product, TAILS[tail].h

        def f(x: Array) -> Array:
            values = h(np.clip(x, 1e-300, 1.0 - 2.0**-53))
            return np.asarray(values.prod(axis=-1) if product else values.sum(axis=-1))

        mean = self.tail.mean
        self.integral = mean**dims if product else dims * mean
        integrand = mcs.Integrand.from_function(f, dims=dims, integral=self.integral)
        self.estimator = mcs.Estimator(integrand)
        how = ", product=True" if product else ""
        self.spec = f"Unbounded({tail!r}, {dims}{how}).estimator"

    def variance(self, sampler: str, n: int) -> float:
        """Return the exact variance of the mean over n points."""
        h, d = self.tail, self.dims
        base, _, step = sampler.partition(" | ")
        offset: float | None = None if step == "shift" else 0.0
        sides = (n,) * d
        if base == "jittered":
            sides = mcs.sampler(base, dims=d).law(n).sides  # type: ignore[attr-defined]
        starts = [offset] * d
        if step == "strata-shift":
            starts = [0.5 * n ** (-1.0 / d) * s for s in sides]
        # A sum over axes depends only on the points along each axis.
        # Strata, Latin hypercubes and scrambled nets are stratified along each axis
        if not self.product:
            if base == "random":
                return d * (h.square - h.mean**2) / n
            if base == "rank1-lattice" or step == "digital-shift":
                return d * h.grid_variance(n)
            parts = [h.square - h.between(s, at) for s, at in zip(sides, starts, strict=True)]
            return sum(parts) / n
        if base == "random":
            return float((h.square**d - h.mean ** (2 * d)) / n)
        if base == "jittered":
            parts = [h.between(s, at) for s, at in zip(sides, starts, strict=True)]
            return float((h.square**d - math.prod(parts)) / n)
        if base == "latin-hypercube":
            apart = [(n * h.mean**2 - h.between(n, at)) / (n - 1) for at in starts]
            return float(h.square**d / n + (1 - 1 / n) * math.prod(apart) - h.mean ** (2 * d))
        # Two points of a net share some leading bits on each axis, also after nested scrambling.
        # The shared leading bits fix an interval. Each half of it contains one of the two points
        levels = int(math.log2(n))
        siblings = []
        for level in range(levels):
            means = h.stratum_means(2 ** (level + 1))
            siblings.append(float(np.mean(means[::2] * means[1::2])))
        of_level = np.array([*siblings, h.square])
        points = mcs.sampler(base, dims=d).draw(n)[0]
        cells = np.rint(points * n).astype(np.int64)
        total = 0.0
        for i in range(n):
            # Count the bits after the leading bits that two points share
            apart_bits = np.frexp((cells ^ cells[i]).astype(float))[1]
            total += float(of_level[levels - apart_bits].prod(axis=-1).sum())
        return total / n**2 - float(h.mean ** (2 * d))


def groups() -> dict[str, Group]:
    """Return the tested groups; scenes are skipped if Mitsuba is not installed."""
    counts = (16, 64, 256, 1024, 4096)

    def functions(dims: int, *specs: str) -> list[Any]:
        return [mcs.Estimator(mcs.integrand(spec, dims=dims)) for spec in specs]

    def formula(text: str, dims: int) -> Any:
        return mcs.Estimator(mcs.integrand(f"formula(expression='{text}')", dims=dims))

    def product(dims: int, weight: float) -> Any:
        return formula("*".join(f"(1+{weight}*(x{i}-0.5))" for i in range(dims)), dims)

    def total(dims: int) -> Any:
        return formula("exp(" + "+".join(f"x{i}/{i + 1}" for i in range(dims)) + ")", dims)

    def corner(dims: int) -> Any:
        return formula("1/(1+" + "+".join(f"x{i}" for i in range(dims)) + ")**2", dims)

    many = ("random", "latin-hypercube", "sobol | owen", "halton | owen", "rank1-lattice | shift")
    found = {
        "2-D": Group(
            functions(
                2,
                "christensen-bilinear",
                "christensen-disk",
                "christensen-gaussian",
                "christensen-step",
                "christensen-triangle",
                "gaussian(width=0.1, center=0.4)",
                "disk(center=(0.45, 0.52), radius=0.27)",
                "half-space(normal=(0.8, 0.6), offset=0.63)",
                "smoothed-step(at=0.4, width=0.2)",
                "linear(gradient=(1, 2))",
                "cosine(frequency=(2, 1))",
            ),
            (
                "random",
                "jittered",
                "jittered | shift",
                "halton | shift",
                "rank1-lattice | shift",
                "sobol | owen",
                "latin-hypercube",
                "poisson-disk",
                "bnot",
            ),
            counts,
        ),
        "1-D": Group(
            functions(1, "gaussian", "step(at=0.3)", "linear"),
            ("random", "jittered", "jittered | shift", "regular | shift", "sobol | owen"),
            counts,
        ),
        "3-D": Group(
            functions(3, "gaussian", "disk(radius=0.4)", "polynomial"),
            ("jittered", "jittered | shift", "sobol | owen", "rank1-lattice | shift"),
            (64, 512, 4096),
        ),
        "5-D": Group([product(5, 1.0), total(5), corner(5)], many, (64, 256, 1024)),
        "10-D": Group([product(10, 0.5), total(10), corner(10)], many, (64, 256, 1024)),
        "densities": Group(
            [
                mcs.Estimator("linear(gradient=1.0)", mcs.density("linear(slope=1)", dims=1)),
                mcs.Estimator(
                    mcs.integrand("gaussian(width=0.2)", dims=2),
                    mcs.density("truncated-normal(sigma=0.3)", dims=2),
                ),
                mcs.MultipleImportance(
                    mcs.integrand("gaussian(width=0.2)", dims=2),
                    ["truncated-normal(sigma=0.3)", "uniform"],
                ),
            ],
            ("random", "jittered", "jittered | shift", "sobol | owen"),
            counts,
        ),
    }
    try:
        pixels = [
            mcs.Estimator(
                mcs.integrand(f"pixel(x=568, y=100, light='light-3', strategy='{strategy}')")
            )
            for strategy in ("light", "bsdf")
        ]
    except mcs.McspectraError as error:
        print(f"no pixels: {error}")
    else:
        found["pixels"] = Group(pixels, ("random", "jittered | shift", "sobol | owen"), counts[:-1])

    # Groups of 1-D and 2-D problems for all fast samplers that have an offset
    many = NEW_REALIZATIONS
    rotated, disk = (
        formula("exp(-9*(x0+x1-0.7)**2-2*(x0-x1)**2)", 2),
        functions(2, "disk(center=(0.45, 0.52), radius=0.27)")[0],
    )
    found["new 2-D"] = Group([rotated, disk], OFFSETS, (64,), many)
    found["new 1-D"] = Group(
        [formula("exp(2*x0)*(x0<0.37)", 1)],
        ("van-der-corput | digital-shift", "van-der-corput | shift", "regular | shift"),
        (16, 64),
        many,
    )

    # Groups of problems in 4 to 8 dims
    def ball(dims: int, square: float) -> Any:
        text = "+".join(f"(x{i}-0.5)**2" for i in range(dims))
        return formula(f"where({text}<{square},1,0)", dims)

    def oblique(dims: int) -> Any:
        normal = [round(1.0 / (1.0 + 0.3 * i), 4) for i in range(dims)]
        spec = f"half-space(normal={normal}, offset={0.45 * sum(normal):.5g})"
        return functions(dims, spec)[0]

    peak = formula("exp(-6*(x0+x1-x2-0.3)**2-3*(x1-x3+0.2)**2-2*(x0-0.4)**2)", 4)
    hinge = formula("max(x0-x1+0.5*x2+0.2*x3,0)", 4)
    found["new 4-D"] = Group([ball(4, 0.2), oblique(4), peak, hinge], IN_4_DIMS, (256,), many)
    wave = formula("cos(2*pi*(0.1+0.5*x0+0.4*x1+0.3*x2+0.3*x3+0.2*x4))", 5)
    found["new 5-D"] = Group([ball(5, 0.3), wave], IN_MANY_DIMS, (256,), many)
    found["new 6-D"] = Group([oblique(6), corner(6)], IN_MANY_DIMS, (256,), many)
    roof = formula("max(" + "+".join(f"x{i}" for i in range(8)) + "-4,0)", 8)
    found["new 8-D"] = Group([product(8, 0.7), roof], IN_MANY_DIMS, (256,), many)

    # Groups of problems with unbounded integrands
    found["new sums"] = Group(
        [Unbounded("t3", 2), Unbounded("root", 2)],
        (
            *("random", "jittered", "jittered | shift", "jittered | strata-shift"),
            *(
                "latin-hypercube",
                "latin-hypercube | shift",
                "sobol | owen",
                "sobol | digital-shift",
            ),
            "rank1-lattice | shift",
        ),
        (64, 256),
    )
    found["new sums, 5-D"] = Group(
        [Unbounded("lognormal", 5)],
        ("random", "latin-hypercube | shift", "sobol | lms", "sobol | digital-shift"),
        (64, 256),
    )
    found["new products"] = Group(
        [Unbounded(tail, 2, product=True) for tail in ("root", "fourth-root", "lognormal")],
        ("random", "jittered", "latin-hypercube", "sobol | owen", "niederreiter | lms"),
        (64, 256),
    )
    return found


OFFSETS = (
    *("random | digital-shift", "jittered | strata-shift", "jittered | digital-shift"),
    *("antithetic-jittered | shift", "box-jitter | strata-shift", "gaussian-jitter | shift"),
    *("uniform-jitter | strata-shift", "regular | shift", "regular | digital-shift"),
    *("latin-hypercube | strata-shift", "latin-hypercube | shift", "n-rooks | digital-shift"),
    *("multi-jittered | shift", "multi-jittered | digital-shift", "orthogonal-array | shift"),
    *("correlated-multi-jittered | strata-shift", "pmj | shift", "pmj02 | digital-shift"),
    *("sobol | digital-shift", "sobol | shift", "niederreiter | digital-shift"),
    *("larcher-pillichshammer | digital-shift", "hammersley | digital-shift"),
    *("halton | digital-shift", "halton | shift", "faure | digital-shift", "faure | shift"),
    *("rank1-lattice | shift", "korobov | shift", "fibonacci | shift", "kronecker | shift"),
    *("hexagonal | shift", "perturbed-lattice | strata-shift", "determinantal | shift"),
    *("poisson-disk | shift", "dart-throwing | strata-shift", "best-candidate | shift"),
)
IN_4_DIMS = (
    *("random | shift", "jittered | shift", "jittered | strata-shift", "box-jitter | shift"),
    *("uniform-jitter | shift", "regular | shift", "latin-hypercube | shift"),
    *("latin-hypercube | strata-shift", "orthogonal-array | shift", "perturbed-lattice | shift"),
    *("sobol | lms", "sobol | digital-shift", "sobol | shift", "niederreiter | owen"),
    *("niederreiter | digital-shift", "halton | digital-shift", "halton | shift"),
    *("hammersley | digital-shift", "faure | digital-shift", "rank1-lattice | shift"),
    *("korobov | shift", "kronecker | shift"),
)
IN_MANY_DIMS = (
    *("latin-hypercube | shift", "latin-hypercube | strata-shift", "orthogonal-array | shift"),
    *("sobol | lms", "sobol | digital-shift", "sobol | shift", "niederreiter | digital-shift"),
    *("halton | shift", "halton | digital-shift", "faure | digital-shift"),
    *("rank1-lattice | shift", "korobov | shift", "kronecker | shift"),
)


def measure(group: Group, sampler: str) -> tuple[tuple[int, ...], Array, Array]:
    """Return counts, reference variances, and the standard errors of these variances.

    Counts have the shape (N,). Variances and standard errors have the shape (problems, N).
    """
    many = _DEAR.get(sampler.partition(" ")[0], group.realizations)
    if many < group.realizations:
        return _measure_together(group, sampler, many)
    variances, errors, counts = [], [], ()
    for problem in group.problems:
        source = mcs.sampler(sampler, dims=problem.dims)
        counts = tuple(sorted({source.nearest_count(n) for n in group.counts}))
        if isinstance(problem, Unbounded):
            variances.append(np.array([problem.variance(sampler, n) for n in counts]))
            errors.append(np.zeros(len(counts)))
            continue
        found = mcs.convergence(problem, source, counts, realizations=many, rng=1)
        low, high = found["variance_ci"].to_numpy().reshape(len(counts), 2).T
        variances.append(found["variance"].to_numpy().reshape(-1))
        half = np.where(np.isfinite(high), (high - low) / 2.0, np.inf)
        errors.append(half / 1.96)
    return counts, np.array(variances), np.array(errors)


def _measure_together(
    group: Group, sampler: str, realizations: int
) -> tuple[tuple[int, ...], Array, Array]:
    """Measure all problems with the same points, because drawing these points takes most time.

    The problems must have no densities. Returns the same arrays as `measure`.
    """
    source = mcs.sampler(sampler, dims=group.problems[0].dims)
    counts = tuple(sorted({source.nearest_count(n) for n in group.counts}))
    variances, errors = np.empty((2, len(group.problems), len(counts)))
    for j, n in enumerate(counts):
        batches = []
        for batch in range(0, realizations, 100):
            points = source.draw(n, realizations=100, rng=10_000 + batch)
            batches.append([p.integrand(points).mean(axis=-1) for p in group.problems])
        off = np.concatenate(batches, axis=-1)
        off -= off.mean(axis=-1, keepdims=True)
        variances[:, j] = (off**2).sum(axis=-1) / (realizations - 1)
        fourth = (off**4).mean(axis=-1)
        errors[:, j] = np.sqrt((fourth - variances[:, j] ** 2) / realizations)
    return counts, variances, errors


@dataclass
class Tally:
    """Statistics of the cells of one group, or of all groups."""

    cells: int = 0
    right: int = 0
    near: int = 0
    covered: int = 0
    missed: float = 0.0

    def add(self, right: Array, near: Array, covered: Array, missed: Array) -> None:
        """Count correct predictions, and keep the largest error in units of standard errors."""
        self.cells += right.size
        self.right += int(right.sum())
        self.near += int(near.sum())
        self.covered += int(covered.sum())
        self.missed = max(self.missed, float(missed.max()))

    def __str__(self) -> str:
        shares = (100.0 * k / max(self.cells, 1) for k in (self.right, self.near, self.covered))
        texts = "{:.1f} % right, {:.1f} % within 20 %, {:.1f} % covered".format(*shares)
        return f"{self.cells} cells: {texts}, worst {self.missed:.1f} se"


def main(*flags: str) -> None:
    """Print a row for each sampler and group of integrands, then the totals.

    The worst predictions are listed last, each with a call that repeats the prediction.
    """
    only = tuple(flag.partition("=")[2] for flag in flags if flag.startswith("--group="))
    samplers = {flag.partition("=")[2] for flag in flags if flag.startswith("--sampler=")}
    worst: list[tuple[float, str]] = []
    totals: dict[str, Tally] = {}
    all_of = Tally()
    print(
        "group        sampler                   cells  right  ≤ 20 %  covered  s a cell  "
        "worst    se"
    )
    for name, group in groups().items():
        if only and not name.startswith(only):
            continue
        own = totals[name] = Tally()
        problems = [p.estimator if isinstance(p, Unbounded) else p for p in group.problems]
        for sampler in group.samplers:
            if samplers and sampler not in samplers:
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                counts, measured, error = measure(group, sampler)
                start = time.perf_counter()
                found = [mcs.predict(p, sampler, counts, rng=0) for p in problems]
                seconds = (time.perf_counter() - start) / measured.size
            value = np.array([each["predicted_variance"].to_numpy().reshape(-1) for each in found])
            bounds = np.array([each["predicted_variance_ci"].to_numpy() for each in found])
            bounds = bounds.reshape(*value.shape, 2)
            # Treat values at rounding level as equal
            size = np.array([[1.0 + abs(float(np.max(p.integral)))] for p in problems])
            none = np.isnan(value) & (measured <= rounding_floor(size))
            value = np.where(none, measured, value)
            bounds = np.where(none[..., None], measured[..., None], bounds)
            methods = [np.broadcast_to(_methods(each), value.shape[1:]) for each in found]

            # Errors relative to the measured value, reduced by the error of the measurement
            off = np.abs(value / measured - 1.0)
            noise = error / measured
            right = (off <= WITHIN) | (off <= 2.0 * noise)
            near = (off <= AT_MOST) | (off <= 2.0 * noise)
            half = np.where(value < measured, bounds[..., 1] - value, value - bounds[..., 0])
            within = np.hypot(half, 1.96 * error)
            distance = np.abs(value - measured)
            # References in closed form are exact up to rounding
            covered = distance <= within + 1e-9 * measured
            missed = np.where(covered, 0.0, np.inf)
            np.divide(1.96 * distance, within, out=missed, where=within > 0.0)
            missed = np.where(distance <= 1e-9 * measured, 0.0, missed)
            missed = np.where(np.isnan(value), np.inf, missed)
            ratio = value / measured
            far = ratio.flat[int(np.argmax(np.where(np.isfinite(off), off, np.inf)))]
            print(
                f"{name:12} {sampler:25} {value.size:5d} {right.mean():6.0%} {near.mean():7.0%} "
                f"{covered.mean():8.0%} {seconds:9.2f}  {far:5.3g} {missed.max():5.1f}",
                flush=True,
            )
            for tally in (own, all_of):
                tally.add(right, near, covered, missed)
            for i, j in np.argwhere(~right | ~near | (missed > MOST_MISSED)):
                problem, n = group.problems[i], counts[j]
                ends = bounds[i, j] / value[i, j] - 1.0
                text = (
                    f"{ratio[i, j]:8.3g} [{ends[0]:+.0%}, {ends[1]:+.0%}], {missed[i, j]:.1f} se, "
                    f"± {noise[i, j]:.1%} ({methods[i][j]})  {_call(problem, sampler, n)}"
                )
                worst.append((float(ratio[i, j]), text))
                if "--live" in flags:
                    print("   ", text, flush=True)
    for name, own in totals.items():
        print(f"{name:12} {own}")
    print(f"all: {all_of} (aim ≥ 98 % right, 100 % within 20 %, ≥ 93 % covered, ≤ 4 se)")
    worst.sort(key=lambda each: -abs(np.log(each[0])) if each[0] > 0 else -np.inf)
    print("predicted/reference [interval], miss, error of the reference (method)  call")
    for _, text in worst[:40]:
        print(text)


def _call(problem: Any, sampler: str, n: int) -> str:
    """Return the call that repeats a prediction."""
    if isinstance(problem, Unbounded):
        made = problem.spec
    elif isinstance(problem, mcs.Estimator):
        made = f"mcs.Estimator({problem.integrand.spec!r}, dims={problem.dims})"
    else:
        made = problem.spec
    return f"mcs.predict({made}, {sampler!r}, [{n}], rng=0)"


def _methods(found: Any) -> Array:
    """Return the name of the prediction method for each number of points n."""
    return np.asarray(found["method"].to_numpy())


if __name__ == "__main__":
    main()
