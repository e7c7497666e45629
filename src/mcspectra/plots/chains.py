"""Chains in time: their spectrum, and the frequencies that the error of their mean comes from."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.plots.description import Axis, Bars, Dots, Line, Mark, Panel, Plot
from mcspectra.plots.groups import Group, Styles, for_each, intervals, numbers
from mcspectra.plots.scales import log_axis, name_axis
from mcspectra.plots.style import labels, sampler_styles
from mcspectra.plots.text import MISSING, number, percent

if TYPE_CHECKING:
    import xarray as xr

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
    names, periods = labels(list(shown), 40), dict[str, None]()
    for each in sorted(shown.values(), key=lambda each: -each.sizes["band"]):
        periods |= dict.fromkeys(map(str, each["band"].values))
    places = {period: k for k, period in enumerate(periods)}

    spectra: list[Mark] = []
    shares: list[Mark] = []
    levels = []
    width = 0.8 / len(shown)
    for row, (name, each) in enumerate(shown.items()):
        low, high = each["band_low"].values, each["band_high"].values
        # Bands on a logarithmic axis, the lowest, from 0, as if it were an octave
        x = np.sqrt(np.maximum(low, high / 2) * high)
        color, ends = styles[name].color, each["chain_spectrum_ci"].values
        measured, fitted = (each[f"{kind}_spectrum"].values for kind in ("chain", "fitted"))
        levels += [measured[measured > 0], fitted[fitted > 0]]
        bands = list(map(str, each["band"].values))
        hover = {"chain": [name] * x.size, "period in draws": bands}
        spectra += [
            Line(x=x, y=fitted, color=color, dashes=styles[name].dashes, label=names[name]),
            Dots(
                x=x,
                y=np.where(measured > 0, measured, np.nan),
                color=color,
                marker=styles[name].marker,
                low=ends[:, 0],
                high=ends[:, 1],
                label=names[name],
                hover={**hover, "spectrum": numbers(measured), "95 %": intervals(ends)},
            ),
        ]
        at = np.array([places[band] for band in bands]) + (row + 0.5) * width - 0.4
        for kind, opacity, part in (("draw", 0.35, width), ("error", 1.0, width / 2)):
            value = each[f"{kind}_share"].values
            texts = [percent(share) if np.isfinite(share) else MISSING for share in value.tolist()]
            title = (
                "share of the error" if kind == "error" else "share of the variance of the draws"
            )
            bars = Bars(at=at, value=value, color=color, thickness=0.9 * part, opacity=opacity)
            shares.append(replace(bars, hover={**hover, title: texts}))
    every = np.concatenate(levels)
    least, most = (float(every.min()), float(every.max())) if every.size else (1.0, 1.0)
    bottom = min(float(each["band_high"].values[0]) for each in shown.values()) / 2
    more = ""
    if len(single) > _MOST:
        more = f" Shown are the {_MOST} of {len(single)} quantities of the fewest effective draws."
    return Plot(
        kind="chains",
        panels=(
            Panel(
                marks=tuple(spectra),
                x=log_axis("frequency in cycles per draw", bottom, 0.5),
                y=log_axis("spectral density S", least / 3, 3 * most),
                grid=True,
                note="" if every.size else "the chains do not move",
            ),
            Panel(
                marks=tuple(shares),
                x=name_axis(list(periods), "period in draws", flipped=False),
                y=Axis(label="share", low=0.0, high=1.05),
                grid=True,
            ),
        ),
        columns=1,
        caption="Spectrum of the chains in time, measured with 95 % intervals, and its fit (lines); by "
        "period, shares of the squared error of the mean (narrow bars) and of the variance of the "
        "draws (wide ones)." + more,
        words="Spectra of chains in time and shares of the error by period. "
        + for_each(
            shown,
            lambda each: f"effective draws {number(float(each['ess']))}, {each['cause'].item()}",
        ),
        height=0.5,
    )
