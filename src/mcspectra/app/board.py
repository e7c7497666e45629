"""The figures of one set-up on the page, and the job that fills them."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from queue import SimpleQueue
from typing import Any, final

import panel as pn

from mcspectra.app.compute import Job, Update
from mcspectra.app.look import text_block
from mcspectra.app.parts import make_parts
from mcspectra.app.state import Setup
from mcspectra.app.views import View, make_views

__all__ = ["Board"]

_STATUS = ".alert { border-left: 4px solid #D55E00; padding-left: 8px; font-weight: 600; }"


@final
class Board:
    """Figures with their sentences, progress, and a button that cancels.

    Parameters
    ----------
    setup, side, theme
        What is shown, ``"A"`` or ``"B"``, and the name of the look.
    later
        Has a function of no arguments called in the page's own thread, holding its lock.
    on_update
        Called in the job's thread before a part is shown.
    on_shown
        Called in the page's thread after one was.
    """

    def __init__(
        self,
        setup: Setup,
        side: str,
        theme: str,
        *,
        later: Callable[[Callable[[], None]], object],
        on_update: Callable[[Update], object],
        on_shown: Callable[[], object],
    ) -> None:
        self.latest: dict[str, Any] = {}
        self._side, self._theme = side, theme
        self._later, self._on_update, self._on_shown = later, on_update, on_shown
        self._job: Job | None = None
        self._inbox: SimpleQueue[tuple[Job, Update | str]] = SimpleQueue()
        self._status = text_block(css=_STATUS)
        self._progress = pn.indicators.Progress(
            value=0, max=100, sizing_mode="stretch_width", margin=(4, 10)
        )
        self._cancel = pn.widgets.Button(name=f"Cancel, {side}", button_type="default", width=110)
        self._cancel.on_click(self._ask_to_cancel)
        self.header = pn.Column(
            pn.Row(self._progress, self._cancel, sizing_mode="stretch_width"),
            self._status,
            sizing_mode="stretch_width",
        )
        self.cards: list[Any] = []
        self._setup = setup
        self._make(setup)

    def run(self, setup: Setup) -> bool:
        """Show another set-up; True if the cards are new because the figures are of another kind."""
        self.cancel(quiet=True)
        new = self._kind(setup) != self._made_for
        if new:
            self._make(setup)
        self.latest.clear()
        self._setup = setup
        self._cancel.disabled = False
        self._say("Computing …")
        self._job = job = Job(
            setup, lambda update: self._hear(job, update), lambda said: self._hear_end(job, said)
        )
        job.start()
        return new

    def cancel(self, *, quiet: bool = False) -> None:
        """Drop the job that is under way."""
        if self._job is not None:
            self._job.cancel()
            self._job = None
            if not quiet:
                self._end("Cancelled; the figures show what was done by then.")

    def _ask_to_cancel(self, _: Any) -> None:
        self._later(self.cancel)

    def refuse(self, sentence: str) -> None:
        """Say why what was entered is not computed."""
        self._say(sentence, alert=True)

    @staticmethod
    def _kind(setup: Setup) -> tuple[object, ...]:
        """What the labels of figures depend on."""
        return setup.dims, setup.frequency_step, setup.n

    def _make(self, setup: Setup) -> None:
        self._made_for = self._kind(setup)
        self._views: list[View] = make_views(setup, self._theme)
        self._captions = [text_block(margin=(0, 10, 12, 10)) for _ in self._views]
        for view in self._views:
            self._name(view, "")
        self.cards = [
            pn.Column(pn.pane.Bokeh(view.figure, sizing_mode="scale_width"), caption, margin=4)
            for view, caption in zip(self._views, self._captions, strict=True)
        ]
        for card in self.cards:
            card.sizing_mode = "stretch_width"

    def _name(self, view: View, sentence: str) -> None:
        """Give the figure a name that screen readers read."""
        title = f"{self._side}: {view.figure.title.text}. {sentence}"
        view.figure.html_attributes = {"role": "img", "aria-label": title.strip()}

    def _hear(self, job: Job, update: Update) -> None:
        self._on_update(update)
        self._inbox.put((job, update))
        self._later(self._read)

    def _hear_end(self, job: Job, sentence: str) -> None:
        self._inbox.put((job, sentence))
        self._later(self._read)

    def _read(self) -> None:
        """Take what has come in, in its order, which the page's callbacks do not keep."""
        while not self._inbox.empty():
            job, news = self._inbox.get()
            if job is not self._job:  # what a job of the past still sends
                continue
            if isinstance(news, Update):
                self._show(news)
            else:
                self._job = None
                self._end(news or "Done.", alert=bool(news) and not self.latest)

    def _show(self, update: Update) -> None:
        self.latest[update.kind] = update.value
        for view, caption in zip(self._views, self._captions, strict=True):
            if view.kind == update.kind:
                sentence = view.show(update.value)
                caption.text = f"<p>{escape(sentence)}</p>"
                self._name(view, sentence)
        self._progress.value = round(100 * update.fraction)
        self._say(f"{update.realizations} realisations, {update.fraction:.0%} done.")
        self._on_shown()

    def _end(self, sentence: str, *, alert: bool = False) -> None:
        self._cancel.disabled = True
        notes: list[str] = []
        if self.latest:
            notes += make_parts(self._setup).notes
        notes += [
            str(value.attrs["note"])
            for kind, value in self.latest.items()
            if kind in ("terms", "convergence") and "note" in value.attrs
        ]
        self._say(" ".join(dict.fromkeys([sentence, *notes])), alert=alert)

    def _say(self, sentence: str, *, alert: bool = False) -> None:
        role = "alert" if alert else "status"
        self._status.text = (
            f'<p role="{role}" class="{role}"><strong>{self._side}</strong> {escape(sentence)}</p>'
        )
