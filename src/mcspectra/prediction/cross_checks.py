"""Methods that check a prediction: pairs of points, sums over frequencies, and a measurement.

Three of the methods sum over frequencies, but only up to a half width.
`energy_share` is the part of ∫f² at frequencies within the half width.
All methods give the same variance if `energy_share` is 1 (docs/spectra.md).

The pair correlation is explained in docs/theory.md, "Pair correlation".
Pairs of random and jittered points have a known density.
For other stationary sets, all pairs are counted by their difference, not by distance only.
The sum over pairs has the terms A(x_i − x_k), where A is the autocorrelation of the integrand.
A is tabulated on the torus and interpolated linearly.

If A were averaged over all directions of h, the result would be exact for isotropic sets only.
For shifted Latin hypercubes of 16 points, an average over directions gives wrong variances.
The variances of smooth integrands are then overestimated by factors of 1.7 to 3.7.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

import msgspec
import numpy as np

from mcspectra.core.analysis import MergeTree, Subject
from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z, student_t
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.ordered import weighted_sum
from mcspectra.core.records import MeanSums
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.estimators.quadrature import (
    grid,
    mesh,
    orders_of,
    square_integral,
    stratum_moments,
    values_at,
)
from mcspectra.integrands import Integrand
from mcspectra.measure._kernels import pair_sum_1d, pair_sum_2d
from mcspectra.measure.terms import Terms
from mcspectra.measure.views import Frequencies
from mcspectra.prediction.known import Cells
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import Independent, Shifted, Strata, independent_sets
from mcspectra.spectra.closed_forms import closed_form_covariance, closed_form_power
from mcspectra.spectra.transforms import FrequencyGrid

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "CheckSettings",
    "draws_power",
    "of_covariance",
    "of_homogenized",
    "of_pairs",
    "of_terms",
    "terms_for",
]

_PAIRS_AT_ONCE = 2**16
"""Number of pairs of frequencies in memory. Each array takes 1 MB of complex numbers."""
_ROUNDING = 4e-15
"""Relative rounding error of ∫g²: some units in the last place of double precision."""


@final
@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Limits of the methods that check a prediction.

    Attributes
    ----------
    most_frequencies
        Largest number of frequencies whose covariances are summed: 625 have 390,625 pairs.
        The default limits the half width to 312 in 1-D, 12 in 2-D, 4 in 3-D and 2 in 4-D.
        In 6 dims and more there would be fewer than three frequencies along each axis.
    cells
        Number of cells along each axis, by number of dims, for samples of the autocorrelation of g.
        The mean of the autocorrelation over its samples is subtracted, so that its error cancels.
        A linear interpolant of a wave of frequency k has the relative error (2πk/cells)²/8.
        For the frequency k, the relative error is 5e-6 k² in 2-D and 5e-9 k² in 1-D.
    most_points
        Largest number of points of a set whose pairs are counted.
        A set of 2^17 points has 8.6e9 pairs.
    tolerance
        Largest relative error of a variance that is computed by quadrature over pairs of points.
        The value is the default tolerance of `exact_variance`, whose results are checked here.
    """

    most_frequencies: int = 625
    cells: Mapping[int, int] = field(default_factory=lambda: {1: 2**15, 2: 2**10})
    most_points: int = 2**17
    tolerance: float = 1e-6


_SETTINGS = CheckSettings()


def terms_for(
    estimator: AbstractEstimator, n: int, half_width: int | None, realizations: int
) -> Terms:
    """Return the `variance_terms` analysis whose spectra, estimates and half width are used."""
    whole = estimator.domain_integrand is not None and not estimator.infinite_weights
    space: Any = "domain" if whole else "primary"
    return Terms(n=n, half_width=half_width, realizations=realizations, space=space)


