"""Every public function with one argument of a wrong type at a time: a sentence, and no hang."""

import inspect
import signal
import threading
import warnings
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra import (
    densities,
    estimators,
    integrands,
    quality,
    rendering,
    report,
    samplers,
    studies,
    testing,
)
from mcspectra.core import analysis
from mcspectra.core.errors import McspectraError
from mcspectra.measure.converge import Convergence
from mcspectra.studies import files, results

WRONG = [
    None,
    3,
    -1,
    2.5,
    "nonsense",
    b"x",
    [],
    {},
    [1, "a"],
    np.zeros((2, 0)),
    float("nan"),
    object(),
    True,
    lambda x: x,
    "\ud800",
    "\0",
]
# Valid arguments for the others, so that the wrong one is found soon or the call is short
RIGHT = {
    "budget": 256,
    "counts": [4, 16, 64],
    "densities": ["uniform", "linear"],
    "density": "linear(slope=0.5)",
    "estimator": "gaussian",
    "f": "gaussian",
    "frequencies": np.array([[1, 2], [0, 1]]),
    "half_width": 4,
    "integrand": "gaussian",
    "integrands": ["linear", "gaussian"],
    "kind": "lattice",
    "n": 16,
    "objective": "gaussian",
    "realizations": 20,
    "sampler": "jittered",
    "samplers": ["jittered"],
    "spec": None,
    "subset": (0,),
}
ESTIMATORS = ("ChannelSampling", "OneSampleMIS", "TechniqueSum", "channel_estimators")
ALWAYS = {"realizations", "half_width"}  # also used instead of the default, which may take long
SECONDS = 20  # processor seconds for a call, including compilation of kernels


def _functions():
    names = [*mcs.__all__, *(f"estimators.{name}" for name in ESTIMATORS), "quality.warp_quality"]
    for package in ("spectra", "measure", "prediction", "explain", "improve", "profiler"):
        own = getattr(mcs, package).__all__
        names += [f"{package}.{name}" for name in own if name not in mcs.__all__]
    for name in sorted(names):
        found = attrgetter(name)(mcs)
        error = isinstance(found, type) and issubclass(found, Exception)
        if callable(found) and not error and not name.startswith("_"):
            yield name


def _parameters(function):
    try:
        found = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return []
    return [p for p in found if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]


class Hang(BaseException):
    """A call took too long."""


def _end(*_):
    raise Hang


@pytest.fixture(autouse=True)
def alone(tmp_path, monkeypatch):
    """An empty folder, because texts may be file names, and an alarm for calls that hang."""
    monkeypatch.chdir(tmp_path)
    before = signal.signal(signal.SIGPROF, _end)
    yield
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.signal(signal.SIGPROF, before)


def _call(function, parameters, arguments):
    """Return the error of a call that is not a clear rejection; otherwise None."""
    named = dict(arguments)
    placed = [named.pop(p.name) for p in parameters if p.kind is p.POSITIONAL_ONLY]
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        function(*placed, **named)
    except McspectraError as error:
        return None if str(error) else "says nothing"
    except Hang:
        return "hangs"
    except Exception as error:  # noqa: BLE001 - any error is reported
        return f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return None


# Documented functions of other modules, with valid other arguments: they are rejected before
# anything is read or computed, or name a missing file
DOORS = (
    (studies.open_results, {"source": "no", "select": "a/*"}),
    (studies.result_paths, {"source": "no"}),
    (studies.result_scalars, {"source": "no", "select": "a/*"}),
    (studies.study_status, {"folder": "no"}),
    (studies.export_results, {"source": "no", "file": "no.csv", "select": "a/*"}),
    (results.output_folder, {"out": "no"}),
    (studies.read_study, {"path": "no.toml", "overrides": ()}),
    (studies.decode_study, {"text": "", "overrides": ()}),
    (studies.make_plan, {"config": None, "folder": "."}),
    (studies.run_study, {"config": None, "out": "no"}),
    (studies.estimate_study, {"plan": None}),
    (studies.summarize, {"tree": None}),
    (files.study_of, {"table": {}}),
    (files.plain_study, {"config": None}),
    (files.expand_grids, {"table": {}}),
    (densities.check_density, {"density": "linear"}),
    (densities.reciprocal_integral, {"density": "linear"}),
    (integrands.fourier_accuracy, {"integrand": "linear", "half_width": 2}),
    (integrands.fourier_grid, {"integrand": "linear", "half_width": 2}),
    (integrands.integral_accuracy, {"integrand": "linear"}),
    (integrands.Channel, {"integrand": "linear", "channel": 0}),
    (quality.summarize, {"figures": None}),
    (rendering.render_file, {"scene": "no.xml", "definitions": {}, "out": None}),
    (report.explain, {"row": studies.SummaryRow(estimator="a", sampler="b"), "terms": None}),
    (report.summary_table, {"rows": [], "analyses": None, "links": None}),
    (report.terms_table, {"rows": []}),
    (report.write_comparison, {"first": "no", "second": "other", "out": None}),
    (report.write_report, {"folder": "no", "out": None}),
    (testing.check_analysis, {"analysis": Convergence(counts=(4, 16), realizations=50)}),
    (testing.check_sampler, {"sampler": "jittered", "counts": (4,)}),
    (analysis.compute, {"analysis": None, "subject": None}),
)


@pytest.mark.parametrize(
    ("function", "right"), [pytest.param(*door, id=door[0].__name__) for door in DOORS]
)
def test_documented_functions_reject_wrong_types(function, right):
    parameters = _parameters(function)
    found = []
    for name in right:
        for wrong in WRONG:
            problem = _call(function, parameters, {**right, name: wrong})
            if problem is not None:
                found.append(f"{function.__name__}({name}={wrong!r:.40}) {problem}")
    assert not found, "\n".join(found)


def test_a_study_is_checked_before_its_folder_is_created():
    config = studies.decode_study(
        'title = "t"\nseed = 1\nsamplers = ["random"]\npredict = {counts = [4]}\n'
        '[[estimators]]\nname = "a"\nintegrand = "gaussian"\n'
    )
    for wrong in (None, 3, "\0", "\ud800"):
        with pytest.raises(McspectraError, match="give the path of the study's folder"):
            studies.run_study(config, "out", folder=wrong)
    assert not list(Path().iterdir())


@pytest.mark.skipif(
    not hasattr(signal, "SIGPROF") or threading.current_thread() is not threading.main_thread(),
    reason="needs alarms",
)
@pytest.mark.parametrize("name", list(_functions()))
def test_wrong_types_are_refused_with_a_sentence(name):
    function = attrgetter(name)(mcs)
    parameters = _parameters(function)
    right = {
        p.name: RIGHT.get(p.name, 1) for p in parameters if p.default is p.empty or p.name in ALWAYS
    }
    right |= {"remedies": {"realizations": 100}, "sampler_bench": {"counts": [4, 16]}}.get(name, {})
    found = []
    for parameter in parameters:
        for wrong in WRONG:
            if wrong is True and isinstance(parameter.default, bool):
                continue  # valid, and `exact` may take minutes
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                problem = _call(function, parameters, {**right, parameter.name: wrong})
            if problem is not None:
                found.append(f"{name}({parameter.name}={wrong!r:.40}) {problem}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("package", "name"),
    [
        (samplers, "Structure"),
        (samplers, "sampler_from_calls"),
        (estimators, "Combination"),
        (estimators, "Moments"),
        (densities, "as_warp"),
    ],
)
def test_internal_names_are_not_public(package, name):
    assert not hasattr(package, name)
