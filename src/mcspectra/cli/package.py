"""The verbs of the package itself: figures of the slides, the explorer, a check, and citations."""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import sys
from importlib import metadata
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import VerbOutput, option, verb, whole
from mcspectra.core.display import counted, printable
from mcspectra.core.errors import ParameterError
from mcspectra.core.references import bibtex
from mcspectra.core.registry import optional_package
from mcspectra.version import __version__

if TYPE_CHECKING:
    from mcspectra.reproduction.gallery import Entry

__all__ = ["app_", "cite_", "doctor_", "reproduce_"]

_EXTRAS = {
    "report": ("bokeh", "jinja2", "latex2mathml"),
    "store": ("zarr",),
    "cluster": ("distributed", "cloudpickle"),
    "render": ("mitsuba", "OpenEXR"),
    "frames": ("flip-evaluator", "tevclient"),
    "qmcpy": ("qmcpy",),
}
"""Optional packages, by the package extra that installs them."""

_CITED = {
    "the three terms under importance sampling": "Singh2019",
    "non-uniform FFT": "Barnett2019",
    "multiple importance sampling": "VeachGuibas1995",
}
_ITSELF = f"""@software{{mcspectra,
  title = {{mcspectra: a profiler for Monte Carlo noise}},
  author = {{{{The mcspectra authors}}}},
  version = {{{__version__}}},
  year = {{2026}}
}}"""


@verb(
    option("FIGURE", "figures (default: all)", dest="figures", nargs="*"),
    option("--list", "list the figures and stop"),
    option("--quick", "fewer realizations and no PDF files: about a minute"),
    option("-o, --out DIR", "output folder (default out/reproduce)", repeated="once"),
)
def reproduce_(options: argparse.Namespace) -> VerbOutput:
    """Make the figures of the slides again, and report which statements of the slides hold.

    Writes DIR/index.html, a lecture in a single self-contained file.
    Also writes DIR/findings.json and DIR/figures/*.png and *.pdf.
    Without FIGURE it makes all figures; --list names them.
    A figure that fails does not stop the others; the exit code is then 1.
    """
    from mcspectra.core.parallel import available_workers
    from mcspectra.reproduction.gallery import (
        FINDINGS_NAME,
        exhibit_names,
        reproduce,
        tally,
        texts,
    )

    if options.list:
        shown = {name: texts()[name].summary for name in exhibit_names(options.figures)}
        width = max(map(len, shown))
        lines = [f"{name.ljust(width)}  {text}" for name, text in shown.items()]
        return VerbOutput(
            "\n".join(lines), [{"name": name, "summary": text} for name, text in shown.items()]
        )

    def show(entry: Entry) -> None:
        print(f"{entry.name}: {entry.tally} ({entry.seconds:.1f} s)", flush=True)
        for finding in entry.findings:
            if finding.agrees is False and not entry.problem:
                why = f": {finding.note}" if finding.note else ""
                print(f"  does not agree: {finding.statement}{why}", flush=True)

    # Store the command that reproduces the gallery, without the name of the folder
    seed = options.seed or 0
    words = ["mcspectra", "reproduce", *options.figures, *(["--quick"] if options.quick else [])]
    made = reproduce(
        options.out or "out/reproduce",
        options.figures,
        quick=options.quick,
        seed=seed,
        command=shlex.join([*words, "--seed", str(seed)]),
        done=None if options.quiet or options.json else show,
        workers=min(available_workers(), len(exhibit_names(options.figures))),
    )
    for entry in made.entries:
        if entry.problem:
            problem = printable(entry.problem)
            print(f"mcspectra: The figure {entry.name} failed: {problem}", file=sys.stderr)
    judged = [
        finding
        for entry in made.entries
        for finding in entry.findings
        if finding.agrees is not None and not entry.problem
    ]
    data = {
        "gallery": made.page,
        "findings": made.page.parent / FINDINGS_NAME,
        "figures": [entry.name for entry in made.entries],
        "agree": sum(bool(each.agrees) and not each.corrects for each in judged),
        "correct": sum(bool(each.agrees) and each.corrects for each in judged),
        "judged": len(judged),
        "failed": list(made.failed),
    }
    return VerbOutput(
        f"{tally(made.entries)}\npage: {printable(made.page)}", data, 1 if made.failed else 0
    )


