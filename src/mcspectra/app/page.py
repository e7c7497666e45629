"""The page of the explorer: controls, figures in a grid, and exports; a session per browser tab."""

from __future__ import annotations

import textwrap
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, final
from urllib.parse import parse_qsl, urlencode

from bokeh.core.templates import get_env
from bokeh.document import Document
from bokeh.models import Column, CustomJS, InlineStyleSheet, Row, TabPanel, Tabs
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.inputs import Checkbox, TextAreaInput
from bokeh.models.widgets.markups import Div
from tornado.ioloop import IOLoop

from mcspectra.app.board import JOINT, STALE, Board, Card, card_of
from mcspectra.app.compute import (
    UPDATE_KINDS,
    analyses_of,
    compute,
    first_round,
    integrand_specs,
    rounds,
)
from mcspectra.app.controls import Controls
from mcspectra.app.figures import FIGURES
from mcspectra.app.scene import SceneView, pixel_spec
from mcspectra.app.specs import UPLOAD, techniques
from mcspectra.app.state import THEMES, ExplorerSetup, ExplorerState
from mcspectra.core.analysis import Analysis
from mcspectra.core.display import escape_html
from mcspectra.core.errors import McspectraError
from mcspectra.core.options import options_of
from mcspectra.core.spec import parse
from mcspectra.plots.kinds import describe
from mcspectra.plots.text import number, rate
from mcspectra.report.study import study_toml
from mcspectra.report.tables import summary_table
from mcspectra.studies.summary import rows_of

__all__ = ["TITLE", "Explorer", "FirstPage", "as_python", "as_toml", "build_page"]

TITLE = "mcspectra explorer"

_TEMPLATE = get_env().from_string(Path(__file__).with_name("page.html.j2").read_text("utf-8"))
_WIDGETS = """
:host { color: var(--ink); --color: var(--ink); --background-color: var(--field);
  --border-color: var(--line); --surface-background-color: var(--raised);
  --hover-color: var(--raised); --placeholder-color: var(--soft); --icon-color: var(--soft);
  --disabled-color: var(--soft); --disabled-background-color: var(--raised);
  --font-size: 13px; }
.bk-btn, input[type=file]::file-selector-button {
  color: var(--ink); background: var(--raised); border-color: var(--line); }
.bk-btn[disabled] { color: var(--soft); background: var(--raised); opacity: 1; }
h2 { font-size: 15px; margin: 8px 0 0; } h3 { font-size: 13px; margin: 4px 0 0; font-weight: 500; }
p { margin: 0 0 4px; } .soft { color: var(--soft); } a { color: var(--link); }
.alert { border-left: 4px solid #D55E00; padding-left: 8px; font-weight: 600; }
.bk-clearfix { width: 100%; } progress { width: 100%; height: 6px; }
ul { margin: 4px 0 8px; padding-left: 18px; }
td, th { padding: 2px 16px 2px 0; text-align: left; }
"""
_TEXTS = """
:host { display: grid !important; gap: 14px;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 380px), 1fr)); }
"""
_TELL = """
const [query, paired] = cb_obj.tags;
history.replaceState(null, "", location.pathname + (query && "?" + query));
document.getElementById("figures").classList.toggle("paired", paired);
"""
_PLACES = [(JOINT, "convergence"), *((side, kind) for kind in FIGURES for side in "AB")]
_LONGEST_MAKING = 2.0  # seconds for which a request waits until the default page is made
_LONGEST_WAIT = 300  # milliseconds until the controls are shown if no figure is ready
_COPY = "navigator.clipboard.writeText(text.value)"
_PROGRAM = "import mcspectra as mcs\n"
_EXAMPLES = {
    "A shift costs a power of n": "integrand=linear&dims=1&n=16&b.sampler=jittered | shift"
    "&b.integrand=linear&b.dims=1&b.n=16",
    "Random and jittered samples": "sampler=random&b.sampler=jittered",
    "Spectra: jittered and Poisson disk": "sampler=jittered&b.sampler=poisson-disk",
    "A density that fits the integrand": "integrand=gaussian(width=0.2)&dims=1"
    "&b.integrand=gaussian(width=0.2)&b.dims=1&b.density=truncated-normal(mean=0.5, sigma=0.25)",
    "Importance sampling can lose the rate": "integrand=linear&dims=1&n=16&b.integrand=linear"
    "&b.dims=1&b.n=16&b.density=linear(slope=-1.2)",
    "Strata at an edge, and between": "n=64&integrand=half-space(normal=[1, 0], offset=0.5)"
    "&b.n=64&b.integrand=half-space(normal=[1, 0], offset=0.5)&b.strata_shift=0.5",
    "Mirroring removes the jump": "sampler=jittered | shift&integrand=linear&dims=1&n=16"
    "&b.sampler=jittered | shift&b.integrand=linear&b.dims=1&b.n=16&b.mirror=integrand",
    "A pixel of Veach's scene": f"integrand={pixel_spec(96, 100)}&n=64",
}
"""Main examples of a talk: the text of each link, and the query string that shows the example."""


