"""Pictures of Veach's scene by light, BSDF and multiple importance sampling, and their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.formatting import number
from mcspectra.report.gallery import Picture
from mcspectra.report.reproduction._limits import mean_and_error
from mcspectra.report.reproduction.base import (
    Exhibit,
    Finding,
    Interval,
    agreement,
    comparison,
    normal_interval,
)
from mcspectra.report.style import WIDE, entitle, new_figure, quiet_colorbar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["exhibit"]

_SAMPLER = "sobol | owen | decorrelate"
_SAMPLES = {"light": 4, "bsdf": 4, "mis": 2}  # a pixel and technique: 4 in all
_TITLES = {
    "light": "light importance sampling, N = 4 spp",
    "bsdf": "BSDF importance sampling, N = 4 spp",
    "mis": "MIS, N = 2 + 2 spp",
}
_SHORT = {"light": "light sampling", "bsdf": "BSDF sampling", "mis": "MIS"}
# Region, the strategy that fails there, and one that does not
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
class _Renders:
    """Images (repeats, height, width, 3) by strategy, and a reference with its batches."""

    scene: str
    reference_spp: int
    batches: Array
    repeats: dict[str, Array]

    @property
    def reference(self) -> Array:
        return np.asarray(self.batches.mean(axis=0))

    def errors(self, strategy: str) -> Array:
        """Squared errors as displayed, sRGB from 0 to 1, of all repeats: (repeats, height, width)."""
        from mcspectra.rendering.files import encode_srgb

        shown, right = encode_srgb(self.repeats[strategy]), encode_srgb(self.reference)
        return np.asarray(((shown - right) ** 2).mean(axis=-1))


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Render the scene by each strategy at 4 samples a pixel, several times, against a reference."""
    renders = _render(168, 128, 8, seed) if quick else _render(288, 1024, 12, seed)
    findings = (
        *(_region(renders, *case) for case in _CASES),
        _whole(renders),
        *(_same_mean(renders, strategy) for strategy in ("light", "mis")),
    )
    return Exhibit(
        name="veach-pictures",
        title="Veach's scene: light, BSDF and multiple importance sampling",
        slide="Veach Scene: Multiple Importance Sampling. Reference image N = 1024 spp; Light importance sampling "
        "N = 4 spp; BSDF importance sampling N = 4 spp.",
        caption=_caption(renders, quick=quick),
        pictures=(_pictures(renders), _who_wins(renders)),
        findings=findings,
    )


def _caption(renders: _Renders, *, quick: bool) -> str:
    values = ", ".join(f"{number(float(renders.errors(s).mean()))} ({_SHORT[s]})" for s in _SAMPLES)
    said = (
        f" The reference has {renders.reference_spp} samples of each technique a pixel here, in place of 1024."
        if quick
        else ""
    )
    return (
        "Light sampling is noisy where a smooth plate reflects a wide light, since most of the light's points are not in "
        "its narrow lobe; BSDF sampling is where a light is small and the surface rough, since hardly a direction meets "
        f"it. MIS fails in neither place, though half of its samples are lost where one "
        f"technique would do. Mean squared errors of a pixel, as displayed: {values}.{said}"
    )


