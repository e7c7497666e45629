"""Which figures an estimator gets, with captions and the words that stand in for the picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, TypeAlias

from mcspectra.report import figures
from mcspectra.report.anything import any_pictures
from mcspectra.report.collect import EstimatorGroup
from mcspectra.report.figures.groups import channel_note, frequency_dims
from mcspectra.report.figures.variance import usable_counts
from mcspectra.report.further_pictures import map_pictures, pair_pictures, remedy_pictures
from mcspectra.report.picture import Picture
from mcspectra.report.study_tables import FURTHER
from mcspectra.report.style import LineStyle
from mcspectra.report.words import (
    band_words,
    captured_words,
    first_channel,
    for_each,
    low_power_words,
    peak_words,
    rate_words,
    term_words,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Picture", "pictures"]

Datasets: TypeAlias = "Mapping[str, xr.Dataset]"
Styles: TypeAlias = Mapping[str, LineStyle]


def pictures(group: EstimatorGroup, styles: Styles) -> Iterator[Picture]:
    """Draw the figures of one estimator, one after the other; analyses that are missing have none."""
    for analysis, draw in _DRAWERS:
        data = group.having(analysis)
        if data:
            yield from draw(data, styles)
    known = {analysis for analysis, _ in _DRAWERS} | set(FURTHER)
    for analysis in (each for each in group.analyses if each not in known):
        yield from any_pictures(analysis, group.having(analysis), styles)


def _convergence(data: Datasets, styles: Styles) -> Iterator[Picture]:
    yield Picture(
        kind="convergence",
        caption=_join(
            "Variance against the number of points, with 95 % intervals, fitted lines and their "
            "rates; dotted, the rate of random sampling.",
            "Variances of zero or of rounding size have no place on a logarithmic axis."
            if any(not usable_counts(first_channel(d)).all() for d in data.values())
            else "",
            channel_note(data),
        ),
        alt="Logarithmic plot of variance against n. " + for_each(data, rate_words),
        figure=figures.convergence_curves(data, styles=styles),
    )


def _terms(data: Datasets, styles: Styles) -> Iterator[Picture]:
    channel = channel_note(data)
    yield Picture(
        kind="terms",
        caption=_join(
            "The terms of the variance, signed: dc + power + cross = predicted, with the measured "
            "variance below; whiskers are 95 % intervals.",
            channel,
        ),
        alt="Bars of the three terms. " + for_each(data, term_words),
        figure=figures.three_terms(data, styles=styles),
    )
    yield Picture(
        kind="captured",
        caption=_join(
            "Share of the measured variance that the spectrum predicts when it is cut at each half "
            "width; at 1 nothing is missing.",
            channel,
        ),
        alt="Predicted over measured variance against the half width. "
        + for_each(data, captured_words),
        figure=figures.captured_curves(data, styles=styles),
    )


def _maps(data: Datasets, styles: Styles) -> Iterator[Picture]:
    channel = channel_note(data)
    yield Picture(
        kind="contributions",
        caption=_join(_contribution_caption(data), channel),
        alt="Signed contribution of each frequency to the variance. " + for_each(data, peak_words),
        figure=figures.contributions(data, styles=styles),
    )
    yield Picture(
        kind="bands",
        caption=_join(
            f"Covariance between bands of frequencies ({_bands_of(data)}) and, where bars stand below, "
            "each band's share of the predicted variance by itself and through the other bands.",
            channel,
        ),
        alt="Matrix of covariances between frequency bands. " + for_each(data, band_words),
        figure=figures.band_covariances(data, styles=styles),
    )
    matrices = {name: d for name, d in data.items() if _has_plain_matrix(d)}
    if matrices:
        yield Picture(
            kind="cross-matrix",
            caption=_join(
                "Cross matrix conj(fₘ) fₗ Cₘₗ: its sum is the predicted variance. The diagonal is "
                "the power term, the framed row and column belong to frequency 0.",
                channel,
            ),
            alt="Real and imaginary parts of the cross matrix, with the diagonal m = l and the "
            f"row and column of dc marked, for {_listed(matrices)}.",
            figure=figures.cross_matrices(matrices),
        )


def _spectrum(data: Datasets, styles: Styles) -> Iterator[Picture]:
    dims = len(frequency_dims(next(iter(data.values()))["power"].to_dataset()))
    level = "the expected power over that of random points (∫1/p / n); m = 0 is left out."
    if dims == 1:
        yield Picture(
            kind="spectrum",
            caption=f"Power spectra: {level}",
            alt="Power against frequency m. " + for_each(data, low_power_words),
            figure=figures.power_lines(data, styles=styles),
        )
    elif dims == 2:
        yield Picture(
            kind="spectrum",
            caption=f"Power spectra on one colour scale: {level}",
            alt="Images of the power over the frequencies m₀ and m₁. "
            + for_each(data, low_power_words),
            figure=figures.power_images(data),
        )
    yield Picture(
        kind="radial-power",
        caption="Mean power over all directions against the length of the frequency, in units "
        "of n to the 1/d: the slope at the left decides the rate."
        + (" In this many dims it stands for the whole spectrum." if dims > 2 else ""),
        alt="Logarithmic plot of n times the radial mean power. " + for_each(data, low_power_words),
        figure=figures.radial_power(data, styles=styles),
    )


def _points(data: Datasets, styles: Styles) -> Iterator[Picture]:
    sizes = {d.sizes["axis"] for d in data.values()}
    n = next(iter(data.values())).sizes["point"]
    strips = "Tick marks on a line, with the borders of n equal strata."
    shown = {1: strips, 2: "The unit square."}.get(max(sizes), "The first two axes only.")
    yield Picture(
        kind="points",
        caption=f"One realisation of n = {n} points of each sampler, after importance sampling "
        f"where there is a density. {shown}",
        alt=f"Point sets of {n} points for {_listed(data)}.",
        figure=figures.point_sets(data, styles=styles),
    )


_DRAWERS: tuple[tuple[str, Callable[[Datasets, Styles], Iterator[Picture]]], ...] = (
    ("convergence", _convergence),
    ("terms", _terms),
    ("terms", _maps),
    ("spectrum", _spectrum),
    ("points", _points),
    ("pcf", pair_pictures),
    ("remedies", remedy_pictures),
    ("map", map_pictures),
)


def _bands_of(data: Datasets) -> str:
    """What the bands are, as ``radial: |m| rounded``."""
    first = next(iter(data.values()))
    meaning = str(first["band"].attrs.get("long_name", "")) if "band" in first.coords else ""
    return meaning.removeprefix("band (").removesuffix(")") or "shells of |m|, one frequency wide"


def _contribution_caption(data: Datasets) -> str:
    first = next(iter(data.values()))
    dims = len(frequency_dims(first))
    what = {1: "at each frequency m", 2: "of each frequency (m₀, m₁)"}.get(
        dims, f"of each shell of |m| (in {dims} dims the frequencies of a shell are summed)"
    )
    several = (
        " Every technique has a panel of its own." if first.sizes.get("technique", 1) > 1 else ""
    )
    return (
        f"Contribution {what} to the variance: all of them sum to the predicted variance; "
        f"negative ones take away.{several}"
    )


def _has_plain_matrix(data: xr.Dataset) -> bool:
    return "cross_matrix" in data and "m_0" not in data.coords and "m_technique" not in data.coords


def _listed(data: Datasets) -> str:
    return ", ".join(data)


def _join(*sentences: str) -> str:
    """Sentences one after the other; a note without a full stop, such as the channel, gets one."""
    shown = (s for s in sentences if s)
    return " ".join(s if s.endswith(".") else f"Shown: {s}." for s in shown)