@final
class Explorer:
    """Controls, figures and exports of one session.

    Parameters
    ----------
    document
        Bokeh document of the session.
    query
        Query string in the address.
    """

    def __init__(self, document: Any, query: str) -> None:
        refused = ""
        try:
            self.state = _state_of(query)
        except McspectraError as error:
            self.state, refused = ExplorerState(), f"{error} The defaults are shown."
        self._document, self._loop = document, IOLoop.current(instance=False)
        self._started = self._closed = self._furnished = False
        self._sheet = InlineStyleSheet(css=_WIDGETS)
        self._boards: dict[str, Board] = {}
        self._controls: dict[str, Controls] = {}
        self._both: Card | None = None  # the curves of A and B in one plot
        self._curves: dict[str, Any] = {}  # the curves that this plot shows

        def block(**options: Any) -> Any:
            return Div(
                sizing_mode="stretch_width",
                stylesheets=[self._sheet],
                disable_math=True,
                **options,
            )

        self._sides = Column(sizing_mode="stretch_width")
        self._headers = Row(sizing_mode="stretch_width")
        self._summary = block()
        self._refused = block(
            text=f'<p role="alert" class="alert">{escape_html(refused)}</p>', visible=bool(refused)
        )
        self._compare = Checkbox(
            label="Compare with a second set-up, B", active=self.state.b is not None,
            stylesheets=[self._sheet],
        )  # fmt: skip
        self._compare.on_change("active", self._choose_comparison)
        self._scene = SceneView(self._sheet, self._choose_pixel, self._later)
        # Texts to export, each with a button that copies it to the clipboard
        self._texts: dict[str, Any] = {}
        self._exports: list[Any] = []
        for name in ("Python", "TOML"):
            self._texts[name] = area = TextAreaInput(
                title=f"As {name}", rows=12, max_length=100_000, sizing_mode="stretch_width",
                stylesheets=[self._sheet],
            )  # fmt: skip
            button = Button(label=f"Copy as {name}", width=140, stylesheets=[self._sheet])
            button.js_on_click(CustomJS(args={"text": area}, code=_COPY))
            self._exports.append(Column(children=[button, area], sizing_mode="stretch_width"))
        examples = "".join(
            f'<li><a href="?{urlencode(parse_qsl(query))}">{escape_html(title)}</a></li>'
            for title, query in _EXAMPLES.items()
        )
        self._talk = block(
            text=f"<details><summary>Examples of the talk</summary><ul>{examples}</ul></details>"
        )
        # If anything changes, Bokeh lays out the whole root element and draws all of its figures.
        # Use separate root elements, so that a change of a text or figure moves no other figure
        self._slots: dict[tuple[str, str], Any] = {
            place: Column(visible=False, sizing_mode="stretch_width") for place in _PLACES
        }
        self.roots: dict[str, Any] = {
            "side": Column(sizing_mode="stretch_width"),
            "head": Column(
                children=[self._refused, self._headers, self._summary], sizing_mode="stretch_width"
            ),
            "scene": self._scene.layout,
            **{_name(*place): slot for place, slot in self._slots.items()},
            "foot": Column(stylesheets=[_TEXTS], sizing_mode="stretch_width"),
        }
        self.roots["head"].js_on_change("tags", CustomJS(code=_TELL))
        self._arrange()

    def prepare(self) -> None:
        """Draw the top figure of the page if its results are in the cache."""
        kind = "integrand" if self.state.b is None else "convergence"
        results = {side: first_round(kind, setup) for side, setup in self.state.setups()}
        if all(result is not None for result in results.values()):
            for side, setup in self.state.setups():
                board = self._boards[side]
                board.latest[kind] = results[side]
                if self.state.b is None:
                    board.show(kind, setup)
            self._draw_both()
            self._lay_out()

    def attach(self, document: Any) -> None:
        """Show the page in the document of a session."""
        self._document, self._loop = document, IOLoop.current(instance=False)
        document.on_event("document_ready", lambda _: self.start())
        document.on_session_destroyed(lambda _: self.close())
        with document.models.freeze():  # Bokeh searches all models once, not after each root
            for name, root in self.roots.items():
                root.name = name
                document.add_root(root)

    def start(self) -> None:
        """Start computing when a browser shows the page. Requests alone compute nothing."""
        if not self._started:  # the event occurs again when a browser reconnects
            self._started = True
            for side, setup in self.state.setups():
                self._boards[side].run(setup)
            # If a link contains a pixel, show the picture as well
            if any("pixel(" in setup.integrand for _, setup in self.state.setups()):
                self._scene.open()
            # Show the controls after the first figure, or soon if the first figure takes long
            if any(slot.visible for slot in self._slots.values()):
                self._furnish()
            else:
                self._document.add_timeout_callback(self._furnish, _LONGEST_WAIT)

    def close(self) -> None:
        """Cancel all jobs when the tab is closed."""
        self._closed = True
        for board in self._boards.values():
            board.cancel(quiet=True)

    def _furnish(self) -> None:
        """Show the controls and the exports, once."""
        if not self._furnished:
            self._furnished = True
            self._lay_out_controls()
            self.roots["side"].children = [self._talk, self._compare, self._sides]
            self.roots["foot"].children = self._exports

    def _lay_out_controls(self) -> None:
        """Create and show the controls of the current set-ups. Two set-ups have a tab each."""
        setups = dict(self.state.setups())
        for side in [side for side in self._controls if side not in setups]:
            self._controls.pop(side)
        for side, setup in setups.items():
            if side not in self._controls:
                self._controls[side] = Controls(
                    setup, side, self._sheet,
                    on_change=partial(self._change, side),
                    on_error=self._boards[side].refuse,
                    on_scene=self._scene.open,
                    later=self._later,
                )  # fmt: skip
        layouts = {side: each.layout for side, each in self._controls.items()}
        self._tabs = Tabs(
            tabs=[TabPanel(child=layout, title=side) for side, layout in layouts.items()],
            sizing_mode="stretch_width", stylesheets=[self._sheet],
        )  # fmt: skip
        self._sides.children = [self._tabs] if len(layouts) > 1 else list(layouts.values())

    def _arrange(self) -> None:
        """Create the boards of the current set-ups, and lay out their figures."""
        setups = dict(self.state.setups())
        for side in [side for side in self._boards if side not in setups]:
            self._boards.pop(side).cancel(quiet=True)
        for side in setups:
            if side not in self._boards:
                self._boards[side] = Board(
                    side, self._sheet,
                    later=self._later, on_update=self._write_texts, on_shown=self._shown,
                )  # fmt: skip
        for board in self._boards.values():
            board.pair(len(setups) > 1)
        if self._furnished:
            self._lay_out_controls()
        self._headers.children = [board.header for board in self._boards.values()]
        self._lay_out()
        self._tell_address()

    def _lay_out(self) -> None:
        """Put each figure into its slot. Figures of A and B are side by side."""
        cards = {side: dict(board.cards) for side, board in self._boards.items()}
        if self._both is not None:
            for own in cards.values():
                own.pop("convergence", None)
        kinds = {kind for own in cards.values() for kind in own}
        cards[JOINT] = {} if self._both is None else {"convergence": self._both}
        wanted: dict[tuple[str, str], tuple[list[Any], bool]] = {}
        for side, kind in self._slots:
            card = cards.get(side, {}).get(kind)
            # If only the other set-up has this figure, the slot is blank, so that pairs remain
            visible = card is not None or (side in self._boards and kind in kinds)
            wanted[side, kind] = ([] if card is None else [card.layout], visible)
        changed = {
            place: new
            for place, new in wanted.items()
            if new != (self._slots[place].children, self._slots[place].visible)
        }
        if not changed:
            return
        # Bokeh searches all models for new ones after each change: let it search once, then send
        self._document.hold()
        with self._document.models.freeze():
            for place, (children, visible) in changed.items():
                classes = children[0].css_classes if children else []
                self._slots[place].update(children=children, visible=visible, css_classes=classes)
        self._document.unhold()

    def _draw_both(self) -> None:
        """Draw the curves of A and B in one plot."""
        curves = {
            f"{side}: {setup.displaced_sampler}": curve
            for side, setup in self.state.setups()
            if (curve := self._boards[side].latest.get("convergence")) is not None
        }
        before = self._both
        if len(curves) < 2:  # keep the figure while a set-up is computed again
            if self.state.b is None:
                self._both = None
            elif before is not None and not any(board.busy for board in self._boards.values()):
                before.layout.styles = STALE
            self._curves = {}
        elif list(curves) != list(self._curves) or any(
            curve is not self._curves[name] for name, curve in curves.items()
        ):
            self._both = card_of(describe("convergence", curves), JOINT, before, self._sheet)
            self._curves = curves

    def _later(self, act: Any) -> None:
        """Schedule `act` in the session's thread with the document's lock. Any thread may call."""

        def add() -> None:
            if not self._closed:
                self._document.add_next_tick_callback(act)

        if self._loop is not None:
            self._loop.add_callback(add)

    def _change(self, side: str, setup: ExplorerSetup) -> None:
        here = self.state
        self.state = replace(here, a=setup) if side == "A" else replace(here, b=setup)
        self._refused.visible = False
        self._tell_address()
        self._boards[side].run(setup)

    def _choose_comparison(self, attr: str, old: bool, new: bool) -> None:
        del attr, old
        other = replace(self.state.a, sampler="random") if new else None
        self.state = replace(self.state, b=other)
        self._arrange()
        if other is not None:
            self._boards["B"].run(other)
        self._shown()
        self._write_texts("")

    def _choose_pixel(self, x: int, y: int, strategy: str) -> None:
        self._furnish()
        side = "B" if self.state.b is not None and self._tabs.active == 1 else "A"
        try:
            spec = pixel_spec(x, y, strategy)
        except McspectraError as error:
            self._controls[side].refuse(str(error))
            return
        self._controls[side].change(integrand=spec, dims=2, density="uniform", smoothing=0.0)

    def _tell_address(self) -> None:
        self.roots["head"].tags = [self.state.query(), self.state.b is not None]

    def _write_texts(self, refused: str) -> None:
        """Export the set-up as Python code and as a study file, from cached results.

        Jobs may call this method in their own threads.
        """
        try:
            texts = (
                (f"# {refused}",) * 2 if refused else (as_python(self.state), as_toml(self.state))
            )
        except McspectraError as error:
            texts = (f"# {error}",) * 2

        def show() -> None:
            for area, text in zip(self._texts.values(), texts, strict=True):
                area.value = text

        self._later(show)

    def _shown(self) -> None:
        """Update the places of figures and the table of results."""
        self._draw_both()
        self._lay_out()
        self._furnish()
        rows = [_row(side, setup, self._boards[side]) for side, setup in self.state.setups()]
        head = "".join(
            f'<th scope="col">{name}</th>'
            for name in ("set-up", "sampler", "n", "variance", "predicted / measured", "rate")
        )
        self._summary.text = f"<table><tr>{head}</tr>{''.join(rows)}</table>"


