"""The picture of Veach's scene on the page: a click, or two numbers, choose a pixel."""

from __future__ import annotations

import threading
from collections.abc import Callable
from html import escape
from typing import Any, final

import panel as pn

from mcspectra.app.look import LOOKS, new_figure
from mcspectra.app.scene import HEIGHT, STRATEGIES, WIDTH, veach_picture
from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError

__all__ = ["SceneView"]

_LABELS = {"balance": "light + bsdf, balance", "power": "light + bsdf, power"}
_OPTIONS = {_LABELS.get(name, name): name for name in STRATEGIES}
_ADVICE = "Click a point of the picture, or give its pixel, to analyse what is seen there."


@final
class SceneView:
    """Picture, numbers and strategy; the picture is rendered when it is asked for.

    Parameters
    ----------
    theme
        Name of the look.
    on_pixel
        Called with x, y and the strategy.
    later
        Has a function called in the page's thread.
    """

    def __init__(
        self,
        theme: str,
        on_pixel: Callable[[int, int, str], object],
        later: Callable[[Callable[[], None]], object],
    ) -> None:
        self._on_pixel, self._later, self._theme = on_pixel, later, theme
        w = pn.widgets
        self._x = w.IntInput(name="Pixel x", value=96, start=0, end=WIDTH - 1, width=90)
        self._y = w.IntInput(name="Pixel y", value=100, start=0, end=HEIGHT - 1, width=90)
        self._strategy = w.Select(name="Sampling of", options=_OPTIONS, width=190)
        self._analyse = w.Button(name="Analyse pixel", width=130, align="end")
        self._analyse.on_click(lambda _: self._choose(self._x.value or 0, self._y.value or 0))
        self._open = w.Button(name="Show Veach's scene", width=180)
        self._open.on_click(lambda _: self._render())
        self._said = pn.pane.HTML("", sizing_mode="stretch_width", margin=(0, 10))
        self._picture = pn.Column(sizing_mode="stretch_width")
        self.layout = pn.Column(self._open, self._said, self._picture, sizing_mode="stretch_width")

    def _choose(self, x: int, y: int) -> None:
        self._on_pixel(x, y, self._strategy.value)

    def _say(self, sentence: str) -> None:
        self._said.object = f'<p role="status">{escape(sentence)}</p>'

    def _render(self) -> None:
        self._open.disabled = True
        self._say("Rendering Veach's scene …")
        threading.Thread(target=self._work, name="explorer scene", daemon=True).start()

    def _work(self) -> None:
        """Render in a thread of its own: Mitsuba compiles for seconds."""
        try:
            image = veach_picture()
        except McspectraError as error:
            sentence = str(error)
            self._later(lambda: self._say(sentence))
            return
        self._later(lambda: self._show(image))

    def _show(self, image: Array) -> None:
        from bokeh.events import Tap

        figure = new_figure(
            "Veach's scene", "x, pixels", "y, pixels", LOOKS[self._theme],
            x_range=(0, WIDTH), y_range=(HEIGHT, 0),
        )  # fmt: skip
        figure.update(max_width=720, aspect_ratio=WIDTH / HEIGHT, sizing_mode="scale_width")
        figure.image_rgba([image], x=0, y=HEIGHT, dw=WIDTH, dh=HEIGHT)
        figure.grid.visible = False
        figure.html_attributes = {"role": "img", "aria-label": f"Veach's scene. {_ADVICE}"}
        figure.on_event(Tap, self._tapped)
        row = pn.Row(self._x, self._y, self._strategy, self._analyse)
        self._picture.objects = [row, pn.pane.Bokeh(figure, sizing_mode="scale_width")]
        self._say(_ADVICE)

    def _tapped(self, event: Any) -> None:
        x, y = int(event.x), int(event.y)
        if 0 <= event.x < WIDTH and 0 <= event.y < HEIGHT:
            self._x.value, self._y.value = x, y
            self._choose(x, y)
