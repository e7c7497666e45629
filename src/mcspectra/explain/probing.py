"""Roughness of a black-box function: jumps, cusps and kinks on lines, and poles.

g is evaluated in equal steps along a line, and close to its ends.
The step is halved repeatedly around the largest second difference.
Each halving takes two evaluations of g.
The second difference shrinks with the square of the step where the function is smooth.
At a kink, the second difference is proportional to the step.
At a cusp |t|^a, the second difference is proportional to the power a of the step.
The second difference stays constant at a jump, and it grows at a pole.
On lines along the axes, g is also evaluated at decreasing distances from both ends.
The slope of log |g| at these distances is the exponent with which g grows at the border.

Another search, called a climb, moves uphill to poles.
A climb starts at the largest or the smallest known value of g.
The climb moves in random directions in which |g| grows.
If |g| grows in none of the tried directions, the step is halved.
The random directions follow an ellipsoid that adapts to previous moves ([Hansen2001]_).
The climb ends early if the function is bounded.
A function that grows as r^−a toward a set of codimension k leads the climb to that set.
At distances r from the end of the climb, the differences g(r) − g(4r) are ∝ r^−a.
The differences g(r) − g(4r) determine the exponent a, whatever constant is added to g.
Near the pole, |g|^(−2/a) is a quadratic form of the position, with the codimension k as rank.
If the pole is on faces of the cube, each of these faces adds one to the codimension.

The volume in which |g| > λ is ∝ λ^(−k/a).
Therefore ∫g² is infinite for a/k ≥ ½, and the integral does not exist for a/k ≥ 1.
Where several faces meet, g may be a product of powers of the distances to these faces.
Two exponents are then compared: the largest one at a single face, and the mean over the faces.
The larger exponent, single-face or mean, determines how large values of |g| are distributed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import BudgetError, ParameterError

__all__ = [
    "LINE_SETTINGS",
    "POLE_SETTINGS",
    "LineSettings",
    "Lines",
    "Pole",
    "PoleSettings",
    "grain",
    "lines_of",
    "mean_dimension",
    "pole_of",
]


@final
@dataclass(frozen=True)
class LineSettings:
    """Settings of evaluations on lines, and limits that separate poles, jumps, cusps and kinks.

    Comments refer to the 152 test cases of ``python -m benchmarks settings``.
    A test case fails if the first cause of its profile is not the right one.
    """

    # Number of equal steps along a line in which g is evaluated, before steps are halved.
    # Values from 8 to 16 give the same results.
    # With 32 steps, the budget allows half as many lines, and two of 152 test cases fail.
    steps: int = 16
    # Number of halvings of the step around the place with the largest second difference of g.
    # After 12 halvings, the step is 1.5e-5 of the length of the line, which is far above rounding.
    # The step 1.5e-5 is far below 1/16, the distance of features that 16 equal steps can find.
    # With 6 halvings, 29 of 152 test cases fail; values from 12 to 24 give the same results.
    halvings: int = 12
    # Number of final halvings whose second differences determine the exponent.
    # Values from 3 to 6 give the same results; with 12, two of 152 test cases fail.
    late: int = 6
    # A line crosses a pole if the exponent of its second differences is below this value.
    # A jump has the exponent 0, and a pole r^−a has the exponent −a.
    # Values from −0.3 to −0.075 give the same results.
    pole: float = -0.15
    # A line may cross a jump if the exponent is below this value. A kink has the exponent 1.
    # A jump has the exponent 0, or up to 0.3 next to a steep part.
    # Values from 0.2 to 0.8 give the same results.
    jump: float = 0.4
    # If a line may cross a jump, its last step is bisected this number of times.
    # After the bisections, a jump keeps at least this fraction of its height.
    # A cusp of order 0.15 keeps 2^(−8 · 0.15) = 0.44 of its height on average.
    # The step after 8 bisections is 6e-8 of the line, so narrower ramps look like jumps.
    bisections: int = 8
    kept: float = 0.75
    # A line without a jump or pole crosses a cusp if the exponent is below this value.
    # A cusp |t|^a has the exponent a, with an error of about 0.1 on one line.
    # No line through a kink had an exponent below 0.86.
    cusp: float = 0.8
    # A line without a jump, pole or cusp crosses a kink if the exponent is below this value.
    # A kink has the exponent 1, and a smooth function has the exponent 2.
    # Of 152 test cases, 14 fail with the value 0.8.
    # With the value 3.2, smooth functions count as kinks, and 36 test cases fail.
    kink: float = 1.6
    # Smallest height of a jump, as a fraction of the spread of g.
    # A jump with a height of 1e-4 of the spread of g causes 1e-8 of the variance.
    # With the numbers of points in a profile, 1e-8 of the variance is always negligible.
    # Values from 5e-5 to 2e-4 give the same results.
    least_jump: float = 1e-4
    # Second differences below this fraction of the spread of g count as rounding.
    # After 12 halvings, the second difference of a smooth g is about 1e-9 of the spread.
    # Values from 5e-10 to 2e-9 give the same results.
    negligible: float = 1e-9
    # Second differences below this number of float spacings also count as rounding.
    # The float spacing is taken at the largest value of g.
    # A sum of a thousand terms in random order is off by about √1000 = 32 spacings.
    # Values from 16 to 64 give the same results.
    grains: float = 32.0
    # Near the end of a line, g is evaluated at decreasing distances from this end.
    # g grows without bound if the last growth of |g| exceeds this multiple of the growth before.
    # The ratio of the last two growths is 2^−10 for a bounded g, 1 for ln t, and 2^(10a) for t^−a.
    # Values from 0.33 to 0.65 give the same results.
    # With the value 1.3, logarithmic growth is missed, and six of 152 test cases fail.
    goes_on: float = 0.65
    # To test whether a jump is normal to an axis, lines are displaced by up to this distance.
    # If an edge has a slope of 1, its crossing with the line then moves by at least 0.0025.
    # After the last halving, steps are about 100 times smaller than 0.0025.
    # Values from 0.0025 to 0.01 give the same results.
    aside: float = 0.005
    # Number of groups of axes. An oblique line (chord) is displaced along one group at a time.
    # If an edge is normal to an axis, its crossing moves only with displacements along this axis.
    # An edge that is oblique to two axes seems normal to an axis with probability 1/3.
    # An edge that is oblique to more than two axes seems normal with a smaller probability.
    groups: int = 3
    # Distances from both ends at which g is evaluated on a line along an axis.
    # From the distance 2^−30 to the distance 2^−40, even the function t^−0.08 grows 1.7 times.
    # The number 1 − 2^−40 is still exact in float64.
    # Half and twice these distances give the same results.
    ends: tuple[float, ...] = (2.0**-4, 2.0**-12, 2.0**-20, 2.0**-30, 2.0**-40)
    # Distance from an end of a line at which g must be computable.
    # A sample of a few thousand points also has points at a distance of 2^−12 from the border.
    inside: float = 2.0**-12

    @property
    def line(self) -> int:
        """Number of evaluations of g on a line along an axis."""
        return self.steps + 2 * self.halvings + self.bisections + 2 * len(self.ends) + 2

    @property
    def chord(self) -> int:
        """Number of evaluations of g on a line that is not parallel to an axis."""
        return self.steps + 2 * self.halvings + self.bisections + 2 * self.groups


LINE_SETTINGS = LineSettings()
"""Default settings of the lines on which g is evaluated."""


@final
@dataclass(frozen=True)
class PoleSettings:
    """Settings of the uphill search for a pole, and of measurements at the pole.

    The search is called a climb. It takes steps to places with larger values of |g|.
    The last place of a climb is called its top.

    Comments refer to the 152 test cases of ``python -m benchmarks settings``, 18 with a pole.
    A test case fails if the first cause of its profile is not the right one.
    """

    # Maximum number of halvings of the step of a climb.
    # A climb starts with a step equal to the distance between neighboring points.
    # After 16 halvings, the largest radius in `radii` is 1/16 of the step at the start.
    # With 8 halvings, 30 of 152 test cases fail, and 10 of 18 poles are measured wrongly.
    # Values from 16 to 32 give the same results.
    halvings: int = 16
    # Largest number of moves with the same step size before the step is halved.
    # Values from 3 to 12 give the same results.
    moves: int = 6
    # The halvings of a climb's step are divided into groups. This is the number in each group.
    # The climb goes on or ends, depending on the medians of |g| over the last three groups.
    # With 2 halvings in a group, one of 18 poles is measured wrongly.
    # Values from 3 to 6 give the same results.
    group: int = 3
    # A climb ends if |g| grows less and less after each group of halvings of the step.
    # If the last growth of |g| is below this multiple of the growth before, g counts as bounded.
    # Near a smooth maximum, three halvings multiply the growth of |g| by 4^−3.
    # Near a pole where g grows like ln r, |g| grows equally in each group of halvings.
    # Values from 0.15 to 0.6 give the same results.
    bounded: float = 0.3
    # Number of rays that start at the top, the point of largest |g| that a climb found.
    # The exponent of a pole is the median of the exponents along the rays.
    # Values from 3 to 12 give the same results.
    rays: int = 6
    # The climb draws random directions from an ellipsoid, which adapts to successful moves.
    # Weight of the newest move in the adapted ellipsoid, from 0 to 1.
    # Values from 0.2 to 0.4 give the same results; with 0.8, one of 18 poles is measured wrongly.
    learning_rate: float = 0.4
    # A pole is measured by values of g at these distances (radii) from the top, along each ray.
    # The unit of the radii is the last step of the climb.
    # Each radius is 4 times the previous radius. The smallest radius is 16 steps.
    # If the top misses the pole by one step, the smallest radius is wrong by at most 6 %.
    # Half and twice these radii give the same results.
    radii: tuple[float, ...] = (2.0**4, 2.0**6, 2.0**8, 2.0**10, 2.0**12)
    # Growth of g toward a single face is measured at this number of radii, from the smallest up.
    # Three radii determine an exponent, whatever constant is added to g.
    # With 2 radii, four of 152 test cases fail; values from 3 to 6 give the same results.
    near: int = 3
    # The top is not a pole if g rises outward on more than this fraction of the rays.
    # Values from 0.125 to 0.5 give the same results.
    rising: float = 0.25
    # Distance from all other faces at which growth toward one face is measured.
    # The unit of the distance from the faces is the last step of the climb.
    # A climb halves its first step 16 times, so 2^15 last steps are half of the first step.
    # Growth toward one face is measured at radii up to 2^8, which are much smaller than 2^15.
    # Values from 2^14 to 2^16 give the same results.
    away: float = 2.0**15
    # If g grows toward a single face with an exponent above this value,
    # the pole is measured as a pole of this face or of all faces that meet at the top.
    # Values from 0.025 to 0.1 give the same results.
    alone: float = 0.05
    # Limit for eigenvalues of the quadratic form |g|^(−2/a), divided by its largest eigenvalue.
    # The codimension is the number of eigenvalues above this limit.
    # Values from 0.002 to 0.008 give the same results.
    rank: float = 0.004
    # A move of the climb is accepted if |g| grows by more than this factor.
    # Values down to 0.5 give the same results.
    # With a factor of 2, few moves are accepted, and 15 of 18 poles are missed.
    better: float = 1.005
    # Number of the largest values of |g| that are compared to decide whether a climb starts.
    # Before |g| is taken, the median of all known values is subtracted from g.
    # Values from 8 to 32 give the same results.
    compared: int = 16
    # A climb starts only if the 16 largest values of |g| differ by at least this fraction.
    # Values from 0.05 to 0.2 give the same results.
    stands_out: float = 0.1
    # Growth with an exponent below this value counts as logarithmic.
    # An exponent below −0.02 shows that there is no pole.
    # In `test_exponents_and_codimensions_of_poles_are_measured`, exponents have errors up to 0.02.
    # Values from 0.01 to 0.04 give the same results.
    least_exponent: float = 0.02


POLE_SETTINGS = PoleSettings()
"""Default settings of the uphill search for a pole, and of measurements at the pole."""

# If the top of a climb is on a face of the cube, it is moved to this distance from the face.
# The distance is the spacing of float64 numbers below 1
_EDGE = 2.0**-53

Function = Callable[[Array], Array]


@final
@dataclass(frozen=True)
class Lines:
    """Measurements on K lines through the cube.

    Attributes
    ----------
    axis
        Axis to which each line is parallel, or −1 for chords: (K,).
    exponent
        Exponent a if the second difference at the roughest place is ∝ step^a: (K,).
    kept
        Change of g over the last step after bisections, as a fraction of the change before: (K,).
        `kept` is 0 for lines whose last step is not bisected.
    place
        Position of the roughest place along the line, from 0 to 1: (K,).
    height
        Size of the change of g over the last step at the roughest place: (K,).
    straight
        Whether the change of g has the same position on a line displaced along other axes.
        If both positions are equal, the discontinuity is normal to one axis: (K,).
    growth
        Exponents a of g ~ t^−a at both ends of a line, 0 if g does not grow there: (K, 2).
        NaN for chords.
    ends
        Difference of g between both ends of the line: (K,); NaN for chords.
    waves
        A cosine with this many periods has g's variance and largest second derivative: (K,).
    turns
        Fraction of the places on the line that are higher or lower than both neighbors: (K,).
    spread
        Variance of g along the line: (K,).
    settings
        Settings with which g was evaluated on lines, and limits of the exponents.
    failed
        Error message, with a position, if g could not be evaluated close to some ends of lines.
        The text is empty if all evaluations succeeded.
        If g has no values close to an end, no growth is reported at this end.
    """

    axis: Array
    exponent: Array
    kept: Array
    place: Array
    height: Array
    straight: Array
    growth: Array
    ends: Array
    waves: Array
    turns: Array
    spread: Array
    settings: LineSettings = LINE_SETTINGS
    failed: str = ""

    @property
    def _rough(self) -> Array:
        """Return lines whose roughest place is a pole, a cusp or a kink."""
        jump = self.kept > self.settings.kept
        return np.asarray(~jump & (self.exponent < self.settings.kink))

    @property
    def _steep(self) -> tuple[Array, bool]:
        """Return lines through poles or cusps, and whether they go through poles.

        The exponent of a single line through a cusp may be negative by chance.
        Therefore the median over the lines decides between a cusp and a pole.
        """
        steep = self._rough & (self.exponent < self.settings.cusp)
        return steep, bool(steep.any() and np.median(self.exponent[steep]) < 0.0)

    def jumps(self, scale: float) -> Array:
        """Return lines whose roughest place is a jump, large compared with the spread of g."""
        large = self.height > self.settings.least_jump * scale
        return np.asarray(large & (self.kept > self.settings.kept))

    def poles(self) -> Array:
        """Return lines whose roughest place is a pole."""
        steep, poles = self._steep
        return np.asarray(steep & (self.exponent < self.settings.pole) & poles)

    def cusps(self) -> Array:
        """Return lines whose roughest place is a cusp: g is continuous with an infinite slope."""
        steep, poles = self._steep
        return np.asarray(steep & (not poles))

    def kinks(self) -> Array:
        """Return lines whose roughest place is a kink."""
        return np.asarray(self._rough & (self.exponent >= self.settings.cusp))


def grain(values: Array) -> float:
    """Return the spacing of floating-point numbers at the largest of the values.

    The numbers are float32 if float32 represents all values exactly, otherwise float64.
    """
    size = np.abs(values).max(initial=0.0)
    with np.errstate(over="ignore"):
        single = (values.astype(np.float32) == values).all()
    return float(np.spacing(np.float32(size) if single else size))


def lines_of(
    g: Function,
    dims: int,
    evaluations: int,
    rng: np.random.Generator,
    settings: LineSettings = LINE_SETTINGS,
) -> Lines:
    """Evaluate g on lines along each axis in turn and, in several dims, on as many oblique lines.

    Parameters
    ----------
    g
        Function of points (k, d) with values (k,).
    dims
        Number of dims d.
    evaluations
        Maximum number of evaluations of g.
    """
    pairs = evaluations // (settings.line + (settings.chord if dims > 1 else 0))
    if pairs < 1:  # Earlier probes may have spent a few evaluations more than their share
        none = np.empty(0)
        return Lines(
            axis=none.astype(int),
            exponent=none,
            kept=none,
            place=none,
            height=none,
            straight=none.astype(bool),
            growth=np.empty((0, 2)),
            ends=none,
            waves=none,
            turns=none,
            spread=none,
            settings=settings,
        )
    order = np.concatenate([rng.permutation(dims) for _ in range(pairs // dims + 1)])[:pairs]
    axis = np.concatenate([order, np.full(pairs if dims > 1 else 0, -1)]).astype(int)
    start, way = rng.random((len(axis), dims)), np.zeros((len(axis), dims))
    for k, i in enumerate(axis):
        if i >= 0:
            start[k, i], way[k, i] = 0.0, 1.0
        else:  # Draw a chord from face to face
            direction = rng.standard_normal(dims)
            with np.errstate(divide="ignore"):
                near, far = np.sort([-start[k] / direction, (1 - start[k]) / direction], axis=0)
            start[k], way[k] = (
                start[k] + near.max() * direction,
                (far.min() - near.max()) * direction,
            )

    def at(t: Array, which: Any = slice(None)) -> Array:
        """Return values of g at places (K, m) on all lines, or on selected lines only."""
        x = start[which, None] + t[..., None] * way[which, None]
        return g(np.clip(x, 0.0, BELOW_ONE).reshape(-1, dims)).reshape(t.shape)

    # Each line has its own step and offset, so that no wave is in phase with all lines
    part = rng.uniform(0.75, 1.0, (len(axis), 1))
    t = part * (np.arange(settings.steps) + rng.uniform(0.2, 0.8, (len(axis), 1)))
    t /= settings.steps
    t += rng.random((len(axis), 1)) * (1.0 - part)
    y = at(t)
    spread = y.var(axis=1)
    turns = (np.diff(np.sign(np.diff(y, axis=1)), axis=1) != 0).mean(axis=1)
    rows = np.arange(len(axis))

    # Examine the ends of lines along the axes.
    # g grows at an end if |g| increases at each step toward the end and exceeds all other values
    usual, straight = np.abs(y).max(), axis >= 0
    growth, ends = np.full((len(axis), 2), np.nan), np.full(len(axis), np.nan)
    gaps = np.array(settings.ends)
    near = np.broadcast_to(gaps, (straight.sum(), len(gaps)))
    both, failed = np.concatenate([near, 1.0 - near], axis=1), ""
    try:
        outer = at(both, straight)
    except BudgetError:
        raise
    except ParameterError:  # Omit the ends of lines on which g raises an error near the border
        outer = np.full(both.shape, np.nan)
        for k, row in enumerate(np.flatnonzero(straight)):
            try:
                outer[k] = at(both[k : k + 1], [row])[0]
            except BudgetError:
                raise
            except ParameterError as error:
                failed = failed or str(error)
                inside = np.flatnonzero(np.tile(gaps >= settings.inside, 2))
                outer[k, inside] = at(both[k : k + 1, inside], [row])[0]
    outer = np.stack(np.split(outer, 2, axis=1))
    size = np.maximum(np.abs(outer), 1e-300)
    slope = np.log(size[..., -1] / size[..., -2]) / math.log(gaps[-2] / gaps[-1])
    gains = np.diff(size, axis=-1)
    grows = (gains > 0).all(axis=-1) & (size[..., -1] > usual)
    grows &= gains[..., -1] > settings.goes_on * gains[..., -2]
    growth[straight] = np.where(grows, slope, 0.0).T
    ends[straight] = outer[1, :, 1] - outer[0, :, 1]

    # Halve the steps around the largest second difference.
    # Near an end, second differences are used only if g does not grow toward this end.
    # On every second line, steps are halved around the largest fourth difference of g.
    # A fourth difference shows a kink even if g is steep elsewhere
    wide = np.full((2, len(axis)), np.nan)
    wide[:, straight] = np.where(grows, np.nan, outer[..., 1])
    t = np.column_stack([np.full(len(axis), gaps[1]), t, np.full(len(axis), 1.0 - gaps[1])])
    y = np.column_stack([wide[0], y, wide[1]])
    middle = 1 + np.argmax(np.nan_to_num(_bends(t, y), nan=-1.0), axis=1)
    middle[1::2] = 3 + np.argmax(np.abs(np.diff(y[1::2, 1:-1], 4, axis=1)), axis=1)
    window, values = (a[rows[:, None], middle[:, None] + (-1, 0, 1)] for a in (t, y))
    sizes = [_bends(window, values)[:, 0]]
    for _ in range(settings.halvings):
        between = 0.5 * (window[:, 1:] + window[:, :-1])
        new = at(between)
        five = np.stack([window[:, 0], between[:, 0], window[:, 1], between[:, 1], window[:, 2]], 1)
        y5 = np.stack([values[:, 0], new[:, 0], values[:, 1], new[:, 1], values[:, 2]], 1)
        second = _bends(five, y5)
        chosen = np.argmax(second, axis=1)
        sizes.append(second[rows, chosen])
        pick = chosen[:, None] + np.arange(3)
        window, values = five[rows[:, None], pick], y5[rows[:, None], pick]
    size = np.array(sizes)[-settings.late - 1 :]
    scale = max(float(np.sqrt(spread.mean())), 1e-300)
    floor = max(settings.negligible * scale, settings.grains * grain(y[:, 1:-1]))
    rough = size[-1] > floor
    # Ignore second differences at rounding level: they are meaningless.
    # If the last second difference is at rounding level, use the first one above this level
    first = np.argmax(size > floor, axis=0)
    size = np.where(size > floor, size, np.maximum(size[first, rows], 1e-300))
    slope = -np.polyfit(np.arange(settings.late + 1), np.log2(size), 1)[0]
    exponent = np.where(rough, slope, 2.0)
    # A steep end of a line is neither a jump nor a kink.
    # Bounded functions of normal quantiles, for example, are steep at the ends of lines
    edge = np.abs(window[:, 1] - 0.5) > 0.5 - 4.0 * gaps[1]
    exponent[edge & (exponent >= settings.pole)] = 2.0

    # Bisect the half-step with the larger change of g: a jump keeps its height, a cusp does not
    height, kept = np.abs(np.diff(values, axis=1)).max(axis=1), np.zeros(len(axis))
    may = np.flatnonzero((exponent >= settings.pole) & (exponent < settings.jump))
    right = np.argmax(np.abs(np.diff(values[may], axis=1)), axis=1)[:, None] + (0, 1)
    ends_t, ends_y = (a[may[:, None], right] for a in (window, values))
    for _ in range(settings.bisections if len(may) else 0):
        between = ends_t.mean(axis=1, keepdims=True)
        new = at(between, may)
        left = np.abs(new - ends_y[:, :1]) > np.abs(ends_y[:, 1:] - new)
        ends_t = np.where(
            left, np.hstack([ends_t[:, :1], between]), np.hstack([between, ends_t[:, 1:]])
        )
        ends_y = np.where(left, np.hstack([ends_y[:, :1], new]), np.hstack([new, ends_y[:, 1:]]))
    kept[may] = np.abs(np.diff(ends_y, axis=1)[:, 0]) / np.maximum(height[may], 1e-300)

    # Evaluate g again at the ends of the smallest steps, displaced toward the center of the cube.
    # A line parallel to an axis is displaced along all other axes at once.
    # A chord, which is oblique, is displaced along one group of axes after another.
    # On the displaced line, a discontinuity that is not normal to an axis lies at another place
    stays = np.ones(len(axis), bool)
    if dims > 1:
        groups = min(settings.groups, dims)
        group = rng.permuted(np.tile(np.arange(dims) % groups, (len(axis), 1)), axis=1)
        # Displacements have random lengths, which prevents cancellation along a slanted edge
        steps = settings.aside * rng.uniform(0.5, 1.0, (len(axis), dims))
        pair = start[:, None] + window[:, ::2, None] * way[:, None]
        aside = np.where(pair[:, :1] < 0.5, steps[:, None], -steps[:, None])

        def moved(which: Array, along: Array) -> Array:
            """Return whether the change of g disappears if lines are displaced along given axes."""
            x = pair[which] + np.where(along[:, None], aside[which], 0.0)
            found = g(np.clip(x, 0.0, BELOW_ONE).reshape(-1, dims)).reshape(-1, 2)
            return np.asarray(np.abs(np.diff(found, axis=1)[:, 0]) <= 0.5 * height[which])

        stays[straight] = ~moved(straight, axis[straight, None] != np.arange(dims))
        lost = [moved(~straight, group[~straight] == k) for k in range(groups)]
        stays[~straight] = np.sum(lost, axis=0) <= 1

    bend = 4.0 * _bends(window, values)[:, 0] / (window[:, 2] - window[:, 0]) ** 2
    varies = np.where(spread > 0.0, np.sqrt(2.0 * spread), np.inf)
    waves = np.sqrt(bend / varies) / (2.0 * math.pi)

    return Lines(
        axis=axis,
        exponent=exponent,
        kept=kept,
        place=window[:, 1],
        height=height,
        straight=stays,
        growth=growth,
        ends=ends,
        waves=waves,
        turns=turns,
        spread=spread,
        settings=settings,
        failed=failed,
    )


def _bends(t: Array, y: Array) -> Array:
    """Return second differences at places (K, m), scaled to equal steps, as (K, m − 2)."""
    span = t[:, 2:] - t[:, :-2]
    return np.asarray(0.5 * span * np.abs(np.diff(np.diff(y) / np.diff(t))))


def mean_dimension(g: Function, points: Array, values: Array, rng: np.random.Generator) -> float:
    """Return the mean dimension Σ_i T_i/Var g, where T_i is the total variance of coordinate i.

    T_i is half the mean squared change of g when coordinate i is redrawn.
    The values (k,) of g at the points (k, d) are given.
    For each of the k points, g is evaluated at d more points.
    """
    k, d = points.shape
    total = 0.0
    for i in range(d):
        moved = points.copy()
        moved[:, i] = rng.random(k)
        total += 0.5 * float(((g(moved) - values) ** 2).mean())
    variance = float(values.var(ddof=1))
    return total / variance if variance > 0.0 else math.nan


@final
@dataclass(frozen=True)
class Pole:
    """A set toward which a function grows without bound.

    Attributes
    ----------
    place
        One point of the set toward which the function grows, (d,).
    exponent
        Exponent a of r^−a, where r is the distance to the pole.
    codimension
        Codimension k of the pole, which is 1 for a surface and d for a point.
    border
        Whether the pole lies on the border of the cube.
    """

    place: Array
    exponent: float
    codimension: int
    border: bool

    @property
    def tail(self) -> float:
        """Tail index of the values of the function: the exponent a divided by the codimension k."""
        return self.exponent / self.codimension


def pole_of(
    g: Function,
    points: Array,
    values: Array,
    evaluations: int,
    rng: np.random.Generator,
    settings: PoleSettings = POLE_SETTINGS,
) -> Pole | None:
    """Search uphill for a pole from the value furthest from the median, then from the other end.

    Parameters
    ----------
    g
        Function of points (k, d) with values (k,).
    points, values
        Points (k, d) at which g is known, and its values (k,).
    evaluations
        Maximum number of evaluations of g.
    """
    d = points.shape[1]
    centre, left = float(np.median(values)), evaluations

    def height(x: Array) -> Array:
        return np.abs(g(x) - centre)

    # Climb only from exceptional values; the largest values of a bounded function are similar
    measure = settings.rays * len(settings.radii) + d * settings.near + d * (d + 1) // 2
    order = np.argsort(values)
    for largest in sorted((order[::-1], order), key=lambda k: -abs(values[k[0]] - centre)):
        top, least = np.abs(values[largest[[0, min(settings.compared, len(values)) - 1]]] - centre)
        if not top - least > settings.stands_out * top:
            continue
        step = len(points) ** (-1.0 / d)
        place, step, made = _climbed(
            height, points[largest[0]], step, left - measure, rng, settings
        )
        left -= made
        pole = _measured(height, place, step, rng, settings) if step > 0.0 else None
        if pole is not None:
            return pole
        left -= measure if step > 0.0 else 0
    return None


def _climbed(
    g: Function,
    x: Array,
    step: float,
    evaluations: int,
    rng: np.random.Generator,
    settings: PoleSettings,
) -> tuple[Array, float, int]:
    """Return the last place of the climb, the last step (0 if g is bounded), and evaluations."""
    d, made, moves, value = len(x), 0, 0, 0.0
    heights, shape = list[float](), np.eye(d)
    while len(heights) < settings.halvings:
        if made + 2 * d > evaluations:
            return x, 0.0, made
        ways = np.linalg.qr(rng.standard_normal((d, d)))[0] @ np.linalg.cholesky(shape).T
        size = step * rng.uniform(0.8, 1.25)  # Random steps never return to the same point
        around = np.clip(x + size * np.concatenate([ways, -ways]), 0.5 * step, 1.0 - 0.5 * step)
        new = g(around)
        made += 2 * d
        if new.max() > settings.better * value:
            # Adapt the ellipsoid of random directions to the direction of the accepted move
            best = around[np.argmax(new)]
            own = settings.learning_rate * np.outer(best - x, best - x) / size**2
            shape = (1.0 - settings.learning_rate) * shape + own
            shape /= np.linalg.det(shape) ** (1.0 / d)
            x, value, moves = best, float(new.max()), moves + 1
            if moves <= settings.moves:
                continue
        heights.append(float(np.median(new)))
        step, moves = 0.5 * step, 0
        recent = 3 * settings.group
        if len(heights) >= recent:
            first, second, third = np.median(np.reshape(heights[-recent:], (3, -1)), axis=1)
            if not third - second > settings.bounded * (second - first):
                return x, 0.0, made
    return x, step, made


def _measured(
    g: Function, top: Array, step: float, rng: np.random.Generator, settings: PoleSettings
) -> Pole | None:
    """Measure a pole along rays, and by a quadratic form.

    Both measurements start at the top: the last place of the uphill search for the pole.
    """
    d, radii = len(top), np.array(settings.radii)
    top = np.where(top < 2.0 * step, _EDGE, np.where(top > 1.0 - 2.0 * step, 1.0 - _EDGE, top))
    inward = np.where(top < 0.5, 1.0, -1.0)
    side = np.minimum(top, 1.0 - top) < radii[-1] * step
    ways = rng.standard_normal((settings.rays, d))
    ways = np.where(side, np.abs(ways) * inward, ways)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    rays = top + step * radii[:, None, None] * ways
    values = g(rays.reshape(-1, d)).reshape(len(radii), settings.rays)
    if (np.diff(values, axis=0) >= 0.0).any(axis=0).mean() > settings.rising:
        return None
    exponent = float(np.median(_slopes(values)[1:]))
    if exponent < -settings.least_exponent:
        return None
    if exponent < settings.least_exponent:
        return Pole(top, 0.0, 1, bool(side.any()))
    if side.sum() > 1:  # Measure the growth toward each single face
        faces = np.flatnonzero(side)
        aside = np.where(side, top + settings.away * step * inward, top)
        close = radii[: settings.near]
        near = np.tile(aside, (len(close), len(faces), 1))
        near[:, np.arange(len(faces)), faces] = (top + step * close[:, None] * inward)[:, faces]
        values = g(near.reshape(-1, d)).reshape(len(close), -1)
        alone = float(_slopes(values).mean(axis=0).max())
        if alone > settings.alone:
            together = Pole(top, exponent, len(faces), True)
            return together if together.tail > alone else Pole(top, alone, 1, True)
    # Subtract the additive constant of g. Then determine the quadratic form from values of g.
    # Evaluate g on lines from the climb's top: along each axis, and along diagonals of two axes
    factor = 4.0**exponent
    rest = float(np.median((factor * values[-1] - values[-2]) / (factor - 1.0)))
    first, second = np.triu_indices(d)
    axes = np.eye(d) * inward
    ways = np.where((first == second)[:, None], axes[first], axes[first] + axes[second])
    least = 1e-3 * max(float(np.median(values[-2])) - rest, 1e-300)
    size = np.maximum((g(top + radii[-2] * step * ways) - rest) / least, 1.0) ** (-2.0 / exponent)
    table = np.zeros((d, d))
    table[first, second] = table[second, first] = size
    own = np.diag(table)
    form = 0.5 * (table - own[:, None] - own) + 1.5 * np.diag(own)
    # The codimension of a pole increases by one for each face of the cube that contains the pole,
    # unless the pole extends from this face into the cube
    side &= own > settings.rank * own.max()
    free = np.linalg.eigvalsh(form[np.ix_(~side, ~side)])
    rank = int(side.sum() + (free > settings.rank * own.max()).sum())
    return Pole(top, exponent, max(rank, 1), bool(side.any()))


def _slopes(values: Array) -> Array:
    """Return the exponents a, (m − 2, k), if c + b r^−a has the values (m, k) at radii r, 4r, …"""
    falls = np.maximum(values[:-1] - values[1:], 1e-300)
    return np.asarray(np.log(falls[:-1] / falls[1:]) / math.log(4.0))
