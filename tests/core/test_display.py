"""What notebooks show: hooks that load nothing from above, and never raise."""

import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.display import html_of, register_accessor


def test_looking_at_an_object_never_raises():
    class Broken(mcs.Integrand):
        dims = 1

        @property
        def spec(self):
            raise RuntimeError("no spec")

        def _evaluate(self, x):
            return x

    assert Broken()._repr_html_() is None
    assert html_of(object()) is not None


@pytest.mark.parametrize("make", ["mcs.sampler('random')", "mcs.Estimator('linear', dims=1)"])
def test_nothing_above_is_loaded_before_something_is_shown(make):
    code = (
        f"import sys; import mcspectra as mcs; c = {make}; x = 'mcspectra.report' in sys.modules; "
    )
    code += "assert c._repr_html_(); print(x, 'mcspectra.report' in sys.modules, "
    code += "any(m in sys.modules for m in ('matplotlib', 'xarray')))"
    done = python("-c", code, check=True)
    assert done.stdout.split() == ["False", "True", "False"]


def test_results_have_the_accessor_and_it_is_registered_once():
    import xarray as xr

    register_accessor()
    before = xr.Dataset.mcspectra
    register_accessor.cache_clear()
    register_accessor()  # a second registration would warn, which is an error here
    assert xr.Dataset.mcspectra is before
