"""Memory of the analyses: constant in the number of realizations, and below a gigabyte at 513²."""

import json
import math
import tracemalloc

import numpy as np
import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.core import parallel
from mcspectra.spectra.transforms import FrequencyGrid

HALF_WIDTH, N = 32, 64
_BLOCK = 2**13
GRID = FrequencyGrid(2, HALF_WIDTH)
REALIZATIONS = 120
BYTES = 16 * GRID.stored
"""Bytes of the spectrum of one realization."""

LARGE = """
import json, resource, sys
import mcspectra as mcs
mcs.variance_terms(
    mcs.Estimator("gaussian(width=0.25)", dims=2), "jittered", 1024, half_width=256,
    realizations=12, workers=2,
)
try:
    # ru_maxrss starts from the memory of the process that started this one.
    with open("/proc/self/status") as status:
        used = next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1024
except OSError:
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps(used))
"""


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Make blocks as small relative to these grids as usual blocks are to large grids."""
    monkeypatch.setattr(parallel, "_BLOCK_NUMBERS", _BLOCK)


def _peak(function):
    """Return the peak memory of Python objects and arrays while `function` runs."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def _terms(realizations, **settings):
    return mcs.variance_terms(
        "gaussian(width=0.25)",
        mcs.sampler("jittered", dims=2),
        N,
        half_width=HALF_WIDTH,
        realizations=realizations,
        **settings,
    )


def _power(realizations, **settings):
    return mcs.power_spectrum(
        "jittered", N, half_width=HALF_WIDTH, realizations=realizations, **settings
    )


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("analysis", [_terms, _power])
def test_memory_is_flat_in_realizations(analysis, workers):
    analysis(REALIZATIONS, workers=workers)  # Imports, compiled kernels, plans
    few = _peak(lambda: analysis(REALIZATIONS, workers=workers))
    many = _peak(lambda: analysis(4 * REALIZATIONS, workers=workers))
    # Threads have a few waiting results of blocks, each of three or four spectra. Four times as
    # many realizations add two
    # levels to the tree, each with a state. Keeping the result of every block would take a thousand
    # spectra.
    assert many - few < (12 + 2 * 4) * BYTES


def test_bands_take_their_square_and_no_more():
    labels = GRID.full(np.arange(GRID.stored) % 200)
    few = _peak(lambda: _terms(REALIZATIONS, workers=1))
    bands = _peak(lambda: _terms(REALIZATIONS, workers=1, bands=labels))
    realizations_a_block = max(1, _BLOCK // (2 * GRID.stored))
    # band_covariance: three in every node of the tree, the sums and the mean and squares of their
    # spread; in a block,
    # merged, and in the result
    nodes = math.ceil(math.log2(REALIZATIONS / 2))
    squares = (3 * nodes + 8) * (8 * 200**2)
    assert bands - few < squares + 8 * 200 * realizations_a_block + labels.nbytes + 2**20


def test_513_squared_stays_far_below_a_gigabyte():
    run = python("-c", LARGE, check=True)
    assert json.loads(run.stdout) < 1e9
