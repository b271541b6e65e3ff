"""Runs a fit to a picture: from its configuration to its folder."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table

from ... import fit, geometry, io, metrics, raster
from ..._arithmetic import as_float
from ..._types import HostArray
from ..._words import counted
from ...config import Config, ConfigError, FitPlan, Mistake, build_shadow_mapping
from ...settings.reference import Encoding, PictureReference
from ...shading import AbstractShading, to_srgb
from ..files._run_folder import folder_of, write_whole
from ..files._stored import PICTURE, PICTURE_STATES, add_files
from ..pages import _table as table
from ..remarks._fit import remarks
from ..remarks._verdict import Unexplained, Verdict, verdict
from . import _pose as poses
from . import _record as record
from ._progress import Stages
from ._setup import load, trace
from ._solve import plan_fit, solve

Picture = Float[HostArray, "h w 3"]
SCENE = "fitted.glb"
"""The file of the fitted scene."""
# The near and far planes of a camera that are found by themselves are moved away by this factor, since it may move.
_SPARE = 2.0


class FittedPicture(NamedTuple):
    """A finished fit to a picture.

    - `pictures`: the reference, and the picture before and after, in their encoding.
    - `measured`: the errors of the picture before and after the fit; `placed`: the fitted scene.
    - `config`: none of a fit that was made in Python.
    """

    name: str
    config: Config | None
    plan: FitPlan
    result: fit.FitResult
    pictures: dict[str, Picture]
    mask: Bool[HostArray, "h w"]
    encoding: str
    placed: geometry.Scene
    measured: dict[str, Any]
    verdict: Verdict
    remarks: list[str]


def run_picture(config: Config, *, console: Console) -> Path:
    """Fits the parameters of `config` to a picture, prints the result, and writes the run's folder.

    **Returns** the folder, `<output>/<name>`. An earlier run there is replaced only once everything is written.

    **Raises** `ConfigError` for a mistake in the configuration, before any long computation.
    """
    folder = folder_of(config)
    with Stages(console) as stages:
        problem, planned = picture_problem(config, stages)
        plan = planned.fit
        result = solve([problem], plan, stages)
        with stages.stage("measuring"):
            fitted = _finished(config.name, config, plan, result, planned.remarks)
        with stages.stage("writing"):
            write_picture(folder, fitted, stages.seconds)
    _print(console, fitted, sum(stages.seconds.values()))
    return folder


def save_picture(result: fit.FitResult, plan: FitPlan, folder: Path, name: str, seconds: dict[str, float]) -> None:
    """Writes the folder of a fit to a picture that was made in Python."""
    write_picture(folder, _finished(name, None, plan, result, []), seconds)


class PicturePlan(NamedTuple):
    """What is fitted, and to which picture.

    - `picture`: none to trace it; `mask`: none if all pixels count.
    """

    scene: geometry.Scene
    fit: FitPlan
    picture: Picture | None
    encoding: Encoding
    mask: Bool[HostArray, "h w"] | None
    remarks: list[str]


def picture_plan(config: Config, stages: Stages) -> PicturePlan:
    """What `config`, whose reference is a picture, fits to which picture.

    **Raises** `ConfigError` for a mistake in the configuration.
    """
    section = config.reference
    assert isinstance(section, PictureReference)
    loaded = load(config, stages)
    scene = _with_spare_depth(config, loaded.scene)
    plan = plan_fit(config, scene)
    picture, encoding = (None, "linear") if section.path is None else _picture(config, section.path)
    mask = None if section.mask is None else _mask(config, section.mask)
    return PicturePlan(scene, plan, picture, section.encoding or encoding, mask, [*loaded.remarks])


def picture_problem(config: Config, stages: Stages) -> tuple[fit.PictureProblem, PicturePlan]:
    """The problem that brings `config` to its picture, and the plan behind it.

    **Raises** `ConfigError` for a mistake in the configuration, before any ray is traced.
    """
    section, planned = config.reference, picture_plan(config, stages)
    assert isinstance(section, PictureReference)
    scene, plan, read, encoding, mask, _ = planned
    assert plan.arrangement is not None
    if read is None:
        shading = plan.arrangement.shading
        assert shading is not None
        with stages.stage("tracing reference"):
            read = traced_picture(scene, shading, section.samples, section.supersampling, config.seed)
            read = encoded(read * 2**section.exposure, encoding)
    moves = any(p.where.startswith(("camera.", "meshes.")) for p in plan.parameters)
    problem = fit.PictureProblem.of(
        scene,
        build_shadow_mapping(config),
        read,
        mask=mask,
        encoding=encoding,
        arrangement=plan.arrangement,
        surface=None if moves else raster.draw_antialiased(scene.mesh, scene.camera),
    )
    return problem, planned


def traced_picture(
    scene: geometry.Scene, shading: AbstractShading, samples: int, supersampling: int, seed: int = 0
) -> Picture:
    """The picture of a scene by rays, linear: the mean over a grid of camera rays in each pixel, shaded with the light
    that shadow rays find at each."""
    height, width = scene.camera.resolution
    resolution: Any = {"resolution": (supersampling * height, supersampling * width)}
    fine = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, **resolution))
    surface = raster.draw_surface(fine.mesh, fine.camera)
    how = {"samples": max(samples // supersampling**2, 1), "seed": seed}
    seen = [as_float(trace(fine.lit_by(i), how).visibility) for i in range(len(fine.lights))]
    image = np.asarray(shading(surface, seen, fine.lights, fine.camera))
    return image.reshape(height, supersampling, width, supersampling, 3).mean(axis=(1, 3))


def encoded(linear: Picture, encoding: str) -> Picture:
    """A linear picture in this encoding."""
    return to_srgb(np.clip(linear, 0, 1)) if encoding == "srgb" else linear


def shown(picture: Picture, encoding: str) -> Picture:
    """A picture for a screen: sRGB from 0 to 1."""
    return np.clip(picture, 0, 1) if encoding == "srgb" else encoded(picture, "srgb")


def write_picture(folder: Path, fitted: FittedPicture, seconds: dict[str, float]) -> None:
    """Writes the run's folder; `seconds` are the times of its stages."""
    result = _result(folder, fitted, seconds)
    write_whole(folder, lambda draft: _write(draft, fitted, result))


