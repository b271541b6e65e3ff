"""Places the meshes of a configuration in the world."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ... import geometry, io
from ..._types import Faces, HostArray
from ...settings.quantities import FARTHEST
from ..sections._scene import TEXTURE_KEYS, MeshConfig

Triple = tuple[float, float, float]


class Placed(NamedTuple):
    """The arrays of a mesh, placed in the world: vertices (v, 3) in double precision, faces, the normals of their
    corners, albedo, and colours of corners and textures, if it has any."""

    vertices: Float[HostArray, "v 3"]
    faces: Faces
    corner_normals: Float[HostArray, "f 3 3"]
    albedo: Float[HostArray, "*f 3"]
    corner_colours: Any = None
    textures: geometry.Textures | None = None

    def counted_from(self, origin: geometry.Origin) -> geometry.Mesh:
        """The mesh with coordinates relative to `origin`, so that single precision suffices."""
        return geometry.Mesh(self.vertices - np.asarray(origin), *self[1:])

    @property
    def bounds(self) -> Float[HostArray, "2 3"]:
        """The minimum and maximum coordinates of the vertices that faces use, (2, 3), in double precision."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(axis=0), used.max(axis=0)])


def build_mesh(config: MeshConfig) -> geometry.Mesh:
    """One mesh, placed in the world.

    **Raises** `ValueError` if its file cannot be used, its options are not valid, or its coordinates are too large.
    """
    return place_mesh(config).counted_from(geometry.WORLD)


def place_mesh(config: MeshConfig) -> Placed:
    """`build_mesh` in double precision."""
    # NumPy, so that nothing is compiled.
    with jax.enable_x64(True):
        if config.builtin is not None:
            mesh, albedo = geometry.library_mesh(config.builtin, **config.options), config.albedo
        else:
            crease_angle = config.crease_angle if config.normals == "creases" else None
            looks = {key: getattr(config, key) for key in TEXTURE_KEYS}
            mesh = io.load_mesh(config.path, crease_angle, albedo=config.albedo, **looks)
            albedo = mesh.albedo
        if config.size is not None:
            mesh = geometry.fit_to_size(mesh, config.size)
        if config.drop_to_ground:
            mesh = geometry.drop_to_ground(mesh)
        return _placed(mesh, config.scale, config.rotate, config.translate, albedo)


def _placed(mesh: geometry.Mesh, scale: float, rotate: Triple, translate: Triple, albedo: Any) -> Placed:
    """The mesh scaled, then rotated about x, y and z in this order by `rotate` degrees, then translated.

    Equals `Mesh.transformed`, but in NumPy and in double precision, because a program would be compiled for every size
    of mesh.

    **Raises** `ValueError` if it extends too far.
    """
    turn = np.eye(3)
    for axis, angle in enumerate(np.radians(rotate)):
        cosine, sine = np.cos(angle), np.sin(angle)
        about_z = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        # The axes that follow this one, in the order of a rotation about it.
        turn = np.roll(about_z, axis + 1, axis=(0, 1)) @ turn
    vertices = np.asarray(mesh.vertices, np.float64) @ turn.T * scale + np.asarray(translate)
    reach = float(np.abs(vertices).max())
    if not reach <= FARTHEST:
        raise ValueError(
            f"reaches {reach:.3g} world units from the origin; expected at most {FARTHEST:g}; give it a size, or a "
            "smaller scale"
        )
    normals = np.asarray(mesh.corner_normals, np.float64) @ turn.T
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = (normals / np.where(length > 0, length, 1)).astype(np.float32)
    return Placed(vertices, mesh.faces, normals, np.asarray(albedo), mesh.corner_colours, mesh.textures)
