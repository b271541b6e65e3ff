"""Triangles of trimesh objects, and of others with vertices and faces, as arrays.

Objects are recognised by their attributes, so this module does not load trimesh. A user with such an object has already
loaded it.
"""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ..settings.scene import Cutout
from ._normals import crease_normals, weld
from ._textures import Textures, linear_colours, scaled_cutoff


@runtime_checkable
class Triangles(Protocol):
    """An object with triangles, such as a `trimesh.Trimesh`."""

    @property
    def vertices(self) -> Any:
        """(v, 3)."""
        ...

    @property
    def faces(self) -> Any:
        """(f, 3), indices into the vertices."""
        ...


@runtime_checkable
class TriangleScene(Protocol):
    """An object with several geometries and a graph that places them, such as a `trimesh.Scene`."""

    @property
    def geometry(self) -> Any:
        """Geometries by name."""
        ...

    @property
    def graph(self) -> Any:
        """`graph[node]` is the node's transform (4, 4) and the name of its geometry."""
        ...


class Part(NamedTuple):
    """Triangles in world space.

    - `vertices`: (v, 3), welded, float64; `faces`: (f, 3), indices into these.
    - `normals`: (f, 3, 3), a unit normal for each corner.
    - `albedo`: (f, 3), in [0, 1]; `None` if the object has no colours.
    - `corner_colours`: (f, 3, 3), in [0, 1], from its vertices; `None` if they have no colours.
    - `textures`: textures of its base colour, or `None`.
    """

    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "f 3"]
    normals: Float[HostArray, "f 3 3"]
    albedo: Float[HostArray, "f 3"] | None
    corner_colours: Float[HostArray, "f 3 3"] | None = None
    textures: Textures | None = None


def parts_of(given: Triangles | TriangleScene, crease_angle: float | int | None) -> list[Part]:
    """The triangles of `given`, with one part for each scene node that has triangles, in the order of its graph.
    **Warns** about geometries without faces, such as paths and point clouds, which are left out.

    **Raises** `ValueError` if there are no triangles, an array has a wrong shape, an index is out of range, or a vertex
    is not finite.
    """
    if not isinstance(given, TriangleScene):
        return [_part(given, np.eye(4), crease_angle, "the mesh")]
    placed = [(node, *given.graph[node]) for node in given.graph.nodes_geometry]
    left_out = sorted({str(name) for _, _, name in placed if not isinstance(given.geometry[name], Triangles)})
    if left_out:
        # The warning points to the user's line, whichever function takes the meshes.
        package = __file__.removesuffix("geometry/_trimesh.py")
        message = f"the scene is used without {', '.join(left_out)}: expected faces, and found none"
        warnings.warn(message, skip_file_prefixes=(package,))
    parts = [
        _part(given.geometry[name], np.asarray(matrix, np.float64), crease_angle, f"the scene's mesh {node!r}")
        for node, matrix, name in placed
        if isinstance(given.geometry[name], Triangles)
    ]
    if not parts:
        raise ValueError("the scene has no geometry with faces; expected at least one triangle: add a mesh to it")
    return parts


def _part(given: Triangles, to_world: Float[HostArray, "4 4"], crease_angle: float | int | None, name: str) -> Part:
    vertices, faces = _checked(given, name)
    if np.linalg.det(to_world[:3, :3]) < 0:
        faces = faces[:, ::-1]
    try:
        points, welded, kept = weld(vertices @ to_world[:3, :3].T + to_world[:3, 3], faces)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(welded) == 0:
        raise ValueError(
            f"every triangle of {name} has two corners at the same position; expected triangles with an area"
        )
    if crease_angle is None:
        normals = _own_normals(given, to_world, name)[faces[kept]]
    else:
        normals = crease_normals(points, welded, crease_angle)
    albedo, colours = _albedo(given, len(faces)), _vertex_colours(given)
    return Part(
        points,
        welded,
        normals,
        None if albedo is None else albedo[kept],
        None if colours is None else colours[faces[kept], :3],
        _textures(given, faces[kept], colours),
    )


def _checked(given: Triangles, name: str) -> tuple[Float[HostArray, "v 3"], Int[HostArray, "f 3"]]:
    vertices, faces = np.asarray(given.vertices, np.float64), np.asarray(given.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"the vertices of {name} have shape {vertices.shape}; expected (v, 3): x, y and z")
    if faces.size == 0:
        raise ValueError(f"{name} has no faces; expected at least one triangle: check how it was made")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(
            f"the faces of {name} have shape {faces.shape} and type {faces.dtype}; expected integers (f, 3): cut faces "
            "of more corners into triangles"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"the faces of {name} use vertices {faces.min()} to {faces.max()}; expected 0 to {len(vertices) - 1}"
        )
    return vertices, faces.astype(np.int64)


