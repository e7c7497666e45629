"""The ledger keeps committed data after any interruption; damage never gives a wrong value."""

import contextlib
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import msgspec
import psutil
import pytest
from tests.processes import Fork

from mcspectra.core.errors import OtherVersionsWarning, StorageError, StoreError
from mcspectra.core.results import package_versions
from mcspectra.studies import ledger as ledger_module
from mcspectra.studies.ledger import FORMAT, LEDGER_NAME, Ledger, StudyNote, is_held, lock_damage

NOTE = StudyNote(
    title="t",
    seed=5,
    config='{"title":"t"}',
    study_hash="ab" * 32,
    versions=package_versions(),
    inputs={"data/a.npy": "0" * 64},
)
PATHS = tuple(f"{e}/{s}/{a}" for e in "abcd" for s in "xyz" for a in ("convergence", "terms"))
RUN = "0-0-10"


def payload(path, size=3000):
    """Return stand-in bytes for a cell's result."""
    return random.Random(path).randbytes(size)


def state_of(block):
    """Return stand-in bytes for a task's state."""
    return payload(str(block), 500)


def scalars(path):
    """Return stand-in numbers for a cell's scalars."""
    return {"rate": random.Random(path).random(), "none": float("inf")}


@pytest.fixture
def running(tmp_path):
    """A ledger with half of its cells finished, one failed cell, and recorded tasks."""
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        for path in PATHS[:12]:
            ledger.finish(path, payload(path), scalars(path))
        ledger.fail(PATHS[12], "It gave NaN.")
        for block in range(4):
            ledger.record(PATHS[13], RUN, (block, 1), payload(str(block), 500), "worker")
    return tmp_path


@pytest.fixture
def finished(tmp_path):
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        for path in PATHS:
            ledger.finish(path, payload(path), scalars(path))
    return tmp_path


def test_recorded_data_is_read_back(running):
    with Ledger.read(running) as ledger:
        assert ledger.study == msgspec.structs.replace(NOTE, config="")
        assert ledger.config == NOTE.config
        assert tuple(ledger.paths) == PATHS
        assert tuple(ledger.done) == PATHS[:12]
        assert ledger.failures() == {PATHS[12]: "It gave NaN."}
        assert ledger.tasks(PATHS[13]) == [(RUN, (block, 1)) for block in range(4)]
        assert ledger.tasks(PATHS[14]) == []
        assert ledger.recorded == 4
        assert ledger.state(PATHS[13], RUN, (2, 1)) == payload("2", 500)
        assert ledger.state(PATHS[13], RUN, (9, 1)) is None
        assert ledger.result(PATHS[3]) == payload(PATHS[3])
        assert ledger.scalars() == {path: scalars(path) for path in PATHS[:12]}
        assert ledger.verify().damaged == {}
        for path, words in {
            PATHS[12]: "no result of .*: It gave NaN",
            PATHS[13]: "not finished",
            "e/x/terms": "has no cell 'e/x/terms'",
        }.items():
            with pytest.raises(StoreError, match=words):
                ledger.result(path)
        assert "worker" in ledger.tally.hosts
        assert (ledger.tally.holder, ledger.tally.finished) == (None, None)


def test_the_writer_can_read_uncommitted_data(tmp_path):
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        ledger.record(PATHS[0], RUN, (0, 2), b"state")
        assert ledger.state(PATHS[0], RUN, (0, 2)) == b"state"
        ledger.finish(PATHS[0], b"result")
        assert ledger.result(PATHS[0]) == b"result"
        assert ledger.tasks(PATHS[0]) == []
        with pytest.raises(StoreError, match="is finished already"):
            ledger.finish(PATHS[0], b"other")


@pytest.mark.skipif(sys.platform != "linux", reason="bytes read are counted by Linux")
def test_a_cell_is_finished_without_reading_the_text_of_its_study(tmp_path):
    long = msgspec.structs.replace(NOTE, config="x" * 2**24)
    with Ledger.create(tmp_path, long, PATHS) as ledger:
        ledger.commit()
        before = psutil.Process().io_counters().read_chars
        for path in PATHS:
            ledger.finish(path, payload(path), scalars(path))
        ledger.commit()
        assert psutil.Process().io_counters().read_chars - before < 2**22


