"""Profile a scene as it is rendered: the sampler to use, the samples per pixel, and the causes.

Method
------
Pixels are chosen at random in strata of the image.
Each pixel is rendered several times with every sampler.
Pixels are rendered as in a render of the whole image (`mcspectra.rendering.rendered`).
Samplers of this package are padded: each request of a path for 1 or 2 numbers gets its own set.
Samplers of this package are also measured with joint dims:
the first coordinates of a path then come from one set of points in several dims.
Mitsuba's own samplers are not changed.
All samplers are measured with two numbers n of samples per pixel.
The best sampler is then confirmed by further renders with new seeds.

The error of a pixel is the ratio σ / mean, as in ``frames``.
The number of samples that a share q of the pixels needs follows from the q-quantile of the errors.
Samplers are compared by the geometric mean of their variances over the noisier half of the pixels.
The noisier pixels decide the number of samples, because other pixels need fewer samples.
Errors from few renders are noisy, which widens the distribution of errors over the pixels.
The errors are therefore moved toward their median; two halves of the renders show how far.
If the answer is far from the measured numbers of samples, it is checked by further renders:
pixels near the quantile are rendered again with a number of samples near the answer.
"""

from __future__ import annotations

import contextlib
import math
import shlex
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from mcspectra.core.checks import (
    PROFILE_PIXELS,
    SECONDS_LIMITS,
    TARGET_LIMITS,
    Array,
    as_integer,
    as_joint_dims,
    as_real,
)
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.display import between, counted, escape_html
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.progress import report
from mcspectra.core.streams import RngLike, Stream
from mcspectra.improve.answers import Answer, CandidateResult, simultaneous_z
from mcspectra.rendering.backend import LOCK, compilations
from mcspectra.rendering.costs import SceneCost
from mcspectra.rendering.map_statistics import path_shares
from mcspectra.rendering.map_tiles import Lighting, Measurement
from mcspectra.rendering.paths import (
    SCENE_INTEGRATOR,
    Dimension,
    Tracer,
    find_integrator,
    window_dimensions,
)
from mcspectra.rendering.pixel import check_channel
from mcspectra.rendering.plugin import FAR_APART, JOINT_DIMS, PLUGIN, joint_dims_of
from mcspectra.rendering.rendered import (
    OWN_SAMPLER,
    Film,
    RenderedPixels,
    chosen_tiles,
    pixels_of,
    preview,
)
from mcspectra.rendering.scenes import Scene, as_scene, load_scene, scene_name, sensor_of
from mcspectra.samplers import as_sampler

__all__ = [
    "Needed",
    "SceneProfile",
    "SceneSettings",
    "VarianceShare",
    "pixel_command",
    "plan_scene",
    "profile_scene",
    "sampler_name",
    "whole_samples",
]


@final
@dataclass(frozen=True)
class SceneSettings:
    """Shares of time for the steps of a scene's profile, and limits of its statistics."""

    # Number of measured pixels.
    # With 1000 pixels, the measured 95 % quantile is a true quantile between 93.6 and 96.4 %.
    pixels: int = 1024
    # Least number of measured pixels, for scenes that are slow to render
    least_pixels: int = 96
    # Numbers of samples per pixel at which samplers are compared.
    # All samplers support powers of 4
    counts: tuple[int, int] = (16, 64)
    # Maximum and minimum number of renders of each pixel.
    # With 32 renders, the variance of a pixel has a relative error of 25 %.
    most_renders: int = 32
    least_renders: int = 8
    # Maximum number of renders if fewer than `pixels` pixels are measured, for example in a crop.
    # With 1024 renders, the variance of a pixel has a relative error of 4 %.
    renders_of_few: int = 1024
    # Number of pixels, and numbers of renders, in the tests that measure the speed.
    # The first render also compiles. The second test takes 65,000 samples, because smaller
    # wavefronts are slow. If it takes less than `pilot_seconds`, the last test has a fourfold size:
    # the fixed time of a wavefront, some hundredths of a second, is then a small part
    pilot_pixels: int = 256
    pilot_renders: tuple[int, int, int] = (1, 16, 64)
    pilot_seconds: float = 0.2
    # Fraction of the time that is spent on the comparison of samplers.
    # The rest of the time is for larger numbers of samples, and for confirming the best sampler
    comparison: float = 0.55
    # Shares of the pixels for which the numbers of samples that reach the target are printed
    shares: tuple[float, float] = (0.5, 0.95)
    # Number of pixels near a quantile of the errors that are rendered with more samples.
    # Each of these pixels is rendered `near_renders` times
    near: int = 32
    near_renders: int = 16
    # Least share of the sum of squared deviations that one render has in a pixel with rare paths.
    # Such a variance is doubled by one render. For few renders the share is larger, so that
    # a pixel of normal values is taken for a pixel with rare paths with probability `outlier`
    dominant: float = 0.5
    outlier: float = 1e-3
    # Minimum number of these pixels on each side of the quantile, if there are that many pixels.
    # The error of the median of 16 pixels is a third of the scatter over pixels
    least_near: int = 8
    # Largest fraction of the time for one number of samples of pixels near a quantile.
    # For each of two quantiles and two samplers, there are at most two such numbers
    nearby_each: float = 0.1
    nearby_most: int = 8
    # Largest number of samples per pixel with which pixels near a quantile are rendered
    most_samples: int = 2**14
    # Largest ratio of a sampler's variance to the least variance at 16 samples.
    # Samplers with a larger variance are not measured at 64 samples.
    # Between 16 and 64 samples, a ratio of variances changes by less than a factor of 2
    dropped: float = 2.0
    # Number of pixels from which the shares of the variance by decision are estimated.
    # For each of these pixels, `cause_chains` pairs of paths are traced
    cause_pixels: int = 128
    cause_chains: int = 64
    # Number of pixels that are listed because they have the largest errors
    worst: int = 5
    # Limits of the slope of log variance against log n. Measured slopes are clipped to this range
    steepest: float = -3.0
    slowest: float = -0.5
    # Usual slope, and its standard deviation over pixels and scenes. Slopes of rendered pixels lie
    # between −1 and −1.5. With 1024 pixels, the measured slope has a weight of 90 % or more
    usual: float = -1.15
    usual_error: float = 0.3
    # Ratio of the upper end of an interval to a number of samples.
    # Above it, the number is not printed if the lower end is at most one sample,
    # because the interval excludes nothing
    unknown: float = 100.0


