"""The xarray accessor of results: ``ds.mcspectra.plot()``, ``.figures()`` and ``.summary()``.

mcspectra registers the accessor when it creates or opens a result.
If a dataset was read in another way, import this module before using the accessor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import xarray as xr

from mcspectra.core.checks import as_choice
from mcspectra.core.display import register_accessor
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import VARIABLES
from mcspectra.plots.backend_matplotlib import GivenAxes, draw, panel_axes
from mcspectra.plots.groups import Data, along, as_group, labelled, method_of, pairs, variant_dims
from mcspectra.plots.kinds import PLOT_KINDS, describe, kinds_of
from mcspectra.plots.text import interval, number, rate
from mcspectra.plots.variance import overlaid
from mcspectra.report.sentences import explain
from mcspectra.studies.summary import rows_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Result"]

_SENTENCES = ("diagnosis", "answer", "note")  # attributes of results that contain sentences


@final
class Result:
    """The accessor ``ds.mcspectra``: figures and sentences of a result."""

    def __init__(self, data: xr.Dataset) -> None:
        self._data = data

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of figures that can show this result; the first is the default of `plot`."""
        return kinds_of(self._data)

    def plot(
        self,
        kind: str | None = None,
        *,
        axes: GivenAxes = None,
        ax: Axes | None = None,
        overlay: xr.Dataset | None = None,
    ) -> Axes | list[Axes]:
        """Draw the result with Matplotlib. Notebooks show the figure; ``plt.savefig`` writes it.

        Parameters
        ----------
        kind
            Kind of figure, one of `kinds`. Default: the first of them.
        axes
            Matplotlib axes to draw into, one per panel. Default: new axes.
        ax
            Another name for `axes` if the figure has one panel, as in pandas and xarray.
        overlay
            Predicted variances of the samplers in this result: the result of `predict`.
            The plot ``convergence`` then also shows the predictions and the theoretical slopes.

        Returns
        -------
        matplotlib.axes.Axes or list of matplotlib.axes.Axes
            The axes that were used; the figure is ``axes.figure``.

        Raises
        ------
        ParameterError
            If no figure shows this result, or if the figure `kind` does not fit this result.
            If the number of `axes` is not the number of panels, or `axes` and `ax` are both given.

        Examples
        --------
        >>> import mcspectra as mcs
        >>> curve = mcs.convergence("disk", "jittered", [16, 64], realizations=50)
        >>> curve.mcspectra.plot().get_ylabel()
        'variance'
        """
        if not isinstance(kind, str | None):
            raise ParameterError(
                f"kind is {kind!r:.80}; it is one of {', '.join(self.kinds)}. Give axes by name: "
                "plot(axes=...)."
            )
        if axes is not None and ax is not None:
            raise ParameterError("axes and ax are the same; give one of them.")
        axes = ax if axes is None else axes
        chosen = self._chosen(kind)
        shown: Data = self._data
        if overlay is not None:
            if chosen != "convergence" or not PLOT_KINDS["prediction"].fits(overlay):
                raise ParameterError(
                    "overlay is a result of predict over the plot 'convergence'; the plot is "
                    f"{chosen!r}."
                )
            shown = overlaid(as_group(shown)[0], as_group(overlay)[0])
        figure = draw(describe(chosen, shown), axes, pyplot=axes is None)
        given = axes if isinstance(axes, list | tuple) else getattr(axes, "flat", [axes])
        panels: list[Any] = panel_axes(figure) if axes is None else list(given)
        return panels[0] if len(panels) == 1 else panels

    def figures(self) -> dict[str, Figure]:
        """Return all figures of this result by kind, without registering them in pyplot.

        Raises
        ------
        ParameterError
            If no figure shows this result.
        """
        self._chosen(None)
        return {kind: draw(describe(kind, self._data)) for kind in self.kinds}

    def paper(
        self,
        folder: str | Path,
        *,
        width: str | float | None = None,
        font_size: float | None = None,
        spectra: str = "linear",
        colors: str | None = None,
    ) -> list[Path]:
        """Write figures and tables for a paper, and a LaTeX page that includes them.

        Each figure is written as PDF, PGF and SVG. Tables need the package booktabs.
        Options that are not given follow Matplotlib's rcParams if those were changed.

        Parameters
        ----------
        folder
            Folder for the files. Existing files with the same names are replaced.
        width
            Width of each figure: inches, or a text such as ``"3.33in"`` or ``"84mm"``.
            Default: 3.33 inches.
        font_size
            Size of all texts in points. Default: 8.
        spectra
            Color scale of a bench's spectra: ``"linear"`` or ``"log"``.
        colors
            Color map of spectra: ``"gray"`` or ``"viridis"``.

        Returns
        -------
        list of Path
            Paths of the figures, the tables and ``main.tex``, which is the last.

        Raises
        ------
        ParameterError
            If an option is not allowed, or no figure shows this result.
        FileFormatError, StoreError, StorageError
            If a file cannot be written.
        """
        from mcspectra.report.paper import write_paper

        self._chosen(None)
        options = {"width": width, "font_size": font_size, "spectra": spectra, "colors": colors}
        return write_paper(self._data, folder, **options)  # type: ignore[arg-type]

    def summary(self) -> str:
        """Describe the result in sentences: rates, terms, predictions or numbers."""
        attributes = (self._data.attrs.get(key, "") for key in _SENTENCES)
        said: Iterable[str] = ()
        if "frames-picture" in self.kinds:
            from mcspectra.report.frames_page import frame_findings

            said = frame_findings(self._data)
        elif "map-variance" in self.kinds:
            from mcspectra.report.map_page import map_sentences

            said = map_sentences(self._data)
        elif {"predicted_variance", "limit_rate"} <= set(self._data.data_vars):
            said = _predictions(self._data)
        parts = [*_sentences(self._data), *said, *attributes]
        return " ".join(part for part in parts if part) or "; ".join(_numbers(self._data)) + "."

    def _chosen(self, kind: str | None) -> str:
        if not self.kinds:
            has = ", ".join(map(str, self._data.data_vars)) or "no variables"
            raise ParameterError(f"No figure shows {has:.200}; draw it with xarray's own plot.")
        return self.kinds[0] if kind is None else as_choice("kind", kind, self.kinds)


