"""Throughput of stock integrators with our samplers compared with the stock sampler.

Each printed line compares two samplers, which render in turn during the same run.
It ends with the median of the ratios of all rounds, and their quartiles.
Kernels compute the points of all these samplers (`mcspectra.rendering.kernel_sets`).
Tables of new point sets are drawn for other samplers, such as ``latin-hypercube``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.timing import timed_pairs
from mcspectra.rendering import load_mitsuba, load_scene, register_samplers
from mcspectra.rendering.plugin import FAR_APART

WIDTH, HEIGHT, SPP, ROUNDS = 192, 128, 16, 25
SPECS = (
    "random",
    "jittered",
    "sobol | owen",
    FAR_APART,
    "sobol | owen | decorrelate(mode='digital-shift')",
    "sobol | decorrelate(mask='blue-noise')",
    "latin-hypercube",
)


def main() -> None:
    """Print ratios of throughput to the stock sampler."""
    register_samplers("llvm_ad_rgb")
    for integrator in ({"type": "direct"}, {"type": "path", "max_depth": 4}):
        reference = _image(integrator, {"type": "independent"})
        for spec in SPECS:
            ours = _image(integrator, {"type": "mcspectra", "spec": spec})
            _line(f"{integrator['type']}: {spec} / independent", ours, reference)


def _image(integrator: dict[str, Any], sampler: dict[str, Any]) -> Callable[[], Any]:
    mitsuba, scene = load_mitsuba(), load_scene("veach")
    renderer = mitsuba.load_dict(integrator)
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}
    given = mitsuba.traverse(scene.sensors()[0])
    camera = mitsuba.load_dict(
        {
            "type": "perspective",
            "fov": float(given["x_fov"].numpy()[0]),
            "to_world": mitsuba.ScalarTransform4f(given["to_world"].matrix.numpy()[..., 0]),
            "film": film,
            "sampler": {**sampler, "sample_count": SPP},
        }
    )

    def image() -> Any:
        return np.array(
            mitsuba.render(scene, sensor=camera, integrator=renderer, seed=mitsuba.UInt32(1))
        )

    return image


def _line(what: str, ours: Callable[[], Any], stock: Callable[[], Any]) -> None:
    pairs = np.array(timed_pairs(ours, stock, ROUNDS))
    rates = WIDTH * HEIGHT * SPP / pairs.min(axis=0) / 1e6
    low, ratio, high = np.quantile(pairs[:, 1] / pairs[:, 0], (0.25, 0.5, 0.75))
    print(
        f"{what:75s} {rates[0]:6.1f} against {rates[1]:6.1f} million samples/s, "
        f"throughput ratio {ratio:.2f} ({low:.2f} to {high:.2f})",
        flush=True,
    )


if __name__ == "__main__":
    main()
