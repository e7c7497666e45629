"""Paths of five scenes compared with renders by Mitsuba, and time of a map relative to raw paths.

A film has 8 × 6 pixels with a box filter.
Mitsuba's render and our variance map with random points each make 400 estimates of 64 paths.
Both programs give the mean and the variance of their estimates.
Welch's test compares the values of both programs, and their squared deviations.
The test uses logarithms of variances, which are closer to normal.
The variance of all bounces together is also compared with 64 times the variance of the renders.
The limit of |t| holds for all tests of the table together (Šidák).
Then a map of 64 × 64 pixels with paths of depth 5 is timed.
Raw renders with the same number of paths are the reference.
With ``--coverage``, six pixels of Cornell's box are measured instead.
The benchmark then prints how often 95 % intervals of shares contain the true share.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import stats

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.rendering import builtin, load_mitsuba, load_scene, variance_map
from mcspectra.rendering.map_statistics import path_shares
from mcspectra.rendering.maps import Map
from mcspectra.rendering.paths import find_integrator
from mcspectra.rendering.scenes import as_scene
from mcspectra.samplers import as_sampler

N, REALIZATIONS, CHAINS = 64, 400, 2000
LARGEST_SE = 0.2  # largest relative standard error of variances in the comparison of all bounces
FALSE_ALARM = 0.001  # probability that any t in the table exceeds its limit by chance
LUMINANCE = [0.212671, 0.715160, 0.072169]
SMALL, LARGE = (8, 6), (64, 64)
COUNTS, MAP_REALIZATIONS = (4, 16, 64), 64
ROUNDS = 5
Scene = dict[str, Any]


def main(*flags: str) -> None:
    """Print a row for each scene and the ratios of times, or the coverage of intervals."""
    if "--coverage" in flags:
        coverage()
        return
    tests = 3 * len(SCENES) * SMALL[0] * SMALL[1]
    level = float(stats.norm.isf((1 - (1 - FALSE_ALARM) ** (1 / tests)) / 2))
    print(f"largest |t| over the pixels; the limit for all {tests} tests is {level:.2f}")
    print("scene     dims  pixels  mean  variance  bounces together  shares by bounce")
    for name, (make, integrator) in SCENES.items():
        print(f"{name:9s} " + compared(sized(make(), SMALL), integrator))
    for name, ratios in times().items():
        low, middle, high = np.percentile(ratios, [0, 50, 100])
        print(f"{name}: {middle:.2f} of raw renders ({low:.2f} … {high:.2f})")


def compared(scene: Scene, integrator: str) -> str:
    """Return a row: dims, pixels, largest test statistics, and shares of the variance."""
    theirs = renders(scene, integrator)
    found = variance_map(
        scene, sampler="random", counts=(N // 4, N), realizations=REALIZATIONS, points="own",
        integrator=integrator, chains=CHAINS, rng=5,
    )  # fmt: skip
    mean, variance = theirs.mean(axis=0), theirs.var(axis=0, ddof=1)
    squares, seen = (theirs - mean) ** 2, variance > 0
    own, weight = found["variance"].values[0, -1], found["path_variance"]
    whole, error = weight.values, found["path_variance_se"].values
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = squares.std(axis=0, ddof=1) / squares.mean(axis=0) / REALIZATIONS**0.5
        means = (found["mean"].values[0] - mean) / np.sqrt((own + variance) / REALIZATIONS)
        both = np.hypot(found["variance_relative_se"].values[0, -1], relative)
        ratio = np.log(own / variance) / both
        # Compare the variance of one path with 64 times the variance of the renders.
        # Only pixels at which both variances are precise enough are used
        path = np.log(whole / (N * variance)) / np.hypot(error / whole, relative)
        told = seen & (error < LARGEST_SE * whole) & (relative < LARGEST_SE)
    weight = weight.where(told)
    parts = (found["bounce_share"] * weight).sum(("y", "x")) / float(weight.sum())
    largest = [
        float(np.abs(t[where]).max()) for t, where in ((means, seen), (ratio, seen), (path, told))
    ]
    shares = " ".join(f"{100 * float(part):.1f}" for part in parts)
    return (
        f"{found.attrs['dims']:4d}  {int(seen.sum()):6d}  {largest[0]:4.2f}  {largest[1]:8.2f}  "
        f"{largest[2]:9.2f} of {int(told.sum()):3d}  {shares} %"
    )


def renders(scene: Scene, integrator: str) -> Array:
    """Return the luminance of independent renders by Mitsuba: (R, h, w)."""
    mitsuba = load_mitsuba()
    import drjit  # Mitsuba is imported first, because it chooses the LLVM library

    loaded, made = load_scene(scene), find_integrator(as_scene(scene), integrator)
    images = [
        mitsuba.render(loaded, integrator=made, spp=N, seed=drjit.opaque(mitsuba.UInt32, 7 + r))
        for r in range(REALIZATIONS)
    ]
    return np.asarray(np.stack([np.asarray(image)[..., :3] for image in images]) @ LUMINANCE)


def times() -> dict[str, list[float]]:
    """Return times of maps of Cornell's box, divided by times of renders with as many paths."""
    mitsuba = load_mitsuba()
    import drjit

    scene = sized(cornell(), LARGE)
    loaded, paths = load_scene(scene), sum(COUNTS) * MAP_REALIZATIONS

    def raw(seed: int) -> None:
        image = mitsuba.render(loaded, spp=paths, seed=drjit.opaque(mitsuba.UInt32, seed))
        drjit.eval(image)
        drjit.sync_thread()

    def mapped(chains: int) -> Callable[[int], None]:
        def work(seed: int) -> None:
            variance_map(
                scene, counts=COUNTS, realizations=MAP_REALIZATIONS, integrator="scene",
                chains=chains, rng=seed,
            )  # fmt: skip

        return work

    works = {"raw": raw, "map": mapped(0), "map with shares of 128 chains": mapped(128)}
    ratios: dict[str, list[float]] = {name: [] for name in works}
    # A round times each function once, because a busy machine then slows all of them alike.
    # The first round is not counted, because it compiles kernels
    for turn in range(ROUNDS + 1):
        seconds = {}
        for name, work in works.items():
            start = time.perf_counter()
            work(turn)
            seconds[name] = time.perf_counter() - start
        for name in works if turn else ():
            ratios[name].append(seconds[name] / seconds["raw"])
    print(f"{LARGE[0]} × {LARGE[1]} pixels, path of depth 5, {paths} paths per pixel")
    return {name: each for name, each in ratios.items() if name != "raw"}


