"""The journal: nothing that was written is lost or misread, wherever the file is cut or damaged."""

import hashlib
import io
import json
import os
import struct
import subprocess
import sys
import textwrap
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcspectra.core.errors import StaleLockWarning, StorageError, StoreError
from mcspectra.studies import journal as journal_module
from mcspectra.studies._records import MOST_PAYLOAD, Damage, Head, encode_record, scan
from mcspectra.studies.journal import Journal, read_journal
from mcspectra.studies.lock import LOCK_NAME, FolderLock, check_unlocked, lock_holder

HEADER = {"study": "0f", "seed": 3, "version": "1"}
TASKS = {
    "a/one": b"first result",
    "a/two": b"",
    "b/übel": np.arange(50.0).tobytes(),
    "c": b"\xf1mcsRec\n in the payload is no record",
}


def filled(folder: Path) -> tuple[Path, list[int]]:
    """A journal of TASKS and a failure; its file, and where its records end."""
    ends = []
    file = folder / "journal" / "log"
    with Journal.create(folder, HEADER) as journal:
        ends.append(file.stat().st_size)
        for key, payload in TASKS.items():
            journal.append(key, payload, None, {"seconds": 0.5, "host": "h"})
            ends.append(file.stat().st_size)
        journal.append("d", None, "It raised.", {})
        ends.append(file.stat().st_size)
    return file, ends


def found(journal: Journal) -> dict[str, bytes]:
    return {key: journal.payload(key) for key in journal.keys()}  # noqa: SIM118


def rewrite(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)


def test_what_is_appended_is_there_at_once_and_after_resuming(tmp_path: Path) -> None:
    filled(tmp_path)
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == TASKS
        assert journal.failures() == {"d": "It raised."}
        assert not journal.done("d")
        assert not journal.done("e")
        assert journal.info("a/one") == {"seconds": 0.5, "host": "h"}
        assert journal.info("e") == {}
        assert journal.damaged == ()
        journal.append("d", b"now", None, {})
        assert journal.done("d")
        assert journal.failures() == {}
        assert journal.payload("d") == b"now"
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == {**TASKS, "d": b"now"}


def test_a_journal_cut_at_any_byte_holds_exactly_the_complete_records(tmp_path: Path) -> None:
    file, ends = filled(tmp_path)
    content = file.read_bytes()
    assert ends[-1] == len(content)
    for cut in range(ends[0], len(content)):
        complete = sum(end <= cut for end in ends) - 1
        rewrite(file, content[:cut])
        state = read_journal(tmp_path)
        assert state is not None
        assert state.done == tuple(TASKS)[:complete]
        assert (state.failures, state.damaged) == ({}, ())
    rewrite(file, content[: ends[2] + 40])
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == dict(list(TASKS.items())[:2])
        assert file.stat().st_size == ends[2]
        journal.append("c", TASKS["c"], None, {})
    with Journal.resume(tmp_path, HEADER) as journal:
        assert list(journal.keys()) == ["a/one", "a/two", "c"]
        assert journal.damaged == ()


def test_every_flipped_byte_is_noticed_and_costs_one_record(tmp_path: Path) -> None:
    file, ends = filled(tmp_path)
    content = file.read_bytes()
    every = [*TASKS, "d"]
    for at in range(ends[0], len(content)):
        damaged = bytearray(content)
        damaged[at] ^= 1 << at % 8
        file.write_bytes(damaged)
        state = read_journal(tmp_path, verify=True)
        assert state is not None
        hit = sum(end <= at for end in ends) - 1
        kept = every[:hit] + every[hit + 1 :]
        assert [*state.done, *state.failures] == kept
        assert state.damaged in ((every[hit],), (f"record at byte {ends[hit]}",))


@pytest.mark.parametrize("at", [0, 5, 18, 20, 25, 40, 60, 70, 100])
def test_a_damaged_header_is_noticed_and_costs_no_record(tmp_path: Path, at: int) -> None:
    file, ends = filled(tmp_path)
    content = bytearray(file.read_bytes())
    assert at < ends[0]
    content[at] ^= 2
    file.write_bytes(content)
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == TASKS
        assert journal.failures() == {"d": "It raised."}
        assert journal.damaged in (("header",), ("first line",))
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == TASKS
        assert journal.damaged == ()


def test_damaged_records_are_gone_after_resuming(tmp_path: Path) -> None:
    file, ends = filled(tmp_path)
    content = bytearray(file.read_bytes())
    content[ends[3] - 1] ^= 128
    content[ends[0]] ^= 1
    file.write_bytes(content)
    with Journal.resume(tmp_path, HEADER) as journal:
        assert journal.damaged == (f"record at byte {ends[0]}", "b/übel")
        assert sorted(journal.keys()) == ["a/two", "c"]
        journal.append("b/übel", b"again", None, {})
        assert journal.payload("b/übel") == b"again"
    with Journal.resume(tmp_path, HEADER) as journal:
        assert journal.damaged == ()
        assert sorted(journal.keys()) == ["a/two", "b/übel", "c"]


