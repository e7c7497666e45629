"""Smoothed lights: findings, and wrong inputs that must disagree."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.reproduction import light_smoothing as smoothing
from mcspectra.reproduction.claims import judge

pytestmark = pytest.mark.render


def test_a_ramp_of_another_width_disagrees(monkeypatch):
    right = mcs.exact_variance
    monkeypatch.setattr(mcs, "exact_variance", lambda *a: 1.1 * right(*a))
    assert judge(smoothing._ramp(0.2)).agrees is False


def test_the_bias_of_the_disk_by_counting():
    """The area of the smoothed disk is computed on a fine grid."""
    width = 0.2
    disk = mcs.smoothed(mcs.integrand(smoothing.DISK), width)
    u = (np.arange(2000) + 0.5) / 2000
    area = float(np.mean(disk(np.stack(np.meshgrid(u, u), axis=-1))))
    expected = np.pi * smoothing.RADIUS**2 + np.pi * width**2 / 12
    assert area == pytest.approx(expected, rel=1e-5)


def test_scans_without_a_gain_disagree():
    scan = mcs.improve.smoothing_scan(
        smoothing.DISK, "jittered", smoothing.BUDGETS, [0.0, 0.2], realizations=100, rng=1
    )
    assert judge(smoothing._bias(scan)).agrees is True
    assert (
        judge(smoothing._best_pays(scan, 1024)).agrees is None
    )  # the width is too large for this budget
    assert (
        judge(smoothing._bias(scan.assign(smoothing_bias=1.01 * scan["smoothing_bias"]))).agrees
        is False
    )
    level = scan.assign(best_width=0.0 * scan["best_width"] + 0.2)
    assert judge(smoothing._narrower(level)).agrees is False
