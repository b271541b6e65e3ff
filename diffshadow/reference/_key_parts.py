"""Cache keys of references: everything a reference depends on, as plain values."""

import dataclasses
from typing import Any

import numpy as np

from .._types import HostArray
from ..geometry import Mesh, Scene
from ..settings.reference import Blockers, Sampler
from ..settings.reference import TracedReference as Settings
from ._sampling import check_sampling
from ._visibility import blocking_faces

# Increase it whenever a change to this subpackage changes its images.
_ALGORITHM = 2
# Settings of lights that affect shading only.
_OF_SHADING = {"inner_angle"}


def key_parts(
    scene: Scene,
    samples: int = Settings.samples,
    sampler: Sampler = Settings.sampler,
    seed: int = 0,
    supersampling: int = Settings.supersampling,
    blockers: Blockers = Settings.blockers,
) -> tuple[Any, ...]:
    """A nested tuple of strings, numbers and NumPy arrays that determines the result of `trace_visibility`.

    Equal keys mean equal references. The key leaves out what has no effect on visibility: shading normals, albedo,
    colours of corners and textures, a spot light's inner angle, and samples, sampler and seed for a light without size.
    Of textures with an alpha test, it has alpha, cutoffs and texture coordinates.

    **Raises** `ValueError` as `trace_visibility` does for several lights, `samples`, `sampler` and `supersampling`.
    """
    return KeyedScene(scene).key_parts(samples, sampler, seed, supersampling, blockers)


class KeyedScene:
    """A scene with one light whose parts of keys are found once, for many seeds."""

    def __init__(self, scene: Scene):
        light, mesh = scene.light, scene.mesh
        self._scene = scene
        self._mesh = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        self._cutouts = _cutouts(mesh)
        self._camera, self._light, self._has_size = _fields(scene.camera), _fields(light), light.has_size

    def key_parts(
        self,
        samples: int = Settings.samples,
        sampler: Sampler = Settings.sampler,
        seed: int = 0,
        supersampling: int = Settings.supersampling,
        blockers: Blockers = Settings.blockers,
    ) -> tuple[Any, ...]:
        """The function `key_parts` of the scene."""
        check_sampling(samples, sampler, supersampling, blockers)
        of_light = (int(samples), str(sampler), int(seed)) if self._has_size else (1, "centre", 0)
        sampling = (*of_light, int(supersampling))
        triangles = (*self._mesh, blocking_faces(self._scene, blockers), *self._cutouts)
        return ("reference", _ALGORITHM, sampling, triangles, self._camera, self._light)


def _cutouts(mesh: Mesh) -> tuple[HostArray, ...]:
    """What an alpha test of the mesh depends on; nothing without one."""
    textures = mesh.alpha_test
    if textures is None:
        return ()
    arrays = textures.uv, textures.index, textures.texels[:, 3], textures.table, textures.cutoff
    return tuple(np.asarray(array) for array in arrays)


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
