"""The verb of any analysis: its options and their help are derived from the analysis itself.

An analysis of `mcspectra.core.analysis.ANALYSES` that has a verb is one, those of other packages too.
What is analysed comes first (an integrand with densities and a sampler, or a sampler alone), then the
options of `mcspectra.core.options.options_of`. `mcspectra.cli.texts` shows the result.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import mcspectra as mcs
from mcspectra.cli.common import Answer, Read, adder, read_sampler, whole, wholes, writing
from mcspectra.cli.texts import VIEWS, data_of, table_of_anything
from mcspectra.core.analysis import ANALYSES, Analysis, Subject, compute
from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.options import Option, options_of
from mcspectra.samplers import GivenPoints

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.estimators import AbstractEstimator

__all__ = ["AnalysisVerb", "add_option", "given_options"]

_COMPARE = ("convergence",)  # analyses that take several samplers
_FILES = (".npz", ".png", ".pdf")


class AnalysisVerb:
    """What `mcspectra.cli.main` asks of a verb's module, for an analysis by its name."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._analysis: type[Analysis] = ANALYSES.load(name)
        self._options = options_of(self._analysis)  # type: ignore[arg-type]
        self._views = VIEWS.get(name, {"": table_of_anything})
        # What the public function takes says what its verb does
        door = getattr(mcs, self._analysis.function, None)
        self._takes = {} if door is None else inspect.signature(door).parameters
        about = inspect.cleandoc(self._analysis.__doc__ or "").partition("\n\n")[0]
        printed = (next(iter(self._views.values())).__doc__ or "").replace("\n    ", "\n")
        self.__doc__ = f"{about}\n\n{printed}"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add what is analysed, the options of the analysis, and those of its views."""
        add = adder(parser)
        if self._analysis.about == "estimator":
            self._add_estimator(add)
        else:
            add("sampler", "sampler spec; - reads point sets from standard input")
            add("-d, --dims D", "number of dims (default 2)", whole())
            if not self._takes or "density" in self._takes:
                add("--density SPEC", "importance density")
        for option in self._options:
            more = ", or all sets of points that are given" if self._all_sets else ""
            add_option(parser, option, more if option.name == "realizations" else "")
        default, *others = self._views
        if others:
            shown = [f"{name}: {self._views[name].__doc__}" for name in others]
            add("--show VIEW", f"{default} (default); {'; '.join(shown)}", default=default)
        add("-o, --out FILE", ".npz: all values; .png or .pdf: a picture, if there is one")

    def _add_estimator(self, add: Callable[..., None]) -> None:
        add("integrand", "integrand spec, e.g. 'gaussian(width=0.25)'")
        add("-d, --dims D", "number of dims, where specs leave it open", whole())
        add("--density SPEC", "density; several mean MIS", repeated="all")
        add(
            "--heuristic SPEC",
            "MIS: balance (default), power(beta=2), cutoff, maximum, optimal or variance-aware",
            repeated="once",
        )
        techniques = "MIS: points of each technique, in units of n"
        add("--shares K,K,…", techniques, wholes(), repeated="once")
        modes = "mirror the integrand or the samples: integrand, random or uniform"
        add("--mirror MODE", modes, repeated="once")
        add(
            "--plus SPEC",
            "further integrand, sampled on its own and added (techniques in primary space)",
            repeated="all",
        )
        several, default = self._name in _COMPARE, self._default_sampler
        about = f"sampler spec{'; repeatable' if several else ''}"
        add(
            "--sampler SPEC",
            about if default is None else f"{about} (default {default})",
            repeated="all" if several else "once",
            required=default is None,
        )

    def run(self, options: argparse.Namespace) -> Answer:
        """Compute, write and show."""
        view = as_choice(
            "--show", getattr(options, "show", next(iter(self._views))), tuple(self._views)
        )
        self._check_file(options.out)
        given = given_options(options, self._analysis)
        subject = self._subject(options)
        if self._all_sets and isinstance(subject.sampler, GivenPoints):
            given = {"realizations": len(subject.sampler.points), **given}
        result = compute(self._analysis(**given), subject, options.seed or 0)
        if options.out is not None:
            with writing(options.out):
                _write(result, options.out)
        text, data = self._views[view](result)
        return Answer(text, {**data_of(result), **data})

    @property
    def _all_sets(self) -> bool:
        """Whether an analysis of point sets takes all that are given, unless it is told how many."""
        counted = any(option.name == "realizations" for option in self._options)
        return counted and self._analysis.about == "sampler"

    @property
    def _default_sampler(self) -> str | None:
        taken = self._takes.get("sampler")
        return taken.default if taken is not None and isinstance(taken.default, str) else None

    def _subject(self, options: argparse.Namespace) -> Subject:
        if self._analysis.about == "sampler":
            from mcspectra.densities import as_warp

            source = read_sampler(options.sampler, options.dims)
            density = as_warp(getattr(options, "density", None), source.dims)
            return Subject(None, source, density)
        from mcspectra.estimators import as_subject

        estimator = _estimator(options)
        texts = options.sampler or self._default_sampler or ""
        if isinstance(texts, list):
            samplers = [read_sampler(text, estimator.dims) for text in texts]
            return as_subject(estimator, samplers, lists=True)
        return as_subject(estimator, read_sampler(texts, estimator.dims))

    def _check_file(self, file: str | None) -> None:
        """Refuse files that cannot be made before anything is computed."""
        if file is None or Path(file).suffix == ".npz":
            return
        if Path(file).suffix not in _FILES:
            raise ParameterError(
                f"--out is {file!r}; it must end in {', '.join(_FILES[:-1])} or {_FILES[-1]}."
            )
        from mcspectra.report.accessor import has_picture

        if not has_picture(self._analysis.variables):
            raise ParameterError(
                f"--out is {file!r}; no picture shows {self._name}, give a .npz file."
            )


def add_option(parser: argparse.ArgumentParser, option: Option, default_note: str = "") -> None:
    """Add an option of an analysis, which has its default; the note stands behind that in the help."""
    own = option.extra.get("flag", option.flag)
    text = option.meaning.rstrip(".")
    text = text[:1].lower() + text[1:] if text[1:2].islower() else text
    choices = (*option.choices, *option.item_choices)
    if any(choice not in text for choice in choices):
        text += f": {', '.join(choices)}"
    if option.is_flag:
        switch = own if "flag" in option.extra or not option.default else f"--no-{own[2:]}"
        parser.add_argument(
            switch,
            dest=option.name,
            default=None,
            action="store_const",
            const=not option.default,
            help=_escaped(f"{text}; on by default" if option.default else text),
        )
        return
    default = option.default
    values = default if isinstance(default, tuple) else (default,)
    shown = ",".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values)
    said = "" if option.required or default is None else f"default {shown}{default_note}"
    listed = option.lists_texts

    def read(name: str, given: str) -> Any:
        if not listed:
            return option.read(given, name)
        # Names have no commas, other texts may: those are given one by one
        texts = given.split(",") if option.item_choices else [given]
        return option.check(tuple(text.strip() for text in texts), name)

    word = option.name.rpartition("_")[2].upper()
    letter = word if option.choices or listed else word[0]
    # One letter may stand for the whole name: -m for --realizations, and -n is all of n
    flags = (
        [own] if own == option.flag or f"-{option.name}" == own or listed else [own, option.flag]
    )
    parser.add_argument(
        *flags,
        action=Read,
        read=read,
        repeated="all" if listed else "last",
        dest=option.name,
        required=option.required,
        metavar=option.extra.get("metavar", letter),
        help=_escaped("; ".join(filter(None, (text, "repeatable" if listed else "", said)))),
    )


def given_options(options: argparse.Namespace, analysis: type[Analysis]) -> dict[str, Any]:
    """The options of an analysis that were given; the analysis has defaults for the others."""
    found = {each.name: getattr(options, each.name, None) for each in options_of(analysis)}
    return {name: value for name, value in found.items() if value is not None}


def _escaped(text: str) -> str:
    return text.replace("%", "%%")


def _write(result: xr.Dataset, file: str) -> None:
    if file.endswith(".npz"):
        np.savez(file, **{str(name): v.values for name, v in result.variables.items()})  # type: ignore[arg-type]
        return
    axes = result.mcspectra.plot()
    (axes[0] if isinstance(axes, list) else axes).figure.savefig(file)


def _estimator(options: argparse.Namespace) -> AbstractEstimator:
    """Make the estimator that the options describe."""
    from mcspectra.estimators import (
        MIRRORINGS,
        Estimator,
        Mirrored,
        MultipleImportance,
        TechniqueSum,
    )

    densities = options.density or []
    for name, given in (("--heuristic", options.heuristic), ("--shares", options.shares)):
        if given is not None and len(densities) < 2:
            raise ParameterError(f"{name} is about several --density options; give two or more.")
    if options.shares is not None and len(options.shares) != len(densities):
        raise ParameterError(
            f"--shares has {len(options.shares)} numbers for {len(densities)} densities; give one "
            "for each."
        )
    if options.plus and densities:
        raise ParameterError("--plus adds whole techniques; it cannot be used with --density.")
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
    if options.mirror is None:
        return estimator
    return Mirrored(estimator, as_choice("--mirror", options.mirror, MIRRORINGS))
