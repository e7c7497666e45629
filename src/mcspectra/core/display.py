"""How components and results show themselves in notebooks.

What is drawn needs the modules of `mcspectra.report`, which lie above everything that is shown. They
are named as text here and imported when something is shown for the first time, as a registry does
with its classes: no module below imports one above, and nothing is loaded that nobody looks at.
"""

from __future__ import annotations

import functools
import importlib
from typing import Any

__all__ = ["html_of", "register_accessor"]

_PICTURES = "mcspectra.report.reprs"
_RESULTS = "mcspectra.report.accessor"


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
