"""Derivatives of shadows here and in other renderers: error over time.

    python experiments/benchmark_peers.py output/peers

A caster hangs over a floor, and the camera sees the floor only. The number is a weighted mean of its light under
a small lamp. Its derivatives are with respect to the lamp's position and the caster's translation. The truth is central
differences of ray-traced pictures of 8 x 8 points a pixel, with the same random numbers on both sides.

- diffshadow: a map with silhouettes. A lamp with a radius is the mean over 16 points on its disk.
- Mitsuba 3 (`direct_projective`, variant `llvm_ad_rgb`): where `mitsuba` is installed. Its lamp is a sphere. Since the
  camera sees no outline, all samples of boundaries go to the shadow's.
- jaxrenderer: where it is installed. It has suns only, so its row is the caster's translation under a sun.

Renderers that are not installed are left out, and named. Errors are the root mean square over seeds of the norm of a
derivative's error, relative to the truth's norm; times are medians in seconds, after compilation. Writes a table
(`peers.csv`) and a picture (`peers.png`).
"""

import argparse
import csv
import importlib
import importlib.util
import resource
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from rich.table import Table

from diffshadow import geometry, io, raster, reference, shadow
from diffshadow.console import Console

EYE, TARGET, FOV = np.array([0.0, 0.9, 1.7]), np.array([0.0, 0.0, 0.2]), 50.0
"""The camera's pose in world units and its vertical field of view in degrees. It lies below every caster."""
LAMP, AIM = np.array([-0.9, 3.6, 0.8]), np.array([0.9, -3.6, -0.8])
"""The lamp's position, and where our spot light points."""
FLOOR = 40.0
"""Width of the floor, which fills the picture."""
LOWEST = 1.1
"""Height of the casters' lowest point above the floor."""
SUN = np.array([0.3, -1.0, -0.25])
"""The direction of the sun's light in the case that all renderers have."""


class Scene(NamedTuple):
    """What all renderers draw: a caster over the floor y = 0, and the side of the picture in pixels."""

    caster: geometry.Mesh
    pixels: int

    @property
    def weights(self) -> Float[np.ndarray, "h w"]:
        """The weight of each pixel, from the bottom row."""
        at = (np.arange(self.pixels) + 0.5) / self.pixels
        return 0.5 + 0.5 * np.cos(8.2 * at + 0.4)[None, :] * np.cos(6.9 * at)[:, None]


class Row(NamedTuple):
    """What one renderer reaches with one setting: the relative error of both derivatives, and seconds a gradient."""

    renderer: str
    setting: str
    by_lamp: float
    by_caster: float
    wall: float
    cpu: float


def main() -> None:
    """Measures, prints and draws."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument(
        "--casters", nargs="+", default=["torus_knot", "sphere", "fence"], help="library names or files"
    )
    parser.add_argument("--radii", nargs="+", type=float, default=[0.02, 0.1], help="radii of the lamp, world units")
    parser.add_argument("--pixels", type=int, default=256, help="side of the picture")
    parser.add_argument("--spp", nargs="+", type=int, default=[4, 16, 64, 256], help="Mitsuba's samples per pixel")
    parser.add_argument("--seeds", type=int, default=5, help="seeds of each setting that draws random numbers")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    console = Console()
    console.print(common.machine())
    renderers = [diffshadow, *installed(console)]
    tables: dict[tuple[str, float], list[Row]] = {}
    for name in options.casters:
        scene = Scene(caster(name), options.pixels)
        for radius in (*options.radii, 0.0):
            exact, doubt = truth(scene, radius)
            rows = [
                row(radius, exact, setting, options.seeds)
                for renderer in renderers
                for setting in renderer(scene, radius, options.spp)
            ]
            tables[name, radius] = rows
            show(console, name, radius, exact, doubt, rows)
    write(options.out / "peers.csv", tables)
    draw(options.out / "peers.png", tables)
    console.print(f"wrote {options.out / 'peers.csv'} and {options.out / 'peers.png'}")


def caster(name: str) -> geometry.Mesh:
    """A caster of a size of 1 whose lowest point is at the height `LOWEST`."""
    mesh = io.load_mesh(name) if Path(name).suffix else geometry.library_mesh(name)
    mesh = geometry.drop_to_ground(geometry.fit_to_size(mesh, 1.0))
    return geometry.Mesh(mesh.vertices + jnp.array([0.0, LOWEST, 0.0]), mesh.faces)


# The truth.


def floor_points(pixels: int, inside: int) -> Float[np.ndarray, "n 3"]:
    """The points of the floor in the middle of `inside` x `inside` parts of each pixel, along rows from the bottom."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up, half = np.cross(right, forward), np.tan(np.radians(FOV) / 2)
    at = half * (2 * (np.arange(pixels * inside) + 0.5) / (pixels * inside) - 1)
    rays = forward + at[None, :, None] * right + at[:, None, None] * up
    return (EYE - rays * (EYE[1] / rays[..., 1:2])).reshape(-1, 3)


