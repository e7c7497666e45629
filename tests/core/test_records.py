"""States of reductions: they merge by rules of their fields, and survive as bytes bit for bit."""

import math
import tracemalloc
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mcspectra.core.analysis import MergeTree
from mcspectra.core.checks import Array
from mcspectra.core.confidence import log_mean_interval
from mcspectra.core.errors import FileFormatError
from mcspectra.core.records import (
    JOIN,
    SAME,
    SUM,
    Join,
    MeanSums,
    merged,
    pack,
    unpack,
)
from mcspectra.core.results import dataset


@dataclass
class Inner:
    total: SUM
    count: int


@dataclass
class Own:
    """A record whose fields depend on each other."""

    words: str

    def merge(self, other):
        return Own(f"({self.words}{other.words})")


@dataclass
class Outer:
    rows: JOIN
    columns: Annotated[Array, Join(1)]
    label: SAME
    weight: float
    inner: Inner
    own: Own
    maybe: SUM | None
    parts: list[Inner]


def _inner(value):
    return Inner(np.array([value, 2 * value]), 1)


def _outer(value, maybe=None):
    return Outer(
        rows=np.full((1, 2), value),
        columns=np.full((2, 1), value),
        label=np.array([7]),
        weight=value,
        inner=_inner(value),
        own=Own(f"{value:g}"),
        maybe=maybe,
        parts=[_inner(value), _inner(-value)],
    )


def test_every_field_merges_by_its_rule():
    both = merged(_outer(1.0), _outer(2.0))
    assert both.rows.tolist() == [[1, 1], [2, 2]]
    assert both.columns.tolist() == [[1, 2], [1, 2]]
    assert both.label.tolist() == [7]
    assert both.weight == 3.0
    assert (both.inner.total.tolist(), both.inner.count) == ([3, 6], 2)
    assert both.own.words == "(12)"
    assert [part.total.tolist() for part in both.parts] == [[3, 6], [-3, -6]]


def test_missing_fields_come_from_the_other_block():
    there = np.array([1.0])
    for left, right, found in (
        (None, None, None),
        (there, None, there),
        (None, there, there),
        (np.array([1.0]), there, np.array([2.0])),
    ):
        both = merged(_outer(1.0, left), _outer(2.0, right)).maybe
        assert (both is None) if found is None else np.array_equal(both, found)


def test_lists_merge_item_by_item_and_have_one_length():
    assert [each.count for each in merged([_inner(1.0)] * 3, [_inner(2.0)] * 3)] == [2, 2, 2]
    with pytest.raises(ValueError, match="shorter"):
        merged([_inner(1.0)] * 2, [_inner(1.0)])


@pytest.mark.parametrize("state", [np.zeros(2), {"a": np.zeros(2)}, 3.0])
def test_values_without_a_merge_rule_raise(state):
    with pytest.raises(TypeError, match="make it a field of a record"):
        merged(state, state)


def test_a_mean_and_its_error_agree_with_numpy():
    values = np.random.default_rng(1).random((9, 4))
    before, tree = values.copy(), MergeTree()
    for row in values:
        tree.add(MeanSums.of(row))
    mean, se = tree.total().mean_and_error()
    np.testing.assert_allclose(mean, values.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(se, values.std(axis=0, ddof=1) / 3, rtol=1e-12)
    np.testing.assert_array_equal(values, before)


def test_one_realization_has_no_error():
    mean, se = MeanSums.of(np.array([2.0])).mean_and_error()
    assert mean.tolist() == [2.0]
    assert np.isnan(se).all()


@pytest.mark.parametrize("count", [4, 10, 30])
def test_intervals_of_positive_means_cover_them(count):
    """Power of one and of eight independent frequencies: ± 2 errors cover 79 to 85 %."""
    rng = np.random.default_rng(1)
    for shape, least in ((1.0, 0.93), (8.0, 0.94)):
        values = rng.gamma(shape, size=(20_000, count))
        mean, se = values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(count)
        low, high = log_mean_interval(mean, se, count).T
        assert ((low <= shape) & (shape <= high)).mean() > least - 4 * np.sqrt(0.07 / 20_000)
        assert (low > 0).all()


def test_intervals_without_spread():
    ends = log_mean_interval(np.array([0.0, 2.0, 3.0]), np.array([0.0, 0.0, math.nan]), 5)
    np.testing.assert_array_equal(ends, [[0, 0], [2, 2], [math.nan, math.nan]])


# --- bytes
# ------------------------------------------------------------------------------------------

ODD = np.array([0.1 + 0.2, -0.0, np.nan, np.inf, 5e-324])
NUMBERS = st.one_of(
    hnp.boolean_dtypes(),
    hnp.integer_dtypes(endianness="?"),
    hnp.unsigned_integer_dtypes(endianness="?"),
    hnp.floating_dtypes(endianness="?"),
    hnp.complex_number_dtypes(endianness="?"),
    hnp.unicode_string_dtypes(endianness="?", max_len=5),
)


def _same(one, other):
    return (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())


@settings(deadline=None)
@given(hnp.arrays(NUMBERS, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)))
def test_arrays_of_every_type_come_back_bit_for_bit(array):
    back = unpack(np.ndarray, pack(array))
    assert _same(back, array)
    assert back.flags.writeable


