"""Answers to the questions that the talk leaves open as future directions.

The first question is what an analysis reveals about an integrand.
The second question is which methods go beyond importance sampling.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Line,
    Mark,
    Panel,
    ReferenceLine,
    TextMark,
)
from mcspectra.plots.scales import log_axis, name_axis, unit_panel
from mcspectra.plots.style import ACCENT, GRAY, INK, PALETTE, TERM_COLORS
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, known_rate, slope
from mcspectra.reproduction.panels import interval_panel, plot_of, variance_panel
from mcspectra.reproduction.strata_alignment import edge, edge_panel

__all__ = ["exhibit"]

AT = 1 / 3  # position of the upright edge
# The density for importance sampling is the product of the means of f along each axis.
# It has this share of the points left of the edge. The share is 0.6
SHARE = 1.5 * AT / (AT + 0.5)
# With 14, 29, 61 and 124 strata per axis, the edge always cuts a stratum into 0.4 and 0.6
COUNTS = (196, 841, 3721, 15376)
_SIDE = 6  # number of strata per axis in pictures
BUDGET = 256
GIVEN = {
    "upright edge": f"half-space(normal=[1, 0], offset={AT:.4f})",
    "oblique edge": "half-space(normal=[1, 0.618], offset=0.7)",
}
AS_GIVEN, ALIGNED = "strata as given", "strata aligned"
RATES = {ALIGNED: -2.0, AS_GIVEN: -1.5}
_LATTICE = 64  # number of points of the lattice that is designed for half-spaces
_HALF_WIDTH = 40
_BANDS = {"x0": "x₀ alone", "x1": "x₁ alone", "x0x1": "x₀ and x₁"}
_ORDER = 12  # order of the quadrature within a stratum, where estimates are smooth
# Labels in the figure for the samplers that are tried instead of jittered points
_CHANGES = {
    "latin-hypercube": "Latin hypercube",
    "rank1-lattice | shift": "shifted lattice",
    "sobol | owen": "Owen-scrambled Sobol'",
    "antithetic-jittered": "antithetic jittered",
    "as given": "jittered, as given",
    "jittered | shift": "shifted jittered",
    "random": "random",
}
_VERDICTS = {"better": PALETTE[2], "undecided": GRAY, "worse": ACCENT, "given": INK}
_TESTED = ((0.3, 0.6), (0.7, 0.8), (1.0, 0.7), (1.3, 0.5), (0.1, 0.31), (1.45, 0.62))


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Diagnose an integrand that has an edge, and compare remedies with importance sampling."""
    few = 150 if quick else 1000
    tried = {
        name: mcs.remedies(f, "jittered", BUDGET, realizations=few, rng=seed, kinds=["sampler"])
        for name, f in GIVEN.items()
    }
    terms = {
        name: mcs.variance_terms(
            f, "jittered", BUDGET, half_width=_HALF_WIDTH, realizations=few, rng=seed, bands="anova"
        )
        for name, f in GIVEN.items()
    }
    found = tried["upright edge"]
    shares = {name: alone(data) for name, data in terms.items()}
    changes = {
        label: [_ratio(data, name) for data in tried.values()]
        for label, name in (
            ("Latin hypercube", "latin-hypercube"),
            ("shifted lattice", "rank1-lattice | shift"),
        )
    }
    latin, (_, lattice_ratio) = changes.values()

    # Compare strata as given with strata that have a border at the edge
    options: dict[str, Any] = {"realizations": 200 if quick else 1500, "rng": seed}
    sides = [round(n**0.5) for n in COUNTS]
    split = {AS_GIVEN: [SHARE] * len(sides), ALIGNED: [aligned_share(side) for side in sides]}
    # The second color is the color of the strata that the edge cuts
    curves = {
        ALIGNED: _aligned_curve(split[ALIGNED], options),
        AS_GIVEN: mcs.convergence(importance_sampling(SHARE), "jittered", list(COUNTS), **options),
    }
    exact = {
        name: np.array([exact_variance(*pair) for pair in zip(each, sides, strict=True)])
        for name, each in split.items()
    }
    best, given = (Measured.of(curve.isel(n=-1), "variance") for curve in curves.values())
    with tempfile.TemporaryDirectory() as folder:
        lattice = mcs.design(
            "lattice", "half-spaces", _LATTICE, rng=seed, path=Path(folder, "lattice.json")
        )
        ratio = _designed(lattice, 100 if quick else 1000, seed)
    ratios = interval_panel(changes, list(GIVEN), "variance ratio", at=1.0, ratio=True)
    panel = variance_panel(curves, exact=exact, rates=RATES, title="variance", beside=0.6)
    ends = {float(n): str(n) for n in (COUNTS[0], COUNTS[-1])}
    return Exhibit(
        numbers={
            "together": number(100 * (1 - shares["oblique edge"]), 2),
            "times": number(1 / latin[0].value, 2),
            "worse": number(latin[1].value, 2),
            "lattice": number(1 / lattice_ratio.value, 2),
            "align": number((given / best).value, 2),
            "budget": BUDGET,
            "N": COUNTS[-1],
        },
        plots=(
            plot_of(
                "remedies",
                _edges_panel(),
                _share_panel(terms),
                # The text of the slide has the ratios
                replace(
                    ratios,
                    marks=tuple(m for m in ratios.marks if not isinstance(m, TextMark)),
                    title="other samplers",
                ),
            ),
            plot_of(
                "all-remedies",
                *(
                    panel
                    for name in GIVEN
                    for panel in (_band_panel(terms[name], name), _change_panel(tried[name], name))
                ),
            ),
            plot_of(
                "better-than-importance",
                _strata_panel(SHARE, AS_GIVEN, seed),
                _strata_panel(aligned_share(_SIDE), ALIGNED, seed),
                replace(panel, x=replace(panel.x, ticks=ends)),
            ),
        ),
        claims=(
            Claim(
                "The diagnosis names the edge and its remedy, a border of strata.",
                found.attrs["diagnosis"],
                holds="discontinuity" in found.attrs["diagnosis"]
                and "border of strata" in found.attrs["diagnosis"],
                shown="a discontinuity on planes normal to an axis",
            ),
            Claim(
                "Frequencies along single axes have more than 90 % of the variance of an upright "
                "edge, by the terms.",
                shares["upright edge"],
                above=0.9,
            ),
            Claim(
                "They have less than 90 % for an oblique edge.",
                shares["oblique edge"],
                below=0.9,
            ),
            Claim(
                "For an upright edge, a Latin hypercube has less variance than jittered points "
                f"at {BUDGET} evaluations: ratio.",
                latin[0],
                below=1.0,
            ),
            Claim(
                "For an oblique edge it has more: ratio.",
                latin[1],
                above=1.0,
            ),
            Claim(
                "There, a shifted lattice has less: ratio.",
                lattice_ratio,
                below=1.0,
            ),
            *about(
                "better-than-importance",
                Claim(
                    "Importance sampling with strata aligned with the edge: the exact variances "
                    "have the rate −2.",
                    slope(COUNTS, exact[ALIGNED]),
                    expected=-2.0,
                    # The share of points left of the edge is rounded to whole columns of strata
                    tolerance=0.05,
                    shown="−2 ± 0.05",
                ),
                Claim(
                    f"Aligned strata at N = {COUNTS[-1]} have the exact variance.",
                    Measured.of(curves[ALIGNED].isel(n=-1), "variance", log=True),
                    expected=float(exact[ALIGNED][-1]),
                    digits=4,
                ),
                known_rate(
                    "Importance sampling keeps the edge: the rate is −1.5 if it cuts strata.",
                    curves[AS_GIVEN],
                    -1.5,
                    exact[AS_GIVEN],
                ),
                Claim(
                    f"At N = {COUNTS[-1]}, aligned strata have less variance than the same "
                    "importance sampling with strata as given: ratio.",
                    given / best,
                    above=1.0,
                ),
                Claim(
                    f"A lattice of {_LATTICE} points designed for half-spaces has less variance on "
                    f"{len(_TESTED)} other half-spaces than jittered points: ratio of mean "
                    "variances.",
                    ratio,
                    below=1.0,
                ),
            ),
        ),
    )


