"""ANOVA of a variance in many dims: contributions of single axes and sets of axes to the noise.

docs/theory.md, "Analysis by axes", derives both methods of this module.
`anova_variances` uses pick-freeze estimates [Sobol2001]_ with whole point sets.
For the empty set of axes, the true covariance is 0.
The covariance that is estimated for the empty set is subtracted from those for all other sets.
Nearly equal errors cancel in the difference. Shares near 1 are therefore precise.

`anova_spectrum` draws frequencies with the probability q(m) = Π_{i∈u} q_1(m_i).
Here q_1(k) is proportional to 1/k² up to K.
The |f_m|² of a function with jumps or a boundary term falls like 1/m_i² along each axis.
Therefore the terms |f_m|² ⟨|S_m|²⟩ / q(m) are bounded.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Analysis, Counted, Need, Reduction, Subject, compute
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.confidence import rounding_floor, student_t
from mcspectra.core.errors import Function, NoClosedForm, Parameter, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNT, REALIZATIONS
from mcspectra.core.ordered import weighted_sum
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.records import JOIN, Join
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import Estimator
from mcspectra.estimators.importance import as_subject
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.tails import tail_note
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.closed_forms import closed_form_power
from mcspectra.spectra.listed import power_at

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["EFFECTIVE_SHARE", "Anova", "AnovaSpectrum", "anova_spectrum", "anova_variances"]

EFFECTIVE_SHARE = 0.99
"""Share of the variance that defines effective dimensions [Caflisch1997]_."""


@dataclass(frozen=True)
class AnovaSettings:
    """Limits of memory, and numbers of realizations and batches for standard errors."""

    # Largest number of axes, or groups of axes.
    # 64 axes have 2,016 pairs, each with an estimate for every realization.
    most_dims: int = 64
    # Largest number of stored estimates, over all subsets and realizations: 0.5 GiB in float64.
    most_values: int = 2**26
    # Largest total number of frequencies. In 1-D the frequencies take 0.6 GiB in all.
    # In 1-D, each frequency m is stored with the probability with which m is drawn.
    # The power spectrum of the points at m, and |f_m|² of the integrand, are also stored.
    most_frequencies: int = 2**24
    # Least number of realizations that give a standard error.
    # With two realizations, all products of deviations are equal, so the standard error would be 0.
    # `variance_terms` also needs four realizations.
    least: int = 4
    # Number of independent batches of frequencies, whose spread gives the standard error.
    # With 16 batches, intervals are 9 % wider than with infinitely many (Student's t).
    # With twice as many batches, intervals would be 4 % narrower.
    # With half as many batches, intervals would be 11 % wider.
    batches: int = 16


_SETTINGS = AnovaSettings()

_Group = Annotated[int, Meta(ge=0, lt=_SETTINGS.most_dims)]
_PARTNER, _ORDER, _UNIFORM = 0x616E6F, 0x616E70, 0x616E71  # Stream labels


@final
class Anova(Counted, frozen=True, kw_only=True):
    """Variance by axis of primary space, and by pair of axes."""

    function = "anova_variances"
    verb = "variance"
    split = "axes"
    variables = (
        *("anova_variance", "anova_variance_se", "total_variance", "total_variance_se"),
        *("higher_order_variance", "higher_order_variance_se"),
        *(f"{name}{end}" for end in ("", "_ci") for name in (
            "anova_share", "total_share", "higher_order_share", "truncation_share",
            "mean_dimension", "effective_dimension_truncation",
            "effective_dimension_superposition", "variance",
        )),
    )  # fmt: skip
    provenance = ("estimator", "sampler", "n", "realizations", "order", "stream_key")

    n: Annotated[int, COUNT] = 1
    order: Annotated[int, Meta(ge=1, le=2, description="1: single axes; 2: also pairs.")] = 2
    realizations: Annotated[int, REALIZATIONS] = 10_000
    groups: Annotated[
        tuple[_Group, ...] | None,
        Meta(
            description="Number of the group of each axis, from 0; a group counts as one axis. By "
            "default each axis is a group.",
            extra={"metavar": "G,G,…"},
        ),
    ] = None

    def need(self, subject: Subject) -> Need:
        """Check that the estimates of all subsets of the axes fit into memory."""
        estimator = subject.estimator
        estimator.check_sampler(subject.sampler, self.n)
        subsets = len(_frozen(max(self._group_of_axes(estimator.dims)) + 1, self.order))
        values = subsets * max(1, estimator.channels) * self.realizations
        if values > _SETTINGS.most_values:
            raise ParameterError(
                f"{self.realizations} realizations of {values // self.realizations} subsets take "
                f"{8 * values / 2**30:.3g} GiB; request at most "
                f"{_SETTINGS.most_values * self.realizations // values} realizations, or give ",
                Parameter("order", 1),
                ".",
            )
        evaluations = sum(estimator.counts)
        points = subsets * self.realizations * self.n * evaluations
        return Need(
            cost=float(points),
            evaluations=points * estimator.evaluations_per_point,
            memory=memory_of(self.n, estimator.dims, 2 * evaluations) + 24 * values,
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Estimates]:
        """Return the estimates of every realization.

        All realizations are kept, because covariances need the means over all realizations.
        """
        e, sampler, n = subject.estimator, subject.sampler, self.n
        partner = stream.child(_PARTNER)
        groups = self._group_of_axes(e.dims)
        masks = np.array([[g in u for g in groups] for u in _frozen(max(groups) + 1, self.order)])
        evaluations = n * sum(e.counts)
        blocks = realization_blocks(self.realizations, 4 * e.dims * evaluations)

        @functools.cache
        def same_always() -> bool:
            """Return whether the sampler draws the same set for all seeds."""
            one, other = (sampler.draw_stream(n, s, 0, 1) for s in (stream, partner))
            return np.array_equal(one, other)

        def estimates(index: int) -> _Estimates:
            """Return estimates in which a subset of axes is kept and all others are replaced."""
            block = blocks[index]
            kept = e.draw(sampler, n, stream, *block)
            # Coordinates on axes that are not kept are replaced by coordinates of other sets.
            # If all sets of the sampler are equal, coordinates of random points are used
            if same_always():
                random = as_sampler("random", sampler.dims)
                others = e.draw(random, n, stream.child(_UNIFORM), *block)
            else:
                others = e.draw(sampler, n, partner, *block)
                for t, y in enumerate(others):
                    keys = stream.child(_ORDER).child(t).uniforms(*block, y.shape[1])
                    others[t] = np.take_along_axis(y, keys.argsort(axis=1)[:, :, None], axis=1)
            found = [
                e.estimate([np.where(mask, x, y) for x, y in zip(kept, others, strict=True)])
                for mask in masks
            ]
            return _Estimates(np.stack(found).reshape(len(masks), block[1], -1))

        return Reduction(
            kind=_Estimates,
            block=estimates,
            blocks=len(blocks),
            cost=float(len(masks) * self.realizations * evaluations),
            result=lambda found: self._labelled(found.values, subject),
        )

    def _group_of_axes(self, dims: int) -> tuple[int, ...]:
        """Return the group of each axis. The analysis treats a group as one axis."""
        given = tuple(range(dims)) if self.groups is None else self.groups
        if len(given) != dims or {*given} != {*range(max(given) + 1)}:
            raise ParameterError(
                Parameter("groups"),
                f" is {list(given)!r:.80}; give one for each of the {dims} axes, numbered from 0 "
                "without gaps.",
            )
        as_integer(
            "dims" if self.groups is None else "groups",
            max(given) + 1,
            least=1,
            most=_SETTINGS.most_dims,
        )
        return given

    def _labelled(self, estimates: Array, subject: Subject) -> xr.Dataset:
        """Return the dataset for estimates (S, R, channels), one for each kept subset of axes.

        The first subset has all axes.
        The share of a subset comes from the covariance of its estimates with those of all axes.
        """
        moments, count = Moments.of(estimates[0], tails=True), estimates.shape[1]
        # Products of deviations, whose means over realizations are covariances: (S, R, channels)
        deviation = estimates - estimates.mean(axis=1, keepdims=True)
        products = deviation * (deviation[0] * (count / (count - 1)))
        # With two realizations, products of deviations are equal, so their spread is not an error
        least = _SETTINGS.least
        per_root = count**-0.5 if count >= least else math.nan
        dims = max(self._group_of_axes(subject.estimator.dims)) + 1
        frozen, listed, axes = _frozen(dims, self.order), _subsets(dims, self.order), range(dims)
        weight = dict(zip(frozen, np.eye(len(frozen)), strict=True))

        def below(*u: int) -> Array:
            """Return weights of covariances. The weighted sum is the variance from axes in u."""
            return np.asarray(weight[u] - weight[()])

        parts = [
            below(*u) - sum((below(a) for a in u if len(u) > 1), np.zeros(len(frozen)))
            for u in listed
        ]
        # Terms of the whole variance, one for each realization, and their mean
        varies = moments.variance > rounding_floor(moments.mean)
        every = weighted_sum(below(*axes), products)
        whole = np.where(varies, every.mean(axis=0), np.nan)

        def combined(weights: list[Array]) -> tuple[Array, Array, Array, Array]:
            """Return parts of the variance with errors, and shares of the variance with intervals.

            Each part of the variance is a weighted sum of covariances.
            """
            each = [weighted_sum(row, products) for row in weights]
            means = np.stack([q.mean(axis=0) for q in each])
            errors, share = (
                np.stack([q.std(axis=0, ddof=1) for q in each]) * per_root,
                means / whole,
            )
            off = [(q - s * every).std(axis=0, ddof=1) for q, s in zip(each, share, strict=True)]
            half = student_t(count) * per_root * np.stack(off) / np.abs(whole)
            return means, errors, share, np.stack([share - half, share + half], axis=-1)

        sizes = np.array([len(u) for u in listed])
        labels = ["".join(f"x{i}" for i in u) for u in listed]
        larger = [below(*axes) - np.sum(parts, axis=0)]
        totals = [below(*axes) - below(*axes[:i], *axes[i + 1 :]) for i in axes]
        up_to = [
            np.sum([part for part, size in zip(parts, sizes, strict=True) if size <= s], axis=0)
            for s in range(1, sizes.max() + 1)
        ]
        own, own_se, share, share_ci = combined(parts)
        total, total_se, total_share, total_share_ci = combined(totals)
        rest, rest_se, rest_share, rest_share_ci = combined(larger)
        *_, first, first_ci = combined([below(*axes[: s + 1]) for s in axes])
        *_, by_size, by_size_ci = combined(up_to)
        *_, mean_size, mean_size_ci = combined([np.sum(totals, axis=0)])
        alone = ("channel",)
        few = f"{count} realizations give no error; use at least {least}" if count < least else ""
        return dataset(
            {
                "anova_variance": (("subset", "channel"), own),
                "anova_variance_se": (("subset", "channel"), own_se),
                "anova_share": (("subset", "channel"), share),
                "anova_share_ci": (("subset", "channel", "bound"), share_ci),
                "total_variance": (("axis", "channel"), total),
                "total_variance_se": (("axis", "channel"), total_se),
                "total_share": (("axis", "channel"), total_share),
                "total_share_ci": (("axis", "channel", "bound"), total_share_ci),
                "higher_order_variance": (alone, rest[0]),
                "higher_order_variance_se": (alone, rest_se[0]),
                "higher_order_share": (alone, rest_share[0]),
                "higher_order_share_ci": ((*alone, "bound"), rest_share_ci[0]),
                "truncation_share": (("axes", "channel"), first),
                "truncation_share_ci": (("axes", "channel", "bound"), first_ci),
                "effective_dimension_truncation": (alone, _least(first)),
                "effective_dimension_truncation_ci": ((*alone, "bound"), _least_ci(first_ci)),
                "effective_dimension_superposition": (alone, _least(by_size)),
                "effective_dimension_superposition_ci": ((*alone, "bound"), _least_ci(by_size_ci)),
                "mean_dimension": (alone, mean_size[0]),
                "mean_dimension_ci": ((*alone, "bound"), mean_size_ci[0]),
                "variance": (alone, moments.variance),
                "variance_ci": (("channel", "bound"), moments.variance_ci),
            },
            {
                "subset": coordinate("subset", np.arange(len(labels)), "subset of axes"),
                "subset_label": ("subset", labels, {"long_name": "axes of the subset"}),
                "subset_size": coordinate("subset", sizes, "number of axes"),
                "axis": coordinate("axis", np.arange(dims), "axis"),
                "axes": coordinate("axes", np.arange(1, dims + 1), "number of axes"),
                "bound": ["low", "high"],
            },
            drop=() if subject.estimator.channels else alone,
            effective_share=EFFECTIVE_SHARE,
            note="; ".join(filter(None, (few, tail_note(moments)))) or None,
        )


@final
class AnovaSpectrum(Analysis, frozen=True, kw_only=True):
    """Variance for each subset of the axes, from sampled frequencies."""

    function = "measure.anova_spectrum"
    variables = ("anova_variance", "anova_variance_se")
    provenance = ("estimator", "sampler", "n", "half_width", "frequencies", "stream_key")

    n: Annotated[int, COUNT]
    order: Annotated[int, Meta(ge=1, le=3, description="Most axes of a subset.")] = 2
    frequencies: Annotated[
        int,
        Meta(
            ge=2 * _SETTINGS.batches,
            le=_SETTINGS.most_frequencies,
            description="Number of sampled frequencies of each subset.",
        ),
    ] = 1024
    half_width: Annotated[
        int,
        Meta(
            ge=1,
            le=2**20,
            description="Largest frequency along each axis; higher ones are left out.",
        ),
    ] = 4096
    realizations: Annotated[
        int,
        Meta(
            ge=2 * _SETTINGS.batches,
            le=10**9,
            description="Number of point sets, if the power of the sampler has no closed form.",
            extra={"flag": "-m", "metavar": "R"},
        ),
    ] = 64

    def need(self, subject: Subject) -> Need:
        """Check that coefficients are exact, points uniform and frequencies uncorrelated."""
        estimator, sampler = subject.estimator, subject.sampler
        estimator.check_sampler(sampler, self.n)
        plain = isinstance(estimator, Estimator) and estimator.density is None
        if not plain or estimator.integrand.fourier_source != "exact":
            raise NoClosedForm(
                f"Sampled frequencies need exact Fourier coefficients and uniform points, which "
                f"{estimator.spec} does not have; use ",
                Function("anova_variances"),
                ".",
            )
        if not sampler.law(self.n).stationary:
            raise NoClosedForm(
                f"The frequencies of {sampler.spec} are correlated; add shift, or use ",
                Function("anova_variances"),
                ".",
            )
        dims = as_integer("dims", estimator.dims, least=1, most=_SETTINGS.most_dims)
        subsets = len(_subsets(dims, self.order))
        total = self.frequencies * subsets
        if total > _SETTINGS.most_frequencies:
            raise ParameterError(
                f"{self.frequencies} frequencies of {subsets} subsets are more than "
                f"{_SETTINGS.most_frequencies:.3g} in total; lower the number of frequencies "
                "or the order."
            )
        return Need(
            cost=float(total * self.n * self.realizations) / _SETTINGS.batches,
            memory=memory_of(self.n, dims, frequencies=total * max(1, estimator.channels)),
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Batches]:
        """Return batches of frequencies and sets. The batches are independent of each other."""
        f, n, dims = subject.estimator.integrand, self.n, subject.estimator.dims
        subsets = _subsets(dims, self.order)
        batches = _SETTINGS.batches
        count = self.frequencies // batches
        # Distribution of one component: ±k with probability ∝ 1/k², k = 1 … K
        cumulative = np.cumsum(np.arange(1.0, self.half_width + 1) ** -2)

        def batch(index: int) -> _Batches:
            # Frequencies of all subsets, (U · count, d), and their probabilities, (U · count,)
            m: Array = np.zeros((len(subsets), count, dims))
            q: Array = np.ones((len(subsets), count))
            for place, subset in enumerate(subsets):
                own = stream.child(2 * index).uniforms(place, 1, count * len(subset))
                u = 2.0 * own.reshape(count, -1)
                sign, u = np.where(u < 1.0, -1.0, 1.0), np.mod(u, 1.0)
                k = np.searchsorted(cumulative, u * cumulative[-1], side="right") + 1.0
                k = np.minimum(k, self.half_width)
                m[place][:, list(subset)] = sign * k
                q[place] = np.prod(0.5 / (k * k * cumulative[-1]), axis=1)
            m, q = m.reshape(-1, dims), q.ravel()
            try:
                power, source = closed_form_power(subject.sampler, n, m), "closed form"
            except NoClosedForm:
                sets = self.realizations // batches
                rng = np.random.SeedSequence(stream.child(2 * index + 1).key)
                found = power_at(subject.sampler, n, m, realizations=sets, rng=rng)
                power, source = found["power"].to_numpy(), f"{batches * sets} realizations"
            energy = np.abs(f.fourier(m).reshape(len(m), -1)) ** 2
            terms = energy * (power / q)[:, None]
            return _Batches(terms.reshape(1, len(subsets), count, -1).mean(axis=2), source)

        def result(found: _Batches) -> xr.Dataset:
            se = found.means.std(axis=0, ddof=1) / math.sqrt(batches)
            return dataset(
                {
                    "anova_variance": (("subset", "channel"), found.means.mean(axis=0)),
                    "anova_variance_se": (("subset", "channel"), se),
                },
                {
                    "subset_label": ("subset", ["".join(f"x{i}" for i in u) for u in subsets]),
                    "subset_size": ("subset", [len(u) for u in subsets]),
                },
                drop=() if f.channels else ("channel",),
                power=found.power,
            )

        return Reduction(kind=_Batches, block=batch, blocks=batches, result=result)


def anova_variances(
    estimator: Any,
    sampler: Sampler | str = "random",
    n: int = 1,
    *,
    dims: int | None = None,
    order: int = 2,
    realizations: int = 10_000,
    groups: Sequence[int] | None = None,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Decompose the variance of an estimate by the axes of its primary space.

    Parameters
    ----------
    estimator, sampler, n
        The estimator with its sampler and number of points, in up to 64 dims or groups.
        Random sampling with n = 1 is the default.
        By default, the parts c_u of the variance are the ANOVA variances σ²_u of the integrand.
    dims
        Number of dims of a function, or of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    order
        Largest number of axes of a subset, 1 or 2.
    realizations
        Number of independent pairs of point sets, at least 2.
    groups
        Group of each axis, numbered from 0 without gaps. By default every axis is a group.
        The subsets, and the dims ``axis`` and ``axes`` of the result, refer to groups of axes.
        A group may hold the axes of one bounce of a path, for example.
    rng
        Seed (SPEC 7). Realization r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    workers
        Number of threads. The default is all processors. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of the integrand.
        If an analysis needs more evaluations, an error is raised, usually before the start.

    Returns
    -------
    xarray.Dataset
        ``anova_variance(subset)`` is the part c_u of the variance from a subset u of axes.
        ``anova_share(subset)`` is c_u divided by the whole variance.
        The part c_u and the whole variance are from the same pairs of point sets.
        All shares sum to 1. The shares of single axes are the first-order Sobol' indices.

        ``total_variance(axis)`` is the sum of c_u over all subsets u that contain the axis.
        ``total_share(axis)`` is the total Sobol' index.
        ``higher_order_variance`` is the variance from subsets with more than `order` axes.
        ``higher_order_share`` is this variance divided by the whole variance.
        ``truncation_share(axes)`` is the share of the first axes in the variance.

        Effective dimensions refer to 99 % of the variance.
        ``effective_dimension_truncation`` is the number of leading axes with 99 % of the variance.
        ``effective_dimension_superposition`` is the least size s of subsets that is enough:
        subsets of up to s axes hold 99 % of the variance. If s exceeds `order`, the value is NaN.
        ``mean_dimension`` is the mean of |u| weighted by c_u. ``variance`` is the whole variance.

        Standard errors of variances have names that end in ``_se``.

        Shares and dimensions have 95 % intervals ``_ci``, which are not clipped to 0 and 1.
        Intervals of ratios of means come from the delta method with Student's t.
        The interval of an effective dimension ends where the interval of the shares crosses 99 %.
        The upper end is infinite if the lower ends of all shares are below 99 %.
        With fewer than 4 realizations, errors and intervals are NaN.
        If f has several channels, the result has the dim channel.

    Raises
    ------
    ParameterError, CountError
        If a value is out of range, or the estimates would not fit into memory.

    Notes
    -----
    The cost is O(R n d²) evaluations for order 2 and O(R n d) for order 1.
    If the parts for different subsets u are correlated, a part c_u may be negative.
    Noise may also make c_u slightly negative, within its standard error.
    The method replaces coordinates of a set by coordinates of a second, independent set.
    A sampler of given sets (`Sampler.from_points`) cannot draw an independent second set.
    For a sampler of given sets, random points replace the second set, so errors are larger.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> parts = mcs.anova_variances(mcs.Estimator("linear", dims=3), realizations=1000, rng=1)
    >>> [round(float(share), 6) for share in parts["anova_share"][:3]]
    [1.0, 0.0, 0.0]
    """
    subject = as_subject(estimator, sampler, dims=dims)
    return compute(Anova.of(locals()), subject, rng, workers)


