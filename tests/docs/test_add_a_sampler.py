"""The page on adding a sampler: its code runs, from the class to the command line."""

import importlib
import os
import re
from pathlib import Path

import numpy as np
import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.errors import CountError
from mcspectra.testing import check_sampler

PAGE = (Path(__file__).parents[2] / "docs" / "add-a-sampler.md").read_text(encoding="utf-8")
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
NAMES = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL).group(1)


@pytest.fixture(scope="module")
def antithetic(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "antithetic.py").write_text(CODE[0], encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield importlib.import_module("antithetic").Antithetic


def test_the_sampler_takes_twenty_lines():
    lines = [line for line in CODE[0].splitlines() if line.strip()]
    assert len(lines) <= 20


def test_the_sampler_satisfies_the_contract(antithetic):
    for dims in (1, 2, 5):
        check_sampler(antithetic(dims=dims))


def test_the_calls_on_the_page_run(antithetic):
    *calls, refused = CODE[1].strip().splitlines()
    for call in calls:
        eval(call, {"mcs": mcs, "Antithetic": antithetic})
    with pytest.raises(CountError) as error:
        eval(refused.partition("#")[0], {"Antithetic": antithetic})
    shown = refused.partition("CountError: … ")[2]
    assert str(error.value).endswith(shown)
    x = antithetic().draw(16, rng=1)[0]
    np.testing.assert_allclose(x[:8] + x[8:], 1.0)
    curve = mcs.convergence(mcs.Estimator("linear(gradient=[1, 1])"), antithetic(), [4])
    assert float(curve["variance"][0]) < 1e-30  # the pairs cancel for a plane


def test_the_command_line_finds_the_sampler_by_its_entry_point(tmp_path):
    (tmp_path / "antithetic.py").write_text(CODE[0], encoding="utf-8")
    info = tmp_path / "antithetic-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: antithetic\nVersion: 1\n")
    group, entry = re.search(r'entry-points\."(.*?)"\]\n(.*)', NAMES).groups()
    (info / "entry_points.txt").write_text(f"[{group}]\n{entry.replace(chr(34), '')}\n")
    arguments = ("points", "antithetic | shift", "-n", "16", "--json")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = python("-m", "mcspectra", *arguments, env=environment, check=True)
    assert '"sampler": "antithetic | shift"' in done.stdout


def test_the_law_predicts_the_variance():
    names = {}
    exec(CODE[0] + CODE[2], names)  # noqa: S102
    slabs = names["Slabs"]()
    check_sampler(slabs, counts=(4, 16))
    for sampler in (slabs, slabs.then(mcs.samplers.Shift())):
        exact = mcs.exact_variance("gaussian", sampler, 16, tolerance=1e-3)
        curve = mcs.convergence("gaussian", sampler, [16], realizations=1000, rng=2)
        low, high = curve["variance_ci"].values[0]
        assert low < exact < high
