"""Pages of a bench in every format, and the command that writes them."""

import csv
import re

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.report import bench_page
from mcspectra.report.bench_page import bench_plots, bench_table, write_bench


@pytest.fixture(scope="module")
def bench(once):
    samplers = ["jittered", "sobol | owen", "pmj02"]
    options = {"counts": (16, 64, 256), "dims": (2, 3), "realizations": 30}
    return once("bench", lambda: mcs.sampler_bench(samplers, **options))


def test_the_table_has_rates_and_ranks(bench):
    columns, rows = bench_table(bench)
    assert columns == ["Integrand", "jittered", "sobol | owen", "pmj02"]
    assert [row[0] for row in rows] == bench["integrand"].values.tolist()
    for j, row in enumerate(rows):
        for i, text in enumerate(row[1:]):
            low, high = bench["rank_ci"].values[i, j]
            if np.isnan(low):
                assert text == "–"
            else:
                assert text.endswith(f"({low:.0f})" if low == high else f"({low:.0f}–{high:.0f})")


def test_the_first_sentence_counts_significant_first_ranks(bench):
    alone = bench.copy(deep=True)
    alone["rank_ci"][:] = 2.0
    assert bench_page._answer(alone).startswith("No sampler is significantly the best on any of")
    alone["rank_ci"][1, 1:] = 1.0
    alone["rank_ci"][0, 0] = 1.0
    count = bench.sizes["integrand"]
    assert bench_page._answer(alone) == (
        f"Of {count} integrands, sobol | owen has the least variance on {count - 1}, jittered on 1."
    )
    alone["rank_ci"][0, 0, 1] = 2.0
    assert bench_page._answer(alone).endswith("; on 1 no sampler is significantly the best.")
    assert bench_page._answer(alone.isel(sampler=[0])) == ""


def test_many_samplers_become_rows_and_figures_of_ten(bench, tmp_path, monkeypatch):
    many = xr.concat([bench.isel(sampler=[k % 3]) for k in range(12)], "sampler")
    many = many.assign_coords(label=("sampler", [f"s{k}" for k in range(12)]))
    columns, rows = bench_table(many)
    assert columns == ["Sampler", *bench["integrand"].values]
    assert [row[0] for row in rows] == [f"s{k}" for k in range(12)]
    quality = [f.plot for f in bench_plots(many) if f.title == "Quality"]
    assert len(quality) == 2
    # The page without images, which take most of the time
    monkeypatch.setattr(bench_page, "bench_plots", lambda *_: iter(()))
    page = write_bench(many.isel(integrand=slice(2)), str(tmp_path / "many.html")).read_text(
        "utf-8"
    )
    assert page.count('<table class="sortable"') == 2  # both tables can be sorted


def test_every_part_has_a_figure(bench):
    titles = [figure.title for figure in bench_plots(bench)]
    assert titles == [
        "Convergence in 2-D", "Convergence in 3-D", "Spectra and pairs: spectra",
        "Spectra and pairs: means over directions", "Spectra and pairs: anisotropy",
        "Spectra and pairs: pair correlation", "Quality", "Points",
        "Projections: jittered", "Projections: sobol | owen",
    ]  # fmt: skip
    plots = {figure.title: figure.plot for figure in bench_plots(bench)}
    # Three labeled pairs of axes
    named = [(p.x.label, p.y.label) for p in plots["Projections: jittered"].panels]
    assert named == [("x₀", "x₁"), ("x₀", "x₂"), ("x₁", "x₂")]
    assert [p.title for p in plots["Points"].panels] == ["pmj02"]
    assert len(plots["Convergence in 3-D"].panels) == 8
    assert all(plot.words for plot in plots.values())


@pytest.mark.usefixtures("undrawn")
def test_all_file_formats_are_written(bench, tmp_path):
    """The HTML is written without figures, which other tests draw."""
    bench = bench.isel(integrand=slice(2), sampler=slice(2))
    for extension in ("html", "pdf", "csv", "tex", "pgf"):
        write_bench(bench, str(tmp_path / f"r.{extension}"))
    pdf = (tmp_path / "r.pdf").read_bytes()
    assert b"/Subtype /Type3" not in pdf
    assert b"/Subtype /CIDFontType2" in pdf  # TrueType within Type 42's Type 0
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 1 + len(list(bench_plots(bench)))
    page = (tmp_path / "r.html").read_text()
    for words in (
        "Sampler bench",
        "Spectra and pairs",
        "jittered",
        "Points/s",
        "Projections",
    ):
        assert words in page
    lines = [s for s in (tmp_path / "r.csv").read_text().splitlines() if s[0] != "#"]
    rows = list(csv.DictReader(lines))
    assert len(rows) == bench["variance"].size
    one = next(r for r in rows if r["sampler"] == "jittered" and r["n"] == "256")
    assert float(one["variance"]) == float(bench["variance"].isel(sampler=0, integrand=0, n=2))
    assert one["rank_low"]
    assert one["rate_high"]
    assert (tmp_path / "r.tex").read_text().count(r"\\") == 1 + bench.sizes["integrand"]
    assert r"\begin{pgfpicture}" in (tmp_path / "r.pgf").read_text()


@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_files(capsys, tmp_path):
    arguments = ["bench", "jittered", "random", "-n", "16,64", "-m", "20"]
    folder = tmp_path / "page"
    files = [folder, tmp_path / "r.csv", tmp_path / "s.tex"]
    assert main([*arguments, *(part for file in files for part in ("-o", str(file)))]) == 0
    out = capsys.readouterr().out
    assert "disk (jump), 2-D" in out
    assert "jittered" in (tmp_path / "r.csv").read_text()
    assert (tmp_path / "s.tex").exists()
    assert main([*arguments, "-o", "r.docx"]) == 2
    said = capsys.readouterr().err
    assert "it must end in .html, .pdf, .csv, .tex or .pgf" in said
    page = (folder / "index.html").read_text("utf-8")
    assert page.count('href="#s-jittered"') == 2  # in the contents and in the table
    assert "uniform point in each" in page
    assert {file.name for file in folder.iterdir()} == {"index.html", "bench.csv"}
    capsys.readouterr()
    (tmp_path / "file").touch()
    assert main([*arguments, "-o", str(tmp_path / "file" / "page")]) == 2
    assert "give a folder inside one that can be written" in capsys.readouterr().err
    assert main(["bench", "command('./none {n}')"]) == 2
    assert "--allow-code './none {n}'" in capsys.readouterr().err
