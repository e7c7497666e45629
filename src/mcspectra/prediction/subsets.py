"""Predictions of variances in many dims, by functions of single axes and sums of products.

Method
------
Let g = Σ_v g_v be the ANOVA of g [Owen1997]_.
Consider a set whose axes are randomized independently of each other.
The variance of the mean of g over the set is a mean over pairs (a, b) of points:

    Var = (1/n²) Σ_{a,b} Σ_v C_v(a, b),    C_v = Cov(g_v(a), g_v(b)) over the randomization.

On each axis, the covariance C_v depends on a single quantity.
Under nested scrambling, the quantity is the number of common digits of a_i and b_i.
Under a digital shift, the quantity is the difference of the digits of a_i and b_i.
Under a shift, the quantity is the difference a_i − b_i on the torus.

For a subset v of one axis the sum is exact.
For larger subsets g is fitted by a sum of products Σ_r Π_i h_ri(x_i).
For a sum of products, the covariances of all subsets v add up to

    Σ_v C_v = Σ_{r,s} Π_i (μ_ri μ_si + k_i^rs(a_i, b_i)) − I²

Here μ_ri is the mean of the factor h_ri.
The covariance of the factors h_ri and h_si under the randomization is k_i^rs.
The part of g outside the fit is treated as white noise, so its energy is divided by n.
The interval allows for white noise with zero to twice the estimated energy of g minus the fit.
The interval also allows for a correlation of ±½ between the fit and g minus the fit.

The fit and its error are computed from values of g at points that this module chooses:

* Profiles g(·, z) along each axis for many z. Their leading singular vectors are the basis of h_ri.
* Least squares over scrambled nets, one axis after another.
* The energy of g minus the fit, at the points of another net.
* ∫g² as a mean over scrambled nets, with an interval from Student's t.

The function g_i of axis i is a mean over profiles, with the fit as a control variate.
First g_i is computed for the fit, which is a sum of products of functions of single axes.
Then the mean difference between profiles of g and profiles of the fit is added.

Strata of a grid need no fit: Var = E (g(x) − g(x'))² / 2n with x and x' in the same stratum.
In Latin hypercubes, the two points of any pair lie in different strata on each axis [Stein1987]_.
All pairs of points therefore have the same distribution.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import Function, NoClosedForm
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream
from mcspectra.estimators.quadrature import values_at
from mcspectra.integrands import Integrand
from mcspectra.prediction.known import Known, Predicted, half_interval
from mcspectra.prediction.torus import lattice_basis
from mcspectra.samplers import as_sampler
from mcspectra.samplers.law import (
    Fixed,
    Independent,
    Law,
    PairedAxes,
    Scrambled,
    Shifted,
    Stationary,
    Strata,
    unmoved,
)
from mcspectra.spectra.bases import hadamard

__all__ = [
    "SUBSET_SETTINGS",
    "TORUS",
    "AnovaModel",
    "Curves",
    "SubsetSettings",
    "all_parts",
    "net",
    "of_subsets",
    "offsets_within",
    "pair_sums",
    "pairs_of",
]

_LEAST_DIMS = 2
_OWN = Stream.from_rng(0x5B5E75)
"""Stream of random numbers for the points of this module. Samplers never use this stream."""
TORUS = 1 << 15
"""Number of distinct differences of coordinates on the torus, for sets that are no lattices."""
_GRADED = 0.25 ** np.arange(6.0, 0.0, -1.0)
"""Additional nodes next to 0 and 1, where warps have poles, in units of the outermost node."""


@final
@dataclass(frozen=True, kw_only=True)
class SubsetSettings:
    """Settings for the fit of g by sums of products, and for its curves.

    All changes that are stated below were measured in six cases at n = 64 and 256.
    The integrands are smooth functions, a ball in 4-D, a slab, a jump along a line and a kink.
    The samplers are latin-hypercube, rank1-lattice | shift, and sobol with owen or digital-shift.
    The variance of a ball in 4-D is predicted within ±63 %, other variances within ±0.2 to 1.3 %.
    Some settings change only the variance of the ball in 4-D, by less than 8 %.
    "The same results" means changes of less than 1e-6.

    Attributes
    ----------
    few_dims
        Largest number of dims in which quadrature computes ∫g² better than nets.
        In few dims, the fit of g needs only a small number of products.
    replicates, replicate
        Number of scrambled nets for ∫g², and number of their points.
        Half or twice as many nets or points change smooth test cases by less than 0.005 %.
    strata
        Number of pairs of points within strata, for each replicate.
        A total of 131,072 pairs gives ±0.8 % for normally distributed differences.
    profile_work
        Total number of evaluations of g for the profiles along all axes.
        Half or twice as many evaluations change only the variance of one test case, a ball in 4-D.
    nodes
        Number of nodes of a profile along an axis.
        Half as many nodes change the variance of a test integrand with a kink by 0.1 %.
        Twice as many nodes change only the variance of one test case, a ball in 4-D.
    groups
        Number of independent groups of profiles. The spread over the groups is the error.
        Half or twice as many groups change only the variance of one test case, a ball in 4-D.
    fitted
        Number of replicates to which products are fitted. One further replicate tests the fit.
        Half or twice as many replicates change only the variance of one test case, a ball in 4-D.
    basis, negligible
        Largest number of basis functions of an axis, and least energy of a basis function.
        The least energy is relative to the total energy of all profiles of g along the axis.
        Halving or doubling `basis` or `negligible` changes only one test case, a ball in 4-D.
    rank, few_rank
        Largest number of products in a fit, if the fit has more than `few_dims` dims.
        In at most `few_dims` dims, a fit has at most `few_rank` products.
        In few dims, only functions with jumps across axes are predicted by a sum of products.
        More than `few_rank` products would not resolve the jumps of a function in few dims.
        For the integrand ball in 4-D, fits of three products predict the variance within ±86 %.
        For the integrand ball in 4-D, fits of twelve products predict the variance within ±53 %.
        With three or twelve products, variances of the other test integrands stay the same.
    sweeps, settled
        Largest number of sweeps of a fit.
        A fit stops earlier if the ratio of successive residuals exceeds `settled`.
        Halving or doubling the number of sweeps changes nothing.
        With `settled` at 0.95 or 0.995, only the variance of one test case, a ball in 4-D, changes.
    block
        Number of points of a block in the least-squares fit.
        Blocks are so small that numerical libraries start no threads.
    ridge
        Ridge of the least squares, relative to the mean of the diagonal.
        Halving or doubling this value changes variances by less than 5e-7.
    good
        A fit is accepted below this residual energy, relative to the variance.
        Halving or doubling the accepted residual energy gives the same results.
    stands_out
        A profile jumps where its step is this many times as large as the neighboring steps.
        A profile has a kink at a node if its slope changes far more there than at nearby nodes.
        The change of slope at a kink must exceed `stands_out` times the change at nearby nodes.
        Halving or doubling `stands_out` changes only one test case, a ball in 4-D.
    halvings
        Number of bisections of a jump, which reduce steps of 1/128 to 2^-47.
        Values from 20 to 80 give the same results.
    shared
        A jump is shared by profiles if the mean profile has a large step.
        The squared step of the mean profile must exceed this fraction of the mean squared step.
        Values from 0.05 to 0.2 give the same results.
    bent
        Least change of the slope at a kink, as a fraction of the largest slope.
        Halving or doubling this value changes variances by less than 0.005 %.
    cells
        Number of cells into which an axis is divided to compute the energy of the fit.
        The means of smooth pieces over the cells of an axis are exact.
        Values from 2^11 to 2^13 give the same results.
    fine, finest
        Number of cells along an axis for the functions of single axes.
        `fine` is for axes along which g is smooth, and `finest` is for axes with jumps.
        For Latin hypercubes and lattices only the variance within cells remains.
        Half or twice as many cells along an axis change variances by less than 0.01 %.
    start
        Standard deviation of the random coefficients with which the fit of a new product starts.
        The constant coefficient of each factor starts at 1.
    adds_up
        Factor for the variance of g minus the fit, if one offset moves all points of a set.
        The factor widens the interval of the prediction, and does not change the variance.
        If one offset moves a lattice, the contributions of kinks to the variance add up.
        If the points are randomized in another way, the factor is 1.
    resolved
        Relative errors of curves between their nodes, for smooth curves and for curves with jumps.
    most_work
        Maximum work of a prediction, about 1.7e10 operations.
        The work is the number of pairs of points, times axes, times the squared number of products.
    draws
        Number of sets that are drawn if a random set is shifted or scrambled.
        A fixed set is drawn only once.
        The interval includes the spread of the variances over the drawn sets.
    digits
        Least number of cells along an axis. The index of a cell gives the digits of a coordinate.
        With more points than this number, an axis has at least as many cells as there are points.
    offsets
        Number of offsets within a stratum. The mean over them replaces a uniformly random offset.
        The offsets are at the centers of equal parts of the stratum.
        Numbers of offsets were compared for a sum of two jumps, latin-hypercube | shift and n = 64.
        The variances with 8 and 32 offsets differ by 0.2 %, and with 4 and 8 offsets by 2 %.
    """

    few_dims: int = 3
    replicates: int = 16
    replicate: int = 1 << 13
    strata: int = 1 << 13
    profile_work: int = 5 << 17
    nodes: int = 128
    groups: int = 4
    fitted: int = 2
    basis: int = 8
    negligible: float = 1e-8
    rank: int = 6
    few_rank: int = 3
    sweeps: int = 30
    settled: float = 0.98
    block: int = 64
    ridge: float = 1e-8
    good: float = 1e-7
    stands_out: float = 4.0
    halvings: int = 40
    shared: float = 0.1
    bent: float = 0.1
    cells: int = 1 << 12
    fine: int = 1 << 14
    finest: int = 1 << 18
    start: float = 0.3
    adds_up: float = 20.0
    resolved: tuple[float, float] = (2e-3, 0.01)
    most_work: float = 2.0**34
    draws: int = 8
    digits: int = 1 << 13
    offsets: int = 8


SUBSET_SETTINGS = SubsetSettings()


def of_subsets(law: Law, known: Known, stream: Stream) -> Predicted:
    """Predict the variance from functions of single axes and sums of products.

    Parameters
    ----------
    law
        Law of the sampler, for example of independent points, strata or Latin hypercubes.
        Sets that are statistically the same after any translation are also possible.
        Nested scrambles, linear scrambles, and digital shifts in base 2 are possible as well.
    known
        The integrand, in at least two dims. It takes about 2^20 evaluations.
        The evaluations are made once for all counts and samplers.
    stream
        Random numbers for samplers that draw a random set and then shift or scramble it.

    Returns
    -------
    Predicted
        `share` is the part of ∫g² in the fit. `tail` is the variance of the part outside the fit.

    Raises
    ------
    NoClosedForm
        If there is only one dim, or the joint distribution of two points is not known.
    """
    g = known.g
    if g.dims < _LEAST_DIMS:
        raise NoClosedForm("Subsets of axes need two dims; use exact_variance or convergence.")
    n = law.n
    strata, by = unmoved(law)
    if isinstance(strata, Strata) and strata.jittered:
        at = None if isinstance(law, Shifted) else tuple(by)
        return known.once(
            ("pairs in strata", strata.sides, at), lambda: _of_strata(strata.sides, at, g)
        )
    parts = known.once("subsets: parts", lambda: all_parts(known))
    if isinstance(law, Independent):
        variance, half = np.array([[p.variance, p.half] for p in parts]).T / n
        return Predicted(variance, half, "energy of g")
    pairs, codes, rows = pairs_of(law, stream)
    work = float(len(rows)) * codes[..., 0].size * SUBSET_SETTINGS.rank**2
    if work > SUBSET_SETTINGS.most_work:
        raise NoClosedForm(
            f"The pairs of {n} points of {law.name} in {g.dims} dims are too many; use ",
            Function("convergence"),
            ".",
        )
    found = []
    for c, p in enumerate(parts):
        first, rest, means, weights = known.once(
            f"subsets: {c} {pairs}", functools.partial(pairs.tables, p)
        )
        mode = ("digits", "xor", "torus").index(pairs.kind)
        sums = [
            pair_sums(x, rows, mode, pairs.bases[0], first, rest, means, weights) for x in codes
        ]
        # Each row of `by_set` holds the variances of one set.
        # The first columns are for functions of single axes, the last column is for products
        by_set = np.array(sums).mean(axis=1) / n
        sets, mean = by_set[:, 0] + by_set[:, -1], by_set.mean(axis=0)
        ones, more = mean[:-1], mean[-1]
        # The variance of g minus the fit is between zero and twice that of white noise.
        # The correlation between the fit and the rest of g is at most ±½.
        # If all points move by the same offset, contributions of g minus the fit may add up
        tail = p.residual / n
        together = pairs.kind != "digits" and len(codes) == 1
        half = (SUBSET_SETTINGS.adds_up if together else 1.0) * tail + math.sqrt(
            max(ones[0] + more, 0.0) * tail
        )
        # Energy of interactions: from pairs, or the whole energy minus the energy of single axes
        single = first[:, -1].sum(axis=0)
        of_whole = (
            p.variance - float(single[0]),
            math.hypot(p.half, float(half_interval(single[1:]))),
        )
        joint, joint_half = min(p.joint, of_whole, key=lambda each: each[1])
        if pairs.latin and joint_half < p.residual:
            # The variance of interactions counts once within strata, n/(n − 1) times between strata
            joint = max(joint, 0.0) / n
            either = 0.5 * joint / max(n - 1.0, 1.0)
            tail, half = joint + either - more, joint_half / n + either
        value = ones[0] + more + tail
        drawn = half_interval(sets) if len(sets) > 1 else 0.0
        # Add an error for peaks of g, which few points hit
        seen = p.half / p.variance if p.variance > 0.0 else 0.0
        rough = any(len(axis.knots) > 2 for axis in p.axes)
        rough |= pairs.leaves_cells and 32 * n > SUBSET_SETTINGS.finest
        between = SUBSET_SETTINGS.resolved[rough] * value
        error = math.hypot(float(half_interval(ones[1:])), half, drawn, between, seen * value)
        share = max(0.0, 1.0 - p.residual / p.variance) if p.variance > 0.0 else 0.0
        found.append((value, error, share, tail))
    variance, error, share, tail = np.array(found).T
    return Predicted(variance, error, "sums of products", share, tail)


@final
@dataclass(frozen=True)
class Curves:
    """Curves along one axis: smooth between the knots, and given by their values at the nodes."""

    knots: Array
    nodes: Array

    def at(self, values: Array, x: Array) -> Array:
        """Interpolate values (…, nodes) piece by piece at x: (…, len(x))."""
        out = np.empty((*values.shape[:-1], len(x)))
        for low, high, line in self._pieces(values):
            there = (x >= low) & (x <= high)
            out[..., there] = line(x[there])
        return out

    def cells(self, values: Array, count: int, offset: float = 0.0) -> Array:
        """Return means over equal cells of the torus. The first cell begins at `offset` < 1."""
        turns, ends = np.divmod(offset + np.arange(count + 1) / count, 1.0)
        wrap = int(np.searchsorted(turns, 1.0))
        total = np.zeros((*values.shape[:-1], count + 1))
        for low, high, line in self._pieces(values):
            sums = line.antiderivative()
            start, end = sums(low)[..., None], sums(high)[..., None]
            # Integrate the piece up to each cell end. The integral is constant outside the piece
            for turn, own in ((0.0, slice(0, wrap)), (end - start, slice(wrap, None))):
                x, out = ends[own], total[..., own]
                first, stop = np.searchsorted(x, (low, high))
                out[..., :first] += start + turn
                out[..., first:stop] += sums(x[first:stop]) + turn
                out[..., stop:] += end + turn
        return np.diff(total) * count

    def _pieces(self, values: Array) -> Iterator[tuple[float, float, Any]]:
        """Yield ends and curve of each smooth piece. Pieces with under two nodes are constant."""
        from scipy.interpolate import PchipInterpolator

        for low, high in itertools.pairwise(self.knots):
            own = (self.nodes > low) & (self.nodes < high)
            x, y = self.nodes[own], values[..., own]
            if len(x) < 2:
                nearest = int(np.abs(self.nodes - 0.5 * (low + high)).argmin())
                x, y = np.array([low, high]), np.repeat(values[..., [nearest]], 2, axis=-1)
            yield low, high, PchipInterpolator(x, y, -1)


@final
@dataclass(frozen=True)
class AnovaModel:
    """Fitted parts of one channel of g. Arrays hold values at the nodes of the axes."""

    variance: float
    half: float  # Half of the 95 % interval of the variance
    axes: list[Curves]
    main: list[Array]  # g_i of all groups and of each group: (1 + groups, nodes)
    factors: list[Array]  # h_ri: (products, nodes)
    residual: float  # Energy of g minus the sum of products
    # Energy of interactions of several axes, and half of its 95 % interval
    joint: tuple[float, float]


@final
@dataclass(frozen=True)
class _Pairs:
    """Quantity of each axis that determines the covariance of the values at two points.

    If `kind` is digits, the quantity is the number of common leading digits, at most `levels`.
    If `kind` is xor or torus, the quantity is the difference of two multiples of 1/bases.
    The difference is taken digit by digit (xor) or on the torus.
    `offsets` displace the cells of each axis. Covariances are averaged over several offsets.
    """

    kind: str
    bases: tuple[int, ...]
    levels: tuple[int, ...]
    latin: bool = False  # Whether all points differ in the first digit
    offsets: tuple[tuple[float, ...], ...] = ()

    @property
    def leaves_cells(self) -> bool:
        """Whether sums of functions of one axis vary only within intervals of length 1/n."""
        return self.latin or self.kind != "digits"

    def tables(self, parts: AnovaModel) -> tuple[Array, Array, Array, Array]:
        """Return four tables from which `pair_sums` computes covariances.

        Two tables hold the covariances of the functions g_i, and of the factors of products.
        Two more tables hold the means of the factors, and the weights of the products.
        """
        singles, pairs, averages = list[Array](), list[Array](), list[Array]()
        for base, levels, curves, main, factors, offsets in zip(
            self.bases,
            self.levels,
            parts.axes,
            parts.main,
            parts.factors,
            self.offsets or [(0.0,)] * len(self.bases),
            strict=True,
        ):
            cells = base**levels
            many = len(curves.knots) > 2 or self.leaves_cells
            k = max(
                16, min(64 * many, SUBSET_SETTINGS.finest // cells), SUBSET_SETTINGS.fine // cells
            )
            k = 1 if base == TORUS else k
            own = len(main)
            # Compute the covariances of g_i, with shape (1 + groups, differences).
            # Then compute the covariances of all pairs of factors
            left, right = np.triu_indices(len(factors))
            left, right = (np.concatenate([np.arange(own), own + side]) for side in (left, right))
            of_offsets = []
            for offset in offsets:
                values = curves.cells(np.concatenate([main, factors]), cells * k, offset)
                mean = values.mean(axis=-1, keepdims=True)
                values = values - mean
                if self.kind == "digits":
                    # Entry k is for points with k common digits; in the last entry all digits agree
                    means = values.reshape(len(values), cells, -1).mean(axis=-1)
                    energy = [(values[left] * values[right]).mean(axis=-1)]
                    while means.shape[-1] > 1:
                        energy.append((means[left] * means[right]).mean(axis=-1))
                        means = means.reshape(len(means), -1, base).mean(axis=-1)
                    within = np.stack([np.zeros(len(left)), *reversed(energy)], axis=-1)
                    apart = within[:, :-1] - np.diff(within, axis=-1) / (base - 1)
                    found = np.concatenate([apart, within[:, -1:]], axis=-1)
                elif self.kind == "xor":
                    spectra = hadamard(values) / (cells * k)
                    found = hadamard(spectra[left] * spectra[right])[:, ::k]
                else:
                    spectra = np.fft.rfft(values)
                    found = np.fft.irfft(spectra[left] * spectra[right].conj(), cells * k)
                    found = (found / (cells * k))[:, ::k]
                of_offsets.append(found)
            found = np.mean(of_offsets, axis=0)
            singles.append(found[:own])
            pairs.append(found[own:])
            averages.append(mean[own:, 0])
        width = max(first.shape[-1] for first in singles)

        def stacked(tables: list[Array]) -> Array:
            # Axes with fewer digits have shorter tables. Fill them with their last covariance
            wide = [np.pad(t, ((0, 0), (0, width - t.shape[-1])), "edge") for t in tables]
            return np.ascontiguousarray(np.stack(wide).transpose(0, 2, 1))

        products = np.stack(averages)
        left, right = np.triu_indices(products.shape[1])
        weights = np.where(left == right, 1.0, 2.0)
        return stacked(singles), stacked(pairs), products[:, left] * products[:, right], weights


@kernel
def pair_sums(
    codes: Array,
    rows: Array,
    mode: int,
    cells: int,
    first: Array,
    rest: Array,
    means: Array,
    weights: Array,
) -> Array:
    """Sum the covariances of chosen points with all points of a set: (rows, variants + 1).

    `rows` holds the indices of the chosen points.
    `codes` (n, d, digits) holds the digits of the coordinates of all points of the set.
    `first` (d, differences, variants) holds the covariances of functions of single axes.
    `rest` (d, differences, q) holds the covariances of the factors of q products.
    The factors have the means `means` (d, q), and the products have the weights `weights` (q,).
    In each row of the result, the first entries are sums of `first` over the axes.
    The last entry is the sum of interactions: Σ_q weight Σ_{|v| ≥ 2} Π_{i∈v} rest_i Π_{i∉v} mean_i.
    `mode` states how the digits of two points are compared. The result selects the covariance.
    Mode 0 counts the common digits of two points. Mode 1 is the exclusive or of their digits.
    Mode 2 is the difference of the digits of two points modulo `cells`.
    """
    variants, q = first.shape[2], rest.shape[2]
    out = np.zeros((rows.size, variants + 1))
    # Products of factors, summed over the subsets with no axis, with one axis, and with more axes
    none, one, more = np.empty(q), np.empty(q), np.empty(q)
    for r in range(rows.size):
        a = codes[rows[r]]
        for k in range(codes.shape[0]):
            b = codes[k]
            none[:], one[:], more[:] = 1.0, 0.0, 0.0
            for i in range(codes.shape[1]):
                if mode == 0:
                    place = 0
                    while place < codes.shape[2] and a[i, place] == b[i, place]:
                        place += 1
                    if place == codes.shape[2]:
                        place = first.shape[1] - 1
                elif mode == 1:
                    place = a[i, 0] ^ b[i, 0]
                else:
                    place = a[i, 0] - b[i, 0]
                    if place < 0:
                        place += cells
                for v in range(variants):
                    out[r, v] += first[i, place, v]
                for j in range(q):
                    x, m = rest[i, place, j], means[i, j]
                    more[j] = more[j] * (m + x) + one[j] * x
                    one[j] = one[j] * m + none[j] * x
                    none[j] *= m
            for j in range(q):
                out[r, variants] += weights[j] * more[j]
    return out


def _of_strata(sides: tuple[int, ...], at: tuple[float, ...] | None, g: Integrand) -> Predicted:
    """Estimate the variance of the mean of g over strata, from pairs of points in the same stratum.

    The variance within strata is half the mean squared difference of g between the two points.
    The coordinates of both points of a pair come from one point of a scrambled net.

    `at` is the corner of a stratum on the torus. None means a uniform translation of all strata.
    """
    d, cells = g.dims, np.array(sides, float)
    u = net(2 * d + d * (at is None), SUBSET_SETTINGS.strata, SUBSET_SETTINGS.replicates, 5)
    x, other = u[..., :d], u[..., d : 2 * d]
    corner = u[..., 2 * d :] / cells if at is None else np.array(at)
    within = np.floor(((x - corner) % 1.0) * cells)
    within = ((np.minimum(within, cells - 1.0) + other) / cells + corner) % 1.0
    change = values_at(g, x) - values_at(g, np.minimum(within, BELOW_ONE))
    spread = 0.5 * (change**2).mean(axis=1) / math.prod(sides)
    return Predicted(spread.mean(axis=0), half_interval(spread), "pairs in strata")


def all_parts(known: Known) -> list[AnovaModel]:
    """Fit a sum of products to each channel of g, and compute the energies of its parts.

    The profiles of all axes pass through the same points.
    """
    g, d = known.g, known.g.dims
    x = net(d, SUBSET_SETTINGS.replicate, SUBSET_SETTINGS.replicates, 0)
    values = values_at(g, x)
    mean = values.mean(axis=(0, 1))
    squares = ((values - mean) ** 2).mean(axis=1)
    energy, half = squares.mean(axis=0), half_interval(squares)
    if d <= SUBSET_SETTINGS.few_dims:  # Use ∫g² of a quadrature, which resolves poles better
        square, error = known.square
        error = np.hypot(error, 2.0 * np.abs(mean) * half_interval(values.mean(axis=1)))
        better = error < half
        energy, half = np.where(better, (square - mean**2, error), (energy, half))
    of_axis = SUBSET_SETTINGS.profile_work / d
    count = max(
        4, 1 << round(math.log2(of_axis / (SUBSET_SETTINGS.groups * SUBSET_SETTINGS.nodes)))
    )
    through = net(d, count, SUBSET_SETTINGS.groups, 2)

    def profiles(axis: int, at: Array, through: Array = through) -> Array:
        """Return values of profiles, with shape (groups, profiles, nodes, channels)."""
        points = np.repeat(through[:, :, None], len(at), axis=2)
        points[..., axis] = at
        return values_at(g, points)

    axes, found = [], []
    for axis in range(d):
        # Use equal steps within each piece, and smaller steps toward 0 and 1, where warps end
        ends = np.unique([0.0, 1.0, *(b for b in g.breaks[axis] if 0.0 < b < 1.0)])
        middles = [
            low + (np.arange(k) + 0.5) * ((high - low) / k)
            for low, high in itertools.pairwise(ends.tolist())
            for k in [max(4, math.ceil(SUBSET_SETTINGS.nodes * (high - low)))]
        ]
        at = np.concatenate(middles)
        at = np.concatenate([at[0] * _GRADED, at, 1.0 - (1.0 - at[-1]) * _GRADED[::-1]])
        along = profiles(axis, at)
        # Mark the nodes whose two neighboring steps are equal
        even = np.append(np.abs(np.diff(at, 2)) < 1e-9, False)
        # Find undeclared jumps of the mean profile and bisect them.
        # At a jump, many profiles change far more between two nodes than at neighboring nodes.
        # If a surface of jumps is not normal to the axis, profiles jump at different coordinates
        steps = np.diff(along, axis=2)
        common = steps.mean(axis=(0, 1))
        change = np.abs(common).max(axis=-1)
        shared = (common**2).sum(axis=-1) > SUBSET_SETTINGS.shared * (steps**2).mean(
            axis=(0, 1)
        ).sum(axis=-1)
        beside = np.maximum(np.append(change[1:], 0.0), np.append(0.0, change[:-1]))
        jumps = []
        stands_out = (
            shared & (change > SUBSET_SETTINGS.stands_out * beside) & (change > 1e-9 * change.sum())
        )
        for k in np.flatnonzero(stands_out & even & np.append(False, even[:-1])).tolist():
            low, high = at[k], at[k + 1]
            if any(low < b < high for b in ends):
                continue
            few = through[:, :: max(1, count // 16)]
            left, right = (profiles(axis, np.array([e]), few).mean((0, 1, 2)) for e in (low, high))
            channel = int(np.abs(right - left).argmax())
            for _ in range(SUBSET_SETTINGS.halvings):
                middle = 0.5 * (low + high)
                value = profiles(axis, np.array([middle]), few).mean((0, 1, 2))
                nearer = abs(value - left)[channel] < abs(value - right)[channel]
                low, high = (middle, high) if nearer else (low, middle)
            jumps.append(0.5 * (low + high))
        # At a kink, the slope changes far more than at neighboring nodes.
        # A kink lies at the intersection of the lines from both sides
        mean = along.mean(axis=(0, 1))
        slopes = np.diff(mean, axis=0)
        bend = np.abs(np.diff(slopes, axis=0)).max(axis=-1)
        both = bend[1:-2] + bend[2:-1]  # Use the four nodes around each interval
        sharp = both > SUBSET_SETTINGS.stands_out * np.maximum(bend[:-3], bend[3:])
        for k in np.flatnonzero(
            sharp & (both > SUBSET_SETTINGS.bent * np.abs(slopes).max())
        ).tolist():
            near = at[k : k + 6]
            if not even[k : k + 4].all() or any(
                near[0] <= b <= near[-1] for b in (*ends[1:-1], *jumps)
            ):
                continue
            channel = int(np.abs(slopes[k + 3] - slopes[k + 1]).argmax())
            before, after = slopes[[k + 1, k + 3], channel]
            gap = mean[k + 3, channel] - mean[k + 2, channel] - after
            if before == after:
                continue
            place = min(max(float(gap / (before - after)), 1e-6), 1.0 - 1e-6)
            jumps.append(float(at[k + 2] + place * (at[k + 3] - at[k + 2])))
        axes.append(Curves(np.unique([*ends, *jumps]), at))
        found.append(along)
    return [
        _fitted(
            float(energy[c]),
            float(half[c]),
            axes,
            [along[..., c] for along in found],
            through,
            x,
            values[..., c],
        )
        for c in range(values.shape[-1])
    ]


def _fitted(
    variance: float,
    half: float,
    axes: list[Curves],
    profiles: list[Array],
    through: Array,
    every: Array,
    all_values: Array,
) -> AnovaModel:
    """Fit a sum of products to values (replicates, n) at points, along one axis at a time."""
    x, values = every[: SUBSET_SETTINGS.fitted + 1], all_values[: SUBSET_SETTINGS.fitted + 1]
    # A profile has the values of g along a line parallel to an axis.
    # The basis functions of an axis are the constant 1 and leading singular vectors of profiles
    bases = []
    for given in profiles:
        flat = given.reshape(-1, given.shape[-1])
        flat = flat - flat.mean(axis=1, keepdims=True)
        size, vectors = np.linalg.eigh(flat.T @ flat)
        keep = int((size[-SUBSET_SETTINGS.basis :] > SUBSET_SETTINGS.negligible * size.sum()).sum())
        one = np.ones((1, flat.shape[1]))
        vectors = vectors.T[::-1][:keep] * math.sqrt(flat.shape[1])
        bases.append(np.concatenate([one, vectors]))
    known = [
        axis.at(basis, x[..., i].ravel()).reshape(len(basis), len(x), -1)
        for i, (axis, basis) in enumerate(zip(axes, bases, strict=True))
    ]
    cells = [
        axis.cells(basis, SUBSET_SETTINGS.cells) for axis, basis in zip(axes, bases, strict=True)
    ]
    # The products of these blocks are so small that BLAS starts no threads.
    # With threads, waiting would take most of the time
    blocks = [basis[:, :-1].reshape(len(basis), -1, SUBSET_SETTINGS.block) for basis in known]
    train = [np.ascontiguousarray(basis.swapaxes(0, 1)) for basis in blocks]
    scale = float(np.abs(values).max()) or 1.0
    target = values[:-1].reshape(-1, SUBSET_SETTINGS.block) / scale

    # Add one product at a time, with and without sums of functions of one axis
    rng = np.random.default_rng(_OWN.child(4).key)
    best, residual = [np.zeros((1, len(basis))) for basis in bases], variance
    fits = {False: best, True: best}
    most = (
        SUBSET_SETTINGS.rank if len(axes) > SUBSET_SETTINGS.few_dims else SUBSET_SETTINGS.few_rank
    )
    for rank, additive in itertools.product(range(most + 1), (False, True)):
        if residual <= SUBSET_SETTINGS.good * variance or not (rank or additive):
            continue
        weights = fits[additive]
        if rank:
            new = [SUBSET_SETTINGS.start * rng.standard_normal((1, len(basis))) for basis in bases]
            for w in new:
                w[0, 0] = 1.0
            weights = [np.concatenate([w, v]) for w, v in zip(weights, new, strict=True)]
        fits[additive] = weights = _least_squares(train, target, weights, additive=additive)
        tested = [w @ b[:, -1] for w, b in zip(weights, known, strict=True)]
        sums = np.sum([t[0] for t in tested], axis=0) + np.prod(
            [t[1:] for t in tested], axis=0
        ).sum(0)
        missed = scale**2 * float(((values[-1] / scale - sums) ** 2).mean())
        # The variance of the fit over the cube may differ from its variance at the test points.
        # This difference is added to the estimated energy of g minus the fit.
        # The variance of g over the cube differs from that at the test points by sampling error.
        # The sampling error of g is subtracted from the difference that is found for the fit
        curves = [w @ c for w, c in zip(weights, cells, strict=True)]  # Rows: sum, products
        averages = np.stack([c.mean(axis=1) for c in curves])
        squares = np.stack([c @ c.T / c.shape[1] for c in curves])
        products = np.prod(averages[:, 1:], axis=0)
        energy = squares[:, 1:, 1:].prod(axis=0).sum() - products.sum() ** 2
        for i, along in enumerate(squares[:, 0] - averages[:, :1] * averages):
            others = np.prod(np.delete(averages[:, 1:], i, axis=0), axis=0)
            energy += along[0] + 2.0 * along[1:] @ others
        energy = scale**2 * float(energy)
        untested = energy - scale**2 * float(sums.var())
        chance = variance - float(values[-1].var())
        missed += max(abs(untested - chance) - 2.0 * half - energy / SUBSET_SETTINGS.cells, 0.0)
        if missed < residual:
            best, residual = weights, missed

    # Compute the function g_i of each axis with the fit as a control variate:
    # add the mean difference between profiles of g and profiles of the fit to g_i of the fit
    curves = [w @ b for w, b in zip(best, bases, strict=True)]
    sums, factors = [scale * f[0] for f in curves], [f[1:] for f in curves]
    factors[0] = scale * factors[0]
    means = np.stack(
        [
            axis.cells(f, SUBSET_SETTINGS.cells).mean(-1)
            for axis, f in zip(axes, factors, strict=True)
        ]
    )
    flat = through.reshape(-1, len(axes))
    at = np.stack(
        [axis.at(f, flat[:, i]) for i, (axis, f) in enumerate(zip(axes, factors, strict=True))]
    )
    main = []
    for i, given in enumerate(profiles):
        others = np.prod(np.delete(at, i, axis=0), axis=0).reshape(-1, *given.shape[:2])
        # Functions of the other axes shift a profile by a constant, so all profiles are centered
        beside = given - np.einsum("rgj,rk->gjk", others, factors[i])
        beside = (beside - beside.mean(axis=-1, keepdims=True)).mean(axis=1) - sums[i]
        own = np.prod(np.delete(means, i, axis=0), axis=0) @ factors[i] + sums[i]
        main.append(own + np.concatenate([beside.mean(axis=0)[None], beside]))

    # The energy of interactions is the energy of g minus its functions of single axes.
    # Errors of the functions of single axes increase the energy of interactions.
    # Therefore the energy of the errors of functions of single axes is subtracted
    at_all = zip(axes, main, np.moveaxis(every, -1, 0), strict=True)
    alone = np.sum([a.at(m[0], t.ravel()).reshape(t.shape) for a, m, t in at_all], axis=0)
    left = ((all_values - alone - (all_values - alone).mean()) ** 2).mean(axis=1)
    spread = [
        a.cells(m[1:], SUBSET_SETTINGS.cells).var(axis=0, ddof=1)
        for a, m in zip(axes, main, strict=True)
    ]
    errors = float(np.mean(spread, axis=1).sum()) / SUBSET_SETTINGS.groups
    joint = float(left.mean()) - errors, float(half_interval(left)) + errors
    return AnovaModel(variance, half, axes, main, factors, residual, joint)


def _least_squares(
    bases: list[Array], target: Array, weights: list[Array], *, additive: bool
) -> list[Array]:
    """Fit Σ_r Π_i h_ri(x_i) to `target`, one axis at a time. Add Σ_i f_i(x_i) if `additive`.

    The shape of `target` is (blocks, size). A basis has the shape (blocks, functions, size).
    Weights of an axis have the shape (1 + products, functions): row 0 is f_i, row r is h_ri.
    """
    weights = [w.copy() for w in weights]
    curves = [w @ b for w, b in zip(weights, bases, strict=True)]  # (blocks, 1 + products, size)
    last = math.inf
    for _ in range(SUBSET_SETTINGS.sweeps):
        # For each axis, compute the product of the factors of all later axes.
        # The loop below multiplies this product by the factors of the earlier axes
        after = [np.ones_like(curves[0][:, 1:])]
        for c in curves[:0:-1]:
            after.append(after[-1] * c[:, 1:])
        before = np.ones(after[0].shape)
        sums = np.sum([c[:, 0] for c in curves], axis=0)
        for i, basis in enumerate(bases):
            others = before * after[len(bases) - 1 - i]
            if additive:
                others = np.concatenate([np.ones_like(target)[:, None], others], axis=1)
            sums = sums - curves[i][:, 0]
            design = (others[:, :, None] * basis[:, None]).reshape(
                len(target), -1, SUBSET_SETTINGS.block
            )
            gram = (design @ design.swapaxes(1, 2)).sum(axis=0)
            gram[np.diag_indices(len(gram))] += SUBSET_SETTINGS.ridge * np.trace(gram) / len(gram)
            right = (design @ (target - sums)[..., None]).sum(axis=0)
            solved = np.linalg.solve(gram, right).reshape(others.shape[1], -1)
            weights[i] = solved if additive else np.concatenate([0.0 * weights[i][:1], solved])
            if i < len(bases) - 1:
                size = np.sqrt(((weights[i][1:] @ basis) ** 2).mean(axis=(0, 2)))
                weights[i][1:] /= size[:, None] + 1e-300
            curves[i] = weights[i] @ basis
            before = before * curves[i][:, 1:]
            sums = sums + curves[i][:, 0]
        left = float(((target - sums - before.sum(axis=1)) ** 2).mean())
        if left > SUBSET_SETTINGS.settled * last:
            break
        last = left
    return weights


def pairs_of(law: Law, stream: Stream) -> tuple[_Pairs, Array, Array]:
    """Return how pairs of points are compared, the points' digits, and indices of some points.

    The digits have shape (sets, n, d, digits).
    It is enough to sum over the pairs that contain a point with one of the returned indices:
    pairs with the chosen points have the same distribution as all pairs of points.

    Raises
    ------
    NoClosedForm
        If the joint distribution of two points of the sampler is not known.
    """
    n, d = law.n, law.dims
    every, one = np.arange(n), np.arange(1)
    inner, by = unmoved(law)
    if isinstance(inner, PairedAxes) and inner.latin:
        codes = np.arange(n)[None, :, None, None].repeat(d, axis=2)
        offsets = offsets_within(1.0 / n, by, uniform=isinstance(law, Shifted))
        return _Pairs("digits", (n,) * d, (1,) * d, latin=True, offsets=offsets), codes, one
    set_ = law.inner if isinstance(law, Shifted | Scrambled) else law
    unknown = isinstance(law, Scrambled) and not (law.nested_pairs or law.xor)
    if unknown or not isinstance(law, Shifted | Scrambled | Stationary):
        raise NoClosedForm(
            f"No law of pairs of points is known for {law.name} in {d} dims; use ",
            Function("convergence"),
            ".",
        )
    digital = isinstance(set_, Fixed) and set_.digital
    x = set_.draw(stream, 0, 1 if set_.fixed else SUBSET_SETTINGS.draws)
    if not isinstance(law, Scrambled):
        moved = np.mod(x - x[:, :1], 1.0)
        lattice = np.abs(moved * n - np.rint(moved * n)).max() < 1e-6
        x = moved if lattice else x
        cells = n if lattice else TORUS
        codes = np.rint(x * cells).astype(np.int64)[..., None] % cells
        return (
            _Pairs("torus", (cells,) * d, (1,) * d),
            codes,
            one if lattice and lattice_basis(x[0]) is not None else every,
        )
    if law.xor:
        cells = 1 << (n - 1).bit_length()
        codes = np.floor(x * cells).astype(np.int64)[..., None]
        return _Pairs("xor", (cells,) * d, (1,) * d), codes, one if digital else every
    bases = law.bases
    levels = tuple(math.ceil(math.log(max(n, SUBSET_SETTINGS.digits), b) - 1e-9) for b in bases)
    codes = np.zeros((*x.shape, max(levels)), np.int64)
    for axis, (b, most) in enumerate(zip(bases, levels, strict=True)):
        # In base b, rounding may move a coordinate slightly below the start of its cell.
        # Adding 1e-9 to the number of the cell prevents wrong digits of this coordinate
        whole = np.floor(x[..., axis] * b**most + (0.0 if b & (b - 1) == 0 else 1e-9))
        for level in range(most):
            codes[..., axis, level] = whole // b ** (most - 1 - level) % b
    binary = digital and set(bases) == {2}
    return _Pairs("digits", bases, levels), codes, one if binary else every


def offsets_within(side: float, by: Array, *, uniform: bool) -> tuple[tuple[float, ...], ...]:
    """Return the offsets of strata along each axis.

    A fixed offset gives one value per axis. A uniformly random offset gives several values.
    """
    if not uniform:
        return tuple((float(b) % side,) for b in by)
    places = (np.arange(SUBSET_SETTINGS.offsets) + 0.5) / SUBSET_SETTINGS.offsets * side
    return (tuple(places.tolist()),) * len(by)


def net(dims: int, n: int, replicates: int, label: int) -> Array:
    """Return scrambled nets for this module, (replicates, n, dims)."""
    return as_sampler("sobol | owen", dims).draw_stream(n, _OWN.child(label), 0, replicates)
