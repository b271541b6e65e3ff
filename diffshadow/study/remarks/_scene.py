"""Remarks on a run's scene: meshes that contribute nothing to the image or extend beyond it, meshes around lights, open
meshes that lose their shadow, and scenes with nothing to compare."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from ... import geometry, reference, shadow
from ..._arithmetic import as_float, dot, normalize
from ..._types import HostArray
from ...config import Config
from ...geometry import Edges, Mesh, Scene, face_normals
from ...raster import Surface
from ...settings.reference import TracedReference
from ._sight import is_inside, size_of

# A mesh is mostly outside if less than this fraction of its surface is in the picture.
_MOSTLY = 0.5
# A mesh is the subject of the picture if it fills this fraction of the visible part.
_MAIN = 0.25
# A mesh is a ground or a wall if its shortest side is less than this fraction of its longest. It may extend beyond the
# picture.
_FLAT = 0.2
# The fraction of the picture's shorter side that a mesh of the suggested size fills.
_SUITABLE = 0.75
# The number of visible points that are tested, to distinguish a lamp's own mesh from a room.
_TRIED = 16
# A mesh may lose this fraction of its shadow, for example through a small hole, without a remark.
_LOST = 0.05
# A mesh that is this many times smaller or larger than all others is probably in another unit.
_ANOTHER_UNIT = 100.0
# Rounding error of twice a triangle's area, as a fraction of the mesh's extent squared.
_NO_AREA = 1e-6


def scene_remarks(
    config: Config, technique: shadow.AbstractTechnique, lit: Sequence[Scene], surface: Surface
) -> Iterator[str]:
    """Warns of meshes, with the likely cause: a mesh that covers no pixel and casts no shadow into the image; a mesh
    that is mostly outside the picture; a mesh around a light that hides all of its light; and an open mesh that loses
    its shadow because of the casting sides.

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


def _cause(mesh: Mesh, others: Sequence[Mesh], camera: geometry.AbstractCamera, *, is_sized: bool) -> str:
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


class Framed(NamedTuple):
    """A mesh that extends beyond the picture.

    - `name`: its key and path; `number`: its index among the meshes.
    - `share`: the fraction of its surface inside the picture.
    - `is_around`: whether the camera is inside its bounding box.
    """

    name: str
    number: int
    share: float
    is_around: bool

    def words(self, scene: Scene) -> tuple[str, str]:
        """The part of a mesh outside the picture, and how to fix it."""
        mesh, camera = scene.meshes[self.number], scene.camera
        low, high = np.asarray(mesh.bounds, np.float64)
        extent = " × ".join(f"{side:.3g}" for side in high - low)
        around = ", around the camera" if self.is_around else ""
        where = f"{self.name} is {extent} world units large{around}, with {self.share:.0%} of it in the picture"
        eye = [float(f"{x:.4g}") + at for x, at in zip(np.asarray(camera.eye), scene.origin, strict=True)]
        mend = f"set scene.meshes.{self.number}.size, to {_suitable(camera):g} for example"
        return where, f"{mend}, or move the camera at {eye}"


def framing_remarks(config: Config, scene: Scene, surface: Surface) -> Iterator[str]:
    """Warns if a mesh that should be in the picture is mostly outside it."""
    framed = _framed(config, scene, surface)
    # In a room, most of it is outside the picture.
    if framed and not framed.is_around and not _is_room(scene, framed.number, surface, _numbers(scene)):
        where, mend = framed.words(scene)
        yield f"{where}: {mend}"


def dark_scene(
    config: Config, lit: Sequence[Scene], surface: Surface, pixels: Sequence[Bool[HostArray, "h w"]]
) -> str | None:
    """The error message for a scene in which no light reaches a pixel that counts; `None` if one does.

    **Arguments:**

    - `lit`: the scene with each light alone; `pixels`: (h, w) for each light, the pixels that count.
    """
    mask, blockers = np.asarray(surface.mask), blockers_of(config)
    if any(reference.is_lit(each, mask & counted, blockers) for each, counted in zip(lit, pixels, strict=True)):
        return None
    hidden = next(lights_inside(config, lit, surface), None)
    framed = _framed(config, lit[0], surface)
    if hidden is not None:
        cause, mend = hidden
    elif framed is not None:
        cause, mend = framed.words(lit[0])
    else:
        cause, mend = "all of it faces away from the light, or is in shadow", "move the light, or the camera"
    lights = "no light" if len(lit) == 1 else "none of its lights"
    return (
        f"{lights} reaches the camera's view, so there is nothing to compare: {cause}; expected surfaces in "
        f"light and in shadow; {mend}"
    )


