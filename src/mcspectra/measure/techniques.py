"""Terms of the variance for each technique and each pair of techniques.

E_t is the part of an estimate from technique t.
The variance is the sum of Cov(E_t, E_s) over all pairs of techniques.
Covariances of different techniques are 0 if their point sets are independent.
Techniques that share points have a nonzero covariance (`mcspectra.estimators.base`).
Each covariance has a dc, a power and a cross term.
The terms use the spectrum S^t and the integrand f^t of technique t instead of S and f.

For large n, the slowest rate of a technique becomes the rate of the sum.
A technique is the *bottleneck* if its rate is significantly slower than all other rates.
The 95 % interval of this rate must lie above the intervals of all other techniques.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

import numpy as np

from mcspectra.core import options
from mcspectra.core.analysis import Counted, Need, Reduction, Steps, Subject, compute
from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.fits import check_window, fit_rates
from mcspectra.core.memory import memory_of
from mcspectra.core.ordered import product, weighted_sum
from mcspectra.core.parallel import realization_blocks
from mcspectra.core.records import JOIN
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.importance import as_subject
from mcspectra.estimators.moments import Moments
from mcspectra.measure.blindness import NO_VARIANCE, is_fixed
from mcspectra.measure.converge import count_stream
from mcspectra.measure.sums import BATCH_SETTINGS, Variables, ratio_factors, spread
from mcspectra.measure.views import Frequencies, View
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import independent_sets

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["UNDECIDED", "Techniques", "technique_estimates", "technique_rates", "technique_terms"]

UNDECIDED = -1
"""Value of ``bottleneck`` if no technique has a significantly slower rate than all others."""

_PARTS = (
    "technique_dc_term",
    "technique_power_term",
    "technique_cross_term",
    "technique_covariance",
)
_FINITE = ("technique_covariance", "technique_variance", "measured_variance", "mean")


@dataclass(frozen=True)
class TechniqueSettings:
    """Limit of memory for sums over pairs of techniques."""

    # Largest number of sums Σ_r S^t conj(S^s) over realizations r: 2^25 sums take 512 MiB.
    # There is one sum for each pair of techniques t and s and each frequency.
    most: int = 2**25


_SETTINGS = TechniqueSettings()


@final
class Techniques(Counted, frozen=True, kw_only=True):
    """Variance of each technique of an estimator, and the technique that decides the rate."""

    function = "technique_terms"
    verb = "variance"
    split = "techniques"
    variables = (
        *_PARTS,
        *(f"{name}_se" for name in _PARTS),
        *(
            "dc_term",
            "power_term",
            "cross_term",
            "predicted_variance",
            "captured",
            "captured_ci",
            "mean",
        ),
        *("measured_variance", "measured_variance_ci"),
        *("technique_variance", "technique_variance_ci"),
        *("technique_rate", "technique_rate_ci", "rate", "rate_ci", "bottleneck"),
    )
    provenance = ("estimator", "sampler", "realizations", "half_width", "eps", "stream_key")

    counts: Annotated[options.Positive | options.Counts, options.COUNTS]
    half_width: Annotated[int, options.HALF_WIDTH] = 64
    realizations: Annotated[int, options.REALIZATIONS] = 1000
    space: Annotated[Literal["domain", "primary"] | None, options.SPACE] = None
    basis: Annotated[str, options.BASIS] = "fourier"
    fit_last: Annotated[options.Window, options.FIT_LAST] = None
    engine: Annotated[str, options.ENGINE] = "auto"
    eps: Annotated[float, options.EPS] = 1e-9

    def need(self, subject: Subject) -> Need:
        """Check that the covariances fit into memory."""
        estimator, counts = subject.estimator, self._counts
        check_window(self.fit_last, len(counts))
        for n in counts:
            estimator.check_sampler(subject.sampler, n)
        basis = Frequencies.of(subject, self).basis
        techniques, evaluations = len(estimator.counts), sum(estimator.counts)
        if techniques**2 * basis.stored > _SETTINGS.most:
            raise ParameterError(
                f"{techniques}² pairs of techniques at {basis.stored} frequencies are more than "
                f"{_SETTINGS.most} covariances; choose a smaller ",
                Parameter("half_width"),
                ".",
            )
        squared = basis.size * techniques**2
        return Need(
            cost=float(self.realizations * (evaluations * sum(counts) + squared * len(counts))),
            memory=memory_of(counts[-1], estimator.dims, evaluations, squared),
            evaluations=self.realizations
            * (evaluations * sum(counts) * estimator.evaluations_per_point),
        )

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """Return the sums over realizations for all counts together."""
        estimator, counts = subject.estimator, self._counts
        frequencies = Frequencies.of(subject, self)
        views = [frequencies.view(n, self, apart=True) for n in counts]
        techniques = len(estimator.counts)

        def of_count(key: str, view: View, n: int, own: Stream) -> Reduction[_Total]:
            """Return the sums for one count. Each block is a batch."""
            evaluations = n * sum(estimator.counts)
            # Number of coordinates of a realization, or of numbers in its spectra if there are more
            numbers = max(evaluations * estimator.dims, 4 * techniques * view.basis.stored)
            blocks = realization_blocks(
                self.realizations, numbers, multiple=2, least=BATCH_SETTINGS.least
            )

            def block(index: int) -> _Total:
                points = estimator.draw(subject.sampler, n, own, *blocks[index])
                sets = independent_sets(estimator.law(subject.sampler, n))
                sums = TechniqueSums.of(view, points, blocks[index][0], sets)
                # A block of one realization has no covariance and is skipped
                some = slice(0, int(sums.count > 1))
                values = sums.covariances(view)[None]
                return _Total(sums, np.array([sums.count - 1.0])[some], values[some])

            cost = float(self.realizations * (evaluations + techniques**2 * view.basis.size))
            return Reduction(kind=_Total, block=block, blocks=len(blocks), cost=cost, key=key)

        streams = [count_stream(stream, n) if self._several else stream for n in counts]
        totals = yield [
            of_count(str(part), *each)
            for part, each in enumerate(zip(views, counts, streams, strict=True))
        ]

        # Join the variables of all counts along a first axis n
        parts = [_variables(total, view) for total, view in zip(totals, views, strict=True)]
        variables: Variables = {
            name: (("n", *dims), np.stack([part[name][1] for part in parts]))
            for name, (dims, _) in parts[0].items()
        }
        notes: dict[str, Any] = {} if self._several else {"n": counts[0]}
        if is_fixed(estimator, subject.sampler):  # The set is fixed: any variance is rounding noise
            notes["note"] = f"{subject.sampler.spec} {NO_VARIANCE}"
            variables = {
                name: (dims, v if name.startswith(("mean", "captured")) else np.zeros_like(v))
                for name, (dims, v) in variables.items()
            }
        if frequencies.diverge:
            notes["note"] = "spectral terms are infinite: ∫1/p diverges"
            variables = frequencies.undefined(variables, _FINITE)
        scalar = estimator.channels == 0
        if self._several:
            moments = [total.sums.moments for total in totals]
            rates, choice = technique_rates(counts, moments, self.fit_last)
            variables |= rates
            words = ["undecided" if t == UNDECIDED else f"technique {t}" for t in choice]
            notes["bottleneck"] = words[0] if scalar else "; ".join(words)
        numbers = np.arange(len(estimator.counts))
        n = coordinate("n", list(counts), "number of points")
        return dataset(
            variables,
            {
                "technique": numbers,
                "technique_other": numbers,
                "bound": ["low", "high"],
                **({"n": n} if self._several else {}),
            },
            drop=["channel"] * scalar + ["n"] * (not self._several),
            basis=frequencies.basis.name,
            space=frequencies.space,
            coefficients=views[0].source,
            engine=views[0].engine,
            **notes,
        )

    @property
    def _several(self) -> bool:
        return isinstance(self.counts, tuple)

    @property
    def _counts(self) -> tuple[int, ...]:
        return self.counts if isinstance(self.counts, tuple) else (self.counts,)


def technique_terms(
    estimator: Any,
    sampler: Sampler | str,
    counts: int | Sequence[int],
    *,
    dims: int | None = None,
    half_width: int = 64,
    realizations: int = 1000,
    rng: RngLike = 0,
    basis: str = "fourier",
    space: str | None = None,
    fit_last: int | str | None = None,
    engine: str = "auto",
    eps: float = 1e-9,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Split the variance of an estimator among its techniques and pairs of them, term by term.

    Parameters
    ----------
    estimator, sampler
        A `MultipleImportance`, a `TechniqueSum` or any other estimator, and its sampler.
    counts
        Technique t draws n c_t points, where c_t is its entry in the ``counts`` of the estimator.
        A list of ascending numbers adds the dim n, rates and the bottleneck.
    dims, half_width, basis, engine, eps, workers
        Same as in `variance_terms`.
    realizations
        Number of independent realizations for each n, at least 2.
    rng
        Seed (SPEC 7). With a single n, the realizations are the same as in `variance_terms`.
        With a list, each n has the same random numbers as in `convergence`.
    space
        ``"domain"`` or ``"primary"`` as in `variance_terms`.
        By default, the space is the domain of f if there is one.
        In primary space the dc terms are 0, because all points of a technique have equal weights.
    fit_last
        Number of the largest counts to which rates are fitted, as in `convergence`.
    max_evaluations
        Maximum number of evaluations of the integrand.
        If an analysis needs more evaluations, an error is raised, usually before the start.

    Returns
    -------
    xarray.Dataset
        ``technique_covariance`` and its terms have the dims technique and technique_other.
        ``technique_covariance`` is the covariance of two techniques' parts of the estimate.
        The sum of the covariances is ``measured_variance``.
        ``technique_dc_term``, ``technique_power_term`` and ``technique_cross_term`` are the terms.
        The sum of the three terms is ``predicted_variance``.
        With at least 4 realizations, the covariance and its terms have standard errors ``_se``.

        ``dc_term``, ``power_term`` and ``cross_term`` are the same as in `variance_terms`.
        In the domain, each of these three terms is a sum over all pairs of techniques.
        In primary space each technique has its own frequencies.
        The dc and power terms then contain no pairs of different techniques.
        The cross term is the rest of the variance.
        ``captured`` has the interval ``captured_ci``.

        ``technique_variance(technique)`` with ``_ci`` is the diagonal of the covariances.

        With a list of n, ``technique_rate`` and ``rate`` have intervals ``_ci``.
        ``bottleneck`` is the technique whose rate is significantly slower than all other rates.
        The 95 % interval of the bottleneck's rate overlaps no interval of another rate.
        If no technique is significantly slower, the value is −1 (undecided).
        The attribute ``bottleneck`` has the name of the slowest technique.
        Techniques without variance are excluded. Several channels add a dim channel.

    Raises
    ------
    CountError, ParameterError
        If a value is out of range, dims disagree, or the sampler does not allow a count.

    Warns
    -----
    InfiniteWeightVarianceWarning
        If ∫1/p diverges for a density p. The spectral terms in the domain are then NaN.

    Notes
    -----
    The time is O(R (n + T² M)) for R realizations, T techniques and M frequencies.
    The memory for T techniques and M frequencies is O(T² M).
    The bottleneck compares the techniques' own variances.
    Correlations between techniques may cancel part of the techniques' own variances.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> parts = mcs.estimators.TechniqueSum(["linear", "step(at=0.3)"], dims=1)
    >>> d = mcs.technique_terms(parts, "jittered", [16, 64, 256], half_width=8, realizations=200)
    >>> d.attrs["bottleneck"]
    'technique 1'
    """
    subject = as_subject(estimator, sampler, dims=dims)
    return compute(Techniques.of(locals()), subject, rng, workers)


