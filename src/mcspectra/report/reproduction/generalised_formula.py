"""The variance as three terms: DC, power and the correlations between frequencies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand
from mcspectra.report.figures.maps import cross_matrices
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._terms import term_bars, term_finding
from mcspectra.report.reproduction.base import Exhibit, Finding, comparison, identity
from mcspectra.report.style import WIDE, new_figure

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.estimators import Estimator
    from mcspectra.integrands import Integrand

__all__ = ["exhibit"]

SAMPLERS = ("random", "jittered", "sobol | owen")
INTEGRANDS = {"f(x) = x": "linear", "bell": "gaussian(center=0.35, width=0.12)"}
DENSITY = "linear(slope=1)"  # p = ½ + x, with ∫1/p = ln 3
_N = 16
_HALF_WIDTH = 40


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Estimate terms and matrices of samplers × integrands, and hold them against closed forms."""
    realizations = 500 if quick else 10_000
    of = {
        label: {name: _terms(integrand(spec, 1), name, realizations, seed) for name in SAMPLERS}
        for label, spec in INTEGRANDS.items()
    }
    weighted = {s: _terms(_weighted(), s, realizations, seed) for s in SAMPLERS[:2]}
    every = [*(d for row in of.values() for d in row.values()), *weighted.values()]
    line = of["f(x) = x"]["jittered"]
    findings = (
        _sum_is_variance(every),
        _third_is_real(every),
        *_line_terms(line),
        *_line_limits(),
        _first(weighted["random"]),
        *(_valid(name, data) for name, data in weighted.items()),
        *_pairing(),
        _only_power(of["f(x) = x"]["random"]),
    )
    return Exhibit(
        name="generalised-formula",
        title="Generalised variance formulation: three terms",
        slide="Generalized Variance Formulation based on Fourier Series: Var(I_N) = I² Var(S₀) + the sum of f_m* f_m "
        "⟨S_m* S_m⟩ over m ≠ 0 + the sum of f_m* f_l ⟨S_m* S_l⟩ over m and l ≠ m. DC component; real and imaginary "
        "coefficients of the third term. Third term is a real entity. Valid for non-uniform PDFs (importance "
        "samples); no homogenization performed; finite sampling domain is properly handled.",
        formula=r"\mathrm{Var}(I_N) = I^2 \mathrm{Var}(S_0) + \sum_{m \neq 0} f_m^* f_m \langle S_m^* S_m \rangle "
        r"+ \sum_m \sum_{l \neq m} f_m^* f_l \langle S_m^* S_l \rangle",
        caption=_caption(of, weighted),
        pictures=(
            *(_matrices(k, label, row) for k, (label, row) in enumerate(of.items())),
            _bars(of, weighted),
        ),
        findings=findings,
    )


