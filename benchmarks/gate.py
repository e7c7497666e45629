"""Measure how often the gate raises false alarms, and how often it finds errors of renderers.

Run ``python -m benchmarks gate`` for all tables, or ``python -m benchmarks gate --quick``.
Frames of a Cornell box with a glass sphere come from Mitsuba's path tracer, at 64 × 64 pixels.
Every pair of sets is drawn anew from a library of frames.
Frames of a faulty renderer are combinations of frames of whole paths and of direct light.
Other tests get the same samples; their thresholds give 1 % false alarms on clean pairs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import ndtri
from scipy.stats import binom

from mcspectra.core.checks import Array
from mcspectra.core.images import REC709
from mcspectra.rendering.gate_frames import TILE, coarsened
from mcspectra.rendering.gate_tests import (
    Contrast,
    Outcome,
    cautious,
    levels_of,
    relabelled,
    relabelling_count,
)

SIZE, LEVEL, RELABELINGS = 64, 0.01, 200
SINGLE, NETS = 4096, 160  # numbers of frames with 1 sample and with 16 Sobol' samples
CLEAN = ((4, 4), (8, 8), (8, 32), (1, 16), (2, 2))
TOTALS, FRAMES = (16, 64, 256), 8


def _scene(depth: int, sampler: dict[str, Any]) -> Any:
    """Return a Cornell box with a glass and a glossy sphere; depth 2 means direct light."""
    from mcspectra.rendering import load_mitsuba

    mi = load_mitsuba()
    scene = mi.cornell_box()
    scene["sensor"]["film"] = {
        "type": "hdrfilm",
        "width": SIZE,
        "height": SIZE,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    scene["sensor"]["sampler"] = sampler
    scene["integrator"] = {"type": "path", "max_depth": depth, "rr_depth": 100}
    glossy = {"type": "roughconductor", "alpha": 0.05}
    balls: tuple[tuple[str, list[float], float, dict[str, Any]], ...] = (
        ("small-box", [0.3, -0.6, 0.3], 0.35, glossy),
        ("large-box", [-0.35, -0.5, -0.2], 0.4, {"type": "dielectric"}),
    )
    for name, center, radius, material in balls:
        scene[name] = {"type": "sphere", "center": center, "radius": radius, "bsdf": material}
    return mi.load_dict(scene)


def _library(depth: int, sampler: dict[str, Any], count: int) -> Array:
    """Render frames of different seeds; return their luminance (frame, y, x)."""
    import mitsuba as mi

    scene = _scene(depth, sampler)
    spp = sampler["sample_count"]
    weights = REC709.astype(np.float32)
    return np.stack([np.asarray(mi.render(scene, spp=spp, seed=k)) @ weights for k in range(count)])


def outcome(rows: Array, first: int, seed: int, *, size: int = 1, alike: bool = True) -> Outcome:
    """Run the gate's tests on frames in memory."""
    rows = np.array(rows, np.float32)
    channels = rows.mean(axis=(1, 2), dtype=np.float64)[:, None]
    levels = levels_of(rows, np.zeros(rows.shape[1:], bool), size, channels)
    contrast = Contrast(first=first, second=len(rows) - first, paired=False)
    if not alike or relabelling_count(contrast) * LEVEL < 1:
        return cautious(levels, contrast, LEVEL, alike=alike, noise=alike)
    weights = contrast.relabelings(RELABELINGS, np.random.default_rng(seed))
    return relabelled(levels, contrast, weights, LEVEL)


def _welch(rows: Array, first: int) -> bool:
    """Whether Welch tests of all pixels, with Šidák's correction, raise an alarm."""
    from scipy.special import stdtr

    a, b = rows[:first], rows[first:]
    if min(len(a), len(b)) < 2:
        return False
    one, other = (v.var(axis=0, ddof=1) / len(v) for v in (a, b))
    noisy = one + other > 0
    one, other = one[noisy].astype(float), other[noisy].astype(float)
    degrees = (one + other) ** 2 / (one**2 / (len(a) - 1) + other**2 / (len(b) - 1))
    t = np.abs(a.mean(axis=0) - b.mean(axis=0))[noisy] / np.sqrt(one + other)
    p = 2 * stdtr(degrees, -t)
    return bool(p.min() < 1 - (1 - LEVEL) ** (1 / p.size))


