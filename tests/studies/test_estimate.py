"""Estimates of a study: compared with real costs, and refused if too large."""

import math
import tracemalloc

import pytest

from mcspectra.cli.studies import estimate_text
from mcspectra.core.errors import ConfigError
from mcspectra.studies import Trust, estimate, estimate_study, make_plan, run_study
from mcspectra.studies.estimate import CellEstimate, wall_time
from mcspectra.studies.files import decode_study

STUDY = """
title = "t"
samplers = ["random", "jittered"]
[convergence]
counts = [16, 256]
realizations = 2000
[terms]
n = 64
half_width = 8
realizations = 2000
[predict]
counts = [16]
method = "exact"
[[estimators]]
name = "a"
integrand = "gaussian"
dims = 2
"""


def _plan(tmp_path, text=STUDY, **options):
    return make_plan(decode_study(text), tmp_path, **options)


def test_every_cell_has_an_estimate_and_storage_is_near_the_truth(tmp_path):
    plan = _plan(tmp_path)
    estimates = estimate_study(plan)
    run_study(plan.config, tmp_path / "out", workers=1)
    assert [each.path for each in estimates] == [cell.path for cell in plan.cells]
    assert [each.tried for each in estimates] == [True] * 6
    tried = [each for each in estimates if each.tried]
    assert all(each.seconds > 0 for each in estimates)
    stored = sum(
        file.stat().st_size
        for each in tried
        for file in (tmp_path / "out/results.zarr" / each.path).rglob("*")
        if file.is_file()
    )
    assert stored / 3 < sum(each.storage for each in tried) < 3 * stored


def test_trial_runs_are_few_and_optional(tmp_path):
    plan = _plan(tmp_path, STUDY.replace("= 2000", "= 1000000000"))
    estimates = estimate_study(plan, probe_seconds=0.2)
    assert sum(each.seconds for each in estimates) > 1000
    none = estimate_study(plan, probe_seconds=0)
    assert not any(each.tried for each in none)
    assert all(each.seconds > 0 and each.storage > 0 and each.memory > 0 for each in none)


@pytest.mark.parametrize("name", ["interrupts", "hangs"])
def test_a_trial_run_that_fails_or_hangs_is_ignored(misbehaving, tmp_path, monkeypatch, name):
    (misbehaving / "hang").touch()
    monkeypatch.setattr(estimate, "_PATIENCE", 0.1)
    text = f"\"python(function='misbehaving:{name}')\""
    changes = {
        '"gaussian"': text,
        'samplers = ["random", "jittered"]': 'samplers = ["random"]',
    }
    study = STUDY
    for old, new in changes.items():
        study = study.replace(old, new)
    config = decode_study(study)
    trust = Trust((f"misbehaving:{name}",))
    estimates = estimate_study(make_plan(config, tmp_path, trust), probe_seconds=0.3)
    (misbehaving / "hang").unlink()
    assert [each.tried for each in estimates] == [False] * 3
    assert [each.error for each in estimates] == [None] * 3


def test_known_failures_are_reported_without_a_trial_run(misbehaving, tmp_path):
    text = "\"python(function='misbehaving:nan_at_once')\""
    config = decode_study(STUDY.replace('"gaussian"', text) + "[spectrum]\nn = 4\n")
    estimates = estimate_study(make_plan(config, tmp_path, Trust(("misbehaving:nan_at_once",))))
    names = ["convergence", "terms", "predict", "spectrum", "points"]
    assert [each.analysis for each in estimates] == 2 * names
    assert all("NaN" in each.error and not each.tried for each in estimates)
    text = estimate_text(estimates, 0.0, 1)
    assert text.count("estimator 'a' will fail: The function is NaN or infinite") == 1
    assert misbehaving.exists()


