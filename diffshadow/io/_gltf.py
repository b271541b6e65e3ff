"""glTF 2.0 files, as JSON or GLB.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 3.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import DracoPy
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from .._types import HostArray
from ..geometry import NO_TEXTURE
from ._errors import Faults, MeshError, damaged
from ._gltf_data import Buffers, Form, NoDataError, chunks, item, unread
from ._gltf_materials import BaseColour, Materials
from ._gltf_schema import DRACO, INSTANCES, VISIBILITY, Document, Node, Primitive, not_obeyed, parse
from ._gltf_skins import Skins
from ._looks import Looks
from ._polygons import Polygons, repeated, strip_triangles
from ._text import excerpt


class _Triangles(NamedTuple):
    """Vertices, triangles, and normals of the vertices, if the file has them."""

    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "t 3"]
    normals: Float[HostArray, "v 3"] | None = None


class Part(NamedTuple):
    """The triangles of a primitive of a node's mesh, in world space.

    - `vertices`, `normals`: (v, 3); `normals` is `None` if the file has none.
    - `faces`: (t, 3), indices into `vertices`.
    - `look`: its base colour.
    """

    node: Node
    primitive: Primitive
    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "t 3"]
    normals: Float[HostArray, "v 3"] | None
    look: BaseColour


class PlacedNode(NamedTuple):
    """A node of the scene with its number in the file, its matrix to world space, and whether it and all of its
    ancestors are visible."""

    node: Node
    number: int
    to_world: Float[HostArray, "4 4"]
    is_visible: bool


# Primitive modes other than triangles: their names, and the number of primitives that n vertices make.
_OTHERS = {
    0: ("point", lambda n: n),
    1: ("line", lambda n: n // 2),
    2: ("line", lambda n: n),
    3: ("line", lambda n: max(n - 1, 0)),
}
_LIST, _STRIP, _FAN = 4, 5, 6
HIDDEN_MESH, NO_POSITIONS = "hidden mesh", "primitive without positions"
CUT_OUT = "primitive that its alpha test cuts out"
_UNREAD_SKIN = "that cannot be read, so its size and position come from its vertices and its node"
# The matrices of this many instances take half a gigabyte.
_MAX_INSTANCES = 1 << 22
# The attributes of instances.
_PLACEMENT: Mapping[str, Form] = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}


def read_gltf(data: bytes, folder: Path) -> Polygons:
    """Reads the triangles of a file's scene, with node transforms, morph weights and skins applied.

    **Arguments:**

    - `data`: the file's bytes.
    - `folder`: the file's folder, where the files it refers to are looked up.

    **Raises** `MeshError` if the file is damaged, or stores its triangles in a way that is not supported.
    """
    text, binary = chunks(data)
    document = parse(text)
    left_out: Counter[str] = Counter()
    parts = [*parts_of(document, Buffers(document, binary, folder), left_out)]
    if any(part.normals is not None for part in parts):
        parts = [part if part.normals is not None else _flat(part) for part in parts]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    corners = np.concatenate([np.zeros((0, 3), np.int64), *faces])
    normals = [part.normals for part in parts if part.normals is not None]
    return Polygons(
        np.concatenate([np.zeros((0, 3)), *(part.vertices for part in parts)]),
        corners.reshape(-1),
        np.full(len(corners), 3),
        left_out,
        np.concatenate(normals) if normals else None,
        looks=_looks(parts),
    )


def _looks(parts: Sequence[Part]) -> Looks | None:
    """The looks of several parts, joined. `None` if no part has a material or colours."""
    looks = [part.look for part in parts]
    if all(look.factor is None and look.colours is None for look in looks):
        return None
    vertices, faces = [len(part.vertices) for part in parts], [len(part.faces) for part in parts]

    def by_vertex(name: str, missing: Sequence[float] | float) -> HostArray | None:
        given = [getattr(look, name) for look in looks]
        if all(values is None for values in given):
            return None
        rows = lambda count: np.tile(np.asarray(missing, float), (count, *[1] * np.ndim(missing)))
        return np.concatenate([rows(count) if of is None else of for of, count in zip(given, vertices, strict=True)])

    textures = list(dict.fromkeys(look.texture for look in looks if look.texture is not None))
    index = [NO_TEXTURE if look.texture is None else textures.index(look.texture) for look in looks]
    factors = [np.ones(3) if look.factor is None else look.factor for look in looks]
    return Looks(
        by_vertex("colours", (1, 1, 1)),
        by_vertex("uv", (0, 0)),
        np.repeat(factors, faces, axis=0),
        np.repeat(index, faces),
        textures,
        by_vertex("alpha", 1),
    )


def parts_of(
    document: Document, buffers: Buffers, left_out: Counter[str], faults: Faults | None = None
) -> Iterator[Part]:
    """The triangles of a file's scene, with node transforms, morph weights and skins applied.

    Parts that are hidden, not triangles, or not supported are added to `left_out`.

    **Arguments:**

    - `faults`: if given, a primitive that cannot be read is added there, and the others are read.

    **Raises** `MeshError` as `read_gltf` does.
    """
    left_out["animation"] += len(document.animations)
    left_out.update(f"extension {name}" for name in not_obeyed(document))
    materials = Materials(document, buffers, left_out)
    nodes = [*nodes_of(document)]
    skins = Skins(document, buffers, {each.number: each.to_world for each in nodes})
    for node, _, to_world, is_visible in nodes:
        if node.mesh is None:
            continue
        if not is_visible:
            left_out[HIDDEN_MESH] += 1
            continue
        mesh = item(document.meshes, node.mesh, "mesh")
        for primitive in mesh.primitives:
            if primitive.mode in _OTHERS:
                name, count = _OTHERS[primitive.mode]
                left_out[name] += count(_count(primitive, buffers))
            elif "POSITION" not in primitive.attributes:
                left_out[NO_POSITIONS] += 1
            else:
                weights = mesh.weights if node.weights is None else node.weights
                try:
                    triangles = _triangles(primitive, weights, buffers)
                    look = materials.base_colour(primitive, len(triangles.vertices))
                    if look.is_cut_out:
                        left_out[CUT_OUT] += 1
                        continue
                    try:
                        posed = None if node.skin is None else skins.posed(node.skin, primitive, *triangles)
                    except (MeshError, NoDataError):
                        posed = None
                        left_out[f"skin of {node.name or mesh.name or 'mesh'} {_UNREAD_SKIN}"] = 1
                    if posed is not None:
                        # The node's own position does not count.
                        triangles, to_world = _Triangles(*posed), np.eye(4)
                    places = to_world @ _instances(node, buffers)
                    yield Part(node, primitive, *repeated(*triangles, places), look.repeated(len(places)))
                except MeshError as fault:
                    if faults is None:
                        raise
                    faults.add(node.name or mesh.name or "mesh", fault)


def _flat(part: Part) -> Part:
    """The part with face normals, which the format prescribes if it stores no normals."""
    corners = part.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = np.arange(part.faces.size).reshape(-1, 3)
    look = part.look.of_vertices(part.faces.reshape(-1))
    vertices = corners.reshape(-1, 3)
    return part._replace(vertices=vertices, faces=faces, normals=np.repeat(normals, 3, axis=0), look=look)


def nodes_of(document: Document) -> Iterator[PlacedNode]:
    """The nodes of the scene: the file's default scene, or otherwise its first one. In a file without scenes, all nodes
    are used.
    """
    if document.scene is not None or document.scenes:
        roots = item(document.scenes, document.scene or 0, "scene").nodes
    else:
        children = {child for node in document.nodes for child in node.children}
        roots = [i for i in range(len(document.nodes)) if i not in children]
    seen: set[int] = set()
    waiting = [(root, np.eye(4), True) for root in reversed(roots)]
    while waiting:
        index, parent, is_visible = waiting.pop()
        node = item(document.nodes, index, "node")
        if index in seen:
            raise damaged(f"its node {index} has two parents, or is its own ancestor")
        seen.add(index)
        to_world = parent @ _matrix(node, index)
        is_visible = is_visible and not _is_hidden(node)
        yield PlacedNode(node, index, to_world, is_visible)
        waiting += [(child, to_world, is_visible) for child in reversed(node.children)]


def _is_hidden(node: Node) -> bool:
    """Whether the node itself is hidden, regardless of its ancestors. Drafts of the extension use `hidden` for
    `visible`."""
    stored = node.extensions.get(VISIBILITY)
    return isinstance(stored, Mapping) and (stored.get("visible") is False or stored.get("hidden") is True)


def _instances(node: Node, buffers: Buffers) -> Float[HostArray, "n 4 4"]:
    """The matrices from the instances of the node's mesh to the node's space."""
    stored = node.extensions.get(INSTANCES)
    attributes = stored.get("attributes") if isinstance(stored, Mapping) else None
    if not isinstance(attributes, Mapping) or not attributes:
        return np.eye(4)[None]
    columns: dict[str, HostArray] = {}
    for name, form in _PLACEMENT.items():
        index = attributes.get(name)
        if index is not None:
            if not isinstance(index, int) or index < 0:
                raise damaged(f"the {name} of its instances is {excerpt(str(index))}; expected an accessor")
            columns[name] = _plain_values(buffers, index, form)
    counts = {len(rows) for rows in columns.values()}
    if len(counts) > 1:
        raise damaged(
            f"its instances have {' and '.join(map(str, sorted(counts)))} rows; expected the same number of each kind"
        )
    count = counts.pop() if counts else 1
    if count > _MAX_INSTANCES:
        raise MeshError(f"has {count:,} instances; expected at most {_MAX_INSTANCES:,}: leave some out")
    matrices = np.tile(np.eye(4), (count, 1, 1))
    try:
        if "ROTATION" in columns:
            matrices[:, :3, :3] = Rotation.from_quat(columns["ROTATION"]).as_matrix()
    except ValueError as error:
        raise damaged("the rotation of one of its instances is not a unit quaternion") from error
    if "SCALE" in columns:
        matrices[:, :3, :3] *= columns["SCALE"][:, None]
    if "TRANSLATION" in columns:
        matrices[:, :3, 3] = columns["TRANSLATION"]
    return matrices


def _plain_values(buffers: Buffers, index: int, form: Form) -> Float[HostArray, "n width"]:
    try:
        return buffers.values(index, form).astype(np.float64)
    except NoDataError:
        raise damaged(f"its accessor {index} has no data") from None


def _matrix(node: Node, index: int) -> Float[HostArray, "4 4"]:
    """The matrix from the node's space to its parent's: section 3.5.3."""
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T
    matrix = np.eye(4)
    try:
        matrix[:3, :3] = Rotation.from_quat(node.rotation).as_matrix() * node.scale
    except ValueError as error:
        raise damaged(f"its node {index} is rotated by {list(node.rotation)}, which is not a rotation") from error
    matrix[:3, 3] = node.translation
    return matrix


def _triangles(primitive: Primitive, weights: Sequence[float], buffers: Buffers) -> _Triangles:
    """The vertices and triangles of a primitive. Their order is defined in section 3.7.2.1."""
    try:
        points = buffers.values(primitive.attributes["POSITION"], "VEC3").astype(np.float64)
        triangles = _ordered(_indices(primitive, buffers), primitive.mode)
        normal = primitive.attributes.get("NORMAL")
        normals = None if normal is None else buffers.values(normal, "VEC3").astype(np.float64)
    except NoDataError:
        points, triangles, normals = _decompressed(primitive, buffers)
    if triangles.max(initial=-1) >= len(points):
        raise damaged(f"a primitive refers to vertex {triangles.max()}, but has {len(points)}")
    if normals is not None and len(normals) != len(points):
        raise damaged(f"a primitive has {len(points)} vertices and {len(normals)} normals")
    for weight, target in zip(weights, primitive.targets, strict=False):
        for name, values in (("POSITION", points), ("NORMAL", normals)):
            if weight and name in target and values is not None:
                values += weight * _moved(target[name], len(values), primitive, buffers)
    return _Triangles(points, triangles, normals)


def _ordered(indices: Int[HostArray, " n"], mode: int) -> Int[HostArray, "t 3"]:
    if mode == _STRIP:
        return strip_triangles(indices)
    if mode == _FAN:
        middle = np.broadcast_to(indices[:1], indices[2:].shape)
        return np.stack([indices[1:-1], indices[2:], middle], axis=-1)
    if len(indices) % 3:
        raise damaged(f"a primitive of triangles has {len(indices)} corners; expected a multiple of three")
    return indices.reshape(-1, 3)


def _decompressed(primitive: Primitive, buffers: Buffers) -> _Triangles:
    """The vertices and triangles that KHR_draco_mesh_compression stores instead of accessors."""
    compressed = primitive.extensions.get(DRACO)
    if compressed is None:
        raise unread(primitive.extensions) or damaged("a primitive has an accessor without data")
    view = compressed.get("bufferView") if isinstance(compressed, Mapping) else None
    if not isinstance(view, int) or view < 0:
        raise damaged(f"a primitive's {DRACO} has no bufferView")
    try:
        mesh = DracoPy.decode(bytes(buffers.view(view)))
        points, faces = np.array(mesh.points, np.float64), np.asarray(mesh.faces, np.int64)
        normals = getattr(mesh, "normals", None)
        normals = None if normals is None or not len(normals) else np.array(normals, np.float64).reshape(-1, 3)
        return _Triangles(points.reshape(-1, 3), faces.reshape(-1, 3), normals)
    except MeshError:
        raise
    except Exception as error:  # point clouds have no faces, and DracoPy's exceptions have no common base
        raise damaged(f"its compressed triangles cannot be decoded ({error})") from error


def _moved(accessor: int, count: int, primitive: Primitive, buffers: Buffers) -> Float[HostArray, "v 3"]:
    """The displacements of a morph target."""
    try:
        moved = buffers.values(accessor, "VEC3")
    except NoDataError:
        raise unread(primitive.extensions) or damaged("a morph target has an accessor without data") from None
    if len(moved) != count:
        raise damaged(f"a morph target has {len(moved)} vertices; expected {count}")
    return moved


def _indices(primitive: Primitive, buffers: Buffers) -> Int[HostArray, " n"]:
    if primitive.indices is None:
        return np.arange(_count(primitive, buffers))
    indices = buffers.values(primitive.indices, "SCALAR")[:, 0]
    if indices.dtype.kind != "u":
        raise damaged(f"a primitive's indices are of type {indices.dtype}; expected unsigned integers")
    return indices.astype(np.int64)


def _count(primitive: Primitive, buffers: Buffers) -> int:
    """The number of corners of a primitive."""
    accessor = primitive.attributes.get("POSITION") if primitive.indices is None else primitive.indices
    return 0 if accessor is None else buffers.count(accessor)
