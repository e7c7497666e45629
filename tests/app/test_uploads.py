"""Uploads are stored under their digest, and broken ones are refused."""

import hashlib
import io

import numpy as np
import pytest
from PIL import Image

from mcspectra.app.uploads import MOST_BYTES, keep_upload, upload_path
from mcspectra.core.errors import FileFormatError


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))


def png(width=3, height=2):
    data = io.BytesIO()
    Image.new("L", (width, height), 128).save(data, "PNG")
    return data.getvalue()


def test_a_picture_is_found_by_its_digest():
    data = png()
    digest = keep_upload(data, "a folder/My Picture.PNG")
    assert digest == hashlib.sha256(data).hexdigest()
    assert upload_path(digest).read_bytes() == data
    assert keep_upload(data, "other.png") == digest
    assert len(list(upload_path(digest).parent.iterdir())) == 1


@pytest.mark.parametrize(
    ("data", "name", "said"),
    [
        (b"", "a.png", "0 bytes"),
        (b"x" * (MOST_BYTES + 1), "a.png", "16 MiB"),
        (b"not a picture", "a.png", "damaged"),
        (png()[:30], "a.png", "damaged"),
        (png(), "a.txt", "must end in"),
        (png(), "", "must end in"),
        (b"x", "a.exr", "cannot be read"),
        (b"x", "a.npy", "cannot be read"),
    ],
)
def test_broken_pictures_are_refused(data, name, said, tmp_path):
    with pytest.raises(FileFormatError, match=said) as caught:
        keep_upload(data, name)
    assert str(tmp_path) not in str(caught.value)
    assert not list(tmp_path.glob("uploads/*"))


def test_pictures_of_too_many_pixels_are_refused():
    with pytest.raises(FileFormatError, match="^The picture, of .* make a smaller version"):
        keep_upload(png(5000, 4000), "a.png")  # Refused before it is decompressed
    data = io.BytesIO()
    np.savez_compressed(data, image=np.zeros((4200, 4000), np.uint8))
    with pytest.raises(FileFormatError, match="at most 16777216"):
        keep_upload(data.getvalue(), "a.npz")


def test_nan_is_refused():
    data = io.BytesIO()
    np.save(data, np.full((2, 2), np.nan))
    with pytest.raises(FileFormatError, match="NaN"):
        keep_upload(data.getvalue(), "a.npy")


def test_unknown_digests_ask_for_the_picture():
    with pytest.raises(FileFormatError, match="upload it again"):
        upload_path("0" * 64)
