"""Pictures that engines drew. `golden/README.md` says how they were made."""

import functools
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

FOLDER = Path(__file__).parent / "engines"
ENGINES = ("three", "babylon", "playcanvas", "godot", "bevy")
# A visibility is stored as a whole number of these.
VISIBILITY_STEPS = 65535


class EngineGolden(NamedTuple):
    """A picture and what the engine drew it from.

    - `settings`: the job of `experiments/engines/engines.py`: light, camera, and for each of `meshes` its `vertices`,
      `normals` and `faces` and the engine's own settings.
    - `info`: matrices as flat lists of 16 with `clip = [x, y, z, 1] @ list.reshape(4, 4)`; near and far as used.
    - `arrays`: `visibility` (h, w), float32 in steps of 1/65535; `mesh` (h, w), index of what is seen, -1 for none;
      `position` and `normal` (h, w, 3), float32, as the engine interpolated them; `map`, and what its technique makes
      of it. All with their bottom row first. Of Godot, in place of all but the map, `picture` (h, w), uint8, in sRGB,
      and under spot and point lights `unshadowed`, the same without shadows.
    """

    name: str
    engine: str
    settings: dict[str, Any]
    info: dict[str, Any]
    arrays: dict[str, np.ndarray]


def engine_goldens(engine: str) -> list[str]:
    """The names of the pictures by one of `ENGINES`."""
    return list(_index(engine)["cases"])


@functools.cache
def engine_golden(engine: str, name: str) -> EngineGolden:
    index = _index(engine)
    case = index["cases"][name]
    settings = {**case["settings"], "meshes": [_mesh(mesh) for mesh in case["settings"]["meshes"]]}
    with np.load(FOLDER / f"{engine}.npz") as stored:
        arrays = {key: unpack(stored[entry]) for key, entry in case["arrays"].items()}
    if "visibility" in arrays:
        arrays["visibility"] = arrays["visibility"].astype(np.float32) / np.float32(VISIBILITY_STEPS)
        arrays["mesh"] = arrays["mesh"].astype(np.int32)
    return EngineGolden(name, engine, settings, case["info"], arrays)


@functools.cache
def _index(engine: str) -> dict[str, Any]:
    return json.loads((FOLDER / f"{engine}.json").read_text())


def _mesh(settings: dict[str, Any]) -> dict[str, Any]:
    name = settings["mesh"]
    with np.load(FOLDER / "geometry.npz") as stored:
        arrays = {key: stored[f"{name}_{key}"] for key in ("vertices", "normals", "faces")}
    return {**arrays, **settings, **({"normals": None} if settings.get("normals", True) is None else {})}


# Floats are stored as the differences of their bits, column to column and row to row, split into planes of bytes:
# lossless, and half the size for smooth images.
def pack(array: np.ndarray) -> np.ndarray:
    if array.dtype != np.float32:
        return array
    bits = array.view(np.uint32)
    # Columns and rows come last, so that each channel and each face is by itself.
    bits = np.moveaxis(bits, -1, 0) if _has_channels(array.shape) else bits
    for axis in (-1, -2):
        bits = np.diff(bits, axis=axis, prepend=np.uint32(0))
    return np.moveaxis(np.ascontiguousarray(bits)[..., None].view(np.uint8), -1, 0)


def unpack(stored: np.ndarray) -> np.ndarray:
    if stored.dtype != np.uint8 or stored.ndim < 3:
        return stored.astype(np.float32) if stored.dtype == np.float16 else stored
    bits = np.ascontiguousarray(np.moveaxis(stored, 0, -1)).view(np.uint32)[..., 0]
    for axis in (-2, -1):
        bits = np.cumsum(bits, axis=axis, dtype=np.uint32)
    bits = np.moveaxis(bits, 0, -1) if bits.ndim == 3 and bits.shape[0] <= 4 else bits
    return np.ascontiguousarray(bits).view(np.float32)


def _has_channels(shape: tuple[int, ...]) -> bool:
    return len(shape) == 3 and shape[-1] <= 4
