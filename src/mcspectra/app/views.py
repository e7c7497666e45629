"""The figures of one set-up: made once, then only their data change.

Every view has a figure and a sentence with its measured numbers, which stands below it for those
who do not see the figure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from mcspectra.app.look import (
    LOOKS,
    Look,
    add_color_bar,
    add_whiskers,
    diverging,
    legend_outside,
    new_figure,
    sequential,
)
from mcspectra.app.state import Setup
from mcspectra.core.checks import Array
from mcspectra.core.fits import line_fit
from mcspectra.estimators.moments import CONFIDENCE_Z, rounding_floor

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.app.compute import PointSet

__all__ = ["VIEWS", "View", "make_views", "signed_log"]

_DECADES = 4.0  # of magnitude on either side of 0 that signed maps show
_MARKS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # on the scale of signed maps
_MOST_BANDS = 48
_TERMS = ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance")


class View(Protocol):
    """A figure of results of one kind."""

    kind: ClassVar[str]
    figure: Any

    def show(self, value: Any) -> str:
        """Show a value of `kind` and return the sentence that belongs to it."""


def signed_log(values: Array) -> Array:
    """Map to [−1, 1]: the sign and, over four decades below the largest, the logarithm of |value|."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if not largest or not np.isfinite(largest):
        return np.zeros(values.shape)
    scaled = 1.0 + np.log10(np.abs(values) / largest + 10.0**-_DECADES) / _DECADES
    return np.asarray(np.sign(values) * np.clip(np.nan_to_num(scaled), 0.0, 1.0))


