"""Measure how often the gate raises false alarms, and how often it finds errors of renderers.

Run ``python -m benchmarks gate`` for all tables, or ``python -m benchmarks gate --quick``.
The flags ``--alarms``, ``--power``, ``--fp16`` and ``--speed`` print one table each.
Frames of a Cornell box with a glass sphere come from Mitsuba's path tracer, at 64 × 64 pixels.
Every pair of sets is drawn anew from a library of frames.
Frames of a faulty renderer are combinations of frames of whole paths and of direct light.
The gate is compared with Mitsuba's z-test, PSNR and SSIM, which get the same samples.
Thresholds of the z-test, PSNR and SSIM are set on 1,000 pairs of sets without an error.
With these thresholds, the three tests raise as many false alarms as the gate.
The denoiser is an à-trous filter with edge stops.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import ndtri
from scipy.stats import binom

from mcspectra.core.checks import Array
from mcspectra.core.images import REC709
from mcspectra.rendering.gate_frames import TILE, coarsened
from mcspectra.rendering.gate_relabelings import relabelled
from mcspectra.rendering.gate_t_tests import cautious
from mcspectra.rendering.gate_tests import (
    Contrast,
    Outcome,
    levels_of,
    relabelling_count,
)

SIZE, LEVEL, RELABELINGS = 64, 0.01, 200
LEVELS, MANY, CALIBRATED = (0.001, 0.01, 0.05, 0.2), 1000, 1000
# Each pixel gets SINGLE independent samples, and NETS independent sets of 16 Sobol' samples
SINGLE, NETS = 2048, 160
BATCH = 128  # number of samples of each pixel that are rendered at once
CLEAN = ((4, 4), (8, 8), (8, 32), (1, 16), (2, 2))
TOTALS, FRAMES = (16, 64, 256), 8
HALF_TOTALS = (64, 256, 1024, 4096)  # samples per pixel of frames in half precision


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


def _samples(depth: int, count: int) -> Array:
    """Return the luminance of independent samples of each pixel (sample, y, x), in large batches.

    If the maximum depth is changed, sample k follows the same path up to the smaller depth.
    """
    import drjit as dr
    import mitsuba as mi

    scene = _scene(depth, {"type": "independent"})
    sensor, integrator = scene.sensors()[0], scene.integrator()
    found = []
    for batch in range(count // BATCH):
        size = BATCH * SIZE**2
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(batch, size)
        index = dr.arange(mi.UInt32, size) % SIZE**2
        place = mi.Vector2f(index % SIZE, index // SIZE) + sampler.next_2d()
        rays, weight = sensor.sample_ray_differential(
            0.0, sampler.next_1d(), place / SIZE, sampler.next_2d()
        )
        value, _, _ = integrator.sample(scene, sampler, rays)
        light = np.asarray(mi.luminance(weight * value))
        found.append(light.reshape(BATCH, SIZE, SIZE).astype(np.float32))
    return np.concatenate(found)


def outcome(
    rows: Array,
    first: int,
    seed: int,
    *,
    size: int = 1,
    alike: bool = True,
    relabelings: int = RELABELINGS,
) -> Outcome:
    """Run the gate's tests on frames in memory."""
    rows = np.array(rows, np.float32)
    channels = rows.mean(axis=(1, 2), dtype=np.float64)[:, None]
    levels = levels_of(rows, np.zeros(rows.shape[1:], bool), size, channels)
    contrast = Contrast(first=first, second=len(rows) - first, paired=False)
    if not alike or relabelling_count(contrast) * LEVEL < 1:
        return cautious(levels, contrast, LEVEL, alike=alike, noise=alike)
    weights = contrast.relabelings(relabelings, np.random.default_rng(seed))
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


