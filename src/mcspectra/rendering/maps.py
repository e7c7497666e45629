"""Maps over an image: variance, its rate, the bottleneck technique, and the gain of MIS.

The integrand of every pixel is `Pixel`, with the ray through the center of the pixel.
As in `convergence`, variances are measured over realizations at several counts n.
The rate is the slope of log variance against log n.
For a whole image, only few realizations are affordable, so all intervals are wide.
The standard error of a variance of 64 normal estimates is 18 %.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, final

import numpy as np
from msgspec import Meta, structs

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject, compute
from mcspectra.core.checks import MAX_DIMS, MOST_JOINT_DIMS, Array, as_integer
from mcspectra.core.errors import McspectraError, Parameter, ParameterError
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNTS, REALIZATIONS, AnyText, Counts, checked
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.rendering import map_statistics as statistics
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.costs import SceneCost, timed_work
from mcspectra.rendering.map_pixels import (
    chosen_pixels,
    nearest_pixels,
    number_of_pixels,
    spread,
)
from mcspectra.rendering.map_tiles import (
    MAP_STRATEGIES,
    RECEIVER,
    Lighting,
    Maps,
    Measurement,
    Prediction,
)
from mcspectra.rendering.padding import Padded, as_rendered, padding_note
from mcspectra.rendering.paths import Dimension, Tracer, window_dimensions
from mcspectra.rendering.pixel import check_channel
from mcspectra.rendering.plugin import default_spec
from mcspectra.rendering.scene_checks import (
    camera_rays,
    check_lights,
    check_scene,
    filter_note,
    integrator_note,
    warn_integrator,
    warn_lens,
)
from mcspectra.rendering.scenes import Scene, as_scene, film_size, scene_name, sensor_of
from mcspectra.samplers import Sampler, as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Map", "compared", "missed", "variance_map"]

_MOST_NUMBERS = 2**27  # maximum number of values in a result (1 GiB)
_LONGEST_SIDE = 65_536
_FILM = (256, 256)  # film size assumed before the scene is read

_DIMS = {
    "variance": ("strategy", "n", "y", "x"),
    "variance_relative_se": ("strategy", "n", "y", "x"),
    "mean": ("strategy", "y", "x"),
    "mean_se": ("strategy", "y", "x"),
    "rate": ("strategy", "y", "x"),
    "rate_se": ("strategy", "y", "x"),
    "rate_ci": ("strategy", "y", "x", "bound"),
    "fit_chi2": ("strategy", "y", "x"),
    "bottleneck": ("y", "x"),
    "dominant_technique": ("y", "x"),
    "mis_gain": ("y", "x"),
    "mis_gain_ci": ("y", "x", "bound"),
    "predicted_ratio": ("strategy", "y", "x"),
    "predicted_ratio_ci": ("strategy", "y", "x", "bound"),
    "path_variance": ("y", "x"),
    "path_variance_se": ("y", "x"),
    "bounce_share": ("bounce", "y", "x"),
    "bounce_share_ci": ("bounce", "y", "x", "bound"),
    "decision_share": ("decision", "y", "x"),
    "decision_share_ci": ("decision", "y", "x", "bound"),
    "largest_bounce": ("y", "x"),
    "largest_decision": ("y", "x"),
    "best_sampler": ("strategy", "y", "x"),
    "measured": ("y", "x"),
    "interpolation_factor": ("strategy", "y", "x"),
}
# Labels of two random streams: one chooses the measured pixels, the other the pixels of a trial
_CHOICE, _TRIAL = 0x9C401, 0x7D1A1
_TRIED = 4096  # maximum number of pixels that a trial measures
# Seconds of the fits, and stored bytes, for each number in a result. Eight bytes are in the
# database and eight in the file of results, also at interpolated pixels; image layers take 2 to 3
_PIXEL_SECONDS, _PIXEL_BYTES = 3e-7, 18.5
# Seconds to interpolate a pixel of the image between measured pixels, for all numbers of a result
_SPREAD_SECONDS = 1.2e-5

_DIRECT_COUNTS, _PATH_COUNTS = (4, 9, 16, 36, 64), (4, 16, 64)
_SHARES_OF_PATHS = tuple(
    name for name in _DIMS if name.startswith(("path_", "bounce_", "decision_", "largest_"))
)
_CHAINS, _LEAST_CHAINS, _MOST_CHAINS = 128, 8, 4096
_Dims = Annotated[int, Meta(ge=2, le=MAX_DIMS)]
_Side = Annotated[int, Meta(ge=1, le=_LONGEST_SIDE)]
_Strategy = Literal["light", "bsdf", "mis-light", "mis-bsdf", "mis"]
_Window = tuple[int, int, int, int]


@final
class Map(Analysis, frozen=True, kw_only=True):
    """Variance, rate and bottleneck at every pixel of a scene; needs the package Mitsuba."""

    function = "rendering.variance_map"
    verb = "map"
    about: ClassVar[Literal["estimator", "sampler", "scene"]] = "scene"
    variables = tuple(_DIMS)

    scene: Annotated[
        str, Meta(description="A built-in scene or a Mitsuba XML file.", extra={"python": True})
    ]
    strategies: Annotated[
        Annotated[tuple[_Strategy, ...], Meta(min_length=1)] | _Strategy,
        Meta(
            description="Some of light, bsdf, mis-light, mis-bsdf, mis.",
            extra={"metavar": "NAME,…"},
        ),
    ] = MAP_STRATEGIES
    counts: Annotated[Counts | None, COUNTS] = None
    realizations: Annotated[int, REALIZATIONS] = 64
    crop: Annotated[
        tuple[int, int, int, int] | None,
        Meta(description="x0, y0, width and height of the part to measure.",
             extra={"metavar": "X0,Y0,W,H"}),
    ] = None  # fmt: skip
    pixels: Annotated[
        Annotated[int, Meta(ge=1)] | AnyText | None,
        Meta(
            description="Measure this number or share of the pixels, such as 1%, in strata of the "
            "image, and interpolate the others; by default all pixels are measured.",
            extra={"metavar": "N|P%"},
        ),
    ] = None
    size: Annotated[
        tuple[_Side, _Side] | None,
        Meta(
            description="Width and height in pixels; by default those of the scene.",
            extra={"metavar": "W,H"},
        ),
    ] = None
    light: Annotated[
        int | str | None,
        Meta(description="Use only this light; all by default.", extra={"metavar": "NAME"}),
    ] = None
    heuristic: Annotated[
        Literal["balance", "power"], Meta(description="Heuristic of MIS: balance or power.")
    ] = "balance"
    channel: Annotated[
        int | str, Meta(description="Channel: luminance, 0, 1 or 2.", extra={"python": True})
    ] = "luminance"
    dims: Annotated[
        _Dims | None,
        Meta(
            description="2, or 3 with a third coordinate that selects lights and lobes; for whole "
            "paths by default all coordinates.",
            extra={"flag": "-d", "metavar": "D"},
        ),
    ] = None
    integrator: Annotated[
        AnyText | None,
        Meta(
            description="Render whole paths with this integrator; scene: with the scene's own.",
            extra={"metavar": "SPEC"},
        ),
    ] = None
    joint_dims: Annotated[
        Annotated[int, Meta(ge=0, le=MOST_JOINT_DIMS)] | None,
        Meta(
            description="Whole paths: first numbers that are joint; each later request of the "
            "integrator has its own points (padded), as in rendered images. By default 4 for "
            "randomized nets, else 0.",
            extra={"metavar": "K"},
        ),
    ] = None
    points: Annotated[
        Literal["shared", "own"],
        Meta(description="shared: the same points at all pixels; own: independent ones."),
    ] = "shared"
    smoothing: Annotated[
        int,
        Meta(
            ge=1,
            le=31,
            description="Width in pixels of the window that rates are averaged over; odd.",
        ),
    ] = 1
    predict_every: Annotated[
        int,
        Meta(
            ge=0, le=2**31, description="Predict at every k-th pixel in x and y; 0: no predictions."
        ),
    ] = 1
    chains: Annotated[
        Annotated[int, Meta(ge=0, le=_MOST_CHAINS)] | None,
        Meta(
            description="Whole paths: pairs of paths for the shares of bounces and decisions, by "
            f"default {_CHAINS}; 0: no shares.",
            extra={"metavar": "R"},
        ),
    ] = None

    def need(self, subject: Subject) -> Need:
        """Return an estimate of the needed resources.

        The size of the film is read from the scene if the scene can be loaded.
        """
        check_channel(self.channel)
        direct = {"light": None, "strategies": MAP_STRATEGIES, "heuristic": "balance"}
        refused, way = direct, "is for direct light; leave it out if you give an integrator"
        if self.integrator is None:
            as_integer("dims", self.points_dims, least=2, most=3)
            refused = {"chains": None, "joint_dims": None}
            way = "is for whole paths; also give an integrator"
        for name, usual in refused.items():
            if getattr(self, name) != usual:
                raise ParameterError(Parameter(name), f" {way}.")
        if self.chains and self.chains < _LEAST_CHAINS:
            raise ParameterError(
                Parameter("chains"),
                f" is {self.chains}; give 0 for no shares, or at least {_LEAST_CHAINS}.",
            )
        counts = self._counts(subject.sampler)
        if self.smoothing % 2 == 0:
            raise ParameterError(
                Parameter("smoothing"), f" is {self.smoothing}; give an odd number of pixels."
            )
        if self.pixels is not None and self.smoothing > 1:
            raise ParameterError(
                Parameter("smoothing"), " is for maps that measure all pixels; leave out one of ",
                Parameter("pixels"), " and ", Parameter("smoothing"), ".",
            )  # fmt: skip
        grid = self.size
        if grid is None and self.crop is None:
            with suppress(McspectraError), LOCK:
                grid = film_size(as_scene(self.scene))
        width, height = grid or _FILM if self.crop is None else self.crop[2:]
        if self.size is not None:
            _, _, width, height = self._window(self.size)
        pixels = max(width, 1) * max(height, 1)
        # If the scene cannot be loaded, its own error follows, and not one about its pixels
        if self.pixels is not None and (grid is not None or self.crop is not None):
            pixels = number_of_pixels(self.pixels, pixels)
        return Need(
            cost=float(pixels * sum(counts) * self.realizations * 4),
            memory=memory_of(counts[-1], subject.sampler.dims, 2, pixels),
        )

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[Maps]:
        """Measure all chosen pixels, row by row. A block of the computation is a tile of pixels."""
        measurement, window = self.measurement(subject, stream)
        x0, y0, width, height = window
        count, chosen, step = width * height, None, measurement.tile_pixels
        if self.pixels is not None and (asked := number_of_pixels(self.pixels, count)) < count:
            chosen = chosen_pixels(window, asked, stream.child(_CHOICE))
            count = len(chosen)
        prediction = measurement.prediction()

        def tile(index: int) -> Maps:
            place = np.arange(index * step, min((index + 1) * step, count))
            if chosen is not None:
                return measurement.tile(chosen[place], prediction)
            each = np.stack([x0 + place % width, y0 + place // width], axis=-1)
            return measurement.tile(each, prediction)

        def result(found: Maps) -> xr.Dataset:
            if not (found.status == RECEIVER).any():
                nothing = (
                    f"No pixel of the crop {list(window)} of {scene_name(self.scene)} sees a "
                    "surface that scatters light; choose another crop."
                )
                raise ParameterError(
                    " ".join([nothing, *check_scene(self.scene, light=self.light)])
                )
            each = {f.name: getattr(found, f.name) for f in fields(found)}
            rows = (height, width) if chosen is None else (1, count)
            shaped = Maps(**{k: v.reshape(*v.shape[:-1], *rows) for k, v in each.items()})
            return labelled(measurement, prediction, window, shaped, self.smoothing, chosen)

        return Reduction(
            kind=Maps,
            block=tile,
            blocks=-(-count // step),
            cost=float(count * sum(measurement.counts) * self.realizations * 4),
            result=result,
        )

    def trial(self, subject: Subject, stream: Stream, seconds: float) -> tuple[float, int] | None:
        """Estimate seconds and stored bytes from measurements of a few pixels."""
        found = self.cost(subject, stream, seconds)
        return found.seconds, found.storage

    def cost(self, subject: Subject, stream: Stream, seconds: float = 4.0) -> SceneCost:
        """Estimate size, time and storage from measurements of a few pixels of all strata."""
        begin = time.perf_counter()
        measurement, window = self.measurement(subject, stream)
        width, height = window[2:]
        total = width * height
        count = total if self.pixels is None else number_of_pixels(self.pixels, total)
        own = stream.child(_TRIAL)
        some = chosen_pixels(window, min(total, _TRIED), own)
        some = some[np.argsort(own.uniforms(0, len(some), 1)[:, 0], kind="stable")]
        prediction, step = measurement.prediction(), measurement.tile_pixels
        loaded = time.perf_counter() - begin

        def work(size: int) -> None:
            for first in range(0, size, step):
                measurement.tile(some[first : min(first + step, size)], prediction)

        paced = timed_work(work, count, first=16, most=len(some), seconds=seconds)
        samples = len(measurement.techniques or ("path",)) * sum(measurement.counts)
        samples = samples * self.realizations + measurement.chains * (
            len(measurement._requests) + 1
        )
        numbers = len(measurement.strategies) * (2 * len(measurement.counts) + 8)
        numbers += 3 * sum(map(len, measurement.partitions)) + 6
        at = ", ".join(map(str, measurement.counts))
        interpolation = 0.0 if self.pixels is None else _SPREAD_SECONDS * total
        return SceneCost(
            scene=scene_name(self.scene).strip("'\""),
            what=f"{self.realizations} realizations at n = {at} with {measurement.sampler.spec}",
            size=(width, height),
            pixels=count,
            samples=samples * count,
            samples_per_second=samples / paced.each,
            seconds=loaded + paced.seconds + interpolation + _PIXEL_SECONDS * total * numbers,
            storage=int(_PIXEL_BYTES * total * numbers),
        )

    def measurement(self, subject: Subject, stream: Stream) -> tuple[Measurement, _Window]:
        """Read the scene; return the measurement of each pixel, and the window of the film."""
        scene = as_scene(self.scene)
        with LOCK:
            sensor_of(scene)
            grid = film_size(scene) if self.size is None else self.size
            if self.integrator is None:
                check_lights(scene, self.light)
                warn_lens(scene)
                warn_integrator(scene)
        window = self._window(grid)
        sampler, tracer = subject.sampler, None
        uses: tuple[Dimension, ...] = ()
        if self.integrator is not None:
            tracer = Tracer(scene, self.integrator, self.channel, grid)
            uses = window_dimensions(tracer, window, self.dims)
            sampler = as_rendered(sampler, uses, self.joint_dims)
        measurement = Measurement(
            lighting=Lighting(
                scene=scene,
                light=self.light,
                heuristic=self.heuristic,
                channel=check_channel(self.channel),
                size=grid,
            ),
            strategies=self._strategies,
            sampler=sampler,
            counts=self._counts(sampler),
            realizations=self.realizations,
            stream=stream,
            own=self.points == "own",
            predict_every=self.predict_every,
            tracer=tracer,
            uses=uses,
            chains=0 if tracer is None else _CHAINS if self.chains is None else self.chains,
        )
        return measurement, window

    def of_samplers(self, subjects: Sequence[Subject]) -> list[Map]:
        """Return the map of each sampler. Only the map of the first sampler has shares of variance.

        Rejects samplers that cannot be compared, and invalid options, before the work begins.
        """
        counts: dict[str, tuple[int, ...]] = {}
        for subject in subjects:
            self.need(subject)
            counts[subject.sampler.spec] = self.measurement(subject, Stream.from_rng(0))[0].counts
        if len(counts) < len(subjects) or not subjects:
            given = [subject.sampler.spec for subject in subjects]
            raise ParameterError(
                Parameter("sampler"), f" is {given!r:.200}; give one, or several that differ."
            )
        if not set.intersection(*map(set, counts.values())):
            each = "; ".join(f"{spec} {list(ns)}" for spec, ns in counts.items())
            raise ParameterError(f"The samplers have no common count ({each}); give counts.")
        others = self if self.integrator is None else structs.replace(self, chains=0)
        return [self, *[others] * (len(subjects) - 1)]

    @property
    def points_dims(self) -> int:
        """Number of dims of the points that sample direct light."""
        return DEFAULT_DIMS if self.dims is None else self.dims

    @property
    def default_sampler(self) -> str:
        """Sampler that is used by default."""
        if self.integrator is None:
            return "jittered"
        return default_spec(*self.counts or (), joint_dims=self.joint_dims)

    def _counts(self, sampler: Sampler) -> tuple[int, ...]:
        """Return the checked counts; by default the usual counts, or the nearest possible ones."""
        usual = _DIRECT_COUNTS if self.integrator is None else _PATH_COUNTS
        near = tuple(sorted({sampler.nearest_count(n) for n in usual}))
        counts = near if self.counts is None else self.counts
        if len(counts) < 2:
            raise ParameterError(
                Parameter("counts"),
                f" is {list(counts)}; give two or more ascending numbers of samples that "
                f"{sampler.spec} can make.",
            )
        for n in counts:
            sampler.check_count(n)
        return counts

    @property
    def _strategies(self) -> tuple[str, ...]:
        """Strategies in their usual order. For ``"mis"``, its two parts are also measured."""
        if self.integrator is not None:
            return ("path",)
        given = (self.strategies,) if isinstance(self.strategies, str) else self.strategies
        chosen = {*given, *(("mis-light", "mis-bsdf") if "mis" in given else ())}
        return tuple(s for s in MAP_STRATEGIES if s in chosen)

    def _window(self, grid: tuple[int, int]) -> _Window:
        """Return the checked crop within the grid, by default the whole grid."""
        window = (0, 0, *grid)
        if self.crop is not None:
            limits = zip(("x0", "y0", "width", "height"), self.crop, (0, 0, 1, 1), strict=True)
            for name, value, least in limits:
                as_integer(f"crop {name}", value, least=least, most=_LONGEST_SIDE)
            window = self.crop
        x0, y0, width, height = window
        if x0 + width > grid[0] or y0 + height > grid[1]:
            raise ParameterError(
                Parameter("crop"),
                f" is {[*window]}, which reaches outside the grid of {grid[0]} × {grid[1]} "
                "pixels; give x0, y0, width and height within it.",
            )
        strategies, counts = len(self._strategies), len(self.counts or _DIRECT_COUNTS)
        numbers = 3 * width * height * strategies * counts
        if numbers > _MOST_NUMBERS:
            raise ParameterError(
                f"A map of {width} × {height} pixels, {strategies} strategies and {counts} counts "
                f"has {numbers:.3g} numbers, more than {_MOST_NUMBERS:.3g}; give a crop or a "
                "smaller size."
            )
        return window


def variance_map(
    scene: Scene,
    strategies: Sequence[str] = MAP_STRATEGIES,
    sampler: Any = None,
    counts: Sequence[int] | None = None,
    realizations: int = 64,
    *,
    crop: Sequence[int] | None = None,
    pixels: int | str | None = None,
    size: Sequence[int] | None = None,
    light: int | str | None = None,
    heuristic: str = "balance",
    channel: str | int = "luminance",
    dims: int | None = None,
    integrator: str | None = None,
    joint_dims: int | None = None,
    points: str = "shared",
    smoothing: int = 1,
    predict_every: int = 1,
    chains: int | None = None,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure the variance of direct illumination at every pixel, and its rate of convergence.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `load_scene`.
    strategies
        One or more of the following, with n samples per technique: ``"light"``, ``"bsdf"``,
        ``"mis"``, and the parts of multiple importance sampling ``"mis-light"`` and ``"mis-bsdf"``.
        If ``"mis"`` is given, its two parts are measured as well.
    sampler
        Sampler or its spec; by default ``"jittered"``.
        Maps with an integrator have the default of `mcspectra.rendering.plugin.default_spec`.
        Each technique has its own points. A list of samplers compares them.
    counts
        Numbers of samples n of a technique: at least two, in ascending order.
        The default is (4, 9, 16, 36, 64), or (4, 16, 64) with an integrator.
        Default numbers are rounded to the nearest numbers that the sampler can make in its dims.
    realizations
        Independent realizations for each n, at least 2.
    crop
        x0, y0, width and height of the measured part; by default all pixels.
        A crop gives the same numbers as the whole image.
    pixels
        Number of pixels that are measured, at least 64, or their share as a text such as ``"1%"``.
        The measured pixels are chosen at random, one in each stratum of the image or crop.
        All other pixels are interpolated, see Notes. By default, all pixels are measured.
    size
        Width and height of a grid of pixels laid over the film; by default the film's own.
        Another aspect ratio does not change the camera's view, but stretches the pixels.
    light, heuristic, channel
        Same as in `Pixel`, but for one channel only.
    dims
        2, the default, or 3. The third coordinate then chooses a light or a BSDF lobe.
        With an integrator, the same as in `PathPixel`.
        With an integrator, the default is how many random numbers paths through 256 pixels use.
    integrator
        Measures whole paths, like `PathPixel`. The only strategy is then ``"path"``.
        The value ``"scene"`` is the scene's own integrator.
        By default, direct light is measured by the given strategies.
    joint_dims
        With an integrator: number of a path's first random numbers that come from one point set.
        Every later request of the integrator has its own set (padding), as in renderers.
        The default is 4 for randomized nets in base 2 and 0 otherwise, as in the plugin.
        With the value `dims`, all random numbers of a path come from one joint set.
    points
        ``"shared"``: in a realization, all pixels have the same points.
        Each pixel is measured as accurately as with points of its own, but in less time.
        Shared points also give smooth maps, but the errors of neighbors are correlated.
        With shared points, structure in a map may be an artifact of one set of points.
        ``"own"``: every pixel has its own realizations, so the errors look like noise.
    smoothing
        Width of the square window over which rates are averaged: an odd number of pixels.
        The average over a window blurs the map of rates.
        The averaged rates have smaller standard errors only with ``points="own"``.
    predict_every
        Step between the pixels at which the variance at the largest count is predicted.
        Pixels are chosen if x and y are multiples of this step. With 0 there are no predictions.
        For jittered points, quadrature over the strata predicts the variance.
        The prediction for random points is exact.
        In 2-D, shifted points use the power spectrum, and scrambled nets in base 2 use gains.
        The variance of other samplers is not predicted.
    chains
        Number of pairs of random paths for the shares of the variance of whole paths.
        The default is 128 pairs. With 0, shares are not computed.
        A pair costs K + 1 paths if a path requests random numbers K times.
    rng
        Seed (SPEC 7).
    workers
        Number of threads; by default all processors. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        All variables have the dims (y, x).
        Variables are NaN if a pixel shows no surface, a light or a perfectly specular surface.

        Moments: ``variance(strategy, n)`` and ``variance_relative_se(strategy, n)``.
        At the largest n there are also ``mean(strategy)`` and ``mean_se(strategy)``.
        Fits of the rate: ``rate(strategy)``, ``rate_se``, ``rate_ci(bound)`` and ``fit_chi2``.

        With ``"mis"``, ``bottleneck`` is the technique with the slower rate in MIS.
        The value 0 stands for light sampling, and 1 for BSDF sampling.
        The value is −1 if the rates do not differ significantly (95 %).
        ``dominant_technique`` is the technique with the larger variance at the largest n, or −1.
        If the single strategies are also measured, ``mis_gain`` and its interval ``mis_gain_ci``:
        the variance of the better single strategy divided by that of MIS.
        ``mis_gain`` uses variances of the fitted lines at equal total samples (the largest n).
        A strategy whose estimates significantly miss light is excluded from ``mis_gain``.

        ``predicted_ratio(strategy)`` and ``predicted_ratio_ci``:
        predicted variance divided by measured variance at the largest n.
        The error includes light that another strategy hits but the prediction's samples missed.
        The ratio is NaN if the relative standard error of the prediction exceeds ½.
        The ratio is NaN if the standard error of the measurement exceeds the limit for rates.
        The ratio is NaN if measured estimates significantly miss light that another strategy hits.

        With an integrator: ``path_variance``, the variance of one random path, with ``_se``.
        ``bounce_share(bounce)`` is the share of the variance that first appears at a bounce.
        Bounce 0 stands for the random numbers of the camera.
        ``decision_share(decision)`` is the share of one kind of decision, summed over all bounces.
        Shares of each kind sum to 1. Interactions count for the last random number involved.
        Estimates may be negative, and their intervals ``_ci`` extend below 0.
        Shares are NaN if the standard error of ``path_variance`` exceeds half of this variance.
        ``largest_bounce`` and ``largest_decision`` are the indices of the largest shares.
        The index is −1 if the largest share does not differ significantly from another share.

        With `pixels`: ``measured`` is 1 at measured pixels, otherwise 0.
        ``interpolation_factor(strategy)`` is a factor f that bounds the error of interpolation:
        at 95 % of interpolated pixels, the variance is between 1/f and f times the given variance.
        At measured pixels f is 1.
        Standard errors and intervals of all variables include the error of interpolation.

        With several samplers, all variables except the shares have the dim (sampler).
        The counts are those that all samplers can make.
        ``best_sampler(strategy)`` is the index of the sampler with the least variance at largest n.
        The index is −1 if the sampler does not differ significantly from another one.

    Raises
    ------
    ParameterError
        If a parameter is not allowed, the crop leaves the film, or no pixel shows a surface.
        If Mitsuba gives values that are not finite.
    CountError
        If a sampler cannot make one of the counts.

    Notes
    -----
    All shares come from the same pairs of paths and are sensitive to outliers.
    With 128 pairs, shares of a few per cent are mostly too small if they come from rare paths.
    Intervals of shares that come from rare paths are also too narrow.

    With `pixels`, another pixel gets the mean of its 8 nearest measured pixels.
    Weights are inverse squares of distances [Shepard1968]_; variances are averaged as logarithms.
    Choices such as ``bottleneck`` are those of the nearest measured pixel.
    The error of interpolation is measured by leaving out each measured pixel once.
    Intervals are as wide as needed for 95 % of the measured pixels.
    Features between measured pixels may be missed.

    Pixels are measured in tiles. For any image, memory is therefore about 200 MiB plus the result.
    A study keeps finished tiles and can resume.
    If few realizations hit a light, variances are mostly far too small at the smaller n.
    There is no rate if a variance at a smaller n is zero, or has a relative standard error above ½.
    If more realizations are measured, more pixels have a rate.
    At each pixel, ``bottleneck`` tests at 95 % whether the rates of the two techniques differ.
    The points of the two techniques are independent.
    If both rates are equal, chance decides at one pixel in 20.
    """
    analysis = Map.of(locals())
    given = analysis.default_sampler if sampler is None else sampler
    several = list(given) if isinstance(given, list | tuple) else [given]
    with _threads(workers):
        subjects = []
        for each in several:
            # The number of dims of whole paths is not known yet, and is checked later
            whole = integrator is not None and not isinstance(each, str)
            source = as_sampler(each, None if whole else analysis.points_dims)
            subjects.append(Subject(None, source))
        single = len(subjects) == 1
        if pixels is not None and not (single or isinstance(rng, int)):
            # Let all samplers measure the same pixels, even if `rng` is a generator or None
            rng = np.random.SeedSequence(Stream.from_rng(rng).key)
        parts = [analysis] if single else checked(analysis).of_samplers(subjects)
        maps = [
            compute(part, subject, rng, workers=1)
            for part, subject in zip(parts, subjects, strict=True)
        ]
    return maps[0] if single else compared(maps)


