"""Facts about a registered sampler, found by trying it: dims, counts, sources."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from typing import final

from mcspectra.core.references import written_out
from mcspectra.core.spec import Call
from mcspectra.samplers.base import Sampler
from mcspectra.samplers.registry import SAMPLERS

__all__ = ["SamplerFacts", "sampler_facts"]

_DIMS_TRIED = 8
_COUNTS_TRIED = 100
_COUNTS_SHOWN = 6


@final
@dataclass(frozen=True, kw_only=True)
class SamplerFacts:
    """Name, summary, dims, counts and sources of a sampler in words.

    Attributes
    ----------
    dims
        Allowed numbers of dims, such as ``any`` or ``1–1111``; ``as given`` if a parameter sets it.
    counts
        Allowed counts, such as ``any`` or ``1, 4, 9, 16, …`` (in 2-D if the sampler allows 2-D).
    sources
        References of the docstring in one line: authors, year, title and address of each work.
    """

    name: str
    summary: str
    dims: str
    counts: str
    sources: str


def sampler_facts(name: str) -> SamplerFacts:
    """Return the facts of a registered sampler with its default parameters.

    Raises
    ------
    UnknownName
        If the name is not registered.
    MissingDependency
        If the sampler needs a package that is not installed.
    """
    cls = SAMPLERS.load(name)
    made = {dims: _made(name, dims) for dims in range(1, _DIMS_TRIED + 1)}
    possible = {dims: sampler for dims, sampler in made.items() if sampler is not None}
    shown = possible.get(2) or next(iter(possible.values()), None)
    return SamplerFacts(
        name=name,
        summary=cls.summary(),
        dims=_dims_in_words(list(possible), cls.max_dims),
        counts="as given" if shown is None else _counts_in_words(shown),
        sources=_sources(cls),
    )


def _made(name: str, dims: int) -> Sampler | None:
    try:
        return SAMPLERS.build(Call(name, {}), dims)  # type: ignore[no-any-return]
    except Exception:  # noqa: BLE001 - external samplers may raise anything
        return None


def _dims_in_words(dims: list[int], most: int | None) -> str:
    if not dims:
        return "as given"
    low, high = dims[0], dims[-1]
    if high == _DIMS_TRIED:
        high = most or 0
    if low == 1 and not high:
        return "any"
    return str(low) if low == high else f"{low}–{high or '…'}"


def _counts_in_words(sampler: Sampler) -> str:
    asked = range(1, _COUNTS_TRIED + 1)
    possible = [n for n in asked if n in sampler._counts_near(n)]
    if len(possible) == _COUNTS_TRIED:
        balanced = [n for n in asked if sampler._count_warning(n) is None]
        return "any" if len(balanced) == _COUNTS_TRIED else f"any; balanced: {_first(balanced)}"
    if possible == [*range(possible[0], _COUNTS_TRIED + 1)]:
        return f"{possible[0]} and more"
    return _first(possible)


def _first(counts: list[int]) -> str:
    return ", ".join(map(str, counts[:_COUNTS_SHOWN])) + ", …"


def _sources(cls: type) -> str:
    """Return the References section of a numpydoc docstring as one line."""
    text = inspect.cleandoc(cls.__doc__ or "")
    match = re.search(
        r"^References\n-+\n(.*?)(?=^\w[^\n]*\n-+\n|\Z)", text, re.MULTILINE | re.DOTALL
    )
    return written_out(match.group(1)).rstrip(".") if match else ""
