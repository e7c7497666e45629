"""Predicted error spectra of images compared with measured spectra.

The cases have different masks, sets and integrands.
The command ``python -m benchmarks masks`` prints the ratio of predicted to measured power.
The ratio is printed for each of four bands of radial frequency, from 64 images.
"""

from __future__ import annotations

import numpy as np

import mcspectra as mcs

INTEGRANDS = ("gaussian(width=0.3)", "gaussian(width=0.1)", "disk")
SETS = ("korobov", "jittered", "sobol")
MASKS = ("white", "blue-noise", "r2")


def main() -> None:
    """Print the worst band of each case, and the number of bands within 5 and 10 %."""
    found = {}
    for mask in MASKS:
        for source in SETS:
            for integrand in INTEGRANDS:
                chain = f"{source} | decorrelate(mask={mask!r}, width=32)"
                power = mcs.prediction.image_error_spectrum(integrand, chain, 4, dims=2, images=64)
                parts = [
                    float(np.sum(p) / np.sum(m))
                    for p, m in zip(
                        np.array_split(power["predicted_power"].values, 4),
                        np.array_split(power["measured_power"].values, 4),
                        strict=True,
                    )
                ]
                found[chain, integrand] = parts
                print(f"{chain} {integrand}: {', '.join(f'{part:.3f}' for part in parts)}")
    off = np.abs(np.concatenate([*found.values()]) - 1.0)
    print(
        f"{off.size} bands: {np.sum(off < 0.05)} within 5 %, {np.sum(off < 0.1)} within 10 %; "
        f"the worst {100 * off.max():.1f} %"
    )
