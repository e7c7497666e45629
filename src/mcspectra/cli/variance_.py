"""The three terms of an estimator's variance, beside its measurement."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.common import (
    Once,
    add_engine_argument,
    add_estimator_arguments,
    build_estimator,
    one_sentence_warnings,
    print_json,
    read_sampler,
    seed_option,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import progress_bars

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["add_arguments", "run"]

_VALUES = (
    "dc_term",
    "power_term",
    "cross_term",
    "predicted_variance",
    "measured_variance",
    "captured",
)


_FURTHER = (
    "dc_term_se",
    "power_term_se",
    "cross_term_se",
    "dc_term_ci",
    "power_term_ci",
    "cross_term_ci",
    "predicted_variance_ci",
    "measured_variance_ci",
    "captured_ci",
    "mean",
    "mean_se",
    "band_covariance",
    "band_covariance_se",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add_estimator_arguments(parser)
    parser.add_argument(
        "--sampler", action=Once, required=True, metavar="SPEC", help="sampler spec"
    )
    parser.add_argument("-n", required=True, metavar="N", help="points (of each technique)")
    parser.add_argument("-m", "--realizations", default=1000, metavar="R", help="default 1000")
    parser.add_argument("--half-width", default=64, metavar="K", help="default 64")
    parser.add_argument("--space", help="domain or primary (default: domain where there is one)")
    parser.add_argument(
        "--basis", default="fourier", help="fourier (default), cosine, walsh, haar or auto"
    )
    parser.add_argument(
        "--bands", default="radial", help="bands in --json: radial, dyadic, anova or wedge"
    )

    add_engine_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Analyse and print."""
    from mcspectra.variance.terms import variance_terms

    estimator = build_estimator(options)
    domain = "domain" if estimator.domain_integrand is not None else "primary"
    with one_sentence_warnings(options.quiet), progress_bars(options.quiet):
        result = variance_terms(
            estimator,
            read_sampler(options.sampler, estimator.dims),
            whole_number("-n", options.n),
            half_width=whole_number("--half-width", options.half_width, least=0),
            realizations=whole_number("--realizations", options.realizations, least=2),
            rng=seed_option(options),
            space=options.space or domain,
            basis=options.basis,
            bands=options.bands,
            engine=options.engine,
        )
    if options.json:
        bands = {"band_labels": result["band"].attrs["labels"].split(", ")}
        values = {name: result[name].values for name in (*_VALUES, *_FURTHER)}
        print_json({**result.attrs, **bands, **values})
    elif not options.quiet:
        print(_text(result))
    return 0


def _text(result: xr.Dataset) -> str:
    attrs = result.attrs
    about = (
        f"coefficients: {attrs['coefficients']}; {attrs['realizations']} realisations; "
        f"{attrs['space']} space, {attrs['basis']} basis"
    )
    lines = [f"{attrs['estimator']}  with  {attrs['sampler']},  n = {attrs['n']}", about]
    rows = []
    for name in _VALUES:
        low, high = np.atleast_2d(result[f"{name}_ci"].values)[0]
        interval = f"{low:.4g} … {high:.4g}" if np.isfinite([low, high]).all() else ""
        rows.append([name.replace("_", " "), "", _shown(result[name].values), interval])
    lines.append(text_table(["", "", "value", "95 % interval"], rows))
    if "note" in attrs:
        lines.append(attrs["note"])
    return "\n".join(lines)


def _shown(values: Any) -> str:
    return ", ".join(
        f"{v:.6g}" if np.isfinite(v) else ("infinite" if np.isinf(v) else "undefined")
        for v in np.atleast_1d(values)
    )
