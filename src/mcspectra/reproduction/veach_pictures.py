"""Images of Veach's scene by light, BSDF and multiple importance sampling, with their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    Heatmap,
    Mark,
    Panel,
    Pixels,
    Plot,
    Scale,
    Segments,
    TextMark,
)
from mcspectra.plots.style import INK
from mcspectra.plots.text import number
from mcspectra.rendering.files import encode_srgb
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, mean_and_error
from mcspectra.reproduction.panels import plot_of

__all__ = ["exhibit"]

_SAMPLER = "sobol | owen | decorrelate"
_SAMPLES = {"light": 4, "bsdf": 4, "mis": 2}  # samples per pixel and technique; 4 in total
_TITLES = {
    "light": "light sampling, N = 4 spp",
    "bsdf": "BSDF sampling, N = 4 spp",
    "mis": "MIS, N = 2 + 2 spp",
}
_SHORT = {"light": "light sampling", "bsdf": "BSDF sampling", "mis": "MIS"}
# Each case names a region of the image, a strategy that fails in this region,
# and a strategy that works in this region
_CASES = (
    ("plate-0", "light", "bsdf"),
    ("plate-0", "light", "mis"),
    ("wall", "bsdf", "light"),
    ("wall", "bsdf", "mis"),
)
_WHERE = {
    "plate-0": "around the reflection of the widest light in the smoothest plate",
    "wall": "on the diffuse wall",
}
_LABELS = {"plate-0": "smoothest plate", "wall": "wall"}


@final
@dataclass(frozen=True, kw_only=True)
class Renders:
    """Images by strategy (repeats, height, width, 3), and the batches of a reference."""

    scene: str
    reference_spp: int
    batches: Array
    repeats: dict[str, Array]

    @property
    def reference(self) -> Array:
        """Mean of the batches, as the reference image."""
        return np.asarray(self.batches.mean(axis=0))

    def errors(self, strategy: str) -> Array:
        """Return squared errors in sRGB (0 to 1) of all repeats, (repeats, height, width)."""
        shown, right = encode_srgb(self.repeats[strategy]), encode_srgb(self.reference)
        return np.asarray(((shown - right) ** 2).mean(axis=-1))

    def window(self, name: str) -> tuple[slice, slice]:
        """Return the rows and columns of a square at a named pixel, with side 1/30 of the width."""
        x, y = mcs.rendering.named_pixels(self.scene)[name]
        half = self.reference.shape[1] // 60
        return slice(y - half, y + half + 1), slice(x - half, x + half + 1)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Render the scene several times by each strategy with 4 samples per pixel, and a reference."""
    renders = _render(168, 64, 8, seed) if quick else _render(288, 512, 12, seed)
    values = ", ".join(f"{number(float(renders.errors(s).mean()))} ({_SHORT[s]})" for s in _SAMPLES)
    spp = renders.reference_spp
    fewer = f" Here the reference has N = {2 * spp} instead of 1024."
    images = {f"reference, {spp} + {spp} spp": renders.reference}
    images |= {title: renders.repeats[strategy][0] for strategy, title in _TITLES.items()}
    return Exhibit(
        numbers={
            "values": values,
            "fewer": fewer if quick else "",
            "repeats": len(renders.repeats["light"]),
        },
        plots=(
            plot_of(
                "veach-pictures",
                *(
                    Panel(
                        marks=(Pixels(rgb=np.round(255 * encode_srgb(image)).astype(np.uint8)),),
                        title=title,
                    )
                    for title, image in images.items()
                ),
            ),
            _who_wins(renders),
        ),
        claims=(
            *(_region(renders, *case) for case in _CASES),
            Claim(
                "At equal numbers of samples: squared error (sRGB, whole image) of BSDF sampling "
                "divided by the error of MIS.",
                _ratio(*(renders.errors(s).mean(axis=(1, 2)) for s in ("bsdf", "mis"))),
                above=1.0,
                note="The caption has the error of light sampling, which is small where it does "
                "not fail, since it uses all samples.",
            ),
            *(_same_mean(renders, strategy) for strategy in ("light", "mis")),
        ),
    )


