"""Shading normals that follow individually moved vertices."""

from collections.abc import Collection

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import as_array, dot, normalize, safe_norm, take
from .._types import HostArray, Vertices
from ._mesh import Mesh
from ._normals import normals_and_angles

# Means whose distances from a corner's normal differ by less than this count as equally good, by the cosine between
# them.
_AS_GOOD = 1e-6


class Smoothing(eqx.Module):
    """The faces over which a mesh's shading normals are smooth, at the corners whose normals depend on the given
    vertices.

    A corner's normal is the mean over the faces around its vertex whose normals are within some angle of its own
    face's, as in `crease_normals`. The angle is the one that explains the normal best: 0 for flat shading, 180 degrees
    for a smooth vertex.

    - `corner`: (n,), corners, 3 · face + index in the face.
    - `around`: (n, d), the corners that the mean is taken over; `counts`: (n, d), which of these entries are corners.
    """

    corner: Int[Array, " n"]
    around: Int[Array, "n d"]
    counts: Bool[Array, "n d"]

    @classmethod
    def of(cls, mesh: Mesh, moved: Collection[int]) -> "Smoothing":
        """The smoothing at all corners whose normals depend on the vertices `moved`, indices into `mesh.vertices`."""
        points, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
        # Vertices at the same position count as one. Files split them where normals differ.
        place = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)[faces]
        at_moved = np.isin(faces, list(moved)).any(axis=1)
        touched = np.isin(place, place[at_moved])
        normals, angles = normals_and_angles(points[faces])
        given = np.asarray(mesh.corner_normals, np.float64).reshape(-1, 3)
        corners, sets = [], []
        for one in np.unique(place[touched]):
            beside = np.flatnonzero(place.reshape(-1) == one)
            smooth = _smooth_sets(given[beside], normals[beside // 3], angles.reshape(-1)[beside])
            for corner, is_smooth in zip(beside, smooth, strict=True):
                if at_moved[beside[is_smooth] // 3].any():
                    corners.append(corner)
                    sets.append(beside[is_smooth])
        most = max(map(len, sets), default=1)
        around = np.array([np.pad(each, (0, most - len(each))) for each in sets], np.int32).reshape(-1, most)
        counts = np.array([np.arange(most) < len(each) for each in sets], bool).reshape(-1, most)
        return cls(as_array(np.array(corners, np.int32)), as_array(around), as_array(counts))

    def corner_normals(self, mesh: Mesh, vertices: Vertices) -> Float[Array, "f 3 3"]:
        """The shading normals (f, 3, 3) of `mesh` with these vertices, differentiable.

        The mesh's own normals change by as much as the means do. Normals from a file, such as the exact normals of a
        curved surface, are therefore kept. They do not jump when a vertex begins to move.
        """
        given = mesh.corner_normals.reshape(-1, 3)
        own = take(given, self.corner)
        change = self._means(mesh, vertices) - self._means(mesh, mesh.vertices)
        # Changes are added, so that normals at rest do not change in the last digit.
        moved = own + (normalize(own + change) - normalize(own))
        return given.at[self.corner].set(moved).reshape(mesh.corner_normals.shape)

    def _means(self, mesh: Mesh, vertices: Vertices) -> Float[Array, "n 3"]:
        """The mean of the faces' unit normals, weighted by their angles at the vertex (Thürmer & Wüthrich 1998)."""
        face, first = self.around // 3, self.around % 3
        at, after, before = (
            take(vertices, take(mesh.faces.reshape(-1), 3 * face + (first + step) % 3)) for step in range(3)
        )
        to_next, to_last = after - at, before - at
        cross = jnp.cross(to_next, to_last)
        sine = safe_norm(cross)
        has_area = self.counts & (sine > 0)
        angle = jnp.where(has_area, jnp.arctan2(sine, jnp.where(has_area, dot(to_next, to_last), 1)), 0)
        return normalize(jnp.sum(angle[..., None] * normalize(cross), axis=1))


def _smooth_sets(
    given: Float[HostArray, "d 3"], normals: Float[HostArray, "d 3"], angles: Float[HostArray, " d"]
) -> Bool[HostArray, "d d"]:
    """For each corner at a vertex, which of its `d` corners have its `given` normal as their mean.

    If several explanations are equally good, the one with the most corners is chosen.
    """
    cosines = normals @ normals.T
    sets = np.eye(len(given), dtype=bool)
    for corner, own in enumerate(given):
        within = cosines[corner] >= np.unique(np.round(cosines[corner], 9))[:, None] - 1e-9
        same = given @ own >= 1 - _AS_GOOD
        candidates = np.concatenate([within, same[None]])
        candidates[:, corner] = True
        means = candidates @ (angles[:, None] * normals)
        length = np.linalg.norm(means, axis=1)
        fits = np.where(length > 0, means @ own / np.where(length > 0, length, 1), -1)
        good = fits >= fits.max() - _AS_GOOD
        sets[corner] = max(candidates[good], key=np.count_nonzero)
    return sets
