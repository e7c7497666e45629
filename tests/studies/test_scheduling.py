"""Chunks in any sizes and order merge in the tree of `MergeTree`; what is next is what is largest."""

import dataclasses
import itertools
import random

import numpy as np
import pytest
import xarray as xr

from mcspectra.core.staged import MergeTree, Run, Whole, chunks
from mcspectra.studies.engines import Outcome
from mcspectra.studies.plan import Cell
from mcspectra.studies.run import drive
from mcspectra.studies.scheduling import Pace, PartialRun, Schedule
from mcspectra.studies.files import ConvergenceConfig
from mcspectra.studies.tasks import pack_payload


class Words:
    """States are the trees themselves, written with brackets: any other order shows."""

    def __init__(self, blocks=(5,)):
        self.runs = [
            Run(part=i, first=0, realizations=b, blocks=b, cost=1.0) for i, b in enumerate(blocks)
        ]

    def stages(self):
        states = []
        for run in self.runs:
            states += yield [run]
        return states

    def block(self, run, index):
        return f"{run.part}.{index}"

    def merge(self, left, right):
        return f"({left} {right})"

    def pack(self, state):
        return {"state": np.frombuffer(state.encode(), np.uint8)}

    def unpack(self, arrays):
        return arrays["state"].tobytes().decode()

    def chunk(self, run, chunk):
        tree = MergeTree(self.merge)
        for index in range(chunk[0], sum(chunk)):
            tree.add(self.block(run, index))
        return tree.total()


def _straight(words, run):
    return words.chunk(run, (0, run.blocks))


def _random_chunks(run, part, chance):
    """All chunks of a run in sizes drawn at random, shuffled."""
    found = []
    while (chunk := part.next_chunk(1 << chance.randrange(5))) is not None:
        found.append(chunk)
    chance.shuffle(found)
    assert sorted(itertools.chain(*(range(a, a + n) for a, n in found))) == list(range(run.blocks))
    return found


@pytest.mark.parametrize("blocks", [*range(1, 20), 31, 32, 33, 100])
def test_chunks_of_any_size_and_order_make_the_same_tree(blocks):
    words = Words((blocks,))
    (run,) = words.runs
    chance = random.Random(blocks)
    for _ in range(20):
        part = PartialRun(words, run)
        for chunk in _random_chunks(run, part, chance):
            assert not part.complete
            part.add(chunk, words.chunk(run, chunk))
        assert part.complete
        assert part.total() == _straight(words, run)


@pytest.mark.parametrize("blocks", [1, 2, 7, 8, 11, 16, 37])
def test_recorded_chunks_of_other_sizes_are_used_and_only_the_rest_is_left(blocks):
    words = Words((blocks,))
    (run,) = words.runs
    everything = sorted({c for size in (1, 2, 4, 8, 16) for c in chunks(blocks, size)})
    chance = random.Random(blocks)
    for _ in range(30):
        found = chance.sample(everything, chance.randrange(len(everything) + 1))
        damaged = {chunk for chunk in found if chance.random() < 0.2}
        part = PartialRun(words, run)
        part.restore(found, lambda c, bad=damaged: None if c in bad else words.chunk(run, c))
        missing = [] if part.complete else _random_chunks_left(part)
        have = {i for a, n in set(found) - damaged for i in range(a, a + n)}
        assert sorted(have | set(missing)) == list(range(blocks))
        assert not have & set(missing)
        part = PartialRun(words, run)
        part.restore(found, lambda c, bad=damaged: None if c in bad else words.chunk(run, c))
        while (chunk := part.next_chunk(1 << chance.randrange(4))) is not None:
            part.add(chunk, words.chunk(run, chunk))
        assert part.total() == _straight(words, run)


def _random_chunks_left(part):
    found = []
    while (chunk := part.next_chunk(1)) is not None:
        found.append(chunk[0])
    return found


def test_chunks_that_are_not_nodes_of_the_tree_are_left_out():
    words = Words((10,))
    (run,) = words.runs
    asked = []
    part = PartialRun(words, run)
    part.restore([(0, 0), (1, 2), (0, 3), (8, 3), (-2, 2), (4, 5), (8, 2)], asked.append)
    assert asked == [(8, 2)]


