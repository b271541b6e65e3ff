"""Cache keys of references: everything a reference depends on, as plain values."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from .._types import HostArray
from ..geometry import Mesh, Scene
from ..settings.reference import Blockers, Sampler
from ..settings.reference import TracedReference as Settings
from ._sampling import check_sampling
from ._visibility import blocking_faces, check_known

# Increase it whenever a change to this subpackage changes its images.
_ALGORITHM = 2
# Settings of lights that affect shading only.
_OF_SHADING = {"inner_angle"}


class KeyedScene(NamedTuple):
    """A scene with one light, and the common part of the keys of its references."""

    scene: Scene
    mesh: tuple[HostArray, HostArray]
    cutouts: tuple[Any, ...]
    camera: Any
    light: Any

    @classmethod
    def of(cls, scene: Scene) -> "KeyedScene":
        """Takes a scene with one light; `ValueError` for several."""
        mesh = scene.mesh
        arrays = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        return cls(scene, arrays, _cutouts(mesh), _fields(scene.camera), _fields(scene.light))


def key_parts(
    scene: Scene | KeyedScene,
    samples: int = Settings.samples,
    sampler: Sampler = Settings.sampler,
    seed: int = 0,
    supersampling: int = Settings.supersampling,
    blockers: Blockers = Settings.blockers,
) -> tuple[Any, ...]:
    """A nested tuple of strings, numbers and NumPy arrays that determines the result of `trace_visibility`.

    Equal keys mean equal references. The key leaves out what has no effect on visibility: shading normals, albedo,
    colours of corners and textures, a spot light's inner angle, and samples, sampler and seed for a light without size.
    For textures with an alpha test, it includes alpha, cutoffs, samplers and texture coordinates.

    **Arguments:** `scene`: a scene, or its `KeyedScene`, which saves time for many keys. The other arguments are as for
    `trace_visibility`.

    **Raises** `ValueError` as `trace_visibility` does for several lights, `samples`, `sampler` and `supersampling`.
    """
    check_sampling(samples, sampler, supersampling, blockers)
    check_known("key_parts", scene)
    known = scene if isinstance(scene, KeyedScene) else KeyedScene.of(scene)
    has_size = known.scene.light.has_size
    of_light = (int(samples), str(sampler), int(seed)) if has_size else (1, "centre", 0)
    sampling = (*of_light, int(supersampling))
    triangles = (*known.mesh, blocking_faces(known.scene, blockers), *known.cutouts)
    return ("reference", _ALGORITHM, sampling, triangles, known.camera, known.light)


def _cutouts(mesh: Mesh) -> tuple[Any, ...]:
    """What an alpha test of the mesh depends on; nothing without one."""
    textures = mesh.alpha_test
    if textures is None:
        return ()
    arrays = textures.uv, textures.index, textures.texels[:, 3], textures.table, textures.cutoff
    others = {"samplers": textures.samplers, "corner_alpha": textures.corner_alpha}
    more = [(name, np.asarray(array)) for name, array in others.items() if array is not None]
    return *(np.asarray(array) for array in arrays), *more


def _fields(module: Any) -> tuple[Any, ...]:
    """The module's class and its fields by name."""
    names = (field.name for field in dataclasses.fields(module) if field.name not in _OF_SHADING)
    values = ((name, getattr(module, name)) for name in names)
    return (type(module).__qualname__, *((name, _plain(value)) for name, value in values))


def _plain(value: Any) -> Any:
    if isinstance(value, bool | int | float | str | None):
        return value
    if isinstance(value, tuple):
        return tuple(_plain(v) for v in value)
    return np.asarray(value)
