"""Maps over an image: variance, its rate, the technique that decides it, the gain of MIS.

Every pixel is the integrand `Pixel` with the ray through its centre, and is measured as
`convergence` does it: variances over realisations at several counts, and the slope of log variance
against log n. So few realisations as an image can afford leave wide intervals (the standard error of
a variance of 64 normal estimates is 18 %), which all results carry.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS
from mcspectra.core.progress import report
from mcspectra.core.results import package_versions
from mcspectra.core.streams import RngLike, Stream
from mcspectra.rendering._map_checks import (
    POINTS,
    Window,
    check_counts,
    check_crop,
    check_memory,
    check_size,
    check_smoothing,
    check_strategies,
)
from mcspectra.rendering._map_kernel import RECEIVER, Lighting
from mcspectra.rendering._map_results import labelled
from mcspectra.rendering._map_store import TileStore
from mcspectra.rendering._map_tiles import MAP_STRATEGIES, Measurement
from mcspectra.rendering._scene_files import scene_state
from mcspectra.rendering.backend import LOCK, load_mitsuba
from mcspectra.rendering.draws import check_channel
from mcspectra.rendering.scene_checks import check_lights, check_scene, warn_lens
from mcspectra.rendering.scenes import Scene, as_scene, film_size, scene_name, sensor_of
from mcspectra.rendering.staged_map import Maps, StagedMap
from mcspectra.rendering.techniques import POWERS
from mcspectra.samplers import as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["staged_map", "variance_map"]


def variance_map(
    scene: Scene,
    strategies: Sequence[str] = MAP_STRATEGIES,
    sampler: Any = "jittered",
    counts: Sequence[int] = (4, 9, 16, 36, 64),
    realizations: int = 64,
    *,
    crop: Sequence[int] | None = None,
    size: Sequence[int] | None = None,
    light: int | str | None = None,
    heuristic: str = "balance",
    channel: str | int = "luminance",
    dims: int = 2,
    points: str = "shared",
    smoothing: int = 1,
    predict_every: int = 1,
    rng: RngLike = 0,
    out: str | Path | None = None,
    resume: bool = False,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure the variance of every pixel's direct illumination and its rate of convergence.

    Parameters
    ----------
    scene
        A scene as of `load_scene`; a dictionary cannot be used with `out`.
    strategies
        Some of ``"light"``, ``"bsdf"``, the shares of multiple importance sampling ``"mis-light"``
        and ``"mis-bsdf"``, and ``"mis"``, their sum, with n samples of each technique, which brings
        its shares along.
    sampler
        Sampler or its spec string; each technique has points of its own.
    counts
        Numbers of samples n of a technique, ascending, at least two.
    realizations
        Independent realisations for each n, at least 2.
    crop
        x0, y0, width and height of the part that is measured; all by default. A crop gives the
        same numbers as the whole.
    size
        Width and height of a grid of pixels laid over the film; by default the film's own. Another
        aspect ratio samples the film unevenly, it changes nothing that the camera sees.
    light, heuristic, channel
        As those of `Pixel`; one channel at a time.
    dims
        2, or 3 to leave the choice of a light, or of a lobe of the BSDF, to a third coordinate.
    points
        ``"shared"``: all pixels have the same points in the same realisation. Each pixel's numbers
        are as good as with its own, faster to make, and give smooth maps; but the errors of
        neighbours are alike, so that structure in a map may be that of one set of points.
        ``"own"``: every pixel has realisations of its own, the errors are noise.
    smoothing
        Odd number of pixels: rates are averaged over a window of so many squared, which blurs them.
        Their standard errors fall accordingly with ``points="own"`` only.
    predict_every
        Predict the variance at the largest count at pixels whose x and y are multiples of this; 0:
        nowhere. By stratum quadrature for jittered points, exactly for random ones, from the
        sampler's power spectrum for others (2-D only).
    rng
        Seed (SPEC 7).
    out, resume
        Folder that keeps finished tiles, and whether to go on with those that are there: the result
        has the same bits as one that was not interrupted.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        On (y, x), NaN where a pixel sees no surface, a light or a perfectly specular surface:
        ``variance(strategy, n)``, ``variance_relative_se(strategy, n)``; ``mean(strategy)`` and
        ``mean_se(strategy)`` at the largest n; ``rate(strategy)``, ``rate_se``, ``rate_ci(bound)``,
        ``fit_chi2``; with ``"mis"``: ``bottleneck``, the technique whose share of MIS has the slower
        rate (0 light, 1 BSDF, −1 if the 95 % interval of their difference contains 0),
        ``dominant_technique``, the one with the larger variance at the largest n, likewise; with the
        single strategies too: ``mis_gain``,
        variance of the better of them over that of MIS at the same total of samples (the largest n,
        from the fitted lines), and ``mis_gain_ci``; ``predicted_ratio(strategy)``, predicted over
        measured variance at the largest n, and ``predicted_ratio_ci``, NaN where the relative standard
        error of the prediction is more than ½, or that of the measurement more than rates allow. That
        error counts light that another strategy sees and the prediction's samples did not meet; NaN,
        too, where the measured estimates met surely less light than those of another strategy.

    Raises
    ------
    ParameterError
        A parameter is not one of those allowed, the crop is outside, no pixel sees a surface, or
        Mitsuba gives values that are not finite.
    CountError
        The sampler cannot make one of the counts.
    StoreError
        `out` holds tiles and `resume` is False, or they are of other settings.

    Notes
    -----
    Memory: about 200 MiB beside the result, whatever the size of the image: pixels are measured in
    tiles. Where few realisations meet a light, variances are mostly far too small at the smaller n:
    there is no rate where one is zero, or has a standard error of more than a half of it, at a
    smaller n than others; more realisations give one. ``bottleneck`` is one comparison a
    pixel, of techniques with points of their own, at 95 %: where both rates are equal a pixel in 20 is
    decided all the same.
    """
    staged = staged_map(
        *(scene, strategies, sampler, counts, realizations),
        crop=crop,
        size=size,
        light=light,
        heuristic=heuristic,
        channel=channel,
        dims=dims,
        points=points,
        smoothing=smoothing,
        predict_every=predict_every,
        rng=rng,
    )
    settings = {} if out is None else _settings(staged.measurement, staged.window)
    store = None if out is None else TileStore(out, settings, resume=resume)
    with _threads(workers):
        return staged.result(_measured(staged, store))


