"""The command ``mcspectra``. Verbs are imported when needed, and errors are one sentence.

Exit codes: 0 for success, 1 if the run failed, 2 for bad input, 130 if interrupted.
The verb ``gate`` also exits with 3 (fail) and 4 (undecided).
Verbs are listed by name, so ``--help`` imports none of them (docs/decisions/0002).
Each verb is a function, for example `run_` for the verb ``run``. This module prints its output.
The module `mcspectra.cli.analysis` turns each analysis into a subcommand (verb).
"""

from __future__ import annotations

import argparse
import errno
import importlib
import io
import json
import os
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from mcspectra.core.display import QUOTED, printable, shown

if TYPE_CHECKING:
    from mcspectra.core.errors import Function, Parameter

__all__ = ["GROUPS", "VERBS", "main"]

GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "study": {
        "run": ("studies", "measure, predict and explain every estimator of a study file"),
        "init": ("studies", "write a study file to start from, or print the schema of such files"),
        "status": ("studies", "count the done, failed, missing and damaged cells of a study"),
        "report": ("studies", "write the report of a study again, or compare two studies"),
        "export": ("studies", "write the results of a study as files"),
    },
    "measure": {
        "points": ("samplers", "draw point sets: text, files, pictures, quality figures"),
        "spectrum": ("analysis", "expected power spectrum of a sampler"),
        "pcf": ("analysis", "pair correlation function of a sampler"),
        "converge": ("analysis", "variance against n, and the fitted rate"),
        "variance": ("analysis", "split a variance into terms, techniques, axes or modes"),
        "bench": ("samplers", "measure samplers side by side: rates, spectra, quality, speed"),
    },
    "predict": {
        "predict": ("analysis", "predict variance and rate at every n without measuring"),
        "plan": ("analysis", "find the smallest n that reaches an error"),
    },
    "explain and improve": {
        "profile": ("profiling", "find the causes of the noise, and the best remedy at a budget"),
        "remedies": ("analysis", "measure changes that may lower the noise, and rank them"),
        "design": ("designs", "search for a sampler or a density for a class of integrands"),
        "integrate": ("samplers", "integrate a function: value and 95 % interval"),
    },
    "render": {
        "pixel": ("scenes", "rates, terms, bottleneck and remedies of one pixel of a scene"),
        "map": ("scenes", "variance, rate and bottleneck at every pixel of a scene"),
        "render": ("scenes", "render a scene with a sampler of this package"),
        "frames": ("scenes", "noise of frames from any renderer: variance, rate, bias, spectrum"),
        "gate": ("gate", "test new renders against a reference: pass, fail or undecided"),
    },
    "more": {
        "app": ("package", "explore samplers, densities and integrands in the browser"),
        "reproduce": (
            "package",
            "make the figures of the slides again, and check the statements",
        ),
        "list": ("samplers", "list samplers, densities, integrands, scenes or analyses"),
        "doctor": ("package", "show what is installed and whether it works"),
        "cite": ("package", "print how to cite the package and its methods"),
    },
}
"""Verbs by group, in the order of the help. Each verb has a module and a summary."""

VERBS = {verb: text for verbs in GROUPS.values() for verb, (_, text) in verbs.items()}
"""Summaries of verbs by name."""

_MODULES = {verb: module for verbs in GROUPS.values() for verb, (module, _) in verbs.items()}

_ANALYSES: dict[str, tuple[str, ...]] = {
    "spectrum": ("spectrum",),
    "pcf": ("pcf",),
    "converge": ("convergence",),
    "variance": ("terms", "techniques", "anova", "modes"),
    "predict": ("predict",),
    "plan": ("plan",),
    "profile": ("profile",),
    "remedies": ("remedies",),
    "map": ("map",),
}
"""Names of the analyses of each verb in the registry, so that the help need not import them.

If several analyses share a verb, ``--split`` chooses one. The default is the first.
"""

