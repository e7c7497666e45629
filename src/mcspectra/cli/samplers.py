"""The verbs of samplers: list names, draw points, integrate and compare samplers."""

from __future__ import annotations

import argparse
import importlib
import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mcspectra as mcs
from mcspectra.cli.common import (
    INTEGRAND,
    VerbOutput,
    given_of,
    group,
    one_sentence_warnings,
    option,
    out,
    page_table,
    read_sampler,
    real,
    text_table,
    verb,
    whole,
    wholes,
)
from mcspectra.cli.texts import data_of
from mcspectra.core.checks import as_choice
from mcspectra.core.decoding import path_to_write
from mcspectra.core.display import QUOTED, counted, printable, shown
from mcspectra.core.errors import FileFormatError, MissingDependency, Parameter, ParameterError
from mcspectra.core.progress import report
from mcspectra.plots.paper import COLORS, SPECTRA, inches

__all__ = ["bench_", "integrate_", "list_", "points_"]

_STYLES = ("page", "paper")
_NO_VERB = "no verb: for study files"
_REGISTRIES = {
    "samplers": ("mcspectra.samplers", "SAMPLERS"),
    "randomizations": ("mcspectra.samplers", "RANDOMIZATIONS"),
    "densities": ("mcspectra.densities", "DENSITIES"),
    "integrands": ("mcspectra.integrands", "INTEGRANDS"),
    "scenes": ("mcspectra.rendering", "SCENES"),
    "filters": ("mcspectra.rendering.frame_filters", "FILTERS"),
    "screen-samplers": ("mcspectra.rendering.screen_samplers", "SCREEN_SAMPLERS"),
    "analyses": ("mcspectra.core.analysis", "ANALYSES"),
}


def _choice(known: tuple[str, ...]) -> Callable[[str, str], str]:
    """Return a parser of option values that accepts only the given words."""
    return lambda name, text: as_choice(name, text, known)


@verb(option("KIND", f"one of {', '.join(_REGISTRIES)}"))
def list_(options: argparse.Namespace) -> VerbOutput:
    """List the names that specs may use, and the analyses."""
    kind = as_choice("kind", options.kind, tuple(_REGISTRIES))
    module, attribute = _REGISTRIES[kind]
    registry = getattr(importlib.import_module(module), attribute)

    # Describe each entry. If an entry cannot be loaded, show the reason instead of its summary
    rows: list[dict[str, Any]] = []
    for name in registry:
        try:
            cls = registry.load(name)
            row = {
                "name": name,
                "summary": (inspect.getdoc(cls) or cls.__name__).splitlines()[0],
                "parameters": [
                    p.name.rstrip("_") + ("" if p.default is p.empty else f"={p.default!r}")
                    for p in inspect.signature(cls).parameters.values()
                ],
            }
            if kind == "samplers":
                from mcspectra.samplers.facts import sampler_facts

                facts = sampler_facts(name)
                row |= {"dims": facts.dims, "counts": facts.counts, "sources": facts.sources}
            if kind == "analyses":
                row |= {"verb": cls.command(), "function": cls.function, "about": cls.about}
        except Exception as error:  # noqa: BLE001 - components of other packages may raise anything
            reason = f"{registry[name]} is not a {registry.kind} ({type(error).__name__})"
            if isinstance(error, MissingDependency):
                reason = str(error)
            row = {"name": name, "summary": f"not available: {reason}", "parameters": []}
        rows.append(row)

    # Print the summary and the parameters of each component.
    # For an analysis, also print the command that runs it.
    # For a sampler, also print dims, counts and sources
    widest, lines = max(len(row["name"]) for row in rows), []
    for row in rows:
        lines.append(f"{row['name'].ljust(widest)}  {row['summary']}")
        more = [", ".join(row["parameters"])]
        if "verb" in row:
            more.append(f"mcspectra {row['verb']}" if row["verb"] else _NO_VERB)
        elif "dims" in row:
            more += [f"dims: {row['dims']}; n: {row['counts']}", row["sources"]]
        lines += [f"{'':{widest}}    {line}" for line in more if line]
    return VerbOutput("\n".join(lines), rows)


