"""``render --compare``: the images of the library, side by side and as layers."""

import json
from typing import Any

import numpy as np
import OpenEXR
import pytest

from mcspectra.cli.main import main
from mcspectra.plots.backend_matplotlib import draw, encode
from mcspectra.plots.maps import strategy_images
from mcspectra.rendering.image import compare_strategies

pytestmark = pytest.mark.render

SMALL = ("veach", "--width", "24", "--height", "16", "--reference-spp", "32", "--compare")
SCENE = "veach(width=24, height=16)"


def run(capsys, *arguments):
    code = main(["render", *map(str, arguments)])
    return code, *capsys.readouterr()


def test_files_and_figures(tmp_path, capsys):
    png, exr = tmp_path / "all.png", tmp_path / "all.exr"
    options = ("--seed", 3, "--spp", 2, "--exposure", "-1", "-o", png, "-o", exr)
    code, out, err = run(capsys, *SMALL, *options, "--json")
    assert (code, err) == (0, "")
    images = compare_strategies(SCENE, 2, reference_spp=32, rng=3)
    assert png.read_bytes() == encode(draw(strategy_images(images, exposure=-1.0)))[0]
    channels = OpenEXR.File(str(exr), separate_channels=True).channels()
    layers = {f"{name}.{c}" for name in (*images, "reference.image_se") for c in "RGB"}
    assert set(channels) == layers
    for name, data in images.items():
        found = channels[f"{name}.G"].pixels
        np.testing.assert_array_equal(found, data["image"][..., 1].astype(np.float32))
    told: Any = json.loads(out)
    assert {n: row["samples"] for n, row in told["images"].items()} == {
        "reference": 64, "light": 2, "bsdf": 2, "mis": 2,
    }  # fmt: skip
    off = np.sqrt(np.mean((images["light"]["image"] - images["reference"]["image"]).values ** 2))
    assert told["images"]["light"]["rms_error"] == pytest.approx(off, rel=1e-12)
    assert told["images"]["reference"]["rms_error"] is None
    assert told["files"] == [str(png), str(exr)]


def test_text_has_a_row_per_image(capsys):
    code, out, _ = run(capsys, *SMALL)
    header, _, *rows = out.splitlines()
    assert code == 0
    assert header.split("  ")[0] == "image"
    assert [row.split()[0] for row in rows] == ["reference", "light", "bsdf", "mis"]
    assert [row.split()[4] for row in rows] == ["64", "4", "4", "4"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--strategy", "light"), "leave out --strategy"),
        (("-m", "3"), "leave out --realizations"),
        (("--reference",), "leave out --reference"),
        (("--spp", "3"), "even number"),
        (("--reference-spp", "33"), "multiple of batches"),
        (("--reference-spp", "many"), "--reference-spp"),
        (("-o", "a.jpg"), "must end in .exr or .png"),
    ],
)
def test_mistakes_are_one_sentence(capsys, options, message):
    code, out, err = run(capsys, *SMALL, *options)
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1


def test_reference_samples_are_for_comparisons(capsys):
    code, _, err = run(capsys, *[option for option in SMALL if option != "--compare"])
    assert code == 2
    assert "--reference-spp is for --compare" in err
