"""Draw the figures of pages that contain no code to run, one PNG for each page.

Run it from the root of the repository: ``python docs/figures/pages.py``, or with names of figures.
The figures of `bases`, `evidence` and `scaling` show numbers from the tables of these pages.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

import mcspectra as mcs

FOLDER = Path(__file__).parent
DOCS = FOLDER.parent
BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
STYLE = {"font.size": 10, "axes.titlesize": 10, "figure.dpi": 110}


def _power(sampler: object, n: int, half_width: int, realizations: int) -> np.ndarray:
    """n times the expected power on a grid of frequencies, 0 at the origin."""
    found = mcs.power_spectrum(sampler, n, half_width=half_width, realizations=realizations, rng=1)
    power = n * found["power"].values
    power[half_width, half_width] = 0.0
    return power.T


def _spectrum(axes: Axes, power: np.ndarray) -> None:
    half = power.shape[0] // 2
    axes.imshow(power, origin="lower", extent=(-half, half, -half, half), cmap="gray", vmax=2)
    axes.set(xticks=[-half, 0, half], yticks=[-half, 0, half])


def conventions() -> Figure:
    figure, (domain, primary, spectrum) = plt.subplots(1, 3, figsize=(10, 2.9))
    f = mcs.integrand("gaussian(center=0.35, width=0.25)", dims=1)
    p = mcs.density("linear(slope=-1.2)", dims=1)
    t = (np.arange(400) + 0.5) / 400
    u = mcs.sampler("jittered", dims=1).draw(12, rng=3)[0]
    x = p.sample(u)
    domain.plot(t, f(t[:, None]), color=BLUE, label="f")
    domain.plot(t, p.pdf(t[:, None]), "--", color=ORANGE, label="p")
    domain.stem(x[:, 0], f(x), linefmt="0.7", markerfmt="ko", basefmt=" ")
    domain.set(title="domain: f, density p, points x", xlabel="x")
    domain.legend()
    v = t[:, None]
    primary.plot(t, f(p.sample(v)) / p.pdf(p.sample(v)), color=GREEN, label="g = f/p")
    primary.stem(u[:, 0], f(x) / p.pdf(x), linefmt="0.7", markerfmt="ko", basefmt=" ")
    primary.set(title="primary space: g = f/p, points u", xlabel="u")
    primary.legend()
    power = mcs.power_spectrum(mcs.sampler("jittered", dims=1), 12, half_width=30, rng=1)
    m = power["m0"].values
    spectrum.plot(m[m != 0], 12 * power["power"].values[m != 0], ".-", color="k", label="n · power")
    size = np.abs(f.fourier(m[:, None])) ** 2
    spectrum.plot(m, size / size.max(), color=BLUE, label="|f_m|², scaled")
    spectrum.set(title="frequencies: power and |f_m|²", xlabel="m (cycles per unit)")
    spectrum.legend(loc="center right", fontsize=8)
    return figure


def theory() -> Figure:
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.3), width_ratios=(1, 1, 1.15))
    half, n = 6, 4
    m = np.arange(-half, half + 1)[:, None]
    p = mcs.density("linear(slope=1)", dims=1)
    f = mcs.integrand("gaussian(center=0.6, width=0.3)", dims=1)
    g = mcs.Integrand.from_function(lambda u: f(p.sample(u)) / p.pdf(p.sample(u)), dims=1)
    closed = mcs.spectra.closed_form_covariance
    jittered = closed("jittered", n, m[:, None], m, density=p)
    shifted = np.diag(np.diag(closed("jittered", n, m[:, None], m)))
    parts = []
    for place, title, c, source in (
        (axes[0], "jittered: f and weights 1/p", jittered, f),
        (axes[1], "jittered | shift: g = f/p", shifted, g),
    ):
        coefficient = source.fourier(m)
        terms = (np.conj(coefficient)[:, None] * coefficient[None, :] * c).real
        top = np.abs(terms).max()
        norm = mpl.colors.SymLogNorm(1e-4 * top, vmin=-top, vmax=top)
        place.imshow(terms, cmap="RdBu_r", norm=norm, extent=(-half - 0.5, half + 0.5) * 2)
        place.set(title=title, xlabel="frequency l", ylabel="frequency m")
        dc, power = terms[half, half], np.trace(terms) - terms[half, half]
        parts.append((dc, power, terms.sum() - dc - power))
    place = axes[2]
    for k, name in enumerate(("dc (first)", "power (second)", "cross (third)")):
        values = [part[k] for part in parts]
        place.bar(np.arange(2) + 0.25 * (k - 1), values, 0.23, label=name)
    place.axhline(0, color="k", lw=0.8)
    place.set(title="the three terms", xticks=[0, 1], xticklabels=["jittered", "jittered | shift"])
    place.legend(fontsize=8)
    return figure


def spectra() -> Figure:
    figure, axes = plt.subplots(2, 4, figsize=(10, 5.2))
    names = ("random", "jittered", "latin-hypercube", "poisson-disk")
    for (top, bottom), name in zip(axes.T, names, strict=True):
        x = mcs.sampler(name, dims=2).draw(256, rng=1)[0]
        top.plot(*x.T, "k.", ms=2.5)
        top.set(title=name, aspect="equal", xticks=[], yticks=[], xlim=(0, 1), ylim=(0, 1))
        _spectrum(bottom, _power(name, 256, 32, 40))
    axes[0, 0].set_ylabel("256 points")
    axes[1, 0].set_ylabel("n · power, 0 to 2")
    return figure


def bases() -> Figure:
    text = (DOCS / "bases.md").read_text(encoding="utf-8")
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), width_ratios=(1.5, 1))
    block = text.partition("cross / predicted, gaussian")[2].partition("cross / predicted, disk")[0]
    kinds = ("fourier", "cosine", "walsh", "haar")
    samplers = ("jittered", "jittered | shift", "jittered | digital-shift", "sobol | owen")
    for k, name in enumerate(samplers):
        row = re.search(rf"^{re.escape(name)}  +([+-].*)$", block, re.MULTILINE)[1]
        values = [float(v) for v in re.findall(r"([+-][\d.]+) ±", row)]
        left.bar(np.arange(4) + 0.2 * (k - 1.5), values, 0.18, label=name)
    left.axhline(0, color="k", lw=0.8)
    left.set(title="cross / predicted, Gaussian, n = 64", xticks=range(4), xticklabels=kinds)
    left.set_ylim(bottom=-2.7)
    left.legend(fontsize=8, ncols=4, loc="lower center")
    block = text.partition("measured at half width 4, 8, 16, 32: smooth")[2]
    for kind, mark in zip(kinds, "os^v", strict=True):
        row = re.search(rf"^  jittered +{kind} +([\d. ]+)$", block, re.MULTILINE)[1]
        right.plot([4, 8, 16, 32], [float(v) for v in row.split()], f"{mark}-", label=kind)
    right.axhline(1, color="0.6", lw=0.8)
    right.set(title="predicted / measured, jittered", xlabel="half width", xscale="log")
    right.set_xticks([4, 8, 16, 32], ["4", "8", "16", "32"])
    right.minorticks_off()
    right.legend(fontsize=8)
    return figure


def evidence() -> Figure:
    text = (DOCS / "evidence.md").read_text(encoding="utf-8")
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6))
    block = text.partition("| law of the estimates |")[2].partition("\n\n")[0]
    for line in block.splitlines()[2:]:
        name, _, *values = (cell.strip() for cell in line.strip("|").split("|"))
        heavy = name in ("lognormal(1)", "t(3)", "lognormal(1.5)")
        style = {"color": ORANGE if heavy else "0.6", "lw": 1.6 if heavy else 1}
        values = [float(v) for v in values[:3]]
        left.plot([20, 100, 1000], values, "o-", ms=3, **style)
        if heavy:
            left.annotate(name, (1000, values[-1]), (4, -3), textcoords="offset points", fontsize=8)
    left.axhline(95, color="k", lw=0.8, ls=":")
    left.set(title="coverage of 95 % intervals (%)", xlabel="number of estimates", xscale="log")
    left.set_xticks([20, 100, 1000], ["20", "100", "1000"])
    left.minorticks_off()
    left.set_xlim(15, 4500)
    line = r"^\| `python -m benchmarks (\w+)` \|.*?\| ([\d.]+)[^|]*\| ([\d.]+) \|$"
    rows = re.findall(line, text, re.MULTILINE)
    rows = [(name, float(ratio), float(aim)) for name, ratio, aim in rows if float(ratio) < 3][:6]
    place = np.arange(len(rows))
    right.barh(place, [row[1] for row in rows], color=BLUE, height=0.6, label="measured")
    right.plot([row[2] for row in rows], place, "k|", ms=18, mew=2, label="aim")
    right.set(title="time, ours / reference", yticks=place, yticklabels=[row[0] for row in rows])
    right.invert_yaxis()
    right.legend(fontsize=8, loc="center right")
    return figure


def scaling() -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2))
    text = (DOCS / "scaling.md").read_text(encoding="utf-8")
    workers, efficiency = (
        [float(v) for v in re.search(rf"^\| {name} \|(.*)\|$", text, re.MULTILINE)[1].split("|")]
        for name in ("workers", "efficiency")
    )
    left.plot(workers, efficiency, "o-", color=BLUE)
    left.axhline(1, color="0.7", lw=0.8)
    left.set(title="efficiency of threads, tasks of 0.2 s", xlabel="workers", ylim=(0, 1.08))
    k = np.geomspace(1, 1000, 50)
    right.loglog(k, 1e3 / (0.07 + 0.1 / k), color=BLUE, label="command")
    right.loglog(k, np.full_like(k, 1e3), color=ORANGE, ls="--", label="dask's scheduler")
    right.set(title="tasks per second (model)", xlabel="tasks per cell", ylim=(300, 3e4))
    right.legend()
    return figure


def _boxes(axes: Axes, boxes: dict[str, tuple[float, float, float, float]], color: str) -> None:
    for text, (x, y, width, height) in boxes.items():
        axes.add_patch(
            FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0.02", fc=color, ec="0.4")
        )
        axes.text(x + width / 2, y + height / 2, text.strip(), ha="center", va="center", fontsize=9)


def _arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], style: str = "->"
) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": style, "color": "0.3"})


def studies() -> Figure:
    figure, axes = plt.subplots(figsize=(10, 3.2))
    axes.set(xlim=(0, 10), ylim=(0, 3.2))
    axes.axis("off")
    text = "study file\n\n2 samplers\n2 estimators\n1 analysis"
    _boxes(axes, {text: (0.1, 0.5, 1.5, 2.2)}, "#e8f1f8")
    cells = [("A, random", 2.45), ("A, jittered", 1.75), ("B, random", 1.05), ("B, jittered", 0.35)]
    _boxes(axes, {f"cell: {name}": (2.3, y, 1.7, 0.45) for name, y in cells}, "#fdf0e2")
    for _, y in cells:
        _arrow(axes, (1.68, 1.6), (2.25, y + 0.22))
        for k in range(4):
            x = 4.75 + 0.5 * k
            axes.add_patch(plt.Rectangle((x, y), 0.42, 0.45, fc="#e4f3ec", ec="0.4"))
        _arrow(axes, (4.08, y + 0.22), (4.7, y + 0.22))
        _arrow(axes, (6.75, y + 0.22), (7.35, 1.6))
    axes.text(5.7, 3.02, "tasks of about a second", ha="center", fontsize=9)
    _boxes(axes, {"ledger\nstudy.sqlite": (7.4, 1.2, 1.1, 0.8)}, "#f5e6ef")
    outputs = {"report.html": 2.3, "results.zarr": 1.4, "export (.csv)": 0.5}
    _boxes(axes, {name: (9.0, y, 0.95, 0.45) for name, y in outputs.items()}, "#eeeeee")
    for y in outputs.values():
        _arrow(axes, (8.56, 1.6), (8.96, y + 0.22))
    return figure


def clusters() -> Figure:
    figure, axes = plt.subplots(figsize=(9, 2.8))
    axes.set(xlim=(0, 9), ylim=(0, 2.8))
    axes.axis("off")
    _boxes(axes, {"mcspectra run\n(the command)": (0.2, 1.0, 1.7, 0.8)}, "#e8f1f8")
    _boxes(axes, {"ledger and results": (0.2, 0.1, 1.7, 0.45)}, "#f5e6ef")
    _boxes(axes, {"dask scheduler": (3.6, 1.0, 1.6, 0.8)}, "#fdf0e2")
    _boxes(axes, {f"worker{' ' * k}": (7.0, 0.15 + 0.9 * k, 1.6, 0.6) for k in range(3)}, "#e4f3ec")
    _arrow(axes, (1.05, 0.97), (1.05, 0.6))
    _arrow(axes, (2.0, 1.55), (3.5, 1.55))
    _arrow(axes, (3.5, 1.2), (2.0, 1.2))
    axes.text(2.75, 1.63, "tasks", ha="center", fontsize=9)
    axes.text(2.75, 0.92, "states and results", ha="center", fontsize=9)
    for k in range(3):
        _arrow(axes, (5.3, 1.4), (6.9, 0.45 + 0.9 * k), style="<->")
    return figure


def reproduce() -> Figure:
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        command = [sys.executable, "-m", "mcspectra", "reproduce", "importance-terms", "--quick"]
        subprocess.run([*command, "--out", folder], check=True)
        browser = play.chromium.launch(executable_path=shutil.which("chromium"))
        page = browser.new_page(viewport={"width": 1300, "height": 760})
        page.goto(Path(folder, "index.html").as_uri() + "#importance-terms")
        shot = Path(folder, "shot.png")
        page.screenshot(path=shot)
        picture = plt.imread(shot)
    figure, axes = plt.subplots(figsize=(13, 7.6))
    axes.imshow(picture)
    axes.axis("off")
    return figure


def notebooks() -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5))
    curve = mcs.convergence("gaussian", ["random", "jittered"], [16, 64, 256], realizations=200)
    terms = mcs.variance_terms("gaussian", "jittered", 64, half_width=8, realizations=200)
    curve.mcspectra.plot(axes=left)
    terms.mcspectra.plot("captured", axes=right)
    return figure


def components() -> Figure:
    figure, axes = plt.subplots(2, 4, figsize=(14, 6.4))
    estimator = mcs.Estimator("gaussian(width=0.3)", "linear(slope=-1)", dims=1)
    estimator.plot(n=16, axes=axes[0, 0])
    mcs.Estimator("step(at=0.36)", dims=1).plot("strata", n=8, axes=list(axes[0, 1:3]))
    estimator.plot("estimates", sampler="random", axes=axes[0, 3])
    terms = mcs.variance_terms("gaussian", "jittered", 64, half_width=8, realizations=200)
    terms.mcspectra.plot("product", axes=list(axes[1, :3]))
    curve = mcs.convergence("gaussian", ["random", "jittered"], [16, 64, 256], realizations=200)
    theory = mcs.predict("gaussian", ["random", "jittered"], [16, 64, 256, 1024])
    curve.mcspectra.plot(axes=axes[1, 3], overlay=theory)
    return figure


_CAUSES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "interior-jump": lambda t: np.where(t < 0.37, 0.4, 1.0) + 0.2 * t,
    "cusp": lambda t: np.sqrt(np.abs(t - 0.37)),
    "kink": lambda t: np.abs(t - 0.37),
    "border-jump": lambda t: np.exp(-t),
    "high-frequency": lambda t: 0.5 + 0.5 * np.cos(2 * np.pi * 24.3 * t),
    "border-growth": lambda t: np.minimum(np.maximum(t, 1e-12) ** -0.3, 1e9),
}


def causes() -> Figure:
    figure, axes = plt.subplots(2, 6, figsize=(12, 4.4), height_ratios=(1, 1.1))
    t = (np.arange(800) + 0.5) / 800
    counts = [4, 8, 16, 32, 64, 128, 256]
    rng = np.random.default_rng(1)
    for (top, bottom), (name, g) in zip(axes.T, _CAUSES.items(), strict=True):
        top.plot(t, g(t), color=BLUE)
        top.set(title=name, xticks=[0, 1], yticks=[])
        for shift, color in ((False, GREEN), (True, ORANGE)):
            ratio = []
            for n in counts:
                x = (np.arange(n) + rng.random((1500, n))) / n
                x = (x + rng.random((1500, 1))) % 1.0 if shift else x
                ratio.append(g(x).mean(axis=1).var() / (g(rng.random(60_000)).var() / n))
            label = "jittered | shift" if shift else "jittered"
            bottom.loglog(counts, ratio, "o-", ms=3, color=color, label=label)
        bottom.set(ylim=(1e-6, 3), xlabel="n")
        bottom.axhline(1, color="0.7", lw=0.8)
        if name != "interior-jump":
            bottom.set_yticklabels([])
    axes[0, 0].set_ylabel("g along a line")
    axes[1, 0].set_ylabel("variance / random")
    axes[1, 0].legend(fontsize=7, loc="lower left")
    return figure


def other_fields() -> Figure:
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10, 3.1))
    from scipy.special import ndtri

    t = (np.arange(300) + 0.5) / 300
    z = ndtri(t)[:, None] + ndtri(t)[None, :]
    left.imshow(z > -0.3, origin="lower", extent=(0, 1, 0, 1), cmap="gray", vmin=-0.5, vmax=1.2)
    left.plot(*mcs.sampler("sobol | owen", dims=2).draw(64, rng=1)[0].T, "o", ms=3, color=BLUE)
    left.set(title="finance: a payoff that jumps", xlabel="first step", ylabel="second step")

    def ishigami(u: np.ndarray) -> np.ndarray:
        y = np.pi * (2 * u - 1)
        wave = np.sin(y[..., 0]) * (1 + 0.1 * y[..., 2] ** 4)
        return wave + 7 * np.sin(y[..., 1]) ** 2

    f = mcs.Integrand.from_function(ishigami, dims=3, integral=3.5)
    parts = mcs.anova_variances(f, order=1, realizations=4000)
    exact = {"anova_share": (0.314, 0.442, 0.0), "total_share": (0.558, 0.442, 0.244)}
    labels = ("first-order", "total")
    for k, (name, truth) in enumerate(exact.items()):
        value, ends = parts[name].values[:3], parts[f"{name}_ci"].values[:3].T
        place = np.arange(3) + 0.3 * k - 0.15
        error = np.abs(ends - value)
        middle.errorbar(place, value, error, fmt="o", capsize=3, label=labels[k])
        middle.plot(place, truth, "kx")
    middle.set(title="Sobol' indices", xticks=range(3), xticklabels=["x0", "x1", "x2"])
    middle.legend(fontsize=8)
    rng = np.random.default_rng(1)
    x, chain = 0.0, []
    for _ in range(400):
        proposal = x + rng.normal()
        x = proposal if rng.random() < np.exp(0.5 * (x**2 - proposal**2)) else x
        chain.append(x)
    right.plot(chain, color=BLUE, lw=0.8)
    right.axhline(np.mean(chain), color=ORANGE, label="mean of the draws")
    right.axhline(0, color="k", ls=":", label="true mean")
    right.set(title="Bayesian: a Markov chain", xlabel="draw")
    right.legend(fontsize=8)
    return figure


def _antithetic(n: int, rng: np.random.Generator) -> np.ndarray:
    x = rng.random((n // 2, 2))
    return np.concatenate([x, np.minimum(1 - x, np.nextafter(1.0, 0.0))])


def add_a_sampler() -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(6.6, 3.2))
    x = _antithetic(32, np.random.default_rng(2))
    for a, b in zip(x[:16], x[16:], strict=True):
        left.plot(*zip(a, b, strict=True), color="0.8", lw=0.8)
    left.plot(*x.T, "o", color=BLUE, ms=4)
    left.set(title="16 antithetic pairs", aspect="equal", xlim=(0, 1), ylim=(0, 1))
    sampler = mcs.Sampler.from_function(_antithetic, dims=2)
    _spectrum(right, _power(sampler, 64, 16, 400))
    right.set_title("n · power, 0 to 2")
    return figure


def add_a_density() -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.4, 2.6))
    t = (np.arange(400) + 0.5) / 400
    a, b = 2.0, 1.5
    left.plot(t, a * b * t ** (a - 1) * (1 - t**a) ** (b - 1), color=BLUE)
    left.set(title="pdf(x) of Kumaraswamy's density", xlabel="x")
    right.plot(t, (-np.expm1(np.log1p(-t) / b)) ** (1 / a), color=BLUE)
    for u in (np.arange(12) + 0.5) / 12:
        x = (-np.expm1(np.log1p(-u) / b)) ** (1 / a)
        right.plot([u, u, 0], [0, x, x], color="0.8", lw=0.7)
    right.set(title="the warp x = sample(u)", xlabel="u", ylabel="x", xlim=(0, 1), ylim=(0, 1))
    return figure


def add_an_integrand() -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.4, 2.8))
    t = (np.arange(200) + 0.5) / 200
    wave = np.abs(2 * t - 1)
    left.imshow(np.outer(wave, wave), origin="lower", extent=(0, 1, 0, 1), cmap="gray")
    left.set(title="a product of triangle waves", xticks=[0, 1], yticks=[0, 1])
    m = np.arange(1, 40)
    size = np.where(m % 2 == 1, (2 / (np.pi * m)) ** 2, np.nan)
    right.loglog(m, size, "o", color=BLUE, label="|f_m|")
    right.loglog(m, (2 / np.pi / m) ** 2, color="0.7", label="∝ 1/m²")
    right.set(title="its coefficients in 1-D", xlabel="m")
    right.legend()
    return figure


FIGURES = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(conventions, theory, spectra, bases, evidence, scaling, studies, clusters, reproduce),
        *(
            notebooks,
            components,
            causes,
            other_fields,
            add_a_sampler,
            add_a_density,
            add_an_integrand,
        ),
    )
}


def main(names: list[str]) -> None:
    """Draw the given figures, by default all of them."""
    mpl.rcParams.update(STYLE)
    for name in names or FIGURES:
        figure = FIGURES[name]()
        figure.tight_layout()
        figure.savefig(FOLDER / f"{name}.png")
        plt.close(figure)


if __name__ == "__main__":
    main(sys.argv[1:])
