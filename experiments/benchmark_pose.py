"""The cost of one step of fitting a spot light's pose, and of its parts.

    python experiments/benchmark_pose.py

The scene is a torus knot on the ground, with an image of 512² pixels, a map of 512² texels and 16 bilinear taps per
pixel. A step draws the map, finds its silhouettes and filters it; derivatives are with respect to position and
direction. Times are medians of compiled runs that take turns. Parts are timed as steps that leave other parts out.
"""

import argparse
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from _common import machine, median_ms
from benchmark_raster import positive
from rich.table import Table

from diffshadow.console import Console
from diffshadow.geometry import Edges, Mesh, PinholeCamera, SpotLight, library_mesh, merge
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    HardCompare,
    RandomDisk,
    ShadowMapping,
    SlopeBias,
    draw_shadow_map,
    plan_crossings,
    stratified,
)

PARTS = (
    "map",
    "map and silhouettes",
    "plain step",
    "step",
    "step and gradient, forward",
    "step and gradient, reverse",
)
POSITION, DIRECTION = jnp.array([-1.2, 2.6, 0.9]), jnp.array([1.2, -2.2, -0.9])


def main() -> None:
    """Measures, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=positive, default=9, help="timed runs of each step")
    parser.add_argument("--pixels", type=positive, default=512, help="side of the image, and of the map in texels")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="which parts")
    options = parser.parse_args()
    size = (options.pixels, options.pixels)
    knot = library_mesh("torus_knot")
    knot = Mesh(knot.vertices - jnp.array([0.0, knot.vertices[:, 1].min(), 0.0]), knot.faces)
    mesh = merge([knot, library_mesh("plane", size=4.0)])
    camera = PinholeCamera((1.3, 1.8, 2.2), (0.1, 0.2, -0.2), fov_y=45.0, near=0.5, far=12.0, resolution=size)
    surface, edges = draw_surface(mesh, camera), Edges.of(mesh)
    technique = ShadowMapping(RandomDisk(2.0, stratified(16, 8)), SlopeBias(1.0), HardCompare())
    light = lambda by: SpotLight(POSITION + by[:3], DIRECTION + by[3:], 40.0, 0.5, 6.0)
    crossings = plan_crossings(mesh, light(jnp.zeros(6)), size, edges)

    def draw(by, outlines=True):
        return draw_shadow_map(mesh, light(by), size, edges=edges if outlines else None, crossings=crossings)

    def loss(by, outlines=True):
        return jnp.mean((technique.visibility(draw(by, outlines), surface) - 0.5) ** 2)

    steps = (
        lambda by: draw(by, outlines=False),
        draw,
        lambda by: loss(by, outlines=False),
        loss,
        jax.jacfwd(lambda by: (loss(by),) * 2, has_aux=True),
        jax.value_and_grad(loss),
    )
    start = jnp.zeros(6)
    compiled = {
        name: eqx.filter_jit(step).lower(start).compile()
        for name, step in zip(PARTS, steps, strict=True)
        if name in options.only
    }
    console = Console()
    medians = median_ms({name: partial(step, start) for name, step in compiled.items()}, options.repeats, console)
    table = Table("part", "ms", "over step")
    for name, ms in medians.items():
        table.add_row(name, f"{ms:.1f}", f"{ms / medians['step']:.2f}" if "step" in medians else "")
    console.print(machine())
    console.print(f"{mesh.faces.shape[0]} triangles, memory for {crossings} crossings")
    console.print(table)


if __name__ == "__main__":
    main()
