"""Adaptive sampling: samples per pixel from a map of the variance, and images rendered with them.

Method
------
A map gives the variance V of each pixel at n samples, and its rate p: V falls like n^p.
The error σ / mean reaches the target E with n·(V / (E·mean)²)^(−1/p) samples.
Rates of single pixels are noisy, so that the median rate of the image is used.
The samples are averaged over small windows of pixels, which removes noise of the variances.
Each average is at least a ninth of the largest number of samples in its window.
A single noisy pixel therefore keeps a large number of samples.

An image takes each pixel's samples, rounded up to a power of two, as one point set.
All pixels with the same number of samples are one wavefront of Mitsuba.
A sample of a pixel with n samples has the weight w/n, where w is the film's filter.
The image is therefore filtered in the same way as an image with equal samples everywhere.

For random points, V = v/n. With samples in proportion to v, all pixels have the same error.
Equal and adaptive samples of the same cost give the same mean square error of the image.
However, noisy pixels have larger errors if all pixels have equally many samples.
Adaptive sampling therefore lowers the largest errors and the upper quantiles of the errors.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import (
    TARGET_LIMITS,
    Array,
    as_integer,
    as_joint_dims,
    as_real,
    as_real_array,
)
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.progress import report
from mcspectra.core.streams import Stream
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.files import write_exr
from mcspectra.rendering.paths import SCENE_INTEGRATOR, Tracer, find_integrator
from mcspectra.rendering.plugin import (
    MOST_SAMPLES,
    PLUGIN,
    default_spec,
    padded_sets,
    register_samplers,
)
from mcspectra.rendering.scenes import (
    Scene,
    as_scene,
    load_scene,
    mitsuba_reason,
    scene_name,
    sensor_of,
)
from mcspectra.rendering.techniques import check_finite

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SamplesPerPixel", "render_adaptive", "samples_per_pixel"]

_LEAST, _MOST = 4, 4096
_STEEPEST, _SLOWEST = -3.0, -0.5  # limits of a pixel's rate; steeper and slower rates are noise
_LEAST_SLOPE_ERROR = 0.05  # least standard error of a pixel's rate about the median rate
_LANES = 2**22  # samples in one wavefront; they take some 400 MiB
_QUANTILES = (0.5, 0.95)


@final
@dataclass(frozen=True)
class SamplesPerPixel:
    """Samples per pixel with which every pixel reaches a target; print it for a summary.

    Attributes
    ----------
    spp
        Samples per pixel (height, width), whole numbers from `least` to `most`.
    low, high
        Ends of the 95 % intervals of `spp` (height, width), within the same limits.
    target
        Relative error σ / mean that pixels should reach.
    least, most
        Least and largest allowed number of samples per pixel.
    uniform
        Equal samples per pixel with which half and 95 % of the pixels reach the target.
    missing
        Share of the pixels that need more than `most` samples.
    filtered
        Whether the film of the scene has another filter than the box filter of the map.
    """

    spp: Array = field(repr=False)
    low: Array = field(repr=False)
    high: Array = field(repr=False)
    target: float
    least: int
    most: int
    uniform: tuple[float, float]
    missing: float
    scene: str
    sampler: str
    filtered: bool = False

    @property
    def mean(self) -> float:
        """Mean number of samples per pixel."""
        return float(self.spp.mean())

    @property
    def text(self) -> str:
        """The advice as sentences."""
        half, most = (math.ceil(each * (1.0 - 1e-9)) for each in self.uniform)
        ratio = self.mean / self.uniform[1]
        told = (
            f"The map takes {100.0 * ratio:.0f} % of the samples that equal samples per pixel "
            "would need for the same 95 % of pixels"
            if ratio < 0.95
            else "Adaptive sampling takes no fewer samples than equal ones; its gain is a smaller "
            "error at the noisiest pixels"
        )
        text = (
            f"Samples per pixel for σ / mean = {self.target:.3g}: {self.spp.min()} to "
            f"{self.spp.max()}, mean {self.mean:.1f}. Equal samples reach the target at half of "
            f"the pixels with {half}, and at 95 % with {most}. {told}."
        )
        if self.missing > 0.0:
            text += (
                f" {self.missing:.1%} of the pixels need more than {self.most} samples, and miss "
                "the target."
            )
        if self.filtered:
            text += (
                " These numbers are for a box filter. The scene's filter averages neighboring "
                "pixels and needs fewer samples; mcspectra profile counts the filter."
            )
        return text

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and texts, without the images."""
        half, most = self.uniform
        return {
            "target": self.target,
            "least": int(self.spp.min()),
            "most": int(self.spp.max()),
            "mean": self.mean,
            "uniform_half": half,
            "uniform_95": most,
            "missing": self.missing,
        }

    def write(self, path: str | PathLike[str]) -> None:
        """Write an EXR file: samples per pixel as channel Y, their interval as layers low and high.

        Raises
        ------
        FileFormatError
            If the file cannot be written.
        """
        layers = {"": self.spp, "low": self.low, "high": self.high}
        told = {"scene": self.scene, "sampler": self.sampler, **self.to_dict()}
        write_exr(path, layers, comment=json.dumps(told))


