"""List what can be named in specs."""

from __future__ import annotations

import argparse
import inspect
from typing import Any

from mcspectra.cli.common import print_json
from mcspectra.core.checks import as_choice

__all__ = ["add_arguments", "run"]

_KINDS = ("samplers", "randomizations", "densities", "integrands", "scenes")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("kind", help=f"one of {', '.join(_KINDS)}")


def run(options: argparse.Namespace) -> int:
    """Print names, parameters and summaries."""
    kind = as_choice("kind", options.kind, _KINDS)
    rows = _rows(kind, _registry(kind))
    if options.json:
        print_json(rows)
    elif not options.quiet:
        widest = max(len(row["name"]) for row in rows)
        for row in rows:
            print(f"{row['name'].ljust(widest)}  {row['summary']}")
            for line in filter(None, (", ".join(row["parameters"]), _abilities(row))):
                print(f"{'':{widest}}    {line}")
    return 0


def _abilities(row: dict[str, Any]) -> str:
    """The dims and counts of a sampler, in a line."""
    return f"dims: {row['dims']}; n: {row['counts']}" if "dims" in row else ""


def _registry(kind: str) -> Any:
    if kind in ("samplers", "randomizations"):
        from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS

        return SAMPLERS if kind == "samplers" else RANDOMIZATIONS
    if kind == "densities":
        from mcspectra.densities import DENSITIES

        return DENSITIES
    if kind == "scenes":
        from mcspectra.rendering import SCENES

        return SCENES
    from mcspectra.integrands import INTEGRANDS

    return INTEGRANDS


def _rows(kind: str, registry: Any) -> list[dict[str, Any]]:
    """One object a name; a component that cannot be loaded says why in its summary."""
    return [_row(kind, registry, name) for name in registry]


def _row(kind: str, registry: Any, name: str) -> dict[str, Any]:
    from mcspectra.core.errors import MissingDependency

    try:
        return _described(kind, registry, name)
    except MissingDependency as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - components from elsewhere may raise anything
        reason = f"{registry[name]} is no {registry.kind} ({type(error).__name__})"
    return {"name": name, "summary": f"not available: {reason}", "parameters": []}


def _described(kind: str, registry: Any, name: str) -> dict[str, Any]:
    from mcspectra.samplers.facts import sampler_facts

    cls = registry.load(name)
    parameters = [
        p.name.rstrip("_") if p.default is p.empty else f"{p.name.rstrip('_')}={p.default!r}"
        for p in inspect.signature(cls).parameters.values()
    ]
    row: dict[str, Any] = {"name": name, "summary": _summary(cls), "parameters": parameters}
    if kind == "samplers":
        facts = sampler_facts(name)
        row |= {"dims": facts.dims, "counts": facts.counts}
    return row


def _summary(component: Any) -> str:
    """First line of the docstring; scenes are functions."""
    if isinstance(component, type):
        return str(component.summary())  # type: ignore[attr-defined]
    return (inspect.getdoc(component) or component.__name__).splitlines()[0]
