"""Findings about densities: multiple importance sampling, color channels, infinite weights, warps.

Each function prints the numbers of one page in ``docs/findings`` and returns its figures by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import mcspectra as mcs
from benchmarks.finding_figures import Curve, slopes, variance_panels, variance_plot, with_interval
from mcspectra.estimators import split_mixture
from mcspectra.plots.description import Line, Panel, Plot, ReferenceLine
from mcspectra.plots.kinds import describe
from mcspectra.plots.scales import log_axis
from mcspectra.plots.style import GRAY, INK

__all__ = ["channels", "infinite_weights", "mis_slowest", "warps"]

Plots = dict[str, Plot]

COUNTS, LARGE, LONG = (16, 64, 256, 1024), (64, 256, 1024, 4096), (4, 16, 64, 256, 1024, 4096)
LIGHT = "piecewise-constant(values=[0, 0, 0, 1, 1, 0, 0, 0, 0, 0])"  # on the interval [0.3, 0.5]
PIXELS = np.array(
    [[0.3, 0.4, 0.9], [0.2, 0.5, 1.0], [6.0, 1.0, 0.4], [14.0, 12.0, 7.0],
     [0.6, 5.0, 0.8], [0.4, 0.7, 4.0], [0.1, 0.9, 0.3], [1.2, 0.3, 0.2]]
)  # fmt: skip
LUMINANCE = PIXELS @ np.array([0.2126, 0.7152, 0.0722])
TABLE = [[1, 2, 4, 2], [1, 3, 9, 3], [2, 5, 8, 2], [1, 2, 3, 1]]
WARPS = ("marginal", "hierarchical", "hilbert", "alias")


def mis_slowest() -> Plots:
    """Compare two techniques, and heuristics for a technique that jumps at a light's edge."""
    d = mcs.technique_terms(
        mcs.estimators.TechniqueSum(["linear", "step(at=0.3)"], dims=1),
        "jittered", COUNTS, half_width=4, realizations=1000, rng=1,
    )  # fmt: skip
    for t, (rate, theory) in enumerate(zip(d["technique_rate"], (-3, -2), strict=True)):
        print(
            f"technique {t}: rate {with_interval(rate, d['technique_rate_ci'][t])}, theory {theory}"
        )
    print(
        f"sum: rate {with_interval(d['rate'], d['rate_ci'])}; bottleneck: {d.attrs['bottleneck']}"
    )
    fraction = 0.3 * np.array(COUNTS) % 1
    exact = 1 / (12 * np.array(COUNTS) ** 3.0) + fraction * (1 - fraction) / np.array(COUNTS) ** 2.0
    parts = [d.sel(technique=t) for t in (0, 1)]
    curves = {
        "sum, formula": Curve(np.array(COUNTS), exact),
        "sum": Curve.of(d, "measured_variance"),
        "f = 1[x<0.3]": Curve.of(parts[1], "technique_variance"),
        "f = x": Curve.of(parts[0], "technique_variance"),
    }
    edge = "MIS at the edge of a light, exact"
    plot = variance_plot({"each technique and their sum": curves, edge: heuristics()})
    return {"mis-slowest": plot}


def heuristics() -> dict[str, Curve]:
    """Return exact variances for a light of smooth brightness, sampled directly or uniformly."""
    light = mcs.density(LIGHT, dims=1)
    f = mcs.Integrand.from_function(
        lambda x: np.where(light.pdf(x) > 0, 1 + x[..., 0], 0.0), dims=1, integral=0.28
    )
    curves = {}
    for heuristic in ("balance", "power(beta=2)", "power(beta=4)", "maximum"):
        e = mcs.MultipleImportance(f, [light, "uniform"], heuristic=heuristic)
        values = np.array([mcs.exact_variance(e, "jittered", n, tolerance=1e-2) for n in LONG])
        curves[heuristic] = Curve(np.array(LONG), values)
        rates = ", ".join(f"{s:.2f}" for s in slopes(LONG, values))
        print(f"{heuristic}: exact rates between n = 4, 16, …, 4096: {rates}")
    return curves


def toy_environment() -> tuple[Any, list[Any], Any]:
    """Return eight RGB pixels times a cosine, with densities of channels and of luminance."""
    tables = [mcs.densities.PiecewiseConstant(values=PIXELS[:, c]) for c in range(3)]
    scale, cells = PIXELS.mean(axis=0), np.diff(np.sin(np.pi * (np.arange(9) / 8 - 0.5)) / np.pi)
    f = mcs.Integrand.from_function(
        lambda x: (
            np.stack([s * t.pdf(x) for s, t in zip(scale, tables, strict=True)], axis=-1)
            * np.cos(np.pi * (x - 0.5))
        ),
        dims=1,
        integral=PIXELS.T @ cells,
    )
    return f, tables, mcs.densities.PiecewiseConstant(values=LUMINANCE)


def channels() -> Plots:
    """Sample a small environment map by its luminance, and by one density per color channel."""
    ways = mcs.estimators.channel_estimators(*toy_environment())
    curves: dict[str, dict[str, Curve]] = {color: {} for color in ("red", "green", "blue")}
    names = {"one": "luminance", "own": "own density", "mis": "MIS of the three"}
    for way, name in names.items():
        cost = sum(ways[way].counts)
        counts = [n for n in (16, 32, 64, 128, 256, 512, 1024) if n * cost <= 1024]
        d = mcs.convergence(ways[way], "jittered", counts, realizations=600, rng=1)
        for c, color in enumerate(curves):
            cell = d.sel(channel=c)
            print(f"{color}, {name}: rate {with_interval(cell['rate'], cell['rate_ci'])}")
            curve = Curve.of(cell)
            curves[color][name] = Curve(cost * curve.x, curve.values, curve.interval)
    plot = variance_plot(curves, x="evaluations of f", limits=(1e-7, 1e-1))
    return {"channels": plot}


