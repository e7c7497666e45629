"""Quality of warps: closed forms of stretch and distortion, and positions of jumps."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError

TABLE = [[1.0, 2.0], [3.0, 1.0]]


def test_uniform_and_products():
    data = mcs.quality.warp_quality("uniform", resolution=16)
    for name in ("stretch", "mean_stretch", "max_stretch", "distortion", "neighbor_expansion"):
        np.testing.assert_allclose(data[name], 1.0, rtol=1e-9)
    assert float(data["jump_length"]) == 0
    data = mcs.quality.warp_quality("grid(nodes=[[0, 0.2, 1], [0, 1]])", resolution=16)
    expected = np.where(data["u0"] < 0.5, 1 / 0.4, 1.6)[:, None] * np.ones(16)
    np.testing.assert_allclose(data["stretch"], expected, rtol=1e-8)
    assert not data["jump"].any()


def test_the_polar_disk():
    """|∂T/∂u_0| = 2π r √u_1 and |∂T/∂u_1| = r/(2√u_1) are orthogonal, with ratio 4π u_1."""
    side = 64
    data = mcs.quality.warp_quality('disk(warp="polar")', resolution=side)
    u = (np.arange(side) + 0.5 + 0.17) / side
    ratio = 4 * np.pi * u
    expected = np.maximum(ratio, 1 / ratio)
    # One-sided differences over a thousandth of a cell have the relative error step/(4 u)
    np.testing.assert_allclose(data["stretch"], expected[None, :].repeat(side, 0), rtol=1e-3)
    # Diagonals of the image of a unit square, √(a² + b²), divided by √(2ab)
    distortion = np.exp(np.log(np.sqrt((ratio + 1 / ratio) / 2)).mean())
    assert float(data["distortion"]) == pytest.approx(distortion, rel=1e-3)
    assert float(data["mean_stretch"]) == pytest.approx(np.exp(np.log(expected).mean()), rel=1e-3)


def test_the_concentric_disk_distorts_less():
    """Singular values come from the closed form of ∂(x, y)/∂(a, b) in the sector φ = (π/4) b/a."""
    data = mcs.quality.warp_quality("disk", resolution=64)
    i, j = 60, 40
    a, b = (2 * (np.array([i, j]) + 0.5 + [0.31, 0.17]) / 64 - 1).tolist()
    phi = math.pi / 4 * b / a
    along = np.array([math.cos(phi), math.sin(phi)])
    around = np.array([-math.sin(phi), math.cos(phi)])
    slopes = np.stack([along - math.pi / 4 * b / a * around, math.pi / 4 * around], axis=1)
    values = np.linalg.svd(slopes, compute_uv=False)
    assert float(data["stretch"][i, j]) == pytest.approx(values[0] / values[1], rel=1e-4)
    # The stretch is largest on the diagonals, b = a
    corner = np.linalg.svd([[1, 0], [-math.pi / 4, math.pi / 4]], compute_uv=False)
    assert float(data["max_stretch"]) == pytest.approx(corner[0] / corner[1], rel=0.05)
    polar = mcs.quality.warp_quality('disk(warp="polar")', resolution=64)
    for name in ("mean_stretch", "max_stretch", "distortion"):
        assert float(data[name]) < float(polar[name])


def test_warps_of_directions_jump_at_the_seam():
    """x_0 of concentric maps jumps by 1 at u_1 = ½, u_0 > ½; polar maps have no jumps."""
    for kind in ("sphere", "hemisphere"):
        data = mcs.quality.warp_quality(kind, resolution=64)
        torn = np.argwhere(data["jump"].values > 0)
        assert (torn[:, 0] == 1).all()
        assert (torn[:, 1] >= 32).all()
        assert set(torn[:, 2]) == {31}
        assert float(data["jump_length"]) == 0.5
        assert float(data["mean_jump"]) == pytest.approx(1.0, abs=1e-6)
        assert (
            float(mcs.quality.warp_quality(f'{kind}(warp="polar")', resolution=32)["jump_length"])
            == 0
        )


def test_warps_of_tables_jump_between_rows():
    """The jump of x_0 at u_1 = 3/7 is computed by hand for each column of cells."""
    data = mcs.quality.warp_quality(f"piecewise-constant(values={TABLE})", resolution=64)
    u = data["u0"].values

    def inverse(first):
        return np.where(u < first, 0.5 * u / first, 0.5 + 0.5 * (u - first) / (1 - first))

    heights = data["jump"].sel(axis=1).values
    border = int(3 / 7 * 64 - 0.5)
    # Tolerance: the slope over 2^-30 of a cell
    np.testing.assert_allclose(
        heights[:, border], np.abs(inverse(1 / 3) - inverse(3 / 4)), atol=1e-8
    )
    heights = heights.copy()
    heights[:, border] = 0
    assert not heights.any()
    assert float(data["jump_length"]) == 1.0


def test_warps_of_one_pdf_have_different_jumps():
    table = [[1, 0.5, 2], [0.1, 0.2, 0.5], [4, 1, 0.1]]
    data = {
        warp: mcs.quality.warp_quality(
            f"piecewise-constant(values={table}, warp={warp!r})", resolution=64
        )
        for warp in ("marginal", "alias")
    }
    smooth = mcs.quality.warp_quality(f"bilinear(values={table})", resolution=32)
    assert float(smooth["jump_length"]) == 0
    for name in ("jump_length", "neighbor_expansion", "mean_jump"):
        assert float(data["alias"][name]) > float(data["marginal"][name])


def test_one_dim():
    data = mcs.quality.warp_quality(
        mcs.density("piecewise-constant(values=[1, 0, 1])"), resolution=32
    )
    assert data["jump"].dims == ("axis", "u0")
    assert float(data["jump"].max()) == pytest.approx(1 / 3)
    assert float(data["jump_length"]) == 1
    np.testing.assert_allclose(data["stretch"], 1.0)
    assert data["warped"].shape == (32, 1)
    assert "density" in data.attrs


@pytest.mark.parametrize(
    ("density", "options", "message"),
    [
        (3, {}, "is not a density"),
        ("disk", {"resolution": 3}, "resolution"),
        ("disk", {"resolution": 10**6}, "resolution"),
        ("disk", {"resolution": math.nan}, "resolution"),
        ("nothing", {}, "no density called"),
        (mcs.density("uniform", dims=3), {}, "3 primary dims"),
    ],
)
def test_bad_input(density, options, message):
    with pytest.raises(ParameterError, match=message):
        mcs.quality.warp_quality(density, **options)


def test_distortion_of_the_concentric_disk():
    """∂T has the columns (1, −πq/4) and (0, π/4) with q = short/long, and area π/4."""
    side = 32
    line = 2 * (np.arange(side) + 0.5) / side - 1
    a, b = line[:, None] + 2 * 0.31 / side, line[None, :] + 2 * 0.17 / side
    q = np.minimum(np.abs(a), np.abs(b)) / np.maximum(np.abs(a), np.abs(b))
    diameter = np.hypot(1, np.pi / 4 * (1 + q))  # the longer of both diagonals
    expected = np.exp(np.log(diameter / np.sqrt(2 * np.pi / 4)).mean())
    data = mcs.quality.warp_quality("disk", resolution=side)
    assert float(data["distortion"]) == pytest.approx(expected, rel=1e-4)
