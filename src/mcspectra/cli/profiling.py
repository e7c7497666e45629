"""The verb `profile`: causes of noise, for an integrand, for Markov chains, or for a scene."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.cli.analysis import analysis_verb
from mcspectra.cli.common import (
    Verb,
    VerbOutput,
    group,
    index_or_name,
    joint_dims,
    option,
    real,
    whole,
)
from mcspectra.cli.texts import data_of, table_of_anything
from mcspectra.core.analysis import ANALYSES
from mcspectra.core.checks import PROFILE_PIXELS, SECONDS_LIMITS, TARGET_LIMITS
from mcspectra.core.decoding import check_decoded_size, check_zarr, opened, read_npy
from mcspectra.core.display import printable, shown
from mcspectra.core.errors import (
    FileFormatError,
    McspectraError,
    ParameterError,
    UnknownName,
    close_match_hint,
    reason_of,
)
from mcspectra.core.options import options_of
from mcspectra.core.registry import optional_package

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["profile_"]


_SUFFIXES = (".npy", ".csv", ".nc", ".zarr")
_TEXT_RATIO = 10  # bytes of memory per byte of a .csv file
_PROFILE = analysis_verb(["profile"])


_OF_SCENES = (
    "target",
    "integrator",
    "compare",
    "joint_dims",
    "spp",
    "pixels",
    "seconds",
    "channel",
)


def _profile(options: argparse.Namespace) -> VerbOutput:
    """Profile an integrand, draws of Markov chains, or a scene."""
    subjects: list[str] = options.integrand
    if len(subjects) == 1 and _is_scene(subjects[0]):
        return _of_scene(options, subjects[0])
    for name in (*_OF_SCENES, "dry_run"):
        if getattr(options, name) not in (None, False, []):
            flag = f"--{name.replace('_', '-')}"
            raise ParameterError(f"{flag} is for scenes; leave it out, or give a Mitsuba XML file.")
    files = [text for text in subjects if Path(text).suffix.lower() in _SUFFIXES]
    if not files and len(subjects) == 1 and not Path(subjects[0]).is_file():
        if options.weights is not None:
            raise ParameterError("--weights is for files of draws; leave it out.")
        options.integrand = subjects[0]
        return _PROFILE.run(options)
    if len(files) < len(subjects):
        (other, *_) = (text for text in subjects if text not in files)
        raise FileFormatError(
            f"{shown(other)} is not a file of draws, which ends in {', '.join(_SUFFIXES[:-1])} or "
            f"{_SUFFIXES[-1]}. Give one integrand, or files of draws."
        )
    profiling: Any = ANALYSES.load("profile")
    own = (
        *("dims", "density", "heuristic", "shares", "mirror", "plus", "sampler"),
        *(each.name for each in options_of(profiling)),
    )
    for name in own:
        if getattr(options, name) is not None:
            flag = f"--{name.replace('_', '-')}"
            raise ParameterError(f"{flag} is for integrands; leave it out with files of draws.")
    return _of_draws(options, files)


def _is_scene(subject: str) -> bool:
    """Return whether a subject is a scene: an XML file, or the name of a built-in scene."""
    if Path(subject).suffix.lower() == ".xml":
        return True
    from mcspectra.rendering.scenes import SCENES

    return subject.partition("(")[0].strip() in SCENES


def _of_scene(options: argparse.Namespace, scene: str) -> VerbOutput:
    """Compare samplers in renders of the scene, or print how long this takes."""
    from mcspectra.profiler.scene_profile import plan_scene, profile_scene

    profiling: Any = ANALYSES.load("profile")
    own = ("dims", "density", "heuristic", "shares", "mirror", "plus", "weights")
    for name in (*own, *(each.name for each in options_of(profiling))):
        if getattr(options, name) not in (None, []):
            flag = f"--{name.replace('_', '-')}"
            raise ParameterError(f"{flag} is not for scenes; leave it out.")
    from mcspectra.report.result_files import check_result_file

    for file in options.out:
        check_result_file(file, (".html",))
    asked = {name: getattr(options, name) for name in _OF_SCENES}
    asked = {name: value for name, value in asked.items() if value not in (None, [])}
    asked["samplers"] = [*asked.pop("compare", []), *([options.sampler] if options.sampler else [])]
    asked["rng"] = options.seed or 0
    if options.dry_run:
        asked.pop("spp", None)
        imports = time.perf_counter() - options.begun
        plan = plan_scene(scene, **asked).later(imports)
        return VerbOutput(plan.text, plan.to_dict())
    found = profile_scene(scene, **asked)
    if options.out:
        from mcspectra.report.scene_page import write_scene_profile

        for file in options.out:
            write_scene_profile(found, file)
    written = [f"wrote {printable(file)}" for file in options.out]
    return VerbOutput("\n".join([found.text, *written]), found.to_dict())


def _of_draws(options: argparse.Namespace, files: list[str]) -> VerbOutput:
    """Analyze Markov chains: errors of means, the frequencies that cause them, and problems."""
    from mcspectra.measure.chains import chain_error
    from mcspectra.report.result_files import check_result_file, write_result_file

    for file in options.out:
        check_result_file(file)

    # Read the draws of the chains, one chain per file, and separate them from their weights
    found = [_draws(file) for file in files]
    draws, weights, named = found[0], None, options.weights
    if len(found) > 1:
        import xarray as xr

        arrays = all(isinstance(each, np.ndarray) and each.ndim == 1 for each in found)
        tables = all(isinstance(each, xr.Dataset) and "chain" not in each.dims for each in found)
        held = {x.shape if arrays else (*x, *x.sizes.values()) for x in found if arrays or tables}
        if len(held) != 1:
            raise FileFormatError(
                f"The {len(found)} files do not hold one chain each with the same length and "
                "quantities; give such files, or one file with all chains."
            )
        draws = np.stack(found) if arrays else xr.concat(found, "chain")
    if named is not None and named.endswith(".npy"):
        weights = _draws(named)
    elif named is not None:
        known = list(map(str, getattr(draws, "data_vars", ())))
        if named not in known:
            hint, close = close_match_hint(named, known)
            raise UnknownName(
                f"The draws have no column {shown(named)}.{hint if known else ''}", close
            )
        weights, draws = draws[named].values, draws.drop_vars(named)

    result = chain_error(draws, weights=weights)
    for file in options.out:
        write_result_file(result, file, "mcspectra profile")
    several = "quantity" in result.dims
    plain = result.drop_dims("band") if several else result
    names, said = (np.atleast_1d(result[key].values) for key in ("cause", "evidence"))
    lines = [f"{result.attrs['chains']} × {result.attrs['draws']} draws"]
    if not np.isnan(result["mcse"]).all():  # if no chain moves, all errors are NaN
        lines.append(table_of_anything(plain).text)
    for k, name in enumerate(names):
        start = f"{result['quantity'].values[k]}: " if several else ""
        lines.append(f"{start}{said[k] or f'cause: {name}'}.")
    return VerbOutput("\n".join(lines), data_of(result))


profile_ = Verb(
    f"""Find the causes of the noise of an integrand, and the best remedy at a budget.

