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
@pytest.mark.parametrize(
    "counts",
    [
        {"locks": 1, "power": 2, "memory": 1, "clocks": 1},
        pytest.param({"power": 300}, marks=pytest.mark.endurance),
        pytest.param({"memory": 150}, marks=pytest.mark.endurance),
        pytest.param({"clocks": 40}, marks=pytest.mark.endurance),
    ],
    ids=lambda counts: "+".join(counts),
)
def test_a_run_survives_faults_of_the_system(tmp_path, counts):
    """A loss of power, allocations that fail, and a clock that jumps; without locks it is refused.

    All runs are forks of one process.
    """
    for kind, found in trials.system(tmp_path, counts).items():
        print(kind)
        assert_held(found)
        assert sum(found[each] for each in ("held", "broken")) == counts[kind]
        assert found["nothing_there"] < found["held"]
