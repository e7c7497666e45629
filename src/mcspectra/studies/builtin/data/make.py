"""Make the data files of the tour: an image used as a density, and a point set.

Run ``python src/mcspectra/studies/builtin/data/make.py``.
The files are checked in, so the tour needs no preparation.
The picture `window.png` shows a bright, soft-edged window and a lamp on a dim wall.
The file `blue.dat` contains 256 Poisson-disk points in UTK's text format.
"""

from pathlib import Path

import numpy as np
from PIL import Image

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.core.pointfiles import write_points

HERE = Path(__file__).parent


def window(width: int = 48, height: int = 32) -> Array:
    """Return the radiance of the picture, float64 (height, width, 3) in [0, 1]."""
    x = (np.arange(width) + 0.5)[None, :] / width
    y = (np.arange(height) + 0.5)[:, None] / height
    wall = 0.03 + 0.05 * (1 - y) + 0 * x
    pane = 1 / (
        (1 + np.exp(-60 * (0.16 - abs(x - 0.3)))) * (1 + np.exp(-60 * (0.2 - abs(y - 0.4))))
    )
    lamp = 0.6 * np.exp(-((x - 0.78) ** 2 + 0.45 * (y - 0.68) ** 2) / (2 * 0.06**2))
    red = wall + 0.75 * pane + lamp
    blue = 1.4 * wall + 0.9 * pane + 0.35 * lamp
    picture: Array = np.clip(np.stack([red, 0.5 * (red + blue), blue], axis=-1), 0, 1)
    return picture


def main() -> None:
    """Write the picture and the set of points."""
    # Encode as 8-bit sRGB, like photographs
    linear = window()
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    Image.fromarray(np.rint(255 * encoded).astype(np.uint8)).save(HERE / "window.png")
    points = mcs.sampler("poisson-disk", dims=2).draw(256, rng=2026)
    write_points(HERE / "blue.dat", list(points))


if __name__ == "__main__":
    main()
