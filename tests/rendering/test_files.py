"""Files of rendered images: reading back, layers, names, and files that cannot be written."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import xarray as xr

from mcspectra.core.errors import FileFormatError, McspectraError, ParameterError
from mcspectra.core.images import read_image
from mcspectra.core.streams import Stream
from mcspectra.rendering.files import (
    encode_srgb,
    write_comparison,
    write_exr,
    write_png,
    write_render,
)

IMAGE = 4.0 * Stream.from_rng(1).uniforms(0, 1, 5 * 7 * 3).reshape(5, 7, 3)


def result(*, errors=True):
    names = ("image", "variance", "image_se") if errors else ("image",)
    arrays = {name: (("y", "x", "channel"), k + IMAGE) for k, name in enumerate(names)}
    return xr.Dataset(arrays, attrs={"sampler": "sobol | owen", "spp": 4})


def planes(file):
    channels = OpenEXR.File(str(file), separate_channels=True).channels()
    return {name: channel.pixels for name, channel in channels.items()}


def test_exr_has_the_image_and_its_errors(tmp_path):
    file = tmp_path / "image.EXR"
    assert write_render(file, result()) == ["", "variance", "image_se"]
    np.testing.assert_array_equal(read_image(file), IMAGE.astype(np.float32))
    found = planes(file)
    assert len(found) == 9
    np.testing.assert_array_equal(found["variance.G"], (1 + IMAGE[..., 1]).astype(np.float32))
    np.testing.assert_array_equal(found["image_se.B"], (2 + IMAGE[..., 2]).astype(np.float32))
    told = json.loads(OpenEXR.File(str(file)).header()["comments"])
    assert told == {"sampler": "sobol | owen", "spp": 4}


def test_exr_of_one_image_has_no_error(tmp_path):
    file = tmp_path / "image.exr"
    assert write_render(file, result(errors=False)) == [""]
    assert set(planes(file)) == set("RGB")


def test_exr_of_a_plane_is_luminance(tmp_path):
    file = tmp_path / "map.exr"
    write_exr(file, {"": IMAGE[..., 0], "rate.light": IMAGE[..., 1]})
    np.testing.assert_array_equal(read_image(file)[..., 0], IMAGE[..., 0].astype(np.float32))
    assert set(planes(file)) == {"Y", "rate.light.Y"}


@pytest.mark.parametrize("exposure", [0.0, -2.0, 1.0])
def test_png_is_the_exposed_image_to_half_a_step(tmp_path, exposure):
    file = tmp_path / "image.png"
    assert write_render(file, result(), exposure=exposure) == [""]
    found = encode_srgb(read_image(file))  # reading undoes the transfer function
    expected = encode_srgb(np.clip(IMAGE * 2.0**exposure, 0, 1))
    assert np.abs(found - expected).max() <= 0.5 / 255 + 1e-6


def test_transfer_function_has_its_published_values():
    # IEC 61966-2-1: both branches meet, 18 % gray is 0.4613…, and values outside [0,1] are clipped.
    values = encode_srgb(np.array([-1.0, 0.0, 0.0031308, 0.0031308001, 0.18, 1.0, 9.0]))
    np.testing.assert_allclose(values[[0, 1, 5, 6]], [0.0, 0.0, 1.0, 1.0], atol=1e-15)
    assert abs(values[2] - values[3]) < 1e-6
    assert abs(values[4] - 0.46135613) < 1e-8


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("image.jpg", "must end in .exr or .png"),
        ("image", "must end in"),
        ("", "not the path"),
        (3, "not the path"),
        (None, "not the path"),
        ("nowhere/image.exr", "folder that does not exist"),
        ("nowhere/image.png", "folder that does not exist"),
        ("\0.exr", "not a possible file name"),
    ],
)
def test_invalid_names_raise(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileFormatError, match=message):
        write_render(name, result())


@pytest.mark.parametrize("extension", [".exr", ".png"])
def test_folders_and_long_names_are_refused(tmp_path, extension):
    (tmp_path / f"folder{extension}").mkdir()
    for name in (f"folder{extension}", 300 * "a" + extension):
        with pytest.raises(FileFormatError):
            write_render(tmp_path / name, result())


@pytest.mark.parametrize("extension", [".exr", ".png"])
def test_files_that_cannot_be_opened_say_why(tmp_path, monkeypatch, extension):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr("PIL.Image.Image.save", refuse)
    with pytest.raises(FileFormatError, match="cannot be written: Permission denied"):
        write_render(tmp_path / f"image{extension}", result())


@pytest.mark.parametrize(
    "layers",
    [
        {},
        {"": np.zeros(3)},
        {"": np.zeros((3, 4, 2))},
        {"": np.zeros((0, 4, 3))},
        {"": np.zeros((3, 4)), "other": np.zeros((4, 4))},
    ],
)
def test_invalid_layers_raise(tmp_path, layers):
    with pytest.raises(ParameterError, match="all of one size"):
        write_exr(tmp_path / "image.exr", layers)
    assert not (tmp_path / "image.exr").exists()


@pytest.mark.parametrize("exposure", [np.nan, np.inf, 1000, "bright", None])
def test_invalid_exposures_raise(tmp_path, exposure):
    with pytest.raises(McspectraError, match="exposure"):
        write_png(tmp_path / "image.png", IMAGE, exposure=exposure)


def test_finite_numbers_stay_finite(tmp_path):
    file, largest = tmp_path / "image.exr", np.finfo(np.float32).max
    values = np.array([[1e300, -1e300, np.inf, -np.inf, np.nan, 1.5]])
    write_exr(file, {"": values})  # an overflow would be a warning, which is an error here
    expected = [[largest, -largest, np.inf, -np.inf, np.nan, 1.5]]
    np.testing.assert_array_equal(planes(file)["Y"], expected)


def test_results_and_paths_that_are_swapped_or_missing(tmp_path):
    file = tmp_path / "a.exr"
    with pytest.raises(ParameterError, match="give the path first, then the result") as refused:
        write_render(result(), file)
    assert "\n" not in str(refused.value)
    for wrong in (None, IMAGE, result().drop_vars("image")):
        with pytest.raises(ParameterError, match="give the result of render"):
            write_render(file, wrong)
    with pytest.raises(FileFormatError, match=r"^A Dataset is not the path"):
        write_exr(result(), {"": IMAGE})
    assert not file.exists()


def test_invalid_comparisons_raise(tmp_path):
    file = tmp_path / "all.exr"
    smaller = result().isel(x=slice(3))
    with pytest.raises(ParameterError, match="all of one size"):
        write_comparison(file, {"reference": result(), "mis": smaller})
    with pytest.raises(ParameterError, match="give the result of render"):
        write_comparison(file, {"reference": xr.Dataset()})
    with pytest.raises(FileFormatError, match=r"must end in \.exr"):
        write_comparison(tmp_path / "all.png", {"reference": result()})
    assert write_comparison(file, {"reference": result()}) == ["reference", "reference.image_se"]
