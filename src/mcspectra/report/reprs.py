"""Samplers, densities, integrands and estimators as notebooks show them: a picture, a few figures.

What is shown is cheap: one set of about 64 points, values on 48² places, integrals only where they
are known exactly. Components that declare themselves `costly`, and functions that turn out to be
slow, are shown without a picture.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from html import escape
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.spec import Component
from mcspectra.densities import Density
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.integrands import Integrand
from mcspectra.plots.text import interval, number, shorten
from mcspectra.report.pictograms import curve, map_image, scatter, strip
from mcspectra.samplers import Sampler
from mcspectra.samplers.base import Structure

__all__ = ["component_html"]

_POINTS = 64
_MOST_NUMBERS = 2**16  # coordinates of the set that is drawn
_CELLS = {1: 192, 2: 48}  # along an axis of a picture
_TIME = 0.2  # seconds for the values of a picture, the first row aside
_MOST_TECHNIQUES = 3
_LONGEST = 160  # characters of a spec

Rows: TypeAlias = list[tuple[str, str]]
Pictures: TypeAlias = list[tuple[str, str]]
"""SVG and the caption below."""


def component_html(component: object) -> str:
    """Return the HTML of a component; what is not known to it is shown by name alone."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of counts, of points where f/p is 0/0: not asked for here
        if isinstance(component, Sampler):
            return _page(component.spec, *_sampler(component))
        if isinstance(component, Density):
            return _page(component.spec, *_density(component))
        if isinstance(component, Integrand):
            return _page(component.spec, *_integrand(component))
        if isinstance(component, AbstractEstimator):
            return _page(component.spec, *_estimator(component))
    summary = component.summary() if isinstance(component, Component) else ""
    return _page(getattr(component, "spec", repr(component)), [], [("", summary)])


def _page(spec: str, pictures: Pictures, rows: Rows) -> str:
    figures = "".join(
        f'<figure style="margin:0 1em 0 0">{svg}<figcaption style="font-size:85%">'
        f"{escape(caption)}</figcaption></figure>"
        for svg, caption in pictures
    )
    cells = "".join(
        f'<tr><th scope="row" style="text-align:left;font-weight:normal;opacity:.7">{escape(key)}'
        f'</th><td style="text-align:left">{escape(value)}</td></tr>'
        for key, value in rows
    )
    return (
        f'<div class="mcspectra"><code>{escape(shorten(spec, _LONGEST))}</code>'
        f'<div style="display:flex;flex-wrap:wrap;align-items:flex-start;margin-top:.4em">{figures}<table>{cells}</table>'
        "</div></div>"
    )


def _sampler(sampler: Sampler) -> tuple[Pictures, Rows]:
    kept = sampler.structure
    rows = [("dims", str(sampler.dims)), ("unbiased", _yes(sampler.unbiased))]
    if kept not in (Structure.UNKNOWN, Structure.NONE):
        rows.append(("keeps", kept.value))
    if sampler.sequence:
        rows.append(("sequence", "the first points of a set are a set themselves"))
    n = sampler.nearest_count(_POINTS)
    if _is_costly(sampler) or n * sampler.dims > _MOST_NUMBERS:
        return [], [*rows, ("picture", f"none: {n} points would take long")]
    points = sampler.draw(n, rng=0)[0]
    rows.append(("smallest distance", f"{number(_smallest_distance(points))} (of these points)"))
    return [_points(points)], rows


def _points(points: Array) -> tuple[str, str]:
    n, dims = points.shape
    caption = f"{n} points" + (f", axes 0 and 1 of {dims}" if dims > 2 else "")
    if dims == 1:
        return strip(points[:, 0], caption), caption
    return scatter(points[:, :2], caption), caption


def _smallest_distance(points: Array) -> float:
    """Smallest toroidal distance of two points; infinite for one. Row by row: little memory."""
    least = np.inf
    for k in range(1, len(points)):
        gap = np.abs(points[:k] - points[k])
        gap = np.minimum(gap, 1.0 - gap)
        least = min(least, float((gap**2).sum(axis=1).min()))
    return float(np.sqrt(least))


def _density(density: Density) -> tuple[Pictures, Rows]:
    values = None if _is_costly(density) else _values(density.pdf, density.dims)
    rows = [("dims", _density_dims(density)), ("inverse", _yes(density.has_inverse))]
    if density.warps:
        rows.append(("warps", ", ".join(density.warps)))
    if values is not None:
        rows.append(("pdf", f"{_range(values)} (in the picture)"))
    if not _is_costly(density) and _overrides(density, Density, "reciprocal_integral"):
        rows.append(("∫ 1/p", number(density.reciprocal_integral())))
    return _picture(values, "p(x)", density.dims), rows


