"""The verbs of samplers: what can be named in specs, points drawn, samplers side by side."""

from __future__ import annotations

import argparse
import importlib
import inspect
import math
from pathlib import Path
from typing import Any

import mcspectra as mcs
from mcspectra.cli.common import (
    Answer,
    given_of,
    one_sentence_warnings,
    option,
    read_sampler,
    text_table,
    verb,
    whole,
    wholes,
)
from mcspectra.cli.texts import data_of
from mcspectra.core.checks import as_choice
from mcspectra.core.display import printable
from mcspectra.core.errors import FileFormatError, MissingDependency

__all__ = ["bench_", "gallery_", "integrate_", "list_", "points_"]

_NO_VERB = "no verb: for study files"
_REGISTRIES = {
    "samplers": ("mcspectra.samplers", "SAMPLERS"),
    "randomizations": ("mcspectra.samplers", "RANDOMIZATIONS"),
    "densities": ("mcspectra.densities", "DENSITIES"),
    "integrands": ("mcspectra.integrands", "INTEGRANDS"),
    "scenes": ("mcspectra.rendering", "SCENES"),
    "analyses": ("mcspectra.core.analysis", "ANALYSES"),
}


@verb(option("kind", f"one of {', '.join(_REGISTRIES)}"))
def list_(options: argparse.Namespace) -> Answer:
    """List what can be named in specs, and the analyses."""
    kind = as_choice("kind", options.kind, tuple(_REGISTRIES))
    module, attribute = _REGISTRIES[kind]
    registry = getattr(importlib.import_module(module), attribute)

    # Describe each; one that cannot be loaded says why in its summary
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
                row |= {"verb": cls.verb, "function": cls.function, "about": cls.about}
        except Exception as error:  # noqa: BLE001 - components from elsewhere may raise anything
            reason = f"{registry[name]} is no {registry.kind} ({type(error).__name__})"
            if isinstance(error, MissingDependency):
                reason = str(error)
            row = {"name": name, "summary": f"not available: {reason}", "parameters": []}
        rows.append(row)

    # Show the summary of each, its parameters, and its verb or its dims, counts and sources
    widest, lines = max(len(row["name"]) for row in rows), []
    for row in rows:
        lines.append(f"{row['name'].ljust(widest)}  {row['summary']}")
        more = [", ".join(row["parameters"])]
        if "verb" in row:
            more.append(f"mcspectra {row['verb']}" if row["verb"] else _NO_VERB)
        elif "dims" in row:
            more += [f"dims: {row['dims']}; n: {row['counts']}", row["sources"]]
        lines += [f"{'':{widest}}    {line}" for line in more if line]
    return Answer("\n".join(lines), rows)


@verb(
    option("sampler", "sampler spec, e.g. 'jittered | shift'; - reads points"),
    option("-n N", "points in a set", whole(), required=True),
    option("-d, --dims D", "number of dims (default 2)", whole()),
    option("-m, --realizations R", "number of sets (default 1)", whole()),
    option("-s S", "short for --seed", lambda _, text: whole(0)("--seed", text), dest="seed"),
    option("--density SPEC", "warp the points to this density"),
    option("-o, --out FILE", "file; - is stdout", default="-"),
    option("--quality", "print quality figures, not points"),
)
def points_(options: argparse.Namespace) -> Answer:
    """Draw point sets; write, picture or judge them.

    Text goes to standard output in UTK's format (a point a line, '#' between sets), files by ending:
    .dat, .bin, .npz, .npy, .csv, .parquet hold points; .svg, .png, .pdf are pictures. With --quality the
    output is a table of distances, discrepancies and so on, over 16 sets unless -m says how many.
    """
    from mcspectra.core.pointfiles import EXTENSIONS, format_dat, write_points
    from mcspectra.densities import as_density
    from mcspectra.plots.backend_matplotlib import FORMATS, write
    from mcspectra.plots.points import point_sets

    # Refuse files that cannot be written
    sampler = read_sampler(options.sampler, options.dims)
    density = as_density(options.density, sampler.dims)
    seed, n, file = options.seed or 0, options.n, options.out
    extension = Path(file).suffix.lower()
    if file != "-" and extension not in (*EXTENSIONS, *FORMATS):
        given = f"the extension {Path(file).suffix!r}" if extension else "no extension"
        raise FileFormatError(
            f"{file} has {given}; points are {', '.join(EXTENSIONS)} files, pictures "
            f"{', '.join(FORMATS)}."
        )

    # Draw as many sets as are asked for, or as quality figures need
    count = options.realizations
    if count is None and options.quality:
        from mcspectra.core.streams import Stream
        from mcspectra.quality.figures import different_realizations

        count = different_realizations(sampler, sampler.check_count(n), Stream.from_rng(seed))
    points = sampler.draw(n, realizations=count or 1, rng=seed)
    meta: dict[str, Any] = {"sampler": sampler.spec, "n": points.shape[1], "seed": seed}
    if density is not None:
        points, meta["density"] = density.sample(points), density.spec

    # Write them
    if extension in EXTENSIONS and file != "-":
        write_points(file, list(points), meta=meta)
    elif file != "-":
        title = ", ".join([sampler.spec, f"n = {meta['n']}", f"seed {seed}"])
        title += f", density {density.spec}" if density is not None else ""
        write(point_sets(points, title), file, captioned=True)

    # Measure them; the table is the result, --quiet silences remarks only
    if options.quality:
        from mcspectra.quality import quality_figures, summarize

        source: Any = sampler if density is None else points
        count, n, _ = points.shape
        with one_sentence_warnings(quiet=True):  # said when the points were drawn
            figures = summarize(quality_figures(source, n, realizations=count, rng=seed))
        rows: list[list[str]] = []
        missing: list[str] = []
        data: dict[str, dict[str, Any]] = {}
        for each in figures:
            if each.missing:
                missing.append(f"no {each.name}: {each.missing}")
                data[each.name] = {"mean": None, "standard_error": None, "missing": each.missing}
            else:
                error = "-" if math.isnan(each.standard_error) else f"{each.standard_error:.2g}"
                rows.append([each.name, each.long_name, f"{each.mean:.5g}", error])
                data[each.name] = {"mean": each.mean, "standard_error": each.standard_error}
        title = f"{sampler.spec}, n = {n}, {count} set{'s' if count > 1 else ''}"
        table = text_table(["figure", "what it is", "mean", "± standard error"], rows)
        lines = [title, table, *([] if options.quiet else missing)]
        about = {**meta, "realizations": count, "quality": data}
        return Answer("\n".join(lines), about if options.json else None)
    if options.json:
        written = {"shape": points.shape, "file": file}
        return Answer(data={**meta, **({"points": points} if file == "-" else written)})
    # The points are the result: --quiet silences warnings only
    return Answer(format_dat(list(points)).rstrip("\n") if file == "-" else "")


