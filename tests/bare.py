"""Use the package without its extras: ``python tests/bare.py [--hide]`` in an empty folder.

`make test-bare` runs this file in a new environment with the wheel and its required packages. The
tests run it with ``--hide`` in a complete environment: packages of extras then cannot be imported.
"""

import contextlib
import importlib.util
import io
import os
import re
import shlex
import sys
import time
import warnings
from pathlib import Path

EXTRAS = {
    "report": ("bokeh", "jinja2", "latex2mathml", "markupsafe", "tornado"),
    "store": ("zarr", "numcodecs"),
    "cluster": ("distributed", "dask", "cloudpickle", "yaml", "psutil"),
    "render": ("mitsuba", "drjit", "OpenEXR"),
    "frames": ("flip_evaluator", "tevclient"),
    "qmcpy": ("qmcpy",),
    "testing": ("hypothesis",),
}
"""Packages that an environment without extras lacks; pillow stays, because matplotlib needs it."""

GAUSSIAN = "gaussian(width=0.25)"
STUDY = f"""\
title = "Bare"
seed = 1
samplers = ["jittered"]
[convergence]
counts = [4, 16, 64]
realizations = 16
[[estimators]]
name = "gaussian"
integrand = "{GAUSSIAN}"
"""


def hide():
    """Make the packages of extras appear to be missing."""
    sys.modules.update(dict.fromkeys(name for names in EXTRAS.values() for name in names))


def main():
    """Run all steps, and print their times."""
    if "--hide" in sys.argv:
        hide()
    warnings.simplefilter("error")
    for name in [name for names in EXTRAS.values() for name in names]:
        assert importlib.util.find_spec(name) is None, f"{name} is installed"
    os.environ["MCSPECTRA_CACHE"] = str(Path("cache").absolute())
    for step in (python, components, commands, readme, study, frames, refusals):
        start = time.perf_counter()
        step()
        print(f"{step.__name__}: {step.__doc__} {time.perf_counter() - start:.1f} s", flush=True)


def python():
    """Every public name loads; samplers, spectra and variances are computed."""
    import numpy as np

    import mcspectra as mcs

    for package in (mcs, mcs.densities, mcs.integrands, mcs.samplers, mcs.studies, mcs.report):
        for name in package.__all__:
            assert getattr(package, name) is not None
    points = mcs.sampler("sobol | owen", dims=2).draw(16, rng=0)
    assert points.shape == (1, 16, 2)
    power = mcs.power_spectrum("jittered", n=16, realizations=16, rng=0)
    assert power["power"].min() >= 0
    estimator = mcs.Estimator(GAUSSIAN)
    curve = mcs.convergence(estimator, "jittered", [16, 64], realizations=16, rng=0)
    assert curve["variance"][1] < curve["variance"][0]
    terms = mcs.variance_terms(estimator, "jittered", n=16, realizations=16, rng=0)
    assert np.isfinite(terms["power_term"]).all()
    assert np.isclose(mcs.integrate(estimator, budget=1000, rng=0)["value"], 0.358, atol=0.01)
    curve.mcspectra.plot()


def components():
    """Every sampler, density, integrand and analysis without QMCPy loads."""
    from mcspectra.core.analysis import ANALYSES
    from mcspectra.densities import DENSITIES
    from mcspectra.integrands import INTEGRANDS
    from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS

    for registry in (SAMPLERS, RANDOMIZATIONS, DENSITIES, INTEGRANDS, ANALYSES):
        for name in registry:
            registry.load(name)


def command(*arguments, code=0):
    """Run a command in this process; return its output and its errors."""
    from mcspectra.cli.main import main as mcspectra

    with (
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as errors,
    ):
        got = mcspectra(list(map(str, arguments)))
    assert got == code, f"{arguments}: exit code {got}\n{errors.getvalue()}"
    return out.getvalue(), errors.getvalue()


def commands():
    """Commands that need no extra answer, and write text, tables and pictures."""
    jittered = ("--sampler", "jittered")
    command("points", "sobol | owen", "-n", 16, "-o", "points.csv")
    command("points", "jittered", "-n", 16, "-o", "points.png")
    command("spectrum", "jittered", "-n", 16, "-m", 16, "-o", "spectrum.pdf")
    command("pcf", "jittered", "-n", 16, "-m", 4, "-o", "pcf.csv")
    command(*("converge", GAUSSIAN, *jittered, "--counts", "16,64", "-m", 20, "-o", "converge.png"))
    command("variance", GAUSSIAN, *jittered, "-n", 16, "-m", 20)
    command("bench", "jittered", "--counts", "16,64", "-m", 20, "-o", "bench.csv")
    command("predict", GAUSSIAN, *jittered, "--counts", "16,64")
    command("plan", GAUSSIAN, *jittered, "--target-error", "1e-2")
    command("profile", GAUSSIAN, "--budget", 20000)
    command("remedies", GAUSSIAN, *jittered, "--budget", 256, "-m", 100)
    command("design", "lattice", "gaussians", "-n", 64, "-d", 2, "--members", 40)
    command("integrate", GAUSSIAN, "--budget", 1000)
    command("init", "begun.toml")
    assert "sobol" in command("list", "samplers")[0]
    assert "10.1111/cgf.13613" in command("cite")[0]
    found, _ = command("doctor")
    for extra in ("report", "store", "cluster", "render", "frames", "qmcpy"):
        assert "--hide" in sys.argv or f"pip install 'mcspectra[{extra}]'" in found, extra
    written = "points.csv points.png spectrum.pdf pcf.csv converge.png bench.csv begun.toml"
    assert all(Path(name).stat().st_size > 100 for name in written.split())