@contextmanager
def _threads(workers: int | None) -> Iterator[None]:
    """Let Dr.Jit use this number of threads inside the block; this affects the whole process."""
    if workers is None:
        yield
        return
    load_mitsuba()
    import drjit

    before = drjit.thread_count()
    drjit.set_thread_count(as_integer("workers", workers, least=1, most=1024))
    try:
        yield
    finally:
        drjit.set_thread_count(before)


_LARGEST_PREDICTED_SE = 0.5  # largest relative standard error of a reported prediction
_SURE_LEVEL = 0.99865  # probability that a normal value is below its mean + 3 standard deviations
_SHARES = ("mis-light", "mis-bsdf")
_SINGLE = ("light", "bsdf")


def labelled(
    measurement: Measurement,
    prediction: Prediction | None,
    window: tuple[int, int, int, int],
    maps: Maps,
    smoothing: int,
    chosen: Array | None = None,
) -> xr.Dataset:
    """Make the dataset of a map from arrays (…, y, x) that hold all tiles.

    If only the `chosen` pixels (P, 2) are measured, arrays are (…, 1, P).
    """
    x0, y0, width, height = window
    lighting, tracer = measurement.lighting, measurement.tracer
    variance, relative_se = maps.variance, maps.relative_se
    # With few realizations, every variance is uncertain, even without rare events
    largest_se = max(0.5, 1.5 * (2.0 / (measurement.realizations - 1)) ** 0.5)
    fits = statistics.fit_lines(
        np.array(measurement.counts), variance, relative_se, maps.mean, largest_se
    )
    rate, rate_se = statistics.smooth(fits.rate, fits.rate_se, smoothing, measurement.own)
    found = {
        "variance": variance,
        "variance_relative_se": relative_se,
        "mean": maps.mean[:, -1],
        "mean_se": np.sqrt(variance[:, -1] / measurement.realizations),
        "rate": rate,
        "rate_se": rate_se,
        "rate_ci": statistics.interval(rate, rate_se),
        "fit_chi2": fits.chi2,
    }
    row = {name: i for i, name in enumerate(measurement.strategies)}
    if "mis" in row:
        shares = [row[name] for name in _SHARES]
        found["bottleneck"] = statistics.slowest(rate[shares], rate_se[shares])
        last = (variance[shares, -1], relative_se[shares, -1])
        found["dominant_technique"] = statistics.dominant(*last)
    lost = missed(row, found["mean"], found["mean_se"], measurement.realizations)
    if row.keys() >= {"mis", *_SINGLE}:
        rows, total = [row[s] for s in _SINGLE], measurement.counts[-1]
        single, mis = fits.of(rows), fits.of([row["mis"]])
        gain = statistics.gain(single, mis, total, lost[rows])
        found["mis_gain"], found["mis_gain_ci"] = gain
    if measurement.chains:
        found |= zip(("path_variance", "path_variance_se"), maps.path_variance, strict=True)
        found |= zip(("largest_bounce", "largest_decision"), maps.largest, strict=True)
        parts = np.split(maps.shares, [len(measurement.partitions[0])], axis=1)
        for name, (share, *ends) in zip(("bounce_share", "decision_share"), parts, strict=True):
            found |= {name: share, f"{name}_ci": np.stack(ends, axis=-1)}
    if np.isfinite(maps.predicted).any():
        found |= _predicted(maps, largest_se, lost)
    if chosen is not None:
        found = spread(found, chosen, window)
    bounces, decisions = (list(each) for each in measurement.partitions)
    return dataset(
        {name: (_DIMS[name], values) for name, values in found.items()},
        {
            "strategy": list(measurement.strategies),
            "n": ("n", list(measurement.counts), {"long_name": "number of points", "units": "1"}),
            "y": ("y", np.arange(y0, y0 + height), {"long_name": "row", "units": "pixels"}),
            "x": ("x", np.arange(x0, x0 + width), {"long_name": "column", "units": "pixels"}),
            "bound": ["low", "high"],
            **({"bounce": bounces, "decision": decisions} if bounces else {}),
        },
        scene=str(lighting.scene),
        sampler=measurement.sampler.spec,
        realizations=measurement.realizations,
        light="all" if lighting.light is None else lighting.light,
        heuristic=lighting.heuristic,
        channel=lighting.channel,
        points="own" if measurement.own else "shared",
        smoothing=smoothing,
        scene_note=(integrator_note if tracer is None else filter_note)(lighting.scene),
        integrator="direct light" if tracer is None else tracer.integrator,
        dims=measurement.sampler.dims,
        joint_dims=_joint_dims(measurement),
        padding=None if tracer is None else padding_note(measurement.sampler),
        chains=measurement.chains,
        camera=camera_rays(lighting.scene) if tracer is None else "sampled",
        size=list(lighting.size),
        film=list(film_size(lighting.scene)),
        crop=list(window),
        prediction=None if prediction is None else prediction.method,
        pixels_measured=int((maps.status == RECEIVER).sum()),
        stream_key=f"{measurement.stream.key:#x}",
    )


