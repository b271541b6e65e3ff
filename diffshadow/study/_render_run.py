"""A technique as it stands, drawn and measured."""

from pathlib import Path
from typing import Any

from rich.console import Console

from ..config import Config, build_technique
from . import _record as record
from . import _table as table
from ._progress import Stages
from ._run_folder import folder_of, write_whole
from ._setup import Drawn, draw, load, visibility_of
from ._shade import shade

SUFFIX = "-render"
"""Ends the name of a render's folder, which keeps it apart from the fit's."""


def run_render(config: Config, *, console: Console) -> Path:
    """Draws the scene of `config` with its technique as it stands, prints its errors, and writes the run's folder.

    **Returns** the folder, `<output>/<name>-render`. An earlier one is replaced once all is written, not before.

    **Raises** `ValueError` for a mistake in the configuration, before any long work.
    """
    folder = folder_of(config, SUFFIX)
    with Stages(console) as stages:
        scene, technique = load(config, stages), build_technique(config, fitting=False)
        drawn = draw(config, scene, technique, stages)
        with stages.stage("measuring"):
            visibility = visibility_of(technique, drawn)
            errors = record.measured(visibility, drawn.reference.visibility, drawn.mask)
        with stages.stage("writing"):
            write_whole(folder, lambda draft: _write(draft, folder, config, drawn, visibility, errors, stages.seconds))
    table.print_errors(console, config.name, errors)
    table.print_lines(console, [table.noise_text(drawn.noise_floor)])
    return folder


def _write(
    draft: Path,
    folder: Path,
    config: Config,
    drawn: Drawn,
    visibility: Any,
    errors: dict[str, float],
    seconds: dict[str, float],
) -> None:
    # Here, since only a run that got this far needs Matplotlib.
    from . import _figures as figures

    truth, mask = drawn.reference.visibility, drawn.mask
    record.write_config(draft, config)
    figures.write_visibility(draft / "visibility.png", "Visibility", visibility, mask)
    figures.write_visibility(draft / "reference.png", "Reference", truth, mask)
    figures.write_difference(draft / "difference.png", visibility, truth, mask)
    figures.write_shaded(draft / "shaded.png", [("Shaded", shade(drawn, visibility))])
    figures.write_shadow_map(draft / "shadow_map.png", drawn.shadow_map)
    record.write_arrays(
        draft,
        {"reference": truth, "visibility": visibility, "mask": mask, "shadow_map_depth": drawn.shadow_map.depth},
    )
    record.write_result(
        draft,
        {
            "name": config.name,
            "kind": "render",
            "metrics": {
                "compare": config.compare.type,
                "errors": errors,
                "reference_noise_floor": drawn.noise_floor,
                "pixels": int(mask.sum()),
            },
            "seconds": {name: round(s, 3) for name, s in seconds.items()},
            "versions": record.versions(),
            "seed": config.seed,
            "command": record.command("render", folder),
        },
    )