def of_covariance(
    estimator: AbstractEstimator, sampler: Sampler, n: int, asked: Terms, _: Stream
) -> Cells:
    """Return the sum of conj(f_m) f_l C_ml over m and l, with C_ml in closed form."""
    given = _of_one_technique(estimator)
    side = int(_SETTINGS.most_frequencies ** (1.0 / estimator.domain_dims) + 1e-9)
    if side < 3:
        raise NoClosedForm(
            f"In {estimator.domain_dims} dims the pairs of frequencies are too many to sum."
        )
    m, f = _coefficients(given, min(_half_width(estimator, sampler, n, asked), (side - 1) // 2))
    total = np.zeros(f.shape[1])
    rows = max(1, _PAIRS_AT_ONCE // len(m))
    for i in range(0, len(m), rows):
        some = m[i : i + rows, None]
        c = closed_form_covariance(sampler, n, some, m[None], density=given.density)
        total += np.einsum("mc,ml,lc->c", np.conj(f[i : i + rows]), c, f).real
    return _certain("covariance", total, "C_ml in closed form", _share(estimator, f))


def of_homogenized(
    estimator: AbstractEstimator, sampler: Sampler, n: int, asked: Terms, _: Stream
) -> Cells:
    """Return the sum of |f_m|² ⟨|S_m|²⟩ over m ≠ 0, or NaN if the power has no closed form."""
    given, width = _of_one_technique(estimator), _half_width(estimator, sampler, n, asked)
    if not _homogeneous(given, sampler, n):
        raise NoClosedForm(
            "The homogenized formula holds for uniform points that are the same after any "
            f"translation, not for {given.spec} with {sampler.spec}; add shift."
        )
    FrequencyGrid(estimator.domain_dims, width)  # Raises an error if there are too many frequencies
    m, f = _coefficients(given, width)
    try:
        known = closed_form_power(sampler, n, m)
        known = np.where((m == 0).all(axis=1), 0.0, known)
        variance, how = weighted_sum(known, np.abs(f) ** 2), "power in closed form"
    except NoClosedForm:
        variance, how = np.full(f.shape[1], np.nan), "power of realizations"
    return _certain("homogenized", variance, how, _share(estimator, f))


def draws_power(estimator: AbstractEstimator, sampler: Sampler, n: int) -> bool:
    """Return whether the method ``homogenized`` needs drawn sets, which measure the power.

    Drawn sets are needed if the method applies, but the power has no closed form.
    """
    given = _of_one_technique(estimator)
    try:
        closed_form_power(sampler, n, np.ones((1, estimator.domain_dims)))
    except NoClosedForm:
        return _homogeneous(given, sampler, n)
    return False


def of_terms(
    found: xr.Dataset,
    estimator: AbstractEstimator,
    realizations: int,
    homogenized: Cells | None,
) -> dict[str, Cells]:
    """Return results from `terms_for`, by name of the method.

    ``terms`` is the sum of the three terms of the variance, and ``measured`` the sample variance.
    ``homogenized`` is the power term. It is included if the power comes from realizations.
    """
    share: Any = np.nan
    if estimator.domain_integrand is not None:
        half_width = found.sizes["half_width"] - 1
        share = _share(estimator, estimator.domain_integrand.fourier_grid(half_width))
    width = max(1, estimator.channels)

    def ends(name: str) -> Array:
        return np.asarray(found[f"{name}_ci"].to_numpy()).reshape(width, 2).T

    rows = {
        "terms": Cells.row(
            "terms",
            "{space} view, {basis}".format(**found.attrs),
            found["predicted_variance"].to_numpy(),
            *ends("predicted_variance"),
            share=share,
            channels=width,
        ),
        "measured": Cells.row(
            "measured",
            f"{realizations} realizations",
            found["measured_variance"].to_numpy(),
            *ends("measured_variance"),
            channels=width,
        ),
    }
    asked = homogenized is not None and homogenized.methods[0] == "homogenized"
    if homogenized is not None and asked and np.isnan(homogenized.variance).all():
        value = np.reshape(found["power_term"].to_numpy(), width)
        half = CONFIDENCE_Z * np.reshape(found["power_term_se"].to_numpy(), width)
        how, part = str(homogenized.hows[0]), homogenized.share[0]
        rows["homogenized"] = Cells.row(
            "homogenized", how, value, value - half, value + half, share=part, channels=width
        )
    return rows


def _of_one_technique(estimator: AbstractEstimator) -> Estimator:
    if not isinstance(estimator, Estimator):
        raise NoClosedForm(
            f"Closed forms of spectra are known for one technique, not for {estimator.spec}."
        )
    return estimator


def _homogeneous(given: Estimator, sampler: Sampler, n: int) -> bool:
    """Return whether the points are uniform and statistically the same after any translation."""
    return given.density is None and sampler.law(n).stationary


def _half_width(estimator: AbstractEstimator, sampler: Sampler, n: int, asked: Terms) -> int:
    """Return the requested half width, or the default half width of `variance_terms`."""
    if asked.half_width is not None:
        return asked.half_width
    domain = msgspec.structs.replace(asked, space="domain")
    return Frequencies.of(Subject(estimator, sampler), domain, n).basis.half_width


def _coefficients(given: Estimator, width: int) -> tuple[Array, Array]:
    """Return frequencies within a half width, (F, d), and coefficients of f, (F, channels or 1)."""
    m = grid(np.arange(-width, width + 1), given.integrand.dims)
    return m, given.integrand.fourier(m).reshape(len(m), -1)


def _share(estimator: AbstractEstimator, f: Array) -> Any:
    """Return the part of ∫f² at the frequencies of the coefficients, or NaN if ∫f² is unknown."""
    within = (np.abs(f) ** 2).reshape(-1, max(1, estimator.channels)).sum(axis=0)
    try:
        assert estimator.domain_integrand is not None
        whole, _ = square_integral(estimator.domain_integrand)
    except ParameterError:  # There are too many dims for a quadrature
        return np.nan
    return np.divide(within, whole, out=np.ones(len(whole)), where=whole > 0)


def _certain(method: str, variance: Array, how: str, share: Any) -> Cells:
    """Return the result of a method that draws no samples: its interval has length 0."""
    return Cells.row(method, how, variance, variance, variance, share=share, channels=len(variance))


def of_pairs(
    estimator: AbstractEstimator, sampler: Sampler, n: int, asked: Terms, stream: Stream
) -> Cells:
    """Return the variance from the pairs of points alone. It is infinite if ∫g² diverges.

    For random and jittered points the density of pairs is known, to a relative error of 1e-6.
    Pairs of other stationary sets in 1-D or 2-D are counted in `realizations` sets.

    Raises
    ------
    NoClosedForm
        If the set is not stationary, has over 2 dims, or is a shifted grid or lattice.
        The error is also raised if a quadrature does not converge to 1e-6.
    """
    estimator.check_independent()
    source, realizations = estimator.randomized(sampler), asked.realizations

    # Check whether the law of the pairs is known, or whether pairs can be counted
    law = source.law(n)
    jittered = isinstance(law, Strata) and law.jittered
    exact = jittered or isinstance(law, Independent)
    lattice = isinstance(law, Shifted) and law.inner.fixed
    if not exact and (source.dims > 2 or not law.stationary or lattice):
        raise NoClosedForm(
            f"The variance of {source.spec} in {source.dims} dims is not found from pairs "
            "of points: give random or jittered, or in 1-D and 2-D a stationary set other than "
            "a lattice, such as one with shift; or use another method."
        )

    variance: Any = 0.0
    square_half: Any = 0.0
    for technique, count in enumerate(estimator.counts):
        g = estimator.primary_integrand(technique)
        if exact:
            # Random points: all pairs of points are equally likely.
            # Jittered points: only pairs in different cells occur
            (square, square_error), points = square_integral(g), n * count
            sides: Any = getattr(source.law(points), "sides", (1,) * g.dims)
            squares = []  # Σ_j (∫_cell j g)²
            for order in orders_of(math.prod(sides), g.dims):
                means, _ = stratum_moments(g, sides, np.zeros(g.dims), order)
                squares.append((means**2).mean(axis=0) / len(means) / (1 if jittered else points))
            coarse, fine = squares
            diverges = np.isinf(square)
            square = np.where(diverges, 0.0, square)
            part = np.where(diverges, np.inf, square / points - fine)
            error = np.where(diverges, 0.0, square_error / points + np.abs(fine - coarse))
            # A variance that vanishes may still have a rounding error
            floor = _ROUNDING * square / points
            if not np.all(error <= np.maximum(_SETTINGS.tolerance * np.abs(part), floor)):
                raise NoClosedForm(
                    f"The quadrature over pairs of {g.spec} has an error of {np.max(error):.2g} in "
                    f"a variance of {np.max(square / points - fine):.6g}; use another method."
                )
            variance = variance + np.maximum(part, 0.0)
            continue
        one = _of_counted_pairs(source, n * count, g, stream)
        tree: MergeTree[MeanSums] = MergeTree()
        first = technique * realizations
        for realization in range(first, first + realizations):
            tree.add(one(realization))
        # Pairs do not change if the set is translated
        sets = independent_sets(source.law(n * count))
        value, se = tree.total().mean_and_error(sets)
        z = CONFIDENCE_Z if sets is None else student_t(min(sets, realizations))
        variance, square_half = variance + value, square_half + (z * se) ** 2
    half = np.broadcast_to(np.sqrt(square_half), np.shape(variance))
    how = "pairs known" if exact else f"pairs of {realizations} sets counted"
    return Cells.row(
        "pair-correlation",
        how,
        variance,
        variance - half,
        variance + half,
        channels=max(1, estimator.channels),
    )


def _of_counted_pairs(
    sampler: Sampler, n: int, g: Integrand, stream: Stream
) -> Callable[[int], MeanSums]:
    """Return a function that estimates the variance from the pairs of points of one realization.

    The estimate sums the autocorrelation A(h) of g over the differences h of all pairs of points.
    """
    if n > _SETTINGS.most_points:
        raise ParameterError(
            f"{n} points have too many pairs to count; give {_SETTINGS.most_points} at most."
        )
    # Values of A(h) at h = k/N on the torus, from cell centers: (channels or 1, N, …)
    cells = _SETTINGS.cells[g.dims]
    x = mesh(*[(np.arange(cells) + 0.5) / cells] * g.dims)
    values = np.moveaxis(values_at(g, x), -1, 0)
    axes = tuple(range(1, g.dims + 1))
    power = np.abs(np.fft.rfftn(values, axes=axes)) ** 2
    table = np.fft.irfftn(power, s=values.shape[1:], axes=axes) / x[..., 0].size
    square, _ = square_integral(g)
    if np.isinf(square).any():
        raise NoClosedForm(
            f"∫g² of {g.spec} diverges: with points that are each uniform the variance is infinite."
        )
    # Subtract the mean of the table instead of I², so that its sampling error cancels
    constant = square / n - table.reshape(len(table), -1).mean(axis=-1)
    add = pair_sum_1d if g.dims == 1 else pair_sum_2d

    def one(realization: int) -> MeanSums:
        points = sampler.draw_stream(n, stream, realization, 1)[0]
        sums = np.array([add(points, channel) for channel in table])
        return MeanSums.of(constant + 2.0 / n**2 * sums)

    return one
