"""Texts of studies with given cells, for ledgers that no run has written."""

import json

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.results import Variable


def text_of(paths, title="t", samplers=("random",)):
    """Return the text of a study, as in ledgers, with names taken from the parts of paths."""
    entries: dict[str, dict] = {}
    for estimator, sampler, analysis in (path.split("/") for path in paths):
        entry = entries.setdefault(estimator, {"name": estimator, "samplers": []})
        if sampler not in entry["samplers"]:
            entry["samplers"].append(sampler)
        entry[analysis] = {}
    study = {"title": title, "samplers": samplers, "estimators": list(entries.values())}
    return json.dumps(study)


def admit(patch, *names, analyses=("convergence", "terms")):
    """Let analyses declare the variables of tests, as analyses of other packages could."""
    for analysis in analyses:
        kind = ANALYSES.load(analysis)
        made = (Variable("made up", "1", None, "biufc", name) for name in names)
        patch.setattr(kind, "variables", (*kind.variables, *made))