@verb(
    option("SAMPLER", "sampler spec, e.g. 'jittered | shift'; - reads points from standard input"),
    option("-n N", "points per set", whole(), required=True),
    option("-d, --dims D", "number of dims (default 2)", whole()),
    option("-m, --realizations R", "number of sets (default 1)", whole()),
    option("--density SPEC", "warp the points to this density"),
    out("points or a picture, see above; - is standard output"),
    option("--quality", "print quality figures instead of points"),
)
def points_(options: argparse.Namespace) -> VerbOutput:
    """Draw point sets, and print, write, plot or measure them.

    Without -o, points are printed as text in UTK's format: one point per line, '#' between sets.
    Files .dat, .bin, .npz, .npy and .csv hold points; .svg, .png, .pdf and .pgf are pictures.
    --quality prints a table of distances, discrepancies and other figures, by default over 16 sets.
    """
    from mcspectra.core.pointfiles import EXTENSIONS, format_dat, write_points
    from mcspectra.densities import as_density
    from mcspectra.plots.backend_matplotlib import FORMATS, write
    from mcspectra.plots.points import point_sets

    # Before drawing, reject files that cannot be written
    sampler = read_sampler(options.sampler, options.dims)
    density = as_density(options.density, sampler.dims)
    seed, n = options.seed or 0, options.n
    files = [file for file in options.out if file != "-"]
    printed = len(files) < len(options.out) or not (files or options.quality)
    for file in files:
        extension = Path(file).suffix.lower()
        if extension not in (*EXTENSIONS, *FORMATS):
            given = f"the extension {shown(Path(file).suffix)}" if extension else "no extension"
            raise FileFormatError(
                f"{printable(file, QUOTED)} has {given}; points need {', '.join(EXTENSIONS)}, and "
                f"pictures {', '.join(FORMATS)}."
            )
        path_to_write(file, "a file", (extension,))

    # Draw the requested number of point sets, or as many as the quality figures need
    count = options.realizations
    if count is None and options.quality:
        from mcspectra.core.streams import Stream
        from mcspectra.quality.figures import different_realizations

        count = different_realizations(sampler, sampler.check_count(n), Stream.from_rng(seed))
    points = sampler.draw(n, realizations=count or 1, rng=seed)
    meta: dict[str, Any] = {"sampler": sampler.spec, "n": points.shape[1], "seed": seed}
    if density is not None:
        points, meta["density"] = density.sample(points), density.spec

    # Write the point sets to files
    for file in files:
        if Path(file).suffix.lower() in EXTENSIONS:
            write_points(file, list(points), meta=meta)
        else:
            title = ", ".join([sampler.spec, f"n = {meta['n']}", f"seed {seed}"])
            title += f", density {density.spec}" if density is not None else ""
            write(point_sets(points, title), file, captioned=True)

    # Measure the quality of the sets
    if options.quality:
        from mcspectra.quality import quality_figures, summarize

        source: Any = sampler if density is None else points
        count, n, _ = points.shape
        # The same warnings were already shown when the points were drawn, so they are not repeated
        with one_sentence_warnings(quiet=True):
            figures = summarize(quality_figures(source, n, realizations=count, rng=seed))
        rows: list[list[str]] = []
        missing: list[str] = []
        figures_of: dict[str, dict[str, Any]] = {}
        for each in figures:
            if each.missing:
                missing.append(f"no {each.name}: {each.missing}")
                figures_of[each.name] = {
                    "mean": None,
                    "standard_error": None,
                    "missing": each.missing,
                }
            else:
                error = "-" if math.isnan(each.standard_error) else f"{each.standard_error:.2g}"
                rows.append([each.name, each.long_name, f"{each.mean:.5g}", error])
                figures_of[each.name] = {"mean": each.mean, "standard_error": each.standard_error}
        title = f"{sampler.spec}, n = {n}, {count} set{'s' if count > 1 else ''}"
        table = text_table(["figure", "meaning", "mean", "± standard error"], rows)
        parts, data = (
            [title, table, *missing],
            {**meta, "realizations": count, "quality": figures_of},
        )
    else:
        parts, data = [], {**meta, "shape": points.shape}
    data |= {"files": files} if files else {}
    if printed and options.json:
        data["points"] = points
    elif printed:
        parts.insert(0, format_dat(list(points)).rstrip("\n"))
    return VerbOutput("\n".join(parts), data)


