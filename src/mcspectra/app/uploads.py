"""Pictures that users upload to the explorer. The cache folder stores them by digest.

The state contains the digest, so a URL shows the same picture after a restart.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from mcspectra.core.cache import cache_folder
from mcspectra.core.errors import FileFormatError
from mcspectra.core.images import IMAGE_EXTENSIONS, read_image

__all__ = ["MOST_BYTES", "keep_upload", "upload_path"]

MOST_BYTES = 16 * 2**20
"""Largest accepted file in bytes."""

_MOST_PIXELS = 2**24
_FOLDER = "uploads"


def keep_upload(data: bytes, name: str) -> str:
    """Store a picture and return its SHA-256 digest.

    Parameters
    ----------
    data
        Content of the file.
    name
        Name of the file. Its extension determines the format.

    Raises
    ------
    FileFormatError
        If the picture is too large, damaged, of an unknown format, or cannot be stored.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in IMAGE_EXTENSIONS:
        raise FileFormatError(f"The picture must end in one of {', '.join(IMAGE_EXTENSIONS)}.")
    if not 0 < len(data) <= MOST_BYTES:
        raise FileFormatError(
            f"The picture has {len(data)} bytes; give one of 1 byte to {MOST_BYTES // 2**20} MiB."
        )
    digest = hashlib.sha256(data).hexdigest()
    file = cache_folder() / _FOLDER / f"{digest}{suffix}"
    part = file.with_name(f"{os.getpid()}-{digest}{suffix}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(data)
        try:
            pixels = read_image(part)[..., 0].size
        except FileFormatError as error:
            raise FileFormatError(str(error).replace(str(part), "The picture")) from None
        if pixels > _MOST_PIXELS:
            raise FileFormatError(
                f"The picture has {pixels} pixels; the explorer accepts at most {_MOST_PIXELS}."
            )
        part.replace(file)
    except OSError as error:
        raise FileFormatError(
            f"The picture cannot be stored in {file.parent}: {error.strerror}."
        ) from None
    finally:
        part.unlink(missing_ok=True)
    return digest


def upload_path(digest: str) -> Path:
    """Return the file of an upload.

    Raises
    ------
    FileFormatError
        If the upload is not on this machine.
    """
    folder = cache_folder() / _FOLDER
    for suffix in IMAGE_EXTENSIONS:
        file = folder / f"{digest}{suffix}"
        if file.is_file():
            return file
    raise FileFormatError(
        "The uploaded picture of this address is not on this machine; upload it again."
    )
