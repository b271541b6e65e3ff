"""Shadows by brute force in float64: rays from any point of the window, against every triangle."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from diffshadow._arithmetic import in_float64

_PAIRS = 1 << 19
_TINY = 1e-12
_TURN = np.arange(8) * np.pi / 4
_CIRCLE = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=-1)


class Crossings(NamedTuple):
    """What is seen at points of the window, (n,) each.

    - `face`: -1 for none; `lit`: True where nothing is seen.
    - `count`: how many faces that count stand between the point and the light, its own among them where the camera
        sees the side that is turned from the light.
    """

    face: np.ndarray
    lit: np.ndarray
    count: np.ndarray


class Truth:
    """The scene of a mesh, light and camera; only the first `casters` faces cast, all of them if left out."""

    def __init__(self, mesh, light, camera, casters=None):
        self.directional = light.is_directional
        with jax.enable_x64(True):
            self._clip_to_world = np.linalg.inv(np.asarray(in_float64(camera).view().matrix))
            self._light = np.asarray(in_float64(light).towards(jnp.zeros((1, 3), jnp.float64)))[0]
        self.resolution = camera.resolution
        self._corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
        a, b, c = np.moveaxis(self._corners, 1, 0)
        self._normals = np.cross(b - a, c - a)
        self._faces_light = np.sum(self._normals * self._towards(self._corners.mean(axis=1)), axis=1) > 0
        self._casters = len(a) if casters is None else casters

    def centres(self):
        """Window coordinates (n, 2) of all pixel centres, row by row."""
        height, width = self.resolution
        rows, columns = np.mgrid[:height, :width]
        return np.stack([columns.ravel(), rows.ravel()], axis=-1) + 0.5

    def at(self, xy, solid=None):
        """`Crossings` at window coordinates `xy` (n, 2). Of faces that are `solid` (f,), those turned from the light
        do not count."""
        counts = np.ones(self._casters, bool) if solid is None else self._faces_light[: self._casters] | ~solid
        step = max(1, _PAIRS // len(self._corners))
        parts = [self._solve(xy[k : k + step], counts) for k in range(0, len(xy), step)]
        return Crossings(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def changes_within(self, xy, radius, solid=None):
        """(n,), whether light or count change somewhere on the circle of `radius` pixels round `xy` (n, 2)."""
        around = (xy[:, None] + radius * _CIRCLE).reshape(-1, 2)
        here, there = self.at(xy, solid), self.at(around, solid)
        differs = lambda a, b: (b.reshape(-1, len(_CIRCLE)) != a[:, None]).any(axis=1)
        return differs(here.lit, there.lit) | differs(here.count, there.count)

    def distances(self, xy, radii=(1e-4, 1e-3, 1 / 512, 1 / 256, 1e-2, 1e-1)):
        """(n,), the least of `radii` within which something changes; infinite if none."""
        return np.min([np.where(self.changes_within(xy, radius), radius, np.inf) for radius in radii], axis=0)

    def _towards(self, points):
        return np.broadcast_to(self._light, points.shape) if self.directional else self._light - points

    def _solve(self, xy, counts):
        height, width = self.resolution
        ndc = xy / [width / 2, height / 2] - 1
        begin, end = (self._unproject(ndc, z) for z in (-1.0, 1.0))
        hits = _distances(begin, end - begin, self._corners)
        hits = np.where((hits >= 0) & (hits <= 1), hits, np.inf)
        face, nearest = hits.argmin(axis=1), hits.min(axis=1)
        seen = np.isfinite(nearest)
        point = begin + np.where(seen, nearest, 0)[:, None] * (end - begin)
        to_light = self._towards(point)
        height_over = lambda v: np.sum(self._normals[face] * v, axis=1)
        same_side = height_over(to_light) * height_over(begin - end) > 0

        distance = _distances(point, to_light, self._corners[: self._casters])
        crossed = (distance > _TINY) & (distance < (np.inf if self.directional else 1))
        own = np.arange(len(crossed)), np.minimum(face, self._casters - 1)
        crossed[own] = np.where(face < self._casters, ~same_side, crossed[own])
        lit = same_side & ~crossed.any(axis=1)
        return np.where(seen, face, -1), lit | ~seen, np.where(seen, (crossed & counts).sum(axis=1), 0)

    def _unproject(self, ndc, z):
        ones = np.ones((len(ndc), 1))
        world = np.concatenate([ndc, z * ones, ones], axis=1) @ self._clip_to_world.T
        return world[:, :3] / world[:, 3:]


def _distances(origin, direction, corners):
    """Multiples of `direction` at which rays (n, 3) meet triangles (f, 3, 3), (n, f); infinite where they miss."""
    a = corners[:, 0]
    first, second = corners[:, 1] - a, corners[:, 2] - a
    p = np.cross(direction[:, None], second)
    determinant = np.einsum("nfd,fd->nf", p, first)
    inverse = 1 / np.where(determinant == 0, 1, determinant)
    s = origin[:, None] - a
    q = np.cross(s, first)
    u, v = np.einsum("nfd,nfd->nf", s, p) * inverse, np.einsum("nfd,nd->nf", q, direction) * inverse
    inside = (determinant != 0) & (u >= -_TINY) & (v >= -_TINY) & (u + v <= 1 + _TINY)
    return np.where(inside, np.einsum("nfd,fd->nf", q, second) * inverse, np.inf)
