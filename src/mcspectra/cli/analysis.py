"""The verb of any analysis: its options and their help are derived from the analysis itself.

An analysis of `mcspectra.core.analysis.ANALYSES` that has a verb is one, those of other packages too.
What is analysed comes first (an integrand with densities and a sampler, or a sampler alone), then the
options of `mcspectra.core.options.options_of`. `mcspectra.cli.texts` shows the result.
"""

from __future__ import annotations

import argparse
import inspect
from typing import TYPE_CHECKING, Any

import mcspectra as mcs
from mcspectra.cli.common import (
    Answer,
    Declaration,
    Verb,
    given_of,
    option,
    read_sampler,
    whole,
    wholes,
)
from mcspectra.cli.texts import VIEWS, data_of, table_of_anything
from mcspectra.core.analysis import ANALYSES, Analysis, Subject, check_names, compute
from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.options import Option, options_of
from mcspectra.samplers import GivenPoints

if TYPE_CHECKING:
    from mcspectra.estimators import AbstractEstimator

__all__ = ["analysis_verb", "declared"]

_ESTIMATOR = (
    option("integrand", "integrand spec, e.g. 'gaussian(width=0.25)'"),
    option("-d, --dims D", "number of dims, where specs leave it open", whole()),
    option("--density SPEC", "density; several mean MIS", repeated="all"),
    option(
        "--heuristic SPEC",
        "MIS: balance (default), power(beta=2), cutoff, maximum, optimal or variance-aware",
        repeated="once",
    ),
    option(
        "--shares K,K,…",
        "MIS: points of each technique, in units of n",
        wholes(),
        repeated="once",
    ),
    option(
        "--mirror MODE",
        "mirror the integrand or the samples: integrand, random or uniform",
        repeated="once",
    ),
    option(
        "--plus SPEC",
        "further integrand, sampled on its own and added (techniques in primary space)",
        repeated="all",
    ),
)
"""Options of what is estimated; the sampler's depends on the analysis."""


def analysis_verb(name: str) -> Verb:
    """Make the verb of an analysis of the registry.

    Raises
    ------
    AnalysisError
        As of `mcspectra.core.analysis.check_names`.
    """
    analysis: type[Analysis] = ANALYSES.load(name)
    check_names(analysis)
    own = options_of(analysis)
    views = VIEWS.get(name, {"": table_of_anything})
    usual, *others = views

    # What the public function takes says what its verb does
    door = getattr(mcs, analysis.function, None)
    takes = {} if door is None else inspect.signature(door).parameters
    default_sampler = takes["sampler"].default if "sampler" in takes else None
    if not isinstance(default_sampler, str):
        default_sampler = None

    # Declare what is analysed
    all_sets = False
    declarations: list[Declaration]
    if analysis.about == "estimator":
        several = "sampler" in analysis.several
        about = f"sampler spec{'; repeatable' if several else ''}"
        about += f" (default {default_sampler})" if default_sampler else ""
        repeated, required = "all" if several else "once", default_sampler is None
        declarations = [
            *_ESTIMATOR,
            option("--sampler SPEC", about, repeated=repeated, required=required),
        ]
    else:
        # An analysis of point sets takes all that are given, unless it is told how many
        all_sets = any(each.name == "realizations" for each in own)
        declarations = [
            option("sampler", "sampler spec; - reads point sets from standard input"),
            option("-d, --dims D", "number of dims (default 2)", whole()),
        ]
        if not takes or "density" in takes:
            declarations.append(option("--density SPEC", "importance density"))

    # Declare the options of the analysis, of its views, and the file
    for each in own:
        more = ", or all sets of points that are given" if all_sets else ""
        declarations.append(declared(each, more if each.name == "realizations" else ""))
    if others:
        shown = [f"{view}: {views[view].__doc__}" for view in others]
        offer = f"{usual} (default); {'; '.join(shown)}"
        declarations.append(option("--show VIEW", offer, default=usual))
    files = (
        ".npz: all values; .csv, .tex: the curve; .png, .svg, .pdf, .pgf: a picture; .html: a page"
    )
    declarations.append(option("-o, --out FILE", files))

    def run(options: argparse.Namespace) -> Answer:
        view = as_choice("--show", getattr(options, "show", usual), tuple(views))

        # Refuse files that cannot be made before anything is computed
        file = options.out
        if file is not None:
            from mcspectra.report.result_files import check_result_file, write_result_file

            check_result_file(file)

        # Compute, write and show
        given = given_of(options, *(each.name for each in own))
        subject = _subject(options, analysis, default_sampler)
        if all_sets and isinstance(subject.sampler, GivenPoints):
            sets = subject.sampler.sets.get(given.get("n", 0), subject.sampler.points)
            given = {"realizations": len(sets), **given}
        result = compute(analysis(**given), subject, options.seed or 0)
        if file is not None:
            write_result_file(result, file, f"mcspectra {analysis.verb}")
        shown = views[view](result)
        return Answer(shown.text, {**data_of(result), **shown.data})

    about = inspect.cleandoc(analysis.__doc__ or "").partition("\n\n")[0]
    printed = inspect.cleandoc(views[usual].__doc__ or "")
    return Verb(f"{about}\n\n{printed}".strip(), tuple(declarations), run)


