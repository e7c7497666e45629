"""Exported programs and studies run unchanged and give the numbers of the explorer."""

import contextlib
import io
import tomllib

import numpy as np
import pytest

from mcspectra.app.compute import analyses_of, compute, integrand_specs
from mcspectra.app.page import as_python, as_toml
from mcspectra.app.state import ExplorerSetup, ExplorerState
from mcspectra.app.uploads import keep_upload
from mcspectra.core.fits import is_resolved
from mcspectra.studies import open_results, read_study, run_study

ALL_COUNTS = {"n": 16, "half_width": 6, "realizations": 8}
SMALL = ALL_COUNTS | {"counts": (4, 16, 64)}
SETUPS = [
    ExplorerSetup(**ALL_COUNTS),  # The others have few counts, whose predictions are quick
    ExplorerSetup(
        dims=1, sampler="jittered | shift", density="linear(slope=0.5)", strata_shift=0.25, **SMALL
    ),
    ExplorerSetup(
        dims=1, integrand="step(at=0.3)", smoothing=0.125, basis="cosine", seed=5, **SMALL
    ),
    ExplorerSetup(
        dims=1, mirror="integrand", density="power(exponent=1)", integrand="polynomial", **SMALL
    ),
    ExplorerSetup(sampler="sobol | owen", frequency_step=0.25, **SMALL),
    ExplorerSetup(bands="dyadic", engine="direct", fit_last="auto", eps=1e-6, **SMALL),
    ExplorerSetup(integrand="technique-sum(integrands=['gaussian', 'disk'])", **SMALL),
    ExplorerSetup(integrand="environment(values=[[[1, 2, 3], [0, 5, 1]]])", channel="1", **SMALL),
]


def ran(program):
    """Run a program; return its names and its output."""
    names: dict[str, object] = {}
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(program, "copied", "exec"), names)  # noqa: S102
    return names, printed.getvalue()


@pytest.mark.filterwarnings("ignore:∫1/p diverges")
@pytest.mark.parametrize("setup", SETUPS)
def test_python_gives_the_numbers_shown(setup):
    names, printed = ran(as_python(ExplorerState(a=setup)))
    for kind in ("predict", "spectrum", "terms", "convergence"):
        shown = compute(kind, setup, setup.realizations)
        for variable in shown:
            np.testing.assert_array_equal(names[kind][variable], shown[variable])
    known = is_resolved(*shown["rate_ci"].values)
    assert (f"{float(shown['rate']):.4g}" if known else "unresolved") in printed


def test_python_of_two_set_ups_has_both():
    names, printed = ran(as_python(ExplorerState(a=SETUPS[4], b=SETUPS[0])))
    assert printed.count("measured_variance") == 2
    assert names["sampler"].spec == "jittered"


@pytest.mark.parametrize("setup", SETUPS)
def test_toml_is_a_study_of_the_same(setup, tmp_path):
    file = tmp_path / "copied.toml"
    file.write_text(as_toml(ExplorerState(a=setup, b=SETUPS[0])), encoding="utf-8")
    study = read_study(file)
    first, second = study.estimators
    assert (first.name, second.name) == ("A", "B")
    assert first.samplers == (setup.displaced_sampler,)
    specs = integrand_specs(setup)
    assert (first.integrands or (first.integrand,)) == specs
    assert first.smoothed == (setup.smoothing or None)
    analyses = analyses_of(setup)
    del analyses["points"]
    assert first.analyses == analyses
    assert set(first.analyses) == {"terms", "convergence", "spectrum", "predict"}
    assert study.seed == setup.seed


def test_toml_runs_and_gives_the_numbers_shown(tmp_path):
    setup = SETUPS[1]
    file = tmp_path / "copied.toml"
    file.write_text(as_toml(ExplorerState(a=setup)), encoding="utf-8")
    run_study(read_study(file), tmp_path / "out", workers=1)
    shown = compute("terms", setup, setup.realizations)
    tree = open_results(tmp_path / "out")
    found = [node["power_term"] for node in tree.subtree if "power_term" in node]
    assert len(found) == 1
    assert found[0].size == 1
    # The study uses another random stream per cell: the same distribution, not the same bits
    assert float(found[0].squeeze()) == pytest.approx(float(shown["power_term"]), rel=1.0)


def test_specs_with_quotes_survive(tmp_path):
    spec = "mixture(parts=['linear(slope=1)', \"tent\"], weights=[0.5, 0.5])"
    state = ExplorerState(a=ExplorerSetup(density=spec, **SMALL))
    assert tomllib.loads(as_toml(state))["estimators"][0]["density"] == spec
    assert repr(spec) in as_python(state)


def test_uploads_are_written_as_files(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))
    data = io.BytesIO()
    np.save(data, np.eye(4))
    digest = keep_upload(data.getvalue(), "picture.npy")
    state = ExplorerState(a=ExplorerSetup(integrand=f"upload(digest='{digest}')", **SMALL))
    names, _ = ran(as_python(state))
    assert names["integrand"].integral == 0.25
    assert "--allow-path" in as_toml(state)
