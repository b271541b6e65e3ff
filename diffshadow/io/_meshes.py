"""Reads meshes."""

import functools
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from .._words import counted
from ..geometry import Mesh, crease_normals, step_of, weld
from ..settings.scene import GLTF_SUFFIXES, TexelFilter, Wraps
from ._errors import FileError, MeshError, MeshWarning, damaged
from ._gltf import read_gltf
from ._gltf_data import files_beside
from ._looks import GivenTexture, Looks, MeshLooks, Picture, looks_of_triangles, read_texture
from ._obj import files_beside_obj, read_obj
from ._off import read_off
from ._paths import existing_file, on_disk
from ._ply import read_ply
from ._polygons import Polygons, triangulate
from ._stl import read_stl
from ._trimesh import read_others, suffix_of_others

# Readers take the file's bytes and its folder.
_READERS: Mapping[str, Callable[[bytes, Path], Polygons]] = {
    **dict.fromkeys(GLTF_SUFFIXES, read_gltf),
    ".obj": read_obj,
    ".off": lambda data, _: read_off(data),
    ".ply": lambda data, _: read_ply(data),
    ".stl": lambda data, _: read_stl(data),
}
# This many recently read images are kept for meshes that share them.
_IMAGES_KEPT = 8
# Coordinates beyond this are infinite in float32.
_MOST = float(np.finfo(np.float32).max)
# Coordinates this close to whole steps, as a fraction of a step, were rounded to these steps.
_BETWEEN = 0.125
# Multiples of this many steps of single precision are round numbers, which have lost no digits.
_ROUND = 8
# A mesh with fewer vertices than this, such as a box, may have round coordinates by design.
_FEW = 12


def load_mesh(
    path: str | os.PathLike[str],
    crease_angle: float | int | None = 30.0,
    *,
    albedo: Sequence[float] | None = None,
    texture: str | os.PathLike[str] | None = None,
    alpha_cutoff: float | None = None,
    texture_wrap: Wraps | None = None,
    texture_filter: TexelFilter | None = None,
) -> Mesh:
    """Reads a mesh from a file: OBJ, PLY, STL, OFF, GLB, glTF 2.0, or a format that trimesh reads.

    The objects of a file are merged into one mesh, with their nodes' transforms applied. Vertices at the same position
    are welded (files split them at texture seams). Polygons, convex or concave, are cut into triangles. Skins are posed
    by the file's nodes. Vertex colours are read from PLY, GLB and glTF as linear colours. From GLB and glTF, materials
    are read too: base colours, their textures and samplers, and alpha tests. From the MTL files of an OBJ file, `Kd`
    (linear), `map_Kd`, `map_d` and `d` are read. A `map_d` cuts out alpha below 0.5. trimesh reads other formats, such
    as 3MF, COLLADA and zip archives, without colours. trimesh cuts polygons as fans, and some formats need a further
    package (`pip install 'diffshadow[meshes]'`).

    **Arguments:**

    - `path`: the file; its suffix names the format. Text may be in any encoding.
    - `crease_angle`: degrees. Edges with a larger angle are shaded as sharp. `None` uses the file's vertex normals,
      which PLY, GLB and glTF can have.

    - `albedo`: (3,), in [0, 1], multiplies the file's colours and textures; by default white, or light grey for a file
        without colours and textures.
    - `texture`: the file of an sRGB image, which replaces all textures. The mesh file must have texture coordinates,
        which are read from OBJ, PLY, GLB and glTF.
    - `alpha_cutoff`: alpha in [0, 1] below which faces are cut out. Alpha is the texture's alpha times the vertices'
        alpha of PLY, GLB and glTF. 0 for no alpha test; by default as in the file.
    - `texture_wrap`: the wrapping of textures beyond their images: `"repeat"`, `"clamp"` or `"mirror"`, or a pair of
      these along u and v; by default as in the file, or repeat.
    - `texture_filter`: the filter between texels: `"linear"` or `"nearest"`; by default as in the file, or linear.

    **Returns:** the mesh in the file's units and axes; use `fit_to_size` and `drop_to_ground` to place it in a scene.
    Under `jax.enable_x64`, its vertices are float64. A mesh far from the file's origin needs this.

    **Warns** with `MeshWarning` if the file has parts other than triangles, such as lines, if polygons are cut as fans,
    or if its coordinates are so far from the origin that single precision has changed the mesh's shape.

    **Raises** `FileError` if the file is missing, damaged, in an unknown format or in one whose package is missing,
    requires an unsupported extension of its format, has a polygon that crosses itself, holds no triangles, or holds
    vertices that are not finite; without a `crease_angle` if it has no normals, or some that are not finite; with a
    `texture` if that cannot be read, or there are no texture coordinates; with an `alpha_cutoff` without textures and
    without alpha of vertices; and with a `texture_wrap` or a `texture_filter` without textures.

    !!! Example

        ```python
        io.write_ply("triangle.ply", np.eye(3, dtype=np.float32), np.array([[0, 1, 2]]))
        io.load_mesh("triangle.ply").faces.shape  # (1, 3)
        ```
    """
    file = existing_file(path, "mesh")
    try:
        # NaN and infinite coordinates are checked after reading.
        with np.errstate(all="ignore"):
            if texture is not None and file.suffix.lower() == ".obj":
                polygons = read_obj(on_disk(file).read_bytes(), file.parent, with_uv=True)
            else:
                polygons = _reader(file)(on_disk(file).read_bytes(), file.parent)
        _check(polygons)
        triangles = triangulate(polygons)
        vertices, faces, kept = weld(polygons.vertices, triangles)
        normals = _own_normals(polygons)[triangles[kept]] if crease_angle is None else None
        picture = None if texture is None else _image(texture)
        given = GivenTexture(picture, alpha_cutoff, texture_wrap, texture_filter)
        looks = _looks(polygons, triangles[kept], kept, given)
    except MeshError as fault:
        raise FileError(f"the mesh file {file} {fault}") from fault
    except OSError as error:
        raise FileError(f"cannot read the mesh file {file}: {error.strerror or error}") from error
    if len(faces) == 0:
        raise FileError(
            f"every triangle of the mesh file {file} has two corners at the same position; "
            "expected triangles with an area: check its export"
        )
    if polygons.are_fans:
        warnings.warn(
            MeshWarning(
                f"the mesh file {file} is read by trimesh, which cuts polygons as fans: concave ones come out wrong; "
                "to avoid this, convert it to OBJ, PLY or glTF"
            ),
            stacklevel=2,
        )
    left_out = _left_out(polygons, _tiny(polygons.vertices[triangles], len(faces)))
    if left_out:
        warnings.warn(MeshWarning(f"the mesh file {file} is loaded without its {left_out}"), stacklevel=2)
    # Before the weld, which merges vertices that were rounded to the same position.
    if coarse := coarse_steps(polygons.vertices[np.unique(polygons.corners)]):
        warnings.warn(MeshWarning(f"the mesh file {file} {coarse}"), stacklevel=2)
    if crease_angle is not None:
        normals = crease_normals(vertices, faces, crease_angle)
    if albedo is not None:
        factor = np.asarray(albedo, np.float64)
        looks = looks._replace(albedo=factor if looks.albedo is None else factor * looks.albedo)
    return Mesh(vertices, faces, normals, *looks)


