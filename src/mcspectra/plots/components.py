"""Plots of samplers, densities, integrands and estimators, for their method ``plot``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.analysis import Subject, compute
from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.integrands import Integrand
from mcspectra.plots.backend_matplotlib import GivenAxes, draw, panel_axes
from mcspectra.plots.kinds import describe
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.power import Points, Spectrum

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["component_result", "plot"]

_POINTS = {1: 16, 2: 64}  # default numbers of points by dims; with more dims, the last number
_HALF_WIDTH, _SETS = 32, 50  # half width and realizations of a spectrum that takes about a second
_REALIZATIONS = 1000  # number of estimates in a histogram
_SUBCELLS = {1: 256, 2: 16}  # number of values of f along each axis of a stratum, by dims


def plot(
    component: object,
    kind: str | None = None,
    *,
    n: int | None = None,
    sampler: Any = "jittered",
    rng: RngLike = 0,
    axes: GivenAxes = None,
) -> Any:
    """Draw a component with Matplotlib; `mcspectra.core.spec.Component.plot` has the parameters."""
    chosen, found = component_result(component, kind, n=n, sampler=sampler, rng=rng)
    figure = draw(describe(chosen, found), axes, pyplot=axes is None)
    given = axes if isinstance(axes, list | tuple) else getattr(axes, "flat", [axes])
    panels: list[Any] = panel_axes(figure) if axes is None else list(given)
    return panels[0] if len(panels) == 1 else panels


def component_result(
    component: object,
    kind: str | None = None,
    *,
    n: int | None = None,
    sampler: Any = "jittered",
    rng: RngLike = 0,
) -> tuple[str, Mapping[str, xr.Dataset]]:
    """Return the kind of plot for a component, and the results that it shows, by name.

    Raises
    ------
    ParameterError
        If the component has no plot, or no plot of this kind.
    """
    makers: Mapping[str, Callable[..., xr.Dataset]]
    if isinstance(component, Sampler):
        makers, source = {"points": _points, "spectrum": _spectrum}, component
    elif isinstance(component, Density | Integrand | AbstractEstimator):
        makers = {"integrand": _integrand}
        if isinstance(component, AbstractEstimator):
            makers |= {"strata": _strata, "estimates": _estimates}
        dims = component.primary_dims if isinstance(component, Density) else component.dims
        source = as_sampler(sampler, dims)
    else:
        raise ParameterError(f"{type(component).__name__} has no plot.")
    chosen = next(iter(makers)) if kind is None else as_choice("kind", kind, tuple(makers))
    count = source.nearest_count(_POINTS[min(source.dims, 2)]) if n is None else n
    source.check_count(count)
    found = makers[chosen](component, source, count, rng)
    if chosen == "spectrum":
        chosen = {1: "lines", 2: "spectrum"}.get(source.dims, "radial")
    name = source.spec if chosen != "strata" else f"{count} strata"
    return chosen, {name: found}


def _points(_: Any, source: Sampler, n: int, rng: RngLike) -> xr.Dataset:
    return compute(Points(n=n), Subject(None, source), rng=rng)


def _spectrum(_: Any, source: Sampler, n: int, rng: RngLike) -> xr.Dataset:
    return compute(
        Spectrum(n=n, half_width=_HALF_WIDTH, realizations=_SETS), Subject(None, source), rng=rng
    )


def _integrand(component: Any, source: Sampler, n: int, rng: RngLike) -> xr.Dataset:
    """Return f and p with points. For a density, f is p itself."""
    if isinstance(component, Density):
        f = Integrand.from_function(component.pdf, dims=component.dims)
        found = compute(Points(n=n), Subject(Estimator(f, component), source), rng=rng)
        return found.drop_vars("density_value").assign_attrs(function="p")
    given = Estimator(component) if isinstance(component, Integrand) else component
    found = compute(Points(n=n), Subject(given, source), rng=rng)
    return found.isel(point=slice(0)) if isinstance(component, Integrand) else found


def _strata(component: AbstractEstimator, _: Sampler, n: int, __: RngLike) -> xr.Dataset:
    """Return the exact variance from each jittered stratum, and the total if the strata move.

    The strata move along the first axis. The total variance is computed for each offset.
    """
    g = component.primary_integrand()
    side = round(n ** (1 / g.dims))
    if g.dims > 2 or side**g.dims != n:
        raise ParameterError(
            f"The plot 'strata' needs 1 or 2 dims and n = k^d, not {n} in {g.dims}."
        )
    fine = _SUBCELLS[g.dims]
    x = (np.moveaxis(np.indices((side * fine,) * g.dims), 0, -1) + 0.5) / (side * fine)
    values = np.asarray(g(x), dtype=float)
    values = values[..., 0] if values.ndim > g.dims else values

    def parts(moved: Array) -> Array:
        cells = moved.reshape([k for _ in range(g.dims) for k in (side, fine)])
        return np.asarray(cells.var(axis=tuple(range(1, 2 * g.dims, 2))) / n**2)

    slides = [float(parts(np.roll(values, -k, axis=0)).sum()) for k in range(fine + 1)]
    names = tuple(f"x{axis}" for axis in range(g.dims))
    strata = tuple(f"stratum{axis}" for axis in range(g.dims))
    return dataset(
        {
            "integrand_value": (names, values),
            "stratum_variance": (strata, parts(values)),
            "sliding_variance": (("offset",), np.array(slides)),
        },
        {
            **dict.fromkeys(names, x.reshape(-1, g.dims)[: side * fine, -1]),
            "offset": np.arange(fine + 1) / fine,
        },
        estimator=component.spec,
        n=n,
    )


def _estimates(component: AbstractEstimator, source: Sampler, n: int, rng: RngLike) -> xr.Dataset:
    stream = Stream.from_rng(rng)
    values = component.estimate(component.draw(source, n, stream, 0, _REALIZATIONS))
    values = values[:, 0] if values.ndim > 1 else values
    known, _, source_of = component.known_integral()
    exact = float(np.ravel(known)[0]) if source_of == "exact" else None
    return dataset(
        {"estimate": (("realization",), values)}, integral=exact, estimator=component.spec,
        sampler=source.spec, n=n,
    )  # fmt: skip
