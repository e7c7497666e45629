"""Records and datasets through arrays of numbers: the same bits, types, names and attributes."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr
from mcspectra.core.packing import pack_dataset, pack_record, unpack_dataset, unpack_record

from mcspectra.core.checks import Array
from mcspectra.core.results import dataset


@dataclass(frozen=True)
class _Inner:
    weight: float
    values: Array


@dataclass(frozen=True)
class _Outer:
    count: int
    inner: _Inner
    spectrum: Array
    matrix: Array | None


def _through_file(arrays):
    """What a file without pickle gives back."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return dict(np.load(io.BytesIO(stream.getvalue()), allow_pickle=False))


ODD = np.array([0.1 + 0.2, -0.0, np.nan, np.inf, 5e-324])


@pytest.mark.parametrize("matrix", [None, np.arange(6.0).reshape(2, 3)])
def test_records_come_back_as_they_were(matrix):
    record = _Outer(7, _Inner(0.1, ODD), np.array([1 + 2j, 3 - 0.1j]), matrix)
    packed = _through_file(pack_record(record))
    assert set(packed) - {"matrix"} == {"count", "inner.weight", "inner.values", "spectrum"}
    back = unpack_record(_Outer, packed)
    assert (type(back.count), type(back.inner.weight)) == (int, float)
    assert (back.count, back.inner.weight) == (7, 0.1)
    assert back.inner.values.tobytes() == ODD.tobytes()
    assert np.array_equal(back.spectrum, record.spectrum)
    assert (back.matrix is None) if matrix is None else np.array_equal(back.matrix, matrix)


def test_a_prefix_keeps_several_records_apart():
    first, second = _Inner(1.0, np.zeros(2)), _Inner(2.0, np.ones(3))
    packed = pack_record(first, "a.") | pack_record(second, "b.")
    assert unpack_record(_Inner, packed, "a.").weight == 1.0
    assert np.array_equal(unpack_record(_Inner, packed, "b.").values, np.ones(3))


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
    data.attrs["scalar"] = 1.5
    back = unpack_dataset(_through_file(pack_dataset(data)))
    xr.testing.assert_identical(back, data)
    assert {n: v.dtype for n, v in back.variables.items()} == {
        n: v.dtype for n, v in data.variables.items()
    }
    assert list(back.indexes) == list(data.indexes)
    assert back["variance"].values.tobytes() == data["variance"].values.tobytes()


def test_an_attribute_of_numpy_becomes_a_number():
    data = _dataset()
    data.attrs["width"] = np.float64(0.3)
    assert unpack_dataset(pack_dataset(data)).attrs["width"] == 0.3


def test_empty_variables():
    data = xr.Dataset({"variance": (("n", "m"), np.zeros((0, 3)))})
    xr.testing.assert_identical(unpack_dataset(pack_dataset(data)), data)


def test_objects_and_odd_attributes_are_refused():
    held = xr.Dataset({"variance": ("n", np.array([{}, None], object))})
    with pytest.raises(TypeError, match="variance"):
        pack_dataset(held)
    odd = _dataset()
    odd.attrs["function"] = print
    with pytest.raises(TypeError):
        pack_dataset(odd)
