"""Test frames of Blender's Cycles: sampling patterns, filters, sequences, and `mcspectra gate`.

Run ``python -m benchmarks blender``, or ``python -m benchmarks blender --quick``.
The benchmark needs Blender 5.0: the program ``blender`` on the path, or the package bpy.
The package bpy may be in this environment, or in a Python that BLENDER_PYTHON names.
The scene has a diffuse and a glossy sphere below an area light, which makes soft shadows.
Frames have 96 × 64 pixels, are not denoised, and each has its own seed.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

PATTERNS = ("TABULATED_SOBOL", "BLUE_NOISE")
SAMPLES, FRAMES = (4, 16, 64), 8
SIZE = (96, 64)
# Numbers of frames: to predict the errors after filters, and to measure these errors
MEASURED, HELD = 24, 48
SEEDS, HELD_SEEDS, TIMES = 4, 8, 12
# In frames of a sequence, only this number of columns on the left is compared.
# Farther to the right, 60 pixels of the light's reflection make half of the variance
COLUMNS = 60
# Number of pairs of frame sets that the gate compares, and number of frames in each set
PAIRS, EACH = 50, 8
INSTALL = (
    "Not run: Blender is not found. Put blender on the path, or run `pip install bpy` in a Python "
    "of the version that bpy needs, and name that Python in BLENDER_PYTHON."
)
# Changes of the scene that the gate must find: roughness of the glossy sphere, power of the light
CHANGES: dict[str, dict[str, float]] = {
    "roughness 0.50 → 0.51": {"roughness": 0.51},
    "roughness 0.50 → 0.55": {"roughness": 0.55},
    "light × 1.002": {"light": 200.4},
    "light × 1.01": {"light": 202.0},
}


def blender() -> list[str] | None:
    """Return the command that runs a script in Blender, or None if Blender is not installed."""
    if python := os.environ.get("BLENDER_PYTHON"):
        return [python]
    if importlib.util.find_spec("bpy"):
        return [sys.executable]
    if program := shutil.which("blender"):
        return [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    return None


def render(command: list[str], jobs: list[dict[str, Any]]) -> None:
    """Render a list of frames; see `_render` for what a job holds."""
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / "jobs.json"
        listed.write_text(json.dumps(jobs))
        words = [*command, __file__, "--", str(listed)]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def still(pattern: str, samples: int, seed: int, folder: Path, **scene: float) -> dict[str, Any]:
    """Return the job of a frame with its own seed."""
    name = str(folder / f"view_{samples}spp_{seed:03d}.exr")
    return {"pattern": pattern, "samples": samples, "seed": 7919 * seed + samples, "out": name} | (
        dict(scene)
    )


def shot(seed: int, time: int, folder: Path, *, animated: bool) -> dict[str, Any]:
    """Return the job of a frame of a sequence with a moving light, at 16 samples.

    Blender's option for animated seeds adds the number of the frame to the seed.
    """
    return {
        "pattern": "TABULATED_SOBOL",
        "samples": 16,
        "seed": 104_729 * seed + (7919 * time if animated else 0),
        "move": 0.02 * time,
        "out": str(folder / f"shot_s{seed}_t{time:03d}.exr"),
    }


def main(*flags: str) -> None:
    """Render the frames, and print their statistics, predictions, and verdicts."""
    command = blender()
    if command is None:
        print(INSTALL)
        return
    quick = "--quick" in flags
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        _statistics(command, place, PATTERNS)
        _filters(command, place, PATTERNS[:1] if quick else PATTERNS)
        _sequences(command, place)
        _gate(command, place, quick=quick)


def _statistics(command: list[str], place: Path, patterns: tuple[str, ...]) -> None:
    """Print the findings of `frames` for each sampling pattern."""
    from mcspectra.rendering import frames
    from mcspectra.report.frames_page import frame_findings

    for pattern in patterns:
        out = place / pattern
        out.mkdir()
        jobs = [still(pattern, n, k, out) for n in SAMPLES for k in range(FRAMES)]
        render(command, jobs)
        found = frames(out, flip=False)
        variances = ", ".join(f"{v:.3g}" for v in found["picture_variance"].values)
        print(f"{pattern}: variance {variances} at {', '.join(map(str, SAMPLES))} samples")
        beside = found["error_correlation"].isel(n=0).sel(lag_y=0, lag_x=1).item()
        print(f"  correlation of horizontal neighbors at {SAMPLES[0]} samples: {beside:.3f}")
        for n in SAMPLES:
            one = found.sel(n=n)
            power = one["error_spectrum"].values
            ends = [power[:6].mean(), *(power[a:b].mean() for a, b in pairwise((6, 18, 30, None)))]
            print(f"  {n} samples, power / white in rings from low to high: ", end="")
            print(", ".join(f"{each:.2f}" for each in ends), flush=True)
        for said in frame_findings(found):
            print(f"  {said}")


def _filters(command: list[str], place: Path, patterns: tuple[str, ...]) -> None:
    """Print predicted and measured errors after filters in space."""
    from benchmarks import filters
    from mcspectra.core.images import luminance, read_image

    print(filters.HEADER)
    for pattern in patterns:
        out = place / f"{pattern}-held"
        out.mkdir()
        render(command, [still(pattern, 4, 100 + k, out) for k in range(MEASURED + HELD)])
        found = (luminance(read_image(file)[..., :3]) for file in sorted(out.glob("*.exr")))
        filters.space(f"Blender {pattern}", found, MEASURED, place / f"{pattern}-used")


def _sequences(command: list[str], place: Path) -> None:
    """Print predicted and measured errors after averages over the frames of sequences."""
    import numpy as np

    from benchmarks import filters
    from mcspectra.core.images import luminance, read_image

    for animated in (True, False):
        out = place / f"shots-{animated}"
        out.mkdir()
        seeds = range(1, SEEDS + HELD_SEEDS + 1)
        render(command, [shot(s, t, out, animated=animated) for s in seeds for t in range(TIMES)])
        read = np.stack(
            [
                [
                    luminance(read_image(out / f"shot_s{s}_t{t:03d}.exr")[:, :COLUMNS, :3])
                    for t in range(TIMES)
                ]
                for s in seeds
            ]
        )
        name = "Blender, " + ("a seed for each frame" if animated else "one seed for all frames")
        filters.time(name, read[:SEEDS], read[SEEDS:], place / f"shots-{animated}-used")


def _gate(command: list[str], place: Path, *, quick: bool) -> None:
    """Print how often `mcspectra gate` rejects frames that differ only in their seeds.

    Also print the verdicts of `mcspectra gate` for frames of changed scenes.
    """
    import numpy as np

    from mcspectra.rendering import gate

    for pattern in PATTERNS[:1] if quick else PATTERNS:
        library = place / f"{pattern}-library"
        library.mkdir()
        render(command, [still(pattern, 16, 300 + k, library) for k in range(6 * EACH)])
        files = sorted(library.glob("*.exr"))
        rng, pairs, alarms = np.random.default_rng(1), 20 if quick else PAIRS, 0
        for _ in range(pairs):
            chosen = [files[k] for k in rng.permutation(len(files))[: 2 * EACH]]
            alarms += gate(chosen[:EACH], chosen[EACH:]).attrs["verdict"] == "fail"
        print(f"{pattern}: {alarms} false alarms at level 0.01 in {pairs} pairs of {EACH} + {EACH}")
        found = gate(files[:EACH], files[EACH : 2 * EACH])
        print(f"  the gate would find a bias of {100 * found.attrs['detectable_image']:.2f} %")
        for name, scene in CHANGES.items():
            out = place / f"{pattern}-{name[:12]}{name[-5:]}".replace(" ", "-")
            out.mkdir()
            render(command, [still(pattern, 16, 500 + k, out, **scene) for k in range(EACH)])
            found = gate(out, files[:EACH])
            least = found["test"].values[int(np.argmin(found["test_p"].values))]
            print(
                f"  {name}: {found.attrs['verdict']}, p = {found.attrs['p']:.4f} ({least}), "
                f"image mean {100 * found.attrs['mean_difference']:+.2f} %",
                flush=True,
            )


def _render(listed: str) -> None:
    """Render jobs inside Blender.

    A job has the sampling pattern, samples, seed, and file, and may change the scene.
    """
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.use_persistent_data = True

    mesh = bpy.ops.mesh
    glossy = None
    for make, color, metal in (
        (lambda: mesh.primitive_plane_add(size=10), (0.6, 0.6, 0.6, 1), 0.0),
        (
            lambda: mesh.primitive_uv_sphere_add(radius=0.8, location=(-1, 0, 0.8)),
            (0.7, 0.1, 0.1, 1),
            0.0,
        ),
        (
            lambda: mesh.primitive_uv_sphere_add(radius=0.8, location=(1, 0, 0.8)),
            (0.9, 0.9, 0.9, 1),
            1.0,
        ),
        (
            lambda: mesh.primitive_plane_add(size=10, location=(0, 3, 0), rotation=(1.5708, 0, 0)),
            (0.2, 0.5, 0.2, 1),
            0.0,
        ),
    ):
        make()
        material = bpy.data.materials.new("material")
        material.use_nodes = True  # the default of Blender 6
        inputs = material.node_tree.nodes["Principled BSDF"].inputs
        inputs["Base Color"].default_value = color
        inputs["Metallic"].default_value, inputs["Roughness"].default_value = metal, 1 - 0.5 * metal
        bpy.context.object.data.materials.append(material)
        glossy = inputs["Roughness"] if metal else glossy
    bpy.ops.object.light_add(type="AREA", location=(0, -1, 4))
    light = bpy.context.object
    light.data.energy, light.data.size = 200, 2.5
    bpy.ops.object.camera_add(location=(0, -6, 2), rotation=(1.35, 0, 0))
    scene.camera = bpy.context.object

    for job in json.loads(Path(listed).read_text()):
        scene.cycles.sampling_pattern = job["pattern"]
        scene.cycles.samples, scene.cycles.seed = job["samples"], job["seed"]
        glossy.default_value = job.get("roughness", 0.5)
        light.data.energy = job.get("light", 200.0)
        light.location.x = job.get("move", 0.0)
        scene.render.filepath = job["out"]
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    _render(sys.argv[-1])
