"""Render the frames of this folder: Mitsuba's Cornell box, one seed for each frame.

Run the script with a folder for the frames: ``python docs/examples/frames/make.py FOLDER``.
The script needs the extra ``render``.
The files are .npy arrays in half precision with 64 × 64 pixels.
These .npy files are small, and mcspectra can read them without optional packages.
Other versions of Mitsuba and other processors give images with different noise.
README quotes numbers of the committed frames, so write new frames to another folder.
"""

import sys
from pathlib import Path

import numpy as np

from mcspectra.rendering import load_mitsuba

SIZE, FRAMES, COUNTS = 64, 6, (16, 64)


def main(folder: str) -> None:
    """Render all frames and write them to a folder."""
    mi = load_mitsuba()
    box = mi.cornell_box()
    box["sensor"]["film"] |= {"width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    scene = mi.load_dict(box)
    for spp in COUNTS:
        for frame in range(FRAMES):
            image = np.array(mi.render(scene, spp=spp, seed=1000 * spp + frame))
            file = Path(folder) / f"cornell_{frame}_{spp}spp.npy"
            np.save(file, image.astype(np.float16))


if __name__ == "__main__":
    main(sys.argv[1])
