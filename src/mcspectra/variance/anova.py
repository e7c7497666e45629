"""ANOVA of a variance in many dims: which axes, alone or together, the noise comes from.

With the ANOVA decomposition f = Σ_u f_u over subsets u of the axes, an estimate is the sum of the means I_u
of f_u over the points, and Var(I) = Σ_u c_u, c_u = Cov(I_u, I): as the contribution map does for frequencies.
For random points c_u = σ²_u/n; a sampler that is good in a projection takes c_u away.

Method: pick-freeze [Sobol2001]_ of whole point sets. Keep the coordinates u of all points, and
replace the others by those of an independent set of the same sampler, its points in random order. Given
the first set, the mean over the second is Σ_{v⊆u} I_v; so the covariance of the two estimates is
Σ_{v⊆u} c_v, and inclusion-exclusion leaves c_u. That of the empty u is 0, but its sample is taken off
all others: most of their errors are in it too, and shares near 1 are then precise. No coefficient
of f is needed, d may be large, and the error is that of a covariance over realisations.

Effective dimension [Caflisch1997]_: in the truncation sense the least s such that the first s axes, in
the superposition sense such that subsets of up to s axes, hold 99 % of the variance.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import (
    MAX_REALIZATIONS,
    Block,
    available_workers,
    realization_blocks,
)
from mcspectra.core.results import dataset
from mcspectra.core.staged import compute
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Moments, as_estimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.variance.staged_anova import StagedAnova

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["EFFECTIVE_SHARE", "anova_variances", "staged_anova"]

EFFECTIVE_SHARE = 0.99
"""Share of the variance that effective dimensions hold."""

_MAX_DIMS = 64
_MAX_VALUES = 2**26  # estimates kept: 0.5 GiB
_PARTNER, _ORDER, _UNIFORM = 0x616E6F, 0x616E70, 0x616E71  # stream labels


def anova_variances(
    estimator: Any,
    sampler: Sampler | str = "random",
    n: int = 1,
    *,
    order: int = 2,
    realizations: int = 10_000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Decompose the variance of an estimate by the axes of its primary space.

    Parameters
    ----------
    estimator, sampler, n
        What is analysed, in up to 64 dims. Random sampling with n = 1, the default, gives the ANOVA
        variances σ²_u of the integrand itself.
    order
        1 or 2: list subsets of up to so many axes.
    realizations
        Independent pairs of point sets, at least 2.
    rng
        Seed (SPEC 7). Realisation r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``anova_variance(subset)`` c_u, with ``_se``, and ``anova_share(subset)`` of the variance (as the
        same pairs give it, so that all shares sum to 1);
        ``total_variance(axis)``, the sum of c_u of all u that hold the axis, with ``_se``;
        ``higher_order_variance``, what subsets beyond `order` have, with ``_se``;
        ``truncation_share(axes)`` of the first so many axes; ``effective_dimension_truncation``,
        ``effective_dimension_superposition`` (NaN beyond `order`) and ``mean_dimension``, the mean
        of |u| weighted by c_u; ``variance`` and ``variance_ci``. A dim channel where f has several.

    Raises
    ------
    ParameterError, CountError
        A value is out of range, or the estimates would not fit in memory.

    Notes
    -----
    O(R n d²) evaluations for order 2, O(R n d) for 1. c_u may be negative: of correlated parts, or by
    noise within its standard error. Sets that are given (`Sampler.from_points`) have no
    independent partners; random points take their part, with larger errors.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> parts = mcs.anova_variances(mcs.Estimator("linear", dims=3), realizations=1000, rng=1)
    >>> [round(float(share), 6) for share in parts["anova_share"][:3]]
    [1.0, 0.0, 0.0]
    """
    threads = available_workers(workers)
    return compute(
        staged_anova(estimator, sampler, n, order=order, realizations=realizations, rng=rng),
        threads,
        "anova_variances",
    )


