"""Remarks on a run's scene: meshes that contribute nothing to the image or leave it, and meshes around lights."""

from collections.abc import Iterator, Sequence

import numpy as np

from ... import reference
from ...config import Config
from ...geometry import AbstractCamera, Mesh, Scene
from ...raster import Surface
from ...shadow import AbstractTechnique
from ._framing import blockers_of, framing_remarks, lights_inside
from ._sides import side_remarks
from ._sight import size_of

# A mesh this many times smaller or larger than all others is likely to be in another unit.
_ANOTHER_UNIT = 100.0
# Rounding error of twice a triangle's area, as a fraction of the mesh's extent squared.
_NO_AREA = 1e-6


def scene_remarks(
    config: Config, technique: AbstractTechnique, lit: Sequence[Scene], surface: Surface
) -> Iterator[str]:
    """A sentence, with the likely cause, for each mesh that covers no pixel and casts no shadow into the image, for one
    that is mostly outside of it, for each mesh around a light that hides all of it, and for each open mesh that loses
    its shadow by the technique's choice of sides.

    **Arguments:**

    - `lit`: the scene with each light alone.
    - `surface`: the scene as its camera sees it.
    """
    meshes = lit[0].meshes
    number = np.repeat(np.arange(len(meshes)), [mesh.faces.shape[0] for mesh in meshes])
    face, mask = np.asarray(surface.face), np.asarray(surface.mask)
    visible = set(number[face[mask]].tolist())
    blockers = blockers_of(config)
    for i, section in enumerate(config.scene.meshes):
        if i not in visible and not any(reference.hides_light(each, number == i, blockers) for each in lit):
            others = [mesh for k, mesh in enumerate(meshes) if k != i]
            cause = _cause(meshes[i], others, lit[0].camera, is_sized=section.size is not None)
            yield f"scene.meshes.{i} ({section.path}) covers no pixel and casts no shadow into the image: {cause}"
    yield from framing_remarks(config, lit[0], surface)
    for cause, mend in lights_inside(config, lit, surface):
        yield f"{cause}: {mend}"
    yield from side_remarks(config, technique, lit)


def _cause(mesh: Mesh, others: Sequence[Mesh], camera: AbstractCamera, *, is_sized: bool) -> str:
    corners, extent = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)], size_of(mesh)
    a, b, c = np.moveaxis(corners, 1, 0)
    if (np.linalg.norm(np.cross(b - a, c - a), axis=-1) <= _NO_AREA * extent**2).all():
        return "its triangles have no area; check its export"
    rest = max(map(size_of, others), default=0.0)
    if rest and not 1 / _ANOTHER_UNIT < extent / rest < _ANOTHER_UNIT:
        mend = "change its size or scale" if is_sized else "its file may be in another unit, so set its size"
        return f"it spans {extent:.3g} world units and the largest of the others {rest:.3g}; {mend}"
    world_to_eye = np.asarray(camera.view().world_to_eye, np.float64)
    if (corners @ world_to_eye[2, :3] + world_to_eye[2, 3] >= 0).all():
        return "it is behind the camera; move it, or turn the camera"
    return "it is outside the image or behind other meshes; move it, or remove it"
