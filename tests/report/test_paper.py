"""Figures and tables for a paper: sizes, fonts, colors, LaTeX."""

import itertools
import re
import shutil
import subprocess

import matplotlib as mpl
import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import Dots, Line
from mcspectra.plots.paper import PaperStyle, inches, paper_plot
from mcspectra.plots.style import PALETTE, sampler_styles
from mcspectra.report import paper
from mcspectra.report.bench_page import bench_labels, bench_plots, bench_table
from mcspectra.report.paper import write_paper

NAMED = "points(path='{}', name='50 % & a_b')"


@pytest.fixture(scope="module")
def bench(once, tmp_path_factory):
    def measured():
        place, rng = tmp_path_factory.mktemp("points"), np.random.default_rng(1)
        for n in (16, 64):
            np.savez(place / f"{n}.npz", points=rng.random((20, n, 2)))
        samplers = ["jittered", NAMED.format(place / "*.npz")]
        made = mcs.sampler_bench(samplers, counts=(16, 64), realizations=20)
        return made.isel(integrand=[0, 4, 7])

    return once("paper-bench", measured)


@pytest.fixture(scope="module")
def folder(bench, once, tmp_path_factory):
    def written():
        folder = tmp_path_factory.mktemp("paper") / "figures"
        look = {"width": "84mm", "font_size": 7, "spectra": "log", "colors": "gray"}
        files = bench.mcspectra.paper(folder, **look)
        assert files[-1] == folder / "main.tex"
        assert all(path.exists() for path in files)
        return folder

    return once("paper", written)


def test_every_figure_has_three_formats_and_tables_are_there(folder):
    names = {"convergence-2d", "spectra", "radial", "anisotropy", "pair-correlation"}
    names |= {"quality", "points"}
    for extension in ("pdf", "pgf", "svg"):
        assert {path.stem for path in folder.glob(f"*.{extension}")} == names
    tables = {path.stem for path in folder.glob("*.tex")}
    assert tables == {"main", "rates-2d", "variances-2d", "quality"}


def test_figures_have_the_width_and_the_font_size_on_white(folder):
    for path in folder.glob("*.svg"):
        text = path.read_text("utf-8")
        width = float(re.search(r'<svg [^>]*width="([\d.]+)pt"', text)[1])
        assert width == pytest.approx(72 * 84 / 25.4, abs=0.01)
        assert re.search(r"fill: #ffffff", text)
    for path in folder.glob("*.pgf"):
        sizes = set(re.findall(r"\\fontsize\{([\d.]+)\}", path.read_text("utf-8")))
        assert {float(size) for size in sizes} == {7.0}, path
    for path in folder.glob("*.pdf"):
        box = re.search(rb"/MediaBox \[ *0 0 ([\d.]+)", path.read_bytes())
        assert float(box[1]) == pytest.approx(72 * 84 / 25.4, abs=0.01)
        assert b"/Subtype /Type3" not in path.read_bytes()


def test_figures_state_n_and_sets(bench):
    said = {figure.name: figure.sets for figure in bench_plots(bench)}
    assert said["convergence-2d"] == "2-D, 20 sets per variance"
    assert said["spectra"] == said["radial"] == "2-D, n = 64, 100 sets (50 % & a_b: 20)"
    assert said["pair-correlation"] == "2-D, n = 64, 16 sets"
    assert said["quality"] == "2-D, means of 8 sets (50 % & a_b: 20)"
    assert said["points"] == "n = 64, one set each"


def test_curves_have_one_width_and_differ_without_color(bench):
    names = bench_labels(bench)
    style = PaperStyle.of()
    styles = style.styles(names)
    assert len({(each.dashes, each.marker) for each in styles.values()}) == len(names)
    for figure in bench_plots(bench, styles):
        if figure.name not in ("convergence-2d", "radial", "anisotropy", "quality"):
            continue
        plot = paper_plot(figure.plot, style, styles)
        for panel in plot.panels:
            colors = {each.color for each in styles.values()}
            curves = [m for m in panel.marks if isinstance(m, Line) and m.color in colors]
            dots = {m.label for m in panel.marks if isinstance(m, Dots)}
            assert {curve.width for curve in curves} == {1.0}
            assert {curve.label for curve in curves} <= dots
            assert panel.x.label or panel.title or plot.columns > 1


