"""The command ``mcspectra``: verbs in lazy modules, one sentence an error.

Exit codes: 0 done; 1 the run failed; 2 bad input; 130 interrupted. Verbs are bound by name, so that
``--help`` imports none of them (docs/decisions/0002): the verb ``run`` is the `Verb` called ``run_`` of
its module, whose `Answer` is printed here; those of analyses are made by `mcspectra.cli.analysis`.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import io
import json
import os
import re
import sys
import threading
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path
from typing import NoReturn

from mcspectra.core.display import printable, shown

__all__ = ["main"]

_MODULES = {
    "studies": {
        "run": "run a study file: results, figures and report.html",
        "report": "write the report of a study again, or compare two studies",
        "status": "what the folder of a study holds: done, failed, missing, damaged",
        "export": "write results as .csv, .parquet, .nc, .json or .zarr.zip",
        "init": "write a study file to begin with",
        "schema": "print the JSON Schema of study files",
    },
    "samplers": {
        "list": "list samplers, randomizations, densities, integrands, scenes or analyses",
        "points": "draw point sets and write them as text or files",
        "integrate": "integrate a function with a budget of evaluations: value and interval",
        "gallery": "measure samplers and show them side by side",
        "bench": "compare samplers: rates, ranks, spectra, quality, speed; a page, PDF or LaTeX",
    },
    "analysis": {
        "spectrum": "expected power spectrum of a sampler",
        "pcf": "pair correlation of a sampler",
        "variance": "the three terms of an estimator's variance against its measurement",
        "converge": "variance against n and the fitted rate",
        "techniques": "variance, terms and rate of each technique by itself, and the bottleneck",
        "remedies": "what would lower the noise at a budget, measured, ranked and explained",
        "exact": "exact variance, where there is a closed form",
        "predict": "variance and rate at every n, predicted from what is known of f and of the sampler",
        "plan": "the least number of points for an error, predicted",
        "profile": "what the noise is, why, and what to do, within a budget",
        "anova": "which axes the variance comes from, effective dimension",
        "modes": "which patterns of frequencies vary together",
        "routes": "variance by every route that is known, side by side",
    },
    "learn": {
        "design": "search a sampler of small variance over a class of integrands, and certify it",
        "learn": "learn an importance density for an integrand and a sampler, and measure what it gains",
    },
    "chains": {
        "chains": "error of the means of Markov chains, its frequencies, and what is wrong",
    },
    "scenes": {
        "frames": "noise of frames of any renderer: variance, rate, fireflies, bias, error spectrum",
        "render": "render a scene's direct illumination: image, variance, EXR and PNG",
        "pixel": "what one pixel sees, its rates, terms and bottleneck, and what would help",
        "map": "variance, rate and bottleneck at every pixel of a scene",
        "mitsuba": "render a Mitsuba scene file, with our samplers known to its integrators",
    },
    "package": {
        "reproduce": "the slides' figures and statements made again, with what agrees",
        "app": "explore samplers, densities and integrands in the browser",
        "doctor": "what is installed and whether it works",
        "cite": "how to cite the package and its methods",
    },
}
"""Modules of the command line, to their verbs and what these do."""

_VERBS = {verb: text for verbs in _MODULES.values() for verb, text in verbs.items()}

_ANALYSES = {
    verb: {"variance": "terms", "converge": "convergence"}.get(verb, verb)
    for verb in _MODULES["analysis"]
}
"""Verbs of our analyses, which are not loaded to know them: to their names in the registry."""

_FAILED_RUNS = ("CellFailed", "ClusterLost", "StorageError")
"""Errors that are nobody's input."""

_LONGEST = 1000  # characters of an unexpected error's own text

