"""Blocks of realizations: every realization once, in order, within the requested size."""

import math
import multiprocessing
import os
import time

import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import (
    available_workers,
    map_in_order,
    process_map,
    realization_blocks,
    slices,
)

SLICE_NUMBERS = 2**19


def _members(blocks):
    return [r for first, count in blocks for r in range(first, first + count)]


@pytest.mark.parametrize("numbers", [0, 1, 100, 2**17, 2**18, 2**30])
def test_slices_cover_a_block(numbers):
    blocks = list(slices((7, 100), numbers))
    assert _members(blocks) == list(range(7, 107))
    assert all(count == 1 or count * numbers <= SLICE_NUMBERS for _, count in blocks)
    assert len({count for _, count in blocks[:-1]}) <= 1


def test_blocks_cover_all_realizations():
    blocks = list(realization_blocks(1001, 2**12, multiple=2, first=5, least=3))
    assert _members(blocks) == list(range(5, 1006))
    assert len(blocks) >= 3
    assert all(count % 2 == 0 for _, count in blocks[:-1])


@pytest.mark.parametrize(("realizations", "least"), [(1, 1), (1001, 3), (1024, 8), (0, 1)])
def test_any_block_is_found_by_its_index(realizations, least):
    blocks = realization_blocks(realizations, 2**12, first=5, least=least)
    listed = list(blocks)
    assert len(blocks) == len(listed)
    assert [blocks[i] for i in range(len(blocks))] == listed
    assert _members(listed) == list(range(5, 5 + realizations))
    with pytest.raises(IndexError):
        blocks[len(blocks)]


def test_blocks_of_a_billion_realizations_use_no_memory():
    blocks = realization_blocks(10**9, 2**21)
    assert len(blocks) == 10**9
    assert blocks[10**9 - 1] == (10**9 - 1, 1)


@pytest.mark.parametrize("workers", [1, 3])
def test_results_come_in_order(workers):
    assert list(map_in_order(lambda x: x * x, range(50), workers)) == [x * x for x in range(50)]


@pytest.mark.parametrize("workers", [1, 2])
def test_processes_return_results_in_order(workers):
    with process_map(workers) as mapped:
        assert list(mapped(math.sqrt, [4.0, 9.0, 0.0])) == [2.0, 3.0, 0.0]
        share = max(1, available_workers() // workers)
        assert list(mapped(available_workers, [None, 5])) == [share, 5]
        with pytest.raises(ValueError, match="domain"):
            list(mapped(math.sqrt, [-1.0]))


def test_a_process_that_dies_gives_an_error():
    with pytest.raises(ParameterError, match="One of 2 processes died"), process_map(2) as mapped:
        list(mapped(os._exit, [1]))


def test_an_interrupt_ends_the_processes():
    def interrupted():
        with process_map(2) as mapped:
            for _ in mapped(time.sleep, [0.0, 60.0, 60.0]):
                raise KeyboardInterrupt

    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    while multiprocessing.active_children():
        assert time.perf_counter() - start < 50
