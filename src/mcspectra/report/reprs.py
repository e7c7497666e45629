"""Notebook representations of samplers, densities, integrands and estimators: images with facts.

Pictures are quick to compute: they show about 64 points, or values on a 48 × 48 grid.
Integrals are shown only if they are known in closed form.
Components that are declared `costly`, and slow functions, are shown without an image.
Images are SVG text. An image is drawn in a millisecond and needs no other files.
"""

from __future__ import annotations

import base64
import io
import time
import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.display import escape_html
from mcspectra.core.spec import Component
from mcspectra.densities import Density
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.integrands import Integrand
from mcspectra.plots.text import interval, number, shorten
from mcspectra.samplers import Sampler
from mcspectra.samplers.base import Structure

__all__ = ["SIDE", "component_html", "curve", "map_image", "scatter", "strip"]

SIDE = 132
"""Width and height of an image in CSS pixels."""

_BLUE = "#0072B2"
# Five colors of viridis (van der Walt, Smith 2015), equally spaced in lightness.
# Colors between the five colors are interpolated linearly.
_VIRIDIS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
_CLIPPED = 0.5  # percentage of values clipped at each end, because functions may have poles
_POINTS = 64
_MOST_NUMBERS = 2**16  # largest number of coordinates (n · dims) of a set that is drawn
_CELLS = {1: 192, 2: 48}  # number of cells along each axis of an image, by dims
# Limit in seconds for the processor time to compute an image, excluding its first row. Processor
# time does not depend on other processes, so that a component has an image on a busy machine too
_TIME = 0.2
_MOST_TECHNIQUES = 3
_LONGEST = 160  # longest spec that is shown, in characters

Rows: TypeAlias = list[tuple[str, str]]
Pictures: TypeAlias = list[tuple[str, str]]
"""Pairs of an SVG image and its caption."""


def component_html(component: object) -> str:
    """Return the HTML of a component. For an unknown kind of component, only its spec is shown."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        # Ignore warnings about the number of points and about f/p = 0/0
        warnings.simplefilter("ignore")
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
        f"{escape_html(caption)}</figcaption></figure>"
        for svg, caption in pictures
    )
    cells = "".join(
        '<tr><th scope="row" style="text-align:left;font-weight:normal;opacity:.7">'
        f"{escape_html(key)}"
        f'</th><td style="text-align:left">{escape_html(value)}</td></tr>'
        for key, value in rows
    )
    return (
        f'<div class="mcspectra"><code>{escape_html(shorten(spec, _LONGEST))}</code>'
        '<div style="display:flex;flex-wrap:wrap;align-items:flex-start;margin-top:.4em">'
        f"{figures}<table>{cells}</table></div></div>"
    )


def _sampler(sampler: Sampler) -> tuple[Pictures, Rows]:
    from scipy.spatial import KDTree

    kept = sampler.structure
    rows = [("dims", str(sampler.dims)), ("unbiased", _yes(sampler.unbiased))]
    if kept not in (Structure.UNKNOWN, Structure.NONE):
        rows.append(("keeps", kept.value))
    if sampler.sequence:
        rows.append(("sequence", "the first points of a set are a smaller set"))
    n = sampler.nearest_count(_POINTS)
    if _is_costly(sampler) or n * sampler.dims > _MOST_NUMBERS:
        return [], [*rows, ("picture", f"omitted: {n} points would take long")]
    points = sampler.draw(n, rng=0)[0]
    # A query for two neighbors finds the point itself first, and the nearest other point second.
    # If the set has a single point, the distance to the second neighbor is ∞
    tree = KDTree(points, boxsize=np.ones(points.shape[1]))
    least = float(np.min(tree.query(points, k=[2])[0]))
    rows.append(("smallest distance", f"{number(least)} (of these points)"))
    dims = sampler.dims
    caption = f"{len(points)} points" + (f", axes 0 and 1 of {dims}" if dims > 2 else "")
    picture = strip(points[:, 0], caption) if dims == 1 else scatter(points[:, :2], caption)
    return [(picture, caption)], rows


def _density(density: Density) -> tuple[Pictures, Rows]:
    values = None if _is_costly(density) else _values(density.pdf, density.dims)
    extra = density.primary_dims - density.dims
    dims = f"{density.dims}, and {extra} for the warp" if extra else f"{density.dims}"
    rows = [("dims", dims), ("inverse", _yes(density.has_inverse))]
    if density.warps:
        rows.append(("warps", ", ".join(density.warps)))
    if values is not None:
        rows.append(("pdf", f"{_range(values)} (in the image)"))
    own = type(density).reciprocal_integral is not Density.reciprocal_integral
    if own and not _is_costly(density):
        rows.append(("∫ 1/p", number(density.reciprocal_integral())))
    return _picture(values, "p(x)", density.dims), rows


def _integrand(integrand: Integrand) -> tuple[Pictures, Rows]:
    values = None if _is_costly(integrand) else _values(integrand, integrand.dims)
    rows = [("dims", str(integrand.dims))]
    if integrand.channels:
        rows.append(("channels", str(integrand.channels)))
    if values is not None:
        rows.append(("values", f"{_range(values)} (in the image)"))
    if not _is_costly(integrand):
        rows += _integral(integrand)
        rows.append(("coefficients", integrand.fourier_source))
    return _picture(values, "f(x)", integrand.dims), rows


def _integral(component: Integrand | AbstractEstimator) -> Rows:
    """Return the integral if it is known exactly; quadrature might take long."""
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
    # Draw f, p and g(u), or f and the function g of each technique
    pictures: Pictures = []
    f = estimator.domain_integrand
    if f is not None:
        pictures += _picture(_values(f, f.dims), "f(x)", f.dims)
    density = estimator.density if isinstance(estimator, Estimator) else None
    if density is not None:
        pictures += _picture(_values(density.pdf, density.dims), "p(x)", density.dims)
    for t in range(min(techniques, _MOST_TECHNIQUES)):
        g = estimator.primary_integrand(t)
        if g is not f:
            name = f"g{t}(u)" if techniques > 1 else "g(u)"
            pictures += _picture(_values(g, g.dims), name, g.dims)
    return pictures, [*rows, *_integral(estimator)]


def _values(function: Callable[[Array], Array], dims: int) -> Array | None:
    """Return values at cell centers, or None if that takes too long. Further coordinates are ½."""
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
        start = start or time.process_time()  # exclude the first row: it may load or compile code
        if time.process_time() - start > _TIME:
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
    """Whether a component or one of its parts is declared costly or is a user's function."""
    if not isinstance(component, Component | AbstractEstimator) or not depth:
        return False
    if getattr(component, "costly", False) or getattr(component, "is_black_box", False):
        return True
    held: list[Any] = []
    for value in getattr(component, "__dict__", {}).values():
        held += value[:_POINTS] if isinstance(value, tuple | list) else [value]
    return any(_is_costly(each, depth - 1) for each in held)


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def scatter(points: Array, label: str) -> str:
    """Draw points (n, 2) of the unit square. The second axis points up."""
    radius = float(np.clip(8.0 / np.sqrt(len(points)), 0.3, 2.2))
    dots = "".join(
        f'<circle cx="{100 * x:.2f}" cy="{100 - 100 * y:.2f}" r="{radius:.2f}"/>' for x, y in points
    )
    return _framed(f'<g fill="{_BLUE}">{dots}</g>', label)


