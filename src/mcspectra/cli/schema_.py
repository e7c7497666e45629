"""Print the JSON Schema of study files, for editors and checkers."""

from __future__ import annotations

import argparse
import json

from mcspectra.cli.common import Answer, adder

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    adder(parser)("--markdown", "print all keys as tables of docs/studies.md")


def run(options: argparse.Namespace) -> Answer:
    """Print."""
    from mcspectra.studies.schema import key_tables, study_schema

    if options.markdown:
        return Answer(key_tables())
    return Answer(json.dumps(study_schema(), indent=2, ensure_ascii=False))