def _errors(cosine: Array) -> dict[str, Callable[[Array, Array], Array]]:
    """Return functions by name; each makes faulty frames from whole paths and direct light."""
    corner = np.zeros((SIZE, SIZE), bool)
    # The error "light dropped in 1 %" darkens a rectangle of 42 among the 4096 pixels
    corner[20:26, 24:31] = True

    return {
        "none": lambda whole, _: whole,
        "BSDF pdf × 0.93": lambda whole, light: light + (whole - light) / 0.93,
        "cosine lost": lambda whole, light: whole - light + light / cosine,
        "roulette without weight": lambda whole, light: light + 0.95 * (whole - light),
        "light dropped in 1 %": lambda whole, light: np.where(corner, whole - light, whole),
        "denoiser on": lambda whole, _: whole,
        "noise × 1.2": lambda whole, _: whole,
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


def _mean(samples: Array, frames: int) -> Array:
    """Average consecutive samples into frames."""
    return np.asarray(samples.reshape(frames, -1, SIZE, SIZE).mean(axis=1))


def _denoised(frames: Array) -> Array:
    """Filter frames by three à-trous levels with edge stops by brightness [Dammertz2010]_."""
    spline = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    found = frames.astype(np.float32)
    for level in range(3):
        # The filter's tolerance is the noise that remains after the earlier filter levels
        noise = found.std(axis=0, ddof=1).mean() * 2.0
        total, weights = np.zeros_like(found), np.zeros_like(found)
        wide = np.pad(found, ((0, 0), *2 * [(2 * 2**level,) * 2]), mode="edge")
        for y in range(5):
            for x in range(5):
                down, right = y * 2**level, x * 2**level
                near = wide[:, down : down + SIZE, right : right + SIZE]
                weight = spline[y] * spline[x] * np.exp(-(((near - found) / noise) ** 2))
                total += weight * near
                weights += weight
        found = total / weights
    return found


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


def _pairs(
    whole: Array, light: Array, total: int, name: str, change: Any, trials: int
) -> Iterator[tuple[Array, Array, dict[str, float]]]:
    """Yield new frames, reference frames, and the scores of other tests."""
    rng, middle = np.random.default_rng(total), whole.mean(axis=0)
    for _ in range(trials):
        order = rng.permutation(len(whole))[: 2 * total]
        ours, theirs = order[:total], order[total:]
        new = _mean(change(whole[ours], light[ours]), FRAMES)
        if name == "noise × 1.2":
            new = middle + np.sqrt(1.2) * (new - middle)
        elif name == "denoiser on":
            new = _denoised(new)
        reference = _mean(whole[theirs], FRAMES)
        variance = whole[theirs].var(axis=0, ddof=1)
        yield new, reference, _scores(new, reference, variance, total)


def _power(whole: Array, light: Array, trials: int) -> None:
    """Print how often each error is found, for the gate and for other tests."""
    errors = _errors(_cosines())
    clean = errors["none"]
    print(f"\nErrors found in {trials} pairs of {FRAMES} + {FRAMES} frames, in %,")
    print(f"at rates of false alarms of {' / '.join(map(str, LEVELS))}.")
    print(f"z-test, PSNR and SSIM have thresholds from {CALIBRATED} clean pairs.")
    print("In brackets: Mitsuba's z-test with its own threshold.")
    print("| error | samples | gate | z-test | PSNR | SSIM |")
    print("|---|---|---|---|---|---|")
    own = -float(ndtri((1 - (1 - LEVEL) ** (1 / SIZE**2)) / 2))
    for total in TOTALS:
        found = [s for *_, s in _pairs(whole, light, total, "none", clean, CALIBRATED)]
        limits = {
            key: np.quantile([each[key] for each in found], 1 - np.array(LEVELS))
            for key in found[0]
        }
        for name, change in errors.items():
            p, scores = [], []
            pairs = _pairs(whole, light, total, name, change, trials)
            for k, (new, reference, score) in enumerate(pairs):
                rows = np.concatenate([new, reference])
                p.append(outcome(rows, FRAMES, k, relabelings=MANY).p)
                scores.append(score)
            values = {key: np.array([each[key] for each in scores]) for key in limits}
            rates = {key: _shares(values[key][:, None] > limits[key]) for key in limits}
            shipped = 100 * (values["z-test"] > own).mean()
            ours = _shares(np.array(p)[:, None] <= np.array(LEVELS) + 1e-9)
            print(
                f"| {name} | {total} | {ours} | {rates['z-test']} ({shipped:.0f}) | "
                f"{rates['PSNR']} | {rates['SSIM']} |",
                flush=True,
            )


def _shares(hits: Array) -> str:
    """Return the percentage of trials in which an error was detected, for each test level.

    The array `hits` has the shape (trial, level). Equal percentages are written once.
    """
    shares = [f"{100 * share:.0f}" for share in hits.mean(axis=0)]
    return " / ".join(shares) if len(set(shares)) > 1 else f"all {shares[0]}"


def _half(whole: Array, pairs: int) -> None:
    """Print how many samples it takes until the gate detects that frames use half precision.

    Frames in half precision are sums of samples, or running means.
    The samples of a frame are drawn with replacement from a library of rendered frames.
    New frames have 16 and N samples, and the reference has N samples in single precision.
    """
    from mcspectra.rendering import gate

    print(f"\nHalf precision found in {pairs} pairs of {FRAMES} + {FRAMES} frames")
    print("| samples N | sums: found | by N against 16 samples | bias | ", end="")
    print("running means: found | by N against 16 samples | bias |")
    print("|---|---|---|---|---|---|---|")
    samples = whole.astype(np.float32)
    truth = float(samples.mean())
    for total in HALF_TOTALS:
        found, trend, means = np.zeros(2, int), np.zeros(2, int), np.zeros(2)
        for k in range(pairs):
            rng = np.random.default_rng(1000 * total + k)
            with tempfile.TemporaryDirectory() as folder:
                place = Path(folder)
                for running in (None, False, True):
                    made = place / str(running)
                    made.mkdir()
                    for spp in (total,) if running is None else (16, total):
                        frames = _halves(samples, rng, spp, running)
                        for i, frame in enumerate(frames):
                            np.save(made / f"{i}_{spp}spp.npy", frame)
                    if running is None:
                        continue
                    kind = int(running)
                    means[kind] += frames.mean() / pairs / truth
                    result = gate(made, place / "None", level=LEVEL)
                    found[kind] += result.attrs["verdict"] == "fail"
                    p = result["test_p"].values[result["test"].values == "trend"]
                    trend[kind] += bool(p.size and p[0] <= LEVEL)
        row = [f"{found[k]} | {trend[k]} | {100 * (means[k] - 1):+.2f} %" for k in (0, 1)]
        print(f"| {total} | {' | '.join(row)} |", flush=True)


def _halves(samples: Array, rng: np.random.Generator, total: int, running: bool | None) -> Array:
    """Return frames of `total` samples, as sums or running means in float16; None: in float32."""
    kind = np.float32 if running is None else np.float16
    found = np.zeros((FRAMES, SIZE, SIZE), kind)
    for k in range(total):
        new = samples[rng.integers(len(samples), size=FRAMES)].astype(kind)
        found = (found + ((new - found) / kind(k + 1) if running else new)).astype(kind)
    return found.astype(np.float32) / (1 if running else total)


def _stated(whole: Array, trials: int) -> None:
    """Print how often the gate detects the smallest bias that it claims to detect at 90 %."""
    rng, found = np.random.default_rng(5), 0
    for k in range(trials):
        order = rng.permutation(len(whole))[: 2 * 16 * FRAMES]
        rows = _mean(whole[order], 2 * FRAMES)
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
    """Print tables of false alarms and of detected errors, and the time of the tests.

    The tables of detected errors include a check of the smallest bias that the gate claims to find.
    """
    from mcspectra.rendering import load_mitsuba, register_samplers

    mi = load_mitsuba()
    register_samplers()
    mi.set_variant("llvm_ad_rgb")
    quick = "--quick" in flags
    parts = {"--alarms", "--power", "--fp16", "--speed"}
    parts = parts & set(flags) or parts
    start = time.perf_counter()
    whole = _samples(6, SINGLE)
    print(
        f"{SINGLE} samples per pixel rendered in {time.perf_counter() - start:.0f} s",
        file=sys.stderr,
    )
    if "--alarms" in parts:
        nets = {"type": "mcspectra", "spec": "sobol | owen", "sample_count": 16}
        libraries = {
            "16 independent": whole.reshape(-1, 16, SIZE, SIZE).mean(axis=1),
            "16 of sobol and owen": _library(6, nets, NETS),
        }
        _alarms(libraries, 100 if quick else 1000)
    if "--power" in parts:
        _power(whole, _samples(2, SINGLE), 6 if quick else 20)
        _stated(whole, 20 if quick else 100)
    if "--fp16" in parts:
        _half(whole, 2 if quick else 8)
    if "--speed" in parts:
        _speed()


if __name__ == "__main__":
    main(*sys.argv[1:])
