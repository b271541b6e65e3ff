"""Speed of the rasterizer and its gradients, compared with OpenGL: in software (Mesa's llvmpipe), or on JAX's GPU.

Each case, a number of triangles and of texels, runs in a separate process, so that its peak memory can be measured.
Both sides draw the same clip-space triangles with back faces culled. Everything takes turns, so that a machine that
slows down affects all alike, and ratios are medians over the turns. OpenGL draws from vertices and indices already
uploaded, on all threads; its time is the wall-clock time of the clear, the draw and `glFinish`, since llvmpipe's timer
queries do not include its threads. Its surface pass writes what ours does, depth, face, position and normal, to float
targets.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from _child import rows_of_child
from _opengl_passes import SETTINGS as SETTINGS
from _opengl_passes import OpenGL, Triangles
from rich.table import Table

from diffshadow import raster, setup, shadow
from diffshadow.geometry import (
    DirectionalLight,
    MatrixLight,
    Mesh,
    PinholeCamera,
    library_mesh,
    merge,
    rotation,
    scaling,
    translation,
)

# At import, since benchmarks make arrays when they are imported.
setup(programs=False)

CULL = "back"
LIGHT_DIRECTION = (0.1, -1.0, 0.5)
"""Nearly along a side of the ground, so that the ground fills most of the map."""
CASCADES = shadow.Cascades(4, shadow_distance=12.0)
CAMERA = PinholeCamera((0, 1.5, 4), (0, 0, 0), near=0.1, far=20.0)
"""Sees the whole ground."""
GROUND_SIZE = 6.0
"""World units; the objects on it are about one unit each."""
AGREEMENT = 1e-4
"""Texels of OpenGL's map and ours count as the same if their window depths differ by no more than this."""

MEASURES = {
    "opengl_depth": "OpenGL depth",
    "opengl_surface": "OpenGL surface",
    "depth": "depth",
    "rasterize": "depth, face",
    "attributes": "depth, position, normal of faces",
    "surface": "surface",
    "forward": "value + forward gradient",
    "reverse": "value + reverse gradient",
    "cascades": "four cascades",
    "maps": "four maps",
}
"""What is timed, and its name in the table. The surface has face, depth, position and normal. The four maps show what
the cascades do, and each is drawn on its own."""


class Comparison(NamedTuple):
    """The ratio of two measurements, or without `peer` nanoseconds per texel; `limits` at some sizes, if not at all."""

    title: str
    measure: str
    peer: str | None
    limits: dict[int, float] | float

    def limit(self, size: int) -> float | None:
        return self.limits.get(size) if isinstance(self.limits, dict) else self.limits


COMPARISONS = {
    "depth": Comparison("depth / OpenGL's", "depth", "opengl_depth", {1024: 1.0, 2048: 1.2}),
    "face": Comparison("depth and face / depth", "rasterize", "depth", {2048: 1.5}),
    "surface": Comparison("surface / OpenGL's", "surface", "opengl_surface", {512: 1.2, 1024: 1.5, 2048: 2.0}),
    "interpolation": Comparison("interpolation, ns per texel", "attributes", None, 35.0),
    "forward": Comparison("forward / depth", "forward", "depth", {1024: 8.0}),
    "reverse": Comparison("reverse / depth", "reverse", "depth", {1024: 12.0, 2048: 12.0}),
    "cascades": Comparison("cascades / four maps", "cascades", "maps", {1024: 1.1, 2048: 1.05}),
}
GROWTH_LIMIT = 1.05
"""Of slopes of time over triangles or texels, in logarithms: 1 is linear."""


