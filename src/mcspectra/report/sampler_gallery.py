"""A gallery of samplers: a card each, as one offline page or as Markdown with pictures."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import MissingDependency, ParameterError, StoreError
from mcspectra.core.progress import report
from mcspectra.report.encode import encode
from mcspectra.report.figures.samplers import sampler_card
from mcspectra.report.formatting import number, rate, slug
from mcspectra.report.html import page_template
from mcspectra.report.sampler_cards import FULL, Card, Effort, measure_card
from mcspectra.samplers import SAMPLERS, sampler
from mcspectra.version import __version__

__all__ = ["FORMATS", "gallery_specs", "write_gallery"]

FORMATS = ("html", "markdown")

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
"""Beside every registered sampler: what is used as often."""


def gallery_specs() -> list[str]:
    """Return the specs of the whole gallery: registered samplers that need no parameters, and more."""
    return sorted([*filter(_makeable, SAMPLERS), *_ALSO])


def write_gallery(
    folder: str | Path,
    specs: Sequence[str] | None = None,
    *,
    effort: Effort = FULL,
    format: str = "html",
    rng: int = 0,
) -> Path:
    """Measure samplers and write their cards.

    Parameters
    ----------
    folder
        Where ``index.html``, or ``index.md`` and ``*.png``, and ``gallery.json`` go; what is there
        under these names is replaced.
    specs
        Samplers, your own beside known ones: ``points(path='mine.dat')``. All by default.
    effort
        How much is drawn.
    format
        ``html`` (one page that stands alone) or ``markdown``.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    McspectraError
        A sampler cannot be made or measured; the message says why.
    StoreError
        The folder cannot be written.
    """
    as_choice("format", format, FORMATS)
    chosen = gallery_specs() if specs is None else list(specs)
    if not chosen:
        raise ParameterError("The gallery is empty; name a sampler at least.")
    root, cards, pictures = Path(folder), [], []
    for i, spec in enumerate(chosen):
        report("gallery", i / len(chosen))
        card = measure_card(spec, effort=effort, rng=rng)
        cards.append(card)
        pictures.append(encode(sampler_card(card.points, card.spectrum, card.projected))[0])
    report("gallery", 1.0)
    try:
        root.mkdir(parents=True, exist_ok=True)
        (root / "gallery.json").write_text(_json(cards), encoding="utf-8")
        write = _write_markdown if format == "markdown" else _write_html
        return write(root, cards, pictures, effort)
    except OSError as error:
        raise StoreError(
            f"The gallery cannot be written to {str(root)!r}: {error.strerror}."
        ) from None


def _makeable(name: str) -> bool:
    """Whether a registered sampler needs nothing from outside: no file, no other package."""
    if name in ("points", "scipy", "qmcpy", "mitsuba"):
        return False
    try:
        return any(_made(name, dims) for dims in (2, 1, 3))
    except MissingDependency:
        return False


def _made(name: str, dims: int) -> bool:
    try:
        sampler(name, dims)
    except ParameterError:
        return False
    return True


def _card_facts(card: Card) -> dict[str, str]:
    """Return what a card says in words, by what it is about."""
    facts = {
        "Dims": card.facts.dims if card.facts else "",
        "Counts": card.facts.counts if card.facts else "",
        **{_rate_name(text, card): rate(*values) for text, values in card.rates.items()},
        **{name: _with_error(mean, se) for name, mean, se in card.quality.values()},
        "Speed": f"{number(card.speed, 2)} points/s at n = {card.n}",
        "Source": card.facts.sources if card.facts else "",
    }
    return {name: value for name, value in facts.items() if value}


def _rate_name(text: str, card: Card) -> str:
    measured = "" if card.randomized == card.spec else " (randomised)"
    return f"Rate on {text.partition('(')[0]}{measured}"


def _with_error(mean: float, se: float) -> str:
    return number(mean) if not math.isfinite(se) or se == 0 else f"{number(mean)} ± {number(se, 1)}"


def _settings(effort: Effort) -> str:
    """How the cards were made, in a sentence or two."""
    low, high = effort.counts[0], effort.counts[-1]
    return (
        f"Each set has n ≈ {effort.n} points in 2-D (or in the only dims it can do). Spectra are "
        f"means over {effort.spectra} realisations, n · power is 1 for random points. Rates are "
        f"exponents of the variance in n with 95 % intervals, for n = {low} … {high} and "
        f"{effort.rates} realisations; sets that are the same every time are randomised first, by "
        "owen (nets) or shift. Optimised sets are 8 for each n, used again under random "
        f"translations, for n up to {effort.slow_counts[-1]}. Speeds are of one thread."
    )


def _write_html(root: Path, cards: list[Card], pictures: list[bytes], effort: Effort) -> Path:
    page = root / "index.html"
    shown = [
        {
            "name": card.name,
            "anchor": slug(card.name),
            "summary": _summary(card),
            "facts": _card_facts(card),
            "picture": base64.b64encode(png).decode("ascii"),
            "alt": _in_words(card),
        }
        for card, png in zip(cards, pictures, strict=True)
    ]
    template = page_template("samplers.html.j2")
    text = template.render(cards=shown, settings=_settings(effort), version=__version__)
    page.write_text(text, encoding="utf-8")
    return page


def _write_markdown(root: Path, cards: list[Card], pictures: list[bytes], effort: Effort) -> Path:
    page = root / "index.md"
    lines = ["# Samplers", "", _settings(effort), ""]
    for card, png in zip(cards, pictures, strict=True):
        (root / f"{slug(card.name)}.png").write_bytes(png)
        lines += _markdown(card)
    page.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    return page


def _markdown(card: Card) -> Iterator[str]:
    yield from (f"## `{card.name}`", "", _summary(card), "")
    yield from (f"![{_in_words(card)}]({slug(card.name)}.png)", "")
    yield from (f"* {name}: {value}" for name, value in _card_facts(card).items())
    yield ""


def _summary(card: Card) -> str:
    return card.facts.summary if card.facts else ""


def _in_words(card: Card) -> str:
    """What the picture shows, for those who do not see it."""
    power = card.n * card.spectrum["radial_power"].values
    return (
        f"{card.n} points of {card.name}, their spectrum, its radial mean (n times the power "
        f"{number(float(power[0]))} at the lowest frequencies, {number(float(power[-1]))} at the "
        "highest) and sections along axes and diagonal"
    )


def _json(cards: Sequence[Card]) -> str:
    return json.dumps([_plain(card) for card in cards], indent=1, ensure_ascii=False) + "\n"


def _plain(card: Card) -> dict[str, Any]:
    """What programs want: numbers, no pictures; NaN is null."""
    return {
        "name": card.name,
        "spec": card.spec,
        "randomized": card.randomized,
        "n": card.n,
        "facts": asdict(card.facts) if card.facts else None,
        "rates": {k: [_finite(v) for v in values] for k, values in card.rates.items()},
        "quality": {k: [name, _finite(a), _finite(b)] for k, (name, a, b) in card.quality.items()},
        "points_per_second": _finite(card.speed),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
