"""The notebooks of Worchel & Alexa ("Differentiable Shadow Mapping for Efficient Inverse Graphics", CVPR 2023), redone.

    git clone https://github.com/mworchel/differentiable-shadow-mapping
    python experiments/worchel_alexa.py differentiable-shadow-mapping

Repeats three of their notebooks with their meshes, images, lights, cameras, resolutions, kernels, losses and steps, on
whatever device JAX has. Prints the loss at the last step and the steps per second, beside what their notebooks print
(on a GPU that they do not name):

- pose: one angle of a mesh, 70 degrees off, from the picture of its shadow (`1_getting_started.ipynb`).
- plane, plane aside: one vertex of a square, from its shadow, as the light sees it and as another camera sees it
  (`3_minimal_plane.ipynb`).
- art: a sphere of 6,402 vertices whose shadow is a picture (`2_shadow_art.ipynb`). The rate falls along half a cosine,
  where theirs is constant.

Their shadow maps hold moments of the distance from the light's eye, filtered by a box whose border repeats the last
texels. So a plane darkens itself a little at the border of the map, and the pictures of their targets show that. The
script computes this border from their formulas, and multiplies the shadow by it before it compares. The loss without
this, and that of the pixels within the border, stand beside it.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from jaxtyping import Array, Float
from rich.table import Table
from scipy.ndimage import uniform_filter

from diffshadow import fit, geometry, io, raster, shadow
from diffshadow.config import ConfigError, Location, Mistake
from diffshadow.console import Console

PRINTED = {"pose": (1.32e-12, 110.86), "plane": (7e-7, 126.69), "plane aside": (0.0, 125.47), "art": (3.26e-5, 63.40)}
"""Loss at the last step and steps per second, as the notebooks print them."""
HALF, TEXELS, DISTANCE = 2.0, 256, 5.0
"""Of their lights: half the map's side and the eye's distance from the origin in world units, and the map's texels."""
LEAST_VARIANCE = 1e-4
"""The variance that their look-up uses where there is less."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


class Outcome(NamedTuple):
    """Of a case: the loss at the last step, steps per second, and remarks."""

    loss: float
    rate: float
    remark: str = ""


@app.default
def main(folder: Path, /, *, only: str = "pose,plane,art", scale: float = 1.0) -> dict[str, Outcome]:
    """Repeats the notebooks in FOLDER.

    Parameters
    ----------
    folder
        A clone of github.com/mworchel/differentiable-shadow-mapping.
    only
        Which cases, separated by commas.
    scale
        Fraction of their steps.
    """
    console = Console()
    names = common.chosen("only", only, ("pose", "plane", "art"))
    common.expect("scale", str(scale), 0 < scale <= 1, "above 0 and at most 1")
    data = folder / "data"
    if not (data / "spot.obj").is_file():
        what = "has no data/spot.obj; expected a clone of github.com/mworchel/differentiable-shadow-mapping"
        raise ConfigError([Mistake(Location(str(folder)), "", what)])
    run: dict[str, Callable[[], dict[str, Outcome]]] = {
        "pose": lambda: {"pose": pose(data, round(200 * scale))},
        "plane": lambda: planes(round(150 * scale)),
        "art": lambda: {"art": art(data, round(400 * scale))},
    }
    found = {key: value for name in names for key, value in run[name]().items()}
    table = Table("", "their loss", "loss", "their steps/s", "steps/s", "", title=str(common.machine()["device"]))
    for name, outcome in found.items():
        loss, rate = PRINTED[name]
        table.add_row(name, f"{loss:.3g}", f"{outcome.loss:.3g}", f"{rate:.0f}", f"{outcome.rate:.1f}", outcome.remark)
    console.print(table)
    return found


class Shadow(eqx.Module):
    """A mesh whose shadow falls on a surface that a camera sees, under one of their lights."""

    mesh: geometry.Mesh
    edges: geometry.Edges
    light: geometry.DirectionalLight
    surface: raster.Surface
    technique: shadow.ShadowMapping
    crossings: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, mesh: geometry.Mesh, way: tuple[float, ...], receiver: geometry.Mesh, camera: Any, box: float
    ) -> "Shadow":
        """Of light along `way`, through a box of this radius in texels."""
        light, edges = light_along(way), geometry.Edges.of(mesh)
        technique = technique_with(box)
        crossings = 4 * shadow.plan_crossings(mesh, light, technique.map.resolution, edges)
        return cls(mesh, edges, light, raster.draw_surface(receiver, camera), technique, crossings)

    def at(self, vertices: Float[Array, "v 3"]) -> Float[Array, "h w"]:
        """Visibility with the mesh's vertices elsewhere."""
        mesh = eqx.tree_at(lambda mesh: mesh.vertices, self.mesh, vertices)
        seen = self.technique.map.draw(mesh, self.light, edges=self.edges, crossings=self.crossings, raises=False)
        return self.technique.visibility(seen, self.surface)


