"""Statistics of frames of any renderer: pixel variance, its rate, and error correlations.

Frames are independent renders of one view, as files.
Each file is read twice, one file at a time.
The first pass computes the moments of every pixel.
The second pass computes correlations of the errors, the deviations from the mean.
Errors are divided by the standard deviation of their pixel.
Bright corners then do not dominate, and white noise has power 1 at all frequencies.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np
import xarray as xr
from scipy.ndimage import uniform_filter

from mcspectra.core.checks import Array, as_integer, as_real, is_path
from mcspectra.core.confidence import CONFIDENCE_Z, deviations_t
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.fits import is_resolved, line_fit
from mcspectra.core.images import (
    Rings,
    exr_layer,
)
from mcspectra.core.progress import report
from mcspectra.core.results import dataset
from mcspectra.estimators.moments import Moments
from mcspectra.rendering.frame_commands import command_words, denoised
from mcspectra.rendering.frame_files import (
    MOST_SPP,
    FrameFiles,
    FrameReader,
    Frames,
    described_paths,
    frame_files,
)
from mcspectra.rendering.frame_filters import (
    Chain,
    Filtered,
    SpatialPower,
    chains_of,
    curve_filters,
    filtered_of,
)
from mcspectra.rendering.frame_references import (
    References,
    reference_errors,
    references_of,
    tile_centers,
    tile_means,
)
from mcspectra.rendering.frame_sequences import (
    Temporal,
    TimeStatistics,
    sequence_files,
    stored_array,
    temporal_of,
)
from mcspectra.rendering.map_statistics import fit_lines, interval, ratio, smooth

__all__ = ["frames"]

_REACH = 8  # largest lag in pixels, to either side, for which correlations are listed
_FILTER = 2  # pixels at this distance may have correlated errors because of a reconstruction filter
_SAMPLE = 2**14  # number of pixels at which two frames are compared
_TAIL = 64  # number of extreme deviations kept per frame; `Moments` uses the same number
_TABLE = 4001  # size of the table that maps a true correlation to the mean of its estimates
_SIGNIFICANCE = 0.05  # significance level of a test of all pixels, frames or lags together
_OUTLIER = 1e-3  # significance level of Grubbs' test at each pixel
_RELATED = 0.1  # smallest correlation of two frames to report, whatever its significance
_REPEATED = 0.05  # smallest correlation of distant pixels to report
_LEAST_PAIRED = 16  # smallest number of common pixels at which two sets are compared frame by frame
_LEAST_GRUBBS = 5  # minimum number of frames for Grubbs' test
# If a single squared error exceeds this share of the sum of squares, the interval has no upper end
_ONE_SQUARE = 0.05
# Rates are averaged over windows of at most 15 pixels until their standard error is below 0.1
_WIDEST, _KNOWN_RATE = 15, 0.1
# If the values miss a tail, their variance and its error are too small.
# The upper end of the interval is therefore moved away from the variance.
# The distance from the variance to the upper end, on a log scale, is multiplied by 1 + c e.
# Here e is the relative standard error of the variance, and c is the constant `_MISSED`.
# For six frames of normal to lognormal noise and c = 2,
# 92 to 97 % of the intervals contain the true variance
_MISSED = 2.0
_NEAR = 15  # width in pixels of the squares whose pixels share a variance, for two or three frames
_SLOWEST = -0.5  # least steep rate that is used to extrapolate to a target


def frames(
    paths: Frames,
    *,
    spp: int | None = None,
    against: Frames | None = None,
    target: float | None = None,
    seconds: float | None = None,
    seconds_against: float | None = None,
    layer: str | None = None,
    tone_mapped: bool = False,
    flip: bool = True,
    sequence: str | None = None,
    filters: str | Sequence[str] = (),
    filter_command: str | None = None,
    filter_timeout: float = 300.0,
    reference: str | PathLike[str] | None = None,
) -> xr.Dataset:
    """Measure the noise of independent renders of one view, by any renderer.

    Parameters
    ----------
    paths
        A folder with its subfolders, a pattern such as ``out/*_64spp.exr``, or a list of files.
        The files are EXR, PFM or .npy of one size with linear values.
        Every number of samples needs at least two files.
    spp
        Samples per pixel of all frames.
        The default is read from the name of the file or folder (``spp64`` or ``64spp``),
        or from the EXR header: ``samplesPerPixel`` (pbrt) or ``cycles.*.samples`` (Blender).
    against
        Frames of the same view by another renderer, integrator or setting.
    target
        Relative root mean square error (σ / mean) that pixels should reach.
    seconds, seconds_against
        Render time of a frame in seconds. By default the time is read from EXR headers.
        The header is ``renderTimeSeconds`` in files of pbrt, and ``RenderTime`` for Blender.
    layer
        Layer or channel of EXR files to measure; by default the first picture.
    tone_mapped
        Whether to accept PNG and JPEG, and undo the sRGB transfer function.
        Clipped values have lost their noise.
    sequence
        Names of the frames of several sequences, such as ``"shot_s{seed}_t{frame}.exr"``.
        The pattern matches the end of each path.
        Names like ``shot_s3_t012.exr`` are recognized without a pattern.
        Errors are then deviations from the mean over the seeds at the same frame.
    filters
        Linear filters whose remaining error is reported, as spec strings:
        ``gaussian(sigma=1.5)``, ``box(width=5)``, ``a-trous(levels=3)``, and for sequences
        ``ema(alpha=0.1)``, or a product such as ``"gaussian(sigma=1.5) | ema(alpha=0.1)"``.
    filter_command
        Program that filters one frame, such as ``"denoise {input} -o {output}"``.
        The program runs on every frame that has the most samples, without a shell.
        A program with ``{inputs}`` and ``{outputs}`` gets the folder of one sequence.
        The frames in this folder are called ``0000.exr``, ``0001.exr`` and so on.
        The program must give the same names to its output files.
    filter_timeout
        Longest time of one run of the program, in seconds.
    reference
        File with the true image, which counts as exact.
        Sequences may have one such file per frame, such as ``"truth/t{frame}.exr"``.
    flip
        Whether to compute FLIP if its package is installed. It takes longer than all other steps.

    Returns
    -------
    xarray.Dataset
        The following variables have the dims n (samples per pixel; 1 if unknown), y and x:
        ``mean`` and ``variance`` of the luminance of one frame, ``variance_ci`` (bound),
        ``relative_rmse``, and ``largest_share``, one frame's share in the sum of squares.
        With several n: ``rate`` and ``rate_ci`` of the variance, averaged over a square of pixels.
        The attribute ``smoothing`` is the width in pixels over which rates are averaged.
        By n: ``picture_variance``, the mean over the pixels, with ``picture_variance_ci``;
        ``picture_rate`` with its interval. With a target: ``needed_spp``.
        ``error_spectrum(n, radius)`` with ``error_spectrum_ci``: power of the standardized errors.
        The power is 1 for white noise. The radius is a frequency in cycles per pixel.
        ``error_correlation(n, lag_y, lag_x)``: correlation of errors at a lag in pixels.
        ``image(y, x, band)``: mean of the frames with most samples; of sequences, the first frames.
        ``flip(n, y, x)``: the FLIP error [Andersson2021]_ of the first frame against ``image``.
        FLIP needs the package flip-evaluator. If a reference is given, FLIP compares with it.
        ``gaussian_variance(n, sigma)``: variance after a Gaussian filter.
        ``gaussian_ratio``: ``gaussian_variance`` over its value for equally strong white noise.
        ``filtered_variance(n, filter)``, ``filtered_ratio``: variance and ratio after `filters`.
        Sequences also have ``joint_spectrum(n, radius, frame_frequency)``, 1 for white noise,
        ``frame_correlation(n, lag_t)``, ``boiling(n)`` (power below 1/8 cycle per frame),
        ``effective_frames(n)`` and ``pixel_effective_frames(n, y, x)``.
        After a moving average: ``average_variance(n, alpha)`` and ``average_ratio(n, alpha)``.
        A command gives ``denoised_variance`` and ``denoised_square``, the mean squared bias.
        For sequences, it also gives ``denoised_boiling`` and ``denoised_correlation(lag_t)``.
        A reference gives ``bias_z(y, x)`` and ``squared_bias(n)``.
        The relative bias, relMSE and SMAPE are given by tile: ``tile_bias(n, tile_y, tile_x)``.
        For the whole image, the relative bias, relMSE and SMAPE are named like ``image_bias(n)``.
        For sequences, errors of the image are means over frames.
        The bias of each frame is ``frame_bias(n, frame)``.
        Two sets of frames are compared at the largest n that both have:
        ``difference`` of the means, ``difference_z`` by Welch's test,
        ``variance_ratio``, the variance of the first set of frames over that of the second set,
        ``picture_ratio``, the ratio of mean variances, and ``equal_time_ratio`` of variance × time.
        Ratios below 1 favor the first set of frames, `paths`.
        See `mcspectra.report.frames_page.frame_findings` for a description of attributes in words.

    Raises
    ------
    FileFormatError
        If a file is missing, broken, of another type, or tone-mapped.
    ParameterError
        If a number of samples has fewer than two frames, sizes differ, or all frames are equal.
        If an option is out of range.

    Notes
    -----
    Memory is about 45 planes of float64 (3 GB at 3840 × 2160), including the result.
    The memory does not depend on the number of frames.
    Transforms of one sequence are kept in a temporary file if they exceed 0.5 GB.
    A temporary file has about 12 bytes for each pixel of each frame of a sequence.

    The error after a linear filter K is ∫ |K(ν)|² P_err(ν) dν, from the measured spectrum.
    See `mcspectra.rendering.frame_filters` for the treatment of borders.
    """
    spp = None if spp is None else as_integer("spp", spp, least=1, most=MOST_SPP)
    given = {"target": target, "seconds": seconds, "seconds_against": seconds_against}
    for name, value in given.items():
        given[name] = None if value is None else as_real(name, value, above=0.0)
    read = FrameReader(layer=layer, tone_mapped=tone_mapped, spp=spp)
    chains = chains_of(filters)
    words = None if filter_command is None else command_words(filter_command)
    wait = as_real("filter_timeout", filter_timeout, above=0.0)
    if reference is not None and not is_path(reference):
        raise ParameterError(Parameter("reference"), f" is {reference!r:.80}; give a file.")
    found = _measured(paths, read, chains, sequence)
    best, ns = found[-1], np.array([each.spp for each in found])
    if layer is None and best.files[0].suffix.lower() == ".exr":
        layer = exr_layer(best.files[0]) or None

    # Compute pixel variances and the variance of the whole picture for every number of samples
    stacked: dict[str, tuple[tuple[str, ...], list[Any]]] = {
        "mean": (("y", "x"), [each.moments.mean for each in found]),
        "variance": (("y", "x"), [each.moments.variance for each in found]),
        "variance_ci": (("y", "x", "bound"), [each.moments.variance_ci for each in found]),
        "relative_rmse": (("y", "x"), [each.relative_rmse for each in found]),
        "largest_share": (("y", "x"), [each.largest_share for each in found]),
        "picture_variance": ((), [each.picture_variance for each in found]),
        "picture_variance_ci": (("bound",), [each.picture_variance_ci for each in found]),
        "error_spectrum": (("radius",), [each.spectrum for each in found]),
        "error_spectrum_ci": (("radius", "bound"), [each.spectrum_ci for each in found]),
        "error_correlation": (("lag_y", "lag_x"), [each.correlation for each in found]),
    }
    temporal = [each.temporal for each in found if each.temporal is not None]
    if temporal:
        stacked |= {
            "joint_spectrum": (("radius", "frame_frequency"), [t.joint for t in temporal]),
            "frame_correlation": (("lag_t",), [t.correlation for t in temporal]),
            "frame_correlation_ci": (("lag_t", "bound"), [t.correlation_ci for t in temporal]),
            "boiling": ((), [t.boiling for t in temporal]),
            "boiling_ci": (("bound",), [t.boiling_ci for t in temporal]),
            "effective_frames": ((), [t.effective for t in temporal]),
            "effective_frames_ci": (("bound",), [t.effective_ci for t in temporal]),
            "pixel_effective_frames": (("y", "x"), [t.pixels for t in temporal]),
        }
    parts = _filter_parts(best, len(chains))
    for dim, (name, _, part) in parts.items():
        left = [each.filtered for each in found]
        stacked |= {
            f"{name}_variance": ((dim,), [each.variance[part] for each in left]),
            f"{name}_variance_ci": ((dim, "bound"), [each.variance_ci[part] for each in left]),
            f"{name}_ratio": ((dim,), [each.ratio[part] for each in left]),
            f"{name}_ratio_ci": ((dim, "bound"), [each.ratio_ci[part] for each in left]),
        }
    variables: dict[str, tuple[tuple[str, ...], Any]] = {
        name: (("n", *dims), np.stack(of)) for name, (dims, of) in stacked.items()
    }
    variables["image"] = (("y", "x", "band"), best.image)
    truth = None
    if reference is not None:
        truth = references_of(reference, read, best.moments.mean.shape, best.numbers)
    if words is not None and truth is not None:
        truth.color(0)  # report a broken reference before the program runs
    image = best.image if truth is None else truth.color(0)
    shown = [_flip(image, read.color(each.files[0])) for each in found if flip]
    flips = [each for each in shown if each is not None]
    if flips:
        variables["flip"] = (("n", "y", "x"), np.stack(flips))

    told: dict[str, Any] = {name: [each.told[name] for each in found] for name in best.told}
    if truth is not None:
        compared, said = _referred(found, truth, read, variables.get("flip"))
        variables |= compared
        told |= {**said, "reference": str(reference)}
    if words is not None:
        after = denoised(words, best.frames, read, truth, wait)
        variables |= {
            "denoised_variance": ((), after.variance),
            "denoised_variance_ci": (("bound",), after.variance_ci),
            "denoised_square": ((), after.bias),
            "denoised_square_ci": (("bound",), after.bias_ci),
        }
        if after.temporal is not None:
            variables |= {
                "denoised_boiling": ((), after.temporal.boiling),
                "denoised_boiling_ci": (("bound",), after.temporal.boiling_ci),
                "denoised_correlation": (("lag_t",), after.temporal.correlation),
                "denoised_correlation_ci": (("lag_t", "bound"), after.temporal.correlation_ci),
            }
        told["filter_command"] = filter_command

    # Compute rates over windows that are wide enough, and the samples needed for the target
    rate, window = np.full(best.moments.mean.shape, np.nan), None
    errors = rate[None]
    if len(found) > 1:
        relative, level = np.stack([_log_variance(each.moments) for each in found], axis=1)
        line = fit_lines(
            ns, np.exp(level)[None], relative[None], variables["mean"][1][None], np.inf
        )
        for window in range(1, _WIDEST + 1, 2):
            rates, errors = smooth(line.rate, line.rate_se, window, independent=True)
            errors *= 1.0 if window == 1 else math.sqrt(best.alike)
            if np.nanmedian(errors) <= _KNOWN_RATE:
                break
        rate = rates[0]
        variables["rate"] = (("y", "x"), rate)
        variables["rate_ci"] = (("y", "x", "bound"), interval(rate, errors[0]))
        slope, slope_se = _picture_rate(found)
        variables["picture_rate"] = ((), slope)
        variables["picture_rate_ci"] = (("bound",), interval(slope, slope_se))
    if given["target"] is not None and not _grows(variables):
        need, spread = _needed(best, given["target"], rate, errors[0], variables)
        variables["needed_spp"] = (("y", "x"), need)
        told |= _percentiles(need, spread)
    told["seconds"] = [given["seconds"] or each.seconds for each in found]
    if against is not None:
        other = _measured(against, read, chains, sequence)
        times = given["seconds"], given["seconds_against"]
        compared, said = _compared(found, other, times, read, parts)
        variables |= compared
        told |= {**said, "against": described_paths(against)}
    lags = {
        f"lag_{a}": np.arange(k) - k // 2 for a, k in zip("yx", best.correlation.shape, strict=True)
    }
    return dataset(
        variables,
        {
            "n": ns,
            **{
                dim: np.arange(size)
                for dim, size in zip("yx", best.moments.mean.shape, strict=True)
            },
            "bound": ["low", "high"],
            "radius": best.radius,
            **lags,
            **(
                {
                    f"tile_{dim}": tile_centers(size)
                    for dim, size in zip("yx", best.moments.mean.shape, strict=True)
                }
                if truth is not None
                else {}
            ),
            **{dim: list(labels) for dim, (_, labels, _) in parts.items()},
            **(
                {"lag_t": np.arange(best.times), "frame_frequency": temporal[-1].frequency}
                if temporal
                else {}
            ),
            **({"frame": np.array(best.numbers)} if temporal and truth is not None else {}),
        },
        frames=described_paths(paths),
        target=given["target"],
        layer=layer,
        smoothing=window,
        times=best.times if temporal else None,
        frames_smoothing=temporal[-1].window if temporal else None,
        **told,
    )


def _referred(
    groups: list[_Group],
    truth: References,
    read: FrameReader,
    flip: tuple[tuple[str, ...], Any] | None,
) -> tuple[dict[str, tuple[tuple[str, ...], Any]], dict[str, Any]]:
    """Compare the frames of each number of samples with references."""
    every = [reference_errors(each.files, each.times, read, truth) for each in groups]
    variables: dict[str, tuple[tuple[str, ...], Any]] = {}
    for own, name in (("bias", "bias"), ("relative", "relmse"), ("symmetric", "smape")):
        variables |= {
            f"tile_{name}": (
                ("n", "tile_y", "tile_x"),
                np.stack([getattr(each, own) for each in every]),
            ),
            f"tile_{name}_ci": (
                ("n", "tile_y", "tile_x", "bound"),
                np.stack([getattr(each, f"{own}_ci") for each in every]),
            ),
            f"image_{name}": (("n",), np.array([each.whole[own][0] for each in every])),
            f"image_{name}_ci": (
                ("n", "bound"),
                np.stack([each.whole[own][1] for each in every]),
            ),
        }
        if groups[-1].times > 1:
            frames = [each.frames[own] for each in every]
            variables |= {
                f"frame_{name}": (("n", "frame"), np.stack([value for value, _ in frames])),
                f"frame_{name}_ci": (("n", "frame", "bound"), np.stack([e for _, e in frames])),
            }
    if flip is not None:
        tiles = np.stack([tile_means(each) for each in flip[1]])
        variables["tile_flip"] = (("n", "tile_y", "tile_x"), tiles)
    best = groups[-1]
    z = _student(every[-1].apart, best.averages, best.count)
    variables["bias_z"] = (("y", "x"), z)
    variables["squared_bias"] = (("n",), np.array([each.square for each in every]))
    limit = _sidak(int((~np.isnan(z)).sum()))
    return variables, {
        "reference_biased_pixels": int((np.abs(z) > limit).sum()),
        "reference_pixels": int((~np.isnan(z)).sum()),
        "reference_z_limit": limit,
    }


_PICTURE = ("picture_variance", "picture_relative_se")


def _resolved_rate(variables: dict[str, tuple[tuple[str, ...], Any]]) -> bool:
    """Whether the interval of the image's rate is at most ± 0.5."""
    return "picture_rate" in variables and is_resolved(*variables["picture_rate_ci"][1])


def _grows(variables: dict[str, tuple[tuple[str, ...], Any]]) -> bool:
    """Whether the image's variance grows significantly with the number of samples."""
    return _resolved_rate(variables) and bool(variables["picture_rate_ci"][1][0] > 0.0)


def _needed(
    best: _Group,
    target: float,
    rate: Array,
    rate_se: Array,
    variables: dict[str, tuple[tuple[str, ...], Any]],
) -> tuple[Array, Array]:
    """Return the samples that each pixel needs, and the error variance of their logarithm.

    Rates of pixels are shrunk towards their mean.
    Otherwise noisy rates near 0 would extrapolate to huge numbers of samples.
    If the rate of the image is not resolved, the variance is assumed to fall as 1/n.
    """
    slope, slope_se = np.full_like(rate, -1.0), np.zeros_like(rate)
    if _resolved_rate(variables):
        shrunk, shrunk_se = _shrunk(rate, rate_se)
        slope = np.where(np.isfinite(shrunk), np.minimum(shrunk, _SLOWEST), -1.0)
        slope_se = np.where(np.isfinite(shrunk), shrunk_se, 0.0)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        distance = 2.0 * np.log(best.relative_rmse / target)
        need = best.spp * np.exp(-distance / slope)
        error = _log_variance(best.moments)[0]
        spread = (error / slope) ** 2 + (slope_se * distance / slope**2) ** 2
    return np.maximum(need, 1.0) if best.told["spp_known"] else need, spread


def _shrunk(rate: Array, se: Array) -> tuple[Array, Array]:
    """Shrink the rates of pixels to their mean; return the rates and their standard errors.

    Empirical Bayes: a rate keeps the share τ²/(τ² + se²) of its distance from the mean.
    The variance τ² of the true rates is estimated as in [DerSimonianLaird1986]_.
    """
    known = np.isfinite(rate) & (se > 0)
    weight, value = se[known] ** -2.0, rate[known]
    if value.size < 2:
        return rate, se
    mean = float(np.average(value, weights=weight))
    excess = float((weight * (value - mean) ** 2).sum()) - (value.size - 1)
    tau2 = max(excess / float(weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    kept = np.divide(tau2, tau2 + se**2, out=np.full_like(rate, np.nan), where=known)
    return mean + kept * (rate - mean), np.sqrt(kept) * se


def _percentiles(need: Array, spread: Array) -> dict[str, float]:
    """Return median and 95th percentile of the samples needed, taken over the pixels.

    Errors of the estimates widen the distribution over the pixels.
    The logarithms of the samples needed are therefore moved towards their median.
    The variance of the logarithms falls by the mean variance of their errors [Louis1984]_.
    """
    known = np.isfinite(need) & np.isfinite(spread) & (need > 0)
    if not known.any():
        return {}
    logs = np.log(need[known])
    middle, far = np.percentile(logs, [50, 95])
    total = float(logs.var())
    factor = math.sqrt(max(1.0 - float(spread[known].mean()) / total, 0.0)) if total > 0 else 0.0
    return {
        "needed_median": math.exp(middle),
        "needed_95": math.exp(middle + factor * (far - middle)),
    }


@final
@dataclass(frozen=True, kw_only=True)
class _Group:
    """Statistics of all frames with one number of samples; `told` holds attributes of the result.

    A group has `count` sequences. Independent frames are sequences of length 1.
    The array `means` has one value per sequence.
    The array `averages` is the variance of the mean over a sequence, for each pixel.
    The array `spread` is the squared standard error of the variance of each pixel.
    For mean squared errors, a sequence is worth `frames_per` independent frames.
    The array `image` is the mean over the sequences of their first frames.
    The number `alike` is the sum of squared correlations of pixels over all lags.
    """

    spp: int
    seconds: float | None
    frames: FrameFiles
    count: int
    moments: Moments
    averages: Array
    spread: Array
    frames_per: float
    largest_share: Array
    image: Array
    means: Array
    radius: Array
    spectrum: Array
    spectrum_ci: Array
    correlation: Array
    alike: float
    resolved: bool
    chosen: Array
    sample: Array
    filtered: Filtered
    curves: dict[str, tuple[float, ...]]
    temporal: Temporal | None
    told: dict[str, Any]

    @property
    def files(self) -> list[Path]:
        """Files of all frames; the files of one sequence are adjacent."""
        return self.frames.files

    @property
    def times(self) -> int:
        """Number of frames of a sequence."""
        return self.frames.times

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the frames of a sequence; empty without a sequence."""
        return self.frames.numbers

    @property
    def relative_rmse(self) -> Array:
        """Median-unbiased estimate of σ / mean of one frame; NaN unless the mean is positive."""
        from scipy.special import chdtri

        # For normal noise, the sample variance s² is below the true σ² in over half of the cases
        degrees = self.moments.count - 1
        positive = np.where(self.moments.mean > 0, self.moments.mean, np.nan)
        s = np.sqrt(degrees / chdtri(degrees, 0.5) * self.moments.variance)
        return np.asarray(s / positive)

    @property
    def related(self) -> float:
        """Number of correlated pixels that give as much information as one independent pixel."""
        frames = 1.0 if self.temporal is None else self.temporal.frames_for_squares
        return self.alike / frames

    def within(self, pixels: Array, read: FrameReader) -> _Group:
        """Return the statistics of the given pixels, which are finite in both sets of frames."""
        mean, m2 = (np.where(pixels, v, np.nan) for v in (self.moments.mean, self.moments.m2))
        means = [float(read.plane(file, None)[0][pixels].mean()) for file in self.files]
        return replace(
            self,
            moments=replace(self.moments, mean=mean, m2=m2),
            averages=np.where(pixels, self.averages, np.nan),
            spread=np.where(pixels, self.spread, np.nan),
            means=np.reshape(means, (self.count, self.times)).mean(axis=1),
        )

    @property
    def picture_variance(self) -> float:
        """Return the mean variance over the pixels."""
        return float(np.nanmean(self.moments.variance))

    @property
    def picture_relative_se(self) -> float:
        """Relative standard error: the value for independent pixels times √Σρ² over all lags.

        Here ρ is the correlation of the errors of two pixels at a lag.
        """
        normal = 2.0 / (self.count + 1) * np.nansum(self.moments.variance**2)
        squares = max(float(np.nansum(self.spread)), float(normal) / self.frames_per)
        return float(np.sqrt(self.alike * squares) / np.nansum(self.moments.variance))

    @property
    def picture_variance_ci(self) -> Array:
        """Interval of the mean variance; the upper end is infinite if a few pixels dominate."""
        error = self.picture_relative_se
        ends = CONFIDENCE_Z * error * np.array([-1.0, 1.0 + _MISSED * error])
        low, high = self.picture_variance * np.exp(ends)
        return np.array([low, high if self.resolved else np.inf])


_Parts = dict[str, tuple[str, tuple[Any, ...], slice]]


def _filter_parts(group: _Group, asked: int) -> _Parts:
    """For each dim of the result that lists filters, return name, labels and positions of filters.

    The positions are indices into the list of all filters.
    """
    specs = group.filtered.specs
    parts: _Parts = {"filter": ("filtered", specs[1 : 1 + asked], slice(1, 1 + asked))}
    first = 1 + asked
    for dim, labels in group.curves.items():
        name = {"sigma": "gaussian", "alpha": "average"}[dim]
        parts[dim] = (name, labels, slice(first, first + len(labels)))
        first += len(labels)
    return {dim: part for dim, part in parts.items() if part[1]}


def _measured(
    paths: Frames, read: FrameReader, asked: list[Chain], sequence: str | None
) -> list[_Group]:
    """Measure each group of frames with one number of samples, in ascending order."""
    groups = sequence_files(frame_files(paths, read), sequence)
    _check_times(groups, asked)
    total, done = 2 * sum(len(each.files) for each in groups), 0
    found: list[_Group] = []
    for each in groups:
        found.append(_group(each, read, asked, done, total))
        done += 2 * len(each.files)
        if found[-1].moments.mean.shape != found[0].moments.mean.shape:
            raise ParameterError(
                f"{each.files[0]} has the size {found[-1].moments.mean.shape}, but "
                f"{found[0].files[0]} has {found[0].moments.mean.shape}; give frames of one view."
            )
    return found


def _check_times(groups: list[FrameFiles], asked: list[Chain]) -> None:
    """Check that all sequences have one length, and that filters in time have sequences."""
    times = sorted({each.times for each in groups})
    if len(times) > 1:
        raise ParameterError(
            f"The sequences have {' and '.join(map(str, times))} frames; give sequences of one "
            "length."
        )
    if times == [1]:
        for each in asked:
            if each.temporal:
                raise ParameterError(
                    f"The filter {each.spec} acts over frames, but {groups[0].files[0]} and the "
                    "others are not sequences; name them like shot_s1_t001.exr, or give ",
                    Parameter("sequence"),
                    ".",
                )


def _group(
    group: FrameFiles, read: FrameReader, asked: list[Chain], done: int, total: int
) -> _Group:
    """Measure the frames of one number of samples; each file is read twice.

    Errors are deviations from the mean over the sequences at the same time.
    """
    # Compute moments and ranges of the pixels, separately at each time
    files, times = group.files, group.times
    count, shape = len(files) // times, None
    pooled: Moments | None = None
    above: Any = 0.0
    below: Any = 0.0
    image_sum: Any = 0.0
    centers: Any = None
    spread: Any = 0.0
    means = np.empty((count, times))
    for t in range(times):
        moments: Moments | None = None
        low: Any = np.inf
        high: Any = -np.inf
        for k in range(count):
            file = files[k * times + t]
            plane, image = read.plane(file, shape)
            each, shape = Moments.of(plane[None]), image.shape
            moments = each if moments is None else moments.merge(each)
            low, high = np.fmin(low, plane), np.fmax(high, plane)
            if t == 0:
                image_sum = image_sum + image
            if not np.isfinite(plane).any():
                raise ParameterError(f"{file} has no finite pixel; leave it out.")
            means[k, t] = np.nanmean(plane)
            report("frames", (done + t * count + k) / total)
        assert moments is not None
        if centers is None:
            kind = np.float64 if times == 1 else np.float32
            centers = stored_array((times, *moments.mean.shape), kind)
        centers[t] = moments.mean
        spread = spread + _variance_of_variance(moments) / times
        above = np.fmax(above, high - moments.mean)
        below = np.fmax(below, moments.mean - low)
        pooled = moments if pooled is None else _pooled(pooled, moments)
    assert pooled is not None
    moments = replace(pooled, mean=pooled.mean / times)
    varied = moments.variance > 0
    if not varied.any():
        reason = (
            "are the same to the last bit" if np.isfinite(moments.mean).any() else "hold only NaN"
        )
        raise ParameterError(
            f"The {len(files)} frames like {files[0]} {reason}; give independent renders, each "
            "with a seed of its own."
        )
    farthest = np.maximum(above, below) ** 2
    share = np.divide(farthest, moments.m2, out=np.full_like(farthest, np.nan), where=varied)

    # Compute statistics of the deviations: power, tails, and correlations between frames
    height, width = moments.mean.shape
    unit = np.zeros((height, width))
    np.divide(math.sqrt(count / (count - 1)), np.sqrt(moments.variance), out=unit, where=varied)
    rings = Rings(height, width)
    curves_of = curve_filters(height, width, times)
    chains = [Chain(()), *asked, *(c for curve in curves_of.values() for c in curve.values())]
    space = SpatialPower(chains, height, width)
    over_time = None if times == 1 else TimeStatistics(times, space, rings, moments.variance)
    power: Any = 0.0
    tail: Moments | None = None
    curves = np.zeros((count, rings.radius.size))
    chosen = _scattered(varied, times)
    sample = np.empty((count, times, chosen.size))
    light, gains = np.where(varied, moments.mean, 0.0), np.empty((count, times))
    left, noise = np.empty((count, len(chains))), np.zeros(len(chains))
    for k, t in np.ndindex(count, times):
        file = files[k * times + t]
        error = np.where(varied, read.plane(file, shape)[0] - centers[t], 0.0)
        gains[k, t] = float((error * light).sum())
        # Find moments and extremes without sorting all values
        values = ends = error[varied]
        if values.size > 2 * _TAIL:
            parts = np.partition(values, (_TAIL - 1, values.size - _TAIL))
            ends = np.concatenate([parts[:_TAIL], parts[-_TAIL:]])
        each = replace(Moments.of(values), extremes=np.sort(ends))
        tail = each if tail is None else tail.merge(each)
        raw = space.transform(error)
        square = np.abs(raw) ** 2
        if over_time is None:
            left[k] = space.left(square)
        noise += space.noise(square) / len(files)
        ones = np.fft.rfft2(error * unit)
        if over_time is not None:
            over_time.add(t, raw, error)
            if t == times - 1:
                over_time.finish()
        sample[k, t] = (error * unit).flat[chosen]
        own = np.abs(ones) ** 2 / varied.sum()
        power = power + own / len(files)
        curves[k] += rings.mean(own) / times
        report("frames", (done + len(files) + k * times + t) / total)
    assert tail is not None
    half = deviations_t(count) * curves.std(axis=0, ddof=1) / math.sqrt(count)

    # Frames of a sequence are not independent: correct the number of independent values
    temporal, frames_per = None, 1.0
    if over_time is not None:
        temporal = temporal_of(over_time, moments.m2, count)
        frames_per = temporal.frames_for_squares
        moments = _recounted(moments, 1 + max(round((count - 1) * frames_per), 1))
    fields = (count - 1) * frames_per  # number of independent images of errors

    # Correct the bias of the correlations, and compute their spectrum
    every = np.fft.irfft2(power, s=(height, width))
    every, loss = _unbiased(every / every[0, 0], 1 + max(round(fields), 1))
    measured, curve = rings.mean(power), np.maximum(rings.mean(np.fft.rfft2(every).real), 0.0)
    half *= np.divide(curve, measured, out=np.ones_like(curve), where=measured > 0)
    # With two frames, the deviations differ only in sign, so their spectra are equal.
    # Equal spectra have a spread of 0, so use at least the errors of normal noise.
    # For R frames of normal noise, the power at the frequencies ±m is a mean of R − 1 values.
    # The R − 1 values are independent and have exponential distributions
    independent = fields * loss**2
    half = np.maximum(half, CONFIDENCE_Z * measured * np.sqrt(2.0 / (rings.sizes * independent)))
    # The sum of squared correlations also contains the squared errors of the correlations.
    # The mean squared error of a correlation is: true sum / (pixels · (R − 1) · loss²)
    alike = max(1.0, float((every**2).sum()) / (1.0 + 1.0 / independent))
    near, repeat, repeated = _lags(every, alike / (varied.sum() * independent))
    pair, relation = _related(sample.reshape(count, -1), alike * times / frames_per)
    # Count pixels with an outlier above twice the pixel's mean.
    # Also compute the number of pixels with outliers that is expected for normal noise
    limit = _grubbs(len(files))
    outliers = (share > limit) & (above > np.maximum(moments.mean, below))
    expected = _OUTLIER / 2 * int((limit * pooled.m2[varied] > moments.mean[varied] ** 2).sum())
    whole = float(np.nansum(moments.variance))
    energy = float((light**2).sum()) or 1.0
    drift, drift_share = (None, 0.0)
    if times == 1:
        drift, drift_share = _drift(
            means[:, 0],
            gains[:, 0] ** 2 / energy,
            float(np.nansum(moments.m2)),
            float(np.nansum(moments.m2 * light**2)) / energy,
        )
    resolved = float(farthest[varied].max()) < _ONE_SQUARE * float(np.nansum(pooled.m2))
    told = {
        "frame_count": len(files),
        "missing": int(np.isnan(moments.mean).sum()),
        "outliers": int(outliers.sum()) if len(files) >= _LEAST_GRUBBS else None,
        "outliers_expected": expected,
        "outlier_share": float(moments.variance[outliers].sum()) / whole,
        "tail_index": _number(float(tail.tail_index)),
        "related": None if pair is None else [str(files[i * times]) for i in pair],
        "relation": _number(relation),
        "drift": drift,
        "drift_share": drift_share,
        "repeat": repeat,
        "repeat_correlation": _number(repeated),
        "spp_known": int(group.spp is not None),
        "correlation_error": math.sqrt(alike / (varied.sum() * independent)),
    }
    if over_time is not None:
        told["sequences"] = count
    # If variances differ between pixels, the error of the mean variance is larger,
    # as if the mean variance were a mean over fewer pixels
    variances = moments.variance[varied]
    uneven = varied.sum() * float((variances**2).sum()) / float(variances.sum()) ** 2
    return _Group(
        spp=group.spp or 1,
        seconds=group.seconds,
        frames=group,
        count=count,
        moments=moments,
        spread=spread / frames_per,
        frames_per=frames_per,
        averages=moments.variance if over_time is None else over_time.sums / (count - 1),
        largest_share=share,
        image=image_sum / count,
        means=means.mean(axis=1),
        radius=rings.radius,
        spectrum=curve,
        spectrum_ci=np.stack([np.maximum(curve - half, 0.0), curve + half], axis=-1),
        correlation=near,
        alike=alike,
        resolved=resolved,
        chosen=chosen,
        sample=sample,
        filtered=filtered_of(
            chains,
            np.stack(over_time.left) if over_time is not None else left[:, :, None],
            uneven * noise,
            space.uneven(np.where(varied, moments.variance, 0.0)),
            space.white,
            varied.size / np.isfinite(moments.mean).sum() * count / (count - 1),
            resolved,
        ),
        curves={name: tuple(curve) for name, curve in curves_of.items()},
        temporal=temporal,
        told=told,
    )


def _variance_of_variance(moments: Moments) -> Array:
    """Return an estimate of the variance of s² of each pixel, without bias from few frames.

    Var(s²) = k₄/R + 2σ⁴/(R − 1) with the fourth cumulant k₄.
    With four or more frames, Var(s²) is estimated by k-statistics [Kenney & Keeping 1951].
    With two or three frames, σ² is the mean variance of nearby pixels.
    If the nearby pixels have different variances, the estimate is too large.
    """
    count = moments.count
    variance, fourth = moments.variance, moments.m4 / count
    if count > 3:
        second = moments.m2 / count
        cumulant = (count + 1) * fourth - 3.0 * (count - 1) * second**2
        cumulant *= count**2 / ((count - 1) * (count - 2) * (count - 3))
        squares = 2.0 / (count + 1) * variance**2
        return np.asarray(squares + cumulant * (count - 1) / (count * (count + 1)))
    known = np.isfinite(variance)
    near = uniform_filter(np.stack([np.where(known, variance, 0.0), known]), (0, _NEAR, _NEAR))
    sigma2 = np.divide(near[0], near[1], out=np.full_like(variance, np.nan), where=known)
    # Mean fourth power of the deviations of R values from their mean
    normal = 3.0 * ((count - 1) / count) ** 2 * sigma2**2
    cumulant = (fourth - normal) * count**3 / ((count - 1) * (count**2 - 3 * count + 3))
    return np.asarray(cumulant / count + 2.0 / (count - 1) * sigma2**2)


def _pooled(a: Moments, b: Moments) -> Moments:
    """Add the means of two groups of values, and the moments of each group about its own mean.

    The groups are, for example, the frames at two times of a sequence.
    """
    return replace(
        a,
        count=a.count + b.count - 1,  # the degrees of freedom, count − 1, add up
        mean=a.mean + b.mean,
        m2=a.m2 + b.m2,
        m3=a.m3 + b.m3,
        m4=a.m4 + b.m4,
    )


def _recounted(moments: Moments, count: int) -> Moments:
    """Return moments with the same variance and kurtosis, but for `count` independent values."""
    factor = (count - 1) / (moments.count - 1)
    return replace(
        moments,
        count=count,
        m2=moments.m2 * factor,
        m3=moments.m3 * factor,
        m4=moments.m4 * (factor**2 * moments.count / count),
    )


def _scattered(varied: Array, times: int) -> Array:
    """Return the pixels at which frames are compared, from a fixed order of all pixels.

    The order is the same for all frames of one size.
    If two sets of frames vary at nearly the same pixels, their compared pixels are nearly equal.
    """
    # Multiples of an odd step near 0.618 of the number of pixels visit all pixels in mixed order
    step = next(k for k in itertools.count(int(0.618 * varied.size) | 1) if _coprime(k, varied))
    order = np.arange(varied.size) * step % varied.size
    return np.asarray(order[varied.ravel()[order]][: max(_SAMPLE // times, _LEAST_PAIRED)])


def _coprime(step: int, varied: Array) -> bool:
    return math.gcd(step, varied.size) == 1


def _drift(
    means: Array, gained: Array, squares: float, chance: float
) -> tuple[float | None, float]:
    """Return the drift of the image mean per frame, and the variance share of brightness changes.

    Parameters
    ----------
    means
        Image mean of each frame, in order.
    gained
        For each frame, the sum of squared deviations due to a change of brightness.
        A change of brightness multiplies all pixels by the same factor.
    squares
        Sum of squared deviations over pixels and frames.
    chance
        Expected sum of `gained` if the errors of pixels are independent.

    Returns
    -------
    tuple
        The drift is None unless the means of the frames significantly follow a straight line.
        The share includes all changes of brightness, also changes without a steady drift.
    """
    count, center = means.size, float(means.mean())
    share = 0.0
    if squares > 0 and chance < _RELATED * squares:  # pixels seldom change together by chance
        share = min(max(float(gained.sum()) - chance, 0.0) / (squares - chance), 1.0)
    if count < 3 or center == 0.0 or not means.std():
        return None, share
    order = np.arange(count) - (count - 1) / 2
    fit = line_fit(order, means, np.ones(count))
    left = float((fit.residuals**2).sum()) / (count - 2)
    t = math.inf if left == 0 else abs(fit.slope) * math.sqrt(float((order**2).sum()) / left)
    from scipy.special import stdtr

    sure = 2.0 * stdtr(count - 2, -t) < _OUTLIER
    return (fit.slope / abs(center) if sure else None), share


def _log_variance(moments: Moments) -> tuple[Array, Array]:
    """Return the standard error of log s², and an unbiased estimate of log σ².

    For ν + 1 normal values, log s² has the mean log σ² + ψ(ν/2) − log(ν/2).
    The variance of log s² is ψ'(ν/2). The estimate is unbiased even for few values.
    """
    from scipy.special import digamma, polygamma

    half = (moments.count - 1) / 2
    with np.errstate(divide="ignore"):
        level = np.log(moments.variance) - digamma(half) + math.log(half)
    return moments.relative_se * math.sqrt(half * polygamma(1, half)), level


def _unbiased(correlation: Array, count: int) -> tuple[Array, float]:
    """Correct the bias of correlations of `count` normal pairs; also return ⟨r⟩/ρ for small ρ.

    With ν = count − 1, the sample correlation r has the mean [Hotelling1953]_
    ⟨r⟩ = ρ (2/ν) [Γ((ν+1)/2) / Γ(ν/2)]² ₂F₁(½, ½; ν/2 + 1; ρ²), where ρ is the true correlation.
    """
    from scipy.special import gammaln, hyp2f1

    half = (count - 1) / 2
    loss = math.exp(2 * (gammaln(half + 0.5) - gammaln(half))) / half
    true = np.linspace(-1.0, 1.0, _TABLE)
    mean = true * loss * hyp2f1(0.5, 0.5, half + 1.0, true**2)
    return np.interp(correlation, mean, true), loss


def _lags(every: Array, variance: float) -> tuple[Array, list[int] | None, float]:
    """Return correlations of errors at small lags, and the lag at which a pattern repeats.

    The lag (y, x) is None if no pattern repeats. The last value is the correlation at this lag.
    """
    height, width = every.shape
    down, right = np.rint(np.fft.fftfreq(height) * height), np.rint(np.fft.fftfreq(width) * width)
    near = [np.abs(lag) <= min(_REACH, (lag.size - 1) // 2) for lag in (down, right)]
    small = [
        np.flatnonzero(mask)[np.argsort(lag[mask])]
        for mask, lag in zip(near, (down, right), strict=True)
    ]
    listed = every[np.ix_(*small)]
    far = np.where(near[0][:, None] & near[1], 0.0, np.abs(every))
    limit = max(_REPEATED, _sidak(far.size // 2) * math.sqrt(variance))
    largest = float(far.max())
    if largest < limit:
        return listed, None, math.nan
    # A pattern repeats at multiples of its period: take the nearest lag with a large correlation
    rows, columns = np.nonzero(far >= 0.9 * largest)
    nearest = np.argmin(np.hypot(down[rows], right[columns]))
    lag = int(down[rows[nearest]]), int(right[columns[nearest]])
    # The period may be an integer fraction of this lag, so test smaller lags as well
    for part in range(2, math.gcd(*lag) + 1):
        inner = lag[0] // part, lag[1] // part
        whole = math.gcd(*lag) % part == 0 and max(map(abs, inner)) > _FILTER
        if whole and abs(every[inner]) >= 0.9 * largest:
            lag = inner
            break
    return listed, [abs(lag[0]), abs(lag[1])], float(every[lag])


def _related(sample: Array, alike: float) -> tuple[tuple[int, int] | None, float]:
    """Return the two frames whose errors correlate most, and their correlation.

    If the largest correlation is not significant, None is returned instead of the frames.

    If errors are independent, deviations from the mean of R frames correlate by −1/(R − 1).
    """
    count, pixels = sample.shape
    if count < 3:
        return None, math.nan
    own = (np.corrcoef(sample) * (count - 1) + 1) / count
    own[np.tril_indices(count)] = 0.0
    first, second = np.unravel_index(np.argmax(np.abs(own)), own.shape)
    found = float(own[first, second])
    limit = max(_RELATED, _sidak(count * (count - 1) // 2) * math.sqrt(alike / pixels))
    return ((int(first), int(second)) if abs(found) > limit else None), found


def _grubbs(count: int) -> float:
    """Return the limit of Grubbs' test for outliers among `count` values [Grubbs1950]_.

    A value is an outlier if its share of the sum of squared deviations exceeds this limit.
    """
    if count < _LEAST_GRUBBS:
        return math.inf
    from scipy.special import stdtrit

    student = float(stdtrit(count - 2, 1 - _OUTLIER / count / 2)) ** 2
    return (count - 1) / count * student / (count - 2 + student)


def _sidak(count: int) -> float:
    """Return the limit that the largest of `count` normal deviates exceeds in 5 % of cases."""
    from scipy.special import ndtri

    return -float(ndtri(-math.expm1(math.log1p(-_SIGNIFICANCE) / max(count, 1)) / 2))


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _flip(reference: Array, test: Array) -> Array | None:
    """FLIP error of two radiance images, or None if the package flip-evaluator is not installed."""
    try:
        from flip_evaluator import evaluate
    except ImportError:
        return None
    pictures = (np.clip(np.nan_to_num(each), 0.0, None) for each in (reference, test))
    wide = (
        np.ascontiguousarray(np.broadcast_to(p, (*p.shape[:2], 3)), np.float32) for p in pictures
    )
    return np.asarray(evaluate(*wide, "HDR", applyMagma=False, computeMeanError=False)[0])[..., 0]


def _compared(
    ours: list[_Group],
    others: list[_Group],
    times: tuple[float | None, float | None],
    read: FrameReader,
    parts: _Parts,
) -> tuple[dict[str, tuple[tuple[str, ...], Any]], dict[str, Any]]:
    """Compare the means and the variances of two sets of frames."""
    common = {each.spp for each in ours} & {each.spp for each in others}
    a, b = (
        max((each for each in both if not common or each.spp in common), key=lambda each: each.spp)
        for both in (ours, others)
    )
    if a.times != b.times:
        raise ParameterError(
            f"{b.files[0]} is of a sequence of {b.times} frames, but {a.files[0]} of {a.times}; "
            "give sequences of one length."
        )
    if a.moments.mean.shape != b.moments.mean.shape:
        raise ParameterError(
            f"{b.files[0]} has the size {b.moments.mean.shape}, but {a.files[0]} has "
            f"{a.moments.mean.shape}; give frames of one view."
        )
    both = np.isfinite(a.moments.mean) & np.isfinite(b.moments.mean)
    if not both.any():
        raise ParameterError(
            f"{a.files[0]} and {b.files[0]} have no pixel that is finite in all frames of both; "
            "give other frames."
        )
    if not both.all():
        a, b = (each.within(both, read) for each in (a, b))
    pairs, relation = _paired(a, b)
    if pairs is None:
        z = _welch(*((each.moments.mean, each.averages, each.count) for each in (a, b)))
        whole = _welch(
            *((each.means.mean(), each.means.var(ddof=1), each.means.size) for each in (a, b))
        )
    else:
        apart = _differences(a, b, pairs, both, read)
        z = _student(apart.mean, apart.variance, apart.count)
        apart_means = np.array([a.means[i] - b.means[j] for i, j in pairs])
        whole = _student(apart_means.mean(), apart_means.var(ddof=1), len(pairs))
    pixels = int((~np.isnan(z)).sum())
    limit = _sidak(pixels)
    # Scale the variance of set b to the number of samples per pixel of set a.
    # Use a measured rate if one is known, and otherwise the rate −1
    step, (rate, rate_se) = 0.0, (math.nan, 0.0)
    if a.spp != b.spp and a.told["spp_known"] and b.told["spp_known"]:
        rate, rate_se = _known_rate(others) or _known_rate(ours) or (-1.0, 0.0)
        step = math.log(a.spp / b.spp)
    scale = math.exp(rate * step) if step else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        variances = a.moments.variance / b.moments.variance / scale
    first, second = a.picture_relative_se, b.picture_relative_se
    # Let ρ be the correlation of the errors of paired frames.
    # The errors of the variances of paired frames have the correlation ρ²
    shared = 0.0 if pairs is None else 2.0 * relation**2 * first * second
    error = math.sqrt(max(first**2 + second**2 - shared, 0.0) + (step * rate_se) ** 2)
    level = math.log(a.picture_variance / b.picture_variance / scale)
    value, bounds = ratio(np.asarray(level), np.asarray(error))
    # If the interval of a variance has no upper end, the ratio is unbounded on the same side
    bounds = np.where([b.resolved, a.resolved], bounds, [0.0, np.inf])
    found: dict[str, tuple[tuple[str, ...], Any]] = {
        "difference": (("y", "x"), a.moments.mean - b.moments.mean),
        "difference_z": (("y", "x"), z),
        "variance_ratio": (("y", "x"), variances),
        "picture_ratio": ((), value),
        "picture_ratio_ci": (("bound",), bounds),
    }
    # Filtered errors of paired frames are also correlated. Ignoring it makes intervals too wide
    for dim, (name, _, part) in parts.items():
        halves = np.hypot(a.filtered.half[part], b.filtered.half[part])
        halves = np.hypot(halves, CONFIDENCE_Z * step * rate_se)
        left = a.filtered.variance[part] / b.filtered.variance[part] / scale
        found[f"{name}_picture_ratio"] = ((dim,), left)
        found[f"{name}_picture_ratio_ci"] = (
            (dim, "bound"),
            np.stack([left * np.exp(-halves), left * np.exp(halves)], axis=-1)
            * np.where([b.resolved, a.resolved], 1.0, [0.0, np.inf]),
        )
    ours_time, other_time = times[0] or a.seconds, times[1] or b.seconds
    if ours_time and other_time:
        faster = ours_time / other_time * scale
        found["equal_time_ratio"] = ((), value * faster)
        found["equal_time_ratio_ci"] = (("bound",), bounds * faster)
    return found, {
        "compared_n": [a.spp, b.spp],
        "scaled_rate": _number(rate),
        "scaled_by": None if not step else "measured" if rate_se else "assumed",
        "pairs": 0 if pairs is None else len(pairs),
        "pair_correlation": _number(relation),
        "identical": int(np.array_equal(a.moments.mean, b.moments.mean, equal_nan=True)),
        "biased_pixels": int((np.abs(z) > limit).sum()),
        "compared_pixels": pixels,
        "z_limit": limit,
        "mean_difference": float(a.means.mean() / b.means.mean() - 1.0),
        "mean_difference_z": float(whole),
    }


def _picture_rate(groups: list[_Group]) -> tuple[Array, Array]:
    """Return the rate of the image's variance and its standard error."""
    whole, apart = (np.array([[getattr(each, name) for each in groups]]) for name in _PICTURE)
    ns = np.array([each.spp for each in groups])
    line = fit_lines(ns, whole, apart, np.zeros_like(whole), largest_se=np.inf)
    return line.rate[0], line.rate_se[0]


def _known_rate(groups: list[_Group]) -> tuple[float, float] | None:
    """Return the rate of the image's variance and its standard error, if the rate is resolved."""
    if len(groups) < 2:
        return None
    rate, se = _picture_rate(groups)
    return (float(rate), float(se)) if is_resolved(*interval(rate, se)) else None


def _paired(a: _Group, b: _Group) -> tuple[list[tuple[int, int]] | None, float]:
    """Return pairs of frames with the same seeds in two sets, and their mean correlation.

    Sets are paired if every frame of the smaller set correlates with a frame of the larger set.
    Each frame of the smaller set needs a frame of its own in the larger set.
    """
    from scipy.optimize import linear_sum_assignment

    _, first, second = np.intersect1d(a.chosen, b.chosen, return_indices=True)
    if first.size < _LEAST_PAIRED or a.times != b.times:
        return None, math.nan
    ours = a.sample[:, :, first].reshape(a.count, -1)
    others = b.sample[:, :, second].reshape(b.count, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        table = np.nan_to_num(np.corrcoef(ours, others)[: len(ours), len(ours) :])
    # With few frames, some deviations correlate by chance: the limit depends on the number of pairs
    chosen = linear_sum_assignment(-table)
    found = table[chosen]
    limit = max(_RELATED, _sidak(table.size) * math.sqrt(max(a.related, b.related) / first.size))
    if float(found.min()) <= limit:
        return None, math.nan
    return [(int(i), int(j)) for i, j in zip(*chosen, strict=True)], float(found.mean())


def _differences(
    a: _Group, b: _Group, pairs: list[tuple[int, int]], both: Array, read: FrameReader
) -> Moments:
    """Return the moments of the differences of paired frames, at pixels that are finite in both."""
    moments: Moments | None = None
    for i, j in pairs:
        apart: Any = 0.0
        for t in range(a.times):
            first, second = a.files[i * a.times + t], b.files[j * b.times + t]
            apart = apart + read.plane(first, None)[0] - read.plane(second, None)[0]
        each = Moments.of(np.where(both, apart / a.times, np.nan)[None])
        moments = each if moments is None else moments.merge(each)
    assert moments is not None
    return moments


def _student(mean: Any, variance: Any, count: int) -> Array:
    """Convert a mean of paired differences to a normal deviate (Student's test)."""
    from scipy.special import ndtri, stdtr

    with np.errstate(invalid="ignore", divide="ignore"):
        t = mean / np.sqrt(variance / count)
        deviate = -ndtri(np.maximum(stdtr(count - 1, -np.abs(t)), 1e-300)) * np.sign(t)
    sure = np.inf if count >= _LEAST_GRUBBS else np.nan
    return np.asarray(
        np.where(variance == 0, np.where(mean == 0, 0.0, np.copysign(sure, mean)), deviate)
    )


def _welch(a: tuple[Any, Any, int], b: tuple[Any, Any, int]) -> Array:
    """Convert a difference of means to a normal deviate (Welch's test).

    Each set is given as its mean, variance and count.
    """
    from scipy.special import ndtri, stdtr

    (mean, variance, count), (other, other_variance, other_count) = a, b
    first, second = variance / count, other_variance / other_count
    with np.errstate(invalid="ignore", divide="ignore"):
        t = (mean - other) / np.sqrt(first + second)
        degrees = (first + second) ** 2 / (first**2 / (count - 1) + second**2 / (other_count - 1))
        deviate = -ndtri(np.maximum(stdtr(degrees, -np.abs(t)), 1e-300)) * np.sign(t)
    # A few equal values do not prove that all values are equal
    sure = np.inf if min(count, other_count) >= _LEAST_GRUBBS else np.nan
    certain = np.where(mean == other, 0.0, np.copysign(sure, mean - other))
    return np.asarray(np.where(first + second == 0, certain, deviate))
