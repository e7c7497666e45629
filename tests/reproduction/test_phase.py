"""Phase: findings, and wrong inputs that must disagree."""

from __future__ import annotations

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.integrands.registry import integrand
from mcspectra.prediction.exact import exact_variance
from mcspectra.reproduction import phase as module


@pytest.mark.parametrize("offset", [0.0, 0.125, 0.5])
def test_exact_variances_agree_with_quadrature(offset: float) -> None:
    """The package's own bar plus cosine is compared where no stratum is cut."""
    bar = exact_variance(integrand(module.BAR, 1), module.displaced(offset), 16)
    assert bar == pytest.approx(module.exact_bar(offset, 16), rel=1e-6, abs=1e-18)
    cosine = integrand("cosine(frequency=1)", 1)
    both = module.exact_curve(0.0)[0]
    assert both == pytest.approx(exact_variance(cosine, "jittered", 16), rel=1e-9)


def test_exact_variances_of_cut_strata_are_sums_over_cells() -> None:
    """With 4000 midpoints per stratum, the error of a cut is at most half a cell."""
    n, offset, cells = 16, 0.125, 4000
    x = ((np.arange(n)[:, None] + (np.arange(cells) + 0.5) / cells + offset) / n) % 1.0
    variance = module.smooth()(x[..., None]).var(axis=1).sum() / n**2
    assert module.exact_curve(offset)[0] == pytest.approx(variance, rel=1e-3)


def test_wrong_displacements_disagree(disagreeing: Disagreeing) -> None:
    terms, curve = module.bar_terms, module.displaced_curve
    others = {0.0: 0.5, 0.125: 0.5, 0.5: 0.0}
    assert disagreeing(
        module,
        bar_terms=lambda offset, _, seed: terms(
            others.get(offset, offset), 400, seed + (offset > 0.5)
        ),
        displaced_curve=lambda offset, _, seed: curve(offset or 0.125, 400, seed),
    ) == [0, 2, 3, 4, 5, 6, 8]
