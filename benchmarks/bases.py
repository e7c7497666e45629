"""Compare bases by the size of the cross term, and by how fast the sum of all terms converges."""

from __future__ import annotations

from typing import Any

import mcspectra as mcs
from mcspectra.spectra.bases import BASES

SAMPLERS = (
    "random",
    "jittered",
    "jittered | shift",
    "jittered | digital-shift",
    "sobol | owen",
    "jittered | shift | mirror(mode='fold')",
    "jittered | mirror",
    "jittered | mirror(mode='uniform')",
    "jittered | shift | mirror(mode='uniform')",
)
FUNCTIONS = {
    "smooth, not periodic": "gaussian(center=0.3, width=0.3)",
    "discontinuous": "disk",
    "periodic": "cosine(frequency=[1, 2])",
}
WIDTHS = (4, 8, 16, 32)


def main() -> None:
    """Print ratios: cross term to predicted variance, and predicted to measured variance."""
    for function in FUNCTIONS.values():
        print(f"cross / predicted, {function}, n = 64, half width 32, 2000 realizations")
        print(f"{'':42s}" + "".join(f"{basis:>18s}" for basis in BASES))
        for sampler in SAMPLERS:
            print(f"{sampler:42s}" + "".join(_share(function, sampler, b) for b in BASES))
    for what, function in FUNCTIONS.items():
        print(
            f"predicted / measured at half width {', '.join(map(str, WIDTHS))}: {what}, {function}"
        )
        for sampler in ("jittered", "jittered | shift", "sobol | owen"):
            for basis in (*BASES, "auto"):
                _captured(function, sampler, basis)


def _terms(function: str, sampler: str, basis: str) -> Any:
    return mcs.variance_terms(
        function, sampler, 64, half_width=32, realizations=2000, rng=1, basis=basis
    )


def _share(function: str, sampler: str, basis: str) -> str:
    d = _terms(function, sampler, basis)
    total = float(d["predicted_variance"])
    share, error = float(d["cross_term"]) / total, float(d["cross_term_se"]) / total
    return f"{share:+9.3f} ± {error:.3f}"


def _captured(function: str, sampler: str, basis: str) -> None:
    d = _terms(function, sampler, basis)
    name = f"auto: {d.attrs['basis']}" if basis == "auto" else basis
    curve = d["captured_by_half_width"].values
    values = "".join(f"{curve[k]:9.3f}" for k in WIDTHS)
    print(f"  {sampler:20s} {name:14s}{values}")


if __name__ == "__main__":
    main()
