"""Stored runs, from which reports, comparisons and figures are made."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from jaxtyping import Bool, Float

from ... import io
from ..._types import HostArray
from ...config import CONFIG_FILE as CONFIG
from ...config import RESULT_FILE as RESULT
from ...config import Config, Row, describe, load_config
from . import _runs as records
from ._files import read_record
from ._parts import SLACK

ARRAYS, REPORT = "arrays.npz", "report.html"
STATES = ("reference", "before", "after")
"""The names of the arrays with a fit's images: the reference, and the images drawn before and after the fit."""


class LightImages(NamedTuple):
    """The images of one light, or of a view under one light.

    - `key`: the light's key, such as `"scene.light"`, or the view's name; `end`: the suffix of its files.
    - `images`: title and visibility (h, w) of each state, with the result last; `errors`: errors of each state.
    - `mask`: (h, w), the pixels that count.
    """

    key: str
    end: str
    reference: Float[HostArray, "h w"]
    mask: Bool[HostArray, "h w"]
    images: list[tuple[str, Float[HostArray, "h w"]]]
    errors: list[records.LightErrors]


@dataclasses.dataclass(frozen=True)
class StoredRun[Of: records.FolderRecord]:
    """A finished run.

    - `folder`: the run's folder.
    - `record`: the content of `result.json`; `arrays`: the arrays of `arrays.npz`, for figures.
    - `settings`: all settings with their units, or `None` for a fit made in Python.
    """

    folder: Path
    record: Of
    arrays: Mapping[str, HostArray]
    settings: Sequence[Row]


class VisibilityRun[Of: records.VisibilityRecord](StoredRun[Of]):
    """A finished fit to images of visibility, or a render."""

    @cached_property
    def errors(self) -> list[tuple[str, records.Errors]]:
        """Title and errors of each state over all lights, with the result last."""
        return list(zip(_titles(self.record).values(), _errors_of(self.record.metrics), strict=True))

    @cached_property
    def lights(self) -> list[LightImages]:
        """The images of each light."""
        lights = self.record.metrics.lights
        each = lambda name, i: self.arrays[name] if len(lights) == 1 else self.arrays[name][i]
        return [
            LightImages(
                light.light,
                "" if len(lights) == 1 else f"_{i}",
                each("reference", i),
                each("mask", i),
                [(title, each(name, i)) for name, title in _titles(self.record).items()],
                _errors_of(light),
            )
            for i, light in enumerate(lights)
        ]

    @cached_property
    def is_of_views(self) -> bool:
        """Whether it is a fit to several views. Only the worst views have pictures."""
        return isinstance(self.record, records.FitRecord) and self.record.metrics.shown is not None

    @cached_property
    def shown(self) -> list[LightImages]:
        """The images with pictures: all lights, or the worst views with the worst first."""
        shown = self.record.metrics.shown if isinstance(self.record, records.FitRecord) else None
        return self.lights if shown is None else [self.lights[i] for i in shown]

    @cached_property
    def shaded(self) -> list[tuple[str, HostArray]]:
        """Title and sRGB image (h, w, 3) of the reference and each state, under all lights, with the result last."""
        names = {"reference": "Reference", **_titles(self.record)}
        found = {title: self.arrays.get(f"shaded_{name}") for name, title in names.items()}
        return [(title, image) for title, image in found.items() if image is not None]


def is_fit(run: StoredRun[Any]) -> TypeGuard[VisibilityRun[records.FitRecord]]:
    """Whether a run is a fit to images of visibility."""
    return isinstance(run.record, records.FitRecord)


def read_run(folder: Path) -> VisibilityRun[Any]:
    """Reads the fit or render in `folder`.

    **Raises** `FileError` if the folder is missing, has no complete fit or render, or has files that are damaged or
    belong to different runs; `ConfigError` if its configuration cannot be read.
    """
    record = read_record(folder)
    if not isinstance(record, records.VisibilityRecord):
        raise io.FileError(f"{folder} holds a {record.kind}; expected the folder of a fit or a render")
    return stored_run(folder, record)


def stored_run(folder: Path, record: records.FolderRecord) -> Any:
    """The run in `folder`, whose record has been read. **Raises** as `read_run`."""
    # A report needs only the run's own files, because meshes and reference images may no longer exist. A fit made in
    # Python has no configuration, and the page of a fit to a picture does not show it.
    is_configured = record.command is not None and not isinstance(record, records.PictureRecord)
    config = load_config(_existing(folder, CONFIG), [], files=False) if is_configured else None
    if config is not None:
        _check_same(folder, record, config)
    file = _existing(folder, ARRAYS)
    arrays = io.read_arrays(file, _layouts(record, config))
    _check_values(file, record, arrays)
    return stored(folder, record, arrays, config)


def stored(
    folder: Path, record: records.FolderRecord, arrays: Mapping[str, Any], config: Config | None
) -> StoredRun[Any]:
    """The run in `folder`, or the run that is about to be written there."""
    kind: Any = VisibilityRun if isinstance(record, records.VisibilityRecord) else StoredRun
    found = {name: np.asarray(array) for name, array in arrays.items()}
    return kind(folder, record, found, [] if config is None else describe(config))