def _alarms(libraries: dict[str, Array], pairs: int) -> None:
    """Print the rate of false alarms for every library and pair of numbers of frames."""
    bound = int(binom.ppf(0.999, pairs, LEVEL))
    print(f"False alarms at level {LEVEL} in {pairs} clean pairs (at most {bound} with 99.9 %)")
    print("| samples | frames | gate | Welch per pixel, Šidák |")
    print("|---|---|---|---|")
    for name, library in libraries.items():
        setups = [(a, b, 1, True, "") for a, b in CLEAN]
        setups += [(8, 32, TILE, True, " stored"), (8, 8, 1, False, " by Welch's t tests")]
        for first, second, size, alike, words in setups:
            rng = np.random.default_rng(first + 100 * second + size)
            count = wrong = 0
            for k in range(pairs):
                rows = library[rng.permutation(len(library))[: first + second]]
                count += outcome(coarsened(rows, size), first, k, size=size, alike=alike).p <= LEVEL
                wrong += _welch(rows, first) if size == 1 and alike else 0
            other = str(wrong) if size == 1 and alike and first > 1 else ""
            print(f"| {name} | {first} + {second}{words} | {count} | {other} |", flush=True)


def _errors(direct: Array, cosine: Array) -> dict[str, Callable[[Array, Array], Array]]:
    """Return functions by name; each makes faulty frames from whole paths and direct light."""
    del direct
    corner = np.zeros((SIZE, SIZE), bool)
    corner[20:26, 24:31] = True  # one error makes these 42 of 4096 pixels too dark

    return {
        "none": lambda whole, _: whole,
        "BSDF pdf × 0.93": lambda whole, light: light + (whole - light) / 0.93,
        "cosine lost": lambda whole, light: whole - light + light / cosine,
        "roulette without weight": lambda whole, light: light + 0.95 * (whole - light),
        "light dropped in 1 %": lambda whole, light: np.where(corner, whole - light, whole),
        "blur of 1 pixel": lambda whole, _: gaussian_filter(whole, (0, 1.0, 1.0)),
        "noise × 1.2": lambda whole, _: whole,
        "fp16 sums": lambda whole, _: whole,
    }


def _cosines() -> Array:
    """Return the cosine between the normal and the direction to the middle of the light."""
    import mitsuba as mi

    scene = _scene(2, {"type": "independent", "sample_count": 16})
    found = mi.load_dict({"type": "aov", "aovs": "p:position,n:sh_normal"})
    values = np.asarray(mi.render(scene, integrator=found, spp=16, seed=1))[..., -6:]
    toward = np.array([0.0, 0.99, 0.0]) - values[..., :3]
    cosine = (toward * values[..., 3:]).sum(axis=-1) / np.linalg.norm(toward, axis=-1)
    return np.clip(np.abs(cosine), 0.25, 1.0)


def _mean(samples: Array, frames: int, half: bool) -> Array:
    """Average consecutive samples into frames, with sums in float16 if `half` is set."""
    each = samples.reshape(frames, -1, SIZE, SIZE)
    if not half:
        return np.asarray(each.mean(axis=1))
    total = np.zeros((frames, SIZE, SIZE), np.float16)
    for k in range(each.shape[1]):
        total = (total + each[:, k].astype(np.float16)).astype(np.float16)
    return total.astype(np.float32) / each.shape[1]


def _ssim(a: Array, b: Array) -> float:
    """Return the mean structural similarity of two images in [0, 1]."""
    m, n = gaussian_filter(a, 1.5), gaussian_filter(b, 1.5)
    va, vb = gaussian_filter(a * a, 1.5) - m * m, gaussian_filter(b * b, 1.5) - n * n
    both = gaussian_filter(a * b, 1.5) - m * n
    c, d = 0.01**2, 0.03**2
    return float(
        (((2 * m * n + c) * (2 * both + d)) / ((m * m + n * n + c) * (va + vb + d))).mean()
    )


def _scores(new: Array, reference: Array, variance: Array, count: int) -> dict[str, float]:
    """Return scores of other tests; larger means more different.

    Mitsuba's z-test allows 0.25 % of the pixels to differ, and uses a variance of at least 1e-4.
    Here the z-test gets the variance of the difference, because both sets have few samples.
    """
    a, b = (np.clip(v.mean(axis=0), 0, 1) ** (1 / 2.2) for v in (new, reference))
    z = np.abs(new.mean(axis=0) - reference.mean(axis=0)) / np.sqrt(
        np.maximum(2 * variance, 1e-4) / count
    )
    return {
        "z-test": float(np.quantile(z, 0.9975)),
        "PSNR": float(((a - b) ** 2).mean()),
        "SSIM": -_ssim(a, b),
    }


