"""Reports of the terms of several samplers at once."""

import pytest

import mcspectra as mcs
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.report.result_files import write_result, write_result_file


@pytest.mark.usefixtures("undrawn")
def test_plots_pages_and_sentences_have_every_sampler(tmp_path):
    f = mcs.integrand("gaussian", dims=1)
    samplers = ["jittered", "random"]
    found = mcs.variance_terms(
        f, samplers, 16, cross_matrix=True, half_width=4, realizations=50, rng=3
    )
    for kind in kinds_of(found):
        assert all(sampler in describe(kind, found).words for sampler in samplers), kind
    assert {"terms", "captured", "contributions", "bands", "cross-matrix"} <= set(kinds_of(found))
    found.mcspectra.plot("terms")
    said = found.mcspectra.summary()
    page = write_result(found, tmp_path / "page.html").read_text(encoding="utf-8")
    write_result_file(found, str(tmp_path / "table.csv"), "")
    table = (tmp_path / "table.csv").read_text(encoding="utf-8")
    for sampler in samplers:
        assert f"{sampler}: " in said
        assert sampler in page
        assert f"\n{sampler}," in table
