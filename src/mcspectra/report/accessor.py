"""Results draw and explain themselves: ``ds.mcspectra.plot()``, ``.figures()``, ``.summary()``.

The accessor is there once mcspectra has made or opened a result; importing this module registers it
for datasets that were read in another way.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

from mcspectra.core.checks import as_choice
from mcspectra.core.display import register_accessor
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import VARIABLES, Variable
from mcspectra.report import figures
from mcspectra.report.figures.groups import frequency_dims
from mcspectra.report.figures.panels import GivenAxes, figure_axes
from mcspectra.report.formatting import interval, number
from mcspectra.report.sentences import explain
from mcspectra.studies import SummaryRow, summarize

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Result", "has_picture"]


@final
@dataclass(frozen=True)
class _Kind:
    """A kind of figure: what draws it, the variables it takes, and how many frequency dims."""

    draw: str
    variables: tuple[str, ...]
    frequency_dims: int | None = None

    def fits(self, data: xr.Dataset) -> bool:
        """Whether a result has all that is drawn."""
        dims = len(frequency_dims(data))
        drawn = self.frequency_dims in (None, dims)
        return drawn and set(self.variables) <= set(map(str, data.variables))

    def __call__(self, data: Any, axes: GivenAxes) -> Figure:
        figure: Figure = getattr(figures, self.draw)(data, axes=axes)
        return figure


# The first that fits is the one that `plot` draws.
_KINDS: Mapping[str, _Kind] = {
    "convergence": _Kind("convergence_curves", ("n", "variance", "variance_ci", "mean", "rate", "rate_ci")),
    "terms": _Kind("three_terms", ("dc_term", "cross_term", "predicted_variance_ci", "measured_variance_ci")),
    "contributions": _Kind("contributions", ("contribution", "power_contribution")),
    "captured": _Kind("captured_curves", ("captured_by_half_width",)),
    "bands": _Kind("band_covariances", ("band_covariance",)),
    "cross_matrix": _Kind("cross_matrices", ("cross_matrix",)),
    "spectrum": _Kind("power_images", ("power",), 2),
    "lines": _Kind("power_lines", ("power",), 1),
    "radial": _Kind("radial_power", ("power", "radial_power")),
    "pair_correlation": _Kind("pair_correlations", ("pair_correlation", "pair_correlation_se")),
    "points": _Kind("point_sets", ("points", "axis")),
    "remedies": _Kind("remedy_ratios", ("remedy", "error_ratio", "error_ratio_ci", "verdict")),
    "warp": _Kind("warp_maps", ("warped", "stretch", "jump")),
    "primary": _Kind("primary_pictures", ("primary_value", "primary_jump", "face_jump")),
}  # fmt: skip


def has_picture(declared: Iterable[str | Variable]) -> bool:
    """Whether results with these variables, as an analysis declares them, can be drawn by `plot`."""
    names = {each if isinstance(each, str) else each.name for each in declared}
    drawn = ({v for v in kind.variables if v in VARIABLES} for kind in _KINDS.values())
    return any(needed <= names for needed in drawn)


_SENTENCES = ("diagnosis", "recommendation", "note")  # attributes that results have


@final
class Result:
    """What ``ds.mcspectra`` is: figures and sentences of a result of mcspectra."""

    def __init__(self, data: xr.Dataset) -> None:
        self._data = data

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of figures that this result can be drawn as, the one of `plot` first."""
        return tuple(name for name, kind in _KINDS.items() if kind.fits(self._data))

    def plot(self, kind: str | None = None, *, axes: GivenAxes = None) -> Axes | list[Axes]:
        """Draw the result.

        Parameters
        ----------
        kind
            One of `kinds`; by default the first.
        axes
            Matplotlib axes to draw into, one or as many as the figure has panels; new ones by
            default.

        Returns
        -------
        matplotlib.axes.Axes, or a list of them
            What was drawn into; the figure is ``axes.figure``.

        Raises
        ------
        ParameterError
            This result cannot be drawn, not as that kind, or `axes` are not as many as are needed.

        Examples
        --------
        >>> import mcspectra as mcs
        >>> curve = mcs.convergence("disk", "jittered", [16, 64], realizations=50)
        >>> curve.mcspectra.plot().get_ylabel()
        'variance'
        """
        drawn = self._figure(self._chosen(kind), axes)
        given = axes if isinstance(axes, list | tuple) else getattr(axes, "flat", [axes])
        panels: list[Any] = figure_axes(drawn) if axes is None else list(given)
        return panels[0] if len(panels) == 1 else panels

    def figures(self) -> dict[str, Figure]:
        """All figures of this result by kind; those of a variance map by ``map_`` and their kind.

        Raises
        ------
        ParameterError
            There is none.
        """
        if _is_map(self._data):
            return {f"map_{kind}": figure for kind, figure in figures.map_figures(self._data)}
        self._chosen(None)
        return {kind: self._figure(kind, None) for kind in self.kinds}

    def summary(self) -> str:
        """What the result says in sentences: rates, terms, or its numbers with their intervals."""
        attributes = (self._data.attrs.get(key, "") for key in _SENTENCES)
        parts = [*_sentences(self._data), *attributes]
        return " ".join(part for part in parts if part) or "; ".join(_numbers(self._data)) + "."

    def _chosen(self, kind: str | None) -> str:
        if not self.kinds:
            has = ", ".join(map(str, self._data.data_vars)) or "no variables"
            raise ParameterError(
                f"No figure shows {has:.200}; draw them with xarray's own plot, or a variance map "
                "with figures()."
            )
        return self.kinds[0] if kind is None else as_choice("kind", kind, self.kinds)

    def _figure(self, kind: str, axes: GivenAxes) -> Figure:
        return _KINDS[kind](_by_name(self._data), axes)


