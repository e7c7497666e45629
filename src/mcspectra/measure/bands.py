"""Partitions of the basis functions into bands, which split an estimate into parts.

A band is a set of functions with the estimate I_a = Σ_{m in a} conj(f_m) S_m.
The sum of Cov(I_a, I_b) over all pairs of bands is the variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.spectra.bases import Basis

__all__ = ["PARTITIONS", "Bands", "check_bands", "make_bands"]

PARTITIONS = ("radial", "anova", "wedge", "dyadic")
"""Names of the partitions."""


@dataclass(frozen=True)
class BandSettings:
    """Largest and default numbers of bands."""

    # Largest number of bands in a user's labels.
    # The covariance of 4,096 bands takes 128 MiB per channel.
    most: int = 4096
    # Number of sectors of directions ±m, with 15° each.
    # Sectors are centered on the axes and the diagonals, with two other sectors in between.
    wedges: int = 12


_SETTINGS = BandSettings()


@final
@dataclass(frozen=True)
class Bands:
    """The band of every stored coefficient, and the name of each band.

    Attributes
    ----------
    of
        Band of each stored coefficient: int64 (H,).
    labels
        Text for each band.
    meaning
        Meaning of the labels. It is the title of a plot axis.
    """

    of: Array
    labels: tuple[str, ...]
    meaning: str


def make_bands(bands: str | Array, basis: Basis) -> Bands:
    """Make a partition into bands by its name, or from the user's labels.

    Parameters
    ----------
    bands
        ``radial`` bands are shells of |m| of width one.
        ``dyadic`` bands are shells whose width doubles.
        ``anova`` groups functions by the axes along which they vary,
        so the bands are the parts of the ANOVA decomposition.
        ``wedge`` (2-D) has a band for the constant and 12 sectors of 15° for the direction of ±m.
        For Walsh and Haar functions, m are the numbers of oscillations along the axes.
        These numbers of oscillations are powers of two.
        Labels may also be an array of integers ≥ 0 with the shape of the basis.
        The labels of m and −m must be equal.

    Raises
    ------
    ParameterError
        If the name is unknown, or labels have a wrong shape, type or range.
        If the labels of m and −m differ.
    """
    check_bands(bands, basis)
    labels: tuple[str, ...] | list[str]
    match bands if isinstance(bands, str) else None:
        case "radial":
            of = np.rint(np.linalg.norm(basis.oscillations(), axis=1)).astype(np.int64)
            labels, meaning = tuple(map(str, range(int(of.max()) + 1))), "radial: |m| rounded"
        case "dyadic":  # The bands of |m| are 0, [1, 2), [2, 4), [4, 8), …
            length = np.linalg.norm(basis.oscillations(), axis=1)
            of = np.where(length > 0, np.frexp(np.maximum(length, 1.0))[1], 0).astype(np.int64)
            labels = ["0", *(f"{2**k}–{2 ** (k + 1)}" for k in range(int(of.max())))]
            meaning = "dyadic: range of |m|"
        case "anova":
            axes = range(basis.dims)
            subset = (basis.oscillations() > 0) @ (1 << np.arange(basis.dims))
            sets = [tuple(i for i in axes if s >> i & 1) for s in range(1 << basis.dims)]
            order = sorted(range(len(sets)), key=lambda s: (len(sets[s]), sets[s]))
            of = np.argsort(order)[subset]
            labels = ["".join(f"x{i}" for i in sets[s]) or "constant" for s in order]
            meaning = "ANOVA: axes that vary"
        case "wedge":
            m = basis.directions()
            angle = np.arctan2(m[:, 1], m[:, 0]) % np.pi  # m and −m have the same direction
            wedges = _SETTINGS.wedges
            sector = (
                np.rint(angle / np.pi * wedges).astype(np.int64) % wedges
            )  # Sectors are centered on the axes
            of = np.where((m == 0).all(axis=1), 0, 1 + sector)
            labels = ["constant", *(f"{180 * k / wedges:g}°" for k in range(wedges))]
            meaning = "wedge: direction of m"
        case _:
            given = np.asarray(bands)
            integer = given.shape == basis.shape and given.dtype.kind in "iu"
            if not integer or given.min() < 0 or given.max() >= _SETTINGS.most:
                raise ParameterError(
                    Parameter("bands"),
                    f" has shape {given.shape} and type {given.dtype}; give "
                    f"{', '.join(map(repr, PARTITIONS))} or integer labels from 0 to "
                    f"{_SETTINGS.most - 1} of "
                    f"shape {basis.shape}.",
                )
            of, meaning = basis.pick(given).astype(np.int64), "given"
            if not np.array_equal(basis.full(of), given):
                raise ParameterError(
                    "bands must be the same for m and −m, so that band estimates are real."
                )
            labels = tuple(map(str, range(int(of.max()) + 1)))
    # Small grids and bases without negative indices lack some directions.
    # Drop the last labels if no coefficient has these labels
    return Bands(of, tuple(labels[: int(of.max()) + 1]), f"band ({meaning})")


def check_bands(bands: str | Array, basis: Basis) -> None:
    """Raise the errors of `make_bands` that do not need its result."""
    if isinstance(bands, str):
        as_choice("bands", bands, PARTITIONS)
        if bands == "wedge" and basis.dims != 2:
            raise ParameterError(
                Parameter("bands", "wedge"),
                f" is for 2 dims, not {basis.dims}; use 'radial' or 'anova'.",
            )
