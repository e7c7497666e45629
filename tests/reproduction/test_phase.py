"""Phase: findings, and what would contradict them."""

import numpy as np
import pytest

from mcspectra.integrands.registry import integrand
from mcspectra.reproduction import phase as module
from mcspectra.reproduction.claims import judge
from mcspectra.variance.exact import exact_variance


@pytest.mark.parametrize("offset", [0.0, 0.125, 0.5])
def test_exact_variances_are_those_of_quadrature(offset):
    """Of the package's own bar and cosine, where no stratum is cut."""
    bar = exact_variance(integrand(module.BAR, 1), module.displaced(offset), 16)
    assert bar == pytest.approx(module.exact_bar(offset, 16), rel=1e-6, abs=1e-18)
    cosine = integrand("cosine(frequency=1)", 1)
    both = module.exact_curve(0.0)[0]
    assert both == pytest.approx(exact_variance(cosine, "jittered", 16), rel=1e-9)


def test_exact_variances_of_cut_strata_are_sums_over_cells():
    """By 4000 midpoints a stratum; a cut is off by half a cell at most."""
    n, offset, cells = 16, 0.125, 4000
    x = ((np.arange(n)[:, None] + (np.arange(cells) + 0.5) / cells + offset) / n) % 1.0
    variance = module.smooth()(x[..., None]).var(axis=1).sum() / n**2
    assert module.exact_curve(offset)[0] == pytest.approx(variance, rel=1e-3)


def test_displaced_strata_are_not_those_at_borders():
    moved = module.bar_terms(0.5, 400, 1)
    assert judge(module._variance_of(0.125, moved)).agrees is False
    assert judge(module._at_borders(moved)).agrees is False
    curve = module.displaced_curve(0.125, 400, 1)
    assert judge(module._rate_of(0.125, curve)).agrees is True
    assert judge(module._rate_of(0.0, curve)).agrees is False


def test_another_sampler_has_another_second_term():
    scan = [module.bar_terms(0.0, 50, seed) for seed in (1, 2)]
    assert judge(module._same_second(scan)).agrees is False
