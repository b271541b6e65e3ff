"""Reads a scene's file."""

import json
import os
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._types import HostArray
from ...geometry import NO_TEXTURE, Mesh, up_of, y_up
from ...settings.scene import GLTF_SUFFIXES, MESH_SUFFIXES, NO_MESH_SUFFIXES
from .._errors import FileError, MeshError, MeshWarning
from .._looks import Picture, Texture, levels_of
from .._meshes import load_mesh
from .._paths import existing_file
from .._text import decode
from .._trimesh import suffix_of_others
from ._gltf import read_gltf_scene
from ._parts import SceneFile, SceneMesh
from ._three_json import read_three


def read_scene(path: str | os.PathLike[str]) -> SceneFile:
    """Reads a scene: a JSON file of three.js (from `scene.toJSON()` or its editor), GLB, glTF 2.0, or any mesh file.

    JSON, GLB and glTF are recognised by their content. A mesh file has no camera and no light. It is rotated if its `z`
    is up.

    **Raises** `FileError` if the file is missing, damaged, or none of these.
    """
    file = existing_file(path, "scene")
    if _is_mesh(file):
        return _of_mesh(file)
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


def _is_mesh(file: Path) -> bool:
    """Whether the suffix of `file` belongs to a format for meshes only."""
    suffix = file.suffix.lower()
    if suffix in MESH_SUFFIXES:
        return suffix not in GLTF_SUFFIXES
    return suffix not in NO_MESH_SUFFIXES and suffix_of_others(file) is not None


def _of_mesh(file: Path) -> SceneFile:
    """The scene of a mesh file.

    **Raises** `FileError` if it cannot be read.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshWarning)
        mesh = load_mesh(file)
    remarks = [str(each.message) for each in caught]
    # The corners of a vertex may have several normals.
    faces = np.asarray(mesh.faces)
    corners = np.asarray(mesh.vertices, np.float64)[faces]
    normals = np.asarray(mesh.corner_normals, np.float64)
    if up_of(corners, False) == "z":
        remarks.append("z is up, because the mesh is flat across z; it is rotated so that y is up")
        corners, normals = y_up(corners), y_up(normals)
    return SceneFile([*_by_texture(file.stem, mesh, corners, normals)], [], [], None, remarks)


def _by_texture(
    name: str, mesh: Mesh, corners: Float[HostArray, "f 3 3"], normals: Float[HostArray, "f 3 3"]
) -> Iterator[SceneMesh]:
    """A separate mesh for the faces of each texture, and for the faces without a texture."""
    textures, albedo = mesh.textures, np.asarray(mesh.albedo, np.float64)
    index = np.full(len(corners), NO_TEXTURE) if textures is None else np.asarray(textures.index)
    numbers = np.unique(index).tolist()
    for count, number in enumerate(numbers, start=1):
        of = np.flatnonzero(index == number)
        rows = lambda values, of=of: np.asarray(values, np.float64)[of].reshape(-1, np.shape(values)[-1])
        faces = np.arange(3 * len(of)).reshape(-1, 3)
        part = SceneMesh(name if len(numbers) == 1 else f"{name} {count}", rows(corners), faces, rows(normals))
        if mesh.corner_colours is not None:
            part = part._replace(colours=rows(mesh.corner_colours))
        elif (albedo[of] == albedo[of[0]]).all():
            red, green, blue = albedo[of[0]].tolist()
            part = part._replace(colour=(red, green, blue))
        else:
            part = part._replace(colours=np.repeat(albedo[of], 3, axis=0), colour=(1.0, 1.0, 1.0))
        if textures is not None and number >= 0:
            cutoff = 0.0 if textures.cutoff is None else float(textures.cutoff[number])
            picture = Picture(levels_of(textures.images()[number]))
            texture = Texture(picture, cutoff or None, textures.each_sampler()[number])
            part = part._replace(texture=texture, uv=rows(textures.uv))
        yield part


def _content(data: bytes) -> Mapping[str, Any]:
    """**Raises** `MeshError` if `data` is not a JSON object."""
    try:
        content = json.loads(decode(data))
    except ValueError as error:
        raise MeshError(
            f"is neither JSON nor GLB ({error}); expected JSON.stringify(scene.toJSON()) of three.js, or glTF"
        ) from error
    if not isinstance(content, dict):
        raise MeshError(
            "holds a JSON value that is not an object; expected the result of three.js' scene.toJSON(), or glTF"
        )
    return content