@final
class FirstPage:
    """The default page, made while the browser starts.

    Loading and compiling the code of the first computation takes most of the time.
    """

    def __init__(self) -> None:
        self._explorer: Explorer | None = None
        self._made, self._asked = threading.Event(), threading.Event()

    def make(self) -> None:
        """Compute the first round of the page, and draw the top figure."""
        setups = [setup for _, setup in _state_of("").setups()]
        try:
            for setup in setups:
                compute("convergence", setup, next(rounds(setup)))
            explorer = Explorer(Document(), "")
            explorer.prepare()
            self._explorer = explorer
        finally:
            self._made.set()
        for kind in UPDATE_KINDS:
            for setup in setups:
                if self._asked.is_set():  # the job of this page computes the rest
                    return
                compute(kind, setup, next(rounds(setup)))

    def take(self, query: str) -> Explorer | None:
        """Return the page at the first call without a query, otherwise None."""
        self._asked.set()
        if query:
            return None
        self._made.wait(_LONGEST_MAKING)
        explorer, self._explorer = self._explorer, None
        return explorer


def build_page(document: Any, first: FirstPage | None = None) -> None:
    """Create the page of a new session from the query string in its address.

    Parameters
    ----------
    document
        Bokeh document of the session.
    first
        The default page if it is made in advance. Requests themselves compute nothing.
    """
    arguments = document.session_context.request.arguments
    query = urlencode([(key, value) for key, values in arguments.items() for value in values])
    explorer = None if first is None else first.take(query)
    if explorer is None:
        explorer = Explorer(document, query)
        explorer.prepare()
    explorer.attach(document)
    document.title = TITLE
    document.template = _TEMPLATE
    document.template_variables.update(
        theme=explorer.state.theme, themes=THEMES, paired=explorer.state.b is not None,
        figures=[_name(*place) for place in _PLACES],
    )  # fmt: skip


