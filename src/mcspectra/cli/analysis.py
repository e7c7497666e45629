"""Subcommands (verbs) that run analyses, with options and help derived from the analyses.

Each analysis in `mcspectra.core.analysis.ANALYSES` may have a verb that runs it.
Analyses that other packages register may have verbs (subcommands) as well.
The subject of the analysis comes first: a sampler, or an integrand with densities and a sampler.
The options of the analysis follow (`mcspectra.core.options.options_of`).
The module `mcspectra.cli.texts` writes the result as text.

Several analyses may share a verb. In this case ``--split`` chooses one.
The parser has the options of the chosen analysis.
Options of the other analyses with this verb raise an error that names the right ``--split``.
"""

from __future__ import annotations

import argparse
import inspect
import itertools
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import mcspectra as mcs
from mcspectra.cli.common import (
    INTEGRAND,
    Declaration,
    Read,
    Verb,
    VerbOutput,
    given_of,
    group,
    option,
    out,
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
    INTEGRAND,
    option("-d, --dims D", "number of dims, unless the specs fix it", whole()),
    option(
        "--density SPEC",
        "importance density; several are combined by multiple importance sampling (MIS); "
        "repeatable",
        repeated="all",
    ),
    option(
        "--heuristic SPEC",
        "heuristic of MIS: balance (default), power(beta=2), cutoff, maximum, optimal or "
        "variance-aware",
        repeated="once",
    ),
    option(
        "--shares K,K,…",
        "with MIS: points of each technique, as multiples of n",
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
        "add the estimate of another integrand with its own points; repeatable",
        repeated="all",
    ),
)
"""Options that describe the estimator. Each analysis declares its own option for samplers."""


def analysis_verb(names: Sequence[str], given: Sequence[str] = ()) -> Verb:
    """Create the verb of one or several analyses. Its options depend on the given arguments.

    Parameters
    ----------
    names
        Names of the analyses in the registry that share this verb.
        If there are several analyses, ``--split`` chooses one; by default, the first.
    given
        Arguments on the command line after the verb.

    Raises
    ------
    AnalysisError
        If an option has a name that is already in use (`mcspectra.core.analysis.check_names`).
    ParameterError
        If ``--split`` is given, but does not name one of the analyses.
    """
    splits: dict[str, tuple[str, type[Analysis]]] = {}
    for each in names:
        kind = ANALYSES.load(each)
        check_names(kind)
        splits[kind.split] = each, kind
    chosen = next(iter(splits))
    if len(splits) > 1:
        for word, following in itertools.zip_longest(given, given[1:]):
            if word == "--split" and following is not None:
                chosen = following
            elif word.startswith("--split="):
                chosen = word.partition("=")[2]
        as_choice("--split", chosen, tuple(splits))
    name, analysis = splits[chosen]
    own = options_of(analysis)
    views = VIEWS.get(name, {"": table_of_anything})
    usual, *others = views

    # Take the verb's default values from the signature of the public function
    door: Any = mcs
    for part in analysis.function.split("."):
        door = getattr(door, part, None)
    takes = {} if door is None else inspect.signature(door).parameters
    default_sampler = takes["sampler"].default if "sampler" in takes else None
    if not isinstance(default_sampler, str):
        default_sampler = None

    # Declare the subject of the analysis
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
        # An analysis of point sets uses all given sets, unless an option limits their number
        all_sets = any(each.name == "realizations" for each in own)
        declarations = [
            option(
                "SAMPLER",
                "sampler spec, or several for one picture; - reads point sets from standard input",
                dest="sampler",
                nargs="+",
            ),
            option("-d, --dims D", "number of dims (default 2)", whole()),
        ]
        if not takes or "density" in takes:
            declarations.append(option("--density SPEC", "importance density"))

    # Declare the options of the analysis and its views, and the output files
    if len(splits) > 1:
        shown: list[str] = []
        for split, (_, kind) in splits.items():
            text = kind.summary().rstrip(".")
            usual = "" if shown else " (default)"
            shown.append(f"{split}{usual}: {text[:1].lower()}{text[1:]}")
        declarations.append(option("--split SPLIT", "; ".join(shown), default=chosen))
    if all_sets:
        notes = {"realizations": ", or all given sets of points"}
        declarations += [declared(each, notes.get(each.name, "")) for each in own]
    else:
        of_splits = {split: options_of(kind) for split, (_, kind) in splits.items()}
        declarations += _of_splits(chosen, of_splits)
    if others:
        further = [f"{view}: {views[view].__doc__}" for view in others]
        offer = f"{usual} (default); {'; '.join(further)}"
        declarations.append(option("--show VIEW", offer, default=usual))
    declarations.append(
        out(
            ".npz: all values; .csv, .tex: the curve; .png, .svg, .pdf, .pgf: a picture; .html: "
            "a page"
        )
    )

    def run(options: argparse.Namespace) -> VerbOutput:
        view = as_choice("--show", getattr(options, "show", usual), tuple(views))

        # Reject invalid output files before computing
        if options.out:
            from mcspectra.report.result_files import check_result_file, write_result_file

            for file in options.out:
                check_result_file(file)

        # Compute the result, write the output files, and print a view
        wanted = given_of(options, *(each.name for each in own))
        results: dict[str, xr.Dataset] = {}
        for subject in _subjects(options, analysis, default_sampler):
            given = wanted
            if all_sets and isinstance(subject.sampler, GivenPoints):
                sets = subject.sampler.sets.get(given.get("n", 0), subject.sampler.points)
                given = {"realizations": len(sets), **given}
            spec = subject.sampler.spec if analysis.about == "sampler" else ""
            results[spec] = compute(analysis(**given), subject, options.seed or 0)
        result = next(iter(results.values()))
        if len(results) > 1:
            import xarray as xr

            result = xr.concat(results.values(), "sampler", combine_attrs="override")
            result = result.assign_coords(sampler=list(results))
        for file in options.out:
            write_result_file(result, file, f"mcspectra {analysis.command()}", view)
        shown = [views[view](each) for each in results.values()]
        if len(results) == 1:
            return VerbOutput(shown[0].text, {**data_of(result), **shown[0].data})
        text = "\n\n".join(
            f"{spec}\n{each.text}" for spec, each in zip(results, shown, strict=True)
        )
        return VerbOutput(text, data_of(result))

    about = inspect.cleandoc(analysis.__doc__ or "").partition("\n\n")[0]
    if len(splits) > 1:
        lead = f"Split a variance into {', '.join([*splits][:-1])} or {[*splits][-1]}."
        about = f"{lead}\n\nWith --split {chosen}: {about[:1].lower()}{about[1:]}"
    printed = inspect.cleandoc(views[usual].__doc__ or "")
    return Verb(f"{about}\n\n{printed}".strip(), tuple(declarations), run)