def light_of(points: Any, lamp: Any) -> Any:
    """The floor's light under a small lamp of intensity 1: cosine over the square of the distance, per square unit."""
    to = lamp - points
    return to[..., 1] / (to**2).sum(-1) ** 1.5


def truth(scene: Scene, radius: float, inside: int = 8) -> tuple[Float[np.ndarray, "6"], float]:
    """Derivatives by the lamp's position and the caster's translation, and how far two steps' differences disagree.

    A radius of 0 stands for the sun: its first three derivatives are 0, since nobody's are compared.
    """
    points, random = floor_points(scene.pixels, inside), np.random.default_rng(0)
    weights = np.repeat(np.repeat(scene.weights, inside, 0), inside, 1).ravel()
    disk = radius * np.sqrt(random.random(len(points))) * np.exp(2j * np.pi * random.random(len(points)))

    def number(lamp: np.ndarray, move: np.ndarray) -> float:
        moved = geometry.Mesh(scene.caster.vertices + move, scene.caster.faces)
        if radius == 0:
            towards, light = np.broadcast_to(-SUN, points.shape), 1.0
        else:
            axis = points - lamp
            axis /= np.linalg.norm(axis, axis=1, keepdims=True)
            side = np.cross(axis, [0.0, 0.0, 1.0])
            side /= np.linalg.norm(side, axis=1, keepdims=True)
            on_lamp = lamp + disk.real[:, None] * side + disk.imag[:, None] * np.cross(axis, side)
            towards, light = on_lamp - points, light_of(points, lamp)
        reach = np.inf if radius == 0 else 1.0
        return float(np.mean(weights * light * ~reference.occluded(moved, points, towards, reach)))

    def differences(step: float) -> np.ndarray:
        columns = []
        for axis in range(0 if radius else 3, 6):
            by = step * np.eye(6)[axis]
            ends = [number(LAMP + sign * by[:3], sign * by[3:]) for sign in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        return np.concatenate([np.zeros(6 - len(columns)), columns])

    fine, coarse = differences(0.01), differences(0.02)
    return fine, float(np.linalg.norm(fine - coarse) / np.linalg.norm(fine))


class Setting(NamedTuple):
    """A renderer with one setting, and the derivatives it finds with a seed."""

    renderer: str
    name: str
    gradient: Callable[[int], Float[np.ndarray, "6"]]


# Renderers: each is a function that yields its settings.


def diffshadow(scene: Scene, radius: float, _: Sequence[int]) -> Iterator[Setting]:
    """This toolkit: maps of several sizes, and several points in a pixel."""
    size = (scene.pixels, scene.pixels)
    camera = geometry.PinholeCamera(tuple(EYE), tuple(TARGET), fov_y=FOV, near=0.1, far=40.0, resolution=size)
    floor, caster = geometry.library_mesh("plane", size=FLOOR), scene.caster
    alone = raster.draw_surface(floor, camera)
    weights, lamps = jnp.asarray(scene.weights), disk_of_lamps(radius)
    for texels, inside in ((256, 1), (256, 5), (512, 13)):
        map_ = shadow.MapSettings((texels, texels), silhouettes=True)
        technique = shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(constant=4.0), map=map_)
        points = raster.points_within_pixels(alone, camera, inside)
        around = jnp.concatenate([caster.vertices, floor.vertices * (2 / FLOOR)])
        if radius == 0:
            light = geometry.DirectionalLight.around(tuple(SUN), around)
        else:
            light = geometry.SpotLight(tuple(LAMP), tuple(AIM), outer_angle=20.0, near=0.5, far=8.0)
        whole = geometry.Scene([caster, floor], camera, light)
        plan = technique.plan(whole)

        def number(by, vertices, at, plan=plan, points=points, technique=technique, light=light):
            moved = eqx.tree_at(lambda light: light.position, light, at + by[:3]) if radius else light
            mesh = geometry.Mesh(vertices + by[3:], caster.faces)
            scene = geometry.Scene([mesh, floor], camera, moved)
            visibility = technique.visibility(technique.prepare(scene, plan=plan), points.surface)
            shaded = light_of(points.surface.position, LAMP + by[:3]) if radius else 1.0
            return jnp.mean(weights * points.mean(visibility * shaded))

        over = lambda by, vertices, at, number=number: jnp.mean(jax.lax.map(lambda x: number(by, vertices, x), at))
        step = eqx.filter_jit(jax.grad(over))
        gradient = lambda _, step=step: np.asarray(step(jnp.zeros(6), caster.vertices, lamps))
        yield Setting("diffshadow", f"map {texels}, {inside} points", gradient)


