"""Time of a power spectrum against the numbers of points, frequencies, realizations, and accuracy.

A spectrum has n points, M frequencies, R realizations and the accuracy ε.
The seconds t per realization follow a model of the NUFFT [Barnett2019]_; R realizations take R t:

    t = a + b n log(1/ε) + c M log M.

The constants a, b and c are fitted to measured times.
In d dims, a point is spread to log^d(1/ε) cells of the grid.
Vector instructions process all cells of a row together.
In two dims, the time per point grows like the number of rows, which is of order log(1/ε).
All cases are timed twice; the smaller processor time of a case counts.

The command ``python -m benchmarks cost --plot`` also draws measured times and the model.
The figure is docs/figures/cost.png.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.spectra.transforms import FrequencyGrid, Transform

FIGURE = Path(__file__).parent.parent / "docs" / "figures" / "cost.png"
DIMS, EPS = 2, 1e-9
COUNTS = (256, 1024, 4096, 16384, 65536)
HALF_WIDTHS = (16, 32, 64, 128, 256)
REALIZATIONS = (2, 4, 8, 16, 32, 64)
ACCURACIES = (1e-2, 1e-4, 1e-6, 1e-8)
# Number of points and half width of the grid, while the realizations R or the accuracy ε vary
FIXED = (4096, 64)
_SECONDS = 0.15  # seconds of repeated calls for each case; all cases are timed twice


@dataclass(frozen=True)
class Series:
    """Measured seconds per call while one quantity varies, and the seconds of the model."""

    label: str
    x: Array
    measured: Array
    model: Array


def main(*flags: str) -> None:
    """Print the fit; with ``--plot``, also draw it."""
    if set(flags) - {"--plot"}:
        raise SystemExit(f"cost takes --plot, not {' '.join(flags)}.")
    cases = [(n, k, EPS) for n in COUNTS for k in HALF_WIDTHS]
    cases += [(*FIXED, eps) for eps in ACCURACIES]
    sweeps = [[_seconds(*case) for case in cases] for _ in range(2)]
    times = np.min(sweeps, axis=0)
    terms = np.array([_terms(*case) for case in cases])
    # Times span four decades, so the fit uses relative residuals
    (a, b, c), *_ = np.linalg.lstsq(terms / times[:, None], np.ones(len(times)))
    ratio = times / (terms @ (a, b, c))
    print(f"2-D, ε {EPS:g} … {ACCURACIES[0]:g}, {len(cases)} cases, n {COUNTS[0]} … {COUNTS[-1]}, "
          f"M {(2 * HALF_WIDTHS[0] + 1)}² … {(2 * HALF_WIDTHS[-1] + 1)}²")  # fmt: skip
    print(f"a {1e6 * a:.3g} µs, b {1e9 * b:.3g} ns, c {1e9 * c:.3g} ns; measured / model: "
          f"median {np.median(ratio):.2f}, {ratio.min():.2f} … {ratio.max():.2f}, "
          f"rms of the logarithm {np.std(np.log(ratio)):.2f}")  # fmt: skip
    linear = _by_realizations()
    slope = np.polyfit(np.log(linear.x), np.log(linear.measured), 1)[0]
    print(f"exponent of the time in R: {slope:.3f} (linear: 1)")
    model = terms @ (a, b, c)
    accuracy = _series(
        f"n = {FIXED[0]}, {2 * FIXED[1] + 1}²", ACCURACIES, times, model, -len(ACCURACIES)
    )
    shares = ", ".join(f"{x:.2f}" for x in accuracy.measured / accuracy.model)
    print(f"measured / model at ε = {', '.join(f'{e:g}' for e in ACCURACIES)}: {shares}")
    if "--plot" in flags:
        step = len(HALF_WIDTHS)
        grids = [
            _series(f"M = {2 * k + 1}²", COUNTS, times, model, i, step)
            for i, k in enumerate(HALF_WIDTHS)
        ]
        _plot(grids, linear, accuracy)


def _series(
    label: str, x: tuple[float, ...], times: Array, model: Array, first: int, step: int = 1
) -> Series:
    """Return the measured and the modeled times of some cases, as functions of x.

    The first x belongs to the case with index `first`, and each next x to a case `step` later.
    """
    chosen = np.arange(len(x)) * step + first
    return Series(label, np.array(x, np.float64), times[chosen], model[chosen])


def _terms(n: int, half_width: int, eps: float) -> tuple[float, float, float]:
    size = float(2 * half_width + 1) ** DIMS
    return 1.0, n * np.log(1.0 / eps), size * np.log(size)


def _seconds(n: int, half_width: int, eps: float = EPS, realizations: int = 2) -> float:
    """Smallest seconds per realization, for power spectra of `realizations` sets on one thread."""
    grid = FrequencyGrid(DIMS, half_width)
    points = mcs.sampler("random", dims=DIMS).draw(n, realizations=realizations, rng=1)
    total, squares = np.zeros(grid.stored), np.zeros(grid.stored)
    transform = Transform(grid, n, engine="nufft", eps=eps)
    transform.add_power(points, None, total, squares)
    best, stop = np.inf, time.thread_time() + _SECONDS
    while time.thread_time() < stop or best == np.inf:
        start = time.thread_time()
        transform.add_power(points, None, total, squares)
        best = min(best, time.thread_time() - start)
    return float(best) / realizations


def _by_realizations() -> Series:
    """Seconds for R realizations; the model is R / 2 times the time of two realizations."""
    n, half_width = FIXED
    count = np.array(REALIZATIONS, np.float64)
    measured = np.array([r * _seconds(n, half_width, EPS, r) for r in REALIZATIONS])
    return Series(f"n = {n}, {2 * half_width + 1}²", count, measured, count * measured[0] / 2)


def _plot(grids: list[Series], linear: Series, accuracy: Series) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained", sharey=False)
    panels = (
        ("points n", "seconds a realization", grids),
        ("realizations R", "seconds", [linear]),
        ("accuracy ε", "seconds a realization", [accuracy]),
    )
    for axis, (x, y, series) in zip(axes, panels, strict=True):
        for one in series:
            (line,) = axis.loglog(one.x, one.measured, "o", label=one.label)
            axis.loglog(one.x, one.model, "-", color=line.get_color(), linewidth=1)
        axis.set_xlabel(x)
        axis.set_ylabel(y)
        axis.legend(fontsize="small")
    axes[1].set_xticks(REALIZATIONS, [str(r) for r in REALIZATIONS], minor=False)
    axes[1].minorticks_off()
    figure.suptitle(
        "Expected power in 2-D, one thread: measured (dots), a + b n log(1/ε) + c M log M"
    )
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURE, dpi=120)
    print(f"drawn to {FIGURE.relative_to(FIGURE.parent.parent.parent)}")


if __name__ == "__main__":
    main()
