"""Images of Veach's scene: findings, and wrong inputs that must disagree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import veach_pictures as veach
from mcspectra.reproduction.claims import Exhibit, judge
from mcspectra.reproduction.gallery import make_exhibit

pytestmark = pytest.mark.render


def test_all_findings_agree(sound: Callable[[Exhibit], None]) -> None:
    made, slides = make_exhibit("veach-pictures", quick=True, seed=1)
    sound(made)
    assert any("instead of 1024" in slide.reason for slide in slides)


def synthetic(noise: dict[str, float]) -> veach.Renders:
    """Return images of constant radiance with noise of the given standard deviations."""
    rng = np.random.default_rng(3)
    shape = (6, 80, 120, 3)
    return veach.Renders(
        scene="veach(width=120, height=80)",
        reference_spp=64,
        batches=0.5 + 0.001 * rng.standard_normal(shape),
        repeats={s: 0.5 + noise[s] * rng.standard_normal(shape) for s in ("light", "bsdf", "mis")},
    )


def test_equal_noise_does_not_disagree(disagreeing: Disagreeing) -> None:
    same = synthetic({"light": 0.05, "bsdf": 0.05, "mis": 0.05})
    worse = synthetic({"light": 0.05, "bsdf": 0.1, "mis": 0.05})
    assert disagreeing(veach, _render=lambda *_: same) == [0, 1, 2, 3, 4]
    assert disagreeing(veach, _render=lambda *_: worse) == [0, 1]


def test_darker_images_disagree_with_the_reference() -> None:
    renders = synthetic({"light": 0.05, "bsdf": 0.05, "mis": 0.05})
    assert judge(veach._same_mean(renders, "light")).agrees is True
    renders.repeats["light"] *= 0.99
    assert judge(veach._same_mean(renders, "light")).agrees is False


def test_errors_are_squared_srgb_differences() -> None:
    renders = synthetic({"light": 0.0, "bsdf": 0.0, "mis": 0.0})
    assert renders.errors("light").shape == (6, 80, 120)
    assert float(renders.errors("light").max()) < 1e-5
