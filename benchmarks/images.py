"""Throughput of whole images against raw Mitsuba calls and stock integrators; the slides' pictures.

``raw`` evaluates the same kernels on points that lie in Dr.Jit's memory already, and reads every
value back. ``stock`` is Mitsuba's `direct` integrator with its own independent sampler, at the same
number of samples. Both sides of each line alternate in the same run. With ``--pictures`` the
slides' comparison is rendered into the current folder.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.timing import compare
from mcspectra.core.streams import Stream
from mcspectra.rendering import (
    Wavefront,
    compare_strategies,
    load_mitsuba,
    load_scene,
    render,
    write_png,
)
from mcspectra.rendering.techniques import sample_columns

SCENE = "veach(width=384, height=256)"
SPP = 4
STOCK = {"light": (1, 0), "bsdf": (0, 1), "mis": (1, 1)}
SAMPLERS = ("random", "sobol | owen | decorrelate(mode='digital-shift')", "sobol | owen")


def main(*flags: str) -> None:
    """Print ratios of throughput: 1 is that of the reference."""
    for strategy in STOCK:
        _tables(strategy)
        for sampler in SAMPLERS:
            _image(strategy, sampler)
    if "--pictures" in flags:
        _pictures()


def _tables(strategy: str) -> None:
    """Tables of points, drawn beforehand, against the raw kernels."""
    waves = Wavefront(SCENE, film="sampled", emission=True)
    pixels = _pixels(waves)
    dims = waves.dims(strategy)
    u = Stream.from_rng(1).uniforms(0, len(pixels), SPP * dims).reshape(-1, SPP, dims)
    ours, raw, ratio = compare(
        lambda: waves.means(strategy, pixels, u), _raw(waves, strategy, pixels, u), rounds=9
    )
    _line(strategy, "tables / raw calls", len(pixels), ours, raw, ratio)


def _raw(waves: Wavefront, strategy: str, pixels: Any, u: Any) -> Any:
    """One lane a sample, points in Dr.Jit's memory, values to NumPy, no checks and no means."""
    import drjit

    pixel = drjit.arange(load_mitsuba().UInt32, len(pixels) * SPP) // SPP
    columns, color = (
        sample_columns(u.reshape(-1, u.shape[-1])),
        waves._colors(strategy, pixels, pixel),
    )
    return lambda: color(columns).numpy()


def _image(strategy: str, sampler: str) -> None:
    """Images by a sampler against the stock integrator."""
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


def _pixels(waves: Wavefront) -> Any:
    x, y = np.meshgrid(np.arange(waves.width), np.arange(waves.height))
    return np.stack([x, y], axis=-1).reshape(-1, 2)


def _pictures() -> None:
    sampler = "sobol | owen | decorrelate(mode='digital-shift')"
    for name, result in compare_strategies(SCENE, SPP, sampler=sampler).items():
        write_png(f"veach-{name}.png", result["image"].values)
        print(f"veach-{name}.png: mean {float(result['image'].mean()):.4f}")


if __name__ == "__main__":
    main()
