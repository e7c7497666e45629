"""Detect estimates that may have missed most of the variance, and explain each in a sentence.

Estimates give no upper bound of the variance in three cases.
All estimates may be equal, or their mean may differ from the integral.
A single estimate may cause most of the variance.
The function `blindness` compares estimates with the known integral and with ∫g².
It also searches for poles of the integrand.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.errors import McspectraError
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.quadrature import closed_moments, growth, square_integral
from mcspectra.estimators.tails import unsampled_note
from mcspectra.samplers import Random, Sampler

__all__ = ["NO_VARIANCE", "VANISHES", "blindness", "blindness_of", "is_fixed"]

NO_VARIANCE = "has no variance: add owen or shift, or compare |bias|"
"""Message for a sampler that always draws the same set. It follows the name of the sampler."""

VANISHES = "the variance vanishes to rounding"
"""Message if all estimates are equal to the integral."""


@dataclass(frozen=True)
class BlindnessSettings:
    """Thresholds that detect estimates which may have missed most of the variance."""

    # Largest share of one estimate in Σ (estimate − mean)².
    # If one estimate has more than 20 % of Σ (estimate − mean)², the tail is not resolved.
    # In a sample of 1,000 exponential numbers, the median of the largest share is 4 %.
    # In one of a thousand samples of exponential numbers, the largest share exceeds 17 %.
    # In a sample of 1,000 normal numbers, the median of the largest share is 1.2 %.
    # In one of a thousand samples of normal numbers, the largest share exceeds 2.4 %.
    large_share: float = 0.2
    # For few estimates, the limit of the largest share is raised above 20 %.
    # Probability that the largest share of normal estimates exceeds the raised limit.
    rarely: float = 1e-3
    # Value of κ − 1 above which ∫g² is computed, to test whether the variance is infinite.
    # κ is the kurtosis of the estimates. κ − 1 is 2 for normal and 8 for exponential estimates.
    # A smaller value only costs time. With a larger value, other tests must detect more poles.
    peaked: float = 9.0
    # Exponent of a pole above which ∫g⁴ diverges.
    # In theory, ∫g⁴ diverges at the exponent ¼. The limit is lower by 5e-4, the error of a fit.
    no_kurtosis: float = 0.2495
    # Distance of the mean from the integral, in standard errors, that cannot be due to chance.
    # The mean of normal estimates is more than 5 standard errors away with probability 6e-7.
    # False alarms are therefore rare even if a study has many counts.
    far: float = 5.0


_SETTINGS = BlindnessSettings()


def is_fixed(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Return whether all estimates use the same points."""
    dealt = estimator.sets == "joint" and len(estimator.counts) > 1 and not sampler.sequence
    return estimator.randomized(sampler).fixed and not dealt


