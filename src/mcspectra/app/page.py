"""The page: controls at the side, figures in a grid, one session for each browser tab."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from typing import Any, final

import panel as pn
from tornado.ioloop import IOLoop

from mcspectra.app.accessible import name_widgets
from mcspectra.app.board import Board
from mcspectra.app.compute import Update
from mcspectra.app.controls import Controls
from mcspectra.app.export import as_python, as_toml
from mcspectra.app.look import text_block
from mcspectra.app.scene import pixel_spec
from mcspectra.app.scene_view import SceneView
from mcspectra.app.state import THEMES, Setup, State
from mcspectra.core.errors import McspectraError

__all__ = ["Explorer", "build_page"]

_GRID = ":host {{ display: grid !important; gap: 8px; grid-template-columns: repeat({columns}); }}"
_ALONE, _ABREAST = "auto-fit, minmax(min(100%, 300px), 1fr)", "2, minmax(0, 1fr)"
_NARROW = "@media (max-width: 700px) { :host { grid-template-columns: 1fr !important; } }"
_COPY = "navigator.clipboard.writeText(text.value)"
_STACKED = (  # on a phone the controls stand above the figures
    "@media (max-width: 700px) { #content { flex-direction: column !important; height: auto "
    "!important; } #sidebar { width: 100% !important; max-width: none !important; height: 45vh "
    "!important; overflow-y: auto; } #main { width: 100% !important; margin: 0 !important; } }"
)
_TABLE = "td, th { padding: 2px 16px 2px 0; text-align: left; }"


@final
class Explorer:
    """Controls, boards and texts of one session.

    Parameters
    ----------
    query
        Query string of the address.
    """

    def __init__(self, query: str) -> None:
        refused = ""
        try:
            self.state = State.from_query(query)
        except McspectraError as error:
            self.state, refused = State(), f"{error} The defaults are shown."
        self._document = pn.state.curdoc
        self._loop = IOLoop.current(instance=False)
        self._location: Any = pn.state.location
        self._boards: dict[str, Board] = {}
        self._controls: dict[str, Controls] = {}
        self._sides = pn.Tabs(sizing_mode="stretch_width")
        self._headers = pn.Row(sizing_mode="stretch_width")
        self._grid = pn.Column(sizing_mode="stretch_width")
        self._summary = text_block(css=_TABLE)
        self._theme_link = text_block()
        self._python = _text_area("As Python")
        self._toml = _text_area("As TOML")
        self._compare = pn.widgets.Checkbox(
            name="Compare with a second set-up, B", value=self.state.b is not None
        )
        self._compare.param.watch(lambda _: self._later(self._choose_comparison), "value")
        self._scene = SceneView(self.state.theme, self._choose_pixel, self._later)
        self._arrange()
        if refused:
            self._boards["A"].refuse(refused)
        for side, setup in self.state.setups():
            self._boards[side].run(setup) if not refused else None

    def page(self) -> Any:
        """The template that Panel serves."""
        template: Any = pn.template.BootstrapTemplate(
            title="mcspectra explorer",
            theme="dark" if self.state.theme == "dark" else "default",
            sidebar_width=330,
            header_background="#1F3A5F",
            raw_css=[_STACKED],
        )
        template.sidebar.extend([self._compare, self._sides])
        template.main.extend(
            [
                self._headers,
                self._summary,
                self._grid,
                self._scene.layout,
                _copies(self._python, self._toml),
                self._theme_link,
            ]
        )
        name_widgets(self._document)
        return template

    def close(self) -> None:
        """Drop all jobs; for a tab that was closed."""
        for board in self._boards.values():
            board.cancel(quiet=True)

    def _arrange(self) -> None:
        """Make controls and boards for the set-ups there are, and lay them out."""
        setups = dict(self.state.setups())
        for side in [side for side in self._boards if side not in setups]:
            self._boards.pop(side).cancel(quiet=True)
            self._controls.pop(side)
        for side, setup in setups.items():
            if side not in self._boards:
                self._boards[side] = self._board(side, setup)
                self._controls[side] = self._control(side, setup)
        self._sides[:] = [(side, each.layout) for side, each in self._controls.items()]
        self._headers.objects = [board.header for board in self._boards.values()]
        self._lay_out()
        self._tell_address()

    def _lay_out(self) -> None:
        """Figures of A and B alternate, so that the same ones stand side by side."""
        columns = _ABREAST if len(self._boards) > 1 else _ALONE
        self._grid.stylesheets = [_GRID.format(columns=columns), _NARROW]
        cards = zip(*(board.cards for board in self._boards.values()), strict=True)
        self._grid.objects = [card for pair in cards for card in pair]

    def _board(self, side: str, setup: Setup) -> Board:
        return Board(
            setup,
            side,
            self.state.theme,
            later=self._later,
            on_update=self._write_texts,
            on_shown=self._summarize,
        )

    def _control(self, side: str, setup: Setup) -> Controls:
        return Controls(
            setup,
            side,
            lambda _: self._later(lambda: self._change(side)),
            lambda sentence: self._later(lambda: self._refuse(side, sentence)),
        )

    def _later(self, act: Any) -> None:
        """Have `act` called in the session's thread, holding the document's lock, from any thread.

        Widgets of Panel call back without that lock, without which bokeh refuses changes of its own
        models as often as the lock is free.
        """
        if self._loop is not None:
            self._loop.add_callback(self._add, act)

    def _add(self, act: Any) -> None:
        """Add `act` to the document, unless the session has ended."""
        if self._document is not None and self._document.session_context is not None:
            self._document.add_next_tick_callback(act)

    def _change(self, side: str) -> None:
        """Show the set-up of a side's controls; later calls may overtake earlier ones."""
        if side not in self._controls:  # the comparison has ended
            return
        setup = self._controls[side].setup
        if setup == dict(self.state.setups())[side]:
            return
        here = self.state
        self.state = replace(here, a=setup) if side == "A" else replace(here, b=setup)
        self._tell_address()
        if self._boards[side].run(setup):
            self._lay_out()

    def _refuse(self, side: str, sentence: str) -> None:
        if side in self._boards:
            self._boards[side].refuse(sentence)

    def _choose_comparison(self) -> None:
        wanted = bool(self._compare.value)
        if wanted == (self.state.b is not None):
            return
        other = replace(self.state.a, sampler="random") if wanted else None
        self.state = replace(self.state, b=other)
        self._arrange()
        if other is not None:
            self._boards["B"].run(other)
        self._summarize()

    def _choose_pixel(self, x: int, y: int, strategy: str) -> None:
        side = "B" if self.state.b is not None and self._sides.active == 1 else "A"
        try:
            spec = pixel_spec(x, y, strategy)
        except McspectraError as error:
            sentence = str(error)
            self._later(lambda: self._refuse(side, sentence))
            return
        self._controls[side].change(integrand=spec, dims=2, density="uniform", smoothing=0.0)

    def _tell_address(self) -> None:
        query = self.state.query()
        if self._location is not None:
            self._location.search = f"?{query}" if query else ""
        other = next(theme for theme in THEMES if theme != self.state.theme)
        there = replace(self.state, theme=other).query()
        self._theme_link.text = f'<p><a href="?{escape(there)}">{other.capitalize()} theme</a></p>'

    def _write_texts(self, update: Update) -> None:
        """Write the exports once the parts are made; runs in a job's thread."""
        if update.kind != "points":
            return
        state = self.state
        try:
            texts = as_python(state), as_toml(state)
        except McspectraError as error:
            texts = (f"# {error}",) * 2

        def show() -> None:
            self._python.value, self._toml.value = texts

        self._later(show)

    def _summarize(self) -> None:
        """A table of the figures that matter, a row for each set-up."""
        rows = [_row(side, setup, self._boards[side].latest) for side, setup in self.state.setups()]
        head = "".join(
            f'<th scope="col">{name}</th>'
            for name in ("", "sampler", "n", "variance", "captured", "rate")
        )
        self._summary.text = f"<table><tr>{head}</tr>{''.join(rows)}</table>"


