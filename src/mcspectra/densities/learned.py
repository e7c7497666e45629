"""Smooth spline densities, built axis by axis, mixed with a share of the uniform density.

p(x) = δ + (1 − δ) Π_i q_i(x_i | x_1 … x_{i−1}), where q_i = Σ_m a_m B_m is a quadratic spline.
The B_m are B-splines of integral 1.
The spline weights a ≥ 0 sum to 1 and depend on the earlier coordinates, in one of two ways:

* *mixtures* of K products: a = Σ_k ω_k c_ki with ω_k ∝ w_k Π_{j<i} Σ_m c_kjm B_m(x_j).
  If K = 1, the density is a product.
* *flows*: a = softmax(θ_i φ), where φ are Legendre polynomials of each earlier coordinate x_j.

The warp T is Rosenblatt's transformation of p itself [Rosenblatt1952]_.
Let Q be the density q of the given coordinates x_1 … x_{i−1}. Let F_i be a monotone cubic spline.
Then u_i = ω F_i(x_i) + (1 − ω) x_i with ω = (1 − δ) Q/((1 − δ) Q + δ).
No coordinate of u chooses a part. Therefore T is continuous and twice differentiable.
T also has an exact inverse.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_real, as_real_array
from mcspectra.core.decoding import check_decoded_size, known_path, opened
from mcspectra.core.errors import FileFormatError, McspectraError
from mcspectra.core.fields import settle
from mcspectra.core.jit import kernel
from mcspectra.densities.base import Density, Wrapper
from mcspectra.densities.tabulated import flat

__all__ = ["DEGREE", "Learned", "SplineDensity", "flow_features", "spline_basis", "spline_lengths"]

DEGREE = 4  # degree of the polynomials of a flow
_FORMAT = "mcspectra density 1"
_TEXT_RATIO = 8  # bytes of memory for each byte of the file
_MOST_GATE = 1e6  # largest absolute value of θ; fitted values are smaller
_PDF, _SAMPLE, _INVERT = 0, 1, 2
_SETTLED = 1e-14  # a Newton step this small ends the iteration


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SplineDensity(Density):
    """Spline density that is given by its tables of coefficients.

    Attributes
    ----------
    knots
        Ends of the C cells of each axis, (d, C + 1), from 0 to 1. There are M = C + 2 splines.
    shares, tables
        For a mixture: w (K,) with sum 1, and c (K, d, M) with rows of sum 1. Empty for a flow.
    gates
        For a flow: the coefficients θ (d, M, 1 + d·DEGREE), which are 0 for later coordinates.
        The array of these coefficients is empty for a mixture.
    defensive
        δ, the smallest value of p, so that |f/p| is at most |f|/δ.
    """

    name: ClassVar[str] = "spline"
    spec = "spline"
    knots: Array
    defensive: float
    shares: Array = field(default_factory=lambda: np.empty(0))
    tables: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    gates: Array = field(default_factory=lambda: np.empty((0, 0, 0)))

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims, one per row of knots."""
        return len(self.knots)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Cdf at the knots of the first axis. Breaks of the other axes depend on the point."""
        middle = np.full((self.knots.shape[1] - 2, self.dims), 0.5)
        middle[:, 0] = self.knots[0, 1:-1]
        found = np.unique(self._walked(middle, _INVERT)[:, 0])
        return (tuple(found[(found > 0) & (found < 1)].tolist()), *((),) * (self.dims - 1))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of a file that `Learned` reads."""
        arrays = {n: getattr(self, n).tolist() for n in ("knots", "shares", "tables", "gates")}
        return {"format": _FORMAT, "defensive": self.defensive, **arrays}

    @cached_property
    def _pieces(self) -> Array:
        return np.stack([_cumulative(line) for line in self.knots])

    def _walked(self, given: Array, mode: int) -> Array:
        wide = self.dims + 1 if mode == _SAMPLE else 1 if mode == _PDF else self.dims
        out = np.empty((math.prod(given.shape[:-1]), wide))
        pieces = self._pieces
        tables = (self.knots, pieces, pieces.sum(axis=-1), self.shares, self.tables, self.gates)
        _walk(mode, *tables, self.defensive, flat(given), out)
        return out.reshape(*given.shape[:-1], wide)

    def _pdf(self, x: Array) -> Array:
        return self._walked(x, _PDF)[..., 0]

    def _sample(self, u: Array) -> Array:
        return self._sample_pdf(u)[0]

    def _sample_pdf(self, u: Array) -> tuple[Array, Array]:
        found = self._walked(u, _SAMPLE)
        return found[..., :-1], found[..., -1]

    def _invert(self, x: Array) -> Array:
        return self._walked(x, _INVERT)


