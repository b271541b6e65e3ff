"""Pictures of a shape for animations."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ... import geometry, raster
from ..._arithmetic import as_float
from ..._pictures import lit
from ..._types import HostArray

Frames = Float[HostArray, "n h w 3"]
# Pixels along a side, and rays along a pixel's.
_SIDE, _FINE = 224, 2
_FRAMES = 48
_ELEVATION = 20.0
# Of the sphere round the shape.
_MARGIN = 1.05
_ALBEDO = np.array([0.86, 0.62, 0.38])
# Of faces that are seen from behind, so that a fold or a hole shows.
_BEHIND = np.array([0.30, 0.47, 0.80])
_BACKGROUND = 0.97


def turntable(mesh: geometry.Mesh) -> Frames:
    """The mesh from all sides."""
    return _frames([mesh] * _FRAMES, 360 / _FRAMES)


def progress(steps: Sequence[tuple[HostArray, HostArray]]) -> Frames:
    """Vertices and faces at several steps, as the camera turns a little. The last frame is shown for a while."""
    meshes = [geometry.Mesh(vertices, faces) for vertices, faces in steps]
    frames = _frames(meshes, 120 / len(meshes))
    return np.concatenate([frames, np.repeat(frames[-1:], 8, axis=0)])


def _frames(meshes: Sequence[geometry.Mesh], turn: float) -> Frames:
    """One mesh to a frame, between which the camera turns by so many degrees."""
    every = np.concatenate([np.asarray(mesh.bounds) for mesh in meshes])
    low, high = every.min(axis=0), every.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 * _MARGIN

    frames = []
    for number, mesh in enumerate(meshes):
        eye = geometry.orbit_eye(as_float(middle), 3 * radius, 30 + number * turn, _ELEVATION)
        camera = geometry.OrthographicCamera(
            eye, as_float(middle), height=2 * radius, near=radius, far=5 * radius, resolution=(_FINE * _SIDE,) * 2
        )
        seen = raster.draw_surface(mesh, camera)
        towards = np.asarray(eye) - middle + 0.6 * radius * np.array([0.0, 3.0, 0.0])
        outwards = _outward_normals(mesh)[np.asarray(seen.face)]
        behind = outwards @ (np.asarray(eye) - middle) < 0
        colours = lit(np.asarray(seen.normal), towards, np.where(behind[..., None], _BEHIND, _ALBEDO))
        image = np.where(np.asarray(seen.mask)[..., None], colours, _BACKGROUND)
        frames.append(image.reshape(_SIDE, _FINE, _SIDE, _FINE, 3).mean(axis=(1, 3)))
    return np.stack(frames)


def _outward_normals(mesh: geometry.Mesh) -> Float[HostArray, "f 3"]:
    """The normals of faces, turned outwards all together if the mesh is wound inwards."""
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    normals = np.cross(b - a, c - a)
    # The sum is six times the volume inside.
    return normals if np.einsum("ij,ij->", a, normals) >= 0 else -normals
