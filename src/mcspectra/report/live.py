"""Which figures of a report are interactive as well, and what draws them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from mcspectra.report import interactive
from mcspectra.report.collect import EstimatorGroup
from mcspectra.report.style import LineStyle

if TYPE_CHECKING:
    import xarray as xr
    from bokeh.models import LayoutDOM

__all__ = ["live_plot"]

Styles: TypeAlias = Mapping[str, LineStyle]
_Draw: TypeAlias = "Callable[[Mapping[str, xr.Dataset], Styles], LayoutDOM]"


def live_plot(kind: str, group: EstimatorGroup, styles: Styles) -> LayoutDOM | None:
    """Draw the interactive form of a figure; None where it would show nothing more.

    Parameters
    ----------
    kind
        Kind of the static figure, as `picture.Picture` has it.
    group, styles
        Results of an estimator, and how each sampler is drawn.
    """
    if kind not in _LIVE:
        return None
    analysis, draw = _LIVE[kind]
    data = group.having(analysis)
    if kind == "contributions" and any(d.sizes.get("technique", 1) > 1 for d in data.values()):
        return None  # the static figure has a panel for every technique
    return draw(data, styles)


def _bands(data: Mapping[str, xr.Dataset], styles: Styles) -> Any:
    del styles
    return interactive.band_plot(data)


def _styled(name: str) -> _Draw:
    """A function of `interactive`, looked up when it is called: bokeh is slow to import."""

    def draw(data: Mapping[str, xr.Dataset], styles: Styles) -> Any:
        return getattr(interactive, name)(data, styles=styles)

    return draw


_LIVE: Mapping[str, tuple[str, _Draw]] = {
    "convergence": ("convergence", _styled("convergence_plot")),
    "terms": ("terms", _styled("terms_plot")),
    "contributions": ("terms", _styled("contribution_plot")),
    "bands": ("terms", _bands),
    "spectrum": ("spectrum", _styled("spectrum_plot")),
    "radial-power": ("spectrum", _styled("radial_plot")),
    "points": ("points", _styled("points_plot")),
}