def infinite_weights() -> Plots:
    """Show that measured variances of the mean weight S_0 do not converge if Var(S_0) is infinite.

    A second panel shows variances of jittered points if p is mixed with a uniform density.
    """
    n, sizes = 16, 2 ** np.arange(6, 19)
    f, p = (
        mcs.integrand("polynomial(coefficients=[0, 0, 1])", dims=1),
        mcs.density("linear(slope=2)", dims=1),
    )
    marks: list[Line | ReferenceLine] = []
    for seed in range(4):
        x = mcs.sampler("random", dims=1).draw(n, realizations=int(sizes[-1]), rng=seed)
        weights = 1 / p.pdf(p.sample(x)).reshape(-1, n)
        spread = [n * weights[:r].mean(axis=1).var(ddof=1) for r in sizes]
        at, label = sizes.astype(float), "n Var(S₀), four runs"
        marks.append(Line(x=at, y=np.array(spread), color=GRAY, width=1.0, label=label))
        print(
            f"run {seed}: n Var(S_0) of 64 realizations {spread[0]:.2f}, of 262144 {spread[-1]:.2f}"
        )
    e = mcs.Estimator(f, p)
    d = mcs.convergence(e, "random", [n], realizations=100_000, rng=1)
    interval = 72 * n * d["variance_ci"].values[0]
    print(f"72 n Var(I): exact 1, measured {72 * n * float(d['variance'][0]):.3f} "
          f"({interval[0]:.3f} … {interval[1]:.3f})")  # fmt: skip
    marks.append(ReferenceLine(at=1.0, color=INK, width=1.2, label="72 n Var(I), exact"))
    every = np.concatenate([m.y for m in marks if isinstance(m, Line)])
    left = Panel(
        marks=tuple(marks),
        x=log_axis("realizations", float(sizes[0]), float(sizes[-1])),
        y=log_axis("sample variance × n", min(1.0, float(every.min())), float(every.max())),
        title="f = x², p = 2x, random",
        grid=True,
    )
    title = "jittered, defensive share 0.1"
    (right,) = variance_panels({title: defensive(f, p)}, x="evaluations of f")
    plot = Plot(kind="findings", panels=(left, right), columns=2, wide=True)
    return {"infinite-weights": plot}


def defensive(f: Any, p: Any) -> dict[str, Curve]:
    """Return exact variances of jittered points with p, and with p mixed with a uniform density.

    The split mixture draws a fixed number of points from each density.
    """
    mixture = mcs.density("defensive(density='linear(slope=2)', share=0.1)", dims=1)
    ways = {
        "p alone": mcs.Estimator(f, p),
        "mixture by a coordinate": mcs.Estimator(f, mixture),
        "split 9 : 1": split_mixture(f, mixture),
    }
    curves = {}
    for name, e in ways.items():
        cost = sum(e.counts)
        counts = np.array([16, 64, 256, 1024] if cost == 1 else [2, 7, 26, 102])
        values = np.array(
            [mcs.exact_variance(e, "jittered", int(n), tolerance=1e-2) for n in counts]
        )
        curves[name] = Curve(cost * counts, values)
        print(f"{name}: exact variance {values[-1]:.2e} at {cost * counts[-1]} evaluations, "
              f"rate {slopes(counts, values)[-1]:.2f} before")  # fmt: skip
    return curves


def warps() -> Plots:
    """Compare warps of a table and of a disk: their maps, and variances of jittered points."""
    specs = {w: f"piecewise-constant(values={TABLE}, warp={w!r})" for w in WARPS}
    specs |= {"bilinear": f"bilinear(values={TABLE})"}
    disks = {f"disk, {w}": f"disk(warp={w!r})" for w in ("polar", "concentric")}
    maps = {}
    for name, spec in (specs | disks).items():
        maps[name] = mcs.quality.warp_quality(spec, resolution=128)
        values = ", ".join(
            f"{what.replace('_', ' ')} {float(maps[name][what]):.2f}"
            for what in ("jump_length", "mean_jump", "mean_stretch", "neighbor_expansion")
        )
        print(f"{name}: {values}")
    chosen = {k: v for k, v in maps.items() if k not in ("bilinear",)}
    f = mcs.integrand("gaussian(center=[0.6, 0.5], width=0.25)", dims=2)
    inside = mcs.Integrand.from_function(
        lambda x: np.where(
            ((x - 0.5) ** 2).sum(-1) <= 0.25, np.exp(-3 * x[..., 0] - x[..., 1]), 0.0
        ),
        dims=2,
    )
    both = ["jittered", "jittered | shift"]
    parts = {
        "a table of 4 × 4, jittered": _measured(f, specs, ["jittered"], LARGE),
        "a disk": _measured(inside, disks, both, LARGE),
    }
    return {"warps": describe("warp", chosen), "warps-variance": variance_plot(parts)}


def _measured(
    f: Any, specs: dict[str, str], samplers: Sequence[str], counts: Sequence[int]
) -> dict[str, Curve]:
    """Measure the convergence of f with each density and sampler; print rates with intervals."""
    curves = {}
    for name, spec in specs.items():
        for sampler in samplers:
            d = mcs.convergence(mcs.Estimator(f, spec), sampler, counts, realizations=400, rng=1)
            label = name + ", shifted" * sampler.endswith("shift")
            curves[label] = Curve.of(d)
            ratio = with_interval(d["variance"][-1], d["variance_ci"][-1], ".2e")
            print(
                f"{label}: rate {with_interval(d['rate'], d['rate_ci'])}, variance {ratio} at "
                f"{counts[-1]}"
            )
    return curves
