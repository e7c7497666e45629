"""The verb `render`: its output and files, and one sentence per mistake."""

import json

import numpy as np
import OpenEXR
import pytest

from mcspectra.cli.main import main
from mcspectra.core.images import read_image
from mcspectra.rendering import render_file
from mcspectra.rendering.image import reference, render

pytestmark = pytest.mark.render

SMALL = ("veach", "--width", "24", "--height", "16")
SCENE = "veach(width=24, height=16)"


@pytest.fixture
def command(capsys):
    """Run `render`; return its exit code, output and errors."""

    def call(*arguments):
        code = main(["render", *map(str, arguments)])
        return code, *capsys.readouterr()

    return call


def test_files_hold_the_image_of_the_library(command, tmp_path):
    exr, png = tmp_path / "image.exr", tmp_path / "image.png"
    options = ("--strategy", "light", "--spp", 4, "-m", 3, "--seed", 5, "--crop", "2,3,7,5")
    code, out, err = command(*SMALL, *options, "-o", exr, "-o", png)
    assert (code, err) == (0, "")
    expected = render(SCENE, "light", spp=4, realizations=3, crop=(2, 3, 7, 5), rng=5)
    np.testing.assert_array_equal(read_image(exr), expected["image"].astype(np.float32))
    layer = OpenEXR.File(str(exr), separate_channels=True).channels()["variance.R"].pixels
    np.testing.assert_array_equal(layer, expected["variance"][..., 0].astype(np.float32))
    assert read_image(png).shape == (5, 7, 3)
    lines = out.splitlines()
    assert lines[0] == f"{SCENE}, light, sobol | owen: 7 × 5 pixels, 4 samples each, 3 images"
    assert [line.split()[0] for line in lines[1:]] == ["mean", "rms", "samples", "wrote", "wrote"]
    rms = np.sqrt((expected["image_se"].values ** 2).mean())
    assert lines[2].split()[-1] == f"{rms:.3g}"


def test_json_has_all_figures(command):
    code, out, err = command(*SMALL, "--strategy", "mis", "--spp", 4, "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    expected = render(SCENE, "mis", spp=4)["image"].mean(("y", "x"))
    np.testing.assert_allclose(found["mean"], expected, rtol=1e-12)
    assert found["rms_se"] is None
    assert (found["width"], found["height"], found["samples"]) == (24, 16, 24 * 16 * 4 * 2)
    assert found["samples_per_second"] > 0


def test_reference_counts_the_samples_of_all_images(command):
    code, out, _ = command(*SMALL, "--reference", "--spp", 32, "-m", 4, "--json")
    found = json.loads(out)
    assert (code, found["spp"], found["realizations"]) == (0, 8, 4)
    expected = reference(SCENE, 32, batches=4)["image"].mean(("y", "x"))
    np.testing.assert_allclose(found["mean"], expected, rtol=1e-12)


def test_quiet_prints_the_result(command, tmp_path):
    file = tmp_path / "image.png"
    arguments = (*SMALL, "--spp", 1, "--strategy", "light", "--quiet", "-o", file)
    code, out, err = command(*arguments)
    assert (code, err) == (0, "")
    assert out.endswith(f"wrote {file}\n")
    assert file.exists()


def test_whole_paths_of_a_built_in_scene(command, tmp_path):
    files = [tmp_path / name for name in ("a.exr", "b.exr", "c.png")]
    outs = [part for file in files for part in ("-o", file)]
    options = ("--integrator", "path(max_depth=3)", "--sampler", "sobol | owen", "--spp", "1.6e1")
    code, out, err = command(*SMALL, *options, *outs, "--json")
    assert (code, err) == (0, "")
    image = render_file(SCENE, integrator="path(max_depth=3)", sampler="sobol | owen", spp=16)
    np.testing.assert_allclose(json.loads(out)["mean"], image.mean((0, 1)), rtol=1e-12)
    np.testing.assert_allclose(read_image(files[0]), image, rtol=1e-3)  # Half floats
    assert files[0].read_bytes() == files[1].read_bytes()
    assert read_image(files[2]).shape == (16, 24, 3)


def test_light_by_number_or_name(command):
    options = ("--strategy", "light", "--spp", 2, "--json", "--light")
    by_name = json.loads(command(*SMALL, *options, "light-0")[1])["mean"]
    by_number = json.loads(command(*SMALL, *options, 0)[1])["mean"]
    assert by_name == by_number


def test_exposure_brightens_the_png(command, tmp_path):
    dark, bright = tmp_path / "dark.png", tmp_path / "bright.png"
    options = (*SMALL, "--spp", 2, "--strategy", "light", "--quiet")
    command(*options, "--exposure", "-3", "-o", dark)
    command(*options, "--exposure", "1", "-o", bright)
    assert read_image(dark).mean() < read_image(bright).mean()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("missing.xml", "--width", 8), "for built-in scenes"),
        (("broken.xml",), "cannot read the scene"),
        ((*SMALL, "--crop", "0,0,25,1"), "the film has 24 × 16 pixels"),
        ((*SMALL, "--crop", "0,0,25"), "give X,Y,W,H"),
        ((*SMALL, "--light", "5"), "light is 5; give a whole number from 0 to 4"),
        ((*SMALL, "--crop", "0,0,a,1"), "--crop"),
        ((*SMALL, "--spp", "many"), "--spp"),
        ((*SMALL, "--spp", "0"), "--spp"),
        ((*SMALL, "-m", "0"), "--realizations"),
        ((*SMALL, "--exposure", "nan"), "--exposure"),
        ((*SMALL, "--exposure", "bright"), "--exposure"),
        ((*SMALL, "-o", "image.jpg"), "must end in .exr or .png"),
        ((*SMALL, "-o", "nowhere/image.exr"), "folder that does not exist"),
        ((*SMALL, "--seed", "-1"), "--seed"),
        (("veach", "--width", "0"), "--width"),
        ((*SMALL, "--sensor", "1"), "--sensor is for whole paths; give --integrator."),
        ((*SMALL, "--integrator", "path", "--crop", "0,0,1,1"), "--crop is for direct light"),
        ((*SMALL, "--integrator", "path", "--compare"), "--compare is for direct light; leave"),
        ((*SMALL, "--integrator", "path", "--sampler", "nosuch"), "no sampler called 'nosuch'"),
        ((*SMALL, "--integrator", "pth"), "Mitsuba cannot render"),
        (("veech", "--integrator", "path"), "no scene called 'veech'"),
        ((), "required"),
    ],
)
def test_mistakes_are_one_sentence(command, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.xml").write_text("<scene version='3.0.0'><sensor>", encoding="utf-8")
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert err.startswith("mcspectra")


def test_unwritable_output_is_one_sentence(command, tmp_path, monkeypatch):
    from pathlib import Path

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    code, _, err = command(*SMALL, "--spp", 1, "--strategy", "light", "-o", tmp_path / "a.exr")
    assert code == 2
    assert "cannot be written: Permission denied" in err
    assert len(err.splitlines()) == 1
