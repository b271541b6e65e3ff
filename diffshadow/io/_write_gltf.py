"""Writes scenes as glTF 2.0: meshes, cameras, and the lights of KHR_lights_punctual.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3 and 4.
"""

import base64
import dataclasses
import json
import math
import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._arithmetic import concrete
from .._checks import check_instance
from .._types import HostArray
from ..geometry import (
    AbstractCamera,
    AbstractLight,
    DirectionalLight,
    MatrixCamera,
    MatrixLight,
    Mesh,
    PointLight,
    Sampler,
    Scene,
    SpotLight,
    View,
)
from ..settings.scene import GLTF_SUFFIXES
from ._atomic import atomic_path
from ._errors import FileError
from ._gltf_materials import FILTERS, WRAPS
from ._gltf_schema import EXTRAS, LIGHTS
from ._looks import levels_of, png_of

_FLOAT, _UNSIGNED = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
# KHR_lights_punctual: the angles of a cone differ, and the outer angle is at most a right angle.
_NARROWER = 1 - 1e-6
# A projection counts as centred if its centre is off by less than rounding errors.
_CENTRED = 1e-6


def write_gltf(path: str | os.PathLike[str], scene: Scene, *, extras: Mapping[str, Any] | None = None) -> None:
    """Writes a scene, such as a fitted scene, as glTF 2.0 for other renderers.

    Meshes have the normals of their corners and their albedo. A single colour is written as the material's colour.
    Several colours, and colours of corners, are written as vertex colours (`COLOR_0`, linear). Textures are 8-bit PNG
    images within the file, with their samplers. Faces with different materials become separate primitives. Alpha tests
    become materials of mode MASK, with the corners' alpha in `COLOR_0`. A vertex is repeated if its corners differ in
    normal, colour or texture coordinates. Cameras are perspective or orthographic. A directional, point or spot light
    becomes a light of KHR_lights_punctual with intensity 1. A rectangle light becomes a point light, and a light of
    matrices becomes a directional or a spot light. The `extras` of the nodes of cameras and lights have all of their
    fields under `diffshadow`, such as near and far of a shadow map, and the `extras` of meshes say whether they cast
    and receive shadows. `read_scene` and `diffshadow import` read meshes, cameras and lights back.

    **Arguments:**

    - `path`: `.glb` for one binary file; `.gltf` for JSON with embedded arrays.
    - `scene`: a scene without traced values. A scene with an origin is written in world coordinates.
    - `extras`: numbers and texts, lists and dictionaries of these, for the `extras` of the file's scene, such as
        `FitResult.fitted`.

    **Raises** `FileError` if the file cannot be written or has another suffix; `ValueError` for traced values, for a
    camera with an off-centre projection, and for `extras` that JSON cannot store; and `TypeError` for an object that is
    not a scene.
    """
    check_instance("what to write", scene, Scene, "a Scene")
    suffix = Path(path).suffix.lower()
    if suffix not in GLTF_SUFFIXES:
        raise FileError(f"cannot write {path}: its name ends with {suffix or 'nothing'!r}; expected .glb or .gltf")
    document, binary = _document(scene, extras or {})
    if suffix == ".gltf":
        uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode("ascii")
        data = _json({**document, "buffers": [{"byteLength": len(binary), "uri": uri}]})
    else:
        data = _glb(_json({**document, "buffers": [{"byteLength": len(binary)}]}), binary)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


class _Arrays:
    """The accessors of a file, and their bytes."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.binary = b""

    def add(self, rows: HostArray, *, bounded: bool = False) -> int:
        """Adds float vectors (n, 2), (n, 3) or (n, 4), or indices (n,). **Returns** the accessor's number."""
        is_index = rows.ndim == 1
        data = np.ascontiguousarray(rows, "<u4" if is_index else "<f4")
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": data.nbytes}
        self.views.append({**view, "target": _INDICES if is_index else _VERTICES})
        kind = {
            "componentType": _UNSIGNED if is_index else _FLOAT,
            "type": "SCALAR" if is_index else f"VEC{rows.shape[1]}",
        }
        limits = {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()} if bounded else {}
        self.accessors.append({"bufferView": len(self.views) - 1, "count": len(data), **kind, **limits})
        self.binary += data.tobytes()
        return len(self.accessors) - 1

    def add_image(self, image: Float[HostArray, "h w 4"]) -> int:
        """Adds an image of linear texels. Row 0 is the bottom row. **Returns** the number of its buffer view."""
        data = png_of(levels_of(image))
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        # The next view begins at a multiple of four bytes.
        self.binary += data + b"\0" * (-len(data) % 4)
        return len(self.views) - 1


