"""The page of one result: sentences, and values with intervals and methods."""

import html
import re

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.plots.kinds import describe
from mcspectra.report.result_files import write_result


@pytest.fixture
def shown(tmp_path, undrawn):
    """Write a page without figures and return its text without markup."""

    def write(result):
        page = write_result(result, tmp_path / "page.html").read_text(encoding="utf-8")
        page = re.sub(r"<(script|style).*?</\1>", "", page, flags=re.DOTALL)
        return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", page)))

    return write


def test_predictions_are_listed_with_their_methods(shown):
    found = mcs.predict("disk", ["random", "rank1-lattice | shift", "sobol"], [16, 64])
    words = shown(found)
    assert "sobol: a deterministic sampler has no variance" in words
    assert "sampler predicted rate limit rate bend n random −1.00 −1.00 –" in words
    for sampler in ("random", "rank1-lattice | shift"):
        for n in (16, 64):
            one = found.sel(sampler=sampler, n=n)
            method = f"{one['method'].item()} {one['how'].item()}"
            assert re.search(rf"{re.escape(sampler)} {n} [^a-z]* {re.escape(method)}", words)
    assert "sobol 16" not in words


def test_all_methods_have_rows_by_n(shown):
    found = mcs.predict("gaussian", "jittered", [16, 64], method="all", realizations=30)
    words = shown(found)
    assert "method n predicted variance" in words
    for n in (16, 64):
        assert re.search(rf"levels {n} [^a-z]* strata", words)
        assert re.search(rf"measured {n} [^a-z]* 30 realizations", words)
    assert "torus 16" not in words


def test_a_plan_has_n_in_its_table_and_its_figure(shown):
    found = mcs.plan("gaussian", ["sobol | owen", "random"], target_error=1e-2)
    words = shown(found)
    for sampler in ("sobol | owen", "random"):
        n = int(found["planned_n"].sel(sampler=sampler))
        assert f"{sampler} {n} " in words
        assert f"{sampler}: n = {n:,}" in str(describe("prediction", found))
    assert "bends" not in describe("prediction", found).caption


def test_infinite_predictions_are_named(shown):
    f = mcs.integrand("formula(expression='1/x')", dims=1)
    found = mcs.predict(f, ["random", "jittered"], [4, 16])
    assert "random 4 ∞ " in shown(found)
    assert "random: infinite" in str(describe("prediction", found))


def test_unresolved_rates_are_not_reported(shown):
    found = mcs.convergence("gaussian", "random", [16, 64], realizations=5)
    assert np.diff(found["rate_ci"]) > 1
    assert "rate unresolved" in shown(found)