def test_a_resumed_ledger_continues(running):
    with Ledger.resume(running, NOTE, PATHS) as ledger:
        assert ledger.damaged == {}
        assert tuple(ledger.done) == PATHS[:12]
        assert len(ledger.tasks(PATHS[13])) == 4
        ledger.forget([PATHS[12]])
        for path in PATHS[12:]:
            ledger.finish(path, payload(path))
        assert ledger.failures() == {}
    with Ledger.read(running) as ledger:
        assert tuple(ledger.done) == PATHS
        assert ledger.recorded == 0
        assert ledger.tally.finished is not None
        assert all(ledger.result(path) == payload(path) for path in PATHS)
    with Ledger.resume(running / "new", NOTE, PATHS) as ledger:
        assert not ledger.done


def test_damaged_scalars_and_study_texts_are_detected(running):
    import sqlite3

    with contextlib.closing(sqlite3.connect(running / LEDGER_NAME)) as connection, connection:
        change = "UPDATE texts SET text = '{}' WHERE kind = ? AND name = ?"
        connection.executemany(change, [("scalars", PATHS[3]), ("config", "")])
    with Ledger.read(running) as ledger:
        with pytest.raises(StoreError, match=f"The scalars of {PATHS[3]} in .* are damaged"):
            ledger.scalars()
        with pytest.raises(StoreError, match=r"The study in .* is damaged: .*--resume keeps"):
            _ = ledger.config
        assert list(ledger.verify().damaged) == ["text of the study", PATHS[3]]
    with Ledger.resume(running, NOTE, PATHS) as ledger:
        assert ledger.config == NOTE.config
        assert PATHS[3] not in ledger.done


def test_the_last_sentence_and_state_are_kept_and_bounded(tmp_path):
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        for text in ("first", "\ud800" + "much " * 10**5):
            ledger.fail(PATHS[0], text)
            ledger.record(PATHS[1], RUN, (0, 1), text[:3].encode("utf-8", "replace"))
    with Ledger.read(tmp_path) as ledger:
        assert len(ledger.failures()[PATHS[0]]) == 10_000
        assert ledger.state(PATHS[1], RUN, (0, 1)) == b"?mu"


def test_commits_happen_automatically(tmp_path, monkeypatch):
    monkeypatch.setattr(ledger_module, "_COMMIT_SECONDS", 0.02)
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        ledger.finish(PATHS[0], b"first")
        end = time.monotonic() + 30
        while ledger.tally.done == 0:
            assert time.monotonic() < end
            time.sleep(0.01)
        with Ledger.read(tmp_path) as reader:
            assert reader.result(PATHS[0]) == b"first"


def test_large_amounts_of_data_are_committed_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(ledger_module, "_COMMIT_SECONDS", 1000.0)
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        ledger.finish(PATHS[0], bytes(2**25 + 1))
        assert ledger.tally.done == 1


def test_results_are_not_overwritten(running):
    with pytest.raises(StoreError, match="already holds results; give another --out, or --resume"):
        Ledger.create(running, NOTE, PATHS)
    Ledger.resume(running, NOTE, PATHS).close()  # The refused run has released the lock


def test_another_study_is_refused(running):
    other = msgspec.structs.replace(NOTE, study_hash="0" * 64)
    for note, paths in ((other, PATHS), (NOTE, PATHS[1:])):
        with pytest.raises(StoreError, match="belongs to another study or another version"):
            Ledger.resume(running, note, paths)


def test_another_version_is_refused_and_other_packages_give_a_warning(running):
    for name, refused in (("mcspectra", True), ("scipy", False)):
        other = msgspec.structs.replace(NOTE, versions=NOTE.versions | {f"version_{name}": "0.0.1"})
        context = pytest.raises(StoreError, match=r"this is 0\.0\.1, whose numbers may differ")
        if not refused:
            context = pytest.warns(OtherVersionsWarning, match=r"scipy .* \(now 0\.0\.1\)")
        with context:
            Ledger.resume(running, other, PATHS).close()