@verb(
    option("--port N", "port on this machine (default: any free port)", whole(0, 65535), default=0),
    option("--no-browser", "print the address and open no browser"),
    option(
        "--allow-path DIR",
        "a folder that specs may read files from; repeatable",
        repeated="all",
        default=[],
    ),
)
def app_(options: argparse.Namespace) -> VerbOutput:
    """Explore in the browser: choose a sampler, a density and an integrand, and see the results.

    Serves a page on this machine only, without access to the network.
    """
    if options.json or options.seed is not None:
        raise ParameterError("app takes neither --json nor --seed; choose the seed on the page.")
    optional_package("bokeh", "report", "The explorer needs")
    from mcspectra.app.server import serve

    serve(options.port, open_browser=not options.no_browser, quiet=options.quiet)
    return VerbOutput()


@verb()
def doctor_(options: argparse.Namespace) -> VerbOutput:  # noqa: ARG001
    """Show what is installed and whether it works: versions, kernels, NUFFT, renderer, extras."""
    import numpy as np

    from mcspectra.core.cache import cache_folder, cache_size
    from mcspectra.core.parallel import available_workers
    from mcspectra.core.results import package_versions
    from mcspectra.rendering.backend import describe
    from mcspectra.spectra.transforms import FrequencyGrid, Transform, direct_sum

    # Compare one NUFFT with the direct sum, because every analysis depends on the NUFFT
    grid = FrequencyGrid(2, 8)
    points = np.random.default_rng(0).random((2, 256, 2))
    try:
        got = Transform(grid, 256, engine="nufft").coefficients(points)
    except (ImportError, OSError, RuntimeError) as error:
        works, transforms = False, f"NUFFT fails: {type(error).__name__}: {error}"
    else:
        off = float(np.abs(got - direct_sum(points, grid.indices())).max())
        works = off < 1e-8
        transforms = f"NUFFT against the direct sum: largest difference {off:.1e}"

    # Find the package versions of each extra, or the command that installs it
    optional = {}
    for extra, names in _EXTRAS.items():
        versions = []
        for name in names:
            try:
                versions.append(f"{name} {metadata.version(name)}")
            except metadata.PackageNotFoundError:
                versions.append(f"{name} not installed")
        optional[extra] = ", ".join(versions)
        if "not installed" in optional[extra]:
            optional[extra] += f" (pip install 'mcspectra[{extra}]')"

    entries, size = cache_size()
    found: dict[str, Any] = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processors": available_workers(),
        **package_versions(),
        "cache of point sets": (
            f"{counted(entries, 'set')}, {size / 2**20:.1f} MiB in {cache_folder()}"
        ),
        "numba cache": os.environ.get("NUMBA_CACHE_DIR", "next to the package"),
        "transforms": transforms,
        "renderer": describe(),
    }
    shown = found | {f"extra {extra}": text for extra, text in optional.items()}
    width, lines = max(map(len, shown)), []
    for name, value in shown.items():
        if isinstance(value, dict):
            texts = {k: ", ".join(v) if isinstance(v, list) else v for k, v in value.items()}
            value = "; ".join(f"{key} {text}" for key, text in texts.items() if text)
        lines.append(f"{name.replace('_', ' ').ljust(width)}  {value}")
    return VerbOutput(
        "\n".join(lines), {**found, "extras": optional, "works": works}, 0 if works else 1
    )


@verb()
def cite_(options: argparse.Namespace) -> VerbOutput:  # noqa: ARG001
    """Print how to cite the package, the paper it implements and the methods it uses (BibTeX)."""
    cited = {"mcspectra": _ITSELF, **{what: bibtex(key) for what, key in _CITED.items()}}
    listed = [{"for": what, "bibtex": entry} for what, entry in cited.items()]
    return VerbOutput("\n\n".join(f"% {what}\n{entry}" for what, entry in cited.items()), listed)
