"""Studies end to end: same bits for any number of workers, resumable, failures reported."""

import pytest

from mcspectra.core.errors import ConfigError, DamagedResultsWarning
from mcspectra.studies import (
    make_plan,
    open_results,
    read_study,
    run_study,
    study_file,
    summarize,
)
from mcspectra.studies.files import decode_study
from mcspectra.studies.ledger import LEDGER_NAME, Ledger, StudyNote

STUDY = """
title = "small"
seed = 3
samplers = ["random", "jittered | shift"]
[convergence]
counts = [16, 64]
realizations = 200
[terms]
n = 16
half_width = 6
realizations = 100
[spectrum]
n = 16
half_width = 8
realizations = 20
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 2
[[estimators]]
name = "one <dim> & more"
integrand = "linear"
dims = 1
density = "linear(slope=1)"
terms = { n = 16, half_width = 8, realizations = 50, cross_matrix = true }
[[estimators]]
name = "mis"
integrand = "linear"
dims = 1
densities = ["uniform", "linear(slope=1)"]
heuristic = "power"
technique_counts = [1, 2]
terms = { n = 16, half_width = 8, realizations = 50, space = "primary" }
[[estimators]]
name = "sum"
integrands = ["linear", "step(at=0.3)"]
dims = 1
"""


@pytest.fixture(scope="module")
def finished(once, tmp_path_factory):
    """The results of the study, which tests only read."""

    def computed():
        folder = tmp_path_factory.mktemp("study")
        run_study(decode_study(STUDY), folder, workers=1)
        return folder

    return once("studies", computed)


def test_resume_computes_only_missing_cells(finished, tmp_path, stored_values):
    import shutil

    shutil.copytree(finished, tmp_path / "copy")
    config = decode_study(STUDY)
    plan = make_plan(config, tmp_path)
    paths = [cell.path for cell in plan.cells]
    note = StudyNote.of(plan.config, plan.inputs)
    Ledger.resume(tmp_path / "copy", note, paths, outdated=["mis/random/terms"]).close()
    (tmp_path / "copy/.results.zarr.partial").mkdir()  # A killed run leaves this file
    seen = []
    run_study(
        decode_study(STUDY),
        tmp_path / "copy",
        resume=True,
        report=lambda progress: seen.append(progress.cell.path),
    )
    assert seen == ["mis/random/terms"]
    assert stored_values(tmp_path / "copy") == stored_values(finished)
    assert not list((tmp_path / "copy").glob(".*.partial"))


def test_resume_repairs_damaged_cells_and_the_store(finished, tmp_path, stored_values):
    """The ledger has garbage, and a chunk is missing, which zarr would read as fill values."""
    import shutil

    shutil.copytree(finished, tmp_path / "copy")
    (tmp_path / "copy/results.zarr/sum/random/convergence/variance/c/0").unlink()
    with Ledger.read(finished) as ledger:
        payload = ledger.result("mis/random/terms")
    file = tmp_path / "copy" / LEDGER_NAME
    file.write_bytes(file.read_bytes().replace(payload[:50], b"garbage" + payload[7:50]))
    seen = []
    with pytest.warns(DamagedResultsWarning, match=r"mis/random/terms \(its digest does not match"):
        run_study(
            decode_study(STUDY),
            tmp_path / "copy",
            resume=True,
            report=lambda progress: seen.append(progress.cell.path),
        )
    assert "mis/random/terms" in seen
    assert stored_values(tmp_path / "copy") == stored_values(finished)
    assert open_results(tmp_path / "copy/results.zarr").leaves


def test_summary_has_a_row_for_every_pair(finished):
    rows = summarize(open_results(finished))
    assert [r.estimator for r in rows[::2]] == ["smooth", "one <dim> & more", "mis", "sum"]
    assert [r.sampler for r in rows[:2]] == ["random", "jittered | shift"]
    smooth = next(r for r in rows if r.estimator == "smooth" and r.sampler == "random")
    assert smooth.rate_low < -1 < smooth.rate_high
    assert smooth.largest_term == "power"
    total = smooth.dc + smooth.power + smooth.cross
    assert total == pytest.approx(smooth.predicted)
    assert smooth.captured == pytest.approx(smooth.predicted / smooth.measured)


def test_names_with_equal_slugs_get_different_groups(tmp_path):
    text = STUDY[: STUDY.index("[[")] + "".join(
        f'[[estimators]]\nname = "{name}"\nintegrand = "gaussian"\n' for name in ("a b", "a-b", "ä")
    )
    plan = make_plan(decode_study(text), tmp_path)
    assert len({cell.path for cell in plan.cells}) == len(plan.cells) == 3 * 2 * 4


def test_thousands_of_similar_names_are_fast():
    from mcspectra.studies.files import Slugs

    slugs = Slugs()
    found = [slugs(f"{'a' * 60} {i}") for i in range(100_000)]
    assert len(set(found)) == len(found)
    assert found[:3] == ["a" * 60, "a" * 60 + "-2", "a" * 60 + "-3"]
    assert [slugs(name) for name in ("b-2", "b", "B", "b!", "zarr.json")] == [
        "b-2", "b", "b-3", "b-4", "zarr.json-2"
    ]  # fmt: skip


def test_the_tour_is_a_valid_study():
    plan = make_plan(read_study("tour"), study_file("tour").parent)
    kinds = {cell.analysis_name for cell in plan.cells}
    assert kinds == {"convergence", "terms", "predict", "spectrum", "points"}


def test_unreadable_study_files(tmp_path):
    with pytest.raises(ConfigError, match="no study file"):
        read_study(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="not a file"):
        read_study(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"title = '\xff'")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_study(tmp_path / "latin.toml")