def _state_of(query: str) -> ExplorerState:
    """Return the state of an address. If the address has no set-up, this is the first example."""
    first = "" if "=" in query.replace("theme=", "") else next(iter(_EXAMPLES.values()))
    return ExplorerState.from_query(
        urlencode(parse_qsl(first) + parse_qsl(query)) if first else query
    )


def _name(side: str, kind: str) -> str:
    """Return the name of the root element of a figure."""
    return f"{side}: {kind}"


def _row(side: str, setup: ExplorerSetup, board: Board) -> str:
    terms, curve = board.latest.get("terms"), board.latest.get("convergence")
    missing = "…" if board.busy else "–"

    # Show the ratio of measured and predicted variance, as in the summary of a report.
    # Measured and predicted variance are for the n at which the variance terms were computed
    parts = {k: v for k, v in board.latest.items() if k in ("terms", "predict")}
    ratio = missing
    if len(parts) == 2:
        ratio = summary_table(rows_of(side, setup.displaced_sampler, parts)).rows[0][4].text
    cells = [
        setup.displaced_sampler,
        str(setup.n),
        missing if terms is None else number(float(terms["measured_variance"])),
        ratio,
        missing
        if curve is None
        else rate(float(curve["rate"]), *map(float, curve["rate_ci"].values)),
    ]
    inside = "".join(f"<td>{escape_html(cell)}</td>" for cell in cells)
    return f'<tr><th scope="row">{side}</th>{inside}</tr>'


