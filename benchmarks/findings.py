"""Numbers and figures of ``docs/findings``, made by ``python -m benchmarks findings --plot``.

Each function prints the numbers of one page, with 95 % intervals, and returns its figures by name.
With ``--plot`` the lines are also written to ``docs/findings/numbers.txt``.
The pages in ``docs/findings`` may quote only numbers in this file.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

import mcspectra as mcs
from benchmarks.finding_densities import channels, infinite_weights, mis_slowest, warps
from benchmarks.finding_figures import (
    Curve,
    slopes,
    variance_panels,
    variance_plot,
    with_interval,
)
from mcspectra.plots.backend_matplotlib import draw, encode
from mcspectra.plots.description import Axis, Line, Panel, Plot, ReferenceLine, Segments
from mcspectra.plots.kinds import describe
from mcspectra.plots.scales import log_axis
from mcspectra.plots.style import ACCENT, INK

__all__ = ["FOLDER", "PAGES", "main"]

FOLDER = Path(__file__).parents[1] / "docs" / "findings"
Plots = dict[str, Plot]

LARGE = (64, 256, 1024, 4096)
SMOOTH, EDGE = "christensen-gaussian", "half-space(normal=[1, 0.618], offset=0.7)"


def homogenisation() -> Plots:
    """Make six plots of variances: each compares a smooth integrand with an interior edge."""
    studies = {
        name: mcs.improve.mirror_study(
            f, "jittered", LARGE, mirrorings=["original", "random", "uniform"],
            realizations=400, rng=1,
        )
        for name, f in (("smooth", SMOOTH), ("edge", EDGE))
    }  # fmt: skip
    parts = {}
    cells = [(m, h) for m in ("original", "random", "uniform") for h in (False, True)]
    theory = {"original": (-2, -1.5), "uniform": (-2, -2), "random": (-1, -1)}
    for mirroring, homogenized in cells:
        curves, rates = {}, []
        for name, study in studies.items():
            cell = study.sel(mirroring=mirroring, homogenized=homogenized)
            rates.append(f"{float(cell['rate']):.2f}".replace("-", "−"))
            curves[name] = Curve.of(cell)
            limit = theory[mirroring][homogenized]
            expected = limit if name == "smooth" else max(limit, -1.5)
            print(
                f"{mirroring}, {'shifted' if homogenized else 'not shifted'}, {name}: "
                f"rate {with_interval(cell['rate'], cell['rate_ci'])}, theory {expected}"
            )
        title = f"{'mirror-' * (mirroring != 'original')}{mirroring}{', shifted' * homogenized}"
        parts[f"{title}: {' and '.join(rates)}"] = curves
    panels = variance_panels(parts, limits=(1e-9, 1e-2))
    plot = Plot(kind="findings", panels=panels, columns=2, wide=True, share="both")
    mirrored = mcs.Mirrored(SMOOTH, "uniform")
    exact = np.array([mcs.exact_variance(mirrored, "jittered | shift", n) for n in LARGE])
    local = ", ".join(f"{rate:.2f}" for rate in slopes(LARGE, exact))
    print(f"uniform, shifted, smooth: exact rates between the counts {local}")
    return {"homogenisation-and-mirroring": plot}


def alignment() -> Plots:
    """Plot exact and measured variances against the shift of strata, for a step and a bar."""
    step, bar = (
        mcs.integrand(s, dims=1) for s in ("step(at=0.3)", "disk(center=0.47, radius=0.27)")
    )
    places = [k / 16 for k in range(16)]
    exact = mcs.improve.strata_shift_scan(step, "jittered", 16, offsets=64)
    measured = mcs.improve.strata_shift_scan(
        step, "jittered", 16, offsets=places, method="measured", realizations=4000, rng=1
    )
    least = exact["variance"].squeeze()
    print(
        f"step, n = 16: n² Var from {256 * float(least.min()):.4f} to "
        f"{256 * float(least.max()):.4f}"
    )
    best = mcs.improve.best_alignment(
        bar, "jittered", 16, edges=[0.2, 0.74], realizations=1000, rng=1
    )
    for name in best["candidate"].values:
        row = best.sel(candidate=name)
        ratio = with_interval(row["variance_ratio"], row["variance_ratio_ci"], ".2g")
        print(f"edges at 0.2 and 0.74, {name}: variance / unshifted {ratio}")
    ci = 256 * measured["variance_ci"].squeeze().values
    whiskers = np.stack([np.repeat(places, 2).reshape(-1, 2), ci], axis=-1)
    scan = mcs.improve.strata_shift_scan(bar, "jittered", 16, offsets=64)
    x, y = Axis(label="offset of strata, in sides"), Axis(label="n² × variance")
    panels = []
    for title, data, marks in (
        (
            "1[x<0.3], n = 16",
            exact,
            [Segments(ends=whiskers, color=ACCENT, width=1.4, label="measured, 95 %")],
        ),
        (
            "1[0.2<x<0.74], n = 16",
            scan,
            [ReferenceLine(at=0.0, color=ACCENT, width=1.6, label="aligned strata")],
        ),
    ):
        values = 256 * data["variance"].squeeze().values
        line = Line(x=data["offset0"].values, y=values, color=INK, width=1.0, label="exact")
        panels.append(Panel(marks=(line, *marks), x=x, y=y, title=title, grid=True))
    return {"alignment": Plot(kind="findings", panels=tuple(panels), columns=2, wide=True)}


def smoothing() -> Plots:
    """Plot a disk's squared error for each width of the edge, and the best width per budget."""
    widths = [0.005, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28]
    d = mcs.improve.smoothing_scan(
        "disk(center=0.47)", "jittered", (64, 256, 1024), [0, *widths], realizations=1000, rng=1
    )
    curves = {}
    for n in d["n"].values:
        cell = d.sel(n=n)
        low, high = (f"{w:g}" for w in cell["best_width_range"].values)
        ratio = float(cell["mse"].sel(width=0) / cell["mse"].min())
        print(
            f"n = {n}: best width {float(cell['best_width']):g} ({low} … {high}), "
            f"mean squared error {ratio:.1f} times lower than with the edge"
        )
        curves[f"n = {n}"] = Curve.of(cell.sel(width=widths), "mse", "width")
    for width in (0, 0.05, 0.1, 0.2):
        cell = d.sel(width=width)
        print(
            f"width {width:g}: rate of the variance {with_interval(cell['rate'], cell['rate_ci'])}"
        )
    curves["bias²"] = Curve(np.array(widths), d["bias_squared"].sel(width=widths).values)
    axis = log_axis("width of the edge", widths[0], widths[-1])
    title, limits = "a disk of radius 0.25, jittered", (2e-7, 1e-3)
    plot = variance_plot({title: curves}, x=axis, y="mean squared error", limits=limits)
    return {"smoothing": plot}