def build_page() -> Any:
    """Make the page of a new session from its address."""
    location: Any = pn.state.location
    explorer = Explorer("" if location is None else location.search)
    pn.state.on_session_destroyed(lambda _: explorer.close())
    return explorer.page()


def _row(side: str, setup: Setup, latest: dict[str, Any]) -> str:
    terms, curve = latest.get("terms"), latest.get("convergence")
    cells = [
        setup.displaced_sampler,
        str(setup.n),
        "…" if terms is None else f"{float(terms['measured_variance']):.4g}",
        "…" if terms is None else f"{float(terms['captured']):.3g}",
        "…" if curve is None else f"{float(curve['rate']):.3f}",
    ]
    return (
        f'<tr><th scope="row">{side}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        + "</tr>"
    )


def _text_area(name: str) -> Any:
    return pn.widgets.TextAreaInput(
        name=name, height=220, max_length=100_000, sizing_mode="stretch_width"
    )


def _copies(*areas: Any) -> Any:
    """Text areas, each with a button that puts its text on the clipboard."""
    columns = []
    for area in areas:
        button = pn.widgets.Button(name=f"Copy {area.name[:1].lower()}{area.name[1:]}")
        button.js_on_click(args={"text": area}, code=_COPY)
        columns.append(pn.Column(button, area, sizing_mode="stretch_width"))
    style = _GRID.format(columns=_ALONE)
    return pn.Column(*columns, sizing_mode="stretch_width", stylesheets=[style])
