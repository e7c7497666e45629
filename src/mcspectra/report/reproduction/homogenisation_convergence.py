"""What homogenisation does to convergence: where it costs the rate, and where it does not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.formatting import number, rate
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._curves import convergence_panel, known_rate, variance_ratio
from mcspectra.report.reproduction.base import Exhibit, Finding, agreement, comparison, identity
from mcspectra.report.style import WIDE, legend_below, new_figure

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.integrands import Integrand

__all__ = ["exhibit"]

COUNTS = (16, 64, 256, 1024)
_LAST = COUNTS[-1]
_HALF_WIDTH = 384  # the disk's power beyond adds 2e-7 to N times its variance, 1e-2


@dataclass(frozen=True)
class Case:
    """An integrand, and the rates of jittered points on it, plain and shifted."""

    title: str
    spec: str
    dims: int
    plain: float
    shifted: float


CASES = (
    Case("f(x) = x, one dim", "linear", 1, -3.0, -2.0),
    Case("exp(−x² − y²), two dims", "christensen-gaussian", 2, -2.0, -1.5),
    Case("disk, two dims", "disk(center=[0.45, 0.52], radius=0.3)", 2, -1.5, -1.5),
    Case("cos(2π(x + y)), two dims", "cosine(frequency=[1, 1])", 2, -2.0, -2.0),
)
_SAMPLERS = ("jittered", "jittered | shift")
_NET = ("sobol | owen", "sobol | owen | shift")

Curves: TypeAlias = "dict[str, xr.Dataset]"


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure variances with and without a shift, against exact ones."""
    realizations = 1000 if quick else 10_000
    curves = {case.title: _curves(case, realizations, seed) for case in CASES}
    exact = {case.title: {s: _exact(case, s) for s in _SAMPLERS} for case in CASES}
    nets = _curves(CASES[1], min(realizations, 4000), seed, _NET)
    findings = (
        *(
            _rate(case, s, curves[case.title], exact[case.title])
            for case in CASES
            for s in _SAMPLERS
        ),
        _price(curves["f(x) = x, one dim"]),
        _same(exact[CASES[3].title]),
        _nets(nets),
    )
    return Exhibit(
        name="homogenisation-convergence",
        title="Homogenisation affects convergence",
        slide="Homogenization affect Convergence; Homogenization Destroys Good Correlations; Homogenization could "
        "destroy good correlations.",
        caption=_caption(curves, nets),
        pictures=(_picture(curves, exact),),
        findings=findings,
    )


def _integrand(case: Case) -> Integrand:
    from mcspectra.integrands.registry import integrand

    return integrand(case.spec, case.dims)


def _curves(
    case: Case, realizations: int, seed: int, samplers: tuple[str, ...] = _SAMPLERS
) -> Curves:
    from mcspectra.variance.convergence import convergence

    data = convergence(
        _integrand(case), list(samplers), list(COUNTS), realizations=realizations, rng=seed
    )
    return {name: data.sel(sampler=name) for name in samplers}


def _exact(case: Case, sampler: str) -> Array:
    from mcspectra.variance.exact import exact_variance

    if case.title.startswith("disk") and sampler != "jittered":
        return _homogenised(_integrand(case))
    return np.array([float(exact_variance(_integrand(case), sampler, n)) for n in COUNTS])


def _homogenised(f: Integrand) -> Array:
    """Σ |f_m|² ⟨|S_m|²⟩ of jittered points, of an indicator f: (1/N)(∫f² − Σ |f_m|² Π sinc²(πm_i/s))."""
    power = np.abs(f.fourier_grid(_HALF_WIDTH)) ** 2
    m = np.arange(-_HALF_WIDTH, _HALF_WIDTH + 1)
    found = []
    for n in COUNTS:
        window = np.sinc(m / n**0.5) ** 2
        found.append((float(np.squeeze(f.integral)) - window @ power @ window) / n)
    return np.array(found)


def _interval(data: xr.Dataset) -> str:
    return rate(float(data["rate"]), *map(float, data["rate_ci"].values))


def _caption(curves: dict[str, Curves], nets: Curves) -> str:
    each = "; ".join(
        f"{title}: {_interval(c['jittered'])} without, {_interval(c['jittered | shift'])} with a shift"
        for title, c in curves.items()
    )
    a, b = (_interval(nets[name]) for name in _NET)
    return (
        f"Rates of jittered points. {each}. The shift moves strata across the border of the domain, where f jumps "
        "from f(1) to f(0): smooth functions that are not periodic lose up to one power of the strata's side. An "
        "edge inside costs as much already, and periodic functions lose nothing: homogenisation does not always "
        f"matter. Owen-scrambled Sobol' points, on exp(−x² − y²), fall from {a} to {b}."
    )


def _rate(case: Case, sampler: str, curves: Curves, exact: dict[str, Array]) -> Finding:
    expected = case.plain if sampler == "jittered" else case.shifted
    return known_rate(
        f"{case.title}: the variance of {sampler} points has the rate {number(expected, 2)}.",
        curves[sampler],
        expected,
        exact[sampler],
    )


def _price(curves: Curves) -> Finding:
    """(1/(6N²) − 1/(12N³)) / (1/(12N³)) = 2N − 1."""
    value, interval = variance_ratio(*(curves[s].sel(n=_LAST) for s in reversed(_SAMPLERS)))
    return comparison(
        f"On f(x) = x the shift multiplies the variance of jittered points by 2N − 1, at N = {_LAST}.",
        expected=2.0 * _LAST - 1.0,
        measured=value,
        interval=interval,
        scale="log",
    )


def _same(exact: dict[str, Array]) -> Finding:
    error = np.abs(exact["jittered | shift"] / exact["jittered"] - 1.0)
    return identity(
        "Counter-example: of cos(2π(x + y)), which is periodic, the exact variances with and without a shift are "
        "the same, N = 16 … 1024: largest relative difference.",
        error=float(error.max()),
        at_most=1e-12,
    )


def _nets(nets: Curves) -> Finding:
    plain, shifted = (nets[name] for name in _NET)
    value = float(shifted["rate"] - plain["rate"])
    half = math.hypot(*(float(np.ptp(d["rate_ci"].values)) / 2 for d in (plain, shifted)))
    return agreement(
        "Other correlations suffer too: on exp(−x² − y²) the rate of Owen-scrambled Sobol' points is worse with a "
        "shift: difference of the rates.",
        measured=value,
        interval=(value - half, value + half),
        above=0.5,
    )


def _picture(curves: dict[str, Curves], exact: dict[str, dict[str, Array]]) -> Picture:
    figure = new_figure(WIDE, 5.6)
    panels = figure.subplots(2, 2)
    for axes, (title, data) in zip(panels.ravel(), curves.items(), strict=True):
        convergence_panel(axes, data, exact[title], title)
    for axes in panels[:, 0]:
        axes.set_ylabel("variance")
    for axes in panels[0]:
        axes.set_xlabel("")
    legend_below(figure, panels[0, 0])
    return Picture(
        kind="homogenisation-convergence",
        caption="Variance of jittered points with and without a shift: measured, with 95 % intervals, and exact "
        "(lines).",
        alt="Four logarithmic plots against N. The lines part for f(x) = x and exp(−x² − y²), the shifted one "
        "falling less steeply; for the disk they run almost together, for the cosine they coincide.",
        figure=figure,
    )
