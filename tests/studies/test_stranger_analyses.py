"""Analyses of other packages have a table in study files and in all their descriptions."""

import sys
import textwrap

import pytest

from mcspectra.core.errors import ConfigError
from mcspectra.studies import decode_study, estimate_study, make_plan, study_schema
from mcspectra.studies.schema import key_tables, template

MODULE = '''
from typing import Annotated

from msgspec import Meta

from mcspectra.core.analysis import Analysis, Need, Reduction
from mcspectra.core.errors import ParameterError
from mcspectra.core.options import COUNT, REALIZATIONS
from mcspectra.core.results import Variable, dataset


class Centre(Analysis, frozen=True, kw_only=True):
    """Mean coordinate of the points."""

    about = "sampler"
    variables = ("mean",)

    n: Annotated[int, COUNT]
    realizations: Annotated[int, REALIZATIONS] = 100
    axis: Annotated[int, Meta(ge=0, description="Which coordinate.")] = 0

    def need(self, subject):
        if self.axis >= subject.sampler.dims:
            raise ParameterError(f"There is no axis {self.axis}.")
        return Need(cost=float(self.n * self.realizations), memory=8 * self.n)

    def reduction(self, subject, stream):
        def block(index):
            points = subject.sampler.draw_stream(self.n, stream, index, 1)
            return points[..., self.axis].mean(axis=1)

        def result(state):
            return dataset({"mean": ((), state.mean())}, n=self.n)

        from mcspectra.core.records import JOIN
        from dataclasses import dataclass

        return Reduction(kind=Means, block=lambda i: Means(block(i)), blocks=self.realizations,
                         result=lambda state: result(state.means))


from dataclasses import dataclass
from mcspectra.core.records import JOIN


@dataclass
class Means:
    means: JOIN


class Frames(Analysis, frozen=True, kw_only=True):
    """Something of a scene."""

    about = "scene"

    scene: Annotated[str, Meta(description="A scene.")]


no_analysis = 3
'''
ENTRIES = """\
[mcspectra.analyses]
centre = stranger_analyses:Centre
frame = stranger_analyses:Frames
broken = stranger_analyses:missing
number = stranger_analyses:no_analysis
samplers = stranger_analyses:Centre
name = stranger_analyses:Centre
Bad/../Name = stranger_analyses:Centre
"""
STUDY = """
title = "t"
samplers = ["random"]
[[estimators]]
name = "a"
dims = 2
integrand = "gaussian"
centre = { n = 8 }
"""


@pytest.fixture(autouse=True)
def package(tmp_path, monkeypatch):
    """An installed package that registers analyses, one of which cannot be loaded."""
    info = tmp_path / "stranger_analyses-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger-analyses\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRIES)
    (tmp_path / "stranger_analyses.py").write_text(textwrap.dedent(MODULE))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("stranger_analyses", None)


def test_its_table_is_planned_and_computed(tmp_path):
    plan = make_plan(
        decode_study(STUDY, overrides=["centre = { n = 4, realizations = 40 }"]), tmp_path
    )
    (cell,) = plan.cells
    assert (cell.path, cell.analysis.n, cell.need.cost) == ("a/random/centre", 8, 800.0)
    result = cell.compute(3)
    points = cell.subject.sampler.draw(8, realizations=100, rng=3)
    assert float(result["mean"]) == pytest.approx(points[..., 0].mean())
    assert result.attrs["analysis"] == "centre"
    (estimate,) = estimate_study(plan)
    assert estimate.tried


def test_its_options_are_checked_and_its_refusals_name_the_place(tmp_path):
    for table, words in (
        ("{ n = 0 }", r"estimators\[0\].centre.n is 0; give a whole number of at least 1"),
        (
            "{ n = 4, axes = 1 }",
            r"no key 'axes'; allowed here: n, realizations, axis.* Did you mean",
        ),
        ("{ n = 4, axis = 2 }", "Estimator 'a', centre: There is no axis 2"),
    ):
        with pytest.raises(ConfigError, match=words):
            make_plan(decode_study(STUDY.replace("{ n = 8 }", table)), tmp_path)


def test_it_appears_in_schema_key_tables_and_template():
    schema = study_schema()
    assert schema["$defs"]["StudyConfig"]["properties"]["centre"]["$ref"] == "#/$defs/Centre"
    assert schema["$defs"]["Centre"]["properties"]["axis"]["description"] == "Which coordinate."
    assert "### `[centre]`\n\nMean coordinate of the points.\n" in key_tables()
    assert "### `[[frames]]`\n" in key_tables()
    assert "# [centre] " in template()


def test_an_analysis_of_scenes_is_a_list_of_tables(tmp_path):
    text = "title = 't'\n[[frames]]\nname = 'f'\nscene = 'veach'\nsamplers = ['random']\n"
    (cell,) = make_plan(decode_study(text), tmp_path).cells
    assert (cell.path, cell.analysis.scene, cell.subject.estimator) == (
        "f/random/frame",
        "veach",
        None,
    )
    with pytest.raises(ConfigError, match="outside the study's folder"):
        make_plan(decode_study(text.replace("veach", "../x.xml")), tmp_path)
    with pytest.raises(ConfigError, match=r"add tables \[\[frames\]\]"):
        decode_study(STUDY.replace("centre = { n = 8 }", "frame = { scene = 'veach' }"))


@pytest.mark.parametrize(
    ("name", "words"), [("broken", "cannot be loaded"), ("number", "not a class")]
)
def test_a_broken_analysis_affects_only_studies_that_name_it(tmp_path, name, words):
    assert make_plan(decode_study(STUDY), tmp_path).cells
    with pytest.raises(ConfigError, match=words):
        decode_study(f"{STUDY}{name} = {{ n = 3 }}")


def test_no_analysis_hides_a_key_or_leaves_the_results(tmp_path):
    assert decode_study(STUDY).samplers == ("random",)
    with pytest.raises(ConfigError, match="no key 'Bad/../Name'"):
        decode_study(f"{STUDY}'Bad/../Name' = {{ n = 3 }}")
