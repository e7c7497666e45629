"""Texts of studies that have the cells that a test wants, for ledgers that no run has written."""

import json

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.results import Variable


def text_of(paths, title="t", samplers=("random",)):
    """The text of a study, as ledgers have it; names of estimators and samplers are parts of paths."""
    entries: dict[str, dict] = {}
    for estimator, sampler, analysis in (path.split("/") for path in paths):
        entry = entries.setdefault(estimator, {"name": estimator, "samplers": []})
        if sampler not in entry["samplers"]:
            entry["samplers"].append(sampler)
        entry[analysis] = {}
    study = {"title": title, "samplers": samplers, "estimators": list(entries.values())}
    return json.dumps(study)


def admit(patch, *names, analyses=("convergence", "terms")):
    """Have analyses declare variables that tests make up, as those of other packages might."""
    for analysis in analyses:
        kind = ANALYSES.load(analysis)
        made = (Variable("made up", "1", None, "biufc", name) for name in names)
        patch.setattr(kind, "variables", (*kind.variables, *made))