@verb(
    option("integrand", "integrand spec, e.g. 'gaussian(width=0.25)'"),
    option("--budget N", "most evaluations", whole(), required=True),
    option("-d, --dims D", "number of dims, where the spec leaves it open", whole()),
    option("--density SPEC", "importance density"),
    option(
        "--sampler SPEC", "a randomised sampler (default sobol | owen, for the median sobol | lms)"
    ),
    option("--combine HOW", "mean of the replicates (default), or median for linear scrambles"),
    option("--cache FILE", "keep values by point, and go on where an earlier run stopped"),
)
def integrate_(options: argparse.Namespace) -> Answer:
    """Integrate a function: value, 95 % interval, evaluations made, replicates and points of each."""
    found = mcs.integrate(
        mcs.Estimator(options.integrand, options.density, dims=options.dims),
        budget=options.budget,
        sampler=options.sampler,
        combine=options.combine or "mean",
        cache=options.cache,
        rng=options.seed or 0,
    )
    data: dict[str, Any] = {str(name): found[name].values.tolist() for name in found}
    low, high = data["interval"]
    text = (
        f"{data['value']:.10g}, 95 %: {low:.10g} to {high:.10g}\n{data['calls']} evaluations made, of "
        f"{data['replicates']} replicates of {data['n']} points of {found.attrs['sampler']}"
    )
    note = found.attrs.get("note")
    return Answer(f"{text}\n{note}" if note else text, data | ({"note": note} if note else {}))


@verb(
    option(
        "SPEC",
        "samplers, e.g. pmj02 \"points(path='mine.dat') | shift\"",
        dest="specs",
        nargs="*",
    ),
    option("--out DIR", "output folder", default="out/gallery"),
    option("--quick", "fewer points and realisations"),
    option("--markdown", "write Markdown and PNG files"),
)
def gallery_(options: argparse.Namespace) -> Answer:
    """Measure samplers and show them side by side: points, spectrum, projections, rates, quality, cost.

    Writes DIR/index.html (one page that stands alone) or, with --markdown, DIR/index.md and pictures;
    DIR/gallery.json holds the numbers. Without a SPEC, all samplers that can be named.
    """
    from mcspectra.report.sampler_gallery import FULL, QUICK, write_gallery

    page = write_gallery(
        options.out,
        options.specs or None,
        effort=QUICK if options.quick else FULL,
        format="markdown" if options.markdown else "html",
        rng=options.seed or 0,
    )
    return Answer(f"gallery: {printable(page)}", {"gallery": page})


@verb(
    option(
        "SAMPLER", "samplers, e.g. jittered \"points(path='mine.dat')\"", dest="specs", nargs="+"
    ),
    option("-n, --counts N,N,…", "numbers of points (default 16,64,256,1024)", wholes()),
    option("-d, --dims D,D,…", "numbers of dims of the integrands (default 2)", wholes()),
    option("-m, --realizations R", "sets of each variance (default 400)", whole(2)),
    option("-o, --out FILE", ".html or .pdf: all of it; .csv, .tex: tables; .pgf: convergence"),
)
def bench_(options: argparse.Namespace) -> Answer:
    """Compare samplers on standard integrands: rates, ranks, spectra, quality, projections, speed.

    Prints a table of rates, in brackets the ranks with simultaneous 95 % intervals. FILE.html is one page
    that stands alone, FILE.pdf has a sheet for each picture. A sampler that cannot do some of the dims is
    left out there.
    """
    from mcspectra.report.bench_page import BENCH_FILES, bench_table, write_bench
    from mcspectra.report.result_files import check_result_file

    check_result_file(options.out, BENCH_FILES)
    given = given_of(options, "counts", "dims", "realizations")
    bench = mcs.sampler_bench(options.specs, **given, rng=options.seed or 0)
    columns, rows = bench_table(bench)
    lines = [text_table(["", *columns[1:]], rows), bench.attrs.get("note", "")]
    if options.out:
        lines.append(f"bench: {write_bench(bench, options.out)}")
    return Answer("\n".join(filter(None, lines)), data_of(bench))