def test_arrays_of_any_memory_layout_come_back():
    array = np.arange(24.0).reshape(2, 3, 4)
    for view in (array.T, array[:, ::2], array[..., ::-1], np.asfortranarray(array)):
        assert np.array_equal(unpack(np.ndarray, pack(view)), view)


@pytest.mark.parametrize("maybe", [None, ODD])
def test_records_come_back_as_they_were(maybe):
    record = _outer(0.1 + 0.2, maybe)
    record.rows = ODD.reshape(1, 5)
    back = unpack(Outer, pack(record))
    assert type(back) is Outer
    assert _same(back.rows, record.rows)
    assert _same(back.columns, record.columns)
    assert (type(back.weight), back.weight) == (float, 0.1 + 0.2)
    assert (type(back.inner), type(back.inner.count), back.inner.count) == (Inner, int, 1)
    assert back.own == record.own
    assert [_same(a.total, b.total) for a, b in zip(back.parts, record.parts, strict=True)] == [
        True,
        True,
    ]
    assert (back.maybe is None) if maybe is None else _same(back.maybe, maybe)
    assert pack(back) == pack(record)


@settings(deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32))
def test_states_that_were_bytes_merge_to_the_same_bits(blocks, seed):
    draws = np.random.default_rng(seed).random((blocks, 3))
    direct, through = MergeTree(), MergeTree()
    for row in draws:
        direct.add(MeanSums.of(row))
        through.add(unpack(MeanSums, pack(MeanSums.of(row))))
    assert pack(direct.total()) == pack(through.total())


def _dataset():
    return dataset(
        {
            "variance": (("n", "channel"), np.array([ODD, ODD[::-1]])),
            "mean_coefficient": (("n",), np.array([1j, 2.5])),
            "reached": ((), np.int64(1)),
            "improvement": (("n",), np.array([True, False])),
        },
        {
            "n": ("n", [4, 16], {"long_name": "number of points", "units": "1"}),
            "label": ("channel", ["", "β", "red", "green", "blue"]),
            "bound": ["low", "high"],
        },
        seed=3,
        eps=0.1 + 0.2,
        note="é; ∫1/p",
        counts=[1, 2],
    )


def test_datasets_come_back_as_they_were():
    data = _dataset()
    data.attrs |= {"scalar": 1.5, "width": np.float64(0.3), "flag": np.True_}
    back = unpack(xr.Dataset, pack(data))
    xr.testing.assert_identical(back, data)
    assert {n: v.dtype for n, v in back.variables.items()} == {
        n: v.dtype for n, v in data.variables.items()
    }
    assert list(back.indexes) == list(data.indexes)
    assert _same(back["variance"].values, data["variance"].values)
    assert [type(back.attrs[name]) for name in ("scalar", "width", "flag")] == [float, float, bool]
    assert pack(back) == pack(data)


def test_datasets_without_values_come_back():
    for data in (xr.Dataset({"variance": (("n", "m"), np.zeros((0, 3)))}), xr.Dataset()):
        xr.testing.assert_identical(unpack(xr.Dataset, pack(data)), data)


@pytest.mark.parametrize(
    "state",
    [
        np.array([{}, None], object),
        np.array([b"raw"]),
        np.zeros(2, "M8[s]"),
        np.zeros(2, "f8,i4"),
        {"a": print},
        Inner(np.array([print], object), 1),
        xr.Dataset({"variance": ("n", np.array([{}, None], object))}),
        xr.Dataset(attrs={"function": print}),
        xr.Dataset({"variance": ((), 1.0, {"note": None})}),
        xr.Dataset(attrs={"list": [print]}),
    ],
)
def test_objects_of_python_are_refused(state):
    with pytest.raises(TypeError):
        pack(state)


# --- untrusted bytes
# --------------------------------------------------------------------------------


