"""Signs of the three terms of the variance, for constant densities and importance sampling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np
import xarray as xr

import mcspectra as mcs
from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Line, Mark, Panel, Plot, ReferenceLine
from mcspectra.plots.scales import unit_axis
from mcspectra.plots.style import FAINT, GRAY, INK, MARKERS, PALETTE, TERM_COLORS
from mcspectra.plots.text import number
from mcspectra.report.page import Slider
from mcspectra.reproduction.claims import Claim, Exhibit, Measured, about, correction
from mcspectra.reproduction.panels import plot_of, term_panel

__all__ = ["exhibit"]

N = 16
# Half widths of the sums over frequencies. A single frequency needs only the half width 1.
_FEW, _MANY = 4, 64
_SHAPE, _FILL = PALETTE[2], "#D5EAE2"  # colors of f and p


@final
@dataclass(frozen=True)
class TermsCase:
    """An estimator with a sampler.

    Attributes
    ----------
    function
        Name of the integrand: ``line``, ``bar``, ``one``, or ``wave`` for 1 − sin 2πx.
    amplitude
        Amplitude a of the density 1 + a sin(2πx), or 0 for a constant density.
    """

    title: str
    function: str
    amplitude: float
    sampler: str

    @property
    def integrand(self) -> mcs.Integrand:
        """The integrand of this case: a line, a bar, a constant or a wave."""
        if self.function == "line":
            return mcs.integrand("linear", 1)
        if self.function == "bar":  # the edges are in the middle of strata 4 and 10 of 16
            return mcs.integrand(f"disk(center={7.5 / N}, radius={3 / N})", 1)
        return _wave(0.0 if self.function == "one" else 1.0)

    @property
    def estimator(self) -> mcs.Estimator:
        """The integrand and its density, as an estimator."""
        return mcs.Estimator(self.integrand, _density(self.amplitude) if self.amplitude else None)

    def terms(self, realizations: int, seed: int) -> xr.Dataset:
        """Estimate the variance terms. Integrands with jumps get more frequencies."""
        wide = _MANY if self.function in ("line", "bar") else _FEW
        return mcs.variance_terms(
            self.estimator, self.sampler, N, half_width=wide, realizations=realizations, rng=seed
        )

    def exact(self) -> tuple[float, float, float]:
        """Return the exact variance terms, summed over all frequencies.

        After a random shift, only the second variance term remains.
        The second term alone is therefore the variance of shifted points.
        For f(x) = x (``line``), the variance of jittered points is 1/(12N³).
        For an interval (``bar``), the variance is 1/(2N²), because each edge halves a stratum.
        """
        if self.sampler == "random":
            return self.exact_random()
        if self.function == "line":
            second = 1 / (6 * N**2) - 1 / (12 * N**3)
            return 0.0, second, 1 / (12 * N**3) - second
        if self.function == "bar":
            return 0.0, 1 / (3 * N**2), 1 / (6 * N**2)
        # The wave has only the frequencies −1, 0 and 1
        m = np.arange(-1, 2)[:, None]
        f = self.integrand.fourier(m)
        c = mcs.spectra.closed_form_covariance(
            self.sampler, N, m[:, None], m[None], self.estimator.density
        )
        matrix = (f.conj()[:, None] * f * c).real
        first, second = float(matrix[1, 1]), float(matrix[0, 0] + matrix[2, 2])
        return first, second, float(matrix.sum()) - first - second

    def panel(self, data: xr.Dataset, y: str = "", *, digits: int = 2) -> Panel:
        """Return a waterfall of the exact terms, beside the measured variance."""
        variance = Measured.of(data, "measured_variance")
        return term_panel(self.exact(), variance, 1e-3, self.title, y, digits=digits)

    def exact_random(self, *, printed: bool = False) -> tuple[float, float, float]:
        """Return the exact variance terms for random points.

        The integrals are midpoint sums, which are accurate for periodic functions.

        N times the terms: I² (∫1/p − 1), ∫1/p (∫f² − I²) and Cov(f², 1/p), with x uniform.
        If `printed`, the third term has ⟨S_m* S_l⟩ instead of ⟨S_m S_l*⟩.
        It is then the third term of the reflected integrand f(1 − x).
        """
        x = (np.arange(4096) + 0.5)[:, None] / 4096
        f = self.integrand(1.0 - x if printed else x)
        p = 1.0 + self.amplitude * np.sin(2 * np.pi * x[:, 0])
        integral, square, inverse = f.mean(), (f**2).mean(), (1 / p).mean()
        first = integral**2 * (inverse - 1.0)
        second = inverse * (square - integral**2)
        third = (f**2 / p).mean() - square * inverse
        return float(first) / N, float(second) / N, float(third) / N


LINE = TermsCase("f = x, jittered", "line", 0.0, "jittered")
BAR = TermsCase("bar, jittered", "bar", 0.0, "jittered")
GOOD = TermsCase("p follows f, random", "wave", -0.8, "random")
STRATIFIED = TermsCase("p follows f, jittered", "wave", -0.8, "jittered")
BAD = TermsCase("p opposes f, random", "wave", 0.8, "random")
FLAT = TermsCase("f = 1, random", "one", -0.8, "random")


def _wave(height: float) -> mcs.Integrand:
    def f(x: Array) -> Array:
        return np.asarray(1.0 - height * np.sin(2 * np.pi * x[..., 0]))

    return mcs.Integrand.from_function(f, dims=1, integral=1.0)


def _density(amplitude: float) -> mcs.Density:
    def pdf(x: Array) -> Array:
        return np.asarray(1.0 + amplitude * np.sin(2 * np.pi * x[..., 0]))

    return mcs.Density.from_functions(pdf=pdf, dims=1)


def exhibit(*, quick: bool, seed: int) -> Exhibit:
    """Measure the terms in cases that confirm statements of the slides, and in counterexamples."""
    realizations = 1000 if quick else 10_000
    of = {case: case.terms(realizations, seed) for case in (LINE, BAR, GOOD, STRATIFIED, BAD, FLAT)}
    shifted = TermsCase("", "line", 0.0, "jittered | shift").terms(realizations, seed)
    third = {case: number(case.exact()[2]) for case in of}
    with_f = "With importance sampling that follows f, {} points, the third term is negative."
    # If p = f, every estimate is I, so the third term is minus the sum of the other two
    estimator = mcs.Estimator(_wave(0.8), _density(-0.8))
    perfect = mcs.variance_terms(
        estimator, "jittered", N, half_width=_FEW, realizations=100, rng=seed
    )
    every = [*(data for case, data in of.items() if case != FLAT), shifted]
    found = [Measured.of(data, "power_term") for data in every]
    counter = BAR.panel(of[BAR], digits=3)
    frames = {f"{a:g}": _scanned(a, counter) for a in (-0.8, -0.4, 0.0, 0.4, 0.8, 0.95)}
    return Exhibit(
        numbers={
            "line": third[LINE],
            "bar": third[BAR],
            "good": third[GOOD],
            "bad": third[BAD],
            "N": N,
            "without": number(LINE.exact()[1] / sum(LINE.exact()), 2),
            "two": number(sum(GOOD.exact()[:2]) / sum(GOOD.exact()), 2),
            "printed": number(sum(GOOD.exact_random(printed=True)) / sum(GOOD.exact()), 2),
        },
        plots=(
            plot_of(
                "crucial-terms",
                LINE.panel(of[LINE], "terms · 10³"),
                FLAT.panel(of[FLAT]),
                GOOD.panel(of[GOOD], "terms · 10³"),
                term_panel(
                    GOOD.exact_random(printed=True),
                    Measured.of(of[GOOD], "measured_variance"),
                    1e-3,
                    "the same, as printed",
                ),
            ),
            frames["0.8"],
            plot_of(
                "six-cases",
                *(
                    case.panel(data, "" if k % 3 else "terms · 10³")
                    for k, (case, data) in enumerate(of.items())
                ),
            ),
        ),
        sliders={"importance-terms": Slider("density p = 1 − a sin 2πx, a =", frames, "0.8")},
        claims=(
            *about(
                "importance-terms",
                Claim(
                    f"The second term is always positive: case of {len(every)} (without f = 1, "
                    "which "
                    "has no second term) whose interval is nearest to 0.",
                    min(found, key=lambda each: each.low / each.value),
                    above=0.0,
                ),
                Claim(
                    "For constant PDF the first term is zero: largest value.",
                    max(float(data["dc_term"]) for data in (of[LINE], of[BAR], shifted)),
                    at_most=1e-20,
                ),
                _negative(
                    "For constant PDF the third term is negative on f(x) = x, jittered points.",
                    of[LINE],
                ),
                # The variance is 2 · ¼/N², because each of the two edges halves a stratum.
                # The second term is the variance after a random shift: 2 · 1/(6N²)
                correction(
                    Claim(
                        "Counterexample: for constant PDF and a bar whose edges halve strata, "
                        "the third "
                        "term of jittered points is positive: 1/(6N²) in total, here over |m| ≤ "
                        "64.",
                        Measured.of(of[BAR], "cross_term"),
                        expected=exact_bar(_MANY),
                        digits=4,
                        note=f"1/(6N²) is {number(1 / (6 * N**2))}.",
                    )
                ),
                correction(
                    Claim(
                        "Counterexample: for shifted points of constant PDF the third term is "
                        "zero.",
                        Measured.of(shifted, "cross_term"),
                        expected=0.0,
                    )
                ),
                *(
                    Claim(
                        f"{case.title}: the third term is the covariance of f² and 1/p over the "
                        "domain, divided by N.",
                        Measured.of(of[case], "cross_term"),
                        expected=case.exact_random()[2],
                        digits=4,
                    )
                    for case in (GOOD, BAD)
                ),
                _negative(with_f.format("random"), of[GOOD]),
                _negative(with_f.format("jittered"), of[STRATIFIED]),
                correction(
                    Claim(
                        "Counterexample: if the density is low where f is high, the third term is "
                        "positive.",
                        Measured.of(of[BAD], "cross_term"),
                        above=0.0,
                    )
                ),
                correction(
                    Claim(
                        "The first term does not reduce the variance: I² Var(S₀) is never "
                        "negative; with "
                        "importance sampling that follows f it is I² (∫1/p − 1)/N.",
                        Measured.of(of[GOOD], "dc_term"),
                        expected=GOOD.exact_random()[0],
                        digits=4,
                        note="The slide holds if the third term outweighs the first.",
                    )
                ),
            ),
            *(_crucial(case, of[case]) for case in (LINE, GOOD)),
            correction(
                Claim(
                    "With ⟨S_m* S_l⟩, as printed, the three terms are not the variance if p "
                    "follows f, random points: variance divided by their sum.",
                    Measured.of(of[GOOD], "measured_variance")
                    / sum(GOOD.exact_random(printed=True)),
                    below=0.9,
                )
            ),
            Claim(
                "The first term cannot be ignored for importance sampling: for f = 1 it is the "
                "whole variance: share minus 1.",
                float(of[FLAT]["dc_term"] / of[FLAT]["measured_variance"]) - 1.0,
                at_most=1e-9,
            ),
            Claim(
                "With the density f itself (1 − 0.8 sin 2πx) the third term cancels the first two: "
                "sum of all three relative to the first two.",
                float(perfect["predicted_variance"])
                / float(perfect["dc_term"] + perfect["power_term"]),
                at_most=1e-9,
            ),
            *(
                Claim(
                    f"{case.title}: the exact three terms sum to the measured variance.",
                    Measured.of(of[case], "measured_variance", log=True),
                    expected=sum(case.exact()),
                    digits=4,
                )
                for case in (LINE, GOOD, STRATIFIED, FLAT)
            ),
        ),
    )


def _scanned(slope: float, counter: Panel) -> Plot:
    """Plot two cases: f and p on top, and the terms below.

    On the left, p = 1 − a sin(2πx) with a = `slope`, and terms of random points against a.
    On the right is the counterexample, whose terms are the panel `counter`.
    """
    x = np.linspace(0.0, 1.0, 200)
    wave = np.sin(2 * np.pi * x)
    pair = Panel(
        marks=(
            Line(x=x, y=1 - wave, low=0 * x, high=1 - wave, color=_FILL, width=0.0),
            Line(x=x, y=1 - wave, color=_SHAPE, width=1.8, label="f"),
            Line(x=x, y=1 - slope * wave, color=_SHAPE, dashes="--", width=1.8, label="p"),
        ),
        x=unit_axis("x"),
        y=Axis(low=0.0, high=2.1, ticks={0.0: "0", 1.0: "1", 2.0: "2"}),
        title=f"random points, a = {slope:g}".replace("-", "−"),
    )
    edges = np.array([4.5, 10.5]) / N
    x = np.repeat([0.0, *edges, 1.0], 2)[1:-1]
    y = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    bar = Panel(
        marks=(
            Line(x=x, y=y, low=0 * y, high=y, color=_FILL, width=0.0),
            *(ReferenceLine(at=k / N, axis="x", color=FAINT, width=0.7) for k in range(1, N)),
            Line(x=x, y=y, color=_SHAPE, width=1.8),
            Line(x=x, y=np.ones_like(x), color=_SHAPE, dashes="--", width=1.8),
        ),
        x=unit_axis("x"),
        y=Axis(low=0.0, high=2.1, ticks={0.0: "0", 1.0: "1", 2.0: "2"}),
        title="jittered points, p = 1",
    )
    names = {"dc_term": "first term", "power_term": "second term", "cross_term": "third term"}
    at = np.linspace(-0.9, 0.97, 80)
    known = np.array([TermsCase("", "wave", -a, "random").exact_random() for a in at]) * 1e3
    here = 1e3 * np.array(TermsCase("", "wave", -slope, "random").exact_random())
    marks: list[Mark] = [
        ReferenceLine(at=0.0, color=INK, width=0.7),
        ReferenceLine(at=slope, axis="x", color=GRAY, dashes="--"),
    ]
    for k, (name, label) in enumerate(names.items()):
        color = TERM_COLORS[name]
        marks.append(Line(x=at, y=known[:, k], color=color, width=2.0, label=label))
    total = known.sum(axis=1)
    marks.append(Line(x=at, y=total, color=INK, width=2.0, label="sum, the variance"))
    colors = [*(TERM_COLORS[name] for name in names), INK]
    marks += [
        Dots(x=np.array([slope]), y=np.array([y]), color=color, marker=marker, size=6.0)
        for y, color, marker in zip([*here, here.sum()], colors, MARKERS, strict=False)
    ]
    curves = Panel(
        marks=tuple(marks),
        x=Axis(label="a (p follows f if a > 0)", low=-0.92, high=1.0),
        y=Axis(label="terms · 10³", low=-120.0, high=160.0),
        grid=True,
    )
    plot = plot_of("importance-terms", pair, bar, curves, replace(counter, title=""))
    return replace(plot, rows=(0.5, 1.2))


def _negative(statement: str, data: xr.Dataset) -> Claim:
    return Claim(statement, Measured.of(data, "cross_term"), below=0.0)


def exact_bar(half_width: int) -> float:
    """Return the cross term of `BAR` up to a half width, in closed form.

    For large half widths, the cross term tends to 1/(6N²).
    """
    m = np.arange(-half_width, half_width + 1)[:, None]
    f = BAR.integrand.fourier(m)
    c = mcs.spectra.closed_form_covariance("jittered", N, m[:, None], m[None])
    matrix = f.conj()[:, None] * f * c
    return float((matrix.sum() - np.trace(matrix)).real)


def _crucial(case: TermsCase, data: xr.Dataset) -> Claim:
    """Compare the sum of the first two terms with the measured variance and its interval."""
    both = float(data["dc_term"] + data["power_term"])
    variance = Measured.of(data, "measured_variance")
    ends = both / variance.high, both / variance.low
    return Claim(
        f"The third term is crucial, {case.title}: the first two terms predict more than twice the "
        "variance: ratio.",
        Measured(both / variance.value, *ends, log=True),
        above=2.0,
    )
