"""List what can be named in specs, and the analyses."""

from __future__ import annotations

import argparse
import importlib
import inspect
from typing import Any

from mcspectra.cli.common import Answer, adder
from mcspectra.core.checks import as_choice

__all__ = ["add_arguments", "run"]

_REGISTRIES = {
    "samplers": ("mcspectra.samplers", "SAMPLERS"),
    "randomizations": ("mcspectra.samplers", "RANDOMIZATIONS"),
    "densities": ("mcspectra.densities", "DENSITIES"),
    "integrands": ("mcspectra.integrands", "INTEGRANDS"),
    "scenes": ("mcspectra.rendering", "SCENES"),
    "analyses": ("mcspectra.core.analysis", "ANALYSES"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    adder(parser)("kind", f"one of {', '.join(_REGISTRIES)}")


def run(options: argparse.Namespace) -> Answer:
    """Give names, parameters and summaries."""
    kind = as_choice("kind", options.kind, tuple(_REGISTRIES))
    module, name = _REGISTRIES[kind]
    registry = getattr(importlib.import_module(module), name)
    rows = [_row(kind, registry, name) for name in registry]
    widest, lines = max(len(row["name"]) for row in rows), []
    for row in rows:
        lines.append(f"{row['name'].ljust(widest)}  {row['summary']}")
        more = (", ".join(row["parameters"]), _abilities(row))
        lines += [f"{'':{widest}}    {line}" for line in more if line]
    return Answer("\n".join(lines), rows)


def _abilities(row: dict[str, Any]) -> str:
    """The dims and counts of a sampler, or the verb of an analysis, in a line."""
    if row.get("verb"):
        return f"mcspectra {row['verb']}"
    return f"dims: {row['dims']}; n: {row['counts']}" if "dims" in row else ""


def _row(kind: str, registry: Any, name: str) -> dict[str, Any]:
    """One component; one that cannot be loaded says why in its summary."""
    from mcspectra.core.errors import MissingDependency

    try:
        return _described(kind, registry, name)
    except MissingDependency as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - components from elsewhere may raise anything
        reason = f"{registry[name]} is no {registry.kind} ({type(error).__name__})"
    return {"name": name, "summary": f"not available: {reason}", "parameters": []}


def _described(kind: str, registry: Any, name: str) -> dict[str, Any]:
    cls = registry.load(name)
    row: dict[str, Any] = {
        "name": name,
        "summary": (inspect.getdoc(cls) or cls.__name__).splitlines()[0],
        "parameters": [
            p.name.rstrip("_") if p.default is p.empty else f"{p.name.rstrip('_')}={p.default!r}"
            for p in inspect.signature(cls).parameters.values()
        ],
    }
    if kind == "samplers":
        from mcspectra.samplers.facts import sampler_facts

        facts = sampler_facts(name)
        row |= {"dims": facts.dims, "counts": facts.counts}
    if kind == "analyses":
        row |= {"verb": cls.verb, "function": cls.function, "about": cls.about}
    return row
