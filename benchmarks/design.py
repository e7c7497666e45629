"""Compare designs with the best usual sampler, on integrands that the search did not use.

For each class of integrands, number of dims and n, all suitable kinds of designs are searched.
The design with the least variance over 400 integrands is measured over 2,000 other integrands.
The integrands form 20 groups, each with its own 32 realizations.
Rivals are sobol | owen, pmj02, and shifted Korobov, rank-1 and Fibonacci lattices.
``MCSPECTRA_NETS`` may name a folder with direction numbers of OneTwo and quad-optimized nets.
If this folder is given, designs are also compared with nets in base 3, scrambled by owen.

The last lines compare designs with folded lattices, on Gaussians of random orientation.
Among these Gaussians, a few narrow ones cause half of the mean variance.
Therefore the benchmark measures 20,000 or 90,000 Gaussians, with 128 realizations per group.
"""

from __future__ import annotations

import itertools
import math
import os
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import mcspectra as mcs
from mcspectra.improve.designs.searches import SearchSettings

CLASSES = ("gaussians", "half-spaces")
DIMS = (2, 4)
KINDS = {
    16: ("points",),
    64: ("points",),
    256: ("lattice", "digital-net", "points"),
    1024: ("lattice", "digital-net"),
}
RIVALS = ("sobol | owen", "korobov | shift", "rank1-lattice | shift")
PLANE = ("pmj02",)  # in 2-D, designs are also compared with these samplers
FOLDED = ("korobov | shift | mirror(mode='fold')", "rank1-lattice | shift | mirror(mode='fold')")
TURNED = ((2, 64, ("lattice", "points")), (2, 256, ("lattice",)), (4, 64, ("lattice", "points")))
"""Gaussians of random orientation: dims, number of points, and kinds of designs to search."""
MEMBERS = {(2, 64): 90_000, (2, 256): 20_000, (4, 64): 20_000}  # numbers of these Gaussians
# The search returns the design that it finds even if a usual sampler has less variance
DESIGNS = SearchSettings(return_rival=False)
NETS = {
    "onetwo_init_tab.dat": "sobol(directions={!r}) | owen",
    "quad_optimized_gf3.dat": "sobol(directions={!r}, base=3) | owen",
}


def main() -> None:
    """Print a line for each class, dims and n, and the times of two searches."""
    warnings.simplefilter("ignore")  # sets in base 3 are not balanced at powers of two
    rivals = list(RIVALS)
    if folder := os.environ.get("MCSPECTRA_NETS"):
        rivals += [spec.format(str(Path(folder) / name)) for name, spec in NETS.items()]
    with tempfile.TemporaryDirectory() as cache:
        os.environ["MCSPECTRA_CACHE"] = cache  # an empty cache, so that every design is searched
        for kind, n in (("lattice", 13), ("owen", 16)):  # compile the kernels first
            mcs.design(kind, "gaussians", n, settings=DESIGNS)
        for kind, n, what in (("lattice", 1009, "a lattice"), ("owen", 256, "64 trees")):
            start = time.perf_counter()
            mcs.design(kind, "gaussians", n, settings=DESIGNS)
            print(f"{what} in 2-D, n = {n}: {time.perf_counter() - start:.1f} s")
        for family, dims, n in itertools.product(CLASSES, DIMS, KINDS):
            _compare(family, dims, n, rivals + list(PLANE) * (dims == 2))
        for dims, n, kinds in TURNED:
            _compare_folded(dims, n, kinds)
    for dims, n in itertools.product(DIMS, (16, 64)):
        error = _least_error(dims, n)
        print(f"half-spaces, {dims}-D, n = {n}: a fixed set has an error of {error:.3g}, not less")


