"""Chains in time: their spectrum, and the frequencies that the error of their mean comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from mcspectra.plots.description import Axis, Dots, Line, Mark, Panel, Plot
from mcspectra.plots.groups import Group, Styles, for_each, intervals, numbers
from mcspectra.plots.scales import log_axis
from mcspectra.plots.style import labels, sampler_styles
from mcspectra.plots.text import number

__all__ = ["chains"]

_MOST = 6  # quantities that are told apart


def chains(group: Group, styles: Styles) -> Plot:
    """Spectra with the fit, and shares of the error and of the draws' variance by band.

    Of many quantities those with the fewest effective draws are shown.
    """
    # A curve for each quantity of each result
    single: dict[str, xr.Dataset] = {}
    for name, each in group.items():
        own = name if len(group) > 1 else ""
        if "quantity" not in each.dims:
            single[own or "chains"] = each
        for k in range(each.sizes.get("quantity", 0)):
            one = each.isel(quantity=k)
            single[", ".join(filter(None, [own, str(one["quantity"].item())]))] = one
    worst = sorted(single, key=lambda name: float(single[name]["ess"].fillna(-1.0)))[:_MOST]
    shown = {name: each for name, each in single.items() if name in worst}
    styles = styles if shown.keys() <= styles.keys() else sampler_styles(list(shown))
    names, levels = labels(list(shown), 40), [np.empty(0)]
    spectra: list[Mark] = []
    shares: list[Mark] = []
    for name, each in shown.items():
        low, high = each["band_low"].values, each["band_high"].values
        x = np.sqrt(np.maximum(low, high / 2) * high)  # the lowest band, from 0, as if an octave
        error, draw, measured, fitted = (
            each[key].values
            for key in ("error_share", "draw_share", "chain_spectrum", "fitted_spectrum")
        )
        ends, color, label = each["chain_spectrum_ci"].values, styles[name].color, names[name]
        levels += [measured[measured > 0], fitted[fitted > 0]]
        hover = {
            "chain": [name] * x.size,
            "period in draws": list(map(str, each["band"].values)),
            "spectrum": numbers(measured),
            "95 %": intervals(ends),
            "share of the error": numbers(error, 3),
            "share of the draws": numbers(draw, 3),
        }
        dots = Dots(x=x, y=measured, color=color, marker=styles[name].marker, hover=hover)
        spectra.append(Line(x=x, y=fitted, color=color, label=label))
        spectra.append(replace(dots, low=ends[:, 0], high=ends[:, 1], label=label))
        shares.append(Line(x=x, y=draw, color=color, dashes=":", label=""))
        shares += [Line(x=x, y=error, color=color, label=label), replace(dots, y=error)]
    every = np.concatenate(levels)
    least, most = (float(every.min()), float(every.max())) if every.size else (1.0, 1.0)
    bottom = min(float(each["band_high"].values[0]) for each in shown.values()) / 2
    axis, hidden = log_axis("frequency in cycles per draw", bottom, 0.5), len(single) - len(shown)
    density = log_axis("spectral density S", least / 3, 3 * most)
    still = "" if every.size else "the chains do not move"
    return Plot(
        kind="chains",
        panels=(
            Panel(marks=tuple(spectra), x=axis, y=density, grid=True, note=still),
            Panel(
                marks=tuple(shares), x=axis, y=Axis(label="share", low=0.0, high=1.05), grid=True
            ),
        ),
        caption="Spectrum of the chains in time, measured in octaves with 95 % intervals, and its fit; "
        "below, the share of each octave of the squared error of the mean, and, dotted, of the "
        "variance of the draws."
        + (f" {hidden} quantities of more effective draws are left out." if hidden else ""),
        words="Spectra of chains in time and shares of the error by frequency. "
        + for_each(
            shown, lambda d: f"effective draws {number(float(d['ess']))}, {d['cause'].item()}"
        ),
        height=0.5,
        share="x",
    )
