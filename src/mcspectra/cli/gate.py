"""The verb ``gate``: a verdict on new renders for continuous integration."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcspectra.cli.common import VerbOutput, option, page_table, real, verb, whole
from mcspectra.core.display import printable
from mcspectra.core.errors import ParameterError
from mcspectra.core.images import ENCODED_EXTENSIONS, LINEAR_EXTENSIONS

__all__ = ["gate_"]


@verb(
    option(
        "NEW",
        "new frames: a folder or a pattern in quotes with two or more independent renders "
        f"({', '.join(LINEAR_EXTENSIONS)}; with --tone-mapped also "
        f"{', '.join(ENCODED_EXTENSIONS)})",
    ),
    option("REFERENCE", "frames of the reference, or a file of --make-reference", nargs="?"),
    option("--level P", "probability of a false alarm (default 0.01)", real(above=0.0, below=1.0)),
    option(
        "--target E",
        "relative bias of the image mean that must be found; otherwise the verdict is undecided",
        real(above=0.0),
    ),
    option("--spp N", "samples per pixel of NEW (default: from names and headers)", whole()),
    option("--spp-reference N", "samples per pixel of REFERENCE", whole()),
    option("--layer NAME", "layer or channel of EXR files"),
    option("--tone-mapped", "also accept PNG and JPEG"),
    option(
        "--make-reference FILE",
        "store the frames NEW as one reference file FILE.exr: mean, variance and small pictures",
    ),
    option("--junit FILE", "write the tests as JUnit XML"),
    option("--github", "print an annotation of a GitHub workflow, and add to its summary"),
    option("-o, --out DIR", "folder for report.html, gate.json and figures", repeated="once"),
)
def gate_(options: argparse.Namespace) -> VerbOutput:
    """Test whether new renders agree with a reference: pass, fail or undecided.

    The exit code is 0 for pass, 3 for fail and 4 for undecided.
    The output states how large a bias the test would have detected.
    The output also states the number of samples that would detect a smaller bias.
    If both sets have 5 frames or more, all with equal numbers of samples,
    the probability of a false alarm is at most --level.
    With fewer frames or unequal samples, t tests are used, and --level holds approximately.
    """
    from mcspectra.rendering.gate import GATE_VERDICTS, gate
    from mcspectra.rendering.gate_frames import write_reference

    if options.make_reference:
        if options.reference is not None:
            raise ParameterError("--make-reference stores the frames NEW; leave REFERENCE out.")
        file = write_reference(
            options.new,
            options.make_reference,
            spp=options.spp,
            layer=options.layer,
            tone_mapped=options.tone_mapped,
        )
        return VerbOutput(f"reference: {printable(file)}", {"reference": file})
    if options.reference is None:
        raise ParameterError("There is no reference; give NEW and REFERENCE.")
    from mcspectra.report import gate_page

    if options.out:
        from mcspectra.report.page import check_page_packages

        check_page_packages("frames,report")
    result = gate(
        options.new,
        options.reference,
        level=0.01 if options.level is None else options.level,
        target=options.target,
        spp=options.spp,
        spp_reference=options.spp_reference,
        layer=options.layer,
        tone_mapped=options.tone_mapped,
        rng=options.seed or 0,
    )
    found, said = gate_page.gate_summary(result), gate_page.gate_findings(result)
    lines, data = list(said), {**found, "findings": said}
    if found["tests"]:
        lines += ["", page_table(gate_page.gate_table(found))]
    if options.out:
        data["report"] = gate_page.write_gate(result, options.out)
        lines.append(f"report: {printable(data['report'])}")
    if options.junit:
        data["junit"] = gate_page.write_junit(result, Path(options.junit))
        lines.append(f"junit: {printable(data['junit'])}")
    if options.github:
        lines.append(gate_page.github_annotation(result))
        gate_page.write_github_summary(result)
    return VerbOutput("\n".join(lines), data, GATE_VERDICTS[found["verdict"]])