def _compare(family: str, dims: int, n: int, rivals: list[str]) -> None:
    ratios = {}
    for kind in KINDS[n]:
        sampler = mcs.design(kind, family, n, dims=dims, rng=0, settings=DESIGNS)
        found = mcs.certificate(sampler, family, n, rivals=rivals[:1], members=400, rng=1)
        ratios[kind] = (float(found["mean_variance"][0]), sampler)
    kind = min(ratios, key=lambda each: ratios[each][0])
    found = mcs.certificate(ratios[kind][1], family, n, rivals=rivals, members=2000, rng=2)
    low, high = found["design_ratio_ci"].values
    steps = ratios[kind][1].spec.partition(" | ")[2]
    print(
        f"{family}, {dims}-D, n = {n}: {float(found['design_ratio']):.3f} ({low:.3f} to "
        f"{high:.3f}) of "
        f"{found.attrs['best_rival']}, {float(found['mean_variance'][0]):.3g}, {kind} {steps}",
        flush=True,
    )


def _turned(dims: int) -> object:
    """Return a class of Gaussians with random orientations and eigenvalues in 0.01 … 1."""

    def gaussian(rng: np.random.Generator) -> mcs.Integrand:
        axes = np.linalg.qr(rng.standard_normal((dims, dims)))[0]
        axes /= np.sqrt(rng.uniform(0.01, 1.0, dims))
        center = rng.random(dims)
        return mcs.Integrand.from_function(
            lambda x: np.exp(-0.5 * (((x - center) @ axes) ** 2).sum(axis=-1)), dims=dims
        )

    return gaussian


def _compare_folded(dims: int, n: int, kinds: tuple[str, ...]) -> None:
    rivals = [*FOLDED, "pmj02-blue-noise"] if dims == 2 else list(FOLDED)
    for kind in kinds:
        sampler = mcs.design(kind, _turned(dims), n, dims=dims, rng=0, settings=DESIGNS)
        found = mcs.certificate(
            sampler,
            _turned(dims),
            n,
            rivals=rivals,
            members=MEMBERS[dims, n],
            realizations=128,
            rng=2,
        )
        low, high = found["design_ratio_ci"].values
        print(
            f"turned Gaussians, {dims}-D, n = {n}, {kind}: {float(found['design_ratio']):.3f} "
            f"({low:.3f} to {high:.3f}) of {found.attrs['best_rival']}",
            flush=True,
        )


def _least_error(dims: int, n: int) -> float:
    """Optimize a fixed set of n points for random half-spaces, and return its mean squared error.

    The optimization starts from three scrambled Sobol' sets; the least error is returned.
    Along a direction v, u_i = F(v·x_i), where F is the distribution of v·x for uniform x.
    The sorted values are u_(1) ≤ u_(2) ≤ ….
    The squared error, averaged over offsets, is the mean of (u_(i) − (i − ½)/n)² plus 1/(12 n²).
    """
    generator = np.random.default_rng(3)
    directions = generator.standard_normal((400 * dims, dims))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    low = np.minimum(directions, 0.0).sum(axis=1)
    sizes = np.maximum(np.abs(directions), 1e-3)
    grid = np.linspace(0.0, 1.0, 2001)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=dims)))
    signs = (-1.0) ** corners.sum(axis=1)
    tables = np.array(
        [
            np.maximum(grid[:, None] * a.sum() - corners @ a, 0.0) ** dims
            @ signs
            / (math.factorial(dims) * a.prod())
            for a in sizes
        ]
    )
    spans, rows = sizes.sum(axis=1), np.arange(len(sizes))

    def error(flat: np.ndarray) -> tuple[float, np.ndarray]:
        place = np.clip((flat.reshape(n, dims) @ directions.T - low) / spans, 0.0, 1.0) * 2000
        cell = np.minimum(place.astype(int), 1999)
        slope = tables[rows, cell + 1] - tables[rows, cell]
        u = tables[rows, cell] + slope * (place - cell)
        off = u - (u.argsort(axis=0).argsort(axis=0) + 0.5) / n
        gradient = (2.0 * off * slope * 2000 / spans) @ directions / off.size
        return 1e3 * (1 / (12 * n * n) + (off**2).mean()), 1e3 * gradient.reshape(-1)

    starts = mcs.sampler("sobol | owen", dims=dims).draw(n, realizations=3, rng=0)
    bounds = [(0.0, 1.0)] * (n * dims)
    return min(
        1e-3 * float(minimize(error, x.reshape(-1), jac=True, method="L-BFGS-B", bounds=bounds).fun)
        for x in starts
    )


if __name__ == "__main__":
    main()
