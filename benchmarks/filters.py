"""Error after filters: predicted from spectra of frames, and measured by filtering other frames.

Run ``python -m benchmarks filters``. It needs the extra ``render``.
The scene is Mitsuba's Cornell box with 96 × 96 pixels and 4 samples per pixel.
The lamp is hidden, because the few pixels at its edge would make most of the variance.
The renders have white noise, correlated errors, or blue noise.
Independent samples give white noise.
A Gaussian reconstruction filter gives correlated errors.
Direct light from Sobol' points with a dither mask gives blue noise.
Sequences have independent frames, or frames that share renders as if samples were reused.
A frame that shares renders is the mean of 4 renders; the next frame contains 3 of these.
The function `mcspectra.rendering.frames` predicts the error from some of the frames.
Frames not used for the prediction are filtered by scipy.ndimage and by a recursive average.
The benchmark ``blender`` does the same with frames of Cycles.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import convolve1d, gaussian_filter

SIZE, SPP = 96, 4
# Numbers of independent frames: to predict the errors, and to measure these errors
MEASURED, HELD = 24, 48
SEEDS, HELD_SEEDS, TIMES, REUSED = 4, 8, 24, 4
# An average over time is compared only if the weight of its first frame is less than FIRST
FIRST = 0.1
# The column "inside" is the error without a border of the image, whose width in pixels is BORDER
BORDER = 16
SPLINE = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0


def _both(image: Any, weights: Any) -> Any:
    return convolve1d(convolve1d(image, weights, axis=0, mode="nearest"), weights, axis=1)


def _a_trous(image: Any) -> Any:
    wide = np.zeros(9)
    wide[::2] = SPLINE
    return _both(_both(image, SPLINE), wide)


SPACE: dict[str, Callable[[Any], Any]] = {
    "gaussian(sigma=1.0)": lambda image: gaussian_filter(image, 1.0, mode="nearest"),
    "gaussian(sigma=1.5)": lambda image: gaussian_filter(image, 1.5, mode="nearest"),
    "gaussian(sigma=3.0)": lambda image: gaussian_filter(image, 3.0, mode="nearest"),
    "box(width=5)": lambda image: _both(image, np.full(5, 0.2)),
    "a-trous(levels=2)": _a_trous,
}
TIME = {
    "ema(alpha=0.2)": (0.2, None),
    "ema(alpha=0.3)": (0.3, None),
    "gaussian(sigma=1.5) | ema(alpha=0.2)": (0.2, "gaussian(sigma=1.5)"),
}


HEADER = f"{'errors':34}{'filter':38}{'predicted':>10}{'95 %':>18}{'inside':>9}{'all':>9}"
HEADER += "  ratio  / white"


def main() -> None:
    """Print predicted and measured root mean square errors after each filter."""
    print(HEADER)
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for name, render in renderers().items():
            frames = (render(seed) for seed in range(MEASURED + HELD))
            ratios += space(name, frames, MEASURED, Path(folder) / f"space-{len(ratios)}")
        white = renderers()["white"]

        def sequence(first: int, reused: int) -> Any:
            renders = np.stack([white(first + k) for k in range(TIMES + reused - 1)])
            return np.stack([renders[t : t + reused].mean(axis=0) for t in range(TIMES)])

        for reused in (1, REUSED):
            name = "independent frames" if reused == 1 else f"renders reused by {reused} frames"
            every = [sequence(1000 * (s + 1), reused) for s in range(SEEDS + HELD_SEEDS)]
            held = np.stack(every[SEEDS:])
            ratios += time(name, every[:SEEDS], held, Path(folder) / f"time-{reused}")
    off = np.abs(np.array(ratios) - 1.0)
    print(f"{off.size} cases: {np.sum(off < 0.05)} within 5 %, the worst {100 * off.max():.1f} %")


def renderers() -> dict[str, Callable[[int], Any]]:
    """Return a function for each kind of error; it renders the luminance of a frame from a seed."""
    from mcspectra.core.images import luminance
    from mcspectra.rendering import load_mitsuba, register_samplers

    mi = load_mitsuba()
    register_samplers(mi.variant())

    def scene(reconstruction: str, integrator: str, sampler: dict[str, Any]) -> Any:
        box = mi.cornell_box()
        film = {"width": SIZE, "height": SIZE, "rfilter": {"type": reconstruction}}
        box["sensor"]["film"] |= film
        box["sensor"]["sampler"] = {"sample_count": SPP, **sampler}
        box["integrator"] = {"type": integrator, "hide_emitters": True}
        return mi.load_dict(box)

    mask = "sobol | decorrelate(mask='blue-noise', width=96)"
    scenes = {
        "white": scene("box", "path", {"type": "independent"}),
        "correlated": scene("gaussian", "path", {"type": "independent"}),
        "blue noise": scene("box", "direct", {"type": "mcspectra", "spec": mask}),
    }

    def rendered(made: Any) -> Callable[[int], Any]:
        return lambda seed: luminance(np.array(mi.render(made, spp=SPP, seed=seed), float))

    return {name: rendered(made) for name, made in scenes.items()}


def space(name: str, frames: Iterator[Any], measured: int, folder: Path) -> list[float]:
    """Compare filters in space, for independent frames."""
    from mcspectra.rendering import frames as measure

    folder.mkdir()
    for k in range(measured):
        np.save(folder / f"{k}.npy", next(frames).astype(np.float32))
    result = measure(folder, flip=False, filters=list(SPACE))
    held = np.stack(list(frames))
    errors = held - held.mean(axis=0)
    ratios = []
    for spec, apply in SPACE.items():
        after = np.stack([apply(error) for error in errors])
        ratios.append(_row(name, spec, result, after, len(held)))
    return ratios


def time(name: str, measured: Any, held: Any, folder: Path) -> list[float]:
    """Compare predicted and measured errors of averages over the frames of sequences.

    The sequences have the shape (sequence, frame, y, x).
    """
    from mcspectra.rendering import frames as measure

    folder.mkdir()
    for seed, sequence in enumerate(measured):
        for t, frame in enumerate(sequence):
            np.save(folder / f"shot_s{seed}_t{t:02d}.npy", frame.astype(np.float32))
    result = measure(folder, flip=False, filters=list(TIME))
    errors = held - held.mean(axis=0)
    times = errors.shape[1]
    ratios = []
    for spec, (alpha, chain) in TIME.items():
        average, shown = errors[:, 0], []
        for t in range(1, times):
            average = (1 - alpha) * average + alpha * errors[:, t]
            if t >= times // 2 and (1 - alpha) ** t < FIRST:
                shown.append([SPACE[chain](e) for e in average] if chain else average)
        ratios.append(_row(name, spec, result, np.concatenate(shown), len(held)))
    return ratios


def _row(name: str, spec: str, result: Any, after: Any, count: int) -> float:
    """Print one comparison, and return the predicted error divided by the measured error."""
    one = result.isel(n=-1).sel(filter=spec)
    predicted = float(np.sqrt(one["filtered_variance"]))
    low, high = np.sqrt(one["filtered_variance_ci"].values)
    squares = after**2 * count / (count - 1)
    inner = squares[:, BORDER:-BORDER, BORDER:-BORDER]
    whole, inside = (float(np.sqrt(each.mean())) for each in (squares, inner))
    ratio = predicted / whole
    print(
        f"{name:34}{spec:38}{predicted:10.5f}{f'{low:.5f} … {high:.5f}':>18}{inside:9.5f}"
        f"{whole:9.5f}  {ratio:.3f}  {np.sqrt(float(one['filtered_ratio'])):7.3f}"
    )
    return ratio
