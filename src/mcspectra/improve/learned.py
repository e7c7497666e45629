"""Importance densities learned from evaluations of an integrand, for the sampler that will be used.

A density p of `mcspectra.densities.learned` is fitted to evaluations f(x_k) at points of density π, by
the least of

    log Σ_k ρ_k p(x_k) − Σ_k w_k log p(x_k) + smoothness,   ρ_k = 1/π(x_k),   w_k ∝ ρ_k |f(x_k)|,

the relative entropy of |f| and p with both integrals as seen by the *same* points: where |f| is of the
family, the least is |f| itself at any number of points, whereas the mean of log p alone has the noise of
the points. Smoothness is a penalty on second differences of the logarithms of the splines' weights
(as of P-splines, [Eilers1996]_). Numbers of cells and parts and the weight of the penalty make candidates, and
those are compared by the variance of f/p with points of the sampler itself, of evaluations not fitted to:
∫f²/p alone does not see how rough f/p is, which is what nets and strata do not remove.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Any, final

import numpy as np

from mcspectra.core.cache import cache_folder
from mcspectra.core.checks import Array, as_choice, as_integer, as_real
from mcspectra.core.decoding import path_to_write
from mcspectra.core.errors import Parameter, ParameterError, writing
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

__all__ = ["LEARNED", "fit_splines", "in_rounds", "learned_density"]

_MOST_DIMS = 24
_LEAST, _USUAL = 256, 2**14  # evaluations
_EACH = 8  # evaluations for each of n points, beside those to fit to: sets of n/4 at least
_FEWEST = 16  # n over the least count to compare candidates at
_MOST_FITTED = 2**13
_BLOCK = 128
_BINS = 512  # of the marginals that the knots come from
_STEPS = 120  # of L-BFGS
_LONGEST = 1.0  # step of a logarithm
_GAIN = 2e-9  # of the function, below which fits end
# Dims up to which flows take them; with more, longer fits cost more and are no better
_ALL_STEPS = 4
_REPLICATES = 6  # at least, of each candidate
_LEAST_WEIGHT = 1e-6  # of a spline to start from
_WORTH = 0.5  # of the variance of uniform points: six sets tell no better, and these are safe
_EACH_GATE = 4  # evaluations of each weight of a flow
_PARTS = 2**16  # stream label of where parts start

# (cells, parts, smoothness) of the candidates of each kind, the one for the first rounds first; 0 parts: a flow
LEARNED: dict[str, tuple[tuple[int, int, float], ...]] = {
    "mixture": ((12, 4, 1e-3), (8, 4, 1e-1), (12, 4, 1e-2), (12, 8, 1e-3)),
    "spline-flow": ((12, 0, 1e-3), (8, 0, 1e-1), (8, 0, 1e-2), (16, 0, 1e-4)),
}
"""Kinds of learned densities, with their candidates."""


# The L-BFGS of samplers: scipy's asks BLAS for threads at each step, which takes 15 times as long as all else
_least = partial(minimize, longest=_LONGEST, gain=_GAIN)


def fit_splines(
    points: Array,
    values: Array,
    pdf: Array,
    setting: tuple[int, int, float],
    defensive: float,
    generator: np.random.Generator,
) -> SplineDensity:
    """Fit a density of splines to values at points.

    Parameters
    ----------
    points, values, pdf
        (N, d); (N, channels), not all 0; density of the points, (N,).
    setting
        Cells of each axis; parts of a mixture, or 0 for a flow; weight of the smoothness.
    defensive
        δ, share of the uniform density.
    generator
        Of the places that parts start from.
    """
    cells, parts, smooth = setting
    # In blocks, whose products are too small for threads: the same bits on every machine's cores
    points, pdf = _padded(points, 0.5), _padded(pdf, np.inf)
    values = _padded(values, 0.0)
    rho = 1.0 / pdf
    w = rho * np.abs(values / np.abs(values).max()).sum(axis=1)
    w, rho = w / w.sum(), rho / rho.sum()

    # Half of the knots where |f| has its mass, and half of them equally spaced
    at, knots = np.linspace(0.0, 1.0, _BINS + 1), np.empty((points.shape[1], cells + 1))
    for line, x in zip(knots, points.T, strict=True):
        mass = np.bincount(np.minimum((x * _BINS).astype(int), _BINS - 1), w, _BINS)
        blend = 0.5 * (at + np.concatenate([[0.0], np.cumsum(mass)]))
        line[:] = np.interp(np.linspace(0.0, 1.0, cells + 1), blend, at)
    knots[:, 0], knots[:, -1] = 0.0, 1.0

    seen = _Seen(
        basis=[_columns(spline_basis(line, x)) for line, x in zip(knots, points.T, strict=True)],
        rho=_in_blocks(rho),
        weight=_in_blocks(w),
        uniform=np.log([spline_lengths(line) for line in knots]),
        defensive=defensive,
        smooth=smooth,
    )

    # Groups of points with the mass of |f|, by Lloyd's method, from which parts start
    own = np.zeros(len(points), np.int64)
    if parts > 1:
        known = min(parts, int(np.count_nonzero(w)))
        seeds = points[generator.choice(len(points), known, p=w, replace=False)]
        for _ in range(8):
            own = ((points[:, None] - seeds) ** 2).sum(axis=-1).argmin(axis=1)
            heavy = np.bincount(own, w, known)
            for j, x in enumerate(points.T):
                sums = np.bincount(own, w * x, known)
                seeds[:, j] = np.where(heavy > 0.0, sums / np.maximum(heavy, 1e-300), seeds[:, j])
    shares, tables = seen.mixture(own, max(parts, 1), _STEPS if parts else _STEPS // 4)
    if parts:
        return SplineDensity(knots=knots, defensive=defensive, shares=shares, tables=np.exp(tables))
    gates = seen.flow(_columns(flow_features(points)), tables[0])
    return SplineDensity(knots=knots, defensive=defensive, gates=gates)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """What fits minimise, of points in blocks."""

    basis: list[Array]  # splines of each axis at the points, (blocks, M, size)
    rho: Array  # ρ and w, (blocks, size), both of sum 1
    weight: Array
    uniform: Array  # logarithms of the weights of the uniform density, (d, M)
    defensive: float
    smooth: float

    def mixture(self, own: Array, count: int, steps: int) -> tuple[Array, Array]:
        """Shares (K,) and logarithms of the tables (K, d, M), from groups of points."""
        from scipy.special import log_softmax, softmax

        # Start from the splines' means over the groups
        tables = np.empty((count, *self.uniform.shape))
        whole = np.maximum(np.bincount(own, self.weight.ravel(), count), 0.1 / count)
        for k in range(count):
            mine = self.weight * _in_blocks(own == k)
            for i, b in enumerate(self.basis):
                found = (mine[:, None] * b).sum(axis=(0, 2)) * np.exp(self.uniform[i])
                found = found / max(found.sum(), 1e-300) + np.exp(self.uniform[i])
                tables[k, i] = np.log(found + _LEAST_WEIGHT)

        def loss(given: Array) -> tuple[float, Array]:
            shares, logits = log_softmax(given[:count]), given[count:].reshape(tables.shape)
            c = softmax(logits, axis=-1)
            inner = [  # of parts, at the points
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

        best = _least(loss, np.concatenate([np.log(whole), tables.ravel()]), iterations=steps)
        return softmax(best[:count]), log_softmax(best[count:].reshape(tables.shape), axis=-1)

    def flow(self, features: Array, start: Array) -> Array:
        """Gates (d, M, 1 + d·DEGREE), from the logarithms of a product's tables (d, M)."""
        shape, before = (*start.shape, features.shape[1]), np.tri(len(start), k=-1, dtype=bool)

        def loss_of(followed: Array) -> tuple[Array, Callable[[Array], tuple[float, Array]]]:
            """Which gates are used, where each axis follows these axes (d, d), and the loss of them."""
            columns = np.insert(np.repeat(followed, DEGREE, axis=1), 0, True, axis=1)
            used = np.broadcast_to(columns[:, None], shape)
            seen = [features[:, c] for c in columns]
            # An axis that follows no other has the same weights at all points
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

        # Follow the axes whose gates would change the product most, as many as the points are enough for
        gates, most = np.zeros(shape), self.rho.size // (_EACH_GATE * shape[1] * DEGREE)
        gates[:, :, 0] = start
        used, loss = loss_of(before)
        slopes = np.zeros(shape)
        slopes[used] = loss(gates[used])[1]
        gain = (slopes[:, :, 1:].reshape(*start.shape, -1, DEGREE) ** 2).sum(axis=(1, 3))
        followed = before & (gain >= np.sort(gain, axis=None)[-min(max(most, 1), gain.size)])
        used, loss = loss_of(followed)
        steps = min(_STEPS, _STEPS * _ALL_STEPS // len(start))
        gates[used] = _least(loss, gates[used], iterations=steps)
        return gates

    def _entropy(self, logarithm: Array) -> tuple[float, Array]:
        """The entropy, and its derivatives by log q at the points."""
        q = np.exp(logarithm)
        p = (1.0 - self.defensive) * q + self.defensive
        mass = float((self.rho * p).sum())
        slope = (self.rho * p / mass - self.weight) * (1.0 - self.defensive) * q / p
        return math.log(mass) - float((self.weight * np.log(p)).sum()), slope

    def _bent(self, logits: Array, axis: int) -> tuple[float, Array]:
        """The penalty, and its derivatives."""
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
        An integrand, also of several channels, its spec, or a function of points (k, d) to (k,).
    kind
        ``"mixture"`` (of products of splines) or ``"spline-flow"`` (splines of each coordinate whose
        weights depend on those before).
    sampler, n
        The points that will be used. The sampler is random.
    dims
        Number of dims, up to 24, where neither f nor the sampler say it.
    evaluations
        Most evaluations of f, 256 or more: half of them, 8192 at most, to fit to, the others to choose by.
        By default 8 n + 8192, 16384 at least.
    defensive
        Least value δ of the density, above 0, below 1: |f|/p is at most |f|/δ.
    rng
        Seed. The same seed gives the same density.
    path
        File to keep the density in, .json. By default in the cache folder.

    Returns
    -------
    Density
        Continuous, with an exact inverse and a continuous warp; its `spec` makes it again from its file.
        ``uniform`` where no candidate halves its variance.

    Raises
    ------
    ParameterError
        Unknown kind; a value out of range; a sampler that is not random; f is NaN or infinite at a point,
        or 0 wherever it was tried; evaluations too few to compare candidates near n.
    CountError
        The sampler has no sets of n points.
    FileFormatError
        The density cannot be written.

    Notes
    -----
    Candidates (`mcspectra.improve.learned.LEARNED`), from smooth to fine, are compared by the variance of f/p with
    six realisations or more of the sampler, at n or the largest count that the evaluations allow: n/16 or more, by
    default usually n/4. The method of fitting is described in `mcspectra.improve.learned`.

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
    d = as_integer("dims", given, least=1, most=_MOST_DIMS)
    source = as_sampler(sampler, d)
    n = source.check_count(n)
    asked = max(_USUAL, _EACH * n + _MOST_FITTED) if evaluations is None else evaluations
    evaluations = as_integer("evaluations", asked, least=_LEAST, most=2**28)
    if source.fixed:
        raise ParameterError(
            f"{source.spec} is the same every time, so that it has no variance; add owen or shift."
        )
    cached = cache_folder() / "densities"
    if chosen is None:
        with writing(cached):
            cached.mkdir(parents=True, exist_ok=True)
    integrand = f if isinstance(f, Integrand) else FunctionIntegrand(function=f, dims=d)
    stream = Stream.from_rng(rng)

    def values_at(x: Array) -> Array:
        """f at points (k, d): (k, channels or 1)."""
        return integrand(x).reshape(len(x), -1)

    # Share out the evaluations: a part to fit to, the rest for sets of the sampler for each candidate
    half, candidates = min(evaluations // 2, _MOST_FITTED), 1 + len(LEARNED[kind])
    allowed = (evaluations - half) // (_REPLICATES * candidates)
    size = min(n, max(allowed, 1))
    while (count := source.nearest_count(size)) > allowed and size > 1:
        size //= 2
    if count > allowed or allowed < n / _FEWEST:
        raise ParameterError(
            f"{evaluations} evaluations are too few to compare {candidates} candidates by {_REPLICATES} "
            f"sets of n/{_FEWEST} points of {source.spec}, n = {n}, or more; give {4 * n} or more."
        )

    # Fit the candidates to their part, from densities that follow f better and better
    made = list[Density]()
    first = LEARNED[kind][0]

    def follow(points: Array, values: Array, pdf: Array) -> Density | None:
        if not values.any():
            return None
        return fit_splines(points, values, pdf, first, defensive, stream.generator(_PARTS))

    sizes = [half // 4, half // 4, half - 2 * (half // 4)]
    seen = in_rounds(values_at, d, sizes, follow, stream)
    if not seen[1].any():
        raise ParameterError(
            f"f is 0 at all {half} points that were tried; give more evaluations, or an integrand "
            "that says where it is not."
        )
    for place, setting in enumerate(LEARNED[kind]):
        report(f"density of {integrand.spec}", 0.3 + 0.1 * place)
        made.append(fit_splines(*seen, setting, defensive, stream.generator(_PARTS)))

    # Choose by the rest
    left = [Uniform(dims=d), *made]
    replicates = (evaluations - half) // (count * len(left))
    u = source.draw_stream(count, stream.child(1), 0, replicates).reshape(-1, d)
    means = []
    for p in left:
        x, pdf = p.sample_pdf(u)
        ratio = values_at(x) / pdf[:, None]
        means.append(ratio.reshape(replicates, count, -1).mean(axis=1))
    scale = np.abs(means).max() or 1.0  # squares of 1e200 would overflow
    variances = (np.array(means) / scale).var(axis=1, ddof=1).sum(axis=-1)
    place = int(np.argmin(variances))
    best = left[place if variances[place] < _WORTH * variances[0] else 0]
    report(f"density of {integrand.spec}", 1.0)
    if not isinstance(best, SplineDensity):
        if chosen is None:
            return best
        best = SplineDensity(
            knots=np.tile([0.0, 1.0], (d, 1)),
            defensive=1.0,
            shares=np.ones(1),
            tables=np.full((1, d, 3), 1.0 / 3.0),
        )

    # Keep it in a file named by what it holds
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
    """Points (N, d), values and densities of points that follow a function better and better.

    After a round `follow` makes of all that is known what the next points come from, with `sample` and
    `pdf`, or None for uniform ones. All points are one sample of the mixture of all densities.
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


def _padded(given: Array, by: float) -> Array:
    """With further entries, so that their number is one of whole blocks."""
    more = [(0, -len(given) % _BLOCK)] + [(0, 0)] * (given.ndim - 1)
    return np.pad(given, more, constant_values=by)


def _in_blocks(given: Array) -> Array:
    return given.reshape(-1, _BLOCK)


def _columns(given: Array) -> Array:
    """Functions at points (N, M), in blocks: (blocks, M, size)."""
    return np.ascontiguousarray(given.reshape(-1, _BLOCK, given.shape[1]).swapaxes(1, 2))