def parts(data: xr.Dataset) -> Array:
    """Return shares of the variance terms for each of `_BANDS`: along x₀, x₁, and both axes."""
    names = str(data["band"].attrs["labels"]).split(", ")
    rows = data["band_covariance"].sum("band_other").values
    return np.asarray([rows[names.index(band)] / rows.sum() for band in _BANDS])


def alone(data: xr.Dataset) -> float:
    """Return the share of frequencies along single axes in the sum of all variance terms."""
    return float(parts(data)[:2].sum())


def _ratio(data: xr.Dataset, name: str) -> Measured:
    """Return the variance after a change divided by the variance as given."""
    row = data.sel(remedy=name)
    low, high = map(float, row["error_ratio_ci"].values)
    return Measured(float(row["error_ratio"]), low, high, log=True)


def _band_panel(data: xr.Dataset, title: str) -> Panel:
    """Return bars of the second and third term in each band, of their sum, and of the variance."""
    half = data["contribution"].sizes["m0"] // 2
    m = np.abs(np.arange(-half, half + 1))
    first, second = np.meshgrid(m > 0, m > 0, indexing="ij")
    power = 1e4 * data["power_contribution"].values
    cross = 1e4 * data["contribution"].values - power
    masks = {"x0": first & ~second, "x1": ~first & second, "x0x1": first & second}
    rows = [(power[mask].sum(), cross[mask].sum()) for mask in masks.values()]
    whole = Measured.of(data, "measured_variance") / 1e-4
    at, value = np.arange(len(rows)), np.array(rows)
    bars = [
        BarChart(at=at + away, value=each, color=TERM_COLORS[key], thickness=0.24, label=label)
        for key, each, away, label in (
            ("power_term", value[:, 0], -0.26, "second term"),
            ("cross_term", value[:, 1], 0.0, "third term"),
            ("predicted_variance", value.sum(axis=1), 0.26, "second + third"),
        )
    ]
    last = float(len(rows))
    total = float(value.sum())
    bars += [
        BarChart(
            at=np.array([last]), value=np.array([total]), thickness=0.24,
            color=TERM_COLORS["predicted_variance"],
        ),
        BarChart(
            at=np.array([last + 0.26]), value=np.array([whole.value]), thickness=0.24,
            low=np.array([whole.low]), high=np.array([whole.high]), label="measured variance",
            color=TERM_COLORS["measured_variance"],
        ),
    ]  # fmt: skip
    ticks = dict(enumerate(("x₀", "x₁", "x₀ and x₁", "all m")))
    top, bottom = max(float(value.max()), whole.high), min(float(value.min()), 0.0)
    return Panel(
        marks=(*bars, ReferenceLine(at=0.0, color=INK, width=0.7)),
        x=Axis(
            label="axes along which m varies",
            low=-0.5,
            high=last + 0.6,
            ticks={float(k): name for k, name in ticks.items()},
        ),
        y=Axis(label="variance · 10⁴", low=1.1 * bottom, high=1.1 * top),
        title=f"{title}: terms",
    )


