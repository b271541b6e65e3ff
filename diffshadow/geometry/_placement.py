"""Bringing a mesh of any size and origin to its place in a scene."""

import equinox as eqx
import jax.numpy as jnp

from .._misc import as_float, concrete
from .._types import Scalar, Vec3
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
    low, high = mesh.bounds
    extent = jnp.max(high - low)
    known = concrete(extent)
    if known is not None and not known > 0:
        raise ValueError(
            f"all vertices of the mesh lie at {low.tolist()}, so it cannot be scaled to a size of {size}; "
            "expected a mesh with an extent: check the file or its export"
        )
    centre = (low + high) / 2 * jnp.array([1.0, 0.0, 1.0])
    return _with_vertices(mesh, (mesh.vertices - centre) * (as_float(size) / extent))


def drop_to_ground(mesh: Mesh, height: Scalar | float | int = 0.0) -> Mesh:
    """The mesh moved up or down so that its lowest vertex lies at y = `height`, world units.

    **Raises** `ValueError` if `height` is not finite.
    """
    wanted = concrete(height)
    if wanted is not None and not abs(wanted) < float("inf"):
        raise ValueError(f"the height to put a mesh at is {wanted}; expected finite world units")
    return _moved(mesh, as_float([0.0, 1.0, 0.0]) * (as_float(height) - mesh.bounds[0, 1]))


def _moved(mesh: Mesh, offset: Vec3) -> Mesh:
    return _with_vertices(mesh, mesh.vertices + offset)


def _with_vertices(mesh: Mesh, vertices) -> Mesh:
    # Even scaling and shifts leave the normals as they are.
    return eqx.tree_at(lambda m: m.vertices, mesh, vertices)
