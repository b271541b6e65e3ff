"""Triangle meshes."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arithmetic import array_module, as_float, as_int, concrete, is_traced, normalize
from .._checks import check_instance, check_outside_trace, listed
from .._padding import padded_to, shared_mesh_size
from .._pictures import SIDE, as_html, draw_faces, is_known, lit
from .._types import Faces, HostArray, Mat4, Vertices
from .._words import counted
from ..settings import Setting
from ..settings.quantities import Fraction
from ._textures import Textures, merged
from ._transforms import transform_points, transform_vectors
from ._trimesh import Triangles, TriangleScene, parts_of

# The albedo of a mesh without colours.
_GREY = 0.8
# The direction from which a mesh is shown.
_FROM = np.array([0.8, 0.7, 1.0])


def _as_faces(faces: Any) -> Faces:
    """**Raises** `ValueError` unless `faces` are triples of integers."""
    given = faces if isinstance(faces, jax.Array) else np.asarray(faces)
    if given.size == 0:
        return as_int(np.zeros((0, 3)))
    if given.ndim != 2 or given.shape[1] != 3:
        raise ValueError(
            f"the mesh's faces have shape {given.shape}; expected (f, 3): cut faces of more corners into triangles"
        )
    if not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"the mesh's faces are of type {given.dtype}; expected integers, indices into its vertices")
    return as_int(given)


class Mesh(eqx.Module):
    """Triangles in world space.

    - `vertices`: (v, 3), world units.
    - `faces`: (f, 3), indices into `vertices`, anticlockwise seen from outside.
    - `corner_normals`: (f, 3, 3), a unit shading normal for each corner of each face. Each side of a crease therefore
      has its own normals. Defaults to the face normals.
    - `albedo`: (f, 3), diffuse colour in [0, 1]. Defaults to light grey; to white with `corner_colours` or `textures`.
    - `corner_colours`: (f, 3, 3), a colour in [0, 1] for each corner of each face, or `None`.
    - `textures`: textures of the faces, or `None`.

    The diffuse colour of a point is the product of `albedo`, the interpolated colour of the corners, and the texture's
    colour.

    **Raises** `ValueError` if there is no face, a vertex is not finite, a face has an index out of range, an albedo or
    a colour is out of its range, or an array has another shape or type.

    !!! Example

        ```python
        triangle = geometry.Mesh([(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)], [(0, 1, 2)])
        geometry.face_normals(triangle)  # [[0. 1. 0.]]
        ```
    """

    vertices: Vertices
    faces: Faces
    corner_normals: Float[Array, "f 3 3"]
    albedo: Float[Array, "f 3"]
    corner_colours: Float[Array, "f 3 3"] | None = None
    textures: Textures | None = None

    def __init__(
        self,
        vertices: Any,
        faces: Any,
        corner_normals: Any = None,
        albedo: Any = None,
        corner_colours: Any = None,
        textures: Textures | None = None,
    ):
        self.vertices = as_float(vertices)
        self.faces = _as_faces(faces)
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ValueError(f"the mesh's vertices have shape {self.vertices.shape}; expected (v, 3): x, y and z")
        if corner_normals is None:
            if self.faces.shape[0] and self.vertices.shape[0]:
                normals = face_normals(self)
                xp = array_module(normals)
                corner_normals = xp.broadcast_to(xp.asarray(normals)[:, None], (*self.faces.shape, 3))
            else:
                corner_normals = np.zeros((*self.faces.shape, 3))
        self.corner_normals = as_float(corner_normals)
        if albedo is None:
            albedo = _GREY if corner_colours is None and textures is None else 1.0
        xp = array_module(albedo, self.faces)
        self.albedo = as_float(xp.broadcast_to(xp.asarray(albedo), self.faces.shape))
        self.corner_colours = None if corner_colours is None else as_float(corner_colours)
        self.textures = textures
        if self.corner_colours is not None and self.corner_colours.shape != (*self.faces.shape, 3):
            raise ValueError(
                f"the mesh's corner_colours have shape {self.corner_colours.shape}; expected {(*self.faces.shape, 3)}, "
                "a colour for each corner of each face"
            )
        if textures is not None and textures.index.shape != self.faces.shape[:1]:
            raise ValueError(
                f"the mesh's textures are for {textures.index.shape[0]} faces; expected {self.faces.shape[0]}, the "
                "number of the mesh's faces"
            )

    def __check_init__(self):
        faces, vertices = concrete(self.faces), concrete(self.vertices)
        if faces is not None and faces.shape[0] == 0:
            raise ValueError("the mesh has no faces; expected at least one triangle: check the file or its export")
        if vertices is not None and not np.isfinite(vertices).all():
            bad = np.flatnonzero(~np.isfinite(vertices).all(axis=-1))
            raise ValueError(
                f"{len(bad)} of the mesh's {len(vertices)} vertices are NaN or infinite (the first is vertex "
                f"{bad[0]}); expected finite coordinates: repair the mesh"
            )
        limits = Setting.of(Fraction).limits
        for name in ("albedo", "corner_colours"):
            colours = None if getattr(self, name) is None else concrete(getattr(self, name))
            if colours is not None and not ((colours >= limits.low) & (colours <= limits.high)).all():
                first = colours.reshape(-1, 3)[0]
                raise ValueError(f"the mesh's {name} is {listed(first)} and so on; expected numbers {limits.words}")
        if faces is not None and (faces.min() < 0 or faces.max() >= self.vertices.shape[0]):
            raise ValueError(
                f"the mesh's faces use vertices {faces.min()} to {faces.max()}, but it has {self.vertices.shape[0]}; "
                "expected indices from 0 to one less than the number of vertices"
            )

    @classmethod
    def from_trimesh(cls, given: Triangles | TriangleScene, crease_angle: float | int | None = 30.0) -> "Mesh":
        """The mesh of a trimesh object, or of any other object with `vertices` and `faces`.

        Vertices at the same position are welded, as in `io.load_mesh`.

        **Arguments:**

        - `given`: a `trimesh.Trimesh`; a `trimesh.Scene`, whose meshes are merged with the transforms of its graph; or
            an object with `vertices` (v, 3) and triangular `faces` (f, 3). Colours of faces, vertices and materials
            become albedo without conversion. A base-colour texture needs texture coordinates (`visual.uv`). Its sRGB
            colours are converted to linear colours. It repeats and is bilinear, because trimesh does not store
            samplers. A glTF material's alpha test is applied.
        - `crease_angle`: degrees. Edges with a larger angle are shaded as sharp (`crease_normals`). `None` uses the
          object's `vertex_normals`.

        **Warns** about geometries of a scene without faces, such as paths, which are left out.

        **Raises** `ValueError` if there are no triangles, an array has a wrong shape, an index is out of range, a
        vertex is not finite, or normals are requested and missing.
        """
        return merge(meshes_of(given, crease_angle))

    def to_trimesh(self) -> Any:
        """A `trimesh.Trimesh` with the same vertices and faces in the same order, and the albedo as face colours.

        Colours have 8 bits. A face with a varying colour has its mean colour. trimesh computes the normals, because it
        does not store normals for corners.
        """
        check_outside_trace("Mesh.to_trimesh", "a mesh of known numbers", "call it outside", self)
        import trimesh  # which takes long to load

        colours = np.round(255 * face_colours(self)).astype(np.uint8)
        return trimesh.Trimesh(np.asarray(self.vertices), np.asarray(self.faces), face_colors=colours, process=False)

    def transformed(self, matrix: Mat4) -> "Mesh":
        """The mesh under an affine `matrix`, with normals under its inverse transpose. A reflection flips the faces."""
        vertices, faces, normals = _transformed(matrix, self.vertices, self.faces, self.corner_normals)
        colours, textures = self.corner_colours, self.textures
        if colours is not None or textures is not None:
            mirrored = jnp.linalg.det(matrix[:3, :3]) < 0
            colours = None if colours is None else jnp.where(mirrored, colours[:, ::-1], colours)
            textures = None if textures is None else textures.turned(mirrored)
        return Mesh(vertices, faces, normals, self.albedo, colours, textures)

    def _repr_html_(self) -> str | None:
        """A picture from the upper right of the front."""
        if not is_known(self):
            return None
        faces, (low, high) = np.asarray(self.faces), np.asarray(self.bounds)
        right = np.cross((0, 1, 0), _FROM)
        axes = np.stack([each / np.linalg.norm(each) for each in (right, np.cross(_FROM, right), -_FROM)], axis=-1)
        half = max(float(np.linalg.norm(high - low)) / 2, np.finfo(np.float32).tiny)
        seen = (np.asarray(self.vertices) - (low + high) / 2) @ axes / half
        colours = lit(np.asarray(face_normals(self)), _FROM, face_colours(self))
        image = draw_faces(np.append(seen, np.ones((len(seen), 1)), axis=1), faces, colours, (SIDE, SIDE))
        size = " x ".join(f"{length:.3g}" for length in high - low)
        return as_html(f"Mesh: {counted(len(faces), 'triangle')}, {len(seen):,} vertices, {size} world units", image)

    def padded(self, to: tuple[int, int] | None = None) -> "Mesh":
        """The mesh with extra faces. They are points, and therefore invisible. Its arrays then have one of a few sizes,
        so that meshes of similar size share compiled programs. A traced mesh is returned unchanged.

        **Arguments:** `to`: the numbers of faces and vertices after padding; by default the next of a few sizes.
        """
        count, vertices = self.faces.shape[0], self.vertices.shape[0]
        faces, size = shared_mesh_size(count, vertices) if to is None else to
        has_its_size = (count, vertices) == (faces, size) and (self.textures is None or self.textures.is_padded)
        if has_its_size or is_traced(self):
            return self
        corner = int(np.asarray(self.faces)[0, 0])
        arrays = [
            padded_to(self.vertices, size, np.asarray(self.vertices)[corner]),
            padded_to(self.faces, faces, corner),
            padded_to(self.corner_normals, faces),
            padded_to(self.albedo, faces),
        ]
        if self.corner_colours is not None:
            arrays.append(padded_to(self.corner_colours, faces))
        if self.textures is not None:
            arrays += jax.tree.leaves(self.textures.padded(faces))
        # Without the checks for users' meshes, which take longer.
        return jax.tree.unflatten(jax.tree.structure(self), jax.device_put(arrays))

    @property
    def alpha_test(self) -> Textures | None:
        """The textures if some of them have an alpha test; `None` if no face is cut out."""
        return None if self.textures is None or self.textures.cutoff is None else self.textures

    @property
    def bounds(self) -> Float[Array, "2 3"]:
        """Minimum and maximum coordinates of the vertices that faces use, (2, 3), world units."""
        xp = array_module(self.vertices, self.faces)
        used = xp.asarray(self.vertices)[xp.asarray(self.faces)].reshape(-1, 3)
        return as_float(xp.stack([used.min(axis=0), used.max(axis=0)]))


MeshLike = Mesh | Triangles | TriangleScene
"""A mesh, or an object that `Mesh.from_trimesh` converts to one."""


def meshes_of(given: Triangles | TriangleScene, crease_angle: float | int | None = 30.0) -> list[Mesh]:
    """Like `Mesh.from_trimesh`, but with a mesh for each node of a scene."""
    return [
        Mesh(part.vertices, part.faces, part.normals, part.albedo, part.corner_colours, part.textures)
        for part in parts_of(given, crease_angle)
    ]


def as_mesh(given: Any, name: str = "the mesh") -> Mesh:
    """`given` if it is a mesh, and otherwise `Mesh.from_trimesh(given)`. Messages call it `name`.

    **Raises** the errors of `Mesh.from_trimesh`, and `TypeError` for any other object.
    """
    if isinstance(given, Mesh):
        return given
    has_faces = isinstance(given, Triangles | TriangleScene) and not isinstance(given, type)
    if not has_faces:
        check_instance(name, given, Mesh, "a Mesh, or an object with vertices and faces, such as a trimesh.Trimesh")
    return Mesh.from_trimesh(given)


def face_normals(mesh: Mesh) -> Float[Array, "f 3"]:
    """Unit geometric normal of each face, (f, 3), outwards by the right-hand rule; 0 for a face without area."""
    vertices, faces = mesh.vertices, mesh.faces
    if array_module(vertices, faces) is jnp:
        return _face_normals(vertices, faces)
    # Padded, so that meshes of similar size share a program.
    size, count = shared_mesh_size(faces.shape[0], vertices.shape[0])
    return as_float(np.asarray(_face_normals(padded_to(vertices, count), padded_to(faces, size)))[: faces.shape[0]])


@jax.jit
def _transformed(
    matrix: Mat4, vertices: Vertices, faces: Faces, normals: Float[Array, "f 3 3"]
) -> tuple[Vertices, Faces, Float[Array, "f 3 3"]]:
    vertices = transform_points(matrix, vertices)[..., :3]
    normals = normalize(transform_vectors(jnp.linalg.inv(matrix).T, normals))
    mirrored = jnp.linalg.det(matrix[:3, :3]) < 0
    return vertices, jnp.where(mirrored, faces[:, ::-1], faces), jnp.where(mirrored, normals[:, ::-1], normals)


@jax.jit
def _face_normals(vertices: Vertices, faces: Faces) -> Float[Array, "f 3"]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return normalize(jnp.cross(b - a, c - a))


def merge(meshes: Sequence[MeshLike]) -> Mesh:
    """One mesh that holds the triangles of all `meshes`, in their order.

    !!! Example

        ```python
        one = geometry.merge([geometry.library_mesh("plane"), geometry.library_mesh("box")])
        one.faces.shape  # (14, 3)
        ```
    """
    meshes = [as_mesh(mesh) for mesh in meshes]
    if not meshes:
        raise ValueError("got no meshes to merge; expected at least one")
    if len(meshes) == 1:
        return meshes[0]
    xp = array_module(*jax.tree.leaves(list(meshes)))
    starts = np.cumsum([0] + [mesh.vertices.shape[0] for mesh in meshes])
    return Mesh(
        xp.concatenate([mesh.vertices for mesh in meshes]),
        xp.concatenate([xp.asarray(mesh.faces) + int(start) for mesh, start in zip(meshes, starts, strict=False)]),
        xp.concatenate([mesh.corner_normals for mesh in meshes]),
        xp.concatenate([mesh.albedo for mesh in meshes]),
        _merged_colours(meshes),
        merged([mesh.textures for mesh in meshes], [mesh.faces.shape[0] for mesh in meshes]),
    )


def _merged_colours(meshes: Sequence[Mesh]) -> Float[Array, "f 3 3"] | None:
    """The corner colours of all `meshes`; white for a mesh without them. `None` if no mesh has any."""
    if all(mesh.corner_colours is None for mesh in meshes):
        return None
    xp = array_module(*(mesh.corner_colours for mesh in meshes))
    white = lambda mesh: xp.ones((*mesh.faces.shape, 3), np.float32)
    return as_float(
        xp.concatenate([white(mesh) if mesh.corner_colours is None else mesh.corner_colours for mesh in meshes])
    )


def face_colours(mesh: Mesh) -> Float[HostArray, "f 3"]:
    """One colour for each face of a mesh with known values: its albedo, times the mean colour of its corners and the
    texture's colour at its centre."""
    colours = np.asarray(mesh.albedo)
    if mesh.corner_colours is not None:
        colours = colours * np.asarray(mesh.corner_colours).mean(axis=1)
    if mesh.textures is not None:
        of = mesh.textures
        colours = colours * np.asarray(of.at(as_int(of.index), as_float(np.asarray(of.uv).mean(axis=1))))[:, :3]
    return colours
