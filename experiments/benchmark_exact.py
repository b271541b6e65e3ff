"""How long exact hard shadows take: the irregular z-buffer beside shadow volumes, the ray-traced reference and a map.

    python experiments/benchmark_exact.py
    python experiments/benchmark_exact.py --triangles 1000 10000 100000 --pixels 256 512 1024

The scene is a torus knot on the ground, under a sun, a spot light and a point light without size. All find one
visibility per pixel, at its centre. Times are medians of compiled runs that take turns:

- `surface`: what the camera sees; `map` and `irregular` need it in addition to their own time.
- `map`: a plain shadow map, drawn and looked up in with one tap.
- `irregular`: points sorted, and triangles tested against them.
- `volumes`: shadow volumes, by z-fail, with a table of edges made beforehand. They see the surface themselves.
- `camera rays`: the reference's first half, which finds the surface.
- `reference`: camera rays and one shadow ray per pixel, by Embree on all cores.

The last columns are ratios. Both are of whole pictures: the surface and the irregular z-buffer, over the reference, and
over the surface and the map.
"""

import argparse

import jax.numpy as jnp
import numpy as np
from _common import machine, median_ms
from benchmark_raster import positive
from rich.table import Table

from diffshadow.console import Console
from diffshadow.geometry import (
    DirectionalLight,
    PinholeCamera,
    PointLight,
    Scene,
    SpotLight,
    library_mesh,
    merge,
)
from diffshadow.raster import draw_surface
from diffshadow.reference import reference_from_image, trace_visibility
from diffshadow.shadow import Bias, IrregularZBuffer, MapSettings, Nearest, ShadowMapping, ShadowVolumes

LIGHTS = {
    "directional": lambda points: DirectionalLight.around(jnp.array([0.5, -1.0, -0.3]), points),
    "spot": lambda points: SpotLight.around(jnp.array([-1.2, 3.0, 0.9]), points),
    "point": lambda points: PointLight.around(jnp.array([0.3, 1.2, 0.2]), points),
}


def scene(triangles: int, pixels: int, light: str) -> Scene:
    """A torus knot of about `triangles` on a ground of two."""
    sides = max(3, round((triangles / 16) ** 0.5))
    knot = library_mesh("torus_knot", segments=max(3, round(triangles / 2 / sides)), sides=sides)
    mesh = merge([knot, library_mesh("plane", size=4.0)])
    size = (pixels, pixels)
    camera = PinholeCamera((1.6, 1.4, 2.0), (0.0, 0.3, 0.0), fov_y=40.0, near=0.1, far=10.0, resolution=size)
    return Scene(mesh, camera, LIGHTS[light](mesh.vertices))


def measure(given: Scene, texels: int, repeats: int, console: Console) -> tuple[dict[str, float], float]:
    """Medians in milliseconds, and in which part of the pixels the irregular z-buffer differs from the reference."""
    surface, truth = draw_surface(given.mesh, given.camera), trace_visibility(given, samples=1)
    plain = ShadowMapping(Nearest(), Bias(1.0, 1.0), map=MapSettings((texels, texels)))
    irregular, volumes = IrregularZBuffer(), ShadowVolumes()
    points, edges = irregular.prepare(given), volumes.prepare(given)
    mesh, ones = given.mesh, np.ones(given.camera.resolution, np.float32)

    def traced(of: object) -> None:
        """A reference is made of NumPy arrays, and is done once it is returned."""

    steps = {
        "surface": lambda: draw_surface(mesh, given.camera).position,
        "map": lambda: plain.visibility(plain.prepare(given), surface),
        "irregular": lambda: irregular.visibility(points, surface),
        "volumes": lambda: volumes.visibility(edges),
        "camera rays": lambda: traced(reference_from_image(ones, given)),
        "reference": lambda: traced(trace_visibility(given, samples=1)),
    }
    same = truth.mask & (np.asarray(surface.face) == truth.face)
    differs = np.mean(np.asarray(steps["irregular"]()) != truth.visibility, where=same)
    return median_ms(steps, repeats, console), float(differs)


def main() -> None:
    """Measures, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=positive, nargs="+", default=[10000], help="in the knot, about")
    parser.add_argument("--pixels", type=positive, nargs="+", default=[512], help="sides of the image")
    parser.add_argument("--texels", type=positive, default=1024, help="side of the map; a point light has six")
    parser.add_argument("--lights", nargs="+", default=list(LIGHTS), choices=list(LIGHTS))
    parser.add_argument("--repeats", type=positive, default=9, help="timed runs of each step")
    options = parser.parse_args()
    console, rows = Console(), []
    for triangles in options.triangles:
        for pixels in options.pixels:
            for light in options.lights:
                given = scene(triangles, pixels, light)
                ms, differs = measure(given, options.texels, options.repeats, console)
                whole = ms["surface"] + ms["irregular"]
                ratios = whole / ms["reference"], whole / (ms["surface"] + ms["map"])
                place = f"{light}, {given.mesh.faces.shape[0]:,}, {pixels}²"
                rows.append(
                    (ms, [place, *(f"{t:.1f}" for t in ms.values()), *(f"{r:.2f}" for r in ratios), f"{differs:.1e}"])
                )
    table = Table("light, triangles, pixels", *rows[0][0], "/ reference", "/ map", "differs")
    for _, row in rows:
        table.add_row(*row)
    console.print(machine())
    console.print(f"map of {options.texels}² texels; milliseconds")
    console.print(table)


if __name__ == "__main__":
    main()
