"""A fit's report: one page that needs no other file."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from ..config import Config, describe
from ..fit import Parameter
from ._table import ERRORS, noise_text, number

_IMAGES = {
    "comparison": "Visibility, and its signed difference from the reference. Pixels in blue-grey do not count: no "
    "surface is seen there, or the light's map does not cover it.",
    "shaded": "The scene, shaded, with the shadows before and after.",
    "loss": "The error over the fit. The soft compare hardens from phase to phase; the hard one judges.",
    "shadow_map": "The shadow map: how far from the light each texel's surface lies.",
}


def write_report(folder: Path, result: Mapping[str, Any], config: Config, parameters: Sequence[Parameter]) -> None:
    """Writes `report.html` of the fit whose `result.json` and images `folder` is about to hold."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("diffshadow", "study"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    before, after = result["metrics"]["before"], result["metrics"]["after"]
    page = environment.get_template("report.html.j2").render(
        result=result,
        summary=_summary(result),
        noise=noise_text(result["metrics"]["reference_noise_floor"]),
        parameters=[(p, f"{p.initial:.4g}", f"{result['fitted'][p.name]:.4g}") for p in parameters],
        errors=[(label, number(key, before[key]), number(key, after[key])) for key, label in ERRORS.items()],
        images=list(_images(folder, result["metrics"]["lights"])),
        settings=describe(config),
        environment={**result["versions"], "seed": result["seed"]},
        seconds=result["seconds"],
    )
    (folder / "report.html").write_text(page, encoding="utf-8")


def _summary(result: Mapping[str, Any]) -> str:
    """What the fit did, in a sentence."""
    before, after = (result["metrics"][when]["rmse"] for when in ("before", "after"))
    names = " and ".join(filter(None, [", ".join(list(result["fitted"])[:-1]), list(result["fitted"])[-1]]))
    if result["solver"]["chosen_phase"] < 0:
        return f"Fitting {names} found nothing better than the start, whose error is {before:.4f} RMSE."
    return (
        f"Fitting {names} took the shadow's error from {before:.4f} to {after:.4f} RMSE, "
        f"{before / max(after, 1e-12):.1f} times less, in {result['solver']['steps']} steps."
    )


def _images(folder: Path, lights: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """Each image's name, data and caption; several lights have images of their own."""
    for name, caption in _IMAGES.items():
        for path in sorted(folder.glob(f"{name}*.png"), key=lambda path: (len(path.stem), path.stem)):
            index = path.stem.removeprefix(name).removeprefix("_")
            yield path.name, _data_uri(path), f"{lights[int(index)]['light']}. {caption}" if index else caption


def _data_uri(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