_EPILOG = """\
Specs name samplers, densities and integrands: name(key=value, ...); samplers chain randomizations:
  mcspectra converge 'christensen-gaussian' --sampler jittered --sampler 'jittered | shift' \\
      --counts 16,64,256,1024
Each verb has its own --help, and takes --json, --seed and --quiet.
"""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence, without the usage block."""

    def error(self, message: str) -> NoReturn:
        sentence = message[:1].upper() + message[1:]
        self.exit(2, f"{self.prog}: {printable(sentence, _LONGEST)}; see '{self.prog} --help'.\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Threads are over realisations and cells; those of BLAS beside them wait for one another.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        # A terminal that lacks a character such as ² shows '?' instead of losing the result.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        return _dispatch(given)
    except SystemExit as stop:  # argparse: --help (0) or bad usage (2)
        return int(stop.code or 0)
    except KeyboardInterrupt as stop:
        said = printable("; ".join(["Interrupted", *map(str, stop.args)]))
        print(f"mcspectra: {said}.", file=sys.stderr)
        tasks = (each.name == "mcspectra-tasks" for each in threading.enumerate())
        if arguments is None and any(tasks):
            # Native code that still computes would keep the process for a minute, or abort it
            sys.stderr.flush()
            os._exit(130)
        return 130
    except BrokenPipeError:
        # The reader has gone (… | head): nothing is wrong. Keep Python from flushing at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if "--debug" in given:
            raise
        from mcspectra.core.errors import McspectraError

        # The exit code, 2 for what the user can mend, and the sentence
        kind, full = type(error).__name__, (errno.ENOSPC, errno.EDQUOT, errno.EIO)
        if isinstance(error, McspectraError):
            code, sentence = 1 if kind in _FAILED_RUNS else 2, str(error)
        elif isinstance(error, MemoryError):
            code, sentence = 2, "Not enough memory; ask for fewer points, dims or frequencies."
        elif isinstance(error, OSError) and error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
            code, sentence = 2, f"{shown(error.filename)} is no path: {error.strerror}."
        elif isinstance(error, OSError) and error.errno in full:
            code, sentence = 1, f"The output cannot be written: {error.strerror}."
        else:
            text = " ".join(str(error)[:_LONGEST].split()) or "no message"
            sentence = f"Unexpected {kind}: {text}; run again with --debug for details."
            code = 1
        print(f"mcspectra: {printable(sentence)}", file=sys.stderr)
        return code


def _dispatch(given: list[str]) -> int:
    """Find the verb, read its options, run it and print its answer."""
    if not given or given[0].startswith("-"):
        return _without_verb(given)
    from mcspectra.cli.common import Verb, one_sentence_warnings, option, whole
    from mcspectra.core.errors import McspectraError, UnknownName, close_match_hint
    from mcspectra.core.progress import progress_bars
    from mcspectra.core.results import strict_json

    name = given[0]
    verb: Verb
    analysis = _ANALYSES.get(name)
    if name not in _VERBS:
        analysis = _outside_verb(name)
        if analysis is None:
            hint, close = close_match_hint(name, _VERBS, "mcspectra --help")
            raise UnknownName(f"There is no verb {name!r}.{hint}", close)
    if analysis is None:
        module = next(module for module, verbs in _MODULES.items() if name in verbs)
        verb = getattr(importlib.import_module(f"mcspectra.cli.{module}"), f"{name}_")
    else:
        from mcspectra.cli.analysis import analysis_verb

        verb = analysis_verb(analysis)

    # Its own options, and those that all verbs have
    parser = _Parser(
        prog=f"mcspectra {name}",
        description=verb.text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    allowed = "code that specs may name: a command or its program, or module:function"
    for declare in (
        *verb.options,
        option("--json", "print JSON instead of text"),
        option("--seed S", "seed, a whole number from 0", whole(0)),
        option("--quiet", "print errors only"),
        option("--allow-code CODE", allowed, repeated="all", default=[]),
        option("--debug", "show the traceback of an error"),
    ):
        declare(parser)
    options = parser.parse_args(given[1:])

    # What texts may reach, for all verbs
    folders = getattr(options, "allow_path", ())
    if options.allow_code or folders:
        from mcspectra.core.trust import allow

        allow(options.allow_code, (Path(folder).absolute() for folder in folders))
    try:
        with one_sentence_warnings(options.quiet), progress_bars(not options.quiet):
            text, data, code = verb.run(options)
    except McspectraError as error:
        error.args = (_as_typed(str(error), parser, analyses=analysis is not None),)
        raise
    if options.json and data is not None:
        print(json.dumps(strict_json(data), indent=2, allow_nan=False))
    elif text and (data is None or not options.quiet):
        print(printable(text, lines=True))
    return code


def _as_typed(sentence: str, parser: argparse.ArgumentParser, *, analyses: bool) -> str:
    """Say an error with options as they are typed, and with verbs for the functions of analyses.

    Words within a sentence are options where an analysis is asked for; files have keys of their own.
    """
    for action in parser._actions:
        flag, name = max(action.option_strings, key=len, default=""), action.dest
        if flag:
            sentence = re.sub(rf"^{name}(?= (?:is|has)\b)", flag, sentence)
        if flag and analyses:
            outside = r"(?<![\w(])(?<!, )(?<!says )"  # of the brackets of a spec
            sentence = re.sub(rf"{outside}{name}=(['\"]?)([\w.-]+)\1", rf"{flag} \2", sentence)
            sentence = re.sub(rf"(?<![\w-]){name}\b", flag, sentence) if "_" in name else sentence
    if not (analyses and re.search(r"[a-z]_[a-z]|use convergence", sentence)):
        return sentence
    from mcspectra.core.analysis import ANALYSES

    for verb, name in _ANALYSES.items():
        if function := ANALYSES.load(name).function:
            place = r"\b" if "_" in function else r"(?<=use )"
            sentence = re.sub(rf"{place}{function}\b", f"'mcspectra {verb}'", sentence)
    return sentence


def _without_verb(given: list[str]) -> int:
    """Print the help, or the version."""
    verbs = dict(_VERBS)
    outside, left_out = _outside_verbs()
    for verb, name in outside.items():
        from mcspectra.core.analysis import ANALYSES

        verbs[verb] = ANALYSES.load(name).summary()
    width = max(map(len, verbs))
    table = "\n".join(f"  {name.ljust(width)}  {text}" for name, text in verbs.items())
    table += "".join(f"\nleft out: {name}: {text}" for name, text in left_out.items())
    parser = _Parser(
        prog="mcspectra",
        description="Measure, predict and explain the variance of Monte Carlo estimators.",
        epilog=f"verbs:\n{table}\n\n{_EPILOG}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    parser.add_argument("verb", nargs="?", metavar="VERB", help="what to do, see below")
    if parser.parse_args(given[:1]).version:
        from mcspectra.version import __version__

        print(__version__)
        return 0
    parser.print_help()
    return 2 if given else 0


def _outside_verb(word: str) -> str | None:
    """The analysis of another package that has a verb.

    Raises
    ------
    SpecError
        It is left out, as of `_outside_verbs`.
    MissingDependency
        This is an analysis's name, which cannot be loaded.
    """
    outside, left_out = _outside_verbs()
    if word in outside:
        return outside[word]
    from mcspectra.core.analysis import ANALYSES
    from mcspectra.core.errors import SpecError

    for name, sentence in left_out.items():
        if word in (name, ANALYSES.load(name).verb):
            raise SpecError(sentence)
    if word in ANALYSES:
        ANALYSES.load(word)
    return None


def _outside_verbs() -> tuple[dict[str, str], dict[str, str]]:
    """Verbs of other packages' analyses, to the names of these; names of those left out, to the reason.

    One is left out if its verb, or its function, is that of another: ours keep theirs. Those that cannot
    be loaded are in neither: `mcspectra list analyses` says why.
    """
    if not entry_points(group="mcspectra.analyses"):
        return {}, {}
    from mcspectra.core.analysis import ANALYSES
    from mcspectra.core.errors import MissingDependency

    owners: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for name in ANALYSES:
        with suppress(MissingDependency):
            for door in ("verb", "function"):
                owners[door, getattr(ANALYSES.load(name), door)].append(name)
    outside = {name for name, target in ANALYSES.items() if not target.startswith("mcspectra.")}
    left_out: dict[str, str] = {}
    for (door, word), names in owners.items():
        if word and len(names) > 1:
            sentence = (
                f"The analyses {' and '.join(map(repr, names))} have the same {door} {word!r}; "
                "uninstall the package of one, or have its author rename it."
            )
        elif door == "verb" and word in _VERBS:
            sentence = (
                f"The analysis {names[0]!r} has the verb {word!r}, which is one of mcspectra itself; "
                "uninstall its package, or have its author rename the verb."
            )
        else:
            continue
        left_out |= {name: sentence for name in names if name in outside}
    found = {
        word: name
        for (door, word), names in owners.items()
        for name in names
        if door == "verb" and word and name in outside and name not in left_out
    }
    return found, left_out
