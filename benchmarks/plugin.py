"""Throughput of stock integrators with our samplers compared with the stock sampler.

Each printed line compares two samplers, which render in turn during the same run.
Kernels compute the points of all these samplers (`mcspectra.rendering.kernel_sets`).
For a mask, the shifts of all pixels are drawn anew for every image.
Tables of new point sets are drawn for other samplers, such as ``latin-hypercube``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.timing import compare
from mcspectra.rendering import load_mitsuba, load_scene, register_samplers

WIDTH, HEIGHT, SPP = 192, 128, 16
SPECS = (
    "random",
    "jittered",
    "sobol | owen",
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
    seconds, reference, ratio = compare(ours, stock, rounds=5)
    rates = [WIDTH * HEIGHT * SPP / s / 1e6 for s in (seconds, reference)]
    print(
        f"{what:75s} {rates[0]:6.1f} against {rates[1]:6.1f} million samples/s, "
        f"throughput ratio {1 / ratio:.2f}"
    )


if __name__ == "__main__":
    main()
