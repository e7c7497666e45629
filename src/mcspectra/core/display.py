"""Display of untrusted text, and of components and results in notebooks.

Names, titles, paths and messages may come from an untrusted file.
`printable` escapes characters that would control a terminal or reorder a line.
`escape_html` and `csv_cell` also escape text that a browser or a spreadsheet would run.
The texts of errors and warnings pass through `printable` when an error or warning is created.
Text in tables and answers passes through `printable` when it is printed.
Text in pages and figures passes through `printable` when it is drawn.

Drawing needs modules of the package `mcspectra.report`, which this package must not import.
The names of these modules are stored as text, and a module is imported when it is first needed.
Registries of components also store the names of classes as text, and import them when needed.
Therefore no module imports from a higher layer, and nothing is loaded before it is needed.
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
    "Drawable",
    "between",
    "counted",
    "csv_cell",
    "escape_html",
    "html_of",
    "needed",
    "plot_of",
    "printable",
    "register_accessor",
    "shown",
]

# Zero-width characters that str.isprintable accepts: fillers and variation selectors
_INVISIBLE = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u3164\uffa0\U000e0100-\U000e01ef]"
)
_BEGINS_FORMULA = ("=", "+", "-", "@", "\t", "\r", "＝", "＋", "－", "＠")
_CUT = " … "

QUOTED = 80
"""Maximum number of characters of a quoted text in a message."""

_PICTURES = "mcspectra.report.reprs"
_RESULTS = "mcspectra.report.accessor"
_PLOTS = "mcspectra.plots.components"


def printable(given: object, most: int | None = None, *, lines: bool = False) -> str:
    r"""Return untrusted text, or a path, in one safe line of at most `most` characters.

    Characters that do not print become escapes such as ``\x1b`` and ``\u202e``.
    Escaped characters are controls, line separators, surrogates, and zero-width characters.
    Direction marks, and characters that are not assigned in Unicode, are also escaped.
    Spaces of other widths become plain spaces. A text that is too long is cut in the middle.

    Parameters
    ----------
    lines
        Whether to keep line feeds, for text of this package that quotes untrusted text.

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
    """Return the ``repr`` of a value for a message. It is shortened and made `printable`.

    A long integer is replaced by its size, since Python writes at most 4300 digits.

    Examples
    --------
    >>> shown([16, "a\\n"]), shown(10**5000)
    ("[16, 'a\\\\n']", 'an integer of about 5001 digits')
    >>> shown([10**5000])
    'a list with an integer of too many digits'
    """
    try:
        return printable(repr(value), most)
    except ValueError:
        if isinstance(value, int):
            return f"an integer of about {int(value.bit_length() * math.log10(2)) + 1} digits"
        return f"a {type(value).__name__} with an integer of too many digits"


def counted(number: int, one: str) -> str:
    """Return a number with its noun, in the plural unless the number is 1.

    Examples
    --------
    >>> counted(1, "task"), counted(2000, "recorded task"), counted(0, "density")
    ('1 task', '2000 recorded tasks', '0 densities')
    """
    if number == 1:
        return f"1 {one}"
    return f"{number} {one[:-1]}ies" if one.endswith("y") else f"{number} {one}s"


def between(low: str, high: str) -> str:
    """Return the ends of an interval as text: one number if both texts are equal.

    Examples
    --------
    >>> between("12", "30"), between("28", "28")
    ('12 to 30', '28')
    """
    return low if low == high else f"{low} to {high}"


def needed(number: int, one: str) -> str:
    """Return ``1 dim is needed`` or ``2 dims are needed``."""
    return f"{counted(number, one)} {'is' if number == 1 else 'are'} needed"


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def escape_html(text: object) -> str:
    """Make untrusted text `printable`, keep its lines, and escape it for an HTML element."""
    return html.escape(printable(text, lines=True))


def csv_cell(value: object) -> object:
    """Return a spreadsheet cell. Text that would run as a formula gets the prefix ``'``.

    A formula begins with ``=``, ``+``, ``-``, ``@`` or a tab, and cannot be read as a number.
    Numbers and None are returned unchanged.
    In all texts, the function `printable` replaces characters that cannot be printed.
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
    """Return a picture and the main figures of a component as HTML, or None if this fails.

    If this fails, a notebook shows plain text, so that displaying an object never raises an error.
    """
    try:
        html: str = importlib.import_module(_PICTURES).component_html(component)
    except Exception:  # noqa: BLE001 - external components may raise anything
        return None
    return html


def plot_of(component: object, kind: str | None, **options: Any) -> Any:
    """Draw a component (see `mcspectra.plots.components`)."""
    return importlib.import_module(_PLOTS).plot(component, kind, **options)


class Drawable:
    """Base class of components and estimators: they have plots, and pictures in notebooks."""

    def _repr_html_(self) -> str | None:
        """Return a picture and the main figures as HTML, for notebooks."""
        return html_of(self)

    def plot(
        self,
        kind: str | None = None,
        *,
        n: int | None = None,
        sampler: Any = "jittered",
        rng: Any = 0,
        axes: Any = None,
    ) -> Any:
        """Draw the component or estimator with Matplotlib.

        Parameters
        ----------
        kind
            A sampler has the plots ``points`` and ``spectrum``.
            Densities and integrands have the plot ``integrand``: the function, as a curve or a map.
            An estimator also has the plots ``strata`` (parts of the variance) and ``estimates``.
            The default is the first of these plots that the component has.
        n
            Number of points. The default is about 16 in 1-D, and about 64 in more dims.
        sampler
            Sampler, or its spec, for the points that are shown with densities and estimators.
        rng
            Seed of the points.
        axes
            Matplotlib axes to draw into, one per panel. By default, new axes are made.

        Returns
        -------
        matplotlib.axes.Axes or list of matplotlib.axes.Axes
            The Matplotlib axes into which the plot was drawn.
        """
        return plot_of(self, kind, n=n, sampler=sampler, rng=rng, axes=axes)


@functools.cache
def register_accessor() -> None:
    """Add the accessor ``mcspectra`` to xarray's datasets: see `mcspectra.report.accessor`."""
    import xarray as xr

    if not hasattr(xr.Dataset, "mcspectra"):
        register: Any = xr.register_dataset_accessor("mcspectra")  # type: ignore[no-untyped-call]
        register(lambda data: importlib.import_module(_RESULTS).Result(data))
