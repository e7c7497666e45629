"""The widgets of one set-up. Widgets for options of analyses are derived from the options."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, final

from bokeh.models import Column, InlineStyleSheet
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.groups import CheckboxGroup
from bokeh.models.widgets.inputs import FileInput, Select, TextInput
from bokeh.models.widgets.markups import Div
from bokeh.models.widgets.sliders import CategoricalSlider, Slider

from mcspectra.app.specs import FORMULA, UPLOAD, base_and_steps, chain, changed
from mcspectra.app.state import (
    CHANNELS,
    MIRRORS,
    MOST_HALF_WIDTH,
    MOST_POINTS,
    OPTIONS,
    ExplorerSetup,
)
from mcspectra.app.uploads import keep_upload
from mcspectra.core.errors import McspectraError
from mcspectra.core.spec import parse
from mcspectra.densities import DENSITIES
from mcspectra.integrands import INTEGRANDS
from mcspectra.samplers import SAMPLERS, sampler

__all__ = ["Controls"]

_STEPS = ["shift", "owen", "digital-shift", "random-rotation", "mirror", "shuffle"]
_NEEDS_MORE = {
    # Components that require parameters or files
    "command", "python", "points", "digital-net", "aligned-strata", "bilinear", "defensive",
    "environment", "formula", "grid", "image", "mixture", "piecewise-constant",
    "piecewise-linear", "pixel", "product",
}  # fmt: skip
_OTHER = "use the spec below"
_EXPONENTS = range(2, 13)  # the slider for counts has these powers of 2
_EXAMPLE = "exp(-x**2 - y**2)"
_PICTURES = ".png,.jpg,.jpeg,.exr,.npy"
_TEXTS = {
    "sampler": "Sampler spec", "density": "Density spec", "integrand": "Integrand spec",
    "n": "Exact n", "seed": "Seed",
}  # fmt: skip
_PARTS = {"strata_shift": ("Strata shift", 0.95, 0.05), "smoothing": ("Smoothing width", 0.5, 0.01)}
_CHOICES: dict[str, tuple[str, Sequence[Any]]] = {
    "channel": ("Channel", list(zip(CHANNELS, ("luminance", "red", "green", "blue"), strict=True))),
    "mirror": ("Mirror", MIRRORS),
    "realizations": ("Realizations", ("64", "256", "1024", "4096")),
}
_SLIDERS: dict[str, tuple[tuple[str, float, float, float], ...]] = {
    "linear": (("slope", -1.9, 1.9, 1.0),),
    "power": (("exponent", 0.0, 4.0, 1.0),),
    "exponential": (("rate", 0.1, 8.0, 1.0),),
    "truncated-normal": (("mean", 0.0, 1.0, 0.5), ("sigma", 0.05, 1.0, 0.2)),
    "tent": (("peak", 0.05, 0.95, 0.5),),
}  # parameters of densities, each with a name, smallest, largest and default value


@final
class Controls:
    """Widgets that show a set-up and report changes by the user.

    Parameters
    ----------
    setup
        Set-up shown at first.
    side
        Name of the set-up, ``"A"`` or ``"B"``. All labels contain the name, for screen readers.
    sheet
        Style sheet of the widgets.
    on_change
        Called with the new set-up.
    on_error
        Called with a sentence if an entry is refused. The set-up and the text of the entry remain.
    on_scene
        Called when the user opens Veach's scene.
    later
        Schedules a function in the page's thread, to run after all events of the same message.
    """

    def __init__(
        self,
        setup: ExplorerSetup,
        side: str,
        sheet: InlineStyleSheet,
        *,
        on_change: Callable[[ExplorerSetup], object],
        on_error: Callable[[str], object],
        on_scene: Callable[[], None],
        later: Callable[[Callable[[], None]], object],
    ) -> None:
        self.setup = setup
        self._side, self._sheet = side, sheet
        self._on_change, self._on_error, self._later = on_change, on_error, later
        self._filling = self._refused = False
        self._density_sliders: Any = Column(sizing_mode="stretch_width")
        # Menus offer common specs; text fields accept any spec
        make, density, integrand = self._make, self._named("density"), self._named("integrand")
        steps = CheckboxGroup(labels=_STEPS, stylesheets=[self._sheet])
        self._watch(steps, "active", self._choose_sampler)
        self._widgets = w = {
            "base": make(Select, "Sampler", self._choose_sampler, options=_offered(SAMPLERS)),
            "steps": steps,
            "count": make(
                CategoricalSlider, "Points n", self._entered("n"), "value_throttled",
                categories=["1"], value="1",
            ),
            "density_name": make(Select, "Density", density, options=_offered(DENSITIES)),
            "integrand_name": make(Select, "Integrand", integrand, options=_offered(INTEGRANDS)),
            "formula": make(TextInput, "Formula", self._choose_formula, placeholder=_EXAMPLE),
            "upload": make(
                FileInput, "Picture as integrand", lambda _: self._later(self._take_upload),
                accept=_PICTURES,
            ),
            "dims": make(Select, "Dims", self._choose_dims, options=["1", "2"]),
        }  # fmt: skip
        # Add widgets for the fields of the set-up
        for name, label in _TEXTS.items():
            w[name] = make(TextInput, label, self._entered(name))
        for name, (label, most, step) in _PARTS.items():
            options = {"start": 0.0, "end": most, "step": step, "value": 0.0}
            w[name] = make(Slider, label, self._entered(name), "value_throttled", **options)
        for name, (label, choices) in _CHOICES.items():
            w[name] = make(Select, label, self._entered(name), options=list(choices))
        # Add widgets for the options of the analyses
        for name, option in OPTIONS.items():
            label = name.replace("_", " ").capitalize()
            free = option.required or option.default is None
            if option.choices and option.choices != ("auto",):  # "auto" options also accept numbers
                choices = [
                    *([("", "by default")] if free else []),
                    *((c, c) for c in option.choices),
                ]
                widget = make(Select, label, self._entered(name), options=choices)
            else:
                shown = "chosen automatically" if free else str(option.default)
                widget = make(TextInput, label, self._entered(name), placeholder=shown)
            widget.description = option.meaning
            w[name] = widget
        scene = Button(label=f"Show Veach's scene, {side}", stylesheets=[sheet])
        scene.on_click(on_scene)
        self._fill()

        def heading(text: str, level: str = "h2") -> Any:
            return Div(text=f"<{level}>{text}</{level}>", stylesheets=[sheet])

        self.layout = Column(
            children=[
                heading("Sampler"), w["base"], heading("Randomizations", "h3"), w["steps"],
                w["sampler"], w["count"], w["n"], w["strata_shift"],
                heading("Density"), w["density_name"], self._density_sliders, w["density"],
                heading("Integrand"), w["integrand_name"], w["formula"], w["integrand"],
                w["upload"], scene,
                w["channel"], w["dims"], w["smoothing"], w["mirror"],
                heading("Analysis"), w["realizations"], w["seed"], *(w[name] for name in OPTIONS),
            ],
            sizing_mode="stretch_width",
        )  # fmt: skip

    def show(self, setup: ExplorerSetup) -> None:
        """Show another set-up in the widgets, without reporting a change by the user."""
        self.setup, self._refused = setup, False
        self._fill()

    def refuse(self, sentence: str) -> None:
        """Report why an entry is refused. The entry stays, so that the user can correct it."""
        self._refused = True
        self._on_error(sentence)

    def change(self, **values: Any) -> None:
        """Change fields of the set-up as a user would.

        A value that is a string is read like the value of a parameter in the page's URL.
        """
        try:
            read = {
                k: ExplorerSetup.read(k, v) if isinstance(v, str) else v for k, v in values.items()
            }
            setup = replace(self.setup, **read)
        except McspectraError as error:
            self.refuse(str(error))
            return
        if setup != self.setup or self._refused:
            self.show(setup)
            self._on_change(setup)

    def _make(
        self,
        kind: Any,
        label: str,
        act: Callable[[Any], object],
        name: str = "value",
        **options: Any,
    ) -> Any:
        widget = kind(title=f"{label}, {self._side}", stylesheets=[self._sheet], **options)
        self._watch(widget, name, act)
        return widget

    def _watch(self, widget: Any, name: str, act: Callable[[Any], object]) -> None:
        """Call `act` for entries by the user, but not for changes that `_fill` makes."""
        widget.sizing_mode = "stretch_width"

        def heard(attribute: str, old: Any, new: Any) -> None:
            del attribute, old
            if not self._filling:
                act(new)
                if not self._refused:
                    self._fill()  # show the current value again instead of an invalid entry

        widget.on_change(name, heard)

    def _entered(self, name: str) -> Callable[[Any], None]:
        return lambda value: self.change(**{name: value})

    def _named(self, kind: str) -> Callable[[str], None]:
        return lambda name: None if name == _OTHER else self.change(**{kind: name})

    def _choose_sampler(self, _: Any) -> None:
        w = self._widgets
        if w["base"].value == _OTHER:
            return
        # Keep earlier randomizations in their order, and append new ones
        _, before = base_and_steps(self.setup.sampler)
        ticked = [w["steps"].labels[k] for k in w["steps"].active]
        steps = [*(s for s in before if s in ticked), *(s for s in ticked if s not in before)]
        text = chain(w["base"].value, steps, self.setup.sampler)
        self.change(sampler=text, n=_nearest(text, self.setup.dims, self.setup.n))

    def _choose_formula(self, text: str) -> None:
        if text.strip():
            self.change(integrand=f"{FORMULA}(expression={text.strip()!r})")

    def _choose_dims(self, text: str) -> None:
        dims = int(text)
        self.change(dims=dims, half_width=min(self.setup.half_width, MOST_HALF_WIDTH[dims]))

    def _take_upload(self) -> None:
        upload = self._widgets["upload"]
        try:
            digest = keep_upload(base64.b64decode(upload.value), upload.filename)
        except McspectraError as error:
            self.refuse(str(error))
            return
        self.change(integrand=f"{UPLOAD}(digest='{digest}')", dims=2)

    def _fill(self) -> None:
        """Show the set-up in all widgets."""
        w, setup = self._widgets, self.setup
        self._filling = True
        try:
            base, steps = base_and_steps(setup.sampler)
            w["base"].value = base if base in w["base"].options else _OTHER
            w["steps"].labels = list(dict.fromkeys([*_STEPS, *steps]))
            w["steps"].active = [w["steps"].labels.index(step) for step in steps]
            counts = {_nearest(setup.sampler, setup.dims, 2**k) for k in _EXPONENTS} | {setup.n}
            w["count"].categories = [str(count) for count in sorted(counts)]
            w["count"].value = str(setup.n)
            for kind in ("density", "integrand"):
                name = parse(getattr(setup, kind)).name
                offered = w[f"{kind}_name"].options
                w[f"{kind}_name"].value = name if name in offered else _OTHER
            call = parse(setup.integrand)
            written = call.arguments.get("expression", "") if call.name == FORMULA else ""
            w["formula"].value = str(written)
            now = str(setup.realizations)
            w["realizations"].options = sorted({*w["realizations"].options, now}, key=int)
            for name in ("dims", *_TEXTS, *_CHOICES, *OPTIONS):
                w[name].value = setup.text(name)
            for name in _PARTS:
                w[name].value = getattr(setup, name)
            # Show sliders for the parameters of the density. Another density gets new sliders
            call = parse(self.setup.density)
            ranges = _SLIDERS.get(call.name, ())
            sliders = self._density_sliders
            titles = [f"Density {key}, {self._side}" for key, *_ in ranges]
            if [slider.title for slider in sliders.children] != titles:
                sliders.children = [
                    self._make(
                        Slider, f"Density {key}", self._moved(key), "value_throttled",
                        start=low, end=high, step=0.05, value=start,
                    )
                    for key, low, high, start in ranges
                ]  # fmt: skip
            for slider, (key, low, high, start) in zip(sliders.children, ranges, strict=True):
                value = call.arguments.get(key, start)
                known = isinstance(value, int | float) and low <= value <= high
                slider.value = float(value) if known else start
        finally:
            self._filling = False

    def _moved(self, key: str) -> Callable[[float], None]:
        return lambda value: self.change(density=changed(self.setup.density, key, round(value, 6)))


def _offered(registry: Any) -> list[str]:
    return [_OTHER, *(name for name in registry if name not in _NEEDS_MORE)]


def _nearest(text: str, dims: int, n: int) -> int:
    """Return the possible count that is nearest to n, or n itself if the sampler is invalid."""
    try:
        return min(sampler(text, dims).nearest_count(n), MOST_POINTS)
    except Exception:  # noqa: BLE001 - the job reports the error of the sampler
        return n
