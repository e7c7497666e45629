"""Leading modes of a covariance of spectra: patterns of coefficients that vary together.

The modes are eigenvectors of Cov(y_m, y_l), with y_m = conj(f_m) S_m or y_m = S_m.
The modes are patterns over the frequencies whose amplitudes are uncorrelated.
Each eigenvalue is the variance of the amplitude of one mode.

The covariance matrix A is never stored.
Randomized subspace iteration [Halko2011]_ needs only the product of A with a few vectors.
Each product with A takes one pass over the realizations, which are drawn again every time.
If Ω is a random matrix, the columns of A Ω approximately span the leading eigenvectors.
With each further factor A, as in A² Ω, the columns approximate the eigenvectors more closely.
The results are the eigenpairs of A projected on the span of these columns (Rayleigh-Ritz).
The distance of λ to an eigenvalue of A is at most ‖A v − λ v‖.
The coordinates are the real and imaginary parts of the stored coefficients.
Real and imaginary parts are multiplied by √2 if only one of the frequencies m and −m is stored.

A is estimated from realizations. Each batch of realizations gives a variance along a mode v.
The spread over batches gives the standard error of λ, which is the variance along v.
The standard error excludes the bias that arises because v is chosen for a large λ.
Even if all true eigenvalues are equal, the bias gives eigenvalues up to `noise_edge`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

import numpy as np
from msgspec import Meta

from mcspectra.core import options
from mcspectra.core.analysis import (
    Counted,
    MergeTree,
    Need,
    Reduction,
    Steps,
    Subject,
    compute,
    compute_chunk,
)
from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.ordered import eigenpairs, orthonormal, product
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators.importance import as_subject
from mcspectra.measure.sums import BATCH_SETTINGS, spread
from mcspectra.measure.views import Frequencies, View, check_bands, make_bands

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["CovarianceProduct", "Modes", "covariance_modes"]


@dataclass(frozen=True)
class ModeSettings:
    """Settings for the computation of modes: numbers of vectors, passes and realizations."""

    # Number of columns of Ω in addition to the number of modes.
    # [Halko2011]_ proves error bounds for any number of added columns, and recommends 5 to 10.
    oversampling: int = 8
    # Largest number of elements of one set of vectors: 1 GiB in float64.
    most_numbers: int = 2**27
    # Number of realizations per coefficient below which a note warns of sampling noise.
    # The true eigenvalues of pure noise are equal. The largest eigenvalue of a sample is larger:
    # (1 + √(1/10))² = 1.73 times the mean for 10 realizations per coefficient [Marchenko1967]_.
    many: float = 10.0
    # Variance of a coordinate that counts as rounding, as a fraction of the largest variance.
    # A variance of 1e-20 times the largest is a standard deviation of 1e-10 times the largest.
    rounding: float = 1e-20


_SETTINGS = ModeSettings()
_START = 0x6D6F6465  # Stream label of the initial random vectors


@final
class Modes(Counted, frozen=True, kw_only=True):
    """Leading eigenvectors of the covariance of the Fourier coefficients."""

    function = "covariance_modes"
    verb = "variance"
    split = "modes"
    variables = (
        *("eigenvalue", "eigenvalue_se", "eigenvalue_residual", "eigenvalue_share"),
        *("mode_contribution", "mode_vector", "band_trace", "noise_edge"),
    )
    provenance = ("estimator", "sampler", "n", "realizations", "passes", "eps", "stream_key")

    n: Annotated[int, options.COUNT]
    half_width: Annotated[int, options.HALF_WIDTH] = 32
    modes: Annotated[int, Meta(ge=1, le=2**62, description="Number of modes.")] = 8
    weighted: Annotated[
        bool,
        Meta(
            description="Weight the coefficients of the points by those of the integrand: "
            "conj(f_m) S_m instead of S_m.",
            extra={
                "flag": "--points-only",
                "help": "modes of the points alone, without the coefficients of the integrand",
            },
        ),
    ] = True
    bands: Annotated[str, options.BANDS] = "radial"
    band: Annotated[
        tuple[str, ...] | str | None,
        Meta(
            description="Labels of the bands to keep; all by default.",
            extra={"python": True, "metavar": "LABEL"},
        ),
    ] = None
    channel: Annotated[int, Meta(ge=0, le=2**31, description="Channel of the integrand.")] = 0
    passes: Annotated[
        int,
        Meta(
            ge=2,
            le=100,
            description="Passes over the realizations; more passes separate close eigenvalues.",
        ),
    ] = 3
    realizations: Annotated[int, options.REALIZATIONS] = 1000
    basis: Annotated[str, options.BASIS] = "fourier"
    space: Annotated[Literal["domain", "primary"] | None, options.SPACE] = None
    engine: Annotated[str, options.ENGINE] = "auto"
    eps: Annotated[float, options.EPS] = 1e-9

    def need(self, subject: Subject) -> Need:
        """Check that the vectors fit into memory."""
        estimator = subject.estimator
        estimator.check_sampler(subject.sampler, self.n)
        as_integer("channel", self.channel, least=0, most=max(0, estimator.channels - 1))
        frequencies = Frequencies.of(subject, self)
        check_bands(self.bands, frequencies.basis)
        size, evaluations = frequencies.size, sum(estimator.counts)
        numbers = size * (self.modes + _SETTINGS.oversampling)
        if numbers > _SETTINGS.most_numbers:
            raise ParameterError(
                f"{self.modes} modes of {size} coefficients take "
                f"{8 * size * self.modes / 2**30:.3g} GiB; request fewer, or a smaller ",
                Parameter("half_width"),
                ".",
            )
        as_integer("modes", self.modes, least=1, most=max(1, size))
        each = evaluations * self.n + numbers
        return Need(
            cost=float(self.passes * self.realizations * each),
            memory=memory_of(self.n, estimator.dims, evaluations, size) + 32 * numbers,
        )

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """Yield passes over the realizations, which multiply the covariance matrix by vectors.

        After the first pass, the vectors are an orthonormal basis of the previous products.
        """
        estimator, n = subject.estimator, self.n
        frequencies = Frequencies.of(subject, self)
        if frequencies.diverge:
            raise ParameterError(
                f"∫1/p diverges for {estimator.spec}: its covariances are infinite; use ",
                Parameter("space", "primary"),
                ".",
            )

        # Find the stored coefficients whose frequencies lie in the chosen bands
        partition = make_bands(self.bands, frequencies.basis)
        inside = np.ones(frequencies.basis.stored, bool)
        if self.band is not None:
            given: Any = [self.band] if isinstance(self.band, str) else self.band
            listed = isinstance(given, list | tuple) and all(isinstance(b, str) for b in given)
            if not listed or not given:
                raise ParameterError(
                    Parameter("band"),
                    f" is {self.band!r}; give labels of bands as text, such as "
                    f"{partition.labels[-1]!r}, or None for all.",
                )
            wanted = [partition.labels.index(as_choice("band", b, partition.labels)) for b in given]
            inside = np.isin(partition.of, wanted)
            if not inside.any():
                raise ParameterError(f"The bands {given} hold no coefficient; give others.")

        view = frequencies.view(n, self)
        coordinates = _Coordinates.of(view, inside, self.channel, weighted=self.weighted)
        as_integer("modes", self.modes, least=1, most=coordinates.size)
        numbers = max(n * estimator.dims * sum(estimator.counts), 4 * coordinates.size)
        blocks = realization_blocks(
            self.realizations, numbers, multiple=2, least=BATCH_SETTINGS.least
        )
        # Number of consecutive blocks that form a batch
        group = -(-len(blocks) // BATCH_SETTINGS.least)

        def step(number: int, vectors: Array) -> Reduction[CovarianceProduct]:
            def batch(index: int) -> CovarianceProduct:
                tree: MergeTree[CovarianceProduct] = MergeTree()
                for place in range(index * group, min((index + 1) * group, len(blocks))):
                    points = estimator.draw(subject.sampler, n, stream, *blocks[place])
                    z = coordinates.real(view.coefficients(points))
                    tree.add(CovarianceProduct.of(z, vectors))
                # Combine the blocks of realizations of a batch.
                # A batch of one realization has no covariance and is skipped
                total = tree.total()
                some, least = slice(0, int(total.count > 1)), max(total.count - 1, 1)
                projected = (product(vectors.T, total.product) / least)[None][some]
                return replace(
                    total, degrees=np.array([total.count - 1.0])[some], projected=projected
                )

            return Reduction(
                kind=CovarianceProduct,
                block=batch,
                blocks=-(-len(blocks) // group),
                key=str(number),
            )

        # Find the range of A Ω, then the eigenpairs of A projected on this range
        width = min(coordinates.size, self.modes + _SETTINGS.oversampling)
        start = np.random.default_rng([stream.key, _START])
        vectors = start.standard_normal((coordinates.size, width))
        for number in range(self.passes - 1):
            (found,) = yield [step(number, vectors)]
            vectors = orthonormal(found.product)
        (found,) = yield [step(self.passes - 1, vectors)]
        values, vectors, residuals, errors = found.eigenpairs(vectors)
        diagonal = found.squares / (found.count - 1)

        # Compute the patterns of the modes over the frequencies.
        # Choose the sign of each vector so that a positive amplitude increases the estimate
        modes, basis, techniques = self.modes, view.basis, len(view.transforms)
        values, vectors = values[:modes], vectors[:, :modes]
        amplitude = product(coordinates.direction[None], vectors)[0]
        vectors = vectors * np.where(amplitude < 0, -1.0, 1.0)
        stored = coordinates.stored(vectors, techniques * basis.stored)
        place, conjugate = basis.whole()
        patterns = stored.reshape(modes, techniques, basis.stored)[..., place]
        patterns = np.where(conjugate, patterns.conj(), patterns)
        patterns = patterns.reshape(modes, techniques, *basis.shape)
        trace, size = float(diagonal.sum()), coordinates.size
        # Largest sample eigenvalue of a flat spectrum of the same trace [Marchenko1967]_.
        # For D varying coordinates and R realizations, this tends to λ (1 + √(D/(R − 1)))²
        least = _SETTINGS.rounding * diagonal.max(initial=0.0)
        varying = int(np.count_nonzero(diagonal > least))
        level = trace / varying if varying else 0.0
        edge = level * (1.0 + math.sqrt(varying / (self.realizations - 1))) ** 2
        mode = coordinate("mode", np.arange(modes), "mode, by eigenvalue")
        note = (
            f"{self.realizations} realizations of {size} coefficients: the largest eigenvalues "
            "of a sample are too large; compare noise_edge, the largest of a flat spectrum."
        )
        return dataset(
            {
                "eigenvalue": (("mode",), values),
                "eigenvalue_se": (("mode",), errors[:modes]),
                "eigenvalue_residual": (("mode",), residuals[:modes]),
                "eigenvalue_share": (("mode",), values / trace if trace else values * np.nan),
                "mode_contribution": (("mode",), values * amplitude**2),
                "mode_vector": (("mode", "technique", *basis.names), patterns),
                "band_trace": ((), trace),
                "noise_edge": ((), edge),
            },
            {"mode": mode, **basis.coords},
            drop=("technique",) if techniques == 1 else (),
            basis=basis.name,
            space=view.space,
            weighted=int(self.weighted),
            channel=self.channel if subject.estimator.channels else None,
            band=self.band if self.band is None or isinstance(self.band, str) else list(self.band),
            real_coefficients=size,
            note=None if self.realizations >= _SETTINGS.many * size else note,
            engine=view.engine,
        )

    def part(self, subject: Subject, stream: Stream, key: str) -> Reduction[Any]:
        """Return the pass over the realizations whose number is `key`.

        Earlier passes are repeated, because each pass starts from the vectors of the pass before.
        """
        steps = self.reduction(subject, stream)
        states = None
        while True:
            (found,) = next(steps) if states is None else steps.send(states)
            if found.key == key:
                return found
            states = [compute_chunk(found, (0, found.blocks))]


def covariance_modes(
    estimator: Any,
    sampler: Any,
    n: int,
    *,
    dims: int | None = None,
    half_width: int = 32,
    modes: int = 8,
    weighted: bool = True,
    bands: str | Array = "radial",
    band: str | Sequence[str] | None = None,
    channel: int = 0,
    passes: int = 3,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str | None = None,
    engine: str = "auto",
    eps: float = 1e-9,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Find the leading eigenvectors of the covariance of the coefficients, without the matrix.

    Parameters
    ----------
    estimator, sampler, n
        Same as in `variance_terms`.
    dims, half_width, realizations, rng, basis, space, engine, eps, workers
        Same as in `variance_terms`.
    modes
        Number of modes, at most the number of coefficients.
    weighted
        If true, find modes of conj(f_m) S_m, whose covariances sum to the variance.
        If false, find modes of S_m, which describe only the points.
    bands, band
        Labels of the bands to include. The default None means all bands.
        The labels are from the partition `bands` (`mcspectra.measure.views.make_bands`).
    channel
        Index of the channel of the integrand.
    passes
        Number of passes over the realizations, at least 2. More passes separate close eigenvalues.
    max_evaluations
        Maximum number of evaluations of the integrand.
        If an analysis needs more evaluations, an error is raised, usually before the start.

    Returns
    -------
    xarray.Dataset
        ``eigenvalue(mode)`` are the eigenvalues of the sample covariance, in descending order.
        ``eigenvalue_se(mode)`` is the batch-means error of the variance along the mode.

        ``noise_edge`` is the largest expected sample eigenvalue if all true eigenvalues are equal.
        Sample eigenvalues differ unless realizations are far more numerous than coefficients.

        ``eigenvalue_residual(mode)`` is a bound of the numerical error of an eigenvalue.
        The distance to an eigenvalue of the sample covariance is at most this bound.
        ``eigenvalue_share(mode)`` is the share of the trace.
        ``mode_contribution(mode)`` is the mode's own part of the variance of an estimate.
        The estimate contains only the frequencies of the chosen bands.
        ``mode_vector(mode, m0, …)`` has norm 1 over all frequencies.
        ``band_trace`` is the sum of all eigenvalues.

    Raises
    ------
    ParameterError
        If a value is out of range, a label is unknown, the vectors are too large, or ∫1/p diverges.

    Notes
    -----
    R realizations of n points with M frequencies take O(passes · R (n + M log M + M modes)) time.
    Each thread takes O(M modes) memory.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.Estimator("linear", dims=1)
    >>> found = mcs.covariance_modes(f, "jittered", 8, half_width=8, modes=2, realizations=100)
    >>> bool(found["eigenvalue"][0] > found["eigenvalue"][1] > 0)
    True
    """
    subject = as_subject(estimator, sampler, dims=dims)
    return compute(Modes.of(locals()), subject, rng, workers)


