"""Designs for classes of integrands against the best usual sampler, on members held back.

For each class, dims and n every kind that can is searched; the one with the least variance over 400
members is measured over 2,000 others, in 20 groups, each with 32 realisations of its own. Rivals: sobol |
owen, pmj02, shifted Korobov, rank-1 and Fibonacci lattices, and, where ``MCSPECTRA_NETS`` names a
folder with their files of direction numbers, OneTwo and quad-optimised nets (base 3) with owen.
"""

from __future__ import annotations

import os
import tempfile
import time
import warnings
from pathlib import Path

import mcspectra as mcs

CLASSES = ("gaussians", "half-spaces", "disks")
CASES = ((2, 16), (2, 64), (2, 256), (2, 1024), (4, 16), (4, 64), (4, 256), (4, 1024))
KINDS = ("lattice", "digital-net", "points")
RIVALS = ("sobol | owen", "korobov | shift", "rank1-lattice | shift")
PLANE = ("pmj02",)  # in 2-D
NETS = {
    "onetwo_init_tab.dat": "sobol(directions={!r}) | owen",
    "quad_optimized_gf3.dat": "sobol(directions={!r}, base=3) | owen",
}


def main() -> None:
    """Print a line for each class, dims and n, and the times of two searches."""
    warnings.simplefilter("ignore")  # base 3 is not balanced at powers of two
    rivals = list(RIVALS)
    if folder := os.environ.get("MCSPECTRA_NETS"):
        rivals += [spec.format(str(Path(folder) / name)) for name, spec in NETS.items()]
    with tempfile.TemporaryDirectory() as cache:
        os.environ["MCSPECTRA_CACHE"] = cache  # nothing is there yet
        for kind, n in (("lattice", 13), ("owen", 16)):  # compile
            mcs.design(kind, "gaussians", n)
        for kind, n, what in (("lattice", 1009, "a lattice"), ("owen", 256, "64 trees")):
            start = time.perf_counter()
            mcs.design(kind, "gaussians", n)
            print(f"{what} in 2-D, n = {n}: {time.perf_counter() - start:.1f} s")
        for dims, n in CASES:
            for family in CLASSES[: 3 if dims == 2 else 2]:
                _compare(family, dims, n, rivals + list(PLANE) * (dims == 2))


def _compare(family: str, dims: int, n: int, rivals: list[str]) -> None:
    ratios = {}
    for kind in KINDS:
        sampler = mcs.design(kind, family, n, dims=dims, rng=0)
        found = mcs.certificate(sampler, family, n, rivals=rivals[:1], members=400, rng=1)
        ratios[kind] = (float(found["mean_variance"][0]), sampler)
    kind = min(ratios, key=lambda each: ratios[each][0])
    found = mcs.certificate(ratios[kind][1], family, n, rivals=rivals, members=2000, rng=2)
    low, high = found["design_ratio_ci"].values
    steps = ratios[kind][1].spec.partition(" | ")[2]
    print(
        f"{family}, {dims}-D, n = {n}: {float(found['design_ratio']):.3f} ({low:.3f} to {high:.3f}) of "
        f"{found.attrs['best_rival']}, {float(found['mean_variance'][0]):.3g}, {kind} {steps}",
        flush=True,
    )


if __name__ == "__main__":
    main()
