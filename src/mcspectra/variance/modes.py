"""Leading modes of a covariance of spectra: which patterns of coefficients vary together.

The matrix of Cov(y_m, y_l), y_m = conj(f_m) S_m or S_m itself, is Hermitian; its eigenvectors are the
patterns over the frequencies whose amplitudes are uncorrelated, its eigenvalues their variances, and
their sum is the power and dc terms. A flat spectrum of eigenvalues is noise without structure;
few large ones say that the sampler has few ways to be wrong.

The matrix is never formed. A randomised range finder [Halko2011]_ needs its product with a few vectors,
a sum over realisations, and since these can be drawn again, every product is a pass over them:
one that finds the range, one that projects on it (Rayleigh-Ritz), more for close eigenvalues. A real
estimate makes coefficients of m and −m conjugates: all is done in the real and imaginary parts of
those stored, times √2, which is a unitary change of coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import (
    MAX_REALIZATIONS,
    Block,
    available_workers,
    map_in_order,
    realization_blocks,
)
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.samplers import as_sampler
from mcspectra.spectra.bases import Basis, make_basis
from mcspectra.variance._coordinates import Coordinates
from mcspectra.variance.bands import make_bands
from mcspectra.variance.subspace import (
    BATCHES,
    CovarianceProduct,
    Eigenpairs,
    flat_edge,
    leading_eigenpairs,
)
from mcspectra.variance.views import SPACES, View, check_terms, chosen_basis, view_dims

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["covariance_modes"]

_OVERSAMPLING = 8  # vectors more than modes: the error falls with their number [Halko2011]
_MAX_NUMBERS = 2**27  # of one set of vectors: 1 GiB
_START = 0x6D6F6465  # stream label of the first vectors


def covariance_modes(
    estimator: Any,
    sampler: Any,
    n: int,
    *,
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
    space: str = "domain",
    engine: str = "auto",
    eps: float = 1e-9,
    workers: int | None = None,
) -> xr.Dataset:
    """Find the leading eigenvectors of the covariance of the coefficients, without the matrix.

    Parameters
    ----------
    estimator, sampler, n
        What is analysed, as in `variance_terms`.
    half_width, realizations, rng, basis, space, engine, eps, workers
        As in `variance_terms`.
    modes
        How many, at most as many as coefficients.
    weighted
        Of conj(f_m) S_m, whose covariances sum to the variance; False: of S_m, the points' own.
    bands, band
        Restrict to the functions of a band or several: their labels in the partition `bands`
        (`mcspectra.variance.bands.make_bands`); None: all.
    channel
        Which channel of the integrand.
    passes
        Passes over the realisations, at least 2; each one more makes small gaps between
        eigenvalues larger.

    Returns
    -------
    xarray.Dataset
        ``eigenvalue(mode)``, descending, of the sample covariance; ``eigenvalue_se(mode)``, its error as
        the variance along the mode, by batch means; ``noise_edge``, the largest eigenvalue to expect if
        all were equal: sampling alone makes flat spectra steep unless there are many more realisations
        than coefficients; ``eigenvalue_residual(mode)``, numerical: a bound of the distance to an
        eigenvalue of the sample covariance; ``eigenvalue_share(mode)`` of the trace;
        ``mode_contribution(mode)``, what the mode alone gives to the variance of the band-limited
        estimate; ``mode_vector(mode, m0, …)``, of norm 1 over all frequencies; ``band_trace``, the sum of
        all eigenvalues.

    Raises
    ------
    ParameterError
        A value is out of range, a label unknown, the vectors would be too large, or ∫1/p diverges.

    Notes
    -----
    O(passes · R (n + M log M + M modes)) time and O(M modes) memory for each thread.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.Estimator("linear", dims=1)
    >>> found = mcs.covariance_modes(f, "jittered", 8, half_width=8, modes=2, realizations=100)
    >>> bool(found["eigenvalue"][0] > found["eigenvalue"][1] > 0)
    True
    """
    as_choice("space", space, SPACES)
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    basis = chosen_basis(basis, estimator, source, space, half_width)
    realizations = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    passes = as_integer("passes", passes, least=2, most=100)
    _check_modes(estimator, half_width, space, basis, modes)
    channel = as_integer("channel", channel, least=0, most=max(0, estimator.channels - 1))
    functions = make_basis(basis, view_dims(estimator, space), half_width)
    inside = _inside(bands, band, functions)
    view = View.of(estimator, n, space, functions, engine, eps)
    coordinates = Coordinates.of(view, inside, channel, weighted=weighted)
    modes = as_integer("modes", modes, least=1, most=coordinates.size)
    stream = Stream.from_rng(rng)
    width = min(coordinates.size, modes + _OVERSAMPLING)
    start = np.random.default_rng([stream.key, _START]).standard_normal((coordinates.size, width))

    def product(vectors: Array) -> CovarianceProduct:
        def block(own: Block) -> CovarianceProduct:
            s = view.coefficients(estimator.draw(source, n, stream, *own))
            return CovarianceProduct.of(coordinates.real(s), vectors)

        numbers = max(n * estimator.dims * sum(estimator.counts), 4 * coordinates.size)
        blocks = list(realization_blocks(realizations, numbers, multiple=2, least=BATCHES))
        parts = map_in_order(block, blocks, available_workers(workers))
        return CovarianceProduct.merged(iter(parts), vectors, -(-len(blocks) // BATCHES))

    pairs = leading_eigenpairs(product, start, passes)
    return _labelled(
        pairs,
        coordinates,
        view,
        modes,
        flat_edge(pairs.diagonal, realizations),
        estimator=estimator.spec,
        sampler=source.spec,
        n=n,
        realizations=realizations,
        basis=basis,
        space=space,
        weighted=int(weighted),
        channel=channel if estimator.channels else None,
        band=band if band is None or isinstance(band, str) else list(band),
        passes=passes,
        real_coefficients=coordinates.size,
        note=_note(coordinates.size, realizations),
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
        engine=view.engine,
        eps=eps,
    )


def _check_modes(
    estimator: AbstractEstimator, half_width: int, space: str, basis: str, modes: int
) -> None:
    """Refuse what memory or mathematics does not allow, before any work."""
    size = check_terms(estimator, half_width, space, cross_matrix=False, basis=basis)
    modes = as_integer("modes", modes, least=1)
    if size * (modes + _OVERSAMPLING) > _MAX_NUMBERS:
        raise ParameterError(
            f"{modes} modes of {size} coefficients take {8 * size * modes / 2**30:.3g} GiB; ask for "
            "fewer, or for a smaller half_width."
        )
    if space == "domain" and estimator.infinite_weights:
        raise ParameterError(
            f"∫1/p diverges for {estimator.spec}: its covariances are infinite; use space='primary'."
        )


_MANY = 10.0  # realisations per coefficient from which on sampling changes eigenvalues by < 75 %


def _note(size: int, realizations: int) -> str | None:
    """Caution where sampling noise shapes the spectrum of eigenvalues."""
    if realizations >= _MANY * size:
        return None
    return (
        f"{realizations} realisations of {size} coefficients: eigenvalues are those of the sample, "
        "the largest too large; compare noise_edge, which a flat spectrum would reach."
    )


def _inside(bands: str | Array, band: str | Sequence[str] | None, basis: Basis) -> Array:
    """Which stored coefficients belong to the bands of these labels: bool (H,)."""
    partition = make_bands(bands, basis)
    if band is None:
        return np.ones(basis.stored, bool)
    given = [band] if isinstance(band, str) else band
    if (
        not isinstance(given, list | tuple)
        or not all(isinstance(b, str) for b in given)
        or not given
    ):
        raise ParameterError(
            f"band is {band!r}; give labels of bands as text, such as {partition.labels[-1]!r}, or None "
            "for all."
        )
    wanted = [partition.labels.index(as_choice("band", b, partition.labels)) for b in given]
    inside = np.isin(partition.of, wanted)
    if not inside.any():
        raise ParameterError(f"The bands {given} hold no coefficient; give others.")
    return inside


def _labelled(
    pairs: Eigenpairs,
    coordinates: Coordinates,
    view: View,
    modes: int,
    edge: float,
    **provenance: Any,
) -> xr.Dataset:
    """Make the dataset; each vector's sign is such that the mode adds to the estimate."""
    values, vectors = pairs.values[:modes], pairs.vectors[:, :modes]
    amplitude = coordinates.direction @ vectors
    vectors = vectors * np.where(amplitude < 0, -1.0, 1.0)
    techniques, basis = len(view.transforms), view.basis
    stored = coordinates.stored(vectors, techniques * basis.stored)
    place, conjugate = basis.whole()
    patterns = stored.reshape(modes, techniques, basis.stored)[..., place]
    patterns = np.where(conjugate, patterns.conj(), patterns)
    patterns = patterns.reshape(modes, techniques, *basis.shape)
    maps: tuple[str, ...] = ("mode", "technique", *basis.names)
    if techniques == 1:
        patterns, maps = patterns[:, 0], ("mode", *basis.names)
    variables: dict[str, tuple[tuple[str, ...], Any]] = {
        "eigenvalue": (("mode",), values),
        "eigenvalue_se": (("mode",), pairs.errors[:modes]),
        "eigenvalue_residual": (("mode",), pairs.residuals[:modes]),
        "eigenvalue_share": (("mode",), values / pairs.trace if pairs.trace else values * np.nan),
        "mode_contribution": (("mode",), values * amplitude**2),
        "mode_vector": (maps, patterns),
        "band_trace": ((), pairs.trace),
        "noise_edge": ((), edge),
    }
    number = ("mode", np.arange(modes), {"long_name": "mode, by eigenvalue", "units": "1"})
    return dataset(variables, {"mode": number, **basis.coords}, **provenance)
