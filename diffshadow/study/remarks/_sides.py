"""Remarks on open meshes whose shadow is lost because only one side of them casts."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ... import reference, shadow
from ..._arithmetic import dot, normalize
from ..._types import HostArray
from ...config import Config
from ...geometry import Edges, Scene, face_normals

# A mesh may lose this part of its shadow, as through a small hole, without a remark.
_LOST = 0.05


class _Lost(NamedTuple):
    """What a mesh loses of its shadow: which faces still cast, and whether any of it is left."""

    side: shadow.Side
    is_all: bool


def side_remarks(config: Config, technique: shadow.AbstractTechnique, lit: Sequence[Scene]) -> Iterator[str]:
    """A sentence for each open mesh without a shadow, or without a part of it, since the faces that are turned to the
    light, or the others, do not cast. It names the key that says so.

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
    """What the mesh of this index loses in the image, if only its `side` casts; none if that is little."""
    own = np.repeat(np.arange(len(scene.meshes)), [mesh.faces.shape[0] for mesh in scene.meshes]) == index
    casting = _turned(scene) if side == "front" else ~_turned(scene)
    without = reference.hidden_pixels(scene, own & ~casting)
    if not without.any():
        return None
    left = reference.hidden_pixels(scene, own & casting)
    lost = np.count_nonzero(without & ~left) / np.count_nonzero(without | left)
    return _Lost(side, not left.any()) if lost > _LOST else None


def _turned(scene: Scene) -> Bool[HostArray, " f"]:
    """Which faces of the scene show their front to its light."""
    mesh = scene.mesh
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return np.asarray(dot(face_normals(mesh), normalize(scene.light.towards(centres))) > 0)


def _key(config: Config, technique: shadow.AbstractTechnique, index: int) -> tuple[str, str]:
    """The key that says which faces cast, with its value, and how to let all of them cast."""
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