def anova_spectrum(
    estimator: Any,
    sampler: Sampler | str,
    n: int,
    *,
    dims: int | None = None,
    order: int = 2,
    frequencies: int = 1024,
    half_width: int = 4096,
    realizations: int = 64,
    rng: RngLike = 0,
) -> xr.Dataset:
    """Split the variance of a sampler among subsets of the axes, by sampled frequencies.

    Parameters
    ----------
    estimator
        An estimator of one integrand with exact Fourier coefficients and uniform points.
        The integrand may have up to 64 dims.
    sampler, n
        Random points, or points with a random shift.
        The distribution of the points must be the same after any translation.
    dims
        Number of dims of a function, or of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    order
        Largest number of axes of a subset, 1 to 3.
    frequencies
        Number of sampled frequencies of each subset, at least 32.
    half_width
        Largest |m_i|. Higher frequencies are omitted.
    realizations
        Total number of point sets, at least 32. It is used if ⟨|S_m|²⟩ has no closed form.
    rng
        Seed (SPEC 7).

    Returns
    -------
    xarray.Dataset
        ``anova_variance(subset)`` is c_u, and ``anova_variance_se(subset)`` is its standard error.
        The standard error comes from the mean of 16 independent batches of frequencies.
        Each batch has its own frequencies and sets.
        The attribute ``power`` reports whether ⟨|S_m|²⟩ is exact.

    Raises
    ------
    NoClosedForm
        If the coefficients are not exact, the points have a density, or frequencies are correlated.
        Use `anova_variances` for densities, inexact coefficients or correlated frequencies.
    ParameterError, CountError
        If a value is out of range, or the frequencies would not fit into memory.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.integrand("gaussian(width=0.5)", dims=3)
    >>> parts = anova_spectrum(f, "latin-hypercube | shift", 64)
    >>> parts["anova_variance"].sizes["subset"]
    6
    >>> bool(parts["anova_variance"][0] < 0.1 * parts["anova_variance"][3])  # strata on each axis
    True
    """
    subject = as_subject(estimator, sampler, dims=dims)
    return compute(AnovaSpectrum.of(locals()), subject, rng)