def as_python(state: ExplorerState) -> str:
    """Return a program that computes and prints the results shown in the explorer.

    Raises
    ------
    McspectraError
        If a set-up cannot be created.
    """
    parts = [_PROGRAM]
    several = state.b is not None
    for name, setup in state.setups():
        # Create density and estimator
        specs, lines = integrand_specs(setup), []
        density = "None"
        if setup.density != "uniform":
            density = f"mcs.density({setup.density!r}, dims={setup.dims})"
        if len(specs) == 1:
            lines.append(f"integrand = mcs.integrand({specs[0]!r}, dims={setup.dims})")
        if setup.smoothing:
            lines.append(f"integrand = mcs.smoothed(integrand, {setup.smoothing!r})")
        lines.append(f"density = {density}")
        if len(specs) == 1:
            lines.append("estimator = mcs.Estimator(integrand, density)")
        else:
            inside = [f"    {spec!r}," for spec in specs]
            lines += [
                "estimator = mcs.estimators.TechniqueSum([",
                *inside,
                f"], dims={setup.dims})",
            ]
        if setup.mirror != "none":
            lines.append(f"estimator = mcs.Mirrored(estimator, {setup.mirror!r})")
        lines.append(f"sampler = mcs.sampler({setup.displaced_sampler!r}, dims={setup.dims})")
        for table, analysis in _exported(setup).items():
            given = _chosen(analysis)
            first = [repr(given.pop(o.name)) for o in options_of(type(analysis)) if o.required]
            of_points = analysis.about == "sampler"
            subject = ["sampler"] if of_points else ["estimator", "sampler"]
            named = [f"{key}={value!r}" for key, value in given.items()]
            named = [*(["density=density"] if of_points else []), *named, f"rng={setup.seed}"]
            call = textwrap.fill(", ".join([*subject, *first, *named]) + ",", 90)
            lines += [f"{table} = mcs.{analysis.function}(", textwrap.indent(call, "    "), ")"]
        lines += [
            'for name in ("dc_term", "power_term", "cross_term", "measured_variance"):',
            '    print(f"{name:18}  {float(terms[name]):.6g}")',
            f"predicted = float(predict['predicted_variance'].sel(n={setup.n}))",
            """print(f"{'predicted_variance':18}  {predicted:.6g}")""",
            'low, high = convergence["rate_ci"].values',
            """rate = f"{float(convergence['rate']):.4g}" if high - low <= 1 else "unresolved\"""",
            """print(f"{'rate':18}  {rate}")""",
        ]
        parts.append((f"# {name}\n" if several else "") + "\n".join(lines) + "\n")
    return "\n".join(parts)