def test_legends_omit_curves_without_values(bench):
    names = bench_labels(bench)
    style = PaperStyle.of()
    styles = style.styles(names)
    missing = bench.copy(deep=True)
    missing["radial_power"][1] = np.nan
    figure = next(f for f in bench_plots(missing, styles) if f.name == "radial")
    labels = paper_plot(figure.plot, style, styles).labels
    assert names[0] in labels
    assert names[1] not in labels


def test_panels_fit_into_narrow_and_wide_figures(bench):
    figure = next(bench_plots(bench))
    columns = []
    for width in (1.5, 3.33, 7.0):
        style = PaperStyle.of(width, 8)
        columns.append(paper_plot(figure.plot, style, {}).columns)
    assert columns == [1, 2, 3]


def test_rc_params_of_the_user_are_kept_where_no_option_is_given():
    usual = PaperStyle.of()
    assert (usual.look.width, usual.look.label, usual.look.small) == (3.33, 8.0, 8.0)
    mine = {
        "figure.figsize": (5.0, 3.0), "font.size": 9.0, "xtick.labelsize": "small",
        "lines.linewidth": 2.0, "image.cmap": "magma",
        "axes.prop_cycle": mpl.cycler(color=["r", "g"]),
    }  # fmt: skip
    with mpl.rc_context(mine):
        style = PaperStyle.of()
        assert (style.look.width, style.look.label) == (5.0, 9.0)
        assert style.look.small == pytest.approx(9.0 * 0.833)
        assert (style.line, style.look.colors, style.colors) == (2.0, "magma", ("r", "g"))
        given = PaperStyle.of("3in", 7, "gray")
        assert (given.look.width, given.look.small, given.look.colors) == (3.0, 7.0, "gray")


def test_widths_have_units():
    assert inches("width", "84mm") == pytest.approx(84 / 25.4)
    assert inches("width", "240 pt") == pytest.approx(240 / 72.27)
    assert inches("width", 3) == 3.0
    for wrong in ("3ft", "", "nan", "inf", 0.5, "-3in", "900cm"):
        with pytest.raises(ParameterError, match="give 1 to 20 inches"):
            inches("width", wrong)


# Color vision of Machado et al. 2009 (severity 1), applied to linear RGB
BLIND = {
    "full": np.eye(3),
    "protan": np.array([
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ]),
    "deutan": np.array([
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]),
    "tritan": np.array([
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ]),
}  # fmt: skip


def lab(linear):
    """Return CIE Lab of linear sRGB with the white of sRGB."""
    to_xyz = np.array([
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ])  # fmt: skip
    ratio = to_xyz @ np.clip(linear, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", BLIND)
def test_eight_colors_differ_for_all_readers(vision):
    assert len(PALETTE) == 8
    rgb = [np.array(mpl.colors.to_rgb(color)) for color in PALETTE]
    linear = [np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) for c in rgb]
    seen = [lab(BLIND[vision] @ each) for each in linear]
    # A difference of 2.3 is just noticeable; the docstring of the palette states 16
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 16


def test_styles_differ_in_gray_and_repeat_late():
    styles = sampler_styles([f"s{k}" for k in range(32)], gray=True)
    assert len(set(styles.values())) == 32
    first = list(styles.values())[:8]
    assert len({(each.dashes, each.marker) for each in first}) == 8


def test_tables_are_booktabs_and_escaped(folder):
    rates = (folder / "rates-2d.tex").read_text("utf-8")
    for rule in (r"\toprule", r"\midrule", r"\bottomrule", r"\cmidrule(lr){2-2}"):
        assert rule in rates
    assert "\\hline" not in rates
    assert r"50 \% \& a\_b" in rates
    rows = [line for line in rates.splitlines() if line.endswith(r"\\")]
    assert len(rows) == 2 + 2
    assert {row.count(" & ") for row in rows[1:]} == {3}
    assert re.search(r"\$-?\d\.\d+\(\d\)\$|\\mathit", rates)
    assert r"\mathbf" in (folder / "variances-2d.tex").read_text("utf-8")