For a scene, a Mitsuba XML file or a built-in name, it compares samplers as they are rendered, on
pixels from all parts of the image. It prints the sampler to use, the samples per pixel that reach
--target, the decisions that cause the variance, and the worst pixels. Samplers of this package are
padded like those of renderers: each request of the integrator has its own points. The first 4
numbers of a path are joint for randomized nets (--joint-dims). With -o page.html it writes a page.

{_PROFILE.text.partition(chr(10) * 2)[2]}

For files of draws of Markov chains it prints the standard error of each mean, its frequencies, and
problems of the chains. A .npy file holds one chain (n,), or (chain, draw), or (chain, draw,
quantity). A .csv file has one column per quantity, one row per draw, and names in the first line.
Each chain is a file, as written by Stan, or a column 'chain' numbers the chains. A .nc or .zarr
store has the dims chain and draw, at its root or in the group posterior, as written by ArviZ.""",
    (
        option(
            "SUBJECT",
            "integrand spec, e.g. 'gaussian(width=0.25)', a function in Python, module:function, "
            "with --dims and --allow-code, a scene (.xml or a name), or files of draws: .npy, "
            ".csv, .nc or .zarr",
            dest="integrand",
            nargs="+",
        ),
        *_PROFILE.options[1:],
        option("--weights NAME", "for draws: column or variable of the weights, or a .npy file"),
        group(
            lambda parser: parser.add_argument_group("scenes"),
            option(
                "--target E",
                "relative error, σ / mean, that pixels should reach (default 0.05)",
                real(**TARGET_LIMITS),
            ),
            option("--integrator SPEC", "integrator of Mitsuba (default: the scene's own)"),
            option(
                "--compare SPEC",
                "a further sampler of this package to compare; repeatable",
                repeated="all",
            ),
            option(
                "--joint-dims K",
                "first numbers of a path that are joint; the others are padded (default 4 for "
                "randomized nets, else 0)",
                joint_dims,
            ),
            option("--spp N", "samples per pixel now (default: the scene's own)", whole()),
            option("--channel CHANNEL", "luminance (default), 0, 1 or 2", index_or_name),
            option(
                "--pixels N",
                "most pixels that are rendered (default 1024)",
                whole(**PROFILE_PIXELS),
            ),
            option("--seconds S", "time for renders (default 30)", real(**SECONDS_LIMITS)),
            option("--dry-run", "only print the size of the profile and the time it takes"),
        ),
    ),
    _profile,
)


def _draws(name: str) -> Any:
    """Read an array or a dataset from a file."""
    import xarray as xr

    file = Path(name)
    if file.suffix.lower() == ".zarr":
        optional_package("zarr", "store", "Files .zarr need")
        try:
            if not file.is_dir():
                raise FileFormatError(f"{file} is not a folder; give the path of a store.")
            check_zarr(file)
            with xr.open_datatree(file, engine="zarr", consolidated=False) as tree:
                return _posterior(tree).load()
        except McspectraError:
            raise
        except Exception as error:  # noqa: BLE001 - zarr and its codecs may raise anything
            raise FileFormatError(f"{file} cannot be read as .zarr: {reason_of(error)}.") from None
    with opened(file, "draws of Markov chains", _SUFFIXES) as (stream, size, named, extension):
        match extension:
            case ".npy":
                return read_npy(stream, size, named)
            case ".csv":
                check_decoded_size(named, size, _TEXT_RATIO * size)
                return _table(stream.read().decode("utf-8-sig"), named)
            case _:
                with xr.open_datatree(file) as tree:
                    check_decoded_size(named, size, tree.nbytes)
                    return _posterior(tree).load()


def _posterior(tree: xr.DataTree) -> xr.Dataset:
    return getattr(tree, "posterior", tree).to_dataset()


def _table(text: str, file: str) -> xr.Dataset:
    """Read the quantities in a .csv file. Stan's diagnostics (names ending in __) are left out."""
    import xarray as xr

    lines = [line for line in text.splitlines() if line.strip()]
    lines = [line.replace('"', "") for line in lines if line[0] != "#"]
    if len(lines) < 2:
        raise FileFormatError(
            f"{file} holds no draws; give a line of names and a line of numbers per draw."
        )
    table = np.genfromtxt(lines, delimiter=",", names=True, deletechars="", ndmin=1)
    columns = {name: ("draw", table[name]) for name in table.dtype.names or ()}
    _, chain = columns.pop("chain", ("", np.zeros(table.size)))
    kept = [name for name in columns if name != "draw" and not name.endswith("__")]
    data = xr.Dataset({name: columns[name] for name in kept})
    split = [data.isel(draw=np.flatnonzero(chain == label)) for label in np.unique(chain)]
    return xr.concat(split, "chain") if len(split) > 1 else data
