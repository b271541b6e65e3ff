"""Meshes from files."""

import os
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int
from trimesh.exchange.load import mesh_formats

from .._types import HostArray
from ..geometry import Mesh, crease_normals, weld
from ._errors import FileError
from ._paths import existing_file

# What trimesh calls the variants of a format that have no suffix of their own.
_NO_SUFFIX = {"stl_ascii"}


def load_mesh(path: str | os.PathLike[str], crease_angle: float | int = 30.0) -> Mesh:
    """The triangles of a mesh file, such as OBJ, PLY, STL, OFF, GLB or glTF.

    A file with several objects gives one mesh of all of them, each where its node puts it. Vertices at the same
    place are welded (files split them at texture seams), polygons are cut into triangles, and colours are left aside.

    **Arguments:**

    - `path`: the file; its suffix names the format.
    - `crease_angle`: degrees; an edge bent by more is shaded sharp. The file's own normals are not used.

    **Returns:** the mesh in the file's own units and axes; `fit_to_size` and `drop_to_ground` bring it to a scene's.

    **Raises** `FileError` if the file is missing, of an unknown format or damaged, or holds no triangles or vertices
    that are not finite.
    """
    file = existing_file(path, "mesh")
    vertices, faces = _triangles(file, _read(file))
    try:
        vertices, faces = weld(vertices, faces)
    except ValueError as error:
        raise FileError(f"the mesh file {file} is damaged: {error}") from error
    if len(faces) == 0:
        raise FileError(f"every triangle of the mesh file {file} has two corners in one place; check its export")
    return Mesh(vertices, faces, crease_normals(vertices, faces, crease_angle))


def _read(file: Path) -> trimesh.Scene:
    known = sorted(set(mesh_formats()) - _NO_SUFFIX)
    if file.suffix.lower().removeprefix(".") not in known:
        raise FileError(
            f"cannot read the mesh file {file}: its suffix is {file.suffix!r}; "
            f"expected one of {', '.join('.' + suffix for suffix in known)}: convert it"
        )
    try:
        return trimesh.load_scene(file, process=False)
    except Exception as error:  # trimesh's readers raise whatever their parsing trips over
        reason = str(error).strip() or type(error).__name__
        raise FileError(
            f"the mesh file {file} is damaged or not of the format that its suffix says ({reason}); export it again"
        ) from error


def _triangles(file: Path, scene: trimesh.Scene) -> tuple[Float[HostArray, "v 3"], Int[HostArray, "f 3"]]:
    """All triangles of the scene in world space, float64."""
    all_vertices, all_faces, start, points = [], [], 0, 0
    for node in scene.graph.nodes_geometry:
        to_world, name = scene.graph[node]
        geometry = scene.geometry[name]
        faces = np.asarray(getattr(geometry, "faces", np.zeros((0, 3))), np.int64)
        if len(faces) == 0:
            points += len(getattr(geometry, "vertices", ()))
            continue
        vertices = np.asarray(geometry.vertices, np.float64)
        _check_indices(file, faces, len(vertices))
        # A mirroring node turns the triangles inside out.
        mirrored = np.linalg.det(to_world[:3, :3]) < 0
        with np.errstate(invalid="ignore"):  # infinite vertices are refused later, with their number
            all_vertices.append(vertices @ to_world[:3, :3].T + to_world[:3, 3])
        all_faces.append((faces[:, ::-1] if mirrored else faces) + start)
        start += len(vertices)
    if not all_faces:
        found = f"{points} points but no triangles" if points else "no triangles"
        raise FileError(f"the mesh file {file} holds {found}; expected at least one triangle: check its export")
    return np.concatenate(all_vertices), np.concatenate(all_faces)


def _check_indices(file: Path, faces: Int[HostArray, "f 3"], count: int) -> None:
    if faces.min() < 0 or faces.max() >= count:
        raise FileError(
            f"the mesh file {file} is damaged: its faces name vertices {faces.min()} to {faces.max()}, "
            f"but it has {count}; export it again"
        )