def disk_of_lamps(radius: float) -> Float[Array, "k 3"]:
    """Points that stand for a lamp: its middle if it is small, or 16 on its disk across the direction to the floor."""
    if radius <= 0.02:
        return jnp.asarray(LAMP[None])
    axis = AIM / np.linalg.norm(AIM)
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    number = np.arange(16)
    spiral = radius * np.sqrt((number + 0.5) / 16) * np.exp(1j * np.pi * (3 - np.sqrt(5)) * number)
    return jnp.asarray(LAMP + spiral.real[:, None] * side + spiral.imag[:, None] * np.cross(axis, side))


def mitsuba(scene: Scene, radius: float, spp: Sequence[int]) -> Iterator[Setting]:
    """Mitsuba 3: samples per pixel, with and without a guide to the shadow's outline."""
    if radius == 0:
        return
    dr, mi = (importlib.import_module(name) for name in ("drjit", "mitsuba"))
    mi.set_variant("llvm_ad_rgb")
    at, to = mi.ScalarTransform4f(), np.asarray(scene.caster.vertices)
    mesh = mi.Mesh("caster", len(to), len(scene.caster.faces), props=black(mi))
    fill = mi.traverse(mesh)
    fill["vertex_positions"] = np.asarray(to, np.float32).ravel()
    fill["faces"] = np.asarray(scene.caster.faces, np.uint32).ravel()
    fill.update()
    film = {"type": "hdrfilm", "width": scene.pixels, "height": scene.pixels, "rfilter": {"type": "box"}}
    world = mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": FOV,
                "fov_axis": "y",
                "near_clip": 0.01,
                "to_world": at.look_at(origin=EYE.tolist(), target=TARGET.tolist(), up=[0, 1, 0]),
                "film": film | {"pixel_format": "luminance", "component_format": "float32"},
            },
            "floor": {
                "type": "rectangle",
                "to_world": at.rotate([1, 0, 0], -90).scale(FLOOR / 2),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
            },
            "caster": mesh,
            "lamp": {
                "type": "sphere",
                "to_world": at.translate(LAMP.tolist()).scale(radius),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1 / radius**2}},
            },
        }
    )
    params = mi.traverse(world)
    vertices, pose = mi.Point3f(np.asarray(to, np.float32).T), mi.Transform4f(params["lamp.to_world"])
    weights = mi.TensorXf(np.ascontiguousarray(scene.weights[::-1, :, None], np.float32))

    def gradient(seed: int, samples: int, integrator: Any) -> np.ndarray:
        lamp, move = mi.Vector3f(0.0), mi.Vector3f(0.0)
        dr.enable_grad(lamp, move)
        params["caster.vertex_positions"] = dr.ravel(vertices + move)
        params["lamp.to_world"] = mi.Transform4f().translate(lamp) @ pose
        params.update()
        image = mi.render(world, params, integrator=integrator, spp=samples, seed=seed, seed_grad=seed + 1000)
        dr.backward(dr.mean(image * weights))
        return np.concatenate([np.asarray(dr.grad(lamp)).ravel(), np.asarray(dr.grad(move)).ravel()])

    for guiding in ("none", "grid"):
        for samples in spp:
            counts = {"sppc": samples, "sppp": 0, "sppi": samples}
            integrator = mi.load_dict({"type": "direct_projective", "guiding": guiding, **counts})
            name = f"{samples} spp" + (f", {guiding}" if guiding != "none" else "")
            yield Setting("Mitsuba", name, partial(gradient, samples=samples, integrator=integrator))