@dataclass(frozen=True)
class _Coordinates:
    """Coordinates z of the vector of coefficients y_m in a band, in a real orthonormal basis."""

    # Positions of the band's coefficients in the array of all stored coefficients, (P,)
    place: Array
    # Factor y_m/S_m of each coefficient, (P,): `scale`, times conj(f_m) for weighted coefficients
    factor: Array
    scale: Array  # Factor √2 for a coefficient that also stands for −m, else 1: (P,)
    # Indices of the coefficients with an imaginary part, (Q,).
    # In a complex basis, all coefficients except those of the frequency 0 have an imaginary part
    complex: Array
    direction: Array  # Vector whose scalar product with z is the band's part of the estimate: (D,)

    @staticmethod
    def of(view: View, inside: Array, channel: int, *, weighted: bool) -> _Coordinates:
        techniques = len(view.transforms)
        place = np.flatnonzero(np.tile(inside, techniques))
        f = view.integrand_coefficients[channel].reshape(-1)[place]
        scale = np.sqrt(np.tile(view.basis.double, techniques)[place])
        towards = scale if weighted else scale * f
        double = np.iscomplexobj(f) & (place % view.basis.stored != view.basis.dc)
        both = np.flatnonzero(double)
        factor = scale * f.conj() if weighted else scale
        direction = np.concatenate([towards.real, towards.imag[both]])
        return _Coordinates(place, factor, scale, both, direction)

    @property
    def size(self) -> int:
        """D."""
        return len(self.direction)

    def real(self, s: Array) -> Array:
        """Return coordinates z, float64 (R, D), of spectra (R, T·H)."""
        y = s[:, self.place] * self.factor
        return np.concatenate([y.real, y.imag[:, self.complex]], axis=1)

    def stored(self, vectors: Array, size: int) -> Array:
        """Convert k vectors of coordinates, (D, k), to arrays of all stored coefficients.

        The result has the shape (k, size), with 0 outside the band.
        """
        half = len(self.place)
        y: Array = vectors[:half].T
        if self.size > half:
            y = y.astype(np.complex128)
            y[:, self.complex] += 1j * vectors[half:].T
        out = np.zeros((vectors.shape[1], size), y.dtype)
        out[:, self.place] = y / self.scale
        return out