def _refused(kind, payload):
    """The payload is rejected in one sentence, and nothing larger than it is allocated."""
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=r"^A stored result cannot be read: .+\.$"):
            unpack(kind, payload)
        assert tracemalloc.get_traced_memory()[1] < 2 * len(payload) + 2**19
    finally:
        tracemalloc.stop()


def _forged(tree, arrays, data=b""):
    header = msgspec.msgpack.encode((tree, arrays))
    return b"mcs1" + len(header).to_bytes(8, "little") + header + data


KINDS = {
    "array": (np.ndarray, pack(ODD)),
    "record": (Outer, pack(_outer(1.0, ODD))),
    "list": (list[Inner], pack([_inner(1.0), _inner(2.0)])),
    "dict": (dict[str, np.ndarray], pack({"a": ODD})),
    "dataset": (xr.Dataset, pack(_dataset())),
}


@pytest.mark.parametrize("name", KINDS)
def test_bytes_that_are_cut_or_too_many_are_refused(name):
    kind, payload = KINDS[name]
    header = 12 + int.from_bytes(payload[4:12], "little")
    for length in {0, 3, 4, 11, 12, header // 2, header - 1, header, len(payload) - 1}:
        _refused(kind, payload[:length])
    _refused(kind, payload + b"\0")


@settings(deadline=None, max_examples=300)
@given(st.sampled_from(sorted(KINDS)), st.lists(st.integers(0, 2**32), min_size=1, max_size=4))
def test_bytes_that_are_damaged_are_refused_or_another_state(name, changes):
    kind, payload = KINDS[name]
    damaged = bytearray(payload)
    header = 12 + int.from_bytes(payload[4:12], "little")
    for change in changes:  # changes to the header, where all errors can occur
        damaged[change % header] ^= 1 + (change >> 20) % 255
    try:
        unpack(kind, bytes(damaged))
    except FileFormatError as error:
        assert str(error).startswith("A stored result cannot be read: ")  # noqa: PT017


@pytest.mark.parametrize("name", KINDS)
def test_bytes_of_other_kinds_are_refused(name):
    kind, _ = KINDS[name]
    others = [payload for other, payload in KINDS.values() if other is not kind]
    for payload in (b"not a state", bytes(100), b"mcs1" + b"\xff" * 20, *others):
        if kind is not np.ndarray or payload not in others:
            _refused(kind, payload)
    _refused(kind, _forged(3, []))
    _refused(kind, _forged(None, []))


CLAIMS = {
    "larger than all memory": [("<f8", (2**60, 2**60))],
    "large": [("<f8", (2**28,))],
    "without rows, of long texts": [("<U1000000000", (0,))],
    "of objects": [("|O", (1,))],
    "of records": [("<f8,<i4", (1,))],
    "a shape that is a name": [("(2,f8", (1,))],
    "of no type": [(None, (1,))],
    "negative": [("<f8", (-1,))],
    "of half a row": [("<f8", (0.5,))],
    "of infinitely many": [("<f8", (float("inf"),))],
    "of many dims": [("<f8", (1,) * 200)],
    "no list": 3,
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_impossible_arrays_are_rejected(claim):
    _refused(np.ndarray, _forged(0, CLAIMS[claim], bytes(8)))


def test_texts_with_invalid_characters_are_rejected():
    variables = [("a", True, ["a"], 0, {})]
    tree = {"attrs": {}, "variables": variables}
    _refused(xr.Dataset, _forged(tree, [("<U1", (1,))], b"\xff" * 4))


def test_a_tree_that_is_too_deep_is_refused():
    deep = b"\x92" + b"\x91" * 100_000
    _refused(np.ndarray, b"mcs1" + len(deep).to_bytes(8, "little") + deep)


@pytest.mark.parametrize(
    "variables",
    [
        [3],
        [("a", True, ["a"], 1, {})],
        [("a", True, ["a"], "0", {})],
        [("a", True, ["a", "b"], 0, {})],
        [("a", True, 3, 0, {})],
        [([1], True, ["a"], 0, {})],
        [("a", True, ["a"], 0, 3)],
        [("a", True, ["x"], 0, {}), ("b", True, ["x"], 1, {})],
    ],
)
def test_impossible_datasets_are_rejected(variables):
    arrays = [("<f8", (1,)), ("<f8", (2,))]
    tree = {"attrs": {}, "variables": variables}
    used = len(variables)
    payload = _forged(tree, arrays[:used], bytes(8 * (1 if used == 1 else 3)))
    _refused(xr.Dataset, payload)
