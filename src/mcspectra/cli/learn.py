"""The verbs that make components: a density for an integrand, a sampler for a class of them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mcspectra as mcs
from mcspectra.cli.common import Answer, option, real, text_table, verb, whole
from mcspectra.core.errors import writing
from mcspectra.variance.learned import LEARNED

__all__ = ["design_", "learn_"]


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
    density = mcs.variance.learned_density(
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


@verb(
    option("kind", "lattice, polynomial-lattice, digital-net, owen, strata or points"),
    option(
        "objective",
        "class: gaussians, disks, half-spaces, or an integrand spec with uniform(a, b) or normal(mean, sd)",
    ),
    option("n", "number of points", whole(1)),
    option("-d, --dims D", "number of dims (default: those of the spec, or 2)", whole(1)),
    option("-o, --out FILE", "write the sampler and its certificate to this .json file"),
    option("--members M", "fresh members of the certificate (default 2000)", whole(20)),
)
def design_(options: argparse.Namespace) -> Answer:
    """Search a sampler of small expected variance over a class of integrands, and certify it.

    Prints its spec and the mean variances over fresh members of the class, beside those of usual
    samplers. Ctrl-C keeps the best sampler so far.
    """
    seed = options.seed or 0
    sampler = mcs.design(
        options.kind, options.objective, options.n, dims=options.dims, rng=seed, path=options.out
    )
    found = mcs.certificate(
        sampler, options.objective, options.n, members=options.members or 2000, rng=seed + 1
    )
    low, high = found["design_ratio_ci"].values
    rows = [
        [str(name), f"{mean:.4g}", f"{start:.4g} to {end:.4g}"]
        for name, mean, (start, end) in zip(
            found["sampler"].values,
            found["mean_variance"].values,
            found["mean_variance_ci"].values,
            strict=True,
        )
    ]
    rows[0][0] = "this design"
    text = (
        f"{sampler.spec}\n{text_table(['sampler', 'mean variance', '95 %'], rows)}\n"
        f"{float(found['design_ratio']):.3g} times (95 %: {low:.3g} to {high:.3g}) the mean variance of "
        f"{found.attrs['best_rival']}"
    )
    data = {
        "spec": sampler.spec,
        "dims": sampler.dims,
        "n": options.n,
        "certificate": {
            **{str(name): found[name].values.tolist() for name in found},
            "sampler": found["sampler"].values.tolist(),
            **{
                key: found.attrs[key]
                for key in ("objective", "best_rival", "members", "realizations")
            },
        },
    }
    if options.out is not None:
        with writing(options.out):
            Path(options.out).write_text(json.dumps(data, indent=2) + "\n")
    return Answer(text, data)
