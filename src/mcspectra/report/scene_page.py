"""Page of the profile of a scene: sampler, samples per pixel, causes and worst pixels."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from mcspectra.core.display import between, counted
from mcspectra.plots.kinds import describe
from mcspectra.plots.maps import located
from mcspectra.plots.text import number
from mcspectra.plots.variance import needed_samples, shares
from mcspectra.profiler.scene_profile import Needed, SceneProfile, pixel_command, whole_samples
from mcspectra.report import page as html

__all__ = ["write_scene_profile"]

_MOST_CAUSES = 8  # largest number of decisions that are listed
_LEAST_SHARE = 0.005  # smallest share of the variance that is listed
_WORDS = {0.5: "half of the pixels", 0.95: "95 % of the pixels"}
_SAMPLERS = (
    "Variance of each sampler in relation to the scene's own: geometric mean over the noisier half "
    "of the pixels at {0} samples per pixel, with simultaneous 95 % intervals. Below 1 there is "
    "less noise. Samplers of Mitsuba are as they are. Ours give each request of the integrator "
    "its own points (padded), or the first numbers of a path from one set (joint_dims)."
)


def write_scene_profile(found: SceneProfile, file: str | Path) -> Path:
    """Write the page of a scene's profile.

    Parameters
    ----------
    found
        Result of `mcspectra.profiler.profile_scene`.
    file
        Path of the HTML file; its folder must exist.

    Raises
    ------
    StoreError
        If the file cannot be written.
    MissingDependency
        If the extra ``report`` is not installed.
    """
    answer, given = found.answer, found.answer.given
    settings = (
        f"Target: σ / mean = {found.target:.3g} at each pixel. {found.size[0]} × "
        f"{found.size[1]} pixels, integrator {found.integrator}; now {found.spp} samples per pixel "
        f"with {given.name}. {counted(found.pixels, 'pixel')} in strata of the image were rendered "
        f"{found.renders} times with each sampler."
    )

    # List the samples per pixel of the recommended and of the given sampler
    both = {answer.best.name: found.needed, given.name: found.needed_now}
    rows = [
        (name, _WORDS[each.share], whole_samples(each.spp), _ends(each))
        for name, needed in both.items()
        for each in needed
    ]
    low, high = (min(max(end, 0.0), 1.0) for end in found.missing_ci)
    missing = (
        f"Now {found.missing:.0%} of the pixels miss the target (95 %: "
        f"{between(f'{low:.0%}', f'{high:.0%}')})."
    )
    table = html.table_of(
        "Samples per pixel at which a share of the pixels has at most the target error.",
        ("Sampler", "Reached at", "Samples per pixel", "95 % interval"),
        rows,
        words=(0, 1),
        stacked=True,
    )
    figure = needed_samples(
        {n: {_WORDS[e.share]: (e.spp, *e.spp_ci) for e in needed} for n, needed in both.items()},
        found.spp,
    )

    # Compare the samplers
    results = answer.results
    ratios = xr.Dataset(
        {
            "error_ratio": ("remedy", [1.0 / each.gain for each in results]),
            "error_ratio_ci": (
                ("remedy", "bound"),
                [[1.0 / each.gain_ci[1], 1.0 / each.gain_ci[0]] for each in results],
            ),
        },
        coords={
            "remedy": [each.name for each in results],
            "verdict": ("remedy", [each.verdict for each in results]),
        },
    )
    about = _SAMPLERS.format(found.compared_spp)
    compared = html.table_of(
        f"Variance in relation to {given.name}.",
        ("Sampler", "Variance", "95 % interval", "Verdict"),
        [
            (
                each.name,
                f"{1.0 / each.gain:.2f}",
                "" if each is given else _ratio_ends(each.gain_ci),
                "as given" if each is given else each.verdict,
            )
            for each in results
        ],
        words=(0, -1),
        stacked=True,
    )
    again, (low, high) = found.confirmed, found.confirmed_ci
    confirmed = (
        f"New renders with {answer.best.name} have {again:.2f} times the variance of those in "
        f"the comparison (95 %: {between(f'{low:.2f}', f'{high:.2f}')})."
    )
    plot = replace(describe("remedies", ratios), caption=about)

    causes = [each for each in found.causes if each.share >= _LEAST_SHARE][:_MOST_CAUSES]
    decisions = (
        html.figures_of(
            [
                shares(
                    [each.decision for each in causes],
                    np.array([each.share for each in causes]),
                    np.array([each.share_ci for each in causes]),
                )
            ]
        )
        if causes
        else ()
    )
    worst = html.table_of(
        f"Pixels with the largest σ / mean of {answer.best.name} at {found.compared_spp} samples "
        "per pixel, and the command that analyzes the pixel.",
        ("Pixel", "σ / mean", "Command"),
        [
            (f"({x}, {y})", number(error, 2), pixel_command(found, x, y))
            for x, y, error in found.worst
        ],
        words=(0, -1),
        stacked=True,
    )
    picture: tuple[html.Figures, ...] = ()
    if found.picture is not None:
        picture = html.figures_of(
            [
                located(
                    found.picture,
                    np.array([each[:2] for each in found.worst]).reshape(-1, 2),
                    size=found.size,
                    caption="The scene by few random paths. Rings: the pixels of the table.",
                )
            ]
        )
    black = (
        f"{counted(found.black, 'measured pixel')} had no light in any render and no error."
        if found.black
        else ""
    )
    facts = (
        ("Scene", found.scene),
        ("Integrator", found.integrator),
        ("Samples", f"{found.samples / 1e6:.1f} million in {found.seconds:.0f} s"),
    )
    notes = [html.Paragraph(text=text) for text in (black, *found.notes) if text]
    page = html.Page(
        title=f"Profile of {Path(found.scene).name}",
        what="profile",
        lead=(html.Paragraph(text=answer.advice, kind="answer"),
              html.Paragraph(text=settings, kind="soft")),
        sections=html.sections_of(
            {
                "Samples per pixel": (
                    html.Paragraph(text=missing), table, *html.figures_of([figure])
                ),
                "Samplers": (
                    compared, *html.figures_of([plot]), html.Paragraph(text=confirmed)
                ),
                "Causes of the variance": decisions,
                "Worst pixels": (*picture, worst, *notes),
                "Provenance": (html.FactList(rows=facts),),
            }
        ),
    )  # fmt: skip
    return html.write_page(page, Path(file))


def _ratio_ends(gains: tuple[float, float]) -> str:
    """Return the interval of the ratio of variances from the interval of the gain."""
    return between(*(f"{1.0 / gain:.2f}" for gain in reversed(gains)))


def _ends(each: Needed) -> str:
    low, high = each.spp_ci
    if not math.isfinite(each.spp):
        return ""
    return between(whole_samples(low), whole_samples(high))
