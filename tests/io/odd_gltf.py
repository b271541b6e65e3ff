"""Small glTF files, odd but valid, with the area and volume that each must have; and those that are refused.

Each begins as a unit square of two triangles at a height of 1, of area 1 and volume 1/3.
"""

import base64
import json
import struct
from collections.abc import Callable
from typing import Any

import DracoPy
import numpy as np
from odd_meshes import OddFile, one

CORNERS = np.array([(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], np.float32)
CODES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}


class Builder:
    """A file of one primitive with these corners, and these indices unless they are `None`.

    Arrays are added to its one buffer, and its JSON is changed, before it is written.
    """

    def __init__(self, corners: Any = CORNERS, indices: Any = (0, 1, 2, 0, 2, 3), **primitive: Any):
        self.bytes = b""
        self.more_buffers: list[dict[str, Any]] = []
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        self.tree |= {"accessors": [], "bufferViews": []}
        self.primitive: dict[str, Any] = {"attributes": {"POSITION": self.add(np.asarray(corners))}, **primitive}
        if indices is not None:
            self.primitive["indices"] = self.add(np.array(indices, np.uint16))
        self.tree["meshes"] = [{"primitives": [self.primitive]}]

    def view(self, array: np.ndarray, **keys: Any) -> int:
        """The index of a new buffer view on the array's numbers."""
        place = {"buffer": 0, "byteOffset": len(self.bytes), "byteLength": array.nbytes}
        self.tree["bufferViews"].append(place | keys)
        self.bytes += array.tobytes()
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array: np.ndarray, **keys: Any) -> int:
        """The index of a new accessor of the array's type and size."""
        form = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        self.tree["accessors"].append(
            {"componentType": CODES[array.dtype.name], "type": form, "count": len(array), **keys}
        )
        return len(self.tree["accessors"]) - 1

    def add(self, array: np.ndarray, **keys: Any) -> int:
        """The index of a new accessor on the array's numbers."""
        return self.accessor(array, bufferView=self.view(array), **keys)

    def text(self) -> bytes:
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.bytes).decode()
        buffers = [{"byteLength": len(self.bytes), "uri": uri}, *self.more_buffers]
        return json.dumps({**self.tree, "buffers": buffers}).encode()

    def binary(self, filling: bytes = b" ") -> bytes:
        text = json.dumps({**self.tree, "buffers": [{"byteLength": len(self.bytes)}]}).encode()
        text += filling * (4 + -len(text) % 4)
        body = self.bytes + bytes(-len(self.bytes) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
        # Chunks of other kinds may follow.
        chunks += struct.pack("<II", 4, 0x12345678) + b"more"
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def built(change: Callable[[Builder], Any], *arguments: Any, **keys: Any) -> Builder:
    """A file that begins as `Builder` makes it of the arguments, with a change."""
    builder = Builder(*arguments, **keys)
    change(builder)
    return builder


def quantized(builder: Builder) -> None:
    """The square in normalized shorts, which its node brings back to size."""
    builder.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    builder.tree["accessors"][0]["normalized"] = True
    builder.tree["nodes"][0] |= {"scale": [1, 1, 2], "translation": [0, 0, 0]}


def interleaved(builder: Builder) -> None:
    """Positions and normals side by side."""
    rows = np.concatenate([np.zeros((4, 3)), CORNERS], axis=1).astype(np.float32)
    builder.tree["accessors"][0] |= {"bufferView": builder.view(rows, byteStride=24), "byteOffset": 12}


def sparse(builder: Builder) -> None:
    """A corner that lies elsewhere in the dense numbers."""
    places, values = np.array([2], np.uint8), CORNERS[2:3]
    builder.tree["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": builder.view(places), "componentType": CODES["uint8"]},
        "values": {"bufferView": builder.view(values)},
    }


