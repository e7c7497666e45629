"""Chunks of any sizes and order merge in the tree of `MergeTree`; the largest work comes first."""

import dataclasses
import itertools
import random
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr

from mcspectra.core.analysis import Analysis, Need, Reduction, chunks, compute_chunk
from mcspectra.core.errors import StorageError
from mcspectra.core.records import pack, unpack
from mcspectra.studies import schedule as schedule_module
from mcspectra.studies.run import drive
from mcspectra.studies.schedule import PartialRun, Schedule, task_seconds
from mcspectra.studies.tasks import Outcome


@dataclass
class Word:
    """The tree itself, written with brackets, which shows any other order."""

    text: str

    def merge(self, right):
        return Word(f"({self.text} {right.text})")


def reduction(key, blocks, cost=1.0):
    return Reduction(
        kind=Word, block=lambda i: Word(f"{key}.{i}"), blocks=blocks, key=key, cost=cost
    )


class Words(Analysis, frozen=True, kw_only=True):
    """An analysis with one reduction per step, whose trees are the result."""

    blocks: tuple[int, ...] = (5,)
    relative_error: float | None = None
    fails: str = ""

    def reductions(self):
        return [reduction(f"r{step}", blocks) for step, blocks in enumerate(self.blocks)]

    def reduction(self, subject, stream):
        if self.fails == "first":
            raise ArithmeticError("before the first run")
        if self.fails == "leaves":
            raise SystemExit(3)
        words = []
        for each in self.reductions():
            (word,) = yield [each]
            words.append(word.text)
        if self.fails == "last":
            raise ZeroDivisionError("in the fit")
        return xr.Dataset({"words": ("run", words)})


def straight(words):
    return [compute_chunk(each, (0, each.blocks)).text for each in words.reductions()]


@dataclass(frozen=True)
class Cell:
    """The part of a plan's cell that the schedule uses."""

    path: str
    analysis: Analysis
    need: Need
    error: str | None = None
    subject: None = None

    def finished(self, result, seed):
        return result.assign_attrs(of=self.path, seed=seed)

    def compute(self, seed):
        raise AssertionError("nobody asked for it")


def cell(name, words=None, cost=1.0):
    return Cell(name, words or Words(), Need(cost=cost))


class Recorded:
    """A ledger in memory."""

    def __init__(self, states=()):
        self.states = dict(states)
        self.asked = []

    def tasks(self, path):
        return [(run, chunk) for of, run, chunk in self.states if of == path]

    def state(self, path, run, chunk):
        self.asked.append(path)
        return self.states[path, run, chunk]

    def record(self, path, run, chunk, payload, host):
        self.states[path, run, chunk] = payload


def outcome(work, seconds=1.0):
    task, compute = work
    return Outcome(task=task, payload=pack(compute()), seconds=seconds)


def trees(settled):
    return unpack(xr.Dataset, settled.payload)["words"].values.tolist()


def random_chunks(run, part, chance):
    """Return all chunks of a run in random sizes, shuffled."""
    found = []
    while (chunk := part.next_chunk(1 << chance.randrange(5))) is not None:
        found.append(chunk)
    chance.shuffle(found)
    assert sorted(itertools.chain(*(range(a, a + n) for a, n in found))) == list(range(run.blocks))
    return found


@pytest.mark.parametrize("blocks", [*range(1, 20), 31, 32, 33, 100])
def test_chunks_of_any_size_and_order_make_the_same_tree(blocks):
    run = reduction("r", blocks)
    chance = random.Random(blocks)
    for _ in range(20):
        part = PartialRun(run)
        for chunk in random_chunks(run, part, chance):
            assert not part.complete
            part.add(chunk, compute_chunk(run, chunk))
        assert part.complete
        assert part.total() == compute_chunk(run, (0, blocks))


