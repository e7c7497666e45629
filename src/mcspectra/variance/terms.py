"""The three terms: variance of an estimator predicted and explained from spectra.

Method (DESIGN §1; the paper's generalised formulation)
-------------------------------------------------------
With f_m = ∫ f exp(−2πi m·x) dx and S_m = Σ_k w_k exp(−2πi m·x_k), the estimate truncated at the
half width K is I = Σ_{|m|≤K} conj(f_m) S_m, and with C_ml = ⟨S_m conj(S_l)⟩ − ⟨S_m⟩ conj(⟨S_l⟩)

    Var(I) = |f_0|² C_00 + Σ_{m≠0} |f_m|² C_mm + Σ_{m≠l} conj(f_m) f_l C_ml.

(The slides print ⟨S_m* S_l⟩: with one sign in both transforms that is the reflected integrand.)
No M × M matrix is stored: the contribution c_m = Re conj(f_m) Cov(S_m, I) sums to the variance, and
what is left of Σ c_m after the first two terms is the cross term. In primary space every technique
has its own integrand and points, and the sums run over (technique, m).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import InfiniteWeightVarianceWarning, warn
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.staged import compute
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.estimators.tails import unsampled_note
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.bases import Basis, make_basis
from mcspectra.variance._term_variables import term_errors, term_variables
from mcspectra.variance.bands import Bands, make_bands
from mcspectra.variance.batches import Variables
from mcspectra.variance.staged_terms import StagedTerms, TermSums
from mcspectra.variance.sums import Partition
from mcspectra.variance.views import SPACES, View, check_terms, chosen_basis, view_dims

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["staged_terms", "variance_terms"]


def variance_terms(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    half_width: int = 64,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str = "domain",
    bands: str | Array = "radial",
    cross_matrix: bool = False,
    engine: str = "auto",
    eps: float = 1e-9,
    workers: int | None = None,
) -> xr.Dataset:
    """Predict the variance of an estimator from spectra, term by term, and measure it beside.

    Parameters
    ----------
    estimator, sampler, n
        What is analysed; `n` counts each technique's points in units of its ``counts``.
    half_width
        Frequencies m run over {−half_width … half_width}^d.
    realizations
        Independent realisations, at least 2.
    rng
        Seed (SPEC 7). Realisation r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    basis
        ``"fourier"``, ``"cosine"``, ``"walsh"`` or ``"haar"`` (`mcspectra.spectra.bases`), or ``"auto"``:
        the one that fits the sampler's randomisation, which the attribute ``basis`` then names.
    space
        ``"domain"``: f with the warped, weighted points (the paper's view); ``"primary"``: g(u) with
        the sampler's own points, where discontinuities made by the warp are visible.
    bands
        ``"radial"``, ``"dyadic"``, ``"anova"``, ``"wedge"``, or an integer label ≥ 0 for every basis
        function: `mcspectra.variance.bands.make_bands`.
    cross_matrix
        Also return C_ml and conj(f_m) f_l C_ml in full, for at most `MAX_MATRIX` frequencies.
    engine, eps
        See `mcspectra.spectra.transforms`.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``dc_term``, ``power_term``, ``cross_term``, ``predicted_variance`` (their sum) with ``_ci``,
        ``measured_variance`` with ``_ci``, ``captured`` with ``_ci`` (predicted/measured, NaN where the
        measured variance is rounding noise), ``contribution`` and ``power_contribution`` on m0, m1,
        …, ``band_covariance(band, band_other)``, ``truncated_variance(half_width)`` and
        ``captured_by_half_width(half_width)``; a dim channel where f has several, a dim technique on
        maps of a primary space with several. With `cross_matrix`, ``coefficient_covariance(m, l)``
        and ``cross_matrix(m, l)``. Standard errors ``_se`` of the terms, ``contribution``,
        ``band_covariance`` and both matrices, and ``_ci`` of the terms, by batch means (from 4
        realisations on): their number is the attribute ``batches``, and 95 % is Student's t with one
        degree of freedom less.

    Raises
    ------
    ParameterError
        A value is out of range, dims disagree, or the matrix would be too large.

    Warns
    -----
    InfiniteWeightVarianceWarning
        ∫1/p diverges: the terms are infinite in the domain view and are given as NaN or infinity.

    Notes
    -----
    O(R (n + M log M)) time and O(M + bands²) memory. 95 % intervals follow from the kurtosis of the
    estimates. A truncated spectrum predicts part of the variance: see ``captured``.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> estimator = mcs.Estimator("linear", dims=1)
    >>> terms = mcs.variance_terms(estimator, "jittered", 8, realizations=200, rng=1)
    >>> bool(terms["cross_term"] < 0 < terms["power_term"])
    True
    """
    threads = available_workers(workers)
    return compute(
        staged_terms(
            estimator,
            sampler,
            n,
            half_width=half_width,
            realizations=realizations,
            rng=rng,
            basis=basis,
            space=space,
            bands=bands,
            cross_matrix=cross_matrix,
            engine=engine,
            eps=eps,
        ),
        threads,
        "variance_terms",
    )


def staged_terms(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    half_width: int = 64,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str = "domain",
    bands: str | Array = "radial",
    cross_matrix: bool = False,
    engine: str = "auto",
    eps: float = 1e-9,
) -> StagedTerms:
    """Return `variance_terms` as a staged analysis of one run, its arguments checked."""
    as_choice("space", space, SPACES)
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    realizations = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    basis = chosen_basis(basis, estimator, source, space, half_width)
    check_terms(estimator, half_width, space, cross_matrix=cross_matrix, basis=basis)
    functions = make_basis(basis, view_dims(estimator, space), half_width)
    view = View.of(estimator, n, space, functions, engine, eps)
    chosen = make_bands(bands, functions)
    partition = view.partition(chosen.of, cross_matrix)
    stream = Stream.from_rng(rng)
    infinite = space == "domain" and estimator.infinite_weights

    def result(total: TermSums) -> xr.Dataset:
        if infinite:
            warn(
                f"∫1/p diverges for {estimator.spec}: Var(S_0) and the spectral terms are infinite "
                "although the estimate's variance need not be; use space='primary'.",
                InfiniteWeightVarianceWarning,
            )
        return _labelled(
            _variables(total, view, partition, infinite=infinite),
            view,
            chosen,
            estimator=estimator.spec,
            sampler=source.spec,
            n=n,
            realizations=realizations,
            batches=total.of_blocks.count,
            basis=basis,
            space=space,
            coefficients=view.source,
            stream_key=f"{stream.key:#x}",
            seed=rng if isinstance(rng, int) else None,
            engine=view.engine,
            eps=eps,
            note=_note(estimator, n * realizations, infinite=infinite),
        )

    return StagedTerms(source, n, stream, realizations, view, partition, result)


def _variables(total: TermSums, view: View, partition: Partition, *, infinite: bool) -> Variables:
    """All result variables with a leading channel axis."""
    variables = term_variables(total.sums, total.measured, view, partition)
    variables |= term_errors(total.of_blocks, variables, view, partition)
    if not infinite:
        return variables
    return {name: (dims, _undefined(name, values)) for name, (dims, values) in variables.items()}


def _note(estimator: AbstractEstimator, samples: int, *, infinite: bool) -> str | None:
    """What to say of terms that are infinite and of a variance that these samples cannot measure."""
    parts = ["spectral terms are infinite: ∫1/p diverges"] if infinite else []
    parts += filter(None, [unsampled_note(estimator, samples)])
    return "; ".join(parts) or None


_INFINITE = ("dc_term", "power_term")
_FINITE = ("measured_variance", "measured_variance_ci", "mean", "mean_se")


def _undefined(name: str, values: Array) -> Array:
    """What remains of a variable where ∫1/p diverges: never a number that means nothing."""
    if name in _FINITE:
        return values
    return np.full_like(values, math.inf if name in _INFINITE else math.nan)


def _labelled(variables: Variables, view: View, chosen: Bands, **provenance: Any) -> xr.Dataset:
    """Make the dataset; axes of one channel or technique are dropped."""
    basis = view.basis
    scalar, single = view.estimator.channels == 0, len(view.transforms) == 1
    dropped = {name for name, gone in (("channel", scalar), ("technique", single)) if gone}
    kept: Variables = {}
    for name, (dims, values) in variables.items():
        index = tuple(0 if dim in dropped else slice(None) for dim in dims)
        kept[name] = (tuple(dim for dim in dims if dim not in dropped), values[index])
    # Labels as an attribute: arrays of strings have no place in zarr's specification yet.
    bands = {"long_name": chosen.meaning, "units": "1", "labels": ", ".join(chosen.labels)}
    numbers = np.arange(len(chosen.labels))
    coords: dict[str, Any] = {
        **basis.coords,
        "bound": ["low", "high"],
        "band": ("band", numbers, bands),
        "band_other": ("band_other", numbers, bands),
        "half_width": ("half_width", np.arange(basis.half_width + 1), {"units": "cycles per unit"}),
    }
    if "cross_matrix" in kept:
        coords |= _matrix_coords(basis, len(view.transforms))
    return dataset(kept, coords, **provenance)


def _matrix_coords(basis: Basis, techniques: int) -> dict[str, Any]:
    """Frequencies along m and l: themselves in 1-D, a running number with m_0, m_1 … beside it else."""
    if basis.dims == 1 and techniques == 1:
        return {"m": basis.axis, "l": basis.axis}
    size = basis.size * techniques
    m = basis.axis[np.indices(basis.shape).reshape(basis.dims, -1)]
    coords: dict[str, Any] = {"m": np.arange(size), "l": np.arange(size)}
    for name in ("m", "l"):
        for i in range(basis.dims):
            coords[f"{name}_{i}"] = (name, np.tile(m[i], techniques))
        if techniques > 1:
            coords[f"{name}_technique"] = (name, np.repeat(np.arange(techniques), basis.size))
    return coords
