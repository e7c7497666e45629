"""Analyses in blocks: the same merge tree whatever the chunks and threads, results in order."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from mcspectra.core.staged import MergeTree, Run, Whole, chunks, compute, compute_chunk, in_step

import mcspectra as mcs


def _tree(merge, states):
    tree = MergeTree(merge)
    for state in states:
        tree.add(state)
    return tree.total()


def _joined(left, right):
    return f"({left}{right})"


def _skewed(left, right):
    """Float merge that is neither associative nor commutative."""
    return left + 0.7 * right


@dataclass
class _Words:
    """Analysis whose states say how they were merged; reuses its left states if `lists`."""

    lists: bool = False
    computed: list[int] = field(default_factory=list)

    def block(self, run, index):
        self.computed.append(index)
        word = f"{run.first + index},"
        return [word] if self.lists else word

    def merge(self, left, right):
        if self.lists:
            left[0] = _joined(left[0], right[0])
            return left
        return _joined(left, right)

    def stages(self):
        said = ""
        for part in range(2):
            runs = [Run(part=part, first=f, realizations=9, blocks=9, cost=1.0) for f in (0, 20)]
            states = yield runs
            said += "|".join(s[0] if self.lists else s for s in states) + ";"
        return said


def _by_definition(names):
    """Left subtree of the largest power of two below the number: the tree, written recursively."""
    if len(names) == 1:
        return names[0]
    half = 1 << ((len(names) - 1).bit_length() - 1)
    return _joined(_by_definition(names[:half]), _by_definition(names[half:]))


@settings(deadline=None)
@given(st.integers(1, 200))
def test_the_tree_is_the_left_balanced_one(blocks):
    names = [f"{i}," for i in range(blocks)]
    assert _tree(_joined, names) == _by_definition(names)


@settings(deadline=None)
@given(st.integers(1, 150), st.integers(0, 8))
def test_chunks_of_one_size_change_nothing(blocks, power):
    run, words = Run(part=0, first=0, realizations=blocks, blocks=blocks, cost=1.0), _Words()
    tree = MergeTree(_joined)
    for chunk in chunks(blocks, 2**power):
        tree.add(compute_chunk(words, run, chunk), chunk[1])
    assert words.computed == list(range(blocks))
    assert tree.total() == _tree(_joined, [f"{i}," for i in range(blocks)])


def _mixed(blocks, choose):
    """Chunks of mixed sizes: each any power of two that divides its first block, and tails."""
    first = 0
    while first < blocks:
        sizes = [2**k for k in range(9) if first % 2**k == 0]
        size = min(choose(sizes), blocks - first)
        yield first, size
        first += size


@settings(deadline=None)
@given(st.integers(1, 150), st.integers(0, 2**32))
def test_chunks_of_mixed_sizes_change_nothing(blocks, seed):
    choose = random.Random(seed).choice
    values = [0.1 * (i + 1) ** 0.5 for i in range(blocks)]
    tree, said = MergeTree(_skewed), MergeTree(_joined)
    for first, size in _mixed(blocks, choose):
        own = range(first, first + size)
        tree.add(_tree(_skewed, [values[i] for i in own]), size)
        said.add(_tree(_joined, [f"{i}," for i in own]), size)
    assert tree.total() == _tree(_skewed, values)
    assert said.total() == _by_definition([f"{i}," for i in range(blocks)])


def test_a_tree_holds_few_states():
    tree = MergeTree(_skewed)
    for i in range(1000):
        tree.add(float(i))
        assert len(tree._nodes) <= 10  # ⌊log₂ 1000⌋ + 1


@pytest.mark.parametrize("lists", [False, True])
@pytest.mark.parametrize("workers", [1, 2, 5])
def test_threads_change_nothing(lists, workers):
    one = "|".join(_by_definition([f"{f + i}," for i in range(9)]) for f in (0, 20))
    assert compute(_Words(lists), workers) == f"{one};{one};"


def test_chunks_cover_all_blocks():
    assert list(chunks(10, 4)) == [(0, 4), (4, 4), (8, 2)]
    assert list(chunks(1, 8)) == [(0, 1)]
    assert list(chunks(0, 8)) == []


def test_run_keys_differ():
    runs = [
        Run(part=p, first=f, realizations=2, blocks=1, cost=1.0) for p in (0, 1) for f in (0, 2)
    ]
    assert len({run.key for run in runs}) == 4


def _counting(part, stages):
    total = 0
    for stage in range(stages):
        state = yield Run(part=part, first=stage, realizations=1, blocks=1, cost=1.0)
        total += state
    return part, total


def _drive(generator, answer):
    """Stages of a generator of runs, and what it returns."""
    stages, states = [], None
    try:
        while True:
            stages.append(generator.send(states))
            states = [answer(run) for run in stages[-1]]
    except StopIteration as end:
        return stages, end.value


def test_generators_go_in_step():
    together = in_step([_counting(p, s) for p, s in enumerate([2, 0, 3, 1])])
    stages, results = _drive(together, lambda run: 10**run.first)
    assert results == [(0, 11), (1, 0), (2, 111), (3, 1)]
    found = [[(run.part, run.first) for run in runs] for runs in stages]
    assert found == [[(0, 0), (2, 0), (3, 0)], [(0, 1), (2, 1)], [(2, 2)]]


def test_no_generators_need_no_stage():
    assert _drive(in_step([]), None) == ([], [])


def _small():
    return mcs.convergence("linear", "jittered", [4, 16], realizations=20, rng=1)


def test_a_whole_is_its_dataset():
    whole = Whole(_small, cost=3.0)
    (run,) = next(whole.stages())
    assert (run.blocks, run.cost) == (1, 3.0)
    xr.testing.assert_identical(compute(whole, 2), _small())
    packed = whole.pack(compute_chunk(whole, run, (0, 1)))
    assert all(isinstance(a, np.ndarray) and a.dtype != object for a in packed.values())
    xr.testing.assert_identical(whole.unpack(packed), _small())


def test_an_error_in_a_block_comes_through():
    def fails():
        raise ValueError("no such integrand")

    with pytest.raises(ValueError, match="no such integrand"):
        compute(Whole(fails), 2)