def scene(triangles: int, seed: int) -> Mesh:
    """A ground plane with seven objects on it, with about `triangles` triangles in total.

    The ground has a tenth of them. Spheres and blobs come in powers of four; torus knots make up the rest.
    """
    rng = np.random.default_rng(seed)
    segments = max(1, round((triangles / 20) ** 0.5))
    left = triangles - 2 * segments**2
    subdivisions = max(0, int(np.log(max(left, 160) / 8 / 20) / np.log(4)))
    pieces = [("sphere", {"subdivisions": subdivisions})] * 2
    pieces += [("blob", {"subdivisions": subdivisions, "seed": seed + k}) for k in range(2)]
    left -= 4 * 20 * 4**subdivisions
    # The length of a knot's tube is about twelve times its circumference.
    sides = max(3, round((left / 3 / 24) ** 0.5))
    pieces += [("torus_knot", {"segments": max(3, round(left / 3 / 2 / sides)), "sides": sides})] * 3
    cells = rng.permutation(9)[: len(pieces)]
    meshes = [library_mesh("plane", size=GROUND_SIZE, segments=segments)]
    for (name, options), cell in zip(pieces, cells, strict=True):
        where = (np.array([cell // 3, 0, cell % 3]) - [1, 0, 1]) * 1.7 + rng.uniform(-0.2, 0.2, 3) * [1, 0, 1]
        size = translation(jnp.asarray(where)) @ rotation(jnp.array([0.0, 1.0, 0.0]), rng.uniform(0, 2 * np.pi))
        meshes.append(library_mesh(name, **options).transformed(size @ scaling(rng.uniform(0.8, 1.3))))
    return merge(meshes)


class Case:
    """The timed functions, which take no arguments."""

    def __init__(self, mesh: Mesh, resolution: tuple[int, int]):
        self.mesh, self.resolution = mesh, resolution
        light = DirectionalLight.around(jnp.array(LIGHT_DIRECTION), mesh.vertices)
        view = light.view()
        cascaded = CASCADES.light(light, CAMERA, resolution)
        of_cascades = cascaded.view()
        alone = [MatrixLight(of_cascades.world_to_eye, eye_to_clip) for eye_to_clip in of_cascades.eye_to_clip]
        self.clip = jax.block_until_ready(jax.jit(lambda vertices: view.clip(vertices))(mesh.vertices))
        # What is drawn is needed to set up the rest, so the first call is timed here.
        draw_time, self.fragments = timed(lambda: raster.rasterize(self.clip, mesh.faces, resolution, cull=CULL))

        def interpolated(face, clip, vertices, faces, corners):
            def band(face, rows):
                at = raster.barycentrics(face, clip, faces, rows)
                depth = raster.interpolate_depth(at, clip, faces)
                return depth, raster.interpolate(at, vertices, faces), raster.interpolate_corners(at, corners)

            return raster.by_bands(band, face)

        @jax.jit
        def surface(clip, vertices, faces, corners):
            fragments = raster.rasterize(clip, faces, resolution, cull=CULL)
            _, position, normal = interpolated(fragments.face, clip, vertices, faces, corners)
            return fragments, position, normal

        def loss(vertices, faces):
            clip = view.clip(vertices)
            face = raster.rasterize(clip, faces, resolution, cull=CULL).face
            return jnp.sum(raster.visible_depth(face, clip, faces) ** 2)

        @jax.jit
        def forward(vertices, faces, offset):
            """The loss and its derivative as the mesh moves."""
            return jax.jvp(lambda offset: loss(vertices + offset, faces), (jnp.zeros_like(offset),), (offset,))

        attributes, reverse, offset = (
            jax.jit(interpolated),
            jax.jit(jax.value_and_grad(loss)),
            jnp.array([0.1, 0.2, 0.3]),
        )
        given = self.clip, mesh.vertices, mesh.faces, mesh.corner_normals
        self.measures: dict[str, Callable[[], Any]] = {
            "depth": lambda: raster.rasterize_depth(self.clip, mesh.faces, resolution, cull=CULL),
            "rasterize": lambda: raster.rasterize(self.clip, mesh.faces, resolution, cull=CULL),
            "attributes": lambda: attributes(self.fragments.face, *given),
            "surface": lambda: surface(*given),
            "forward": lambda: forward(mesh.vertices, mesh.faces, offset),
            "reverse": lambda: reverse(mesh.vertices, mesh.faces),
            "cascades": lambda: shadow.draw_shadow_map(mesh, cascaded, resolution),
            "maps": lambda: [shadow.draw_shadow_map(mesh, light, resolution) for light in alone],
        }
        self.first_call = {"rasterize": draw_time}
        for name, work in self.measures.items():
            if name not in self.first_call:
                self.first_call[name], _ = timed(work)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Milliseconds until the result is ready, and the result."""
    start = time.perf_counter()
    result = jax.block_until_ready(work())
    return 1e3 * (time.perf_counter() - start), result


def peak_memory() -> float:
    """This process's peak memory so far, in MiB."""
    # Linux counts kilobytes, macOS bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def open_opengl(case: Case) -> tuple[OpenGL | None, str]:
    """OpenGL with the case's triangles, or why there is none."""
    try:
        mesh = case.mesh
        arrays = map(np.asarray, (case.clip, mesh.vertices, mesh.faces, mesh.corner_normals))
        opengl = OpenGL(Triangles(*arrays), case.resolution, CULL, on_gpu=jax.default_backend() != "cpu")
    except Exception as error:  # moderngl and its loader raise bare Exception
        return None, f"{type(error).__name__}: {error}"
    return opengl, opengl.name


def measure(triangles: int, size: int, repeats: int, seed: int, with_opengl: bool) -> dict[str, Any]:
    """Times one case in this process; times are in milliseconds, memory in MiB."""
    mesh = scene(triangles, seed)
    jax.block_until_ready(mesh)
    loaded = peak_memory()
    case = Case(mesh, (size, size))
    device = jax.devices()[0]
    row: dict[str, Any] = {
        "asked": triangles,
        "triangles": mesh.faces.shape[0],
        "size": size,
        "seen": float(jnp.mean(case.fragments.face >= 0)),
        "memory": {"loaded": loaded, "peak": peak_memory()},
        "first_call": case.first_call,
        "device": f"{device.platform}: {device.device_kind}",
        "dtype": str(case.clip.dtype),
    }
    if device.platform != "cpu":
        row["memory"]["device_peak"] = (device.memory_stats() or {}).get("peak_bytes_in_use", 0) / 2**20

    opengl, row["opengl"] = open_opengl(case) if with_opengl else (None, "left out")
    work = dict(case.measures)
    if opengl is not None:
        opengl.draw_depth()
        row["agreement"] = float(np.mean(np.abs(opengl.depth() - np.asarray(case.fragments.depth)) <= AGREEMENT))
        work |= {"opengl_depth": opengl.draw_depth, "opengl_surface": opengl.draw_surface}
    times = in_turns(work, repeats)
    row["measures"] = {name: {"median": statistics.median(each), "least": min(each)} for name, each in times.items()}
    row["comparisons"] = compared(times, size)
    return row


def in_turns(work: dict[str, Callable[[], Any]], repeats: int) -> dict[str, list[float]]:
    """Milliseconds of each, called in turn."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for turn in range(repeats + 1):
        for name, call in work.items():
            taken, _ = timed(call)
            if turn:  # The first warms up.
                times[name].append(taken)
    return times


def compared(times: dict[str, list[float]], size: int) -> dict[str, dict[str, float | None]]:
    """Each comparison's value and limit, where both of its sides were timed."""
    found = {}
    for name, (_, measure, peer, _) in COMPARISONS.items():
        if peer is None:
            value = statistics.median(times[measure]) * 1e6 / size**2
        elif peer in times:
            value = statistics.median(ours / theirs for ours, theirs in zip(times[measure], times[peer], strict=True))
        else:
            continue
        found[name] = {"value": value, "limit": COMPARISONS[name].limit(size)}
    return found


def machine() -> dict[str, Any]:
    """What the times depend on, besides the code."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        cpu = models[0] if models else cpu
    versions = {name: version(name) for name in ("diffshadow", "jax", "jaxlib", "numpy")}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"cpu": cpu, "cores": cores, "python": platform.python_version(), **versions}


def in_child(triangles: int, size: int, options: argparse.Namespace) -> dict[str, Any]:
    """Runs `measure` in a separate process."""
    case = f"the case of {triangles} triangles at {size} x {size}"
    command = ["--triangles", str(triangles), "--sizes", str(size), "--repeats", str(options.repeats)]
    command += ["--seed", str(options.seed)] + ["--no-opengl"] * (not options.opengl)
    return rows_of_child(__file__, case, *command)[-1]


def comparison_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Each comparison's median and, in brackets, its limit."""
    table = Table(title="Ratios, median (limit)")
    for title in ("triangles", "texels", *(comparison.title for comparison in COMPARISONS.values())):
        table.add_column(title, justify="right")
    for row in rows:
        cells = []
        for name in COMPARISONS:
            found = row["comparisons"].get(name, {"value": None, "limit": None})
            limit = "" if found["limit"] is None else f" ({found['limit']:g})"
            cells.append("-" if found["value"] is None else f"{found['value']:.2f}{limit}")
        table.add_row(f"{row['triangles']:,}", f"{row['size']}²", *cells)
    return table


def time_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Medians in milliseconds."""
    table = Table(title="Milliseconds, median")
    for title in ("triangles", "texels", *MEASURES.values()):
        table.add_column(title, justify="right")
    for row in rows:
        measures = row["measures"]
        cells = [f"{measures[name]['median']:.2f}" if name in measures else "-" for name in MEASURES]
        table.add_row(f"{row['triangles']:,}", f"{row['size']}²", *cells)
    return table


def growth(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """How each measurement grows over triangles and over texels: the slope of a line through its logarithms.

    The greatest of the slopes at all sizes or numbers of triangles; none where there is only one to compare.
    """
    found: dict[str, dict[str, float]] = {}
    for over, along, fixed in (
        ("triangles", lambda r: r["triangles"], "size"),
        ("texels", lambda r: r["size"] ** 2, "asked"),
    ):
        for name in MEASURES:
            slopes = []
            for key in {row[fixed] for row in rows}:
                line = [
                    (along(r), r["measures"][name]["median"]) for r in rows if r[fixed] == key and name in r["measures"]
                ]
                if len(line) > 1:
                    slopes.append(float(np.polyfit(*np.log(np.array(line)).T, deg=1)[0]))
            if slopes:
                found.setdefault(over, {})[name] = max(slopes)
    return found


def growth_table(found: dict[str, dict[str, float]]) -> Table:
    table = Table(title=f"Growth: greatest slope of log time over log count (limit {GROWTH_LIMIT})")
    for title in ("over", *MEASURES.values()):
        table.add_column(title, justify="right")
    for over, slopes in found.items():
        table.add_row(over, *(f"{slopes[name]:.2f}" if name in slopes else "-" for name in MEASURES))
    return table


def cost_table(rows: Sequence[dict[str, Any]]) -> Table:
    """First calls, memory, and the fraction of texels that are the same on both sides."""
    table = Table(title="First call (compilation and one run), seconds; peak memory, MiB")
    names = [name for name in MEASURES if any(name in row["first_call"] for row in rows)]
    for title in ("triangles", "texels", *(MEASURES[name] for name in names), "scene", "peak", "same texels"):
        table.add_column(title, justify="right")
    for row in rows:
        times = [f"{row['first_call'][name] / 1e3:.2f}" if name in row["first_call"] else "-" for name in names]
        memory = [f"{row['memory']['loaded']:.0f}", f"{row['memory']['peak']:.0f}"]
        same = f"{row['agreement']:.3%}" if "agreement" in row else "-"
        table.add_row(f"{row['triangles']:,}", f"{row['size']}²", *times, *memory, same)
    return table


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--triangles", type=positive, nargs="+", default=[1000, 10_000, 100_000, 1_000_000])
    parser.add_argument(
        "--sizes", type=positive, nargs="+", default=[256, 512, 1024, 2048, 4096], help="texels along a side"
    )
    parser.add_argument("--repeats", type=positive, default=9)
    parser.add_argument("--seed", type=int, default=0, help="of the scene")
    parser.add_argument("--json", type=Path, help="file to write all numbers to")
    parser.add_argument("--no-opengl", dest="opengl", action="store_false", help="time our side only")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args(argv)


def positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is not positive; expected 1 or more")
    return number


def main(argv: Sequence[str] | None = None) -> None:
    options = arguments(argv)
    if options.child:
        row = measure(options.triangles[0], options.sizes[0], options.repeats, options.seed, options.opengl)
        print(json.dumps(row))
        return
    # Here, so that the processes that are measured do without.
    from diffshadow.console import Console

    console = Console()
    about = machine()
    console.print(", ".join(f"{name} {value}" for name, value in about.items()))
    rows = []
    for triangles in options.triangles:
        for size in options.sizes:
            with console.status(f"{triangles:,} triangles at {size} x {size}"):
                rows.append(in_child(triangles, size, options))
            if len(rows) == 1:
                console.print(f"ours: {rows[0]['device']}, {rows[0]['dtype']}; OpenGL: {rows[0]['opengl']}")
                if options.opengl and "agreement" not in rows[0]:
                    console.print("OpenGL is not available: timing our side only.")
    grown = growth(rows)
    console.print(comparison_table(rows), time_table(rows), cost_table(rows))
    if grown:
        console.print(growth_table(grown))
    if options.json:
        report = {"machine": about, "cull": CULL, "growth": grown, "rows": rows}
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