def _own_normals(given: Triangles, to_world: Float[HostArray, "4 4"], name: str) -> Float[HostArray, "v 3"]:
    """The vertices' unit normals in world space."""
    normals = np.asarray(getattr(given, "vertex_normals", None), np.float64)
    if normals.shape != np.shape(given.vertices) or not np.isfinite(normals).all():
        raise ValueError(f"{name} has no finite vertex_normals (v, 3); expected some, or a crease_angle in degrees")
    linear = to_world[:3, :3]
    # The inverse transpose times the determinant, whose sign a mirror has reversed.
    turned = normals @ np.stack([np.cross(linear[:, i - 2], linear[:, i - 1]) for i in range(3)])
    turned *= np.sign(np.linalg.det(linear)) or 1.0
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return turned / np.where(length > 0, length, 1)


def _albedo(given: Triangles, count: int) -> Float[HostArray, "f 3"] | None:
    """The colour of each of `count` faces; `None` if there are no colours."""
    visual = getattr(given, "visual", None)
    if not getattr(visual, "defined", False):
        return None
    material = getattr(visual, "material", None)
    if material is None:
        colours = None if getattr(visual, "kind", None) == "vertex" else getattr(visual, "face_colors", None)
    elif _image(material) is not None:
        # Without a factor, a texture's colours stay as they are.
        colours = getattr(material, "baseColorFactor", None)
    else:
        has_none = getattr(material, "baseColorFactor", material) is None
        colours = None if has_none else getattr(material, "main_color", None)
    if colours is None:
        return None
    return np.broadcast_to(np.asarray(colours, np.float64)[..., :3] / 255, (count, 3))


def _vertex_colours(given: Triangles) -> Float[HostArray, "v c"] | None:
    """The colours of vertices, possibly with alpha, in [0, 1]; `None` if they have no colours."""
    visual = getattr(given, "visual", None)
    if getattr(visual, "kind", None) == "vertex":
        stored = getattr(visual, "vertex_colors", ())
    else:
        # Together with a texture.
        attributes = getattr(visual, "vertex_attributes", None)
        stored = attributes.get("color", ()) if isinstance(attributes, Mapping) else ()
    colours = np.asarray(stored)
    if colours.shape not in [(len(given.vertices), width) for width in (3, 4)]:
        return None
    greatest = float(np.iinfo(colours.dtype.str).max) if colours.dtype.kind in "iu" else 1.0
    return np.clip(colours / greatest, 0, 1)


def _image(material: Any) -> Any:
    """The image of a material's base colour, or `None`."""
    image = getattr(material, "baseColorTexture", None)
    return getattr(material, "image", None) if image is None else image


def _textures(
    given: Triangles, faces: Int[HostArray, "f 3"], colours: Float[HostArray, "v c"] | None
) -> Textures | None:
    """The base-colour texture and its alpha test; `None` without an image or texture coordinates. The objects do not
    store samplers."""
    visual = getattr(given, "visual", None)
    material, uv = getattr(visual, "material", None), getattr(visual, "uv", None)
    image = None if material is None else _image(material)
    if image is None or uv is None or np.shape(uv)[:1] != np.shape(given.vertices)[:1]:
        return None
    factor = getattr(material, "baseColorFactor", None)
    cutoff = None
    if str(getattr(material, "alphaMode", None) or "").upper() == "MASK":
        given_cutoff = getattr(material, "alphaCutoff", None)
        cutoff = scaled_cutoff(Cutout.alpha_cutoff if given_cutoff is None else float(given_cutoff), _alpha(factor))
    # The image's first row is its top row.
    levels = np.asarray(image.convert("RGBA"), np.float64)[::-1] / 255
    has_alpha = cutoff is not None and colours is not None and colours.shape[1] == 4
    alpha = colours[faces, 3] if has_alpha and colours is not None else None
    return Textures.of(linear_colours(levels), np.asarray(uv, np.float64)[faces, :2], cutoff, corner_alpha=alpha)


def _alpha(factor: Any) -> float:
    return 1.0 if factor is None or np.size(factor) < 4 else float(np.asarray(factor)[3]) / 255