def _titles(record: records.VisibilityRecord) -> dict[str, str]:
    """The titles of the states of a run, by the names of their arrays."""
    if isinstance(record, records.RenderRecord):
        return {"visibility": "Visibility"}
    return {"before": "Before", "after": "After"}


def _errors_of(
    of: records.FitMetrics | records.RenderMetrics | records.FittedLight | records.RenderedLight,
) -> list[Any]:
    """The errors of each state."""
    return [of.before, of.after] if isinstance(of, records.FitMetrics | records.FittedLight) else [of.errors]


def _existing(folder: Path, name: str) -> Path:
    if not (folder / name).is_file():
        raise io.FileError(f"{folder} holds an incomplete run: it has no {name}; expected all files: run it again")
    return folder / name


def _check_same(folder: Path, record: records.FolderRecord, config: Config) -> None:
    """Checks that the record and the configuration belong to the same run."""
    named = {}
    if isinstance(record, records.ShapeRecord):
        if config.fit.shape is None:
            raise io.FileError(f"{folder / CONFIG} has no fit.shape; expected the run's own: run it again")
        return
    if isinstance(record, records.VisibilityRecord) and config.fit.views is None and config.fit.validation is None:
        lights = [".".join(map(str, ("scene", *key))) for key in config.scene.each_light]
        named["lights"] = lights, [light.light for light in record.metrics.lights]
    if isinstance(record, records.FitRecord):
        named["parameters"] = list(config.fit.parameters), list(record.fitted)
    for what, (ours, theirs) in named.items():
        if ours != theirs:
            raise io.FileError(
                f"{folder} holds files of different runs: {CONFIG} has the {what} {', '.join(ours)}, and {RESULT} has "
                f"{', '.join(theirs)}; expected the same: run it again"
            )


def _layouts(record: records.FolderRecord, config: Config | None) -> dict[str, io.ArrayLayout]:
    """The layouts of the arrays that reports and figures need."""
    count, images = lambda kind: io.ArrayLayout(kind, (None,)), lambda *shape: io.ArrayLayout("f", shape, bytes=4)
    history = {"history_phase": count("iu"), "history_loss": io.ArrayLayout("f", (None,), bytes=4)}
    if isinstance(record, records.ShapeRecord):
        assert config is not None
        assert config.fit.shape is not None
        shape = (len(record.metrics.lights), *config.fit.shape.resolution)
        return {**dict.fromkeys(STATES, images(*shape)), **history}
    if isinstance(record, records.PictureRecord):
        height, width = record.metrics.resolution
        mask = io.ArrayLayout("b", (height, width))
        return {**dict.fromkeys(STATES, images(height, width, 3)), "mask": mask, **history}
    if config is None:
        assert isinstance(record, records.FitRecord)
        assert record.metrics.resolution is not None
        height, width = record.metrics.resolution
    else:
        height, width = config.scene.camera.resolution
    lights, states = len(record.metrics.lights), ("reference", *_titles(record))
    shape = (height, width) if lights == 1 else (lights, height, width)
    shaded = io.ArrayLayout("u", (height, width, 3), required=False, bytes=1)
    layouts = {
        **dict.fromkeys(states, images(*shape)),
        "mask": io.ArrayLayout("b", shape),
        **dict.fromkeys((f"shaded_{name}" for name in states), shaded),
    }
    if not isinstance(record, records.FitRecord):
        return layouts
    values = io.ArrayLayout("f", (None, len(record.fitted)))
    start = io.ArrayLayout("iu", (None,), required=False)
    return {**layouts, **history, "history_start": start, "history_values": values}


def _check_values(file: Path, record: records.FolderRecord, arrays: Mapping[str, HostArray]) -> None:
    """Checks the values of the arrays of visibility."""
    if not isinstance(record, records.VisibilityRecord):
        return
    for name in ("reference", *_titles(record)):
        low, high = float(arrays[name].min()), float(arrays[name].max())
        # Written so that NaN fails.
        if not (low >= -SLACK and high <= 1 + SLACK):
            raise _damaged(file, f"the array {name} holds values from {low:g} to {high:g}; expected 0 to 1")
    counted, pixels = int(arrays["mask"].sum()), record.metrics.pixels
    if counted != pixels:
        raise _damaged(file, f"{counted:,} pixels count in the array mask; expected the {pixels:,} of {RESULT}")
    if isinstance(record, records.FitRecord):
        lengths = {name: len(array) for name, array in arrays.items() if name.startswith("history_")}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise _damaged(file, f"the arrays differ in length: {listed}; expected equal lengths")
        phases = len(record.solver.phases)
        if not ((arrays["history_phase"] >= 0) & (arrays["history_phase"] < phases)).all():
            message = f"the array history_phase has phases that {RESULT} does not list; expected 0 to {phases - 1}"
            raise _damaged(file, message)


def _damaged(file: Path, reason: str) -> io.FileError:
    return io.FileError(f"{file} is damaged: {reason}: run it again")
