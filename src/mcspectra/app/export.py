"""The state as a Python program and as a study file, both of which run as they are."""

from __future__ import annotations

import textwrap
from typing import Any

from mcspectra.app.compute import analyses_of, integrand_specs
from mcspectra.app.specs import UPLOAD, techniques
from mcspectra.app.state import Setup, State
from mcspectra.core.analysis import Analysis
from mcspectra.core.options import options_of
from mcspectra.core.spec import parse
from mcspectra.report.study import study_toml

__all__ = ["as_python", "as_toml"]

_HEAD = "import mcspectra as mcs\n"


def as_python(state: State) -> str:
    """Return a program that computes, and prints, what the explorer shows at the end of a job.

    Raises
    ------
    McspectraError
        A set-up cannot be made.
    """
    parts = [_HEAD]
    several = state.b is not None
    for name, setup in state.setups():
        # Lines that make density and estimator
        specs, lines = integrand_specs(setup), []
        density = "None"
        if setup.density != "uniform":
            density = f"mcs.density({setup.density!r}, dims={setup.dims})"
        if len(specs) == 1:
            lines.append(f"integrand = mcs.integrand({specs[0]!r}, dims={setup.dims})")
        if setup.smoothing:
            lines.append(f"integrand = mcs.smoothed(integrand, {setup.smoothing!r})")
        lines.append(f"density = {density}")
        if len(specs) == 1:
            lines.append("estimator = mcs.Estimator(integrand, density)")
        else:
            inside = [f"    {spec!r}," for spec in specs]
            lines += ["estimator = mcs.TechniqueSum([", *inside, f"], dims={setup.dims})"]
        if setup.mirror != "none":
            lines.append(f"estimator = mcs.Mirrored(estimator, {setup.mirror!r})")
        lines.append(f"sampler = mcs.sampler({setup.displaced_sampler!r}, dims={setup.dims})")
        for table, analysis in _exported(setup).items():
            given = _chosen(analysis)
            first = [repr(given.pop(o.name)) for o in options_of(type(analysis)) if o.required]
            of_points = analysis.about == "sampler"
            subject = ["sampler"] if of_points else ["estimator", "sampler"]
            named = [f"{key}={value!r}" for key, value in given.items()]
            named = [*(["density=density"] if of_points else []), *named, f"rng={setup.seed}"]
            call = textwrap.fill(", ".join([*subject, *first, *named]) + ",", 90)
            lines += [f"{table} = mcs.{analysis.function}(", textwrap.indent(call, "    "), ")"]
        lines += [
            'for name in ("dc_term", "power_term", "cross_term", "measured_variance"):',
            '    print(f"{name:18}  {float(terms[name]):.6g}")',
            f"predicted = float(predict['predicted_variance'].sel(n={setup.n}))",
            """print(f"{'predicted_variance':18}  {predicted:.6g}")""",
            'low, high = convergence["rate_ci"].values',
            """rate = f"{float(convergence['rate']):.4g}" if high - low <= 1 else "unresolved\"""",
            """print(f"{'rate':18}  {rate}")""",
        ]
        parts.append((f"# {name}\n" if several else "") + "\n".join(lines) + "\n")
    return "\n".join(parts)


def _exported(setup: Setup) -> dict[str, Analysis]:
    """The analyses with numbers to print; points are drawn by each of them."""
    return {name: each for name, each in analyses_of(setup).items() if name != "points"}


def _chosen(analysis: Analysis) -> dict[str, Any]:
    """Options of an analysis that are not as by default; tuples as lists, which people write."""
    given = {o.name: getattr(analysis, o.name) for o in options_of(type(analysis))}
    defaults = {o.name: o.default for o in options_of(type(analysis))}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in given.items()
        if value != defaults[key]
    }


def as_toml(state: State) -> str:
    """Return a study file of the same analyses, for ``mcspectra run``.

    Raises
    ------
    McspectraError
        A set-up cannot be made.
    """
    entries: list[dict[str, Any]] = []
    for name, setup in state.setups():
        parts = integrand_specs(setup)
        entries.append(
            {
                "name": name,
                "dims": setup.dims,
                **({"integrand": parts[0]} if len(parts) == 1 else {"integrands": list(parts)}),
                "samplers": [setup.displaced_sampler],
                "density": None if setup.density == "uniform" else setup.density,
                "smoothed": setup.smoothing or None,
                "mirror": None if setup.mirror == "none" else setup.mirror,
                **{table: _chosen(analysis) for table, analysis in _exported(setup).items()},
            }
        )
    study = {"title": "From the explorer", "seed": state.a.seed, "estimators": entries}
    specs = [spec for _, setup in state.setups() for spec in techniques(setup.integrand)]
    uploaded = any(parse(spec).name == UPLOAD for spec in specs)
    # A study reads files from its own folder only, unless it is told of another
    note = "# Run with --allow-path and the folder of the picture below.\n" if uploaded else ""
    return note + study_toml(study)
