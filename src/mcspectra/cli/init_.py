"""Write a study file to begin with: commented, and it runs as it is."""

from __future__ import annotations

import argparse

from mcspectra.cli.common import Answer, adder

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    adder(parser)("FILE", "default study.toml", nargs="?", default="study.toml")


def run(options: argparse.Namespace) -> Answer:
    """Write it, unless something is there."""
    from mcspectra.studies.schema import write_template

    file = write_template(options.file)
    return Answer(f"{file}: run it with 'mcspectra run {file}'.", {"file": file})
