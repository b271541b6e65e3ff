"""Stored runs: what reports, comparisons and figures are made from."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ... import io
from ..._types import HostArray
from ...config import CONFIG_FILE as CONFIG
from ...config import Config, Row, describe, load_config
from ._run_folder import RESULT
from ._schema import checked_result, read_json, write_json
from ._schema_parts import SLACK

ARRAYS, REPORT = "arrays.npz", "report.html"
KINDS = {"fit": (("Before", "before"), ("After", "after")), "render": (("Visibility", "visibility"),)}
"""The images of each kind of run: their titles, and the names of their arrays."""
SHAPE = "shape"
"""The kind of a fit of a shape."""
PICTURE = "picture"
"""The kind of a fit to a picture."""
PICTURE_STATES = ("reference", "before", "after")
"""The names of its arrays: the picture that the fit compares with, and the pictures drawn before and after the fit."""
SWEEP = "sweep"
"""The kind of a folder that holds many runs."""
ADVISE = "advise"
"""The kind of a folder that holds the fits of several techniques, and what is recommended."""


class LightImages(NamedTuple):
    """The images of one light, or of a view under one light.

    - `key`: the light's key, such as `"scene.light"`, or the view's name; `end`: the suffix of its files.
    - `images`: title and visibility (h, w) of each state, the result last; `errors`: errors of each state, by name.
    - `mask`: (h, w), the pixels that count.
    """

    key: str
    end: str
    reference: Float[HostArray, "h w"]
    mask: Bool[HostArray, "h w"]
    images: list[tuple[str, Float[HostArray, "h w"]]]
    errors: list[Mapping[str, float | None]]


class StoredRun(NamedTuple):
    """A finished fit or render.

    - `folder`: the run's folder.
    - `result`: the content of `result.json`; `arrays`: those arrays of `arrays.npz` that figures are made from.
    - `settings`: all settings, with their units; none of a fit made in Python.
    """

    folder: Path
    result: Mapping[str, Any]
    arrays: Mapping[str, HostArray]
    settings: Sequence[Row]

    @property
    def name(self) -> str:
        """The run's name."""
        return self.result["name"]

    @property
    def kind(self) -> str:
        """`"fit"` or `"render"`."""
        return self.result["kind"]

    @property
    def errors(self) -> list[tuple[str, Mapping[str, float | None]]]:
        """Title and errors over all lights of each state, the result last."""
        measured = self.result["metrics"]
        return [(title, measured[_errors_key(self.kind, name)]) for title, name in KINDS[self.kind]]

    @property
    def lights(self) -> list[LightImages]:
        """The images of each light."""
        lights = self.result["metrics"]["lights"]
        each = lambda name, i: self.arrays[name] if len(lights) == 1 else self.arrays[name][i]
        states = KINDS[self.kind]
        return [
            LightImages(
                light["light"],
                "" if len(lights) == 1 else f"_{i}",
                each("reference", i),
                each("mask", i),
                [(title, each(name, i)) for title, name in states],
                [light[_errors_key(self.kind, name)] for _, name in states],
            )
            for i, light in enumerate(lights)
        ]

    @property
    def shown(self) -> list[LightImages]:
        """The images that have pictures: of all lights, or of the worst views, the worst first."""
        lights, shown = self.lights, self.result["metrics"].get("shown")
        return lights if shown is None else [lights[i] for i in shown]

    @property
    def shaded(self) -> list[tuple[str, HostArray]]:
        """Title and sRGB image (h, w, 3) of the reference and each state, under all lights, the result last."""
        names = [("Reference", "reference"), *KINDS[self.kind]]
        return [(title, self.arrays[f"shaded_{name}"]) for title, name in names if f"shaded_{name}" in self.arrays]


def read_run(folder: Path) -> StoredRun:
    """Reads the run in `folder`.

    **Raises** `FileError` if the folder is missing, holds no complete fit or render, or holds files that are damaged
    or belong to different runs; `ConfigError` if its configuration cannot be read.
    """
    result = read_result(folder)
    if result["kind"] not in KINDS:
        raise io.FileError(f"{folder} holds a {result['kind']}; expected the folder of a {' or a '.join(KINDS)}")
    # A report needs only the run's own files: meshes and reference images may no longer exist. A fit made in Python has
    # no configuration.
    is_configured = result.get("command") is not None
    config = load_config(_existing(folder, CONFIG), [], files=False) if is_configured else None
    if config is not None:
        _check_same(folder, result, config)
    file = _existing(folder, ARRAYS)
    arrays = io.read_arrays(file, _layouts(result, config))
    _check_values(file, result, arrays)
    return StoredRun(folder, result, arrays, [] if config is None else describe(config))


