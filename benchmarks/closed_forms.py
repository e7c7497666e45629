"""Closed-form Fourier power and covariance of scrambled nets compared with many realizations.

Each net is tested with each randomization in 1 to 4 dims.
The closed forms are compared with means over 100,000 realizations of the net.
The frequencies are random integers.
A difference divided by its standard error is called z.
Real and imaginary parts of a covariance count separately.
The root mean square of z is 1 if closed forms and means agree.
"""

from __future__ import annotations

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array

REALIZATIONS = 100_000
NETS = ("sobol", "niederreiter", "halton", "faure")
STEPS = ("owen", "lms", "digital-shift")
MOST_RMS = 1.1
_PAIRS = 24  # number of pairs of frequencies in each case; half have two equal frequencies
_HIGHEST = 9
_BLOCK = 5000  # number of realizations that are drawn at a time
# Number of points of a net in 1, 2, 3 and 4 dims; nets that are not listed have 16 points
_COUNTS = {"halton": (12, 12, 12, 12), "faure": (16, 16, 9, 25)}


def z_values(sampler: str, n: int, dims: int, realizations: int = REALIZATIONS) -> Array:
    """Return differences between closed forms and means, in standard errors."""
    rng = np.random.default_rng(dims)
    m = rng.integers(-_HIGHEST, _HIGHEST + 1, (_PAIRS, dims))
    other = rng.integers(-_HIGHEST, _HIGHEST + 1, (_PAIRS, dims))
    other[: _PAIRS // 2] = m[: _PAIRS // 2]
    # The largest correlation is between frequencies that differ by a multiple of n along one axis
    other[-4:] = m[-4:]
    other[-4:, 0] += n * rng.choice([-1, 1], 4)
    source = mcs.sampler(sampler, dims=dims)
    exact = mcs.spectra.closed_form_covariance(source, n, m, other)

    # S_m has mean 0, or 1 at m = 0, because points are uniform
    at_zero = [(k == 0).all(axis=1).astype(float) for k in (m, other)]
    total, squares = np.zeros((2, _PAIRS)), np.zeros((2, _PAIRS))
    for first in range(0, realizations, _BLOCK):
        count = min(_BLOCK, realizations - first)
        points = source.draw(n, realizations=count, rng=1, first=first)
        s, t = (
            np.exp(-2j * np.pi * (points @ k.T)).mean(axis=1) - zero
            for k, zero in zip((m, other), at_zero, strict=True)
        )
        product = s * t.conj()
        for part, values in enumerate((product.real, product.imag)):
            total[part] += values.sum(axis=0)
            squares[part] += (values**2).sum(axis=0)
    mean = total / realizations
    error = np.sqrt(np.maximum(squares / realizations - mean**2, 0.0) / realizations)
    off = mean - np.stack([exact.real, exact.imag])
    # Sums that are equal in all realizations have only rounding errors, so they are left out
    varies = error > 1e-12
    assert (np.abs(off[~varies]) < 1e-9).all(), (sampler, dims)
    return np.asarray(off[varies] / error[varies])


def main(*flags: str) -> None:
    """Print a row for each net and randomization.

    The last row has the root mean square of all differences, in standard errors.
    """
    only = [flag.partition("=")[2] for flag in flags if flag.startswith("--net=")]
    found = []
    print("net | step | dims | n | numbers | z rms | largest z")
    for net in NETS:
        for step in STEPS if not only or net in only else ():
            for dims in range(1, 5):
                n = _COUNTS.get(net, (16,) * 4)[dims - 1]
                z = z_values(f"{net} | {step}", n, dims)
                found.append(z)
                # In 1-D, a digital shift moves a whole grid, so all realizations have equal powers
                shown = "exact to rounding"
                if z.size:
                    shown = f"{np.sqrt(np.mean(z**2)):.2f} | {np.abs(z).max():.1f}"
                print(f"{net} | {step} | {dims} | {n} | {z.size} | {shown}", flush=True)
    every = np.concatenate(found)
    rms = float(np.sqrt(np.mean(every**2)))
    print(f"all: {every.size} numbers, z rms {rms:.3f} (aim ≤ {MOST_RMS})")


if __name__ == "__main__":
    main()
