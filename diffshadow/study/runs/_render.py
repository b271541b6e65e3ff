"""Runs a render: draws a technique without fitting it, and measures its errors."""

import dataclasses
from functools import cached_property
from pathlib import Path
from typing import Any

from jaxtyping import Float32
from rich.console import Console

from ... import shadow
from ..._types import HostArray
from ...config import CONFIG_FILE, Config, build_technique
from .._drawn import Drawn
from ..pages._console import print_run
from ..record import _runs as records
from ..record._folder import folder_of
from ..record._stored import StoredRun
from ..remarks._bias import bias_remarks
from ..remarks._layout import layout_remarks
from ..remarks._reference import reference_remarks
from ..remarks._scene import scene_remarks
from ._measure import (
    Pictures,
    aliasing,
    combined,
    light_arrays,
    measured,
    noise,
    perceptual_error,
    shaded,
    stacked,
    suffix,
)
from ._progress import Progress
from ._setup import draw, load, visibility_of
from ._write import write_run

SUFFIX = "-render"
"""Suffix of a render's folder, which distinguishes it from the fit's."""


@dataclasses.dataclass(frozen=True)
class Rendered:
    """A finished render: the scene as drawn, and visibility and errors for each light.

    `debug`: whether images of the technique's intermediate results are written, too.
    """

    config: Config
    technique: shadow.AbstractTechnique
    drawn: list[Drawn]
    visibility: list[Float32[HostArray, "h w"]]
    errors: list[dict[str, float]]
    debug: bool = False

    @cached_property
    def pictures(self) -> Pictures:
        """The shaded pictures by the names of their arrays."""
        images = {"reference": [each.reference.visibility for each in self.drawn], "visibility": self.visibility}
        return {f"shaded_{name}": shaded(self.config, self.drawn, image) for name, image in images.items()}

    def record(self, **about: Any) -> records.RenderRecord:
        """Its record."""
        config, drawn = self.config, self.drawn
        lights = [
            records.RenderedLight(
                light=each.key,
                errors=records.LightErrors(**errors),
                aliasing=aliasing(self.technique, each),
                reference_noise_floor=each.noise_floor,
                pixels=each.pixels,
            )
            for each, errors in zip(drawn, self.errors, strict=True)
        ]
        sentences = [
            *drawn[0].remarks,
            *scene_remarks(config, self.technique, [each.scene for each in drawn], drawn[0].surface),
            *layout_remarks(self.technique, [each.key for each in drawn], [each.state for each in drawn]),
            *bias_remarks(
                config,
                self.technique,
                [each.key for each in drawn],
                [each.scene for each in drawn],
                [each.state for each in drawn],
            ),
            *reference_remarks(config, drawn),
        ]
        return records.RenderRecord(
            name=config.name,
            metrics=records.RenderMetrics(
                technique=config.technique.type,
                compare=config.compare.type,
                errors=records.Errors(
                    **combined(self.errors, drawn), flip=perceptual_error(self.pictures, "visibility", drawn)
                ),
                reference_noise_floor=noise(drawn),
                pixels=sum(each.pixels for each in drawn),
                lights=lights,
            ),
            warnings=sentences,
            **about,
        )

    def arrays(self) -> dict[str, Any]:
        """Its images, what was drawn from the lights, and the shaded pictures."""
        return {
            "reference": stacked([each.reference.visibility for each in self.drawn]),
            "visibility": stacked(self.visibility),
            "mask": stacked([each.mask for each in self.drawn]),
            **light_arrays(self.drawn),
            **self.pictures,
        }

    @property
    def stored_configs(self) -> dict[str, Config]:
        """The configuration that its folder holds, by the name of its file."""
        return {CONFIG_FILE: self.config}

    def write(self, draft: Path, run: StoredRun[Any]) -> None:
        """Writes its figures."""
        from ..pages import _figures as figures
        from ._debug import write_debug

        figures.write_figures(run, draft)
        for i, each in enumerate(self.drawn):
            end = suffix(i, self.drawn)
            figures.write_from_light(draft, end, self.technique, each.state)
            if self.debug:
                write_debug(draft, end, self.config, self.technique, each)


def run_render(config: Config, *, console: Console, debug: bool = False) -> Path:
    """Draws the scene of `config` with its technique unfitted, prints its errors, and writes the run's folder.

    **Arguments:**

    - `debug`: whether to also write images of the technique's intermediate results.

    **Returns** the folder, `<output>/<name>-render`. An earlier one is replaced only once everything is written.

    **Raises** `ValueError` for a mistake in the configuration, before any long computation.
    """
    folder = folder_of(config, SUFFIX)
    with Progress(console) as progress:
        loaded, technique = load(config, progress), build_technique(config, fitting=False)
        rendered = render_drawn(config, technique, draw(config, loaded, technique, progress), progress, debug=debug)
        with progress.stage("writing"):
            record = write_run(folder, rendered, progress.seconds, "render")
    print_run(console, record, sum(progress.seconds.values()))
    return folder


def render_drawn(
    config: Config, technique: shadow.AbstractTechnique, drawn: list[Drawn], progress: Progress, *, debug: bool = False
) -> Rendered:
    """The visibility that `technique` computes for a scene that is already drawn, and its errors."""
    with progress.stage("measuring"):
        visibility = [visibility_of(technique, each) for each in drawn]
        errors = [measured(image, each) for image, each in zip(visibility, drawn, strict=True)]
    return Rendered(config, technique, drawn, visibility, errors, debug)
