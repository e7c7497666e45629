"""The third term encodes phase: strata that are shifted, and functions of equal power spectra."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import convergence_panel, known_rate
from mcspectra.report.reproduction._terms import interval_of
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, comparison, identity
from mcspectra.report.style import INK, PALETTE, WIDE, entitle, legend_below, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from mcspectra.integrands import Integrand

__all__ = ["exhibit"]

COUNTS = (16, 64, 256, 1024)
OFFSETS = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
CURVES = (0.0, 0.125, 0.5)
_N = 16
_HALF_WIDTH = 48
_BAR = "disk(center=0.5, radius=0.25)"  # edges at 1/4 and 3/4, borders of strata of 4^k points
_HIGHEST = 12  # frequency of the two functions of equal power

Scan: TypeAlias = "list[xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Displace strata against edges, and edges against strata."""
    realizations = 1000 if quick else 10_000
    scan = [_terms(o, realizations, seed) for o in OFFSETS]
    curves = {_label(o): _curve(o, realizations, seed) for o in CURVES}
    findings = (
        _same_second(scan),
        _turned(),
        *(_variance(o, data) for o, data in zip(OFFSETS, scan, strict=True) if o in CURVES),
        _signs(scan[0], negative=True),
        _signs(scan[OFFSETS.index(0.5)], negative=False),
        _mean_of_third(),
        *(_rate(o, curves[_label(o)]) for o in CURVES),
        *_equal_power(),
    )
    return Exhibit(
        name="phase",
        title="The third term encodes phase",
        slide="Third term is difficult to analyze. Third Term: Encodes phase (Ramamoorthi et al. 2012). Strata shifting "
        "affects convergence.",
        formula=r"S_m \mapsto e^{-2\pi i\, m \Delta} S_m: \qquad C_{mm} \mapsto C_{mm}, \qquad "
        r"C_{ml} \mapsto e^{-2\pi i\, (m - l) \Delta}\, C_{ml}",
        caption=_caption(scan, curves),
        pictures=(_offsets(scan), _convergence(curves), _functions()),
        findings=findings,
    )


def _label(offset: float) -> str:
    return {
        0.0: "not displaced",
        0.125: "displaced by 1/8 of a side",
        0.5: "displaced by half a side",
    }[offset]


def _sampler(offset: float) -> str:
    return f"jittered | strata-shift(offset={offset})"


