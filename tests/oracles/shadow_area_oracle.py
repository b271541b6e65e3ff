"""The area in light of a rectangle of the plane y = 0, exactly: an oracle for shadows and their derivatives."""

import numpy as np

from diffshadow.geometry import Mesh


def lit_area(mesh: Mesh, towards, box, lines: int = 2001) -> float:
    """The area of `box` (x0, x1, z0, z1) that no triangle of `mesh` hides from the light, in float64.

    **Arguments:**

    - `towards`: (4,), the light, homogeneous: (x, y, z, 1) for a position, (x, y, z, 0) for the way to a distant one.
    - `lines`: rows along which the union of all triangles' shadows is measured exactly.
    """
    v, light = np.asarray(mesh.vertices, np.float64), np.asarray(towards, np.float64)
    # Where the line from the light through a vertex meets y = 0.
    ray = v * light[3] - light[:3]
    ground = (v - ray * (v[:, 1:2] / ray[:, 1:2]))[:, [0, 2]]
    x0, x1, z0, z1 = box
    return (x1 - x0) * (z1 - z0) - _union(ground[np.asarray(mesh.faces)], box, lines)


def difference(function, at, step: float = 1e-3) -> np.ndarray:
    """The derivative of a function of a vector, by central differences."""
    at = np.asarray(at, np.float64)
    return np.array([(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))])


def _union(triangles, box, lines: int) -> float:
    x0, x1, z0, z1 = box
    height = (z1 - z0) / lines
    low = np.clip(np.ceil((triangles[..., 1].min(1) - z0) / height - 0.5).astype(int), 0, lines)
    high = np.clip(np.floor((triangles[..., 1].max(1) - z0) / height - 0.5).astype(int), -1, lines - 1)
    rows = np.maximum(high - low + 1, 0)
    own = np.repeat(np.arange(len(triangles)), rows)
    line = low[own] + np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows)
    z = z0 + height * (line + 0.5)
    left, right = np.full(len(own), np.inf), np.full(len(own), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        p, q = triangles[own, a], triangles[own, b]
        meets = (p[:, 1] <= z) != (q[:, 1] <= z)
        x = p[:, 0] + (z - p[:, 1]) / np.where(meets, q[:, 1] - p[:, 1], 1) * (q[:, 0] - p[:, 0])
        left, right = np.where(meets, np.minimum(left, x), left), np.where(meets, np.maximum(right, x), right)
    left, right = np.clip(left, x0, x1), np.clip(right, x0, x1)
    # One line after the other, far apart; what earlier intervals have covered does not count again.
    order = np.lexsort((left, line))
    shift = line[order] * (4 * (x1 - x0))
    left, right = left[order] + shift, right[order] + shift
    covered = np.maximum.accumulate(np.concatenate([[-np.inf], right]))[:-1]
    return height * np.maximum(right - np.maximum(left, covered), 0)[right > left].sum()