_SETTINGS = SceneSettings()
_ENDLESS = 1e12  # numbers of samples above this are not printed
_MITSUBA = ("independent", "multijitter", "ldsampler")
_OURS = "sobol | owen"
_CLASSES = {
    # Class of a sampler in Mitsuba, and name of its plugin
    "IndependentSampler": "independent",
    "StratifiedSampler": "stratified",
    "MultijitterSampler": "multijitter",
    "OrthogonalSampler": "orthogonal",
    "LowDiscrepancySampler": "ldsampler",
}


@final
@dataclass(frozen=True)
class VarianceShare:
    """Share of the variance that is due to one decision of a random path.

    An interaction of several decisions counts as a share of the last of these decisions.
    """

    decision: str
    share: float
    share_ci: tuple[float, float]


@final
@dataclass(frozen=True)
class Needed:
    """Number of samples per pixel with which a share of the pixels reaches the target error."""

    share: float
    spp: float
    spp_ci: tuple[float, float]


@final
@dataclass(frozen=True)
class SceneProfile:
    """The noise of a rendered scene. Print this object to see the advice.

    Attributes
    ----------
    answer
        The recommended sampler, compared with the sampler of the scene.
        The recommended sampler and the scene's sampler take `compared_spp` samples per pixel.
        The errors `rmse` in the answer are medians of σ / mean over the pixels.
    target
        Relative error σ / mean that pixels should reach.
    needed, needed_now
        Numbers of samples per pixel with which half and 95 % of the pixels reach the target.
        `needed` is for the recommended sampler, and `needed_now` for the sampler of the scene.
    missing, missing_ci
        Share of the pixels that miss the target with the present settings of the scene.
    spp
        Present number of samples per pixel of the scene.
    causes
        Shares of the variance by decision of a random path, the largest share first.
    confirmed, confirmed_ci
        Variance of the recommended sampler in new renders, divided by the first measurement.
    worst
        Pixels with the largest relative errors: x, y, and the error with `compared_spp` samples.
    picture
        A small picture of the scene, linear RGB (height, width, 3).
    """

    scene: str
    integrator: str
    target: float
    spp: int
    size: tuple[int, int]
    pixels: int
    renders: int
    compared_spp: int
    answer: Answer
    needed: tuple[Needed, ...]
    needed_now: tuple[Needed, ...]
    missing: float
    missing_ci: tuple[float, float]
    causes: tuple[VarianceShare, ...]
    confirmed: float
    confirmed_ci: tuple[float, float]
    worst: tuple[tuple[int, int, float], ...]
    black: int
    seconds: float
    samples: int
    notes: tuple[str, ...] = field(default=())
    picture: Array | None = field(default=None, repr=False, compare=False)

    @property
    def text(self) -> str:
        """All results as text of several lines."""
        best, low_high = self.answer.best, _percent_ci
        lines = [self.answer.advice, ""]
        lines.append(f"target      σ / mean = {self.target:.3g} at each pixel")
        both = ((best.name, self.needed), (self.answer.given.name, self.needed_now))
        for name, needed in both if self.answer.changes else both[:1]:
            for each in needed:
                lines.append(
                    f"{f'at {each.share:.0%}':<11} {_spp(each)} samples per pixel with {name}"
                )
        lines.append(
            f"now         {self.spp} samples per pixel with {self.answer.given.name}: "
            f"{self.missing:.0%} of the pixels {low_high(self.missing_ci)} miss the target"
        )
        for k, cause in enumerate(self.causes[:2]):
            head = "causes" if k == 0 else ""
            lines.append(
                f"{head:<11} {cause.decision}: {cause.share:.0%} {low_high(cause.share_ci)} of the "
                "variance (random numbers, one path per pixel)"
            )
        lines.append(
            f"confirmed   new renders with {best.name} have {self.confirmed:.2f} "
            f"({_ends(*self.confirmed_ci)}) times the variance of those in the comparison"
        )
        lines.append(
            "samplers    variance in relation to the scene's sampler: geometric mean over the "
            f"noisier half of the pixels at {self.compared_spp} samples per pixel"
        )
        for result in self.answer.results:
            low, high = result.gain_ci
            most = 1.0 / low if low > 0.0 else math.inf
            ends = "" if result is self.answer.given else f"({_ends(1.0 / high, most)})"
            lines.append(f"  {result.name:<60} {1.0 / result.gain:.2f} {ends}".rstrip())
        lines.append(f"worst pixels at {self.compared_spp} samples per pixel with {best.name}")
        for x, y, error in self.worst:
            lines.append(f"  σ / mean {error:<8.2g} {pixel_command(self, x, y)}")
        lines += self.notes
        lines.append(
            f"measured    {self.scene}, integrator {self.integrator}, {self.size[0]} × "
            f"{self.size[1]} pixels: {counted(self.pixels, 'pixel')} rendered {self.renders} times "
            f"({self.samples / 1e6:.1f} million samples, {self.seconds:.0f} s)"
        )
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return f"<pre>{escape_html(self.text)}</pre>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists."""
        own = ("answer", "causes", "needed", "picture")
        plain = {k: v for k, v in vars(self).items() if k not in own}
        plain["answer"] = {**self.answer.to_dict(), "causes": [vars(c) for c in self.causes]}
        plain["causes"] = [vars(cause) for cause in self.causes]
        plain["needed"] = [vars(each) for each in self.needed]
        plain["needed_now"] = [vars(each) for each in self.needed_now]
        plain["samplers"] = [each.to_dict() for each in self.answer.results]
        return plain