@dataclass(frozen=True)
class _Estimates:
    """Estimates for each subset of kept axes, with shape (S, R, channels)."""

    values: Annotated[Array, Join(1)]


@dataclass(frozen=True)
class _Batches:
    """Means over the frequencies of each batch, (B, U, channels), for U subsets of axes.

    `power` tells whether ⟨|S_m|²⟩ is from a closed form or from realizations.
    """

    means: JOIN
    power: Annotated[str, "same"]


def _subsets(dims: int, order: int) -> list[tuple[int, ...]]:
    """Return the subsets of 1 to `order` axes, by size."""
    return [u for s in range(1, order + 1) for u in itertools.combinations(range(dims), s)]


def _frozen(dims: int, order: int) -> list[tuple[int, ...]]:
    """Return the subsets of axes to keep, without duplicates: first all axes, then none."""
    axes = tuple(range(dims))
    without = [(*axes[:i], *axes[i + 1 :]) for i in axes]
    first = [axes[:s] for s in range(1, dims)]
    return list(dict.fromkeys([axes, (), *_subsets(dims, order), *without, *first]))


def _least(shares: Array) -> Array:
    """Return the least number of axes whose share is at least 99 %, or NaN if no number is enough.

    `shares[s − 1]` is the share of the variance that s axes hold.
    """
    enough = shares >= EFFECTIVE_SHARE
    return np.where(enough.any(axis=0), enough.argmax(axis=0) + 1.0, np.nan)


def _least_ci(ends: Array) -> Array:
    """Return the 95 % intervals of an effective dimension, one for each channel: (channels, 2).

    The array `ends` has the interval of each share: (number of axes, channels, 2).
    """
    least = _least(ends)[..., ::-1]
    unknown = np.asarray(np.isnan(ends).any(axis=(0, 2)))[:, None]
    return np.where(unknown, np.nan, np.nan_to_num(least, nan=np.inf))
