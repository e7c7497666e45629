"""Exact variances of random and stratified sampling and of scrambled nets, by quadrature.

For independent points u_j uniform in strata of equal volume, Var(I_n) = n^-2 Σ_j Var_j(g) with g
the primary-space integrand; random sampling is one stratum; a shared random offset δ of all strata
is averaged over: E_δ[Var | δ] + Var_δ(E | δ). Nets have a finite sum over levels or over the dual net
(`mcspectra.variance._nets`). Quadratures of two orders must agree, else NoClosedForm.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject
from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNTS, Counts
from mcspectra.core.results import dataset
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, as_subject
from mcspectra.integrands import Integrand
from mcspectra.samplers import (
    Halton,
    Jittered,
    LatinHypercube,
    Owen,
    Random,
    Randomized,
    Regular,
    Sampler,
    Shift,
    StrataShift,
    UniformJitter,
    VanDerCorput,
)
from mcspectra.variance._antithetic import antithetic_variance
from mcspectra.variance._nets import net_variance, scrambling
from mcspectra.variance._reflections import mirrored_variance, without_mirror
from mcspectra.variance._squares import mean_square
from mcspectra.variance._strata import grid_mean, offset_rule, spread_within_strata

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Exact", "exact_variance"]

_ORDERS = ((12, 20), (6, 10), (4, 6))
_MANY = 400  # nets in 2-D have n² cells: 10² nodes in each of more are too many
_TOLERANCE = 1e-6


@final
class Exact(Analysis, frozen=True, kw_only=True):
    """Exact variances; NaN, with the reason as a note, where no closed form is known."""

    verb = "exact"
    variables = ("exact_variance",)

    counts: Annotated[Counts, COUNTS, Meta(extra={"flag": "-n"})]

    def need(self, subject: Subject) -> Need:
        """The sampler can do every count."""
        estimator = subject.estimator
        for n in self.counts:
            estimator.check_sampler(subject.sampler, n)
        memory = memory_of(self.counts[-1], estimator.dims, sum(estimator.counts))
        return Need(cost=1000.0 * sum(self.counts), memory=memory)

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Variances]:  # noqa: ARG002
        """The variance of one count after the other; nothing is random."""
        estimator, sampler = subject.estimator, subject.sampler

        def of_count(index: int) -> _Variances:
            try:
                value, note = exact_variance(estimator, sampler, self.counts[index]), ""
            except NoClosedForm as error:
                value, note = np.full(max(1, estimator.channels), np.nan), str(error)
            return _Variances(np.reshape(value, (1, -1)), note)

        def result(found: _Variances) -> xr.Dataset:
            return dataset(
                {"exact_variance": (("n", "channel"), found.values)},
                {"n": np.array(self.counts)},
                drop=() if estimator.channels else ("channel",),
                estimator=estimator.spec,
                sampler=sampler.spec,
                note=found.note or None,
            )

        return Reduction(
            kind=_Variances,
            block=of_count,
            blocks=len(self.counts),
            cost=1000.0 * sum(self.counts),
            result=result,
        )


@dataclass(frozen=True)
class _Variances:
    """Of counts, (N, channels or 1), and why the last that is not known is not known."""

    values: Array
    note: str

    def merge(self, other: _Variances) -> _Variances:
        """Those of both."""
        values = np.concatenate([self.values, other.values])
        return _Variances(values, other.note or self.note)


def exact_variance(
    estimator: AbstractEstimator | Integrand | str, sampler: Sampler | str, n: int
) -> Any:
    """Return the exact variance of an estimator, without sampling.

    Parameters
    ----------
    estimator, sampler, n
        Any estimator with one of: random, jittered, regular, uniform-jitter, each alone or with
        shift or strata-shift, and with mirror; antithetic-jittered; latin-hypercube, alone or with
        shift; nets and sequences such as sobol or halton with owen, and those in base 2 with digital-shift. Latin hypercubes and nets take cells,
        about n to a side: some thousands of points in 2-D, some tens in 3-D.

    Returns
    -------
    float or ndarray
        The variance; an array (channels,) where f has several. Relative error about 1e-6 or less;
        infinite where ∫g² diverges, exactly 0 where it is no more than rounding.

    Raises
    ------
    NoClosedForm
        Not known for this sampler, or the quadrature does not converge (discontinuities that are
        neither axis-aligned nor integrated in closed form).

    Examples
    --------
    >>> import mcspectra as mcs
    >>> variance = mcs.exact_variance(mcs.Estimator("linear", dims=1), "jittered", 4)
    >>> round(variance * 12 * 4**3, 9)
    1.0
    """
    subject = as_subject(estimator, sampler)
    given: AbstractEstimator = subject.estimator
    n = subject.sampler.check_count(n)
    given.check_sampler(subject.sampler, n)
    given.check_independent()
    # What a sequence does to its own digits, as the randomisation that does the same
    source = given.randomized(subject.sampler)
    if isinstance(source, Halton | VanDerCorput) and source.scramble == "owen":
        source = replace(source, scramble="none").then(Owen())
    total: Any = 0.0
    for technique, count in enumerate(given.counts):
        g = given.primary_integrand(technique)
        total = total + _converged(source, n * count, g)
    return total if given.channels else float(np.squeeze(total))


def _converged(sampler: Sampler, n: int, g: Integrand) -> Array:
    """Variance on which two orders agree, 0 where it is all rounding; (channels,) or (1,)."""
    low, high = (_variance(sampler, n, g, order) for order in _orders(n, g.dims))
    agree = np.abs(high - low) <= _TOLERANCE * np.abs(high)
    if agree.all():
        return high
    square = mean_square(g)
    if sampler.unbiased:  # one point next to the pole outweighs all others
        high = np.where(np.isinf(square), np.inf, high)
    # Σ (mean g² − (mean g)²)/n is rounded by some 1e-15 of ∫g²/n: all there is if it vanishes.
    rounding = 4e-15 * square / n
    known = agree | np.isinf(high) | (np.abs(high - low) <= rounding)
    if not known.all():
        raise NoClosedForm(
            f"The stratum quadrature of {g.spec} does not converge ({np.max(low):.6g} against "
            f"{np.max(high):.6g}); use convergence or variance_terms."
        )
    vanishes = ~agree & np.isfinite(high) & (np.maximum(low, high) <= rounding)
    return np.where(vanishes, 0.0, high)


def _orders(n: int, dims: int) -> tuple[int, int]:
    """Orders of two rules to compare; in 2-D and up lower, and for many points lower still."""
    return _ORDERS[0] if dims == 1 else _ORDERS[1] if n < _MANY else _ORDERS[2]


def _variance(sampler: Sampler, n: int, g: Integrand, order: int) -> Array:
    """Variance of the mean of g over a stratified set; (channels,) or (1,)."""
    mode, inner = without_mirror(sampler)
    if mode is not None:
        of_inner = functools.partial(_variance, order=order)
        return mirrored_variance(of_inner, mode, inner, n, g)
    if sampler.name == "antithetic-jittered":
        return antithetic_variance(g, n, order)
    kind = scrambling(sampler)
    if kind is not None:
        return net_variance(sampler, n, g, order, kind)
    base, offset, shifted = _decompose(sampler, g.dims)
    if isinstance(base, Random):
        return spread_within_strata(g, (1,) * g.dims, np.zeros(g.dims), order) / n
    sides = (n,) if isinstance(base, LatinHypercube) else base.sides(n)
    jittered = isinstance(base, Jittered | LatinHypercube)
    if jittered and not shifted:
        return spread_within_strata(g, sides, offset * n ** (-1.0 / g.dims), order) / n
    if not jittered and not (shifted or isinstance(base, UniformJitter)):
        return np.zeros(max(1, g.channels))  # a deterministic set
    nodes, weights = offset_rule(g, sides, order)
    if jittered:
        spreads = np.stack([spread_within_strata(g, sides, d, order) for d in nodes])
        return np.asarray(weights @ spreads) / n
    # A grid with one random offset: the variance of its mean over the offset
    means = np.stack([grid_mean(g, sides, d) for d in nodes])
    return np.asarray(weights @ (means - weights @ means) ** 2)


def _decompose(sampler: Sampler, dims: int) -> tuple[Any, Array, bool]:
    """Return the base, its fixed offset in strata, and whether a random shift follows."""
    base, steps = (
        (sampler.base, sampler.steps) if isinstance(sampler, Randomized) else (sampler, ())
    )
    known = isinstance(base, Random | Jittered | Regular | UniformJitter)
    known = known or (isinstance(base, LatinHypercube) and dims == 1)
    if not known or not all(isinstance(step, Shift | StrataShift) for step in steps):
        raise NoClosedForm(
            f"No exact variance is known for {sampler.spec} in {dims} dims; "
            "use convergence or variance_terms."
        )
    offset = np.zeros(dims)
    for step in steps:
        if isinstance(step, StrataShift):
            offset = offset + np.asarray(step.offset, float)
    return base, offset % 1.0, any(isinstance(step, Shift) for step in steps)
