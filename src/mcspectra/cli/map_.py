"""Map variance, its rate and what decides it over an image of a scene.

Writes DIR/maps.exr (all layers), DIR/*.png, DIR/map.json and DIR/report.html; DIR/study.sqlite keeps
what is finished, and --resume goes on from there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mcspectra.cli.analysis import add_option, given_options
from mcspectra.cli.common import Answer, adder, read_sampler, text_table, whole
from mcspectra.core.analysis import Subject
from mcspectra.core.options import checked, options_of
from mcspectra.core.streams import Stream
from mcspectra.rendering.maps import Map

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options: the scene and its sampler, the folder, and those of the analysis."""
    add = adder(parser)
    add("scene", "scene, e.g. veach, or a Mitsuba XML file")
    add("--out DIR", "output folder", default="out/map")
    add("--resume", "go on with the tiles of DIR")
    add("--sampler SPEC", "default jittered", default="jittered")
    add("--workers N", "threads; all processors by default", whole())
    for option in options_of(Map):
        if option.name != "scene":
            add_option(parser, option)


def run(options: argparse.Namespace) -> Answer:
    """Measure as a study of one map, and write."""
    from mcspectra.report.further_pictures import with_labels
    from mcspectra.report.map_page import map_note, map_summary, write_map
    from mcspectra.studies import StudyConfig, Trust, open_results, run_study
    from mcspectra.studies.files import SceneConfig

    analysis = checked(Map(**given_options(options, Map)))
    # Refuse what cannot be before there is a folder
    subject = Subject(None, read_sampler(options.sampler, analysis.dims))
    analysis.need(subject)
    analysis.reduction(subject, Stream.from_rng(0))
    entry = SceneConfig(name="map", samplers=(options.sampler,), kind="map", analysis=analysis)
    study = StudyConfig(title=f"Map of {options.scene}", seed=options.seed or 0, scenes=(entry,))
    trust = Trust((), (Path(options.scene).parent,))
    run_study(study, options.out, resume=options.resume, workers=options.workers, trust=trust)
    tree = open_results(options.out)
    (found,) = (node.to_dataset() for node in tree.subtree if node.name == "map" and node.data_vars)
    result = with_labels(found, "strategy").assign_coords(bound=["low", "high"])
    page, summary = write_map(result, options.out), map_summary(result)
    shown = summary["strategies"]
    rows = [[name, "", *(f"{v:.4g}" for v in row.values())] for name, row in shown.items()]
    table = text_table(["strategy", "", *next(iter(shown.values()))], rows)
    return Answer(f"{table}\n{map_note(summary)}\nmap: {page}", {**summary, "report": page})
