"""Remarks on biases that remove much of a caster's shadow."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ... import reference, shadow
from ..._arithmetic import as_float
from ..._padding import padded_to, shared_size
from ..._types import HostArray
from ..._words import counted
from ...config import Config
from ...geometry import Edges, Mesh, Scene
from ...raster import Surface
from ._scene import turned

# A mesh causes a remark if it loses more than this share of its shadow to the bias. A smaller share is enough if the
# bias exceeds this fraction of the mesh's length along the light.
_LOST, _PART, _LOST_OF_SHORT = 0.5, 1 / 3, 0.22
# The number of points that are tested on a mesh, and the number of points that must cast a shadow into the picture.
_TRIED, _FEWEST = 128, 8
_NUMBERS = ("constant", "slope", "normal_offset")


class _Loss(NamedTuple):
    """The part of a mesh's shadow that the bias removes.

    - `mesh`: its index; `share`: share of its shadow's area.
    - `shift`: the distance by which the bias moves the shadowed surfaces towards the light; `texel`: the side of a
      texel there. Both in world units.
    - `across`, `along`: the mesh's narrowest side across the light and its length along it, in world units.
    """

    mesh: int
    share: float
    shift: float
    texel: float
    across: float
    along: float


def bias_remarks(
    config: Config,
    technique: shadow.AbstractTechnique | shadow.FittableTechnique,
    keys: Sequence[str],
    lit: Sequence[Scene],
    states: Sequence[Any],
) -> Iterator[str]:
    """A sentence for each light whose casters lose much of their shadow, because the bias moves the shadowed surfaces
    in front of the casters.

    **Arguments:**

    - `keys`, `lit`, `states`: the key of each light, the scene with this light alone, and the technique's state for it.
    """
    if not isinstance(technique, shadow.ShadowMapping):
        return
    for key, scene, state in zip(keys, lit, states, strict=True):
        losses = sorted(_losses(technique, scene, state), key=lambda each: -each.share)
        if losses:
            yield _sentence(config, key, losses)


def _sentence(config: Config, key: str, losses: Sequence[_Loss]) -> str:
    worst = losses[0]
    name = f"scene.meshes.{worst.mesh}"
    others = f" and {counted(len(losses) - 1, 'other mesh')} lose" if losses[1:] else " loses"
    narrow = _narrowed(config, key)
    mends = ["raise shadow_map.resolution", *([narrow] if narrow else [])]
    return (
        f"{name} ({config.scene.meshes[worst.mesh].path}){others} much of the shadow of {key} to the bias: it moves "
        f"surfaces {worst.shift:.3g} world units towards the light, which is {worst.shift / worst.texel:.2g} texels, "
        f"and {name} is {worst.along:.3g} world units long along the light and {worst.across:.3g} wide across it, "
        f"{worst.across / worst.texel:.2g} texels; about {worst.share:.0%} of its shadow is lost: "
        f"{', '.join(mends)}, or lower bias.{_largest(config)}"
    )


def _largest(config: Config) -> str:
    """The key of the largest number of the bias."""
    return max(_NUMBERS, key=lambda name: getattr(config.bias, name))


def _narrowed(config: Config, key: str) -> str | None:
    """How to use a light's texels for a smaller part of the scene. Empty if there is no key for it."""
    light = next(each for at, each in config.scene.each_light.items() if key == ".".join(map(str, ("scene", *at))))
    if light.type == "directional":
        return f"narrow its map with {key}.shadow_camera"
    return f"lower {key}.outer_angle" if light.type == "spot" else None


