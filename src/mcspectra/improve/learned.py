"""Importance densities learned from evaluations of an integrand, for a given sampler.

A density p of `mcspectra.densities.learned` is fitted to values f(x_k) of the integrand.
The points x_k are random with the density π. The fit minimizes the following sum over points:

    log Σ_k ρ_k p(x_k) − Σ_k w_k log p(x_k) + smoothness,   ρ_k = 1/π(x_k),   w_k ∝ ρ_k |f(x_k)|.

Without the smoothness term, the sum is the relative entropy of |f| and p, up to a constant.
Both integrals of the relative entropy are estimated from the *same* points.
If |f| belongs to the family of densities p, the minimum is |f| for any number of points.
A fit without the first sum would also adapt p to random clusters and gaps of the points.
The smoothness term is a penalty on second differences of the logarithms of spline weights,
as in P-splines [Eilers1996]_.

A candidate is a density with a given number of cells, number of mixture parts and smoothness.
Candidates are compared by the variance of f/p with points of the sampler itself.
The variances are computed from evaluations that were not used in the fit.
The integral ∫f²/p alone does not measure the roughness of f/p.
The roughness of f/p causes the variance that nets and strata do not remove.
The best candidate is checked on fresh points.
If the best candidate does not beat uniform points, the result is the uniform density.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, final

import numpy as np

from mcspectra.core.cache import cache_folder
from mcspectra.core.checks import Array, as_choice, as_integer, as_real
from mcspectra.core.decoding import path_to_write
from mcspectra.core.errors import NoGainWarning, Parameter, ParameterError, warn, writing
from mcspectra.core.progress import report
from mcspectra.core.streams import RngLike, Stream
from mcspectra.densities import Density, Uniform
from mcspectra.densities.learned import (
    DEGREE,
    Learned,
    SplineDensity,
    flow_features,
    spline_basis,
    spline_lengths,
)
from mcspectra.integrands.base import FunctionIntegrand, Integrand
from mcspectra.integrands.registry import as_integrand
from mcspectra.samplers import Sampler
from mcspectra.samplers.optimised import minimize
from mcspectra.samplers.registry import as_sampler

__all__ = ["LEARNED", "LearnSettings", "fit_splines", "in_rounds", "learned_density"]


@final
@dataclass(frozen=True)
class LearnSettings:
    """Settings of fits of splines, and of the choice between fitted densities."""

    # Settings of the candidates of two kinds: mixtures of splines and spline flows.
    # The first number of a candidate is the number of cells along each axis.
    # The second number of a candidate is the number of parts of a mixture, or 0 for a flow.
    # The third number of a candidate is the weight of the smoothness penalty.
    # The first candidate is also fitted in each round, to place the points of the next round.
    # One candidate is chosen by evaluations that were not used in any fit.
    # If one candidate is left out, the variances of two test functions change by −30 to +6 %.
    # The test functions have a peak in 2-D and two bells in 3-D.
    mixture: tuple[tuple[int, int, float], ...] = (
        (12, 4, 1e-3),
        (8, 4, 1e-1),
        (12, 4, 1e-2),
        (12, 8, 1e-3),
    )
    spline_flow: tuple[tuple[int, int, float], ...] = (
        (12, 0, 1e-3),
        (8, 0, 1e-1),
        (8, 0, 1e-2),
        (16, 0, 1e-4),
    )
    # Maximum number of dims of a learned density. In 24-D, the fit of a flow takes 9 s.
    most_dims: int = 24
    # Least allowed number of evaluations. Half of the 256 evaluations are for the fit.
    # A quarter of the 256 evaluations is for the choice between candidates.
    # To choose between candidates, each candidate is evaluated with six sets of two points.
    # Another quarter of the 256 evaluations checks the result on fresh points.
    least_evaluations: int = 256
    # Largest allowed number of evaluations. Their points in one dim take 2 GB.
    most_evaluations: int = 2**28
    # Least number of evaluations by default.
    # The fit, the choice of a candidate and the check take `most_fitted` evaluations each.
    usual_evaluations: int = 3 * 2**13
    # By default, 16 n evaluations are made in addition to `most_fitted`, for n points.
    # Half of the 16 n evaluations choose one of five candidates, with six sets of n/4 points each.
    # The other 8 n evaluations check the result: 16 sets with the chosen density, 16 uniform sets.
    evaluations_per_point: int = 16
    # A set that compares candidates has at least n points divided by this number.
    # With n/16 points, nets give nearly the same ratios of variances as with n points.
    # With fewer points, nets do not resolve the splines.
    fewest_divisor: int = 16
    # Maximum number of evaluations in a fit.
    # With 2048 instead of 4096 evaluations, variances of two test functions change by −21 to +12 %.
    most_fitted: int = 2**13
    # Number of points in each block into which the sums of a fit are divided.
    # BLAS does not use threads for blocks of 128 points, so all machines compute the same bits.
    block: int = 128
    # Number of bins of the marginal distributions of |f|, which decide where spline knots lie.
    # Half or twice as many bins change the variances of fitted densities by 1 % at most.
    bins: int = 512
    # Number of rounds of Lloyd's method, which groups points to start the parts of a mixture.
    # Half or twice as many rounds change the variances of fitted densities by 5 % at most.
    lloyd_rounds: int = 8
    # Maximum number of steps of L-BFGS in a fit.
    # Half or twice as many steps change the variances of fitted densities by 5 % at most.
    steps: int = 120
    # Largest change of the logarithm of a spline weight in one step of L-BFGS.
    # With the limit 1, a weight changes by a factor of at most e in a step.
    # With the limit 0.5 or 2, the variance of one of the fitted densities falls by 18 %.
    # The variances of all other fitted densities change by 1 % with the limit 0.5 or 2.
    longest: float = 1.0
    # L-BFGS ends if the entropy decreases by less than this number.
    # With values from 2e-10 to 2e-8, variances of fitted densities are the same to three digits.
    gain: float = 2e-9
    # Maximum number of dims in which a flow is fitted with all `steps`.
    # For d dims above this limit, the number of steps is multiplied by 4/d.
    # Longer fits cost more and do not improve the densities.
    most_dims_of_all_steps: int = 4
    # Least number of sets from which the variance of each candidate is estimated.
    # With 6 sets, the logarithm of a ratio of two variances has a standard error of √(4/5) = 0.9.
    least_replicates: int = 6
    # The check of the result compares the variances with the density and with uniform points.
    # In the check, each variance is estimated from at least this number of fresh sets.
    # If a ratio of variances of 16 sets is below 1/2.4, the true ratio is below 1 at 95 %.
    least_checks: int = 16
    # Least effective number (Σ|f|)²/Σf² of uniform points, in the fit and in the check.
    # 16 effective points all miss a peak with a third of ∫|f| with probability e^(−16/3) = 0.5 %.
    # With the limit 4, a fit missed one of three equal peaks, and had 2.3 times the variance.
    least_effective: float = 16.0
    # Weight that is added to every spline at the start of a fit, so that logarithms are finite.
    # With values from 1e-8 to 1e-4, variances of fitted densities differ by 0.3 % at most.
    least_weight: float = 1e-6
    # A density is kept only if it reduces the variance of uniform points to this fraction or less.
    # Variances from six sets have such large errors that a smaller gain is uncertain.
    # If the gain is uncertain, uniform points are the safe choice.
    most_ratio: float = 0.5
    # Least number of evaluations for each weight of a flow.
    # With fewer evaluations, weights would follow the noise of the points.
    # Regressions also need a few evaluations per weight
    # (`mcspectra.improve.improved.RegressionSettings`).
    # In 2-D and 3-D, 2 or 8 evaluations per weight give the same results.
    evaluations_per_gate: int = 4

    def checked(self, name: str, value: object) -> int:
        """Return a number of evaluations, which errors call `name`."""
        least, most = self.least_evaluations, self.most_evaluations
        return as_integer(name, value, least=least, most=most)


_SETTINGS = LearnSettings()
_PARTS = 2**16  # number of the random stream that chooses initial parts of mixtures

LEARNED = {"mixture": _SETTINGS.mixture, "spline-flow": _SETTINGS.spline_flow}
"""Kinds of learned densities, each with its candidates."""


def fit_splines(
    points: Array,
    values: Array,
    pdf: Array,
    setting: tuple[int, int, float],
    defensive: float,
    generator: np.random.Generator,
    *,
    settings: LearnSettings = _SETTINGS,
) -> SplineDensity:
    """Fit a density of splines to the absolute values of an integrand at points.

    Parameters
    ----------
    points, values, pdf
        Points (N, d); values (N, channels), not all 0; and the density of the points, (N,).
    setting
        Number of cells along each axis, number of parts, and weight of the smoothness penalty.
        A mixture has at least one part. If the number of parts is 0, a flow is fitted.
    defensive
        Share δ of the uniform density.
    generator
        Random numbers, which choose initial points for the parts of a mixture.
    settings
        Settings of the fit.
    """
    cells, parts, smooth = setting
    # Fill the last block of points with points of weight 0
    points, values, pdf = (
        _padded(given, by, settings.block)
        for given, by in ((points, 0.5), (values, 0.0), (pdf, np.inf))
    )
    rho = 1.0 / pdf
    w = rho * np.abs(values / np.abs(values).max()).sum(axis=1)
    w, rho = w / w.sum(), rho / rho.sum()

    # Place the knots by two rules with equal weights: equal masses of |f|, and equal distances
    bins = settings.bins
    at, knots = np.linspace(0.0, 1.0, bins + 1), np.empty((points.shape[1], cells + 1))
    for line, x in zip(knots, points.T, strict=True):
        mass = np.bincount(np.minimum((x * bins).astype(int), bins - 1), w, bins)
        blend = 0.5 * (at + np.concatenate([[0.0], np.cumsum(mass)]))
        line[:] = np.interp(np.linspace(0.0, 1.0, cells + 1), blend, at)
    knots[:, 0], knots[:, -1] = 0.0, 1.0

    seen = _Seen(
        basis=[
            _columns(spline_basis(line, x), settings.block)
            for line, x in zip(knots, points.T, strict=True)
        ],
        rho=rho.reshape(-1, settings.block),
        weight=w.reshape(-1, settings.block),
        uniform=np.log([spline_lengths(line) for line in knots]),
        defensive=defensive,
        smooth=smooth,
        settings=settings,
    )

    # Group points by Lloyd's method, with |f| as the mass.
    # Each group of points gives one initial part of the mixture
    own = np.zeros(len(points), np.int64)
    if parts > 1:
        known = min(parts, int(np.count_nonzero(w)))
        seeds = points[generator.choice(len(points), known, p=w, replace=False)]
        for _ in range(settings.lloyd_rounds):
            own = ((points[:, None] - seeds) ** 2).sum(axis=-1).argmin(axis=1)
            heavy = np.bincount(own, w, known)
            for j, x in enumerate(points.T):
                sums = np.bincount(own, w * x, known)
                seeds[:, j] = np.where(heavy > 0.0, sums / np.maximum(heavy, 1e-300), seeds[:, j])
    steps = settings.steps if parts else settings.steps // 4
    shares, tables = seen.mixture(own, max(parts, 1), steps)
    if parts:
        return SplineDensity(knots=knots, defensive=defensive, shares=shares, tables=np.exp(tables))
    gates = seen.flow(_columns(flow_features(points), settings.block), tables[0])
    return SplineDensity(knots=knots, defensive=defensive, gates=gates)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """The function that a fit of splines minimizes; its points are processed in blocks."""

    basis: list[Array]  # values of the splines of each axis at the points, (blocks, M, size)
    rho: Array  # weights ρ and w of the points, (blocks, size); the sum of each is 1
    weight: Array
    uniform: Array  # logarithms of the spline weights of the uniform density, (d, M)
    defensive: float
    smooth: float
    settings: LearnSettings = _SETTINGS

    def mixture(self, own: Array, count: int, steps: int) -> tuple[Array, Array]:
        """Fit the shares (K,) of the parts of a mixture, and their log spline weights (K, d, M)."""
        from scipy.special import log_softmax, softmax

        # Start from the mean values of the splines over the groups of points
        tables = np.empty((count, *self.uniform.shape))
        whole = np.maximum(np.bincount(own, self.weight.ravel(), count), 0.1 / count)
        for k in range(count):
            mine = self.weight * (own == k).reshape(self.weight.shape)
            for i, b in enumerate(self.basis):
                found = (mine[:, None] * b).sum(axis=(0, 2)) * np.exp(self.uniform[i])
                found = found / max(found.sum(), 1e-300) + np.exp(self.uniform[i])
                tables[k, i] = np.log(found + self.settings.least_weight)

        def loss(given: Array) -> tuple[float, Array]:
            shares, logits = log_softmax(given[:count]), given[count:].reshape(tables.shape)
            c = softmax(logits, axis=-1)
            inner = [  # Density of each part at the points
                np.maximum(np.moveaxis(c[:, i] @ b, 1, 0), 1e-300).copy()
                for i, b in enumerate(self.basis)
            ]
            each = shares[:, None, None] + sum(np.log(v) for v in inner)
            most = each.max(axis=0)
            parts = np.exp(each - most)
            total = parts.sum(axis=0)
            value, slope = self._entropy(most + np.log(total))
            mine = slope / total * parts
            held = mine.sum(axis=(1, 2))
            penalty, gradient = self._bent(logits - self.uniform, 2)
            for i, b in enumerate(self.basis):
                seen = ((mine / inner[i]).swapaxes(0, 1) @ b.swapaxes(1, 2)).sum(axis=0)
                gradient[:, i] += c[:, i] * (seen - held[:, None])
            by_shares = held - np.exp(shares) * held.sum()
            return value + penalty, np.concatenate([by_shares, gradient.ravel()])

        best = self._least(loss, np.concatenate([np.log(whole), tables.ravel()]), steps)
        return softmax(best[:count]), log_softmax(best[count:].reshape(tables.shape), axis=-1)

    def flow(self, features: Array, start: Array) -> Array:
        """Fit the coefficients by which the splines of an axis depend on earlier axes."""
        shape, before = (*start.shape, features.shape[1]), np.tri(len(start), k=-1, dtype=bool)

        def loss_of(followed: Array) -> tuple[Array, Callable[[Array], tuple[float, Array]]]:
            """Return a mask of the coefficients that are fitted, and the function to minimize.

            `followed` (d, d) states for each axis on which other axes its density depends.
            """
            columns = np.insert(np.repeat(followed, DEGREE, axis=1), 0, True, axis=1)
            used = np.broadcast_to(columns[:, None], shape)
            seen = [features[:, c] for c in columns]
            # An axis that does not depend on other axes has the same weights at all points
            shown = [f if f.shape[1] > 1 else f[:1, :, :1] for f in seen]

            def loss(given: Array) -> tuple[float, Array]:
                gates = np.zeros(shape)
                gates[used] = given
                chosen, own, joint = [], [], np.zeros(self.rho.shape)
                for b, gate, c, f in zip(self.basis, gates, columns, shown, strict=True):
                    a = gate[:, c] @ f
                    a -= a.max(axis=1, keepdims=True)
                    np.exp(a, out=a)
                    a /= a.sum(axis=1, keepdims=True)
                    chosen.append(a)
                    own.append(np.maximum((a * b).sum(axis=1), 1e-300))
                    joint += np.log(own[-1])
                value, slope = self._entropy(joint)
                gates[:, :, 0] -= self.uniform
                penalty, gradient = self._bent(gates, 1)
                size_of = 0.1 * self.smooth * gates
                size_of[:, :, 0] = 0.0
                gradient += 2.0 * size_of
                for i, (b, a, q) in enumerate(zip(self.basis, chosen, own, strict=True)):
                    rise = b * (slope / q)[:, None]
                    rise -= slope[:, None]
                    rise *= a
                    gradient[i][:, columns[i]] += (rise @ seen[i].swapaxes(1, 2)).sum(axis=0)
                return value + penalty + float((size_of * gates).sum()), gradient[used]

            return used, loss

        # Let the splines of each axis depend on the earlier axes that change the density most.
        # An earlier axis changes the density much if the loss has a large gradient in its weights.
        # The number of points limits how many dependences between axes are fitted
        each = self.settings.evaluations_per_gate
        gates, most = np.zeros(shape), self.rho.size // (each * shape[1] * DEGREE)
        gates[:, :, 0] = start
        used, loss = loss_of(before)
        slopes = np.zeros(shape)
        slopes[used] = loss(gates[used])[1]
        gain = (slopes[:, :, 1:].reshape(*start.shape, -1, DEGREE) ** 2).sum(axis=(1, 3))
        followed = before & (gain >= np.sort(gain, axis=None)[-min(max(most, 1), gain.size)])
        used, loss = loss_of(followed)
        steps = self.settings.steps
        steps = min(steps, steps * self.settings.most_dims_of_all_steps // len(start))
        gates[used] = self._least(loss, gates[used], steps)
        return gates

    def _least(
        self, loss: Callable[[Array], tuple[float, Array]], start: Array, steps: int
    ) -> Array:
        """Minimize the loss by the package's own L-BFGS.

        SciPy's L-BFGS uses threads of BLAS in each step and takes 15 times as long as the rest.
        """
        longest, gain = self.settings.longest, self.settings.gain
        return minimize(loss, start, iterations=steps, longest=longest, gain=gain)

    def _entropy(self, logarithm: Array) -> tuple[float, Array]:
        """Return the relative entropy of f and p, and its derivatives by log q at each point."""
        q = np.exp(logarithm)
        p = (1.0 - self.defensive) * q + self.defensive
        mass = float((self.rho * p).sum())
        slope = (self.rho * p / mass - self.weight) * (1.0 - self.defensive) * q / p
        return math.log(mass) - float((self.weight * np.log(p)).sum()), slope

    def _bent(self, logits: Array, axis: int) -> tuple[float, Array]:
        """Return the smoothness penalty and its derivatives."""
        bend = np.diff(logits, 2, axis=axis)
        back = np.moveaxis(np.zeros_like(logits), axis, 0)
        for shift, factor in enumerate((1.0, -2.0, 1.0)):
            back[shift : len(back) - 2 + shift] += factor * np.moveaxis(bend, axis, 0)
        return self.smooth * float((bend**2).sum()), 2.0 * self.smooth * np.moveaxis(back, 0, axis)


def learned_density(
    f: Any,
    kind: str,
    sampler: Sampler | str,
    n: int,
    *,
    dims: int | None = None,
    evaluations: int | None = None,
    defensive: float = 0.05,
    rng: RngLike = 0,
    path: str | PathLike[str] | None = None,
) -> Density:
    """Learn an importance density for an integrand, a sampler and a number of points.

    Parameters
    ----------
    f
        An integrand with one or more channels, or a spec.
        Instead of an integrand, f may be a function that maps points (k, d) to values (k,).
    kind
        ``"mixture"`` is a mixture of products of splines.
        In a ``"spline-flow"``, the spline weights of a coordinate depend on earlier coordinates.
    sampler, n
        The sampler and the number of points that will be used. The sampler must be random.
    dims
        Number of dims, up to 24. It is needed if neither f nor the sampler has a number of dims.
    evaluations
        Maximum number of evaluations of f, at least 256.
        Half of the evaluations are for the fit, but at most 8192.
        Half of the remaining evaluations are for the choice between candidates.
        The other half of the remaining evaluations are for the check of the chosen density.
        The default is 16 n + 8192, and at least 24576.
    defensive
        Lower bound δ of the density p, between 0 and 1. It limits |f|/p to |f|/δ.
    rng
        Seed (SPEC 7). The same seed gives the same density.
    path
        File for the density, with the suffix .json. The default is a file in the cache folder.

    Returns
    -------
    Density
        A continuous density with an exact inverse and a continuous warp.
        The `spec` of the density contains the path of the file in which the density is stored.
        If no candidate halves the variance of uniform points, the density is ``uniform``.
        The density is also ``uniform`` if fresh points do not confirm the gain.
        If the density is ``uniform``, a `NoGainWarning` is issued.

    Raises
    ------
    ParameterError
        If the kind is unknown, a value is out of range, or the sampler is not random.
        If f is NaN or infinite at a point, or 0 at all points.
        If there are too few evaluations to compare candidates near n.
    CountError
        If the sampler has no sets of n points.
    FileFormatError
        If the file of the density cannot be written.

    Notes
    -----
    Candidate densities (`mcspectra.improve.learned.LEARNED`) range from smooth to fine.
    The variance of f/p is compared for at least six realizations of the sampler.
    Each realization has n points if the evaluations allow it.
    Otherwise, each realization has at least n/16 points, and by default usually n/4.
    The best candidate is checked on fresh points, with at least 16 realizations.
    The check must show with 95 % confidence that the variance is less than for uniform points.
    In addition, ∫f²/p must be smaller than ∫f².
    The effective number (Σ|f|)²/Σf² of uniform points must be at least 16.
    With a smaller effective number of points, peaks of f may be missed.
    `mcspectra.improve.learned` describes the method of fitting.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.integrand("gaussian(width=0.1)", dims=2)
    >>> p = mcs.improve.learned_density(f, "mixture", "sobol | owen", 64, evaluations=4096)
    >>> float(p.pdf([[0.5, 0.5]])[0]) > 4.0
    True
    """
    kind = as_choice("kind", kind, tuple(LEARNED))
    defensive = as_real("defensive", defensive, above=0.0, below=1.0)
    chosen = path_to_write(path, "a file for the density", (".json",))
    given = getattr(sampler, "dims", None) if dims is None else dims
    if isinstance(f, str | Integrand):
        f = as_integrand(f, given)
        given = f.dims
    elif not callable(f):
        raise ParameterError(
            f"f is {f!r:.80}; give an integrand, its spec, or a function of points."
        )
    if given is None:
        raise ParameterError(
            Parameter("dims"),
            " is missing; give the number of dims of the function's points.",
        )
    settings = _SETTINGS
    d = as_integer("dims", given, least=1, most=settings.most_dims)
    source = as_sampler(sampler, d)
    n = source.check_count(n)
    usual = settings.evaluations_per_point * n + settings.most_fitted
    asked = max(settings.usual_evaluations, usual) if evaluations is None else evaluations
    evaluations = settings.checked("evaluations", asked)
    if source.fixed:
        raise ParameterError(
            f"{source.spec} is deterministic, so it has no variance; add owen or shift."
        )
    cached = cache_folder() / "densities"
    if chosen is None:
        with writing(cached):
            cached.mkdir(parents=True, exist_ok=True)
    integrand = f if isinstance(f, Integrand) else FunctionIntegrand(function=f, dims=d)
    stream = Stream.from_rng(rng)

    def values_at(x: Array) -> Array:
        """Return f at points (k, d), as an array (k, channels or 1)."""
        return integrand(x).reshape(len(x), -1)

    # Divide the evaluations between the fit, the choice of a candidate, and its check
    half, candidates = min(evaluations // 2, settings.most_fitted), 1 + len(LEARNED[kind])
    checked = (evaluations - half) // 2
    least = (settings.least_replicates * candidates, 2 * settings.least_checks)
    counts = []
    for given_to, sets in zip((evaluations - half - checked, checked), least, strict=True):
        allowed = given_to // sets
        size = min(n, max(allowed, 1))
        while (count := source.nearest_count(size)) > allowed and size > 1:
            size //= 2
        if count > allowed or allowed < n / settings.fewest_divisor:
            raise ParameterError(
                f"{evaluations} evaluations are too few to compare {candidates} candidates and to "
                f"check the best one by sets of n/{settings.fewest_divisor} points of "
                f"{source.spec}, n = {n}, or more; give {8 * n} or more."
            )
        counts.append(count)

    # Fit the candidates to points whose density approximates f better in each round
    made = list[Density]()
    first = LEARNED[kind][0]

    def follow(points: Array, values: Array, pdf: Array) -> Density | None:
        if not values.any():
            return None
        places = stream.generator(_PARTS)
        return fit_splines(points, values, pdf, first, defensive, places, settings=settings)

    sizes = [half // 4, half // 4, half - 2 * (half // 4)]
    seen = in_rounds(values_at, d, sizes, follow, stream)
    if not seen[1].any():
        raise ParameterError(
            f"f is 0 at all {half} tested points; give more evaluations, or an integrand with "
            "landmarks where it is not 0."
        )
    for place, setting in enumerate(LEARNED[kind]):
        report(f"density of {integrand.spec}", 0.3 + 0.1 * place)
        places = stream.generator(_PARTS)
        made.append(fit_splines(*seen, setting, defensive, places, settings=settings))

    def ratios_at(p: Density, count: int, replicates: int, label: int) -> tuple[Array, Array]:
        """Return points (replicates, count, d) with density p, and the values of f/p."""
        u = source.draw_stream(count, stream.child(label), 0, replicates).reshape(-1, d)
        x, pdf = p.sample_pdf(u)
        ratio = values_at(x) / pdf[:, None]
        return x, ratio.reshape(replicates, count, -1)

    def variances_of(ratios: Sequence[Array]) -> Array:
        """Return the variance over realizations for each density, in an arbitrary unit."""
        means = np.array([ratio.mean(axis=1) for ratio in ratios])
        scale = np.abs(means).max() or 1.0  # Prevents overflow of squares
        return np.asarray((means / scale).var(axis=1, ddof=1).sum(axis=-1))

    # Choose a candidate by its variance, from evaluations that were not used in the fit
    uniform, count = Uniform(dims=d), counts[0]
    replicates = (evaluations - half - checked) // (count * candidates)
    left = [uniform, *made]
    variances = variances_of([ratios_at(p, count, replicates, 1)[1] for p in left])
    place = int(np.argmin(variances))
    best = left[place if variances[place] < settings.most_ratio * variances[0] else 0]
    no_gain = (
        f"no candidate has less than {settings.most_ratio:g} of the variance of uniform points"
    )

    # Check the chosen density on fresh points, by variances of sets and by means of f²/p.
    # If the fit has missed a peak, sets with density p may also miss the peak, but ∫f²/p is large.
    # If only few uniform points have nonzero f, all points may miss other peaks
    if best is not uniform:
        from scipy.special import fdtri

        count = counts[1]
        replicates = checked // (2 * count)
        both = [ratios_at(p, count, replicates, 2) for p in (best, uniform)]
        after, before = variances_of([ratio for _, ratio in both])
        most = float(fdtri(replicates - 1, replicates - 1, 0.95))
        x = np.concatenate([points for points, _ in both])
        pdf = best.pdf(x)
        f_at = np.concatenate([ratio.reshape(len(points), -1) for points, ratio in both])
        f_at[: len(x) // 2] *= pdf[: len(x) // 2, None]
        scale = np.abs(f_at).max() or 1.0
        f_at /= scale
        squares = (f_at**2).sum(axis=1) / (0.5 * (1.0 + pdf))
        met = np.concatenate([seen[1][: sizes[0]] / scale, f_at[len(x) // 2 :]])
        met = np.abs(met).sum(axis=1)
        effective = met.sum() ** 2 / max((met**2).sum(), 1e-300)
        if effective < settings.least_effective:
            best = uniform
            no_gain = (
                f"only about {effective:.0f} of {len(met)} uniform points hit its peaks, and "
                "others may be missed"
            )
        elif not (after * most < before and (squares / pdf).sum() < squares.sum()):
            best = uniform
            no_gain = (
                f"{2 * replicates * count} fresh evaluations do not confirm that the best "
                "candidate has less variance than uniform points"
            )
    report(f"density of {integrand.spec}", 1.0)
    if not isinstance(best, SplineDensity):
        warn(
            f"The density of {integrand.spec} is uniform: {no_gain}; use uniform points, or give "
            f"more than {evaluations} evaluations.",
            NoGainWarning,
        )
        if chosen is None:
            return best
        best = SplineDensity(
            knots=np.tile([0.0, 1.0], (d, 1)),
            defensive=1.0,
            shares=np.ones(1),
            tables=np.full((1, d, 3), 1.0 / 3.0),
        )

    # Store the density in a file that is named by a hash of its content
    text = json.dumps(best.to_dict()) + "\n"
    name = hashlib.sha256(text.encode()).hexdigest()[:32]
    target = cached / f"{name}.json" if chosen is None else chosen
    with writing(target):
        target.write_text(text)
    return Learned(path=str(target))


def in_rounds(
    values_at: Callable[[Array], Array],
    dims: int,
    sizes: Sequence[int],
    follow: Callable[[Array, Array, Array], Any],
    stream: Stream,
) -> tuple[Array, Array, Array]:
    """Return points (N, d) that follow a function better in each round, values and densities.

    Before each round except the first, `follow` fits a density to all evaluations.
    `follow` returns an object with `sample` and `pdf`, or None for uniform points.
    The returned density of all points is the mixture of the densities of all rounds.
    """
    points, values = np.empty((0, dims)), np.empty((0, 1))
    pdf = np.empty(0)
    maps: list[Any] = []
    for index, size in enumerate(sizes):
        u = stream.generator(index).random((size, dims))
        maps.append(follow(points, values, pdf) if index else None)
        x = u if maps[-1] is None else maps[-1].sample(u)
        found = values_at(x).reshape(size, -1)
        points = np.concatenate([points, x])
        values = np.concatenate([values, found]) if index else found
        shares = np.array(sizes[: index + 1]) / sum(sizes[: index + 1])
        pdf = shares @ [np.ones(len(points)) if m is None else m.pdf(points) for m in maps]
    return points, values, pdf


def _padded(given: Array, by: float, block: int) -> Array:
    """Append entries with the value `by` until the length is a multiple of `block`."""
    more = [(0, -len(given) % block)] + [(0, 0)] * (given.ndim - 1)
    return np.pad(given, more, constant_values=by)


def _columns(given: Array, block: int) -> Array:
    """Divide the values of M functions at N points, (N, M), into blocks: (blocks, M, size)."""
    return np.ascontiguousarray(given.reshape(-1, block, given.shape[1]).swapaxes(1, 2))