@verb(
    INTEGRAND,
    option("--budget B", "most evaluations of the integrand", whole(), required=True),
    option("-d, --dims D", "number of dims, if the spec does not fix it", whole()),
    option("--density SPEC", "importance density"),
    option(
        "--sampler SPEC",
        "a randomized sampler (default 'sobol | owen', with --combine median 'sobol | lms')",
    ),
    option(
        "--combine HOW",
        "mean of the replicates (default), or median, which needs linear scrambles",
    ),
    option("--tolerance W", "stop at this half width of the interval", real(above=0.0)),
    option("--cache FILE", "file of values by point; a later run reuses them"),
)
def integrate_(options: argparse.Namespace) -> VerbOutput:
    """Integrate a function within a budget of evaluations.

    Prints the value, its 95 % interval, and the number of evaluations.
    Also prints the number and the size of the replicates.
    """
    found = mcs.integrate(
        mcs.Estimator(options.integrand, options.density, dims=options.dims),
        budget=options.budget,
        sampler=options.sampler,
        combine=options.combine or "mean",
        cache=options.cache,
        tolerance=options.tolerance,
        rng=options.seed or 0,
    )
    data: dict[str, Any] = {str(name): found[name].values.tolist() for name in found}
    low, high = data["interval"]
    text = (
        f"{data['value']:.10g}, 95 %: {low:.10g} to {high:.10g}\n"
        f"{counted(data['calls'], 'evaluation')} for {data['replicates']} replicates of "
        f"{data['n']} points of {found.attrs['sampler']}"
    )
    note = found.attrs.get("note")
    return VerbOutput(f"{text}\n{note}" if note else text, data | ({"note": note} if note else {}))