@dataclass(frozen=True)
class CovarianceProduct:
    """Σ (z − z̄)(z − z̄)ᵀ V over realizations. The method `merge` adds more realizations."""

    # `count` is the number of realizations, `mean` is z̄ (D,), and `along` is Vᵀ z̄ (k,)
    count: int
    mean: Array
    along: Array
    product: Array  # Σ (z − z̄)(z − z̄)ᵀ V over realizations, (D, k)
    squares: Array  # the sum of squares Σ (z − z̄)², (D,)
    # Degrees of freedom of the batches, (B,), and matrices Vᵀ A_b V of the batches, (B, k, k)
    degrees: Array
    projected: Array

    @staticmethod
    def of(z: Array, vectors: Array) -> CovarianceProduct:
        """Return sums over realizations z, (R, D), without batches."""
        mean, width = z.mean(axis=0), vectors.shape[1]
        deviation = z - mean
        total = product(deviation.T, product(deviation, vectors))
        squares = (deviation**2).sum(axis=0)
        along, none = product(mean[None], vectors)[0], (np.zeros(0), np.zeros((0, width, width)))
        return CovarianceProduct(len(z), mean, along, total, squares, *none)

    def merge(self, other: CovarianceProduct) -> CovarianceProduct:
        """Return the sums over all realizations of two objects, about the mean of all."""
        count = self.count + other.count
        delta, along = other.mean - self.mean, other.along - self.along
        factor, part = self.count * other.count / count, other.count / count
        return CovarianceProduct(
            count,
            self.mean + delta * part,
            self.along + along * part,
            self.product + other.product + factor * np.outer(delta, along),
            self.squares + other.squares + factor * delta**2,
            np.concatenate([self.degrees, other.degrees]),
            np.concatenate([self.projected, other.projected]),
        )

    def eigenpairs(self, vectors: Array) -> tuple[Array, Array, Array, Array]:
        """Return eigenpairs of the unbiased covariance A in the range of vectors (D, k).

        The results are the eigenvalues in descending order, and the eigenvectors (D, k).
        Further results are the residuals ‖A v − λ v‖ and standard errors.
        """
        image = self.product / (self.count - 1)
        values, rotation = eigenpairs(product(vectors.T, image))
        found = product(vectors, rotation)
        # The batches give a standard error of the variance along each eigenvector
        errors = np.full(len(values), np.nan)
        if len(self.degrees):
            along = np.einsum("ik,bij,jk->bk", rotation, self.projected, rotation)
            share = self.degrees / self.degrees.sum()
            errors = spread(along - product(share[None], along), share)
        residuals = np.linalg.norm(product(image, rotation) - found * values, axis=0)
        return np.maximum(values, 0.0), found, residuals, errors