def _losses(technique: shadow.ShadowMapping, scene: Scene, state: Any) -> Iterator[_Loss]:
    sizes = [mesh.faces.shape[0] for mesh in scene.meshes]
    number = np.repeat(np.arange(len(sizes)), sizes)
    solid = np.concatenate([_solid(mesh) for mesh in scene.meshes])
    starts = np.flatnonzero(scene.casting_faces & (turned(scene) | ~solid))
    faces = np.concatenate([_spread(starts[number[starts] == i]) for i in range(len(sizes))])
    hidden = reference.hidden_points(scene, faces, solid)
    if not len(hidden.caster):
        return
    shift, texel = _shifts(technique, state, hidden)
    seen = _is_in_picture(scene, hidden.position)
    mesh = number[faces[hidden.caster]]
    # Other casters may still hide points that move past the nearest caster.
    towards = np.asarray(scene.light.towards(as_float(hidden.position)), np.float64)
    distance = np.linalg.norm(towards, axis=1, keepdims=True)
    moved = hidden.position + shift[:, None] * towards / distance
    reach = np.inf if scene.light.is_directional else 1.0
    lost = seen & ~reference.occluded(scene.casters, moved, towards, reach)
    for i in np.unique(mesh[seen]):
        own = seen & (mesh == i)
        if np.count_nonzero(own) < _FEWEST:
            continue
        share = float(hidden.area[own & lost].sum() / max(hidden.area[own].sum(), np.finfo(float).tiny))
        if share <= _LOST_OF_SHORT:
            continue
        across, along = _extents(scene, i)
        moved_by = float(np.median(shift[own]))
        if share > (_LOST_OF_SHORT if moved_by > _PART * along else _LOST):
            yield _Loss(int(i), share, moved_by, float(np.median(texel[own])), across, along)


def _solid(mesh: Mesh) -> Bool[HostArray, " f"]:
    """Whether each face is a part of a closed surface."""
    edges = Edges.of(mesh)
    return np.asarray(edges.solid)[np.asarray(edges.component)]


def _spread(faces: Int[HostArray, " n"]) -> Int[HostArray, " m"]:
    """The tested faces of a mesh: evenly spaced, or repeated if there are few. Empty for an empty mesh."""
    if not len(faces):
        return faces
    return faces[np.arange(_TRIED) * len(faces) // _TRIED] if len(faces) >= _TRIED else np.resize(faces, _TRIED)


def _shifts(
    technique: shadow.ShadowMapping, state: Any, hidden: reference.HiddenPoints
) -> tuple[Float[HostArray, " n"], Float[HostArray, " n"]]:
    """The distance by which the bias moves each point towards the light, and the width of a texel there, in world
    units."""
    count = len(hidden.position)
    # The points are stored like the pixels of a picture, with padding, so that scenes share a program.
    padded = lambda values: as_float(padded_to(values, shared_size(count)))[None]
    position, normal = padded(hidden.position), padded(hidden.normal)
    mask = jnp.arange(shared_size(count))[None] < count
    surface = Surface(position, normal, normal, jnp.ones_like(position), jnp.where(mask, 0, -1), mask)
    shift, texel = technique.shift(state, surface)
    return np.asarray(shift, np.float64)[0, :count], np.asarray(texel, np.float64)[0, :count]


def _is_in_picture(scene: Scene, points: Float[HostArray, "n 3"]) -> Bool[HostArray, " n"]:
    clip = np.asarray(scene.camera.view().clip(as_float(points)))
    return (np.abs(clip[:, :3]) <= clip[:, 3:]).all(axis=1)


def _extents(scene: Scene, index: int) -> tuple[float, float]:
    """A mesh's narrower side across the light, and its length along it, in world units."""
    mesh = scene.meshes[index]
    corners = np.asarray(mesh.vertices, np.float64)[np.unique(np.asarray(mesh.faces))]
    middle = as_float(corners.mean(axis=0))
    towards = np.asarray(scene.light.towards(middle), np.float64)
    axis = towards / np.linalg.norm(towards)
    centred = corners - corners.mean(axis=0)
    across = centred - np.outer(centred @ axis, axis)
    # The last of the three directions is the light's. Across it, the extent is zero.
    narrow = np.linalg.svd(across, full_matrices=False)[2][1]
    return float(np.ptp(across @ narrow)), float(np.ptp(centred @ axis))