def _subjects(
    options: argparse.Namespace, analysis: type[Analysis], default_sampler: str | None
) -> list[Subject]:
    """Create the subjects: each sampler with its density, or an estimator with its samplers."""
    if analysis.about == "sampler":
        from mcspectra.densities.registry import as_warp

        sources = [read_sampler(text, options.dims) for text in options.sampler]
        for source in sources:
            if source.dims != sources[0].dims:
                raise ParameterError(
                    f"The samplers have {sources[0].dims} and {source.dims} dims; give samplers of "
                    "the same dims."
                )
            if sources.count(source) > 1:
                raise ParameterError(f"The sampler {source.spec} is given twice; give it once.")
        density = getattr(options, "density", None)
        return [Subject(None, source, as_warp(density, source.dims)) for source in sources]
    return [_estimator_subject(options, default_sampler)]


def _estimator_subject(options: argparse.Namespace, default_sampler: str | None) -> Subject:
    """Return the estimator and the samplers that the options describe, as one `Subject`."""
    from mcspectra.estimators import (
        MIRRORINGS,
        Estimator,
        Mirrored,
        MultipleImportance,
        TechniqueSum,
        as_subject,
    )

    # Reject options that exclude each other
    densities = options.density or []
    for name, given in (("--heuristic", options.heuristic), ("--shares", options.shares)):
        if given is not None and len(densities) < 2:
            raise ParameterError(f"{name} needs several --density options; give two or more.")
    if options.shares is not None and len(options.shares) != len(densities):
        raise ParameterError(
            f"--shares is {','.join(map(str, options.shares))}; give {len(densities)} numbers, one "
            "for each --density."
        )
    if options.plus and densities:
        raise ParameterError("--plus adds whole techniques; it cannot be used with --density.")

    # Create the estimator
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

    # Combine the estimator with its samplers
    given = default_sampler if options.sampler is None else options.sampler
    texts = given if isinstance(given, list) else [str(given)]
    samplers = [read_sampler(text, estimator.dims) for text in texts]
    return as_subject(estimator, samplers if len(samplers) > 1 else samplers[0], lists=True)