_NOW = {
    "exact": "predict --method exact",
    "routes": "predict --method all",
    "techniques": "variance --split techniques",
    "anova": "variance --split axes",
    "modes": "variance --split modes",
    "gallery": "bench",
    "learn": "design density",
    "chains": "profile draws.npy",
    "mitsuba": "render SCENE --sampler …",
    "schema": "init --schema",
}
"""Verbs of earlier versions, and the verbs that replace them."""

_FAILED_RUNS = ("CellFailed", "ClusterLost", "StorageError")
"""Errors that are not caused by the input."""

_LONGEST = 1000  # maximum length of the message of an unexpected error in characters
_LONGEST_USAGE = 250  # maximum length of an error message of the argument parser in characters

_BEFORE = {"--json": 0, "--quiet": 0, "--debug": 0, "--seed": 1, "--allow-code": 1}
"""Options that may come before or after the verb. The number 1 means that a value follows."""

_HELP = """\
usage: mcspectra VERB ...     mcspectra VERB --help     mcspectra --version

Measure, predict and explain the variance of Monte Carlo estimators.

{groups}

All verbs accept --json, --seed and --quiet, also before the verb.
Specs chain names with bars: mcspectra points 'jittered | shift' -n 16
"""


class _Parser(argparse.ArgumentParser):
    """An argument parser that reports an error as one sentence, without the usage block."""

    def error(self, message: str) -> NoReturn:
        sentence = message[:1].upper() + message[1:]
        self.exit(
            2, f"{self.prog}: {printable(sentence, _LONGEST_USAGE)}; see '{self.prog} --help'.\n"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    begun = time.perf_counter()
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Threads compute realizations and cells in parallel. BLAS threads would compete with them
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        # If a terminal lacks a character such as ², print '?' instead and keep the other text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        return _dispatch(given, begun)
    except SystemExit as stop:  # argparse stops after --help (0) or bad usage (2)
        return int(stop.code or 0)
    except KeyboardInterrupt as stop:
        said = printable("; ".join(["Interrupted", *map(str, stop.args)]))
        print(f"mcspectra: {said}.", file=sys.stderr)
        tasks = (each.name == "mcspectra-tasks" for each in threading.enumerate())
        if arguments is None and any(tasks):
            # Native code in other threads could keep the process alive for a minute, or crash it
            sys.stderr.flush()
            os._exit(130)
        return 130
    except BrokenPipeError:
        # The reader closed the pipe (… | head), which is normal. Keep Python from flushing at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if "--debug" in given:
            raise
        from mcspectra.core.errors import McspectraError

        # Exit code 2 means an error that the user can correct
        kind, full = type(error).__name__, (errno.ENOSPC, errno.EDQUOT, errno.EIO)
        if isinstance(error, McspectraError):
            code, sentence = 1 if kind in _FAILED_RUNS else 2, str(error)
        elif isinstance(error, MemoryError):
            code, sentence = 2, "Not enough memory; use fewer points, dims or frequencies."
        elif isinstance(error, OSError) and error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
            code, sentence = 2, f"{shown(error.filename)} is not a path: {error.strerror}."
        elif isinstance(error, OSError) and error.errno in full:
            code, sentence = 1, f"The output cannot be written: {error.strerror}."
        else:
            text = " ".join(str(error)[:_LONGEST].split()) or "no message"
            sentence = f"Unexpected {kind}: {text}; run again with --debug for details."
            code = 1
        print(f"mcspectra: {printable(sentence)}", file=sys.stderr)
        return code


def _dispatch(given: list[str], begun: float) -> int:
    """Find the verb, parse its options, run it, and print its output.

    The time `begun` is the start of the command. Estimates of its time include its imports.
    """
    # If options were given before the verb, move them to the place after the verb
    first = 0
    while first < len(given) and (name := given[first].partition("=")[0]) in _BEFORE:
        first += 1 if "=" in given[first] else 1 + _BEFORE[name]
    given = [*given[first : first + 1], *given[:first], *given[first + 1 :]]
    if not given or given[0].startswith("-"):
        return _without_verb(given)
    from mcspectra.cli.common import Verb, one_sentence_warnings, option, whole
    from mcspectra.core.errors import McspectraError, UnknownName, close_match_hint
    from mcspectra.core.progress import progress_bars
    from mcspectra.core.results import strict_json

    # Load the verb from its module. A verb without a module is created from its analyses
    name, module = given[0], _MODULES.get(given[0], "analysis")
    verb: Verb
    if module == "analysis":
        analyses = _ANALYSES.get(name, ())
        if len(analyses) != 1:  # other packages may add analyses to a verb
            analyses = (*analyses, *_outside_analyses(name))
        if not analyses and name in _NOW:
            raise UnknownName(f"The verb {shown(name)} is now 'mcspectra {_NOW[name]}'.")
        if not analyses:
            hint, close = close_match_hint(name, VERBS, "mcspectra --help")
            raise UnknownName(f"There is no verb {shown(name)}.{hint}", close)
        from mcspectra.cli.analysis import analysis_verb

        verb = analysis_verb(analyses, given[1:])
    else:
        verb = getattr(importlib.import_module(f"mcspectra.cli.{module}"), f"{name}_")

    # Declare the options of the verb, and then the options of all verbs
    parser = _Parser(
        prog=f"mcspectra {name}",
        description=verb.text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    allowed = "code that specs may run: a command or its program, or module:function; repeatable"
    for declare in (
        *verb.options,
        option("--json", "print JSON instead of text"),
        option("--seed S", "seed, a whole number of at least 0", whole(0)),
        option("--quiet", "print only the result: no progress, warnings or notes"),
        option("--allow-code CODE", allowed, repeated="all", default=[]),
        option("--debug", "show the traceback of an error"),
    ):
        declare(parser)
    options, unknown = parser.parse_known_args(given[1:])
    if unknown:
        parser.error(f"unrecognized arguments: {printable(' '.join(unknown), QUOTED)}")
    options.begun = begun

    # For every verb, --allow-code and --allow-path name the code and the folders that specs may use
    folders = getattr(options, "allow_path", ())
    if options.allow_code or folders:
        from mcspectra.core.trust import allow

        allow(options.allow_code, (Path(folder).absolute() for folder in folders))
    try:
        with one_sentence_warnings(options.quiet), progress_bars(not options.quiet):
            text, data, code = verb.run(options)
    except McspectraError as error:
        error.args = (error.sentence(_writer(parser)),)
        raise
    if options.json and data is not None:
        print(json.dumps(strict_json(data), indent=2, allow_nan=False))
    elif text:
        print(printable(text, lines=True))
    return code


def _writer(parser: argparse.ArgumentParser) -> Callable[[Parameter | Function], str]:
    """Return a function that adapts names in messages to the command line.

    For example, a message names the option ``--seed`` instead of the parameter `seed`,
    and the command ``mcspectra predict`` instead of the Python function `predict`.
    """
    import shlex

    from mcspectra.core.analysis import ANALYSES
    from mcspectra.core.errors import Parameter

    flags = {
        action.dest: max(action.option_strings, key=len, default=str(action.metavar or action.dest))
        for action in parser._actions
    }

    def write(part: Parameter | Function) -> str:
        if isinstance(part, Parameter):
            flag = flags.get(part.name)
            if flag is None or part.value is None:
                return flag or str(part)
            return f"{flag} {shlex.quote(str(part.value))}"
        for names in _ANALYSES.values():
            for name in names:
                analysis = ANALYSES.load(name)
                if analysis.function == part.name:
                    # --split selects an analysis of the verb, and the first is the default
                    word = analysis.verb if name == names[0] else analysis.command()
                    return f"'mcspectra {word}'"
        return str(part)

    return write


def _without_verb(given: list[str]) -> int:
    """Print the help or the version if there is no verb."""
    if given[:1] == ["--version"]:
        from mcspectra.version import __version__

        print(__version__)
        return 0
    groups = {group: dict.fromkeys(verbs) for group, verbs in GROUPS.items()}
    texts, left_out = dict(VERBS), dict[str, str]()
    if entry_points(group="mcspectra.analyses"):
        from mcspectra.core.analysis import ANALYSES

        outside, left_out = _outside_verbs()
        for verb, names in outside.items():
            if verb not in VERBS:
                groups.setdefault("other packages", {})[verb] = None
                texts[verb] = ANALYSES.load(names[0]).summary()
    width = max(map(len, texts))
    lines = []
    for group, verbs in groups.items():
        lines += [group, *(f"  {verb.ljust(width)}  {texts[verb]}" for verb in verbs)]
    lines += [f"left out: {name}: {text}" for name, text in left_out.items()]
    if given[:1] not in ([], ["-h"], ["--help"]):
        before = given[0].partition("=")[0] in _BEFORE
        lack = "no verb" if before else f"no option {shown(given[0])} before the verb"
        sentence = f"There is {lack}; see 'mcspectra --help'."
        print(f"mcspectra: {sentence}", file=sys.stderr)
        return 2
    print(_HELP.format(groups="\n".join(lines)), end="")
    return 0


def _outside_analyses(word: str) -> list[str]:
    """Return the analyses from other packages that this subcommand (verb) runs.

    Raises
    ------
    SpecError
        If the analysis was left out by `_outside_verbs`; the message gives the reason.
    MissingDependency
        If the word is the name of an analysis that cannot be loaded.
    """
    outside, left_out = _outside_verbs()
    if word in outside or word in VERBS:
        return outside.get(word, [])
    from mcspectra.core.analysis import ANALYSES
    from mcspectra.core.errors import SpecError

    for name, sentence in left_out.items():
        if word in (name, ANALYSES.load(name).verb):
            raise SpecError(sentence)
    if word in ANALYSES:
        ANALYSES.load(word)
    return []


def _outside_verbs() -> tuple[dict[str, list[str]], dict[str, str]]:
    """Return the verbs of analyses from other packages, and reasons why analyses are omitted.

    The first dictionary maps each verb to the names of its analyses.
    The second dictionary maps the name of each omitted analysis to the reason.

    An analysis is omitted if another analysis has the same function, or the same verb and split.
    Analyses of this package have priority.
    An analysis that cannot be loaded appears in neither of the two returned dictionaries.
    The command `mcspectra list analyses` states why an analysis could not be loaded.
    """
    if not entry_points(group="mcspectra.analyses"):
        return {}, {}
    from mcspectra.core.analysis import ANALYSES
    from mcspectra.core.errors import MissingDependency

    owners: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for name in ANALYSES:
        with suppress(MissingDependency):
            analysis = ANALYSES.load(name)
            owners["verb", analysis.command()].append(name)
            owners["function", analysis.function].append(name)
    outside = {name for name, target in ANALYSES.items() if not target.startswith("mcspectra.")}
    left_out: dict[str, str] = {}
    for (door, word), names in owners.items():
        verb = ANALYSES.load(names[0]).verb
        shared = bool(ANALYSES.load(names[0]).split) and len(_ANALYSES.get(verb, ())) > 1
        if word and len(names) > 1:
            sentence = (
                f"The analyses {' and '.join(map(repr, names))} have the same {door} {word!r}; "
                "uninstall the package of one, or ask its author to rename it."
            )
        elif door == "verb" and verb in VERBS and not shared:
            sentence = (
                f"The analysis {names[0]!r} has the verb {verb!r}, which belongs to mcspectra "
                "itself; uninstall its package, or ask its author to rename the verb."
            )
        else:
            continue
        left_out |= {name: sentence for name in names if name in outside}
    found: dict[str, list[str]] = {}
    for (door, word), names in owners.items():
        for name in names:
            if door == "verb" and word and name in outside and name not in left_out:
                found.setdefault(ANALYSES.load(name).verb, []).append(name)
    return found, left_out