def staged_map(
    scene: Scene,
    strategies: Sequence[str] = MAP_STRATEGIES,
    sampler: Any = "jittered",
    counts: Sequence[int] = (4, 9, 16, 36, 64),
    realizations: int = 64,
    *,
    crop: Sequence[int] | None = None,
    size: Sequence[int] | None = None,
    light: int | str | None = None,
    heuristic: str = "balance",
    channel: str | int = "luminance",
    dims: int = 2,
    points: str = "shared",
    smoothing: int = 1,
    predict_every: int = 1,
    rng: RngLike = 0,
) -> StagedMap:
    """Return `variance_map` as a staged analysis, its arguments checked: a block is a tile."""
    measurement = _measurement(
        *(scene, strategies, sampler, counts, realizations, size, light, heuristic, channel),
        *(dims, points, predict_every, Stream.from_rng(rng)),
    )
    smoothing = check_smoothing(smoothing)
    window = check_crop(crop, measurement.lighting.size)
    check_memory(window, len(measurement.strategies), len(measurement.counts))

    def result(maps: Maps) -> xr.Dataset:
        if not (maps["status"] == RECEIVER).any():
            nothing = (
                f"No pixel of the crop {list(window)} of {scene_name(scene)} sees a surface that "
                "scatters light; choose another crop."
            )
            raise ParameterError(" ".join([nothing, *check_scene(scene, light=light)]))
        return labelled(measurement, window, maps, smoothing, rng)

    return StagedMap(measurement, window, result)


def _measurement(
    scene: Scene,
    strategies: Any,
    sampler: Any,
    counts: Any,
    realizations: int,
    size: Any,
    light: int | str | None,
    heuristic: str,
    channel: Any,
    dims: int,
    points: str,
    predict_every: int,
    stream: Stream,
) -> Measurement:
    """Check all parameters, in the order in which they are given."""
    scene = as_scene(scene)
    with LOCK:
        sensor_of(scene)
        grid = film_size(scene) if size is None else check_size(size)
        check_lights(scene, light)
        warn_lens(scene)
    chosen = as_sampler(sampler, as_integer("dims", dims, least=2, most=3))
    return Measurement(
        lighting=Lighting(
            scene=scene,
            light=light,
            heuristic=as_choice("heuristic", heuristic, tuple(POWERS)),
            channel=check_channel(channel, ("luminance",)),
            size=grid,
        ),
        strategies=check_strategies(strategies),
        sampler=chosen,
        counts=tuple(chosen.check_count(n) for n in check_counts(counts)),
        realizations=as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS),
        stream=stream,
        own=as_choice("points", points, POINTS) == "own",
        predict_every=as_integer("predict_every", predict_every, least=0),
    )


def _measured(staged: StagedMap, store: TileStore | None) -> Maps:
    """Measure all tiles, or read them; arrays (…, y, x)."""
    maps: Maps = {}
    for tile in range(staged.tiles):
        place = staged.places(tile)
        found = None if store is None else store.load(tile)
        if found is None:
            found = staged.tile(tile)
            if store is not None:
                store.save(tile, found)
        for name, values in found.items():
            if name not in maps:
                maps[name] = np.empty((*values.shape[:-1], staged.pixels), values.dtype)
            maps[name][..., place] = values
        report("map", (int(place[-1]) + 1) / staged.pixels)
    return staged.image(maps)


def _settings(measurement: Measurement, window: Window) -> dict[str, Any]:
    """All that the bits of a tile depend on, as JSON can hold it."""
    lighting = measurement.lighting
    if not isinstance(lighting.scene, str | Path):
        raise ParameterError(
            "out keeps tiles of scenes that a name or a file describes, not of dictionaries; write "
            "the scene to a file (mitsuba.xml.dict_to_xml), or leave out out=."
        )
    path = Path(lighting.scene).expanduser()
    content = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
    return {
        "scene": str(lighting.scene),
        "scene_sha256": content,
        "scene_files": None if content is None else scene_state(path),
        "light": lighting.light,
        "heuristic": lighting.heuristic,
        "channel": lighting.channel,
        "size": lighting.size,
        "strategies": measurement.strategies,
        "sampler": repr(measurement.sampler),
        "counts": measurement.counts,
        "realizations": measurement.realizations,
        "stream": measurement.stream.key,
        "own": measurement.own,
        "predict_every": measurement.predict_every,
        "window": window,
        "tile_pixels": measurement.tile_pixels,
        "versions": {**package_versions(), "mitsuba": load_mitsuba().__version__},
    }


@contextmanager
def _threads(workers: int | None) -> Iterator[None]:
    """Have Dr.Jit, whose threads are those of the whole process, use so many of them inside."""
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
