"""Where estimates missed what makes their variance, and what is said of it.

Estimates that show no spread, whose mean is off the integral, or of which one makes the variance bound
nothing from above: `blindness` finds them by what is known of the integrand besides them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

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

_LARGE_SHARE = 0.2  # of Σ (estimate − mean)², in one square: the tail is not resolved
_RARELY = 1e-3  # normal estimates have a larger square this often; of few, one is always large
_PEAKED = 9.0  # κ − 1 of estimates whose variance may be infinite: it is worth a quadrature
_NO_KURTOSIS = 0.2495  # exponent of poles whose ∫g⁴ diverges, less what slopes are off by
_FAR = 5.0  # standard errors from the integral that are no chance


def is_fixed(estimator: AbstractEstimator, sampler: Sampler) -> bool:
    """Whether all estimates are of the same points."""
    dealt = estimator.sets == "joint" and len(estimator.counts) > 1 and not sampler.sequence
    return estimator.randomized(sampler).fixed and not dealt


def blindness(
    estimators: Sequence[AbstractEstimator],
    samplers: Sequence[Sampler],
    counts: Array,
    realizations: int,
    measured: dict[str, Array],
) -> tuple[Array, list[str]]:
    """Where estimates missed what makes their variance, and sentences that say why.

    Parameters
    ----------
    measured
        By name, each (estimator, sampler, n, channel): ``realizations``, ``variance``, its
        ``relative_se``, the ``largest_share`` of a square in it, whether it is ``resolved`` and the
        ``tail_index``, ``bias``, ``bias_se`` and the ``floor`` of rounding.

    Returns
    -------
    tuple
        Which variances have no finite upper end, in the shape of ``variance``; the sentences.
    """
    from scipy.special import gammainc, ndtr, stdtrit

    r = measured["realizations"]
    # More points lighten tails: those that are heavy at n are so at smaller counts, seen there or not
    heavy, unresolved = (
        np.logical_or.accumulate(found[:, :, ::-1], axis=2)[:, :, ::-1]
        for found in (measured["largest_share"] > _large_share(r), ~measured["resolved"])
    )
    suspect = heavy | unresolved | (r * measured["relative_se"] ** 2 > _PEAKED)
    with np.errstate(divide="ignore", invalid="ignore"):
        pull = measured["bias"] / measured["bias_se"]
    noise = 4 * np.sqrt(measured["floor"])
    missed = np.abs(measured["bias"]) > noise + _FAR * measured["bias_se"]
    rare = float(ndtr(-_FAR))
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
        # n times the variance of random points, Σ_t (∫g_t² − (∫g_t)²)/counts[t]: NaN where no closed form is
        # known; where it may be infinite, which a quadrature tells, that is tried
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

            # A count has the first of these that holds, and the sentence its worst value
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
                 everywhere & (peaks >= _NO_KURTOSIS), everywhere * peaks),
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
    """The same of one sampler and count: of each channel, and the sentences; a constant has one, too."""
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

    A fifth; of few realisations more, which normal ones exceed once in a thousand times [Grubbs 1950].
    """
    from scipy.special import stdtrit

    r = np.maximum(realizations, 3)
    t2 = stdtrit(r - 2, _RARELY / (2 * r)) ** 2
    normal = (r - 1) / r * t2 / (r - 2 + t2)
    return np.where(realizations > 2, np.maximum(normal, _LARGE_SHARE), 1.0)