def blindness(
    estimators: Sequence[AbstractEstimator],
    samplers: Sequence[Sampler],
    counts: Array,
    realizations: int,
    measured: dict[str, Array],
) -> tuple[Array, list[str]]:
    """Find variances whose source the estimates missed, and explain each in a sentence.

    Parameters
    ----------
    measured
        Arrays (estimator, sampler, n, channel) by name.
        ``variance`` has the relative error ``relative_se``, and ``bias`` the error ``bias_se``.
        ``tail_index`` is the tail index, and ``realizations`` the number of realizations.
        ``largest_share`` is the largest share of one square in the variance.
        ``resolved`` states whether the variance is resolved.
        ``exponent`` is the exponent with which a user's function grows toward a face of the cube.
        ``floor`` is the rounding error of the variance.

    Returns
    -------
    tuple
        Whether each variance has no upper bound, in the shape of ``variance``.
        A list of sentences gives the reasons.
    """
    from scipy.special import gammainc, ndtr, stdtrit

    r = measured["realizations"]
    # Tails get lighter with more points.
    # A tail that is heavy at n is also heavy at smaller n, even if estimates do not show it
    heavy, unresolved = (
        np.logical_or.accumulate(found[:, :, ::-1], axis=2)[:, :, ::-1]
        for found in (measured["largest_share"] > _large_share(r), ~measured["resolved"])
    )
    suspect = heavy | unresolved | (r * measured["relative_se"] ** 2 > _SETTINGS.peaked)
    with np.errstate(divide="ignore", invalid="ignore"):
        pull = measured["bias"] / measured["bias_se"]
    noise = 4 * np.sqrt(measured["floor"])
    missed = np.abs(measured["bias"]) > noise + _SETTINGS.far * measured["bias_se"]
    rare = float(ndtr(-_SETTINGS.far))
    far = missed & (np.abs(pull) > -stdtrit(r - 1, rare))
    varies = measured["variance"] > measured["floor"]

    blind, notes, fixed = np.zeros(varies.shape, bool), dict[str, None](), dict[str, None]()
    for i, e in enumerate(estimators):
        unsampled = unsampled_note(e, int(counts[-1]) * realizations)
        if unsampled is not None:
            notes[f"{e.spec}: {unsampled}"] = None
        # Find the largest exponent of poles of any technique, without calling user functions.
        # The exponent of a user's function comes from its values at points
        techniques = range(len(e.counts) if not e.is_black_box else 0)
        peaks = np.max([growth(e.primary_integrand(t)) for t in techniques], axis=0, initial=0.0)
        seen = measured["exponent"][i].max(axis=(0, 1))
        # n times the variance of random points, Σ_t (∫g_t² − (∫g_t)²)/counts[t].
        # The value is NaN without a closed form.
        # If the variance may be infinite, ∫g² is computed by quadrature
        doubtful, of_random = bool((suspect & varies)[i].any()), np.zeros(max(1, e.channels))
        for t, count in enumerate(e.counts):
            g, unknown = e.primary_integrand(t), np.full(of_random.shape, np.nan)
            mean, square = closed_moments(g) or (unknown, unknown)
            if square is unknown:
                if not (doubtful or g.dims == 1) or g.dims > 2 or g.is_black_box:
                    of_random = unknown
                    break
                with suppress(McspectraError):
                    square = square_integral(g)[0]
                    mean = np.where(np.isinf(square), 0.0, np.atleast_1d(g.integral))
            of_random += (square - mean**2) / count
        for j, sampler in enumerate(samplers):
            source, at = e.randomized(sampler), (i, j)
            if is_fixed(e, sampler):
                fixed[f"{sampler.spec} {NO_VARIANCE}"] = None
                continue
            of = {name: values[at] for name, values in measured.items()}
            known = isinstance(source, Random) & np.isfinite(of_random) & (of_random > 0)
            true = np.where(known, of_random, 1.0) / counts[:, None]
            half = of["relative_se"] ** -2.0
            low = gammainc(half, half * of["variance"] / true) < rare
            agrees = ~missed[at] & (varies[at].any(axis=0) | (e.integral_source == "exact"))
            excess = true / np.where(varies[at], of["variance"], np.nan)

            # For each count, report the first of the listed problems that occurs.
            # If the same problem occurs at several counts, report its worst value
            everywhere = np.ones_like(low)
            for text, where, size in (
                ("∫g² diverges: infinite variance", everywhere & np.isinf(of_random), excess),
                ("all estimates are equal{at}: the samples missed the source of the variance",
                 ~varies[at] & missed[at] & ~agrees, excess),
                ("all estimates are equal{at}: the variance is 0, or the samples missed its source",
                 ~varies[at] & ~agrees, excess),
                (("by ∫g² the variance is {worst:.3g} times the measured one{at}: samples missed "
                 "a rare region"),
                 varies[at] & known & low, excess),
                (("the mean is {worst:+.3g} standard errors from the integral{at}: samples missed "
                 "a rare region"),
                 far[at] & source.unbiased, pull[at]),
                (("∫g⁴ diverges because g grows as t^-{worst:.2g}: estimates give no upper bound "
                 "of the variance"),
                 everywhere & (peaks >= _SETTINGS.no_kurtosis), everywhere * peaks),
                (("g grows about as t^-{worst:.2g} with the distance t to a face of the cube: "
                 "estimates give no upper bound of the variance"),
                 everywhere & (seen >= _SETTINGS.no_kurtosis), everywhere * seen),
                ("tails not resolved{at}: a single estimate causes {worst:.3g} % of the variance",
                 heavy[at] & varies[at], 100 * of["largest_share"]),
                (("tails not resolved{at}: few estimates cause the variance, tail index k̂ = "
                 "{worst:.2f}"),
                 unresolved[at] & varies[at] & np.isfinite(of["tail_index"]), of["tail_index"]),
                ("tails not resolved{at}: few estimates cause the variance",
                 unresolved[at] & varies[at], excess),
            ):  # fmt: skip
                new = where & ~blind[at]
                blind[at] |= new
                if new.any():
                    place = f" at n = {', '.join(map(str, counts[new.any(axis=1)]))}"
                    said = text.format(at=place, worst=max(size[new].tolist(), key=abs))
                    notes[f"{e.spec} with {sampler.spec}: {said}"] = None
            blind[at] |= unsampled is not None
    if blind.any():
        notes["these variances have no finite upper bound"] = None
    return blind, [*notes, *fixed]


def blindness_of(
    estimator: AbstractEstimator, sampler: Sampler, n: int, moments: Moments
) -> tuple[Array, list[str]]:
    """Apply `blindness` to each channel for one sampler and one n.

    If no other reason is found and the variance is 0 up to rounding, a sentence reports this.
    """
    integral, error, _ = estimator.known_integral()
    bias = moments.mean - np.atleast_1d(integral)
    measured = {
        "realizations": np.full(bias.shape, moments.count),
        **{name: getattr(moments, name) for name in (
            "variance", "relative_se", "largest_share", "resolved", "tail_index", "exponent",
        )},
        "bias": bias,
        "bias_se": np.hypot(moments.mean_se, error),
        "floor": rounding_floor(np.fmax(np.abs(moments.mean), np.abs(integral))),
    }  # fmt: skip
    cell = {name: np.asarray(values)[None, None, None] for name, values in measured.items()}
    blind, notes = blindness([estimator], [sampler], np.array([n]), moments.count, cell)
    if not notes and (moments.variance <= measured["floor"]).all():
        notes = [f"{estimator.spec} with {sampler.spec}: {VANISHES}"]
    return blind[0, 0, 0], notes


def _large_share(realizations: Array) -> Array:
    """Return the limit for the largest share of one estimate in Σ (estimate − mean)².

    If the largest share exceeds the limit, the tail of the estimates counts as unresolved.
    The limit is a fifth, or more for few realizations.
    Normal estimates exceed the limit with probability 0.001 [Grubbs 1950].
    """
    from scipy.special import stdtrit

    r = np.maximum(realizations, 3)
    t2 = stdtrit(r - 2, _SETTINGS.rarely / (2 * r)) ** 2
    normal = (r - 1) / r * t2 / (r - 2 + t2)
    return np.where(realizations > 2, np.maximum(normal, _SETTINGS.large_share), 1.0)