def test_changed_inputs_are_refused_or_their_cells_forgotten(running):
    other = msgspec.structs.replace(NOTE, inputs={"data/a.npy": "1" * 64})
    with pytest.raises(StoreError, match=r"another version of the file 'data/a.npy': .*--retry"):
        Ledger.resume(running, other, PATHS)
    outdated = {PATHS[0], PATHS[12], PATHS[13]}
    with Ledger.resume(running, other, PATHS, outdated=outdated) as ledger:
        assert tuple(ledger.done) == PATHS[1:12]
        assert (ledger.failures(), ledger.recorded, ledger.damaged) == ({}, 0, {})
        ledger.finish(PATHS[0], b"new")
    with Ledger.read(running) as ledger:
        assert ledger.study.inputs == other.inputs
        assert ledger.result(PATHS[0]) == b"new"
        assert ledger.result(PATHS[1]) == payload(PATHS[1])
        assert ledger.verify().damaged == {}


def test_a_second_writer_is_refused_and_the_first_is_named(running):
    with Ledger.resume(running, NOTE, PATHS) as first:
        assert is_held(running)
        with pytest.raises(StoreError, match=f"written by process {os.getpid()} on host"):
            Ledger.resume(running, NOTE, PATHS)
        first.finish(PATHS[20], b"goes on")
    assert not is_held(running)
    Ledger.resume(running, NOTE, PATHS).close()


def test_a_noted_holder_is_not_a_lock(running):
    def begin():
        ledger = Ledger.resume(running, NOTE, PATHS)
        os.kill(os.getpid(), signal.SIGKILL)
        return ledger

    assert Fork(begin).wait() == -signal.SIGKILL
    assert not is_held(running)
    with Ledger.read(running) as ledger:
        assert ledger.tally.holder is not None
        assert ledger.tally.holder.pid != os.getpid()
    with Ledger.resume(running, NOTE, PATHS) as ledger:
        assert ledger.tally.holder is not None
        assert ledger.tally.holder.pid == os.getpid()


def test_readers_see_whole_commits_while_it_is_written(tmp_path):
    over = threading.Event()
    seen: list[int] = []

    def look():
        while not over.is_set():
            with Ledger.read(tmp_path) as reader:
                assert not reader.damaged
                done = tuple(reader.done)
                assert reader.damaged == {}
                assert len(done) % 4 == 0
                seen.append(len(done))
                for path in done[-1:]:
                    assert reader.result(path) == payload(path)
                assert reader.verify().damaged == {}

    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        thread = threading.Thread(target=look)
        thread.start()
        for first in range(0, len(PATHS), 4):
            with ledger._guard:
                for path in PATHS[first : first + 4]:
                    ledger.record(path, RUN, (0, 1), b"state")
                ledger.commit()
                for path in PATHS[first : first + 4]:
                    ledger.finish(path, payload(path))
                ledger.commit()
            time.sleep(0.02)
            while first % 8 == 0 and thread.is_alive() and (not seen or seen[-1] <= first):
                time.sleep(0.001)  # On a loaded machine the reader may be late
        over.set()
        thread.join()
    assert seen == sorted(seen)
    assert len(set(seen)) > 2


def test_a_commit_during_verification_is_not_damage(tmp_path, monkeypatch):
    committed = []
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger, Ledger.read(tmp_path) as reader:
        rows = reader._rows

        def finish():
            ledger.finish(PATHS[0], payload(PATHS[0]))
            ledger.commit()

        def between(statement, values=()):
            if "FROM results" in statement and not committed:
                committed.append(threading.Thread(target=finish))
                committed[0].start()
                committed[0].join(0.3)  # It continues when the reader has finished this cell
            return rows(statement, values)

        monkeypatch.setattr(reader, "_rows", between)
        assert reader.verify().damaged == {}
        committed[0].join()
        assert reader.verify().done == PATHS[:1]


def fill_until_killed(out, seed):
    """Fill a ledger, and kill this process at a random moment; for forks only."""
    moment = random.Random(str(seed)).random() * 0.06

    def kill():
        time.sleep(moment)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=kill, daemon=True).start()
    with Ledger.resume(out, NOTE, PATHS) as ledger:
        for path in PATHS:
            if path in ledger.done:
                assert not ledger.tasks(path)
                continue
            for block in range(5):
                state = payload(f"{path}{block}", 20_000)
                if (RUN, (block, 1)) in ledger.tasks(path):
                    assert ledger.state(path, RUN, (block, 1)) == state
                else:
                    ledger.record(path, RUN, (block, 1), state)
                time.sleep(0.0003)
            ledger.finish(path, payload(path))
    return 0


