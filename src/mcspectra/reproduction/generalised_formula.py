"""The variance as three terms: dc, power, and correlation between frequencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Heatmap,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    TextMark,
)
from mcspectra.plots.kinds import describe
from mcspectra.plots.style import FAINT, INK, TERM_COLORS
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about
from mcspectra.reproduction.panels import in_columns, matrix_panel, plot_of, term_panel

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "sobol | owen")
LINE, BELL = "linear", "gaussian(center=0.35, width=0.12)"
DENSITY = "linear(slope=1)"  # p = ½ + x, for which ∫1/p = ln 3
N = 16
HALF_WIDTH = 40
_UNIT = 1e-5  # of terms in figures
_SHOWN = 10  # half width of the matrices in the figure


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Estimate terms and matrices of all samplers and integrands, and compare with closed forms."""
    realizations = 500 if quick else 5000
    line, bell = (
        {name: terms(mcs.integrand(spec, 1), name, realizations, seed) for name in SAMPLERS}
        for spec in (LINE, BELL)
    )
    by_density = mcs.Estimator(mcs.integrand(BELL, 1), DENSITY)
    weighted = {name: terms(by_density, name, realizations, seed) for name in SAMPLERS[:2]}
    every = [*line.values(), *bell.values(), *weighted.values()]
    variances = {name: float(mcs.exact_variance(by_density, name, N)) for name in weighted}
    integral = float(np.squeeze(mcs.integrand(BELL, 1).integral))

    # Compute the exact second and third variance terms for f(x) = x and jittered points.
    # The exact terms are sums over all frequencies |m| ≤ HALF_WIDTH
    _, *exact = split(exact_matrix(mcs.integrand(LINE, 1), "jittered", None, HALF_WIDTH))

    # Extrapolate the second and the third variance term to all frequencies.
    # If only frequencies |m| ≤ K are summed, the error of a term is of order 1/K
    near, far = (
        np.array(split(exact_matrix(mcs.integrand(LINE, 1), "jittered", None, k)))
        for k in (256, 512)
    )
    limits = {
        "second term is 1/(6N²) − 1/(12N³)": 1 / (6 * N**2) - 1 / (12 * N**3),
        "third term is 1/(6N³) − 1/(6N²)": 1 / (6 * N**3) - 1 / (6 * N**2),
    }

    # For jittered importance samples, sum the terms of the formula with ⟨S_m conj(S_l)⟩.
    # Sum the terms again with ⟨conj(S_m) S_l⟩, as printed on the slides
    f = mcs.integrand(BELL, 1)
    mirrored = mcs.Integrand.from_function(lambda x: f(1.0 - x), dims=1, integral=f.integral)
    matrix = exact_matrix(f, "jittered", DENSITY, 64)
    of_random = exact_matrix(f, "random", DENSITY, 128)
    as_printed = _printed(f, matrix)
    reflected = mcs.Estimator(mirrored, DENSITY)
    known = [float(mcs.exact_variance(e, "jittered", N)) for e in (by_density, reflected)]
    texts = (
        "with ⟨S_m conj(S_l)⟩ the sum is the variance",
        "with ⟨conj(S_m) S_l⟩, as on the slides, it is the variance of the reflected f(1 − x)",
    )
    values = (float(matrix.sum().real), as_printed)

    # Compare the sum of the terms with the truncated variance in each case.
    # The third term of each case is the sum of the off-diagonal entries of its matrix
    errors = [float(d["predicted_variance"] / d["truncated_variance"][-1]) - 1.0 for d in every]
    off = [
        each[~np.eye(len(each), dtype=bool)]
        for each in (data["cross_matrix"].values for data in every)
    ]
    entries = exact_matrix(f, "jittered", DENSITY, _SHOWN)

    # Exact terms over all frequencies. The bell needs only a few frequencies
    terms_of = {
        "f = x, random": (line["random"], (0.0, 1 / (12 * N), 0.0)),
        "f = x, jittered": (line["jittered"], (0.0, *limits.values())),
        "bell, p = ½ + x, random": (
            weighted["random"],
            split(of_random),
        ),
        "bell, p = ½ + x, jittered": (weighted["jittered"], split(matrix)),
    }
    measured = {
        title: Measured.of(data, "measured_variance", log=True)
        for title, (data, _) in terms_of.items()
    }
    cases = [
        (title.rpartition(" ")[2], terms_of[title][1], measured[title], printed)
        for title, printed in (
            ("bell, p = ½ + x, random", _printed(f, of_random)),
            ("bell, p = ½ + x, jittered", as_printed),
        )
    ]
    first, second, third = split(matrix)
    # The third term is a small part of the variance, so measure the variance precisely
    curve = mcs.convergence(by_density, "jittered", [N], realizations=40 * realizations, rng=seed)
    rest = Measured.of(curve.isel(n=0), "variance") - Measured.normal(first + second, 0.0)
    return Exhibit(
        numbers={
            "N": N,
            "third": number(third / _UNIT, 2),
            "measured": number(rest.value / _UNIT, 2),
            "half": number((rest.high - rest.low) / 2 / _UNIT, 1),
            "printed": number((as_printed - first - second) / _UNIT, 2),
        },
        plots=(
            plot_of(
                "exact-matrices",
                *_third_maps(entries),
                _conjugates(
                    (third, as_printed - first - second),
                    rest,
                ),
            ),
            _matrices(1, line),
            _matrices(2, bell),
            plot_of("three-terms", *(_shares(*case) for case in cases)),
            plot_of(
                "four-cases",
                *(
                    term_panel(
                        known_terms, measured[title], _UNIT, title, "" if k % 2 else "terms · 10⁵"
                    )
                    for k, (title, (_, known_terms)) in enumerate(terms_of.items())
                ),
            ),
        ),
        claims=(
            Claim(
                "The three terms sum to the sample variance of the truncated estimates, for "
                f"{len(every)} pairs of sampler and integrand: largest relative difference.",
                float(np.abs(errors).max()),
                at_most=1e-10,
                note="This holds for any number of realizations. The tolerance 1e-9 of the "
                "transforms cancels here.",
            ),
            *(
                Claim(
                    f"f(x) = x, {N} jittered points: the {word} term over |m| ≤ {HALF_WIDTH} "
                    "agrees with the closed form.",
                    Measured.of(line["jittered"], name),
                    expected=value,
                    digits=4,
                )
                for name, word, value in zip(
                    ("power_term", "cross_term"), ("second", "third"), exact, strict=True
                )
            ),
            *(
                Claim(
                    f"f(x) = x, jittered points, all frequencies: the {text}: relative difference.",
                    float(value / known - 1.0),
                    at_most=2e-3,
                    note="Sums up to |m| = 256 and 512, extrapolated in 1/K. The relative error of "
                    "the next order is about (N/K)².",
                )
                for value, (text, known) in zip((2 * far - near)[1:], limits.items(), strict=True)
            ),
            Claim(
                "The first term of random importance samples of p = ½ + x is I² (ln 3 − 1)/N.",
                Measured.of(weighted["random"], "dc_term"),
                expected=integral**2 * (np.log(3.0) - 1.0) / N,
                digits=4,
            ),
            *(
                Claim(
                    f"The formula holds for importance samples: the three terms of {name} points, "
                    "p = ½ + x, sum to the exact variance.",
                    Measured.of(weighted[name], "predicted_variance", log=True),
                    expected=variance,
                    tolerance=1e-3 * variance,
                    shown=f"{number(variance, 4)} ± 0.1 %",
                    note="Tolerance: the border cuts the bell at 1.4 % of its height, so less than "
                    "this remains beyond |m| = 40.",
                )
                for name, variance in variances.items()
            ),
            Claim(
                "Random points of constant density have no third term on f(x) = x.",
                Measured.of(line["random"], "cross_term"),
                expected=0.0,
            ),
            *about(
                "exact-matrices",
                Claim(
                    "The third term is real: imaginary part divided by the sum of the "
                    "magnitudes of "
                    "its entries, largest.",
                    float(max(abs(each.sum().imag) / np.abs(each).sum() for each in off)),
                    at_most=1e-14,
                ),
                *(
                    replace(
                        Claim(
                            "It matters which S is conjugated, for jittered points, p = ½ + x "
                            "and the "
                            f"bell: {text}: relative difference.",
                            value / right - 1.0,
                            at_most=0.01,
                            note=(
                                "The other variance differs by "
                                f"{number(100 * abs(value / wrong - 1.0), 2)} %."
                            ),
                        ),
                        corrects="slides" in text,
                    )
                    for text, value, right, wrong in zip(
                        texts, values, known, known[::-1], strict=True
                    )
                ),
            ),
            *(
                Claim(
                    f"{title}: the exact three terms sum to the measured variance.",
                    measured[title],
                    expected=sum(known_terms),
                    digits=4,
                )
                for title, (_, known_terms) in terms_of.items()
            ),
        ),
    )


