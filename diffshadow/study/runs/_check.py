"""Checks of a run that trace few rays."""

from rich.console import Console

from ... import fit
from ...config import Config, build_fit, build_technique
from ...settings.engines import Engine
from ...settings.techniques import Mapped
from ..files._run_folder import folder_of
from ..pages import _table as table
from ..remarks._scene import scene_remarks
from ._progress import Stages
from ._render import SUFFIX
from ._setup import check_comparable, load, see
from ._shape import shape_problem


def check(config: Config, *, console: Console) -> int:
    """Checks `config`: does everything that a render or a fit does before it traces its reference.

    A fit is checked only if the technique can be fitted. Remarks on the scene are printed. Nothing is written.

    **Returns** the number of triangles in the scene.

    **Raises** `ConfigError` for a mistake in the configuration.
    """
    if config.fit.shape is not None:
        return _check_shape(config, console)
    # An engine's numbers are fitted only by name.
    names_engine = any(name.startswith("technique.") for name in config.fit.parameters)
    fits = isinstance(config.technique, Mapped) or (isinstance(config.technique, Engine) and names_engine)
    for suffix in (SUFFIX, "") if fits else (SUFFIX,):
        folder_of(config, suffix)
    with Stages(console) as stages:
        scene, remarks = load(config, stages)
        technique = build_technique(config, fitting=False)
        if fits:
            build_fit(config, scene)
        seen = see(config, scene, technique, stages)
        # Of several views, some may be dark.
        if fits and config.fit.views is None:
            check_comparable(config, seen, stages)
    of_scene = scene_remarks(config, technique, seen.lit, seen.surface)
    table.print_lines(console, [*remarks, *seen.remarks, *of_scene], warn=True)
    return scene.mesh.faces.shape[0]


def _check_shape(config: Config, console: Console) -> int:
    """Makes all that a fit of a shape needs. **Returns** the number of triangles that it starts from."""
    folder_of(config)
    with Stages(console) as stages:
        plan, problem, _ = shape_problem(config, stages)
        fit.check_shape(problem, plan.phases)
    return plan.start.faces.shape[0]