def _render(width: int, reference_spp: int, repeats: int, seed: int) -> Renders:
    scene = f"veach(width={width}, height={width * 2 // 3})"

    def images(strategy: str, spp: int, first: int, count: int) -> Array:
        rngs = range(1000 * seed + first, 1000 * seed + first + count)
        render = mcs.rendering.render
        found = [render(scene, strategy, _SAMPLER, spp, rng=rng)["image"].values for rng in rngs]
        return np.stack(found)

    return Renders(
        scene=scene,
        reference_spp=reference_spp,
        batches=images("mis", reference_spp // 8, 0, 8),
        repeats={s: images(s, spp, 100, repeats) for s, spp in _SAMPLES.items()},
    )


def _ratio(above: Array, below: Array) -> Measured:
    """Return the ratio of two means over repeats, with a 95 % Student's t interval."""
    from scipy.special import stdtrit

    (a, a_se), (b, b_se) = mean_and_error(above), mean_and_error(below)
    value = float(a / b)
    half = float(stdtrit(len(above) - 1, 0.975)) * float(np.hypot(a_se / a, b_se / b))
    return Measured(value, value * float(np.exp(-half)), value * float(np.exp(half)), log=True)


def _region(renders: Renders, name: str, worse: str, better: str) -> Claim:
    rows, columns = renders.window(name)
    means = (renders.errors(s)[:, rows, columns].mean(axis=(1, 2)) for s in (worse, better))
    short = _SHORT[worse]
    return Claim(
        f"{short[0].upper()}{short[1:]} fails {_WHERE[name]}: squared error divided by the error "
        f"of {_SHORT[better]}.",
        _ratio(*means),
        above=1.0,
    )


def _same_mean(renders: Renders, strategy: str) -> Claim:
    """Compare the mean of the images with the mean of the reference."""
    (value, se), (mean, mean_se) = (
        mean_and_error(images.mean(axis=(1, 2, 3)))
        for images in (renders.repeats[strategy], renders.batches)
    )
    times = float(value / mean)
    return Claim(
        f"The mean of images by {_SHORT[strategy]} equals the mean of the reference: ratio.",
        Measured.normal(times, times * float(np.hypot(se / value, mean_se / mean))),
        expected=1.0,
        shown="1",
        note="BSDF sampling is omitted: too few of its samples hit the smallest light for a normal "
        "interval."
        if strategy == "light"
        else "",
    )


def _who_wins(renders: Renders) -> Plot:
    light, bsdf = (renders.errors(s).mean(axis=0) for s in ("light", "bsdf"))
    least = 1e-6  # avoids division by zero at the lights and in the dark background
    values = np.log10((light + least) / (bsdf + least))[::-1]
    height, width = values.shape
    scale = Scale(
        label="log₁₀ of error by light / by BSDF sampling", low=-3.0, high=3.0, palette="diverging"
    )
    marks: list[Mark] = [
        Heatmap(values=values, x=np.arange(width) + 0.5, y=np.arange(height) + 0.5, scale=scale)
    ]
    for name, label in _LABELS.items():
        rows, columns = renders.window(name)
        left, right, low, high = (
            columns.start,
            columns.stop,
            height - rows.stop,
            height - rows.start,
        )
        corners = np.array([(left, low), (right, low), (right, high), (left, high)], float)
        ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        marks += [Segments(ends=ends, color="#FFFFFF", width=3.2), Segments(ends=ends, color=INK)]
        marks.append(
            # Place the label above the reflection of the lights, where the picture is dark
            TextMark(x=(left + right) / 2, y=2.0 * high - low, text=label, side="above")
        )
    axis = Axis(ticks={})
    return Plot(
        kind="veach-errors",
        panels=(Panel(marks=tuple(marks), x=axis, y=axis, square=True),),
        height=2 / 3,
    )
