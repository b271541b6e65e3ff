"""Scales and moves a mesh into a scene."""

from typing import Any

import equinox as eqx

from .._arithmetic import array_module, as_float, concrete
from .._types import Scalar
from ._mesh import Mesh, MeshLike, as_mesh


def fit_to_size(mesh: MeshLike, size: Scalar | float | int) -> Mesh:
    """The mesh scaled uniformly to `size`, and centred on the origin in x and z.

    **Arguments:**

    - `mesh`: at any scale.
    - `size`: length of the longest side of the resulting bounding box, world units.

    **Returns:** the scaled mesh, centred on 0 in x and z and scaled about y = 0. Use `drop_to_ground` to set its
    height.

    **Raises** `ValueError` if `size` is not positive, or the mesh has no extent.

    !!! Example

        ```python
        torus = geometry.fit_to_size(geometry.library_mesh("torus"), 2.0)
        low, high = torus.bounds
        float((high - low).max())  # 2.0
        ```
    """
    mesh, known_size = as_mesh(mesh), concrete(size)
    if known_size is not None and not 0 < known_size < float("inf"):
        raise ValueError(f"the size to fit a mesh to is {known_size}; expected positive world units")
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


def drop_to_ground(mesh: MeshLike, height: Scalar | float | int = 0.0) -> Mesh:
    """The mesh moved up or down so that its lowest vertex lies at y = `height`, world units.

    **Raises** `ValueError` if `height` is not finite.

    !!! Example

        ```python
        torus = geometry.drop_to_ground(geometry.library_mesh("torus"), 0.5)
        float(torus.vertices[:, 1].min())  # 0.5
        ```
    """
    mesh, known = as_mesh(mesh), concrete(height)
    if known is not None and not abs(known) < float("inf"):
        raise ValueError(f"the height to put a mesh at is {known}; expected finite world units")
    xp = array_module(mesh.vertices, height)
    low = xp.asarray(mesh.bounds)[0]
    offset = xp.asarray([0, 1, 0], low.dtype) * (xp.asarray(height, low.dtype) - low[1])
    return _with_vertices(mesh, xp.asarray(mesh.vertices) + offset)


def _with_vertices(mesh: Mesh, vertices: Any) -> Mesh:
    # Uniform scaling and translation do not change normals.
    return eqx.tree_at(lambda m: m.vertices, mesh, as_float(vertices))
