"""Time of `variance_terms` with 64 given bands, relative to drawing and transforming the points.

The time of `variance_terms` is divided by the time of drawing and transforming the points alone.
Every analysis of spectra must draw and transform its points.
The printed seconds are the shortest time of all rounds. The ratio is the median over the rounds.
The ratio of the shortest times is also printed, because the machine may have been busy.
"""

from __future__ import annotations

import numpy as np

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.spectra.transforms import FrequencyGrid, Transform

SIZES = ((64, 1024, 1000), (128, 4096, 500), (256, 4096, 120))  # (half width, n, realizations)
BANDS = 64


def main() -> None:
    """Print seconds and the ratio for each size, on one thread."""
    for half_width, n, realizations in SIZES:
        ours, theirs, ratio = _ratio(half_width, n, realizations)
        print(
            f"{2 * half_width + 1}² frequencies, {n} points, {realizations} realizations: "
            f"{ours:.2f} s, points and transforms alone {theirs:.2f} s, "
            f"ratio {ratio:.2f} (aim ≤ 1.3; best over best {ours / theirs:.2f})"
        )


def _ratio(half_width: int, n: int, realizations: int) -> tuple[float, float, float]:
    grid = FrequencyGrid(2, half_width)
    estimator = mcs.Estimator("gaussian(width=0.25)", dims=2)
    sampler = mcs.sampler("jittered", dims=2)
    labels = np.random.default_rng(0).integers(0, BANDS, grid.stored)
    bands = grid.full(labels)
    transform, stream = Transform(grid, n), Stream.from_rng(1)

    def terms() -> None:
        mcs.variance_terms(
            estimator,
            sampler,
            n,
            half_width=half_width,
            realizations=realizations,
            rng=1,
            bands=bands,
            workers=1,
        )

    def transforms() -> None:
        for first, count in realization_blocks(realizations, grid.size, multiple=2):
            transform.coefficients(sampler.draw_stream(n, stream, first, count))

    return compare(terms, transforms, rounds=5)


if __name__ == "__main__":
    main()
