"""Remarks on meshes that a picture shows nothing of."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from .. import reference
from .._types import HostArray
from ..config import Casting, Config
from ..geometry import AbstractCamera, Mesh
from ..raster import Surface

# A mesh this many times smaller or larger than all others is likely to be in another unit.
_ANOTHER_UNIT = 100.0
# Twice a triangle's area, as a share of the mesh's extent squared, that rounding alone makes.
_NO_AREA = 1e-6


def idle_meshes(config: Config, casting: Casting, surface: Surface) -> Iterator[str]:
    """A sentence, with its likely cause, for each mesh that covers no pixel and casts no shadow into the picture.

    **Arguments:**

    - `surface`: the scene as its camera sees it.
    """
    number = np.repeat(np.arange(len(casting.meshes)), [mesh.faces.shape[0] for mesh in casting.meshes])
    face, mask = np.asarray(surface.face), np.asarray(surface.mask)
    visible = set(number[face[mask]].tolist())
    for i, section in enumerate(config.scene.meshes):
        if i not in visible and not reference.hides_light(casting.scene, number == i):
            corners = [_corners(mesh) for mesh in casting.meshes]
            cause = _cause(corners.pop(i), corners, casting.scene.camera, is_sized=section.size is not None)
            yield f"scene.meshes.{i} ({section.path}) covers no pixel and casts no shadow into the picture: {cause}"


def _cause(
    corners: Float[HostArray, "f 3 3"],
    others: Sequence[Float[HostArray, "_ 3 3"]],
    camera: AbstractCamera,
    *,
    is_sized: bool,
) -> str:
    a, b, c = np.moveaxis(corners, 1, 0)
    extent = _extent(corners)
    if (np.linalg.norm(np.cross(b - a, c - a), axis=-1) <= _NO_AREA * extent**2).all():
        return "its triangles have no area; check its export"
    rest = max(map(_extent, others), default=0.0)
    if rest and not 1 / _ANOTHER_UNIT < extent / rest < _ANOTHER_UNIT:
        mend = "change its size or scale" if is_sized else "its file may be in another unit, so set its size"
        return f"it spans {extent:.3g} world units and the largest of the others {rest:.3g}; {mend}"
    world_to_eye = np.asarray(camera.view().world_to_eye, np.float64)
    if (corners @ world_to_eye[2, :3] + world_to_eye[2, 3] >= 0).all():
        return "it lies behind the camera; move it, or turn the camera"
    return "it lies outside the picture or behind other meshes; move it, or remove it"


def _corners(mesh: Mesh) -> Float[HostArray, "f 3 3"]:
    return np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]


def _extent(corners: Float[HostArray, "f 3 3"]) -> float:
    """The diagonal of the box that holds all corners, in world units."""
    return float(np.linalg.norm(np.ptp(corners, axis=(0, 1))))
