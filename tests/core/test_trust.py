"""One policy for the access of untrusted text: studies, command-line specs and the explorer."""

import pytest

from mcspectra.app.state import ExplorerSetup
from mcspectra.core.errors import ConfigError, McspectraError
from mcspectra.core.spec import parse
from mcspectra.core.trust import Trust, allow, process_trust
from mcspectra.samplers import allow_code, sampler
from mcspectra.studies import decode_study, make_plan

COMMAND = "command('./mine {n} {seed}', dims=2)"
STUDY = f'title = "t"\nsamplers = ["{COMMAND}"]\n[points]\nn = 4\n[[estimators]]\nname = "a"\n'
STUDY += 'dims = 2\nintegrand = "linear"\n'


def test_the_same_trust_holds_for_specs_studies_and_the_explorer(tmp_path):
    study = decode_study(STUDY)
    calls = (
        lambda: sampler(COMMAND),
        lambda: ExplorerSetup(sampler=COMMAND),
        lambda: make_plan(study, tmp_path, process_trust()),
    )
    for call in calls:
        with pytest.raises(ConfigError, match="--allow-code"):
            call()
    allow_code("./mine")
    assert process_trust() == Trust(code=("./mine",))
    for call in calls:
        call()


def test_a_trust_allows_named_folders_and_subfolders(tmp_path):
    for name in ("in/below", "out"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("in/a", "in/below/b", "out/c"):
        (tmp_path / name).touch()
    (tmp_path / "in" / "link").symlink_to(tmp_path / "out" / "c")
    (tmp_path / "in" / "loop").symlink_to(tmp_path / "in" / "loop")
    trust = Trust(folders=(tmp_path / "in",))
    assert all(trust.reads(tmp_path / name) for name in ("in/a", "in/below/b", "in/none"))
    names = ("out/c", "in/link", "in/../out/c", "in/loop/x", "in\0")
    assert not any(trust.reads(tmp_path / name) for name in names)
    assert not Trust().reads(tmp_path / "in" / "a")
    wider = trust.widened(folders=[tmp_path / "out"], code=["a:b"])
    assert wider.reads(tmp_path / "in" / "link")
    assert wider.runs(parse("python('a:b')"))
    assert not wider.runs(parse("python('a:c')"))
    assert not wider.runs(parse("command('./x {n}')"))
    assert wider.runs(parse("points(path='a:b')"))


@pytest.mark.parametrize(
    "given", [{"code": ["os"]}, {"code": [3]}, {"folders": ["a"]}, {"folders": [None]}]
)
def test_invalid_entries_raise_one_sentence(given):
    with pytest.raises(McspectraError, match=r"\.$"):
        allow(**given)
    assert process_trust() == Trust()