def sparse_from_zeros(builder: Builder) -> None:
    """Places and values in one view, each at its own offset."""
    places = np.arange(-2, 4, dtype=np.int16)
    view = builder.view(np.frombuffer(places.tobytes() + CORNERS.tobytes(), np.uint8))
    builder.tree["accessors"][0] |= {
        "sparse": {
            "count": 4,
            "indices": {"bufferView": view, "byteOffset": 4, "componentType": CODES["uint16"]},
            "values": {"bufferView": view, "byteOffset": 12},
        }
    }
    del builder.tree["accessors"][0]["bufferView"]


def morphed(builder: Builder) -> None:
    """A target that lifts the square from 0 to 2, by half."""
    builder.primitive["targets"] = [{"POSITION": builder.add(2 * np.array([[0, 0, 1]] * 4, np.float32))}]
    builder.tree["meshes"][0]["weights"] = [0.25]
    builder.tree["nodes"][0]["weights"] = [0.5]


def mirrored(builder: Builder) -> None:
    builder.tree["nodes"] = [{"children": [1], "scale": [-1, 1, 1]}, {"mesh": 0, "translation": [3, 0, 0]}]


def turned(builder: Builder) -> None:
    """By a quarter about z, and by another as a matrix, in columns; the square ends where it was."""
    quarter = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1]
    builder.tree["nodes"] = [{"children": [1], "rotation": [0, 0, 0.5**0.5, 0.5**0.5]}, {"mesh": 0, "matrix": quarter}]


def with_lines(builder: Builder) -> None:
    attributes = builder.primitive["attributes"]
    builder.tree["meshes"][0]["primitives"] += [{"attributes": attributes, "mode": mode} for mode in range(4)]


def compressed_with_a_copy(builder: Builder) -> None:
    builder.tree["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    builder.primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}


def draco(builder: Builder) -> None:
    """Without a copy that can be read: its accessors say how much there is, and nothing else."""
    data = np.frombuffer(DracoPy.encode(CORNERS, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)), np.uint8)
    extension = {"bufferView": builder.view(data), "attributes": {"POSITION": 0}}
    builder.primitive["extensions"] = {"KHR_draco_mesh_compression": extension}
    builder.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    for accessor in builder.tree["accessors"]:
        del accessor["bufferView"]


def twice(file: OddFile) -> OddFile:
    return file._replace(area=2 * file.area, volume=2 * file.volume)


def draco_beside_plain(builder: Builder) -> None:
    draco(builder)
    plain = {"attributes": {"POSITION": builder.add(CORNERS)}, "mode": 6}
    builder.tree["meshes"][0]["primitives"].insert(0, plain)


def instanced(builder: Builder) -> None:
    """Two, each of half the size along x: one turned by half about z, one mirrored and moved."""
    rotations = np.array([[0, 0, 1, 0], [0, 0, 0, 1]], np.float32)
    attributes = {
        "TRANSLATION": builder.add(np.array([[1, 1, 0], [2, 0, 0]], np.float32)),
        "ROTATION": builder.add(rotations),
        "SCALE": builder.add(np.array([[0.5, 1, 1], [-0.5, 1, 1]], np.float32)),
    }
    builder.tree["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    builder.tree["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]


