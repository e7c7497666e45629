"""An untrusted study runs no code, reads no files elsewhere, and cannot leave the store."""

import hashlib
import sys

import numpy as np
import pytest

from mcspectra.core.analysis import Analysis
from mcspectra.core.errors import ConfigError, ParameterError
from mcspectra.core.spec import parse_chain
from mcspectra.studies import Trust, make_plan, run_study
from mcspectra.studies.files import decode_study
from mcspectra.studies.vetting import Vetting

STUDY = """
title = "t"
samplers = ["random"]
[convergence]
counts = [4]
realizations = 10
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""
CODE = "\"python(function='strangers:f')\""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module that writes a mark file when it is imported."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "strangers.py").write_text(
        f"open({str(tmp_path / 'mark')!r}, 'w').close()\n"
        "def f(x):\n    return 2 * x[..., 0]\nvalue = 3\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    yield tmp_path / "mark"
    sys.modules.pop("strangers", None)


def _with(old, new):
    assert old in STUDY
    return decode_study(STUDY.replace(old, new))


def test_code_is_imported_only_if_allowed(module, tmp_path):
    config = _with('"linear"', CODE)
    with pytest.raises(ConfigError, match="--allow-code strangers:f"):
        make_plan(config, tmp_path)
    with pytest.raises(ConfigError, match="--allow-code strangers:f"):
        make_plan(config, tmp_path, Trust(code=("strangers:other",)))
    assert not module.exists()
    estimator = make_plan(config, tmp_path, Trust(code=("strangers:f",))).cells[0].subject.estimator
    assert module.exists()
    assert estimator.primary_values(0, np.array([[0.25]])) == 0.5
    assert estimator.dims == 1


def test_a_module_next_to_the_study_is_not_found(tmp_path):
    (tmp_path / "beside.py").write_text("def f(x): return x[..., 0]\n")
    config = _with('"linear"', "\"python(function='beside:f')\"")
    with pytest.raises(ConfigError, match="cannot be imported"):
        make_plan(config, tmp_path, Trust(code=("beside:f",)))


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("python(function='strangers:value')", "not a function"),
        ("python(function='strangers:none')", "cannot be imported"),
        ("python(function='strangers')", "module:function"),
        ("python(function='os;x:f')", "module:function"),
        ("python(function=3)", "module:function"),
        ("python(code='1')", "function='module:function'"),
        ("python", "function='module:function'"),
    ],
)
def test_invalid_functions_are_refused(module, tmp_path, spec, words):
    trust = Trust(code=("strangers:value", "strangers:none"))
    with pytest.raises(ConfigError, match=words):
        make_plan(_with('"linear"', f'"{spec}"'), tmp_path, trust)


def test_densities_and_samplers_cannot_be_functions(module, tmp_path):
    trust = Trust(code=("strangers:f",))
    with pytest.raises(ConfigError, match="only integrands"):
        make_plan(_with("dims = 1", f"dims = 1\ndensity = {CODE}"), tmp_path, trust)
    with pytest.raises(ConfigError, match="--allow-code strangers:f"):
        make_plan(_with('["random"]', f"[{CODE}]"), tmp_path)
    assert not module.exists()


def test_samplers_of_code_are_allowed_by_name(tmp_path, monkeypatch):
    folder = tmp_path / "study"
    folder.mkdir()
    (tmp_path / "my_points.py").write_text("def draw(n, rng):\n    return rng.random((n, 1))\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    program = folder / "mine"
    program.write_text(
        f"#!{sys.executable}\nimport sys\n"
        "n = int(sys.argv[1])\n"
        "print('\\n'.join(str((k + int(sys.argv[2]) / 2**31) / n) for k in range(n)))\n"
    )
    program.chmod(0o755)
    specs = "[\"python('my_points:draw')\", \"command('./mine {n} {seed}', dims=1, name='mine')\"]"
    config = _with('["random"]', specs)
    for code in ((), ("my_points:draw",), ("./mine {n} {seed}",)):
        with pytest.raises(ConfigError, match="--allow-code"):
            make_plan(config, folder, Trust(code=code))
    plan = make_plan(config, folder, Trust(code=("my_points:draw", "./mine")))
    # The program lies in the study's folder, independent of the working folder; both are inputs
    assert plan.inputs["mine"] == hashlib.sha256(program.read_bytes()).hexdigest()
    assert "module my_points" in plan.inputs
    by_inputs = {cell.inputs: cell.subject.sampler for cell in plan.cells}
    points = by_inputs[("mine",)].draw(4, realizations=2, rng=1)
    offsets = (4 * points[..., 0]) % 1.0
    np.testing.assert_allclose(offsets, offsets[:, :1].repeat(4, axis=1))


def test_a_program_is_not_searched_in_the_working_folder(tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    program = elsewhere / "mine"
    program.write_text("#!/bin/sh\necho 0.5\n")
    program.chmod(0o755)
    monkeypatch.chdir(elsewhere)
    config = _with('["random"]', "[\"command('./mine {seed}', dims=1)\"]")
    (cell, *_) = make_plan(config, tmp_path, Trust(code=("./mine",))).cells
    with pytest.raises(ParameterError, match="cannot be run: No such file"):
        cell.subject.sampler.draw(1)


@pytest.mark.parametrize("name", ["strangers", "a b:c", "a:b()", "", ":", "a:b:c"])
def test_allowances_are_checked(name):
    with pytest.raises(ConfigError, match="module:function"):
        Trust(code=(name,))


@pytest.fixture
def places(tmp_path):
    """A study's folder with a point set inside, one outside, and links to the latter."""
    folder, outside = tmp_path / "study", tmp_path / "outside"
    (folder / "sub").mkdir(parents=True)
    outside.mkdir()
    for file in (folder / "sub/in.dat", outside / "out.dat"):
        np.savetxt(file, np.linspace(0, 0.9, 4)[:, None])
    (folder / "link.dat").symlink_to(outside / "out.dat")
    (folder / "loop.dat").symlink_to(folder / "loop.dat")
    return folder, outside


