"""Speed of the rasterizer drawing a light's depth map, compared with OpenGL in software (Mesa's llvmpipe).

Each case, a number of triangles and of texels, runs in a separate process, so that its peak memory can be measured.
Both sides draw the same clip-space triangles with back faces culled. They take turns, so that a machine that slows down
affects both. OpenGL draws only depth, from vertices and indices already uploaded, on all threads; its time is the
wall-clock time of the clear, the draw and `glFinish`, since llvmpipe's timer queries do not include its threads.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from diffshadow import raster, use_all_cores
from diffshadow.geometry import DirectionalLight, Mesh, library_mesh, merge, rotation, scaling, translation

# At import, since benchmarks make arrays when they are imported.
use_all_cores()

CULL = "back"
LIGHT_DIRECTION = (0.1, -1.0, 0.5)
"""Nearly along a side of the ground, so that the ground fills most of the map."""
GROUND_SIZE = 6.0
"""World units; the objects on it are about one unit each."""
AGREEMENT = 1e-4
"""Texels of OpenGL's map and ours count as the same if their window depths differ by no more than this."""

# The measurements of our side, and their names in the table.
MEASURES = {
    "plan": "count pass",
    "depth": "depth only",
    "rasterize": "depth + index",
    "rasterize_counting": "count, then draw",
    "attributes": "depth, position, normal",
    "gradient": "value + gradient",
}
SETTINGS = {
    "EGL_PLATFORM": "surfaceless",
    "LIBGL_ALWAYS_SOFTWARE": "1",
    "GALLIUM_DRIVER": "llvmpipe",
}
VERTEX_SHADER = """
#version 330
in vec4 position;
void main() { gl_Position = position; }
"""
FRAGMENT_SHADER = """
#version 330
void main() {}
"""


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
        view = DirectionalLight.around(jnp.array(LIGHT_DIRECTION), mesh.vertices).view()
        self.clip = jax.block_until_ready(jax.jit(lambda vertices: view.clip(vertices))(mesh.vertices))
        # Counting and drawing are needed to set up the rest, so their first calls are timed here.
        plan_time, self.capacity = timed(lambda: raster.plan(self.clip, mesh.faces, resolution, cull=CULL))
        draw = {"cull": CULL, "capacity": self.capacity}
        draw_time, self.fragments = timed(lambda: raster.rasterize(self.clip, mesh.faces, resolution, **draw))
        corners = mesh.corner_normals

        @jax.jit
        def attributes(face, clip, vertices, faces, corners):
            at = raster.barycentrics(face, clip, faces)
            depth = raster.interpolate_depth(at, clip, faces)
            normal = raster.interpolate_corners(at, corners)
            return depth, raster.interpolate(at, vertices, faces), normal

        @jax.jit
        @jax.value_and_grad
        def gradient(vertices, faces):
            clip = view.clip(vertices)
            face = raster.rasterize(clip, faces, resolution, cull=CULL, capacity=self.capacity).face
            return jnp.sum(raster.interpolate_depth(raster.barycentrics(face, clip, faces), clip, faces))

        self.measures: dict[str, Callable[[], Any]] = {
            "plan": lambda: raster.plan(self.clip, mesh.faces, resolution, cull=CULL),
            "rasterize": lambda: raster.rasterize(self.clip, mesh.faces, resolution, **draw),
            "rasterize_counting": lambda: raster.rasterize(self.clip, mesh.faces, resolution, cull=CULL),
            "attributes": lambda: attributes(self.fragments.face, self.clip, mesh.vertices, mesh.faces, corners),
            "gradient": lambda: gradient(mesh.vertices, mesh.faces),
        }
        depth_only = getattr(raster, "rasterize_depth", None)
        if depth_only is not None:
            self.measures["depth"] = lambda: depth_only(self.clip, mesh.faces, resolution, **draw)
        self.first_call = {"plan": plan_time, "rasterize": draw_time}
        for name, work in self.measures.items():
            # Counting and then drawing compiles nothing new.
            if name not in (*self.first_call, "rasterize_counting"):
                self.first_call[name], _ = timed(work)


