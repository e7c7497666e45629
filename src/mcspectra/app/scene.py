"""The picture of Veach's scene on the page. A click or two numbers choose a pixel."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, final

import numpy as np
from bokeh.events import Tap
from bokeh.models import Column, ColumnDataSource, InlineStyleSheet, Row
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.inputs import Select, Spinner
from bokeh.models.widgets.markups import Div

from mcspectra.app.specs import TECHNIQUES
from mcspectra.core.cache import cached_array
from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.display import escape_html
from mcspectra.core.errors import McspectraError
from mcspectra.plots.backend_bokeh import draw
from mcspectra.plots.description import Axis, Panel, Pixels, Plot
from mcspectra.rendering.files import encode_srgb

__all__ = ["HEIGHT", "STRATEGIES", "WIDTH", "SceneView", "pixel_spec", "veach_picture"]

WIDTH, HEIGHT = 192, 128
STRATEGIES = ("light", "bsdf", "balance", "power", "mis-light", "mis-bsdf")
_HEURISTICS = ("balance", "power")  # heuristics for the sum of light and BSDF sampling
_SCENE = f"veach(width={WIDTH}, height={HEIGHT})"
_SPP = 64
_LABELS = {"balance": "light + bsdf, balance", "power": "light + bsdf, power"}
_ADVICE = "Click a point of the picture, or enter its pixel, to analyze the light there."


def pixel_spec(x: int, y: int, strategy: str = "light") -> str:
    """Return the spec of the integrand at a pixel, counted from the left and from the top.

    The strategies ``"balance"`` and ``"power"`` are sums of light and BSDF sampling.
    The balance or power heuristic gives the weights of the two techniques.
    The strategies ``"mis-light"`` and ``"mis-bsdf"`` are the two terms of the sum ``"balance"``.

    Raises
    ------
    ParameterError
        If the pixel lies outside the picture, or the strategy does not exist.
    """
    x = as_integer("x of the pixel", x, least=0, most=WIDTH - 1)
    y = as_integer("y of the pixel", y, least=0, most=HEIGHT - 1)
    as_choice("strategy", strategy, STRATEGIES)
    where = f"scene='{_SCENE}', x={x}, y={y}"
    if strategy not in _HEURISTICS:
        return f"pixel({where}, strategy='{strategy}')"
    parts = [
        f"pixel({where}, strategy='mis-{name}', heuristic='{strategy}')"
        for name in ("light", "bsdf")
    ]
    return f"{TECHNIQUES}(integrands={parts!r})"


def veach_picture() -> Array:
    """Return the scene in 8-bit sRGB, (HEIGHT, WIDTH, 3), with the first row at the top.

    Raises
    ------
    MissingDependency
        If Mitsuba or LLVM is missing.
    """
    linear = cached_array(f"explorer {_SCENE} {_SPP} 1", _rendered)
    return np.rint(255.0 * encode_srgb(linear)).astype(np.uint8)


def _rendered() -> Array:
    from mcspectra.rendering.image import render

    return np.asarray(render(_SCENE, spp=_SPP)["image"].to_numpy(), np.float64)


@final
class SceneView:
    """Picture, pixel and strategy. The picture is rendered when the user opens it.

    Parameters
    ----------
    sheet
        Style sheet of the widgets.
    on_pixel
        Called with x, y and the strategy.
    later
        Schedules a function in the page's thread.
    """

    def __init__(
        self,
        sheet: InlineStyleSheet,
        on_pixel: Callable[[int, int, str], object],
        later: Callable[[Callable[[], None]], object],
    ) -> None:
        self._on_pixel, self._later = on_pixel, later
        style: dict[str, Any] = {"stylesheets": [sheet]}
        self._x = Spinner(title="Pixel x", value=96, low=0, high=WIDTH - 1, width=90, **style)
        self._y = Spinner(title="Pixel y", value=100, low=0, high=HEIGHT - 1, width=90, **style)
        options: Any = [(name, _LABELS.get(name, name)) for name in STRATEGIES]
        self._strategy = Select(
            title="Sampling of", value="light", options=options, width=190, **style
        )
        self._analyse = Button(label="Analyze pixel", width=130, align="end", **style)
        self._analyse.on_click(lambda: self._choose(self._x.value or 0, self._y.value or 0))
        self._said = Div(sizing_mode="stretch_width", visible=False, **style)
        self._marked = ColumnDataSource({"x": [], "y": []})
        wrap: Any = {"flex-wrap": "wrap"}
        self._row = Row(children=[self._x, self._y, self._strategy, self._analyse], styles=wrap)
        self.layout = Column(children=[self._said], sizing_mode="stretch_width")

    def _choose(self, x: float, y: float) -> None:
        self._marked.data = {"x": [int(x) + 0.5], "y": [int(y) + 0.5]}
        self._on_pixel(int(x), int(y), self._strategy.value)

    def _say(self, sentence: str) -> None:
        self._said.visible = True
        self._said.text = f'<p role="status">{escape_html(sentence)}</p>'

    def open(self) -> None:
        """Render and show the picture, once."""
        if self._said.visible:
            return
        self._say("Rendering Veach's scene …")
        threading.Thread(target=self._work, name="explorer scene", daemon=True).start()

    def _work(self) -> None:
        """Render in a separate thread: Mitsuba compiles for several seconds."""
        try:
            image = veach_picture()
        except McspectraError as error:
            sentence = str(error)
            self._later(lambda: self._say(sentence))
            return
        self._later(lambda: self._show(image))

    def _show(self, image: Array) -> None:
        panel = Panel(
            marks=(Pixels(rgb=image),),
            x=Axis(label="x, pixels", low=0.0, high=WIDTH),
            y=Axis(label="y, pixels", low=0.0, high=HEIGHT, flipped=True),
            square=True,
        )
        words = f"Veach's scene. {_ADVICE}"
        figure: Any = draw(Plot(kind="scene", panels=(panel,), words=words, wide=True)).model
        for color, width in (("#000000", 4), ("#FFFFFF", 2)):
            figure.scatter(
                "x", "y", source=self._marked, size=12, fill_color=None,
                line_color=color, line_width=width,
            )  # fmt: skip
        figure.on_event(Tap, self._tapped)
        self.layout.children = [self._said, self._row, figure]
        self._say(_ADVICE)

    def _tapped(self, event: Any) -> None:
        if 0 <= event.x < WIDTH and 0 <= event.y < HEIGHT:
            self._x.value, self._y.value = int(event.x), int(event.y)
            self._choose(event.x, event.y)