def staged_anova(
    estimator: Any,
    sampler: Sampler | str = "random",
    n: int = 1,
    *,
    order: int = 2,
    realizations: int = 10_000,
    rng: RngLike = 0,
) -> StagedAnova:
    """Return `anova_variances` as a staged analysis, its arguments checked."""
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    order = as_integer("order", order, least=1, most=2)
    realizations = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    subsets = _Subsets.of(as_integer("dims", estimator.dims, least=1, most=_MAX_DIMS), order)
    _check_memory(len(subsets.masks) * max(1, estimator.channels), realizations)
    stream = Stream.from_rng(rng)
    pairs = _Pairs(estimator, source, n, stream, _ignores_streams(source, n, stream))

    def block_estimates(block: Block) -> Array:
        return pairs.estimates(subsets.masks, block)

    def result(estimates: Array) -> xr.Dataset:
        return _labelled(
            subsets,
            estimates,
            scalar=estimator.channels == 0,
            estimator=estimator.spec,
            sampler=source.spec,
            n=n,
            realizations=realizations,
            order=order,
            effective_share=EFFECTIVE_SHARE,
            stream_key=f"{stream.key:#x}",
            seed=rng if isinstance(rng, int) else None,
        )

    numbers = 4 * n * estimator.dims * sum(estimator.counts)
    cost = float(len(subsets.masks) * realizations * n * sum(estimator.counts))
    return StagedAnova(block_estimates, realization_blocks(realizations, numbers), cost, result)


@dataclass(frozen=True)
class _Subsets:
    """The subsets of axes that are frozen.

    Attributes
    ----------
    masks
        All of them, each once, the full and the empty set first: bool (S, d).
    listed
        Those of up to `order` axes, by size.
    """

    masks: Array
    listed: tuple[tuple[int, ...], ...]

    @staticmethod
    def of(dims: int, order: int) -> _Subsets:
        axes = range(dims)
        listed = [u for size in range(1, order + 1) for u in itertools.combinations(axes, size)]
        without = [tuple(a for a in axes if a != i) for i in axes]
        first = [tuple(range(s)) for s in range(1, dims)]
        every = dict.fromkeys([tuple(axes), (), *listed, *without, *first])
        masks = np.array([[a in u for a in axes] for u in every])
        return _Subsets(masks, tuple(listed))

    def place(self, subset: tuple[int, ...]) -> int:
        """Where a subset is among the masks."""
        wanted = np.isin(np.arange(self.masks.shape[1]), subset)
        return int(np.flatnonzero((self.masks == wanted).all(axis=1))[0])


@dataclass(frozen=True)
class _Pairs:
    """Pairs of independent sets, whose coordinates are exchanged."""

    estimator: AbstractEstimator
    sampler: Sampler
    n: int
    stream: Stream
    uniform: bool

    def estimates(self, masks: Array, block: Block) -> Array:
        """Estimates with the axes of each mask kept and the others replaced: (S, R, channels)."""
        kept = self.estimator.draw(self.sampler, self.n, self.stream, *block)
        others = self._partners(block)
        found = [
            self.estimator.estimate(
                [np.where(mask, x, y) for x, y in zip(kept, others, strict=True)]
            )
            for mask in masks
        ]
        return np.stack(found).reshape(len(masks), block[1], -1)

    def _partners(self, block: Block) -> list[Array]:
        """Independent sets, each in an order of its own."""
        if self.uniform:
            return self.estimator.draw(
                as_sampler("random", self.sampler.dims), self.n, self.stream.child(_UNIFORM), *block
            )
        drawn = self.estimator.draw(self.sampler, self.n, self.stream.child(_PARTNER), *block)
        return [self._shuffled(y, t, block) for t, y in enumerate(drawn)]

    def _shuffled(self, points: Array, technique: int, block: Block) -> Array:
        keys = self.stream.child(_ORDER).child(technique).uniforms(*block, points.shape[1])
        return np.take_along_axis(points, keys.argsort(axis=1)[:, :, None], axis=1)


def _ignores_streams(sampler: Sampler, n: int, stream: Stream) -> bool:
    """Whether the sampler makes the same set of any stream, so that it has no independent partner."""
    first = sampler.draw_stream(n, stream, 0, 1)
    return np.array_equal(first, sampler.draw_stream(n, stream.child(_PARTNER), 0, 1))


def _check_memory(columns: int, realizations: int) -> None:
    if columns * realizations > _MAX_VALUES:
        raise ParameterError(
            f"{realizations} realisations of {columns} subsets take "
            f"{8 * columns * realizations / 2**30:.3g} GiB; ask for at most "
            f"{_MAX_VALUES // columns} realisations, or for order=1."
        )