def _terms(offset: float, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.terms import variance_terms

    return variance_terms(
        integrand(_BAR, 1), _sampler(offset), _N,
        half_width=_HALF_WIDTH, realizations=realizations, rng=seed,
    )  # fmt: skip


def _smooth() -> Integrand:
    """The bar, and a cosine that gives what is left of the variance when edges cost nothing."""
    from mcspectra.integrands.base import Integrand

    def f(x: Array) -> Array:
        return np.asarray((np.abs(x[..., 0] - 0.5) < 0.25) + np.cos(2 * np.pi * x[..., 0]))

    return Integrand.from_function(f, dims=1, integral=0.5)


def _curve(offset: float, realizations: int, seed: int) -> xr.Dataset:
    from mcspectra.variance.convergence import convergence

    return convergence(
        _smooth(), _sampler(offset), list(COUNTS), realizations=realizations, rng=seed
    )


def exact_bar(offset: float, n: int) -> float:
    """Both edges cut a stratum into shares s = offset and 1 − s: 2 s(1 − s)/N²."""
    return 2 * offset * (1 - offset) / n**2


def exact_curve(offset: float) -> Array:
    """Variances of the bar and the cosine: of each stratum, by quadrature on both sides of its cut."""
    return np.array([_strata_variance(offset, n) for n in COUNTS])


def _strata_variance(offset: float, n: int) -> float:
    node, weight = np.polynomial.legendre.leggauss(8)
    node, weight = (node + 1) / 2, weight / 2
    left, right = (
        node * (1 - offset),
        1 - offset + node * offset,
    )  # cuts are 1 − offset from the left
    t, w = np.concatenate([left, right]), np.concatenate([weight * (1 - offset), weight * offset])
    x = ((np.arange(n)[:, None] + t + offset) / n) % 1.0
    f = _smooth()(x[..., None])
    mean = f @ w
    return float((((f - mean[:, None]) ** 2) @ w).sum()) / n**2


def _caption(scan: Scan, curves: dict[str, xr.Dataset]) -> str:
    third = [float(d["cross_term"]) for d in scan]
    second = number(float(scan[0]["power_term"]))
    rates = ", ".join(
        f"{rate(float(c['rate']), *map(float, c['rate_ci'].values))} ({label})"
        for label, c in curves.items()
    )
    return (
        f"Strata moved by a part of their side keep all |S_m|, and with them the second term, {second} for {_N} "
        f"jittered points and a bar; the third follows the phase, from {number(min(third))} to {number(max(third))}. "
        f"Displacement affects convergence: rates of a bar and a cosine are {rates}. Two functions of equal power "
        "spectra differ in the third term alone."
    )


def _same_second(scan: Scan) -> Finding:
    second = np.array([float(d["power_term"]) for d in scan])
    return identity(
        f"The second term does not depend on where the strata lie, for {len(OFFSETS)} offsets and the same random "
        "numbers: largest relative difference.",
        error=float(np.ptp(second) / second[0]),
        at_most=1e-9,
    )


def _matrix(sampler: str, half_width: int = _HALF_WIDTH) -> tuple[Array, Array]:
    """Frequencies (M, 1) and C_ml in closed form."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    m = np.arange(-half_width, half_width + 1)[:, None]
    return m, closed_form_covariance(sampler, _N, m[:, None], m[None])


def _third(f: Array, c: Array) -> float:
    matrix = f.conj()[:, None] * f[None] * c
    return float((matrix.sum() - np.trace(matrix)).real)


def _turned() -> Finding:
    """The third term of points displaced by Δ is that of f displaced by −Δ: a phase of its coefficients."""
    offset = 0.3
    m, moved = _matrix(_sampler(offset))
    _, c = _matrix("jittered")
    f = integrand(_BAR, 1).fourier(m)
    turned = f * np.exp(2j * np.pi * m[:, 0] * offset / _N)
    return identity(
        "Moving the strata by Δ is the same as turning the phases of f_m by 2πmΔ: difference of the third terms.",
        error=_third(f, moved) - _third(turned, c),
        at_most=1e-14,
    )


def _variance(offset: float, data: xr.Dataset) -> Finding:
    expected = exact_bar(offset, _N)
    low, high = interval_of(data, "measured_variance")
    return comparison(
        f"Bar, strata {_label(offset)}: the variance is 2 s(1 − s)/N², with s = {number(offset)}.",
        expected=expected,
        measured=float(data["measured_variance"]),
        interval=(low, high),
        scale="log",
        tolerance=1e-25,
        note="Tolerance: rounding." if offset == 0.0 else "",
    )


def _signs(data: xr.Dataset, *, negative: bool) -> Finding:
    where = "at borders of strata it is negative" if negative else "in the middle it is positive"
    return agreement(
        f"Phase decides the sign of the third term: with the edges {where}.",
        measured=float(data["cross_term"]),
        interval=interval_of(data, "cross_term"),
        below=0.0 if negative else math.inf,
        above=-math.inf if negative else 0.0,
    )


def _mean_of_third() -> Finding:
    """The mean over equally spaced offsets is exact for all m − l but multiples of 64 strata."""
    f = integrand(_BAR, 1).fourier(_matrix("jittered")[0])
    values = [_third(f, _matrix(_sampler(k / 64))[1]) for k in range(64)]
    return identity(
        "Averaged over all offsets, which is homogenisation, the third term is 0: over its largest size.",
        error=float(np.mean(values) / np.abs(values).max()),
        at_most=1e-12,
    )


def _rate(offset: float, curve: xr.Dataset) -> Finding:
    expected = -3.0 if offset == 0.0 else -2.0
    return known_rate(
        f"Strata shifting affects convergence: bar and cosine, strata {_label(offset)}: rate {number(expected, 2)}.",
        curve,
        expected,
        exact_curve(offset),
    )


def _pair() -> tuple[Array, Array, Array]:
    """Frequencies, and coefficients of two real functions of equal |f_m|: a peak and a spread-out one.

    Phases of the second are those of a chirp, π m²/K.
    """
    m = np.arange(-_HIGHEST, _HIGHEST + 1)[:, None]
    size = 1.0 / (1.0 + np.abs(m[:, 0]))
    return m, size + 0j, size * np.exp(1j * np.pi * np.sign(m[:, 0]) * m[:, 0] ** 2 / _HIGHEST)


def _equal_power() -> list[Finding]:
    _, c = _matrix("jittered", _HIGHEST)
    m, peak, chirp = _pair()
    second = [float(np.abs(f) ** 2 @ np.diag(c).real) for f in (peak, chirp)]
    total = [second[k] + _third(f, c) for k, f in enumerate((peak, chirp))]
    x = _grid_strata()
    direct = [_stratified(x, m, f) for f in (peak, chirp)]
    ratio = total[0] / total[1]
    return [
        identity(
            "Two functions of equal |f_m| have the same second term: relative difference.",
            error=second[0] / second[1] - 1.0,
            at_most=1e-14,
        ),
        identity(
            "Their variances with jittered points differ, and the three terms know it: ratio of both predictions less "
            "that of quadrature over strata.",
            error=ratio - direct[0] / direct[1],
            at_most=1e-9,
            note=f"The ratio is {number(ratio, 4)}.",
        ),
    ]


def _grid_strata() -> Array:
    """Nodes in each of N strata, (N, nodes), of Gauss's rule, and their weights below."""
    node, weight = np.polynomial.legendre.leggauss(16)
    return np.stack([(np.arange(_N)[:, None] + (node + 1) / 2) / _N, np.tile(weight / 2, (_N, 1))])


def _stratified(nodes: Array, m: Array, f: Array) -> float:
    x, weight = nodes
    values = _series(x, m, f)
    mean = (values * weight).sum(axis=1)
    return float(((values - mean[:, None]) ** 2 * weight).sum()) / _N**2


def _series(x: Array, m: Array, f: Array) -> Array:
    return np.asarray((np.exp(2j * np.pi * x[..., None] * m[:, 0]) @ f).real)


def _offsets(scan: Scan) -> Picture:
    figure = new_figure(WIDE, 3.2)
    axes = figure.subplots()
    quiet(axes, grid=True)
    for (name, label), color in zip(
        (("power_term", "second term"), ("cross_term", "third term"), ("predicted_variance", "sum")),
        PALETTE, strict=False,
    ):  # fmt: skip
        values = 1e3 * np.array([float(d[name]) for d in scan])
        ends = 1e3 * np.array([interval_of(d, name) for d in scan])
        axes.errorbar(
            OFFSETS, values, np.abs(ends.T - values), fmt="o-", ms=4, lw=1.2, color=color, label=label
        )  # fmt: skip
    s = np.linspace(0.0, 1.0, 100)
    exact = 1e3 * np.array([exact_bar(t, _N) for t in s])
    axes.plot(s, exact, "--", color=INK, lw=1, label="exact variance, all frequencies")
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.set(xlabel="offset of the strata (sides)", ylabel="terms · 10³", xlim=(-0.02, 1.02))
    legend_below(figure, axes, columns=4)
    return Picture(
        kind="phase-offsets",
        caption=f"Terms of the variance of a bar with {_N} jittered points against the offset of the strata, over "
        f"|m| ≤ {_HALF_WIDTH}, with 95 % intervals.",
        alt="Curves over the offset. The second term is level; the third is negative at 0 and positive at a half; "
        "their sum follows the arch of the exact variance.",
        figure=figure,
    )


def _convergence(curves: dict[str, xr.Dataset]) -> Picture:
    figure = new_figure(WIDE * 0.75, 3.6)
    axes = figure.subplots()
    convergence_panel(
        axes, curves, {_label(o): exact_curve(o) for o in CURVES}, "bar and cosine, jittered points"
    )
    axes.set_ylabel("variance")
    legend_below(figure, axes, columns=3)
    return Picture(
        kind="phase-convergence",
        caption="Variance against the number of points for strata displaced by parts of their side: measured, with "
        "95 % intervals, and exact (lines).",
        alt="Logarithmic plot of three falling lines. That of strata that are not displaced is steeper than the other "
        "two, which are parallel.",
        figure=figure,
    )


def _functions() -> Picture:
    m, peak, chirp = _pair()
    x = np.linspace(0.0, 1.0, 600)
    figure = new_figure(WIDE, 2.7)
    panels = figure.subplots(1, 2)
    _, c = _matrix("jittered", _HIGHEST)
    for axes, f, title in zip(
        panels, (peak, chirp), ("equal phases", "phases πm²/12"), strict=True
    ):
        second = float(np.abs(f) ** 2 @ np.diag(c).real)
        _draw(axes, x, _series(x, m, f), f"{title}: variance {number(second + _third(f, c))}")
    panels[0].set_ylabel("f(x)")
    return Picture(
        kind="phase-functions",
        caption=f"Two functions with the same power spectrum, and their exact variances with {_N} jittered points.",
        alt="On the left a function with one peak at the border of the domain, on the right one whose waves are spread "
        "over the domain.",
        figure=figure,
    )


def _draw(axes: Axes, x: Array, values: Array, title: str) -> None:
    quiet(axes, grid=True)
    axes.plot(x, values, color=PALETTE[0], lw=1.3)
    axes.set(xlabel="x (domain, 0 to 1)", xlim=(0, 1))
    entitle(axes, title)