def _finished(
    name: str, config: Config | None, plan: FitPlan, result: fit.FitResult, of_scene: list[str]
) -> FittedPicture:
    problem: Any = result.problems[0]
    arrangement = result.arrangement
    assert arrangement is not None
    parameters = result.parameters
    start = fit.with_parameters(problem.arrangement, parameters, [result.initial[p.name] for p in parameters])
    # The fit judged both, so there is memory for their outlines.
    at = lambda subject: np.asarray(problem.picture(subject))
    pictures = {"reference": np.asarray(problem.reference), "before": at(start), "after": at(arrangement)}
    mask = np.asarray(problem.weight) > 0
    placed = arrangement.placed(problem.scene)
    measured, constant = _measured(pictures, mask, problem.encoding)
    before, after = (measured[state]["rmse"] for state in PICTURE_STATES[1:])
    # One colour all over a picture of one colour has no error.
    left = Unexplained(after, constant) if after >= constant > 0 else None
    said = verdict(config, result, before, after, left)
    messages = [*of_scene, *remarks(config, result, said.kind)]
    return FittedPicture(name, config, plan, result, pictures, mask, problem.encoding, placed, measured, said, messages)


def _measured(
    pictures: dict[str, Picture], mask: Bool[HostArray, "h w"], encoding: str
) -> tuple[dict[str, Any], float]:
    """The errors of the picture before and after the fit, and the least RMSE of a picture of one colour."""
    truth = pictures["reference"]
    found: dict[str, Any] = {"pixels": int(mask.sum()), "resolution": list(mask.shape)}
    for state in PICTURE_STATES[1:]:
        image = pictures[state]
        difference = (image - truth)[mask]
        errors: dict[str, float | None] = {
            "rmse": float(np.sqrt(np.mean(difference**2))),
            "mae": float(np.abs(difference).mean()),
            "flip": None,
        }
        try:
            drawn, original = (shown(each, encoding) for each in (image, truth))
            errors["flip"], _ = metrics.flip(drawn, original, mask)
        except ImportError:
            pass
        found[state] = errors
    return found, float(np.sqrt(np.mean(np.var(truth[mask].astype(np.float64), axis=0))))


