"""What several verbs share: reading options, writing tables and JSON."""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer, as_real
from mcspectra.core.errors import ParameterError

if TYPE_CHECKING:
    from mcspectra.estimators import AbstractEstimator
    from mcspectra.samplers import Sampler

__all__ = [
    "Once",
    "add_engine_argument",
    "add_estimator_arguments",
    "build_estimator",
    "counts_option",
    "index_or_name",
    "one_sentence_warnings",
    "print_json",
    "read_sampler",
    "real_number",
    "realizations_option",
    "seed_option",
    "text_table",
    "whole_number",
]


def whole_number(name: str, text: object, *, least: int = 1, most: int | None = None) -> int:
    """Read an option that must be a whole number."""
    try:
        return as_integer(name, int(str(text)), least=least, most=most)
    except ValueError:
        limit = f"from {least} to {most}" if most is not None else f"of at least {least}"
        raise ParameterError(f"{name} is {text!r}; give a whole number {limit}.") from None


def real_number(name: str, text: object) -> float:
    """Read an option that must be a positive number."""
    try:
        return as_real(name, float(str(text)), above=0.0)
    except ValueError:
        raise ParameterError(f"{name} is {text!r}; give a number greater than 0.") from None


def seed_option(options: argparse.Namespace) -> int:
    """Read --seed, 0 by default."""
    return 0 if options.seed is None else whole_number("--seed", options.seed, least=0)


class Once(argparse.Action):
    """An option that may be given once only, where argparse would take the last."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Store the value, or refuse a second one."""
        if getattr(namespace, self.dest) is not None:
            parser.error(f"{option_string} is given twice; give it once")
        setattr(namespace, self.dest, values)


def counts_option(text: str) -> list[int]:
    """Read comma-separated counts."""
    return [whole_number("--counts", part.strip()) for part in text.split(",")]


def read_sampler(text: str, dims: int | None) -> Sampler:
    """Read a sampler spec, or a point set in UTK text format from standard input for ``-``."""
    from mcspectra.samplers import GivenPoints, sampler

    first, bar, rest = text.partition("|")
    if first.strip() != "-":
        return sampler(text, dims)
    from mcspectra.core.pointfiles import parse_dat
    from mcspectra.core.spec import parse_chain
    from mcspectra.samplers import RANDOMIZATIONS

    if sys.stdin is None or sys.stdin.closed:
        raise ParameterError("'-' reads points from standard input, which is closed.")
    given: Any = GivenPoints.from_sets(
        parse_dat(sys.stdin.read(), "standard input"), "standard input"
    )
    for call in parse_chain(rest) if bar else []:
        given = given.then(RANDOMIZATIONS.build(call))
    return given  # type: ignore[no-any-return]


def realizations_option(text: object, sampler: Sampler, default: int) -> int:
    """Read --realizations; by default as many as there are sets where the points are given."""
    from mcspectra.samplers import GivenPoints

    if text is not None:
        return whole_number("--realizations", text)
    return len(sampler.points) if isinstance(sampler, GivenPoints) else default


def add_estimator_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe an estimator."""
    parser.add_argument("integrand", help="integrand spec, e.g. 'gaussian(width=0.25)'")
    parser.add_argument(
        "-d", "--dims", metavar="D", help="number of dims, where specs leave it open"
    )
    parser.add_argument(
        "--density", action="append", metavar="SPEC", help="density; several mean MIS"
    )
    parser.add_argument(
        "--heuristic",
        action=Once,
        metavar="SPEC",
        help="MIS: balance (default), power(beta=2), cutoff, maximum, optimal or variance-aware",
    )
    parser.add_argument(
        "--shares",
        action=Once,
        metavar="K,K,…",
        help="MIS: points of each technique, in units of n",
    )
    parser.add_argument(
        "--mirror",
        action=Once,
        metavar="MODE",
        help="mirror the integrand or the samples: integrand, random or uniform",
    )
    parser.add_argument(
        "--plus",
        action="append",
        metavar="SPEC",
        help="further integrand, sampled on its own and added (techniques in primary space)",
    )


def add_engine_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that chooses how transforms are computed."""
    parser.add_argument(
        "--engine", default="auto", help="auto (default), nufft, direct, or gpu (extra gpu)"
    )


def build_estimator(options: argparse.Namespace) -> AbstractEstimator:
    """Make the estimator that the options describe."""
    estimator = _plain_estimator(options)
    if options.mirror is None:
        return estimator
    from mcspectra.estimators import MIRRORINGS, Mirrored

    return Mirrored(estimator, as_choice("--mirror", options.mirror, MIRRORINGS))


def _plain_estimator(options: argparse.Namespace) -> AbstractEstimator:
    """The estimator before it is mirrored."""
    from mcspectra.estimators import Estimator, MultipleImportance, TechniqueSum

    dims = None if options.dims is None else whole_number("--dims", options.dims)
    densities = options.density or []
    for name, given in (("--heuristic", options.heuristic), ("--shares", options.shares)):
        if given is not None and len(densities) < 2:
            raise ParameterError(f"{name} is about several --density options; give two or more.")
    if options.plus:
        if densities:
            raise ParameterError("--plus adds whole techniques; it cannot be used with --density.")
        return TechniqueSum([options.integrand, *options.plus], dims=dims)
    if len(densities) > 1:
        return MultipleImportance(
            options.integrand,
            densities,
            heuristic=options.heuristic or "balance",
            counts=None if options.shares is None else _shares(options.shares, len(densities)),
            dims=dims,
        )
    return Estimator(options.integrand, densities[0] if densities else None, dims=dims)


def _shares(text: str, techniques: int) -> list[int]:
    shares = [whole_number("--shares", part.strip()) for part in text.split(",")]
    if len(shares) != techniques:
        raise ParameterError(
            f"--shares has {len(shares)} numbers for {techniques} densities; give one for each."
        )
    return shares


def index_or_name(text: str | None) -> int | str | None:
    """Return an option that is a number or a name: whole numbers as such, also negative ones."""
    digits = "" if text is None else text.removeprefix("-")
    return int(text) if text and digits.isdecimal() and len(digits) < 20 else text


def print_json(data: Any) -> None:
    """Print strict JSON: NaN and infinity become null."""
    print(json.dumps(_plain(data), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, complex):
        return {"re": _plain(value.real), "im": _plain(value.imag)}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Align columns with two blanks between; all but the first two to the right."""
    table = [list(header), *map(list, rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(header))]
    lines = []
    for row in table:
        cells = [
            cell.ljust(width) if i < 2 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


@contextmanager
def one_sentence_warnings(quiet: bool) -> Iterator[None]:
    """Show each warning once, as one line on standard error, or not at all."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: Any) -> None:
        if str(message) in seen:  # from another place in the code
            return
        seen.add(str(message))
        print(f"mcspectra: Warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if quiet else "default")
        warnings.showwarning = show  # type: ignore[assignment]
        yield
