"""Maps in tiles that are measured apart: the same bits as at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from tests.staging import check_cuts, run_sizes

from mcspectra.core.errors import ParameterError
from mcspectra.core.staged import compute
from mcspectra.rendering import _map_tiles as tiles
from mcspectra.rendering import variance_map
from mcspectra.rendering.maps import staged_map
from mcspectra.studies import open_results, run_study
from mcspectra.studies.files import decode_study

pytestmark = pytest.mark.render

SMALL: dict[str, Any] = {
    "strategies": ("light", "bsdf", "mis"),
    "counts": (4, 16),
    "realizations": 8,
    "size": (8, 6),
    "crop": (1, 0, 7, 6),
    "predict_every": 2,
    "rng": 3,
}


def test_tiles_measured_apart_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "TILE_LANES", 8 * 8)  # eight pixels, which cross rows

    def public(workers: int) -> xr.Dataset:
        return variance_map("penumbra", **SMALL, workers=workers)

    found = check_cuts(lambda: staged_map("penumbra", **SMALL), public, monkeypatch, 2**21, 6)
    assert float(found["variance"].max()) > 0
    monkeypatch.undo()
    whole = staged_map("penumbra", **SMALL)
    assert run_sizes(whole) == [1]
    xr.testing.assert_identical(compute(whole, 1), found)


def test_a_study_cuts_a_map_into_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "TILE_LANES", 8 * 8)
    study = """
title = "map"
seed = 3
samplers = ["jittered"]
[[maps]]
name = "m"
scene = "penumbra"
strategies = ["light", "bsdf", "mis"]
counts = [4, 16]
realizations = 8
size = [8, 6]
crop = [1, 0, 7, 6]
predict_every = 2
"""
    run_study(decode_study(study), tmp_path, workers=2)
    stored = open_results(tmp_path)["m/jittered/map"]
    direct = variance_map("penumbra", **SMALL)
    for name in direct.data_vars:
        assert np.array_equal(stored[name], direct[name], equal_nan=True), name


@pytest.mark.parametrize(
    "changes",
    [
        {"realizations": 1},
        {"counts": (16, 4)},
        {"counts": (4, float("nan"))},
        {"crop": (0, 0, 9, 9)},
        {"smoothing": 2},
        {"dims": 4},
        {"size": (10**9, 10**9), "crop": None},
    ],
)
def test_bad_input_is_refused_before_anything_runs(changes: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        staged_map("penumbra", **{**SMALL, **changes})