@pytest.mark.parametrize("blocks", [1, 2, 7, 8, 11, 16, 37])
def test_recorded_chunks_of_other_sizes_are_used_and_only_the_rest_is_left(blocks):
    run = reduction("r", blocks)
    everything = sorted({c for size in (1, 2, 4, 8, 16) for c in chunks(blocks, size)})
    chance = random.Random(blocks)
    for _ in range(30):
        found = chance.sample(everything, chance.randrange(len(everything) + 1))
        damaged = {chunk for chunk in found if chance.random() < 0.2}

        def load(chunk, bad=damaged):
            return None if chunk in bad else compute_chunk(run, chunk)

        part = PartialRun(run)
        part.restore(found, load)
        missing = []
        while (chunk := part.next_chunk(1)) is not None:
            missing.append(chunk[0])
        have = {i for a, n in set(found) - damaged for i in range(a, a + n)}
        assert sorted(have | set(missing)) == list(range(blocks))
        assert not have & set(missing)
        part = PartialRun(run)
        part.restore(found, load)
        assert not list(part.fresh())
        while (chunk := part.next_chunk(1 << chance.randrange(4))) is not None:
            part.add(chunk, compute_chunk(run, chunk))
        assert part.total() == compute_chunk(run, (0, blocks))


@pytest.mark.parametrize("blocks", [1, 7, 16, 37])
def test_states_recorded_during_a_run_restore_all_of_it(blocks):
    """Record at random moments: merged chunks are recorded, and nothing is recorded twice."""
    run = reduction("r", blocks)
    chance = random.Random(blocks)
    for _ in range(30):
        part, recorded, done = PartialRun(run), {}, set()
        for chunk in random_chunks(run, part, chance)[: chance.randrange(blocks + 1)]:
            part.add(chunk, compute_chunk(run, chunk))
            done |= set(range(chunk[0], sum(chunk)))
            if chance.random() < 0.3:
                recorded |= dict(part.fresh())
                assert not list(part.fresh())
        recorded |= dict(part.fresh())
        assert all(word == compute_chunk(run, chunk) for chunk, word in recorded.items())
        again = PartialRun(run)
        again.restore(recorded, recorded.get)
        left = set()
        while (chunk := again.next_chunk(8)) is not None:
            left |= set(range(chunk[0], sum(chunk)))
        assert left == set(range(blocks)) - done


def test_chunks_that_are_not_nodes_of_the_tree_are_ignored():
    asked = []
    part = PartialRun(reduction("r", 10))
    part.restore([(0, 0), (1, 2), (0, 3), (8, 3), (-2, 2), (4, 5), (8, 2)], asked.append)
    assert asked == [(8, 2)]


def test_tasks_are_short_compared_with_the_time_limit():
    assert task_seconds(None) == task_seconds(100.0) == 1.0
    assert task_seconds(2.0) == 0.4


def test_sizes_follow_the_measured_pace():
    """Use the pace of the cell, otherwise of the analysis; compilation is soon forgotten."""
    words = Words(blocks=(10**6,), relative_error=0.1)
    schedule = Schedule([cell("a", words, 1.0), cell("b", words, 0.5)], 0, Recorded(), 1.0)
    first = schedule.next_work()
    assert first[0].chunk == (0, 1)
    schedule.take(outcome(first, 2.0**-3))
    assert schedule.next_work()[0].chunk[1] == 1  # (1, 8) would not be a node of the tree
    assert [schedule.next_work()[0].chunk for _ in range(3)] == [(2, 2), (4, 4), (8, 8)]
    slow = schedule.next_work()
    assert slow[0].chunk == (16, 8)
    schedule.take(outcome(slow, 8 * 100.0))
    for _ in range(12):
        work = schedule.next_work()
        schedule.take(Outcome(task=work[0], state=work[1](), seconds=2.0**-3 * work[0].chunk[1]))
    assert schedule.next_work()[0].chunk[1] >= 4


def test_cells_go_largest_first_and_reductions_step_by_step():
    words = Words(blocks=(3, 2))
    cells = [cell("a", words, 1.0), cell("b", words, 3.0), cell("c", words, 2.0)]
    schedule = Schedule(cells, 0, Recorded())
    works = [schedule.next_work() for _ in range(9)]
    assert [task.key for task, _ in works] == [f"{n}/r0/{i}+1" for n in "bca" for i in range(3)]
    assert schedule.next_work() is None
    assert schedule.under_way == 9
    for work in works[2::-1]:
        assert not list(schedule.settled())
        schedule.take(outcome(work, 2.0))
    second = [schedule.next_work(), schedule.next_work(), schedule.next_work()]
    assert [work and work[0].key for work in second] == ["b/r1/0+1", "b/r1/1+1", None]
    schedule.take(outcome(second[1]))
    schedule.take(outcome(second[0]))
    (settled,) = schedule.settled()
    assert trees(settled) == straight(words)
    assert unpack(xr.Dataset, settled.payload).attrs == {"of": "b", "seed": 0}