def _result(folder: Path, fitted: FittedPicture, seconds: dict[str, float]) -> dict[str, Any]:
    result, config, camera = fitted.result, fitted.config, fitted.placed.camera
    return {
        "verdict": fitted.verdict._asdict(),
        "name": fitted.name,
        "kind": PICTURE,
        "encoding": fitted.encoding,
        "initial": result.initial,
        "fitted": result.fitted,
        "bounds": {p.name: {"lower": p.lower, "upper": p.upper, "unit": p.unit} for p in fitted.plan.parameters},
        "truth": fitted.plan.truth,
        "deviations": {} if result.precision is None else result.precision.deviations,
        "camera": {key: np.asarray(getattr(camera, key)).tolist() for key in ("eye", "target", "up")},
        "metrics": fitted.measured,
        "steps": result.steps,
        "warnings": fitted.remarks,
        "seconds": {name: round(s, 3) for name, s in seconds.items()},
        "versions": record.versions(),
        **({} if config is None else {"seed": config.seed, "command": record.command("fit", folder)}),
    }


def _write(draft: Path, fitted: FittedPicture, result: dict[str, Any]) -> None:
    # Imported here, since only a run that gets this far needs Matplotlib.
    from ..pages._picture import report_picture

    history = fitted.result.history
    if fitted.config is not None:
        record.write_config(draft, fitted.config)
    record.write_arrays(
        draft,
        {
            **{name: picture.astype(np.float32) for name, picture in fitted.pictures.items()},
            "mask": fitted.mask,
            "history_phase": np.asarray([step.phase for step in history], np.int32),
            "history_loss": np.asarray([step.loss for step in history], np.float32),
        },
    )
    for name, picture in fitted.pictures.items():
        io.write_png(draft / f"{name}.png", shown(picture, fitted.encoding))
    io.write_gltf(draft / SCENE, fitted.placed, extras=fitted.result.fitted)
    record.write_result(draft, result)
    add_files(draft, [report_picture(draft).name])


def _print(console: Console, fitted: FittedPicture, seconds: float) -> None:
    said = fitted.verdict
    table.print_lines(console, [said.sentence, *said.remedies], warn=said.kind == table.UNEXPLAINED)
    before, after = (fitted.measured[state] for state in PICTURE_STATES[1:])
    errors = Table("", "before", "after", title=fitted.name, title_justify="left")
    for column in errors.columns[1:]:
        column.justify = "right"
    for key, title in (("rmse", "RMSE of the picture"), ("mae", "MAE of the picture"), ("flip", "FLIP")):
        if before[key] is not None:
            errors.add_row(title, f"{before[key]:.4f}", f"{after[key]:.4f}")
    console.print(errors)
    poses.print_poses(console, fitted.plan, fitted.result)
    table.print_lines(console, fitted.remarks, warn=True)
    table.print_lines(console, [f"{counted(fitted.result.steps, 'step')}, {seconds:.1f} s in all"])


def _with_spare_depth(config: Config, scene: geometry.Scene) -> geometry.Scene:
    """The scene, whose camera may move without cutting off what it sees."""
    section: Any = config.scene.camera
    camera: Any = scene.camera
    near, far = float(camera.near), float(camera.far)
    wide = (near / _SPARE, far * _SPARE) if section.type == "pinhole" else (2 * near - far, 2 * far - near)
    given = {key: value for key, value in zip(("near", "far"), wide, strict=True) if getattr(section, key) is None}
    return dataclasses.replace(scene, camera=dataclasses.replace(camera, **given))


def _picture(config: Config, path: str) -> tuple[Picture, Encoding]:
    try:
        image, encoding = io.read_picture(path)
    except io.FileError as error:
        raise _error(config, "path", str(error)) from error
    _check_size(config, "path", image)
    return image, encoding


def _mask(config: Config, path: str) -> Bool[HostArray, "h w"]:
    try:
        mask = io.read_visibility(path) > 0.5
    except io.FileError as error:
        raise _error(config, "mask", str(error)) from error
    _check_size(config, "mask", mask)
    if not mask.any():
        raise _error(config, "mask", "has no pixel above 0.5, so that none counts; expected some: draw it in white")
    return mask


def _check_size(config: Config, key: str, image: HostArray) -> None:
    have, need = list(image.shape[:2]), list(config.scene.camera.resolution)
    if have != need:
        given = f"is an image of {have} pixels, [height, width], and scene.camera.resolution is {need}"
        raise _error(config, key, f"{given}; expected the same; scale the image, or set the resolution")


def _error(config: Config, key: str, what: str) -> ConfigError:
    return ConfigError([Mistake(config.origin.place(("reference", key)), f"reference.{key}", what)])