def _printed(f: mcs.Integrand, matrix: Array) -> float:
    """Return the sum of conj(f_m) f_l conj(C_ml), given the matrix conj(f_m) f_l C_ml."""
    half = len(matrix) // 2
    coefficient = f.fourier(np.arange(-half, half + 1)[:, None])
    pairs = coefficient.conj()[:, None] * coefficient[None]
    return float((pairs * (matrix / pairs).conj()).sum().real)


def _shares(title: str, known: Sequence[float], variance: Measured, printed: float) -> Panel:
    """Plot the terms, their sum and the sum as printed, divided by the measured variance."""
    panel = term_panel(known, variance, variance.value, title, "divided by the variance")
    share = printed / variance.value
    marks: tuple[Mark, ...] = (
        BarChart(at=np.array([5.3]), value=np.array([share]), color=FAINT, thickness=0.72),
        TextMark(x=5.3, y=share, text=number(share, 2), side="above"),
        TextMark(x=5.3, y=0.5 * share, text="slide", side="middle"),
    )
    return replace(
        panel,
        marks=(*panel.marks, *marks),
        x=replace(panel.x, high=5.9),
        y=replace(panel.y, low=0.0, high=1.25),
    )


def _third_maps(entries: Array) -> list[Panel]:
    """Return maps of the real and imaginary parts of the third term, without the diagonal.

    The diagonal belongs to the other terms. Without a color bar, the maps are larger.
    """
    shown = entries.copy()
    np.fill_diagonal(shown, complex(np.nan, np.nan))
    real = matrix_panel("real part", shown.real)
    imaginary = matrix_panel("imaginary part", shown.imag, y=False)
    scale = replace(real.scales[0], label="")
    panels = []
    for panel in (real, imaginary):
        marks = tuple(
            replace(mark, scale=scale) if isinstance(mark, Heatmap) else mark
            for mark in panel.marks
        )
        y = Axis(label="m", ticks=panel.y.ticks) if panel.y.label else Axis(ticks={})
        panels.append(replace(panel, marks=marks, x=replace(panel.x, label="l"), y=y))
    return panels