def lights_inside(config: Config, lit: Sequence[Scene], surface: Surface) -> Iterator[tuple[str, str]]:
    """For each mesh that hides the light inside it from everything that the camera sees: the light and the mesh, and
    how to fix it."""
    number = _numbers(lit[0])
    for key, scene in zip(config.scene.each_light, lit, strict=True):
        for i, section in enumerate(config.scene.meshes):
            if (section.casts or blockers_of(config) == "all") and _hides_all(scene, i, surface, number):
                light, mesh = ".".join(map(str, ("scene", *key))), f"scene.meshes.{i}"
                mend = f"set {mesh}.casts to false" if section.casts else "set reference.blockers to casters"
                yield (
                    f"{light} is inside {mesh} ({section.path}), which hides it from all that the camera sees",
                    f"if that is the lamp's own mesh, {mend}; otherwise move the light out of it",
                )


def blockers_of(config: Config) -> reference.Blockers:
    """What blocks rays of the reference."""
    return config.reference.blockers if isinstance(config.reference, TracedReference) else "casters"


def _hides_all(scene: Scene, index: int, surface: Surface, number: Int[HostArray, " f"]) -> bool:
    """Whether the scene's only light is inside a mesh and all visible surfaces are outside of it.

    **Arguments:** `number`: (f,), the index of each face's mesh.
    """
    mesh, place = scene.meshes[index], getattr(scene.light, "position", None)
    if place is None or not is_inside(mesh, np.asarray(place, np.float64)):
        return False
    return not _is_room(scene, index, surface, number)


