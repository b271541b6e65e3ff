"""How close does a shape come that is fitted to its shadows, over the number of suns and the images' resolution?

    python experiments/shapes.py configs/shape_from_shadows.yaml
    python experiments/shapes.py configs/shape_from_shadows.yaml scene.meshes.0.path=spot.obj --suns 3,12 --sizes 128

Fits the shape of the configuration to its traced shadows: under several numbers of suns, and under the suns of the
configuration with images of several sizes. Each fit runs with large steps, and again without: the same phases with
strength 0, where every vertex follows its own gradient, by shorter steps (`--plain-rate`; of 0.3, 0.1 and 0.03, the
first is best). Beside them stands the
visual hull, the largest shape with these shadows: the intersection of the prisms that the targets' outlines cut out of
space. No shape that casts the targets reaches beyond it. Fits start within a coarse one, so a fit that is closer owes
this to what it prefers: smooth shapes.

The suns are spread by the golden angle, at elevations from 30 to 70 degrees. Every result is measured by its Chamfer
distance from the truth, as a fraction of the longest side, and by the overlap of its shadows with the truth's (the
intersection over union, by rays) under the suns of `fit.shape.unseen`, which no fit has seen.

The figure has the distance and the overlap over the number of suns and over the size, and below them the truth and the
three results of the last fit.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import contourpy
import manifold3d
import numpy as np
from cyclopts import App
from jaxtyping import Float
from rich.table import Table

from diffshadow import fit, geometry, metrics, raster, study
from diffshadow.config import Config, Screen, ShapePlan, load_config
from diffshadow.console import Console

NAME = "shapes"
LARGE, PLAIN, HULL = "large steps", "plain steps", "visual hull"
GOLDEN_ANGLE, GOLDEN_RATIO = 137.50776, 0.6180340
LOWEST, HIGHEST = 30.0, 70.0
"""Elevations of the suns, in degrees."""
PICTURE = 300
"""Pixels along a side of a picture of a shape, each the mean of four rays."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


class Case(NamedTuple):
    """The shadows that a shape is found from."""

    plan: ShapePlan
    problem: fit.ShapeProblem
    targets: list[np.ndarray]


