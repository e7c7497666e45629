"""Immutable state of the explorer, which is converted to and from the query string of a URL.

A state has one set-up A, or two set-ups A and B to compare.
The query string contains only fields that differ from their defaults, and can be bookmarked.
In the query string, the fields of B have the prefix ``b.``.
Anybody may have written a URL. Sizes are therefore limited, and specs must not name files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, final
from urllib.parse import parse_qsl, urlencode

from mcspectra.app.specs import check_spec
from mcspectra.core.checks import as_choice, as_instance, as_integer
from mcspectra.core.errors import ParameterError, close_match_hint
from mcspectra.core.fields import check_fields, checked, choice, real, whole
from mcspectra.core.options import options_of
from mcspectra.measure.converge import Convergence
from mcspectra.measure.terms import Terms
from mcspectra.prediction.prediction import Prediction
from mcspectra.spectra.power import Points, Spectrum

__all__ = [
    "ANALYSES",
    "CHANNELS",
    "MIRRORS",
    "MOST_HALF_WIDTH",
    "MOST_POINTS",
    "OPTIONS",
    "THEMES",
    "ExplorerSetup",
    "ExplorerState",
]

ANALYSES = {
    "points": Points,
    "spectrum": Spectrum,
    "convergence": Convergence,
    "terms": Terms,
    "predict": Prediction,
}
"""Analyses that the page shows, by the names of their tables in study files."""

_KNOWN = {
    option.name: option
    for name, kind in ANALYSES.items()
    if name != "predict"  # the page does not show methods that need realizations
    for option in options_of(kind)
}

MIRRORS = ("none", "integrand", "random", "uniform")
CHANNELS = ("luminance", "0", "1", "2")
THEMES = ("auto", "light", "dark")

MOST_POINTS = 2**16
"""Maximum number of points per set in the explorer. Studies accept more."""

MOST_HALF_WIDTH = {1: 1024, 2: 128}
"""Largest half width of the frequencies, by number of dims."""

_MOST_REALIZATIONS = 2**14
_MOST_QUERY = 8000
_MOST_SEED = 2**63
_PREFIX = "b."


def _option(name: str) -> Any:
    """Declare the field for an option. If its value is None, the explorer chooses it."""
    option = _KNOWN[name]
    return checked(
        lambda _, given: option.check(given), None if option.required else option.default
    )


def _as_half_width(name: str, given: object, dims: int) -> int:
    return as_integer(name, given, least=1, most=MOST_HALF_WIDTH[dims])


@final
@dataclass(frozen=True, kw_only=True)
class ExplorerSetup:
    """An estimator, a sampler, a number of points, and settings of the analyses.

    If a field and an option of an analysis have the same name, they also have the same meaning.

    Parameters
    ----------
    sampler, density, integrand
        Specs, which must not name files. The integrand may be ``upload(digest='…')``.
        A sum of techniques is ``technique-sum(integrands=['…', '…'])``.
    n
        Points per set.
    dims
        Number of dims, 1 or 2.
    strata_shift
        Shift of all points as a fraction of a stratum, in [0, 1). 0 means no shift.
    mirror
        ``"none"`` or a mode of `mcspectra.Mirrored`.
    channel
        Channel to show if the integrand has several: ``"luminance"``, or a number as text.
    smoothing
        Width of the ramps that replace edges. 0 means no ramps.
    realizations
        Number of realizations in the last round.
    seed
        Seed of all random draws.

    Raises
    ------
    ParameterError, SpecError
        If a value has the wrong type or range, or a spec cannot be read or names a file.
    """

    sampler: str = "jittered"
    n: int = whole(256, least=1, most=MOST_POINTS)
    density: str = "uniform"
    integrand: str = "gaussian"
    dims: int = whole(2, least=1, most=2)
    strata_shift: float = real(0.0, least=0.0, below=1.0)
    mirror: str = choice(*MIRRORS)
    channel: str = choice(*CHANNELS)
    smoothing: float = real(0.0, least=0.0, most=1.0)
    realizations: int = whole(1024, least=2, most=_MOST_REALIZATIONS)
    seed: int = whole(0, least=0, most=_MOST_SEED)
    basis: str = _option("basis")
    half_width: int = checked(_as_half_width, 64, using="dims")
    frequency_step: float = _option("frequency_step")
    space: str | None = _option("space")
    bands: str = _option("bands")
    counts: tuple[int, ...] | None = _option("counts")
    fit_last: int | str | None = _option("fit_last")
    engine: str = _option("engine")
    eps: float = _option("eps")

    def __post_init__(self) -> None:
        for name in ("sampler", "density", "integrand"):
            check_spec(name, getattr(self, name))
        check_fields(self)
        if self.counts and max(self.counts) > MOST_POINTS:
            raise ParameterError(
                f"counts may be at most {MOST_POINTS} in the explorer; give smaller ones."
            )
        as_instance("bands", self.bands, str, ", ".join(_KNOWN["bands"].choices))

    @property
    def displaced_sampler(self) -> str:
        """Spec of the sampler, including the shift of the strata."""
        if not self.strata_shift:
            return self.sampler
        return f"{self.sampler} | strata-shift(offset={self.strata_shift!r})"

    def differences(self) -> dict[str, str]:
        """Return the fields that differ from their defaults, as texts."""
        return {
            each.name: self.text(each.name)
            for each in dataclasses.fields(self)
            if getattr(self, each.name) != each.default
        }

    @staticmethod
    def from_texts(texts: Mapping[str, str]) -> ExplorerSetup:
        """Create a set-up from texts by field. All other fields get their defaults.

        Raises
        ------
        ParameterError
            If a field is unknown, or a text is not a number although a number is needed.
            If `ExplorerSetup` rejects a value.
        """
        return ExplorerSetup(
            **{name: ExplorerSetup.read(name, text) for name, text in texts.items()}
        )

    @staticmethod
    def read(name: str, text: str) -> Any:
        """Convert a text to the value of a field. For an option, an empty text gives the default.

        Raises
        ------
        ParameterError
            If the field does not exist, or `text` is not a number although the field needs one.
        """
        defaults = {each.name: each.default for each in dataclasses.fields(ExplorerSetup)}
        if name not in defaults:
            hint, close = close_match_hint(name, defaults)
            known = hint if close else f" Known keys are {', '.join(defaults)}."
            raise ParameterError(f"The address has an unknown key {name[:40]!r}.{known}")
        kind: Any = type(defaults[name])
        if name in OPTIONS:
            return OPTIONS[name].read(text, name) if text.strip() else defaults[name]
        if kind is str:
            return text
        try:
            return kind(text)
        except ValueError:
            what = "whole number" if kind is int else "number"
            raise ParameterError(f"{name} is {text[:40]!r}; give a {what}.") from None

    def text(self, name: str) -> str:
        """Return the value of a field as text that `read` accepts."""
        value = getattr(self, name)
        if value is None:
            return ""
        return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


OPTIONS = {
    name: _KNOWN[name]
    for name in (each.name for each in dataclasses.fields(ExplorerSetup))
    if name in _KNOWN and name not in ("n", "realizations")
}
"""Options of the analyses that can be set on the page."""


@final
@dataclass(frozen=True, kw_only=True)
class ExplorerState:
    """State of the explorer: set-up A, perhaps a set-up B, and the theme.

    By default, the browser chooses the theme.

    Examples
    --------
    >>> state = ExplorerState(a=ExplorerSetup(n=64), b=ExplorerSetup(sampler="sobol | owen"))
    >>> state.query()
    'n=64&b.sampler=sobol+%7C+owen'
    >>> ExplorerState.from_query(state.query()) == state
    True
    """

    a: ExplorerSetup = field(default_factory=ExplorerSetup)
    b: ExplorerSetup | None = None
    theme: str = THEMES[0]

    def __post_init__(self) -> None:
        for name, setup, kinds in (
            ("a", self.a, ExplorerSetup),
            ("b", self.b, ExplorerSetup | None),
        ):
            as_instance(name, setup, kinds, "an ExplorerSetup")
        as_choice("theme", self.theme, THEMES)

    def setups(self) -> Iterator[tuple[str, ExplorerSetup]]:
        """Yield ``"A"`` with its set-up, and ``"B"`` with its set-up if there is one."""
        yield "A", self.a
        if self.b is not None:
            yield "B", self.b

    def query(self) -> str:
        """Return the query string for `from_query`, without a question mark."""
        pairs = list(self.a.differences().items())
        if self.b is not None:
            # If set-up B has only default values, the query contains n of B, to show that B exists
            own = self.b.differences() or {"n": str(self.b.n)}
            pairs += [(_PREFIX + key, text) for key, text in own.items()]
        if self.theme != THEMES[0]:
            pairs.append(("theme", self.theme))
        return urlencode(pairs)

    @staticmethod
    def from_query(query: str) -> ExplorerState:
        """Read a query string, with or without a question mark.

        Raises
        ------
        ParameterError, SpecError
            If the query is too long, repeats a field, or has an unknown field or an invalid value.
        """
        if len(query) > _MOST_QUERY:
            raise ParameterError(
                f"The address is longer than {_MOST_QUERY} characters; shorten its specs."
            )
        query = query.removeprefix("?")
        try:
            pairs = parse_qsl(
                query, keep_blank_values=True, strict_parsing=bool(query), errors="strict"
            )
        except ValueError:  # includes UnicodeDecodeError
            raise ParameterError(
                "The address cannot be read; after '?' it needs key=value pairs joined by '&'."
            ) from None
        given = dict(pairs)
        if len(given) < len(pairs):
            raise ParameterError("The address holds a key twice; give each key once.")
        theme = given.pop("theme", THEMES[0])
        b = {key[len(_PREFIX) :]: t for key, t in given.items() if key.startswith(_PREFIX)}
        a = {key: text for key, text in given.items() if not key.startswith(_PREFIX)}
        other = ExplorerSetup.from_texts(b) if b else None
        return ExplorerState(a=ExplorerSetup.from_texts(a), b=other, theme=theme)
