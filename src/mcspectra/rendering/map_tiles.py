"""Estimates of many pixels in many realizations by one Dr.Jit loop over the samples of each pixel.

A lane is one realization of one pixel.
The lane adds up its samples in a recorded loop: float32 values in a float64 sum.
Only one number per lane is copied, so memory does not grow with the number of samples.
A lane has the same bits no matter which other lanes are computed.
One evaluation gives two estimates of a technique, without and with the weight of MIS.
With one lane per sample instead, Veach's scene takes 2 to 3 times as long on two cores.

Predictions
-----------
Variances are predicted from values of the integrand g, without points of the sampler.
All pixels of a tile use the same table of samples. The predicted variance is that of n points.

*Jittered* points: Var = n⁻² Σ_j Var_j(g) over the strata j.
Each Var_j = ∫g² − (∫g)² comes from pairs of independent samples.
A grid divides the stratum into cells, and each cell has one pair.
The product of the means of all first and of all second samples estimates (∫g)² without bias.
Two independent predictions per stratum give the standard error.

*Random* points: Var = (∫g² − (∫g)²)/n on a midpoint grid.

*Shifted* points and other stationary points, in two dims: Var = Σ_{m≠0} |g_m|² ⟨|S_m|²⟩.
The coefficients g_m come from the FFT of a midpoint grid.
The FFT adds the energy of higher frequencies to that of the frequencies on the grid (aliasing).
If the power ⟨|S_m|²⟩ has no closed form, its own error is added.

*Nets* in base 2 with nested scrambling, in two dims:
n Var = Σ_l Γ_l σ²_l, with the gains Γ_l of levels l.
The variance of g is the sum of σ²_l, the parts that depend on l_j bits of coordinate j.
The parts come from means over blocks of a grid with a random point in each cell.

For random points, shifted points and nets, grids of half the resolution give standard errors.
Other samplers have no prediction, because the formulas ignore the cross term of the variance.

No prediction detects a light that is so rare that no sample hits it.
If one technique hits significantly more light (`surely`) than another technique,
the prediction of the other technique includes the missed light in its error (`unmet`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.errors import NoClosedForm, Parameter, ParameterError
from mcspectra.core.parallel import Block
from mcspectra.core.records import Join
from mcspectra.core.streams import Stream
from mcspectra.estimators.base import draw_sets
from mcspectra.estimators.moments import Moments
from mcspectra.rendering import map_statistics as statistics
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.paths import Dimension, Tracer
from mcspectra.rendering.scenes import Scene, find_emitter, load_scene, scene_name
from mcspectra.rendering.techniques import (
    POWERS,
    Hit,
    check_finite,
    chooses_lobe,
    chosen_channel,
    follow_camera,
    heuristic_weight,
    pixel_sums,
    sample_bsdf,
    sample_columns,
    sample_light,
)
from mcspectra.samplers import Jittered, Sampler
from mcspectra.samplers.law import Fixed, Independent, Scrambled, Strata
from mcspectra.spectra.gain import gains_at

__all__ = [
    "MAP_STRATEGIES",
    "NOTHING",
    "RECEIVER",
    "SHINES",
    "SPECULAR",
    "TECHNIQUES",
    "TILE_LANES",
    "Lighting",
    "Maps",
    "Measurement",
    "Prediction",
    "Receivers",
    "prediction_for",
    "surely",
    "unmet",
]

MAP_STRATEGIES: Final = ("light", "bsdf", "mis-light", "mis-bsdf", "mis")

TILE_LANES = 2**19
"""Pixels times realizations in one kernel; they take some 100 MiB including their results."""

_BLOCK_REALIZATIONS = 1024
_TABLE_NUMBERS = 2**23  # maximum number of values in one table of points, 64 MiB
_KEPT_NUMBERS = 2**24  # maximum number of values in tables that all tiles share
_PREDICTED_VALUES = 2**21  # maximum number of integrand values computed at once
_CHAIN_VALUES = 2**20  # maximum number of path values computed at once
# Labels of two random streams: one for samples of predictions, one for pairs of paths
_PREDICTION, _CHAIN = 0x9D1C7, 0xC4A17


_Pixels = Annotated[Array, Join(-1)]


@final
@dataclass(frozen=True)
class Maps:
    """Results at P pixels: status, moments (strategies, counts, P), predictions (strategies, P).

    Predictions are for the largest count. They are NaN if there is nothing to estimate.
    The last three attributes are the results of `path_shares`, with these shapes:
    ``path_variance`` (2, P), ``shares`` (3, parts, P) and ``largest`` (2, P).
    """

    status: _Pixels
    mean: _Pixels
    variance: _Pixels
    relative_se: _Pixels
    predicted: _Pixels
    predicted_se: _Pixels
    path_variance: _Pixels
    shares: _Pixels
    largest: _Pixels


@final
@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Measures every pixel; most attributes are the same as in `Map`.

    With a `tracer`, whole paths are measured, and ``path`` is the only strategy.
    The attribute `uses` describes the coordinates of a path.
    Shares of the variance come from `chains` pairs of paths; 0 gives no shares.

    Realization r of n points is realization r of ``stream.child(n)``, as in `convergence`.
    If `own` is true, pixels have their own points:
    pixel number k = y·width + x uses realization k·realizations + r.
    """

    lighting: Lighting
    strategies: tuple[str, ...]
    sampler: Sampler
    counts: tuple[int, ...]
    realizations: int
    stream: Stream
    own: bool
    predict_every: int
    tracer: Tracer | None = None
    uses: tuple[Dimension, ...] = ()
    chains: int = 0
    _tables: dict[tuple[int, Block], list[Array]] = field(default_factory=dict, repr=False)

    @property
    def techniques(self) -> list[str]:
        """Techniques that the strategies use."""
        return [t for t in TECHNIQUES if {t, f"mis-{t}", "mis"}.intersection(self.strategies)]

    @property
    def block(self) -> int:
        """Number of realizations per kernel. It is fixed, so that sums keep their order."""
        fitting = _TABLE_NUMBERS // (self.counts[-1] * self.sampler.dims)
        return max(1, min(self.realizations, _BLOCK_REALIZATIONS, fitting))

    @property
    def tile_pixels(self) -> int:
        """Number of pixels of a tile."""
        lanes = TILE_LANES
        if self.own:
            lanes = min(lanes, _TABLE_NUMBERS // (self.counts[-1] * self.sampler.dims))
        return max(1, lanes // self.block)

    @property
    def partitions(self) -> tuple[dict[Any, Array], dict[Any, Array]]:
        """Masks that select the random numbers of each bounce, and those of each kind of decision.

        If no shares of the variance are computed, the two returned dictionaries are empty.
        """
        requests = self._requests if self.chains else []
        bounces, decisions = ([each[k] for each in requests] for k in (0, 1))
        both = ({v: np.array([w == v for w in of]) for v in of} for of in (bounces, decisions))
        return next(both), next(both)

    @property
    def _requests(self) -> list[tuple[int, str]]:
        """The bounce and the decision for which each group of random numbers is drawn, in order."""
        return list(dict.fromkeys((use.bounce, use.decision) for use in self.uses))

    def prediction(self) -> Prediction | None:
        """Return the method that predicts variances at the largest count."""
        if not self.predict_every or self.tracer is not None:
            return None
        return prediction_for(self.sampler, self.counts[-1], self.stream.child(_PREDICTION))

    def tile(self, pixels: Array, prediction: Prediction | None) -> Maps:
        """Measure pixels (P, 2), given as x and y."""
        receivers = Receivers(self.lighting, pixels) if self.tracer is None else None
        status = np.zeros(len(pixels), np.int8) if receivers is None else receivers.status
        shape = (len(self.strategies), len(self.counts), len(pixels))
        mean, variance, relative_se = (np.full(shape, np.nan) for _ in range(3))
        predicted, predicted_se = (np.full((shape[0], shape[2]), np.nan) for _ in range(2))
        path_variance, largest = (np.full((2, len(pixels)), np.nan) for _ in range(2))
        shares = np.full((3, sum(map(len, self.partitions)), len(pixels)), np.nan)
        parts = predicted, predicted_se, path_variance, shares, largest
        found = Maps(status, mean, variance, relative_se, *parts)
        seen = np.flatnonzero(status == RECEIVER)
        if not len(seen):
            return found
        if (
            receivers
            and "bsdf" in self.techniques
            and self.sampler.dims == 2
            and receivers.chooses_lobe()
        ):
            raise ParameterError(
                f"A visible BSDF of {scene_name(self.lighting.scene)} selects a lobe by an extra "
                "random number; give ",
                Parameter("dims", 3),
                ": the third coordinate then selects the lobe.",
            )

        # Compute moments over realizations of each strategy
        for i, n in enumerate(self.counts):
            total: list[Moments] = []
            for first in range(0, self.realizations, self.block):
                block = first, min(self.block, self.realizations - first)
                if receivers is None:
                    made = [self._traced(pixels, *self._points(pixels, n, block))]
                else:
                    drawn = zip(TECHNIQUES, self._points(receivers.pixels, n, block), strict=True)
                    each = {t: receivers.estimates(t, u) for t, u in drawn if t in self.techniques}
                    made = [combined(strategy, each) for strategy in self.strategies]
                own = [Moments.of(estimates) for estimates in made]
                total = [x.merge(y) for x, y in zip(total, own, strict=True)] if total else own
            for s, moments in enumerate(total):
                for name in ("mean", "variance", "relative_se"):
                    getattr(found, name)[s, i, seen] = getattr(moments, name)[: len(seen)]

        # Compute shares of the variance of one path, for a chunk of pixels at a time
        if self.chains:
            most = _TABLE_NUMBERS // len(self.uses) if self.own else _CHAIN_VALUES
            step = max(1, most // (self.chains * (len(self._requests) + 1)))
            members = [np.stack(list(each.values())) for each in self.partitions]
            for start in range(0, len(pixels), step):
                part = slice(start, start + step)
                told = statistics.path_shares(self._chains(pixels[part]), members)
                for array, values in zip((path_variance, shares, largest), told, strict=True):
                    array[..., part] = values[..., : len(pixels[part])]

        # Predict at every `predict_every`-th pixel, for a chunk of pixels at a time
        if prediction is None:
            return found
        chosen = seen[(pixels[seen] % self.predict_every == 0).all(axis=1)]
        step = max(1, _PREDICTED_VALUES // len(prediction.samples))
        for start in range(0, len(chosen), step):
            part = chosen[start : start + step]
            receivers = Receivers(self.lighting, pixels[part])
            each = {t: receivers.values(t, prediction.samples) for t in self.techniques}
            there = np.max([surely(prediction, plain) for plain, _ in each.values()], axis=0)
            for s, strategy in enumerate(self.strategies):
                # Variances of independent techniques add up.
                # The error includes light that another technique hits and this technique misses
                terms = ("mis-light", "mis-bsdf") if strategy == "mis" else (strategy,)
                both = [prediction.variance(combined(term, each)) for term in terms]
                whole = combined("mis" if strategy.startswith("mis") else strategy, each)
                errors = [se for _, se in both] + [unmet(prediction, whole, there)]
                found.predicted[s, part] = np.sum([v for v, _ in both], axis=0)[: len(part)]
                se = np.sqrt(np.square(errors).sum(axis=0))
                found.predicted_se[s, part] = se[: len(part)]
        return found

    def _chains(self, pixels: Array) -> Array:
        """Values (R, K + 1, P) of pairs of paths that share more and more random numbers."""
        uses, dims = [(use.bounce, use.decision) for use in self.uses], len(self.uses)
        request = np.array([self._requests.index(each) for each in uses])
        first = np.zeros(1, int)
        if self.own:
            first = (pixels @ [1, self.lighting.size[0]]) * self.chains
        stream = self.stream.child(_CHAIN)
        drawn = [stream.uniforms(int(start), self.chains, 2 * dims) for start in first]
        x, y = np.split(np.stack(drawn, axis=1).astype(np.float32), 2, axis=-1)
        u = np.stack([np.where(request < k, x, y) for k in range(len(self._requests) + 1)], axis=1)
        u = u.reshape(-1, len(first), 1, dims)
        return self._traced(pixels, u if self.own else u[:, 0]).reshape(
            self.chains, -1, max(2, len(pixels))
        )

    def _traced(self, pixels: Array, u: Array) -> Array:
        """Return the mean value of the paths through each pixel, for random numbers u.

        A single pixel is listed twice, so that sums have the same rounding as with more pixels.
        """
        assert self.tracer is not None
        twice = np.repeat(pixels, 2, axis=0) if len(pixels) == 1 else pixels
        if u.ndim == 4 and len(twice) > u.shape[1]:
            u = np.repeat(u, 2, axis=1)
        return self.tracer.means(u, twice)

    def _points(self, pixels: Array, n: int, block: Block) -> list[Array]:
        """Points of each technique, (R, n, d), or (R, P, n, d) if pixels have their own points."""

        def draw(own: Block) -> list[Array]:
            if self.tracer is not None:
                return [self.sampler.draw_stream(n, self.stream.child(n), *own)]
            return draw_sets("independent", (1, 1), self.sampler, n, self.stream.child(n), *own)

        if self.own:
            width = self.lighting.size[0]
            numbers = (pixels @ [1, width]) * self.realizations + block[0]
            drawn = [draw((int(first), block[1])) for first in numbers]
            return [np.stack(each, axis=1) for each in zip(*drawn, strict=True)]
        tables = self._tables.get((n, block)) or draw(block)
        if sum(self.counts) * self.realizations * 2 * self.sampler.dims <= _KEPT_NUMBERS:
            self._tables[n, block] = tables
        return tables


def combined(strategy: str, both: dict[str, tuple[Array, Array]]) -> Array:
    """Combine plain and weighted estimates of the techniques into the estimate of a strategy."""
    if strategy == "mis":
        return both["light"][1] + both["bsdf"][1]
    return both[strategy.removeprefix("mis-")][int(strategy.startswith("mis-"))]


TECHNIQUES = ("light", "bsdf")
RECEIVER, NOTHING, SHINES, SPECULAR = range(4)
"""What a pixel shows: a lit surface, nothing, a light, or a perfectly specular surface."""

_SAMPLE: Final = {"light": sample_light, "bsdf": sample_bsdf}


@final
@dataclass(frozen=True, kw_only=True)
class Lighting:
    """Settings of the light estimates, as in `Pixel`, and the size of the pixel grid."""

    scene: Scene
    light: int | str | None
    heuristic: str
    channel: str | int
    size: tuple[int, int]


class Receivers:
    """The lit surface points visible in pixels (P, 2) of the grid, and estimates of their light.

    Attributes
    ----------
    status
        Code of what each pixel shows, int8 (P,); `RECEIVER` means a lit surface.
    pixels
        Pixels that show a lit surface, whose light is estimated.
        A single pixel is listed twice, because a sum over one pixel would be rounded differently.
    """

    def __init__(self, lighting: Lighting, pixels: Array) -> None:
        self._lighting = lighting
        with LOCK:
            # Load Mitsuba before Dr.Jit is imported, because this chooses the working libLLVM
            load_mitsuba()
            self.status = self._look(pixels)[0]
            seen = pixels[self.status == RECEIVER]
            # NumPy adds up a single column in another order than several columns.
            # A single pixel is listed twice, so that its sums are added in the same order as others
            self.pixels = np.repeat(seen, 2, axis=0) if len(seen) == 1 else seen
            # Trace these pixels again without the other pixels, which would waste lanes
            self._kept = self._look(self.pixels)[1] if len(self.pixels) else None

    def __len__(self) -> int:
        return len(self.pixels)

    def estimates(self, technique: str, u: Array) -> tuple[Array, Array]:
        """Return two estimates, without and with MIS weight: means over samples, (R, P) each.

        Samples u are (R, n, dims), equal for all pixels, or (R, P, n, dims).
        With 3 dims, the third selects a light or a lobe.
        Values that are not finite raise a ParameterError.
        """
        with LOCK:
            sums = self._sums(technique, u)
        for each in sums:
            check_finite(each.T, self._lighting.scene, self.pixels)
        return sums[0] / u.shape[-2], sums[1] / u.shape[-2]

    def values(self, technique: str, u: Array) -> tuple[Array, Array]:
        """Return values without and with the weight of MIS at samples u (N, dims): (N, P) each."""
        return self.estimates(technique, u[:, None, :])

    def chooses_lobe(self) -> bool:
        """Whether a BSDF needs a third random number, which 2-D points lack."""
        import drjit

        tries = 8  # number of directions that are tested at every point
        with LOCK:
            mitsuba = load_mitsuba()
            lane = drjit.arange(mitsuba.UInt32, len(self) * tries)
            u = mitsuba.Point2f(*((mitsuba.Float(k * lane % tries) + 0.5) / tries for k in (1, 3)))
            return chooses_lobe(self._gathered(lane // tries), u)

    def _look(self, pixels: Array) -> tuple[Array, Any]:
        """Return status and first hits of pixels. One kernel serves all pixels."""
        import drjit

        mitsuba, scene = load_mitsuba(), load_scene(self._lighting.scene)
        position = ((pixels + 0.5) / self._lighting.size).astype(np.float32)
        film = mitsuba.Point2f(*(mitsuba.Float(np.ascontiguousarray(c)) for c in position.T))
        at = follow_camera(scene, film)
        specular = mitsuba.has_flag(at.bsdf().flags(), mitsuba.BSDFFlags.Delta)
        status = drjit.select(specular, mitsuba.Int32(SPECULAR), RECEIVER)
        status[at.emitter(scene) != None] = SHINES  # != compares all lanes; "is not" does not
        status[~at.is_valid()] = NOTHING
        drjit.make_opaque(at)
        return np.broadcast_to(np.asarray(status.numpy()), len(pixels)).astype(np.int8), at

    def _gathered(self, pixel: Any) -> Hit:
        import drjit

        at = drjit.gather(load_mitsuba().SurfaceInteraction3f, self._kept, pixel)
        return Hit(load_scene(self._lighting.scene), at, at.bsdf())

    def _sums(self, technique: str, u: Array) -> Array:
        """Return sums over samples in the chosen channel, without and with weight: (2, R, P)."""
        import drjit

        mitsuba, given = load_mitsuba(), self._lighting
        emitter = None if given.light is None else find_emitter(given.scene, given.light)
        columns = sample_columns(u.reshape(-1, u.shape[-1]))

        def at(pixel: Any) -> Callable[[Any], tuple[Any, Any]]:
            hits = self._gathered(pixel)

            def value(row: Any) -> tuple[Any, Any]:
                x, y, *extra = (drjit.gather(type(c), c, row) for c in columns)
                found = _SAMPLE[technique](hits, emitter, mitsuba.Point2f(x, y), *extra)
                color, own, other = found
                chosen = chosen_channel(color, given.channel)
                return chosen, chosen * heuristic_weight(own, other, POWERS[given.heuristic])

            return value

        return pixel_sums(u, len(self), 2, at)


_REPEATS = 2  # number of predictions per stratum, which give a standard error
# Approximate number of grid cells in all strata together.
# More cells resolve smaller lights. A stratum has at least 2 cells per axis
_CELLS = 4096
_GRIDS = {2: 64, 3: 16}  # number of midpoints along each axis, by number of dims; even numbers
_POWER_REALIZATIONS = 1024
_SURE = 3.0  # number of standard errors between an estimate and its lower bound


def surely(prediction: Prediction, values: Array) -> Array:
    """Lower bound (P,) of the integral of values (N, P): estimate minus three standard errors."""
    mean, se = prediction.mean(values)
    return mean - _SURE * se


def unmet(prediction: Prediction, values: Array, there: Array) -> Array:
    """Return the error (P,) of variances predicted from values (N, P) that may miss light.

    The values may miss a part M of the integral, in a region of small volume q.
    For any stratification, M adds the variance M²/(q n), because few points hit its small region.
    If none of N samples hit the region, q is at most about 1/N. The integral is at least `there`.
    If the missed part M exceeds three standard errors, q is unknown, and the error infinite.
    """
    mean, se = prediction.mean(values)
    missed = np.maximum(there - mean, 0.0)
    error = len(prediction.samples) * missed**2 / prediction.count
    return np.where(missed > _SURE * se, np.inf, error)


def prediction_for(sampler: Sampler, n: int, stream: Stream) -> Prediction | None:
    """Return a method that predicts the variance of n points, or None if there is none."""
    law = sampler.law(n)
    if isinstance(law, Strata) and law.jittered:
        return _Strata.of(law.sides, stream)
    if isinstance(law, Independent):
        return _Grid(method="random", count=n, samples=_midpoints(law.dims))
    if law.dims != 2:
        return None
    if law.stationary:
        power, se = _grid_power(sampler, n, stream)
        return _Grid(method="spectrum", count=n, samples=_midpoints(2), power=power, power_se=se)
    nested = isinstance(law, Scrambled) and law.nested_pairs and set(law.bases) == {2}
    if isinstance(law, Scrambled) and nested and isinstance(law.inner, Fixed):
        side = _GRIDS[2]
        gains = gains_at(law.inner, law.bases, side.bit_length() - 1)
        # Random points in the cells, in C order, also measure the variation inside the cells
        u = Jittered(dims=2, sides_=(side, side)).draw_stream(side * side, stream, 0, 1)[0]
        u = u[np.lexsort(np.floor(u * side).T[::-1])]
        return _Grid(method="gains", count=n, samples=u, gains=gains)
    return None


@final
@dataclass(frozen=True, kw_only=True)
class _Strata:
    """Prediction by strata. The samples have the order (repeat, half of a pair, stratum, cell)."""

    count: int
    samples: Array = field(repr=False)
    method: str = "strata"

    @staticmethod
    def of(sides: tuple[int, ...], stream: Stream) -> _Strata:
        dims, strata = len(sides), int(np.prod(sides))
        cells = max(2, round((_CELLS / strata) ** (1.0 / dims)))
        fine = tuple(cells * side for side in sides)
        count = strata * cells**dims
        sampler = Jittered(dims=dims, sides_=fine)
        u = sampler.draw_stream(count, stream, 0, 2 * _REPEATS)
        cell = np.floor(u[0] * fine).astype(np.int64) // cells
        order = np.argsort(np.ravel_multi_index(tuple(cell.T), sides), kind="stable")
        return _Strata(count=strata, samples=u[:, order].reshape(-1, dims))

    def variance(self, values: Array) -> tuple[Array, Array]:
        g = values.reshape(_REPEATS, 2, self.count, -1, values.shape[-1])
        means = g.mean(axis=3)
        own = (g**2).mean(axis=(1, 3)) - means[:, 0] * means[:, 1]
        difference = own[0] - own[1]
        predicted = own.mean(axis=0).sum(axis=0) / self.count**2
        squares = difference**2
        se = np.sqrt(squares.sum(axis=0)) / (2.0 * self.count**2)
        return predicted, se * _student(squares)

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Return the integral and its standard error, from the independent samples of each cell."""
        cells = values.reshape(2 * _REPEATS, -1, values.shape[-1])
        variance = cells.var(axis=0, ddof=1).sum(axis=0) / len(cells)
        return values.mean(axis=0), np.sqrt(variance) / cells.shape[1]


@final
@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Prediction from a midpoint grid, and from the power spectrum or the gains of the points.

    If neither power nor gains are given, the points are random.
    """

    method: str
    count: int
    samples: Array = field(repr=False)
    power: Array | None = field(repr=False, default=None)  # power at each frequency m
    power_se: Array = field(repr=False, default_factory=lambda: np.zeros(()))
    gains: Array | None = field(repr=False, default=None)  # gains Γ_l for levels l = (i, j)

    def variance(self, values: Array) -> tuple[Array, Array]:
        """Return the variance; its error comes from the power and grids of half the resolution."""
        grid, *coarse = self._grids(values)
        whole, *parts = map(self._of_grid, (grid, *coarse))
        if self.power is None:
            return whole, _error_of_mean(parts)
        # The power at −m equals the power at m, so the errors at m and −m are equal: add them.
        # Different pairs m, −m have independent errors, so add the squares of these errors
        doubled = np.sqrt(2.0 * _sum(self.power_se**2, _energy(grid) ** 2))
        return whole, np.hypot(_error_of_mean(parts), doubled)

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Return the integral. Its error comes from the grids of half the resolution."""
        parts = [part.reshape(-1, part.shape[-1]).mean(axis=0) for part in self._grids(values)[1:]]
        return values.mean(axis=0), _error_of_mean(parts)

    def _grids(self, values: Array) -> list[Array]:
        """Return the grid, and its parts of half the resolution: every second node along axes."""
        dims = self.samples.shape[-1]
        grid = values.reshape(*[_GRIDS[dims]] * dims, -1)
        offsets = itertools.product((0, 1), repeat=dims)
        return [grid, *(grid[tuple(slice(k, None, 2) for k in each)] for each in offsets)]

    def _of_grid(self, grid: Array) -> Array:
        """Variance from the values of one grid."""
        if self.power is not None:
            return _sum(self.power, _energy(grid))
        if self.gains is None:
            return np.asarray(grid.reshape(-1, grid.shape[-1]).var(axis=0) / self.count)
        # Compute Σ_l Γ_l σ²_l / n
        side, pixels = grid.shape[1:]
        levels = range(side.bit_length())
        # Mean squares of the means over blocks: sums of σ² over all levels up to (i, j)
        squares = np.empty((len(levels), len(levels), pixels))
        for i, j in itertools.product(levels, levels):
            blocks = grid.reshape(2**i, side >> i, 2**j, side >> j, pixels).mean(axis=(1, 3))
            squares[i, j] = (blocks**2).mean(axis=(0, 1))
        parts = np.diff(np.diff(squares, axis=0, prepend=0.0), axis=1, prepend=0.0)
        gains = self.gains[: len(levels), : len(levels)]
        return np.tensordot(gains, parts, axes=2) / self.count


Prediction: TypeAlias = _Strata | _Grid
"""Methods that predict variances from values (N, P) of the integrand at their own samples."""


def _student(squares: Array) -> Array:
    """Return the ratio of the quantile of Student's t to the normal quantile, for each pixel.

    The squared error of a pixel is the sum of `squares` (J, P) over the J strata.
    If the squared error comes from a single stratum, it has one degree of freedom.
    """
    from scipy.special import stdtrit

    total, fourth = squares.sum(axis=0), (squares**2).sum(axis=0)
    effective = np.divide(total**2, fourth, out=np.ones_like(total), where=fourth > 0.0)
    return np.asarray(stdtrit(effective, 0.975) / CONFIDENCE_Z)


def _error_of_mean(parts: list[Array]) -> Array:
    return np.asarray(np.std(parts, axis=0, ddof=1) / np.sqrt(len(parts)))


def _energy(grid: Array) -> Array:
    """|g_m|² of values (side, side, P), 0 at m = 0."""
    energy: Array = np.abs(np.fft.fft2(grid, axes=(0, 1)) / len(grid) ** 2) ** 2
    energy[0, 0] = 0.0
    return energy


def _sum(power: Array, energy: Array) -> Array:
    """Return Σ_m |g_m|² ⟨|S_m|²⟩ for the energy |g_m|².

    The power ⟨|S_m|²⟩ may extend to further frequencies, which are ignored.
    """
    side = len(energy)
    m = np.fft.fftfreq(side, 1.0 / side).astype(int)
    return np.tensordot(power[np.ix_(m, m)], energy, axes=2)


def _midpoints(dims: int) -> Array:
    axis = (np.arange(_GRIDS[dims]) + 0.5) / _GRIDS[dims]
    return np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), axis=-1).reshape(-1, dims)


def _grid_power(sampler: Sampler, n: int, stream: Stream) -> tuple[Array, Array]:
    """Return the power and its standard error at the frequencies of the grid, in FFT order."""
    from mcspectra.spectra.closed_forms import closed_form_power
    from mcspectra.spectra.power import power_spectrum

    side = _GRIDS[2]
    m = np.fft.fftfreq(side, 1.0 / side)
    frequencies = np.stack(np.meshgrid(m, m, indexing="ij"), axis=-1)
    try:
        known = closed_form_power(sampler, n, frequencies)
    except NoClosedForm:
        seed, half = np.random.SeedSequence(stream.key), side // 2
        options: dict[str, Any] = {"half_width": half, "realizations": _POWER_REALIZATIONS}
        spectrum = power_spectrum(sampler, n, rng=seed, **options)
        both = (spectrum[name].values[:-1, :-1] for name in ("power", "power_se"))
        power, se = (np.fft.ifftshift(each) for each in both)
        return power, se
    return known, np.zeros_like(known)