def _sentences(data: xr.Dataset) -> Iterator[str]:
    """Yield the sentences of `explain` for each estimator, sampler and channel of a result."""
    analysis = next(
        (kind for kind in ("convergence", "terms") if PLOT_KINDS[kind].fits(data)), None
    )
    if analysis is None:
        return
    several = {"estimator", "sampler", "channel", *variant_dims(data)} & set(data.dims)
    for estimator, points, _, each in pairs(data):
        for k, row in enumerate(rows_of(estimator, points, {analysis: each})):
            channel = each.isel(channel=k) if "channel" in each.dims else each
            said = explain(row, channel if analysis == "terms" else None)
            yield f"{row.estimator}, {row.sampler}: {said}" if several else said


def _predictions(data: xr.Dataset) -> Iterator[str]:
    """Yield the predicted variance at the largest n, and the rates, per sampler and method."""
    for _, points, _, whole in pairs(labelled(data)):
        for _, each in along(whole, "method"):
            for channel in range(each.sizes.get("channel", 1)):
                one = (each.isel(channel=channel) if "channel" in each.dims else each).isel(n=-1)
                value, now, limit = (
                    float(one[v]) for v in ("predicted_variance", "local_rate", "limit_rate")
                )
                if math.isnan(value):
                    continue
                name = f"{points} [{channel}]" if "channel" in each.dims else points
                rates = [
                    f"{rate(slope, None, None)} {where}"
                    for slope, where in ((now, "now"), (limit, "at large n"))
                    if math.isfinite(slope)
                ]
                yield (
                    f"{name}: variance {number(value)} at n = {int(one['n'])} by {method_of(one)}"
                    + (f", rate {' and '.join(rates)}" if rates else "")
                    + "."
                )


def _numbers(data: xr.Dataset) -> Iterator[str]:
    """Yield the meaning, value and interval of scalars, and the meaning and dims of arrays."""
    for key in map(str, data.data_vars):
        meaning = data[key].attrs.get("long_name", VARIABLES.get(key, (key, ""))[0])
        if data[key].ndim or data[key].dtype.kind not in "iuf":
            if not key.endswith(("_ci", "_se")):
                yield f"{meaning}: over {', '.join(map(str, data[key].dims)) or 'nothing'}"
            continue
        limits = data.get(f"{key}_ci")
        low, high = (None, None) if limits is None else map(float, limits.values)
        ends = "" if low is None else f" ({interval(low, high)})"
        if not key.endswith("_se"):
            yield f"{meaning}: {number(float(data[key]))}{ends}"


register_accessor()