def _change_panel(data: xr.Dataset, title: str) -> Panel:
    """Return the variances after some changes, divided by the variance as given."""
    marks: list[Mark] = [ReferenceLine(at=1.0, axis="x", color=INK)]
    ends: list[float] = []
    for k, name in enumerate(_CHANGES):
        row = data.sel(remedy=name)
        low, high = row["error_ratio_ci"].values
        verdict = str(row["verdict"].values)
        ends += [low, high]
        marks.append(
            Dots(
                x=np.array([float(row["error_ratio"])]), y=np.array([float(k)]),
                low=np.array([low]), high=np.array([high]), across=True, size=6.0,
                color=_VERDICTS.get(verdict, GRAY),
            )
        )  # fmt: skip
    known = np.array(ends)[np.isfinite(ends)]
    return Panel(
        marks=tuple(marks),
        x=log_axis("variance / variance as given", float(known.min()), float(known.max())),
        y=name_axis(list(_CHANGES.values())),
        title=f"{title}: changes",
        grid=True,
    )


def _edges_panel() -> Panel:
    """Return the edges of both integrands in the unit square."""
    ends = {"upright edge": [AT, AT], "oblique edge": [0.7, 0.082]}
    lines = [
        Line(x=np.array(x), y=np.array([0.0, 1.0]), color=color, width=3.0, label=name)
        for (name, x), color in zip(ends.items(), PALETTE, strict=False)
    ]
    texts = [
        TextMark(x=x, y=y, text=text, side="middle")
        for x, y, text in ((0.16, 0.25, "f = 1"), (0.82, 0.75, "f = 0"))
    ]
    return unit_panel((*lines, *texts), "two integrands")