def _render(width: int, reference_spp: int, repeats: int, seed: int) -> _Renders:
    from mcspectra.rendering.image import render

    scene = f"veach(width={width}, height={width * 2 // 3})"

    def image(strategy: str, spp: int, counter: int) -> Array:
        found = render(scene, strategy, _SAMPLER, spp, rng=1000 * seed + counter)
        return np.asarray(found["image"].values)

    batches = 8
    return _Renders(
        scene=scene,
        reference_spp=reference_spp,
        batches=np.stack([image("mis", reference_spp // batches, k) for k in range(batches)]),
        repeats={
            strategy: np.stack([image(strategy, spp, 100 + k) for k in range(repeats)])
            for strategy, spp in _SAMPLES.items()
        },
    )


def _ratio(above: Array, below: Array) -> tuple[float, Interval]:
    """Ratio of two means over repeats with a 95 % interval by Student's t."""
    from scipy.special import stdtrit

    (a, a_se), (b, b_se) = mean_and_error(above), mean_and_error(below)
    ratio = float(a / b)
    half = float(stdtrit(len(above) - 1, 0.975)) * float(np.hypot(a_se / a, b_se / b))
    return ratio, (ratio * float(np.exp(-half)), ratio * float(np.exp(half)))


def _whole(renders: _Renders) -> Finding:
    ratio, interval = _ratio(*(renders.errors(s).mean(axis=(1, 2)) for s in ("bsdf", "mis")))
    return agreement(
        "At equal numbers of samples: squared error, as displayed, of BSDF sampling over that of MIS, whole image.",
        measured=ratio,
        interval=interval,
        above=1.0,
        scale="log",
        note="That of light sampling is in the caption: where it does not fail, all samples are its own.",
    )


def _region(renders: _Renders, name: str, worse: str, better: str) -> Finding:
    rows, columns = _window(renders, name)
    ratio, interval = _ratio(
        *(renders.errors(s)[:, rows, columns].mean(axis=(1, 2)) for s in (worse, better))
    )
    return agreement(
        f"{_SHORT[worse][0].upper()}{_SHORT[worse][1:]} fails {_WHERE[name]}: squared error over that of "
        f"{_SHORT[better]}.",
        measured=ratio,
        interval=interval,
        above=1.0,
        scale="log",
    )


def _window(renders: _Renders, name: str) -> tuple[slice, slice]:
    """Rows and columns about a named pixel, a thirtieth of the image wide."""
    from mcspectra.rendering.scenes import named_pixels

    x, y = named_pixels(renders.scene)[name]
    half = renders.reference.shape[1] // 60
    return slice(y - half, y + half + 1), slice(x - half, x + half + 1)


def _same_mean(renders: _Renders, strategy: str) -> Finding:
    """Mean of the image over that of the reference."""
    means = renders.repeats[strategy].mean(axis=(1, 2, 3))
    wholes = renders.batches.mean(axis=(1, 2, 3))
    (value, se), (whole, whole_se) = mean_and_error(means), mean_and_error(wholes)
    ratio = float(value / whole)
    error = ratio * float(np.hypot(se / value, whole_se / whole))
    return comparison(
        f"The mean of images by {_SHORT[strategy]} is that of the reference: ratio.",
        expected=1.0,
        measured=ratio,
        interval=normal_interval(ratio, error),
        text="1",
        note="BSDF sampling is left out: too few of its samples meet the smallest light for a normal interval."
        if strategy == "light"
        else "",
    )


def _pictures(renders: _Renders) -> Picture:
    figure = new_figure(WIDE, 5.5)
    grid = figure.subplots(2, 2)
    images = {s: renders.repeats[s][0] for s in _SAMPLES}
    _show(
        grid[0, 0],
        renders.reference,
        f"reference, N = {renders.reference_spp} spp of each technique",
    )
    for axes, (strategy, image) in zip(grid.ravel()[1:], images.items(), strict=True):
        _show(axes, image, _TITLES[strategy])
    return Picture(
        kind="veach-pictures",
        caption="Veach's scene: four plates, the one farthest back the smoothest, under four spheres of equal power and a "
        "fill light. All images at the same exposure.",
        alt="Four images of plates that reflect lights. The reference is smooth. Light sampling has noise in the "
        "reflections of the wide light at the back plate; BSDF sampling has noise on the wall and in reflections of small "
        "lights; MIS has little everywhere.",
        figure=figure,
    )


def _show(axes: Axes, image: Array, title: str) -> None:
    from mcspectra.rendering.files import encode_srgb

    axes.imshow(encode_srgb(image), interpolation="nearest")
    axes.set_axis_off()
    entitle(axes, title)


def _who_wins(renders: _Renders) -> Picture:
    light, bsdf = (renders.errors(s).mean(axis=0) for s in ("light", "bsdf"))
    least = 1e-6  # of what the lights themselves and the dark background have
    figure = new_figure(WIDE, 4.2)
    axes = figure.subplots()
    drawn = axes.imshow(
        np.log10((light + least) / (bsdf + least)), cmap="PuOr", vmin=-3, vmax=3,
        interpolation="nearest",
    )  # fmt: skip
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8, extend="both")
    quiet_colorbar(bar, "log₁₀ of error by light / by BSDF sampling")
    axes.set_axis_off()
    for name in _WHERE:
        _frame(axes, renders, name)
    return Picture(
        kind="veach-errors",
        caption=f"Squared error, as displayed, by light sampling over that by BSDF sampling, mean of "
        f"{len(renders.repeats['light'])} images: orange, light sampling is better; purple, BSDF sampling. Frames: the "
        "two regions of the findings.",
        alt="The scene in two colours. Orange on wall, floor and in most reflections; purple where the smooth plates at the "
        "back reflect the wide lights.",
        figure=figure,
    )


def _frame(axes: Axes, renders: _Renders, name: str) -> None:
    from matplotlib.patches import Rectangle

    rows, columns = _window(renders, name)
    corner = (columns.start - 0.5, rows.start - 0.5)
    size = columns.stop - columns.start
    axes.add_patch(Rectangle(corner, size, size, fill=False, ec="white", lw=3.2))
    axes.add_patch(Rectangle(corner, size, size, fill=False, ec="black", lw=1.6))
    axes.annotate(
        _LABELS[name], corner, (0, 4), textcoords="offset points", fontsize=8, color="black",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )  # fmt: skip