def remedies() -> Plots:
    """Find remedies for three set-ups: a shift, an interior jump, a slow technique."""
    mis = mcs.MultipleImportance(
        mcs.integrand("polynomial(coefficients=[0.5, 0, 1])", dims=1),
        ["uniform", "piecewise-constant(values=[1, 2, 3])"],
    )
    setups = {
        "smooth, shifted": (SMOOTH, "jittered | shift"),
        "edge inside": ("disk(center=0.47)", "jittered"),
        "slow technique": (mis, "jittered"),
    }
    found = {}
    for name, (estimator, sampler) in setups.items():
        d = mcs.remedies(estimator, sampler, 1024, realizations=1000, rng=1)
        print(f"{name}: {d.attrs['diagnosis']}")
        for remedy in d["remedy"].values:
            row = d.sel(remedy=remedy)
            print(f"  {remedy}: error ratio "
                  f"{with_interval(row['error_ratio'], row['error_ratio_ci'], '.3g')}, "
                  f"rate {with_interval(row['rate'], row['rate_ci'])}, "
                  f"{row['verdict'].item()}")  # fmt: skip
        print(f"  {d.attrs['answer']}")
        found[name] = d
    return {"remedies": describe("remedies", found)}


PAGES: dict[str, Callable[[], Plots]] = {
    "mis-slowest": mis_slowest,
    "homogenisation-and-mirroring": homogenisation,
    "alignment": alignment,
    "smoothing": smoothing,
    "channels": channels,
    "infinite-weights": infinite_weights,
    "warps": warps,
    "remedies": remedies,
}
"""Functions that make the figures of each page, by the name of the page."""


def main(*flags: str) -> None:
    """Print all numbers; with ``--plot``, also save them and the figures."""
    kept = []
    for page, make in PAGES.items():
        lines = io.StringIO()
        with contextlib.redirect_stdout(lines):
            plots = make()
        text = f"{page}\n" + "".join(f"  {line}\n" for line in lines.getvalue().splitlines())
        print(text, end="", flush=True)
        kept.append(text)
        if "--plot" in flags:
            for name, plot in plots.items():
                (FOLDER / f"{name}.png").write_bytes(encode(draw(plot))[0])
    if "--plot" in flags:
        (FOLDER / "numbers.txt").write_text("".join(kept), encoding="utf-8")
        print(f"drawn to {FOLDER.relative_to(FOLDER.parents[1])}")


if __name__ == "__main__":
    main()