def _density_dims(density: Density) -> str:
    extra = density.primary_dims - density.dims
    return f"{density.dims}" + (f", and {extra} for the warp" if extra else "")


def _integrand(integrand: Integrand) -> tuple[Pictures, Rows]:
    values = None if _is_costly(integrand) else _values(integrand, integrand.dims)
    rows = [("dims", str(integrand.dims))]
    if integrand.channels:
        rows.append(("channels", str(integrand.channels)))
    if values is not None:
        rows.append(("values", f"{_range(values)} (in the picture)"))
    if not _is_costly(integrand):
        rows += _integral(integrand)
        rows.append(("coefficients", integrand.fourier_source))
    return _picture(values, "f(x)", integrand.dims), rows


def _integral(component: Integrand | AbstractEstimator) -> Rows:
    """The integral where it is known; a quadrature may take long."""
    if component.integral_source != "exact":
        return []
    return [("∫ f", ", ".join(number(float(v), 6) for v in np.atleast_1d(component.integral)))]


def _estimator(estimator: AbstractEstimator) -> tuple[Pictures, Rows]:
    techniques = len(estimator.counts)
    rows = [("dims of the sampler", str(estimator.dims)), ("techniques", str(techniques))]
    if techniques > 1 or estimator.counts != (1,):
        rows.append(("samples", " + ".join("n" if c == 1 else f"{c} n" for c in estimator.counts)))
        rows.append(("sets", estimator.sets))
    if _is_costly(estimator):
        return [], rows
    return list(_views(estimator)), [*rows, *_integral(estimator)]


def _views(estimator: AbstractEstimator) -> Iterator[tuple[str, str]]:
    """Pictures of f, p and g(u), or of f and the g of every technique."""
    f = estimator.domain_integrand
    if f is not None:
        yield from _picture(_values(f, f.dims), "f(x)", f.dims)
    density = estimator.density if isinstance(estimator, Estimator) else None
    if density is not None:
        yield from _picture(_values(density.pdf, density.dims), "p(x)", density.dims)
    for t in range(min(len(estimator.counts), _MOST_TECHNIQUES)):
        g = estimator.primary_integrand(t)
        if g is not f:
            name = f"g{t}(u)" if len(estimator.counts) > 1 else "g(u)"
            yield from _picture(_values(g, g.dims), name, g.dims)


def _values(function: Callable[[Array], Array], dims: int) -> Array | None:
    """Values at the centres of a grid of cells, the axes beyond two at ½; None if that takes long."""
    side = _CELLS[min(dims, 2)]
    centres = (np.arange(side) + 0.5) / side
    rows = []
    start = None
    for row in centres if dims > 1 else np.split(centres, 8):
        x = np.full((side if dims > 1 else len(row), dims), 0.5)
        x[:, 0] = row
        if dims > 1:
            x[:, 1] = centres
        rows.append(function(x))
        start = start or time.monotonic()  # the first row may load or compile what it needs
        if time.monotonic() - start > _TIME:
            return None
    return np.stack(rows) if dims > 1 else np.concatenate(rows)


def _picture(values: Array | None, name: str, dims: int) -> Pictures:
    if values is None:
        return []
    caption = name + (f", axes 0 and 1 of {dims}, others at ½" if dims > 2 else "")
    drawn = curve(values, caption) if dims == 1 else map_image(values, caption)
    return [(drawn, caption)]


def _range(values: Array) -> str:
    finite = values[np.isfinite(values)]
    return interval(float(finite.min()), float(finite.max())) if finite.size else "not finite"


def _is_costly(component: object, depth: int = 8) -> bool:
    """Whether a component, or one that it is made of, declares itself costly."""
    if not isinstance(component, Component | AbstractEstimator) or not depth:
        return False
    if getattr(component, "costly", False):
        return True
    held: list[Any] = []
    for value in getattr(component, "__dict__", {}).values():
        held += value[:_POINTS] if isinstance(value, tuple | list) else [value]
    return any(_is_costly(each, depth - 1) for each in held)


def _overrides(component: object, base: type, method: str) -> bool:
    return getattr(type(component), method) is not getattr(base, method)


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"