def hidden_twin(builder: Builder) -> None:
    builder.tree["nodes"].append({"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}})
    builder.tree["scenes"][0]["nodes"].append(1)
    builder.tree["extensionsRequired"] = ["KHR_node_visibility"]


def with_an_extension(builder: Builder) -> None:
    builder.tree["extensionsUsed"] = ["ACME_new_triangles", "KHR_mesh_quantization"]


def animated(builder: Builder) -> None:
    builder.tree["animations"] = [{}]


def without_positions(builder: Builder) -> None:
    builder.tree["meshes"][0]["primitives"].append({"attributes": {"COLOR_0": 0}})


HALVES = np.full((4, 4), 20000, np.uint16)


def skin_missing(builder: Builder) -> None:
    builder.tree["nodes"][0] |= {"skin": 0, "name": "figure"}


def skinned(builder: Builder, sets: int = 1, weights: Any = HALVES) -> None:
    """The square at twice its size, below a node whose place does not count. Half of each corner follows a joint that
    quarters it, half one that scales it by 3/4: by 3/2, of half the size that its inverse bind matrix leaves."""
    builder.tree["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9], "scale": [5, 5, 5]},
        {"scale": [0.5, 0.5, 0.5], "children": [2]},
        {"scale": [0.5, 0.5, 0.5]},
        {"scale": [1.5, 1.5, 1.5]},
    ]
    builder.tree["scenes"] = [{"nodes": [0, 1, 3]}]
    inverses = np.stack([np.eye(4), np.diag([0.5, 0.5, 0.5, 1])]).astype(np.float32)
    place = builder.add(inverses.reshape(2, 16))
    builder.tree["accessors"][place]["type"] = "MAT4"
    builder.tree["skins"] = [{"joints": [2, 3], "inverseBindMatrices": place}]
    for number in range(sets):
        # With two sets, the first joint is in one, and the second in the other.
        joints = [0, 1, 0, 0] if sets == 1 else [number] * 4
        builder.primitive["attributes"] |= {
            f"JOINTS_{number}": builder.add(np.tile(np.array([joints], np.uint8), (4, 1))),
            f"WEIGHTS_{number}": builder.add(
                weights * np.array([[1, sets == 1, 0, 0]], weights.dtype), normalized=True
            ),
        }


def skinned_by_two_sets(builder: Builder) -> None:
    skinned(builder, 2, np.full((4, 4), 0.5, np.float32))


def skinned_by_a_mirror(builder: Builder) -> None:
    """A joint without an inverse bind matrix, and vertices without weights, which follow the first joint."""
    builder.tree["nodes"] = [{"mesh": 0, "skin": 0, "translation": [9, 9, 9]}, {"scale": [-1, 1, 1]}]
    builder.tree["scenes"] = [{"nodes": [0, 1]}]
    builder.tree["skins"] = [{"joints": [1]}]
    builder.primitive["attributes"] |= {
        "JOINTS_0": builder.add(np.zeros((4, 4), np.uint16)),
        "WEIGHTS_0": builder.add(np.zeros((4, 4), np.uint8), normalized=True),
    }


def behind_a_camera(builder: Builder) -> None:
    builder.tree["nodes"][0]["camera"] = 0


def without_scenes(builder: Builder) -> None:
    del builder.tree["scenes"]


def needs_textures(builder: Builder) -> None:
    builder.tree["extensionsRequired"] = ["KHR_texture_transform", "KHR_materials_unlit"]
    builder.tree["images"] = [{"uri": "nowhere.png"}]


def nothing(builder: Builder) -> None:
    pass


STRIP = np.array([(0, 0, 1), (0.5, 0, 1), (0, 1, 1), (0.5, 1, 1), (0, 2, 1), (0.5, 2, 1)], np.float32)
SHORTS = np.round(CORNERS * [32767, 32767, 32767 / 2]).astype(np.int16)
LOW = CORNERS * np.float32([1, 1, 0])
ELSEWHERE = CORNERS + np.float32([[0], [0], [7], [0]])
TWICE = CORNERS * np.float32(2)
HALF_DOWN = CORNERS - np.float32([0, 0, 1])

BUILT = {
    "list": built(nothing),
    "list_without_indices": built(nothing, CORNERS[[0, 1, 2, 0, 2, 3]], None),
    "strip": built(nothing, STRIP, range(6), mode=5),
    "strip_without_indices": built(nothing, STRIP, None, mode=5),
    "fan": built(nothing, CORNERS, (0, 1, 2, 3), mode=6),
    "fan_without_indices": built(nothing, CORNERS, None, mode=6),
    "quantized": built(quantized, SHORTS),
    "interleaved": built(interleaved),
    "sparse": built(sparse, ELSEWHERE),
    "sparse_from_zeros": built(sparse_from_zeros, CORNERS),
    "morphed": built(morphed, HALF_DOWN),
    "mirrored": built(mirrored),
    "turned": built(turned),
    "compressed_with_a_copy": built(compressed_with_a_copy),
    "draco": built(draco),
    "behind_a_camera": built(behind_a_camera),
    "skinned": built(skinned, TWICE),
    "skinned_by_two_sets": built(skinned_by_two_sets, TWICE),
    "skinned_by_a_mirror": built(skinned_by_a_mirror),
    "instanced": built(instanced),
    "without_scenes": built(without_scenes),
    "needs_textures": built(needs_textures),
}
LEFT_OUT = {
    "lines": (built(with_lines), "4 points and 9 lines"),
    "skin_missing": (
        built(skin_missing),
        "1 skin of figure that cannot be read, so its size and position come from its vertices and its node",
    ),
    "hidden_twin": (built(hidden_twin), "1 hidden mesh"),
    "with_an_extension": (built(with_an_extension), "1 extension ACME_new_triangles"),
    "animated": (built(animated), "1 animation"),
    "without_positions": (built(without_positions), "1 primitive without positions"),
}
FILES = {
    **{f"{name}.gltf": one(builder.text()) for name, builder in BUILT.items()},
    "list.glb": one(BUILT["list"].binary()),
    "filled_up.glb": one(BUILT["list"].binary() + bytes(8)),
    "text_filled_up_with_zeros.glb": one(BUILT["list"].binary(b"\0")),
    "draco_beside_plain.gltf": twice(one(built(draco_beside_plain).text())),
    **{f"{name}.gltf": one(builder.text(), said) for name, (builder, said) in LEFT_OUT.items()},
    "latin_1.gltf": one(BUILT["list"].text().replace(b'"asset"', b'"extras": "J\xfcrgen", "asset"')),
    "utf_8_with_mark.gltf": one(b"\xef\xbb\xbf" + BUILT["list"].text()),
}


# Refusals


def draco_damaged(builder: Builder) -> None:
    compressed_with_a_copy(builder)
    del builder.tree["accessors"][0]["bufferView"]


def draco_without_data(builder: Builder) -> None:
    draco(builder)
    builder.primitive["extensions"]["KHR_draco_mesh_compression"] = {}


def meshopt(builder: Builder) -> None:
    builder.more_buffers.append({"byteLength": 48, "extensions": {"EXT_meshopt_compression": {"fallback": True}}})
    builder.tree["bufferViews"][0] |= {
        "buffer": 1,
        "byteOffset": 0,
        "extensions": {"EXT_meshopt_compression": {"buffer": 0}},
    }


def required(name: str) -> Callable[[Builder], None]:
    def change(builder: Builder) -> None:
        builder.tree["extensionsRequired"] = [name]

    return change


def changed(part: str, **keys: Any) -> Callable[[Builder], None]:
    """Changes the first item of a list of the file."""

    def change(builder: Builder) -> None:
        builder.tree[part][0] |= keys

    return change


def lines_alone(builder: Builder) -> None:
    builder.primitive["mode"] = 1


def uneven_instances(builder: Builder) -> None:
    instanced(builder)
    attributes = builder.tree["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
    attributes["SCALE"] = builder.add(np.ones((3, 3), np.float32))


def instances_of_no_accessor(builder: Builder) -> None:
    instanced(builder)
    builder.tree["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = -1


def countless_instances(builder: Builder) -> None:
    instanced(builder)
    sparse = {
        "count": 1,
        "indices": {"bufferView": builder.view(np.uint8([0])), "componentType": CODES["uint8"]},
        "values": {"bufferView": builder.view(CORNERS[:1])},
    }
    zeros = builder.accessor(CORNERS, sparse=sparse)
    builder.tree["accessors"][zeros]["count"] = 2**24
    builder.tree["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {"TRANSLATION": zeros}


def looped(builder: Builder) -> None:
    builder.tree["nodes"] = [{"children": [1]}, {"children": [0], "mesh": 0}]


def zeros(builder: Builder) -> None:
    sparse_from_zeros(builder)
    builder.tree["accessors"][0]["count"] = 10**12


REFUSALS = {
    "draco_damaged": (draco_damaged, "compressed triangles cannot be decoded"),
    "draco_without_data": (draco_without_data, "KHR_draco_mesh_compression has no bufferView"),
    "instances_of_no_accessor": (instances_of_no_accessor, "the SCALE of its instances is '-1'; expected an accessor"),
    "meshopt": (meshopt, "stores triangles with EXT_meshopt_compression"),
    "meshopt_required": (required("EXT_meshopt_compression"), "requires EXT_meshopt_compression"),
    "unknown_extension": (required("ACME_new_triangles"), "requires ACME_new_triangles"),
    "lines_alone": (lines_alone, "holds 3 lines but no triangles"),
    "looped": (looped, "node 0 has two parents, or is its own ancestor"),
    "uneven_instances": (uneven_instances, "its instances have 2 and 3 rows; expected the same number of each"),
    "countless_instances": (
        countless_instances,
        "16,777,216 instances; expected at most 4,194,304",
    ),
    "zeros": (zeros, "declares 1000000000000 zeros"),
    "old": (lambda builder: builder.tree.update(asset={"version": "1.0"}), "of glTF version '1.0'.*convert it"),
    "no_asset": (lambda builder: builder.tree.pop("asset"), "asset: Field required"),
    "wrong_kind": (changed("meshes", primitives="three"), "meshes.0.primitives: Input should be a valid list"),
    "no_such_mesh": (changed("nodes", mesh=4), "refers to mesh 4, but has 1"),
    "no_such_scene": (lambda builder: builder.tree.update(scene=2), "refers to scene 2, but has 1"),
    "no_rotation": (changed("nodes", rotation=[0, 0, 0, 0]), "which is not a rotation"),
    "too_many_rows": (changed("accessors", count=5), "needs 60 bytes of buffer view 0, which has 48"),
    "beyond_the_buffer": (changed("bufferViews", byteOffset=1000), "ends beyond its buffer"),
    "wrong_form": (changed("accessors", type="VEC2"), "accessor 0 holds 'VEC2'; expected VEC3"),
    "vertex_9": (
        lambda builder: builder.primitive.update(indices=builder.add(np.uint8([0, 1, 9]))),
        "refers to vertex 9",
    ),
    "four_corners": (lambda builder: builder.primitive.pop("indices"), "has 4 corners; expected a multiple of three"),
}


def with_buffers(*buffers: dict[str, Any]) -> bytes:
    return json.dumps({**BUILT["list"].tree, "buffers": buffers}).encode()


REFUSED = {
    **{f"{name}.gltf": (built(change).text(), said) for name, (change, said) in REFUSALS.items()},
    "missing_file.gltf": (
        with_buffers({"byteLength": 60, "uri": "square%200.bin"}),
        r"needs the file 'square%200\.bin' in the same folder, which does not exist; put it there",
    ),
    "elsewhere.gltf": (with_buffers({"byteLength": 60, "uri": "https://a.b/c.bin"}), "keeps its data at 'https:"),
    "short_buffer.gltf": (with_buffers({"byteLength": 60, "uri": "data:;base64,AAAA"}), "has 3 bytes; expected 60"),
    "no_base64.gltf": (with_buffers({"byteLength": 60, "uri": "data:;base64,A"}), "is not in base64"),
    "no_data.gltf": (with_buffers({"byteLength": 60}), "buffer 0 has no data"),
    "no_json.gltf": (b"garbage", "it is not JSON"),
    "array.gltf": (b"[]", "Input should be a valid dictionary"),
    "old.glb": (b"glTF" + struct.pack("<II", 1, 12), "of glTF version 1"),
    "cut.glb": (BUILT["list"].binary()[:-10], "expected"),
    "longer.glb": (BUILT["list"].binary() + b"more", r"has \d+ bytes; expected \d+"),
    "no_json_chunk.glb": (b"glTF" + struct.pack("<II", 2, 12), "no chunk of JSON"),
}
