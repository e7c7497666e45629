"""The pages on adding a density and an integrand: their code runs as described."""

import importlib
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.testing import BrokenContract, check_density, check_integrand

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {
    "add-a-density": ("kumaraswamy", "Kumaraswamy", "densities"),
    "add-an-integrand": ("triangle_wave", "TriangleWave", "integrands"),
}


@pytest.fixture(params=PAGES)
def page(request, tmp_path_factory):
    """Return the text, the blocks of code, and the page's class, imported from a file."""
    module, name, family = PAGES[request.param]
    text = (DOCS / f"{request.param}.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    folder = tmp_path_factory.mktemp("own")
    (folder / f"{module}.py").write_text(code[1], encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        cls = getattr(importlib.import_module(module), name)
        names = {"mcs": mcs, "np": np, name: cls, "check_density": check_density}
        names["check_integrand"] = check_integrand
        yield SimpleNamespace(
            text=text, code=code, folder=folder, module=module, family=family, names=names
        )
        sys.modules.pop(module)


def test_pages_are_short(page):
    assert len(page.text.splitlines()) <= 70


def test_functions_are_enough(page):
    exec(page.code[0], page.names)  # noqa: S102
    for name in {"p", "q", "f"} & set(page.names):
        made = page.names[name]
        (check_integrand if name == "f" else check_density)(made)


def test_the_checks_pass_or_fail_as_on_the_page(page):
    *sound, broken = page.code[2].strip().splitlines()
    for line in sound:
        exec(line, page.names)  # noqa: S102
    assert broken.endswith("# BrokenContract: …")
    with pytest.raises(BrokenContract):
        exec(broken, page.names)  # noqa: S102


def test_uses_in_the_text_work(page):
    (use,) = re.findall(r"`(mcs\.(?:Estimator|convergence)\(.*?)`", page.text)
    assert eval(use, page.names) is not None


def test_the_command_line_lists_the_class_by_its_entry_point(page, capsys):
    info = page.folder / "own-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1\n")
    toml = re.search(r"```toml\n(.*?)```", page.text, re.DOTALL).group(1)
    group, entry = re.search(r'entry-points\."(.*?)"\]\n(.*)', toml).groups()
    (info / "entry_points.txt").write_text(f"[{group}]\n{entry.replace(chr(34), '')}\n")
    assert main(["list", page.family]) == 0
    assert entry.partition(" ")[0] in capsys.readouterr().out