def test_a_payload_damaged_while_the_journal_is_open_is_refused(tmp_path: Path) -> None:
    with Journal.create(tmp_path, HEADER) as journal:
        journal.append("a", b"result", None, {})
        with (tmp_path / "journal" / "log").open("r+b") as file:
            file.seek(-1, os.SEEK_END)
            file.write(b"!")
        with pytest.raises(StoreError, match="'a' in .* is damaged"):
            journal.payload("a")
        assert journal.damaged == ("a",)
        assert not journal.done("a")
        with pytest.raises(StoreError, match="holds no result of 'a'"):
            journal.payload("a")


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from("abcd"), st.one_of(st.none(), st.binary(max_size=200))),
        min_size=1,
        max_size=12,
    ),
    st.data(),
)
def test_the_last_complete_record_of_each_key_counts(
    tmp_path_factory: pytest.TempPathFactory,
    records: list[tuple[str, bytes | None]],
    data: st.DataObject,
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    file = folder / "journal" / "log"
    ends = []
    with Journal.create(folder, HEADER) as journal:
        start = file.stat().st_size
        for key, payload in records:
            journal.append(key, payload, "no" if payload is None else None, {})
            ends.append(file.stat().st_size)
    cut = data.draw(st.integers(start, ends[-1]))
    rewrite(file, file.read_bytes()[:cut])
    kept = dict(record for record, end in zip(records, ends, strict=True) if end <= cut)
    with Journal.resume(folder, HEADER) as journal:
        assert found(journal) == {k: v for k, v in kept.items() if v is not None}
        assert set(journal.failures()) == {k for k, v in kept.items() if v is None}
        assert journal.damaged == ()


def test_a_record_that_claims_a_terabyte_is_not_believed(tmp_path: Path) -> None:
    file, ends = filled(tmp_path)
    content = file.read_bytes()
    study = content[28:36]
    for claimed in (10**9, MOST_PAYLOAD + 1, 10**12, 2**63):
        lengths = struct.pack("<8s8sIQ", b"\xf1mcsRec\n", study, 10, claimed)
        fake = lengths + struct.pack("<I", zlib.crc32(lengths)) + b"{}" * 20
        for rest in (b"", content[ends[0] :]):
            rewrite(file, content[: ends[0]] + fake + rest)
            state = read_journal(tmp_path, verify=True)
            assert state is not None
            assert len(state.done) == (4 if rest else 0)
            if rest:
                assert state.damaged == (f"record at byte {ends[0]}",)


def test_a_head_that_is_no_head_is_damage(tmp_path: Path) -> None:
    file, ends = filled(tmp_path)
    content = file.read_bytes()
    for text in (b"[]", b"{}", b'{"key": 3, "sha256": ""}', b"[" * 100_000):
        lengths = struct.pack("<8s8sIQ", b"\xf1mcsRec\n", content[28:36], len(text), 0)
        start = lengths + struct.pack("<I", zlib.crc32(lengths)) + text
        record = start + hashlib.sha256(start).digest()[:16]
        rewrite(file, content[: ends[0]] + record + content[ends[0] :])
        state = read_journal(tmp_path)
        assert state is not None
        assert len(state.done) == 4
        assert state.damaged == (f"record at byte {ends[0]}",)


def test_a_journal_of_another_study_or_format_is_refused(tmp_path: Path) -> None:
    file, _ = filled(tmp_path)
    with pytest.raises(StoreError, match=r"another run \(seed, user differ\)"):
        Journal.resume(tmp_path, {**HEADER, "seed": 4, "user": 1})
    with pytest.raises(StoreError, match="holds a journal already"):
        Journal.create(tmp_path, HEADER)
    file.write_bytes(b"mcspectra journal 2\nsomething else")
    with pytest.raises(StoreError, match="journal format 2; this version reads 1"):
        Journal.resume(tmp_path, HEADER)
    with pytest.raises(StoreError, match="journal format 2"):
        read_journal(tmp_path)
    assert lock_holder(tmp_path) is None


def test_records_of_another_study_do_not_count(tmp_path: Path) -> None:
    file, ends = filled(tmp_path)
    with Journal.create(tmp_path / "other", {**HEADER, "seed": 4}) as journal:
        journal.append("e", b"other", None, {})
    other = (tmp_path / "other" / "journal" / "log").read_bytes()
    content = file.read_bytes()
    file.write_bytes(content + other[ends[0] :])
    with Journal.resume(tmp_path, HEADER) as journal:
        assert journal.damaged == ("e",)
        assert found(journal) == TASKS


def test_without_a_journal_resuming_begins_one_and_looking_finds_none(tmp_path: Path) -> None:
    assert read_journal(tmp_path) is None
    with Journal.resume(tmp_path, HEADER) as journal:
        assert list(journal.keys()) == []
        journal.append("a", b"x", None, {})
    state = read_journal(tmp_path)
    assert state is not None
    assert state.done == ("a",)


def test_forgotten_records_leave_the_file_when_they_are_most_of_it(tmp_path: Path) -> None:
    file = tmp_path / "journal" / "log"
    big = {f"t{i}": bytes([i]) * 300_000 for i in range(8)}
    with Journal.create(tmp_path, HEADER) as journal:
        for key, payload in big.items():
            journal.append(key, payload, None, {"i": key})
        journal.forget(["t0", "t1", "nothing"])
        assert file.stat().st_size > 2_400_000
        journal.forget(["t2", "t3", "t5"])
        assert file.stat().st_size < 1_000_000
        assert found(journal) == {k: big[k] for k in ("t4", "t6", "t7")}
        journal.append("t8", b"more", None, {})
        journal.append("t8", b"most", None, {})
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == {**{k: big[k] for k in ("t4", "t6", "t7")}, "t8": b"most"}
        assert journal.info("t6") == {"i": "t6"}
    assert [path.name for path in file.parent.iterdir()] == ["log"]


def test_a_compact_journal_holds_what_is_not_forgotten_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "journal" / "log"
    with Journal.create(tmp_path, HEADER) as journal:
        empty = file.stat().st_size
        for key in ("a", "b"):
            journal.append(key, b"result", None, {})
        journal.append("c", None, "It failed.", {})
        journal.forget(["a", "b"])
        assert file.stat().st_size > empty
        journal.compact()
        state = read_journal(tmp_path, HEADER, verify=True)
        assert state is not None
        assert (state.done, state.failures, state.damaged) == ((), {"c": "It failed."}, ())
        journal.forget(["c"])
        journal.compact()
        assert file.stat().st_size == empty
        journal.append("d", b"more", None, {})
    with Journal.resume(tmp_path, HEADER) as journal:
        assert found(journal) == {"d": b"more"}


def test_a_journal_of_another_study_is_replaced_only_if_that_is_asked_for(tmp_path: Path) -> None:
    with Journal.create(tmp_path, HEADER) as journal:
        journal.append("a", b"x", None, {})
    other = {**HEADER, "seed": 4}
    with pytest.raises(StoreError, match="belongs to another run"):
        Journal.resume(tmp_path, other)
    with Journal.resume(tmp_path, HEADER, renew=True) as journal:
        assert found(journal) == {"a": b"x"}
    with Journal.resume(tmp_path, other, renew=True) as journal:
        assert found(journal) == {}
        journal.append("b", b"y", None, {})
    with Journal.resume(tmp_path, other) as journal:
        assert found(journal) == {"b": b"y"}


@pytest.mark.parametrize(
    ("payload", "error"), [(None, None), (b"result", "sentence")], ids=["neither", "both"]
)
def test_a_record_is_a_result_or_an_error(
    tmp_path: Path, payload: bytes | None, error: str | None
) -> None:
    with (
        Journal.create(tmp_path, HEADER) as journal,
        pytest.raises(StoreError, match="needs a result or an error"),
    ):
        journal.append("a", payload, error, {})


def test_what_is_too_large_for_a_record_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_module, "MOST_PAYLOAD", 10)
    with Journal.create(tmp_path, HEADER) as journal:
        with pytest.raises(StoreError, match="has 11 bytes; a record holds 10"):
            journal.append("a", bytes(11), None, {})
        with pytest.raises(StoreError, match="noted with 'a' has"):
            journal.append("a", b"", None, {"text": "x" * 2**21})
        journal.append("b", None, "long \udcff " + "x" * 2**21, {})
        assert len(journal.failures()["b"]) == 10_000
        assert list(journal.keys()) == []


