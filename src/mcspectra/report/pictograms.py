"""Small pictures as SVG text, made without matplotlib: points, curves, maps.

A notebook draws one for every object it shows; text takes a millisecond and loads nothing.
"""

from __future__ import annotations

import base64
import io
from html import escape

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["SIDE", "curve", "map_image", "scatter", "strip"]

SIDE = 132
"""Width and height of a picture in CSS pixels."""

_BLUE = "#0072B2"
# Five colours of viridis (van der Walt, Smith 2015), even in lightness; between them linear.
_VIRIDIS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
_CLIPPED = 0.5  # per cent of values at either end that may lie beyond the colours: poles


def scatter(points: Array, label: str) -> str:
    """Points (n, 2) of the unit square, the second axis upwards."""
    radius = float(np.clip(8.0 / np.sqrt(len(points)), 0.3, 2.2))
    dots = "".join(
        f'<circle cx="{100 * x:.2f}" cy="{100 - 100 * y:.2f}" r="{radius:.2f}"/>' for x, y in points
    )
    return _framed(f'<g fill="{_BLUE}">{dots}</g>', label)


def strip(points: Array, label: str) -> str:
    """Points (n,) of the unit interval as upright lines."""
    width = float(np.clip(30.0 / len(points), 0.1, 1.0))
    lines = "".join(f"M{100 * x:.2f} 35V65" for x in points)
    return _framed(f'<path d="{lines}" stroke="{_BLUE}" stroke-width="{width:.2f}"/>', label)


def curve(values: Array, label: str) -> str:
    """Values (k,) or (k, channels) at the centres of k equal cells; the axis starts at 0 or below."""
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
    """Values (k, k) or (k, k, channels) in a grid of cells; three channels are colours."""
    colored = values.ndim == 3 and values.shape[2] == 3
    shown = values if colored else values.reshape(*values.shape[:2], -1)[..., 0]
    low, high = _limits(shown)
    scaled = np.clip((shown - low) / (high - low or 1.0), 0.0, 1.0)
    pixels = 255.0 * scaled if colored else _colors(scaled)
    pixels[~np.isfinite(pixels)] = 255.0
    upright = np.round(pixels).astype(np.uint8).swapaxes(0, 1)[::-1]
    picture = f'<image width="100" height="100" href="{_png(upright)}" style="image-rendering:pixelated"/>'
    return _framed(picture, label)


def _framed(drawing: str, label: str) -> str:
    frame = '<rect width="100" height="100" fill="none" stroke="currentColor" stroke-opacity=".4"/>'
    return (
        f'<svg role="img" aria-label="{escape(label)}" viewBox="-1 -1 102 102" width="{SIDE}" '
        f'height="{SIDE}" xmlns="http://www.w3.org/2000/svg">{drawing}{frame}</svg>'
    )


def _limits(values: Array) -> tuple[float, float]:
    """Least and largest value shown: nearly all of them, infinite ones aside."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 0.0
    low, high = np.percentile(finite, [_CLIPPED, 100.0 - _CLIPPED])
    return float(low), float(high)


def _line(x: Array, y: Array) -> str:
    """Path through points, interrupted at values that are not finite; far ones end at the frame."""
    parts, pen = [], "M"
    for at, height in zip(x, np.clip(y, 0.0, 100.0), strict=True):
        if not np.isfinite(height):
            pen = "M"
            continue
        parts.append(f"{pen}{at:.2f} {height:.2f}")
        pen = "L"
    return "".join(parts)


def _colors(scaled: Array) -> Array:
    """Colours (..., 3), 0 to 255, of values from 0 to 1."""
    nodes = np.linspace(0.0, 1.0, len(_VIRIDIS))
    return np.stack([np.interp(scaled, nodes, c) for c in np.transpose(_VIRIDIS)], axis=-1)


def _png(pixels: Array) -> str:
    """A data URL of pixels uint8 (height, width, 3)."""
    from PIL import Image

    held = io.BytesIO()
    Image.fromarray(pixels).save(held, "png")
    return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode("ascii")