def _image(path: str | os.PathLike[str]) -> Picture:
    """Reads an image file. **Raises** `FileError` if it cannot be read."""
    file = existing_file(path, "texture")
    try:
        copy = on_disk(file)
        state = copy.stat()
        return _read_image(copy, str(file), state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise FileError(f"cannot read the texture {file}: {error.strerror or error}") from error


@functools.lru_cache(maxsize=_IMAGES_KEPT)
def _read_image(file: Path, name: str, time: int, size: int) -> Picture:
    """An image file last changed at this time. All meshes with this image share one array."""
    return read_texture(file.read_bytes(), name)


def _looks(
    polygons: Polygons,
    triangles: Int[HostArray, "t 3"],
    number: Int[HostArray, " t"],
    given: GivenTexture,
) -> MeshLooks:
    """The colours and textures of the triangles with these indices in the file.

    **Raises** `MeshError` for a texture without coordinates, and for a cutoff or a sampler without textures.
    """
    polygon = np.repeat(np.arange(len(polygons.sizes)), np.maximum(polygons.sizes - 2, 0))[number]
    looks = looks_of_triangles(polygons.looks or Looks(), triangles, polygon, given)
    names = {"alpha_cutoff": given.cutoff, "texture_wrap": given.wrap, "texture_filter": given.filter}
    for name, value in names.items():
        if value is not None and looks.textures is None:
            raise MeshError(
                f"has no textures, and {name} {value} was given; expected a texture with it: give one, or leave {name} "
                "out"
            )
    return looks


def files_of_mesh(path: str | os.PathLike[str]) -> list[Path]:
    """The absolute paths of a mesh file and of the files that it refers to, if they exist."""
    file = Path(os.path.abspath(path))
    beside = {**dict.fromkeys(GLTF_SUFFIXES, files_beside), ".obj": files_beside_obj}.get(file.suffix.lower())
    if beside is None:
        return [file]
    try:
        return [file, *beside(on_disk(file).read_bytes(), file.parent)]
    except (MeshError, OSError):
        # The reader reports it.
        return [file]


def _reader(file: Path) -> Callable[[bytes, Path], Polygons]:
    """The reader for the suffix of `file`.

    **Raises** `FileError` if there is none.
    """
    if own := _READERS.get(file.suffix.lower()):
        return own
    suffix = suffix_of_others(file)
    if suffix is None:
        raise FileError(
            f"cannot read the mesh file {file}: its suffix is {file.suffix!r}; expected one of "
            f"{', '.join(_READERS)}, or of a format of meshes that trimesh reads, such as .3mf or .zip: convert it"
        )
    return lambda data, _: read_others(data, suffix, file.name)


def coarse_steps(vertices: Float[HostArray, "v 3"]) -> str:
    """The fault of `vertices` that were rounded to single precision far from their origin. Empty if there is no
    fault."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    step = step_of(low, high)
    if not step or len(vertices) < _FEW:
        return ""
    # Coordinates below the largest power of two have smaller steps.
    far = vertices[np.abs(vertices) >= 2.0 ** np.floor(np.log2(np.abs(vertices).max()))]
    # In binary numbers, or in the decimals of a text file.
    decimal = lambda least: 10.0 ** np.ceil(np.log10(least))
    off = lambda steps: np.abs(far - np.round(far / steps) * steps).max()
    are_whole = lambda steps: bool(off(steps) <= _BETWEEN * min(step, steps))
    is_rounded = are_whole(step) or are_whole(decimal(step * _BETWEEN))
    if not is_rounded or are_whole(_ROUND * step) or are_whole(decimal(_ROUND * step)):
        return ""
    return (
        f"is far from its origin: its coordinates are rounded to steps of {step:.2g}, "
        f"{step / (high - low).max():.2%} of its size, as in single precision, which changes its shape; move it to "
        "the origin before the export, and set its position with translate"
    )


def _own_normals(polygons: Polygons) -> Float[HostArray, "v 3"]:
    """The unit normals of the file's vertices; 0 where they are 0.

    **Raises** `MeshError` if there are none, or a face uses one that is not finite.
    """
    normals = polygons.normals
    if normals is None:
        raise MeshError("has no normals of vertices, or a format whose normals are not read; set normals to creases")
    if not np.isfinite(normals[polygons.corners]).all():
        raise damaged("some of its normals are NaN or infinite")
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals / np.where(length > 0, length, 1)


def _check(polygons: Polygons) -> None:
    """**Raises** `MeshError` if there are no faces, or a face refers to a missing or non-finite vertex."""
    vertices, corners, sizes = polygons[:3]
    if not (sizes >= 3).any():
        found = _left_out(polygons) or (f"{len(vertices)} points" if len(vertices) else "")
        raise MeshError(
            f"holds {f'{found} but ' if found else ''}no triangles; expected at least one triangle: check its export"
        )
    unknown = np.flatnonzero((corners < 0) | (corners >= len(vertices)))
    if len(unknown):
        face = int(np.searchsorted(np.cumsum(sizes), unknown[0], side="right"))
        raise damaged(f"face {face + 1} refers to vertex {corners[unknown[0]]}; expected 0 to {len(vertices) - 1}")
    bad = np.unique(corners[~(np.abs(vertices) <= _MOST).all(axis=-1)[corners]])
    if len(bad):
        raise damaged(
            f"{len(bad)} of the {len(vertices)} vertices are NaN or infinite in single precision "
            f"(the first is vertex {bad[0]})"
        )


def _tiny(triangles: Float[HostArray, "t 3 3"], left: int) -> int:
    """The number of triangles with three distinct corners that the weld dropped. `left` is the number that remains."""
    apart = (triangles != np.roll(triangles, 1, axis=1)).any(axis=-1).all(axis=-1)
    return int(np.count_nonzero(apart)) - left


def _left_out(polygons: Polygons, tiny: int = 0) -> str:
    """The parts of the file that are not loaded, in words. Empty if there are none."""
    counts = {
        **polygons.left_out,
        "face of fewer than three corners": int((polygons.sizes < 3).sum()),
        "triangle of a millionth of its extent": tiny,
    }
    words = [counted(count, name) for name, count in counts.items() if count]
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
