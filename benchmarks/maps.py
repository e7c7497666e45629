"""Rate map of Veach's scene compared with raw Mitsuba calls for the same samples.

The raw calls evaluate four strategies separately:
light sampling and BSDF sampling, each with and without the weights of MIS.
Mitsuba's kernels read random numbers and first hits from tables that exist before the measurement.
A kernel processes all samples in parallel, and sums over the samples of a pixel.
The raw Mitsuba calls copy their results to NumPy, and compute no statistics.
The map loops over samples. One evaluation gives both the plain and the weighted estimate.
The benchmark also prints the time of the kernels of the map without statistics ("kernels alone").
``--full`` maps 256 × 170 pixels without predictions and compares with the raw calls alone.
This map takes minutes. The default map is smaller.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.rendering import load_mitsuba, variance_map
from mcspectra.rendering.map_tiles import TECHNIQUES, Lighting, Receivers
from mcspectra.rendering.techniques import heuristic_weight, sample_bsdf, sample_light

COUNTS, REALIZATIONS = (4, 9, 16, 36, 64), 64
FULL, SMALL = (256, 170), (48, 32)
LANES = 2**20
ROUNDS = 3


def main(*flags: str) -> None:
    """Print the seconds of the map and of the raw calls, their ratio, and samples per second."""
    full = "--full" in flags
    size = FULL if full else SMALL
    raw = RawCalls(size)
    run_map((8, 8), predict_every=1)  # compile first
    raw.run(REALIZATIONS // 32)
    works = [
        ("map", lambda: run_map(size)),
        ("raw calls", lambda: raw.run(REALIZATIONS)),
    ]
    if not full:
        works += [
            ("map with predictions", lambda: run_map(size, predict_every=1)),
            ("kernels alone", raw.loops),
        ]
    seconds = dict.fromkeys([name for name, _ in works], float("inf"))
    # The load of the machine varies, so each round times all computations
    for _ in range(1 if full else ROUNDS):
        for name, work in works:
            start = time.perf_counter()
            work()
            seconds[name] = min(seconds[name], time.perf_counter() - start)
    samples = 4 * size[0] * size[1] * sum(COUNTS) * REALIZATIONS
    for name, spent in seconds.items():
        print(
            f"{name:21s} {spent:7.1f} s  {samples / spent / 1e6:6.1f} M samples/s  "
            f"{spent / seconds['raw calls']:.2f} of raw"
        )


def run_map(size: tuple[int, int], predict_every: int = 0) -> None:
    """Map the variance of light and BSDF sampling, plain and weighted, and of MIS."""
    variance_map(
        "veach",
        counts=COUNTS,
        realizations=REALIZATIONS,
        size=size,
        predict_every=predict_every,
    )


class RawCalls:
    """Raw Mitsuba calls for all pixels of a grid; first hits and tables are computed in advance."""

    def __init__(self, size: tuple[int, int]) -> None:
        grid = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).reshape(-1, 2)
        lighting = Lighting(
            scene="veach", light=None, heuristic="balance", channel="luminance", size=size
        )
        self._pixels = Receivers(lighting, grid)
        stream = Stream.from_rng(1)
        self._tables = {
            n: stream.child(n).uniforms(0, 1, 2 * n * REALIZATIONS).reshape(2, -1) for n in COUNTS
        }

    def run(self, realizations: int) -> None:
        """Evaluate each strategy separately."""
        for technique in (sample_light, sample_bsdf):
            for weighted in (False, True):
                for n, table in self._tables.items():
                    step = max(1, LANES // (n * len(self._pixels)))
                    for first in range(0, realizations, step):
                        count = min(step, realizations - first)
                        part = table[:, first * n : (first + count) * n]
                        self._kernel(technique, weighted, n, part)

    def loops(self) -> None:
        """Compute the estimates of light and BSDF sampling with the kernels that the map uses."""
        for technique in TECHNIQUES:
            for n, table in self._tables.items():
                u = table.reshape(2, REALIZATIONS, n)
                self._pixels.estimates(technique, np.moveaxis(u, 0, -1))

    def _kernel(self, technique: Any, weighted: bool, n: int, table: Array) -> Array:
        import drjit

        mitsuba = load_mitsuba()
        samples, width = (drjit.opaque(mitsuba.UInt32, k) for k in (n, len(self._pixels)))
        lane = drjit.arange(mitsuba.UInt32, table.shape[1] * len(self._pixels))
        row = lane // samples
        index = (row // width) * samples + lane - row * samples
        hits = self._pixels._gathered(row % width)
        u = [drjit.gather(mitsuba.Float, mitsuba.Float(np.float32(c)), index) for c in table]
        value, own, other = technique(hits, None, mitsuba.Point2f(*u))
        if weighted:
            value *= heuristic_weight(own, other, 1)
        return np.asarray(drjit.block_sum(mitsuba.luminance(value), n).numpy())


if __name__ == "__main__":
    main()
