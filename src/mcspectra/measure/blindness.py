"""Estimates that missed the source of their variance, and the sentences that report it.

Estimates without spread, estimates whose mean is off the integral, and estimates of which one makes
most of the variance give no upper bound. `blindness` finds them with the help of the known
integral, ∫g² and poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.moments import Moments, rounding_floor
from mcspectra.estimators.quadrature import closed_moments, growth, square_integral
from mcspectra.estimators.tails import unsampled_note
from mcspectra.measure.doors import NO_VARIANCE, VANISHES
from mcspectra.samplers import Random, Sampler

__all__ = ["blindness", "blindness_of", "is_fixed"]


@dataclass(frozen=True)
class BlindnessSettings:
    """Thresholds above which estimates are taken to have missed the source of their variance."""

    # Part of Σ (estimate − mean)² in one square above which the tail is not resolved. In samples of
    # 1,000 exponential numbers the largest square has 4 % (median), and 17 % once in a thousand
    # samples; normal ones have 1.2 and 2.4 %.
    large_share: float = 0.2
    # Probability that the largest square of a few normal estimates exceeds the share that is used
    # for them.
    rarely: float = 1e-3
    # κ − 1 of estimates above which ∫g² is computed to see whether the variance is infinite. It is
    # 2 for normal and 8 for exponential estimates. A smaller value costs time only, a larger one
    # leaves more poles to other tests.
    peaked: float = 9.0
    # Exponent of a pole above which ∫g⁴ diverges. The limit is ¼, and fitted slopes are right to
    # 5e-4.
    no_kurtosis: float = 0.2495
    # Standard errors between the mean and the integral that cannot be chance: a normal law has a
    # probability of 6e-7, which stays small over the many counts of a study.
    far: float = 5.0


_SETTINGS = BlindnessSettings()


def is_fixed(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Whether all estimates have the same points."""
    dealt = estimator.sets == "joint" and len(estimator.counts) > 1 and not sampler.sequence
    return estimator.randomized(sampler).fixed and not dealt


def blindness(
    estimators: Sequence[AbstractEstimator],
    samplers: Sequence[Sampler],
    counts: Array,
    realizations: int,
    measured: dict[str, Array],
) -> tuple[Array, list[str]]:
    """Estimates that missed the source of their variance, and sentences that explain it.

    Parameters
    ----------
    measured
        Arrays (estimator, sampler, n, channel) by name: ``realizations``, ``variance``, its
        ``relative_se``, the ``largest_share`` of a square in it, whether it is ``resolved``, the
        ``tail_index``, ``bias``, ``bias_se`` and the ``floor`` of rounding.

    Returns
    -------
    tuple
        Whether each variance has no finite upper end, in the shape of ``variance``; the sentences.
    """
    from scipy.special import gammainc, ndtr, stdtrit

    r = measured["realizations"]
    # More points lighten tails: a tail that is heavy at n is heavy at smaller counts, observed
    # there or not
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
        # Largest exponent of poles of any technique; black boxes are not called for it
        techniques = range(len(e.counts) if not e.is_black_box else 0)
        peaks = np.max([growth(e.primary_integrand(t)) for t in techniques], axis=0, initial=0.0)
        # n times the variance of random points, Σ_t (∫g_t² − (∫g_t)²)/counts[t]: NaN without a
        # closed form. If the variance may be infinite, a quadrature of ∫g² is tried
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

            # The first condition that holds at a count is reported, with the worst value over
            # counts
            everywhere = np.ones_like(low)
            for text, where, size in (
                ("∫g² diverges, the variance is infinite", everywhere & np.isinf(of_random), excess),
                ("none of the estimates varies{at}: what makes their variance was not met",
                 ~varies[at] & ~agrees, excess),
                ("∫g² makes the variance {worst:.3g} times the measured one{at}: what is rare was not met",
                 varies[at] & known & low, excess),
                ("the mean is {worst:+.3g} standard errors off the integral{at}: what is rare was not met",
                 far[at] & source.unbiased, pull[at]),
                ("∫g⁴ diverges, g grows as t^-{worst:.2g}: no estimates bound the variance",
                 everywhere & (peaks >= _SETTINGS.no_kurtosis), everywhere * peaks),
                ("tails not resolved{at}: a single estimate makes {worst:.3g} % of the variance",
                 heavy[at] & varies[at], 100 * of["largest_share"]),
                ("tails not resolved{at}: few estimates make the variance, tail index k̂ = {worst:.2f}",
                 unresolved[at] & varies[at] & np.isfinite(of["tail_index"]), of["tail_index"]),
                ("tails not resolved{at}: few estimates make the variance",
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
        notes["none of these variances has a finite upper bound"] = None
    return blind, [*notes, *fixed]


def blindness_of(
    estimator: AbstractEstimator, sampler: Sampler, n: int, moments: Moments
) -> tuple[Array, list[str]]:
    """`blindness` for one sampler and count, by channel; estimates without variance also have a sentence."""
    integral, error, _ = estimator.known_integral()
    bias = moments.mean - np.atleast_1d(integral)
    measured = {
        "realizations": np.full(bias.shape, moments.count),
        **{name: getattr(moments, name) for name in (
            "variance", "relative_se", "largest_share", "resolved", "tail_index",
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
    """Share of the variance in one square, above which the tail of the estimates is not resolved.

    A fifth, or more for few realizations: normal ones exceed it once in a thousand times [Grubbs
    1950].
    """
    from scipy.special import stdtrit

    r = np.maximum(realizations, 3)
    t2 = stdtrit(r - 2, _SETTINGS.rarely / (2 * r)) ** 2
    normal = (r - 1) / r * t2 / (r - 2 + t2)
    return np.where(realizations > 2, np.maximum(normal, _SETTINGS.large_share), 1.0)
