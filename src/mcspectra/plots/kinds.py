"""Kinds of plots: what each shows of a result, and the door through which results become plots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import final

import xarray as xr

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.plots import chains, frames, maps, points, spectra, variance, warps
from mcspectra.plots.anything import anything, shown_variables
from mcspectra.plots.description import Plot
from mcspectra.plots.groups import Data, Group, Styles, as_group, frequency_dims
from mcspectra.plots.style import sampler_styles

__all__ = ["KINDS", "Kind", "describe", "kinds_of"]


@final
@dataclass(frozen=True)
class Kind:
    """A kind of plot.

    Attributes
    ----------
    describe
        Makes the plot of results by name.
    variables
        What a result must have.
    dims
        How many frequency dims it must have; None: any number.
    pixels
        Whether it shows results over the pixels of a picture.
    """

    describe: Callable[[Group, Styles], Plot]
    variables: tuple[str, ...]
    dims: int | None = None
    pixels: bool = False

    def fits(self, data: xr.Dataset) -> bool:
        """Return whether a result has what is shown."""
        if {"y", "x"} <= set(data.dims) and not self.pixels:
            return False
        return not self.lacks(data) and self.dims in (None, len(frequency_dims(data)))

    def lacks(self, data: xr.Dataset) -> list[str]:
        """Return what is shown that a result does not have; labels may be attributes."""
        return [
            v for v in self.variables if v not in data.variables and f"labels_{v}" not in data.attrs
        ]


KINDS: Mapping[str, Kind] = {
    "convergence": Kind(variance.convergence, ("n", "variance", "variance_ci", "mean", "rate", "rate_ci")),
    "terms": Kind(variance.terms, ("dc_term", "power_term", "cross_term", "predicted_variance_ci", "measured_variance_ci")),
    "captured": Kind(variance.captured, ("captured_by_half_width",)),
    "contributions": Kind(spectra.contributions, ("contribution", "power_contribution")),
    "bands": Kind(spectra.bands, ("band_covariance",)),
    "cross-matrix": Kind(spectra.cross_matrix, ("cross_matrix",)),
    "spectrum": Kind(spectra.spectrum, ("power",), 2),
    "lines": Kind(spectra.lines, ("power",), 1),
    "radial": Kind(spectra.radial, ("power", "radial_power")),
    "pair-correlation": Kind(spectra.pair_correlation, ("pair_correlation", "pair_correlation_ci")),
    "points": Kind(points.points, ("points", "axis")),
    "remedies": Kind(variance.remedies, ("remedy", "error_ratio", "error_ratio_ci", "verdict")),
    "techniques": Kind(variance.techniques, ("technique_covariance", "technique_variance_ci")),
    "technique-rates": Kind(variance.technique_rates, ("n", "technique_variance", "technique_rate", "rate_ci")),
    "anova": Kind(variance.anova, ("anova_variance", "anova_variance_se", "subset_label")),
    "profile": Kind(variance.profile, ("n", "variance", "variance_ci", "integral")),
    "exact": Kind(variance.exact, ("n", "exact_variance")),
    "prediction": Kind(variance.prediction, ("n", "predicted_variance", "predicted_variance_ci")),
    "routes": Kind(variance.routes, ("route_variance", "route_variance_ci", "energy_share")),
    "modes": Kind(spectra.modes, ("eigenvalue", "eigenvalue_se", "eigenvalue_share", "mode_vector")),
    "chains": Kind(chains.chains, ("error_share", "chain_spectrum", "fitted_spectrum")),
    "warp": Kind(warps.warp, ("warped", "stretch", "jump")),
    "primary": Kind(warps.primary, ("primary_value", "primary_jump", "face_jump")),
    **{
        kind: Kind(describe, variables, pixels=True)
        for kind, (variables, describe) in {**frames.FRAMES, **maps.MAPS}.items()
    },
    "anything": Kind(anything, (), pixels=True),
}  # fmt: skip
"""The first kind that fits a result is the one that its accessor's ``plot`` draws."""


def kinds_of(data: Data) -> tuple[str, ...]:
    """Return the kinds of plots that show a result; ``anything`` where no other kind does."""
    first = next(iter(as_group(data)[0].values()))
    fitting = (name for name, kind in KINDS.items() if kind.fits(first) and name != "anything")
    return tuple(fitting) or (("anything",) if shown_variables(first) else ())


def describe(kind: str, data: Data, styles: Styles | None = None) -> Plot:
    """Describe a plot of a result, or of several by the name of their sampler.

    Parameters
    ----------
    kind
        One of `KINDS`.
    data
        A dataset, perhaps with the dims estimator and sampler, or datasets by name; of several
        channels the first is shown.
    styles
        How each name is drawn; by default each has a style of its own.

    Raises
    ------
    ParameterError
        No such kind, nothing to draw, or a result of another analysis.
    """
    chosen = KINDS[as_choice("kind", kind, tuple(KINDS))]
    group, note = as_group(data)
    for name, each in group.items():
        if lacking := chosen.lacks(each):
            raise ParameterError(
                f"The result for {name!r} has no {' and no '.join(lacking)}; give a result of the "
                f"analysis that the plot {kind!r} shows."
            )
        if not chosen.fits(each):
            raise ParameterError(
                f"The spectrum of {name!r} has {len(frequency_dims(each))} frequency dims; the plot "
                f"{kind!r} shows {chosen.dims}: use 'radial' for any number of dims."
            )
    plot = chosen.describe(group, styles or sampler_styles(list(group)))
    if not note:
        return plot
    shown = note.removeprefix("Shown: ").rstrip(".")
    titles = [f"{shown}: {panel.title}" if panel.title else shown for panel in plot.panels]
    panels = tuple(replace(p, title=t) for p, t in zip(plot.panels, titles, strict=True))
    return replace(plot, panels=panels, caption=f"{plot.caption} {note}")
