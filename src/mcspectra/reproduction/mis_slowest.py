"""Multiple importance sampling has the rate of its slowest technique: two examples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Panel, TextMark
from mcspectra.reproduction.claims import (
    Claim,
    Exhibit,
    Measured,
    known_rate,
    pixel_rate,
    rate_text,
)
from mcspectra.reproduction.panels import plot_of, variance_panel

__all__ = ["exhibit"]

_AT = 0.3
_COUNTS = (16, 32, 64, 128, 256, 512)
_SIDES = (6, 8, 11, 16, 23, 32)  # strata per axis; doubled for full quality
_PIXELS: dict[str, dict[str, Any]] = {
    "wall": {"scene": "veach", "x": 568, "y": 100, "light": "light-3"},
    "plate": {"scene": "veach", "x": 600, "y": 430, "light": "light-3"},
}
_WHERE = {"wall": "the diffuse wall", "plate": "the roughest plate"}
_RATES = {"light sampling": -2.0, "BSDF sampling": -1.5, "MIS": -1.5}
TECHNIQUES = {"f = x": -3.0, f"1[x < {_AT}]": -2.0}


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure single techniques and their sum, for a 1-D example and for two pixels."""
    toy = toy_curves(400 if quick else 4000, seed)
    sides = [side if quick else 2 * side for side in _SIDES]
    pixels = {name: _pixel(name, sides, 80 if quick else 250, seed) for name in _PIXELS}
    light, bsdf, mis = (rate_text(pixels["wall"].isel(estimator=i)) for i in range(3))
    known = dict(zip(toy, (exact(0), exact(1), exact(0) + exact(1)), strict=True))
    bottleneck = toy["sum"].attrs["bottleneck"]
    variances = np.array([mcs.exact_variance(_toy(), "jittered", n) for n in _COUNTS])
    return Exhibit(
        numbers={"light": light, "bsdf": bsdf, "mis": mis},
        plots=(
            plot_of("mis-slowest", _techniques("wall", pixels["wall"])),
            plot_of("mis-plate", _techniques("plate", pixels["plate"])),
            plot_of(
                "toy-techniques",
                variance_panel(
                    toy,
                    exact=known,
                    title="two techniques and their sum",
                    x="number of points N of each technique",
                ),
            ),
        ),
        claims=(
            *(
                known_rate(
                    f"Toy: rate of the technique {name}, jittered.", toy[name], rate, known[name]
                )
                for name, rate in TECHNIQUES.items()
            ),
            known_rate(
                "Toy: the sum has the rate of the slower technique.", toy["sum"], -2.0, known["sum"]
            ),
            Claim(
                "Toy: the technique whose interval of the rate is above all others is the slowest.",
                bottleneck,
                holds=bottleneck == "technique 1",
                shown="technique 1",
            ),
            Claim(
                "Toy: the variance of the sum is 1/(12N³) + {aN}(1 − {aN})/N² with the fractional "
                "part {·}: largest relative difference.",
                float(np.abs(variances / known["sum"] - 1).max()),
                at_most=1e-9,
            ),
            *(
                pixel_rate(
                    f"Veach's scene, {_WHERE[where]}: rate of {name}, jittered.",
                    found.isel(estimator=i),
                    rate,
                )
                for where, found in pixels.items()
                for i, (name, rate) in enumerate(_RATES.items())
            ),
            *(_follows(where, found) for where, found in pixels.items()),
            *(_what_is_left(where, found) for where, found in pixels.items()),
        ),
    )


def _toy() -> Any:
    return mcs.estimators.TechniqueSum(["linear", f"step(at={_AT})"], dims=1)


def toy_curves(realizations: int, seed: int) -> dict[str, xr.Dataset]:
    """Measure the convergence of the two techniques and of their sum."""
    data = mcs.technique_terms(
        _toy(), "jittered", _COUNTS, half_width=1, realizations=realizations, rng=seed
    )
    names = {f"technique_{name}": name for name in ("rate", "rate_ci", "variance", "variance_ci")}
    curves = {
        name: data.sel(technique=k)[list(names)].rename(names) for k, name in enumerate(TECHNIQUES)
    }
    whole = data[["rate", "rate_ci", "measured_variance", "measured_variance_ci"]]
    curves["sum"] = whole.rename(measured_variance="variance", measured_variance_ci="variance_ci")
    return curves


def exact(technique: int) -> Array:
    """Return the variance: 1/(12n³) for f = x, or s(1 − s)/n² for 1[x < a], where s = a n mod 1."""
    n = np.array(_COUNTS, float)
    part = _AT * n % 1.0
    return np.asarray(1 / (12 * n**3) if technique == 0 else part * (1 - part) / n**2)


def _pixel(where: str, sides: Sequence[int], realizations: int, seed: int) -> xr.Dataset:
    """Measure five estimators: light sampling, BSDF sampling, MIS, and the two parts of MIS."""
    place = _PIXELS[where]
    alone, mis = mcs.rendering.pixel_strategies(**place), mcs.rendering.pixel_mis(**place)
    parts = [mis.primary_integrand(t) for t in (0, 1)]
    return mcs.convergence(
        [alone["light"], alone["bsdf"], mis, *parts],
        "jittered",
        [side**2 for side in sides],
        realizations=realizations,
        rng=seed,
    )


def _techniques(where: str, found: xr.Dataset) -> Panel:
    """Plot the variances of both techniques and of MIS, with lines of the theoretical slopes."""
    panel = variance_panel(
        {name: found.isel(estimator=i) for i, name in enumerate(_RATES)},
        rates=_RATES,
        relative=True,
        title=f"a pixel of {_WHERE[where]}, jittered",
        x="samples N of each technique",
        beside=0.4,
    )
    marks = (
        replace(mark, text=mark.text.replace("slope", "theory"))
        if isinstance(mark, TextMark)
        else mark
        for mark in panel.marks
    )
    return replace(panel, marks=tuple(marks))


def _follows(where: str, found: xr.Dataset) -> Claim:
    """Compare the rate of MIS with the rate of BSDF sampling. The two estimates are independent."""
    bsdf, mis = (Measured.of(found.isel(estimator=i), "rate") for i in (1, 2))
    return Claim(
        f"Veach's scene, {_WHERE[where]}: rate of MIS minus rate of BSDF sampling.",
        mis - bsdf,
        expected=0.0,
        tolerance=0.125,
        shown="0 ± 0.12",
        note="Tolerance: a quarter of the distance to the rate of light sampling.",
    )


def _what_is_left(where: str, found: xr.Dataset) -> Claim:
    """Compare the variances of the two techniques in MIS at the largest N."""
    light, bsdf = (found.isel(estimator=i, n=-1) for i in (3, 4))
    return Claim(
        f"Veach's scene, {_WHERE[where]}: at N = {int(light['n'])} the BSDF technique dominates "
        "the variance of MIS: variance of the BSDF technique divided by variance of the light "
        "technique.",
        Measured.of(bsdf, "variance") / Measured.of(light, "variance"),
        above=1.0,
    )
