"""Out-of-range parameters of stochastic and optimized samplers are refused by name."""

import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.samplers import SAMPLERS, sampler

NAN, INF = float("nan"), float("inf")
PLANE = [
    name for name in SAMPLERS if SAMPLERS.load(name).min_dims == SAMPLERS.load(name).max_dims == 2
]


@pytest.mark.parametrize(
    ("name", "parameter", "values"),
    [
        ("box-jitter", "width", [-0.1, 1001, NAN, INF, "1", True, None, [1, 2]]),
        ("gaussian-jitter", "width", [-0.1, 1001]),
        ("regular", "position", ["middle", None]),
        ("regular", "sides", ["33", 4, [3], [3, 0], [3, 2.5], [3, True], [65536, 65536]]),
        ("uniform-jitter", "sides", [[3], [3, 0]]),
        ("jittered", "sides", [[3], [3, 0]]),
        ("poisson-disk", "boundary", ["torodial", True]),
        ("poisson-disk", "mode", ["minimal", None]),
        ("poisson-disk", "radius", [0.2, 1.5, NAN, "wide"]),
        ("dart-throwing", "radius", [0, 1.2, NAN, None]),
        ("best-candidate", "candidates", [0, 1.5, INF, 10_001]),
        ("farthest-point", "sweeps", [0, 100_001]),
        ("farthest-point", "sets", [0, 1.5, "many"]),
        ("lloyd", "iterations", [0, 2.5, NAN]),
        ("lloyd", "tolerance", [-0.1, 1.1, NAN, "x"]),
        ("bnot", "iterations", [0]),
        ("bnot", "tolerance", [-0.1, 1.1]),
        ("gaussian-blue-noise", "sigma", [0.1, 3, NAN, "x", None, True]),
        ("gaussian-blue-noise", "iterations", [0, 1.5]),
        ("perturbed-lattice", "width", [-0.1, 1001, None]),
        ("perturbed-lattice", "correlation", [-2.1, 2.5, NAN]),
        ("stealthy-hyperuniform", "stealthiness", [0, 0.5, 3, NAN, "x"]),
        ("stealthy-hyperuniform", "iterations", [0]),
        ("step-blue-noise", "cutoff", [0, 0.57, NAN, None]),
        ("step-blue-noise", "iterations", [0]),
        ("target-spectrum", "iterations", [0]),
        ("target-spectrum", "frequencies", [[0.5], 1, [], [1, 0], [0, 5], [0, NAN], "x"]),
        ("target-spectrum", "power", [[1], [-1, 1], [1, INF], "x"]),
        ("target-pcf", "distances", [[0.5], [1, 0]]),
        ("pmj02-blue-noise", "sweeps", [0, 101, 1.5, "2"]),
        ("void-and-cluster", "cells", [3, 257, 4.5]),
        ("ldbn", "chunk", [1, 3, 24, 128, 2.5]),
        ("ldbn", "sweeps", [0, 10**6]),
        ("determinantal", "dims", [0, 65, 1.5]),
        ("poisson-disk", "dims", [0, 5]),
        ("dart-throwing", "dims", [9]),
    ],
)
def test_values_out_of_range(name, parameter, values):
    cls = SAMPLERS.load(name)
    field = f"{parameter}_" if f"{parameter}_" in cls.__dataclass_fields__ else parameter
    for value in values:
        with pytest.raises(ParameterError, match=parameter):
            cls(**{field: value})


@pytest.mark.parametrize("name", PLANE)
def test_samplers_in_the_plane_name_alternatives(name):
    for dims in (1, 3, 2.5, "2", None):
        with pytest.raises(ParameterError, match=f"^{name}: dims is .* must be 2, .* use "):
            SAMPLERS.load(name)(dims=dims)
    assert SAMPLERS.load(name)(dims=2.0).dims == 2


def test_samplers_of_all_families_are_in_the_plane_only():
    assert {"hexagonal", "multi-jittered", "lloyd", "pmj", "target-pcf", "ldbn"} <= set(PLANE)


def test_largest_counts():
    """Larger counts would take too much time or memory."""
    most = {
        "poisson-disk": 2**26,
        "dart-throwing": 2**22,
        "best-candidate": 2**16,
        "farthest-point": 2**16,
        "void-and-cluster": 2**16,
        "ldbn": 2**16,
        "pmj02-blue-noise": 2**18,
        "stealthy-hyperuniform": 2**14,
        "determinantal": 2**11,
    }
    assert {name: sampler(name).max_count for name in most} == most


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("poisson-disk(mode='maximal', radius=0.5)", "its own minimum distance"),
        ("poisson-disk(mode='maximal', dims=4)", "1 to 3 dims, not 4"),
        ("sobol | subset(of=0)", "of is"),
        ("sobol | subset(of=2.5)", "of is"),
        ("sobol | subset(of=2199023255552)", "of is"),
        ("sobol | subset(of=1000000000)", "1000000000 points"),
        ("sobol | subset(pick='first')", "random, run"),
        ("jittered | subset(of=20)", "16 and 25"),
        ("sobol | skip(count=-1)", "count is"),
        ("sobol | skip(count=0.5)", "count is"),
        ("sobol | skip(count=2199023255552)", "count is"),
    ],
)
def test_parameters_that_do_not_fit(spec, words):
    with pytest.raises(ParameterError, match=words):
        sampler(spec)