def test_the_page_is_sound_latex(folder):
    """Check braces, environments, characters and included files, which needs no LaTeX."""
    for path in [*folder.glob("*.tex"), *folder.glob("*.pgf")]:
        # Matplotlib makes % printable before each text
        text = path.read_text("utf-8").replace(r"\catcode`\%=\active\def%{\%}", "")
        text = re.sub(r"(?<!\\)%.*", "", text)
        plain = re.sub(r"\\[\\{}%&_#$]", "", text)
        assert plain.count("{") == plain.count("}"), path
        assert plain.count("$") % 2 == 0, path
        begun, ended = (re.findall(rf"\\{w}\{{(\w+\*?)\}}", text) for w in ("begin", "end"))
        assert sorted(begun) == sorted(ended), path
        assert set(re.findall(r"[^\x00-\x7f]", text)) <= set("–…"), path
        for picture in re.findall(r"\\includegraphics\[[^]]*\]\{([\w.-]+)\}", text):
            assert (folder / picture).exists()
    text = (folder / "main.tex").read_text("utf-8")
    for name in re.findall(r"\\mcfigure\{([\w.-]+)\}", text):
        assert (folder / f"{name}.pdf").exists()
        assert (folder / f"{name}.pgf").exists()
    for name in re.findall(r"\\mctable\{([\w.-]+)\}", text):
        assert (folder / f"{name}.tex").exists()
    assert text.count(r"\mcfigure{") == 7
    assert text.count(r"\mctable{") == 3


@pytest.mark.slow
@pytest.mark.parametrize("figures", ["pdf", "pgf"])
def test_the_page_compiles(folder, tmp_path, figures):
    command = shutil.which("pdflatex") or shutil.which("tectonic")
    if command is None:
        pytest.skip("neither pdflatex nor tectonic is installed")
    place = tmp_path / "figures"
    shutil.copytree(folder, place)
    page = place / "main.tex"
    if figures == "pgf":
        head = r"\newcommand{\mcfigure}"
        text = page.read_text("utf-8").replace(f"\n{head}", f"\n%{head}", 1)
        page.write_text(text.replace(f"\n%{head}[1]{{\\input", f"\n{head}[1]{{\\input"), "utf-8")
    options = ["-interaction=nonstopmode", "-halt-on-error"] if "pdflatex" in command else []
    done = subprocess.run(
        [command, *options, "main.tex"], cwd=place, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert (place / "main.pdf").read_bytes().startswith(b"%PDF")


def test_other_results_have_figures_and_a_table_too(tmp_path):
    curve = mcs.convergence("gaussian", ["random", "jittered"], [16, 64], realizations=20)
    written = curve.mcspectra.paper(tmp_path / "p", width=3, font_size=8)
    names = [path.name for path in written]
    assert names == [
        "convergence.pdf",
        "convergence.pgf",
        "convergence.svg",
        "values.tex",
        "main.tex",
    ]


def test_rates_of_rounding_noise_are_named(bench):
    tiny = bench.copy(deep=True)
    tiny["variance"][0, 0] = 1e-34 * np.array([1.0, 2.0])
    tiny["rate"][0, 0] = np.nan
    rates = next(table for table in paper._bench_tables(tiny) if table.name == "rates-2d")
    assert "jittered & below rounding & " in rates.source
    assert "below rounding" in bench_table(tiny)[1][0][1]


def test_wrong_options_are_refused(bench, tmp_path):
    for options, said in (
        ({"spectra": "db"}, "linear, log"),
        ({"colors": "red"}, "gray, viridis"),
        ({"font_size": float("nan")}, "finite"),
        ({"width": "3ft"}, "1 to 20 inches"),
    ):
        with pytest.raises(ParameterError, match=said):
            write_paper(bench, tmp_path / "x", **options)
    assert not (tmp_path / "x").exists()


def test_the_command_passes_its_options(tmp_path, capsys, monkeypatch):
    given = []
    monkeypatch.setattr(
        paper, "write_paper", lambda _, folder, **options: [given.append((folder, options))]
    )
    arguments = ["bench", "jittered", "-n", "16,64", "-m", "10", "--quiet", "--style", "paper"]
    look = ["--width", "3in", "--font-size", "9", "--spectra", "log", "--colors", "gray"]
    assert main([*arguments, "-o", str(tmp_path / "f"), *look]) == 0
    options = {"width": 3.0, "font_size": 9.0, "spectra": "log", "colors": "gray"}
    assert given == [(str(tmp_path / "f"), options)]
    capsys.readouterr()
    for more, said in (
        ([*arguments, "-o", str(tmp_path / "f.pdf")], "writes a folder"),
        (arguments, "give its name with -o"),
        (["bench", "jittered", "--width", "3in"], "add --style paper"),
    ):
        assert main(more) == 2
        assert said in capsys.readouterr().err
