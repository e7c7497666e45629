"""Variances of one tile of pixels: moments over realisations of every strategy and count."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import Block
from mcspectra.core.records import Join
from mcspectra.core.streams import Stream
from mcspectra.estimators import Moments
from mcspectra.estimators.sets import draw_sets
from mcspectra.rendering._map_kernel import TECHNIQUES, Lighting, Receivers
from mcspectra.rendering._map_prediction import Prediction, prediction_for, surely, unmet
from mcspectra.rendering.scenes import scene_name
from mcspectra.samplers import Sampler

__all__ = ["MAP_STRATEGIES", "TILE_LANES", "Maps", "Measurement"]

MAP_STRATEGIES: Final = ("light", "bsdf", "mis-light", "mis-bsdf", "mis")

TILE_LANES = 2**19
"""Pixels times realisations in one kernel; some 100 MiB with what is made of them."""

_BLOCK_REALIZATIONS = 1024
_TABLE_NUMBERS = 2**23  # of one table of points, 64 MiB
_KEPT_NUMBERS = 2**24  # of all tables that are kept for the next tile
_PREDICTED_VALUES = 2**21  # integrand values at once
_PREDICTION = 0x9D1C7  # label of the stream of the prediction's samples


_Pixels = Annotated[Array, Join(-1)]


@final
@dataclass(frozen=True)
class Maps:
    """Results at pixels, which are along the last axis of all arrays.

    Attributes
    ----------
    status
        What a pixel sees, (P,).
    mean, variance, relative_se
        (strategies, counts, P), NaN where there is nothing to estimate.
    predicted, predicted_se
        Variance at the largest count, (strategies, P).
    """

    status: _Pixels
    mean: _Pixels
    variance: _Pixels
    relative_se: _Pixels
    predicted: _Pixels
    predicted_se: _Pixels


@final
@dataclass(frozen=True, kw_only=True)
class Measurement:
    """The measurement made at every pixel.

    Attributes
    ----------
    lighting
        Scene, lights and grid.
    strategies
        Of `MAP_STRATEGIES`.
    sampler, counts, realizations, stream
        Points: realisation r of n of them is that of ``stream.child(n)``, as in `convergence`.
    own
        Whether each pixel has points of its own: number (y·width + x)·realizations + r of the
        stream. Otherwise all pixels share them.
    predict_every
        Predict at pixels whose x and y are both multiples of this; 0 nowhere.
    """

    lighting: Lighting
    strategies: tuple[str, ...]
    sampler: Sampler
    counts: tuple[int, ...]
    realizations: int
    stream: Stream
    own: bool
    predict_every: int
    _tables: dict[tuple[int, Block], list[Array]] = field(default_factory=dict, repr=False)

    @property
    def techniques(self) -> list[str]:
        """Techniques that the strategies need."""
        single = {"light": "light", "mis-light": "light", "bsdf": "bsdf", "mis-bsdf": "bsdf"}
        needed = {single.get(strategy, "both") for strategy in self.strategies}
        return [t for t in TECHNIQUES if needed & {t, "both"}]

    @property
    def block(self) -> int:
        """Realisations in one kernel, whatever the tile: sums over them keep their order."""
        fitting = _TABLE_NUMBERS // (self.counts[-1] * self.sampler.dims)
        return max(1, min(self.realizations, _BLOCK_REALIZATIONS, fitting))

    @property
    def tile_pixels(self) -> int:
        """Pixels of a tile."""
        lanes = TILE_LANES
        if self.own:
            lanes = min(lanes, _TABLE_NUMBERS // (self.counts[-1] * self.sampler.dims))
        return max(1, lanes // self.block)

    def prediction(self) -> Prediction | None:
        """How variances at the largest count are predicted."""
        if not self.predict_every:
            return None
        return prediction_for(self.sampler, self.counts[-1], self.stream.child(_PREDICTION))

    def tile(self, pixels: Array, prediction: Prediction | None) -> Maps:
        """Measure pixels (P, 2), x and y of each."""
        receivers = Receivers(self.lighting, pixels)
        shape = (len(self.strategies), len(self.counts), len(pixels))
        mean, variance, relative_se = (np.full(shape, np.nan) for _ in range(3))
        predicted, predicted_se = (np.full((shape[0], shape[2]), np.nan) for _ in range(2))
        found = Maps(receivers.status, mean, variance, relative_se, predicted, predicted_se)
        seen = np.flatnonzero(receivers.status == 0)
        if not len(seen):
            return found
        if "bsdf" in self.techniques and self.sampler.dims == 2 and receivers.chooses_lobe():
            raise ParameterError(
                f"A visible BSDF of {scene_name(self.lighting.scene)} selects a lobe by an extra random "
                "number; give dims=3, the third coordinate is that number."
            )

        # Moments over realisations of each strategy
        for i, n in enumerate(self.counts):
            total: list[Moments] = []
            for first in range(0, self.realizations, self.block):
                block = first, min(self.block, self.realizations - first)
                drawn = zip(TECHNIQUES, self._points(receivers, n, block), strict=True)
                both = {t: receivers.estimates(t, u) for t, u in drawn if t in self.techniques}
                own = [Moments.of(combined(strategy, both)) for strategy in self.strategies]
                total = [x.merge(y) for x, y in zip(total, own, strict=True)] if total else own
            for s, moments in enumerate(total):
                for name in ("mean", "variance", "relative_se"):
                    getattr(found, name)[s, i, seen] = getattr(moments, name)[: len(seen)]

        # Predictions at every so many pixels, a chunk at a time
        if prediction is None:
            return found
        chosen = seen[(pixels[seen] % self.predict_every == 0).all(axis=1)]
        step = max(1, _PREDICTED_VALUES // len(prediction.samples))
        for start in range(0, len(chosen), step):
            part = chosen[start : start + step]
            receivers = Receivers(self.lighting, pixels[part])
            each = {t: receivers.values(t, prediction.samples) for t in self.techniques}
            for s, strategy in enumerate(self.strategies):
                v, se = _predicted(prediction, strategy, each)
                found.predicted[s, part] = v[: len(part)]
                found.predicted_se[s, part] = se[: len(part)]
        return found

    def _points(self, receivers: Receivers, n: int, block: Block) -> list[Array]:
        """Points of each technique, (R, n, d), or (R, P, n, d) where pixels have their own."""

        def draw(own: Block) -> list[Array]:
            return draw_sets("independent", (1, 1), self.sampler, n, self.stream.child(n), *own)

        if self.own:
            width = self.lighting.size[0]
            numbers = (receivers.pixels @ [1, width]) * self.realizations + block[0]
            drawn = [draw((int(first), block[1])) for first in numbers]
            return [np.stack(each, axis=1) for each in zip(*drawn, strict=True)]
        tables = self._tables.get((n, block)) or draw(block)
        if sum(self.counts) * self.realizations * 2 * self.sampler.dims <= _KEPT_NUMBERS:
            self._tables[n, block] = tables
        return tables


def combined(strategy: str, both: dict[str, tuple[Array, Array]]) -> Array:
    """Estimate of a strategy, from the plain and weighted ones of the techniques."""
    if strategy == "mis":
        return both["light"][1] + both["bsdf"][1]
    return both[strategy.removeprefix("mis-")][int(strategy.startswith("mis-"))]


def _predicted(
    prediction: Prediction, strategy: str, each: dict[str, tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Variance of a strategy and its standard error; those of independent techniques add up.

    The error has a part for the light that another technique sees and this strategy does not.
    """
    parts = ("mis-light", "mis-bsdf") if strategy == "mis" else (strategy,)
    found = [prediction.variance(combined(part, each)) for part in parts]
    there = np.max([surely(prediction, plain) for plain, _ in each.values()], axis=0)
    whole = combined("mis" if strategy.startswith("mis") else strategy, each)
    errors = [se for _, se in found] + [unmet(prediction, whole, there)]
    variance: Array = np.sum([v for v, _ in found], axis=0)
    return variance, np.sqrt(np.square(errors).sum(axis=0))
