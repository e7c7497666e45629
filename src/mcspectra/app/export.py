"""The state as a Python program and as a study file, both of which run as they are."""

from __future__ import annotations

import json

from mcspectra.app.parts import integrand_specs, ladder, make_parts
from mcspectra.app.specs import UPLOAD, techniques
from mcspectra.app.state import Setup, State
from mcspectra.core.spec import parse

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
        parts.append(_program(setup, f"# {name}\n" if several else ""))
    return "\n".join(parts)


def _program(setup: Setup, head: str) -> str:
    made = make_parts(setup)
    lines = _estimator_lines(setup)
    common = f"realizations={setup.realizations}, rng={setup.seed}"
    lines += [
        f"sampler = mcs.sampler({setup.displaced_sampler!r}, dims={setup.dims})",
        "spectrum = mcs.power_spectrum(",
        f"    sampler, {setup.n}, density=density, half_width={setup.half_width},",
        f"    frequency_step={setup.frequency_step!r}, {common},",
        ")",
        "terms = mcs.variance_terms(",
        f"    estimator, sampler, {setup.n}, half_width={setup.half_width}, {common},",
        f"    basis={setup.basis!r}, space={made.space!r},",
        ")",
        f"curve = mcs.convergence(estimator, sampler, {ladder(setup)}, {common})",
        'for name in ("dc_term", "power_term", "cross_term", "predicted_variance",',
        '             "measured_variance"):',
        '    print(f"{name:18}  {float(terms[name]):.6g}")',
        """print(f"{'rate':18}  {float(curve['rate']):.4g}")""",
    ]
    return head + "\n".join(lines) + "\n"


def _estimator_lines(setup: Setup) -> list[str]:
    """Lines that make ``density`` and ``estimator``."""
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
    return lines


def as_toml(state: State) -> str:
    """Return a study file of the same analyses, for ``mcspectra run``.

    Raises
    ------
    McspectraError
        A set-up cannot be made.
    """
    lines = [*_upload_advice(state), 'title = "From the explorer"', f"seed = {state.a.seed}"]
    for name, setup in state.setups():
        lines += _tables(name, setup)
    return "\n".join(lines) + "\n"


def _upload_advice(state: State) -> list[str]:
    """A study reads files from its own folder only, unless it is told of another."""
    specs = [spec for _, setup in state.setups() for spec in techniques(setup.integrand)]
    if all(parse(spec).name != UPLOAD for spec in specs):
        return []
    return ["# Run with --allow-path and the folder of the picture below."]


def _tables(name: str, setup: Setup) -> list[str]:
    made = make_parts(setup)
    common = f"realizations = {setup.realizations}"
    lines = [
        "",
        "[[estimators]]",
        f"name = {_text(name)}",
        f"dims = {setup.dims}",
        _integrand_line(integrand_specs(setup)),
        f"samplers = [{_text(setup.displaced_sampler)}]",
    ]
    if setup.density != "uniform":
        lines.append(f"density = {_text(setup.density)}")
    if setup.smoothing:
        lines.append(f"smoothed = {setup.smoothing!r}")
    if setup.mirror != "none":
        lines.append(f"mirror = {_text(setup.mirror)}")
    grid = f"n = {setup.n}\nhalf_width = {setup.half_width}\n{common}"
    return [
        *lines,
        "",
        "[estimators.terms]",
        grid,
        f"basis = {_text(setup.basis)}",
        f"space = {_text(made.space)}",
        "",
        "[estimators.spectrum]",
        grid,
        f"frequency_step = {setup.frequency_step!r}",
        "",
        "[estimators.convergence]",
        f"counts = {ladder(setup)}",
        common,
    ]


def _integrand_line(specs: tuple[str, ...]) -> str:
    if len(specs) == 1:
        return f"integrand = {_text(specs[0])}"
    return f"integrands = [{', '.join(map(_text, specs))}]"


def _text(text: str) -> str:
    """A basic string of TOML: JSON's escapes are TOML's, specs hold no control characters."""
    return json.dumps(text, ensure_ascii=False)