def jaxrenderer(scene: Scene, radius: float, _: Sequence[int]) -> Iterator[Setting]:
    """jaxrenderer: the same picture's mean under a sun. Its map is as large as the picture."""
    if radius:
        return
    renderer = importlib.import_module("renderer")
    floor, pixels = geometry.library_mesh("plane", size=FLOOR), scene.pixels
    weights = jnp.asarray(scene.weights).T[..., None]

    def model(vertices: Any, faces: Any) -> Any:
        normals, uvs = jnp.zeros_like(vertices).at[:, 1].set(1.0), jnp.zeros((len(vertices), 2))
        parts = renderer.Model.create(vertices, normals, uvs, faces, jnp.ones((1, 1, 3)))
        return renderer.ModelObject(model=parts)

    camera = renderer.CameraParameters(
        pixels, pixels, 1.0, 0.1, 40.0, FOV, FOV, jnp.asarray(EYE), jnp.asarray(TARGET), jnp.array([0.0, 1.0, 0.0])
    )
    white, none = jnp.ones(3), jnp.zeros(3)
    sun = renderer.LightParameters(-jnp.asarray(SUN), white, none, white, none)
    shadows = renderer.ShadowParameters(none, jnp.array([0.0, 1.0, 0.0]), white)

    def number(move: Any) -> Any:
        objects = [model(scene.caster.vertices + move, scene.caster.faces), model(floor.vertices, floor.faces)]
        image = renderer.Renderer.get_camera_image(objects, sun, camera, pixels, pixels, shadow_param=shadows)
        return jnp.mean(image * weights)

    step = jax.jit(jax.jacfwd(number))
    gradient = lambda _: np.concatenate([np.zeros(3), np.asarray(step(none))])
    yield Setting("jaxrenderer", "its only shadow", gradient)


def black(mi: Any) -> Any:
    """The properties of a mesh that reflects nothing."""
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}})
    return props


def installed(console: Console) -> list[Any]:
    """The other renderers that are at hand."""
    found = []
    for module, renderer in (("mitsuba", mitsuba), ("renderer", jaxrenderer)):
        if importlib.util.find_spec(module) is None:
            console.print(f"left out: {renderer.__name__}, which is not installed")
        else:
            found.append(renderer)
    return found


# Figures.


def row(radius: float, exact: np.ndarray, setting: Setting, seeds: int) -> Row:
    """Runs a setting once to compile it, then with `seeds` seeds."""
    setting.gradient(0)
    errors, walls, cpus = [], [], []
    for seed in range(1, 1 + seeds):
        wall, cpu = time.perf_counter(), cpu_seconds()
        found = setting.gradient(seed)
        walls.append(time.perf_counter() - wall)
        cpus.append(cpu_seconds() - cpu)
        errors.append(found - exact)
    relative = lambda part: float(
        np.sqrt(np.mean([np.sum(error[part] ** 2) for error in errors]) / max(np.sum(exact[part] ** 2), 1e-30))
    )
    by_lamp = relative(slice(0, 3)) if radius else float("nan")
    return Row(
        setting.renderer,
        setting.name,
        by_lamp,
        relative(slice(3, 6)),
        statistics.median(walls),
        statistics.median(cpus),
    )


def cpu_seconds() -> float:
    """The processor's seconds of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def show(console: Console, name: str, radius: float, exact: np.ndarray, doubt: float, rows: Sequence[Row]) -> None:
    """Prints the table of a scene."""
    lamp = f"a lamp of radius {radius:g}" if radius else "a sun"
    table = Table("renderer", "setting", "error by lamp", "by caster", "s", "CPU-s", title=f"{name} under {lamp}")
    for row in rows:
        table.add_row(
            row.renderer,
            row.setting,
            f"{row.by_lamp:.1%}",
            f"{row.by_caster:.1%}",
            f"{row.wall:.3f}",
            f"{row.cpu:.3f}",
        )
    console.print(table)
    console.print(f"truth {np.array2string(exact, precision=4)}; its two steps differ by {doubt:.1%}")


def write(path: Path, tables: dict[tuple[str, float], list[Row]]) -> None:
    """Writes all rows as CSV."""
    with path.open("w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(["caster", "radius", *Row._fields])
        for (name, radius), rows in tables.items():
            lines.writerows([name, radius, *row] for row in rows)


def draw(path: Path, tables: dict[tuple[str, float], list[Row]]) -> None:
    """Draws the error by the caster's translation over the processor's time, a panel for each scene."""
    casters, radii = (list(dict.fromkeys(key[i] for key in tables)) for i in (0, 1))
    plot, axes = common.figure(3.4 * len(radii), 2.8 * len(casters), len(casters), len(radii), sharex=True, sharey=True)
    for (name, radius), rows in tables.items():
        panel = axes[casters.index(name) * len(radii) + radii.index(radius)]
        for renderer in dict.fromkeys(row.renderer for row in rows):
            points = [(row.cpu, row.by_caster) for row in rows if row.renderer == renderer]
            panel.loglog(*zip(*points, strict=True), "o", label=renderer)
        panel.set_title(f"{Path(name).stem}, " + (f"lamp of radius {radius:g}" if radius else "sun"))
        panel.set_xlabel("CPU-seconds a gradient")
        panel.set_ylabel("relative error")
        panel.legend()
    plot.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