@dataclass(frozen=True)
class _Total:
    """Sums over realizations, and the estimates of each block for standard errors."""

    sums: TechniqueSums
    weights: JOIN  # Degrees of freedom of each block: (B,)
    values: JOIN  # The dc, power and cross terms and the measured covariance: (B, 4, C, T, T)


def _variables(total: _Total, view: View) -> Variables:
    """Return result variables of one count, with a leading channel axis."""
    found, moments = total.sums.covariances(view), total.sums.moments
    share = total.weights / total.weights.sum()
    # With few stored sets, a factor widens the standard error of the whole estimate's variance.
    # The widening factor of the whole estimate also widens the standard errors of all techniques
    wider = moments.widening[:, -1]
    errors = spread(total.values - weighted_sum(share, total.values), share)
    errors = errors * wider[:, None, None]
    predicted = found[:3].sum(axis=(0, 2, 3))
    # Compute predicted and measured variance of the whole estimate by block, (B, 2, C)
    whole = total.values.sum(axis=(-2, -1))
    sides = np.stack([whole[:, :3].sum(axis=1), whole[:, 3]], axis=1)
    # As in `variance_terms`, each technique has its own frequencies in primary space
    dc, power = (np.einsum("cts->c" if view.space == "domain" else "ctt->c", c) for c in found[:2])
    measured, mean = moments.variance[:, -1], moments.mean[:, -1]
    real = np.where(measured > rounding_floor(mean), measured, np.nan)
    pairs, each = ("channel", "technique", "technique_other"), ("channel", "technique")
    return {
        **{name: (pairs, values) for name, values in zip(_PARTS, found, strict=True)},
        **{f"{name}_se": (pairs, values) for name, values in zip(_PARTS, errors, strict=True)},
        "dc_term": (("channel",), dc),
        "power_term": (("channel",), power),
        "cross_term": (("channel",), predicted - dc - power),
        "predicted_variance": (("channel",), predicted),
        "measured_variance": (("channel",), measured),
        "measured_variance_ci": (("channel", "bound"), moments.variance_ci[:, -1]),
        "captured": (("channel",), predicted / real),
        "captured_ci": (
            ("channel", "bound"),
            (predicted / real)[:, None]
            * ratio_factors(sides[:, 0], sides[:, 1], share) ** wider[:, None],
        ),
        "mean": (("channel",), mean),
        "technique_variance": (each, moments.variance[:, :-1]),
        "technique_variance_ci": ((*each, "bound"), moments.variance_ci[:, :-1]),
    }