def _subject(
    options: argparse.Namespace, analysis: type[Analysis], default_sampler: str | None
) -> Subject:
    """Make what the options describe: a sampler with its density, or an estimator with samplers."""
    if analysis.about == "sampler":
        from mcspectra.densities.registry import as_warp

        source = read_sampler(options.sampler, options.dims)
        return Subject(None, source, as_warp(getattr(options, "density", None), source.dims))
    from mcspectra.estimators import (
        MIRRORINGS,
        Estimator,
        Mirrored,
        MultipleImportance,
        TechniqueSum,
        as_subject,
    )

    # Refuse options that do not go together
    densities = options.density or []
    for name, given in (("--heuristic", options.heuristic), ("--shares", options.shares)):
        if given is not None and len(densities) < 2:
            raise ParameterError(f"{name} is about several --density options; give two or more.")
    if options.shares is not None and len(options.shares) != len(densities):
        raise ParameterError(
            f"--shares is {','.join(map(str, options.shares))}; give {len(densities)} numbers, one for "
            "each --density."
        )
    if options.plus and densities:
        raise ParameterError("--plus adds whole techniques; it cannot be used with --density.")

    # Make the estimator
    estimator: AbstractEstimator
    if options.plus:
        estimator = TechniqueSum([options.integrand, *options.plus], dims=options.dims)
    elif len(densities) > 1:
        estimator = MultipleImportance(
            options.integrand,
            densities,
            heuristic=options.heuristic or "balance",
            counts=options.shares,
            dims=options.dims,
        )
    else:
        estimator = Estimator(options.integrand, *densities, dims=options.dims)
    if options.mirror is not None:
        estimator = Mirrored(estimator, as_choice("--mirror", options.mirror, MIRRORINGS))

    # Let it meet its samplers
    given = default_sampler if options.sampler is None else options.sampler
    texts = given if isinstance(given, list) else [str(given)]
    samplers = [read_sampler(text, estimator.dims) for text in texts]
    return as_subject(estimator, samplers if len(samplers) > 1 else samplers[0], lists=True)


def declared(given: Option, default_note: str = "") -> Declaration:
    """Declare an option of an analysis, which has its default; the note stands behind that in the help."""
    own = given.extra.get("flag", given.flag)
    text = given.meaning.rstrip(".")
    text = text[:1].lower() + text[1:] if text[1:2].islower() else text
    choices = (*given.choices, *given.item_choices)
    if any(choice not in text for choice in choices):
        text += f": {', '.join(choices)}"
    if given.is_flag:
        switch = own if "flag" in given.extra or not given.default else f"--no-{own[2:]}"
        help = f"{text}; on by default" if given.default else text
        return lambda parser: parser.add_argument(
            switch,
            dest=given.name,
            default=None,
            action="store_const",
            const=not given.default,
            help=help.replace("%", "%%"),
        )
    default = given.default
    values = default if isinstance(default, tuple) else (default,)
    shown = ",".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values)
    said = "" if given.required or default is None else f"default {shown}{default_note}"
    listed = given.lists_texts

    def read(name: str, text: str) -> Any:
        if not listed:
            return given.read(text, name)
        # Names have no commas, other texts may: those are given one by one
        texts = text.split(",") if given.item_choices else [text]
        return given.check(tuple(each.strip() for each in texts), name)

    parts = [part for part in (text, "repeatable" if listed else "", said) if part]
    word = given.name.rpartition("_")[2].upper()
    letter = word if given.choices or listed else word[0]
    # One letter may stand for the whole name: -m for --realizations, and -n is all of n
    flags = [own] if own == given.flag or f"-{given.name}" == own or listed else [own, given.flag]
    return option(
        f"{', '.join(flags)} {given.extra.get('metavar', letter)}",
        "; ".join(parts).replace("%", "%%"),
        read,
        repeated="all" if listed else "last",
        dest=given.name,
        required=given.required,
    )
