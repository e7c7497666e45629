"""Every claim of every quick exhibit agrees; exhibits with other tests are made in those tests."""

import pytest

from mcspectra.reproduction.gallery import make_exhibit, texts

ELSEWHERE = {
    "direct-illumination",
    "environment-channels",
    "estimator",
    "real-and-integer-frequencies",
    "veach-pictures",
}
RENDERED = {"light-smoothing", "mis-slowest"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.render] if name in RENDERED else [])
        for name in texts()
        if name not in ELSEWHERE
    ],
)
def test_all_findings_agree(name, sound):
    sound(*make_exhibit(name, quick=True, seed=1))