@dataclass(frozen=True)
class _Covariances:
    """Products of deviations, whose means over realisations are covariances: (S, R, channels)."""

    products: Array

    @staticmethod
    def of(estimates: Array) -> _Covariances:
        deviation = estimates - estimates.mean(axis=1, keepdims=True)
        count = estimates.shape[1]
        return _Covariances(deviation * (deviation[0] * (count / (count - 1))))

    def combined(self, weights: Array) -> tuple[Array, Array]:
        """Linear combinations (U, S) of the covariances, and their standard errors: (U, channels)."""
        found = [np.tensordot(row, self.products, axes=1) for row in weights]
        count = self.products.shape[1]
        means = np.stack([q.mean(axis=0) for q in found])
        return means, np.stack([q.std(axis=0, ddof=1) for q in found]) / np.sqrt(count)


def _weights(subsets: _Subsets) -> dict[str, Array]:
    """Combinations (., S) of the covariances that estimate each variance."""
    unit = np.eye(len(subsets.masks))
    axes = tuple(range(subsets.masks.shape[1]))

    def below(u: tuple[int, ...]) -> Array:
        """Of all subsets of u."""
        return np.asarray(unit[subsets.place(u)] - unit[subsets.place(())])

    def part(u: tuple[int, ...]) -> Array:
        return below(u) - sum((below((a,)) for a in u if len(u) > 1), np.zeros(len(unit)))

    parts = np.stack([part(u) for u in subsets.listed])
    return {
        "anova_variance": parts,
        "total_variance": np.stack(
            [below(axes) - below(tuple(a for a in axes if a != i)) for i in axes]
        ),
        "higher_order_variance": below(axes)[None] - parts.sum(axis=0),
        "first": np.stack([below(axes[: s + 1]) for s in axes]),
    }


def _labelled(
    subsets: _Subsets, estimates: Array, *, scalar: bool, **provenance: Any
) -> xr.Dataset:
    """Make the dataset of all combinations."""
    covariances, moments = _Covariances.of(estimates), Moments.of(estimates[0])
    found = {name: covariances.combined(w) for name, w in _weights(subsets).items()}
    first, own = found.pop("first")[0], found["anova_variance"][0]
    varies = moments.variance > rounding_floor(moments.mean)
    whole = np.where(varies, first[-1], np.nan)  # the variance, by the same pairs
    sizes = np.array([len(u) for u in subsets.listed])
    by_size = np.stack([own[sizes <= s].sum(axis=0) for s in range(1, sizes.max() + 1)])
    dims = {"anova_variance": ("subset",), "total_variance": ("axis",)}
    variables: dict[str, tuple[tuple[str, ...], Any]] = {}
    for name, (values, errors) in found.items():
        own_dims = (*dims.get(name, ()), "channel")
        scalars = name not in dims
        variables[name] = (own_dims, values[0] if scalars else values)
        variables[f"{name}_se"] = (own_dims, errors[0] if scalars else errors)
    variables |= {
        "anova_share": (("subset", "channel"), own / whole),
        "truncation_share": (("axes", "channel"), first / whole),
        "effective_dimension_truncation": (("channel",), _least(first / whole)),
        "effective_dimension_superposition": (("channel",), _least(by_size / whole)),
        "mean_dimension": (("channel",), found["total_variance"][0].sum(axis=0) / whole),
        "variance": (("channel",), moments.variance),
        "variance_ci": (("channel", "bound"), moments.variance_ci),
    }
    if scalar:
        variables = {
            name: (tuple(d for d in dims if d != "channel"), v.take(0, dims.index("channel")))
            for name, (dims, v) in variables.items()
        }
    return dataset(variables, _coords(subsets, sizes), **provenance)


def _coords(subsets: _Subsets, sizes: Array) -> dict[str, Any]:
    labels = ["".join(f"x{i}" for i in u) for u in subsets.listed]
    dims = subsets.masks.shape[1]
    return {
        "subset": ("subset", np.arange(len(labels)), {"long_name": "subset of axes", "units": "1"}),
        "subset_label": ("subset", labels, {"long_name": "axes of the subset"}),
        "subset_size": ("subset", sizes, {"long_name": "number of axes", "units": "1"}),
        "axis": ("axis", np.arange(dims), {"long_name": "axis", "units": "1"}),
        "axes": ("axes", np.arange(1, dims + 1), {"long_name": "number of axes", "units": "1"}),
        "bound": ["low", "high"],
    }


def _least(shares: Array) -> Array:
    """Least number, from 1, whose share (s, channels) is enough; NaN where none is."""
    enough = shares >= EFFECTIVE_SHARE
    return np.where(enough.any(axis=0), enough.argmax(axis=0) + 1.0, np.nan)