def _of_splits(chosen: str, options: dict[str, tuple[Option, ...]]) -> list[Declaration]:
    """Declare the options of all analyses from which the option --split selects one.

    An option that belongs only to analyses that are not selected raises an error.
    Options of all of these analyses come first.
    The other options follow in groups. A group has the options that the same analyses share.
    """
    owners: dict[str, list[str]] = {}
    for split, its in options.items():
        for each in its:
            for flag in _flags(each):
                owners.setdefault(flag, []).append(split)
    common: list[Declaration] = []
    groups: dict[str, list[Declaration]] = {}
    taken: set[str] = set()
    for split in (chosen, *(each for each in options if each != chosen)):
        for each in options[split]:
            flags = [flag for flag in _flags(each) if flag not in taken]
            taken |= {*flags}
            if not flags:
                continue
            having = max((owners[flag] for flag in flags), key=len)
            *head, last = having
            where = f"--split {' or '.join([', '.join(head), last] if head else [last])}"

            def refuse(label: str, _: Any, where: str = where) -> Any:
                raise ParameterError(f"{label} is for {where}; give that, or leave {label} out.")

            if split == chosen:
                notes = [
                    f", {_default(one)} with --split {other}"
                    for other, its in options.items()
                    for one in its
                    if one.name == each.name and _default(one) not in ("", _default(each))
                ]
                declaration = declared(each, "".join(notes))
            else:
                declaration = declared(each, flags=flags, refuse=refuse)
            if len(having) == len(options):
                common.append(declaration)
            else:
                groups.setdefault(f"with {where}", []).append(declaration)

    def make(title: str) -> Callable[[Any], Any]:
        return lambda parser: parser.add_argument_group(title)

    return [*common, *(group(make(title), *each) for title, each in groups.items())]


def _flags(given: Option) -> list[str]:
    """Return the flags of an option: usually a letter and the name. The option n is only ``-n``."""
    own = given.extra.get("flag", given.flag)
    if given.is_flag:
        return [own if "flag" in given.extra or not given.default else f"--no-{own[2:]}"]
    alone = own == given.flag or f"-{given.name}" == own or given.lists_texts
    return [own] if alone else [own, given.flag]


def _default(given: Option) -> str:
    """Format the default of an option for the help; the text is empty without a default."""
    if given.required or given.default is None or given.is_flag:
        return ""
    values = given.default if isinstance(given.default, tuple) else (given.default,)
    return ",".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values)


def declared(
    given: Option,
    default_note: str = "",
    *,
    flags: Sequence[str] | None = None,
    refuse: Callable[[str, Any], Any] | None = None,
) -> Declaration:
    """Declare an option of an analysis with its default.

    Parameters
    ----------
    given
        The option to declare, with its name, type, default and description.
    default_note
        Text that follows the option's default in the help.
    flags
        Flags to declare. By default, these are all flags of the option.
    refuse
        Function that raises an error if the option is given, but only another analysis has it.
    """
    flags = _flags(given) if flags is None else flags
    text = given.extra.get("help", given.meaning).rstrip(".")
    text = text[:1].lower() + text[1:] if text[1:2].islower() else text
    words = set(re.findall(r"[\w-]+", text))
    if left := [each for each in (*given.choices, *given.item_choices) if each not in words]:
        text += f": {', '.join(left)}"
    if given.is_flag:
        help = f"{text}; on by default" if given.default and "help" not in given.extra else text
        how: dict[str, Any] = {"action": "store_const", "const": not given.default}
        if refuse is not None:
            how = {"action": Read, "read": refuse, "nargs": 0}
        return lambda parser: parser.add_argument(
            *flags, dest=given.name, default=None, help=help.replace("%", "%%"), **how
        )
    said = f"default {_default(given)}{default_note}" if _default(given) else ""
    listed = given.lists_texts

    def read(name: str, text: str) -> Any:
        if not listed:
            return given.read(text, name)
        # Names contain no commas, so commas may separate them. Other texts are not split
        texts = text.split(",") if given.item_choices else [text]
        return given.check(tuple(each.strip() for each in texts), name)

    parts = [part for part in (text, "repeatable" if listed else "", said) if part]
    word = given.name.rpartition("_")[2].upper()
    letter = word if given.choices or listed else word[0]
    return option(
        f"{', '.join(flags)} {given.extra.get('metavar', letter)}",
        "; ".join(parts).replace("%", "%%"),
        refuse or read,
        repeated="all" if listed else "last",
        dest=given.name,
        required=given.required and refuse is None,
    )
