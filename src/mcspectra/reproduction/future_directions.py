"""Answers to the questions that the talk leaves open as future directions.

The first question is what an analysis reveals about an integrand.
The second question is which methods go beyond importance sampling.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Heatmap,
    Line,
    Mark,
    Panel,
    ReferenceLine,
    Scale,
)
from mcspectra.plots.scales import log_axis, name_axis, unit_panel
from mcspectra.plots.style import ACCENT, GRAY, INK, PALETTE, TERM_COLORS
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, rate_claim, slope
from mcspectra.reproduction.panels import plot_of, variance_panel
from mcspectra.reproduction.strata_alignment import edge

__all__ = ["exhibit"]

# With 6, 13, 27 and 55 strata per axis, the edge at 2/7 always cuts a stratum into 5/7 and 2/7
COUNTS = (36, 169, 729, 3025)
AT = 2 / 7
OBLIQUE = "half-space(normal=[1, 0.618], offset=0.7)"
BUDGET = 256
RATES = {"uniform points": -1.5, "importance sampling": -1.5, "aligned strata": -2.0}
_TABLE = 8  # cells along each side of the tabulated density for importance sampling
_LATTICE = 64  # number of points of the lattice that is designed for half-spaces
_HALF_WIDTH = 40
_BANDS = {"x0": "x₀", "x1": "x₁", "x0x1": "both"}
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
_STRATA = Scale(
    kind="names",
    names=("right of the edge", "left of the edge", "stratum cut by the edge"),
    colors=("#FFFFFF", "#D6E6F1", "#F5C9A9"),
)
# A stratum counts as cut by the edge if both of its parts are larger than this fraction.
# Smaller parts are the result of rounding
_FEW = 1e-3
_PIXELS, _FINE = 132, 5  # pixels along each side of a picture of strata, and samples per pixel
_TESTED = ((0.3, 0.6), (0.7, 0.8), (1.0, 0.7), (1.3, 0.5), (0.1, 0.31), (1.45, 0.62))


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Diagnose an integrand that has an edge, and compare remedies with importance sampling."""
    few = 150 if quick else 1000
    given: dict[str, Any] = {"edge plus ramp": edge(AT), "oblique edge": OBLIQUE}
    tried = {
        name: mcs.remedies(f, "jittered", BUDGET, realizations=few, rng=seed, kinds=["sampler"])
        for name, f in given.items()
    }
    terms = {
        name: mcs.variance_terms(
            f, "jittered", BUDGET, half_width=_HALF_WIDTH, realizations=few, rng=seed, bands="anova"
        )
        for name, f in given.items()
    }
    found, slanted = tried.values()
    shares = {name: alone(data) for name, data in terms.items()}
    realizations = 200 if quick else 1500
    options: dict[str, Any] = {"realizations": realizations, "rng": seed}
    curves = {
        "uniform points": mcs.convergence(edge(AT), "jittered", list(COUNTS), **options),
        "importance sampling": mcs.convergence(_weighted(), "jittered", list(COUNTS), **options),
        "aligned strata": _measured_aligned(realizations, seed),
    }
    exact = {
        "uniform points": _exact(),
        "aligned strata": np.array(
            [float(mcs.exact_variance(_aligned(n), "jittered", n)) for n in COUNTS]
        ),
    }
    last = {name: Measured.of(curve.isel(n=-1), "variance") for name, curve in curves.items()}
    with tempfile.TemporaryDirectory() as folder:
        lattice = mcs.design(
            "lattice", "half-spaces", _LATTICE, rng=seed, path=Path(folder, "lattice.json")
        )
        ratio = _designed(lattice, 100 if quick else 1000, seed)
    latin = [_ratio(data, "latin-hypercube") for data in tried.values()]
    lattice_ratio = _ratio(slanted, "rank1-lattice | shift")
    align = last["importance sampling"] / last["aligned strata"]
    usual = last["importance sampling"] / last["uniform points"]
    return Exhibit(
        numbers={
            "alone": number(100 * shares["edge plus ramp"], 2),
            "together": number(100 * (1 - shares["oblique edge"]), 2),
            "times": number(1 / latin[0].value, 2),
            "worse": number(latin[1].value, 2),
            "lattice": number(1 / lattice_ratio.value, 2),
            "align": number(align.value, 2),
            "usual": number(usual.value, 2),
            "design": number(ratio.value, 2),
            "budget": BUDGET,
            "N": COUNTS[-1],
        },
        plots=(
            plot_of(
                "remedies",
                *(
                    panel
                    for name in given
                    for panel in (_band_panel(terms[name], name), _change_panel(tried[name], name))
                ),
            ),
            plot_of(
                "better-than-importance",
                _strata_panel(mcs.Estimator(edge(AT)), "uniform points", seed),
                _strata_panel(_weighted(), "importance sampling by f", seed),
                _strata_panel(_aligned(COUNTS[0]), "aligned strata", seed),
                variance_panel(
                    curves,
                    exact=exact,
                    rates=RATES,
                    title="variance, jittered points",
                    beside=0.6,
                ),
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
                "Frequencies along single axes have more than 90 % of the variance of an edge plus "
                "a ramp, by the terms.",
                shares["edge plus ramp"],
                above=0.9,
            ),
            Claim(
                "They have less than 90 % for an oblique edge.",
                shares["oblique edge"],
                below=0.9,
            ),
            Claim(
                "For an edge plus a ramp, a Latin hypercube has less variance than jittered points "
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
                    "Strata aligned with the edge: the exact variances have the rate −2.",
                    slope(COUNTS, exact["aligned strata"]),
                    expected=-2.0,
                    # Rounding the edge to whole strata changes the variance by a fraction 1/s²
                    tolerance=0.05,
                    shown="−2 ± 0.05",
                ),
                Claim(
                    f"Aligned strata at N = {COUNTS[-1]} have the exact variance.",
                    Measured.of(curves["aligned strata"].isel(n=-1), "variance", log=True),
                    expected=float(exact["aligned strata"][-1]),
                    digits=4,
                ),
                rate_claim(
                    "Importance sampling by a table of f keeps the edge: the rate stays near −1.5.",
                    curves["importance sampling"],
                    -1.5,
                    0.25,
                    "Tolerance: half of the distance to −2; exact variances are not known.",
                ),
                Claim(
                    f"At N = {COUNTS[-1]}, aligned strata have less variance than importance "
                    "sampling: ratio.",
                    last["importance sampling"] / last["aligned strata"],
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


def alone(data: xr.Dataset) -> float:
    """Return the share of frequencies along single axes in the sum of all variance terms."""
    names = str(data["band"].attrs["labels"]).split(", ")
    rows = data["band_covariance"].sum("band_other").values
    return float(sum(rows[names.index(axis)] for axis in ("x0", "x1")) / rows.sum())


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
            ("predicted_variance", value.sum(axis=1), 0.26, "sum of both"),
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
    ticks = dict(enumerate((*_BANDS.values(), "all")))
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


def _strata_panel(estimator: mcs.Estimator, title: str, seed: int) -> Panel:
    """Return the strata of an estimator on the domain, a set of points, and the edge."""
    n, side = COUNTS[0], round(COUNTS[0] ** 0.5)

    def placed(u: Array) -> Array:
        return u if estimator.density is None else np.asarray(estimator.density.sample(u))

    # Place fine samples of each stratum on the domain, and find strata with samples on both sides
    fine = _PIXELS * _FINE
    t = (np.arange(fine) + 0.5) / fine
    u = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    x = placed(u)
    of = (u * side).astype(int) @ np.array([side, 1])
    left = np.bincount(of, x[:, 0] < AT) / np.bincount(of)
    kinds = np.where(left < _FEW, 0.0, np.where(left > 1 - _FEW, 1.0, 2.0))
    values = np.full((_PIXELS, _PIXELS), np.nan)
    pixel = np.minimum((x * _PIXELS).astype(int), _PIXELS - 1)
    values[pixel[:, 1], pixel[:, 0]] = kinds[of]
    # Assign a pixel that has no sample to the stratum of the nearest sampled pixel on its left
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(_PIXELS)), axis=1)
    values = np.take_along_axis(values, known, axis=1)
    centers = (np.arange(_PIXELS) + 0.5) / _PIXELS
    marks: list[Mark] = [
        Heatmap(values=values, x=centers, y=centers, scale=_STRATA, name="stratum")
    ]
    # Draw the borders of strata
    s = np.linspace(0.0, 1.0 - 1e-9, 400)
    for border in np.arange(1, side) / side:
        level = np.full_like(s, border)
        for line in (np.stack([level, s], axis=-1), np.stack([s, level], axis=-1)):
            x = placed(line)
            marks.append(Line(x=x[:, 0], y=x[:, 1], color=GRAY, width=0.7))
    dots = placed(mcs.sampler("jittered", 2).draw(n, rng=seed)[0])
    marks += [
        Dots(x=dots[:, 0], y=dots[:, 1], color=PALETTE[0], size=3.5),
        Line(x=np.array([AT, AT]), y=np.array([0.0, 1.0]), color=INK, width=2.0),
    ]
    return unit_panel(marks, title)


def _aligned(n: int) -> mcs.Estimator:
    """Return an estimator whose strata have a border at the discontinuity of the integrand."""
    return mcs.aligned(edge(AT), [[AT], []], n)


def _measured_aligned(realizations: int, seed: int) -> xr.Dataset:
    """Measure the variance with aligned strata, whose borders change with the number of points."""
    options: dict[str, Any] = {"realizations": realizations, "rng": seed}
    curves = [mcs.convergence(_aligned(n), "jittered", [n], **options) for n in COUNTS]
    return xr.concat([c[["mean", "variance", "variance_ci"]] for c in curves], dim="n")


def _weighted() -> mcs.Estimator:
    """Return traditional importance sampling: a density from a table of f."""
    u = (np.arange(16 * _TABLE) + 0.5) / (16 * _TABLE)
    values = np.asarray(edge(AT)(np.stack(np.meshgrid(u, u), axis=-1)))
    table = values.reshape(_TABLE, 16, _TABLE, 16).mean(axis=(1, 3))
    return mcs.Estimator(edge(AT), mcs.densities.PiecewiseConstant(values=table))


def _exact() -> Array:
    """Return exact variances of jittered points."""
    return np.array([float(mcs.exact_variance(edge(AT), "jittered", n)) for n in COUNTS])


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
