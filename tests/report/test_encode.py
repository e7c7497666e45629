"""Bytes of figures."""

import io

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from mcspectra.report.encode import encode
from mcspectra.report.style import new_figure, quiet


def drawn(title: str = "a title") -> Figure:
    figure = new_figure(3, 2)
    axes = figure.subplots()
    quiet(axes)
    axes.plot([0, 1], [0, 1], color="#D55E00", lw=6)
    axes.set_title(title)
    return figure


def test_encode__both_formats_and_nothing_about_the_time() -> None:
    png, pdf = encode(drawn())
    assert png.startswith(b"\x89PNG")
    assert pdf.startswith(b"%PDF")
    assert b"CreationDate" not in pdf
    assert b"Producer" in pdf


def test_encode__same_figure_same_bytes() -> None:
    assert encode(drawn()) == encode(drawn())


def test_encode__size_and_colour_survive_the_palette() -> None:
    png, _ = encode(drawn())
    image = Image.open(io.BytesIO(png)).convert("RGB")
    assert image.size == (360, 240)
    assert image.getpixel((0, 0)) == (0xFC, 0xFC, 0xFA)  # no seam to the frame in the page
    away = np.abs(np.asarray(image).astype(int) - (0xD5, 0x5E, 0x00)).max(axis=2)
    # The line covers 6 pt x ~2.5 in: far more than 1 % of the pixels have its colour.
    assert (away <= 16).mean() > 0.01


def test_encode__glyphs_that_the_font_lacks_are_no_error() -> None:
    png, pdf = encode(drawn("推定 $x"))
    assert png
    assert pdf
