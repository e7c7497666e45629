"""The verb of learned densities: one for an integrand, a sampler and a number of points."""

from __future__ import annotations

import argparse

import mcspectra as mcs
from mcspectra.cli.common import Answer, option, real, text_table, verb, whole
from mcspectra.variance.learned import LEARNED

__all__ = ["learn_"]


@verb(
    option("integrand", "spec of the integrand"),
    option("-k, --kind KIND", f"{', '.join(LEARNED)} (default mixture)"),
    option("-s, --sampler SAMPLER", "a random sampler (default 'sobol | owen')"),
    option("-n N", "number of points (default 256)", whole(1)),
    option("-d, --dims D", "number of dims (default: the integrand's own, or 2)", whole(1)),
    option(
        "--evaluations E",
        "most evaluations to learn from (default 8 n + 8192, 16384 at least)",
        whole(1),
    ),
    option(
        "--defensive SHARE", "least value of the density (default 0.05)", real(above=0.0, below=1.0)
    ),
    option("-m, --realizations M", "of the measurement (default 1000)", whole(2)),
    option("-o, --out FILE", "write the density to this .json file"),
)
def learn_(options: argparse.Namespace) -> Answer:
    """Learn an importance density for an integrand and a sampler, and measure what it gains.

    Prints its spec and the variances without and with it, of points that it was not learned from.
    """
    sampler, n, seed = options.sampler or "sobol | owen", options.n or 256, options.seed or 0
    f = mcs.integrand(options.integrand, dims=options.dims)
    density = mcs.learned_density(
        f,
        options.kind or "mixture",
        sampler,
        n,
        evaluations=options.evaluations,
        defensive=0.05 if options.defensive is None else options.defensive,
        rng=seed,
        path=options.out,
    )
    estimators = [mcs.Estimator(f), mcs.Estimator(f, density)]
    found = [
        mcs.convergence(e, sampler, [n], realizations=options.realizations or 1000, rng=seed + 1)
        for e in estimators
    ]
    variances = [float(r["variance"][0]) for r in found]
    intervals = [r["variance_ci"].values[0].tolist() for r in found]
    rows = [
        [name, f"{variance:.4g}", f"{low:.4g} to {high:.4g}"]
        for name, variance, (low, high) in zip(
            ("uniform", "learned"), variances, intervals, strict=True
        )
    ]
    text = f"{density.spec}\n{text_table(['density', f'variance, n = {n}', '95 %'], rows)}"
    data = {
        "spec": density.spec,
        "dims": f.dims,
        "n": n,
        "sampler": sampler,
        "variance": dict(zip(("uniform", "learned"), variances, strict=True)),
        "variance_ci": dict(zip(("uniform", "learned"), intervals, strict=True)),
    }
    return Answer(text, data)
