"""Runs a render: draws a technique without fitting it, and measures its errors."""

from pathlib import Path
from typing import Any, NamedTuple

from jaxtyping import Float32
from rich.console import Console

from ... import shadow
from ..._types import HostArray
from ...config import Config, build_technique
from .._drawn import Drawn
from ..files._run_folder import folder_of, write_whole
from ..files._stored import stored, to_bytes
from ..pages import _table as table
from ..remarks._layout import layout_remarks
from ..remarks._reference import reference_remarks
from ..remarks._scene import scene_remarks
from . import _record as record
from ._progress import Stages
from ._setup import draw, load, visibility_of
from ._shade import Pictures, perceptual_error, shade

SUFFIX = "-render"
"""Suffix of a render's folder, which distinguishes it from the fit's."""


class Rendered(NamedTuple):
    """A finished render: the scene as drawn, and visibility and errors for each light."""

    config: Config
    technique: shadow.AbstractTechnique
    drawn: list[Drawn]
    visibility: list[Float32[HostArray, "h w"]]
    errors: list[dict[str, float]]


def run_render(config: Config, *, console: Console, debug: bool = False) -> Path:
    """Draws the scene of `config` with its technique unfitted, prints its errors, and writes the run's folder.

    **Arguments:**

    - `debug`: whether to also write images of the technique's intermediate results.

    **Returns** the folder, `<output>/<name>-render`. An earlier one is replaced only once everything is written.

    **Raises** `ValueError` for a mistake in the configuration, before any long computation.
    """
    folder = folder_of(config, SUFFIX)
    with Stages(console) as stages:
        loaded, technique = load(config, stages), build_technique(config, fitting=False)
        rendered = render_drawn(config, technique, draw(config, loaded, technique, stages), stages)
        with stages.stage("writing"):
            result = write_render(folder, rendered, stages.seconds, debug)
    measured = result["metrics"]
    lights = {light["light"]: light["errors"] for light in measured["lights"]}
    table.print_errors(console, config.name, measured["errors"], lights)
    table.print_lines(console, [table.noise_text(record.noise(rendered.drawn))])
    table.print_lines(console, result["warnings"], warn=True)
    return folder


def render_drawn(config: Config, technique: shadow.AbstractTechnique, drawn: list[Drawn], stages: Stages) -> Rendered:
    """The visibility by `technique` of a scene that is already drawn, and its errors."""
    with stages.stage("measuring"):
        visibility = [visibility_of(technique, each) for each in drawn]
        errors = [record.measured(image, each) for image, each in zip(visibility, drawn, strict=True)]
    return Rendered(config, technique, drawn, visibility, errors)


def write_render(folder: Path, rendered: Rendered, seconds: dict[str, float], debug: bool = False) -> dict[str, Any]:
    """Writes the run's folder; `seconds` are the times of its stages. **Returns** its result."""
    shaded = _shaded(rendered)
    result = _result(folder, rendered, shaded, seconds)
    write_whole(folder, lambda draft: _write(draft, rendered, shaded, result, debug))
    return result


def _remarks(rendered: Rendered) -> list[str]:
    """Remarks on the scene, its layout and its reference."""
    config, technique, drawn = rendered.config, rendered.technique, rendered.drawn
    return [
        *drawn[0].remarks,
        *scene_remarks(config, technique, [each.scene for each in drawn], drawn[0].surface),
        *layout_remarks(technique, [each.key for each in drawn], [each.state for each in drawn]),
        *reference_remarks(config, drawn),
    ]


def _shaded(rendered: Rendered) -> Pictures:
    """The shaded pictures by the names of their arrays."""
    config, drawn = rendered.config, rendered.drawn
    images = {"reference": [each.reference.visibility for each in drawn], "visibility": rendered.visibility}
    return {f"shaded_{name}": to_bytes(shade(config, drawn, image)) for name, image in images.items()}


def _write(draft: Path, rendered: Rendered, shaded: Pictures, result: dict[str, Any], debug: bool) -> None:
    # Imported here, since only a run that gets this far needs Matplotlib.
    from ..pages import _figures as figures
    from ..pages._report import write_report
    from . import _debug as debug_figures

    config, drawn = rendered.config, rendered.drawn
    arrays = {
        "reference": record.stacked([each.reference.visibility for each in drawn]),
        "visibility": record.stacked(rendered.visibility),
        "mask": record.stacked([each.mask for each in drawn]),
        **record.light_arrays(drawn),
        **shaded,
    }
    run = stored(draft, result, arrays, config)
    record.write_config(draft, config)
    record.write_arrays(draft, arrays)
    figures.write_figures(run, draft)
    for i, each in enumerate(drawn):
        end = record.suffix(i, drawn)
        figures.write_from_light(draft, end, rendered.technique, each.state)
        if debug:
            debug_figures.write_debug(draft, end, config, rendered.technique, each)
    write_report(run)
    record.write_result(draft, result)


def _result(folder: Path, rendered: Rendered, shaded: Pictures, seconds: dict[str, float]) -> dict[str, Any]:
    config, drawn, errors = rendered.config, rendered.drawn, rendered.errors
    aliasing = [record.aliasing(rendered.technique, each) for each in drawn]
    perceived = perceptual_error(shaded["shaded_visibility"], shaded["shaded_reference"], drawn)
    return {
        "name": config.name,
        "kind": "render",
        "metrics": {
            "technique": config.technique.type,
            "compare": config.compare.type,
            "errors": {**record.combined(errors, drawn), "flip": perceived},
            "reference_noise_floor": record.noise(drawn),
            "pixels": sum(each.pixels for each in drawn),
            "lights": [
                {
                    "light": each.key,
                    "errors": e,
                    "aliasing": extents,
                    "reference_noise_floor": each.noise_floor,
                    "pixels": each.pixels,
                }
                for each, e, extents in zip(drawn, errors, aliasing, strict=True)
            ],
        },
        "warnings": _remarks(rendered),
        "seconds": {name: round(s, 3) for name, s in seconds.items()},
        "versions": record.versions(),
        "seed": config.seed,
        "command": record.command("render", folder),
    }
