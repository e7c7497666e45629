"""The cache of arrays: stored entries, checks, and damaged entries."""

import hashlib
import time

import numpy as np
import pytest

from mcspectra.core import cache
from mcspectra.core.cache import cache_folder, cache_size, cached_array
from mcspectra.core.errors import CacheWarning, ParameterError
from mcspectra.core.records import pack

VALUES = np.random.default_rng(1).random((50, 2))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_WORTH_KEEPING", -1.0)
    cache._drop_oldest.cache_clear()
    cache._warn_once.cache_clear()
    return tmp_path / "cache"


class Maker:
    """Counts how often the array is computed."""

    def __init__(self, values=VALUES):
        self.values, self.calls = values, 0

    def __call__(self):
        self.calls += 1
        return self.values


def entry(folder):
    (file,) = folder.glob("*/*.array")
    return file


def test_an_array_is_computed_once_then_read(folder):
    make = Maker()
    first, second = cached_array("key", make), cached_array("key", make)
    assert make.calls == 1
    np.testing.assert_array_equal(first, VALUES)
    np.testing.assert_array_equal(second, VALUES)
    assert second.dtype == np.float64
    assert second.flags.writeable
    assert cache_size() == (1, entry(folder).stat().st_size)
    assert not list(folder.glob("*/*.part"))


def test_other_keys_are_other_entries():
    cached_array("a", Maker())
    other = Maker(VALUES[:3])
    np.testing.assert_array_equal(cached_array("b", other), VALUES[:3])
    assert other.calls == 1


def test_quick_arrays_are_not_stored(monkeypatch):
    monkeypatch.setattr(cache, "_WORTH_KEEPING", 3600.0)
    cached_array("key", Maker())
    assert cache_size() == (0, 0)


def flip(content, at):
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


def signed(record):
    """An entry with another record."""
    packed = pack(record)
    return hashlib.sha256(packed).digest() + packed


DAMAGE = {
    "empty": lambda content: b"",
    "truncated": lambda content: content[:-8],
    "cut in the head": lambda content: content[:30],
    "longer": lambda content: content + bytes(8),
    "a bit of the data": lambda content: flip(content, len(content) - 100),
    "a bit of the name": lambda content: flip(content, 3),
    "another key": lambda content: content.replace(b"\xa3key", b"\xa3kez"),
    "another key, signed": lambda content: signed({"kez": VALUES}),
    "another shape": lambda content: content.replace(b"\x92\x32\x02", b"\x92\x02\x32"),
    "no array": lambda content: signed({"key": 1}),
    "no record": lambda content: hashlib.sha256(b"[1]").digest() + b"[1]",
    "format 1": lambda content: b'mcspectra cache 1\n{"key":"key"}\n' + content[-800:],
    "not text": lambda content: bytes(range(256)) * 4,
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_damaged_entries_are_computed_again(folder, damage):
    cached_array("key", Maker())
    file = entry(folder)
    sound = file.read_bytes()
    assert damage(sound) != sound
    file.write_bytes(damage(sound))
    make = Maker()
    with pytest.warns(CacheWarning, match="is damaged; it is computed again"):
        np.testing.assert_array_equal(cached_array("key", make), VALUES)
    assert make.calls == 1
    assert file.read_bytes() == sound


def test_an_unwritable_folder_gives_one_warning(folder):
    folder.write_text("a file where the folder should be")
    make = Maker()
    with pytest.warns(CacheWarning, match="cannot be stored in"):
        cached_array("key", make)
    cached_array("key", make)  # a second warning would be an error here
    assert make.calls == 2


def test_the_oldest_entries_are_deleted_above_the_limit(folder, monkeypatch):
    for key in "abc":
        cached_array(key, Maker())
        time.sleep(0.02)
    monkeypatch.setattr(cache, "_LIMIT", 2 * entry_size(folder) + 1)
    cache._drop_oldest.cache_clear()
    cached_array("d", Maker())
    assert cache_size()[0] == 2
    again = Maker()
    cached_array("d", again)
    assert again.calls == 0


def entry_size(folder):
    return next(folder.glob("*/*.array")).stat().st_size


def test_the_folder_is_the_platform_s_unless_chosen(monkeypatch):
    monkeypatch.delenv("MCSPECTRA_CACHE")
    assert cache_folder().name == "mcspectra"


@pytest.mark.parametrize(("key", "make"), [(3, Maker()), (None, Maker()), ("key", VALUES)])
def test_invalid_keys_and_functions_raise(key, make):
    with pytest.raises(ParameterError, match="a key and a function"):
        cached_array(key, make)