@app.default
def main(
    config: Path,
    /,
    *overrides: str,
    suns: str = "2,3,4,6,8,12,18",
    sizes: str = "32,64,128,256",
    plain_rate: float = 0.3,
) -> dict[str, Any]:
    """Fits the shape of CONFIG under several numbers of suns, and with images of several sizes.

    Parameters
    ----------
    config
        YAML file with the fit of a shape from traced shadows, and with unseen lights.
    overrides
        KEY=VALUE pairs that replace values of the file.
    suns
        Numbers of suns, separated by commas.
    sizes
        Sides of the images in pixels, separated by commas.
    plain_rate
        Length of steps without large steps, as a fraction of the rates of the phases.
    """
    console = Console()
    counts, sides = (sorted(set(common.listed(name, given, int))) for name, given in (("suns", suns), ("sizes", sizes)))
    common.expect("suns", suns, counts[0] > 0, "one or more, each positive")
    common.expect("sizes", sizes, sides[0] > 0, "one or more, each positive")
    common.expect("plain-rate", str(plain_rate), 0 < plain_rate <= 1, "above 0 and at most 1")
    settings = common.load(config, overrides, shape=True)
    check(settings)
    usual = len(settings.scene.each_light), settings.fit.shape.resolution[0]  # type: ignore[union-attr]
    cases = dict.fromkeys([(count, usual[1]) for count in counts] + [(usual[0], side) for side in sides])
    rows: list[dict[str, Any]] = []
    found: dict[str, geometry.Mesh] = {}
    truth: Any = None
    for count, side in common.progress(cases, "fitting", console):
        replaced = f"scene.lights={spread(count)}", f"fit.shape.resolution=[{side}, {side}]"
        case = Case(*study.shape_problem(load_config(config, [*overrides, *replaced], fitting=True)))
        found, truth = shapes_of(case, plain_rate), case.plan.truth
        rows += [{"suns": count, "resolution": side, "method": name, **measured(case, found[name])} for name in found]
    show(console, rows)
    summary = {"config": str(config), "overrides": list(overrides), "plain_rate": plain_rate}
    folder = common.write(settings, NAME, picture(rows, usual, truth, found), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def check(settings: Config) -> None:
    """**Raises** `ConfigError` unless the shape is fitted to its own shadows, and measured under unseen lights."""
    shape = settings.fit.shape
    assert shape is not None
    if shape.images or shape.targets:
        what = "has images or targets; expected a shape that is fitted to its own shadows: remove them"
        raise common.mistake(settings, "fit.shape", what)
    if not shape.unseen:
        what = "is missing; expected lights to measure the shape under: add some, as 'unseen: [{elevation: 40}]'"
        raise common.mistake(settings, "fit.shape.unseen", what)


def spread(count: int) -> str:
    """The section of so many suns, as YAML."""
    sun = lambda i: (
        f"{{azimuth: {(i * GOLDEN_ANGLE) % 360:.2f}, "
        f"elevation: {LOWEST + (HIGHEST - LOWEST) * ((i * GOLDEN_RATIO) % 1):.2f}}}"
    )
    return f"[{', '.join(map(sun, range(count)))}]"


def shapes_of(case: Case, plain_rate: float) -> dict[str, geometry.Mesh]:
    """The shape that each method finds."""
    plain = [dataclasses.replace(phase, strength=0.0, rate=phase.rate * plain_rate) for phase in case.plan.phases]
    return {
        LARGE: fit.fit_shape(case.problem, case.plan.phases).mesh,
        PLAIN: fit.fit_shape(case.problem, plain).mesh,
        HULL: visual_hull(case),
    }


def measured(case: Case, mesh: geometry.Mesh) -> dict[str, float]:
    """How close a shape is to the truth."""
    plan, truth = case.plan, case.plan.truth
    assert truth is not None
    triangles = lambda mesh: (np.asarray(mesh.vertices), np.asarray(mesh.faces))
    size = float(np.ptp(np.asarray(truth.bounds), axis=0).max())
    overlap = lambda screen, target: metrics.intersection_over_union(study.shadow_on(screen, mesh), target)
    return {
        "chamfer": metrics.chamfer_distance(triangles(mesh), triangles(truth)) / size,
        "seen": float(np.mean([overlap(*each) for each in zip(plan.seen, case.targets, strict=True)])),
        "unseen": float(np.mean([overlap(screen, study.shadow_on(screen, truth)) for screen in plan.unseen])),
    }


def visual_hull(case: Case) -> geometry.Mesh:
    """The largest shape that casts the targets: the intersection of a prism for each (Laurentini 1994)."""
    prisms = [
        prism(screen, np.asarray(view.surface.position, np.float64), target)
        for screen, view, target in zip(case.plan.seen, case.problem.views, case.targets, strict=True)
    ]
    hull = manifold3d.Manifold.batch_boolean(prisms, manifold3d.OpType.Intersect).to_mesh()
    return geometry.Mesh(np.asarray(hull.vert_properties)[:, :3], np.asarray(hull.tri_verts))


def prism(
    screen: Screen, position: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w"]
) -> manifold3d.Manifold:
    """All that lies before the shadow on a screen, as the sun sees it. `position`: of the screen's pixels."""
    way = np.asarray(screen.light.direction, np.float64)  # type: ignore[attr-defined]
    way = way / np.linalg.norm(way)
    across = np.cross(way, np.eye(3)[np.abs(way).argmin()])
    across = across / np.linalg.norm(across)
    frame = np.stack([across, np.cross(way, across), way], axis=1)
    origin, column, row = position[0, 0], position[0, 1] - position[0, 0], position[1, 0] - position[0, 0]
    # Lit pixels round the image close outlines that reach its border.
    lines: Any = contourpy.contour_generator(z=np.pad(target, 1, constant_values=1.0)).lines(0.5)
    on_screen = [origin + (line[:, :1] - 1) * column + (line[:, 1:] - 1) * row for line in lines]
    outline = [(points @ frame)[:, :2] for points in on_screen]
    area = manifold3d.CrossSection(outline, manifold3d.FillRule.EvenOdd)
    depth = float((origin - position[-1, -1]) @ (origin - position[-1, -1])) ** 0.5 * 4
    place: Any = frame @ np.array([0, 0, origin @ way - depth])
    matrix: Any = np.column_stack([frame, place])
    return area.extrude(2 * depth).transform(matrix)


def show(console: Console, rows: Sequence[dict[str, Any]]) -> None:
    """Prints a row for each case, with Chamfer distance and unseen overlap of each method."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    table = Table("suns", "pixels", *methods, title="Chamfer distance [%], unseen overlap", title_justify="left")
    for key in dict.fromkeys((row["suns"], row["resolution"]) for row in rows):
        own = [row for row in rows if (row["suns"], row["resolution"]) == key]
        table.add_row(*map(str, key), *(f"{100 * row['chamfer']:.2f}  {row['unseen']:.3f}" for row in own))
    console.print(table)


def picture(
    rows: Sequence[dict[str, Any]],
    usual: tuple[int, int],
    truth: geometry.Mesh,
    found: dict[str, geometry.Mesh],
) -> Any:
    """The figure."""
    made, axes = common.figure(9.6, 6.6, 2, 4, height_ratios=(1, 0.9))
    curves = [
        ("suns", "resolution", usual[1], "number of suns"),
        ("resolution", "suns", usual[0], "image's side [pixels]"),
    ]
    for number, (along, fixed, value, label) in enumerate(curves):
        of_case = [row for row in rows if row[fixed] == value]
        for place, key, factor, title in ((0, "chamfer", 100, "Chamfer [% of size]"), (1, "unseen", 1, "unseen IoU")):
            chart = axes[2 * number + place]
            for i, name in enumerate(found):
                own = [row for row in of_case if row["method"] == name]
                chart.plot(
                    [row[along] for row in own], [factor * row[key] for row in own], label=name, **common.curve(i)
                )
            ticks = sorted({row[along] for row in of_case})
            chart.set_xscale("log", base=2)
            chart.set_xticks(ticks, [str(tick) for tick in ticks])
            chart.minorticks_off()
            common.chart(chart, title, label, "")
            if key == "chamfer":
                chart.set_ylim(bottom=0)
    common.legend(axes[0])
    last = rows[-1]
    shown = {"truth": truth, **found}
    for chart, (name, mesh) in zip(axes[4:], shown.items(), strict=True):
        common.style.picture(chart, shaded(mesh, truth))
        title = name if name == "truth" else f"{name}, {last['suns']} suns, {last['resolution']}²"
        common.style.title(chart, title)
    return made


def shaded(mesh: geometry.Mesh, around: geometry.Mesh) -> Float[np.ndarray, "h w 3"]:
    """A picture of a shape, from where it shows all `around`."""
    low, high = np.asarray(around.bounds, np.float64)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    eye = middle + 3 * radius * np.array([0.55, 0.35, 0.76])
    camera = geometry.OrthographicCamera(
        eye, middle, height=1.9 * radius, near=radius, far=5 * radius, resolution=(2 * PICTURE, 2 * PICTURE)
    )
    seen = raster.draw_surface(mesh, camera)
    towards = np.array([0.35, 0.75, 0.55]) / np.linalg.norm([0.35, 0.75, 0.55])
    lambert = np.clip(np.asarray(seen.normal) @ towards, 0, 1)[..., None]
    image = np.where(np.asarray(seen.mask)[..., None], np.array([0.86, 0.62, 0.38]) * (0.25 + 0.75 * lambert), 0.97)
    return image.reshape(PICTURE, 2, PICTURE, 2, 3).mean(axis=(1, 3))


if __name__ == "__main__":
    common.start(app)