def _share_panel(terms: dict[str, xr.Dataset]) -> Panel:
    """Return bars of the shares of the variance along x₀, along x₁, and along both axes."""
    marks: list[Mark] = []
    at = np.arange(float(len(_BANDS)))
    for k, (name, data) in enumerate(terms.items()):
        value, places = 100 * parts(data), at + 0.36 * (k - 0.5)
        marks.append(
            BarChart(
                at=places, value=value, color=PALETTE[k], lying=True, thickness=0.34, label=name
            )
        )
        marks += [
            TextMark(x=max(float(v), 0.0), y=float(y), text=f"{v:.0f} %", color=PALETTE[k])
            for v, y in zip(np.abs(value.round()), places, strict=True)
        ]
    return Panel(
        marks=tuple(marks),
        x=Axis(
            label="% of the variance",
            low=0.0,
            high=150.0,
            ticks={0.0: "0", 50.0: "50", 100.0: "100"},
        ),
        y=name_axis(list(_BANDS.values())),
        title="m varies along",
    )


def _strata_panel(share: float, title: str, seed: int) -> Panel:
    """Return the strata of importance sampling on the domain, and a set of points."""
    borders = np.minimum(np.arange(_SIDE + 1) / _SIDE, BELOW_ONE)
    density = _density(share)
    across, up = density.sample(np.stack([borders, borders], axis=-1)).T
    points = density.sample(mcs.sampler("jittered", 2).draw(_SIDE**2, rng=seed)[0])
    return edge_panel(AT, across, up, title, points, y="" if share != SHARE else "y")


def aligned_share(side: int) -> float:
    """Return the share of points left of the edge, rounded to whole columns of strata."""
    return round(SHARE * side) / side


def _density(share: float) -> mcs.Density:
    """Return the density of importance samples, of which a `share` is left of the edge.

    Across, it is constant on both sides of the edge, which is the first border of three cells.
    Along the other axis, it is (AT + y) / (AT + ½).
    """
    heights = [share / AT, *[(1 - share) / (1 - AT)] * 2]
    along = mcs.densities.Linear(slope=1 / (AT + 0.5), dims=1)
    return mcs.densities.Product(parts=[mcs.densities.PiecewiseConstant(values=heights), along])


def importance_sampling(share: float) -> mcs.Estimator:
    """Return importance sampling of an edge plus a ramp by the means of f along each axis.

    The share of points left of the edge is `SHARE`, or `aligned_share`.
    """
    return mcs.Estimator(edge(AT), _density(share))


def exact_variance(share: float, side: int) -> float:
    """Return the variance of jittered importance samples, by quadrature in each row of strata.

    Within a row, f/p has one value left and another value right of the edge.
    A column of strata that the edge cuts mixes both, with the fractions `cut` and 1 − `cut`.
    """
    t, weights = gauss_rule(_ORDER)
    density = _density(share)
    v = (np.arange(side)[:, None] + t) / side
    # Left and right of the edge: mean and mean square of f/p in each row of strata
    first, second = np.empty((2, side)), np.empty((2, side))
    for k, u in enumerate((0.5 * share, 0.5 * (1 + share))):
        x = density.sample(np.stack([np.full_like(v, u), v], axis=-1))
        value = edge(AT)(x) / density.pdf(x)
        first[k], second[k] = value @ weights, value**2 @ weights
    whole = int(np.floor(share * side + 1e-9))
    cut = max(share * side - whole, 0.0)
    within = (second - first**2).sum(axis=1)
    fractions = np.array([cut, 1 - cut])
    mixed = (fractions @ second - (fractions @ first) ** 2).sum()
    total = whole * within[0] + mixed + (side - whole - 1) * within[1]
    return float(total) / side**4


def _aligned_curve(shares: Sequence[float], options: dict[str, Any]) -> xr.Dataset:
    """Measure the variance of aligned strata, whose share depends on the number of points."""
    curves = [
        mcs.convergence(importance_sampling(share), "jittered", [n], **options)
        for share, n in zip(shares, COUNTS, strict=True)
    ]
    return xr.concat([c[["mean", "variance", "variance_ci"]] for c in curves], dim="n")


def _designed(lattice: mcs.Sampler, realizations: int, seed: int) -> Measured:
    """Return the mean variance of the lattice over half-spaces, relative to jittered points."""
    options: dict[str, Any] = {"realizations": realizations, "rng": seed}
    tested = [
        f"half-space(normal=[{np.cos(a)}, {np.sin(a)}], offset={offset})" for a, offset in _TESTED
    ]
    both = [mcs.convergence(tested, s, [_LATTICE], **options) for s in (lattice, "jittered")]
    means = []
    for data in both:
        value = data["variance"].values.ravel()
        half = np.diff(data["variance_ci"].values.reshape(-1, 2), axis=1)[:, 0] / 2
        spread = float(np.sqrt((half**2).sum()) / len(value))
        means.append(Measured(v := float(value.mean()), v - spread, v + spread))
    return means[0] / means[1]
