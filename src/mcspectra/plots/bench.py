"""Pictures of a bench that single results do not have: anisotropy, quality against n, projections."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Mark, Panel, Plot
from mcspectra.plots.groups import Group, Styles, lines_of, numbers
from mcspectra.plots.points import square
from mcspectra.plots.scales import count_axis, log_axis

if TYPE_CHECKING:
    from mcspectra.variance.bench import Measured

__all__ = ["anisotropy", "projections", "quality_curves"]

_MOST_AXES = 10


def anisotropy(rings: Group, styles: Styles) -> Plot:
    """Anisotropy of spectra by ring, in dB; what noise alone makes is dotted."""
    curves, noise = {}, {}
    for name, each in rings.items():
        curves[name] = (each["radius"].values, each["anisotropy_db"].values)
        noise[name] = each["anisotropy_noise_db"].values
    under = ("|m|", "anisotropy (dB)")
    marks: list[Mark] = [*lines_of(curves, styles, under)]
    marks += [
        line
        for name, each in rings.items()
        for line in lines_of(
            {"noise alone": (each["radius"].values, noise[name])},
            {"noise alone": type(styles[name])(color=styles[name].color, dashes=":")},
            under,
        )
    ]
    axis = log_axis("|m| (cycles per unit)", 1.0, max(float(x.max()) for x, _ in curves.values()))
    return Plot(
        kind="anisotropy",
        panels=(Panel(marks=tuple(marks), x=axis, y=Axis(label="anisotropy (dB)"), grid=True),),
        caption="Variance of the power over direction, over the squared mean of its ring, in dB; dotted, "
        "what noise alone makes of an isotropic spectrum: only above it is there a direction.",
        words=f"Anisotropy against the length of the frequency for {', '.join(curves)}.",
    )


def quality_curves(figures: Mapping[str, Mapping[str, Measured]], styles: Styles) -> Plot:
    """Figures of quality against n: a panel for each, a line for each sampler."""
    panels = []
    for name, curves in figures.items():
        found = {k: tuple(map(np.array, m[1:])) for k, m in curves.items()}
        shown = {k: (n.astype(float), mean) for k, (n, mean, _) in found.items()}
        marks: list[Mark] = [*lines_of(shown, styles, ("n", name))]
        every = np.concatenate([mean for _, mean in shown.values()])
        for label, (n, mean, error) in found.items():
            half = 1.96 * np.nan_to_num(error)
            marks.append(
                Dots(
                    x=n.astype(float),
                    y=mean,
                    color=styles[label].color,
                    marker=styles[label].marker,
                    size=3.5,
                    low=mean - half,
                    high=mean + half,
                    hover={"sampler": [label] * n.size, "n": numbers(n), name: numbers(mean)},
                )
            )
        positive = every.min(initial=np.inf) > 0 and every.max(initial=0.0) > 4 * every.min(
            initial=1.0
        )
        title = name.replace("_", " ")
        counts = [k for measured in curves.values() for k in measured.counts]
        panels.append(
            Panel(
                marks=tuple(marks),
                x=count_axis("number of points n", counts, 4),
                y=log_axis("", float(every.min()), float(every.max()), 5) if positive else Axis(),
                title=title,
                grid=True,
            )
        )
    return Plot(
        kind="bench-quality",
        panels=tuple(panels),
        columns=3,
        caption="Quality of the point sets against the number of points: "
        + "; ".join(
            f"{name.replace('_', ' ')}: {next(iter(curves.values())).about}"
            for name, curves in figures.items()
        )
        + ". Whiskers are 95 % intervals of the mean.",
        words=f"Panels of {', '.join(figures)} against n.",
        height=0.8,
        wide=True,
    )


def projections(points: Mapping[str, Array], styles: Styles) -> Plot:
    """One set of each sampler on all pairs of axes, the first 10 at most.

    Parameters
    ----------
    points
        By sampler, (n, d), all of the same d ≥ 2.
    styles
        How each sampler is drawn.
    """
    dims = min(_MOST_AXES, *(x.shape[1] for x in points.values()))
    names = list(points)
    pairs = list(combinations(range(dims), 2))
    panels = [
        square(
            points[name],
            styles[name].color,
            title=name if k == 0 else "",
            axes=pair,
        )
        for k, pair in enumerate(pairs)
        for name in names
    ]
    left_out = max(x.shape[1] for x in points.values()) - dims
    return Plot(
        kind="projections",
        panels=tuple(panels),
        columns=-(-len(panels) // -(-len(panels) // 5)),
        caption="One set of each sampler, projected on pairs of axes."
        + (f" The last {left_out} axes are left out." if left_out else ""),
        words=f"{len(pairs)} projections of {', '.join(names)}.",
        height=1.0,
        wide=True,
    )
