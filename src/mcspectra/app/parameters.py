"""Specs as sliders and lists see them: names that can be chosen, numbers that can be moved."""

from __future__ import annotations

from collections.abc import Sequence

from mcspectra.core.errors import McspectraError
from mcspectra.core.spec import Call, parse, parse_chain

__all__ = ["DENSITY_SLIDERS", "Range", "base_and_steps", "chain", "changed", "moved"]

Range = tuple[str, float, float, float]
"""Parameter, least, most, and its default value."""

DENSITY_SLIDERS: dict[str, tuple[Range, ...]] = {
    "linear": (("slope", -1.9, 1.9, 1.0),),
    "power": (("exponent", 0.0, 4.0, 1.0),),
    "exponential": (("rate", 0.1, 8.0, 1.0),),
    "truncated-normal": (("mean", 0.0, 1.0, 0.5), ("sigma", 0.05, 1.0, 0.2)),
    "tent": (("peak", 0.05, 0.95, 0.5),),
}
"""Parameters of densities that have sliders."""


def base_and_steps(text: str) -> tuple[str, list[str]]:
    """Return the names of a chain's sampler and of its randomisations.

    Raises
    ------
    SpecError
        Not a chain.
    """
    first, *rest = parse_chain(text)
    return first.name, [call.name for call in rest]


def chain(base: str, steps: Sequence[str], text: str) -> str:
    """Write a chain of these names; those that `text` has already keep their parameters."""
    try:
        known = {call.name: _format(call) for call in parse_chain(text)}
    except McspectraError:
        known = {}
    return " | ".join(known.get(name, name) for name in (base, *steps))


def moved(text: str, ranges: Sequence[Range]) -> dict[str, float]:
    """Return where the sliders of a density stand: its single numbers, else the default."""
    given = parse(text).arguments
    found = {}
    for key, low, high, default in ranges:
        value = given.get(key, default)
        number = isinstance(value, int | float) and low <= value <= high
        found[key] = float(value) if number else default
    return found


def changed(text: str, key: str, value: float | str) -> str:
    """Return the spec with one parameter changed."""
    call = parse(text)
    return _format(Call(call.name, {**call.arguments, key: value}))


def _format(call: Call) -> str:
    shown = ", ".join(f"{key}={value!r}" for key, value in call.arguments.items())
    return f"{call.name}({shown})" if shown else call.name
