"""Views of a measured spectrum that ``spectrum --show`` prints: a table as text, and the JSON data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.common import text_table

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["VIEWS", "View"]

View = Callable[["xr.Dataset"], tuple[str, dict[str, Any]]]
"""Of the dataset of `power_spectrum`: the text, and what is printed as JSON."""


def _power(spectrum: xr.Dataset) -> tuple[str, dict[str, Any]]:
    n, dims = spectrum.attrs["n"], len(spectrum["power"].dims)
    radius, power = spectrum["radius"].values, spectrum["radial_power"].values
    error = spectrum["radial_power_se"].values
    rows = [
        [f"{r:.4g}", f"{r / n ** (1 / dims):.3f}", f"{n * p:.5g}", _shown(n * se)]
        for r, p, se in zip(radius, power, error, strict=True)
    ]
    text = text_table(["|m|", "|m|/n^(1/d)", "n·power", "std. error"], rows)
    return text, _data(spectrum, spectrum.attrs, ("radius", "radial_power", "radial_power_se"))


def _radial(spectrum: xr.Dataset) -> tuple[str, dict[str, Any]]:
    from mcspectra.spectra.shapes import radial_statistics

    found, n = radial_statistics(spectrum), spectrum.attrs["n"]
    names = ("radial_power", "radial_power_se", "anisotropy_db", "anisotropy_noise_db")
    header = ["|m|", "", "n·power", "std. error", "anisotropy dB", "noise alone dB"]
    columns = [found[name].values for name in ("radius", *names)]
    rows = [
        [f"{r:.4g}", "", *map(_shown, (n * power, n * error, *anisotropy))]
        for r, power, error, *anisotropy in zip(*columns, strict=True)
    ]
    return text_table(header, rows), _data(found, spectrum.attrs, ("radius", *names, "anisotropy"))


def _slices(spectrum: xr.Dataset) -> tuple[str, dict[str, Any]]:
    from mcspectra.spectra.shapes import slices

    found, n = slices(spectrum), spectrum.attrs["n"]
    columns = (found[name].values.ravel() for name in ("slice_power", "slice_power_se"))
    labels = np.repeat(found["slice"].values, found.sizes["multiple"])
    radius = found["slice_radius"].values.ravel()
    rows = [
        [str(label), f"{r:.4g}", _shown(n * power), _shown(n * se)]
        for label, r, power, se in zip(labels, radius, *columns, strict=True)
    ]
    names = ("slice", "multiple", "slice_radius", "slice_power", "slice_power_se")
    text = text_table(["direction", "|m|", "n·power", "std. error"], rows)
    return text, _data(found, spectrum.attrs, names)


def _wedges(spectrum: xr.Dataset) -> tuple[str, dict[str, Any]]:
    from mcspectra.spectra.shapes import wedge_means

    found, n = wedge_means(spectrum), spectrum.attrs["n"]
    names = ("angle", "wedge_power", "wedge_power_se")
    rows = [
        [f"{angle:.4g}°", "", _shown(n * power), _shown(n * se)]
        for angle, power, se in zip(*(found[name].values for name in names), strict=True)
    ]
    text = text_table(["direction", "", "n·power", "std. error"], rows)
    return text, _data(found, spectrum.attrs, names)


def _exponent(spectrum: xr.Dataset) -> tuple[str, dict[str, Any]]:
    from mcspectra.spectra.shapes import low_frequency_exponent

    found = low_frequency_exponent(spectrum)
    names = ("low_frequency_exponent", "low_frequency_exponent_ci", "exponent_fit_chi2")
    b, (low, high), chi2 = (found[name].values for name in names)
    data = _data(found, {**spectrum.attrs, **found.attrs}, names)
    if np.isnan(b):
        return f"no exponent: {found.attrs['reason']}", data
    directions = found.attrs["directions"]
    where = "" if directions == "all" else f", directions {directions}"
    window = f"|m| ≤ {found.attrs['up_to']:.4g} ({found.attrs['lengths']} lengths{where})"
    text = (
        f"power ∝ |m|^b for {window}: b = {float(b):.4g}, 95 % interval {low:.4g} … {high:.4g}, "
        f"χ² per degree of freedom {float(chi2):.3g}"
    )
    if "reason" in found.attrs:
        text += f"\n{found.attrs['reason']}"
    return text, data


VIEWS: Mapping[str, View] = {
    "power": _power,
    "radial": _radial,
    "slices": _slices,
    "wedges": _wedges,
    "exponent": _exponent,
}


def _data(found: xr.Dataset, attrs: Mapping[Any, Any], names: Sequence[str]) -> dict[str, Any]:
    about = {str(key): value for key, value in attrs.items()}
    return {**about, **{name: found[name].values for name in names}}


def _shown(value: float) -> str:
    return f"{value:.5g}" if np.isfinite(value) else "–"