def test_divisible_cells_have_tasks_of_about_a_second(tmp_path):
    """10⁹ realizations make tasks of 1 s, and of 0.2 s with a time limit of 1 s."""
    text = STUDY.replace("= 2000", "= 1000000000")
    counted = {}
    for limit in ("", "time_limit = 1.0\n"):
        estimates = estimate_study(_plan(tmp_path, limit + text), probe_seconds=0.2)
        target = 0.2 if limit else 1.0
        for each in estimates:
            expected = 1 if each.analysis == "predict" else math.ceil(each.seconds / target)
            assert each.tasks == expected, each
        counted[limit] = sum(each.tasks for each in estimates)
    assert min(counted.values()) > 1000


MAPS = """
title = "t"
samplers = ["sobol | owen"]
[[maps]]
name = "first"
scene = "penumbra(width=20, height=15)"
integrator = "path(max_depth=2)"
chains = 0
realizations = 20
[[maps]]
name = "whole"
scene = "penumbra(width=20, height=15)"
integrator = "path(max_depth=2)"
chains = 0
realizations = 20
[[maps]]
name = "crop"
scene = "penumbra(width=20, height=15)"
integrator = "path(max_depth=2)"
chains = 0
realizations = 20
crop = [0, 0, 20, 15]
[[maps]]
name = "subset"
scene = "penumbra(width=20, height=15)"
integrator = "path(max_depth=2)"
chains = 0
realizations = 20
pixels = "30%"
"""


@pytest.mark.render
def test_maps_of_a_film_and_of_the_whole_crop_have_the_same_estimate(tmp_path):
    # The trial of the first map also compiles the kernels. On a loaded machine it took 16 s, and
    # trials of 12 s in all left out the last map
    _, whole, crop, subset = estimate_study(_plan(tmp_path, MAPS), probe_seconds=60.0)
    assert whole.storage == crop.storage > 0
    assert whole.memory == crop.memory
    # Both times are measured, and other programs may slow one of them down.
    # The estimates of a version with this fault differed by a factor of 32
    assert 1 / 8 < whole.seconds / crop.seconds < 8
    # The layers of a subset are interpolated, and stored at every pixel
    assert subset.storage == whole.storage
    # Maps use all processors, so that several workers take as long as one
    cells = [whole, crop, subset]
    assert wall_time(cells, 4) == wall_time(cells, 1) == sum(each.seconds for each in cells)


def test_wall_time():
    cells = [
        CellEstimate(path=f"{s}", estimator="a", sampler="b", analysis="terms", seconds=s,
                     memory=1, storage=1, tried=True)
        for s in (1.0, 2.0, 9.0)
    ]  # fmt: skip
    assert wall_time(cells, 1) == 12.0
    assert wall_time(cells, 4) == 9.0
    assert wall_time([], 4) == 0.0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("counts = [16, 256]", "counts = [16, 2000000000]"),
        ("n = 64", "n = 2000000000"),
        ("counts = [16]\n", "counts = [2000000000]\n"),
        ('[predict]\ncounts = [16]\nmethod = "exact"', "[pcf]\nn = 2000000000"),
        ('[predict]\ncounts = [16]\nmethod = "exact"', "[anova]\nn = 2000000000"),
        ('[predict]\ncounts = [16]\nmethod = "exact"', "[spectrum]\nn = 2000000000"),
        ('[predict]\ncounts = [16]\nmethod = "exact"', "[techniques]\ncounts = [2000000000]"),
        ('[predict]\ncounts = [16]\nmethod = "exact"', "[remedies]\nbudget = 2000000000"),
    ],
)
def test_too_many_points_are_refused_with_an_estimate_before_allocation(tmp_path, old, new):
    assert old in STUDY
    tracemalloc.start()
    try:
        with pytest.raises(
            ConfigError,
            match=r"of memory, and this machine has|are 2e\+18 pairs|at most|<= "
            r"|from 1 to 16777216",
        ):
            _plan(tmp_path, STUDY.replace(old, new), force=True)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_too_many_evaluations_need_force(tmp_path):
    text = STUDY.replace("counts = [16, 256]", "counts = [1048576]").replace(
        "= 2000", "= 1000000000"
    )
    with pytest.raises(ConfigError, match=r"about 2\.1e\+15 evaluations.*--force"):
        _plan(tmp_path, text)
    assert _plan(tmp_path, text, force=True).cells
