"""Contracts of samplers, densities, integrands and analyses, with functions that check them.

User code is called through `called`, which converts exceptions to BrokenContract errors.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.analysis import (
    Analysis,
    MergeTree,
    Need,
    Subject,
    check_names,
    chunks,
    compute_chunk,
    finished,
    steps_of,
)
from mcspectra.core.checks import BELOW_ONE, Array, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import AnalysisError, DensityError, McspectraError, ParameterError
from mcspectra.core.options import checked, options_of
from mcspectra.core.records import pack, unpack
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.densities.adaptive import recurrences
from mcspectra.densities.registry import as_density
from mcspectra.integrands import Integrand, integral_accuracy
from mcspectra.integrands.registry import as_integrand
from mcspectra.samplers import Sampler, as_sampler

__all__ = [
    "BrokenContract",
    "check_analysis",
    "check_density",
    "check_integrand",
    "check_sampler",
]

_FALSE_ALARM = 1e-6
# Largest allowed deviation in standard errors.
# A correct component deviates by more than 7 standard errors with probability 7e-8 (Student's t).
_SPREADS = 7.0
_SAME = 1e-9  # largest relative difference of values and integrals that counts as rounding
_REALIZATIONS, _CELLS = 640, 35  # numbers of realizations and of cells for the uniformity test
_SAMPLES = 20_000
_SIDES = {1: 64, 2: 8}  # number of cells along each axis for counting samples, by dims
_LEAST = 5.0  # smallest expected number of samples per cell, as χ² requires
_RECIPROCAL = 1e-3
_ROUNDING = 1e-12
_REMAINDER = 3.5  # limit for the error of a quadrature, as a multiple of its estimate
_QUADRATURE_DIMS = 3
# If no point falls into a region, the expected number of points is assumed to be at most 20.
# A region with 20 expected points is empty with probability e^-20.
_MISSED = 20.0
_FREQUENCIES = ((1,), (-3,), (0, 2), (1, -1), (4, 7), (2, 1, 0), (0, -1, 3))
_SEED = 7
_NEED_SECONDS = 0.1  # time limit for `need`, which a study calls for every estimator and sampler
_SIZE = 2  # number of blocks in a chunk of an analysis


class BrokenContract(McspectraError, AssertionError):
    """A component violates its contract. The message says how."""


def check_sampler(sampler: Sampler | str, *, counts: tuple[int, ...] = (16, 64)) -> None:
    """Check a sampler against the contract of all samplers.

    Parameters
    ----------
    sampler
        The sampler, or its spec string.
    counts
        Numbers of points to try. They are rounded to the nearest possible numbers.

    Raises
    ------
    BrokenContract
        If the points are not float64 of shape (R, n, dims) in [0,1).
        If a realization depends on the call that draws it, or realizations of a fixed set differ.
        If a count returned by `nearest_count` cannot be drawn.
        If a sampler claims to be unbiased, but its points are not uniform over all realizations.
        False alarms have a probability of 1e-6.

    Examples
    --------
    >>> check_sampler("jittered | shift")
    """
    source = as_sampler(sampler)
    if not isinstance(counts, Iterable):
        raise ParameterError(f"counts is {shown(counts)}; give a list of numbers of points.")
    for each in counts:
        n = source.nearest_count(as_integer("counts", each, least=1))
        who = f"{source.spec} with n = {n}"

        # Check type, shape and range of the points
        points = source.draw(n, realizations=3, rng=1)
        kind, wanted = type(points).__name__, (3, n, source.dims)
        demand(isinstance(points, np.ndarray), who, f"gives {kind}, not an array")
        demand(points.shape == wanted, who, f"gives shape {points.shape}, not {wanted}")
        demand(points.dtype == np.float64, who, f"gives {points.dtype}, not float64")
        low, high = float(points.min()), float(points.max())
        demand(low >= 0.0 and high < 1.0, who, f"gives points from {low} to {high}, not in [0,1)")

        # Any call gives the same realizations, and all realizations of a fixed set are equal
        whole = source.draw(n, realizations=6, rng=7)
        for first, count in ((0, 1), (1, 3), (5, 1)):
            part = source.draw(n, realizations=count, rng=7, first=first)
            same = np.array_equal(part, whole[first : first + count])
            demand(same, who, f"gives different points for realization {first} in another call")
        same = not source.fixed or bool((whole == whole[0]).all())
        demand(same, who, "is declared fixed, but its realizations are different sets")
        if not source.unbiased:
            continue

        # Compare the mean number of points per cell with n / (number of cells).
        # There are 35 cells per axis, and 5 × 7 cells per pair of neighboring axes,
        # because few samplers have strata of the same size.
        # The error of each mean is computed from the spread over realizations,
        # so the error includes the dependence between the points of a set.
        # The spread may be 0 by chance, if a cell has the same count in all realizations.
        # Therefore the spread is at least the value for counts that vary in one realization only
        from scipy.stats import norm

        points = source.draw(n, realizations=_REALIZATIONS, rng=20)
        coarse, fine = np.floor(5 * points), np.floor(7 * points)
        dims, least = points.shape[2], math.sqrt(n / _CELLS / _REALIZATIONS)
        numbers = [np.floor(_CELLS * points[..., j]) for j in range(dims)]
        pairs = range(dims if dims > 1 else 0)
        numbers += [7 * coarse[..., j] + fine[..., (j + 1) % dims] for j in pairs]
        found = []
        for cells in numbers:
            hits = np.stack([(cells == cell).sum(axis=1) for cell in range(_CELLS)])
            error = np.maximum(hits.std(axis=1, ddof=1), least) / math.sqrt(_REALIZATIONS)
            found.append((hits.mean(axis=1) - n / _CELLS) / error)
        worst, tests = float(np.abs(found).max()), np.size(found)
        demand(
            -np.expm1(tests * np.log1p(-2 * norm.sf(worst))) > _FALSE_ALARM,
            who,
            f"is declared unbiased, but its points are not uniform ({worst:.3g} standard errors in "
            f"one of {tests} cells)",
        )


def check_density(density: Density | str, *, dims: int | None = None) -> None:
    """Check a density against the contract of all densities.

    Parameters
    ----------
    density
        The density, or its spec string.
    dims
        Number of dims, if the spec string has no ``dims``.

    Raises
    ------
    BrokenContract
        If pdf, sample or invert raise, return a wrong shape or type, or change their input.
        If pdf is negative, not finite or does not integrate to 1.
        If samples leave [0,1), have density 0, or do not follow the pdf (false alarms: 1e-6).
        If invert is not the inverse of sample, or breaks are not ascending numbers inside (0, 1).
        If the reported integral of 1/p, `reciprocal_integral`, is wrong.

    Notes
    -----
    In 1-D and 2-D, samples are counted in cells (Pearson's χ²), in addition to `Density.check`.
    The documentation of `Density.check` describes which errors are found in more dims.

    Examples
    --------
    >>> check_density("linear(slope=1)", dims=1)
    """
    given = as_density(density, dims)
    if given is None:
        raise BrokenContract("None is not a density; give a density or its spec.")
    who, u = given.spec, recurrences(given.primary_dims, key=1)
    u[0, 0] = 0.0
    u[0, 1] = BELOW_ONE

    # Check types and shapes of the results of sample, pdf and invert for an array of 3 × 5 points
    few = u[:3, :5]
    x = values_at(who, "sample", given.sample, few, (*few.shape[:-1], given.dims))
    low, high = float(x.min()), float(x.max())
    demand(low >= 0.0 and high < 1.0, who, f"gives samples from {low} to {high}, not in [0,1)")
    values_at(who, "pdf", given.pdf, x, x.shape[:-1])
    if given.has_inverse:
        values_at(who, "invert", given.invert, x, few.shape)
    check_breaks(who, given.breaks, given.primary_dims)

    # Convert errors that `Density.check` finds to broken contracts
    try:
        called(who, "check", given.check)
    except BrokenContract as error:
        if isinstance(error.__cause__, DensityError):
            raise BrokenContract(str(error.__cause__)) from error.__cause__
        raise
    x = given.sample(u[0, 2:])  # skip corners of the cube, where the pdf may be 0
    zero = ~(given.pdf(x) > 0.0)
    demand(not zero.any(), who, f"gives the sample {x[zero][:1].tolist()} of density 0")

    # Count samples in cells (Pearson's χ²). Cells with zero probability must stay empty
    if given.dims <= 2:
        from scipy.stats import chi2

        from mcspectra.densities.adaptive import integrate

        side = _SIDES[given.dims]
        x = given.sample(np.random.default_rng(7).random((_SAMPLES, given.primary_dims)))
        expected = _SAMPLES * integrate(given._pdf, given.dims, cells=side).cells
        place = np.minimum((x * side).astype(int), side - 1)
        index = place @ side ** np.arange(given.dims)[::-1]
        counts = np.bincount(index, minlength=side**given.dims)
        full = expected > _LEAST
        rest, none = counts[~full].sum(), expected[~full].sum()
        statistic = float((((counts - expected) ** 2)[full] / expected[full]).sum())
        p = float(chi2.sf(statistic, max(int(full.sum()) - (not none), 1)))
        demand(
            p > _FALSE_ALARM and bool(abs(rest - none) <= _SPREADS * np.sqrt(none) + _LEAST),
            who,
            f"gives samples that do not follow its pdf (χ² = {statistic:.4g} in {full.sum()} "
            "cells)",
        )

    # ∫1/p must be at least 1 (Jensen). If the means over points are finite, it must agree with them
    if type(given).reciprocal_integral is Density.reciprocal_integral:
        return
    found = called(who, "reciprocal_integral", given.reciprocal_integral)
    demand(found >= 1.0 - _SAME, who, f"gives {found} for ∫1/p, less than 1")
    with np.errstate(divide="ignore", over="ignore"):
        values = 1.0 / given.pdf(recurrences(given.dims, key=1))
    if np.isfinite(found) and np.isfinite(values).all():
        mean, spread = mean_and_error(values)
        allowed = _SPREADS * spread + _RECIPROCAL * mean
        # Near a zero of p, the mean of a few points is usually too low, which is not an error
        short = bool(mean < found and spread > _RECIPROCAL * mean)
        demand(
            short or bool(abs(mean - found) <= allowed),
            who,
            f"gives {found:.6g} for ∫1/p, but points give {mean:.6g} ± {spread:.2g}",
        )


def check_integrand(integrand: Integrand | str, *, dims: int | None = None) -> None:
    """Check an integrand against the contract of all integrands.

    Parameters
    ----------
    integrand
        The integrand, or its spec string.
    dims
        Number of dims, if the spec string has no ``dims``.

    Raises
    ------
    BrokenContract
        If values, integral or coefficients raise, have a wrong shape or type, or are not finite.
        If a value depends on other points, or the input is changed.
        If breaks are not ascending numbers inside (0, 1).
        If a closed form (integral, coefficients, means over boxes) does not agree with the values.
        False alarms have a probability of about 1e-6.

    Notes
    -----
    Closed forms are compared with means over 32 shifted sets of 4096 points.
    In up to three dims, closed forms may differ from the means by up to seven standard errors.
    Beyond seven standard errors, closed form and mean are also compared with a quadrature.
    Errors of a closed form below these limits are not detected.
    If f differs from 0 in less than 1e-4 of the domain, points may miss this region.
    For such a small region, `Integrand.landmarks` must return a point where f is not 0.

    Examples
    --------
    >>> check_integrand("gaussian(width=0.3)", dims=2)
    """
    f = as_integrand(integrand, dims)
    who, x = f.spec, recurrences(f.dims, key=1)
    few, one = x[:3, :5], np.ones((*x.shape[:-1], 1))
    channels = (f.channels,) if f.channels else ()
    values = values_at(who, "its values", f, few, (*few.shape[:-1], *channels))
    demand(bool(np.isfinite(values).all()), who, "gives values that are not finite")
    check_breaks(who, f.breaks, f.dims)

    # Check the integral
    found = np.asarray(called(who, "its integral", lambda: f.integral))
    demand(found.shape == channels, who, f"has an integral of shape {found.shape}")
    demand(bool(np.isfinite(found).all()), who, "has an integral that is not finite")
    if f._integral() is not None:
        _compare(f, "an integral", found[..., None], x, one)

    # Check coefficients of the class: f_0 = ∫f, f_−m = conj f_m, and agreement with points
    m = np.array([row + (0,) * (f.dims - len(row)) for row in _FREQUENCIES if len(row) <= f.dims])
    if called(who, "its coefficients", f._fourier, np.zeros((1, f.dims))) is not None:
        found = called(who, "its coefficients", f.fourier, m.reshape(1, -1, f.dims))
        wanted = (1, len(m), *channels)
        demand(found.shape == wanted, who, f"has coefficients of shape {found.shape}, not {wanted}")
        demand(found.dtype == np.complex128, who, f"has coefficients {found.dtype}, not complex128")
        dc = called(who, "its coefficients", f.fourier, np.zeros((1, f.dims)))[0]
        limit = 1e-9 * (1.0 + float(np.abs(np.asarray(f.integral)).max()))
        same = bool(np.abs(dc - f.integral).max() <= limit)
        demand(same, who, "has a coefficient f_0 that is not its integral")
        mirrored = called(who, "its coefficients", f.fourier, -m)
        same = bool(np.abs(mirrored - found[0].conj()).max() <= limit)
        demand(same, who, "has coefficients with f_-m ≠ conj(f_m)")
        angle = 2.0 * np.pi * (x @ m.T)
        values = found[0].T if f.channels else found[0]
        _compare(f, "coefficients", values.real, x, np.cos(angle))
        _compare(f, "coefficients", values.imag, x, -np.sin(angle))

    # Check the means of f and f² over boxes with irregular borders, and over the whole domain
    low = np.stack([np.zeros(f.dims), np.full(f.dims, 0.17), np.linspace(0.03, 0.4, f.dims)])
    high = np.stack([np.ones(f.dims), np.full(f.dims, 0.61), np.full(f.dims, 0.97)])
    found = called(who, "box_moments", f.box_moments, low, high)
    for power, part in enumerate(found or (), 1):
        shape = np.shape(part)
        demand(shape == (len(low), *channels), who, f"has box moments of shape {shape}")
        for claimed, a, b in zip(np.asarray(part), low, high, strict=True):
            box = _Restricted(f, tuple(a), tuple(b), power)
            _compare(box, "box moments", claimed[..., None], x, one)


@final
@dataclass(frozen=True, eq=False)
class _Restricted(Integrand):
    """Restriction of another integrand, or of its square, to a box. It has no closed forms."""

    name: ClassVar[str] = "seen"
    inner: Integrand
    low: tuple[float, ...]
    high: tuple[float, ...]
    power: int = 1

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims, the same as without the restriction to a box."""
        return self.inner.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Number of channels, the same as without the restriction to a box."""
        return self.inner.channels

    @property
    def spec(self) -> str:
        """Spec of the integrand without the restriction to a box."""
        return self.inner.spec

    def landmarks(self) -> Array:
        """Return the landmarks inside the box: points in small regions where f may differ from 0.

        The points have coordinates relative to the box.
        """
        low, high = np.array(self.low), np.array(self.high)
        places = (self.inner.landmarks() - low) / (high - low)
        return np.asarray(places[((places >= 0.0) & (places <= 1.0)).all(axis=1)])

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Return the breaks of the integrand inside the box, in coordinates of the box."""
        ends = zip(self.inner.breaks, self.low, self.high, strict=True)
        return tuple(tuple((c - a) / (b - a) for c in axis if a < c < b) for axis, a, b in ends)

    def _evaluate(self, x: Array) -> Array:
        low, high = np.array(self.low), np.array(self.high)
        values: Array = self.inner(np.minimum(low + (high - low) * x, 1.0)) ** self.power
        return values


def _compare(f: Integrand, what: str, claimed: Array, x: Array, factors: Array) -> None:
    """Compare closed forms (..., k) with the means of values × factors (sets, points, k)."""
    values = called(f.spec, "its values", f, x)
    products = values[..., None] * (factors[..., None, :] if f.channels else factors)
    mean, error = mean_and_error(products)
    rounding = _ROUNDING * (1.0 + float(np.abs(values).max()))
    allowed = _SPREADS * error + rounding
    places = f.landmarks()
    if not values.any() and len(places):  # no point fell into the region with the largest values
        largest = float(np.abs(f(places)).max())
        allowed = allowed + largest * _MISSED / values.shape[0] / values.shape[1]
    off = ~(np.abs(claimed - mean) <= allowed)
    if not off.any():
        return
    # Points may miss a small region, so also compare with a quadrature of the values
    agree = False
    if factors.shape[-1] == 1 and f.dims <= _QUADRATURE_DIMS:
        seen = f if isinstance(f, _Restricted) else _Restricted(f, (0.0,) * f.dims, (1.0,) * f.dims)
        limit = _REMAINDER * integral_accuracy(seen)[1] + 1e-13
        agree = bool(np.abs(np.asarray(seen.integral) - claimed[..., 0]).max() <= limit)
    claim, found, spread = (float(a[off][0]) for a in (claimed, mean, error))
    demand(
        agree,
        f.spec,
        f"has {what} in conflict with its values: {claim:.6g}, but points give {found:.6g} "
        f"± {spread:.2g}",
    )


def check_analysis(analysis: Analysis, estimator: Any = None, sampler: Any = "jittered") -> None:
    """Check an analysis against the contract of all analyses.

    Parameters
    ----------
    analysis
        The analysis, with options that make it quick to compute.
        The analysis should have more than one block, so that merging is also checked.
    estimator, sampler
        Subject of the analysis. The estimator may be an integrand (default: 2-D `gaussian`).
        Spec strings are accepted. Some analyses also take lists of samplers.

    Raises
    ------
    BrokenContract
        If an option has no description, a reserved name, or a default outside its limits.
        If `need` raises an error, is slow or is not finite.
        If keys of reductions repeat, or if `part` lacks a key.
        If the state of a reduction changes when it is stored as bytes and read again.
        If results depend on chunks, differ for the same seed, or have undeclared variables.

    Examples
    --------
    >>> from mcspectra.measure.converge import Convergence
    >>> check_analysis(Convergence(counts=(4, 16), realizations=50))
    """
    from mcspectra.estimators import as_subject

    if not isinstance(analysis, Analysis):
        raise ParameterError(f"{shown(analysis)} is not an analysis; give an Analysis instance.")
    kind = type(analysis)
    who = kind.__name__
    subject = as_subject("gaussian" if estimator is None else estimator, sampler, lists=True)
    if analysis.about != "estimator":
        subject = Subject(None, subject.sampler)

    # Check the options of the analysis
    demand(bool(kind.summary()), who, "has no docstring; its first line is the summary")
    try:
        check_names(kind)
    except AnalysisError as error:
        raise BrokenContract(str(error)) from error
    for option in options_of(kind):
        demand(bool(option.meaning), who, f"has the option {option.name} without a meaning")
        if not option.required:
            called(who, f"the default of {option.name}", option.check, option.default)
    clean: Analysis = called(who, "its options", checked, analysis)

    # Check the resources that the analysis claims to need. Integrands import this module at their
    # first use, which is not time of `need`
    import scipy.special  # noqa: F401

    start = time.process_time()
    need = called(who, "need", clean.need, subject)
    demand(isinstance(need, Need), who, f"returns {need!r} from need, not a Need")
    finite = math.isfinite(need.cost) and need.cost >= 0 and need.memory >= 0
    demand(finite, who, f"returns {need!r} from need, which is not finite")
    spent = time.process_time() - start
    demand(spent < _NEED_SECONDS, who, f"takes {spent:.2g} s in need")

    # Compute the result twice, in two ways
    first, again = (pack(_computed(clean, subject, who, size)) for size in (0, _SIZE))
    demand(first == again, who, "gives different results in chunks, or for the same seed")


def _computed(analysis: Analysis, subject: Subject, who: str, size: int) -> Any:
    """Compute the result from single blocks, or, if `size` > 0, from chunks stored as bytes."""
    stream = Stream.from_rng(_SEED)
    steps = steps_of(analysis, subject, stream)
    states: list[Any] | None = None
    try:
        while True:
            found = next(steps) if states is None else steps.send(states)
            states = []
            for each in found:
                part = called(who, "part", analysis.part, subject, stream, each.key)
                reduction, tree = part if size else each, MergeTree[Any]()
                for chunk in chunks(reduction.blocks, size or 1):
                    state = called(who, "block", compute_chunk, reduction, chunk)
                    if size:
                        payload = called(who, "a state as bytes", pack, state)
                        state = called(who, "a state from bytes", unpack, reduction.kind, payload)
                        same = pack(state) == payload
                        demand(same, who, "has a state that changes when it is stored as bytes")
                    called(who, "merging states", tree.add, state, chunk[1])
                states.append(called(who, "merging states", tree.total))
    except AnalysisError as error:
        raise BrokenContract(str(error)) from error
    except StopIteration as end:
        return called(who, "its variables", finished, analysis, end.value, _SEED)


def demand(holds: bool, who: str, sentence: str) -> None:
    """Raise a BrokenContract with the message ``who sentence``, unless `holds` is true."""
    if not holds:
        raise BrokenContract(f"{who} {sentence}.")


def called(who: str, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function. An exception is converted to a BrokenContract that names `what`."""
    try:
        # Floating-point warnings are ignored, because later checks find values that are not finite
        with np.errstate(all="ignore"):
            return function(*arguments)
    except BrokenContract:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()).rstrip(".") or "no message"
        raise BrokenContract(f"{who} fails in {what}: {type(error).__name__}: {reason}.") from error


def values_at(
    who: str, what: str, function: Callable[[Array], Any], points: Array, shape: tuple[int, ...]
) -> Array:
    """Return the values of a function at points (sets, points, d), and check them.

    The values must be float64 with the given shape, and the input must not change.
    Each value must depend only on its own point.
    """
    before = points.copy()
    found = called(who, what, function, points)
    demand(np.array_equal(points, before), who, f"changes the points given to {what}")
    demand(
        isinstance(found, np.ndarray), who, f"gives {type(found).__name__} in {what}, not an array"
    )
    demand(found.shape == shape, who, f"gives shape {found.shape} in {what}, not {shape}")
    demand(found.dtype == np.float64, who, f"gives {found.dtype} in {what}, not float64")
    alone = called(who, what, function, points[1, 2])
    largest = float(np.max(np.abs(found), where=np.isfinite(found), initial=0.0))
    same = np.allclose(alone, found[1, 2], rtol=0.0, atol=_SAME * largest, equal_nan=True)
    demand(same, who, f"gives different values in {what} for a point alone and among others")
    return np.asarray(found)


def check_breaks(who: str, breaks: Any, axes: int) -> None:
    """Check that the breaks of each axis are ascending numbers inside (0, 1)."""
    demand(len(breaks) == axes, who, f"has breaks for {len(breaks)} axes, not {axes}")
    for axis in breaks:
        fits = list(axis) == sorted(set(axis)) and all(0.0 < b < 1.0 for b in axis)
        demand(fits, who, f"has breaks {axis!r}, which do not ascend within (0, 1)")


def mean_and_error(values: Array) -> tuple[Array, Array]:
    """Return the mean of values (sets, points, ...), and its standard error from the sets."""
    means = values.mean(axis=1)
    return means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))
