"""The verb ``pixel``: text, JSON, files, and one sentence with exit code 2 for bad input."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.conftest import of_a_bell, predicted_bell

from mcspectra.cli.main import main
from mcspectra.estimators import Estimator
from mcspectra.measure.converge import convergence
from mcspectra.measure.terms import variance_terms
from mcspectra.rendering import Pixel, backend, named_pixels
from mcspectra.report.pixel_page import STRATEGY_NAMES
from mcspectra.studies import pixel
from mcspectra.studies.pixel import EFFORTS, analyse_pixel

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]

SAMPLERS = ("jittered", "sobol | owen")
SMALL = (
    "-n",
    "4,16",
    "-m",
    "20",
    "--no-remedies",
    "--sampler",
    SAMPLERS[0],
    "--sampler",
    SAMPLERS[1],
)
CAMERA = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="40"/>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
    <transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
  </sensor>
"""
MIRROR = f"""{CAMERA}<shape type="rectangle" id="mirror"><bsdf type="conductor"/></shape>
  <emitter type="constant" id="sky"/></scene>"""
LAMP = f"""{CAMERA}<shape type="rectangle" id="lamp"><emitter type="area"/></shape></scene>"""


def run(capsys, *arguments):
    code = main(["pixel", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module", autouse=True)
def small_effort(once):
    """Reduce the work; equal arguments return the same tree."""
    small = replace(EFFORTS["quick"], half_width={2: 6, 3: 2}, resolution=16)

    def kept(*given, **options):
        key = hashlib.sha256(repr((given, sorted(options.items()))).encode()).hexdigest()
        return once(f"pixel-{key}", lambda: analyse_pixel(*given, **options))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pixel, "predict", predicted_bell)
        patch.setattr(
            "mcspectra.rendering.pixel._POINTS", 2**12
        )  # Points for means; 2**17 would take seconds
        patch.setattr(pixel, "variance_terms", of_a_bell(variance_terms))
        patch.setitem(EFFORTS, "quick", small)
        patch.setattr(pixel, "analyse_pixel", kept)
        yield


@pytest.mark.usefixtures("undrawn")
def test_json_and_files_hold_the_numbers_of_the_library_or_are_refused(capsys, tmp_path):
    code, out, err = run(
        capsys, "figure1", "Q", *SMALL, "--out", tmp_path / "new" / "out", "--json"
    )
    assert code == 0, err
    printed: dict[str, Any] = json.loads(out)
    x, y = named_pixels("figure1")["Q"]
    estimators = [
        Estimator(Pixel(scene="figure1", x=x, y=y, strategy=s)) for s in ("light", "bsdf")
    ]
    curves = convergence(estimators, list(SAMPLERS), (4, 16), realizations=20)
    assert len(printed["rates"]) == 8
    for row, where in zip(printed["rates"], np.ndindex(2, 2), strict=False):
        one = curves.isel(estimator=where[0], sampler=where[1])
        assert row["sampler"] == SAMPLERS[where[1]]
        assert row["variance"] == one["variance"].values.tolist()
        assert row["rate"] == float(one["rate"])
    assert (printed["pixel"]["x"], printed["pixel"]["y"]) == (x, y)
    assert "remedies" not in printed
    report = Path(printed.pop("report"))
    assert report.is_file()
    assert json.loads((report.parent / "pixel.json").read_text(encoding="utf-8")) == printed
    # The same analysis, and a folder that cannot be made
    (tmp_path / "file").write_text("", encoding="utf-8")
    code, _, err = run(capsys, "figure1", "Q", *SMALL, "--out", tmp_path / "file" / "out")
    assert code == 2
    assert "cannot be written" in err.splitlines()[-1]


def test_text_has_rows_and_sentences(capsys):
    x, y = named_pixels("figure1")["Q"]
    code, out, _ = run(capsys, "figure1", "Q", *SMALL)
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == f"pixel ({x}, {y}) of figure1"
    for name in STRATEGY_NAMES.values():
        for sampler in SAMPLERS:
            found = [line for line in lines if line.split("  ")[0] == name and sampler in line]
            assert found
            assert re.search(r"∫g²|exact|strata|torus|gains", found[0])  # Method of the prediction
        assert any(line.startswith(f"{name}: ") for line in lines)
    assert any("bottleneck of MIS" in line for line in lines)
    assert "of all lines through the cube cross a discontinuity of the integrand" in " ".join(
        out.split()
    )
    assert not any(line.startswith("remedy") for line in lines)


def test_quiet_prints_the_result(capsys):
    loud = run(capsys, "figure1", "Q", *SMALL)
    assert run(capsys, "figure1", "Q", *SMALL, "--quiet") == (0, loud[1], "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("figure1", "-1", "0"), "X"),
        (("figure1", "nan", "0"), "X"),
        (("figure1", "5"), "no row"),
        (("figure1",), "required"),
        (("figure1", "P", "--light", "7"), "light"),
        (("figure1", "P", "--counts", "16,x"), "--counts"),
        (("figure1", "P", "-m", "1"), "--realizations"),
        (("figure1", "P", "--quick", "--full"), "not allowed"),
        (("figure1", "P", "-o", __file__), "give a folder"),
    ],
)
def test_bad_input(capsys, arguments, words):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "x", "words"),
    [
        (MIRROR, 4, "mirror"),
        (LAMP, 4, "sees the light 'lamp'"),
        (LAMP, 0, "sees nothing"),
        ("<scene", 4, "cannot read"),
        ("", 4, "cannot read"),
    ],
)
def test_files_that_cannot_be_used(capsys, tmp_path, text, x, words):
    file = tmp_path / "scene.xml"
    file.write_text(text, encoding="utf-8")
    code, out, err = run(capsys, file, x, 4)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("missing", ["_no_mitsuba", "_no_library"])
def test_without_mitsuba_or_llvm(capsys, monkeypatch, missing):
    monkeypatch.setattr(backend, "_loaded", [])
    monkeypatch.setattr(backend, "_already_running", lambda: False)
    if missing == "_no_mitsuba":
        monkeypatch.setattr(backend.importlib.util, "find_spec", lambda _: None)
    else:
        monkeypatch.setattr(backend, "find_library", lambda: (None, []))
    code, out, err = run(capsys, "veach", 1, 1)
    assert (code, out) == (2, "")
    assert "pip install 'mcspectra[render]'" in err
    assert err.count("\n") == 1