def read_result(folder: Path) -> Mapping[str, Any]:
    """The content of `result.json` in `folder`, checked against its schema.

    **Raises** `FileError` if there is none, if it is damaged, or if it is not of a fit, a render, a sweep or a
    recommendation.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise io.FileError(f"{folder} {what}; expected the folder of a finished run, such as runs/quickstart")
    file = folder / RESULT
    if not file.is_file():
        raise io.FileError(f"{folder} holds no run: it has no {RESULT}; expected the folder of a finished run")
    result = read_json(file)
    kind = result.get("kind") if isinstance(result, dict) else None
    if kind not in (*KINDS, SHAPE, PICTURE, SWEEP, ADVISE):
        raise io.FileError(
            f"{file} is not of a fit, render, sweep or recommendation; expected one of these: runs inside a sweep keep "
            "only numbers, unless sweep.figures is true"
        )
    return checked_result(result, file)


def stored(folder: Path, result: Mapping[str, Any], arrays: Mapping[str, Any], config: Config | None) -> StoredRun:
    """The run that is about to be written to `folder`."""
    settings = [] if config is None else describe(config)
    return StoredRun(folder, result, {name: np.asarray(array) for name, array in arrays.items()}, settings)


def add_files(folder: Path, names: Sequence[str]) -> None:
    """Adds `names` to the files listed in the result in `folder`, so that the next run there replaces them too."""
    result = read_json(folder / RESULT)
    result["files"] = sorted({*result.get("files", ()), *names})
    with io.atomic_path(folder / RESULT) as temporary:
        write_json(temporary, result)


def to_bytes(picture: Float[HostArray, "h w 3"]) -> UInt8[HostArray, "h w 3"]:
    """An image of values from 0 to 1 in 8 bits per channel, as stored in `arrays.npz`."""
    return np.rint(picture * 255).astype(np.uint8)


def _existing(folder: Path, name: str) -> Path:
    if not (folder / name).is_file():
        raise io.FileError(f"{folder} holds an incomplete run: it has no {name}; expected all files: run it again")
    return folder / name


def _check_same(folder: Path, result: Mapping[str, Any], config: Config) -> None:
    """Checks that result and configuration belong to the same run."""
    named = {}
    if config.fit.views is None and config.fit.validation is None:
        lights = [".".join(map(str, ("scene", *key))) for key in config.scene.each_light]
        named["lights"] = lights, [light["light"] for light in result["metrics"]["lights"]]
    if result["kind"] == "fit":
        named["parameters"] = list(config.fit.parameters), list(result["fitted"])
    for what, (ours, theirs) in named.items():
        if ours != theirs:
            raise io.FileError(
                f"{folder} holds files of different runs: {CONFIG} has the {what} {', '.join(ours)}, and {RESULT} has "
                f"{', '.join(theirs)}; expected the same: run it again"
            )


def _layouts(result: Mapping[str, Any], config: Config | None) -> dict[str, io.ArrayLayout]:
    """The layouts of the arrays that reports and figures need."""
    height, width = result["metrics"]["resolution"] if config is None else config.scene.camera.resolution
    lights = len(result["metrics"]["lights"])
    images = (height, width) if lights == 1 else (lights, height, width)
    states = [name for _, name in KINDS[result["kind"]]]
    layouts = {
        **dict.fromkeys(("reference", *states), io.ArrayLayout("f", images, bytes=4)),
        "mask": io.ArrayLayout("b", images),
        **{
            f"shaded_{name}": io.ArrayLayout("u", (height, width, 3), required=False, bytes=1)
            for name in ("reference", *states)
        },
    }
    if result["kind"] == "fit":
        layouts |= {
            "history_phase": io.ArrayLayout("iu", (None,)),
            "history_start": io.ArrayLayout("iu", (None,), required=False),
            "history_loss": io.ArrayLayout("f", (None,), bytes=4),
            "history_values": io.ArrayLayout("f", (None, len(result["fitted"]))),
        }
    return layouts


def _check_values(file: Path, result: Mapping[str, Any], arrays: Mapping[str, HostArray]) -> None:
    """Checks the values of the arrays."""
    for name in ("reference", *(name for _, name in KINDS[result["kind"]])):
        low, high = float(arrays[name].min()), float(arrays[name].max())
        # Written so that NaN fails.
        if not (low >= -SLACK and high <= 1 + SLACK):
            raise _damaged(file, f"the array {name} holds values from {low:g} to {high:g}; expected 0 to 1")
    counted, pixels = int(arrays["mask"].sum()), result["metrics"]["pixels"]
    if counted != pixels:
        raise _damaged(file, f"{counted:,} pixels count in the array mask; expected the {pixels:,} of {RESULT}")
    if result["kind"] == "fit":
        lengths = {name: len(array) for name, array in arrays.items() if name.startswith("history_")}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise _damaged(file, f"the arrays differ in length: {listed}; expected equal lengths")
        phases = len(result["solver"]["phases"])
        if not ((arrays["history_phase"] >= 0) & (arrays["history_phase"] < phases)).all():
            message = f"the array history_phase has phases that {RESULT} does not list; expected 0 to {phases - 1}"
            raise _damaged(file, message)


def _errors_key(kind: str, name: str) -> str:
    return "errors" if kind == "render" else name


def _damaged(file: Path, reason: str) -> io.FileError:
    return io.FileError(f"{file} is damaged: {reason}: run it again")
