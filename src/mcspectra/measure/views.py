"""The two views of an estimator: pairs of integrand coefficients and spectra of points.

The *domain* view has one integrand f, and warped points with weights from all techniques.
In *primary* space every technique has its own integrand g_t and the sampler's own points.
Sums then run over all techniques and all frequencies m.

Basis functions are divided into *bands*, which split an estimate into parts:
The estimate of a band a is I_a = Σ_{m in a} conj(f_m) S_m.
The sum of Cov(I_a, I_b) over all pairs of bands is the variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import InfiniteWeightVarianceWarning, Parameter, ParameterError, warn
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Mirrored
from mcspectra.estimators.quadrature import closed_moments
from mcspectra.measure.sums import Partition, Variables
from mcspectra.samplers import Random, sampler
from mcspectra.samplers.randomizations import Mirror
from mcspectra.spectra.bases import Basis, Coefficients, fitting_basis, make_basis

__all__ = ["PARTITIONS", "Bands", "Frequencies", "View", "check_bands", "make_bands"]

PARTITIONS = ("radial", "anova", "wedge", "dyadic")
"""Names of the partitions."""


@dataclass(frozen=True)
class FrequencySettings:
    """Settings of the default half width, and of estimates of ∫f² and of mean squared weights."""

    # The default half width is at least this number.
    # A half width of 64 resolves features of 1/128 of the cube, such as pixels of a thumbnail.
    least_width: int = 64
    # The default half width contains at most this number of frequencies, 2^17.
    # In 2-D a half width of 128 fits, and one spectrum takes 1 MiB in half storage.
    most_frequencies: int = 2**17
    # The half width is halved if less than this fraction of Σ|f_m|² is lost.
    # The default is about ten times the rounding error of float64.
    rounding: float = 1e-15
    # Number of points that estimate mean squares of weights and of functions.
    # The points give the energy share of a smooth f to 1e-4, and of a discontinuous f to 1 %.
    probes: int = 2**14


@dataclass(frozen=True)
class BandSettings:
    """Largest and default numbers of bands."""

    # Largest number of bands in a user's labels.
    # The covariance of 4,096 bands takes 128 MiB per channel.
    most: int = 4096
    # Number of sectors of directions ±m, with 15° each.
    # Sectors are centered on the axes and the diagonals, with two other sectors in between.
    wedges: int = 12


_SETTINGS = FrequencySettings()
_BANDS = BandSettings()


@final
@dataclass(frozen=True)
class Frequencies:
    """The basis functions of an analysis, in the domain or in primary space."""

    estimator: AbstractEstimator
    space: str  # ``"domain"`` or ``"primary"``
    basis: Basis

    @staticmethod
    def of(subject: Subject, asked: Any, n: int = 1) -> Frequencies:
        """Choose the space, the half width and the basis, where the arguments do not give them.

        The half width is chosen for n points.

        With ``"auto"``, the basis is chosen to suit the randomization of the points.
        In the domain, the points of a mirrored integrand are folded.
        In primary space, the points of the estimator are the points of the sampler.
        """
        estimator, space, basis = subject.estimator, asked.space, asked.basis
        domain = estimator.domain_integrand
        if space == "domain" and domain is None:
            raise ParameterError(
                f"{estimator.spec} has no common domain: its techniques are given on their own "
                "unit cubes; use ",
                Parameter("space", "primary"),
                ".",
            )
        chosen = space or ("primary" if domain is None else "domain")
        dims = estimator.dims if chosen == "primary" else estimator.domain_dims
        width: int | None = asked.half_width
        if width is None:
            # The default half width is twice the frequency n^(1/d), rounded up to a power of two.
            # A lower limit and the largest number of frequencies may change the default half width.
            # At frequencies above 2 n^(1/d), n jittered points have the power of random points
            width = max(
                _SETTINGS.least_width, 2 ** math.ceil(math.log2(2.0 * n ** (1.0 / dims)) - 1e-9)
            )
            while width > 1 and (2 * width + 1) ** dims > _SETTINGS.most_frequencies:
                width //= 2
            if domain is not None and domain.fourier_source == "exact" and dims <= 2:
                # Halve the width while f has only rounding noise in the outer half
                power = np.abs(domain.fourier_grid(width)) ** 2
                power = power.reshape(*(2 * width + 1,) * dims, -1)
                while width > 1:
                    inner = (slice(width // 2, -(width // 2)),) * dims
                    if power[inner].sum() < (1.0 - _SETTINGS.rounding) * power.sum():
                        break
                    power, width = power[inner], width // 2
        if basis == "auto":
            source = estimator.randomized(subject.sampler)
            mirrored = isinstance(estimator, Mirrored) and estimator.mode == "integrand"
            if chosen == "domain" and mirrored:
                source = source.then(Mirror(mode="fold"))
            count = asked.n if hasattr(asked, "n") else asked.counts[-1]
            basis = fitting_basis(source.law(source.nearest_count(count)), width)
        return Frequencies(estimator, chosen, make_basis(basis, dims, width))

    @property
    def size(self) -> int:
        """Number of coefficients. In primary space, all techniques have their own coefficients."""
        techniques = len(self.estimator.counts) if self.space == "primary" else 1
        return self.basis.size * techniques

    @property
    def diverge(self) -> bool:
        """Whether Var(S_0) and the spectral terms are infinite."""
        return self.space == "domain" and self.estimator.infinite_weights

    def view(self, n: int, asked: Any, *, apart: bool = False) -> View:
        """Prepare transforms of n points and coefficients of f; `apart` separates the techniques.

        In primary space, techniques are always separate.
        """
        estimator, basis = self.estimator, self.basis
        f = estimator.domain_integrand if self.space == "domain" else None
        techniques = range(len(estimator.counts))
        counts = estimator.counts if apart or f is None else (sum(estimator.counts),)
        transforms = [basis.transform(n * count, asked.engine, asked.eps) for count in counts]
        integrands = [estimator.primary_integrand(t) for t in techniques] if f is None else [f]
        found = [basis.integrand(g) for g in integrands]
        stacked = np.stack([coefficients for coefficients, _ in found], axis=1)
        return View(
            estimator,
            self.space,
            basis,
            tuple(coefficients for coefficients, _ in transforms),
            transforms[0][1],
            np.broadcast_to(stacked, (len(stacked), len(counts), basis.stored)),
            "; ".join(dict.fromkeys(source for _, source in found)),
        )

    def undefined(
        self, variables: Variables, finite: tuple[str, ...], infinite: tuple[str, ...] = ()
    ) -> Variables:
        """Replace the variables of terms that diverge by NaN, or by infinity."""
        warn(
            f"∫1/p diverges for {self.estimator.spec}: Var(S_0) and the spectral terms are "
            "infinite, although the variance of the estimate may be finite; use space='primary'.",
            InfiniteWeightVarianceWarning,
        )
        return {
            name: (dims, v)
            if name.startswith(finite)
            else (dims, np.full_like(v, math.inf if name in infinite else math.nan))
            for name, (dims, v) in variables.items()
        }


@dataclass(frozen=True)
class View:
    """Coefficients of an integrand and transforms of points, in the domain or primary space."""

    estimator: AbstractEstimator
    space: str
    basis: Basis
    # Transforms of points to S_m: one for each technique, or one for the points of all techniques
    transforms: tuple[Coefficients, ...]
    engine: str
    integrand_coefficients: Array  # Coefficients f^t of each technique t, (C, T, H)
    source: str  # Source of the coefficients

    def spectra(self, points: list[Array]) -> list[Array]:
        """Return the spectra of a block, (R, H), for each technique or for all together."""
        if self.space == "primary":
            return [
                transform(u, None) for transform, u in zip(self.transforms, points, strict=True)
            ]
        # The weights of a single technique may depend on u, not only on x
        if len(self.transforms) == 1:
            return [self.transforms[0](*self.estimator.weighted_points(points))]
        warped = [self.estimator.warp(t, u) for t, u in enumerate(points)]
        return [
            transform(x, self.estimator.weight(t, x) / x.shape[1])
            for t, (transform, x) in enumerate(zip(self.transforms, warped, strict=True))
        ]

    def coefficients(self, points: list[Array]) -> Array:
        """Return spectra of a block, with the techniques concatenated: (R, T·H)."""
        parts = self.spectra(points)
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def energy(self, n: int) -> tuple[Array, Array]:
        """Return the share of ∫f² in the basis, and the variance of the rest for random points.

        Both results are (channels or 1,), and NaN if ∫f² is not known.
        The power of random points is (1/n) times the mean square of the weights.
        """
        estimator, basis = self.estimator, self.basis
        f = np.abs(self.integrand_coefficients) ** 2 * basis.double
        integrands = [estimator.primary_integrand(t) for t in range(len(estimator.counts))]
        if self.space == "domain" and estimator.domain_integrand is not None:
            integrands = [estimator.domain_integrand]
        # Find ∫g² of each integrand, (C, T). Without a closed form, average over scrambled points
        probes = _SETTINGS.probes
        squares = []
        for g in integrands:
            exact = closed_moments(g)
            if exact is None:
                x = sampler("sobol | owen", g.dims).draw(probes, rng=0)[0]
                squares.append((np.asarray(g(x)).reshape(probes, -1) ** 2).mean(axis=0))
            else:
                squares.append(exact[1])
        whole = np.stack(squares, axis=1)
        held = f[:, : len(integrands)].sum(axis=2)
        rest = np.maximum(whole - held, 0.0)
        if self.space == "primary":
            level = 1.0 / np.array(estimator.counts, float)
        else:
            drawn = estimator.draw(Random(dims=estimator.dims), probes, Stream.from_rng(0), 0, 1)
            _, weights = estimator.weighted_points(drawn)
            level = np.array([probes * np.square(weights).sum()])
        share = np.divide(held.sum(1), whole.sum(1), out=np.ones(len(f)), where=whole.sum(1) > 0)
        return np.minimum(share, 1.0), (rest * level).sum(axis=1) / n

    def partition(self, band: Array, matrix: bool) -> Partition:
        """Return coefficients and labels, repeated for each technique."""
        techniques = len(self.transforms)
        shell = self.basis.oscillations().max(axis=1)
        dc = np.zeros(self.basis.stored, bool)
        dc[self.basis.dc] = True
        flat = self.integrand_coefficients.reshape(len(self.integrand_coefficients), -1)
        return Partition(
            np.ascontiguousarray(flat),
            np.tile(self.basis.double, techniques),
            np.tile(dc, techniques),
            np.tile(band, techniques),
            np.tile(shell, techniques),
            matrix,
        )


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
        ``anova`` groups functions by the axes along which they vary.
        The bands of ``anova`` are the parts of the ANOVA decomposition.
        ``wedge`` (2-D) has a band for the constant and 12 sectors of 15° for the direction of ±m.
        For Walsh and Haar functions, m are the numbers of oscillations along the axes.
        The numbers of oscillations are powers of two.
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
            wedges = _BANDS.wedges
            sector = (
                np.rint(angle / np.pi * wedges).astype(np.int64) % wedges
            )  # Sectors are centered on the axes
            of = np.where((m == 0).all(axis=1), 0, 1 + sector)
            labels = ["constant", *(f"{180 * k / wedges:g}°" for k in range(wedges))]
            meaning = "wedge: direction of m"
        case _:
            given = np.asarray(bands)
            integer = given.shape == basis.shape and given.dtype.kind in "iu"
            if not integer or given.min() < 0 or given.max() >= _BANDS.most:
                raise ParameterError(
                    Parameter("bands"),
                    f" has shape {given.shape} and type {given.dtype}; give "
                    f"{', '.join(map(repr, PARTITIONS))} or integer labels from 0 to "
                    f"{_BANDS.most - 1} of "
                    f"shape {basis.shape}.",
                )
            of, meaning = basis.pick(given).astype(np.int64), "given"
            if not np.array_equal(basis.full(of), given):
                raise ParameterError(
                    "bands must be the same for m and −m, so that band estimates are real."
                )
            labels = tuple(map(str, range(int(of.max()) + 1)))
    # On small grids, or without negative indices, some bands have no coefficients.
    # Drop the labels of empty bands at the end of the list
    return Bands(of, tuple(labels[: int(of.max()) + 1]), f"band ({meaning})")


def check_bands(bands: str | Array, basis: Basis) -> None:
    """Check the arguments of `make_bands` before any bands are made."""
    if isinstance(bands, str):
        as_choice("bands", bands, PARTITIONS)
        if bands == "wedge" and basis.dims != 2:
            raise ParameterError(
                Parameter("bands", "wedge"),
                f" is for 2 dims, not {basis.dims}; use 'radial' or 'anova'.",
            )
