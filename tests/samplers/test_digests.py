"""Points do not change between versions: digests of every registered sampler and of chains.

``digests.json`` has SHA-256 digests (12 digits) for each spec and count: of realizations 1 and 2
for seeds 7 and 8, or of realization 1 if sets are optimized. Delete a line and run ``python -m
tests.samplers.test_digests`` to store new digests; explain in the changelog why points changed.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from mcspectra.samplers import RANDOMIZATIONS, SAMPLERS, as_sampler
from mcspectra.samplers.optimised import OptimisedSampler

TABLE = Path(__file__).with_name("digests.json")
SEEDS = (7, 8)
STORED = json.loads(TABLE.read_text()) if TABLE.exists() else {}

# Cheap parameters for optimized sets, and counts that nearly all samplers allow
QUICK = {
    "bnot": "bnot(iterations=5)",
    "digital-net": "digital-net(matrices=[[8, 4, 2, 1, 16, 32], [8, 12, 10, 15, 17, 51]])",
    "gaussian-blue-noise": "gaussian-blue-noise(iterations=5)",
    "farthest-point": "farthest-point(sweeps=5)",
    "lloyd": "lloyd(iterations=5)",
    "sliced-optimal-transport": "sliced-optimal-transport(iterations=2, directions=4)",
    "stealthy-hyperuniform": "stealthy-hyperuniform(stealthiness=0.2)",
    "step-blue-noise": "step-blue-noise(iterations=3)",
    "target-pcf": "target-pcf(iterations=3)",
    "target-spectrum": "target-spectrum(iterations=3)",
}
CHAINS = [
    "sobol(dims=5)",
    "halton(skip=5, dims=3)",
    "faure(dims=4) | owen",
    "orthogonal-array(strength=3, jitter='correlated-multi-jittered', dims=4)",
    "latin-hypercube(strength=2)",
    "korobov(dims=3) | random-rotation",
    "rank1-lattice | shift | mirror(mode='fold')",
    "sobol | owen(method='hash')",
    "sobol | lms(shift=False)",
    "sobol | mirror(mode='uniform')",
    "halton(dims=3) | owen | lms",
    "jittered | owen(base=3)",
    "jittered | strata-shift(offset=[0.3, 0.2]) | shift",
    "sobol | decorrelate(mask='r2')",
    "sobol | decorrelate(mask='blue-noise', mode='digital-shift', width=16)",
    "poisson-disk | mirror | random-rotation(boundary='clipped')",
    "kronecker | skip(count=9) | shuffle | subset",
    "points",
    *[f"{base} | {step}" for base in ("sobol", "halton", "random") for step in RANDOMIZATIONS],
]
OF_OTHERS = ("command", "points", "python", "shared-cells")  # points from outside the package
SPECS = [*(QUICK.get(name, name) for name in SAMPLERS if name not in OF_OTHERS), *CHAINS]


def source_of(spec):
    if spec == "points":
        return as_sampler(np.random.default_rng(1).random((4, 16, 2)))
    return as_sampler(spec)


def digests_of(spec):
    """Return digests for three counts, or for fewer if the sampler allows fewer."""
    source = source_of(spec)
    optimised = isinstance(source, OptimisedSampler)
    found = {}
    for asked in (4, 7, 16) if optimised else (1, 16, 300):
        n = source.nearest_count(asked)
        drawn = (
            source.draw(n, realizations=1 if optimised else 2, rng=seed, first=1) for seed in SEEDS
        )
        found[str(n)] = [hashlib.sha256(points.tobytes()).hexdigest()[:12] for points in drawn]
    return found


def test_the_table_holds_every_registered_name():
    assert set(STORED) == set(SPECS)


@pytest.mark.filterwarnings(
    "ignore::mcspectra.core.errors.NotPowerOfTwoWarning", "ignore::UserWarning"
)
@pytest.mark.parametrize("spec", SPECS)
def test_points_match_the_stored_digests(spec):
    assert digests_of(spec) == STORED[spec]


if __name__ == "__main__":
    new = {spec: STORED.get(spec) or digests_of(spec) for spec in SPECS}
    lines = (f"{json.dumps(spec)}: {json.dumps(new[spec])}" for spec in SPECS)
    TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
