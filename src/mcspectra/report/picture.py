"""A figure of a report with what is said about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from mcspectra.report.style import NARROW

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Picture"]


@final
@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure with its kebab-case kind, a caption, and an alternative text of what it shows."""

    kind: str
    caption: str
    alt: str
    figure: Figure

    @property
    def wide(self) -> bool:
        """Whether it takes the whole width of a page."""
        return bool(self.figure.get_figwidth() > NARROW)
