"""Expected power of 4096 points on 512² frequencies, against one plain complex FFT of that size.

Our grids hold m and −m: 513² frequencies, −256 … 256, where the FFT has 512², −256 … 255.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum

POINTS, HALF_WIDTH, REALIZATIONS = 4096, 256, 8


def main() -> None:
    """Print milliseconds, the ratio, and the error against the direct sum."""
    grid = FrequencyGrid(2, HALF_WIDTH)
    transform = Transform(grid, POINTS)
    points = mcs.sampler("jittered", dims=2).draw(POINTS, realizations=REALIZATIONS, rng=1)
    plane = np.random.default_rng(0).random((512, 512)) + 0j
    total, squares = np.zeros(grid.stored), np.zeros(grid.stored)

    def power() -> None:
        transform.add_power(points, None, total, squares)

    def plain() -> None:
        for _ in range(REALIZATIONS):
            scipy.fft.fft2(plane, workers=1)

    ours, theirs, ratio = (value for value in compare(power, plain, rounds=25))
    print(f"power spectrum, 4096 points, 513² frequencies: {1e3 * ours / REALIZATIONS:.2f} ms")
    print(f"scipy.fft.fft2, 512²:                          {1e3 * theirs / REALIZATIONS:.2f} ms")
    print(f"ratio a realisation, one thread (aim ≤ 1.5):   {ratio:.2f}")
    got = transform.coefficients(points[:2])
    chosen = np.random.default_rng(1).choice(grid.stored, 2000, replace=False)
    exact = direct_sum(points[:2], grid.indices()[chosen])
    print(
        f"largest error of 2 × 2000 coefficients:        {abs(got[:, chosen] - exact).max():.1e} of the peak"
    )


if __name__ == "__main__":
    main()
