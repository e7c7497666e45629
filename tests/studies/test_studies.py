"""Studies end to end: same bits for any number of workers, resumable, honest about failures."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ConfigError, DamagedResultsWarning, StoreError
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
from mcspectra.studies.run import CellFailed
from mcspectra.variance.convergence import Convergence

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


def _values(folder):
    """Every array of a store, by path."""
    tree = open_results(folder)
    return {
        f"{node.path}/{name}": np.asarray(variable.values)
        for node in tree.subtree
        for name, variable in node.to_dataset().variables.items()
    }


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    run_study(decode_study(STUDY), folder, workers=1)
    return folder


def test_one_and_two_workers_give_identical_bits(finished, tmp_path):
    run_study(decode_study(STUDY), tmp_path, workers=2)
    one, two = _values(finished), _values(tmp_path)
    assert one.keys() == two.keys()
    assert len(one) > 100
    for name, values in one.items():
        assert values.tobytes() == two[name].tobytes(), name


def test_cells_are_what_the_functions_return(finished):
    tree = open_results(finished)
    stored = tree["smooth/jittered-shift/convergence"].to_dataset()
    direct = mcs.convergence(
        mcs.Estimator("gaussian", dims=2), "jittered | shift", [16, 64], realizations=200, rng=3
    )
    assert np.array_equal(stored["variance"], direct["variance"])
    assert stored.attrs["estimator_name"] == "smooth"
    assert stored.attrs["sampler_spec"] == "jittered | shift"
    assert tree.attrs["study"]["title"] == "small"


def test_resume_computes_only_what_is_missing(finished, tmp_path):
    import shutil

    shutil.copytree(finished, tmp_path / "copy")
    config = decode_study(STUDY)
    plan = make_plan(config, tmp_path)
    paths = [cell.path for cell in plan.cells]
    note = StudyNote.of(plan.config, plan.inputs)
    Ledger.resume(tmp_path / "copy", note, paths, outdated=["mis/random/terms"]).close()
    (tmp_path / "copy/.results.zarr.partial").mkdir()  # what a killed run leaves
    seen = []
    run_study(
        decode_study(STUDY),
        tmp_path / "copy",
        resume=True,
        report=lambda progress: seen.append(progress.cell.path),
    )
    assert seen == ["mis/random/terms"]
    one, two = _values(finished), _values(tmp_path / "copy")
    assert one.keys() == two.keys()
    assert all(one[name].tobytes() == two[name].tobytes() for name in one)
    assert not list((tmp_path / "copy").glob(".*.partial"))


def test_resume_mends_damaged_cells_and_the_store(finished, tmp_path):
    """Garbage in the ledger; a chunk that is gone, which zarr would read as fill values."""
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
    one, two = _values(finished), _values(tmp_path / "copy")
    assert all(one[name].tobytes() == two[name].tobytes() for name in one)
    assert open_results(tmp_path / "copy/results.zarr").leaves


def test_existing_store_is_an_error_without_resume(finished):
    with pytest.raises(StoreError, match="--resume"):
        run_study(decode_study(STUDY), finished)


def test_store_of_another_study_is_refused(finished):
    with pytest.raises(StoreError, match="another study"):
        run_study(decode_study(STUDY.replace("seed = 3", "seed = 4")), finished, resume=True)


def test_no_results_is_a_sentence(tmp_path):
    with pytest.raises(StoreError, match="no results"):
        open_results(tmp_path)


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


def test_failed_cells_do_not_take_the_others_with_them(tmp_path, monkeypatch):
    real = Convergence.reduction

    def failing(self, subject, stream):
        if isinstance(subject.estimator, mcs.TechniqueSum) and subject.sampler.spec == "random":
            raise mcs.McspectraError("the integrand gave NaN")
        return real(self, subject, stream)

    monkeypatch.setattr(Convergence, "reduction", failing)
    with pytest.raises(CellFailed, match="the integrand gave NaN") as caught:
        run_study(decode_study(STUDY), tmp_path, workers=2)
    assert list(caught.value.failures) == ["sum/random/convergence"]
    monkeypatch.setattr(Convergence, "reduction", real)
    seen = []

    def again(**given):
        run_study(
            decode_study(STUDY),
            tmp_path,
            resume=True,
            report=lambda p: seen.append(p.cell.path),
            **given,
        )

    with pytest.raises(CellFailed, match="the integrand gave NaN"):
        again()
    assert seen == []
    again(retry=True)
    assert seen == ["sum/random/convergence"]


def test_interrupt_leaves_a_resumable_store(finished, tmp_path):
    def stop(progress):
        if progress.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(decode_study(STUDY), tmp_path, workers=2, report=stop)
    run_study(decode_study(STUDY), tmp_path, workers=2, resume=True)
    one, two = _values(finished), _values(tmp_path)
    assert one.keys() == two.keys()
    assert all(one[name].tobytes() == two[name].tobytes() for name in one)


def test_paths_are_relative_to_the_study_file(tmp_path):
    points = np.random.default_rng(1).random((16, 2))
    np.savetxt(tmp_path / "set.dat", points)
    text = STUDY[: STUDY.index("[[")].replace(
        'samplers = ["random", "jittered | shift"]',
        "samplers = [\"points(path='set.dat') | shift\"]",
    )
    text = text.replace("counts = [16, 64]", "counts = [16]")
    (tmp_path / "s.toml").write_text(text + '[[estimators]]\nname="a"\nintegrand="gaussian"\n')
    plan = make_plan(read_study(tmp_path / "s.toml"), tmp_path)
    drawn = plan.cells[0].subject.sampler.draw(16, realizations=3)
    offset = (drawn - points) % 1.0
    assert np.allclose(np.ptp(offset, axis=1) % 1.0, 0, atol=1e-12)
    assert not np.array_equal(drawn[0], drawn[1])


def test_names_that_meet_in_one_group_name_stay_apart(tmp_path):
    text = STUDY[: STUDY.index("[[")] + "".join(
        f'[[estimators]]\nname = "{name}"\nintegrand = "gaussian"\n' for name in ("a b", "a-b", "ä")
    )
    plan = make_plan(decode_study(text), tmp_path)
    assert len({cell.path for cell in plan.cells}) == len(plan.cells) == 3 * 2 * 4


def test_thousands_of_names_that_begin_alike_are_named_at_once():
    from mcspectra.studies.plan import _Slugs

    slugs = _Slugs()
    found = [slugs(f"{'a' * 60} {i}") for i in range(100_000)]
    assert len(set(found)) == len(found)
    assert found[:3] == ["a" * 60, "a" * 60 + "-2", "a" * 60 + "-3"]
    assert [slugs(name) for name in ("b-2", "b", "B", "b!", "zarr.json")] == [
        "b-2", "b", "b-3", "b-4", "zarr.json-2"
    ]  # fmt: skip


def test_the_tour_is_a_valid_study():
    plan = make_plan(read_study("tour"), study_file("tour").parent)
    kinds = {cell.analysis_name for cell in plan.cells}
    assert kinds == {"convergence", "terms", "spectrum", "points"}


def test_unreadable_study_files(tmp_path):
    with pytest.raises(ConfigError, match="no study file"):
        read_study(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="not a file"):
        read_study(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"title = '\xff'")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_study(tmp_path / "latin.toml")
