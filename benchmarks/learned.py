"""Ratios of variances with and without learned densities.

Each density is learned for the sampler and n.
The variances use 200 realizations that were not used for learning.
Run ``python -m benchmarks learned``.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from scipy.special import ndtri

import mcspectra as mcs
from mcspectra.improve.learned import LEARNED

REALIZATIONS = 200
GROWTH = np.linspace(0.5, 2.0, 8)


def _normal(x):
    return ndtri(np.clip(x, 1e-300, 1.0 - 2.0**-53))


INTEGRANDS = {
    "peak off the axes, 2-D": (
        2,
        lambda x: np.exp(-((x - (0.3, 0.7)) ** 2).sum(-1) / 0.005),
    ),
    "product of peaks, 4-D": (4, lambda x: (1.0 / (0.04 + (x - 0.4) ** 2)).prod(-1)),
    "ridge across the axes, 2-D": (2, lambda x: np.exp(-100.0 * (x[..., 0] - x[..., 1]) ** 2)),
    "corner pole, 2-D": (2, lambda x: (np.maximum(x, 1e-300) ** -0.3).prod(-1)),
    "smooth product, 8-D": (8, lambda x: np.exp(x * GROWTH).prod(-1)),
    "digital option, 2-D": (2, lambda x: (_normal(x).sum(-1) > 1.5) * 1.0),
    "two bells (camel), 3-D": (
        3,
        lambda x: sum(np.exp(-((x - c) ** 2).sum(-1) / 0.02) for c in (1 / 3, 2 / 3)),
    ),
}
"""Number of dims and function of each integrand, by name."""


def variance(f, density, u):
    """Return the variance of the means over sets u of shape (realizations, n, d)."""
    if density is None:
        return f(u).mean(axis=1).var(ddof=1)
    x = density.sample(u)
    return (f(x) / density.pdf(x)).mean(axis=1).var(ddof=1)


def main():
    print(
        f"variance over that of uniform points; 95 %: ± {196 * math.sqrt(4 / REALIZATIONS):.0f} %"
    )
    for name, (dims, f) in INTEGRANDS.items():
        for sampler, n in (("random", 1024), ("sobol | owen", 64), ("sobol | owen", 1024)):
            u = mcs.sampler(sampler, dims=dims).draw(n, realizations=REALIZATIONS, rng=7)
            before = variance(f, None, u)
            found = []
            for kind in LEARNED:
                p = mcs.improve.learned_density(f, kind, sampler, n, dims=dims)
                ratio = variance(f, p, u) / before
                found.append("uniform" if p.name == "uniform" else f"{ratio:.2g}")
            print(f"| {name} | `{sampler}` | {n} | {' | '.join(found)} |")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
