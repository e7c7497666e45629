"""Results as files: tables for programs and LaTeX, and images in every format."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.kinds import describe
from mcspectra.report.result_files import csv_text, latex_table, result_table, write_result_file


@pytest.fixture(scope="module")
def curve():
    named = mcs.Sampler.from_points(np.random.default_rng(1).random((8, 16, 2)))
    assert named.dims == 2
    return mcs.convergence(
        mcs.Estimator("gaussian"), ["random", "jittered"], [16, 64], realizations=50
    )


def test_a_table_has_a_row_per_coordinate(curve, tmp_path):
    columns, rows = result_table(curve)
    assert columns[:5] == ["sampler", "n", "variance", "variance_low", "variance_high"]
    assert [row[:2] for row in rows] == [
        ["random", 16], ["random", 64], ["jittered", 16], ["jittered", 64]
    ]  # fmt: skip
    np.testing.assert_array_equal([row[2] for row in rows], curve["variance"].values.ravel())
    np.testing.assert_array_equal(
        [row[4] for row in rows], curve["variance_ci"].values[..., 1].ravel()
    )
    # Variables with fewer dims are repeated
    at = columns.index("rate")
    np.testing.assert_array_equal([row[at] for row in rows], np.repeat(curve["rate"].values, 2))

    file = tmp_path / "c.csv"
    write_result_file(curve, str(file), "t")
    text = file.read_text()
    body = "".join(line for line in text.splitlines(keepends=True) if line[0] != "#")
    read = np.genfromtxt(io.StringIO(body), delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_array_equal(read["variance"], curve["variance"].values.ravel())
    assert "# seed: 0" in text


def test_scalars_are_in_comments_above_the_table(curve, tmp_path):
    one = curve.isel(sampler=0)
    write_result_file(one, str(tmp_path / "c.csv"), "t")
    assert f"# rate: {float(one['rate'])}" in (tmp_path / "c.csv").read_text()


def test_latex_tables_are_escaped():
    text = latex_table(
        ["a_b", "x"], [["50 % & {more}", 1.25e-7], ["points(path='p', name='mine')", None]]
    )
    assert r"a\_b & x \\" in text  # a name given by the user
    assert r"50 \% \& \{more\} & 1.25$\times10^{-7}$ \\" in text
    assert r"mine & -- \\" in text
    with pytest.raises(ParameterError, match="limited to 500"):
        latex_table(["a"], [[1.0]] * 501)


@pytest.mark.parametrize("extension", ["png", "svg", "pdf", "pgf"])
def test_pictures_in_every_format(curve, tmp_path, extension):
    file = tmp_path / f"c.{extension}"
    write_result_file(curve, str(file), "t")
    head = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF", "pgf": b"% for LaTeX"}[extension]
    data = file.read_bytes()
    assert data.startswith(head)
    if extension == "pdf":
        assert b"/Type /Font" in data
        assert (
            b"/Subtype /Type3" not in data
        )  # Type 42 is TrueType, which editors and printers support
    again = tmp_path / f"d.{extension}"
    write_result_file(curve, str(again), "t")
    assert again.read_bytes() == data


def test_pgf_files_use_latex_mathematics(tmp_path):
    """LaTeX fonts lack ⁻, and the oldest ones have a dash instead of a bar."""
    result = mcs.convergence("disk", "sobol | owen", [16, 64], realizations=20, rng=0)
    write_result_file(result, str(tmp_path / "c.pgf"), "t")
    text = (tmp_path / "c.pgf").read_text("utf-8")
    assert "sobol $|$ owen" in text
    assert "n$^{-1}$, the rate of random sampling" in text
    assert "10$^{-3}$" in text
    assert text.isascii()


def test_names_are_escaped_in_latex(tmp_path):
    r"""A name such as ``\input{…}`` must not run as a command."""
    name = r"\input{/etc/passwd} $x$ %_#&~^"
    result = mcs.convergence("linear(dims=1)", "random", [4, 8], realizations=8)
    plot = describe("convergence", result)
    panels = tuple(replace(panel, title=name) for panel in plot.panels)
    backend_matplotlib.write(replace(plot, panels=panels), tmp_path / "c.pgf")
    text = (tmp_path / "c.pgf").read_text("utf-8")
    shown = (
        r"\textbackslash{}input\{/etc/passwd\} \$x\$ \%\_\#\&\textasciitilde{}\textasciicircum{}"
    )
    assert shown in text
    assert r"\input{" not in text


def test_maps_in_pgf_are_pictures_beside_it(tmp_path):
    result = mcs.power_spectrum("jittered", 16, half_width=4, realizations=4)
    write_result_file(result, str(tmp_path / "s.pgf"), "t")
    named = re.findall(r"\\includegraphics\[[^]]*\]\{(.*?)\}", (tmp_path / "s.pgf").read_text())
    assert named
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in named)


def test_missing_folders_give_an_error(curve, tmp_path):
    for extension in ("csv", "tex", "npz", "pgf", "pdf"):
        with pytest.raises(FileFormatError, match="cannot be written"):
            write_result_file(curve, str(tmp_path / f"no/such.{extension}"), "t")


def test_table_cells_are_not_spreadsheet_formulas():
    about = {"estimator": "a,=1+1;@x", "title": "\x1b[2J"}
    text = csv_text(["=name", "value"], [["=1+1", -1.5], ["-2", None], ["+x", 2]], about)
    assert text.splitlines() == [
        "# estimator: a, =1+1; @x", r"# title: \x1b[2J",
        "'=name,value", "'=1+1,-1.5", "-2,", "'+x,2",
    ]  # fmt: skip