def _points(path):
    return _with('["random"]', f"[\"points(path='{path}') | shift\"]")


def test_files_are_read_below_the_studys_folder(places):
    folder, outside = places
    for path in ("sub/in.dat", "./sub/../sub/in.dat", folder / "sub/in.dat"):
        assert make_plan(_points(path), folder).cells
    for path in ("../outside/out.dat", outside / "out.dat", "link.dat", "loop.dat"):
        with pytest.raises(ConfigError, match=r"outside the study's folder.*--allow-path"):
            make_plan(_points(path), folder)
    for path in ("../outside/out.dat", outside / "out.dat", "link.dat"):
        assert make_plan(_points(path), folder, Trust(folders=(outside,))).cells


def test_files_inside_lists_and_inner_specs_are_found(places):
    vetting = Vetting(places[0], Trust())
    ((inside,), names) = vetting.calls("points(path=['sub/in.dat', 'sub/in.dat'])")
    assert inside.arguments["path"] == [str(places[0] / "sub/in.dat")] * 2
    assert names == ("sub/in.dat",)
    ((inner,), _) = vetting.calls("defensive(density=\"image(path = 'sub/in.dat', channel=0)\")")
    path = str(places[0] / "sub/in.dat")
    assert inner.arguments["density"] == f"image(path={path!r}, channel=0)"
    for spec in (
        "mixture(densities=['uniform', \"image(path='/etc/passwd')\"])",
        "defensive(density=\"image(path='../x.png')\")",
        'defensive(density="defensive(density=\'image(path=\\"../x.png\\")\')")',
        "points(path=['sub/in.dat', '/etc/passwd'])",
        "points(path=[['../x']])",
        "digital-net(matrices='../net.txt')",
        "qmcpy(generator='DigitalNetB2', options={'generating_matrices': '../x.txt'})",
        "qmcpy(generator='Lattice', options={'generating_vector': '../x.npy'})",
        "pixel(scene={'sky': {'type': 'envmap', 'filename': '../sky.exr'}}, x=0, y=0)",
        "pixel(scene='../scene.xml')",
        "pixel(scene='/elsewhere/scene')",
    ):
        with pytest.raises(ConfigError, match="outside the study's folder"):
            vetting.calls(spec)


@pytest.mark.parametrize(
    "spec",
    [
        "digital-net(matrices=[['10', '01'], ['01', '10']])",
        "mixture(densities=['uniform', 'linear(slope=[1, 2])'], weights=[0.25, 0.75])",
        "image(path=None, pixels=[[1, 2]])",
        "linear(note='(not a spec')",
    ],
)
def test_specs_without_files_stay_as_they_are(places, spec):
    assert Vetting(places[0], Trust()).calls(spec) == (parse_chain(spec), ())


class _Scene(Analysis, frozen=True, kw_only=True):
    """An analysis whose options name files, as another package could register."""

    scene: str
    proposals: tuple[str, ...] = ()


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ("veach", "veach"),
        ("sky(turbidity=3)", "sky(turbidity=3)"),
        ("sub/room.XML", "{folder}/sub/room.XML"),
    ],
)
def test_options_that_are_scenes_are_names_or_files(places, scene, expected):
    found, _ = Vetting(places[0], Trust()).options(_Scene(scene=scene))
    assert found == _Scene(scene=expected.format(folder=places[0]))


def test_options_that_are_specs_are_checked_as_specs(places):
    vetting = Vetting(places[0], Trust())
    given = _Scene(scene="veach", proposals=("uniform", "image(path='sub/in.dat')"))
    found, names = vetting.options(given)
    assert found.proposals == ("uniform", f"image(path='{places[0]}/sub/in.dat')")
    assert names == ("sub/in.dat",)
    with pytest.raises(ConfigError, match="outside the study's folder"):
        vetting.options(_Scene(scene="veach", proposals=("image(path='../x.png')",)))


@pytest.mark.parametrize(
    "name", ["../../evil", "/etc/passwd", "..", "zarr.json", "c", "\u2028", "C:\\x"]
)
def test_hostile_names_stay_in_the_store(tmp_path, name):
    text = STUDY.replace('"a"', f"'{name}'")
    folder = tmp_path / "x" / "y"
    run_study(decode_study(text), folder / "out", workers=1)
    assert [p.name for p in tmp_path.iterdir()] == ["x"]
    assert [p.name for p in folder.iterdir()] == ["out"]
    names = {"results.zarr", "study.lock", "study.sqlite"}
    assert {p.name for p in (folder / "out").iterdir()} == names
    (cell,) = make_plan(decode_study(text), tmp_path).cells
    assert (folder / "out/results.zarr" / cell.path / "variance").is_dir()
    assert all(part.strip(".") for part in cell.path.split("/"))