def _terms(f: Integrand | Estimator, sampler: str, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.terms import variance_terms

    return variance_terms(
        f,
        sampler,
        _N,
        half_width=_HALF_WIDTH,
        realizations=realizations,
        rng=seed,
        cross_matrix=True,
    )


def _weighted() -> Estimator:
    from mcspectra.estimators import Estimator

    return Estimator(integrand(INTEGRANDS["bell"], 1), DENSITY)


def _caption(of: dict[str, dict[str, xr.Dataset]], weighted: dict[str, xr.Dataset]) -> str:
    line = of["f(x) = x"]["jittered"]
    power, cross = number(float(line["power_term"])), number(-float(line["cross_term"]))
    first, all_ = (number(float(weighted["random"][k])) for k in ("dc_term", "predicted_variance"))
    return (
        f"All of the variance is in a matrix over pairs of frequencies, conj(f_m) f_l Cov(S_m, S_l): its centre is the "
        f"first term, its diagonal the second, all else the third, whose imaginary part cancels. On f(x) = x with "
        f"{_N} jittered points the second term is {power}, of which the third takes back {cross}. With importance "
        f"samples of p = ½ + x the first term no longer vanishes: {first} of {all_} for random points on the bell. "
        "The slides conjugate the other S: that is the variance of the reflected integrand."
    )


def _sum_is_variance(every: list[xr.Dataset]) -> Finding:
    """Against the variance of the estimates truncated at the same frequencies, which is measured."""
    errors = [float(d["predicted_variance"] / d["truncated_variance"][-1]) - 1.0 for d in every]
    return identity(
        f"The three terms sum to the sample variance of the truncated estimates, of {len(every)} pairs of sampler and "
        "integrand: largest relative difference.",
        error=float(np.abs(errors).max()),
        at_most=1e-10,
        note="For any number of realisations; transforms have a tolerance of 1e-9 and cancel here.",
    )


def _third_is_real(every: list[xr.Dataset]) -> Finding:
    errors = []
    for data in every:
        matrix = data["cross_matrix"].values
        off = matrix[~np.eye(len(matrix), dtype=bool)]
        errors.append(abs(off.sum().imag) / np.abs(off).sum())
    return identity(
        "The third term is real: its imaginary part over the sum of the sizes of its entries, largest.",
        error=float(max(errors)),
        at_most=1e-14,
    )


def _exact_matrix(f: Integrand, sampler: str, density: str | None, half_width: int) -> Array:
    """conj(f_m) f_l C_ml in closed form."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    m = np.arange(-half_width, half_width + 1)[:, None]
    c = closed_form_covariance(sampler, _N, m[:, None], m[None], density)
    coefficient = f.fourier(m)
    return np.asarray(coefficient.conj()[:, None] * coefficient[None] * c)


def _split(matrix: Array) -> tuple[float, float, float]:
    """First, second and third term of a matrix."""
    diagonal = np.diag(matrix).real
    first = float(diagonal[len(diagonal) // 2])
    power = float(diagonal.sum()) - first
    return first, power, float(matrix.sum().real) - power - first


def _line_terms(data: xr.Dataset) -> list[Finding]:
    """Against the closed form at the same frequencies."""
    exact = _split(_exact_matrix(integrand("linear", 1), "jittered", None, _HALF_WIDTH))
    return [
        term_finding(
            f"f(x) = x, {_N} jittered points: the {word} term, over |m| ≤ {_HALF_WIDTH}, is that of the closed form.",
            data, name, value,
        )
        for name, word, value in zip(
            ("power_term", "cross_term"), ("second", "third"), exact[1:], strict=True
        )
    ]  # fmt: skip


def _line_limits() -> list[Finding]:
    """Over all frequencies: closed forms summed up to 2^9, and what is left of a 1/K tail extrapolated."""
    near, far = (
        np.array(_split(_exact_matrix(integrand("linear", 1), "jittered", None, k)))
        for k in (256, 512)
    )
    total = 2 * far - near  # tails are proportional to 1/K
    expected = {
        "second term is 1/(6N²) − 1/(12N³)": 1 / (6 * _N**2) - 1 / (12 * _N**3),
        "third term is 1/(6N³) − 1/(6N²)": 1 / (6 * _N**3) - 1 / (6 * _N**2),
    }
    return [
        identity(
            f"f(x) = x, jittered points, all frequencies: the {text}: relative difference.",
            error=float(value / known - 1.0),
            at_most=2e-3,
            note="Sums up to |m| = 256 and 512, extrapolated in 1/K; tails of the next order are some (N/K)² of them.",
        )
        for value, (text, known) in zip(total[1:], expected.items(), strict=True)
    ]


def _first(data: xr.Dataset) -> Finding:
    integral = float(np.squeeze(integrand(INTEGRANDS["bell"], 1).integral))
    return term_finding(
        "The first term of random importance samples of p = ½ + x is I² (ln 3 − 1)/N.",
        data,
        "dc_term",
        integral**2 * (np.log(3.0) - 1.0) / _N,
    )


def _valid(name: str, data: xr.Dataset) -> Finding:
    from mcspectra.variance.exact import exact_variance

    expected = float(exact_variance(_weighted(), name, _N))
    return comparison(
        f"The formula holds for importance samples: the three terms of {name} points of p = ½ + x sum to the exact "
        "variance.",
        expected=expected,
        measured=float(data["predicted_variance"]),
        interval=tuple(map(float, data["predicted_variance_ci"].values)),  # type: ignore[arg-type]
        tolerance=1e-3 * expected,
        scale="log",
        text=f"{number(expected, 4)} ± 0.1 %",
        note="Tolerance: the bell is cut at the border, at 1.4 % of its height: beyond |m| = 40 less than that is left.",
    )


def _pairing() -> list[Finding]:
    """Which S to conjugate: sums of the closed form of random importance samples, f as the bell."""
    from mcspectra.estimators import Estimator
    from mcspectra.integrands.base import Integrand as Function
    from mcspectra.variance.exact import exact_variance

    f = integrand(INTEGRANDS["bell"], 1)
    mirrored = Function.from_function(lambda x: f(1.0 - x), dims=1, integral=f.integral)
    matrix = _exact_matrix(f, "random", DENSITY, 128)
    coefficient = f.fourier(_column(128))
    pairs = coefficient.conj()[:, None] * coefficient[None]
    as_printed = float((pairs * (matrix / pairs).conj()).sum().real)
    known = [float(exact_variance(Estimator(g, DENSITY), "random", _N)) for g in (f, mirrored)]
    values = (float(matrix.sum().real), as_printed)
    texts = (
        "with ⟨S_m conj(S_l)⟩ the sum is the variance",
        "with ⟨conj(S_m) S_l⟩, as the slides print it, it is that of the reflected integrand f(1 − x)",
    )
    return [
        identity(
            f"Which S is conjugated matters, for random points of p = ½ + x and the bell: {text}: relative "
            "difference.",
            error=value / right - 1.0,
            at_most=0.01,
            note=f"The other one differs by {number(100 * abs(value / wrong - 1.0), 2)} %.",
        )
        for text, value, right, wrong in zip(texts, values, known, known[::-1], strict=True)
    ]


def _column(half_width: int) -> Array:
    return np.arange(-half_width, half_width + 1)[:, None]


def _only_power(data: xr.Dataset) -> Finding:
    return term_finding(
        "Random points of constant density have no third term on f(x) = x.", data, "cross_term", 0.0
    )


def _matrices(number_: int, label: str, row: dict[str, xr.Dataset]) -> Picture:
    return Picture(
        kind=f"cross-matrix-{number_ + 1}",
        caption=f"Real (above) and imaginary parts (below) of conj(f_m) f_l Cov(S_m, S_l) of {_N} points, {label}. "
        "In one dim Owen-scrambled Sobol' points are "
        "jittered points. Signed logarithmic colours.",
        alt=f"Six square images over m and l, for {', '.join(row)}: a main diagonal, to which jittered and Sobol' "
        "points add negative stripes 16 apart. Imaginary parts are antisymmetric.",
        figure=cross_matrices(row),
    )


def _bars(of: dict[str, dict[str, xr.Dataset]], weighted: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE, 4.6)
    panels = figure.subplots(2, 3)
    shown = {f"{label}: {name}": d for label, row in of.items() for name, d in row.items()}
    shown = dict(list(shown.items())[:3]) | {
        f"bell, p = ½ + x: {name}": d for name, d in weighted.items()
    } | {f"bell: {SAMPLERS[1]}": of["bell"][SAMPLERS[1]]}  # fmt: skip
    for axes, (title, data) in zip(panels.ravel(), shown.items(), strict=True):
        term_bars(axes, data, 1e-5, title)
    for axes in panels[:, 0]:
        axes.set_ylabel("terms · 10⁵")
    return Picture(
        kind="three-terms",
        caption=f"The three terms and their sum, over |m| ≤ {_HALF_WIDTH}, {_N} points, with 95 % intervals.",
        alt="Six panels of four bars. The first term is 0 but for importance samples; the third is negative for "
        "jittered and Sobol' points and makes the sum much smaller than the second.",
        figure=figure,
    )
