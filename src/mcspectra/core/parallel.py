"""Work on blocks of realizations: a fixed partition, pools of workers, and results in order.

The partition depends only on the size of the problem, and never on the number of workers.
Results of blocks are returned in order, so sums have the same bits for any number of workers.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar, final

from mcspectra.core.checks import as_integer
from mcspectra.core.errors import ParameterError

__all__ = [
    "MAX_REALIZATIONS",
    "Block",
    "Mapper",
    "RealizationBlocks",
    "available_workers",
    "map_in_order",
    "process_map",
    "realization_blocks",
    "slices",
]

Item = TypeVar("Item")
Result = TypeVar("Result")

Block = tuple[int, int]
"""First realization of a block, and number of realizations in it."""

Mapper: TypeAlias = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]
"""Function that is called as ``map`` with a function of one argument, and keeps the order."""

MAX_REALIZATIONS = 10**9
"""Largest number of realizations of one analysis."""

# Numbers in a block: 16 MiB of float64, more than any cache and far less than all memory
_BLOCK_NUMBERS = 2**21
_SLICE_NUMBERS = 2**19  # numbers in a slice: 4 MiB, which take one or two milliseconds
_processes = 1  # number of processes of `process_map` to which this process belongs


def available_workers(workers: int | None = None) -> int:
    """Return `workers`. The default is the number of processors that this process may use.

    Processes of `process_map` share the processors equally, and each may use at least one.
    """
    if workers is not None:
        return as_integer("workers", workers, least=1, most=1024)
    affinity = getattr(os, "sched_getaffinity", None)
    count = len(affinity(0)) if affinity else os.cpu_count() or 1
    return max(1, count // _processes)


@final
@dataclass(frozen=True)
class RealizationBlocks:
    """The realizations from `first` to `stop` − 1, divided into blocks of at most `size`."""

    first: int
    stop: int
    size: int

    def __len__(self) -> int:
        return len(range(self.first, self.stop, self.size))

    def __getitem__(self, index: int) -> Block:
        start = range(self.first, self.stop, self.size)[index]
        return start, min(self.size, self.stop - start)

    def __iter__(self) -> Iterator[Block]:
        return map(self.__getitem__, range(len(self)))


def realization_blocks(
    realizations: int, numbers_each: int, *, multiple: int = 1, first: int = 0, least: int = 1
) -> RealizationBlocks:
    """Split realizations into blocks of about `_BLOCK_NUMBERS` numbers.

    The size of a block is a multiple of `multiple`.
    There are at least `least` blocks if there are enough realizations for blocks of `multiple`.
    """
    size = max(1, _BLOCK_NUMBERS // max(1, numbers_each) // multiple) * multiple
    size = min(size, max(1, realizations // least // multiple) * multiple)
    return RealizationBlocks(first, first + realizations, size)


def slices(block: Block, numbers_each: int) -> Iterator[Block]:
    """Split a block into slices of about `_SLICE_NUMBERS` numbers.

    Slices limit memory and stay in a shared cache.
    In one thread, smaller slices that fit into a second-level cache are not faster.
    In several threads, smaller slices are slower, because threads wait for Python's lock.
    Each wait for the lock takes 0.1 ms, because an idle processor has to wake up.
    The parallel efficiency of two threads was 0.39 for slices of 2^16 numbers.
    The efficiency was 0.77 for slices of 2^18 numbers, and 0.87 for 2^19 and 2^20 numbers.
    For two processes, the efficiency is 0.91 to 0.95.
    """
    size = max(1, _SLICE_NUMBERS // max(1, numbers_each))
    start, stop = block[0], block[0] + block[1]
    return ((own, min(size, stop - own)) for own in range(start, stop, size))


def map_in_order(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Yield ``function(item)`` in order. `workers` threads compute a few results in advance."""
    if workers == 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(copy_context().run, function, item))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


@contextmanager
def process_map(workers: int) -> Iterator[Mapper]:
    """Provide ``map`` for work that holds Python's lock, such as drawing figures.

    With one worker, the current process computes each result when the caller asks for it.
    More workers are new processes, which import the function and start all work at once.
    New processes are spawned, because forking a process with threads may hang.
    Each new process gets an equal share of the processors: more threads would wait for each other.

    Raises
    ------
    ParameterError
        If a process dies. New processes die at their start if the calling script does not have
        the line ``if __name__ == "__main__":`` before its own calls.
    """
    if workers == 1:
        yield map
        return
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, spawn, _begin, (workers,))
    try:
        yield pool.map
    except BaseException as error:
        # Ending the pool would wait for the work in progress, also after Ctrl-C
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        if isinstance(error, BrokenProcessPool):
            raise ParameterError(
                f"One of {workers} processes died; check its output and the free memory, guard "
                'the script by if __name__ == "__main__":, or give workers=1.'
            ) from None
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _begin(processes: int) -> None:
    """Prepare one of several new processes."""
    global _processes
    _processes = processes
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process ends the workers