class OpenGL:
    """A depth pass in software, with its triangles already uploaded.

    **Raises** moderngl's errors if there is no EGL, `ImportError` without moderngl, and `RuntimeError` if the driver is
    not llvmpipe.
    """

    def __init__(self, clip: np.ndarray, faces: np.ndarray, resolution: tuple[int, int]):
        os.environ.update(SETTINGS)
        import moderngl  # optional; it reads the environment when it is first used

        height, width = resolution
        # The stub's type of `backend` is wrong.
        self.context = gl = moderngl.create_context(
            standalone=True,
            backend="egl",  # pyright: ignore[reportArgumentType]
            require=330,
        )
        self.name = f"{gl.info['GL_RENDERER']}, {gl.info['GL_VERSION']}"
        if "llvmpipe" not in self.name:
            raise RuntimeError(f"OpenGL is {self.name}; expected Mesa's llvmpipe: install libgl1-mesa-dri")
        program = gl.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
        vertices = gl.buffer(np.ascontiguousarray(clip, np.float32).tobytes())
        indices = gl.buffer(np.ascontiguousarray(faces, np.int32).tobytes())
        self.triangles = gl.vertex_array(program, [(vertices, "4f", "position")], index_buffer=indices)
        self.target = gl.framebuffer([], gl.depth_renderbuffer((width, height)))
        self.resolution, self.mode = resolution, gl.TRIANGLES
        self.target.use()
        gl.enable_only(gl.DEPTH_TEST | gl.CULL_FACE)
        gl.front_face, gl.cull_face, gl.depth_func = "ccw", CULL, "<"

    def draw(self) -> None:
        self.target.clear(depth=1.0)
        self.triangles.render(self.mode)
        self.context.finish()

    def depth(self) -> np.ndarray:
        """The map last drawn, (h, w), row 0 at the bottom."""
        return np.frombuffer(self.target.read(components=1, attachment=-1, dtype="f4"), "f4").reshape(self.resolution)


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
        opengl = OpenGL(np.asarray(case.clip), np.asarray(case.mesh.faces), case.resolution)
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
        "triangles": mesh.faces.shape[0],
        "size": size,
        "capacity": case.capacity._asdict(),
        "seen": float(jnp.mean(case.fragments.face >= 0)),
        "memory": {"loaded": loaded, "peak": peak_memory()},
        "first_call": case.first_call,
        "device": f"{device.platform}: {device.device_kind}",
        "dtype": str(case.clip.dtype),
    }
    if device.platform != "cpu":
        row["memory"]["device_peak"] = (device.memory_stats() or {}).get("peak_bytes_in_use", 0) / 2**20

    opengl, row["opengl"] = open_opengl(case) if with_opengl else (None, "left out")
    if opengl is not None:
        opengl.draw()
        row["agreement"] = float(np.mean(np.abs(opengl.depth() - np.asarray(case.fragments.depth)) <= AGREEMENT))
        opengl.draw()
    row["measures"] = {name: alternate(work, opengl, repeats) for name, work in case.measures.items()}
    return row


def alternate(work: Callable[[], Any], opengl: OpenGL | None, repeats: int) -> dict[str, float]:
    """Medians of our time and of OpenGL's, called in turn, and their ratio."""
    ours, theirs = [], []
    timed(work)
    for _ in range(repeats):
        ours.append(timed(work)[0])
        if opengl is not None:
            theirs.append(timed(opengl.draw)[0])
    result = {"median": statistics.median(ours), "least": min(ours)}
    if theirs:
        result |= {"opengl": statistics.median(theirs), "ratio": statistics.median(ours) / statistics.median(theirs)}
    return result


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
    """Runs `measure` in a separate process.

    **Raises** `RuntimeError` with the end of the child's error output if it fails.
    """
    command = [sys.executable, __file__, "--child", "--triangles", str(triangles), "--sizes", str(size)]
    command += ["--repeats", str(options.repeats), "--seed", str(options.seed)]
    child = subprocess.run(command + ["--no-opengl"] * (not options.opengl), capture_output=True, text=True)
    if child.returncode:
        raise RuntimeError(
            f"the case of {triangles} triangles at {size} x {size} ended with exit code {child.returncode} "
            f"(-9 means that memory ran out):\n{child.stderr[-2000:]}"
        )
    return json.loads(child.stdout.splitlines()[-1])


def time_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Medians in milliseconds, in brackets the ratio to OpenGL's depth pass."""
    table = Table(title="Milliseconds, median (times OpenGL's depth pass)")
    for title in ("triangles", "texels", "OpenGL depth", *MEASURES.values(), "index / depth"):
        table.add_column(title, justify="right")
    for row in rows:
        measures = row["measures"]
        theirs = [m["opengl"] for m in measures.values() if "opengl" in m]
        cells = [f"{row['triangles']:,}", f"{row['size']}²", f"{statistics.median(theirs):.2f}" if theirs else "-"]
        for name in MEASURES:
            found = measures.get(name)
            ratio = f" ({found['ratio']:.2f})" if found and "ratio" in found else ""
            cells.append(f"{found['median']:.2f}{ratio}" if found else "-")
        both = "depth" in measures
        cells.append(f"{measures['rasterize']['median'] / measures['depth']['median']:.2f}" if both else "-")
        table.add_row(*cells)
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
    parser.add_argument("--sizes", type=positive, nargs="+", default=[512, 1024, 2048], help="texels along a side")
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
    console = Console(width=None if sys.stdout.isatty() else 200)
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
    console.print(time_table(rows), cost_table(rows))
    if options.json:
        options.json.write_text(json.dumps({"machine": about, "cull": CULL, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
