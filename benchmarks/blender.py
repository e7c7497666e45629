"""Measure the noise of the sampling patterns of Blender's Cycles with `mcspectra frames`.

Run ``BLENDER_PYTHON=… python -m benchmarks blender``.
The variable names a Python 3.11 that has the package bpy.
This Python interpreter runs the file as a script, which renders two spheres below an area light.
Each pattern has 8 frames of 96 × 72 pixels with 4, 16 and 64 samples.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

PATTERNS = ("TABULATED_SOBOL", "BLUE_NOISE")
SAMPLES, FRAMES = (4, 16, 64), 8


def main() -> None:
    """Render the frames of each pattern, and print their statistics."""
    python = os.environ.get("BLENDER_PYTHON")
    if python is None:
        print("Not run: set BLENDER_PYTHON to a Python that has the package bpy.")
        return
    from mcspectra.rendering import frames
    from mcspectra.report.frames_page import frame_findings

    with tempfile.TemporaryDirectory() as folder:
        for pattern in PATTERNS:
            out = Path(folder) / pattern
            command = [python, __file__, pattern, str(out)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            found = frames(out, flip=False)
            variances = ", ".join(f"{v:.3g}" for v in found["picture_variance"].values)
            print(f"{pattern}: variance {variances} at {', '.join(map(str, SAMPLES))} samples")
            for said in frame_findings(found):
                print(f"  {said}")


def render(pattern: str, folder: str) -> None:
    """Render the frames of one sampling pattern in Blender."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.sampling_pattern = pattern
    scene.render.resolution_x, scene.render.resolution_y = 96, 72
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"

    mesh = bpy.ops.mesh
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
        material.use_nodes = True
        inputs = material.node_tree.nodes["Principled BSDF"].inputs
        inputs["Base Color"].default_value = color
        inputs["Metallic"].default_value, inputs["Roughness"].default_value = metal, 1 - 0.8 * metal
        bpy.context.object.data.materials.append(material)
    bpy.ops.object.light_add(type="AREA", location=(0, -1, 4))
    bpy.context.object.data.energy, bpy.context.object.data.size = 200, 1.5
    bpy.ops.object.camera_add(location=(0, -6, 2), rotation=(1.35, 0, 0))
    scene.camera = bpy.context.object

    for samples in SAMPLES:
        for frame in range(FRAMES):
            scene.cycles.samples, scene.cycles.seed = samples, 7919 * frame + samples
            scene.render.filepath = f"{folder}/spp{samples}/{frame}.exr"
            bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    render(*sys.argv[1:])