def test_pictured_cells_go_first_and_the_cheapest_of_them_before_all():
    class Pictured(Words, frozen=True, kw_only=True):
        pictured = True

    plain, shown = Words(blocks=(1,)), Pictured(blocks=(1,))
    cells = [
        cell("a", plain, 1.0), cell("b", shown, 8.0), cell("c", plain, 9.0), cell("d", shown, 2.0),
    ]  # fmt: skip
    schedule = Schedule(cells, 0, Recorded())
    works = [schedule.next_work() for _ in cells]
    assert [task.path for task, _ in works] == ["d", "b", "c", "a"]


def test_the_costliest_reduction_goes_first_and_states_in_their_order():
    class Both(Words, frozen=True, kw_only=True):
        def reduction(self, subject, stream):
            found = yield [reduction("small", 1, 1.0), reduction("large", 2, 9.0)]
            return xr.Dataset({"words": ("run", [word.text for word in found])})

    schedule = Schedule([cell("a", Both())], 0, Recorded())
    works = [schedule.next_work() for _ in range(3)]
    assert [task.key for task, _ in works] == ["a/large/0+1", "a/large/1+1", "a/small/0+1"]
    for work in works:
        schedule.take(outcome(work))
    (settled,) = schedule.settled()
    assert trees(settled) == ["small.0", "(large.0 large.1)"]


def test_a_failing_task_fails_its_cell_and_no_other():
    words = Words(blocks=(3,))
    schedule = Schedule([cell("a", words), cell("b", words)], 0, Recorded())
    works = [schedule.next_work() for _ in range(6)]
    schedule.take(Outcome(task=works[1][0], error="no"))
    (settled,) = schedule.settled()
    assert (settled.cell.path, settled.error, settled.payload) == ("a", "no", None)
    schedule.take(outcome(works[0]))
    schedule.take(Outcome(task=works[2][0], error="no"))
    assert list(schedule.settled()) == []
    for work in works[3:]:
        schedule.take(outcome(work))
    (settled,) = schedule.settled()
    assert trees(settled) == straight(words)
    assert schedule.under_way == 0


def test_an_error_outside_of_tasks_fails_its_cell():
    one = Words(blocks=(1,))
    words = {
        "a": Words(blocks=(1,), fails="last"),
        "b": Words(fails="first"),
        "d": Words(fails="leaves"),
        "c": one,
    }
    cells = [cell(name, each) for name, each in words.items()]
    schedule = Schedule(cells, 0, Recorded())
    first, last = schedule.next_work(), schedule.next_work()
    assert schedule.next_work() is None
    schedule.take(outcome(first))
    schedule.take(Outcome(task=last[0], payload=b"damaged on its way"))
    errors = {settled.cell.path: settled.error for settled in schedule.settled()}
    assert errors["a"] == "It raised ZeroDivisionError: in the fit."
    assert errors["b"] == "It raised ArithmeticError: before the first run."
    assert "cannot be read" in errors["c"]
    assert errors["d"] == "It raised SystemExit: 3."


def test_a_recording_error_ends_the_run_and_fails_no_cell(monkeypatch):
    class Full(Recorded):
        def record(self, *_):
            raise StorageError("The disk is full.")

    monkeypatch.setattr(schedule_module, "_RECORDED_AFTER", 0.0)
    schedule = Schedule([cell("a")], 0, Full())
    with pytest.raises(StorageError):
        schedule.take(outcome(schedule.next_work()))
    assert list(schedule.settled()) == []


