"""Figures as bytes, the same for the same figure: PNG for pages and pictures, PDF for papers."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["encode", "encode_exact"]

_DPI = 120
_PDF_IMAGE_DPI = 200  # of images inside the PDF; everything else is vectors
_COLORS = 256


def encode(figure: Figure) -> tuple[bytes, bytes]:
    """Return PNG and PDF bytes of a figure, without time stamps.

    The layout is computed once for both. The PNG has a palette of 256 colours, a third of the
    size and for flat colours no visible difference.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    with warnings.catch_warnings():
        # Names in scripts that the font lacks show as boxes; the page has them in full.
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure.set_dpi(_DPI)  # before the layout: hinted text has another width at another dpi
        engine = figure.get_layout_engine()
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
        # Straight to the backend: savefig would draw the figure once more, for its layout.
        figure.set_dpi(_PDF_IMAGE_DPI)
        pdf = io.BytesIO()
        metadata = {"CreationDate": None, "Creator": "mcspectra"}
        FigureCanvasPdf(figure).print_pdf(  # type: ignore[no-untyped-call]
            pdf, metadata=metadata
        )
        figure.set_dpi(_DPI)
        figure.set_canvas(canvas)
    return _palette_png(pixels), pdf.getvalue()


def encode_exact(figure: Figure) -> bytes:
    """Return a PNG of a figure at its own dpi, in full colour: photographs need more than 256."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
    png = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(png, format="PNG")
    return png.getvalue()


def _palette_png(pixels: np.ndarray) -> bytes:
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(pixels)).quantize(
        _COLORS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
    )
    # The octree rounds colours; the paper, which meets the page, keeps its own.
    palette, paper = image.getpalette() or [], int(np.asarray(image)[0, 0])
    palette[3 * paper : 3 * paper + 3] = pixels[0, 0].tolist()
    image.putpalette(palette)
    png = io.BytesIO()
    image.save(png, format="PNG", compress_level=6)
    return png.getvalue()
