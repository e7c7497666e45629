"""Images of direct illumination by our own samplers, with the error of each pixel.

Every pixel has its own point set: realization y·width + x of the sampler.
Each of the independent images has its own random stream.
A crop therefore has the same bits as the same part of the whole image.
Kernels compute binary nets with ``owen`` scrambling themselves, by its hash (`kernel_sets`).
A sampler that ends in ``decorrelate(…)`` draws one set and moves it at each pixel.
Renderers also move one set at each pixel, which is cheaper than a separate set for each pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core import progress
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers, map_in_order
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators.moments import Moments
from mcspectra.rendering.kernel_sets import NetPoints, net_of, scramble_key
from mcspectra.rendering.scene_checks import (
    camera_rays,
    check_environment,
    warn_integrator,
    warn_lens,
    warn_missed,
)
from mcspectra.rendering.scenes import Scene, scene_name
from mcspectra.rendering.wavefront import Wavefront
from mcspectra.samplers import Sampler, as_sampler

__all__ = ["CHANNELS", "compare_strategies", "reference", "render"]

CHANNELS = ("R", "G", "B")
_TILE_LANES = 2**19  # samples per tile; points in 8 dims then take 32 MiB as float64
_MOST_SAMPLES = 2**20  # limit of samples per pixel in one image
_MOST_PIXELS = 2**26  # limit of pixels per image; their moments then take 5 GiB


def render(
    scene: Scene,
    strategy: str = "mis",
    sampler: str | Sampler = "sobol | owen",
    spp: int = 16,
    *,
    realizations: int = 1,
    crop: Sequence[int] | None = None,
    film: str = "sampled",
    light: int | str | None = None,
    heuristic: str = "balance",
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Render a scene's direct illumination, including directly visible lights.

    Rays start at the center of the lens, at the midpoint of the time that the shutter is open.
    A camera with a lens or a shutter therefore raises an `IncompleteImageWarning`.
    The same warning appears if a strategy misses a light or surface that is a delta function.

    Parameters
    ----------
    scene
        A scene: a name, a file or a dictionary, as in `load_scene`.
    strategy
        ``"light"`` or ``"bsdf"`` for sampling of lights or of the BSDF.
        ``"mis"`` for multiple importance sampling, the sum of ``"mis-light"`` and ``"mis-bsdf"``.
    sampler
        A sampler or its spec, with the number of dims that the strategy needs (`Wavefront.dims`).
    spp
        Samples per pixel; with ``"mis"`` samples of each technique, as renderers count them.
    realizations
        Number R of independent images. At least 2 are needed for the variance of each pixel.
    crop
        x, y, width and height of a part of the film, in pixels; by default the whole film.
    film
        ``"sampled"``: rays pass through sampled positions in the pixel, with a box filter.
        ``"center"``: rays pass through the pixel's center.
    light
        Index or name of the only light to use.
    heuristic
        ``"balance"`` or ``"power"`` (β = 2).
    rng
        Seed of the random numbers, as defined by SPEC 7 of Scientific Python.
    workers
        Number of threads that draw points while other points render. It does not change the result.

    Returns
    -------
    xarray.Dataset
        ``image`` (y, x, channel): mean of R images.
        If R > 1, ``variance`` is the variance of one image (ddof = 1).
        If R > 1, ``image_se`` is the standard error of ``image``.
        Coordinates are pixels of the film. The attribute ``camera`` describes where rays start.

    Raises
    ------
    ParameterError
        If a parameter is out of range, the crop leaves the film, or the scene cannot be rendered.
        If an environment map is scaled, or has pixel values that are not a radiance.
    CountError
        If the sampler cannot make `spp` points.
    MissingDependency
        If Mitsuba or LLVM is missing.
    """
    waves = Wavefront(scene, light, film, heuristic=heuristic, emission=True)
    check_environment(scene, light)
    source = as_sampler(sampler, waves.dims(strategy))
    spp = source.check_count(as_integer("spp", spp, least=1, most=_MOST_SAMPLES))
    realizations = as_integer("realizations", realizations, least=1, most=MAX_REALIZATIONS)
    left, top, width, height = _as_crop(crop, waves)
    stream, net = Stream.from_rng(rng), net_of(source)
    warn_lens(scene)
    warn_integrator(scene)
    warn_missed(scene, strategy, light)

    # Choose tiles and images that are rendered together.
    # All images of a tile are rendered before the next tile
    count = width * height
    size = min(count, max(1, _TILE_LANES // spp))
    together = max(1, _TILE_LANES // (size * spp))
    blocks = (
        (tile, range(first, min(first + together, realizations)))
        for tile in (range(k, min(k + size, count)) for k in range(0, count, size))
        for first in range(0, realizations, together)
    )

    def draw(block: tuple[range, range]) -> tuple[range, Callable[[], Array]]:
        """Draw the points of a tile; return a function that computes means (images · P, 3)."""
        tile, images = block
        lines = np.arange(tile.start // width, (tile.stop - 1) // width + 1)
        grid = np.empty((len(lines), width, 2), np.int64)
        grid[..., 0], grid[..., 1] = np.arange(left, left + width), (lines + top)[:, None]
        pixels = grid.reshape(-1, 2)[tile.start - lines[0] * width :][: len(tile)]
        numbers = pixels[:, 0] + waves.width * pixels[:, 1]
        streams = [stream.child(image) for image in images]
        everywhere = np.tile(pixels, (len(images), 1)) if len(images) > 1 else pixels
        if net is not None:
            keys = np.array([scramble_key(each) for each in streams], np.uint64)
            points = NetPoints(net, spp, keys, numbers.astype(np.uint32))
            return images, lambda: waves.net_means(strategy, everywhere, points)
        # Samplers draw only consecutive realizations
        runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
        parts = [(each, int(run[0]), len(run)) for each in streams for run in runs]
        u = np.concatenate([source.draw_stream(spp, *part) for part in parts])
        return images, lambda: waves.means(strategy, everywhere, u)

    # Sum moments over images, tile by tile. If kernels compute the points, no points are drawn
    moments: list[Moments] = []
    finished, threads = 0, available_workers(workers)
    for images, evaluate in map_in_order(draw, blocks, threads if net is None else 1):
        means = evaluate()
        # For a single image, skip the variances. With 4 samples per pixel, 1/3 less time is needed
        if realizations == 1:
            found = Moments(1, means, *[np.zeros(())] * 3)
        else:
            found = Moments.of(means.reshape(len(images), -1, len(CHANNELS)))
        if images.start == 0:
            moments.append(found)
        else:
            moments[-1] = moments[-1].merge(found)
        finished += len(means)
        progress.report("render", finished / (count * realizations))
    names = {"image": "mean"}
    if realizations > 1:
        names |= {"variance": "variance", "image_se": "mean_se"}
    joined = {}
    for name, of in names.items():
        parts = [getattr(m, of) for m in moments]
        values = np.concatenate(parts) if len(parts) > 1 else parts[0]
        joined[name] = values.reshape(height, width, len(CHANNELS))
    return dataset(
        {name: (("y", "x", "channel"), values) for name, values in joined.items()},
        {
            "y": np.arange(top, top + height),
            "x": np.arange(left, left + width),
            "channel": list(CHANNELS),
        },
        strategy=strategy,
        sampler=source.spec,
        spp=spp,
        realizations=realizations,
        scene=scene_name(scene).strip("'\""),
        film=film,
        camera=camera_rays(scene),
        light=light,
        heuristic=heuristic if strategy.startswith("mis") else None,
        seed=rng if isinstance(rng, int) else None,
    )


def reference(scene: Scene, spp: int = 1024, *, batches: int = 16, **options: Any) -> xr.Dataset:
    """Render with many samples, and estimate the error of every pixel from independent batches.

    Parameters
    ----------
    scene, options
        Same as in the function `render`.
    spp
        Samples per pixel in all batches together.
    batches
        Number of independent images that are averaged, at least 2. It must divide `spp`.

    Returns
    -------
    xarray.Dataset
        Same as in `render`; the degrees of freedom of ``image_se`` are `batches` − 1.
    """
    count = as_integer("batches", batches, least=2, most=_MOST_SAMPLES)
    each, rest = divmod(as_integer("spp", spp, least=count), count)
    if rest:
        raise ParameterError(Parameter("spp"), f" is {spp}; give a multiple of batches, {count}.")
    return render(scene, spp=each, realizations=count, **options)


def compare_strategies(
    scene: Scene, spp: int = 4, *, reference_spp: int = 1024, **options: Any
) -> dict[str, xr.Dataset]:
    """Render a scene by each strategy with equal numbers of samples, and render a reference.

    Parameters
    ----------
    scene, options
        Same as in the function `render`.
    spp
        Samples per pixel, an even number.
        Multiple importance sampling takes half of the samples from each technique.
    reference_spp
        Samples per pixel of each technique in the reference, as in `reference`.

    Returns
    -------
    dict
        ``reference``, ``light``, ``bsdf`` and ``mis``, each with the variables of `render`.
    """
    count = as_integer("spp", spp, least=2, most=_MOST_SAMPLES)
    if count % 2:
        raise ParameterError(
            Parameter("spp"), f" is {count}; give an even number, half for each technique."
        )
    images = {"reference": reference(scene, reference_spp, **options)}
    for strategy, samples in (("light", count), ("bsdf", count), ("mis", count // 2)):
        images[strategy] = render(scene, strategy, spp=samples, **options)
    return images


def _as_crop(crop: object, waves: Wavefront) -> tuple[int, int, int, int]:
    """Check a window inside the film, and return x, y, width and height."""
    given = (0, 0, waves.width, waves.height) if crop is None else crop
    if not isinstance(given, Sequence | np.ndarray) or isinstance(given, str) or len(given) != 4:
        raise ParameterError(
            Parameter("crop"), f" is {shown(crop)}; give four whole numbers: x, y, width, height."
        )
    film = f"the film has {waves.width} × {waves.height} pixels"
    try:
        x = as_integer("x of the crop", given[0], least=0, most=waves.width - 1)
        y = as_integer("y of the crop", given[1], least=0, most=waves.height - 1)
        width = as_integer("width of the crop", given[2], least=1, most=waves.width - x)
        height = as_integer("height of the crop", given[3], least=1, most=waves.height - y)
    except ParameterError as error:
        raise ParameterError(f"{str(error).rstrip('.')}; {film}.") from None
    if width * height > _MOST_PIXELS:
        raise ParameterError(
            f"{width * height:.3g} pixels are too many for one image; give a crop of at most "
            f"{_MOST_PIXELS:.3g}."
        )
    return x, y, width, height
