"""The lecture has the same bytes for any number of processes."""

import pytest

from mcspectra.reproduction.gallery import reproduce


@pytest.mark.slow
def test_processes_do_not_change_the_lecture(tmp_path):
    names = ["power-spectra", "validity"]
    made = [
        reproduce(tmp_path / str(workers), names, quick=True, workers=workers) for workers in (1, 2)
    ]
    assert [entry.name for entry in made[1].entries] == names
    one, two = (sorted(path for path in made[i].page.parent.rglob("*.*")) for i in (0, 1))
    assert [path.name for path in one] == [path.name for path in two]
    for first, second in zip(one, two, strict=True):
        assert first.read_bytes() == second.read_bytes()
