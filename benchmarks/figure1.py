"""The paper's Figure 1: eight convergence rates, for two pixels under a square area light.

The points are jittered.
"""

from __future__ import annotations

import itertools

import mcspectra as mcs
from mcspectra.rendering import named_pixels, pixel_strategies

COUNTS = tuple(side**2 for side in (8, 11, 16, 23, 32, 45, 64))
SAMPLERS = ["jittered", "jittered | shift"]


def main() -> None:
    """Print expected and fitted rates with 95 % intervals for n from 64 to 4096."""
    pixels = named_pixels("figure1")
    curves = list(itertools.product("PQ", ("light", "bsdf")))
    estimators = [
        mcs.Estimator(pixel_strategies("figure1", *pixels[name])[strategy])
        for name, strategy in curves
    ]
    found = mcs.convergence(estimators, SAMPLERS, COUNTS, realizations=1000, rng=1)
    print("pixel  strategy  sampler           expected    rate   interval")
    for (i, (name, strategy)), (j, sampler) in itertools.product(
        enumerate(curves), enumerate(SAMPLERS)
    ):
        expected = -2.0 if (name, strategy, sampler) == ("P", "light", "jittered") else -1.5
        rate = float(found["rate"].values[i, j])
        low, high = found["rate_ci"].values[i, j]
        shown = f"{name:5s}  {strategy:8s}  {sampler:16s}  {expected:+.1f}"
        print(f"{shown}      {rate:+.3f}  {low:+.3f} … {high:+.3f}")


if __name__ == "__main__":
    main()
