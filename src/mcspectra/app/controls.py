"""The widgets that choose one set-up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import panel as pn

from mcspectra.app.parameters import DENSITY_SLIDERS, base_and_steps, chain, changed, moved
from mcspectra.app.specs import FORMULA, UPLOAD
from mcspectra.app.state import BASES, CHANNELS, MIRRORS, MOST_HALF_WIDTH, MOST_POINTS, Setup
from mcspectra.app.uploads import keep_upload
from mcspectra.core.errors import McspectraError
from mcspectra.core.spec import parse

__all__ = ["Controls"]

_STEPS = ["shift", "owen", "digital-shift", "random-rotation", "mirror", "shuffle"]
_NEEDS_MORE = {
    # Components that mean nothing without parameters, or with files
    "points", "digital-net", "aligned-strata", "bilinear", "defensive", "environment", "formula", "grid",
    "image", "mixture", "piecewise-constant", "piecewise-linear", "pixel", "product", "vegas",
}  # fmt: skip
_OTHER = "as written below"
_EXPONENTS = range(2, 13)  # of 2: the counts on the slider
_REAL_STEP = 0.25
_FREQUENCIES = {"integer": 1.0, "real, every ¼": _REAL_STEP}
_CHANNELS = dict(zip(("luminance", "red", "green", "blue"), CHANNELS, strict=True))
_REALIZATIONS = (64, 256, 1024, 4096)
_HALF_WIDTHS = (16, 32, 64, 128)
_EXAMPLE = "exp(-x**2 - y**2)"
_PICTURES = ".png,.jpg,.jpeg,.exr,.npy"


@final
class Controls:
    """Widgets that show a set-up and call back when the user has changed it.

    Parameters
    ----------
    setup
        What they show at first.
    side
        ``"A"`` or ``"B"``, part of all labels, so that screen readers tell them apart.
    on_change
        Called with the new set-up.
    on_error
        Called with a sentence when what was entered is refused; the set-up stays.
    """

    def __init__(
        self,
        setup: Setup,
        side: str,
        on_change: Callable[[Setup], object],
        on_error: Callable[[str], object],
    ) -> None:
        self.setup = setup
        self._side, self._on_change, self._on_error = side, on_change, on_error
        self._filling = False
        self._density_sliders: Any = pn.Column(sizing_mode="stretch_width")
        self._widgets = self._made()
        self._watch()
        self._fill()
        w = self._widgets
        sampler = [w[k] for k in ("base", "sampler", "count", "n", "strata_shift")]
        density = [w["density_name"], self._density_sliders, w["density"]]
        integrand = [
            w[k]
            for k in (
                "integrand_name",
                "formula",
                "integrand",
                "channel",
                "dims",
                "smoothing",
                "mirror",
            )
        ]
        analysis = [w[k] for k in ("basis", "frequencies", "half_width", "realizations", "seed")]
        self.layout = pn.Column(
            *_section("Sampler", sampler[:1]),
            pn.pane.HTML(f"<p>Randomisations, {side}</p>", margin=(0, 10)),
            w["steps"],
            *sampler[1:],
            *_section("Density", density),
            *_section("Integrand", [*integrand, _upload_row(w["upload"], side)]),
            *_section("Analysis", analysis),
            sizing_mode="stretch_width",
        )

    def show(self, setup: Setup) -> None:
        """Show another set-up without calling back."""
        self.setup = setup
        self._fill()

    def change(self, **values: Any) -> None:
        """Change fields of the set-up as if by hand."""
        try:
            fields = {name: getattr(self.setup, name) for name in Setup.__dataclass_fields__}
            setup = Setup(**{**fields, **values})
        except McspectraError as error:
            self._on_error(str(error))
            return
        if setup != self.setup:
            self.show(setup)
            self._on_change(setup)

    def _made(self) -> dict[str, Any]:
        from mcspectra.densities import DENSITIES
        from mcspectra.integrands import INTEGRANDS
        from mcspectra.samplers import SAMPLERS

        w, label = pn.widgets, self._label
        return {
            "base": w.Select(name=label("Sampler"), options=_offered(SAMPLERS)),
            "steps": w.CheckBoxGroup(name=label("Randomisations"), options=_STEPS),
            "sampler": w.TextInput(name=label("Sampler spec")),
            "count": w.DiscreteSlider(name=label("Points n"), options=[self.setup.n]),
            "n": w.IntInput(name=label("Exact n"), start=1, end=MOST_POINTS),
            "strata_shift": _slider(label("Strata shift"), 0.0, 0.95, 0.05),
            "density_name": w.Select(name=label("Density"), options=_offered(DENSITIES)),
            "density": w.TextInput(name=label("Density spec")),
            "integrand_name": w.Select(name=label("Integrand"), options=_offered(INTEGRANDS)),
            "formula": w.TextInput(name=label("Formula"), placeholder=_EXAMPLE),
            "integrand": w.TextInput(name=label("Integrand spec")),
            "channel": w.Select(name=label("Channel"), options=_CHANNELS),
            "upload": w.FileInput(accept=_PICTURES, multiple=False),
            "dims": w.Select(name=label("Dims"), options=[1, 2]),
            "smoothing": _slider(label("Smoothing width"), 0.0, 0.5, 0.01),
            "mirror": w.Select(name=label("Mirror"), options=list(MIRRORS)),
            "basis": w.Select(name=label("Basis"), options=list(BASES)),
            "frequencies": w.Select(name=label("Frequencies"), options=_FREQUENCIES),
            "half_width": w.Select(name=label("Half width"), options=list(_HALF_WIDTHS)),
            "realizations": w.Select(name=label("Realisations"), options=list(_REALIZATIONS)),
            "seed": w.IntInput(name=label("Seed"), start=0),
        }

    def _label(self, text: str) -> str:
        return f"{text}, {self._side}"

    def _watch(self) -> None:
        w = self._widgets
        for name in ("sampler", "n", "density", "integrand", "channel", "mirror", "basis", "seed"):
            self._bind(w[name], "value", name)
        for name in ("half_width", "realizations"):
            self._bind(w[name], "value", name)
        for name in ("strata_shift", "smoothing"):
            self._bind(w[name], "value_throttled", name)
        self._bind(w["count"], "value_throttled", "n")
        self._bind(w["frequencies"], "value", "frequency_step")
        self._on(w["base"], "value", self._choose_sampler)
        self._on(w["steps"], "value", self._choose_sampler)
        self._on(w["density_name"], "value", lambda name: self._choose("density", name))
        self._on(w["integrand_name"], "value", lambda name: self._choose("integrand", name))
        self._on(w["formula"], "value", self._choose_formula)
        self._on(w["dims"], "value", self._choose_dims)
        self._on(w["upload"], "value", self._take_upload)

    def _bind(self, widget: Any, parameter: str, name: str) -> None:
        self._on(widget, parameter, lambda value: self.change(**{name: value}))

    def _on(self, widget: Any, parameter: str, act: Callable[[Any], object]) -> None:
        """Have `act` called with what the user enters, not with what `_fill` does."""

        def heard(event: Any) -> None:
            if not self._filling and event.new is not None:
                act(event.new)
                self._fill()  # what was refused goes back to what holds

        widget.param.watch(heard, parameter)

    def _choose_sampler(self, _: Any) -> None:
        w = self._widgets
        if w["base"].value == _OTHER:
            return
        text = chain(w["base"].value, self._chosen_steps(), self.setup.sampler)
        self.change(sampler=text, n=_possible(text, self.setup))

    def _chosen_steps(self) -> list[str]:
        """The randomisations that are ticked: those of before in their order, then new ones."""
        _, before = base_and_steps(self.setup.sampler)
        ticked = self._widgets["steps"].value
        kept = [name for name in before if name in ticked]
        return [*kept, *(name for name in ticked if name not in kept)]

    def _choose(self, kind: str, name: str) -> None:
        if name != _OTHER:
            self.change(**{kind: name})

    def _choose_formula(self, text: str) -> None:
        if text.strip():
            self.change(integrand=f"{FORMULA}(expression={text.strip()!r})")

    def _choose_dims(self, dims: int) -> None:
        half_width = min(self.setup.half_width, MOST_HALF_WIDTH[dims])
        self.change(dims=dims, half_width=half_width)

    def _take_upload(self, data: bytes) -> None:
        upload = self._widgets["upload"]
        try:
            digest = keep_upload(data, upload.filename or "")
        except McspectraError as error:
            self._on_error(str(error))
            return
        self.change(integrand=f"{UPLOAD}(digest='{digest}')", dims=2)

    def _fill(self) -> None:
        """Have all widgets show the set-up."""
        self._filling = True
        try:
            self._fill_samplers()
            self._fill_others()
            self._fill_density()
        finally:
            self._filling = False

    def _fill_samplers(self) -> None:
        w, setup = self._widgets, self.setup
        base, steps = base_and_steps(setup.sampler)
        w["base"].value = base if base in w["base"].options else _OTHER
        w["steps"].options = list(dict.fromkeys([*_STEPS, *steps]))
        w["steps"].value = steps
        w["sampler"].value = setup.sampler
        w["count"].options = _counts(setup)
        w["count"].value = w["n"].value = setup.n

    def _fill_others(self) -> None:
        w, setup = self._widgets, self.setup
        for kind in ("density", "integrand"):
            text = getattr(setup, kind)
            name = parse(text).name
            w[kind].value = text
            w[f"{kind}_name"].value = name if name in w[f"{kind}_name"].options else _OTHER
        call = parse(setup.integrand)
        written = call.arguments.get("expression", "") if call.name == FORMULA else ""
        w["formula"].value = str(written)
        for name in ("half_width", "realizations"):
            value = getattr(setup, name)
            w[name].options = sorted({*w[name].options, value})
            w[name].value = value
        step = setup.frequency_step
        w["frequencies"].options = {**_FREQUENCIES} | (
            {} if step in _FREQUENCIES.values() else {f"every {step:g}": step}
        )
        w["frequencies"].value = step
        for name in ("dims", "channel", "mirror", "basis", "seed", "strata_shift", "smoothing"):
            w[name].value = getattr(setup, name)

    def _fill_density(self) -> None:
        """Sliders for the numbers of the density; made anew when it is another one."""
        ranges = DENSITY_SLIDERS.get(parse(self.setup.density).name, ())
        stand = moved(self.setup.density, ranges)
        labels = [self._label(f"Density {key}") for key in stand]
        if [slider.name for slider in self._density_sliders] != labels:
            self._density_sliders.objects = [
                self._density_slider(*each, self._label(f"Density {each[0]}")) for each in ranges
            ]
        for slider, value in zip(self._density_sliders, stand.values(), strict=True):
            slider.value = value

    def _density_slider(self, key: str, low: float, high: float, default: float, label: str) -> Any:
        slider = _slider(label, low, high, 0.05, default)
        self._on(
            slider,
            "value_throttled",
            lambda value: self.change(density=changed(self.setup.density, key, round(value, 6))),
        )
        return slider


def _slider(label: str, low: float, high: float, step: float, value: float = 0.0) -> Any:
    return pn.widgets.FloatSlider(name=label, start=low, end=high, step=step, value=value)


def _section(title: str, widgets: list[Any]) -> list[Any]:
    for widget in widgets:
        widget.sizing_mode = "stretch_width"
    return [pn.pane.HTML(f"<h3>{title}</h3>", margin=(4, 10, 0, 10)), *widgets]


def _upload_row(upload: Any, side: str) -> Any:
    upload.sizing_mode = "stretch_width"
    said = pn.pane.HTML(f"<label>Picture as integrand, {side}</label>", margin=(0, 10))
    return pn.Column(said, upload, sizing_mode="stretch_width", margin=0)


def _offered(registry: Any) -> list[str]:
    return [_OTHER, *(name for name in registry if name not in _NEEDS_MORE)]


def _counts(setup: Setup) -> list[int]:
    """Counts on the slider: those near powers of 2 that the sampler can do, and the present one."""
    found = {setup.n}
    try:
        found |= {_nearest(setup.sampler, setup.dims, 2**k) for k in _EXPONENTS}
    except Exception:  # noqa: BLE001 - the job says what is wrong with the sampler
        return [setup.n]
    return sorted(found)


def _possible(text: str, setup: Setup) -> int:
    """The count nearest to the present one that another sampler can do."""
    try:
        return _nearest(text, setup.dims, setup.n)
    except Exception:  # noqa: BLE001 - the job says what is wrong with the sampler
        return setup.n


def _nearest(text: str, dims: int, n: int) -> int:
    from mcspectra.samplers import sampler

    return min(sampler(text, dims).nearest_count(n), MOST_POINTS)
