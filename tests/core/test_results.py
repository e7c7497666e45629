"""Results: registered variables, attributes that every format can store, strict JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from mcspectra.core.results import VARIABLES, attributes_of, dataset, strict_json


@pytest.mark.parametrize(
    ("name", "kind", "units", "dims"),
    [
        ("power", "f", "1", ("m", "frequency?")),
        ("power_se", "f", "1", ("m", "frequency?")),
        ("rate_ci", "f", "1", ("remedy?", "strategy?", "y?", "x?", "bound")),
        ("mean_coefficient", "c", "1", ("m", "frequency?")),
        ("cross_matrix", "fc", "f²", ("m", "l")),
        ("noise_edge", "f", "f²", ()),
        ("image", "f", "W/(m² sr)", None),
    ],
)
def test_the_table_of_variables_is_read(name, kind, units, dims):
    found = VARIABLES[name]
    assert (found.kind, found.units, found.dims) == (kind, units, dims)
    assert VARIABLES["power_contribution"].meaning.startswith("|f_m|² C_mm, the diagonal")
    assert "\\" not in "".join(each.meaning for each in VARIABLES.values())


def test_attributes_are_numbers_texts_or_json():
    found = attributes_of(n=np.int64(4), eps=0.5, sampler="random", counts=(1, 2), density=None)
    assert found == {"n": 4, "eps": 0.5, "sampler": "random", "counts": "[1, 2]"}
    assert type(found["n"]) is int
    assert dataset({}, n=4).attrs["n"] == 4


def test_values_outside_strict_json_become_null_or_text():
    given = {
        1: [float("nan"), -np.inf, 2.5],
        "array": np.array([[1, 2], [3, 4]]),
        "number": np.float32(0.5),
        "complex": 1 + 2j,
        "path": Path("a") / "b",
        "tuple": (True, None, "text"),
    }
    assert json.loads(json.dumps(strict_json(given), allow_nan=False)) == {
        "1": [None, "-inf", 2.5],
        "array": [[1, 2], [3, 4]],
        "number": 0.5,
        "complex": {"re": 1.0, "im": 2.0},
        "path": str(Path("a") / "b"),
        "tuple": [True, None, "text"],
    }
