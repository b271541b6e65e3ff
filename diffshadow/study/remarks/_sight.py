"""Error messages for a camera or a light that sees nothing, with the likely cause."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ... import geometry, raster
from ..._arithmetic import as_float
from ..._types import HostArray
from ...config import Config

# A point is inside a mesh if the mesh covers more than this fraction of the sphere of directions. A closed mesh covers
# all of it from inside; an open mesh covers no more than half from nearby.
_INSIDE = 0.75
# Single precision has seven digits.
_MIN_RATIO = 1e-6
_NO_DEPTHS = "single precision cannot distinguish depths between its near and far"
_NO_POINTS = (
    "none is within its frustum, because single precision cannot distinguish points at this distance",
    "move it nearer",
)
# Triangles per batch.
_SOME = 1 << 18


def blind_camera(config: Config, scene: geometry.Scene, surface: raster.Surface) -> str | None:
    """The error message for a camera that sees no surface at any pixel's centre; `None` if it sees one."""
    if np.asarray(surface.mask).any():
        return None
    camera = scene.camera
    eye, target = np.asarray(camera.eye, np.float64), np.asarray(camera.target, np.float64)
    near, far, looks = float(camera.near), float(camera.far), float(np.linalg.norm(target - eye))
    inside = _mesh_around(config, scene, eye)
    if inside is not None:
        cause, mend = f"its eye is inside {inside}", "move the eye out of it"
    elif _has_no_depths(camera.view()):
        cause, mend = _NO_DEPTHS, "set near and far, or move the eye nearer"
    elif not near <= looks <= far:
        cause = f"its target is {looks:.3g} world units away"
        mend = "set near and far, or check the sizes and positions of the meshes"
    else:
        cause = "no triangle covers one"
        mend = "change its target, narrow its view, move it nearer, or raise the resolution"
    return (
        f"sees no surface at any pixel's centre: {cause}; its near is {near:.3g}, its far is {far:.3g}, and the "
        f"scene's size is {size_of(scene.mesh):.3g} world units; expected a part of the scene in sight; {mend}"
    )


def blind_light(config: Config, scene: geometry.Scene, surface: raster.Surface) -> str:
    """The error message for the only light of `scene`, if its frustum contains nothing that the camera sees."""
    light, points = scene.light, np.asarray(surface.position)[np.asarray(surface.mask)]
    cause, mend = _most_are(config, scene, points)
    position = getattr(light, "position", None)
    inside = None if position is None else _mesh_around(config, scene, np.asarray(position, np.float64), scene.casts)
    if inside is not None:
        cause, mend = f"{cause}, and it is inside {inside}", f"move it out of that mesh, {mend}"
    view = light.view()
    return (
        f"and the camera see no common surface: of {len(points):,} pixels with a surface, {cause}; the light's near "
        f"is {float(view.near):.3g}, its far is {float(view.far):.3g}, and the scene's size is "
        f"{size_of(scene.mesh):.3g} world units; expected a surface that both see; {mend}, or turn the camera"
    )


def _most_are(config: Config, scene: geometry.Scene, points: Float[HostArray, "n 3"]) -> tuple[str, str]:
    """The position of most of `points`, which are all outside the light's frustum, and how to get them inside."""
    light = scene.light
    if _has_no_depths(light.view()):
        return f"none is within its frustum, because {_NO_DEPTHS}", "set its near and far, or move it nearer"
    position = getattr(light, "position", None)
    if position is not None and np.spacing(np.abs(points - np.asarray(position)).max()) > size_of(scene.mesh):
        return _NO_POINTS
    layer = light.layer(as_float(points))
    view = light.view().facing(layer)
    x, y, z, w = np.moveaxis(np.asarray(view.clip(as_float(points)), np.float64), -1, 0)
    behind = w <= 0
    beyond = ~behind & (z > w)
    beside = ~(behind | beyond) & (np.maximum(np.abs(x), np.abs(y)) > w)
    widen = "set its frame to scene" if light.is_directional else "change its target, widen its outer_angle"
    cases = [
        (behind, "{:,} are behind it", "change its target"),
        (beyond, "{:,} are beyond its far", "raise its far"),
        (beside, "{:,} are to the side of its frustum", widen),
    ]
    which, cause, mend = max(cases, key=lambda case: int(case[0].sum()))
    if not which.any():
        if offset := config.bias.normal_offset:
            return f"a normal_offset of {offset:g} texels moves all out of its frustum", "lower bias.normal_offset"
        return _NO_POINTS
    return cause.format(int(which.sum())), mend


def _has_no_depths(view: geometry.View) -> bool:
    """Whether all depths are equal in single precision: near is too close to far, or to a perspective view's eye."""
    near, far = float(view.near), float(view.far)
    return far - near < _MIN_RATIO * max(abs(near), abs(far)) or (view.is_perspective and near < _MIN_RATIO * far)


def _mesh_around(
    config: Config, scene: geometry.Scene, point: Float[HostArray, "3"], among: Sequence[bool] | None = None
) -> str | None:
    """The key of the first mesh that contains `point`, of all meshes or of `among`."""
    for i, mesh in enumerate(scene.meshes):
        if (among is None or among[i]) and is_inside(mesh, point):
            return f"scene.meshes.{i} ({config.scene.meshes[i].path})"
    return None


def is_inside(mesh: geometry.Mesh, point: Float[HostArray, "3"]) -> bool:
    """Whether `point` is inside the mesh."""
    low, high = np.asarray(mesh.bounds, np.float64)
    return bool(((low <= point) & (point <= high)).all()) and abs(_winding_number(mesh, point)) > _INSIDE


def _winding_number(mesh: geometry.Mesh, point: Float[HostArray, "3"]) -> float:
    """The winding number of the mesh around `point`: the sum of its triangles' solid angles over 4π.

    tan(Ω / 2) = a · (b × c) / (|a| |b| |c| + (a · b) |c| + (b · c) |a| + (c · a) |b|), with a, b, c the vectors to the
    corners (Van Oosterom & Strackee 1983).
    """
    vertices, faces, total = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces), 0.0
    for start in range(0, len(faces), _SOME):
        a, b, c = np.moveaxis(vertices[faces[start : start + _SOME]] - point, 1, 0)
        along = lambda u, v: np.einsum("ij,ij->i", u, v)
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        divisor = la * lb * lc + along(a, b) * lc + along(b, c) * la + along(c, a) * lb
        total += float(np.arctan2(along(a, np.cross(b, c)), divisor).sum())
    return total / (2 * np.pi)


def size_of(mesh: geometry.Mesh) -> float:
    """The diagonal of the mesh's bounding box, world units."""
    low, high = np.asarray(mesh.bounds, np.float64)
    return float(np.linalg.norm(high - low))
