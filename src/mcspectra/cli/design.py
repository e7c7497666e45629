"""The verb of designs: a sampler for a class of integrands, with its certificate."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mcspectra as mcs
from mcspectra.cli.common import Answer, option, text_table, verb, whole
from mcspectra.core.errors import writing

__all__ = ["design_"]


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