def samples_per_pixel(
    result: xr.Dataset,
    target: float,
    *,
    least: int = _LEAST,
    most: int = _MOST,
    smoothing: int = 3,
) -> SamplesPerPixel:
    """Compute samples per pixel with which each pixel reaches a relative error.

    Parameters
    ----------
    result
        A map of whole paths, by `variance_map` with an integrator.
        If the map compares samplers, its first sampler is used.
    target
        Relative error σ / mean that each pixel should reach.
    least, most
        Limits of the samples per pixel.
    smoothing
        Width in pixels of the windows over which samples are averaged, an odd number.

    Returns
    -------
    SamplesPerPixel
        Whole numbers of samples, never below `least`.
        Pixels without a variance, and black ones, have `least` samples.

    Raises
    ------
    ParameterError
        If a parameter is out of range, or the map is not of whole paths.

    Notes
    -----
    Intervals include the errors of the variances, of interpolated pixels and of the rates.
    Smoothing does not narrow the intervals, because pixels of a map may share their points.
    """
    goal = as_real("target", target, **TARGET_LIMITS)
    least = as_integer("least", least, least=1, most=MOST_SAMPLES)
    most = as_integer("most", most, least=least, most=MOST_SAMPLES)
    width = as_integer("smoothing", smoothing, least=1, most=31)
    if width % 2 == 0:
        raise ParameterError(Parameter("smoothing"), f" is {width}; give an odd number of pixels.")
    if "path" not in result.coords.get("strategy", ()):
        raise ParameterError(
            "Samples per pixel are for maps of whole paths; make the map with ",
            Parameter("integrator"),
            ".",
        )
    data = result.isel(sampler=0) if "sampler" in result.dims else result
    name = str(data["sampler"].values) if "sampler" in data.coords else str(data.attrs["sampler"])
    data = data.sel(strategy="path")
    last, n = data.isel(n=-1), float(data["n"].values[-1])
    variance, error, mean = (
        last[key].transpose("y", "x").values for key in ("variance", "variance_relative_se", "mean")
    )

    # Extrapolate with the median rate; rates of single pixels scatter about it
    rates, rate_se = data["rate"].values, data["rate_se"].values
    known = np.isfinite(rates) & np.isfinite(rate_se)
    slope, slope_error = -1.0, 0.25
    if known.any():
        slope = float(np.clip(np.median(rates[known]), _STEEPEST, _SLOWEST))
        spread = 1.4826 * float(np.median(np.abs(rates[known] - slope)))
        noise = float(np.median(rate_se[known]))
        slope_error = math.sqrt(max(spread**2 - noise**2, _LEAST_SLOPE_ERROR**2))
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = (variance > 0.0) & (mean != 0.0)
        away = np.where(seen, (2.0 * np.log(goal * np.abs(mean)) - np.log(variance)) / slope, 0.0)
        wanted = np.where(seen, n * np.exp(np.minimum(away, 60.0)), 0.0)
        error = np.where(np.isfinite(error), error, 1.0)
        half = CONFIDENCE_Z * np.hypot(error, slope_error * away) / abs(slope)

    # Average the numbers of samples; the result is never far below the largest number of its window
    smooth, half = (_averaged(each, width) for each in (np.minimum(wanted, 4.0 * most), half))
    factor = np.exp(np.minimum(half, 60.0))

    def limited(values: Array) -> Array:
        # A number that exceeds a whole number only by rounding errors is not raised to the next one
        return np.clip(np.ceil(values * (1.0 - 1e-9)), least, most).astype(np.int64)

    if not seen.any():
        raise ParameterError("All pixels of the map are black; choose another view or channel.")
    quantiles = np.quantile(wanted[seen], _QUANTILES)
    return SamplesPerPixel(
        spp=limited(smooth),
        low=limited(smooth / factor),
        high=limited(smooth * factor),
        target=goal,
        least=least,
        most=most,
        uniform=(float(max(quantiles[0], 1.0)), float(max(quantiles[1], 1.0))),
        missing=float((wanted > most).mean()),
        scene=str(data.attrs.get("scene", "")),
        sampler=name,
        # A map of whole paths has such a note if the film's filter is not a box filter
        filtered=bool(data.attrs.get("scene_note")),
    )