def _trials(
    whole: Array, light: Array, total: int, name: str, change: Any, trials: int
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield the p-value of the gate, and the scores of other tests, for each trial."""
    rng, middle = np.random.default_rng(total), whole.mean(axis=0)
    for k in range(trials):
        order = rng.permutation(len(whole))[: 2 * total]
        ours, theirs = order[:total], order[total:]
        new = _mean(change(whole[ours], light[ours]), FRAMES, half=name == "fp16 sums")
        if name == "noise × 1.2":
            new = middle + np.sqrt(1.2) * (new - middle)
        reference = _mean(whole[theirs], FRAMES, half=False)
        variance = whole[theirs].var(axis=0, ddof=1)
        p = outcome(np.concatenate([new, reference]), FRAMES, k).p
        yield p, _scores(new, reference, variance, total)


def _power(whole: Array, light: Array, trials: int) -> None:
    """Print how often each error is found, for the gate and for other tests."""
    errors = _errors(light, _cosines())
    print(f"\nErrors found in {trials} pairs of {FRAMES} + {FRAMES} frames, in %")
    print("z-test, PSNR and SSIM have thresholds for 1 % false alarms, set on these clean pairs.")
    print("In brackets: Mitsuba's z-test with its own threshold.")
    print("| error | samples | gate | z-test | PSNR | SSIM |")
    print("|---|---|---|---|---|---|")
    own = -float(ndtri((1 - (1 - LEVEL) ** (1 / SIZE**2)) / 2))
    for total in TOTALS:
        limits: dict[str, float] = {}
        for name, change in errors.items():
            found = list(_trials(whole, light, total, name, change, trials))
            p = np.array([each[0] for each in found])
            scores = {key: np.array([s[key] for _, s in found]) for key in found[0][1]}
            if not limits:
                limits = {key: float(np.quantile(v, 0.99)) for key, v in scores.items()}
            rates = {key: 100 * (v > limits[key]).mean() for key, v in scores.items()}
            shipped = 100 * (scores["z-test"] > own).mean()
            print(
                f"| {name} | {total} | {100 * (p <= LEVEL).mean():.0f} | {rates['z-test']:.0f} "
                f"({shipped:.0f}) | {rates['PSNR']:.0f} | {rates['SSIM']:.0f} |",
                flush=True,
            )


def _stated(whole: Array, trials: int) -> None:
    """Print how often the smallest bias that the gate states is found: it should be 90 %."""
    rng, found = np.random.default_rng(5), 0
    for k in range(trials):
        order = rng.permutation(len(whole))[: 2 * 16 * FRAMES]
        rows = _mean(whole[order], 2 * FRAMES, half=False)
        tests = outcome(rows, FRAMES, k).tests
        stated = next(each.detectable for each in tests if each.name == "image")
        rows[:FRAMES] += stated * rows[FRAMES:].mean()
        found += outcome(rows, FRAMES, k).p <= LEVEL
    print(
        f"\nStated bias of the image mean, added to all pixels: found in {found} of {trials} pairs"
    )


def _speed() -> None:
    """Print how long all tests take for 5 + 5 frames, each with one million pixels."""
    rng = np.random.default_rng(1)
    rows = rng.standard_exponential((10, 1024, 1024), dtype=np.float32)
    start = time.perf_counter()
    outcome(rows, 5, 0)
    print(f"\nTests of 5 + 5 frames of 1024 × 1024 pixels: {time.perf_counter() - start:.1f} s")


def main(*flags: str) -> None:
    """Print false alarms, power, the check of the stated bias, and seconds."""
    from mcspectra.rendering import load_mitsuba, register_samplers

    mi = load_mitsuba()
    register_samplers()
    mi.set_variant("llvm_ad_rgb")
    quick = "--quick" in flags
    start = time.perf_counter()
    one = {"type": "independent", "sample_count": 1}
    whole, light = (_library(depth, one, SINGLE) for depth in (6, 2))
    nets = {"type": "mcspectra", "spec": "sobol | owen", "sample_count": 16}
    sobol = _library(6, nets, NETS)
    seconds = time.perf_counter() - start
    print(f"{2 * SINGLE + NETS} frames rendered in {seconds:.0f} s", file=sys.stderr)
    libraries = {
        "16 independent": whole.reshape(-1, 16, SIZE, SIZE).mean(axis=1),
        "16 of sobol and owen": sobol,
    }
    _alarms(libraries, 100 if quick else 1000)
    _power(whole, light, 20 if quick else 100)
    _stated(whole, 50 if quick else 200)
    _speed()


if __name__ == "__main__":
    main()
