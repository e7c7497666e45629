"""Lost pages, power, memory, clocks and locks: see trials.py, which prints the counts."""

import pytest
from tests.studies import trials

FAULTS = pytest.mark.skipif(trials.shim() is None, reason="needs Linux and a C compiler")


def more(few, many):
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.endurance)])


def assert_held(found):
    print(dict(found))
    assert found["held"]
    assert not found["broken"]


@more((24, 6), (1, 24))
def test_each_cell_off_a_zeroed_page_is_recovered(tmp_path, count):
    """Of the short run, three pages of a ledger of 36 cells: a header, and pages of results."""
    found = trials.pages(tmp_path, *count)
    assert_held(found)
    assert found["recovered"] == found["cells_off_pages"]


@FAULTS
@more(3, 300)
def test_a_run_survives_a_loss_of_power(tmp_path, count):
    found = trials.power(tmp_path, count)
    assert_held(found)
    assert found["nothing_there"] < found["held"]


@FAULTS
@more(2, 150)
def test_a_run_survives_allocations_that_fail(tmp_path, count):
    assert_held(trials.memory(tmp_path, count))


@FAULTS
@more(2, 40)
def test_a_run_survives_a_clock_that_jumps(tmp_path, count):
    assert_held(trials.clocks(tmp_path, count))


@FAULTS
def test_without_locks_a_run_is_refused(tmp_path):
    assert_held(trials.locks(tmp_path))