LIMITED = """
import resource, sys
from pathlib import Path
from mcspectra.core.errors import StorageError
from mcspectra.studies.journal import Journal

limit = int(sys.argv[2])
journal = Journal.resume(Path(sys.argv[1]), {"study": "0f"})
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
for i in range(100):
    if not journal.done(f"t{i}"):
        try:
            journal.append(f"t{i}", bytes([i]) * 5000, None, {})
        except StorageError as error:
            print(error)
            assert i == 0 or journal.payload(f"t{i - 1}") == bytes([i - 1]) * 5000
            journal.close()
            sys.exit(1)
journal.close()
"""


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(LIMITED))
    # Each time there is room for some more records, at last for all.
    for limit, least in [(3000, 0), (52_000, 9), (300_001, 50), (10**6, 100)]:
        ended = subprocess.run(
            [sys.executable, str(script), str(tmp_path), str(limit)],
            capture_output=True,
            text=True,
            check=False,
        )
        state = read_journal(tmp_path, verify=True)
        assert state is not None
        assert state.done[:least] == tuple(f"t{i}" for i in range(least))
        assert state.damaged == ()
        assert state.size <= limit
        assert ended.stderr == ""
        assert ended.returncode == (0 if least == 100 else 1)
        if least < 100:
            assert "cannot be written: File too large; what was finished is kept" in ended.stdout
            assert ended.stdout.count("\n") == 1