def light_along(way: tuple[float, ...]) -> geometry.DirectionalLight:
    """One of their lights."""
    up = (0.0, 0.0, -1.0) if way[1] else (0.0, 1.0, 0.0)
    return geometry.DirectionalLight(way, np.zeros(3), (2 * HALF, 2 * HALF), 0.1 - DISTANCE, 10 - DISTANCE, 0.0, up)


def technique_with(box: float) -> shadow.ShadowMapping:
    """A map of their size with outlines, and a box of this radius in texels."""
    settings = shadow.MapSettings((TEXELS, TEXELS), silhouettes=True)
    return shadow.ShadowMapping(shadow.PercentageCloser(box), shadow.ConstantBias(0.0), map=settings)


def square(centre: tuple[float, ...], normal: tuple[float, ...], half: float) -> geometry.Mesh:
    """A square of two triangles, with their order of vertices."""
    across, upright = ((1, 0, 0), (0, 1, 0)) if normal[2] else ((1, 0, 0), (0, 0, -1))
    u, v = half * np.array(across, float), half * np.array(upright, float)
    middle = np.array(centre)
    return geometry.Mesh([middle - u - v, middle + u - v, middle - u + v, middle + u + v], [[0, 1, 2], [2, 1, 3]])


def pose(data: Path, steps: int) -> Outcome:
    """The angle of a mesh. Their loss is of the shaded picture, where what is lit is 1/π."""
    spot = io.load_mesh(data / "spot.obj")
    vertices, faces, _ = geometry.weld(np.asarray(spot.vertices, float), np.asarray(spot.faces), 0)
    spot = geometry.Mesh(vertices + np.array([0, 0.77 + 1.5, 0]), faces)
    camera = geometry.OrthographicCamera(
        (-1, 1, -1), (0.2, 0.5, 0.2), height=2, near=0.1, far=10, resolution=(512, 512)
    )
    scene = Shadow.of(spot, (0, -1, 0), square((0, 0, 0), (0, 1, 0), 2), camera, 1.5)

    def image(scene: Shadow, angle: Array) -> Array:
        (angle,) = angle
        turn = jnp.array([[jnp.cos(angle), 0, jnp.sin(angle)], [0, 1, 0], [-jnp.sin(angle), 0, jnp.cos(angle)]])
        seen = scene.at(jnp.matmul(scene.mesh.vertices, turn.T, precision="highest"))
        return jnp.where(scene.surface.mask, seen, 0) / math.pi

    end, outcome = adam(scene, image, np.zeros(1), np.array([math.radians(70)]), 0.03, steps)
    return outcome._replace(remark=f"{math.degrees(float(end[0])):.5f} degrees off, from 70")


def planes(steps: int) -> dict[str, Outcome]:
    """A corner of a square, seen by two cameras."""
    receiver, caster = square((0, 0, -2), (0, 0, 1), 1), square((0, 0, 1), (0, 0, 1), 0.75)
    cameras = {
        "plane": geometry.OrthographicCamera((0, 0, 0), (0, 0, -2), height=2, near=0.1, far=10, resolution=(512, 512)),
        "plane aside": geometry.PinholeCamera(
            (1, 0, 0.75), (0, 0, -2), fov_y=45, near=0.1, far=10, resolution=(512, 512)
        ),
    }

    def image(scene: Shadow, vertex: Array) -> Array:
        return scene.at(scene.mesh.vertices.at[3].set(vertex))

    truth = np.asarray(caster.vertices, float)[3]
    found = {}
    for name, camera in cameras.items():
        scene = Shadow.of(caster, (0, 0, -1), receiver, camera, 1.5)
        end, outcome = adam(scene, image, truth, truth * [0.5, 0.5, 1], 0.005, steps)
        off = np.abs(end - truth)[:2].max()
        found[name] = outcome._replace(remark=f"corner {off:.1e} off, a texel is {2 * HALF / TEXELS:.1e}")
    return found


