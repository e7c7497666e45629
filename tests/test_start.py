"""Starting is quick: no slow module is imported before it is needed.

The times are in docs/evidence.md, from ``python -m benchmarks start``: a timed test would depend on
the load of the machine.
"""

import pytest

from tests.processes import python

HEAVY = ("numpy", "scipy", "numba", "xarray", "pandas", "zarr", "matplotlib", "mitsuba", "finufft")


@pytest.mark.parametrize(
    "code", ["import mcspectra", "from mcspectra.cli.main import main; main(['--help'])"]
)
def test_nothing_heavy_is_imported(code):
    check = f"import sys; {code}; print([m for m in {HEAVY} if m in sys.modules], file=sys.stderr)"
    done = python("-c", check, check=True)
    assert done.stderr.strip().endswith("[]")


def test_every_public_name_loads():
    import mcspectra as mcs

    for name in mcs.__all__:
        assert getattr(mcs, name) is not None


def test_no_module_hides_a_function_of_its_package():
    # A module with the name of a function would replace it as soon as it is imported
    code = """
import pkgutil, mcspectra as mcs
for name in ("spectra", "measure", "prediction", "explain", "improve", "profiler"):
    package = getattr(mcs, name)
    modules = {each.name for each in pkgutil.iter_modules(package.__path__)}
    print(name, sorted(modules & set(package.__all__)))
    print(name, [each for each in package.__all__ if not callable(getattr(package, each))])
"""
    lines = python("-c", code, check=True).stdout.splitlines()
    assert len(lines) == 12
    assert all(line.endswith(" []") for line in lines)
