"""Partitions of the basis functions into bands, whose parts of an estimate are compared.

A band is a set of functions; I_a = Σ_{m in a} conj(f_m) S_m, and Cov(I_a, I_b) summed over all pairs of
bands is the variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.spectra.bases import Basis

__all__ = ["PARTITIONS", "Bands", "check_bands", "make_bands"]

PARTITIONS = ("radial", "anova", "wedge", "dyadic")
_MAX_BANDS = 4096
_WEDGES = 12


@final
@dataclass(frozen=True)
class Bands:
    """A band for every stored coefficient, and what each band is called.

    Attributes
    ----------
    of
        Band of each stored coefficient: int64 (H,).
    labels
        Text for each band.
    meaning
        What the labels are, for the axis of a plot.
    """

    of: Array
    labels: tuple[str, ...]
    meaning: str


def make_bands(bands: str | Array, basis: Basis) -> Bands:
    """Make a partition by name, or of the user's labels.

    Parameters
    ----------
    bands
        ``radial``: shells of the length of the oscillations, one wide; ``dyadic``: shells that double;
        ``anova``: by the axes along which a function varies, so that the bands are the parts of the
        ANOVA decomposition; ``wedge`` (2-D): the constant, and 12 sectors of 15° of the direction
        of ±m (Walsh and Haar: of the numbers of oscillations along the axes, powers of two); or integer labels ≥ 0, an array of the basis' shape, the same for m and −m.

    Raises
    ------
    ParameterError
        An unknown name, labels of another shape, type or range, or ones that part m from −m.
    """
    check_bands(bands, basis)
    if not isinstance(bands, str):
        return _given(np.asarray(bands), basis)
    make = {"radial": _radial, "anova": _anova, "wedge": _wedge, "dyadic": _dyadic}
    found = make[bands](basis)
    # The last may be empty: small grids, and bases without negative indices, lack directions.
    return Bands(found.of, found.labels[: int(found.of.max()) + 1], found.meaning)


def check_bands(bands: str | Array, basis: Basis) -> None:
    """Raise what `make_bands` would, as far as that takes no work."""
    if isinstance(bands, str):
        as_choice("bands", bands, PARTITIONS)
        if bands == "wedge" and basis.dims != 2:
            raise ParameterError(
                f"bands='wedge' is for 2 dims, not {basis.dims}; use 'radial' or 'anova'."
            )


def _radial(basis: Basis) -> Bands:
    shell = np.rint(_length(basis)).astype(np.int64)
    names = tuple(map(str, range(int(shell.max()) + 1)))
    return Bands(shell, names, "band (radial: |m| rounded)")


def _dyadic(basis: Basis) -> Bands:
    """0; then [1, 2), [2, 4), [4, 8), …"""
    length = _length(basis)
    shell = np.where(length > 0, np.frexp(np.maximum(length, 1.0))[1], 0).astype(np.int64)
    names = ["0", *(f"{2**k}–{2 ** (k + 1)}" for k in range(int(shell.max())))]
    return Bands(shell, tuple(names), "band (dyadic: range of |m|)")


def _anova(basis: Basis) -> Bands:
    varies = basis.oscillations() > 0
    subset = varies @ (1 << np.arange(basis.dims))
    order = sorted(range(1 << basis.dims), key=lambda s: (s.bit_count(), _axes_of(s, basis.dims)))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    names = ["".join(f"x{i}" for i in _axes_of(s, basis.dims)) or "constant" for s in order]
    return Bands(place[subset], tuple(names), "band (ANOVA: axes that vary)")


def _wedge(basis: Basis) -> Bands:
    m = basis.directions()
    angle = np.arctan2(m[:, 1], m[:, 0]) % np.pi  # ±m are one direction
    sector = np.rint(angle / np.pi * _WEDGES).astype(np.int64) % _WEDGES  # centred on the axes
    band = np.where((m == 0).all(axis=1), 0, 1 + sector)
    names = ["constant", *(f"{180 * k / _WEDGES:g}°" for k in range(_WEDGES))]
    return Bands(band, tuple(names), "band (wedge: direction of m)")


def _given(labels: Array, basis: Basis) -> Bands:
    integer = labels.shape == basis.shape and labels.dtype.kind in "iu"
    if not integer or labels.min() < 0 or labels.max() >= _MAX_BANDS:
        raise ParameterError(
            f"bands has shape {labels.shape} and type {labels.dtype}; give "
            f"{', '.join(map(repr, PARTITIONS))} or integer labels from 0 to {_MAX_BANDS - 1} of shape "
            f"{basis.shape}."
        )
    stored = basis.pick(labels).astype(np.int64)
    if not np.array_equal(basis.full(stored), labels):
        raise ParameterError(
            "bands must be the same for m and −m, so that band estimates are real."
        )
    return Bands(stored, tuple(map(str, range(int(stored.max()) + 1))), "band (given)")


def _length(basis: Basis) -> Array:
    return np.asarray(np.sqrt((basis.oscillations() ** 2).sum(axis=1)))


def _axes_of(subset: int, dims: int) -> tuple[int, ...]:
    return tuple(i for i in range(dims) if subset >> i & 1)
