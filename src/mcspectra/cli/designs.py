"""The verb `design`: search for a sampler or an importance density, and measure the result."""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any, Literal

import mcspectra as mcs
from mcspectra.cli.common import (
    VerbOutput,
    given_of,
    group,
    option,
    out,
    real,
    text_table,
    verb,
    whole,
)
from mcspectra.core.decoding import path_to_write
from mcspectra.core.errors import ParameterError, writing
from mcspectra.improve.designs.searches import KINDS
from mcspectra.improve.learned import LEARNED

__all__ = ["design_"]

_DENSITY: Literal["density"] = "density"
_OF_DENSITIES = ("family", "sampler", "budget", "defensive", "realizations")
_OF_SAMPLERS = ("members",)


@verb(
    option("KIND", f"{', '.join(KINDS)} (samplers), or {_DENSITY}"),
    option(
        "OBJECTIVE",
        "integrand spec; for samplers also a class: gaussians, disks, half-spaces, or a spec with "
        "uniform(a, b) or normal(mean, sd)",
    ),
    option("-n N", "number of points", whole(1), required=True),
    option("-d, --dims D", "number of dims (default: those of the spec, or 2)", whole(1)),
    group(
        lambda parser: parser.add_argument_group("samplers"),
        option(
            "--members M",
            "integrands of the class used to measure the result (default 2000)",
            whole(20),
        ),
    ),
    group(
        lambda parser: parser.add_argument_group("density"),
        option("--family FAMILY", f"{', '.join(LEARNED)} (default mixture)"),
        option("--sampler SPEC", "a randomized sampler (default 'sobol | owen')"),
        option(
            "--budget B",
            "evaluations to learn from (default 16 n + 8192, at least 24576)",
            whole(1),
        ),
        option(
            "--defensive SHARE",
            "share of the uniform density in the mixture (default 0.05)",
            real(above=0.0, below=1.0),
        ),
        option("-m, --realizations R", "point sets per measured variance (default 1000)", whole(2)),
    ),
    out(".json: the density, or the sampler with its certificate"),
)
def design_(options: argparse.Namespace) -> VerbOutput:
    """Search for a sampler or a density with small variance, and measure the gain.

    A sampler is optimized for a class of integrands.
    The table compares the variances of the new sampler and of usual samplers.
    The variances are means over integrands of the class that the search did not use.
    If a usual sampler has less variance, the usual sampler is saved instead.
    Ctrl-C ends the search and keeps the best sampler found.

    A density is learned for one integrand and one sampler.
    The table compares variances with and without the density, at points not used for learning.
    If the learned density does not lower the variance, the uniform density is saved instead.
    """
    density = options.kind == _DENSITY
    other = "samplers" if density else "densities"
    for name in _OF_SAMPLERS if density else _OF_DENSITIES:
        if getattr(options, name) is not None:
            raise ParameterError(f"--{name} is for {other}; leave it out with {options.kind}.")
    for file in options.out:
        path_to_write(file, "a .json file", (".json",))
    first, *copies = options.out or [None]
    text, data = (_density if density else _sampler)(options, first)
    for file in copies:
        sets = Path(first).with_suffix(".npz")
        with writing(file):
            shutil.copyfile(first, file)
            if sets.exists() and sets.parent != Path(file).parent:
                shutil.copyfile(sets, Path(file).parent / sets.name)
    return VerbOutput(text, data)


def _sampler(options: argparse.Namespace, path: str | None) -> tuple[str, dict[str, Any]]:
    """Search for a sampler, certify its variance, and store both in the file."""
    seed = options.seed or 0
    sampler = mcs.design(
        options.kind, options.objective, options.n, dims=options.dims, rng=seed, path=path
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
    # If the best usual sampler is unbiased, and better with 95 % confidence, save it instead
    spec, saved = sampler.spec, ""
    if low > 1.0:
        rival = mcs.sampler(found.attrs["best_rival"], sampler.dims)
        kept = "its points are not uniform, so this design is kept"
        saved = (
            f"\n{rival.spec} has less variance than this design; "
            f"{'it is saved instead' if rival.unbiased else kept}"
        )
        spec = rival.spec if rival.unbiased else spec
    text = (
        f"{spec}\n{text_table(['sampler', 'mean variance', '95 %'], rows)}\n"
        f"{float(found['design_ratio']):.3g} times (95 %: {low:.3g} to {high:.3g}) "
        f"the mean variance of {found.attrs['best_rival']}{saved}"
    )
    data = {
        "spec": spec,
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
    if path is not None:
        sets = str(Path(path).with_suffix(".npz"))
        # The JSON file refers to the .npz file of point sets by its path relative to the JSON file
        stored = spec.replace(repr(sets), repr(Path(sets).name))
        with writing(path):
            Path(path).write_text(json.dumps(data | {"spec": stored}, indent=2) + "\n")
    return text, data


def _density(options: argparse.Namespace, path: str | None) -> tuple[str, dict[str, Any]]:
    """Learn a density, write it to the file, and measure the variances with and without it."""
    n, seed = options.n, options.seed or 0
    sampler = options.sampler or "sobol | owen"
    f = mcs.integrand(options.objective, dims=options.dims)
    asked = given_of(options, "family", "budget", "defensive")
    density = mcs.design(_DENSITY, f, n, sampler=sampler, rng=seed, path=path, **asked)
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
    return text, data
