"""Building blocks of subcommands (verbs): options, parsers of values, output, tables, JSON."""

from __future__ import annotations

import argparse
import inspect
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, final

from mcspectra.core.checks import as_integer, as_real
from mcspectra.core.display import printable, shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.options import whole_number

if TYPE_CHECKING:
    from mcspectra.report.page import Table
    from mcspectra.samplers import Sampler

__all__ = [
    "Declaration",
    "Read",
    "Verb",
    "VerbOutput",
    "folder_name",
    "given_of",
    "group",
    "index_or_name",
    "one_sentence_warnings",
    "option",
    "out",
    "page_table",
    "read_sampler",
    "real",
    "text_table",
    "verb",
    "whole",
    "wholes",
]

_LONGEST = 2000  # maximum length of a printed warning in characters
_PAGES = frozenset({".html", ".md", ".json", ".csv", ".png", ".svg", ".pdf", ".exr"})


class VerbOutput(NamedTuple):
    """Output of a subcommand (verb): a text, data for --json, and the exit code.

    Without data, the text is the result itself (such as a schema) and is printed even with --json.
    """

    text: str = ""
    data: Any = None
    code: int = 0


class Read(argparse.Action):
    """Parse the value of an option immediately, so that an error can name the option.

    Parameters
    ----------
    read
        Function that computes a value from the name of the option and its text.
        By default, the value is the text itself.
    repeated
        Effect of a repeated option: ``"last"`` keeps the last value, ``"once"`` raises an error.
        ``"all"`` collects all values in a list, including the items of tuples.
    """

    def __init__(
        self,
        option_strings: Sequence[str],
        dest: str,
        *,
        read: Callable[[str, str], Any] | None = None,
        repeated: Literal["last", "once", "all"] = "last",
        **further: Any,
    ) -> None:
        super().__init__(option_strings, dest, **further)
        self._read, self._repeated = read, repeated
        self._label = max(option_strings, key=len, default=str(self.metavar or dest))

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Parse and store the value, or exit with an error."""
        if values is None:  # an optional positional argument was not given
            return
        value = values if self._read is None else self._read(self._label, values)
        before = getattr(namespace, self.dest)
        if self._repeated == "once" and before is not None:
            parser.error(f"{option_string} is given twice; give it once")
        if self._repeated == "all":
            value = [*(before or []), *(value if isinstance(value, tuple) else [value])]
        setattr(namespace, self.dest, value)


Declaration = Callable[[Any], Any]
"""A function that adds options to a parser or to a group of options."""


def option(
    usage: str, help: str, read: Callable[[str, str], Any] | None = None, **further: Any
) -> Declaration:
    """Declare an option by its usage text.

    With ``"-m, --realizations R", "help", whole()``, the option takes a number.
    With ``"--quick", "help"`` it is a switch. With ``"SCENE", "help"`` it is positional.
    Other arguments are passed to `Read` or to argparse.
    """
    *names, last = (word.rstrip(",") for word in usage.split())
    if names and last == "DIR":
        read = folder_name
    if not names and last.startswith("-"):
        return lambda parser: parser.add_argument(last, action="store_true", help=help)
    further |= {"metavar": last, "action": Read, "read": read, "help": help}
    names = names or [further.pop("dest", last.lower())]
    return lambda parser: parser.add_argument(*names, **further)


def out(help: str, **further: Any) -> Declaration:
    """Declare ``-o, --out``, a list of output files, which is empty by default."""
    return option(
        "-o, --out FILE", f"{help}; repeatable", repeated="all", **{"default": [], **further}
    )


def group(make: Callable[[Any], Any], *options: Declaration) -> Declaration:
    """Declare the options of a group. The function `make` adds the group to the parser."""

    def declare(parser: Any) -> None:
        added = make(parser)
        for each in options:
            each(added)

    return declare


@final
class Verb(NamedTuple):
    """A verb of the command line, with help text, options and function."""

    text: str
    options: tuple[Declaration, ...]
    run: Callable[[argparse.Namespace], VerbOutput]


def verb(*options: Declaration) -> Callable[[Callable[[argparse.Namespace], VerbOutput]], Verb]:
    """Create a command-line verb from a function, whose docstring becomes the help text."""
    return lambda run: Verb(inspect.cleandoc(run.__doc__ or ""), options, run)


def whole(least: int = 1, most: int | None = None) -> Callable[[str, str], int]:
    """Return a parser of whole numbers within limits."""

    return lambda name, text: as_integer(name, whole_number(text), least=least, most=most)


def wholes(form: str = "", least: int = 1) -> Callable[[str, str], list[int]]:
    """Return a parser of whole numbers with commas between them. The form W,H means two numbers."""

    def read(name: str, text: str) -> list[int]:
        parts = text.split(",")
        if form and len(parts) != form.count(",") + 1:
            raise ParameterError(f"{name} is {shown(text)}; give {form}, whole numbers.")
        return [whole(least)(name, part.strip()) for part in parts]

    return read


def real(**limits: float) -> Callable[[str, str], float]:
    """Return a parser of numbers within the limits of `as_real`."""

    def read(name: str, text: str) -> float:
        try:
            number: float | str = float(text)
        except ValueError:
            number = text
        return as_real(name, number, **limits)

    return read


def folder_name(name: str, text: str) -> str:
    """Read the name of a folder, and reject files and names with extensions of pages."""
    path = Path(text)
    if (path.suffix.lower() in _PAGES or path.exists()) and not path.is_dir():
        raise ParameterError(
            f"{name} is {shown(text)}, the name of a file; give a folder for several files."
        )
    return text


def given_of(options: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Of the named options, return those that the user gave on the command line."""
    found = ((name, getattr(options, name, None)) for name in names)
    return {name: value for name, value in found if value is not None}


