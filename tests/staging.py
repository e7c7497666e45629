"""Staged analyses, computed in every way they may be: in chunks, by threads, through files."""

from __future__ import annotations

import io
import random

import numpy as np
import xarray as xr

from mcspectra.core import parallel
from mcspectra.core.staged import MergeTree, chunks, compute, compute_chunk

__all__ = ["check_cuts", "run_sizes"]


def _through_file(arrays):
    """What a file without pickle gives back."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return dict(np.load(io.BytesIO(stream.getvalue()), allow_pickle=False))


def _run_in_chunks(make, run, size):
    """State of a run from chunks in any order, through a file to an analysis of its own."""
    parts = list(chunks(run.blocks, size))
    packed, analysis = {}, make()
    for chunk in random.Random(size).sample(parts, len(parts)):
        packed[chunk] = _through_file(analysis.pack(compute_chunk(analysis, run, chunk)))
    analysis = make()
    tree = MergeTree(analysis.merge)
    for chunk in parts:
        tree.add(analysis.unpack(packed[chunk]), chunk[1])
    return tree.total()


def _drive(analysis, compute_run):
    stages, states = analysis.stages(), None
    try:
        while True:
            states = [compute_run(run) for run in stages.send(states)]
    except StopIteration as end:
        return end.value


def run_sizes(analysis):
    """Numbers of blocks of all runs."""
    sizes = []

    def compute_run(run):
        sizes.append(run.blocks)
        return compute_chunk(analysis, run, (0, run.blocks))

    _drive(analysis, compute_run)
    return sizes


def check_cuts(make, public, monkeypatch, block_numbers, blocks=5):
    """Check that chunks and threads change nothing: `make` a staged analysis, `public` its function.

    Blocks are made so small that some run has `blocks` of them at least.
    """
    monkeypatch.setattr(parallel, "_BLOCK_NUMBERS", block_numbers)
    assert max(run_sizes(make())) >= blocks
    expected = compute(make(), 1)
    xr.testing.assert_identical(compute(make(), 2), expected)
    xr.testing.assert_identical(public(workers=1), expected)
    xr.testing.assert_identical(public(workers=2), expected)
    for size in (1, 2, 4, 2**30):
        found = _drive(make(), lambda run, size=size: _run_in_chunks(make, run, size))
        xr.testing.assert_identical(found, expected)
    return expected