def test_sizes_follow_the_measured_pace():
    pace = Pace(1.0)
    assert pace.blocks(("cell", "kind"), 1.0) == 1
    pace.learn(("cell", "kind"), 10.0, 1.0)
    assert pace.blocks(("cell", "kind"), 1.0) == 8
    assert pace.blocks(("other", "kind"), 10.0) == 1
    assert pace.blocks(("other", "kind"), 0.001) == 2**13
    pace.learn(("cell",), 10.0, 1000.0)
    pace.learn(("cell",), 10.0, 1000.0)
    assert pace.blocks(("cell", "kind"), 1.0) == 1
    pace.forget("cell")
    assert pace.blocks(("cell", "kind"), 1.0) == 8
    pace.learn(("none",), 0.0, 1.0)
    pace.learn(("instant",), 1.0, 0.0)
    assert pace.blocks(("instant",), 1.0) == 2**30
    assert pace.blocks(("none",), 1.0) == 1


def _cell(name, cost=1.0):
    return Cell(
        path=f"{name}/s/kind",
        analysis="kind",
        estimator_name=name,
        sampler_spec="s",
        estimator=None,
        sampler=None,
        settings=None,
        cost=cost,
    )


class Source:
    """Analyses by the names of cells; chunks recorded by their keys."""

    def __init__(self, analyses, recorded=None):
        self.analyses = analyses
        self.recorded = recorded or {}

    def analysis(self, cell):
        return self.analyses[cell.estimator_name]

    def load(self, key):
        return self.recorded.get(key)


def _outcome(words, task, seconds=1.0):
    state = words.chunk(task.run, task.chunk)
    return Outcome(key=task.key, payload=pack_payload(words.pack(state)), seconds=seconds)


def test_cells_go_largest_first_and_runs_stage_by_stage():
    words = {name: Words((3, 2)) for name in "abc"}
    cells = [_cell("a", 1.0), _cell("b", 3.0), _cell("c", 2.0)]
    schedule = Schedule(cells, Source(words), {}, Pace())
    tasks = [schedule.next_task() for _ in range(9)]
    assert [task.key for task in tasks] == [
        f"{n}/s/kind/0-0-3/{i}+1" for n in "bca" for i in range(3)
    ]
    assert schedule.next_task() is None
    assert schedule.under_way == 9
    for task in tasks[2::-1]:
        assert not list(schedule.settled())
        schedule.take(_outcome(words["b"], task))
    second = [schedule.next_task(), schedule.next_task(), schedule.next_task()]
    assert [task and task.key for task in second] == [
        "b/s/kind/1-0-2/0+1",
        "b/s/kind/1-0-2/1+1",
        None,
    ]
    assert schedule.take(_outcome(words["b"], second[1])) is second[1]
    assert schedule.take(_outcome(words["b"], second[0])) is None
    (settled,) = schedule.settled()
    assert settled.result == [_straight(words["b"], run) for run in words["b"].runs]


def test_a_failing_task_fails_its_cell_and_no_other():
    words = {name: Words((3,)) for name in "ab"}
    schedule = Schedule([_cell("a"), _cell("b")], Source(words), {}, Pace())
    tasks = [schedule.next_task() for _ in range(6)]
    assert schedule.take(Outcome(key=tasks[1].key, error="no")) is None
    (settled,) = schedule.settled()
    assert (settled.cell.estimator_name, settled.error, settled.result) == ("a", "no", None)
    assert schedule.take(_outcome(words["a"], tasks[0])) is None
    assert schedule.take(Outcome(key=tasks[2].key, error="no")) is None
    assert list(schedule.settled()) == []
    for task in tasks[3:]:
        schedule.take(_outcome(words["b"], task))
    (settled,) = schedule.settled()
    assert settled.result == [_straight(words["b"], words["b"].runs[0])]
    assert schedule.under_way == 0


def test_what_fails_outside_of_tasks_fails_its_cell_too():
    class Broken(Words):
        def stages(self):
            yield [self.runs[0]]
            raise ZeroDivisionError("in the fit")

    class Stillborn(Words):
        def stages(self):
            raise ArithmeticError("before the first run")
            yield []

    class Leaving(Words):
        def stages(self):
            raise SystemExit(3)
            yield []

    words = {"a": Broken((1,)), "b": Stillborn(), "d": Leaving(), "c": Words((1,))}
    schedule = Schedule([_cell(name) for name in "abdc"], Source(words), {}, Pace())
    first, last = schedule.next_task(), schedule.next_task()
    assert schedule.next_task() is None
    schedule.take(_outcome(words["a"], first))
    schedule.take(Outcome(key=last.key, payload=b"damaged on its way"))
    errors = {settled.cell.estimator_name: settled.error for settled in schedule.settled()}
    assert errors["a"] == "It raised ZeroDivisionError: in the fit."
    assert errors["b"] == "It raised ArithmeticError: before the first run."
    assert "cannot be read" in errors["c"]
    assert errors["d"] == "It raised SystemExit: 3."


