"""Checks of a run that need no ray."""

from rich.console import Console

from ..config import Config, build_fit, build_technique
from ._progress import Stages
from ._render_run import SUFFIX
from ._run_folder import folder_of
from ._setup import load, see


def check(config: Config, *, console: Console) -> int:
    """Does all that a render or a fit of `config` begins with, up to tracing rays, for its errors.

    A fit is checked where the technique has one. Nothing is written.

    **Returns** the number of triangles of the scene.

    **Raises** `ConfigError` for a mistake in the configuration.
    """
    fits = config.technique.type == "shadow_map"
    for suffix in (SUFFIX, "") if fits else (SUFFIX,):
        folder_of(config, suffix)
    with Stages(console) as stages:
        casting = load(config, stages)
        technique = build_technique(config, fitting=False)
        if fits:
            build_fit(config, casting)
        see(config, casting, technique, stages)
    return casting.scene.mesh.faces.shape[0]
