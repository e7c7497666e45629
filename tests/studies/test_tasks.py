"""Tasks are computed from text alone, and their results are plain numbers."""

import io
import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.errors import ConfigError, FileFormatError, ParameterError, StoreError
from mcspectra.core.staged import Run
from mcspectra.studies.files import decode_study
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.tasks import (
    StudyText,
    analysis_of,
    compute_task,
    pack_payload,
    task_of,
    unpack_payload,
)
from mcspectra.studies.vetting import Trust

STUDY = """
title = "t"
seed = 5
samplers = ["jittered | shift"]
[exact]
counts = [4, 16]
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""
ARRAYS = {
    "file": np.arange(6.0).reshape(2, 3),
    "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
    "scalar": np.array(1.5),
    "empty": np.empty((0, 3), np.complex128),
    "bytes": np.frombuffer(b"header", np.uint8),
    "special": np.array([np.nan, -0.0, np.inf, 5e-324]),
}


def _text(study=STUDY, **changes):
    text = StudyText.of(decode_study(study), Path())
    return msgspec.structs.replace(text, **changes)


def test_payloads_come_back_bit_for_bit():
    payload = pack_payload(ARRAYS)
    found = unpack_payload(payload)
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        assert found[name].shape == array.shape
        assert found[name].tobytes() == array.tobytes()
        assert found[name].flags.writeable
    assert found["fortran"].flags.f_contiguous
    assert pack_payload(ARRAYS) == payload
    assert np.load(io.BytesIO(payload), allow_pickle=False)["scalar"] == 1.5
    assert unpack_payload(pack_payload({})) == {}


def test_objects_are_neither_written_nor_read():
    with pytest.raises(FileFormatError, match="objects"):
        pack_payload({"a": np.array([{}], object)})
    buffer = io.BytesIO()
    np.savez(buffer, a=np.array([{}], object))
    with pytest.raises(FileFormatError, match="objects"):
        unpack_payload(buffer.getvalue())


def test_claims_of_payloads_are_checked_before_anything_is_allocated():
    """A header that claims 10¹² numbers, and a compressed member that would grow."""
    for shape in ((10**12,), (-1,), (1, 10**18, 0), (0,), (2,)):
        with pytest.raises(FileFormatError, match="does not hold"):
            unpack_payload(_member(b"".join(_npy(shape, b"\0" * 8))))
    assert unpack_payload(_member(b"".join(_npy((1,), b"\0" * 8))))["a"].tolist() == [0.0]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, a=np.zeros(10**6))
    with pytest.raises(FileFormatError, match="compressed"):
        unpack_payload(buffer.getvalue())


def _npy(shape, data):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    return stream.getvalue(), data


def _member(raw):
    """A zip with `raw` as its member, of a right checksum."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.npy", raw)
    return buffer.getvalue()


@pytest.mark.parametrize("cut", [0, 1, 10, 100, -1])
def test_torn_payloads_are_refused(cut):
    with pytest.raises(FileFormatError, match="cannot be read"):
        unpack_payload(pack_payload(ARRAYS)[:cut])


def test_flipped_bits_are_noticed():
    payload = bytearray(pack_payload({"a": np.arange(100.0)}))
    payload[400] ^= 1
    with pytest.raises(FileFormatError, match="cannot be read"):
        unpack_payload(bytes(payload))


def test_keys_say_what_the_task_is():
    run = Run(part=2, first=100, realizations=25, blocks=8, cost=16.0)
    task = task_of("a/b/convergence", run, (4, 2))
    assert task.key == "a/b/convergence/2-100-25/4+2"
    assert (task.run, task.chunk, task.cost) == (run, (4, 2), 4.0)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(task), type=type(task)) == task


def test_a_worker_needs_text_alone():
    """The text goes to JSON and back, as to another machine; the result is what the function gives."""
    text = msgspec.json.decode(msgspec.json.encode(_text()), type=StudyText)
    path = "a/jittered-shift/exact"
    analysis = analysis_of(text, path)
    assert analysis_of(text, path) is analysis
    (run,) = next(analysis.stages())
    state = analysis.unpack(unpack_payload(compute_task(text, task_of(path, run, (0, 1)))))
    wanted = [
        mcs.exact_variance(mcs.Estimator("linear", dims=1), "jittered | shift", n) for n in (4, 16)
    ]
    assert isinstance(state, xr.Dataset)
    assert state["exact_variance"].values.tolist() == wanted


def test_another_version_is_refused():
    with pytest.raises(StoreError, match=r"0\.0\.0.*same version"):
        analysis_of(_text(version="0.0.0"), "a/jittered-shift/exact")


def test_unknown_cells_are_refused():
    with pytest.raises(StoreError, match="no cell 'a/b'"):
        analysis_of(_text(), "a/b")


def test_trust_goes_along():
    study = STUDY.replace('"linear"', "\"python(function='strangers:f')\"")
    trust = Trust(("a:b",), (Path("elsewhere"),))
    text = StudyText.of(decode_study(study), Path(), trust)
    assert text.code == ("a:b",)
    assert text.paths == (str(Path("elsewhere").absolute()),)
    assert text.folder == str(Path().absolute())
    with pytest.raises(ConfigError, match="--allow-code strangers:f"):
        text.plan()


def test_failures_are_sentences():
    assert explain(ParameterError("n is 3; give 4.")) == "n is 3; give 4."
    assert explain(ZeroDivisionError("division by zero")) == (
        "It raised ZeroDivisionError: division by zero."
    )
    assert explain(KeyError()) == "It raised KeyError."
    assert explain(ValueError("two\nlines.")) == "It raised ValueError: two lines."
    assert len(explain(ValueError("x" * 10**6))) < 1000
