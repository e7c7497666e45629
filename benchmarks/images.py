"""Throughput of whole images compared with stock integrators, and pictures as in the slides.

The name ``stock`` is Mitsuba's `direct` integrator with its own independent sampler.
The stock integrator renders with the same number of samples as our integrator.
The two renderers of each printed line are timed in turns, in the same run.
With ``--pictures``, the slides' comparison is rendered to the current folder.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.timing import compare
from mcspectra.rendering import (
    compare_strategies,
    load_mitsuba,
    load_scene,
    render,
    write_png,
)

SCENE = "veach(width=384, height=256)"
SPP = 4
STOCK = {"light": (1, 0), "bsdf": (0, 1), "mis": (1, 1)}
SAMPLERS = ("random", "sobol | owen | decorrelate(mode='digital-shift')", "sobol | owen")


def main(*flags: str) -> None:
    """Print ratios of throughput; 1 is the reference."""
    for strategy in STOCK:
        for sampler in SAMPLERS:
            _image(strategy, sampler)
    if "--pictures" in flags:
        _pictures()


def _image(strategy: str, sampler: str) -> None:
    """Time images by a sampler and by the stock integrator."""
    mitsuba, scene = load_mitsuba(), load_scene(SCENE)
    counts = dict(zip(("emitter_samples", "bsdf_samples"), STOCK[strategy], strict=True))
    direct = mitsuba.load_dict({"type": "direct", **counts})

    def stock() -> Any:
        return np.array(mitsuba.render(scene, integrator=direct, spp=SPP, seed=mitsuba.UInt32(1)))

    ours, theirs, ratio = compare(lambda: render(SCENE, strategy, sampler, SPP), stock, rounds=9)
    _line(strategy, f"{sampler} / stock direct", 384 * 256, ours, theirs, ratio)


def _line(
    strategy: str, what: str, pixels: int, ours: float, reference: float, ratio: float
) -> None:
    rates = (pixels * SPP / seconds / 1e6 for seconds in (ours, reference))
    ours_rate, reference_rate = rates
    print(
        f"{strategy:6s} {what:65s} {ours_rate:6.1f} against {reference_rate:6.1f} "
        f"million samples/s, throughput ratio {1 / ratio:.2f}"
    )


def _pictures() -> None:
    sampler = "sobol | owen | decorrelate(mode='digital-shift')"
    for name, result in compare_strategies(SCENE, SPP, sampler=sampler).items():
        write_png(f"veach-{name}.png", result["image"].values)
        print(f"veach-{name}.png: mean {float(result['image'].mean()):.4f}")


if __name__ == "__main__":
    main()