def _joint_dims(measurement: Measurement) -> int | None:
    """Return how many first numbers of a path come from one set, or None for direct light."""
    sampler = measurement.sampler
    if measurement.tracer is None:
        return None
    return sampler.joint if isinstance(sampler, Padded) else sampler.dims


def compared(maps: Sequence[xr.Dataset]) -> xr.Dataset:
    """Combine the maps of several samplers, and find the best sampler at each pixel."""
    import xarray as xr

    shares = [name for name in (*_SHARES_OF_PATHS, "measured") if name in maps[0]]
    names = [str(each.attrs["sampler"]) for each in maps]
    found = xr.concat(
        [each.drop_vars(shares, errors="ignore") for each in maps],
        xr.Variable("sampler", names),
        join="inner",
        combine_attrs="drop_conflicts",
    )
    last = found.isel(n=-1)
    best = statistics.least(last["variance"].values, last["variance_relative_se"].values)
    if "measured" in maps[0]:
        # Interpolation errors are common to all samplers, so only measured pixels are compared
        rows, columns = nearest_pixels(maps[0]["measured"].values == 1.0)
        best = best[:, rows, columns]
    made = dataset({"best_sampler": (_DIMS["best_sampler"], best)})
    return found.assign({**maps[0][shares].data_vars, **made.data_vars}).assign_attrs(
        sampler=", ".join(names)
    )