def _averaged(values: Array, width: int) -> Array:
    """Mean of values (y, x) over windows; borders are extended by their own values."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(values, width, mode="nearest"))


def render_adaptive(
    scene: Scene,
    spp: Any,
    *,
    integrator: str | None = None,
    sampler: str | None = None,
    joint_dims: int | None = None,
    seed: int = 0,
) -> Array:
    """Render a scene with a number of samples for each pixel, by one of Mitsuba's integrators.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `load_scene`.
    spp
        Samples per pixel (height, width) of the film, whole numbers from 1 to 65,536.
        The samples per pixel are rounded up to powers of two.
    integrator
        Mitsuba plugin, such as ``"path(max_depth=5)"``; by default the scene's own.
    sampler, joint_dims
        One of our samplers and its joint dims, as in `render_file`.
        The default is that of `mcspectra.rendering.plugin.default_spec`, with 4 joint dims.
    seed
        Seed of the image, an integer of at least 0.

    Returns
    -------
    ndarray
        float64 (height, width, 3), radiance, filtered by the film's reconstruction filter.

    Raises
    ------
    ParameterError
        If `spp` does not fit the film, or Mitsuba cannot trace the paths.
    """
    request, spec = as_scene(scene), SCENE_INTEGRATOR if integrator is None else integrator
    stream = Stream.from_rng(as_integer("seed", seed, least=0, most=2**32 - 1))
    points = default_spec(joint_dims=joint_dims) if sampler is None else sampler
    register_samplers()
    with LOCK:
        load_scene(request)
        find_integrator(request, spec)
        film = sensor_of(request).film()
        width, height = (int(k) for k in film.crop_size())
    levels = _levels(spp, width, height)
    plugin: dict[str, Any] = {"type": PLUGIN, "spec": points}
    if joint_dims is not None:
        plugin["joint_dims"] = as_joint_dims("joint_dims", joint_dims)
    for count in np.unique(levels):
        # Check the sampler before Mitsuba does, so that the error has a message of this package
        padded_sets(points, int(count), joint_dims)
    tracer = Tracer(request, spec, "rgb", (width, height))
    with LOCK:
        try:
            return _rendered(tracer, levels, plugin, stream)
        except (RuntimeError, TypeError) as error:
            raise ParameterError(
                f"Mitsuba cannot render {scene_name(request)} with {points}: "
                f"{mitsuba_reason(error)}."
            ) from None


def _levels(spp: Any, width: int, height: int) -> Array:
    """Return checked samples per pixel, rounded up to powers of two."""
    given = as_real_array("spp", spp)
    given = given[..., 0] if given.ndim == 3 and given.shape[2] == 1 else given
    if given.shape != (height, width):
        raise ParameterError(
            Parameter("spp"),
            f" has the shape {given.shape}; give one number for each pixel of the film, "
            f"{(height, width)}.",
        )
    bad = ~((given >= 1) & (given <= MOST_SAMPLES) & (given == np.rint(given)))
    if bad.any():
        y, x = np.argwhere(bad)[0]
        raise ParameterError(
            Parameter("spp"),
            f" is {given[y, x]:.6g} at the pixel ({x}, {y}); give whole numbers from 1 to "
            f"{MOST_SAMPLES}.",
        )
    levels: Array = 2 ** np.ceil(np.log2(given)).astype(np.int64)
    return levels


def _wavefronts(levels: Array) -> Iterator[tuple[int, Array, float]]:
    """Yield the samples per pixel, pixels (P, 2) as x and y, and the finished part of the work."""
    done, total = 0, int(levels.sum())
    for count in np.unique(levels).tolist():
        pixels = np.argwhere(levels == count)[:, ::-1]
        step = max(1, _LANES // count)
        for first in range(0, len(pixels), step):
            part = pixels[first : first + step]
            yield count, part, done / total
            done += count * len(part)


def _rendered(tracer: Tracer, levels: Array, plugin: dict[str, Any], stream: Stream) -> Array:
    import drjit

    mitsuba = load_mitsuba()
    film = sensor_of(tracer.scene).film()
    height, width = levels.shape
    block = mitsuba.ImageBlock(
        mitsuba.ScalarVector2u(width, height), mitsuba.ScalarPoint2i(0, 0), 4,
        rfilter=film.rfilter(), border=not film.rfilter().is_box_filter(),
    )  # fmt: skip
    made: dict[int, Any] = {}
    for number, (count, pixels, done) in enumerate(_wavefronts(levels)):
        report("render", done)
        if count not in made:
            made[count] = mitsuba.load_dict({**plugin, "sample_count": count})
        source, lanes = made[count].fork(), len(pixels) * count
        source.set_samples_per_wavefront(count)
        key = int(stream.keys(number, 1)[0, 0] >> np.uint64(32))
        source.seed(mitsuba.UInt32(key), lanes)
        pixel = drjit.arange(mitsuba.UInt32, lanes) // drjit.opaque(mitsuba.UInt32, count)
        x, y = (
            drjit.gather(mitsuba.Float, mitsuba.Float(np.ascontiguousarray(c, np.float32)), pixel)
            for c in pixels.T
        )
        position = source.next_2d()
        color = tracer.trace(source, x, y, position)
        weight = drjit.opaque(mitsuba.Float, 1.0 / count)
        place = mitsuba.Point2f(x + position.x, y + position.y)
        block.put(place, [*(weight * c for c in (color.x, color.y, color.z)), weight])
        drjit.eval(block.tensor())
    values = np.array(block.tensor(), np.float64)
    border = block.border_size()
    values = values[border : border + height, border : border + width]
    image = values[..., :3] / values[..., 3:]
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    check_finite(image.reshape(-1, 3), tracer.scene, places.reshape(-1, 2))
    report("render", 1.0)
    return np.asarray(image)