def test_recorded_chunks_are_not_computed_again():
    words = Words(blocks=(4, 3))
    runs = words.reductions()
    known = [(runs[0], (0, 4)), (runs[1], (0, 2))]
    records = {("a", run.key, chunk): pack(compute_chunk(run, chunk)) for run, chunk in known}
    schedule = Schedule([cell("a", words)], 0, Recorded(records | {("a", "r9", (0, 1)): b""}))
    work = schedule.next_work()
    assert work[0].key == "a/r1/2+1"
    assert schedule.next_work() is None
    schedule.take(outcome(work))
    (settled,) = schedule.settled()
    assert trees(settled) == straight(words)


def test_states_are_recorded_once_in_a_second_of_work():
    """At the end of a run the rest is recorded; a finished cell leaves no states."""
    records = Recorded()
    schedule = Schedule([cell("a", Words(blocks=(16,)))], 0, records)
    works = [schedule.next_work() for _ in range(16)]
    for work in works[:9]:
        schedule.take(outcome(work, 0.3))
    assert [chunk for _, _, chunk in records.states] == [(0, 4), (0, 8)]
    schedule.record()
    assert [chunk for _, _, chunk in records.states] == [(0, 4), (0, 8), (8, 1)]
    for work in works[9:]:
        schedule.take(outcome(work, 5.0 if work is works[-1] else 0.01))
    assert len(records.states) == 3
    assert [trees(settled) for settled in schedule.settled()] == [straight(Words(blocks=(16,)))]


def test_cells_known_to_be_short_are_one_task():
    known = Words(blocks=(4, 2))
    adaptive = Words(blocks=(4, 2), relative_error=0.1)
    (first, _) = known.reductions()
    records = Recorded({("c", "r0", (0, 2)): pack(compute_chunk(first, (0, 2)))})
    cells = [cell("m", known, 9.0), cell("a", known, 3.0), cell("b", adaptive, 2.0)]
    schedule = Schedule([*cells, cell("c", known, 1.0)], 0, records, 1.0)
    works = [schedule.next_work() for _ in range(4)]
    for work in works:
        schedule.take(outcome(work, 0.05))
    schedule.take(outcome(schedule.next_work(), 0.05))  # The second step of m as one task
    works = [schedule.next_work() for _ in range(4)]
    assert [work and work[0].key for work in works] == ["a", "b/r0/0+4", "c/r0/2+2", None]
    list(schedule.settled())
    result = xr.Dataset({"x": ("n", [1.0, 2.0])}, attrs={"of": "a"})
    schedule.take(Outcome(task=works[0][0], payload=pack(result), seconds=1.0))
    (settled,) = schedule.settled()
    assert unpack(xr.Dataset, settled.payload).identical(result)


def test_a_damaged_result_of_a_whole_cell_fails_it():
    schedule = Schedule([cell("m", Words(blocks=(1,)), 9.0), cell("a")], 0, Recorded())
    schedule.take(outcome(schedule.next_work(), 0.1))
    work = schedule.next_work()
    assert work[0].run is None
    schedule.take(Outcome(task=work[0], payload=pack(np.zeros(3))[:-1]))
    assert [s.error is None for s in schedule.settled()] == [True, False]


def test_fully_recorded_cells_are_restored_one_at_a_time():
    """A resumed run may find thousands of them, mixed with cells that have tasks or fail."""
    words = Words(blocks=(4,))
    state = pack(compute_chunk(words.reductions()[0], (0, 4)))
    records = Recorded({(name, "r0", (0, 4)): state for name in "abd"})
    broken = dataclasses.replace(cell("e", words, 2.5), error="It cannot be planned.")
    cells = [cell(name, words, cost) for name, cost in zip("abcd", (4, 3, 2, 1), strict=True)]
    schedule = Schedule([broken, *cells], 0, records)
    held = []

    class Executor:
        workers = 8

        def submit(self, task, compute):
            held.append((task, compute))

        def outcomes(self):
            while held:
                yield outcome(held.pop(0))

    order = []
    for settled in drive(schedule, Executor()):
        order.append(settled.cell.path)
        if settled.payload is not None and settled.cell.path != "c":
            assert records.asked == [name for name in order if name in "abd"]
    assert order == ["a", "b", "e", "d", "c"]
