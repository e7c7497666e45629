"""Compare SciPy's L-BFGS-B, QR and eigensolver with our own minimizer, QR and eigensolver.

The command ``python -m benchmarks descent`` runs L-BFGS-B and our own minimizer.
Both minimizers are applied to the energies, or similar functions, of three optimized samplers.
For equal numbers of evaluations, the command prints the smallest value that each minimizer finds.
To compare bits, the computations of SciPy and NumPy are repeated with other numbers of threads.
These computations are also repeated with the kernels of OpenBLAS for other processors.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import optimize

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.samplers.hyperuniform import summed_power
from mcspectra.samplers.optimised import minimize
from mcspectra.samplers.relaxation import near_energy

STARTS = 3
COUNTS = (256, 1024)
_FURTHER = 2  # limit of L-BFGS-B's evaluations, as a multiple of the evaluations of our descent
_MEMORY = 10  # number of past steps that L-BFGS stores, in both programs

DIGESTS = """
import hashlib
import numpy as np
from scipy.optimize import minimize
def show(name, *arrays):
    print(name, hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest(), sep="|")
def wave(x):
    y, s = x - 0.1 * np.sin(np.arange(x.size)), np.linspace(1, 100, x.size)
    return float(np.sum(s * y**2 + 0.1 * y**4)), 2 * s * y + 0.4 * y**3
for size in (2_000, 20_000):
    start = np.random.default_rng(0).standard_normal(size)
    found = minimize(wave, start, jac=True, method="L-BFGS-B", options={"maxiter": 30})
    show(f"L-BFGS-B, {size} coordinates", found.x)
from mcspectra.samplers.optimised import minimize
for size in (2_000, 20_000):
    start = np.random.default_rng(0).standard_normal(size)
    show(f"ours, {size} coordinates", minimize(wave, start, iterations=30, longest=1.0))
from mcspectra.core.ordered import eigenpairs, orthonormal
for size, columns in ((300, 58), (20_000, 58)):
    a = np.random.default_rng(size).standard_normal((size, columns))
    show(f"numpy.linalg.qr, {size} x {columns}", np.linalg.qr(a)[0])
    show(f"ours, {size} x {columns}", orthonormal(a))
for size in (16, 58, 240):
    a = np.random.default_rng(size).standard_normal((3 * size, size))
    matrix = np.einsum("ij,ik->jk", a, a)
    show(f"numpy.linalg.eigh, {size}", *np.linalg.eigh(matrix))
    show(f"ours, {size}", *eigenpairs(matrix))
"""
MACHINES = (
    {"OPENBLAS_NUM_THREADS": "2"},
    *({"OPENBLAS_CORETYPE": c} for c in ("Nehalem", "Haswell")),
)


class Task(NamedTuple):
    """A function that an optimized sampler minimizes; the descent stops at the value `goal`."""

    name: str
    n: int
    function: Callable[[Array], tuple[float, Array]]
    iterations: int
    goal: float


def tasks() -> Iterator[Task]:
    for n in COUNTS:
        blue, step, stealthy = (
            mcs.sampler(name, dims=2)
            for name in ("gaussian-blue-noise", "step-blue-noise", "stealthy-hyperuniform")
        )
        energy = partial(near_energy, blue.sigma * n**-0.5)
        yield Task(blue.name, n, energy, blue.iterations, -np.inf)
        yield Task(step.name, n, step._loss(n), step.iterations, -np.inf)
        power = partial(summed_power, stealthy.constrained(n))
        yield Task(stealthy.name, n, power, stealthy.iterations, 1e-20)


def values_of(
    task: Task, run: Callable[[Callable[[Array], tuple[float, Array]], Array], object], seed: int
) -> Array:
    """Return the smallest value that a minimizer has found by each evaluation, (evaluations,)."""
    found = []

    def counted(x: Array) -> tuple[float, Array]:
        value, gradient = task.function(x.reshape(task.n, 2))
        found.append(value)
        return value, gradient.reshape(x.shape)

    run(counted, np.random.default_rng(seed).random((task.n, 2)))
    return np.minimum.accumulate(found)


def print_values() -> None:
    print(
        f"{'descent':22} {'n':>5} {'evaluations':>11} {'ours':>11} {'L-BFGS-B':>11}  as good "
        "as ours after"
    )
    for task in tasks():
        for seed in range(STARTS):
            ours = values_of(
                task,
                lambda f, x, t=task: minimize(
                    f, x, iterations=t.iterations, longest=t.n**-0.5 / 4, goal=t.goal
                ),
                seed,
            )
            limit = _FURTHER * len(ours)
            options = {
                "maxcor": _MEMORY,
                "maxfun": limit,
                "maxiter": limit,
                "ftol": 0.0,
                "gtol": 0.0,
            }
            theirs = values_of(
                task,
                lambda f, x, o=options: optimize.minimize(
                    f, x.ravel(), jac=True, method="L-BFGS-B", options=o
                ),
                seed,
            )
            same = theirs[min(len(ours), len(theirs)) - 1]
            good = np.flatnonzero(theirs <= max(ours[-1] * (1.0 + 1e-9), task.goal))
            after = f"{1 + good[0]}" if good.size else f"not after {len(theirs)}"
            print(
                f"{task.name:22} {task.n:5} {len(ours):11} {ours[-1]:11.5g} {same:11.5g}  {after}",
                flush=True,
            )


def digests(**environment: str) -> dict[str, str]:
    done = subprocess.run(
        [sys.executable, "-c", DIGESTS],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **environment},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return dict(line.split("|") for line in done.stdout.splitlines())


def print_bits() -> None:
    one = digests()
    others = {" ".join(each.values()): digests(**each) for each in MACHINES}
    columns = ["2 threads" if name == "2" else name for name in others]
    print(f"\n{'bits compared with 1 thread':32} {' '.join(f'{c:>10}' for c in columns)}")
    for name, digest in one.items():
        same = ["same" if other[name] == digest else "others" for other in others.values()]
        print(f"{name:32} {' '.join(f'{s:>10}' for s in same)}")


def main() -> None:
    """Print the minima that both programs find, and which settings change the bits of results."""
    print_values()
    print_bits()


if __name__ == "__main__":
    main()
