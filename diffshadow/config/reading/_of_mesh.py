"""Configurations made of a mesh file alone."""

from pathlib import Path
from typing import Any, NamedTuple

from ...settings.scene import GLTF_SUFFIXES, MESH_SUFFIXES, NO_MESH_SUFFIXES
from .._errors import ConfigError, Location, Mistake


class MeshScene(NamedTuple):
    """A section `scene` with a mesh file, its longest side in world units, and notes, each a sentence without a full
    stop."""

    scene: dict[str, Any]
    side: float
    notes: tuple[str, ...]


def is_mesh(file: Path) -> bool:
    """Whether `file` is named like a mesh."""
    suffix = file.suffix.lower()
    if suffix in MESH_SUFFIXES:
        return True
    if suffix in NO_MESH_SUFFIXES or not file.is_file():
        return False
    from ... import io

    return io.suffix_of_others(file) is not None


def scene_of_mesh(file: Path) -> MeshScene:
    """The scene of a mesh file, which is turned if its `z` is up. Camera, light and ground are left to be found.

    **Raises** `ConfigError` if the file cannot be read.
    """
    # They load JAX.
    from ... import geometry, io
    from ..framing._find import corners_of
    from ..sections._scene import MeshConfig

    path = str(file.absolute())
    try:
        io.existing_file(file, "mesh")
        corners = corners_of(MeshConfig(path=path))
    except (ValueError, OSError) as error:
        raise ConfigError([Mistake(Location(str(file)), "", str(error))]) from error
    is_gltf = file.suffix.lower() in GLTF_SUFFIXES
    notes: list[str] = []
    mesh: dict[str, Any] = {"path": path}
    if geometry.up_of(corners, is_gltf) == "z":
        mesh["rotate"] = [-90.0, 0.0, 0.0]
        notes.append(
            "z is taken as up, since the mesh lies flat across z; if y is, set scene.meshes.0.rotate=[0, 0, 0]"
        )
    elif is_gltf and geometry.stands_on_z(corners):
        notes.append(
            "y is taken as up, as glTF says, and the mesh has a flat foot across z; if z is up, set "
            "'scene.meshes.0.rotate=[-90, 0, 0]'"
        )
    if is_gltf and (left_out := _left_out(file)):
        notes.append(f"the file's {left_out} are not taken; to take them: diffshadow import {file}")
    side = float((corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max())
    return MeshScene({"meshes": [mesh], "ground": "auto", "light": "auto"}, side, tuple(notes))


def _left_out(file: Path) -> str:
    """The cameras and lights of a glTF file, in words; empty if it has none."""
    from ... import io

    try:
        scene = io.read_scene(file)
    except io.FileError:
        return ""
    parts = (("cameras", scene.cameras), ("lights", scene.lights))
    return " and ".join(name for name, entries in parts if entries)
