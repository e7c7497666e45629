"""A map as a staged analysis: its tiles, which are measured anywhere and laid side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.staged import Run, Stages
from mcspectra.rendering._map_checks import Window
from mcspectra.rendering._map_prediction import Prediction
from mcspectra.rendering._map_tiles import Measurement

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Maps", "StagedMap"]

Maps = dict[str, Array]
"""Arrays by name, the pixels of one tile or of several along their last axis."""


@final
@dataclass(frozen=True)
class StagedMap:
    """One run of all pixels, row by row; a block is a tile.

    Attributes
    ----------
    measurement
        What is measured at every pixel.
    window
        Of the pixels.
    result
        The dataset, made of arrays (…, y, x).
    """

    measurement: Measurement
    window: Window
    result: Callable[[Maps], xr.Dataset]

    @property
    def pixels(self) -> int:
        """Number of all pixels."""
        return self.window[2] * self.window[3]

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return -(-self.pixels // self.measurement.tile_pixels)

    def places(self, tile: int) -> Array:
        """Numbers of a tile's pixels in the window."""
        step = self.measurement.tile_pixels
        return np.arange(tile * step, min((tile + 1) * step, self.pixels))

    def tile(self, index: int) -> Maps:
        """Measure the pixels of a tile."""
        x0, y0, width, _ = self.window
        place = self.places(index)
        pixels = np.stack([x0 + place % width, y0 + place // width], axis=-1)
        return self.measurement.tile(pixels, self._prediction)

    def image(self, maps: Maps) -> Maps:
        """Arrays of all pixels as (…, y, x)."""
        _, _, width, height = self.window
        return {name: each.reshape(*each.shape[:-1], height, width) for name, each in maps.items()}

    def stages(self) -> Stages:
        """One run."""
        measured = self.measurement
        cost = self.pixels * sum(measured.counts) * measured.realizations * len(measured.techniques)
        (maps,) = yield [
            Run(part=0, first=0, realizations=self.pixels, blocks=self.tiles, cost=float(cost))
        ]
        return self.result(self.image(maps))

    def block(self, run: Run, index: int) -> Maps:  # noqa: ARG002
        """A tile."""
        return self.tile(index)

    def merge(self, left: Maps, right: Maps) -> Maps:
        """Pixels of both."""
        return {name: np.concatenate([left[name], right[name]], axis=-1) for name in left}

    def pack(self, state: Maps) -> dict[str, Array]:
        """The arrays."""
        return state

    def unpack(self, arrays: dict[str, Array]) -> Maps:
        """Inverse of `pack`."""
        return arrays

    @cached_property
    def _prediction(self) -> Prediction | None:
        return self.measurement.prediction()
