"""The figures of one set-up on the page, and the background job that computes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, final

from bokeh.models import Column, InlineStyleSheet, Row
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.markups import Div

from mcspectra.app.compute import UPDATE_KINDS, Job, Update, make_parts
from mcspectra.app.figures import FIGURES, figures_of
from mcspectra.app.state import ExplorerSetup
from mcspectra.core.display import escape_html
from mcspectra.plots.backend_bokeh import Drawn, draw
from mcspectra.plots.description import Plot

__all__ = ["JOINT", "STALE", "Board", "Card", "card_of"]

JOINT = "A and B"
"""Name that stands for both set-ups, in figures that show A and B together."""

_FRESH: Any = {"opacity": "1", "filter": "none"}
_FRAMES = {False: 216, True: 100}  # width of a panel in pixels: for one set-up, and for two
STALE: Any = {"opacity": "0.35", "filter": "grayscale(1)"}
"""Style of a figure if its set-up has changed or cannot be computed."""


@final
@dataclass
class Card:
    """A figure on the page with its heading and text."""

    drawn: Drawn
    layout: Any


@final
class Board:
    """The figures of one set-up, with texts, a progress bar and a cancel button.

    Parameters
    ----------
    side
        Name of the set-up, ``"A"`` or ``"B"``.
    sheet
        Style sheet of the widgets.
    later
        Schedules a function without arguments in the page's thread, with the lock of the page.
    on_update
        Called once with an empty text in the job's thread, after the first round of results.
        If the job ends or is canceled during the first round, `on_update` is called immediately.
        If nothing can be computed, the text is a sentence with the reason.
    on_shown
        Called in the page's thread after results were shown, and after the job has ended.
    """

    def __init__(
        self,
        side: str,
        sheet: InlineStyleSheet,
        *,
        later: Callable[[Callable[[], None]], object],
        on_update: Callable[[str], object],
        on_shown: Callable[[], object],
    ) -> None:
        self.latest: dict[str, Any] = {}
        self.cards: dict[str, Card] = {}
        self._side, self._sheet = side, sheet
        self._later, self._on_update, self._on_shown = later, on_update, on_shown
        self._job: Job | None = None
        self._inbox: SimpleQueue[tuple[Job, Update | str]] = SimpleQueue()
        # For each job and each part of its results, the last update that the job has sent
        self._newest: dict[tuple[Job, str], Update] = {}
        self._fresh: set[str] = set()  # kinds of figures that the current job has already shown
        # For each part of the results, the displayed value and the names of its figures
        self._drawn: dict[str, tuple[Any, list[str]]] = {}
        self._paired = False
        self._fraction = 0.0
        self._status = Div(sizing_mode="stretch_width", stylesheets=[sheet])
        self._cancel = Button(label=f"Cancel, {side}", width=110, stylesheets=[sheet])
        self._cancel.on_click(lambda: self.cancel())
        self.header = Row(children=[self._status, self._cancel], sizing_mode="stretch_width")

    def run(self, setup: ExplorerSetup) -> None:
        """Compute and show another set-up."""
        self.cancel(quiet=True)
        self.latest.clear()
        self._newest.clear()
        self._fresh.clear()
        self._setup = setup
        self._cancel.disabled = False
        self._say("Computing …")
        self._job = job = Job(
            setup,
            lambda update: self._hear(job, update),
            lambda sentence: self._hear_end(job, sentence),
        )
        job.start()

    def cancel(self, *, quiet: bool = False) -> None:
        """Cancel the running job."""
        job = self._job
        if job is not None:
            job.cancel()
            self._job = None
            if not quiet:
                self._end("Canceled; the figures show the results so far.")
                self._update_early(job)

    @property
    def busy(self) -> bool:
        """Whether a job is running."""
        return self._job is not None

    def refuse(self, sentence: str) -> None:
        """Report why an entry is not computed. The earlier figures remain, but turn gray."""
        self.cancel(quiet=True)
        self.latest.clear()
        self._fresh.clear()
        self._end(sentence, alert=True)

    def pair(self, paired: bool) -> None:
        """Choose whether the headings of figures contain the name of the set-up (A or B)."""
        self._paired = paired
        for kind, card in self.cards.items():
            card.layout.children[0].text = self._heading(kind)
            self._size(kind, card.drawn)

    def _size(self, kind: str, drawn: Drawn) -> None:
        """Shrink the panels of the integrand, so that they fit side by side in half of the page."""
        panels: list[Any] = getattr(drawn.model, "children", [])
        if kind != "integrand" or not panels:
            return
        size = _FRAMES[self._paired]
        for panel in panels:
            panel.update(
                frame_width=size, frame_height=size, min_border_right=0 if self._paired else 12,
                toolbar_location=None if self._paired else "right",
            )  # fmt: skip
        for panel in panels[1:]:
            panel.left[0].visible = panel.y_range is not panels[0].y_range or not self._paired

    def _heading(self, kind: str) -> str:
        return _heading(kind, self._side if self._paired else "")

    def _hear(self, job: Job, update: Update) -> None:
        first_round = (job, UPDATE_KINDS[-1]) not in self._newest
        self._post(job, update)
        # The first figures should not wait until texts are written, so they are shown first
        if first_round and update.kind == UPDATE_KINDS[-1]:
            self._on_update("")

    def _hear_end(self, job: Job, sentence: str) -> None:
        self._update_early(job)
        self._post(job, sentence)

    def _update_early(self, job: Job) -> None:
        """Call `on_update` if the job ends in its first round, with some results."""
        first, last = ((job, UPDATE_KINDS[k]) in self._newest for k in (0, -1))
        if first and not last:
            self._on_update("")

    def _post(self, job: Job, news: Update | str) -> None:
        if isinstance(news, Update):
            self._newest[job, news.kind] = news
        self._inbox.put((job, news))
        self._later(self._read)

    def _read(self) -> None:
        """Process the oldest update of the inbox.

        The page may run callbacks in any order, but updates are processed in order of arrival.
        The browser gets changes after a callback ends, so each update has a callback of its own.
        """
        job, news = self._inbox.get()
        if job is not self._job:  # an earlier job sent this update
            return
        if not isinstance(news, Update):
            self._job = None
            self._end(news or "Done.", alert=bool(news) and not self.latest)
            return
        if news.kind in self.latest and self._newest[job, news.kind] is not news:
            return  # the queue contains a newer update of the same part
        self.latest[news.kind] = news.value
        self._fresh |= set(self.show(news.kind, self._setup))
        self._fraction = news.fraction
        self._say(f"{news.realizations} realizations, {news.fraction:.0%} done.")
        self._on_shown()

    def show(self, kind: str, setup: ExplorerSetup) -> list[str]:
        """Draw the figures of a part of `latest`. If the part has not changed, send nothing.

        Returns the names of the figures.
        """
        value = self.latest[kind]
        before, names = self._drawn.get(kind, (None, []))
        if before is value:
            for name in names:
                self.cards[name].layout.styles = _FRESH
            return names
        plots = figures_of(kind, value, setup.displaced_sampler)
        for plot in plots:
            self._place(plot)
        names = [plot.kind for plot in plots]
        self._drawn[kind] = (value, names)
        return names

    def _place(self, plot: Plot) -> None:
        """Show a plot in its card (figure with heading)."""
        before = self.cards.get(plot.kind)
        card = card_of(plot, self._side, before, self._sheet, named=self._paired)
        if card is not before:
            self._size(plot.kind, card.drawn)
            self.cards[plot.kind] = card

    def _end(self, sentence: str, *, alert: bool = False) -> None:
        """Report the end of the job. Remove figures without results, or turn old figures gray."""
        self._cancel.disabled = True
        old = [kind for kind in self.cards if kind not in self._fresh]
        if len(self.latest) > 0 and sentence == "Done.":
            for kind in old:
                del self.cards[kind]
        else:
            for kind in old:
                self.cards[kind].layout.styles = STALE
        notes: list[str] = list(make_parts(self._setup).notes) if self.latest else []
        notes += [
            str(value.attrs["note"])
            for kind, value in self.latest.items()
            if kind in ("terms", "convergence", "predict") and "note" in value.attrs
        ]
        if alert:
            self._on_update(sentence)
        self._fraction = 0.0 if alert else 1.0
        self._say(" ".join(dict.fromkeys([sentence, *notes])), alert=alert)
        self._on_shown()

    def _say(self, sentence: str, *, alert: bool = False) -> None:
        role = "alert" if alert else "status"
        self._status.text = (
            f'<p role="{role}" class="{role}"><strong>{self._side}:</strong> '
            f"{escape_html(sentence)}</p>"
            f'<progress aria-label="Progress of {self._side}" value="{self._fraction:.3f}">'
            "</progress>"
        )


def card_of(
    plot: Plot, side: str, before: Card | None, sheet: InlineStyleSheet, *, named: bool = True
) -> Card:
    """Show a plot in the earlier card `before` if the plot fits into it, otherwise in a new card.

    A card is a figure with a heading. The argument `side` is the name of the set-up, A or B.
    If `named` is true, the heading contains the name of the set-up.
    The label for screen readers always names the set-up.
    """
    words = f'<p>{escape_html(plot.words)}</p><p class="soft">{escape_html(plot.caption)}</p>'
    if before is not None and before.drawn.fits(plot):
        before.drawn.update(plot)
        before.layout.children[2].text = words
        before.layout.styles = _FRESH
        return before
    drawn = draw(plot)
    texts = [
        Div(text=t, sizing_mode="stretch_width", stylesheets=[sheet], disable_math=True)
        for t in (_heading(plot.kind, side if named else ""), words)
    ]
    layout = Column(
        children=[texts[0], drawn.model, texts[1]],
        sizing_mode="stretch_width",
        styles=_FRESH,
        html_attributes={"role": "group", "aria-label": f"{side}: {FIGURES[plot.kind]}"},
        css_classes=["joint"] if side == JOINT else ["wide"] if len(plot.panels) > 2 else [],
    )
    return Card(drawn, layout)


def _heading(kind: str, side: str) -> str:
    return f"<h2>{f'{side}: ' if side else ''}{FIGURES[kind]}</h2>"
