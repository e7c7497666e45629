"""RMS error of lattices for functions that a substitution makes periodic.

Substitutions of the integration variable, of the orders 3 to 6, make a function periodic.
Each line has the root mean square error of one shifted lattice of n points, over 40 shifts.
For comparison, folded lattices and plain lattices integrate the function without a substitution.
"""

from __future__ import annotations

import numpy as np

import mcspectra as mcs
from benchmarks.peers import problems
from mcspectra.estimators import Estimator
from mcspectra.improve.improved import Periodized

COUNTS, SHIFTS, ORDERS = (64, 128, 256, 512, 1024, 4096), 40, (3, 4, 5, 6)
MOST_DIMS = 5
LATTICE = "rank1-lattice | shift"


def main() -> None:
    """Print a line for each integrand and each way to use the lattice."""
    for name, f, dims, integral in problems():
        if integral is None or dims > MOST_DIMS:
            continue
        plain = Estimator(mcs.Integrand.from_function(f, dims=dims, integral=integral))
        setups = {
            "plain": (plain, LATTICE),
            "folded": (plain, f"{LATTICE} | mirror(mode='fold')"),
        } | {f"order {k}": (Estimator(Periodized.of(plain, k)), LATTICE) for k in ORDERS}
        for label, (estimator, sampler) in setups.items():
            source, cells = mcs.sampler(sampler, dims=dims), []
            for n in COUNTS:
                points = source.draw(n, realizations=SHIFTS, rng=0)
                estimates = estimator.primary_values(0, points).mean(axis=1)
                error = float(np.sqrt(np.mean((estimates - integral) ** 2)))
                cells.append(f"{n}: {error:.1e}")
            print(f"{name:24} {label:8} {'  '.join(cells)}", flush=True)


if __name__ == "__main__":
    main()
