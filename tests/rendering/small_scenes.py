"""Five small scenes: a glossy plate, a room, an environment map, a thin lens and fog."""

import numpy as np

from mcspectra.rendering import load_mitsuba


def camera(width, height, *, kind="perspective", spp=16, rfilter="box", **more):
    """A camera that looks down at the origin."""
    look = load_mitsuba().ScalarTransform4f().look_at
    return {
        "type": kind,
        "fov": 40,
        "to_world": look(origin=[0, 2, 6], target=[0, 0.6, 0], up=[0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": rfilter},
        },
        "sampler": {"type": "multijitter", "sample_count": spp},
        **more,
    }


def plane(turn, place, size, **more):
    """A square that is turned about the x axis, scaled and moved."""
    at = load_mitsuba().ScalarTransform4f()
    return {
        "type": "rectangle",
        "to_world": at.translate(place).rotate([1, 0, 0], turn).scale(size),
        **more,
    }


def light(value):
    """An area light of this radiance."""
    return {"type": "area", "radiance": {"type": "rgb", "value": value}}


def plate(**film):
    """A glossy plate that mirrors two lights."""
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": camera(**film),
        "floor": plane(-90, [0, 0, 0], 5, bsdf={"type": "roughconductor", "alpha": 0.15}),
        "back": plane(0, [0, 0, -4], 5, bsdf={"type": "diffuse"}),
        "lamp": plane(60, [-1.5, 3, -2], 0.6, emitter=light([8, 6, 4])),
        "ball": {
            "type": "sphere",
            "center": [1.5, 1.5, -2],
            "radius": 0.3,
            "emitter": light([4, 6, 9]),
        },
    }


def room(**film):
    """The Cornell box with paths of up to six segments."""
    scene = load_mitsuba().cornell_box()
    own = camera(**film)
    scene["integrator"] = {"type": "path", "max_depth": 6}
    scene["sensor"] |= {"film": own["film"], "sampler": own["sampler"]}
    return scene


def sky(**film):
    """Two balls on a floor, lit by an environment map with six bright spots."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:32, 0:64]
    data = (0.3 + 0.2 * np.cos(x / 64 * 2 * np.pi))[..., None] * np.ones(3)
    for _ in range(6):
        row, column, color = rng.integers(2, 16), rng.integers(0, 64), rng.random(3)
        away = (y - row) ** 2 + ((x - column + 32) % 64 - 32) ** 2
        data += 12 * np.exp(-away / 3.0)[..., None] * color
    rough = {"type": "roughplastic", "alpha": 0.1}
    metal = {"type": "roughconductor", "alpha": 0.3}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": camera(**film),
        "sky": {"type": "envmap", "bitmap": load_mitsuba().Bitmap(data.astype(np.float32))},
        "floor": plane(-90, [0, 0, 0], 6, bsdf={"type": "diffuse"}),
        "ball": {"type": "sphere", "center": [-1, 1, 0], "radius": 1, "bsdf": rough},
        "other": {"type": "sphere", "center": [1.4, 0.8, 0.5], "radius": 0.8, "bsdf": metal},
    }


def lens(**film):
    """Balls out of focus on a checkered floor, seen by a camera with a thin lens."""
    fine = load_mitsuba().ScalarTransform4f().scale(12)
    checks = {"type": "diffuse", "reflectance": {"type": "checkerboard", "to_uv": fine}}
    balls = {
        f"ball-{k}": {
            "type": "sphere",
            "center": [k - 2.0, 0.4, 2 - 1.2 * k],
            "radius": 0.4,
            "bsdf": {"type": "plastic"},
        }
        for k in range(4)
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": camera(**film, kind="thinlens", aperture_radius=0.15, focus_distance=5.0),
        "floor": plane(-90, [0, 0, 0], 6, bsdf=checks),
        "back": plane(0, [0, 0, -5], 8, bsdf={"type": "diffuse"}),
        "lamp": plane(90, [0, 5, 0], 1.2, emitter=light([9, 9, 9])),
        **balls,
    }


def fog(**film):
    """A box of fog in front of a wall, lit by a ball."""
    at = load_mitsuba().ScalarTransform4f()
    inside = {
        "type": "homogeneous",
        "albedo": 0.8,
        "sigma_t": 0.6,
        "phase": {"type": "hg", "g": 0.3},
    }
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 5},
        "sensor": camera(**film),
        "floor": plane(-90, [0, 0, 0], 6, bsdf={"type": "diffuse"}),
        "back": plane(0, [0, 0, -4], 8, bsdf={"type": "diffuse"}),
        "cloud": {
            "type": "cube",
            "to_world": at.translate([0, 1.2, 0]).scale([2, 1.1, 1]),
            "bsdf": {"type": "null"},
            "interior": inside,
        },
        "lamp": {
            "type": "sphere",
            "center": [1, 4, 1],
            "radius": 0.5,
            "emitter": light([30, 28, 25]),
        },
    }


SCENES = {"plate": plate, "room": room, "sky": sky, "lens": lens, "fog": fog}
