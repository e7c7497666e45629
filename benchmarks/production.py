"""Work on scenes at production size: maps against raw renders, adaptive images, estimated times.

Without a flag, a crop of 240 × 135 pixels is mapped (paths of depth 6, n = 4, 16 and 64).
The same samples are rendered by ``mi.render`` with the stock sampler, in turn with the map.
``--adaptive`` compares adaptive images with images that have equally many samples in all pixels.
A variance map gives the samples per pixel of an adaptive image; all images have the same cost.
``--dry-run`` compares estimated times of maps, images, profiles and pixels with measured ones.
"""

import json
import math
import shlex
import subprocess
import sys
import tempfile
import time

import numpy as np
from tests.rendering.small_scenes import SCENES

from benchmarks.timing import compare
from mcspectra.core.images import REC709
from mcspectra.rendering import load_mitsuba, variance_map
from mcspectra.rendering.adaptive import render_adaptive, samples_per_pixel

CROP, COUNTS, REALIZATIONS, ROUNDS = (240, 135), (4, 16, 64), 4, 5
SHARES = (0.5, 0.95, 0.99)  # quantiles at which the relative errors of pixels are compared


def against_raw():
    """Print the time of a map in relation to raw renders of the same samples."""
    mitsuba = load_mitsuba()
    scene = SCENES["room"](width=CROP[0], height=CROP[1])
    loaded = mitsuba.load_dict(scene)

    def mapped():
        variance_map(scene, integrator="scene", counts=COUNTS, realizations=REALIZATIONS, chains=0)

    def raw():
        for n in COUNTS:
            for seed in range(REALIZATIONS):
                np.array(mitsuba.render(loaded, spp=n, seed=mitsuba.UInt32(seed)))

    best, reference, ratio = compare(mapped, raw, ROUNDS)
    samples = CROP[0] * CROP[1] * sum(COUNTS) * REALIZATIONS / 1e6
    print(
        f"map / mi.render of the same {samples:.1f} million samples: median {ratio:.2f} of "
        f"{ROUNDS} pairs; {samples / best:.2f} and {samples / reference:.2f} million samples/s"
    )


def adaptive(width=32, height=24, renders=24):
    """Print errors of adaptive images, divided by errors with equal samples at equal cost."""
    for name, target in (("room", 0.1), ("sky", 0.03), ("lens", 0.05), ("fog", 0.1)):
        scene = SCENES[name](width=width, height=height)
        found = variance_map(
            scene, integrator="scene", counts=COUNTS, realizations=32, chains=0, rng=1
        )
        wanted = samples_per_pixel(found, target)
        cost = float((2 ** np.ceil(np.log2(wanted.spp))).mean())
        low = 2 ** math.floor(math.log2(cost))

        def errors(spp, first, scene=scene):
            made = [render_adaptive(scene, spp, seed=first + k) for k in range(renders)]
            values = np.stack(made) @ REC709
            seen = values.mean(axis=0) > 0
            relative = values.std(axis=0, ddof=1)[seen] / values.mean(axis=0)[seen]
            return np.array([*np.quantile(relative, SHARES), np.mean(relative**2) ** 0.5])

        own = errors(wanted.spp, 0)
        both = [errors(np.full((height, width), n), 1000 * n) for n in (low, 2 * low)]
        share = math.log2(cost / low)
        equal = np.exp((1 - share) * np.log(both[0]) + share * np.log(both[1]))
        told = ", ".join(f"{v:.2f}" for v in own / equal)
        ends = f"{wanted.spp.min()} to {wanted.spp.max():4} samples, cost {cost:3.0f}"
        print(
            f"{name:5} target {target:<4}: {ends}; errors at 50, 95 and 99 % and RMS: {told}; "
            f"error at 95 % {own[1]:.3f}",
            flush=True,
        )


# Commands whose times are estimated, with sizes for which each takes 5 to 60 s on 2 cores
LARGE, SCENE = ("--width", "1920", "--height", "1080"), "penumbra(width=1920, height=1080)"
DEPTH = ("--integrator", "path(max_depth=4)")
COMMANDS = (
    ("map", "veach", "--integrator", "path(max_depth=6)", "--crop", "100,100,60,40"),
    ("map", SCENE, *DEPTH, "--pixels", "1%", "--counts", "4,16", "--realizations", "2"),
    ("map", "veach", "--crop", "100,100,60,40", "--realizations", "16"),
    ("render", "penumbra", *LARGE, *DEPTH, "--spp", "16"),
    ("render", "penumbra", *LARGE, "--spp", "8"),
    ("profile", SCENE, *DEPTH, "--seconds", "15"),
    ("pixel", "veach", "100", "100"),
    ("pixel", "veach", "100", "100", *DEPTH),
)


def seconds_of(command, *more):
    """Run a command in a new process. Return its wall time and its printed JSON."""
    words = (sys.executable, "-m", "mcspectra", *command, "--json", *more)
    start = time.perf_counter()
    made = subprocess.run(words, check=True, capture_output=True, text=True)
    return time.perf_counter() - start, json.loads(made.stdout)


def estimated():
    """Print estimated and measured seconds of commands, each in a process of its own.

    A dry run stores compiled kernels on disk, and the measured run loads them.
    """
    for command in COMMANDS:
        found = seconds_of(command, "--dry-run")[1]
        cost, most = found["seconds"], found["most"]
        with tempfile.TemporaryDirectory() as folder:
            place = {"map": f"{folder}/map", "render": f"{folder}/image.exr"}.get(command[0])
            seconds, _ = seconds_of(command, *(("-o", place) if place else ()))
        print(
            f"{shlex.join(command)}: estimated {cost:.1f} s"
            f"{'' if most is None else f' (at most {most:.1f} s)'}, measured {seconds:.1f} s, "
            f"ratio {cost / seconds:.2f}",
            flush=True,
        )


def main(*flags):
    """Compare a map with raw renders, or make the comparison that a flag selects."""
    mitsuba = load_mitsuba()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    if "--adaptive" in flags:
        adaptive()
    elif "--dry-run" in flags:
        estimated()
    else:
        against_raw()
