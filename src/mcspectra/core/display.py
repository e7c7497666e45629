"""Text of others as it is shown, and how components and results show themselves in notebooks.

Names, titles, paths and messages may come from a stranger's file: `printable` takes from them what would
steer a terminal or reorder a line, `escape_html` and `csv_cell` what a browser or a spreadsheet would run.
Errors and warnings of the package pass through `printable` where they are made, tables and answers where
they are printed, pages and pictures where they are drawn.

What is drawn needs the modules of `mcspectra.report`, which lie above everything that is shown. They
are named as text here and imported when something is shown for the first time, as a registry does
with its classes: no module below imports one above, and nothing is loaded that nobody looks at.
"""

from __future__ import annotations

import functools
import html
import importlib
import math
import re
import unicodedata
from typing import Any

__all__ = [
    "QUOTED",
    "counted",
    "csv_cell",
    "escape_html",
    "html_of",
    "needed",
    "printable",
    "register_accessor",
    "shown",
]

# Characters of no width that str.isprintable lets pass: fillers, and marks that choose a variant
_INVISIBLE = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u3164\uffa0\U000e0100-\U000e01ef]"
)
_BEGINS_FORMULA = ("=", "+", "-", "@", "\t", "\r", "＝", "＋", "－", "＠")
_CUT = " … "

QUOTED = 80
"""Most characters of a text of others in a message."""

_PICTURES = "mcspectra.report.reprs"
_RESULTS = "mcspectra.report.accessor"


def printable(given: object, most: int | None = None, *, lines: bool = False) -> str:
    r"""Return text of others, or a path, in one line that can be shown, of `most` characters if given.

    Characters that are not printed stand as escapes such as ``\x1b`` and ``\u202e``: controls, marks of
    direction and others without width, line separators, surrogates, characters that Unicode has not
    assigned. Blanks of other widths become plain ones. A text that is too long loses its middle.

    Parameters
    ----------
    lines
        Whether line feeds stay, for text of our own that holds text of others.

    Examples
    --------
    >>> printable("a\x1b[2Jb\nc")
    'a\\x1b[2Jb\\nc'
    >>> printable("x" * 20, 11)
    'xxxxxx … xx'
    """
    text = str(given)
    if most is not None and len(text) > most:
        tail = (most - len(_CUT)) // 3
        text = f"{text[: most - len(_CUT) - tail]}{_CUT}{text[len(text) - tail :]}"
    inside = text.replace("\n", "") if lines else text
    if not inside.isprintable():
        strange = {c for c in set(inside) if not c.isprintable()}
        blanks = {c for c in strange if unicodedata.category(c) == "Zs"}
        text = text.translate({ord(c): " " if c in blanks else _escape(c) for c in strange})
    return text if text.isascii() else _INVISIBLE.sub(lambda found: _escape(found[0]), text)


def shown(value: object, most: int = QUOTED) -> str:
    """Return the ``repr`` of a value as messages quote it: `printable` and short; for a long number its size.

    Python refuses to write integers of more than 4300 digits.

    Examples
    --------
    >>> shown([16, "a\\n"]), shown(10**5000), shown([10**5000])
    ("[16, 'a\\\\n']", 'an integer of about 5001 digits', 'a list with an integer of too many digits')
    """
    try:
        return printable(repr(value), most)
    except ValueError:
        if isinstance(value, int):
            return f"an integer of about {int(value.bit_length() * math.log10(2)) + 1} digits"
        return f"a {type(value).__name__} with an integer of too many digits"


def counted(number: int, one: str) -> str:
    """Return a number with its noun, which is plural unless the number is 1.

    Examples
    --------
    >>> counted(1, "task"), counted(2000, "recorded task"), counted(0, "density")
    ('1 task', '2000 recorded tasks', '0 densities')
    """
    if number == 1:
        return f"1 {one}"
    return f"{number} {one[:-1]}ies" if one.endswith("y") else f"{number} {one}s"


def needed(number: int, one: str) -> str:
    """Return ``1 dim is needed`` or ``2 dims are needed``."""
    return f"{counted(number, one)} {'is' if number == 1 else 'are'} needed"


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def escape_html(text: object) -> str:
    """Return a text of others for HTML, in an element or an attribute: `printable`, its lines kept."""
    return html.escape(printable(text, lines=True))


def csv_cell(value: object) -> object:
    """Return the cell of a table for spreadsheets: text that they would compute begins with ``'``.

    That is a text that begins with ``=``, ``+``, ``-``, ``@`` or a tab and is not a number. Numbers and
    None are returned as they are; text is `printable`.
    """
    if not isinstance(value, str):
        return value
    if value.startswith(_BEGINS_FORMULA):
        try:
            float(value)
        except ValueError:
            value = f"'{value}"
    return printable(value)


def html_of(component: object) -> str | None:
    """Return a picture and the main figures of a component as HTML; None where that fails.

    A notebook then shows the plain text instead: to look at an object never raises.
    """
    try:
        html: str = importlib.import_module(_PICTURES).component_html(component)
    except Exception:  # noqa: BLE001 - components of others may raise anything
        return None
    return html


@functools.cache
def register_accessor() -> None:
    """Give xarray's datasets the accessor ``mcspectra``: see `mcspectra.report.accessor`."""
    import xarray as xr

    if not hasattr(xr.Dataset, "mcspectra"):
        register: Any = xr.register_dataset_accessor("mcspectra")  # type: ignore[no-untyped-call]
        register(lambda data: importlib.import_module(_RESULTS).Result(data))
