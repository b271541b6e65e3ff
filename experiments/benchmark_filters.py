"""Speed of shadow map filters, compared with the same shaders by OpenGL in software (Mesa's llvmpipe).

Both sides draw one scene from one camera under one light, with maps of the same size. They take turns, so that a
machine that slows down affects both. OpenGL draws on all threads; its time is the wall-clock time of the clear, the
draw and `glFinish`. Each comparison includes the same work on both sides:

- `filter`: look-ups into the map only. OpenGL: the draw, minus that of a shader that does everything but look up.
- `visibility`: from the surface to its visibility, with projection and bias. OpenGL: the draw, minus that of a shader
  that writes a constant.
- `whole`: the above and drawing the image. OpenGL: the draw.

Some filters are also timed beside a limit on the same pixels and map: a bare loop over the texels of as many nearest
taps, or a box that reads the same texels.
"""

import argparse
import json
import statistics
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from benchmark_raster import SETTINGS, machine, positive, timed
from jax import lax
from rich.table import Table

from diffshadow import raster, shadow
from diffshadow.console import Console
from diffshadow.geometry import DirectionalLight, Mesh, PinholeCamera

# The shaders that drew the golden shadow factors.
sys.path.append(str(Path(__file__).parent.parent / "tests" / "golden"))
import _opengl  # pyright: ignore[reportMissingImports]
import _techniques  # pyright: ignore[reportMissingImports]

RADIUS = 3.5
"""Of the disk, in texels."""
BIAS = 1.5
"""Constant bias, in texels."""
WIDTH = 0.5
"""Of the soft compare, in texels."""
HARD, SOFT = shadow.HardCompare("less"), shadow.SoftCompare(WIDTH)
COMPARISONS = {"filter": "projection", "visibility": "trivial", "whole": None}
"""The measurements of our side, and the shader whose draw is subtracted from OpenGL's."""


class Case(NamedTuple):
    """A filter with a compare; the corresponding shader, and whether that interpolates the four nearest texels.

    - `bar`: the target for the ratio of `visibility`, or none.
    """

    filter: shadow.AbstractFilter
    compare: shadow.AbstractCompare
    shader: str
    linear: bool = False
    early_out: bool = False
    bar: float | None = None


def cases() -> dict[str, Case]:
    disk = lambda lookup, early_out=False: shadow.RandomDisk(RADIUS, lookup=lookup, early_out=early_out)
    # A box of whole texels around the receiver's texel, as in shaders; and one that moves smoothly.
    grid = 0.5 * np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(25, 1, 1, 2)
    texels = shadow.RandomDisk(2.0, shadow.Pattern(jnp.asarray(grid, float)), lookup="nearest")
    box = shadow.PercentageCloser(2.5)
    return {
        "random disk, nearest, hard": Case(disk("nearest"), HARD, "random_disk", bar=0.7),
        "random disk, nearest, hard, early-out": Case(disk("nearest", True), HARD, "random_disk", early_out=True),
        "random disk, nearest, soft": Case(disk("nearest"), SOFT, "random_disk"),
        "random disk, bilinear, hard": Case(disk("bilinear"), HARD, "random_disk", linear=True),
        "random disk, bilinear, soft": Case(disk("bilinear"), SOFT, "random_disk", linear=True),
        "5 x 5 whole texels, hard": Case(texels, HARD, "box", bar=0.3),
        "5 x 5 sliding, hard": Case(box, HARD, "box", bar=0.3),
        "5 x 5 sliding, soft": Case(box, SOFT, "box"),
        "four taps, hard": Case(shadow.FourTap(), HARD, "four_tap", linear=True),
        "bilinear, hard": Case(shadow.Bilinear(), HARD, "bilinear", linear=True),
        "nearest, hard": Case(shadow.Nearest(), HARD, "nearest"),
    }


BARE_LOOP = "bare loop"
LIMITS = {
    "random disk, nearest, hard": (BARE_LOOP, 1.5),
    "random disk, bilinear, hard": (BARE_LOOP, 3.0),
    "5 x 5 whole texels, hard": ("5 x 5 sliding, hard", 2.0),
}
"""The limit that a case is timed beside, and the target for the ratio of `filter` to it."""

JACOBIANS = ("random disk, nearest, soft", "random disk, bilinear, soft", "5 x 5 sliding, soft")
JACOBIAN_BAR = 4.0


