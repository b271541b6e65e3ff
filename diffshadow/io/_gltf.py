"""glTF 2.0 files, as JSON and as GLB: what trimesh would drop or misread in silence is mended or refused first.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 3.
"""

import base64
import json
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from jaxtyping import Int

from .._types import HostArray
from ._errors import MeshError, damaged
from ._text import decode

_MAGIC = b"glTF"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_UINT32 = 5125
_FAN, _LIST = 6, 4
# Modes of primitives that are no triangles: what to call them, and how many n vertices make.
_OTHERS = {
    0: ("point", lambda n: n),
    1: ("line", lambda n: n // 2),
    2: ("line", lambda n: n),
    3: ("line", lambda n: max(n - 1, 0)),
}
_DRACO = "KHR_draco_mesh_compression"
# Extensions of looks alone, which do not say where triangles are.
_OF_LOOKS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_animation_", "KHR_technique", "KHR_xmp")
_OF_LOOKS += ("EXT_texture_", "EXT_lights_", "MSFT_texture_", "MSFT_packing_")


class Prepared:
    """A file's JSON and data, in which triangles are lists that trimesh reads as they are meant.

    - `json`: the text; its buffers are data URIs.
    - `left_out`: how many things of other kinds the file holds, by their names in the singular.

    **Raises** `MeshError` if the file is damaged, or keeps its triangles in a way that cannot be read.
    """

    def __init__(self, file: Path):
        self._tree, binary = _parse(file.read_bytes())
        _check_extensions(self._tree.get("extensionsRequired", ()))
        # A GLB file's own data are its first buffer's.
        self._buffers = [
            _buffer(each, binary or b"" if i == 0 else b"", file.parent)
            for i, each in enumerate(self._tree.get("buffers", []))
        ]
        self.left_out: Counter[str] = Counter()
        for node in self._tree.get("nodes", []):
            self.left_out["skin"] += "skin" in node
            self.left_out["morphed node"] += any(node.get("weights", ()))
            self.left_out["instanced node"] += "EXT_mesh_gpu_instancing" in node.get("extensions", {})
        for mesh in self._tree.get("meshes", []):
            self.left_out["morphed mesh"] += any(mesh.get("weights", ()))
            # An empty mesh stays, since nodes go by their numbers.
            mesh["primitives"] = list(self._prepared(mesh["primitives"]))

    @property
    def json(self) -> bytes:
        uri = lambda data: "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        buffers = [{"byteLength": len(data), "uri": uri(data)} for data in self._buffers]
        return json.dumps({**self._tree, "buffers": buffers}).encode()

    def _prepared(self, primitives: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        for primitive in primitives:
            mode = primitive.get("mode", _LIST)
            corners = primitive.get("indices", primitive["attributes"].get("POSITION"))
            if mode in _OTHERS:
                name, count = _OTHERS[mode]
                self.left_out[name] += count(0 if corners is None else self._accessor(corners)["count"])
                continue
            self._check(primitive)
            yield self._as_list(primitive) if mode == _FAN else primitive

    def _check(self, primitive: dict[str, Any]) -> None:
        """**Raises** `MeshError` if trimesh would read other numbers than are meant."""
        if "POSITION" not in primitive["attributes"]:
            raise damaged("a primitive has no positions")
        extensions = primitive.get("extensions", {})
        for index in (primitive["attributes"]["POSITION"], primitive.get("indices")):
            if index is None:
                continue
            accessor = self._accessor(index)
            if "sparse" in accessor:
                raise MeshError("has sparse accessors, which cannot be read; export it without them")
            if accessor.get("normalized"):
                raise MeshError("has positions of normalized integers, which cannot be read; export them as floats")
            if "bufferView" in accessor:
                self._check_data(self._tree["bufferViews"][accessor["bufferView"]])
            elif _DRACO not in extensions:
                _check_extensions(extensions)
                raise damaged("a primitive has an accessor without data")

    def _check_data(self, view: dict[str, Any]) -> None:
        """**Raises** `MeshError` if a view's data are missing, as they are where an extension alone has them."""
        buffer, end = self._buffers[view["buffer"]], view.get("byteOffset", 0) + view["byteLength"]
        if end > len(buffer):
            _check_extensions(view.get("extensions", ()))
            raise damaged(f"a buffer has {len(buffer)} bytes; expected {end}")

    def _as_list(self, primitive: dict[str, Any]) -> dict[str, Any]:
        """A fan as a list of triangles, section 3.7.2.1."""
        corners = self._indices(primitive)
        middle = np.broadcast_to(corners[:1], corners[2:].shape)
        data = np.stack([corners[1:-1], corners[2:], middle], axis=-1).astype("<u4")
        self._buffers.append(data.tobytes())
        views, accessors = self._tree.setdefault("bufferViews", []), self._tree["accessors"]
        views.append({"buffer": len(self._buffers) - 1, "byteLength": data.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": _UINT32, "count": data.size, "type": "SCALAR"})
        return {**primitive, "mode": _LIST, "indices": len(accessors) - 1}

    def _indices(self, primitive: dict[str, Any]) -> Int[HostArray, "n"]:
        if "indices" not in primitive:
            return np.arange(self._accessor(primitive["attributes"]["POSITION"])["count"])
        accessor = self._accessor(primitive["indices"])
        if "bufferView" not in accessor:
            raise MeshError("has a compressed fan of triangles, which cannot be read; export it as a list")
        view = self._tree["bufferViews"][accessor["bufferView"]]
        kind = np.dtype(_INDEX_TYPES[accessor["componentType"]])
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(self._buffers[view["buffer"]], kind, accessor["count"], start).astype(np.int64)

    def _accessor(self, index: int) -> dict[str, Any]:
        return self._tree["accessors"][index]


def _parse(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a glTF or GLB file, and the buffer that a GLB file may hold."""
    text, binary = _chunks(data) if data.startswith(_MAGIC) else (data, None)
    try:
        tree = json.loads(decode(text))
    except (ValueError, RecursionError) as error:
        raise damaged(f"it is no JSON ({error})") from error
    if not isinstance(tree, dict):
        raise damaged("its JSON is no object")
    version = str(tree.get("asset", {}).get("version", "2.0"))
    if version.partition(".")[0] != "2":
        raise MeshError(f"is of glTF version {version[:20]}, which cannot be read; convert it to glTF 2.0")
    return tree, binary


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    if len(data) < 12:
        raise damaged("it ends within its header")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise MeshError(f"is of glTF version {version}, which cannot be read; convert it to glTF 2.0")
    if length > len(data):
        raise damaged(f"it has {len(data)} bytes; expected {length}")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON not in found:
        raise damaged("it has no chunk of JSON")
    return found[_JSON], found.get(_BINARY)


def _buffer(buffer: dict[str, Any], binary: bytes, folder: Path) -> bytes:
    """The buffer's data; those that an extension alone has are missing."""
    uri = buffer.get("uri")
    if uri is None:
        return binary
    if uri.startswith("data:"):
        head, _, payload = uri.partition(",")
        content = base64.b64decode(unquote(payload)) if head.endswith(";base64") else unquote_to_bytes(payload)
    else:
        content = _beside(uri, folder)
    if len(content) < buffer["byteLength"]:
        raise damaged(f"a buffer has {len(content)} bytes; expected {buffer['byteLength']}")
    return content


def _beside(uri: str, folder: Path) -> bytes:
    """The content of another file."""
    if "://" in uri:
        raise MeshError(f"keeps its data at {uri}; download them, and name that file instead")
    # Some writers forget to quote special characters.
    paths = [folder / unquote(uri), folder / uri]
    path = next((path for path in paths if path.exists()), paths[0])
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"needs the file {path}, which does not exist; put it there") from None
    except OSError as error:
        raise MeshError(f"needs the file {path}, which cannot be read: {error.strerror}; check it") from error


def _check_extensions(names: Iterable[str]) -> None:
    """**Raises** `MeshError` if one of the extensions may say where triangles are, and cannot be read."""
    known = (_DRACO, "KHR_mesh_quantization")
    unread = [name for name in names if not name.startswith(_OF_LOOKS) and name not in known]
    if unread:
        raise MeshError(f"needs {', '.join(unread)[:160]}, which cannot be read; export it without")