@final
@dataclass(frozen=True, kw_only=True)
class Learned(Wrapper):
    """A density from a file that `mcspectra.improve.learned_density` made.

    Attributes
    ----------
    path
        The .json file.

    Raises
    ------
    FileFormatError
        If the file cannot be read, or does not contain a learned density.
    """

    name: ClassVar[str] = "learned"
    path: str | os.PathLike[str]

    def _check(self) -> None:
        known_path(self.path, "a learned density", (".json",))
        settle(self, path=os.fspath(self.path))
        self._inside  # noqa: B018 - checks the content

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims in the file."""
        return self._inside.dims

    def cuts(self, others: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        """Return `others`; in 1-D and 2-D, add places of the domain where the pdf is not smooth."""
        if self.dims > 2:
            return others
        ends = self._inside.knots[:, 1:-1]
        return tuple((*line.tolist(), *more) for line, more in zip(ends, others, strict=True))

    def _sample_pdf(self, u: Array) -> tuple[Array, Array]:
        return self._inside._sample_pdf(u)

    @cached_property
    def _inside(self) -> SplineDensity:
        with opened(self.path, "a learned density", (".json",)) as (stream, size, named, _):
            check_decoded_size(named, size, _TEXT_RATIO * size)
            text = stream.read()
        try:
            found = json.loads(text)
            share = as_real("defensive", found["defensive"], above=0.0, most=1.0)
            knots, shares, tables, gates = (
                as_real_array(n, found[n]) for n in ("knots", "shares", "tables", "gates")
            )
            (d, cells), size = np.subtract(knots.shape, (0, 1)), shares.size
            splines = cells + 2
            if size:
                fits = tables.shape == (size, d, splines) and not gates.size
                fits &= np.allclose([*tables.sum(-1).ravel(), shares.sum()], 1.0)
                fits &= bool((tables >= 0.0).all() and (shares >= 0.0).all())
            else:
                fits = gates.shape == (d, splines, 1 + d * DEGREE) and not tables.size
                fits &= bool((np.abs(gates) < _MOST_GATE).all())
            ends = (knots[:, 0] == 0.0) & (knots[:, -1] == 1.0)
            fits &= found["format"] == _FORMAT and bool((np.diff(knots) > 0.0).all())
            if not (fits and ends.all()):
                raise ValueError
            return SplineDensity(
                knots=knots,
                defensive=share,
                shares=shares,
                tables=tables.reshape(size, d, splines),
                gates=gates.reshape(-1, splines, 1 + d * DEGREE),
            )
        except (ValueError, LookupError, TypeError, RecursionError, McspectraError):
            raise FileFormatError(
                f"{self.path} is not a learned density, or is damaged; give a file that "
                "mcs.improve.learned_density(…, path=…) wrote."
            ) from None


def _splines(knots: Array) -> Any:
    """Return C + 2 quadratic B-splines of integral 1 on knots (C + 1,), as a SciPy spline."""
    from scipy.interpolate import BSpline

    ends = np.concatenate([[0.0, 0.0], knots, [1.0, 1.0]])
    return BSpline(ends, np.diag(1.0 / spline_lengths(knots)), 2)


def spline_lengths(knots: Array) -> Array:
    """Return the weights of the splines that add up to the uniform density, (C + 2,)."""
    ends = np.concatenate([[0.0, 0.0], knots, [1.0, 1.0]])
    return np.asarray((ends[3:] - ends[:-3]) / 3.0)


def spline_basis(knots: Array, x: Array) -> Array:
    """Return values of the B-splines of integral 1 at points (k,): (k, C + 2)."""
    return np.asarray(_splines(knots)(x))


def flow_features(x: Array) -> Array:
    """Return φ at points (k, d): 1 and then polynomials of each coordinate, (k, 1 + d·DEGREE)."""
    t = 2.0 * x - 1.0
    found = [np.ones_like(t), t]
    for n in range(1, DEGREE):
        found.append(((2 * n + 1) * t * found[n] - n * found[n - 1]) / (n + 1))
    columns = np.stack(found[1:], axis=-1).reshape(len(x), -1)
    return np.concatenate([np.ones((len(x), 1)), columns], axis=1)


def _cumulative(knots: Array) -> Array:
    """Return integrals of three splines on each cell, as cubics in its coordinate: (C, 3, 4)."""
    total, width, cells = (
        _splines(knots).antiderivative(),
        np.diff(knots),
        np.arange(len(knots) - 1),
    )
    # Taylor series of the splines' integrals at the left ends of the cells
    found = [total(knots[:-1], p) * (width**p / math.factorial(p))[:, None] for p in range(4)]
    return np.stack([np.array(found)[:, cells, cells + r].T for r in range(3)], axis=1)


@kernel
def _walk(
    mode: int,
    knots: Array,
    pieces: Array,
    ends: Array,
    shares: Array,
    tables: Array,
    gates: Array,
    defensive: float,
    given: Array,
    out: Array,
) -> None:  # pragma: no cover - compiled
    # The argument `mode` chooses whether to sample, to invert, or to evaluate the pdf.
    # To sample, `given` holds u, and `out` gets x and the pdf, (N, d + 1).
    # To invert, `given` holds x, and `out` gets u. Otherwise `out` gets the pdf at x, (N, 1).
    # The array `a` holds the spline weights of one axis
    d, cells, parts = knots.shape[0], knots.shape[1] - 1, shares.size
    a, held, x = np.empty(cells + 2), np.empty(parts), np.empty(d)
    degree = (gates.shape[2] - 1) // d if parts == 0 else 0
    features = np.empty(1 + d * degree)
    features[0] = 1.0
    for n in range(given.shape[0]):
        joint = 1.0
        held[:] = shares
        for i in range(d):
            # Compute the weights of the splines, given the earlier coordinates
            a[:] = 0.0
            if parts:
                for k in range(parts):
                    for m in range(cells + 2):
                        a[m] += held[k] * tables[k, i, m]
            else:
                for m in range(cells + 2):
                    for r in range(1 + i * degree):
                        a[m] += gates[i, m, r] * features[r]
                a[:] = np.exp(a - a.max())
                a /= a.sum()
            spread = (1.0 - defensive) * joint
            spread /= spread + defensive

            # Find the cell of x_i. To sample, compare u_i with the cdf at the right ends of cells.
            # To invert or to evaluate, compare x_i itself with the right ends of cells
            left, c = 0.0, 0
            while c < cells - 1:
                end = knots[i, c + 1]
                if mode == _SAMPLE:
                    share = left
                    for r in range(3):
                        share += a[c + r] * ends[i, c, r]
                    end = spread * share + (1.0 - spread) * end
                if given[n, i] < end:
                    break
                left += a[c]
                c += 1

            # Compute the cubic of the cdf in this cell
            low, width = knots[i, c], knots[i, c + 1] - knots[i, c]
            k0, k1, k2, k3 = left, 0.0, 0.0, 0.0
            for r in range(3):
                piece = pieces[i, c, r]
                k0 += a[c + r] * piece[0]
                k1 += a[c + r] * piece[1]
                k2 += a[c + r] * piece[2]
                k3 += a[c + r] * piece[3]
            if mode == _SAMPLE:
                # Apply Newton's method within a bracket
                t0 = spread * k0 + (1.0 - spread) * low - given[n, i]
                t1 = spread * k1 + (1.0 - spread) * width
                t2, t3 = spread * k2, spread * k3
                below, above = 0.0, 1.0
                t = min(max(-t0 / (t1 + t2 + t3), 0.0), 1.0)
                for _ in range(60):
                    off = t0 + t * (t1 + t * (t2 + t * t3))
                    if off > 0.0:
                        above = t
                    else:
                        below = t
                    moved = t - off / (t1 + t * (2.0 * t2 + 3.0 * t * t3))
                    if not below <= moved <= above:
                        moved = 0.5 * (below + above)
                    step, t = abs(moved - t), moved
                    if step <= _SETTLED:
                        break
                x[i] = low + t * width
                out[n, i] = x[i]
            else:
                x[i] = given[n, i]
                t = (x[i] - low) / width
                if mode == _INVERT:
                    share = k0 + t * (k1 + t * (k2 + t * k3))
                    out[n, i] = spread * share + (1.0 - spread) * x[i]

            # Update everything that the densities of later coordinates depend on
            if mode == _INVERT and i == d - 1:
                break
            here = max((k1 + t * (2.0 * k2 + 3.0 * t * k3)) / width, 0.0)
            joint *= here
            if parts and here > 0.0:
                for k in range(parts):
                    own = 0.0
                    for r in range(3):
                        piece = pieces[i, c, r]
                        slope = piece[1] + t * (2.0 * piece[2] + 3.0 * t * piece[3])
                        own += tables[k, i, c + r] * slope
                    held[k] *= max(own / (width * here), 0.0)
            elif not parts:
                s = 2.0 * x[i] - 1.0
                before, current = 1.0, s
                for r in range(degree):
                    features[1 + i * degree + r] = current
                    order = r + 1.0
                    before, current = (
                        current,
                        ((2.0 * order + 1.0) * s * current - order * before) / (order + 1.0),
                    )
        if mode != _INVERT:
            out[n, -1] = (1.0 - defensive) * joint + defensive