def _conjugates(values: Sequence[float], measured: Measured) -> Panel:
    """Plot the third term with ⟨S_m conj(S_l)⟩, and with ⟨conj(S_m) S_l⟩.

    A band is the 95 % interval of the measured third term.
    """
    at, value = np.arange(2.0), np.array(values) / _UNIT
    names = dict(zip(at.tolist(), ("⟨Sₘ Sₗ*⟩", "⟨Sₘ* Sₗ⟩"), strict=True))
    low, high = measured.low / _UNIT, measured.high / _UNIT
    ends, one = np.array([-0.6, 1.6]), np.ones(2)
    texts = (
        TextMark(x=float(x), y=min(float(y), low), text=number(float(y), 2), side="below")
        for x, y in zip(at, value, strict=True)
    )
    middle = measured.value / _UNIT * one
    return Panel(
        marks=(
            BarChart(at=at, value=value, color=TERM_COLORS["cross_term"], thickness=0.6),
            Line(
                x=ends, y=middle, low=low * one, high=high * one, color=INK, dashes="--",
                width=1.4,
            ),
            ReferenceLine(at=0.0, color=INK, width=0.7),
            *texts,
            TextMark(x=0.0, y=low - 3.0, text="measured", side="below"),
            TextMark(x=0.0, y=low - 4.7, text=number(measured.value / _UNIT, 2), side="below"),
        ),
        x=Axis(low=-0.6, high=1.6, ticks=names),
        y=Axis(label="third term · 10⁵", low=1.2 * float(value.min()), high=0.0),
        title="sums",
    )  # fmt: skip


def terms(
    f: mcs.Integrand | mcs.Estimator, sampler: str, realizations: int, seed: int
) -> xr.Dataset:
    """Return the variance terms, including the matrix of the cross term."""
    return mcs.variance_terms(
        f, sampler, N, half_width=HALF_WIDTH, realizations=realizations, rng=seed, cross_matrix=True
    )


def exact_matrix(f: mcs.Integrand, sampler: str, density: str | None, half_width: int) -> Array:
    """Return conj(f_m) f_l C_ml in closed form."""
    m = np.arange(-half_width, half_width + 1)[:, None]
    c = mcs.spectra.closed_form_covariance(sampler, N, m[:, None], m[None], density)
    coefficient = f.fourier(m)
    return np.asarray(coefficient.conj()[:, None] * coefficient[None] * c)


def split(matrix: Array) -> tuple[float, float, float]:
    """Return the first, second and third variance term from the matrix conj(f_m) f_l C_ml."""
    diagonal = np.diag(matrix).real
    first = float(diagonal[len(diagonal) // 2])
    power = float(diagonal.sum()) - first
    return first, power, float(matrix.sum().real) - power - first


def _matrices(place: int, row: Mapping[str, xr.Dataset]) -> Plot:
    return replace(in_columns(describe("cross-matrix", row)), kind=f"cross-matrix-{place}")
