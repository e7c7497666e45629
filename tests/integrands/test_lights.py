"""Irradiance from a rectangle: Lambert's formula, view factors, horizon and occluder."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import RectangleLight

SCREEN = [[0.05, -2, 0.5], [1, 0, 0], [0.1, 4, 0.2]]
CASES = {
    "facing": {},
    "radiance": {"radiance": 2.5},
    "tilted": {"normal": (1, 2, 2), "corner": (0.3, 0.2, 2)},
    "below the horizon in part": {"normal": (1, 0, 0.2)},
    "all below the horizon": {"normal": (0, 0, -1)},
    "elsewhere": {
        "corner": (3, 1, -2),
        "edge0": (0, 0, 2),
        "edge1": (0.5, 3, 0),
        "origin": (0.5, 0.5, 0.5),
        "normal": (1, 0.3, 0.2),
    },
    "parallelogram": {"edge1": (0.5, 1, 0.3)},
    "occluded": {"occluder": SCREEN},
    "occluder through the light": {"occluder": [[-0.2, -1, 0.5], [0, 2, 0], [0.4, 0, 1]]},
    "occluder behind": {"occluder": [[-3, -3, 1.5], [6, 0, 0], [0, 6, 0]]},
    "occluder on the other side": {"occluder": [[-3, -3, -0.5], [6, 0, 0], [0, 6, 0]]},
    "occluder around the origin": {"occluder": [[-0.2, -0.1, -1], [0, 0.2, 0], [0.3, 0, 1.8]]},
    "occluder seen from its edge": {"occluder": [[0, 0, 0.2], [0, 0, 0.5], [0.1, 0, 0]]},
}
HIDES_NOTHING = ("occluder behind", "occluder on the other side", "occluder seen from its edge")


@pytest.fixture(params=list(CASES), ids=str)
def light(request):
    return RectangleLight(**CASES[request.param])


def midpoints(side):
    line = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)


def test_the_integral_is_the_mean_of_the_values(light):
    """The midpoint rule has an error of 1/side² for smooth f, and of one cell per border at
    jumps."""
    side = 512
    values = light(midpoints(side))
    jumps = 4 * values.max() / side if "occluder" in light.spec else 0.0
    assert light.integral == pytest.approx(values.mean(), rel=1e-4, abs=jumps / 8 + 1e-6)
    assert light.integral_source == "exact"


def test_values_in_the_words_of_the_definition(light):
    x = np.random.default_rng(1).random((200, 2))
    for s, value in zip(x, light(x), strict=True):
        point = np.array(light.corner) + s[0] * np.array(light.edge0) + s[1] * np.array(light.edge1)
        w = point - light.origin
        across = np.cross(light.edge0, light.edge1)
        area = np.linalg.norm(across)
        r = np.linalg.norm(w)
        cosine = max(0.0, np.dot(w, light.normal) / (r * np.linalg.norm(light.normal)))
        other = abs(w @ across) / (r * area)
        seen = not hidden(light, w)
        assert value == pytest.approx(
            light.radiance * cosine * other * area * seen / r**2, rel=1e-14
        )


def hidden(light, w):
    """Return whether a linear solve puts the hit inside the occluder and before the light."""
    if light.occluder is None:
        return False
    corner, e0, e1 = (np.array(v) for v in light.occluder)
    matrix = np.stack([e0, e1, -w], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-14:
        return False
    a, b, tau = np.linalg.solve(matrix, np.array(light.origin) - corner)
    return 0 <= a <= 1 and 0 <= b <= 1 and 0 < tau < 1


def view_factor(a, b):
    """View factor of an element to a parallel rectangle a × b at distance 1 over one corner."""
    p, q = math.sqrt(1 + a * a), math.sqrt(1 + b * b)
    return (a / p * math.atan(b / p) + b / q * math.atan(a / q)) / (2 * math.pi)


@pytest.mark.parametrize(("a", "b"), [(1, 1), (0.3, 2), (50, 70), (1e-3, 1e-3)])
def test_view_factors(a, b):
    f = RectangleLight(corner=(0, 0, 1), edge0=(a, 0, 0), edge1=(0, b, 0))
    assert f.integral == pytest.approx(math.pi * view_factor(a, b), rel=1e-12, abs=1e-15)


def test_a_light_that_fills_the_sky():
    f = RectangleLight(corner=(-1e4, -1e4, 1), edge0=(2e4, 0, 0), edge1=(0, 2e4, 0), radiance=3)
    assert f.integral == pytest.approx(3 * math.pi, rel=1e-7)


def test_occluders_that_hide_nothing():
    for case in HIDES_NOTHING:
        f = RectangleLight(**CASES[case])
        assert f.integral == pytest.approx(RectangleLight().integral, rel=1e-14)
    shadow = RectangleLight(**CASES["occluded"]).integral
    assert 0.2 < shadow / RectangleLight().integral < 0.8
    whole = RectangleLight(occluder=[[-1, -1, 0.5], [2, 0, 0], [0, 2, 0]])
    assert whole.integral == pytest.approx(0.0, abs=1e-15)
    assert whole(midpoints(8)).max() == 0


def test_importance_sampling_by_solid_angle_takes_the_distance_out():
    """f/p = Ω L cos θ has less variance than area sampling."""
    where = "corner=[-1, -0.3, 0.2], edge0=[2, 0, 0], edge1=[0, 1, 0]"
    f = mcs.integrand(f"rectangle-light({where})")
    p = mcs.density(f"spherical-rectangle({where})")
    u = midpoints(256).reshape(-1, 2)
    g = mcs.Estimator(f, p).primary_values(0, u)
    assert g.mean() == pytest.approx(f.integral, rel=1e-4)
    assert g.max() <= p.solid_angle * (1 + 1e-12)
    assert g.var() < 0.5 * f(u).var()


def test_the_spec_makes_it_again(light):
    again = mcs.integrand(light.spec)
    assert again == light
    assert hash(again) == hash(light)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radiance": -1}, "radiance"),
        ({"normal": (0, 0, 0)}, "normal"),
        ({"normal": (0, 0)}, "normal"),
        ({"edge0": (0, 0, 0)}, "no area"),
        ({"origin": (0, 0, 1)}, "in the plane"),
        ({"occluder": 3}, "occluder is 3"),
        ({"occluder": [[0, 0, 1]]}, "occluder"),
        ({"occluder": [[0, 0, 1], [1, 0], [0, 1, 0]]}, r"occluder\[1\]"),
        ({"occluder": [[0, 0, 1], [1, 0, 0], [2, 0, 0]]}, "no area"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(ParameterError, match=message) as caught:
        RectangleLight(**options)
    assert "\n" not in str(caught.value)


def test_other_dims_are_refused():
    with pytest.raises(ParameterError, match="dims"):
        mcs.integrand("rectangle-light", dims=3)
