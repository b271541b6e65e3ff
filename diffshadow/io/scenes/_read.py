"""Reads a scene's file."""

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._errors import FileError, MeshError
from .._paths import existing_file
from .._text import decode
from ._gltf import read_gltf_scene
from ._parts import SceneFile
from ._three_json import read_three


def read_scene(path: str | os.PathLike[str]) -> SceneFile:
    """Reads a scene: a JSON file of three.js (`scene.toJSON()`, or its editor's), GLB or glTF 2.0.

    The content decides which it is.

    **Raises** `FileError` if the file is missing, damaged, or none of these.
    """
    file = existing_file(path, "scene")
    try:
        data = file.read_bytes()
        # NaN and infinite coordinates are checked after reading.
        with np.errstate(all="ignore"):
            content = None if data.startswith(b"glTF") else _content(data)
            if content is None or "asset" in content:
                return read_gltf_scene(data, file.parent)
            return read_three(content)
    except MeshError as fault:
        raise FileError(f"the scene file {file} {fault}") from fault
    except RecursionError as error:
        raise FileError(f"the scene file {file} is nested too deeply; flatten its groups") from error
    except OSError as error:
        raise FileError(f"cannot read the scene file {file}: {error.strerror or error}") from error


def _content(data: bytes) -> Mapping[str, Any]:
    """**Raises** `MeshError` if `data` is no object of JSON."""
    try:
        content = json.loads(decode(data))
    except ValueError as error:
        raise MeshError(
            f"is neither JSON nor GLB ({error}); expected JSON.stringify(scene.toJSON()) of three.js, or glTF"
        ) from error
    if not isinstance(content, dict):
        raise MeshError("holds a JSON value that is no object; expected what scene.toJSON() of three.js gives, or glTF")
    return content
