"""Zarr stores that do not decompress to more than their metadata claim.

A few hundred bytes of Zstandard decompress to gigabytes, whatever shape the array claims to have; a zip
file hides the same in its own compression. Sizes are therefore read from the headers first.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zarr.storage import LocalStore, WrapperStore

from mcspectra.core.errors import StoreError
from mcspectra.core.memory import available_memory, shown_bytes

if TYPE_CHECKING:
    from zarr.abc.store import Store
    from zarr.core.buffer import Buffer

__all__ = ["BoundedStore", "check_zip", "content_size"]

_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_HEADER = 18
_MOST_METADATA = 2**28  # bytes of a zarr.json in a zip file; 2,000 consolidated cells take 2**24


class BoundedStore(WrapperStore["Store"]):
    """A store whose chunks are at most as large as the largest chunk that an array of it claims.

    Parameters
    ----------
    store
        The store.
    bound
        Its one element is that largest chunk in bytes; whoever checks metadata raises it.
    """

    def __init__(self, store: Store, bound: list[int] | None = None) -> None:
        super().__init__(store)
        self.bound = [0] if bound is None else bound

    @property
    def folder(self) -> Path | None:
        """Where it is, if that is a folder of this machine."""
        return getattr(self._store, "root", None) if isinstance(self._store, LocalStore) else None

    def allow(self, size: int) -> None:
        """An array claims chunks of `size` bytes, which was found to be acceptable."""
        self.bound[0] = max(self.bound[0], size)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Buffer | None:
        """The bytes of a key.

        Raises
        ------
        StoreError
            It is a chunk that would decompress to more than any array claims.
        """
        value = await super().get(key, prototype, byte_range)
        if value is not None and not key.endswith("zarr.json"):
            self._check(key, value)
        return value

    def _check(self, key: str, value: Buffer) -> None:
        start = value[:_MOST_HEADER].to_bytes()
        if not start.startswith(_MAGIC):
            return  # not compressed, or damaged: the decoder says so
        size = content_size(start)
        if size is None or size > self.bound[0]:
            claim = "an unknown size" if size is None else shown_bytes(size)
            raise StoreError(
                f"The chunk {key} would decompress to {claim}, and its array has "
                f"{shown_bytes(self.bound[0])} at most; it is not read."
            )

    def _with_store(self, store: Store) -> BoundedStore:
        return BoundedStore(store, self.bound)


def content_size(frame: bytes) -> int | None:
    """Bytes that a Zstandard frame decompresses to, by its header (RFC 8878, section 3.1.1.1).

    None if it does not say, as frames of streams do, or is cut off.
    """
    descriptor = frame[4] if len(frame) > 4 else 0
    flag, single = descriptor >> 6, bool(descriptor & 0x20)
    width = 1 if flag == 0 and single else (0, 2, 4, 8)[flag]
    start = 5 + (not single) + (0, 1, 2, 4)[descriptor & 3]
    field = frame[start : start + width]
    if width == 0 or len(field) < width:
        return None
    return int.from_bytes(field, "little") + (256 if width == 2 else 0)


def check_zip(path: Path) -> None:
    """Refuse a zip file with a member that is larger than memory, or metadata too large to be any.

    Raises
    ------
    StoreError
        It names the member.
    """
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            most = available_memory()
            if info.filename.endswith("zarr.json"):
                most = min(most, _MOST_METADATA)
            if info.file_size > most:
                raise StoreError(
                    f"{str(path)!r} holds {info.filename!r} of {shown_bytes(info.file_size)}; at most "
                    f"{shown_bytes(most)} are read of it."
                )
