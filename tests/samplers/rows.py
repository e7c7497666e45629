"""Samplers that the contract tests cover: one row each, and more if parameters change much."""

from dataclasses import dataclass

__all__ = ["ANY", "GRIDS", "ROWS", "Row"]


@dataclass(frozen=True)
class Row:
    """A sampler of the contract tests: spec, dims and an allowed count for each."""

    spec: str
    counts: dict[int, int]
    fixed: bool = False  # whether all realizations have the same points
    unbiased: bool = True


ANY = {1: 16, 2: 16, 3: 16, 10: 16}
GRIDS = {1: 16, 2: 16, 3: 64, 10: 1024}

ROWS = (
    Row("random", ANY),
    Row("regular", GRIDS, fixed=True, unbiased=False),
    Row("regular(position='corner')", GRIDS, fixed=True, unbiased=False),
    Row("regular(sides=[2, 5])", {2: 10}, fixed=True, unbiased=False),
    Row("hexagonal", {2: 16}, fixed=True, unbiased=False),
    Row("uniform-jitter", GRIDS),
    Row("uniform-jitter(sides=[3, 1, 5])", {3: 15}),
    Row("jittered", GRIDS),
    Row("jittered(sides=[2, 5])", {2: 10}),
    Row("box-jitter", GRIDS, unbiased=False),
    Row("box-jitter(width=2)", GRIDS),
    Row("gaussian-jitter", GRIDS, unbiased=False),
    Row("antithetic-jittered", {1: 16, 2: 18, 3: 16, 10: 2048}),
    Row("latin-hypercube", ANY),
    Row("latin-hypercube(strength=2)", {1: 9, 2: 9, 3: 9, 10: 121}),
    Row("n-rooks", {2: 16}),
    Row("multi-jittered", {2: 16}),
    Row("correlated-multi-jittered", {2: 14}),
    Row("orthogonal-array", {2: 9, 3: 9, 10: 121}),
    Row("orthogonal-array(jitter='jittered')", {2: 9, 3: 9}),
    Row("orthogonal-array(strength=3, jitter='correlated-multi-jittered')", {3: 27, 4: 27}),
    Row("gaussian-blue-noise(iterations=5)", {1: 16, 2: 16, 3: 16, 10: 3}),
    Row("halton", ANY, fixed=True, unbiased=False),
    Row("halton(skip=5, scramble='permute')", ANY),
    Row("halton(skip=5, scramble='owen')", ANY),
    Row("hammersley", ANY, fixed=True, unbiased=False),
    Row("hammersley(scramble='permute')", {2: 16, 3: 18}),
    Row("hammersley(scramble='owen')", {2: 16, 3: 18}),
    Row("van-der-corput", {1: 16}, fixed=True, unbiased=False),
    Row("van-der-corput(base=3, scramble='permute')", {1: 16}),
    Row("van-der-corput(base=3, scramble='owen')", {1: 16}),
    Row("digital-net(matrices=[[2, 1], [2, 3]])", {2: 4}, fixed=True, unbiased=False),
    Row("faure", {1: 16, 2: 16, 3: 9, 10: 11}, fixed=True, unbiased=False),
    Row("larcher-pillichshammer", {2: 16}, fixed=True, unbiased=False),
    Row("niederreiter", ANY, fixed=True, unbiased=False),
    Row("sobol", ANY, fixed=True, unbiased=False),
    Row("rank1-lattice", ANY, fixed=True, unbiased=False),
    Row("rank1-lattice(vector=[1, 7, 3])", {3: 16}, fixed=True, unbiased=False),
    Row("korobov", ANY, fixed=True, unbiased=False),
    Row("korobov(a=7)", ANY, fixed=True, unbiased=False),
    Row("fibonacci", {2: 21}, fixed=True, unbiased=False),
    Row("kronecker", ANY, fixed=True, unbiased=False),
    Row("kronecker(alpha=[0.41421356, 0.73205081])", {2: 16}, fixed=True, unbiased=False),
    Row("poisson-disk", {1: 16, 2: 16, 3: 16}),
    Row("poisson-disk(mode='maximal')", {1: 16, 2: 16, 3: 4}),
    Row("poisson-disk(boundary='bounded')", {1: 16, 2: 16, 3: 16}, unbiased=False),
    Row("dart-throwing", {1: 16, 2: 16, 3: 16, 8: 16}),
    Row("best-candidate", ANY),
    Row("farthest-point(sets=3, sweeps=5)", {2: 16}),
    Row("projective-blue-noise", {1: 16, 2: 16, 3: 16, 6: 8}),
    Row("lloyd(iterations=5)", {2: 16}),
    Row("bnot(iterations=5)", {2: 16}),
    Row("void-and-cluster", {2: 16}),
    Row("pmj", {2: 16}),
    Row("pmj02", {2: 16}),
    Row("pmj02-blue-noise", {2: 16}, unbiased=False),
    Row("ldbn", {2: 16}, unbiased=False),
    Row("scipy(engine='LatinHypercube')", ANY),
    Row("perturbed-lattice", GRIDS),
    Row("perturbed-lattice(correlation=1.0)", {1: 16, 2: 16, 3: 64, 6: 64}),
    Row("stealthy-hyperuniform(stealthiness=0.2)", {2: 8}),
    Row("stealthy-hyperuniform(sets=4)", {1: 16, 2: 16, 3: 16, 10: 16}),
    Row("determinantal", ANY),
    Row("mitsuba", {1: 16, 2: 12, 3: 16, 10: 16}),
    Row("mitsuba(sampler='ldsampler')", {2: 16}),
    Row("qmcpy", ANY),
    Row("step-blue-noise(iterations=3)", {2: 16}),
    Row("target-spectrum(iterations=3)", {2: 16}),
    Row("target-pcf(iterations=3)", {2: 16}),
    Row(
        "sliced-optimal-transport(iterations=2, directions=4)",
        {2: 16, 3: 16, 10: 16},
        unbiased=False,
    ),
    Row("points(path='{path}')", ANY, unbiased=False),
    Row("shared-cells(path='{path}')", {1: 4, 2: 16, 3: 16}),
)
