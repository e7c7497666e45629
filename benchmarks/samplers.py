"""Samplers compared with NumPy's random numbers, and with sets of SciPy and QMCPy, in one run.

The default is 2^16 points in 2-D on one thread.
The benchmark prints points per second, and the reference's time divided by ours.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import mcspectra as mcs
from benchmarks.timing import compare
from mcspectra.core.streams import Stream

COUNT = 2**16
AGAINST_NUMPY = {
    "random": "2",
    "jittered": "2",
    "jittered | shift": "",
    "latin-hypercube": "",
    "multi-jittered": "",
    "correlated-multi-jittered": "0.3",
    "halton": "",
    "sobol": "",
    "sobol | digital-shift": "",
    "sobol | owen(method='hash')": "0.3",
    "sobol | owen(method='nested')": "",
    "sobol | lms": "",
    "pmj02": "",
    "rank1-lattice(vector=[1, 19463]) | shift": "",
    "kronecker | shift": "",
}
"""Specs of samplers, each with the least allowed ratio of the time of NumPy to our time."""


def main() -> None:
    """Print a line for each sampler."""
    for spec, aim in AGAINST_NUMPY.items():
        _line(spec, _drawn(spec, COUNT), _numpy(COUNT), "NumPy", aim, COUNT)
    small, sets = 16, 100_000
    _line(
        "100,000 sets of 16 jittered points",
        _drawn("jittered", small, sets),
        _numpy(small * sets),
        "NumPy",
        "1",
        small * sets,
    )
    _against_scipy()
    _against_qmcpy()
    _alone()


def _line(
    name: str,
    ours: Callable[[], Any],
    theirs: Callable[[], Any],
    who: str,
    aim: str,
    points: int,
    rounds: int = 9,
) -> None:
    seconds, _, ratio = compare(ours, theirs, rounds=rounds)
    wanted = f" (aim {aim})" if aim else ""
    speed = f"{points / seconds / 1e6:8.2f} M points/s"
    print(f"{name:42s} {speed}, {who}'s time over ours {1 / ratio:.3g}{wanted}")


def _drawn(spec: str, n: int, realizations: int = 1) -> Callable[[], Any]:
    sampler, stream = mcs.sampler(spec, dims=2), Stream.from_rng(1)
    sampler.check_count(n)
    return lambda: sampler.draw_stream(n, stream, 0, realizations)


def _numpy(count: int) -> Callable[[], Any]:
    generator = np.random.default_rng(0)
    return lambda: generator.random((count, 2))


def _against_scipy() -> None:
    from scipy.stats import qmc

    generator = np.random.default_rng(0)
    _line(
        "halton(scramble='permute')",
        _drawn("halton(scramble='permute')", COUNT),
        lambda: qmc.Halton(2, scramble=True, rng=generator).random(COUNT),
        "SciPy",
        "5",
        COUNT,
    )
    n = 61**2  # SciPy takes minutes for 251² points
    _line(
        f"latin-hypercube(strength=2), {n} points",
        _drawn("latin-hypercube(strength=2)", n),
        lambda: qmc.LatinHypercube(2, strength=2, rng=generator).random(n),
        "SciPy",
        "100",
        n,
        rounds=3,
    )
    _poisson_disk(qmc, generator)


def _poisson_disk(qmc: Any, generator: np.random.Generator) -> None:
    """Compare our time per point for 1024 points with SciPy's time per point.

    SciPy fills the whole square with points of the same radius.
    """
    from scipy.spatial.distance import pdist

    ours = _drawn("poisson-disk(boundary='bounded')", 1024)
    radius = float(pdist(ours()[0]).min())
    filled: list[int] = []

    def theirs() -> None:
        filled.append(len(qmc.PoissonDisk(2, radius=radius, rng=generator).fill_space()))

    seconds, reference, _ = compare(ours, theirs, rounds=5)
    ratio = (reference / np.mean(filled)) / (seconds / 1024)
    print(
        f"{'poisson-disk, 1024 points':42s} {1.024e-3 / seconds:8.2f} M points/s, SciPy's "
        "time over "
        f"ours {ratio:.3g} a point, same radius (aim 300)"
    )


def _against_qmcpy() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import qmcpy

        def theirs() -> None:
            qmcpy.DigitalNetB2(2, randomize="NUS", seed=7).gen_samples(COUNT)

        ours = _drawn("sobol | owen(method='nested')", COUNT)
        _line("sobol | owen(method='nested')", ours, theirs, "QMCPy", "100", COUNT, rounds=3)


def _alone() -> None:
    """Print the speed of two samplers that are not compared with other packages.

    The sets of ``bnot`` are optimized in each round, without the cache.
    """
    for spec, n, aim in (("pmj02", COUNT, "5 M points/s"), ("bnot", 1024, "5 s")):
        sampler = mcs.sampler(spec, dims=2)
        draw = getattr(sampler, "_optimize", None)
        best = float("inf")
        for realization in range(5):
            keys = Stream.from_rng(2).keys(realization, 1)
            start = time.perf_counter()
            if draw is None:
                sampler.draw_stream(n, Stream.from_rng(2), realization, 1)
            else:
                draw(n, keys[0], lambda _: None)
            best = min(best, time.perf_counter() - start)
        print(
            f"{f'{spec}, {n} points':42s} {n / best / 1e6:8.4f} M points/s, {best:.3g} s (aim "
            f"{aim})"
        )


if __name__ == "__main__":
    main()