@verb(
    option(
        "SPEC",
        "samplers, e.g. jittered \"points(path='mine.dat') | shift\"; by default all that need "
        "no file",
        dest="specs",
        nargs="*",
    ),
    option("-n, --counts N,N,…", "numbers of points (default 16,64,256,1024)", wholes()),
    option("-d, --dims D,D,…", "numbers of dims of the integrands (default 2)", wholes()),
    option("-m, --realizations R", "point sets per variance (default 400)", whole(2)),
    out(
        ".html, or a folder: the page; .pdf: its tables and pictures; .csv, .tex: rates; .pgf: "
        "convergence; with --style paper a folder"
    ),
    group(
        lambda parser: parser.add_argument_group(
            "masks and screen-space samplers",
            "SPEC may also be tiles, tables, python or command; -n is the number of points per "
            "pixel (default 1), -m the number of blocks (default 8)",
        ),
        option("--screen INTEGRAND", "rank by the errors of pixels, over space and time"),
        option("--block W,H,T", "pixels and frames (default 64,64,128)", wholes("W,H,T")),
        option("--sigma S", "width of the blur in pixels (default 1.5)", real(least=0.1)),
        option("--alpha A", "weight of a new frame in the EMA (default 0.1)", real(least=0.001)),
    ),
    group(
        lambda parser: parser.add_argument_group("figures for a paper"),
        option(
            "--style NAME",
            "page (default), or paper: figures and tables for LaTeX",
            _choice(_STYLES),
        ),
        option(
            "--width W", "width of a paper's figures, e.g. 3.33in or 84mm (default 3.33in)", inches
        ),
        option(
            "--font-size PT",
            "size of a paper's texts in points (default 8)",
            real(least=3.0, most=30.0),
        ),
        option(
            "--spectra SCALE",
            "color scale of a paper's spectra: linear (default), log",
            _choice(SPECTRA),
        ),
        option(
            "--colors MAP", "colors of a paper's spectra: gray, viridis (default)", _choice(COLORS)
        ),
    ),
)
def bench_(options: argparse.Namespace) -> VerbOutput:
    """Compare samplers: rates, ranks, points, spectra, projections, quality, speed.

    Prints a table of rates on standard integrands, with ranks in brackets.
    The 95 % intervals of the rates are simultaneous.
    A sampler is left out for dims that it does not support.

    The page, FILE.html or DIR/index.html, has a section for each sampler.
    A section shows points and spectrum in 2-D, and lists dims, counts and sources.
    DIR/bench.csv has the numbers.

    --screen compares masks and screen-space samplers by their errors in images, before any render.
    The table has the variance, its share at low frequencies, and the variance after filters.

    With --style paper, DIR has each figure as PDF, PGF and SVG, and the tables.
    The file main.tex in DIR contains all figures and tables.
    Width, sizes and colors that are not given follow the rcParams of Matplotlib.
    """
    look = given_of(options, "width", "font_size", "spectra", "colors")
    paper = options.style == "paper"
    if look and not paper:
        name = next(iter(look)).replace("_", "-")
        raise ParameterError(f"--{name} is for figures of a paper; add --style paper.")
    if options.screen is not None:
        if paper:
            raise ParameterError("--style paper is not for --screen; leave one of them out.")
        return _screen(options)
    for name in ("block", "sigma", "alpha"):
        if getattr(options, name) is not None:
            raise ParameterError(Parameter(name), " needs ", Parameter("screen"), "; add it.")
    from mcspectra.report.bench_page import bench_table, check_bench_file, is_folder, write_bench
    from mcspectra.report.sampler_cards import CardEffort, all_samplers, measure_card

    for file in options.out:
        check_bench_file(file)
        if paper and not is_folder(file):
            raise ParameterError(f"--style paper writes a folder; {shown(file)} is a file.")
    if paper and not options.out:
        raise ParameterError("--style paper writes a folder; give its name with -o.")
    specs, seed = options.specs or all_samplers(options.dims or (2,)), options.seed or 0
    given = given_of(options, "counts", "dims", "realizations")
    bench = mcs.sampler_bench(specs, **given, rng=seed)

    # An HTML page has one section for each sampler, called the card of the sampler.
    # Cards are measured only if such a page is written.
    # The result of `sampler_bench` already has the rates, so each card uses only the largest count
    cards = []
    if not paper and any(is_folder(file) or file.endswith(".html") for file in options.out):
        spectra = min(200, options.realizations or 200)
        effort = CardEffort(n=min(int(bench["n"][-1]), 1024), spectra=spectra, counts=())
        for k, spec in enumerate(specs):
            report("cards", k / len(specs))
            cards.append(measure_card(spec, effort=effort, rng=seed))
        report("cards", 1.0)
    columns, rows = bench_table(bench)
    lines = [text_table(["", *columns[1:]], rows), bench.attrs.get("note", "")]
    written = []
    for file in options.out:
        if paper:
            from mcspectra.report.paper import write_paper

            written.append(write_paper(bench, file, **look)[-1])
        else:
            written.append(write_bench(bench, file, cards))
    lines += [f"bench: {path}" for path in written]
    data = data_of(bench) | ({"files": written} if written else {})
    return VerbOutput("\n".join(filter(None, lines)), data)


_MASKS = (
    "random",
    "sobol | decorrelate(mask='white')",
    "sobol | decorrelate(mask='r2')",
    "sobol | decorrelate(mask='blue-noise')",
    "sobol | decorrelate(mask='blue-noise', time='golden')",
    "sobol | decorrelate(mask='spatiotemporal')",
)
"""Samplers that ``bench --screen`` compares if none are given."""


def _screen(options: argparse.Namespace) -> VerbOutput:
    """Compare masks and screen-space samplers by the errors of images."""
    from mcspectra.rendering import screen_spectrum
    from mcspectra.report.screen_page import (
        check_screen_file,
        screen_findings,
        screen_summary,
        screen_table,
        write_screen,
    )

    for file in options.out:
        check_screen_file(file)
    for name, given in (("counts", options.counts), ("dims", options.dims)):
        if given is not None and len(given) > 1:
            raise ParameterError(
                Parameter(name), f" has {len(given)} numbers; with --screen give one."
            )
    result = screen_spectrum(
        options.specs or list(_MASKS),
        options.screen,
        (options.counts or [1])[0],
        dims=(options.dims or [None])[0],
        seeds=options.realizations or 8,
        rng=options.seed or 0,
        **given_of(options, "block", "sigma", "alpha"),
    )
    table = screen_table(result)
    lines = [page_table(table), table.caption, *screen_findings(result)]
    written = [write_screen(result, file) for file in options.out]
    lines += [f"screen: {path}" for path in written]
    data = screen_summary(result) | ({"files": written} if written else {})
    return VerbOutput("\n".join(lines), data)