def _by_name(data: xr.Dataset) -> Any:
    """The result, with several estimators or variants by their names: figures know samplers only."""
    if "estimator" not in data.dims and not _variant_dims(data):
        return data
    single = not {"estimator", "sampler"} & set(data.dims)
    return {
        names.variant if single else f"{names.estimator}, {names.points}": each
        for names, each in _pairs(data)
    }


@final
@dataclass(frozen=True)
class _Names:
    estimator: str
    sampler: str
    variant: str = ""

    @property
    def points(self) -> str:
        """The sampler and the variant."""
        return f"{self.sampler}, {self.variant}" if self.variant else self.sampler


def _pairs(data: xr.Dataset) -> Iterator[tuple[_Names, xr.Dataset]]:
    """Every estimator with every sampler, and every variant of them, of a result."""
    for of_estimator, estimator in _split(data, "estimator"):
        for of_sampler, sampler in _split(of_estimator, "sampler"):
            for each, variant in _variants(of_sampler):
                yield _Names(estimator, sampler, variant), each


def _split(data: xr.Dataset, dim: str) -> Iterator[tuple[xr.Dataset, str]]:
    if dim not in data.dims:
        yield data, str(data.attrs.get(f"{dim}_spec", data.attrs.get(dim, dim)))
        return
    for k in range(data.sizes[dim]):
        each = data.isel({dim: k})
        yield each, str(each[dim].values) if dim in each.coords else f"{dim} {k}"


def _variant_dims(data: xr.Dataset) -> list[str]:
    """Dims along which one sampler has several curves, as those of `mirror_study`."""
    if not _KINDS["convergence"].fits(data):
        return []
    known = ("estimator", "sampler", "channel")
    return [str(dim) for dim in data["rate"].dims if dim not in known]


def _variants(data: xr.Dataset) -> Iterator[tuple[xr.Dataset, str]]:
    """Every curve of a sampler, with what tells it from the others."""
    dims = _variant_dims(data)
    for place in itertools.product(*(range(data.sizes[dim]) for dim in dims)):
        at = dict(zip(dims, place, strict=True))
        yield data.isel(at), ", ".join(_label(dim, data[dim].values[k]) for dim, k in at.items())


def _label(dim: str, value: Any) -> str:
    """A place on a dim in few words: ``uniform``, ``not homogenized``, ``width 0.1``."""
    if value.dtype.kind == "b":
        return dim if value else f"not {dim}"
    return str(value) if value.dtype.kind == "U" else f"{dim} {value}"


def _sentences(data: xr.Dataset) -> Iterator[str]:
    """`explain` of every estimator, sampler and channel; nothing for other results."""
    analysis = next((k for k in ("convergence", "terms") if _KINDS[k].fits(data)), None)
    if analysis is None:
        return
    several = {"estimator", "sampler", "channel", *_variant_dims(data)} & set(data.dims)
    for names, each in _pairs(data):
        for k, row in enumerate(_rows(each, analysis, names)):
            said = explain(row, _channel(each, k) if analysis == "terms" else None)
            yield f"{row.estimator}, {row.sampler}: {said}" if several else said


def _rows(data: xr.Dataset, analysis: str, names: _Names) -> list[SummaryRow]:
    """The summary of one result as that of a study with nothing else."""
    import xarray as xr

    attributes = {"estimator_name": names.estimator, "sampler_spec": names.points}
    one = data.drop_vars(["estimator", "sampler"], errors="ignore").assign_attrs(attributes)
    return summarize(xr.DataTree.from_dict({f"/e/s/{analysis}": one}))


def _channel(data: xr.Dataset, k: int) -> xr.Dataset:
    return data.isel(channel=k) if "channel" in data.dims else data


def _numbers(data: xr.Dataset) -> Iterator[str]:
    """Single numbers with their meaning and interval; of other variables what they are."""
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


def _is_map(data: xr.Dataset) -> bool:
    return {"variance", "mean", "rate"} <= set(map(str, data.data_vars)) and "x" in data.dims


register_accessor()