def coverage() -> None:
    """Print the coverage of the intervals of variance shares, for each bounce.

    The coverage is the fraction of 400 trials in which the interval contains the true share.
    The true share is measured with 100,000 chains.
    """
    scene = sized(cornell(), (32, 32))
    pixels = np.array([(16, 16), (8, 25), (20, 28), (25, 12), (10, 20), (3, 15)])

    def shares(chains: int, seed: int) -> Array:
        analysis = Map(scene=scene, integrator="scene", chains=chains)  # type: ignore[arg-type]
        subject = Subject(None, as_sampler("random"))
        made, _ = analysis.measurement(subject, Stream.from_rng(seed))
        members = [np.stack(list(each.values())) for each in made.partitions]
        return np.asarray(path_shares(made._chains(pixels), members)[1][:, : len(members[0])])

    truth = np.mean([shares(4000, seed)[0] for seed in range(25)], axis=0)
    for chains in (128, 512):
        found = np.stack([shares(chains, 1000 + trial) for trial in range(400)])
        inside = (found[:, 1] <= truth) & (found[:, 2] >= truth)
        rates = inside.sum(axis=0) / np.isfinite(found[:, 0]).sum(axis=0)
        print(f"{chains} chains")
        for bounce, (held, share) in enumerate(zip(rates, truth, strict=True)):
            print(
                f"  bounce {bounce}: shares {share.min():.3f} … {share.max():.3f}, held "
                f"{held.min():.3f} … {held.max():.3f}"
            )


def sized(scene: Scene, size: tuple[int, int]) -> Scene:
    """Return the scene with this film size and a box filter: a pixel's mean is an integral."""
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}}
    return scene | {"sensor": scene["sensor"] | {"film": film}}


def cornell() -> Scene:
    """Return Mitsuba's Cornell box, to depth 5."""
    scene: Scene = dict(load_mitsuba().cornell_box())
    return scene | {"integrator": {"type": "path", "max_depth": 5, "rr_depth": 100}}


def fog() -> Scene:
    """Return Cornell's box with a sphere of rough glass, filled with a scattering medium."""
    scene, mitsuba = cornell(), load_mitsuba()
    for name in ("small-box", "large-box"):
        del scene[name]
    medium = {
        "type": "homogeneous",
        "albedo": 0.8,
        "sigma_t": 0.4,
        "phase": {"type": "hg", "g": 0.3},
    }
    place = mitsuba.ScalarTransform4f
    return scene | {
        "glass": {
            "type": "sphere", "center": [0.3, -0.5, 0.2], "radius": 0.45,
            "bsdf": {"type": "roughdielectric", "alpha": 0.2, "int_ior": 1.5},
        },
        "inside": {
            "type": "cube", "to_world": place().scale(0.99), "bsdf": {"type": "null"},
            "interior": medium,
        },
    }  # fmt: skip


def sky() -> Scene:
    """Return a scene with a ball of rough metal on a plate, lit by a map of the sky with a sun.

    The camera has a lens with an aperture and a shutter that stays open for some time.
    """
    mitsuba = load_mitsuba()
    place = mitsuba.ScalarTransform4f
    map_ = np.full((16, 32, 3), 0.3, np.float32)
    map_[:8] = [0.4, 0.6, 1.0]
    map_[4, 20] = [60.0, 50.0, 40.0]
    return {
        "type": "scene",
        "sensor": {
            "type": "thinlens", "fov": 40.0, "aperture_radius": 0.15, "focus_distance": 4.0,
            "shutter_open": 0.0, "shutter_close": 1.0,
            "to_world": place().look_at([0, -4, 1.5], [0, 0, 0.4], [0, 0, 1]),
        },
        "light": {
            "type": "envmap", "bitmap": mitsuba.Bitmap(map_),
            "to_world": place().rotate([1, 0, 0], 90),
        },
        "ground": {
            "type": "rectangle", "to_world": place().scale(5), "bsdf": {"type": "diffuse"},
        },
        "ball": {
            "type": "sphere", "center": [0.0, 0.0, 0.6], "radius": 0.6,
            "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.25},
        },
    }  # fmt: skip


SCENES: dict[str, tuple[Callable[[], Scene], str]] = {
    "cornell": (cornell, "scene"),
    "veach": (builtin.veach, "path(max_depth=3)"),
    "penumbra": (builtin.penumbra, "path(max_depth=4, rr_depth=2)"),
    "fog": (fog, "volpath(max_depth=6, rr_depth=100)"),
    "sky": (sky, "path(max_depth=4, rr_depth=100)"),
}


if __name__ == "__main__":
    main(*sys.argv[1:])
