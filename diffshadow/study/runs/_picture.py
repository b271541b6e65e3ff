"""Fits to a picture: the plan, the problem, and the pictures before and after, how they are measured, their arrays and
their files."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float

from ... import fit, geometry, io, metrics, raster
from ..._arithmetic import as_float
from ..._types import HostArray
from ...config import CONFIG_FILE, Config, ConfigError, FitPlan, Mistake, build_shadow_mapping
from ...settings.reference import Encoding, PictureReference
from ...shading import AbstractShading, to_srgb
from ..record import _runs as records
from ..record._stored import StoredRun
from ..remarks._fit import remarks
from ..remarks._verdict import Unexplained, verdict
from ._progress import Progress
from ._setup import load, plan_fit, trace

Picture = Float[HostArray, "h w 3"]
SCENE = "fitted.glb"
"""The file of the fitted scene."""
# The near and far planes of a camera that are found by themselves are moved away by this factor, since it may move.
_SPARE = 2.0


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


def picture_plan(config: Config, progress: Progress) -> PicturePlan:
    """For a `config` whose reference is a picture: what is fitted, and to which picture.

    **Raises** `ConfigError` for a mistake in the configuration.
    """
    section = config.reference
    assert isinstance(section, PictureReference)
    loaded = load(config, progress)
    scene = _with_spare_depth(config, loaded.scene)
    plan = plan_fit(config, scene)
    picture, encoding = (None, "linear") if section.path is None else _picture(config, section.path)
    mask = None if section.mask is None else _mask(config, section.mask)
    return PicturePlan(scene, plan, picture, section.encoding or encoding, mask, [*loaded.remarks])


def picture_problem(config: Config, progress: Progress) -> tuple[fit.PictureProblem, PicturePlan]:
    """The problem that brings `config` to its picture, and the plan behind it.

    **Raises** `ConfigError` for a mistake in the configuration, before any ray is traced.
    """
    section, planned = config.reference, picture_plan(config, progress)
    assert isinstance(section, PictureReference)
    scene, plan, read, encoding, mask, _ = planned
    assert plan.arrangement is not None
    if read is None:
        shading = plan.arrangement.shading
        assert shading is not None
        with progress.stage("tracing reference"):
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
        points=plan.points,
    )
    return problem, planned


def traced_picture(
    scene: geometry.Scene, shading: AbstractShading, samples: int, supersampling: int, seed: int = 0
) -> Picture:
    """The ray-traced picture of a scene, linear: the mean over a grid of camera rays in each pixel. Each is shaded with
    the light that its shadow rays find."""
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


@dataclasses.dataclass(frozen=True)
class FittedPicture:
    """A finished fit to a picture.

    - `name`: name of the run; `config`: its configuration; none for a fit that was made in Python.
    - `truth`: true values of fitted numbers, by name, as far as they are known.
    - `pictures`: the reference, and the picture before and after, in their `encoding`.
    - `placed`: the fitted scene.
    """

    name: str
    config: Config | None
    result: fit.FitResult
    truth: Mapping[str, float]
    pictures: dict[str, Picture]
    mask: Bool[HostArray, "h w"]
    encoding: Encoding
    placed: geometry.Scene
    metrics: records.PictureMetrics
    verdict: records.Verdict
    remarks: list[str]

    @classmethod
    def of(
        cls,
        name: str,
        config: Config | None,
        result: fit.FitResult,
        truth: Mapping[str, float],
        of_scene: list[str],
    ) -> Self:
        """Measures the pictures of a fit, and reports the result."""
        problem: Any = result.problems[0]
        arrangement = result.arrangement
        assert arrangement is not None
        start = fit.with_parameters(problem.arrangement, result.parameters, list(result.initial.values()))
        # The fit judged both, so there is memory for their outlines.
        at = lambda subject: np.asarray(problem.picture(subject))
        pictures = {"reference": np.asarray(problem.reference), "before": at(start), "after": at(arrangement)}
        mask, encoding = np.asarray(problem.weight) > 0, problem.encoding
        before, after = (
            _errors(pictures[state], pictures["reference"], mask, encoding) for state in ("before", "after")
        )
        measured = records.PictureMetrics(
            before=before, after=after, pixels=int(mask.sum()), resolution=list(mask.shape)
        )
        # One colour all over a picture of one colour has no error.
        constant = float(np.sqrt(np.mean(np.var(pictures["reference"][mask].astype(np.float64), axis=0))))
        left = Unexplained(after.rmse, constant) if after.rmse >= constant > 0 else None
        said = verdict(config, result, before.rmse, after.rmse, left)
        sentences = [*of_scene, *remarks(config, result, said.kind)]
        placed = arrangement.placed(problem.scene)
        return cls(name, config, result, truth, pictures, mask, encoding, placed, measured, said, sentences)

    def record(self, **about: Any) -> records.PictureRecord:
        """Its record."""
        result, camera = self.result, self.placed.camera
        return records.PictureRecord.of(
            result,
            verdict=self.verdict,
            name=self.name,
            encoding=self.encoding,
            bounds={p.name: records.Bounds.of(p) for p in result.parameters},
            truth=dict(self.truth),
            deviations={} if result.precision is None else dict(result.precision.deviations),
            camera={key: np.asarray(getattr(camera, key)).tolist() for key in ("eye", "target", "up")},
            metrics=self.metrics,
            warnings=self.remarks,
            **about,
        )

    def arrays(self) -> dict[str, Any]:
        """Its pictures, and the history of the fit."""
        history = self.result.history
        return {
            **{name: picture.astype(np.float32) for name, picture in self.pictures.items()},
            "mask": self.mask,
            "history_phase": np.asarray([step.phase for step in history], np.int32),
            "history_loss": np.asarray([step.loss for step in history], np.float32),
        }

    @property
    def stored_configs(self) -> dict[str, Config]:
        """The configuration that its folder holds, by the name of its file."""
        return {} if self.config is None else {CONFIG_FILE: self.config}

    def write(self, draft: Path, run: StoredRun[Any]) -> None:
        """Writes its pictures, and the fitted scene."""
        for name, picture in self.pictures.items():
            io.write_png(draft / f"{name}.png", shown(picture, self.encoding))
        io.write_gltf(draft / SCENE, self.placed, extras=self.result.fitted)


def _errors(image: Picture, truth: Picture, mask: Bool[HostArray, "h w"], encoding: Encoding) -> records.PictureErrors:
    """The errors of a picture."""
    difference = (image - truth)[mask]
    try:
        flip, _ = metrics.flip(shown(image, encoding), shown(truth, encoding), mask)
    except ImportError:
        flip = None
    rmse = float(np.sqrt(np.mean(difference**2)))
    return records.PictureErrors(rmse=rmse, mae=float(np.abs(difference).mean()), flip=flip)


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