class Ours(eqx.Module):
    """The compiled functions of a case, on a surface and a map that are already drawn."""

    mesh: Mesh
    camera: PinholeCamera
    shadow_map: shadow.ShadowMap
    surface: raster.Surface

    @classmethod
    def draw(cls, pixels: int, texels: int) -> "Ours":
        mesh = Mesh(*_techniques.scene())
        camera = PinholeCamera(
            (1.6, 3.4, 2.6), (0.0, 0.0, 0.3), fov_y=40.0, near=0.5, far=12.0, resolution=(pixels,) * 2
        )
        light = DirectionalLight((0.5, -1.0, -0.3), (0.0, 0.3, 0.2), (6.0, 6.0), -3.5, 3.5)
        shadow_map = shadow.draw_shadow_map(mesh, light, (texels, texels))
        return cls(mesh, camera, shadow_map, raster.draw_surface(mesh, camera))

    def lookup(self) -> shadow.Lookup:
        at = shadow.receiver(self.shadow_map, self.surface)
        return shadow.look_up(self.shadow_map, at, shadow.Bias(BIAS)(at))

    def measures(self, case: Case) -> dict[str, Callable[[], Any]]:
        """The measured functions, by the names of `COMPARISONS`."""
        technique = shadow.ShadowMapping(case.filter, shadow.Bias(BIAS), case.compare)
        lookup = self.lookup()

        @eqx.filter_jit
        def look(filter, compare, shadow_map, lookup):
            return filter(shadow_map, lookup, compare)

        @eqx.filter_jit
        def visibility(technique, shadow_map, surface):
            return technique.visibility(shadow_map, surface)

        def whole():
            surface = raster.draw_surface(self.mesh, self.camera)
            return visibility(technique, self.shadow_map, surface)

        return {
            "filter": lambda: look(case.filter, case.compare, self.shadow_map, lookup),
            "visibility": lambda: visibility(technique, self.shadow_map, self.surface),
            "whole": whole,
        }

    def bare_loop(self, filter: shadow.RandomDisk) -> Callable[[], jax.Array]:
        """The hard compares of a random disk's nearest taps, by a loop that is given the index of each tap's texel.

        All that is left is to read a depth, compare it and add, which no filter with as many taps can do without.
        """
        lookup, offsets = self.lookup(), np.asarray(filter.pattern.offsets)
        (height, width), tile = lookup.depth.shape, offsets.shape[1]
        tiles = 1, -(-height // tile), -(-width // tile), 1
        offset = np.tile(offsets, tiles)[:, :height, :width]
        texel = np.floor(np.asarray(lookup.texel) + np.asarray(filter.radius) * offset)
        # The map gets a border of empty texels. Those further out are moved there.
        rows, columns = self.shadow_map.resolution
        column, row = np.moveaxis(np.clip(texel, -1, (columns, rows)).astype(np.uint32) + 1, -1, 0)
        stored = jnp.pad(self.shadow_map.depth, 1, constant_values=2.0).reshape(-1)
        indices = jnp.asarray(row * (columns + 2) + column)

        @jax.jit
        def run(stored, indices, depth):
            def add(total, index):
                element = lax.GatherDimensionNumbers((), (0,), (0,))
                read = lax.gather(stored, index[..., None], element, (1,), mode="promise_in_bounds")
                return total + (depth < read), None

            return lax.scan(add, jnp.zeros_like(depth), indices)[0] / len(indices)

        return lambda: run(stored, indices, lookup.depth)

    def jacobian(self, case: Case) -> dict[str, Callable[[], Any]]:
        """Visibility, and visibility with its forward-mode Jacobian, by constant bias, slope bias and radius."""

        def of(values, shadow_map, surface):
            filter = eqx.tree_at(lambda f: f.radius, case.filter, values[2])
            technique = shadow.ShadowMapping(filter, shadow.Bias(values[0], values[1]), case.compare)
            return technique.visibility(shadow_map, surface)

        @eqx.filter_jit
        def pushed(values, shadow_map, surface):
            value, push = jax.linearize(lambda values: of(values, shadow_map, surface), values)
            return value, jax.vmap(push, out_axes=-1)(jnp.eye(3))

        primal, values = eqx.filter_jit(of), jnp.array([BIAS, 0.2, case.filter.radius])
        return {
            "primal": lambda: primal(values, self.shadow_map, self.surface),
            "jacobian": lambda: pushed(values, self.shadow_map, self.surface),
        }


class OpenGL:
    """The same scene, camera, light and map, drawn on all threads.

    **Raises** moderngl's errors if there is no EGL, `ImportError` without moderngl, and `RuntimeError` if the driver is
    not llvmpipe.
    """

    def __init__(self, ours: Ours):
        # The golden images use one thread and narrow instructions, which are for reproducible bits and not for speed.
        with patch.dict(_opengl.SETTINGS, SETTINGS, clear=True):
            self.gl = gl = _opengl.OpenGL()
        self.name = f"{gl.renderer}, {gl.version}"
        vertices, faces = np.asarray(ours.mesh.vertices), np.asarray(ours.mesh.faces)
        camera, view = (_view(of.view()) for of in (ours.camera, ours.shadow_map.light))
        resolution = ours.shadow_map.resolution
        self.light = _techniques.Light(view, (*-np.asarray(ours.shadow_map.light.direction), 0.0))
        self.painter = _techniques.Painter(gl, vertices, faces, camera, ours.camera.resolution, channels=(1,))
        self.map = gl.depth_texture(view.clip(vertices), faces, resolution, 32, _opengl.State())
        self.settings = {"texel_depth": view.texel_depth(resolution), "map": 0, "offsets": 1, "radius": RADIUS}
        self.settings |= {"constant_bias": BIAS, "slope_bias": 0.0, "least_bias": 0.0}

    def prepare(self, case: Case) -> None:
        if case.shader == "random_disk" and isinstance(case.filter, shadow.RandomDisk):
            _techniques.offset_texture(self.gl, np.asarray(case.filter.pattern.offsets))
        _techniques.bind_map(self.gl, self.map, case.linear, "<")
        for shader in (case.shader, "projection", "trivial"):
            self.painter.set(shader, self.light, self.settings | {"early_out": case.early_out})

    def draws(self, case: Case) -> dict[str, Callable[[], None]]:
        """The case's draw as `shader`, and the draws that are subtracted from it by their own names."""
        named = {"projection": "projection", "trivial": "trivial", "shader": case.shader}
        return {name: partial(self.painter.render, shader) for name, shader in named.items()}

    def visibility(self, case: Case) -> np.ndarray:
        """The image by the case's shader, (h, w); 1 where there is no surface."""
        self.painter.render(case.shader)
        return self.painter.read() / _techniques.TAPS[case.shader]


def _view(view: Any) -> Any:
    arrays = (np.asarray(x, np.float32) for x in (view.world_to_eye, view.eye_to_clip))
    return _techniques.View(*arrays, float(view.near), float(view.far))


def open_opengl(ours: Ours) -> tuple[OpenGL | None, str]:
    """OpenGL with our scene, or why there is none."""
    try:
        opengl = OpenGL(ours)
    except Exception as error:  # moderngl and its loader raise bare Exception
        return None, f"{type(error).__name__}: {error}"
    return opengl, opengl.name


def interleaved(works: dict[str, Callable[[], Any]], repeats: int) -> dict[str, list[float]]:
    """Milliseconds of each function, called in turn `repeats` times, without the first call of each."""
    for work in works.values():
        timed(work)
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            times[name].append(timed(work)[0])
    return times


def compare(ours: Ours, opengl: OpenGL | None, case: Case, repeats: int) -> dict[str, Any]:
    """Medians of both sides in milliseconds, and their ratios."""
    works = ours.measures(case)
    if opengl is not None:
        opengl.prepare(case)
        works |= opengl.draws(case)
    times = interleaved(works, repeats)
    row: dict[str, Any] = {"ours": {name: statistics.median(times[name]) for name in COMPARISONS}, "bar": case.bar}
    if opengl is not None:
        row["opengl"] = {
            name: statistics.median(np.subtract(times["shader"], times[less] if less else 0))
            for name, less in COMPARISONS.items()
        }
        row["ratio"] = {name: row["ours"][name] / row["opengl"][name] for name in COMPARISONS}
        row["agreement"] = agreement(ours, np.asarray(works["visibility"]()), opengl.visibility(case))
    return row


def agreement(ours: Ours, visibility: np.ndarray, drawn: np.ndarray) -> float:
    """The fraction of pixels facing the light whose visibility is the same on both sides."""
    facing = np.asarray(ours.surface.mask & (shadow.receiver(ours.shadow_map, ours.surface).cosine > 0))
    return float(np.mean(np.abs(visibility - drawn)[facing] <= 1e-4))


def compare_jacobian(ours: Ours, case: Case, repeats: int) -> dict[str, float]:
    times = {name: statistics.median(t) for name, t in interleaved(ours.jacobian(case), repeats).items()}
    return times | {"ratio": times["jacobian"] / times["primal"], "bar": JACOBIAN_BAR}


def compare_limit(ours: Ours, case: Case, limit: str, bar: float, repeats: int) -> dict[str, Any]:
    """Medians of the look-ups of a case and of its limit in milliseconds, and their ratio."""
    at_least = ours.bare_loop(case.filter) if limit == BARE_LOOP else ours.measures(cases()[limit])["filter"]
    times = interleaved({"filter": ours.measures(case)["filter"], "limit": at_least}, repeats)
    row = {name: statistics.median(each) for name, each in times.items()}
    return row | {"ratio": row["filter"] / row["limit"], "beside": limit, "bar": bar}


def case_table(rows: dict[str, dict[str, Any]]) -> Table:
    table = Table(title="Milliseconds, median: ours / OpenGL = ratio")
    for title in ("case", *COMPARISONS, "bar", "same pixels"):
        table.add_column(title, justify="left" if title == "case" else "right")
    for name, row in rows.items():
        cells = [f"{row['ours'][of]:.2f}" for of in COMPARISONS]
        if "opengl" in row:
            more = zip(row["opengl"].values(), row["ratio"].values(), strict=True)
            cells = [f"{cell} / {theirs:.2f} = {ratio:.2f}" for cell, (theirs, ratio) in zip(cells, more, strict=True)]
        same = f"{row['agreement']:.2%}" if "agreement" in row else "-"
        table.add_row(name, *cells, "-" if row["bar"] is None else f"{row['bar']}", same)
    return table


def limit_table(rows: dict[str, dict[str, Any]]) -> Table:
    table = Table(title="Look-ups beside a limit, milliseconds, median")
    for title in ("case", "filter", "limit", "", "ratio", "bar"):
        table.add_column(title, justify="left" if title in ("case", "") else "right")
    for name, row in rows.items():
        cells = f"{row['filter']:.2f}", f"{row['limit']:.2f}", row["beside"], f"{row['ratio']:.2f}", f"{row['bar']}"
        table.add_row(name, *cells)
    return table


def jacobian_table(rows: dict[str, dict[str, float]]) -> Table:
    table = Table(title="Forward-mode Jacobian of constant bias, slope bias and radius, milliseconds, median")
    for title in ("case", "visibility", "with Jacobian", "ratio", "bar"):
        table.add_column(title, justify="left" if title == "case" else "right")
    for name, row in rows.items():
        cells = f"{row['primal']:.2f}", f"{row['jacobian']:.2f}", f"{row['ratio']:.2f}", f"{row['bar']}"
        table.add_row(name, *cells)
    return table


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--pixels", type=positive, default=512, help="of the image along a side")
    parser.add_argument("--texels", type=positive, default=1024, help="of the map along a side")
    parser.add_argument("--repeats", type=positive, default=15)
    parser.add_argument("--only", default="", help="only cases whose name contains this")
    parser.add_argument("--json", type=Path, help="file to write all numbers to")
    parser.add_argument("--no-opengl", dest="opengl", action="store_false", help="time our side only")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    options = arguments(argv)
    console = Console()
    about = machine()
    console.print(", ".join(f"{name} {value}" for name, value in about.items()))
    ours = Ours.draw(options.pixels, options.texels)
    opengl, name = open_opengl(ours) if options.opengl else (None, "left out")
    device, seen = jax.devices()[0], float(jnp.mean(ours.surface.mask))
    console.print(f"ours: {device.platform}: {device.device_kind}; OpenGL: {name}; {seen:.1%} of the image is covered")
    chosen = {key: case for key, case in cases().items() if options.only in key}
    rows, limits, jacobians = {}, {}, {}
    for key, case in chosen.items():
        with console.status(key):
            rows[key] = compare(ours, opengl, case, options.repeats)
    for key, limit in LIMITS.items():
        if key in chosen:
            with console.status(f"limit: {key}"):
                limits[key] = compare_limit(ours, chosen[key], *limit, options.repeats)
    for key in JACOBIANS:
        if key in chosen:
            with console.status(f"Jacobian: {key}"):
                jacobians[key] = compare_jacobian(ours, chosen[key], options.repeats)
    console.print(case_table(rows), limit_table(limits), jacobian_table(jacobians))
    if options.json:
        report = {"machine": about, "opengl": name, "covered": seen, "cases": rows, "limits": limits}
        report |= {"jacobians": jacobians, "pixels": options.pixels, "texels": options.texels}
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