def readme():
    """The README's three commands run."""
    root = Path(__file__).parents[1]
    here = Path.cwd()
    os.chdir(root)
    asked = re.findall(
        r"^\$ mcspectra (.*)$", (root / "README.md").read_text("utf-8"), re.MULTILINE
    )
    for line in asked:
        command(*shlex.split(line))
    os.chdir(here)
    assert len(asked) == 3


def study():
    """A study runs without its report, and reports this; its results are shown and exported."""
    Path("study.toml").write_text(STUDY, encoding="utf-8")
    out, errors = command("run", "study.toml", "--out", "study")
    assert "jittered" in out
    assert "results: study" in out
    (left_out,) = [line for line in errors.splitlines() if "this run leaves it out" in line]
    assert "pip install 'mcspectra[report]'" in left_out
    assert not Path("study/report.html").exists()
    assert "finished" in command("status", "study")[0]
    command("export", "study", "-o", "study.csv", "-o", "study.zarr")
    assert Path("study.zarr/zarr.json").exists()
    assert "variance" in Path("study.csv").read_text("utf-8")


def frames():
    """Frames of .npy and .pfm files are read."""
    import numpy as np

    rng = np.random.default_rng(0)
    for kind in ("npy", "pfm"):
        Path(kind).mkdir(exist_ok=True)
        for k in range(4):
            pixels = (1.0 + 0.1 * rng.standard_normal((8, 8, 3))).astype("<f4")
            if kind == "npy":
                np.save(f"npy/{k}.npy", pixels)
            else:
                Path(f"pfm/{k}.pfm").write_bytes(b"PF\n8 8\n-1.0\n" + pixels.tobytes())
        assert "σ / mean" in command("frames", f"{kind}/*", "--spp", 16)[0]


def refusals():
    """Features of an extra fail with one sentence that names the command to install it."""
    Path("frame.exr").touch()
    Path("draws.zarr").mkdir(exist_ok=True)
    scene = "veach"
    refused = {
        ("report", "study"): "report",
        ("report", "study", "--compare", "other"): "report",
        ("spectrum", "jittered", "-n", 16, "-o", "page.html"): "report",
        ("bench", "jittered", "-o", "page.html"): "report",
        ("reproduce",): "report",
        ("app",): "report",
        ("profile", "draws.zarr"): "store",
        ("run", "study.toml", "--out", "new", "--time-limit", 100): "cluster",
        ("run", "study.toml", "--out", "new", "--cluster", "local"): "cluster",
        ("frames", "npy/*", "--spp", 16, "--out", "frames"): "frames,report",
        ("frames", "frame.exr", "frame.exr"): "frames",
        ("frames", "npy/*", "--spp", 16, "--tev", "localhost:1"): "frames",
        ("integrate", "environment(path='frame.exr')", "--budget", 100): "frames",
        ("pixel", scene, 1, 1): "render",
        ("pixel", scene, 1, 1, "--out", "pixel"): "render,report",
        ("map", scene, "--out", "map"): "render,report",
        ("render", scene, "-o", "scene.png"): "render",
        ("run", "veach", "--out", "new"): "render",
    }
    for arguments, extra in refused.items():
        _, errors = command(*arguments, code=2)
        (sentence,) = [line for line in errors.splitlines() if "Warning: " not in line]
        wanted = rf"pip install 'mcspectra\[{extra}\]'\.?"
        assert re.fullmatch(rf"mcspectra: .* need.*: {wanted}", sentence), (arguments, sentence)
    for name in ("page.html", "new", "pixel", "map", "scene.png"):
        assert not Path(name).exists(), name

    # Python functions
    import mcspectra as mcs
    from mcspectra.core.errors import MissingDependency
    from mcspectra.report.result_files import write_result

    f = mcs.integrand(GAUSSIAN)
    curve = mcs.convergence(mcs.Estimator(f), "jittered", [4], realizations=8, rng=0)
    for call, extra in (
        (lambda: mcs.report.write_report("study"), "report"),
        (lambda: mcs.report.write_comparison("study", "other"), "report"),
        (lambda: write_result(curve, "page.html"), "report"),
        (lambda: mcs.integrands.Calls(f, dims=2, budget=100, workers=2), "cluster"),
        (lambda: mcs.rendering.variance_map(scene), "render"),
    ):
        said = "nothing"
        try:
            call()
        except MissingDependency as error:
            said = str(error)
        assert f"pip install 'mcspectra[{extra}]'" in said, (extra, said)


if __name__ == "__main__":
    main()