def _is_room(scene: Scene, index: int, surface: Surface, number: Int[HostArray, " f"]) -> bool:
    """Whether the camera is inside a mesh, or inside some of the other meshes that it sees."""
    others = np.asarray(surface.mask) & (number[np.asarray(surface.face)] != index)
    seen = np.asarray(surface.position, np.float64)[others]
    tried = [np.asarray(scene.camera.eye, np.float64), *seen[:: max(len(seen) // _TRIED, 1)]]
    return any(is_inside(scene.meshes[index], point) for point in tried)


def _framed(config: Config, scene: Scene, surface: Surface) -> Framed | None:
    """The mesh that fills most of the picture, if most of it is outside the picture and it is not a ground or a
    wall."""
    seen = _numbers(scene)[np.asarray(surface.face)[np.asarray(surface.mask)]]
    counts = np.bincount(seen, minlength=len(scene.meshes))
    index = int(counts.argmax())
    mesh = scene.meshes[index]
    low, high = np.asarray(mesh.bounds, np.float64)
    share = _share(mesh, scene.camera)
    if counts[index] < _MAIN * len(seen) or (high - low).min() < _FLAT * (high - low).max() or share >= _MOSTLY:
        return None
    eye = np.asarray(scene.camera.eye, np.float64)
    name = f"scene.meshes.{index} ({config.scene.meshes[index].path})"
    return Framed(name, index, share, bool(((low <= eye) & (eye <= high)).all()))


def _share(mesh: Mesh, camera: geometry.AbstractCamera) -> float:
    """The fraction of the mesh's surface inside the picture, in front of or behind other meshes."""
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
    a, b, c = np.moveaxis(corners, 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    matrix = np.asarray(camera.view().matrix, np.float64)
    clip = corners.mean(axis=1) @ matrix[:, :3].T + matrix[:, 3]
    inside = (np.abs(clip[:, :2]) <= clip[:, 3:]).all(axis=1)
    return float(areas[inside].sum() / max(areas.sum(), np.finfo(np.float64).tiny))


def _suitable(camera: geometry.AbstractCamera) -> float:
    """The size of a mesh at the camera's target that fits into the picture, to one digit."""
    distance = np.linalg.norm(np.asarray(camera.target, np.float64) - np.asarray(camera.eye, np.float64))
    sides = np.asarray(camera.view().texel_extent(as_float(distance), (1, 1)), np.float64)
    return float(f"{_SUITABLE * sides.min():.1g}")


def _numbers(scene: Scene) -> Int[HostArray, " f"]:
    """The index of each face's mesh."""
    return np.repeat(np.arange(len(scene.meshes)), [mesh.faces.shape[0] for mesh in scene.meshes])


class _Lost(NamedTuple):
    """The loss of a mesh's shadow: which faces still cast, and whether any shadow remains."""

    side: shadow.Side
    is_all: bool


def side_remarks(config: Config, technique: shadow.AbstractTechnique, lit: Sequence[Scene]) -> Iterator[str]:
    """Warns of each open mesh that loses all or part of its shadow, because only faces towards the light cast, or only
    faces away from it. The warning names the key that sets this.

    **Arguments:**

    - `lit`: the scene with each light alone.
    """
    for i, (mesh, section) in enumerate(zip(lit[0].meshes, config.scene.meshes, strict=True)):
        sides = [technique.casting_sides(scene)[i] for scene in lit]
        if all(side in (None, "double") for side in sides) or Edges.of(mesh).is_closed:
            continue
        losses = [_lost(scene, i, side) for scene, side in zip(lit, sides, strict=True) if side in ("front", "back")]
        found = next((loss for loss in losses if loss is not None), None)
        if found is not None:
            key, mend = _key(config, technique, i)
            what = "no shadow" if found.is_all else "only a part of its shadow"
            yield (
                f"scene.meshes.{i} ({section.path}) is an open mesh and casts {what}: {key}, so only faces that show "
                f"their {found.side} to the light cast; {mend}, or close the mesh"
            )


def _lost(scene: Scene, index: int, side: shadow.Side) -> _Lost | None:
    """The loss in the image if only the given `side` of this mesh casts; `None` if the loss is small."""
    own = np.repeat(np.arange(len(scene.meshes)), [mesh.faces.shape[0] for mesh in scene.meshes]) == index
    casting = turned(scene) if side == "front" else ~turned(scene)
    without = reference.hidden_pixels(scene, own & ~casting)
    if not without.any():
        return None
    left = reference.hidden_pixels(scene, own & casting)
    lost = np.count_nonzero(without & ~left) / np.count_nonzero(without | left)
    return _Lost(side, not left.any()) if lost > _LOST else None


def turned(scene: Scene) -> Bool[HostArray, " f"]:
    """Which faces of the scene show their front to its light."""
    mesh = scene.mesh
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return np.asarray(dot(face_normals(mesh), normalize(scene.light.towards(centres))) > 0)


def _key(config: Config, technique: shadow.AbstractTechnique, index: int) -> tuple[str, str]:
    """The key that sets the casting faces, with its value, and how to let all of them cast."""
    each = lambda name, value: f"{name}.{index}" if isinstance(value, tuple) else name
    if isinstance(technique, shadow.ThreeJs):
        of_mesh = lambda values: values[index] if isinstance(values, tuple) else values
        side, given = of_mesh(technique.side), of_mesh(technique.shadow_side)
        key = each("technique.shadow_side", technique.shadow_side)
        mend = "set technique.shadow_side to double, as shadowSide of the material"
        if given is not None:
            return f"{key} is {given}", mend
        return f"{each('technique.side', technique.side)} is {side} and {key} is not set", mend
    if isinstance(technique, shadow.BabylonJs):
        key = each("technique.back_face_culling", technique.back_face_culling)
        also = " and technique.force_back_faces_only is true" if technique.force_back_faces_only else ""
        return f"{key} is true{also}", f"set {key} to false, as backFaceCulling of the material"
    return f"shadow_map.cull is {config.shadow_map.cull}", "set shadow_map.cull to none"
