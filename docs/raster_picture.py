"""Draws `images/raster.png`: what each pixel of a light's view sees, coloured by the size of the triangle's pixel box.

Run as `python docs/raster_picture.py`.
"""

from pathlib import Path

import jax.numpy as jnp
import matplotlib
import numpy as np

from diffshadow import geometry, raster

matplotlib.use("Agg")
from matplotlib import pyplot as plt

SIZE = 192
SIDES = (2, 4, 8, 16)


def main() -> None:
    plane = geometry.library_mesh("plane", size=1.6)
    knot = geometry.library_mesh("torus_knot", segments=72, sides=12)
    ball = geometry.library_mesh("sphere", radius=0.2, subdivisions=4)
    ball = ball.transformed(geometry.translation(jnp.array([-0.55, 0.0, 0.45])))
    mesh = geometry.merge([plane, knot, ball])
    light = geometry.DirectionalLight.around(jnp.array([0.5, -1.0, -0.6]), mesh.vertices)
    clip = light.view().clip(mesh.vertices)
    face = np.asarray(raster.rasterize(clip, mesh.faces, (SIZE, SIZE), cull="back").face)

    window = np.asarray((clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * SIZE)[np.asarray(mesh.faces)]
    box = np.floor(window.max(axis=1) - 0.5) - np.ceil(window.min(axis=1) - 0.5) + 1
    size_class = np.searchsorted(SIDES, box.max(axis=1))
    shown = np.where(face >= 0, size_class[face], np.nan)

    figure, axes = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    names = [f"{side} x {side} window" for side in SIDES] + ["blocks of 16 x 16"]
    colours = plt.get_cmap("viridis", len(names))
    image = axes.imshow(shown, origin="lower", cmap=colours, vmin=-0.5, vmax=len(names) - 0.5, interpolation="nearest")
    # The pattern of the faces themselves, faintly.
    axes.imshow(np.where(face % 2 == 0, 0.0, np.nan), origin="lower", cmap="gray", alpha=0.12, interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    figure.colorbar(image, ticks=range(len(names))).ax.set_yticklabels(names)
    figure.savefig(Path(__file__).parent / "images" / "raster.png", dpi=100)


if __name__ == "__main__":
    main()
