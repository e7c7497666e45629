"""Throughput of a pixel as an integrand compared with Mitsuba kernels without our checks.

The raw calls pass the same NumPy points as float32 to Mitsuba's light or BSDF sampling.
The raw calls use one kernel, and return the float32 values to NumPy.
The pixel and the raw calls are timed in turn, with the same million samples.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.timing import compare
from mcspectra.core.checks import Array
from mcspectra.rendering import Pixel, load_mitsuba, load_scene
from mcspectra.rendering.backend import LOCK
from mcspectra.rendering.scenes import find_emitter
from mcspectra.rendering.techniques import primary_hit, sample_bsdf, sample_light

SAMPLES = 2**20
LEAST = 0.8
PLACE: dict[str, Any] = {"scene": "veach", "x": 568, "y": 100, "light": "light-3"}


def main() -> None:
    """Print samples per second, and raw time divided by ours, for light and BSDF sampling."""
    u = np.random.default_rng(1).random((SAMPLES, 2))
    for strategy in ("light", "bsdf"):
        pixel = Pixel(**PLACE, strategy=strategy)
        ours, raw, times = compare(partial(pixel, u), partial(raw_call, strategy, u))
        verdict = "met" if 1.0 / times >= LEAST else "missed"
        print(
            f"{strategy:6s} ours {SAMPLES / ours / 1e6:5.1f} M/s  raw {SAMPLES / raw / 1e6:5.1f} "
            "M/s  "
            f"ratio {1.0 / times:.2f} (at least {LEAST}: {verdict})"
        )


def raw_call(strategy: str, u: Array) -> Array:
    """Return the values that Mitsuba computes at the random numbers `u` (M, 2)."""
    mitsuba = load_mitsuba()
    with LOCK:
        hit = primary_hit(load_scene(PLACE["scene"]), PLACE["x"], PLACE["y"])
        emitter = find_emitter(PLACE["scene"], PLACE["light"])
        sample = sample_light if strategy == "light" else sample_bsdf
        samples = mitsuba.Point2f(*np.ascontiguousarray(u.T, np.float32))
        value, _, _ = sample(hit, emitter, samples)
        return np.asarray(mitsuba.luminance(value).numpy())


if __name__ == "__main__":
    main()