def test_what_is_recorded_is_not_computed_again():
    words = Words((4, 3))
    known = [(words.runs[0], (0, 4)), (words.runs[1], (0, 2))]
    source = Source(
        {"a": words},
        {f"a/s/kind/{run.key}/{c[0]}+{c[1]}": words.pack(words.chunk(run, c)) for run, c in known},
    )
    found = {"a/s/kind": [(run.key, chunk) for run, chunk in known] + [("9-9-9", (0, 1))]}
    schedule = Schedule([_cell("a")], source, found, Pace())
    task = schedule.next_task()
    assert task.key == "a/s/kind/1-0-3/2+1"
    assert schedule.next_task() is None
    schedule.take(_outcome(words, task))
    (settled,) = schedule.settled()
    assert settled.result == [_straight(words, run) for run in words.runs]


def test_cells_known_to_be_short_are_one_task():
    words = {name: Words((4, 2)) for name in "abc"}
    source = Source(words, {"c/s/kind/0-0-4/0+2": words["c"].pack("known")})
    pace = Pace(1.0)
    pace.learn(("kind",), 1.0, 0.5)
    adaptive = ConvergenceConfig(counts=(1,), relative_error=0.1)
    cells = [
        _cell("a", 3.0),
        dataclasses.replace(_cell("b", 2.0), settings=adaptive),
        _cell("c", 1.0),
    ]
    schedule = Schedule(cells, source, {"c/s/kind": [("0-0-4", (0, 2))]}, pace)
    keys = [schedule.next_task() for _ in range(4)]
    assert [task and task.key for task in keys] == [
        "a/s/kind/-1-0-1/0+1",
        "b/s/kind/0-0-4/0+4",
        "c/s/kind/0-0-4/2+2",
        None,
    ]
    result = xr.Dataset({"x": ("n", [1.0, 2.0])}, attrs={"of": "a"})
    whole = pack_payload(Whole(lambda: None).pack(result))
    assert schedule.take(Outcome(key=keys[0].key, payload=whole, seconds=1.0)) is None
    (settled,) = schedule.settled()
    assert settled.result.identical(result)


def test_cells_like_short_ones_are_not_even_built():
    """Once a whole cell has been measured, its cost says enough of others."""
    words = {"a": Words((1,))}
    schedule = Schedule([_cell("a", 2.0), _cell("b", 1.0)], Source(words), {}, Pace(1.0))
    first = schedule.next_task()
    schedule.take(_outcome(words["a"], first, seconds=0.5))
    assert schedule.next_task().key == "b/s/kind/-1-0-1/0+1"
    assert [settled.error for settled in schedule.settled()] == [None]


def test_of_cells_that_are_all_recorded_one_result_at_a_time_is_held():
    """A resumed run may find thousands; a cell that has tasks and one that fails come between."""
    words = {name: Words((4,)) for name in "abcd"}
    known = {name: words[name].runs[0] for name in "abd"}
    keys = {f"{name}/s/kind/{run.key}/0+4": name for name, run in known.items()}
    loaded = []

    class Watched(Source):
        def load(self, key):
            loaded.append(keys[key])
            return words[keys[key]].pack(words[keys[key]].chunk(known[keys[key]], (0, 4)))

    found = {f"{name}/s/kind": [(run.key, (0, 4))] for name, run in known.items()}
    broken = dataclasses.replace(_cell("e", 2.5), error="It cannot be planned.")
    cells = [broken, *(_cell(name, cost) for name, cost in zip("abcd", (4, 3, 2, 1), strict=True))]
    schedule = Schedule(cells, Watched(words), found, Pace())
    held = []

    class Engine:
        workers = 8

        def submit(self, task):
            held.append(task)

        def outcomes(self):
            while held:
                yield _outcome(words["c"], held.pop(0))

    order = []
    for settled in drive(schedule, Engine(), lambda outcome: None):
        order.append(settled.cell.estimator_name)
        if settled.result is not None and settled.cell.estimator_name != "c":
            assert loaded == [name for name in order if name in "abd"]
    assert order == ["a", "b", "e", "d", "c"]


def test_a_cell_that_is_all_recorded_is_done_at_once():
    words = Words((4,))
    source = Source({"a": words}, {"a/s/kind/0-0-4/0+4": words.pack("known")})
    schedule = Schedule([_cell("a")], source, {"a/s/kind": [("0-0-4", (0, 4))]}, Pace())
    assert schedule.next_task() is None
    assert [settled.result for settled in schedule.settled()] == [["known"]]
