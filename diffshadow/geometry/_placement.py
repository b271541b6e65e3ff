"""Bringing a mesh of any size and origin to its place in a scene."""

from typing import Any

import equinox as eqx

from .._misc import array_module, as_float, concrete
from .._types import Scalar
from ._mesh import Mesh


def fit_to_size(mesh: Mesh, size: Scalar | float | int) -> Mesh:
    """The mesh scaled evenly to `size`, and centred over the origin in x and z.

    **Arguments:**

    - `mesh`: at any scale.
    - `size`: length of the longest side of the resulting bounding box, world units.

    **Returns:** the scaled mesh. Its x and z are centred on 0; its heights are scaled about y = 0, and
    `drop_to_ground` then sets them.

    **Raises** `ValueError` if `size` is not positive, or the mesh has no extent.
    """
    wanted = concrete(size)
    if wanted is not None and not 0 < wanted < float("inf"):
        raise ValueError(f"the size to fit a mesh to is {wanted}; expected positive world units")
    xp = array_module(mesh.vertices, size)
    low, high = xp.asarray(mesh.bounds)
    extent = xp.max(high - low)
    known = concrete(extent)
    if known is not None and not known > 0:
        raise ValueError(
            f"all vertices of the mesh lie at {low.tolist()}, so it cannot be scaled to a size of {size}; "
            "expected a mesh with an extent: check the file or its export"
        )
    centre = (low + high) / 2 * xp.asarray([1, 0, 1], low.dtype)
    return _with_vertices(mesh, (xp.asarray(mesh.vertices) - centre) * (xp.asarray(size, low.dtype) / extent))


def drop_to_ground(mesh: Mesh, height: Scalar | float | int = 0.0) -> Mesh:
    """The mesh moved up or down so that its lowest vertex lies at y = `height`, world units.

    **Raises** `ValueError` if `height` is not finite.
    """
    wanted = concrete(height)
    if wanted is not None and not abs(wanted) < float("inf"):
        raise ValueError(f"the height to put a mesh at is {wanted}; expected finite world units")
    xp = array_module(mesh.vertices, height)
    low = xp.asarray(mesh.bounds)[0]
    offset = xp.asarray([0, 1, 0], low.dtype) * (xp.asarray(height, low.dtype) - low[1])
    return _with_vertices(mesh, xp.asarray(mesh.vertices) + offset)


def _with_vertices(mesh: Mesh, vertices: Any) -> Mesh:
    # Even scaling and shifts leave the normals as they are.
    return eqx.tree_at(lambda m: m.vertices, mesh, as_float(vertices))