def strip(points: Array, label: str) -> str:
    """Draw points (n,) of the unit interval as vertical lines."""
    width = float(np.clip(30.0 / len(points), 0.1, 1.0))
    lines = "".join(f"M{100 * x:.2f} 35V65" for x in points)
    return _framed(f'<path d="{lines}" stroke="{_BLUE}" stroke-width="{width:.2f}"/>', label)


def curve(values: Array, label: str) -> str:
    """Draw values (k,) or (k, channels) at k cell centers, in a range that includes 0."""
    columns = values.reshape(len(values), -1)
    low, high = _limits(columns)
    low, high = min(low, 0.0), max(high, 0.0)
    scale = 90.0 / (high - low) if high > low else 0.0
    x = 100.0 * (np.arange(len(values)) + 0.5) / len(values)
    zero = 95.0 + scale * low
    axis = (
        f'<path d="M0 {zero:.2f}H100" stroke="currentColor" stroke-opacity=".3" stroke-width=".6"/>'
    )
    lines = "".join(
        f'<path d="{_line(x, 95.0 - scale * (column - low))}" fill="none" stroke="{_BLUE}" '
        f'stroke-width="1.4" stroke-opacity="{1.0 / (1 + k):.2f}"/>'
        for k, column in enumerate(columns.T)
    )
    return _framed(axis + lines, label)


def map_image(values: Array, label: str) -> str:
    """Draw values (k, k) or (k, k, channels) on a grid of cells; three channels are RGB."""
    from PIL import Image

    colored = values.ndim == 3 and values.shape[2] == 3
    shown = values if colored else values.reshape(*values.shape[:2], -1)[..., 0]
    low, high = _limits(shown)
    scaled = np.clip((shown - low) / (high - low or 1.0), 0.0, 1.0)
    nodes = np.linspace(0.0, 1.0, len(_VIRIDIS))
    pixels = (
        255.0 * scaled
        if colored
        else np.stack([np.interp(scaled, nodes, c) for c in np.transpose(_VIRIDIS)], axis=-1)
    )
    pixels[~np.isfinite(pixels)] = 255.0
    upright = np.round(pixels).astype(np.uint8).swapaxes(0, 1)[::-1]
    held = io.BytesIO()
    Image.fromarray(upright).save(held, "png")
    url = f"data:image/png;base64,{base64.b64encode(held.getvalue()).decode('ascii')}"
    picture = f'<image width="100" height="100" href="{url}" style="image-rendering:pixelated"/>'
    return _framed(picture, label)


def _framed(drawing: str, label: str) -> str:
    frame = '<rect width="100" height="100" fill="none" stroke="currentColor" stroke-opacity=".4"/>'
    return (
        f'<svg role="img" aria-label="{escape_html(label)}" viewBox="-1 -1 102 102" width="{SIDE}" '
        f'height="{SIDE}" xmlns="http://www.w3.org/2000/svg">{drawing}{frame}</svg>'
    )


def _limits(values: Array) -> tuple[float, float]:
    """Return the limits of a color scale: two percentiles of the finite values."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 0.0
    low, high = np.percentile(finite, [_CLIPPED, 100.0 - _CLIPPED])
    return float(low), float(high)


def _line(x: Array, y: Array) -> str:
    """Return an SVG path, clipped to the frame, with gaps where values are not finite."""
    parts, pen = [], "M"
    for at, height in zip(x, np.clip(y, 0.0, 100.0), strict=True):
        if not np.isfinite(height):
            pen = "M"
            continue
        parts.append(f"{pen}{at:.2f} {height:.2f}")
        pen = "L"
    return "".join(parts)