def _document(scene: Scene, extras: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
    """The file's JSON without its buffer, and the buffer's bytes."""
    arrays = _Arrays()
    meshes, materials, nodes, images, textures = [], [], [], [], []
    samplers: list[Sampler] = []
    casts, receives = (each or (True,) * len(scene.meshes) for each in (scene.casts, scene.receives))
    for i, mesh in enumerate(scene.meshes):
        primitives = []
        for part, texture in _by_texture(mesh):
            primitive, material = _primitive(part, arrays)
            if texture is not None:
                images.append({"bufferView": arrays.add_image(texture.image), "mimeType": "image/png"})
                if texture.sampler not in samplers:
                    samplers.append(texture.sampler)
                textures.append({"source": len(images) - 1, "sampler": samplers.index(texture.sampler)})
                material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": len(textures) - 1}
                if texture.cutoff:
                    material |= {"alphaMode": "MASK", "alphaCutoff": texture.cutoff}
            primitives.append({**primitive, "material": len(materials)})
            materials.append(material)
        meshes.append({"name": f"mesh {i}", "primitives": primitives})
        shadows = {"casts": casts[i], "receives": receives[i]}
        nodes.append({"name": f"mesh {i}", "mesh": i, "extras": {EXTRAS: shadows}})
    camera, place = _camera(scene.camera)
    nodes.append({"name": "camera", "camera": 0, **place, "extras": {EXTRAS: _fields(scene.camera)}})
    lights = []
    for i, light in enumerate(scene.lights):
        kind, place = _light(light)
        lights.append(kind)
        its = {"extras": {EXTRAS: _fields(light)}, "extensions": {LIGHTS: {"light": i}}}
        nodes.append({"name": f"light {i}", **place, **its})
    # In double precision; the values in arrays are relative to the origin.
    root = {
        "name": "scene",
        "children": list(range(len(nodes))),
        "translation": [float(x) for x in scene.origin],
    }
    return {
        "asset": {"version": "2.0", "generator": "diffshadow"},
        "scene": 0,
        "scenes": [{"nodes": [len(nodes)], **({"extras": dict(extras)} if extras else {})}],
        "nodes": [*nodes, root],
        "meshes": meshes,
        "materials": materials,
        "cameras": [camera],
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
        "extensionsUsed": [LIGHTS],
        "extensions": {LIGHTS: {"lights": lights}},
        **({"images": images, "textures": textures, "samplers": [*map(_sampler, samplers)]} if images else {}),
    }, arrays.binary


def _sampler(sampler: Sampler) -> dict[str, int]:
    """The sampler with OpenGL's constants."""
    number = lambda numbers, word: next(number for number, each in numbers.items() if each == word)
    u, v = (number(WRAPS, word) for word in sampler.wrap)
    return {"wrapS": u, "wrapT": v, "magFilter": number(FILTERS, sampler.filter)}


class _Texture(NamedTuple):
    """Linear texels, the cutoff of the alpha test (0 for none), and the sampler."""

    image: Float[HostArray, "h w 4"]
    cutoff: float
    sampler: Sampler


def _by_texture(mesh: Mesh) -> Iterator[tuple[Mesh, _Texture | None]]:
    """A separate mesh for the faces of each texture, and for the faces without a texture."""
    if mesh.textures is None:
        yield mesh, None
        return
    textures = mesh.textures
    index, images, samplers = _known(textures.index), textures.images(), textures.each_sampler()
    cutoff = np.zeros(len(images)) if textures.cutoff is None else _known(textures.cutoff)
    for number in np.unique(index):
        of = np.flatnonzero(index == number)
        colours = None if mesh.corner_colours is None else _known(mesh.corner_colours)[of]
        faces, normals, albedo = (_known(values)[of] for values in (mesh.faces, mesh.corner_normals, mesh.albedo))
        own = None if number < 0 else textures.for_faces(of)
        part = Mesh(mesh.vertices, faces, normals, albedo, colours, own)
        yield part, None if number < 0 else _Texture(images[number], float(cutoff[number]), samplers[number])


def _primitive(mesh: Mesh, arrays: _Arrays) -> tuple[dict[str, Any], dict[str, Any]]:
    """The triangles of a mesh without their material, and the material."""
    faces, albedo = _known(mesh.faces), _known(mesh.albedo)
    is_plain = bool((albedo == albedo[0]).all())
    colours = None if is_plain else np.repeat(albedo, 3, axis=0)
    if mesh.corner_colours is not None:
        corner_colours = _known(mesh.corner_colours).reshape(-1, 3)
        colours = corner_colours if colours is None else colours * corner_colours
    if mesh.textures is not None and mesh.textures.corner_alpha is not None:
        alpha = _known(mesh.textures.corner_alpha).reshape(-1, 1)
        colours = np.concatenate([np.ones((len(alpha), 3)) if colours is None else colours, alpha], axis=1)
    # An image's first row is its top row.
    uv = None if mesh.textures is None else _known(mesh.textures.uv).reshape(-1, 2) * (1, -1) + (0, 1)
    corners = _known(mesh.corner_normals).reshape(-1, 3).astype(np.float32)
    # A face without area has no normal, but the format requires unit vectors.
    corners = np.where(np.abs(corners).sum(axis=1, keepdims=True) > 0, corners, np.asarray([0, 0, 1], np.float32))
    columns = [faces.reshape(-1, 1).astype(np.float64), corners]
    columns += [values for values in (colours, uv) if values is not None]
    _, first, corner = np.unique(np.concatenate(columns, axis=1), axis=0, return_index=True, return_inverse=True)
    attributes = {
        "POSITION": arrays.add(_known(mesh.vertices)[faces.ravel()[first]], bounded=True),
        "NORMAL": arrays.add(corners[first]),
    }
    if colours is not None:
        attributes["COLOR_0"] = arrays.add(colours[first])
    if uv is not None:
        attributes["TEXCOORD_0"] = arrays.add(uv[first])
    colour = [*albedo[0].tolist(), 1.0] if is_plain else [1.0] * 4
    look = {"baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 1.0}
    material = {"pbrMetallicRoughness": look, "doubleSided": True}
    return {"attributes": attributes, "indices": arrays.add(corner.ravel())}, material


def _camera(camera: AbstractCamera) -> tuple[dict[str, Any], dict[str, Any]]:
    """The camera, and the position of its node."""
    view = camera.view()
    clip = _known(view.eye_to_clip).astype(np.float64)
    off = clip[:2, 2] if view.is_perspective else clip[:2, 3]
    if isinstance(camera, MatrixCamera) and np.abs(off).max() > _CENTRED:
        raise ValueError(
            f"the camera's projection is off-centre by {off.tolist()}, which glTF cannot hold; expected a centred one: "
            "crop the image otherwise, or use a PinholeCamera"
        )
    ends = {"znear": float(_known(view.near)), "zfar": float(_known(view.far))}
    across, up = 1 / clip[0, 0], 1 / clip[1, 1]
    if view.is_perspective:
        lens = {"yfov": 2 * math.atan(up), "aspectRatio": across / up, **ends}
        kind = {"type": "perspective", "perspective": lens}
    else:
        kind = {"type": "orthographic", "orthographic": {"xmag": across, "ymag": up, **ends}}
    return kind, {"matrix": _placed(view, _known(camera.eye))}


def _light(light: AbstractLight) -> tuple[dict[str, Any], dict[str, Any]]:
    """The light, and the position of its node."""
    plain = {"color": [1.0, 1.0, 1.0], "intensity": 1.0}
    view = None if isinstance(light, PointLight) else light.view()
    if view is None or not isinstance(light, DirectionalLight | SpotLight | MatrixLight):
        position = _known(getattr(light, "position")).astype(np.float64)  # noqa: B009
        return {"type": "point", **plain}, {"translation": position.tolist()}
    if isinstance(light, DirectionalLight) or not view.is_perspective:
        place = _known(light.center) if isinstance(light, DirectionalLight) else None
        return {"type": "directional", **plain}, {"matrix": _placed(view, place)}
    if isinstance(light, SpotLight):
        angles = light.outer_angle, 0.0 if light.inner_angle is None else light.inner_angle
        outer, inner = (math.radians(float(_known(angle))) for angle in angles)
        place = _known(light.position)
    else:
        # Encloses its whole frustum.
        across, up = (1 / _known(view.eye_to_clip)[k, k] for k in range(2))
        outer, inner, place = math.atan(math.hypot(across, up)), 0.0, None
    cone = {"innerConeAngle": min(inner, outer * _NARROWER), "outerConeAngle": outer}
    return {"type": "spot", **plain, "spot": cone}, {"matrix": _placed(view, place)}


def _placed(view: View, place: HostArray | None) -> list[float]:
    """The matrix of a node in column-major order. The node has the axes of `view`. Its origin is `place` (3,), or the
    eye of `view`."""
    to_eye = _known(view.world_to_eye).astype(np.float64)
    # After rounding to single precision, its axes are not quite orthogonal.
    left, _, right = np.linalg.svd(to_eye[:3, :3])
    matrix = np.eye(4)
    matrix[:3, :3] = (left @ right).T
    matrix[:3, 3] = -matrix[:3, :3] @ to_eye[:3, 3] if place is None else place
    return matrix.T.ravel().tolist()


def _fields(module: Any) -> dict[str, Any]:
    """The fields of a camera or a light, with its class as `type`."""
    values = {field.name: getattr(module, field.name) for field in dataclasses.fields(module)}
    plain = {name: None if value is None else np.asarray(_known(value)).tolist() for name, value in values.items()}
    return {"type": type(module).__name__, **plain}


def _known(value: Any) -> Float[HostArray, "..."]:
    """**Raises** `ValueError` if JAX traces `value`."""
    known = concrete(value)
    if known is None:
        raise ValueError(
            "the scene is traced by JAX, so its values are not known; expected numbers: write it outside jit"
        )
    return np.asarray(known)


def _json(document: Mapping[str, Any]) -> bytes:
    try:
        return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the extras have values that JSON cannot store ({error}); expected numbers, texts, and lists and "
            "dictionaries of these"
        ) from error


def _glb(text: bytes, binary: bytes) -> bytes:
    """A GLB file: section 4 of the specification."""
    parts = b""
    for kind, data, filler in ((_JSON, text, b" "), (_BINARY, binary, b"\0")):
        padded = data + filler * (-len(data) % 4)
        parts += struct.pack("<II", len(padded), kind) + padded
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts
