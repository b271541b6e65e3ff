"""A run as its folder holds it: what reports, comparisons and figures are made of."""

import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from .. import io
from .._types import HostArray
from ..config import Config, Row, describe, load_config
from ._run_folder import RESULT

ARRAYS, CONFIG, REPORT = "arrays.npz", "config.yaml", "report.html"
KINDS = {"fit": (("Before", "before"), ("After", "after")), "render": (("Visibility", "visibility"),)}
"""The images of each kind of run: their titles, and the arrays that hold them."""
SWEEP = "sweep"
"""The kind of a folder that holds many runs."""


class LightImages(NamedTuple):
    """What a run made of one light.

    - `key`: of the light, such as `"scene.light"`; `end`: what tells its files from other lights'.
    - `images`: title and visibility (h, w) of each state, the result last; `errors`: of each, by name.
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

    - `folder`: that holds it.
    - `result`: as in `result.json`; `arrays`: as in `arrays.npz`; `settings`: every one, with its unit.
    """

    folder: Path
    result: Mapping[str, Any]
    arrays: Mapping[str, HostArray]
    settings: Sequence[Row]

    @property
    def name(self) -> str:
        """As the configuration has it."""
        return self.result["name"]

    @property
    def kind(self) -> str:
        """`"fit"` or `"render"`."""
        return self.result["kind"]

    @property
    def errors(self) -> list[tuple[str, Mapping[str, float | None]]]:
        """Title and errors, over all lights, of each state, the result last."""
        measured = self.result["metrics"]
        return [(title, measured[_errors_key(self.kind, name)]) for title, name in KINDS[self.kind]]

    @property
    def lights(self) -> list[LightImages]:
        """The images, light by light."""
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
    def shaded(self) -> list[tuple[str, HostArray]]:
        """Title and sRGB picture (h, w, 3) of the reference and each state under all lights, the result last."""
        names = [("Reference", "reference"), *KINDS[self.kind]]
        return [(title, self.arrays[f"shaded_{name}"]) for title, name in names if f"shaded_{name}" in self.arrays]


def read_run(folder: Path) -> StoredRun:
    """The run in `folder`.

    **Raises** `FileError` if there is no folder, or it holds no finished fit or render, or only a part of one.
    """
    result = read_result(folder)
    if result["kind"] not in KINDS:
        raise io.FileError(f"{folder} holds a {result['kind']}; expected the folder of a {' or a '.join(KINDS)}")
    settings = describe(load_config(_existing(folder, CONFIG), []))
    file = _existing(folder, ARRAYS)
    try:
        # Opened here, for `np.load` leaves a damaged file open.
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        run = StoredRun(folder, result, arrays, settings)
        _check(run)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, LookupError, TypeError) as error:
        raise _damaged(f"{file} or {RESULT}", f"{type(error).__name__}: {error}") from error
    return run


def read_result(folder: Path) -> Mapping[str, Any]:
    """What `result.json` in `folder` holds.

    **Raises** `FileError` if there is none, or it is not that of a fit, a render or a sweep.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise io.FileError(f"{folder} {what}; expected the folder of a finished run, such as runs/quickstart")
    file = folder / RESULT
    if not file.is_file():
        raise io.FileError(f"{folder} holds no run: it has no {RESULT}; expected the folder of a finished run")
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise _damaged(str(file), str(error)) from error
    kind = result.get("kind") if isinstance(result, dict) else None
    if kind not in (*KINDS, SWEEP):
        raise io.FileError(
            f"{file} is of no fit, render or sweep; expected one of them: of the runs inside a sweep only numbers are "
            "kept, unless sweep.figures is true"
        )
    return result


def stored(folder: Path, result: Mapping[str, Any], arrays: Mapping[str, Any], config: Config) -> StoredRun:
    """The run that `folder` is about to hold."""
    return StoredRun(folder, result, {name: np.asarray(array) for name, array in arrays.items()}, describe(config))


def add_files(run: StoredRun, names: Sequence[str]) -> None:
    """Has the result of `run` name more files as its own, so that its next run replaces them with the others."""
    result = {**run.result, "files": sorted({*run.result.get("files", ()), *names})}
    with io.atomic_path(run.folder / RESULT) as temporary:
        temporary.write_text(
            json.dumps(result, indent=2, ensure_ascii=False) + "\n", encoding="utf-8", errors="backslashreplace"
        )


def to_bytes(picture: Float[HostArray, "h w 3"]) -> UInt8[HostArray, "h w 3"]:
    """A picture of values from 0 to 1 with 8 bits a channel, as `arrays.npz` keeps it."""
    return np.rint(picture * 255).astype(np.uint8)


def _existing(folder: Path, name: str) -> Path:
    if not (folder / name).is_file():
        raise io.FileError(f"{folder} holds only a part of a run: it has no {name}; expected all files: run it again")
    return folder / name


def _check(run: StoredRun) -> None:
    """Looks at everything once, so that nothing is found missing later."""
    errors = [dict(measured) for _, measured in run.errors]
    for light in run.lights:
        errors += [dict(measured) for measured in light.errors]
        for _, image in [("", light.mask), *light.images]:
            if image.shape != light.reference.shape or image.ndim != 2:
                raise ValueError(f"images of the shapes {image.shape} and {light.reference.shape}")
    if any("rmse" not in measured for measured in errors):
        raise KeyError("rmse")


def _errors_key(kind: str, name: str) -> str:
    return "errors" if kind == "render" else name


def _damaged(what: str, reason: str) -> io.FileError:
    return io.FileError(f"{what} is damaged ({reason}); expected what a run wrote: run it again")
