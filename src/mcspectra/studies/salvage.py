"""Recover rows of a damaged SQLite file by reading every leaf page of a table on its own.

SQLite reaches rows through inner pages and indices, so one damaged page hides many sound pages.
A leaf page says where its rows are, and the number of columns of a row identifies the table.
Recovered rows may be wrong or out of date, so the caller must check them.
The file format is described at https://www.sqlite.org/fileformat2.html.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias, final

__all__ = ["Leaves", "Row"]

Row: TypeAlias = tuple[bool, int, tuple[Any, ...]]
"""A row of a table: whether its page is in use, its number (rowid), and its column values.

The value is None for a column that stores the rowid."""

_INNER, _LEAF = 5, 13  # Type bytes of inner and leaf pages of tables
_LARGEST = 2**20  # Maximum number of trunk pages read from the free list: 8 GB
_SIZES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # Bytes of an integer, by its serial type


@final
class Leaves:
    """Leaf pages of an SQLite file with a known page size, where every byte may be damaged.

    Parameters
    ----------
    file
        Path of the file. It stays open until `close` is called, and it is not changed.
    size
        Page size in bytes.
    """

    def __init__(self, file: Path, size: int) -> None:
        self._stream = file.open("rb")
        self._size = size
        self._pages = -(-file.stat().st_size // size)
        self._used = self._pages_in_use()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def rows(self) -> Iterator[Row]:
        """Yield all readable rows of all tables, in the order of the pages."""
        for number in range(1, self._pages + 1):
            page, start = self._page(number), 100 * (number == 1)
            if page[start] != _LEAF:
                continue
            for place in self._cells(page, start + 8, start):
                try:
                    payload, after = _varint(page, place)
                    rowid, after = _varint(page, after)
                    content = self._content(page, after, payload)
                    row = number in self._used, rowid, _values(content)
                except (IndexError, ValueError):  # The row cannot be decoded
                    continue
                yield row

    def _page(self, number: int) -> bytes:
        """Return a page by its number, counted from 1; pages beyond the file's end are zeros."""
        if not 1 <= number <= self._pages:
            return bytes(self._size)
        self._stream.seek((number - 1) * self._size)
        return self._stream.read(self._size).ljust(self._size, b"\0")

    def _cells(self, page: bytes, first: int, start: int) -> list[int]:
        """Return the offsets of all rows on a page."""
        count = min(_number(page, start + 3, 2), (self._size - first) // 2)
        return [_number(page, first + 2 * i, 2) for i in range(count)]

    def _content(self, page: bytes, start: int, length: int) -> bytes:
        """Return the bytes of a row; a long row continues on overflow pages."""
        if length > self._pages * self._size:
            raise ValueError("a row that is longer than the file")
        most = self._size - 35
        if length <= most:
            local = length
        else:
            least = (self._size - 12) * 32 // 255 - 23
            local = least + (length - least) % (self._size - 4)
            local = least if local > most else local
        parts, left = [page[start : start + local]], length - local
        following = _number(page, start + local, 4) if left else 0
        while left:
            if not 1 < following <= self._pages:
                raise ValueError("an overflow page that does not exist")
            page = self._page(following)
            following = _number(page, 0, 4)
            parts.append(page[4 : 4 + min(left, self._size - 4)])
            left -= len(parts[-1])
        content = b"".join(parts)
        if len(content) != length:
            raise ValueError("a row that ends beyond its page")
        return content

    def _pages_in_use(self) -> frozenset[int]:
        """Return the numbers of the pages in use; rows on free pages have been deleted.

        If the list of free pages is damaged, return the pages that the trees of tables reach.
        """
        first = self._page(1)
        trunk, free, trunks = _number(first, 32, 4), set[int](), 0
        while 1 < trunk <= self._pages and trunk not in free and trunks < _LARGEST:
            page, trunks = self._page(trunk), trunks + 1
            count = min(_number(page, 4, 4), self._size // 4 - 2)
            free |= {trunk, *(_number(page, 8 + 4 * i, 4) for i in range(count))}
            trunk = _number(page, 0, 4)
        if trunk == 0 and len(free) == _number(first, 36, 4) and any(first):
            return frozenset(range(1, self._pages + 1)) - free
        reached, waiting = set[int](), [1]
        for place in self._cells(first, 108, 100):
            try:
                length, after = _varint(first, place)
                _, after = _varint(first, after)
                waiting.append(int(_values(self._content(first, after, length))[3]))
            except (IndexError, ValueError, TypeError):
                continue
        while waiting:
            number = waiting.pop()
            page, start = self._page(number), 100 * (number == 1)
            if number not in reached and page[start] in (_INNER, _LEAF):
                reached.add(number)
                if page[start] == _INNER:
                    cells = self._cells(page, start + 12, start)
                    waiting += [_number(page, place, 4) for place in (start + 8, *cells)]
        return frozenset(reached)


def _number(content: bytes, at: int, size: int) -> int:
    return int.from_bytes(content[at : at + size], "big")


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """Decode an integer of one to nine bytes; return its value and the offset of its end."""
    value = 0
    for place in range(at, at + 8):
        value = value << 7 | content[place] & 127
        if content[place] < 128:
            return value, place + 1
    value = value << 8 | content[at + 8]
    return value - (value >> 63 << 64), at + 9


def _values(content: bytes) -> tuple[Any, ...]:
    """Return the values of a row; raise an error if a text is not UTF-8."""
    end, at = _varint(content, 0)
    kinds: list[int] = []
    values: list[Any] = []
    while at < end:
        kind, at = _varint(content, at)
        kinds.append(kind)
    for kind in kinds:
        size = _SIZES.get(kind, 0) if kind < 12 else (kind - 12) // 2
        part = content[at : at + size]
        if len(part) < size or kind in (7, 10, 11) or kind < 0:
            raise ValueError("a value that no row of a ledger contains")
        at += size
        if kind >= 12:
            values.append(part.decode() if kind % 2 else part)
        elif kind in (8, 9):
            values.append(kind - 8)
        else:
            values.append(int.from_bytes(part, "big", signed=True) if kind else None)
    return tuple(values)
