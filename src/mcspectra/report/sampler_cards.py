"""Summary cards of samplers: a part of the page of a benchmark, or Markdown text.

A card shows one sampler's points, spectrum, projections, rates, quality, cost and sources.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import final

import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.display import escape_html
from mcspectra.core.errors import (
    McspectraError,
    MissingDependency,
    ParameterError,
    StoreError,
    writing,
)
from mcspectra.core.progress import report
from mcspectra.core.references import ADDRESS
from mcspectra.core.results import dataset
from mcspectra.core.spec import parse_chain
from mcspectra.core.streams import Stream
from mcspectra.estimators import Estimator
from mcspectra.measure.bench import SHARED_SETS, making_seconds, randomized, shared_sets
from mcspectra.measure.converge import convergence
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.description import Plot
from mcspectra.plots.points import QUALITY_HEADS, sampler_card
from mcspectra.plots.text import NEGLIGIBLE, number, rate, with_error
from mcspectra.quality import quality_figures, summarize
from mcspectra.quality.figures import different_realizations
from mcspectra.report import page as html
from mcspectra.samplers import SAMPLERS, Sampler, sampler
from mcspectra.samplers.facts import SamplerFacts, sampler_facts
from mcspectra.spectra.power import power_spectrum

__all__ = [
    "FULL",
    "QUICK",
    "Card",
    "CardEffort",
    "all_samplers",
    "card_sections",
    "measure_card",
    "write_cards",
]

_ALSO = (
    "sobol | owen",
    "sobol | owen(method='hash')",
    "sobol | lms",
    "halton | owen",
    "halton | permute",
    "rank1-lattice | shift | mirror(mode='fold')",
    "latin-hypercube(strength=2)",
    "poisson-disk(boundary='bounded')",
)
"""Specs that `all_samplers` adds to the registered samplers."""

_PROJECTED_DIMS = 4
_INTEGRANDS = {1: ("gaussian", "step(at=0.3)"), 2: ("gaussian", "disk")}


@final
@dataclass(frozen=True, kw_only=True)
class CardEffort:
    """Numbers of points and realizations for a card.

    Attributes
    ----------
    n
        Number of points for images, spectrum and quality figures, rounded to a possible count.
    spectra, rates
        Number of realizations for the spectrum and for the variance at each count.
    counts
        Numbers of points for the rates. Without any, rates are not measured.
    slow_counts, slow_rates
        Same as `counts` and `rates`, for samplers that generate points slowly.
    """

    n: int = 1024
    spectra: int = 200
    rates: int = 2000
    counts: tuple[int, ...] = (16, 64, 256, 1024, 4096)
    slow_counts: tuple[int, ...] = (16, 64, 256, 1024)
    slow_rates: int = 400


FULL = CardEffort()
QUICK = CardEffort(
    n=256, spectra=40, rates=300, counts=(16, 64, 256), slow_counts=(16, 64, 256), slow_rates=100
)


@final
@dataclass(frozen=True, kw_only=True)
class Card:
    """Measurements of one sampler.

    Attributes
    ----------
    spec
        Spec of the sampler that the images and the spectrum show.
    randomized
        Spec of the sampler whose rates were measured. Fixed sets are randomized to measure rates.
        Empty if no rates were measured.
    points
        One realization of the points, with shape (n, dims).
    projected
        The third and fourth coordinates of a 4-D set, (n, 2), or None if 4-D sets are impossible.
    spectrum
        Result of `power_spectrum`.
    curves
        Results of `convergence` by integrand. Empty if fewer than two counts are possible.
    quality
        Long name, mean and standard error of each quality figure.
    speed
        Points per second on one thread, without caches.
    """

    name: str
    facts: SamplerFacts | None
    spec: str
    randomized: str
    n: int
    points: Array
    projected: Array | None
    spectrum: xr.Dataset
    curves: Mapping[str, xr.Dataset]
    quality: Mapping[str, tuple[str, float, float]]
    speed: float

    @property
    def rates(self) -> dict[str, tuple[float, float, float]]:
        """Rate of the variance by integrand, with the ends of its interval."""
        return {
            text: (float(curve["rate"]), *map(float, curve["rate_ci"].values))  # type: ignore[misc]
            for text, curve in self.curves.items()
        }


def all_samplers(dims: Sequence[int] = (2, 1, 3)) -> list[str]:
    """Return the specs of all samplers without required parameters that support one of `dims`."""
    return sorted(spec for spec in (*SAMPLERS, *_ALSO) if _makeable(spec, dims))


def write_cards(
    folder: str | Path,
    specs: Sequence[str] | None = None,
    *,
    effort: CardEffort = FULL,
    rng: int = 0,
) -> Path:
    """Measure samplers and write their cards as a Markdown page for the documentation.

    Parameters
    ----------
    folder
        Output folder. It gets ``index.md``, ``*.png`` and ``gallery.json``, replacing older files.
    specs
        Specs of samplers. Default: `all_samplers`.
    effort
        Numbers of points and realizations.
    rng
        Integer seed.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    McspectraError
        If a sampler cannot be created or measured. The message gives the reason.
    StoreError
        If the folder cannot be written.
    """
    chosen = all_samplers() if specs is None else list(specs)
    if not chosen:
        raise ParameterError("The list of samplers is empty; give at least one.")
    cards = []
    for i, spec in enumerate(chosen):
        report("cards", i / len(chosen))
        cards.append(measure_card(spec, effort=effort, rng=rng))
    report("cards", 1.0)
    root = Path(folder)
    # Write the numbers to a JSON file
    numbers = [
        {
            "name": card.name,
            "spec": card.spec,
            "randomized": card.randomized,
            "n": card.n,
            "facts": asdict(card.facts) if card.facts else None,
            "rates": card.rates,
            "quality": card.quality,
            "points_per_second": card.speed,
        }
        for card in cards
    ]
    html.write_json(root / "gallery.json", numbers)

    # Write the Markdown page and one image per sampler
    names, page = html.anchors(card.name for card in cards), root / "index.md"
    lines = ["# Samplers", "", _settings(effort), ""]
    with writing(root, StoreError):
        for card, name in zip(cards, names, strict=True):
            plot, summary = _card_plot(card), card.facts.summary if card.facts else ""
            png, _ = backend_matplotlib.encode(backend_matplotlib.draw(plot), with_pdf=False)
            (root / f"{name}.png").write_bytes(png)
            lines += [f"## `{card.name}`", "", summary, "", f"![{plot.words}]({name}.png)", ""]
            facts = "\n".join(f"* {name}: {value}" for name, value in _card_facts(card))
            lines += [ADDRESS.sub(r"<\g<0>>", facts), ""]
        page.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    return page


def measure_card(spec: str, *, effort: CardEffort = FULL, rng: int = 0) -> Card:
    """Measure a sampler in 2-D, or else in the number of dims that it supports.

    Raises
    ------
    McspectraError
        If the spec cannot be read, or a required parameter is missing.
    """
    name = parse_chain(spec)[0].name
    source = _in_two_dims(spec)
    light = shared_sets(source)
    n = source.nearest_count(effort.n)
    counts = {light.nearest_count(each) for each in effort.counts or (n,)}
    free = light if light.unbiased else randomized(light, sorted(counts))[0]
    slow = light != source
    wide = round(2.0 * n ** (1.0 / light.dims))
    several, few = (
        different_realizations(light, n, Stream.from_rng(rng), most)
        for most in (SHARED_SETS if slow else effort.spectra, SHARED_SETS)
    )
    found = quality_figures(light, n, figures=tuple(QUALITY_HEADS), realizations=few, rng=rng)
    return Card(
        name=spec,
        facts=sampler_facts(name) if name in SAMPLERS else None,
        spec=source.spec,
        randomized=free.spec if effort.counts else "",
        n=n,
        points=light.draw(n, rng=rng)[0],
        projected=_projection(spec, n, rng),
        spectrum=power_spectrum(light, n, half_width=wide, realizations=several, rng=rng),
        curves=_curves(source.dims, free, effort, rng, slow=slow) if effort.counts else {},
        quality={
            figure.name: (figure.long_name, figure.mean, figure.standard_error)
            for figure in summarize(found)
            if not figure.missing
        },
        speed=n / making_seconds(source, n, rng),
    )


def _in_two_dims(spec: str) -> Sampler:
    """Create the sampler in 2-D, or else in 1-D or 3-D. If all fail, raise the error of 2-D."""
    reason: McspectraError | None = None
    for dims in (2, 1, 3):
        try:
            return sampler(spec, dims)
        except McspectraError as error:
            reason = reason or error
    assert reason is not None
    raise reason


def _projection(spec: str, n: int, rng: int) -> Array | None:
    try:
        source = shared_sets(sampler(spec, _PROJECTED_DIMS))
        points: Array = source.draw(source.nearest_count(n), rng=rng)[0, :, 2:]
    # Leave out the projection if drawing fails, for example if a program prints too few coordinates
    except McspectraError:
        return None
    return points


def _curves(
    dims: int, source: Sampler, effort: CardEffort, rng: int, *, slow: bool
) -> dict[str, xr.Dataset]:
    """Measure convergence on some integrands. Empty if fewer than two counts are possible."""
    wanted = effort.slow_counts if slow else effort.counts
    counts = sorted({source.nearest_count(n) for n in wanted})
    if len(counts) < 2:
        return {}
    many = effort.slow_rates if slow else effort.rates
    return {
        text: convergence(Estimator(text, dims=dims), source, counts, realizations=many, rng=rng)
        for text in _INTEGRANDS.get(dims, ("gaussian",))
    }


def _makeable(spec: str, dims: Sequence[int]) -> bool:
    """Whether a sampler supports one of the given `dims` without a file or another package."""
    if spec in ("points", "scipy", "qmcpy", "mitsuba"):
        return False
    for d in dims:
        with suppress(ParameterError, MissingDependency):
            sampler(spec, d)
            return True
    return False


def card_sections(cards: Sequence[Card], anchors: Sequence[str]) -> list[html.Section]:
    """Return a section of a page for each card."""
    sections = []
    for card, anchor in zip(cards, anchors, strict=True):
        facts = []
        for name, value in _card_facts(card):
            text = ADDRESS.sub(r'<a href="\g<0>">\g<0></a>', escape_html(value))
            facts.append((name, html.Markup(text)))
        blocks: tuple[html.Block, ...] = (
            html.Paragraph(text=card.facts.summary if card.facts else ""),
            *html.figures_of([_card_plot(card)]),
            html.FactList(rows=tuple(facts)),
        )
        sections.append(html.Section(title=card.name, anchor=anchor, blocks=blocks, code=True))
    return sections


def _card_plot(card: Card) -> Plot:
    """Return the plot of a card, with a description for screen readers."""
    points = dataset({"points": (("point", "axis"), card.points)}, {}, n=card.n)
    power = card.n * card.spectrum["radial_power"].values
    words = (
        f"{card.n} points of {card.name}; their power spectrum; its radial mean, where n · power "
        f"is {number(float(power[0]))} at the lowest and {number(float(power[-1]))} at the highest "
        "frequencies; and sections along the axes and the diagonal"
    )
    plot = sampler_card({"points": points, "spectrum": card.spectrum}, card.projected)
    return replace(plot, words=words, wide=True)


def _card_facts(card: Card) -> list[tuple[str, str]]:
    """Return the properties of a sampler for its card, as pairs (label, text)."""
    step = card.randomized.rpartition(" | ")[2]
    measured = f" (randomized by {step})" if card.randomized not in ("", card.spec) else ""
    rates = card.rates
    if card.randomized and not rates:
        rates = dict.fromkeys(_INTEGRANDS.get(card.points.shape[1], ("gaussian",)), (math.nan,) * 3)
    facts = [
        ("Dims", card.facts.dims if card.facts else ""),
        ("Counts", card.facts.counts if card.facts else ""),
        *((f"Rate on {text.partition('(')[0]}{measured}", rate(*v)) for text, v in rates.items()),
        # Omit a standard error at rounding level
        *(
            (name, with_error(mean, se if se > NEGLIGIBLE * abs(mean) else None))
            for name, mean, se in card.quality.values()
        ),
        ("Speed", f"{number(card.speed, 2)} points/s at n = {card.n}"),
        ("Source", card.facts.sources if card.facts else ""),
    ]
    return [(name, value) for name, value in facts if value]


def _settings(effort: CardEffort) -> str:
    """Describe in words how the results on the cards of samplers were measured."""
    low, high = effort.counts[0], effort.counts[-1]
    return (
        f"Each card shows a set of n ≈ {effort.n} points in 2-D, or in the only number of dims "
        f"that the sampler supports.\nSpectra are means over {effort.spectra} realizations; "
        "n · power is 1 for random points.\n"
        "Rates are exponents of the variance in n with 95 % intervals, measured with "
        f"{effort.rates} realizations for n = {low} … {high}.\n"
        "For rates, deterministic sets are randomized first: nets and digit sequences by owen, "
        "others by shift.\n"
        "Optimized samplers have 8 sets per n; further realizations are shifted copies "
        f"(n ≤ {effort.slow_counts[-1]}).\nSpeeds are measured with one thread."
    )