@dataclass(frozen=True)
class TechniqueSums:
    """Sums over `count` realizations about the running means. `merge` adds other realizations."""

    count: int
    mean: Array  # Mean spectra S̄ of the techniques, (T, H)
    products: Array  # (T, T, H): Σ_r (S^t − S̄^t) conj(S^s − S̄^s)
    values_mean: Array  # Truncated and full estimates of the techniques, (2, C, T)
    values_products: Array  # Sums of products of deviations of these estimates, (2, C, T, T)
    moments: Moments  # Moments of the techniques' full estimates and of their sum: (C, T + 1)

    @staticmethod
    def of(
        view: View, points: list[Array], first: int = 0, sets: int | None = None
    ) -> TechniqueSums:
        """Return the sums of one block of realizations; see `Moments.of` for `first` and `sets`."""
        parts = view.spectra(points)
        # Compute the techniques' parts of the truncated and of the full estimate: (R, C, T) each
        weighted = view.integrand_coefficients.conj() * view.basis.double
        truncated = np.stack(
            [product(s, weighted[:, t].T).real for t, s in enumerate(parts)], axis=2
        )
        full = technique_estimates(view.estimator, points)
        s, values = np.stack(parts, axis=1), np.stack([truncated, full[..., :-1]], axis=1)
        mean, values_mean = s.mean(axis=0), values.mean(axis=0)
        deviation, off = s - mean, values - values_mean
        return TechniqueSums(
            count=len(s),
            mean=mean,
            products=np.einsum("rth,rsh->tsh", deviation, deviation.conj()),
            values_mean=values_mean,
            values_products=np.einsum("rkct,rkcs->kcts", off, off),
            moments=Moments.of(full, tails=True, first=first, sets=sets),
        )

    def merge(self, other: TechniqueSums) -> TechniqueSums:
        """Return the sums over the realizations of both objects (Chan, Golub & LeVeque 1983)."""
        a, b = self.count, other.count
        factor, part = a * b / (a + b), b / (a + b)
        delta, jump = other.mean - self.mean, other.values_mean - self.values_mean
        return replace(
            self,
            count=a + b,
            mean=self.mean + part * delta,
            products=self.products
            + other.products
            + factor * np.einsum("th,sh->tsh", delta, delta.conj()),
            values_mean=self.values_mean + part * jump,
            values_products=self.values_products
            + other.values_products
            + factor * np.einsum("kct,kcs->kcts", jump, jump),
            moments=self.moments.merge(other.moments),
        )

    def covariances(self, view: View) -> Array:
        """Return dc term, power term, cross term and measured covariance of pairs: (4, C, T, T).

        The terms are unbiased: dc + power + cross is the covariance of the truncated estimates.
        """
        f, basis, degrees = view.integrand_coefficients, view.basis, max(self.count - 1, 1)
        weighted = self.products * basis.double / degrees
        at = slice(basis.dc, basis.dc + 1)
        dc = _paired(f[..., at], weighted[..., at])
        weighted[..., at] = 0.0
        power = _paired(f, weighted)
        total, measured = self.values_products / degrees
        return np.stack([dc, power, total - dc - power, measured])