def index_or_name(name: str, text: str) -> int | str:
    """Read a text as an integer, which may be negative, or otherwise as a name."""
    del name
    digits = text.removeprefix("-")
    return int(text) if digits.isdecimal() and len(digits) < 20 else text


def read_sampler(text: str, dims: int | None) -> Sampler:
    """Read a sampler spec. ``-`` stands for a point set in UTK text format on standard input."""
    from mcspectra.samplers import RANDOMIZATIONS, GivenPoints, sampler

    first, bar, rest = text.partition("|")
    if first.strip() != "-":
        return sampler(text, dims)
    from mcspectra.core.pointfiles import parse_dat
    from mcspectra.core.spec import parse_chain

    if sys.stdin is None or sys.stdin.closed:
        raise ParameterError("'-' reads points from standard input, which is closed.")
    given: Any = GivenPoints.from_sets(
        parse_dat(sys.stdin.read(), "standard input"), "standard input"
    )
    for call in parse_chain(rest) if bar else []:
        given = given.then(RANDOMIZATIONS.build(call))
    return given  # type: ignore[no-any-return]


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int = 2) -> str:
    """Align columns with gaps of two blanks: the first `words` columns left, all others right."""
    table = [[printable(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for row in table:
        cells = [
            cell.ljust(width) if i < words else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def page_table(table: Table, first: str = "", words: int = 0) -> str:
    """Align the columns of a table from a report.

    `first`, if given, renames the first column. At least `words` columns are left-aligned.
    """
    header = [first or table.columns[0], *table.columns[1:]]
    first_row = table.rows[0] if table.rows else ()
    numbers = next((k for k, cell in enumerate(first_row) if k and cell.numeric), len(header))
    rows = [[cell.text for cell in row] for row in table.rows]
    return text_table(header, rows, max(words, numbers))


@contextmanager
def one_sentence_warnings(quiet: bool) -> Iterator[None]:
    """Show each warning once as a line on standard error, or show no warnings."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: Any) -> None:
        text = printable(message, _LONGEST)
        if text in seen:  # other code has already issued the same warning
            return
        seen.add(text)
        print(f"mcspectra: Warning: {text}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if quiet else "default")
        warnings.showwarning = show  # type: ignore[assignment]
        yield
