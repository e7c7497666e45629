"""Expected power of 4096 points on 512² frequencies, compared with one complex FFT of that size.

Our grids contain both m and −m: 513² frequencies, from −256 to 256 on each axis.
The FFT has 512² frequencies, from −256 to 255 on each axis.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum

POINTS, HALF_WIDTH, REALIZATIONS = 4096, 256, 8
CHOSEN = 64  # number of realizations for the comparison of `power_spectrum`


def main() -> None:
    """Print milliseconds, their ratio, and the error compared with the direct sum."""
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
    print(f"ratio a realization, one thread (aim ≤ 1.5):   {ratio:.2f}")

    def chosen() -> None:
        mcs.power_spectrum(
            "jittered", POINTS, half_width=HALF_WIDTH, realizations=CHOSEN, workers=1
        )

    def plain_chosen() -> None:
        for _ in range(CHOSEN):
            scipy.fft.fft2(plane, workers=1)

    ours, theirs, ratio = (value for value in compare(chosen, plain_chosen, rounds=5))
    print(f"power_spectrum, {CHOSEN} realizations, draws too:     {1e3 * ours / CHOSEN:.2f} ms")
    print(f"ratio a realization, one thread (aim ≤ 0.7):   {ratio:.2f}")
    given = {"half_width": HALF_WIDTH, "realizations": CHOSEN}
    fast = mcs.power_spectrum("jittered", POINTS, **given)
    exact = mcs.power_spectrum("jittered", POINTS, eps=1e-12, **given)
    off = (abs(fast["power"] - exact["power"]) / exact["power_se"]).where(exact["power_se"] > 0)
    print(
        f"its largest error in standard errors (eps {fast.attrs['eps']:.0e}): "
        f"{float(off.max()):.1e}"
    )
    got = transform.coefficients(points[:2])
    chosen = np.random.default_rng(1).choice(grid.stored, 2000, replace=False)
    exact = direct_sum(points[:2], grid.indices()[chosen])
    print(
        "largest error of 2 × 2000 coefficients:        "
        f"{abs(got[:, chosen] - exact).max():.1e} of the peak"
    )


if __name__ == "__main__":
    main()