def pixel_command(found: SceneProfile, x: int, y: int) -> str:
    """Return the command that analyzes a pixel of a profiled scene."""
    integrator = shlex.quote(found.integrator)
    return f"mcspectra pixel {shlex.quote(found.scene)} {x} {y} --integrator {integrator}"


def _noisy(values: Sequence[Array]) -> Array:
    """Return a mask of the noisier half of the pixels. Noise is averaged over all samplers."""
    logs = np.mean([np.log(np.maximum(v.var(axis=0, ddof=1), 1e-300)) for v in values], axis=0)
    mean = np.abs(np.mean([v.mean(axis=0) for v in values], axis=0))
    with np.errstate(divide="ignore"):
        relative = np.where(mean > 0.0, logs - 2.0 * np.log(mean), -np.inf)
    seen = relative[np.isfinite(relative)]
    return np.asarray(relative >= (np.median(seen) if seen.size else -np.inf))


def _noise_of_log(renders: int) -> float:
    """Return the standard deviation of the logarithm of a variance, from normal values."""
    from scipy.special import polygamma

    return math.sqrt(float(polygamma(1, 0.5 * (renders - 1))))


def _spread(logs: Array, noise: float) -> float:
    """Return the standard deviation of logarithms of variances, which is at least their noise.

    One pixel has no standard deviation, and that of few pixels may be small by chance.
    """
    return max(float(np.std(logs, ddof=1)) if len(logs) > 1 else 0.0, noise)


def _scale(deviations: Array) -> float:
    """Return a standard deviation that few outliers do not change, from deviations from a center.

    The median absolute deviation of normal values is 0.6745 standard deviations.
    """
    return float(np.median(np.abs(deviations))) / 0.6745


def _rare(values: Array, mean: Array) -> Array:
    """Return a mask of the pixels whose variance is due to rare paths, from renders (R, P).

    The variance of such a pixel is unknown: with more renders it may be far larger.
    In a pixel with rare paths, one render has most of the sum of squared deviations.
    Or no render has a rare path: all renders are equal, but other samplers have another mean.
    """
    from scipy.special import stdtrit

    off = (values - values.mean(axis=0)) ** 2
    total, count = off.sum(axis=0), len(values)
    # Grubbs' limit of the share of one of `count` normal values
    t2 = float(stdtrit(count - 2, _SETTINGS.outlier / (2.0 * count))) ** 2
    limit = max(_SETTINGS.dominant, (count - 1) / count * t2 / (count - 2 + t2))
    eps = 4.0 * np.finfo(np.float32).eps
    equal = total <= count * (eps * mean) ** 2
    apart = np.abs(values.mean(axis=0) - mean) > eps * mean
    return np.asarray(np.where(equal, apart, off.max(axis=0) > limit * total))


def _in_order(found: Iterable[Needed]) -> tuple[Needed, ...]:
    """Return the numbers of samples in ascending order of the shares of pixels.

    More pixels never need fewer samples. Each share has its own renders, so that by chance its
    number may be smaller than the number before. Then it gets the number before.
    """
    made = list[Needed]()
    for each in found:
        if made:
            last = made[-1]
            ends = tuple(map(max, each.spp_ci, last.spp_ci))
            each = Needed(each.share, max(each.spp, last.spp), (ends[0], ends[1]))
        made.append(each)
    return tuple(made)


def _spp(each: Needed) -> str:
    low, high = each.spp_ci
    unknown = high > _SETTINGS.unknown * each.spp and low <= 1.0
    if unknown or not each.spp < _ENDLESS:
        return "an unknown number of"
    if not high < _ENDLESS:
        return f"{whole_samples(each.spp)} ({whole_samples(low)} or more)"
    found, ends = whole_samples(each.spp), between(whole_samples(low), whole_samples(high))
    return found if found == ends else f"{found} ({ends})"


def _ends(low: float, high: float) -> str:
    return between(f"{low:.2f}", f"{high:.2f}")


def whole_samples(value: float) -> str:
    """Format a number of samples with two or three digits, rounded up to a whole number."""
    if not value < _ENDLESS:
        return "unknown" if math.isnan(value) else "∞"
    if value < 1.0:
        return "1"
    scale = 10.0 ** max(0, math.floor(math.log10(value)) - 2)
    return f"{math.ceil(value / scale) * scale:.0f}"


def _percent_ci(ends: tuple[float, float]) -> str:
    low, high = (min(max(end, 0.0), 1.0) for end in ends)
    return f"({between(f'{low:.0%}', f'{high:.0%}')})"


def profile_scene(
    scene: Scene,
    *,
    target: float | None = None,
    integrator: str | None = None,
    samplers: Sequence[str] = (),
    joint_dims: int | None = None,
    spp: int | None = None,
    channel: str | int = "luminance",
    pixels: int | None = None,
    crop: Sequence[int] | None = None,
    seconds: float = 30.0,
    rng: RngLike = 0,
) -> SceneProfile:
    """Compare samplers on a rendered scene, and find the samples per pixel for a target error.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `mcspectra.rendering.load_scene`.
    target
        Relative error σ / mean that pixels should reach, by default 0.05.
    integrator
        One of Mitsuba's integrators; by default the integrator of the scene.
    samplers
        Specs of further samplers of this package to compare.
    joint_dims
        Number of joint dims of this package's samplers; by default the plugin's number.
    spp
        Present number of samples per pixel; by default the number in the scene.
    channel
        ``"luminance"``, 0, 1 or 2.
    pixels
        Maximum number of measured pixels, by default 1024.
    crop
        The rectangle of the image in which pixels are measured: x0, y0, width and height.
    seconds
        Time for renders, in seconds. Loading the scene and compiling kernels take extra time.
    rng
        Seed (SPEC 7). The number of renders depends on the speed of the machine.

    Raises
    ------
    ParameterError
        If a parameter is out of range, or Mitsuba cannot render the scene.
    """
    goal = _goal(target)
    work, candidates, given, own = _prepared(
        scene, integrator, samplers, joint_dims, channel, seconds, rng
    )
    now = own if spp is None else as_integer("spp", spp, least=1, most=2**24)
    work.crop = _checked_crop(crop, work.rendered.film)
    return work.profile(candidates, goal, now, _most(pixels), given)


