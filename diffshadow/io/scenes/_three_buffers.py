"""The numbers of a three.js file's geometries."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ..._types import HostArray
from .._errors import MeshError, damaged
from .._text import excerpt
from ._three_geometries import GEOMETRIES, Geometry, build_geometry
from ._three_schema import Attribute, GeometryData, GeometryEntry

_TYPES = {
    "Int8Array": np.int8,
    "Uint8Array": np.uint8,
    "Uint8ClampedArray": np.uint8,
    "Int16Array": np.int16,
    "Uint16Array": np.uint16,
    "Int32Array": np.int32,
    "Uint32Array": np.uint32,
    "Float32Array": np.float32,
    "Float64Array": np.float64,
}


def geometry_of(entry: GeometryEntry) -> Geometry:
    """The triangles of a geometry.

    **Raises** `MeshError` if it is damaged, or is stored as parameters of a shape that is not supported.
    """
    if entry.data is not None:
        return _stored(entry.data, entry.type)
    if entry.type not in GEOMETRIES:
        raise MeshError(
            f"has a {entry.type}, stored as parameters alone, which cannot be built; write its triangles "
            "instead: set geometry.type = 'BufferGeometry' and delete geometry.parameters before toJSON()"
        )
    return build_geometry(entry.type, entry.model_extra or {})


def values_of(attribute: Attribute, data: GeometryData | None, name: str) -> Float[HostArray, "n width"]:
    """The rows of an attribute. Normalized integers are mapped to [-1, 1] or [0, 1].

    **Raises** `MeshError` if its data are missing or are not numbers.
    """
    if attribute.is_interleaved_buffer_attribute:
        kind, rows = _interleaved(attribute, data, name)
    else:
        kind = _kind(attribute.type)
        flat = _numbers(attribute.array, name)
        if len(flat) % attribute.item_size:
            raise damaged(f"its attribute {name} has {len(flat)} numbers; expected a multiple of {attribute.item_size}")
        rows = flat.reshape(-1, attribute.item_size)
    if attribute.normalized and np.dtype(kind).kind in "iu":
        rows = np.maximum(rows / np.iinfo(kind).max, -1)
    return rows


def maybe_half_floats(entry: GeometryEntry) -> list[str]:
    """The attributes of a geometry whose whole numbers may be the bits of half floats. Files have no type for half
    floats."""
    data = entry.data
    if data is None:
        return []
    found = []
    for name in ("position", "normal"):
        attribute = data.attributes.get(name)
        if attribute is None or attribute.normalized or _type(attribute, data) != "Uint16Array":
            continue
        bits = values_of(attribute, data, name).astype(np.uint16)
        if np.isfinite(bits.view(np.float16)).all():
            found.append(name)
    return found


def _type(attribute: Attribute, data: GeometryData) -> str:
    """The name of the array that holds an attribute."""
    if not attribute.is_interleaved_buffer_attribute:
        return attribute.type
    buffer = data.interleaved_buffers.get(attribute.data or "")
    return "" if buffer is None else buffer.type


def _stored(data: GeometryData, kind: str) -> Geometry:
    if "position" not in data.attributes:
        raise MeshError(f"has a {kind} with no attribute position; give it one, or remove its mesh from the scene")
    vertices = values_of(data.attributes["position"], data, "position")
    if vertices.shape[1] != 3:
        raise damaged(f"its attribute position has {vertices.shape[1]} numbers to a vertex; expected 3")
    normals = None
    if "normal" in data.attributes:
        normals = values_of(data.attributes["normal"], data, "normal")
        if normals.shape != vertices.shape:
            raise damaged(f"a {kind} has {len(vertices)} vertices and {len(normals)} normals")
    for name, rows in (("position", vertices), ("normal", normals)):
        if rows is not None and not np.isfinite(rows).all():
            bad = int(np.flatnonzero(~np.isfinite(rows).all(axis=-1))[0])
            raise damaged(f"its attribute {name} is NaN or infinite at vertex {bad} (JSON writes these as null)")
    if data.index is None:
        corners = np.arange(len(vertices))
    else:
        indices = _numbers(data.index.array, "index")
        if not np.isfinite(indices).all() or (indices != np.trunc(indices)).any():
            raise damaged("its index holds other than whole numbers")
        corners = indices.astype(np.int64)
    if len(corners) and not (corners.min() >= 0 and corners.max() < len(vertices)):
        raise damaged(f"its index reaches from {corners.min()} to {corners.max()}, with {len(vertices)} vertices")
    faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
    groups = [(group.start // 3, int(min(group.count // 3, len(faces))), group.material_index) for group in data.groups]
    return Geometry(vertices, faces, normals, groups)


def _interleaved(attribute: Attribute, data: GeometryData | None, name: str) -> tuple[Any, Float[HostArray, "n width"]]:
    buffer = data.interleaved_buffers.get(attribute.data or "") if data is not None else None
    words = data.array_buffers.get(buffer.buffer) if data is not None and buffer is not None else None
    if buffer is None or words is None:
        raise damaged(f"its attribute {name} is in a buffer that the file lacks")
    kind = _kind(buffer.type)
    values = np.frombuffer(_numbers(words, name).astype(np.uint32).tobytes(), kind)
    if attribute.offset + attribute.item_size > buffer.stride:
        raise damaged(f"its attribute {name} reaches beyond the stride of its buffer")
    rows = values[: len(values) // buffer.stride * buffer.stride].reshape(-1, buffer.stride)
    return kind, rows[:, attribute.offset : attribute.offset + attribute.item_size].astype(np.float64)


def _kind(name: str) -> Any:
    if name not in _TYPES:
        raise damaged(f"an attribute is of type {excerpt(name)}; expected one of {', '.join(_TYPES)}")
    return _TYPES[name]


def _numbers(values: Any, name: str) -> Float[HostArray, " n"]:
    """A JSON list as float64. JSON's null becomes NaN. Older releases write a list as an object with numbered keys."""
    try:
        flat = np.array(list(values.values()) if isinstance(values, dict) else values, np.float64)
    except (TypeError, ValueError):
        flat = np.zeros(())
    if flat.ndim != 1:
        raise damaged(f"its attribute {name} holds {excerpt(str(values))}; expected a list of numbers")
    return flat