def test_a_journal_that_cannot_be_begun_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "journal").write_text("a file in the way")
    with pytest.raises(StorageError, match="cannot be written: "):
        Journal.resume(tmp_path, HEADER)
    assert lock_holder(tmp_path) is None


class Counted(io.BytesIO):
    """A file that counts what is read of it."""

    reads = 0
    bytes_read = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.reads, self.bytes_read = self.reads + 1, self.bytes_read + len(data)
        return data


def test_a_hundred_thousand_records_are_found_in_one_pass() -> None:
    count, study = 100_000, bytes(8)
    sha256 = hashlib.sha256(b"payload").hexdigest()
    content = b"".join(
        encode_record(study, Head(f"estimator/sampler/{i}", sha256), 7) + b"payload"
        for i in range(count)
    )
    for verify, reads in ((False, 2), (True, 3)):
        file = Counted(content)
        records = list(scan(file, 0, len(content), verify=verify))
        assert len(records) == count
        assert not any(isinstance(record, Damage) for record in records)
        assert file.reads == reads * count
        assert file.bytes_read == len(content) - (0 if verify else 7 * count)


def test_payloads_are_verified_without_being_held(tmp_path: Path) -> None:
    with Journal.create(tmp_path, HEADER) as journal:
        journal.append("a", bytes(2**25), None, {})
        journal.append("b", bytes(2**25), None, {})
    tracemalloc.start()
    with Journal.resume(tmp_path, HEADER) as journal:
        assert journal.done("b")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**23


def test_a_second_writer_is_refused_by_name(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path, HEADER)
    holder = lock_holder(tmp_path)
    assert holder is not None
    assert holder.pid == os.getpid()
    with pytest.raises(StoreError, match=f"written by process {os.getpid()} on host"):
        Journal.resume(tmp_path, HEADER)
    with pytest.raises(StoreError, match="written by process"):
        check_unlocked(tmp_path)
    journal.close()
    journal.close()
    check_unlocked(tmp_path)
    assert not (tmp_path / LOCK_NAME).exists()


def test_one_lock_can_cover_more_than_the_journal(tmp_path: Path) -> None:
    with FolderLock.take(tmp_path) as lock:
        with Journal.create(tmp_path, HEADER, lock=lock) as journal:
            journal.append("a", b"x", None, {})
        with Journal.resume(tmp_path, HEADER, lock=lock) as journal:
            assert list(journal.keys()) == ["a"]
        with pytest.raises(StoreError, match="being written"):
            FolderLock.take(tmp_path)
    FolderLock.take(tmp_path).release()


KILLED = """
import os, signal, sys
from mcspectra.studies.journal import Journal

journal = Journal.create(sys.argv[1], {"study": "0f", "seed": 3, "version": "1"})
journal.append("a", b"x" * 100, None, {})
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_lock_of_a_killed_process_is_taken_over_with_a_warning(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert (tmp_path / LOCK_NAME).exists()
    check_unlocked(tmp_path)
    with (
        pytest.warns(StaleLockWarning, match="left behind by process"),
        Journal.resume(tmp_path, HEADER) as journal,
    ):
        assert found(journal) == {"a": b"x" * 100}


def test_the_lock_of_another_machine_is_refused_and_one_after_a_reboot_taken_over(
    tmp_path: Path,
) -> None:
    mine = FolderLock.take(tmp_path)
    words = json.loads((tmp_path / LOCK_NAME).read_text())
    mine.release()
    (tmp_path / LOCK_NAME).write_text(json.dumps({**words, "host": "elsewhere", "boot": "1"}))
    with pytest.raises(StoreError, match="on host 'elsewhere' since .*remove run.lock"):
        FolderLock.take(tmp_path)
    with pytest.raises(StoreError, match="on host 'elsewhere'"):
        check_unlocked(tmp_path)
    for left in ({**words, "boot": "1"}, {**words, "host": "renamed"}):
        (tmp_path / LOCK_NAME).write_text(json.dumps(left))
        with pytest.warns(StaleLockWarning, match="taken over"):
            FolderLock.take(tmp_path).release()
    (tmp_path / LOCK_NAME).write_text("}{")
    with pytest.warns(StaleLockWarning, match="cannot be read"):
        FolderLock.take(tmp_path).release()