def plan_scene(
    scene: Scene,
    *,
    target: float | None = None,
    integrator: str | None = None,
    samplers: Sequence[str] = (),
    joint_dims: int | None = None,
    channel: str | int = "luminance",
    pixels: int | None = None,
    crop: Sequence[int] | None = None,
    seconds: float = 30.0,
    rng: RngLike = 0,
) -> SceneCost:
    """Return what `profile_scene` with these parameters would do, and how long it would take.

    The function loads the scene and renders a few pixels to measure the speed.
    These renders also show about how many samples the target takes.
    """
    goal = _goal(target)
    work, candidates, given, _ = _prepared(
        scene, integrator, samplers, joint_dims, channel, seconds, rng
    )
    work.crop = _checked_crop(crop, work.rendered.film)
    return work.plan(candidates, _most(pixels), given, goal)


def _goal(target: float | None) -> float:
    return 0.05 if target is None else as_real("target", target, **TARGET_LIMITS)


def _checked_crop(crop: Sequence[int] | None, film: Film) -> tuple[int, int, int, int] | None:
    if crop is None:
        return None
    given = [as_integer("crop", each, least=0) for each in crop]
    x0, y0, width, height = given if len(given) == 4 else (0, 0, 0, 0)
    if not (width and height and x0 + width <= film.width and y0 + height <= film.height):
        raise ParameterError(
            Parameter("crop"),
            f" is {given}; give x0, y0, width and height within {film.width} × {film.height} "
            "pixels.",
        )
    return x0, y0, width, height


def _most(pixels: int | None) -> int:
    return as_integer("pixels", _SETTINGS.pixels if pixels is None else pixels, **PROFILE_PIXELS)


def _prepared(
    scene: Scene,
    integrator: str | None,
    samplers: Sequence[str],
    joint_dims: int | None,
    channel: str | int,
    seconds: float,
    rng: RngLike,
) -> tuple[_Work, dict[str, str | Mapping[str, Any]], str, int]:
    """Read a scene and prepare its profile.

    Return the work to be done, all samplers, the scene's sampler, and its samples per pixel.
    """
    limit = as_real("seconds", seconds, **SECONDS_LIMITS)
    check_channel(channel)
    request, spec = as_scene(scene), SCENE_INTEGRATOR if integrator is None else integrator
    begin = time.perf_counter()
    with LOCK:
        load_scene(request)
        find_integrator(request, spec)
        film, own = Film.of(request), sensor_of(request).sampler()
        now, given = int(own.sample_count()), sampler_name(own)
    tracer = Tracer(request, spec, channel, (film.width, film.height))
    work = _Work(RenderedPixels(tracer, film), Stream.from_rng(rng), limit, begin)
    return work, _candidates(given, samplers, joint_dims), given, now


def sampler_name(sampler: Any) -> str:
    """Return the name of a sampler's plugin, or the spec of a sampler of this package."""
    return _CLASSES.get(str(sampler.class_name())) or str(sampler).partition("\n")[0]


def _candidates(
    given: str, samplers: Sequence[str], joint_dims: int | None
) -> dict[str, str | Mapping[str, Any]]:
    """Return all compared samplers: name and plugin. The sampler of the scene is the first."""
    found: dict[str, str | Mapping[str, Any]] = {given: OWN_SAMPLER}
    found |= {name: name for name in _MITSUBA if name not in found}
    for spec in dict.fromkeys((_OURS, *samplers)):
        own = as_sampler(spec, 2)
        joint = (
            joint_dims_of(own) if joint_dims is None else as_joint_dims("joint_dims", joint_dims)
        )
        for k in dict.fromkeys((joint, 0)):
            name = f"{spec} ({f'joint_dims={k}' if k else 'padded'})"
            found.setdefault(name, {"type": PLUGIN, "spec": spec, "joint_dims": k})
    found.setdefault(
        f"{FAR_APART} (joint_dims={JOINT_DIMS})",
        {"type": PLUGIN, "spec": FAR_APART, "joint_dims": JOINT_DIMS},
    )
    return found


