"""The noise of whole paths: parts that sum to the variance, padding, the verb and its page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError
from mcspectra.rendering import path_pixel
from mcspectra.studies import analyse_path

pytestmark = pytest.mark.render

SCENE, X, Y = "penumbra(width=16, height=12)", 8, 9
PATH = "path(max_depth=3, rr_depth=2)"
SAMPLERS = ("random", "sobol | owen")


@pytest.fixture(scope="module")
def tree() -> xr.DataTree:
    return analyse_path(
        SCENE, X, Y, integrator=PATH, samplers=SAMPLERS, counts=(64, 256), realizations=200, rng=3
    )


def test_shares_by_bounce_sum_to_the_variance_of_a_path(tree: xr.DataTree) -> None:
    parts = tree["anova/bounce"].to_dataset()
    assert parts["axis_label"].values.tolist() == ["camera", "bounce 1", "bounce 2", "bounce 3"]
    whole = parts["anova_share"].sum() + parts["higher_order_share"]
    assert float(whole) == pytest.approx(1.0, abs=1e-12)
    # The same variance by the values of other random paths, 5 standard errors of both
    f = path_pixel(SCENE, X, Y, integrator=PATH)
    values = f(np.random.default_rng(17).random((2**17, f.dims)))
    deviation = (values - values.mean()) ** 2
    total = parts["anova_variance"].sum() + parts["higher_order_variance"]
    count = parts.attrs["realizations"]
    error = deviation.std() * np.hypot(len(values) ** -0.5, count**-0.5)
    assert abs(float(total) - deviation.mean()) < 5 * error
    # What a path of three turns draws in the last one is not used
    assert float(parts["total_share"][3]) == 0.0
    assert float(parts["total_share"][1]) > 0.5


def test_groupings_agree(tree: xr.DataTree) -> None:
    # Up to the end of each bounce: the same numbers kept, however they are grouped
    bounce, request = (tree[f"anova/{kind}"].to_dataset() for kind in ("bounce", "request"))
    names = request["axis_label"].values.tolist()
    last = [
        k for k, n in enumerate(names) if n in ("film", "bounce 1 roulette", "bounce 2 roulette")
    ]
    np.testing.assert_allclose(
        request["truncation_share"].values[last], bounce["truncation_share"].values[:3], atol=1e-12
    )
    of_all = tree["anova/decision"]["axis_label"].values.tolist()
    assert of_all == ["film", "light", "lobe", "direction", "roulette"]


def test_padding_ends_at_all_coordinates_and_starts_near_random_points(tree: xr.DataTree) -> None:
    padding, curves = tree["padding"].to_dataset(), tree["convergence"].to_dataset()
    assert padding["dims"].values.tolist() == [2, 8, 14, 20]
    sobol, random = (curves.sel(sampler=s)["variance"].values for s in reversed(SAMPLERS))
    assert np.array_equal(padding["variance"].values[-1], sobol)
    # The film alone makes next to nothing of the noise: as random points, within intervals
    low, high = padding["variance_ci"].isel(dims=0, n=-1).values
    assert low / 1.3 < random[-1] < high * 1.3
    assert padding["variance"].values[1, -1] < 0.5 * random[-1]


def test_a_sampler_with_a_count_it_lacks_is_refused_first() -> None:
    with pytest.raises(mcs.McspectraError, match="jittered"):
        analyse_path(SCENE, X, Y, integrator=PATH, samplers=["jittered"], counts=(64, 256))
    with pytest.raises(ParameterError, match="at a time"):
        analyse_path(SCENE, X, Y, integrator=PATH, channel="rgb")
    with pytest.raises(ParameterError, match="ascending"):
        analyse_path(SCENE, X, Y, integrator=PATH, counts=(64,))


def test_the_verb_prints_writes_and_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tree: xr.DataTree, monkeypatch: Any
) -> None:
    monkeypatch.setattr("mcspectra.studies.path.analyse_path", lambda *_, **__: tree)
    asked = ["pixel", SCENE, str(X), str(Y), "--integrator", PATH]
    assert main([*asked, "--json", "--out", str(tmp_path / "out")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["pixel"]["dims"] == 20
    assert {"by bounce", "by decision", "sampler", "padding"} <= printed["sentences"].keys()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Good coordinates" in page
    assert "bounce 1 light" in page
    assert main(asked) == 0
    assert "20 random numbers a path" in capsys.readouterr().out
    assert main([*asked, "--light", "lamp"]) == 2
    assert "--light is for direct light" in capsys.readouterr().err
