"""Meshes from files."""

import contextlib
import io
import logging
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.load import mesh_formats

from ..geometry import Mesh, crease_normals, weld
from ._errors import FileError, MeshError, MeshWarning, damaged
from ._gltf import Prepared
from ._obj import read_obj
from ._off import read_off
from ._paths import existing_file
from ._ply import read_ply
from ._polygons import Polygons, triangulate

# What trimesh calls the variants of a format that have no suffix of their own.
_NO_SUFFIX = {"stl_ascii"}
# Coordinates beyond this are infinite in single precision.
_MOST = float(np.finfo(np.float32).max)


def load_mesh(path: str | os.PathLike[str], crease_angle: float | int = 30.0) -> Mesh:
    """The triangles of a mesh file, such as OBJ, PLY, STL, OFF, GLB or glTF.

    A file with several objects gives one mesh of all of them, each where its node puts it. Vertices at the same
    place are welded (files split them at texture seams), and polygons are cut into triangles, concave ones too.
    Colours, materials and skins are left aside.

    **Arguments:**

    - `path`: the file; its suffix names the format. Text may be of any encoding.
    - `crease_angle`: degrees; an edge bent by more is shaded sharp. The file's own normals are not used.

    **Returns:** the mesh in the file's own units and axes; `fit_to_size` and `drop_to_ground` bring it to a scene's.

    **Warns** with `MeshWarning` if the file holds something else beside its triangles, such as lines.

    **Raises** `FileError` if the file is missing, of an unknown format or damaged, needs an extension of its format
    that is not read, has a polygon that crosses itself, or holds no triangles or vertices that are not finite.
    """
    file = existing_file(path, "mesh")
    try:
        polygons = _read(file)
        _check(polygons)
        vertices, faces = weld(polygons.vertices, triangulate(polygons))
    except MeshError as fault:
        raise FileError(f"the mesh file {file} {fault}") from fault
    if len(faces) == 0:
        raise FileError(f"every triangle of the mesh file {file} has two corners in one place; check its export")
    left_out = _left_out(polygons)
    if left_out:
        warnings.warn(MeshWarning(f"the mesh file {file} is loaded without its {left_out}"), stacklevel=2)
    return Mesh(vertices, faces, crease_normals(vertices, faces, crease_angle))


def _read(file: Path) -> Polygons:
    suffix, known = file.suffix.lower(), sorted(f".{name}" for name in set(mesh_formats()) - _NO_SUFFIX)
    if suffix not in known:
        raise FileError(
            f"cannot read the mesh file {file}: its suffix is {file.suffix!r}; "
            f"expected one of {', '.join(known)}: convert it"
        )
    try:
        return _READERS.get(suffix, _by_trimesh)(file)
    except OSError as error:
        raise FileError(f"cannot read the mesh file {file}: {error.strerror or error}; check it") from error
    except MeshError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their parsing trips over
        raise damaged(_reason(error)) from error


def _reason(error: Exception) -> str:
    """Why a library could not read a file, in words."""
    text = " ".join(str(error).split())
    match error:
        case KeyError():
            return f"it lacks {text}"
        case AssertionError() | AttributeError() | IndexError() | TypeError():
            return "its parts do not fit together"
    return text or type(error).__name__


def _gltf(file: Path) -> Polygons:
    prepared = Prepared(file)
    options: dict[str, Any] = {"file_type": "gltf", "skip_materials": True}
    return _polygons(_load(io.BytesIO(prepared.json), **options), prepared.left_out)


def _by_trimesh(file: Path) -> Polygons:
    return _polygons(_load(file))


def _load(source: Path | io.BytesIO, **options: Any) -> trimesh.Scene:
    """**Raises** `MeshError` if trimesh logs a warning: something is not as the file means it."""
    with _logged("trimesh") as warned:
        scene = trimesh.load_scene(source, process=False, **options)
    if warned:
        raise damaged(" ".join(warned[0].split()))
    return scene


@contextlib.contextmanager
def _logged(name: str) -> Iterator[list[str]]:
    """The warnings that the logger `name` is given inside, which are not printed."""
    messages: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: messages.append(record.getMessage())
    logger = logging.getLogger(name)
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield messages
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


def _polygons(scene: trimesh.Scene, left_out: Mapping[str, int] | None = None) -> Polygons:
    """All triangles of the scene in world space."""
    counts = dict(left_out or {})
    all_vertices, all_faces, start = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for node in scene.graph.nodes_geometry:
        to_world, name = scene.graph[node]
        geometry = scene.geometry[name]
        vertices = np.asarray(geometry.vertices, np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(geometry, "faces", np.zeros((0, 3))), np.int64)
        if len(faces) == 0 and len(vertices):
            counts["point"] = counts.get("point", 0) + len(vertices)
            continue
        # A mirroring node turns the triangles inside out.
        mirrored = np.linalg.det(to_world[:3, :3]) < 0
        with np.errstate(invalid="ignore", over="ignore"):  # infinite vertices are refused later, with their number
            all_vertices.append(vertices @ to_world[:3, :3].T + to_world[:3, 3])
        _check_indices(faces.reshape(-1), len(vertices), 3)
        all_faces.append((faces[:, ::-1] if mirrored else faces) + start)
        start += len(vertices)
    faces = np.concatenate(all_faces)
    return Polygons(np.concatenate(all_vertices), faces.reshape(-1), np.full(len(faces), 3), counts)


_READERS: Mapping[str, Callable[[Path], Polygons]] = {
    ".glb": _gltf,
    ".gltf": _gltf,
    # These may hold polygons, which trimesh cuts as if they were convex.
    ".obj": lambda file: read_obj(file.read_bytes()),
    ".off": lambda file: read_off(file.read_bytes()),
    ".ply": read_ply,
}


def _check(polygons: Polygons) -> None:
    """**Raises** `MeshError` if there are no faces, or one of them has a vertex that cannot be."""
    vertices, corners, sizes, _ = polygons
    if not (sizes >= 3).any():
        found = _left_out(polygons) or (f"{len(vertices)} points" if len(vertices) else "")
        raise MeshError(
            f"holds {f'{found} but ' if found else ''}no triangles; expected at least one triangle: check its export"
        )
    _check_indices(corners, len(vertices), sizes)
    bad = np.unique(corners[~(np.abs(vertices) <= _MOST).all(axis=-1)[corners]])
    if len(bad):
        raise damaged(
            f"{len(bad)} of the {len(vertices)} vertices are NaN or infinite in single precision "
            f"(the first is vertex {bad[0]})"
        )


def _check_indices(corners: Any, count: int, sizes: Any) -> None:
    unknown = np.flatnonzero((corners < 0) | (corners >= count))
    if len(unknown):
        ends = np.cumsum(np.broadcast_to(sizes, len(corners) // 3) if np.ndim(sizes) == 0 else sizes)
        face = int(np.searchsorted(ends, unknown[0], side="right"))
        raise damaged(f"face {face + 1} names vertex {corners[unknown[0]]}; expected 0 to {count - 1}")


def _left_out(polygons: Polygons) -> str:
    """What the file holds beside faces, in words; empty if nothing."""
    counts = {**polygons.left_out, "face of fewer than three corners": int((polygons.sizes < 3).sum())}
    words = [f"{count} {name if count == 1 else _plural(name)}" for name, count in counts.items() if count]
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def _plural(name: str) -> str:
    first, of, rest = name.partition(" of ")
    return f"{first}s{of}{rest}"