def _exported(setup: ExplorerSetup) -> dict[str, Analysis]:
    """Return the analyses that print numbers. Each of them draws its own points."""
    return {name: each for name, each in analyses_of(setup).items() if name != "points"}


def _chosen(analysis: Analysis) -> dict[str, Any]:
    """Return the options of an analysis that differ from their defaults, with tuples as lists."""
    given = {o.name: getattr(analysis, o.name) for o in options_of(type(analysis))}
    defaults = {o.name: o.default for o in options_of(type(analysis))}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in given.items()
        if value != defaults[key]
    }


def as_toml(state: ExplorerState) -> str:
    """Return a study file with the same analyses, for the command ``mcspectra run``.

    Raises
    ------
    McspectraError
        If a set-up cannot be created.
    """
    entries: list[dict[str, Any]] = []
    for name, setup in state.setups():
        parts = integrand_specs(setup)
        entries.append(
            {
                "name": name,
                "dims": setup.dims,
                **({"integrand": parts[0]} if len(parts) == 1 else {"integrands": list(parts)}),
                "samplers": [setup.displaced_sampler],
                "density": None if setup.density == "uniform" else setup.density,
                "smoothed": setup.smoothing or None,
                "mirror": None if setup.mirror == "none" else setup.mirror,
                **{table: _chosen(analysis) for table, analysis in _exported(setup).items()},
            }
        )
    study = {"title": "From the explorer", "seed": state.a.seed, "estimators": entries}
    specs = [spec for _, setup in state.setups() for spec in techniques(setup.integrand)]
    uploaded = any(parse(spec).name == UPLOAD for spec in specs)
    # By default, a study reads files only from its own folder; other folders must be allowed
    note = "# Run with --allow-path and the folder of the picture below.\n" if uploaded else ""
    return note + study_toml(study)