def technique_estimates(estimator: AbstractEstimator, points: list[Array]) -> Array:
    """Return the parts of the estimates from each technique, then their sum: (R, C, T + 1)."""
    each = [estimator.primary_values(t, u).mean(axis=1) for t, u in enumerate(points)]
    parts = np.stack([v.reshape(len(v), -1) for v in each], axis=2)
    return np.concatenate([parts, parts.sum(axis=2, keepdims=True)], axis=2)


def _paired(f: Array, products: Array) -> Array:
    """Return Re Σ_h conj(f^t_h) f^s_h products^ts_h: (C, T, T)."""
    return np.stack([np.einsum("th,sh,tsh->ts", g.conj(), g, products).real for g in f])


def technique_rates(
    ns: Sequence[int], moments: Sequence[Moments], window: int | str | None = None
) -> tuple[Variables, list[int]]:
    """Return rates of all techniques and of the whole estimate, and the bottleneck by channel.

    `moments` holds the moments of `technique_estimates` for each count.
    """
    variance = np.stack([m.variance for m in moments])  # Axes: count, channel, technique
    relative = np.stack([m.relative_se for m in moments])
    # Rounding errors scale with the whole estimate, because the part of a technique may be 0
    size = np.stack([np.abs(m.mean).max(axis=1, keepdims=True) for m in moments])
    floor = np.broadcast_to(rounding_floor(size), variance.shape)
    fits = fit_rates(np.array(ns), variance, relative, floor, window)
    rate, interval = fits["rate"], fits["interval"]
    still = np.asarray((variance <= floor)[:, :, :-1].all(axis=0))
    choice = []
    for rates, intervals, own in zip(rate, interval, still, strict=True):
        # Among the techniques that vary, find the one whose interval lies above all others
        moving = np.flatnonzero(~own).tolist()
        slowest = max(
            moving, key=lambda t: np.nan_to_num(rates[t], nan=-math.inf), default=UNDECIDED
        )
        low = intervals[slowest, 0]
        others = [intervals[t, 1] for t in moving if t != slowest]
        # A comparison with a rate that could not be fitted is false. The result is then undecided
        decided = moving and math.isfinite(low) and all(high < low for high in others)
        choice.append(slowest if decided else UNDECIDED)
    variables: Variables = {
        "technique_rate": (("channel", "technique"), rate[:, :-1]),
        "technique_rate_ci": (("channel", "technique", "bound"), interval[:, :-1]),
        "rate": (("channel",), rate[:, -1]),
        "rate_ci": (("channel", "bound"), interval[:, -1]),
        "bottleneck": (("channel",), np.array(choice)),
    }
    return variables, choice