def sound_results(out):
    """Return the number of finished cells of a ledger, which must be sound."""
    with Ledger.read(out) as ledger:
        assert ledger.verify().damaged == {}
        assert all(ledger.result(path) == payload(path) for path in ledger.done)
        return len(ledger.done)


@pytest.mark.parametrize("kills", [6, pytest.param(150, marks=pytest.mark.endurance)])
def test_a_ledger_killed_at_any_moment_is_sound(tmp_path, monkeypatch, kills):
    """Each killed run leaves a sound ledger, and together they finish all cells."""
    monkeypatch.setattr(ledger_module, "_COMMIT_SECONDS", 0.001)
    out, said, killed, done = tmp_path / "out", tmp_path / "said", 0, 0
    while killed < kills:
        ended = Fork(fill_until_killed, out, killed, said=said).wait()
        assert ended in (0, -signal.SIGKILL), said.read_text()
        killed += ended != 0
        if (out / LEDGER_NAME).exists():
            before, done = done, sound_results(out)
            assert done >= before
        if done == len(PATHS):
            shutil.rmtree(out)
            done = 0
    assert said.read_text() == ""


def mutated(file, chosen):
    """Change, zero or cut off random bytes."""
    content = bytearray(file.read_bytes())
    at = chosen.randrange(len(content))
    kind = chosen.choice(("flip", "flip", "flip", "zero", "cut", "page"))
    if kind == "flip":
        content[at] ^= 1 << chosen.randrange(8)
    elif kind == "zero":
        length = chosen.choice((1, 8, 512, 8192))
        content[at : at + length] = bytes(len(content[at : at + length]))
    elif kind == "cut":
        del content[at:]
    else:
        first, second = (8192 * chosen.randrange(len(content) // 8192) for _ in range(2))
        content[first : first + 8192] = content[second : second + 8192]
    file.write_bytes(content)
    return kind


def check_mutation(folder, note=NOTE, paths=PATHS, payload=payload, scalars=scalars):
    """Check that each value of a damaged ledger is right or reported, and that both verbs agree."""
    noticed = False
    try:
        with Ledger.read(folder) as ledger:
            done = list(ledger.done)
            noticed = bool(ledger.damaged)
            for path in done:
                try:
                    assert ledger.result(path) == payload(path)
                except StoreError:
                    noticed = True
            with contextlib.suppress(StoreError):
                for path, found in ledger.scalars().items():
                    assert found == scalars(path)
            for path in paths:
                for run, chunk in ledger.tasks(path):
                    state = ledger.state(path, run, chunk)
                    assert state in (None, state_of(chunk[0]))
            ledger.failures()
            states = [ledger.state(paths[13], RUN, (block, 1)) for block in range(4)]
            whole = len(done) == len(paths) or (
                len(done) == 12 and None not in states and len(ledger.failures()) == 1
            )
            noticed = noticed or not whole
    except StoreError:
        noticed = True
    try:
        with Ledger.read(folder, salvage=True) as ledger:
            said = ledger.verify(paths)
    except StoreError:
        said = None
    assert said is None or said.damaged or not noticed
    try:
        with Ledger.resume(folder, note, paths) as ledger:
            assert said is not None
            assert tuple(ledger.done) == said.done
            assert ledger.failures() == said.failed
            assert ledger.recorded == said.recorded
            assert ledger.damaged == said.damaged
            lost = len(ledger.done) not in (12, len(paths)) or (
                len(ledger.done) == 12 and (ledger.recorded, len(ledger.failures())) != (4, 1)
            )
            assert ledger.damaged or not lost
            for path in paths:
                if path in ledger.done:
                    assert ledger.result(path) == payload(path)
                else:
                    ledger.finish(path, payload(path), scalars(path))
        with Ledger.read(folder) as ledger:
            assert ledger.verify().damaged == {}
            assert tuple(ledger.done) == paths
            assert ledger.scalars() == {path: scalars(path) for path in paths}
            assert all(ledger.result(path) == payload(path) for path in paths)
    except StoreError:
        assert said is None
        return "refused"
    return "noticed" if said.damaged else "without effect"


@pytest.mark.parametrize(
    ("number", "seed"), [(20, 1), pytest.param(500, 2, marks=pytest.mark.endurance)]
)
@pytest.mark.parametrize("kind", ["running", "finished"])
def test_no_damage_gives_a_wrong_value(request, tmp_path, kind, number, seed):
    folder, work, chosen = request.getfixturevalue(kind), tmp_path / "work", random.Random(seed)
    found = {"refused": 0, "noticed": 0, "without effect": 0}
    for _ in range(number):
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        shutil.copy(folder / LEDGER_NAME, work)
        change = mutated(work / LEDGER_NAME, chosen)
        came = check_mutation(work)
        assert came != "refused" or change == "cut"  # This cuts off both copies of the notes
        found[came] += 1
    print(kind, found)
    assert found["noticed"] > 5


def fill_up_to(out, limit):
    """Fill a ledger whose file may have at most `limit` bytes; for forks only."""
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        with Ledger.resume(out, NOTE, PATHS) as ledger:
            for path in PATHS:
                if path not in ledger.done:
                    ledger.finish(path, payload(path))
                    time.sleep(0.005)
    except StorageError as error:
        print(error, file=sys.stderr)
        return 3
    return 0


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(ledger_module, "_COMMIT_SECONDS", 0.001)
    limits = (10_000, 100_000, 120_000, 10**6)
    out, errors, found, done = tmp_path / "out", tmp_path / "errors", [], 0
    for limit in limits:
        ended = Fork(fill_up_to, out, limit, said=errors).wait()
        assert not (out / f".{LEDGER_NAME}.partial").exists()
        begun = (out / LEDGER_NAME).exists()
        if begun:
            before, done = done, sound_results(out)
            assert done >= before
        found.append((ended, begun, done))
    said = errors.read_text().splitlines()
    assert [code for code, _, _ in found] == [3, 3, 3, 0]
    assert len(said) == 3
    for limit, sentence, (_, begun, done) in zip(limits, [*said, ""], found, strict=True):
        assert ("cannot be written" in sentence) == (limit < 10**6)
        assert begun or limit == 10_000
        assert ("nothing is finished yet" in sentence) == (not begun)
        assert ("finished work is stored" in sentence) == (begun and limit < 10**6)
        assert limit < 100_000 or done > 0
    assert found[-1][2] == len(PATHS)


def test_an_error_of_a_background_commit_ends_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(ledger_module, "_COMMIT_SECONDS", 0.01)

    def finish_all(ledger):
        monkeypatch.setattr(ledger_module, "_PUT_TEXT", "INSERT INTO none VALUES (?, ?, ?, ?)")
        for path in PATHS:
            ledger.finish(path, payload(path))
            time.sleep(0.02)

    with (
        pytest.raises(
            StorageError, match=r"cannot be written: no such table.*is stored, and --resume"
        ),
        Ledger.create(tmp_path, NOTE, PATHS) as ledger,
    ):
        finish_all(ledger)
    monkeypatch.undo()
    assert not is_held(tmp_path)
    Ledger.resume(tmp_path, NOTE, PATHS).close()


def test_an_interrupted_commit_is_repeated(tmp_path, monkeypatch):
    """Ctrl-C during a write rolls the commit back; closing the ledger writes it."""
    monkeypatch.setattr(ledger_module, "_COMMIT_SECONDS", 1000.0)
    write = Ledger._write

    def interrupted(self, steps, tally):
        def steps_then_signal():
            yield from steps
            raise KeyboardInterrupt

        monkeypatch.setattr(Ledger, "_write", write)
        write(self, steps_then_signal(), tally)

    def run():
        with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
            ledger.finish(PATHS[0], payload(PATHS[0]))
            monkeypatch.setattr(Ledger, "_write", interrupted)
            ledger.commit()

    with pytest.raises(KeyboardInterrupt):
        run()
    with Ledger.read(tmp_path) as ledger:
        assert tuple(ledger.done) == PATHS[:1]
        assert ledger.verify().damaged == {}
        assert ledger.tally.holder is None


def test_unwritable_folders_give_a_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be written: Not a directory; give another") as met:
        Ledger.create(tmp_path / "file" / "out", NOTE, PATHS)
    assert not isinstance(met.value, StorageError)
    with pytest.raises(StoreError, match="There are no results in"):
        Ledger.read(tmp_path)


def create_without_rights(*folders):
    """Try to create ledgers as a user without root's rights; for forks only."""
    if os.getuid() == 0:
        os.setuid(65534)
    for folder in folders:
        try:
            Ledger.create(Path(folder), NOTE, PATHS)
        except StoreError as error:
            print(error, file=sys.stderr)
    return 0


def test_folders_without_permission_give_a_sentence(tmp_path):
    """Uses a user without root's rights, who has no access to pytest's folders."""
    said = tmp_path / "said"
    with tempfile.TemporaryDirectory() as name:
        for part, mode in (("", 0o755), ("closed", 0o000), ("read-only", 0o555)):
            Path(name, part).mkdir(exist_ok=True)
            Path(name, part).chmod(mode)
        folders = f"{name}/read-only", f"{name}/closed"
        assert Fork(create_without_rights, *folders, said=said).wait() == 0
        Path(name, "closed").chmod(0o700)
    assert "read-only' cannot be written: it cannot be opened" in said.read_text()
    assert "closed' cannot be written: Permission denied" in said.read_text()


def test_a_finished_ledger_is_read_without_the_right_to_write(finished, tmp_path):
    (finished / LEDGER_NAME).chmod(0o444)
    with Ledger.read(finished) as ledger:
        assert ledger.result(PATHS[0]) == payload(PATHS[0])


@pytest.mark.parametrize(
    "link",
    [
        *(f"{LEDGER_NAME}{end}" for end in ("", "-journal", "-wal", "-shm")),
        "study.lock",
        "study.lock-journal",
    ],
)
def test_a_ledger_or_a_lock_that_is_a_link_is_refused(running, tmp_path_factory, link):
    secret = tmp_path_factory.mktemp("secret")
    (secret / "key").write_text("mine")
    place = running / link
    place.unlink(missing_ok=True)
    place.symlink_to(secret / "key")
    with pytest.raises(StoreError, match=rf"{link}' is a symbolic link"):
        Ledger.resume(running, NOTE, PATHS)
    if link.startswith("study.sqlite"):
        with pytest.raises(StoreError, match=rf"{link}' is a symbolic link"):
            Ledger.read(running)
    assert {file.name: file.read_text() for file in secret.iterdir()} == {"key": "mine"}


def test_a_link_at_the_temporary_file_is_not_followed(running, tmp_path_factory):
    (tmp_path_factory.mktemp("secret") / "key").write_text("mine")
    key = tmp_path_factory.mktemp("other") / "key"
    key.write_text("mine")
    (running / f".{LEDGER_NAME}.partial").symlink_to(key)
    with Ledger.resume(running, NOTE, PATHS, outdated={PATHS[0]}) as ledger:
        assert len(ledger.done) == 11
    assert key.read_text() == "mine"


def test_a_forged_journal_deletes_no_file(running, tmp_path_factory):
    """SQLite deletes the file that a journal names as part of a transaction over several files."""
    key = tmp_path_factory.mktemp("secret") / "key"
    key.write_bytes(b"mine\0")
    name, magic = str(key).encode(), bytes.fromhex("d9d505f920a163d7")
    pages = (running / LEDGER_NAME).stat().st_size // 8192
    head = magic + b"".join(n.to_bytes(4, "big") for n in (0, 1, pages, 512, 8192))
    sums = b"".join(n.to_bytes(4, "big") for n in (len(name), sum(name)))
    lock_page = (2**30 // 8192 + 1).to_bytes(4, "big")
    journal = running / f"{LEDGER_NAME}-journal"
    journal.write_bytes(head.ljust(512, b"\0") + lock_page + name + sums + magic)
    for look in (Ledger.read, lambda folder: Ledger.resume(folder, NOTE, PATHS)):
        with pytest.raises(
            StoreError, match="-journal' names another file, which a run never writes"
        ):
            look(running)
    assert key.read_bytes() == b"mine\0"


def test_a_ledger_with_another_kind_of_journal_is_not_opened_by_sqlite(running):
    """SQLite would write two other files; the rows are read without it."""
    content = bytearray((running / LEDGER_NAME).read_bytes())
    content[18:20] = b"\2\2"
    (running / LEDGER_NAME).write_bytes(content)
    with Ledger.read(running, salvage=True) as ledger:
        found = ledger.verify(PATHS)
    assert found.done == PATHS[:12]
    assert {file.name for file in running.iterdir()} == {LEDGER_NAME, "study.lock"}
    with Ledger.resume(running, NOTE, PATHS) as ledger:
        assert tuple(ledger.done) == PATHS[:12]


def zeroed(file, page):
    content = bytearray(file.read_bytes())
    content[8192 * page : 8192 * (page + 1)] = bytes(8192)
    file.write_bytes(content)


@pytest.mark.parametrize("kind", ["running", "finished"])
def test_both_verbs_keep_results_outside_a_zeroed_page(request, tmp_path, kind):
    """All results outside of the zeroed page are kept; see tests/studies/trials.py."""
    folder, work = request.getfixturevalue(kind), tmp_path / "work"
    content = (folder / LEDGER_NAME).read_bytes()
    work.mkdir()
    for page in range(len(content) // 8192):
        (work / LEDGER_NAME).write_bytes(content)
        zeroed(work / LEDGER_NAME, page)
        with Ledger.read(work, salvage=True) as ledger:
            found = ledger.verify(PATHS)
        on_page = content[8192 * page : 8192 * (page + 1)]
        for path in PATHS[: 12 if kind == "running" else None]:
            # Stand-in bytes contain no scalars
            pieces = (payload(path)[:16], payload(path)[-16:], f"scalars{path}".encode())
            assert path in found.done or any(each in on_page for each in pieces), (page, path)
        assert found.damaged
        assert check_mutation(work) == "noticed"


@pytest.mark.parametrize("kind", ["text", "folder", "database"])
def test_an_invalid_lock_file_gives_a_sentence(running, kind):
    lock = running / "study.lock"
    assert lock_damage(running) is None
    lock.unlink()
    if kind == "text":
        lock.write_text("junk")
    elif kind == "folder":
        lock.mkdir()
    else:
        shutil.copy(running / LEDGER_NAME, lock)
    assert "not the empty file that a run locks; remove it" in lock_damage(running)
    with pytest.raises(
        StoreError, match=r"study.lock' (cannot be locked: .*|is not a file); remove"
    ):
        Ledger.resume(running, NOTE, PATHS)
    assert not is_held(running)
    shutil.rmtree(lock) if kind == "folder" else lock.unlink()
    (running / "study.lock-journal").write_text("junk")  # SQLite drops the journal of an empty file
    Ledger.resume(running, NOTE, PATHS).close()


def test_links_made_by_the_user_are_allowed(running, tmp_path):
    """Links to the output folder itself and to other files in it are allowed."""
    (tmp_path / "scratch").symlink_to(running)
    (running / "notes").symlink_to(tmp_path)
    with Ledger.resume(tmp_path / "scratch", NOTE, PATHS) as ledger:
        assert PATHS[0] in ledger.done


def test_other_files_are_not_ledgers(tmp_path):
    import sqlite3

    for content in (b"text", b"", bytes(8192 * 3), random.Random(1).randbytes(8192 * 3)):
        (tmp_path / LEDGER_NAME).write_bytes(content)
        with pytest.raises(StoreError, match="or it is not a ledger; give another folder"):
            Ledger.read(tmp_path)
        with pytest.raises(StoreError, match="or it is not a ledger; give another folder"):
            Ledger.resume(tmp_path, NOTE, PATHS)
    (tmp_path / LEDGER_NAME).unlink()
    with sqlite3.connect(tmp_path / LEDGER_NAME) as connection:
        connection.execute("CREATE VIEW cells AS SELECT 1 AS place, zeroblob(10) AS path")
        connection.execute(f"PRAGMA user_version = {FORMAT}")
    connection.close()
    with pytest.raises(StoreError, match="or it is not a ledger; give another folder"):
        Ledger.read(tmp_path)
    connection = sqlite3.connect(tmp_path / LEDGER_NAME)
    connection.execute("PRAGMA user_version = 3")
    connection.close()
    with pytest.raises(
        StoreError, match=f"has store format 3, but this version reads {FORMAT}: export it"
    ):
        Ledger.read(tmp_path)
