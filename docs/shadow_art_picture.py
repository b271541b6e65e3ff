"""Draws `images/shadow_art.webp`: the sculpture of `notebooks/shadow_art.py` and its two shadows, as it is fitted.

Run as `python docs/shadow_art_picture.py`.
"""

import os
import runpy
from pathlib import Path

import matplotlib
import numpy as np

from diffshadow import geometry, io

matplotlib.use("Agg")

SIDE, FRAMES, PAUSE, MILLISECONDS = 300, 32, 10, 90
ROOT = Path(__file__).parent.parent


def main() -> None:
    os.chdir(ROOT / "notebooks")
    notebook = runpy.run_path("shadow_art.py")
    steps, faces = notebook["steps"], np.asarray(notebook["faces"])
    # Most happens at first.
    shown = np.unique(np.geomspace(1, len(steps), FRAMES).astype(int)) - 1
    meshes = [*(geometry.Mesh(steps[number][0], faces) for number in shown), notebook["result"].mesh]
    frames = [notebook["room"](mesh, SIDE)[SIDE // 6 : -SIDE // 9] for mesh in meshes]
    frames = np.stack([frames[0]] * 4 + frames + [frames[-1]] * PAUSE)
    io.write_animation(ROOT / "docs" / "images" / "shadow_art.webp", frames, MILLISECONDS)


if __name__ == "__main__":
    main()
