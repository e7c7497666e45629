"""Variances of scrambled nets and of strata from means of g over cells.

Nested uniform scrambling multiplies each variance σ²_l by a factor, the gain Γ_l of the net.
The theory is in docs/theory.md, "Gains of scrambled nets".
Here σ²_l is the variance of the part of g that varies with l_j digits of coordinate j.
All but finitely many gains are 1.
Gains other than 1 occur only at levels l with at most about n cells.
At levels with about n cells, Σ l_j is near log n, but single l_j may be much smaller.
A table T has the means of g over equal cells. The variance is a sum over the levels of the table,
plus the rest ω²_T within the cells, minus a correction for levels that the table lacks:

    n Var = Σ_{l ≤ T} Γ_l σ²_l + ω²_T − Σ_{l ≰ T} (1 − Γ_l) σ²_l,

Here ω²_T is the mean variance of g within the cells of one table T.
The variances σ²_l that table T lacks come from tables with more cells along some axes.
Tables with more cells along some axes have about the same total number of cells.
For a digital shift, the weights of the energies depend on g; see `of_moves`.

Cells are integrated in closed form if the moments of g over boxes are known.
Otherwise Gauss-Legendre rules are used, which are cut at the breaks of g.
Cells whose neighbors have very different g contain curves of jumps.
Cells with curves of jumps are divided into parts, and each part is integrated by itself.
Integration uses a fine and a coarse rule, and the error is their difference.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import MEASURE_IT, Function, NoClosedForm, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.estimators.quadrature import grid, in_closed_form, stratum_moments
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.measure.blindness import NO_VARIANCE
from mcspectra.prediction.exact import level_variances, paired
from mcspectra.prediction.known import Known, Predicted
from mcspectra.samplers.law import AntitheticPair, Fixed, Law, Moved, PairedAxes, Scrambled, Strata
from mcspectra.spectra.gain import gains_at

__all__ = ["LevelsSettings", "of_levels"]

Levels = tuple[int, ...]


@final
@dataclass(frozen=True, kw_only=True)
class LevelsSettings:
    """Settings for the choice and integration of cells.

    The stated changes were measured in seven cases with n = 64 to 1024, in 1 to 3 dims.
    The integrands are a jump along a line, smooth functions and a pole.
    The samplers are jittered, sobol | owen and halton | owen.

    Attributes
    ----------
    most_dims
        Largest number of dims. In 4-D, 32,768 cells would have only 13 per side.
    cells
        Number of cells of the first table, by number of dims.
        Half or twice as many cells change variances by less than 0.1 %, within the 95 % intervals.
    long, most_cells
        Largest number of cells of a table with more cells along some axes than along others.
        The number of cells is at most `long` n Π b_j, where b_j is the base of axis j.
        Because of the product Π b_j of the bases, cells may resolve one more digit along each axis.
        No table has more than `most_cells` cells.
        Halving or doubling `long` or `most_cells` changes nothing.
    more
        Number of additional digits, after the digits of n, for which gains are computed.
        With more digits than n has, two points usually differ in every coordinate.
        Results are the same for values from 1 to 6.
    orders
        Orders of the coarse and the fine Gauss-Legendre rule in each cell, by number of dims.
        The error of an integral is the difference between the coarse and the fine rule.
    parts
        Number of parts along each axis of a cell with a jump, by number of dims.
        Half as many parts change variances by up to 0.13 %, and twice as many by 0.05 %.
        A change of 0.13 % is smaller than the 95 % intervals of predicted variances.
    most_rough, rough
        Largest number of cells that are divided, by number of dims.
        A cell is divided only if g varies in it by more than `rough` times the mean over cells.
        Halving or doubling `most_rough` or `rough` changes nothing.
        A jump cuts a few hundred of 65,536 cells in 2-D, and a few thousand of 32,768 in 3-D.
    block
        Number of evaluations of g per call, 16 MB in 2-D. It has no effect on the result.
    clear, doubt
        Tables may miss a part of ∫g² that comes from poles inside cells.
        The part of ∫g² that tables miss is added if it exceeds `clear` times the error of ∫g².
        Scrambling multiplies the missed part of ∫g² by an unknown gain between 0 and about 1.
        `doubt` is the assumed uncertainty of the gain that multiplies the missed part of ∫g².
        With half of `clear`, variances have noise of 0.015 %. With twice `clear`, nothing changes.
    most_error, noise
        If half of the 95 % interval exceeds this fraction of the variance, an error is raised.
        If cells are less accurate than `most_error`, other methods have relative errors below 0.2.
        An interval is always accepted if half of it is below `noise` times ∫g².
        Halving or doubling `most_error` or `noise` changes nothing.
    """

    most_dims: int = 3
    cells: Mapping[int, int] = field(default_factory=lambda: {1: 2**16, 2: 2**16, 3: 2**15})
    long: int = 8
    most_cells: int = 2**18
    more: int = 3
    orders: Mapping[int, tuple[int, int]] = field(
        default_factory=lambda: {1: (6, 10), 2: (2, 3), 3: (2, 3)}
    )
    parts: Mapping[int, int] = field(default_factory=lambda: {1: 16, 2: 8, 3: 3})
    most_rough: Mapping[int, int] = field(default_factory=lambda: {1: 2**8, 2: 2**12, 3: 2**12})
    rough: float = 3.0
    block: int = 2**20
    clear: float = 2.0
    doubt: float = 0.5
    most_error: float = 0.2
    noise: float = 1e-12


_SETTINGS = LevelsSettings()
_ROUNDING = 4e-15
"""Relative rounding error of ∫g²: some units in the last place of double precision."""


def of_levels(law: Law, known: Known, stream: Stream) -> Predicted:  # noqa: ARG001
    """Predict the variance of scrambled nets and of strata from means of g over cells.

    Parameters
    ----------
    law
        The law of a sampler in 1 to 3 dims. Fixed sets must have nested or linear scrambling.
        Strata must not be shifted at random.
    known
        The integrand g, and the tables made for other counts and samplers.
    stream
        The random stream is not used, because the method draws no random numbers.

    Raises
    ------
    NoClosedForm
        If the sampler has another law, more than 3 dims or no randomness.
        If g is not finite at a node, or the result may be wrong by more than a fifth.

    References
    ----------
    [Owen1997]_, [Haber1967]_, [DickPillichshammer2010]_
    """
    if law.fixed:
        raise NoClosedForm(f"{law.name} {NO_VARIANCE}.")
    n, dims = law.n, law.dims
    if dims > _SETTINGS.most_dims:
        raise NoClosedForm(
            f"Tables of cells are for at most {_SETTINGS.most_dims} dims; {known.g.spec} has "
            f"{dims}."
        )
    if isinstance(law, Scrambled) and law.nested_pairs and isinstance(law.inner, Fixed):
        return _scrambled(law.inner, law.bases, known)
    offset = np.zeros(dims)
    if isinstance(law, Moved):
        offset, law = np.array(law.by), law.inner
    match law:
        case Strata(sides=sides, motif=AntitheticPair()) if not offset.any():
            mean = Known(paired(known.g, sides[0]))
            return _strata(sides, offset, n // 2, mean, "strata, pairs of points", whole=False)
        case Strata(sides=sides) if law.jittered:
            return _strata(sides, np.mod(offset, 1.0 / np.array(sides)), n, known, "strata")
        case PairedAxes() if law.latin and dims == 1 and not offset.any():
            return _strata((n,), offset, n, known, "strata")
    raise NoClosedForm(f"No gains by level and no strata are known for {law.name}.")


def _scrambled(net: Fixed, bases: tuple[int, ...], known: Known) -> Predicted:
    """Predict the variance of a fixed set under nested scrambling."""
    n, dims = net.n, net.dims
    origin: Any = (0,) * dims

    # Compute gains for a few digits beyond those of n, where all coordinates usually differ
    levels = math.ceil(math.log(max(n, 2), min(bases)) - 1e-9) + _SETTINGS.more
    try:
        gains = gains_at(net, bases, levels)
    except ParameterError as error:
        raise NoClosedForm(error, " Or use ", *MEASURE_IT, ".") from None
    wanted = np.abs(gains - 1.0) > 1e-9
    wanted[origin] = False

    # Sum Γ_l σ²_l and σ²_l over the levels of the tables
    least = _SETTINGS.cells[dims]
    most = max(least, min(_SETTINGS.long * n * math.prod(bases), _SETTINGS.most_cells))
    held = list(_tables(wanted, bases, least, most))
    counted = np.zeros(np.max(held, axis=0) + 1, bool)
    first, plain, weighed = None, 0.0, 0.0
    for cells in held:
        whole = first is None
        parts, *spread = known.once(
            ("levels", bases, cells, whole),
            functools.partial(_table, known.g, bases, cells, whole=whole),
        )
        first = first or (parts, *spread)
        at = tuple(np.indices([level + 1 for level in cells]))
        new = ~counted[at]
        new[origin] = False  # Level 0, the mean, has no gain
        ends = tuple(np.minimum(axis, side - 1) for axis, side in zip(at, gains.shape, strict=True))
        plain = plain + parts[:, new].sum(axis=1)
        weighed = weighed + (gains[ends][..., None] * parts)[:, new].sum(axis=1)
        counted[at] = True

    # The variance within cells is the same as for random points (gain 1)
    # if the tables contain every level whose gain differs from 1
    assert first is not None
    parts, within, off = first
    inside = parts.reshape(len(within), -1, within.shape[1]).sum(axis=1)
    missed = _missed(known, (within + inside)[-1])
    square = within + inside + missed
    rest = np.maximum(square - parts[(slice(None), *origin)] - plain, 0.0)
    missing = wanted.copy()
    missing[tuple(map(slice, counted.shape))] &= ~counted[tuple(map(slice, wanted.shape))]
    missing |= wanted & (np.indices(wanted.shape).max(axis=0) == levels)
    doubt = np.abs(gains[missing] - 1.0).max(initial=0.0) * rest[-1]
    doubt = off + _SETTINGS.doubt * missed + doubt
    return _predicted(weighed + rest, n, square[-1], "gains by level", rest=rest[-1], doubt=doubt)


def _tables(wanted: Array, bases: Sequence[int], least: int, most: int) -> Iterator[Levels]:
    """Yield the levels of each needed table: the number of digits along each axis.

    The first table has nearly equal numbers of cells along all axes.
    Longer tables, of up to `most` cells, have the wanted levels that the first table lacks.
    """

    def grown(levels: Levels, most: int = most) -> Levels:
        while True:
            sides = [b**level for b, level in zip(bases, levels, strict=True)]
            axis = int(np.argmin(sides))
            if math.prod(sides) * bases[axis] > most:
                return levels
            levels = tuple(level + (i == axis) for i, level in enumerate(levels))

    first = grown((0,) * len(bases), least)
    yield first
    left = [tuple(map(int, level)) for level in np.argwhere(wanted)]
    left = [levels for levels in left if math.prod(map(pow, bases, levels)) <= most]
    found = [first]
    while left := [v for v in left if any(map(int.__gt__, v, found[-1]))]:
        # Take the longest table first. Among equally long tables, take the one with most cells
        found.append(grown(max(left, key=lambda v: (max(v), sum(v)))))
        yield found[-1]


def _table(
    g: Integrand, bases: Sequence[int], levels: Levels, *, whole: bool
) -> tuple[Array, Array, Array]:
    """Return energies of g over cells, by a coarse and a fine rule (Q = 2) or exactly (Q = 1).

    The energies σ²_l have shape (Q, levels + 1 of each axis, channels).
    At level 0 the energy is the square of the mean.
    The second returned array is the mean variance within the cells, (Q, channels).
    The third returned array is twice the standard error of the mean variance within the cells.
    """
    sides = tuple(map(pow, bases, levels))
    means, squares = _cell_moments(g, sides, np.zeros(g.dims), refined=whole)

    # At jumps, the squared means of cells and the variance within cells have opposite errors.
    # If the squared means and the variance within cells are added, their errors cancel.
    # For long cells, only the squared means are computed, so their errors are not canceled.
    # Therefore the means by two quadrature rules are multiplied with each other, not squared.
    # The errors of the two quadrature rules are hardly correlated
    pairs = ([(0, 0), (-1, -1)] if whole else [(-1, -1), (0, -1)])[: len(means)]
    halves = [0.5 * (means[a] + sign * means[b]) for a, b in pairs for sign in (1.0, -1.0)]
    sums, differences = (
        np.stack([level_variances(h, tuple(bases)) for h in halves[k::2]]) for k in (0, 1)
    )
    return sums - differences, *_spread(means, squares)


def _spread(means: Array, squares: Array) -> tuple[Array, Array]:
    """Return the mean variance within cells, (Q, channels), and twice its error.

    The moments of g in each cell have shape (Q, …, channels).
    The moments come from Q = 2 quadrature rules, or from a closed form.
    The means of two rules over all cells may agree by chance, so the rules are compared per cell.
    Errors in different cells are independent: the error is the root sum of squares over cells.
    """
    within = np.maximum(squares - means**2, 0.0).reshape(len(means), -1, means.shape[-1])
    error = 2.0 * np.sqrt(((within[-1] - within[0]) ** 2).sum(axis=0)) / within.shape[1]
    return within.mean(axis=1), error


def _cell_moments(
    g: Integrand, sides: tuple[int, ...], offset: Array, *, refined: bool = True
) -> tuple[Array, Array]:
    """Return means of g and of g² over cells displaced by `offset`, both (Q, *sides, channels).

    If `refined`, cells with much variation are integrated more finely, unless moments are exact.
    """
    dims = g.dims
    if in_closed_form(g):
        mean, square = stratum_moments(g, sides, offset, 1)
        return mean.reshape(1, *sides, -1), square.reshape(1, *sides, -1)
    # If an axis has more cells than in a cubic table, the cells are shorter along this axis.
    # Shorter cells need one quadrature node less along the axis
    fine = np.array([not refined and side**dims > _SETTINGS.cells[dims] for side in sides])
    by_order = [stratum_moments(g, sides, offset, order - fine) for order in _SETTINGS.orders[dims]]
    means = np.stack([m for m, _ in by_order]).reshape(2, *sides, -1)
    squares = np.stack([s for _, s in by_order]).reshape(2, *sides, -1)
    if not (np.isfinite(means).all() and np.isfinite(squares).all()):
        raise NoClosedForm(f"{g.spec} is not finite everywhere; use ", *MEASURE_IT, ".")
    if not refined:
        return means, squares

    # Find the cells in which g varies most, or differs most from g in the neighboring cells.
    # Skip cells that contain a break of g, where the quadrature is divided anyway
    from scipy.ndimage import maximum_filter, minimum_filter

    size = (3,) * dims + (1,)
    fine = means[-1]
    varies = maximum_filter(fine, size, mode="nearest") - minimum_filter(fine, size, mode="nearest")
    varies = varies + np.sqrt(np.maximum(squares[-1] - fine**2, 0.0))
    rough = (varies / np.maximum(varies.max(axis=tuple(range(dims))), 1e-300)).sum(axis=-1)
    limit = _SETTINGS.rough * rough.mean()
    # Cells at 0 and 1 are not refined, because warps have their poles there
    edges = (0.0, *((1e-9, 1.0 - 1e-9) if dims <= 2 else ()))
    for axis, breaks in enumerate(g.breaks):
        place = (np.array([*edges, *breaks]) - offset[axis]) % 1.0 * sides[axis]
        cut = place[np.abs(place - np.rint(place)) > 1e-12]
        rough[(slice(None),) * axis + (np.minimum(cut, sides[axis] - 1).astype(np.int64),)] = 0.0
    most = min(_SETTINGS.most_rough[dims], rough.size)
    chosen = np.argpartition(rough.ravel(), rough.size - most)[rough.size - most :]
    chosen = np.sort(chosen[rough.ravel()[chosen] > limit])

    # Integrate over the parts of the chosen cells
    channels = means.shape[-1]
    for q, order in enumerate(_SETTINGS.orders[dims]):
        node, weight = gauss_rule(order)
        nodes = ((np.arange(_SETTINGS.parts[dims])[:, None] + node) / _SETTINGS.parts[dims]).ravel()
        weights = np.tile(weight / _SETTINGS.parts[dims], _SETTINGS.parts[dims])
        inside, shares = grid(nodes, dims), grid(weights, dims)
        shares = shares.prod(axis=1)
        step = max(1, _SETTINGS.block // len(shares))
        for start in range(0, len(chosen), step):
            some = chosen[start : start + step]
            corner = np.stack(np.unravel_index(some, sides), axis=-1)
            x = (corner[:, None] + inside) / sides + offset
            values = g(np.where(x < 1.0, x, x - 1.0)).reshape(len(some), len(shares), channels)
            means[q].reshape(-1, channels)[some] = shares @ values
            squares[q].reshape(-1, channels)[some] = shares @ values**2
    return means, squares


def _strata(
    sides: tuple[int, ...], offset: Array, n: int, known: Known, how: str, *, whole: bool = True
) -> Predicted:
    """Predict the variance of a mean of n independent values of g, one in each of n equal strata.

    If the whole cube is a single stratum, all n values are at uniform points of the cube.

    If `whole`, g is the same for all n, so that one computation of ∫g² serves all counts.
    """
    # Choose cells that divide the strata, up to the number of cells in the settings
    sizes = sides
    while not in_closed_form(known.g):
        axis = int(np.argmin(sizes))
        finer = tuple(cells + (i == axis) * sides[i] for i, cells in enumerate(sizes))
        if math.prod(finer) > _SETTINGS.cells[known.g.dims]:
            break
        sizes = finer
    means, squares = known.once(
        ("moments", sizes, *offset), lambda: _cell_moments(known.g, sizes, offset)
    )
    square = squares[-1].reshape(-1, squares.shape[-1]).mean(axis=0)
    value, error = _spread(_merged(means, sides), _merged(squares, sides))
    missed = _missed(known, square) if whole else 0.0 * square
    return _predicted(
        value + missed, n, square + missed, how, doubt=error + _SETTINGS.doubt * missed
    )


def _missed(known: Known, square: Array) -> Array:
    """Return the part of ∫g² that a table misses, because its cells do not resolve poles."""
    if in_closed_form(known.g):
        return 0.0 * square
    exact, error = known.square
    return np.where(exact - square > _SETTINGS.clear * error, exact - square, 0.0)


def _merged(moment: Array, sides: tuple[int, ...]) -> Array:
    """Average moments over coarser cells; the moments are (Q, cells of each axis, channels)."""
    for axis, side in enumerate(sides, start=1):
        shape = (*moment.shape[:axis], side, -1, *moment.shape[axis + 1 :])
        moment = moment.reshape(shape).mean(axis=axis + 1)
    return np.asarray(moment)


def _predicted(
    scaled: Array, n: int, square: Array, how: str, *, rest: Any = 0.0, doubt: Any = 0.0
) -> Predicted:
    """Return the predicted variance and its interval.

    The array `scaled` has n times the variance, as computed by each of Q quadrature rules.
    The shape of `scaled` is (Q, channels).
    """
    rounding = _ROUNDING * square
    value = np.where(scaled[-1] > rounding, scaled[-1], 0.0)
    error = np.abs(scaled[-1] - scaled[0]) + doubt + rounding + 1e-9 * value
    if ((error > _SETTINGS.most_error * value) & (error > _SETTINGS.noise * square)).any():
        raise NoClosedForm(
            f"Cells do not resolve the variance: {np.max(value) / n:.3g} may be wrong by "
            f"{np.max(error) / n:.2g}; use ",
            Function("convergence"),
            ".",
        )
    rest = np.broadcast_to(np.asarray(rest, float), value.shape)
    share = 1.0 - rest / np.maximum(square, 1e-300)
    return Predicted(value / n, error / n, how, share, np.minimum(rest, value) / n)
