"""List what can be named in specs."""

from __future__ import annotations

import argparse
import inspect
from typing import Any

from mcspectra.cli.common import print_json
from mcspectra.core.checks import as_choice

__all__ = ["add_arguments", "run"]

_KINDS = ("samplers", "randomizations", "densities", "integrands")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("kind", help=f"one of {', '.join(_KINDS)}")


def run(options: argparse.Namespace) -> int:
    """Print names, parameters and summaries."""
    rows = _rows(_registry(as_choice("kind", options.kind, _KINDS)))
    if options.json:
        print_json(rows)
    elif not options.quiet:
        table = [[r["name"], r["summary"], ", ".join(r["parameters"])] for r in rows]
        widest = max(len(row[0]) for row in table)
        for name, summary, parameters in table:
            print(f"{name.ljust(widest)}  {summary}")
            if parameters:
                print(f"{'':{widest}}    {parameters}")
    return 0


def _registry(kind: str) -> Any:
    if kind in ("samplers", "randomizations"):
        from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS

        return SAMPLERS if kind == "samplers" else RANDOMIZATIONS
    if kind == "densities":
        from mcspectra.densities import DENSITIES

        return DENSITIES
    from mcspectra.integrands import INTEGRANDS

    return INTEGRANDS


def _rows(registry: Any) -> list[dict[str, Any]]:
    """One object a name; a component that cannot be loaded says why in its summary."""
    from mcspectra.core.errors import MissingDependency

    rows = []
    for name in registry:
        try:
            cls = registry.load(name)
        except MissingDependency as error:
            rows.append({"name": name, "summary": f"not available: {error}", "parameters": []})
            continue
        parameters = [
            p.name.rstrip("_") if p.default is p.empty else f"{p.name.rstrip('_')}={p.default!r}"
            for p in inspect.signature(cls).parameters.values()
        ]
        rows.append({"name": name, "summary": cls.summary(), "parameters": parameters})
    return rows
