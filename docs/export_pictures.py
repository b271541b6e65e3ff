"""Draws `images/export/*.png`: the steps of a shadow map, from bare depths to soft edges.

Run as `python docs/export_pictures.py`.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from PIL import Image

from diffshadow import geometry, raster, shading, shadow

FOLDER = Path(__file__).parent / "images" / "export"
PIXELS = (225, 300)
TEXELS = (192, 192)

# Filter and biases, constant, slope and normal offset, in texels.
STEPS = {
    "acne": (shadow.Nearest(), shadow.Bias(0.0, 0.0, 0.0)),
    "bias": (shadow.Nearest(), shadow.Bias(0.5, 0.5, 0.0)),
    "too_much": (shadow.Nearest(), shadow.Bias(12.0, 0.5, 0.0)),
    "pcf": (shadow.PercentageCloser(1.5), shadow.Bias(1.0, 1.0, 0.5)),
    "disk": (shadow.RandomDisk(3.0, shadow.vogel(16, rotated=True)), shadow.Bias(1.5, 1.5, 0.5)),
}


def main() -> None:
    knot = geometry.drop_to_ground(geometry.fit_to_size(geometry.library_mesh("torus_knot"), 1.0))
    meshes = [
        knot.transformed(geometry.translation(jnp.array([0.0, 0.12, 0.0]))),
        geometry.library_mesh("plane", size=3.0),
    ]
    camera = geometry.PinholeCamera((1.3, 1.4, 1.8), (0.15, 0.3, 0.0), fov_y=36.0, resolution=PIXELS)
    light = geometry.DirectionalLight.around((0.7, -1.0, -0.3), geometry.merge(meshes).vertices)
    scene = geometry.Scene(meshes, camera, light)
    surface = raster.draw_surface(scene.mesh, camera)
    FOLDER.mkdir(exist_ok=True)
    for name, (kernel, bias) in STEPS.items():
        technique = shadow.ShadowMapping(kernel, bias, map=shadow.MapSettings(TEXELS))
        state = technique.prepare(scene)
        linear = shading.Phong()(surface, technique.visibility(state, surface), light, camera)
        write(name, shading.to_srgb(np.clip(np.asarray(linear), 0, 1)))
        if name == "acne":
            write("map", np.asarray(state.depth))


def write(name: str, image: np.ndarray) -> None:
    """Writes an image, (h, w) or (h, w, 3), from 0 to 1, whose row 0 is at the bottom."""
    Image.fromarray(np.rint(255 * image[::-1]).astype(np.uint8)).save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