def _signed_labels(values: Array) -> dict[float, str]:
    """What the marks of the scale of `signed_log` mean for these values."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if not largest or not np.isfinite(largest):
        return {0.0: "0"}
    size = {mark: largest * 10.0 ** (_DECADES * (abs(mark) - 1.0)) for mark in _MARKS}
    return {mark: f"{np.sign(mark) * size[mark]:.1e}" if mark else "0" for mark in _MARKS}


def _signed_bar(figure: Any, mapper: Any, title: str, look: Look) -> Any:
    from bokeh.models import FixedTicker

    return add_color_bar(figure, mapper, title, look, ticker=FixedTicker(ticks=list(_MARKS)))


class PointsView:
    """Points, coloured by their weight 1/p."""

    kind: ClassVar[str] = "points"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import ColumnDataSource, LinearColorMapper

        self._source = ColumnDataSource({"x": [], "y": [], "w": []})
        colors = sequential()[look.darkest :]
        self._mapper = LinearColorMapper(palette=colors, low=0.5, high=1.5)
        self._equal = look.equal
        flat = setup.dims == 1
        self.figure = new_figure(
            "Points and weights", "x₀", "weight 1/p" if flat else "x₁", look,
            x_range=(0, 1), tooltips=[("x", "(@x, @y)"), ("weight 1/p", "@w")],
            **({} if flat else {"y_range": (0, 1)}),
        )  # fmt: skip
        self.figure.scatter(
            "x", "y", source=self._source, size=6, line_color=look.ink, line_width=0.3,
            fill_color={"field": "w", "transform": self._mapper},
        )  # fmt: skip
        self._bar = add_color_bar(self.figure, self._mapper, "1/p", look, visible=False)

    def show(self, value: PointSet) -> str:
        """Show one set."""
        x, w = value.points, value.weights
        y = w if x.shape[1] == 1 else x[:, 1]
        low, high = float(w.min()), float(w.max())
        ends = (low, high) if high > low else self._equal
        self._mapper.update(low=ends[0], high=ends[1])
        self._bar.visible = high > low
        self._source.data = {"x": x[:, 0], "y": y, "w": w}
        spread = "all weights 1" if low == high == 1 else f"weights {low:.3g} to {high:.3g}"
        return f"{len(x)} points, {spread}."


class SpectrumView:
    """Expected power n⟨|S_m|²⟩ on the grid of frequencies: a map, or a curve in one dim."""

    kind: ClassVar[str] = "spectrum"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import ColumnDataSource, LogColorMapper

        self._mapper = LogColorMapper(palette=sequential(), low=1e-3, high=10.0)
        step = "integer" if setup.frequency_step == 1 else "real"
        title = f"Power, {step} frequencies"
        self._flat = setup.dims == 1
        if self._flat:
            self._source = ColumnDataSource({"m": [], "power": []})
            self.figure = new_figure(
                title, "m, cycles per unit", "n⟨|S|²⟩", look, y_axis_type="log",
                tooltips=[("m", "@m"), ("n⟨|S|²⟩", "@power")],
            )  # fmt: skip
            self.figure.line("m", "power", source=self._source, color=look.series[0])
            return
        self._source = _image_source()
        self.figure = _map_figure(title, self._source, self._mapper, look, "n⟨|S|²⟩")
        add_color_bar(self.figure, self._mapper, "n⟨|S|²⟩", look)

    def show(self, value: xr.Dataset) -> str:
        """Show a spectrum; the power at 0 belongs to the constant and is left out."""
        power = value.attrs["n"] * value["power"].to_numpy()
        shown = np.maximum(power, 1e-12)
        shown[tuple(size // 2 for size in shown.shape)] = np.nan
        m = value["m0"].to_numpy()
        if self._flat:
            self._source.data = {"m": m, "power": shown}
        else:
            self._mapper.update(low=1e-3, high=float(np.nanquantile(shown, 0.999)))
            self._source.data = _image_data(shown.T, m, shown.T)
        return (
            f"{value.attrs['realizations']} realisations; mean power over all frequencies "
            f"{np.nanmean(shown):.3g}, of random points 1."
        )


class RadialView:
    """Power averaged over directions, with the level of random points."""

    kind: ClassVar[str] = "spectrum"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import ColumnDataSource
        from bokeh.models.annotations import Span

        del setup
        self._source = ColumnDataSource({"r": [], "power": [], "low": [], "high": []})
        self.figure = new_figure(
            "Radial power", "|m|, cycles per unit", "n⟨|S|²⟩", look,
            y_axis_type="log", tooltips=[("|m|", "@r"), ("n⟨|S|²⟩", "@power")],
        )  # fmt: skip
        color = look.series[0]
        self.figure.varea("r", "low", "high", source=self._source, color=color, alpha=0.25)
        self.figure.line("r", "power", source=self._source, color=color, line_width=2)
        self.figure.add_layout(
            Span(location=1, dimension="width", line_color=look.series[1], line_dash="dashed")
        )

    def show(self, value: xr.Dataset) -> str:
        """Show the radial mean with two standard errors."""
        n = value.attrs["n"]
        r = value["radius"].to_numpy()
        power = np.maximum(n * value["radial_power"].to_numpy(), 1e-12)
        spread = 2 * n * np.nan_to_num(value["radial_power_se"].to_numpy())
        low, high = np.maximum(power - spread, power / 100), power + spread
        self._source.data = {"r": r, "power": power, "low": low, "high": high}
        return f"At the lowest frequencies {power[0]:.3g} of the power of random points."


class ContributionView:
    """The contribution c_m of every frequency to the variance."""

    kind: ClassVar[str] = "terms"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import ColumnDataSource, LinearColorMapper

        title = "Contributions"
        self._flat = setup.dims == 1
        if self._flat:
            self._source = ColumnDataSource({"m": [], "c": []})
            self.figure = new_figure(
                title, "m", "c / variance", look, tooltips=[("m", "@m"), ("c/Var", "@c")]
            )
            self.figure.vbar(x="m", top="c", width=0.8, source=self._source, color=look.series[0])
            return
        mapper = LinearColorMapper(palette=diverging(look), low=-1, high=1)
        self._source = _image_source()
        self.figure = _map_figure(title, self._source, mapper, look, "c_m / variance")
        self._bar = _signed_bar(self.figure, mapper, "c / variance", look)

    def show(self, value: xr.Dataset) -> str:
        """Show the map, colours on a signed logarithm over four decades."""
        c = _one_technique(value["contribution"]) / _measured(value)
        m = value["m0"].to_numpy()
        if self._flat:
            self._source.data = {"m": m, "c": np.nan_to_num(c)}
        else:
            self._source.data = _image_data(signed_log(c).T, m, c.T)
            self._bar.major_label_overrides = _signed_labels(c)
        if not np.isfinite(c).any():
            return "The contributions are not finite here."
        where = np.unravel_index(int(np.nanargmax(np.abs(c))), c.shape)
        at = ", ".join(str(m[i]) for i in where)
        return (
            f"Orange adds, blue takes away; largest at m = ({at}): {c[where]:.3g} of the variance."
        )


class BandsView:
    """Covariance of the estimates limited to bands of frequency."""

    kind: ClassVar[str] = "terms"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import LinearColorMapper

        del setup
        mapper = LinearColorMapper(palette=diverging(look), low=-1, high=1)
        self._source = _image_source()
        self.figure = _map_figure(
            "Covariance of bands", self._source, mapper, look,
            "Cov(I_a, I_b) / variance", axes=("band a, |m|", "band b, |m|"),
        )  # fmt: skip
        self._bar = _signed_bar(self.figure, mapper, "Cov / variance", look)

    def show(self, value: xr.Dataset) -> str:
        """Show the lowest bands."""
        c = value["band_covariance"].to_numpy()[:_MOST_BANDS, :_MOST_BANDS] / _measured(value)
        self._source.data = _image_data(signed_log(c), np.arange(len(c)), c)
        self._bar.major_label_overrides = _signed_labels(c)
        own = float(np.trace(c))
        if not np.isfinite(own):
            return "The covariances are not finite here."
        return f"Within bands {own:.3g} of the variance, between them {np.nansum(c) - own:.3g}."


class TermsView:
    """The three terms, their sum, and the measured variance."""

    kind: ClassVar[str] = "terms"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import ColumnDataSource

        names = ["dc", "power", "cross", "sum", "measured"]
        columns = ("name", "value", "low", "high", "color")
        self._fixed = {"name": names, "color": list(look.series[: len(names)])}
        self._source = ColumnDataSource({key: [] for key in columns})
        self.figure = new_figure(
            f"Terms at n = {setup.n}", "", "variance", look, x_range=names,
            tooltips=[("@name", "@value"), ("95 %", "@low … @high")],
        )  # fmt: skip
        bars = self.figure.vbar(
            x="name", top="value", width=0.7, source=self._source, fill_color="color",
            line_color=None,
        )  # fmt: skip
        self.figure.hover.renderers = [bars]
        add_whiskers(self.figure, self._source, "name", look)

    def show(self, value: xr.Dataset) -> str:
        """Show terms with 95 % intervals; what is not finite has no bar."""
        found = np.array([float(value[name]) for name in _TERMS])
        bounds = np.array([value[f"{name}_ci"].to_numpy() for name in _TERMS])
        top = np.where(np.isfinite(found), found, np.nan)
        low, high = (np.where(np.isfinite(b), b, top) for b in bounds.T)
        self._source.data = {**self._fixed, "value": top, "low": low, "high": high}
        dc, power, cross, predicted, measured = found
        return (
            f"dc {dc:.3g} + power {power:.3g} + cross {cross:.3g} = {predicted:.3g}; "
            f"measured {measured:.4g}, captured {float(value['captured']):.3g}."
        )


class ConvergenceView:
    """Measured variance against n with its fitted rate."""

    kind: ClassVar[str] = "convergence"

    def __init__(self, setup: Setup, look: Look) -> None:
        from bokeh.models import ColumnDataSource, FixedTicker

        del setup
        self._source = ColumnDataSource({"n": [], "v": [], "low": [], "high": []})
        # Kept: a model that is new makes bokeh walk through the whole document, for 0.2 s
        self._ticker = FixedTicker(ticks=[])
        self._lines = ColumnDataSource({"n": [], "fit": [], "random": []})
        self.figure = new_figure(
            "Convergence", "n", "variance", look, x_axis_type="log", y_axis_type="log",
            tooltips=[("n", "@n"), ("variance", "@v")],
        )  # fmt: skip
        blue, orange = look.series[:2]
        for name, color, dash in (("fit", blue, "solid"), ("random", orange, "dashed")):
            self.figure.line(
                "n", name, source=self._lines, color=color, line_dash=dash,
                legend_label="fit" if name == "fit" else "slope −1",
            )  # fmt: skip
        measured = self.figure.scatter("n", "v", source=self._source, size=8, color=blue)
        self.figure.hover.renderers = [measured]
        add_whiskers(self.figure, self._source, "n", look)
        self.figure.xaxis.ticker = self._ticker
        legend_outside(self.figure, look)

    def show(self, value: xr.Dataset) -> str:
        """Show the counts whose variance is above rounding, and the line of the fit."""
        n, v = value["n"].to_numpy().astype(float), value["variance"].to_numpy()
        low, high = value["variance_ci"].to_numpy().T
        mean = value["mean"].to_numpy()
        integral = mean - value["bias"].to_numpy()
        seen = v > rounding_floor(np.maximum(np.abs(mean), np.abs(integral)))
        columns = {"n": n, "v": v, "low": np.maximum(low, v / 100), "high": high}
        self._source.data = {key: column[seen] for key, column in columns.items()}
        rate, bounds = float(value["rate"]), value["rate_ci"].to_numpy()
        if not np.isfinite(rate) or not seen.any():
            self._lines.data = {"n": [], "fit": [], "random": []}
            return "No rate: too few counts have a variance above rounding."
        error = np.log(high[seen] / low[seen]) / (2 * CONFIDENCE_Z)
        fit = line_fit(np.log(n[seen]), np.log(v[seen]), error**-2.0)
        line = np.exp(fit.at(np.log(n), slope=rate))
        self._ticker.ticks = n.tolist()
        self._lines.data = {"n": n, "fit": line, "random": v[seen][0] * n[seen][0] / n}
        left = f"; {np.sum(~seen)} of {len(n)} counts are rounding noise" if not seen.all() else ""
        return (
            f"Fitted rate {rate:.3f}, 95 % interval {bounds[0]:.2f} to {bounds[1]:.2f}; "
            f"{value.attrs['realizations']} realisations{left}."
        )


VIEWS: tuple[type[Any], ...] = (
    PointsView,
    SpectrumView,
    RadialView,
    TermsView,
    ConvergenceView,
    ContributionView,
    BandsView,
)
"""All views, in the order they stand on the page."""


def make_views(setup: Setup, theme: str) -> list[View]:
    """Make empty views of a set-up in a theme."""
    return [view(setup, LOOKS[theme]) for view in VIEWS]


def _measured(value: xr.Dataset) -> float:
    measured = float(value["measured_variance"])
    return measured if measured > 0 else np.nan


def _one_technique(contribution: xr.DataArray) -> Array:
    return np.asarray(
        contribution.sum("technique") if "technique" in contribution.dims else contribution
    )


def _image_source() -> Any:
    from bokeh.models import ColumnDataSource

    columns = ("image", "shown", "x", "y", "dw", "dh")
    return ColumnDataSource({name: [] for name in columns})


def _image_data(image: Array, axis: Array, shown: Array) -> dict[str, Any]:
    """Columns of a square map whose cells are centred on `axis`; `shown` is what hovering tells."""
    step = float(axis[1] - axis[0]) if len(axis) > 1 else 1.0
    start, side = float(axis[0]) - step / 2, step * len(axis)
    return {
        "image": [image.astype(np.float32)],
        "shown": [shown.astype(np.float32)],
        "x": [start], "y": [start], "dw": [side], "dh": [side],
    }  # fmt: skip


def _map_figure(
    title: str,
    source: Any,
    mapper: Any,
    look: Look,
    what: str,
    axes: tuple[str, str] = ("m₀", "m₁"),
) -> Any:
    made = new_figure(title, *axes, look, tooltips=[("at", "($x, $y)"), (what, "@shown")])
    made.image("image", x="x", y="y", dw="dw", dh="dh", source=source, color_mapper=mapper)
    made.x_range.range_padding = made.y_range.range_padding = 0
    made.grid.visible = False
    return made