@dataclass
class _Work:
    rendered: RenderedPixels
    stream: Stream
    limit: float
    begin: float
    side: int = 1
    used: int = 0
    crop: tuple[int, int, int, int] | None = None

    def _stream(self) -> Stream:
        self.used += 1
        return self.stream.child(self.used)

    def profile(
        self,
        candidates: Mapping[str, str | Mapping[str, Any]],
        target: float,
        now: int,
        most: int,
        given: str,
    ) -> SceneProfile:
        settings, counts = _SETTINGS, list(_SETTINGS.counts)
        tiles, renders, _ = self.planned(candidates, most, given)
        pixels = pixels_of(tiles, self.side)

        # Render with all samplers at the first number of samples.
        # At the larger number of samples, render only with promising samplers
        values: dict[str, dict[int, Array]] = {name: {} for name in candidates}
        notes: list[str] = []
        for k, n in enumerate(counts):
            for j, (name, plugin) in enumerate(candidates.items()):
                report("profile: samplers", (k + j / len(candidates)) / 2)
                if k and not values[name]:
                    continue
                if k and name != given:
                    among = _noisy([v[counts[0]] for v in values.values() if v])
                    firsts = {
                        other: self._ratio(v[counts[0]], values[given][counts[0]], among)
                        for other, v in values.items()
                        if v
                    }
                    least = min(log for log, _ in firsts.values())
                    if firsts[name][0] - least > math.log(settings.dropped):
                        continue
                try:
                    values[name][n] = self._values(plugin, n, tiles, renders)
                except ParameterError as error:
                    if name == given:
                        raise
                    notes.append(f"not tried  {name}: {error}")
        return self._result(candidates, values, tiles, pixels, renders, target, now, given, notes)

    def planned(
        self, candidates: Mapping[str, str | Mapping[str, Any]], most: int, given: str
    ) -> tuple[Array, int, float]:
        """Return tiles of pixels, a number of renders that the time allows, and the speed.

        The speed is the measured number of samples per second.
        """
        settings, rendered, counts = _SETTINGS, self.rendered, _SETTINGS.counts
        tiles, side = chosen_tiles(rendered.film, most, self._stream(), self.crop)
        self.side, wide = side, (side + 2 * rendered.film.margin) ** 2

        # Measure the speed with few renders. The first render also compiles the kernel
        report("profile: speed", 0.0)
        some = tiles[:: max(1, len(tiles) * self.side**2 // _SETTINGS.pilot_pixels)]
        for pilot in settings.pilot_renders:
            before = rendered.samples, rendered.seconds
            self._values(candidates[given], counts[0], some, pilot)
            spent = rendered.seconds - before[1]
            if pilot > 1 and spent > settings.pilot_seconds:
                break
        speed = (rendered.samples - before[0]) / spent
        allowed = settings.comparison * self.limit * speed
        each = wide * sum(counts) * len(candidates)
        renders = int(allowed / (each * len(tiles)))
        if renders < settings.least_renders:
            keep = max(
                math.ceil(settings.least_pixels / side**2),
                int(allowed / (each * settings.least_renders)),
            )
            order = np.argsort(self._stream().uniforms(0, len(tiles), 1)[:, 0], kind="stable")
            tiles = tiles[np.sort(order[:keep])]
        # Few pixels are rendered more often: their variances are as precise as the time allows
        few = max(1, settings.pixels // (len(tiles) * side**2))
        most_renders = min(few * settings.most_renders, settings.renders_of_few)
        renders = min(max(renders, settings.least_renders), most_renders)
        renders += renders % 2
        return tiles, renders, speed

    def plan(
        self,
        candidates: Mapping[str, str | Mapping[str, Any]],
        most: int,
        given: str,
        target: float,
    ) -> SceneCost:
        """Measure the speed, and estimate the time and the number of samples of the profile.

        All kernels of the profile are compiled, and stored on disk for the profile.
        """
        settings, counts, rendered = _SETTINGS, _SETTINGS.counts, self.rendered
        with compilations() as compiled:
            tiles, renders, _ = self.planned(candidates, most, given)
            tracer, film = rendered.tracer, rendered.film
            pixels = pixels_of(tiles, self.side)
            self._causes(pixels, np.ones(len(pixels)))
            preview(tracer.scene, tracer.integrator)
        fixed = time.perf_counter() - self.begin - sum(compiled)

        # Measure the mean speed of all samplers at the larger number of samples
        some = tiles[:: max(1, len(tiles) * self.side**2 // settings.pilot_pixels)]
        traced, spent, near = 0, 0.0, 0
        for name, plugin in candidates.items():
            with contextlib.suppress(ParameterError):  # the profile says why it leaves one out
                for n in counts:
                    self._values(plugin, n, some, 1)
                before = rendered.samples, rendered.seconds
                values = self._values(plugin, counts[-1], some, settings.pilot_renders[1])
                traced += rendered.samples - before[0]
                spent += rendered.seconds - before[1]
                if name == given:
                    near = self._nearby(values, target)
        speed = traced / spent

        # Count the samples to compare all samplers, and to confirm the best sampler
        wide = (self.side + 2 * film.margin) ** 2
        samples = wide * len(tiles) * renders * (sum(counts) * len(candidates) + counts[-1])
        compared = fixed + samples / speed
        # Pixels near two quantiles are rendered with the scene's sampler and with the best one
        near *= min(len(candidates), 2)
        longest = settings.nearby_most * settings.nearby_each * self.limit
        return SceneCost(
            scene=scene_name(tracer.scene).strip("'\""),
            what=f"{renders} renders of each with {len(candidates)} samplers",
            size=(film.width, film.height),
            pixels=len(tiles) * self.side**2,
            samples=samples + near,
            samples_per_second=speed,
            seconds=compared + near / speed,
            most=compared + longest,
        )

    def _nearby(self, values: Array, target: float) -> int:
        """Estimate the number of samples for pixels near the quantiles of one sampler's errors.

        The values (R, P) are those of R renders of P pixels with the last of the compared counts.
        """
        settings, mean = _SETTINGS, np.abs(values.mean(axis=0))
        (first, last), seen = settings.counts, mean > 0.0
        if not seen.any():
            return 0
        logs, samples = self._narrowed(values[:, seen], mean[seen]), 0
        for share in settings.shares:
            away = 2.0 * math.log(target) - float(np.quantile(logs, share))
            wanted = last * math.exp(away / settings.usual)
            each = self._each_near(settings.near, settings.near_renders)
            samples += each * (self._next_count(first, last, wanted, each) or 0)
        return samples

    def _each_near(self, pixels: int, renders: int) -> int:
        """Return the number of paths for renders of pixels, if each takes one sample."""
        return (1 + 2 * self.rendered.film.margin) ** 2 * pixels * renders

    def _next_count(self, first: int, n: float, wanted: float, each: int) -> int | None:
        """Return the number of samples with which pixels near a quantile are rendered next.

        No more renders are needed if the last number n is close to the number wanted, and none
        are made if they take too much time; the result is then None.
        The renders take `each` paths if each pixel has one sample.
        """
        settings = _SETTINGS
        if 0.5 * n <= wanted <= 2.0 * n or wanted < 0.5 * first or n >= settings.most_samples:
            return None
        speed = self.rendered.samples / self.rendered.seconds
        afford = settings.nearby_each * self.limit * speed / each
        count = 4 ** max(1, round(math.log(min(wanted, afford, settings.most_samples), 4)))
        return None if count <= n and wanted > n else count

    def _values(
        self, plugin: str | Mapping[str, Any], n: int, tiles: Array, renders: int, side: int = 0
    ) -> Array:
        return self.rendered.estimates(plugin, n, tiles, side or self.side, renders, self._stream())

    @staticmethod
    def _ratio(a: Array, b: Array, among: Array | None = None) -> tuple[float, float]:
        """Return the mean over pixels of log Var(a)/Var(b), and its standard error.

        The values a and b are (R, P) for R renders of P pixels.
        The mask `among` (P,) selects pixels; by default all pixels are used.
        """
        if among is not None:
            a, b = a[:, among], b[:, among]
        va, vb = a.var(axis=0, ddof=1), b.var(axis=0, ddof=1)
        floor = (4.0 * np.finfo(np.float32).eps * a.mean(axis=0)) ** 2
        known = (va > floor) & (vb > floor)
        if not known.any():
            return 0.0, math.inf
        logs = np.log(va[known] / vb[known])
        noise = math.hypot(_noise_of_log(len(a)), _noise_of_log(len(b)))
        return float(logs.mean()), _spread(logs, noise) / math.sqrt(known.sum())

    def _result(
        self,
        candidates: Mapping[str, str | Mapping[str, Any]],
        values: Mapping[str, dict[int, Array]],
        tiles: Array,
        pixels: Array,
        renders: int,
        target: float,
        now: int,
        given: str,
        notes: list[str],
    ) -> SceneProfile:
        settings = _SETTINGS
        first, last = settings.counts
        # Average each pixel over all renders, because all samplers are unbiased
        every = [(n, v.mean(axis=0)) for each in values.values() for n, v in each.items()]
        mean = sum(n * m for n, m in every) / sum(n for n, _ in every)
        mean = np.abs(np.asarray(mean))
        seen = mean > 0.0
        if not seen.any():
            raise ParameterError("All measured pixels are black; choose another view or channel.")

        # Choose the best sampler, and confirm it with new seeds
        at = {name: last if last in each else first for name, each in values.items() if each}
        # Choose noisy pixels by the renders at the first number of samples.
        # Otherwise, pixels with estimates that are too large by chance would be preferred
        among = _noisy([each[first] for each in values.values() if first in each])
        ratios = {
            name: self._ratio(values[name][n], values[given][n], among)
            for name, n in at.items()
            if name != given
        }
        promising = [name for name in ratios if at[name] == last]
        best = min(promising, key=lambda name: ratios[name][0], default=given)
        if best != given and ratios[best][0] >= 0.0:
            best = given
        report("profile: confirmation", 0.0)
        again = self._values(candidates[best], last, tiles, renders)
        confirmed, confirmed_se = self._ratio(again, values[best][last], among)
        if best != given:
            # The least of several variances tends to be too small; new renders avoid this bias
            ratios[best] = self._ratio(again, values[given][last], among)
        fresh = {name: values[name] for name in {best, given}}
        fresh[best] = {**values[best], last: np.concatenate([values[best][last], again])}

        # Compare with the scene's own sampler
        z = simultaneous_z(len(ratios))
        integrator = self.rendered.tracer.integrator

        def result(name: str) -> CandidateResult:
            n = at[name]
            own = values[name][n] if name not in fresh else fresh[name][n]
            logs = self._logs(own, mean)[seen]
            median = math.exp(0.5 * float(np.median(logs)))
            spread = 1.2533 * _spread(logs, _noise_of_log(len(own))) / math.sqrt(len(logs))
            ends = tuple(median * math.exp(0.5 * k * CONFIDENCE_Z * spread) for k in (-1, 1))
            log, se = ratios.get(name, (0.0, 0.0))
            gain_ci = (math.exp(-log - z * se), math.exp(-log + z * se))
            verdict: Any = "given"
            if name != given:
                verdict = "undecided"
                verdict = "better" if gain_ci[0] > 1.0 else verdict
                verdict = "worse" if gain_ci[1] < 1.0 else verdict
            change = f"keep {name}" if name == given else f"use {name}"
            return CandidateResult(
                name, change, (integrator, name), last, median, (ends[0], ends[1]),
                gain=math.exp(-log), gain_ci=gain_ci, verdict=verdict,
            )  # fmt: skip

        others = sorted(ratios, key=lambda name: (name != best, ratios[name][0]))
        results = [result(name) for name in (given, *others)]
        report("profile: samples per pixel", 0.0)
        whole = Answer.of(last, results)
        chosen = whole.best.name
        needed = {
            name: _in_order(
                self._needed(
                    candidates[name],
                    fresh.get(name, values[name]),
                    mean,
                    pixels,
                    share,
                    target,
                    # The variance of independent samples falls exactly as 1/n
                    rate=-1.0 if name == "independent" else None,
                )
                for share in settings.shares
            )
            for name in {chosen, given}
        }

        # Compute the share of pixels that miss the target at present.
        # Errors are extrapolated from the last measured number of samples
        logs, slope = self._quantities(fresh[given], mean, seen)
        errors = np.zeros(len(mean))
        errors[seen] = np.exp(0.5 * (logs + slope * math.log(now / last)))
        lacking = float((errors > target)[seen].mean())
        half = CONFIDENCE_Z * math.sqrt(
            max(lacking * (1 - lacking), 0.25 / seen.sum()) / seen.sum()
        )
        noisy = np.zeros(len(mean))
        noisy[seen] = np.exp(
            0.5 * self._quantities(fresh.get(chosen, values[chosen]), mean, seen)[0]
        )
        order = np.argsort(-noisy, kind="stable")[: settings.worst]
        report("profile: causes", 0.0)
        answer = self._answer(results, chosen, needed[chosen], target)
        rendered = self.rendered
        return SceneProfile(
            scene=scene_name(rendered.tracer.scene).strip("'\""),
            integrator=integrator,
            target=target,
            spp=now,
            size=(rendered.film.width, rendered.film.height),
            pixels=len(pixels),
            renders=renders,
            compared_spp=last,
            answer=answer,
            needed=needed[chosen],
            needed_now=needed[given],
            missing=lacking,
            missing_ci=(lacking - half, lacking + half),
            causes=self._causes(pixels, mean),
            confirmed=math.exp(confirmed),
            confirmed_ci=(
                math.exp(confirmed - CONFIDENCE_Z * confirmed_se),
                math.exp(confirmed + CONFIDENCE_Z * confirmed_se),
            ),
            worst=tuple(
                (int(pixels[k, 0]), int(pixels[k, 1]), float(noisy[k]))
                for k in order
                if noisy[k] > 0
            ),
            black=int((~seen).sum()),
            seconds=time.perf_counter() - self.begin,
            samples=rendered.samples,
            notes=tuple(notes),
            picture=preview(rendered.tracer.scene, integrator),
        )

    @staticmethod
    def _answer(
        results: Sequence[CandidateResult], chosen: str, needed: Sequence[Needed], target: float
    ) -> Answer:
        """Return the answer, which ends with a sentence about samples per pixel."""
        given = results[0]
        best = next(each for each in results if each.name == chosen)
        half, most = needed
        spp = (
            f"σ / mean = {target:.3g} takes {_spp(half)} samples per pixel at half of the pixels "
            f"and {_spp(most)} at 95 %."
        )
        if chosen == given.name:
            lead = f"Keep {given.name}: no compared sampler has significantly less variance."
        else:
            low, high = best.gain_ci
            lead = (
                f"Use {best.name}: {best.gain:.2f} times less variance than {given.name} "
                f"({_ends(low, high)}) at the noisier half of the pixels, with {best.n} "
                "samples per pixel."
            )
        return Answer.of(best.n, results, instead=f"{lead} {spp}")

    @staticmethod
    def _logs(values: Array, mean: Array) -> Array:
        """Return the logarithm of the squared relative error of each pixel, from renders (R, P)."""
        from scipy.special import digamma

        half = 0.5 * (len(values) - 1)
        # The mean logarithm of a sample variance of normal values is too small by this bias
        bias = float(digamma(half)) - math.log(half)
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = (4.0 * np.finfo(np.float32).eps) ** 2
            logs = np.log(np.maximum(values.var(axis=0, ddof=1) / mean**2, floor))
        return np.asarray(logs - bias)

    @classmethod
    def _narrowed(cls, values: Array, mean: Array) -> Array:
        """Return logarithms of squared errors of pixels, moved toward their median.

        Noise of the measured errors makes the spread of their logarithms over the pixels too large.
        Moving the logarithms toward their median removes the part of the spread that is only noise.
        Both spreads are medians: a dark pixel with rare paths may have no variance in half of the
        renders, and a mean would then be far larger than the noise of other pixels.
        """
        logs = cls._logs(values, mean)
        both = [values[k::2] for k in (0, 1)]
        known = np.all([half.max(axis=0) > half.min(axis=0) for half in both], axis=0)
        if not known.any():
            return logs
        apart = np.subtract(*(cls._logs(half[:, known], mean[known]) for half in both))
        center = float(np.median(logs))
        # The noise of a log variance of few renders grows faster than as one over their number,
        # so the difference of two halves is related to it by the noise of normal values
        part = _noise_of_log(len(values)) / math.hypot(*(_noise_of_log(len(v)) for v in both))
        noise, total = part * _scale(apart), _scale(logs[known] - np.median(logs[known]))
        keep = math.sqrt(max(1.0 - (noise / total) ** 2, 0.0)) if total > 0.0 else 1.0
        return np.asarray(center + keep * (logs - center))

    def _quantities(
        self, values: Mapping[int, Array], mean: Array, seen: Array
    ) -> tuple[Array, float]:
        """Return log squared errors at the largest number of samples, and their median slope.

        Black pixels are left out: only the pixels in the mask `seen` are used.
        """
        logs = {n: self._narrowed(v[:, seen], mean[seen]) for n, v in values.items()}
        first, last = min(logs), max(logs)
        if first == last:
            return logs[last], _SETTINGS.usual
        slope = float(np.median(logs[last] - logs[first])) / math.log(last / first)
        return logs[last], min(max(slope, _SETTINGS.steepest), _SETTINGS.slowest)

    def _needed(
        self,
        plugin: str | Mapping[str, Any],
        values: Mapping[int, Array],
        mean: Array,
        pixels: Array,
        share: float,
        target: float,
        rate: float | None = None,
    ) -> Needed:
        """Find the number of samples with which a share of the pixels reaches the target.

        The rate of the variance is estimated unless it is known exactly.
        """
        settings, goal = _SETTINGS, 2.0 * math.log(target)
        seen = np.flatnonzero(mean > 0.0)
        raw = {n: self._logs(v[:, seen], mean[seen]) for n, v in values.items()}
        logs = {n: self._narrowed(v[:, seen], mean[seen]) for n, v in values.items()}
        first, last = min(logs), max(logs)
        half = CONFIDENCE_Z * math.sqrt(share * (1.0 - share) / len(seen))

        def quantile(n: int) -> tuple[float, float]:
            """Return a quantile of the log squared errors, and its standard error from ranks."""
            ends = np.quantile(logs[n], [max(share - half, 0.0), share, min(share + half, 1.0)])
            # With few pixels, the noise of each measured variance is the larger error
            noise = 1.2533 * _noise_of_log(len(values[n])) / math.sqrt(len(seen))
            return float(ends[1]), max(float(ends[2] - ends[0]) / (2.0 * CONFIDENCE_Z), noise)

        # Variances of pixels with rare paths may be larger. In the worst case, all of these pixels
        # are above the quantile, and the upper end of the interval has a larger rank
        hidden = _rare(values[last][:, seen], mean[seen]) & (logs[last] < quantile(last)[0])
        highest = share + half + float(hidden.mean())
        higher = math.inf
        if not hidden.any():
            higher = 0.0
        elif highest < 1.0:
            higher = float(np.subtract(*np.quantile(logs[last], [highest, share + half])))

        def bounded(slope: float) -> float:
            return min(max(slope, settings.steepest), settings.slowest)

        (level, error), (before, before_error) = quantile(last), quantile(first)
        if rate is None and first == last:  # Measured at one number of samples only
            slope, slope_error = settings.usual, settings.usual_error
        elif rate is None:
            slope = bounded((level - before) / math.log(last / first))
            slope_error = max(math.hypot(error, before_error) / math.log(last / first), 0.1)
            # If few pixels hardly show the slope, the usual slope of renders counts more
            weight = 1.0 / (1.0 + (slope_error / settings.usual_error) ** 2)
            slope = weight * slope + (1.0 - weight) * settings.usual
            slope_error *= math.sqrt(weight)
        else:
            slope, slope_error = rate, 0.0
        n = float(last)
        wanted = n * math.exp((goal - level) / slope)
        if abs(before - goal) < abs(level - goal):
            n, level, error = float(first), before, before_error
            wanted = n * math.exp((goal - level) / slope)

        # Render the pixels near the quantile of the errors, with about the number of samples wanted
        for _ in range(2):
            # The renders at the first number of samples choose the pixels. The renders at the last
            # number of samples are then not too small or too large because of the choice
            order = np.argsort(raw[first], kind="stable")
            rank = round(share * (len(order) - 1))
            # The quantile is in the middle of the chosen pixels
            aside = max(min(settings.near // 2, rank, len(order) - 1 - rank), settings.least_near)
            picks = order[max(rank - aside, 0) : rank + aside]
            near = seen[picks]
            renders = settings.near_renders * max(1, settings.near // len(near))
            count = self._next_count(first, n, wanted, self._each_near(len(near), renders))
            if count is None:
                break  # extrapolate
            found = self._values(plugin, count, pixels[near], renders, side=1)
            # Each pixel is compared with itself: if half of these pixels are far noisier than the
            # others, the median of their errors would be a matter of chance
            change = self._logs(found, mean[near]) - raw[last][picks]
            own = quantile(last)[0] + float(np.median(change))
            # The error of the quantile is added to the error of the median change
            noise = math.hypot(_noise_of_log(renders), _noise_of_log(len(values[last])))
            spread = max(_scale(change - np.median(change)), noise)
            scatter = 1.2533 * spread / math.sqrt(len(near))
            # If the new renders contradict the extrapolated error, the interval includes both
            away = own - level - slope * math.log(count / n)
            known = math.hypot(error, scatter, slope_error * math.log(count / n))
            if abs(away) > CONFIDENCE_Z * known:
                scatter = math.hypot(scatter, away / CONFIDENCE_Z)
            if count != n and rate is None:
                # The slope between these two numbers of samples is noisy if they are close,
                # so it is averaged with the slope before, weighted by the errors of both
                step = math.log(count / n)
                weight = slope_error**2 / (slope_error**2 + (scatter**2 + error**2) / step**2)
                slope = bounded(slope + weight * ((own - level) / step - slope))
                slope_error *= math.sqrt(1.0 - weight)
            n, level, error = float(count), own, math.hypot(error, scatter)
            wanted = n * math.exp((goal - level) / slope)
        away = math.hypot(error, slope_error * abs(math.log(wanted / n))) / abs(slope)
        factor = math.exp(min(CONFIDENCE_Z * away, 700.0))
        most = wanted * factor
        most *= math.exp(-higher / slope) if higher < math.inf else math.inf
        return Needed(share, wanted, (wanted / factor, most))

    def _causes(self, pixels: Array, mean: Array) -> tuple[VarianceShare, ...]:
        """Return the shares of the variance by decision of random paths, over all pixels."""
        settings, tracer = _SETTINGS, self.rendered.tracer
        lit = np.flatnonzero(mean > 0.0)
        picks = lit[np.linspace(0, len(lit) - 1, min(len(lit), settings.cause_pixels)).astype(int)]
        width, height = tracer.size
        uses = window_dimensions(tracer, (0, 0, width, height), None)
        measurement = Measurement(
            lighting=Lighting(
                scene=tracer.scene, light=None, heuristic="balance", channel=tracer.channel,
                size=tracer.size,
            ),
            strategies=("path",),
            sampler=as_sampler("random", len(uses)),
            counts=(1,),
            realizations=2,
            stream=self._stream(),
            own=True,
            predict_every=0,
            tracer=tracer,
            uses=uses,
            chains=settings.cause_chains,
        )  # fmt: skip
        requests = list(dict.fromkeys((use.bounce, use.decision) for use in uses))
        found = measurement._chains(pixels[picks])[..., : len(picks)] / mean[picks]
        (whole, _), shares, _ = path_shares(found, [np.eye(len(requests), dtype=bool)])
        known = np.isfinite(shares[0]).all(axis=0) & np.isfinite(whole)
        if not (whole[known] > 0.0).any():
            return ()  # no traced path of these pixels found light
        parts, total = shares[0][:, known] * whole[known], whole[known]
        share = parts.sum(axis=1) / total.sum()
        off = parts - share[:, None] * total
        se = (
            off.std(axis=1, ddof=1) * math.sqrt(known.sum()) / total.sum()
            if known.sum() > 1
            else np.full_like(share, np.inf)
        )
        made = [
            VarianceShare(
                str(Dimension(*requests[k])),
                float(share[k]),
                (float(share[k] - CONFIDENCE_Z * se[k]), float(share[k] + CONFIDENCE_Z * se[k])),
            )
            for k in np.argsort(-share, kind="stable")
        ]
        return tuple(made)