def missed(row: dict[str, int], mean: Array, se: Array, realizations: int) -> Array:
    """Whether a strategy (S, y, x) significantly missed light that another strategy hit (t-test).

    The measured variance of a strategy is too small if the strategy missed light.
    ``"mis-light"`` and ``"mis-bsdf"`` estimate different integrals, so this test ignores them.
    """
    from scipy.special import stdtrit

    reach = se * stdtrit(realizations - 1, _SURE_LEVEL)
    whole = [i for name, i in row.items() if name not in _SHARES]
    found = np.zeros(mean.shape, bool)
    with np.errstate(invalid="ignore"):
        found[whole] = (mean + reach)[whole] < (mean - reach)[whole].max(axis=0)
    return found


def _predicted(maps: Maps, largest_se: float, missed: Array) -> dict[str, Array]:
    """Ratio of predicted to measured variance at the largest count, and its interval.

    The interval combines the errors of both variances.
    The ratio is NaN if hardly any samples of the measurement or of the prediction hit a rare event.
    If hardly any samples hit a rare event, variances and their errors are mostly far too small.
    """
    predicted, measured = maps.predicted, maps.variance[:, -1]
    with np.errstate(invalid="ignore", divide="ignore"):
        own, other = maps.predicted_se / predicted, maps.relative_se[:, -1]
        error = np.hypot(own, other)
        log_ratio = np.log(predicted) - np.log(measured)
        known = np.isfinite(log_ratio) & (own <= _LARGEST_PREDICTED_SE) & (other <= largest_se)
        log_ratio[~known | missed] = np.nan
        value, ci = statistics.ratio(log_ratio, error)
    return {"predicted_ratio": value, "predicted_ratio_ci": ci}
