"""Predicted variances against precise measured ones: how many are right, and whether intervals cover.

Each row is a sampler in a group of problems; each of its cells a problem at a count. A cell counts as
right where predicted/measured is within 5 %, or within two standard errors of the measurement, whose
interval covers where the difference is within both intervals together. Predictions see no sample of f at
the sampler's points; measurements have at least 1,000 realisations. ``--group=2-D`` takes one group.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.estimators.moments import rounding_floor

WITHIN, AT_MOST = 0.05, 0.2
"""Relative errors of predictions that count as right, and that none may exceed."""

REALIZATIONS = 10_000
"""Of measurements: relative standard errors of about 1.4 % where the estimates are normal."""

_DEAR = {"bnot": 2000, "poisson-disk": 4000}  # realisations of samplers that take long


@dataclass(frozen=True)
class Group:
    """Problems that are tried with the same samplers and counts."""

    problems: Sequence[Any]
    samplers: Sequence[str]
    counts: Sequence[int]


def groups() -> dict[str, Group]:
    """Return what is tried; scenes are left out where Mitsuba is not installed."""
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
    return found


def measure(group: Group, sampler: str) -> tuple[tuple[int, ...], Array, Array]:
    """Counts (N,), measured variances (problems, N) and their standard errors."""
    many = _DEAR.get(sampler.partition(" ")[0], REALIZATIONS)
    variances, errors, counts = [], [], ()
    for problem in group.problems:
        dims = problem.dims
        source = mcs.sampler(sampler, dims=dims)
        counts = tuple(sorted({source.nearest_count(n) for n in group.counts}))
        found = mcs.convergence(problem, source, counts, realizations=many, rng=1)
        low, high = found["variance_ci"].to_numpy().reshape(len(counts), 2).T
        variances.append(found["variance"].to_numpy().reshape(-1))
        half = np.where(np.isfinite(high), (high - low) / 2.0, np.inf)
        errors.append(half / 1.96)
    return counts, np.array(variances), np.array(errors)


def main(*flags: str) -> None:
    """Print a row for each sampler of each group, the totals and the ten worst cells."""
    only = [flag.partition("=")[2] for flag in flags if flag.startswith("--group=")]
    worst: list[tuple[float, str]] = []
    totals = np.zeros(4)
    print("group      sampler                 cells  right  ≤ 20 %  covered  s a cell  worst")
    for name, group in groups().items():
        if only and name not in only:
            continue
        for sampler in group.samplers:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                counts, measured, error = measure(group, sampler)
                start = time.perf_counter()
                found = [mcs.predict(p, sampler, counts, rng=0) for p in group.problems]
                seconds = (time.perf_counter() - start) / measured.size
            value = np.array([each["predicted_variance"].to_numpy().reshape(-1) for each in found])
            bounds = np.array([each["predicted_variance_ci"].to_numpy() for each in found])
            bounds = bounds.reshape(*value.shape, 2)
            # Where neither finds more than rounding, they agree
            size = np.array([[1.0 + abs(float(np.max(p.integral)))] for p in group.problems])
            none = np.isnan(value) & (measured <= rounding_floor(size))
            value = np.where(none, measured, value)
            bounds = np.where(none[..., None], measured[..., None], bounds)
            methods = [np.broadcast_to(_methods(each), value.shape[1:]) for each in found]

            # Relative to the measured value, whose own error is allowed for
            off = np.abs(value / measured - 1.0)
            noise = error / measured
            right = (off <= WITHIN) | (off <= 2.0 * noise)
            near = (off <= AT_MOST) | (off <= 2.0 * noise)
            half = np.where(value < measured, bounds[..., 1] - value, value - bounds[..., 0])
            covered = np.abs(value - measured) <= np.hypot(half, 1.96 * error)
            ratio = value / measured
            far = ratio.flat[int(np.argmax(np.where(np.isfinite(off), off, np.inf)))]
            print(
                f"{name:10} {sampler:23} {value.size:5d} {right.mean():6.0%} {near.mean():7.0%} "
                f"{covered.mean():8.0%} {seconds:9.2f}  {far:.3g}",
                flush=True,
            )
            totals += (value.size, right.sum(), near.sum(), covered.sum())
            for i, j in np.argwhere(~right):
                text = f"{group.problems[i].spec}, {sampler}, n = {counts[j]} ({methods[i][j]})"
                worst.append((float(ratio[i, j]), text))
    cells, right_, near_, covered_ = totals
    print(
        f"{cells:.0f} cells: {right_ / cells:.1%} right (aim ≥ 95 %), {near_ / cells:.1%} within 20 % "
        f"(aim 100 %), {covered_ / cells:.1%} covered (aim 93–97 %)"
    )
    worst.sort(key=lambda each: -abs(np.log(each[0])) if each[0] > 0 else -np.inf)
    for far, text in worst[:20]:
        print(f"  {far:8.3g}  {text}")


def _methods(found: Any) -> Array:
    """Names of the methods along n."""
    return np.asarray(found["method"].to_numpy())


if __name__ == "__main__":
    main()