def adam(
    scene: Shadow,
    image: Callable[[Shadow, Array], Array],
    truth: Float[np.ndarray, " n"],
    start: Float[np.ndarray, " n"],
    rate: float,
    steps: int,
) -> tuple[Float[np.ndarray, " n"], Outcome]:
    """Where Adam (Kingma & Ba 2015) ends that fits numbers to the image of the truth."""

    @eqx.filter_jit
    def value_and_gradient(scene: Shadow, numbers: Array, target: Array) -> Any:
        return jax.value_and_grad(lambda numbers: jnp.mean((image(scene, numbers) - target) ** 2))(numbers)

    target = eqx.filter_jit(image)(scene, jnp.asarray(truth, jnp.float32))
    at = lambda numbers: value_and_gradient(scene, jnp.asarray(numbers, jnp.float32), target)
    jax.block_until_ready(at(start))
    numbers, mean, square, loss, began = start, np.zeros_like(start), np.zeros_like(start), 0.0, time.perf_counter()
    for step in range(1, steps + 1):
        value, gradient = at(numbers)
        loss, gradient = float(value), np.asarray(gradient, float)
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        numbers = numbers - rate * mean / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
    return numbers, Outcome(loss, steps / (time.perf_counter() - began))


def art(data: Path, steps: int) -> Outcome:
    """A sphere whose shadow is a picture."""
    target, border = io.read_visibility(data / "shadow_art_target_bunny.png"), their_border()
    sphere = io.load_mesh(data / "sphere.obj")
    vertices, faces, _ = geometry.weld(np.asarray(sphere.vertices, float), np.asarray(sphere.faces), 0)
    wall = square((0, 0, -2), (0, 0, 1), HALF)
    camera = geometry.OrthographicCamera(
        (0, 0, 0), (0, 0, -2), height=2 * HALF, near=0.1, far=10, resolution=target.shape
    )
    # Of the shadow times the border, less the target: the border goes into the target and the weight.
    view = fit.ShapeView(
        light_along((0, 0, -1)), raster.draw_surface(wall, camera), np.minimum(target / border, 1), border**2
    )
    problem = fit.ShapeProblem(geometry.Mesh(vertices, faces), [view], technique=technique_with(2.5))
    # Their rate is in world units, and ours a fraction of the shadow's longest side.
    rate = 0.2 / fit.shadow_size([view], vertices.mean(axis=0))
    phase = fit.ShapePhase(strength=20, rate=rate, steps=steps, blur=0)
    fit.check_shape(problem, [phase])
    images, began = [], [0.0]

    def keep(step: fit.ShapeStep) -> None:
        # The first step waits for the compiler.
        began[0] = began[0] or time.perf_counter()
        images[:] = step.images

    found = fit.fit_shape(problem, [phase], on_step=keep)
    rate = (len(found.history) - 1) / (time.perf_counter() - began[0])
    square_of = lambda factor: (factor * images[0] - target) ** 2
    whole, within, plain = square_of(border).mean(), square_of(1)[2:-2, 2:-2].mean(), square_of(1).mean()
    return Outcome(float(whole), rate, f"{within:.3g} within the border, {plain:.3g} with a white border")


def their_border() -> Float[np.ndarray, "h w"]:
    """The visibility that their look-up gives a bare wall (`compute_visibility` and `filter_shadow_map`)."""
    x = (np.arange(TEXELS) + 0.5) / TEXELS * 2 * HALF - HALF
    depth = np.sqrt(x[:, None] ** 2 + x**2 + (DISTANCE + 2) ** 2)
    mean, of_squares = (uniform_filter(values, 5, mode="nearest") for values in (depth, depth**2))
    variance = np.maximum(of_squares - mean**2, LEAST_VARIANCE)
    return np.where(depth <= mean, 1, variance / (variance + (depth - mean) ** 2))


if __name__ == "__main__":
    common.start(app)
