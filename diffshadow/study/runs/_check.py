"""Checks of a run that trace few rays."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from ... import fit, io, shadow
from ...config import Config, build_technique
from ...settings.engines import Engine
from ...settings.techniques import Mapped
from ..pages import _table as table
from ..record._folder import folder_of
from ..remarks._bias import bias_remarks
from ..remarks._layout import layout_remarks
from ..remarks._scene import scene_remarks
from ._measure import shade_lit
from ._picture import picture_plan
from ._progress import Progress
from ._render import SUFFIX
from ._setup import SeenScene, check_comparable, load, plan_fit, see
from ._shape import shape_problem

PREVIEW = "-preview.png"
"""What follows the configuration's name in the name of a preview."""
# Visibility below which a pixel counts as shadowed.
_SHADOWED = 0.5


class Checked(NamedTuple):
    """The number of triangles in a checked scene. With a preview, also the path of its picture, and the part of the
    picture's pixels that are in shadow."""

    triangles: int
    preview: Path | None = None
    shadow: float = 0.0


def check(config: Config, *, console: Console, preview: bool = False) -> Checked:
    """Checks `config`: does everything that a render or a fit does before it traces its reference.

    A fit is checked only if the technique can be fitted. Remarks on the scene are printed. Nothing is written, except
    with `preview`: a picture `<output>/<name>-preview.png`, drawn with the technique unfitted.

    **Raises** `ConfigError` for a mistake in the configuration.
    """
    if config.fit.shape is not None:
        return _check_shape(config, console)
    if config.reference.type == "picture":
        return _check_picture(config, console, preview)
    # An engine's numbers are fitted only by name.
    names_engine = any(name.startswith("technique.") for name in config.fit.parameters)
    fits = isinstance(config.technique, Mapped) or (isinstance(config.technique, Engine) and names_engine)
    for suffix in (SUFFIX, "") if fits else (SUFFIX,):
        folder_of(config, suffix)
    with Progress(console) as progress:
        scene, remarks, _ = load(config, progress)
        technique = build_technique(config, fitting=False)
        if fits:
            plan_fit(config, scene)
        seen = see(config, scene, technique, progress)
        # Of several views, some may be dark.
        if fits and config.fit.views is None:
            check_comparable(config, seen, progress)
    of_scene = scene_remarks(config, technique, seen.lit, seen.surface)
    keys = [".".join(map(str, key)) for key in seen.keys]
    of_layout = layout_remarks(technique, keys, seen.states)
    of_bias = bias_remarks(config, technique, keys, seen.lit, seen.states)
    table.print_lines(console, [*remarks, *seen.remarks, *of_scene, *of_layout, *of_bias], warn=True)
    triangles = int(scene.mesh.faces.shape[0])
    return Checked(triangles, *_preview(config, technique, seen)) if preview else Checked(triangles)


def _preview(config: Config, technique: shadow.AbstractTechnique, seen: SeenScene) -> tuple[Path, float]:
    """Writes a picture of the scene. **Returns** its path, and the part of its pixels that are in shadow."""
    visibility = [np.asarray(technique.visibility(state, seen.surface), np.float32) for state in seen.states]
    file = config.output_folder / f"{config.name}{PREVIEW}"
    file.parent.mkdir(parents=True, exist_ok=True)
    io.write_png(file, shade_lit(config, seen.surface, seen.lit, visibility))
    dark = np.all([image < _SHADOWED for image in visibility], axis=0)
    return file, float((dark & np.asarray(seen.surface.mask)).mean())


def _check_picture(config: Config, console: Console, preview: bool) -> Checked:
    """Reads the picture, and makes all that a fit to it needs."""
    folder_of(config)
    with Progress(console) as progress:
        planned = picture_plan(config, progress)
    table.print_lines(console, planned.remarks, warn=True)
    scene = planned.scene
    triangles = int(scene.mesh.faces.shape[0])
    if not preview:
        return Checked(triangles)
    with Progress(console) as progress:
        technique = build_technique(config, fitting=False)
        seen = see(config, scene, technique, progress)
    return Checked(triangles, *_preview(config, technique, seen))


def _check_shape(config: Config, console: Console) -> Checked:
    """Makes all that a fit of a shape needs. It counts the triangles that the fit starts from."""
    folder_of(config)
    with Progress(console) as progress:
        plan, problem, _ = shape_problem(config, progress)
        fit.check_shape(problem, plan.phases)
    table.print_lines(console, plan.remarks, warn=True)
    return Checked(problem.mesh.faces.shape[0])
