"""Scenes of glTF 2.0 files: meshes, cameras, and the lights of KHR_lights_punctual.

https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_lights_punctual
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ValidationError

from ..._types import HostArray
from .._errors import Faults, damaged
from .._gltf import CUT_OUT, HIDDEN_MESH, NO_POSITIONS, nodes_of, parts_of
from .._gltf_data import Buffers, chunks, item
from .._gltf_materials import BaseColour
from .._gltf_schema import (
    EXTRAS,
    LIGHTS,
    TRANSMISSION,
    UNLIT,
    VISIBILITY,
    Camera,
    Document,
    Light,
    Material,
    Node,
    parse,
)
from .._text import excerpt
from ._parts import SceneCamera, SceneFile, SceneLight, SceneMesh, Vector


def read_gltf_scene(data: bytes, folder: Path) -> SceneFile:
    """Reads the meshes, cameras and lights of a file's scene.

    **Arguments:**

    - `data`: the file's bytes.
    - `folder`: the file's folder, where the files it refers to are looked up.

    **Raises** `MeshError` if it is damaged or cannot be read.
    """
    text, binary = chunks(data)
    document = parse(text)
    remarks: list[str] = []
    left_out: Counter[str] = Counter()
    faults = Faults()
    materials = _all(Material, document.materials, "materials")
    meshes, empty = [], 0
    for part in parts_of(document, Buffers(document, binary, folder), left_out, faults):
        name = _mesh_name(part.node, document)
        if not len(part.faces):
            remarks.append(f"{name}: it has no triangles; left out")
            empty += 1
            continue
        number = part.primitive.material
        material = Material() if number is None else item(materials, number, "material")
        side = "double" if material.double_sided else "front"
        emits = any(material.emissive_factor) or UNLIT in material.extensions
        mesh = SceneMesh(name, part.vertices, part.faces, part.normals, side, emits=emits, **_look(part.look))
        meshes.append(mesh._replace(**_shadows(part.node)))
        has = part.normals is not None, part.look.texture is not None
        remarks += [f"{name}: {remark}" for remark in _remarks(material, *has)]
    fault = faults.error()
    if fault is not None and not meshes:
        raise fault
    lost = sum(left_out[name] for name in (HIDDEN_MESH, NO_POSITIONS, CUT_OUT)) + empty + faults.count
    # These are named one by one below.
    del left_out[HIDDEN_MESH]
    remarks += faults.remarks()
    remarks += [f"{count} × {name}: left out" for name, count in left_out.items() if count]
    cameras, lights = _placed(document, remarks)
    return SceneFile(meshes, cameras, lights, None, list(dict.fromkeys(remarks)), lost)


def _mesh_name(node: Node, document: Document) -> str:
    return node.name or item(document.meshes, node.mesh or 0, "mesh").name or "mesh"


def _shadows(node: Node) -> dict[str, bool]:
    """Whether a mesh casts and receives shadows, if `write_gltf` has stored this."""
    extras = node.extras.get(EXTRAS) if isinstance(node.extras, Mapping) else None
    given = extras if isinstance(extras, Mapping) else {}
    return {name: given[name] for name in ("casts", "receives") if isinstance(given.get(name), bool)}


def _look(look: BaseColour) -> dict[str, Any]:
    """The colours and the texture of a mesh."""
    found: dict[str, Any] = {"colours": look.colours}
    if look.factor is not None:
        found["colour"] = _vector(look.factor)
    texture = look.texture
    if texture is not None:
        found |= {"texture": texture, "alpha": None if texture.cutoff is None else look.alpha}
        found |= {} if texture.picture is None else {"uv": look.uv}
    return found


def _remarks(material: Material, has_normals: bool, has_texture: bool) -> Iterator[str]:
    """The differences between a mesh here and in the file."""
    if material.alpha_mode == "MASK" and not has_texture:
        yield "its alpha test is left out, because it has no readable texture; the whole surface casts"
    transmission = material.extensions.get(TRANSMISSION)
    if material.alpha_mode == "BLEND" or (isinstance(transmission, dict) and transmission.get("transmissionFactor")):
        yield "it is transparent, but opaque here; in shadow maps it is also opaque in three.js"
    if UNLIT in material.extensions:
        yield "its material is unlit (KHR_materials_unlit) and shows no shadows; here it shows them"
    if not has_normals:
        yield "it has no normals; its faces' normals are used"


def _placed(document: Document, remarks: list[str]) -> tuple[list[SceneCamera], list[SceneLight]]:
    """The cameras and lights of the nodes. Adds hidden ones to `remarks`."""
    cameras, lights = _all(Camera, document.cameras, "cameras"), _lights(document)
    seen: list[SceneCamera] = []
    beside: list[SceneCamera] = []
    lit: list[SceneLight] = []
    for node, _, to_world, is_visible in nodes_of(document):
        hidden = []
        if node.mesh is not None and not is_visible:
            hidden.append(_mesh_name(node, document))
        if node.camera is not None:
            camera = item(cameras, node.camera, "camera")
            placed = _camera(camera, node.name or camera.name or "camera", to_world)
            (seen if is_visible else beside).append(placed)
        of_node = node.extensions.get(LIGHTS)
        if isinstance(of_node, dict):
            number = of_node.get("light")
            if not isinstance(number, int) or number < 0:
                raise damaged(f"a node refers to the light {excerpt(str(number))}")
            light = item(lights, number, "light")
            placed = _light(light, node.name or light.name or light.type, to_world)
            if is_visible:
                lit.append(placed)
            else:
                hidden.append(placed.name)
        remarks += [f"{name}: hidden by {VISIBILITY}; left out" for name in hidden]
    # The extension does not hide cameras, so a hidden camera may be used if there is no other.
    said = "left out" if seen else "used anyway, because there is no other camera"
    remarks += [f"{camera.name}: hidden by {VISIBILITY}; {said}" for camera in beside]
    return seen or beside, lit


def _lights(document: Document) -> list[Light]:
    stored = document.extensions.get(LIGHTS)
    entries = stored.get("lights") if isinstance(stored, dict) else None
    return _all(Light, entries if isinstance(entries, list) else [], LIGHTS)


def _camera(camera: Camera, name: str, to_world: Float[HostArray, "4 4"]) -> SceneCamera:
    _, up, backward = _axes(to_world)
    place = name, _vector(to_world[:3, 3]), _vector(-backward), _vector(up)
    if camera.type == "perspective" and camera.perspective is not None:
        lens = camera.perspective
        return SceneCamera(*place, lens.znear, lens.zfar, math.degrees(lens.yfov), aspect=lens.aspect_ratio)
    if camera.type == "orthographic" and camera.orthographic is not None:
        box = camera.orthographic
        if not (box.xmag and box.ymag):
            raise damaged(f"its camera {excerpt(name)} has no width or height")
        return SceneCamera(*place, box.znear, box.zfar, height=2 * abs(box.ymag), aspect=abs(box.xmag / box.ymag))
    raise damaged(f"its camera {excerpt(name)} is {camera.type}, without the settings of one")


def _light(light: Light, name: str, to_world: Float[HostArray, "4 4"]) -> SceneLight:
    direction = None if light.type == "point" else _vector(-_axes(to_world)[2])
    inner = outer = None
    if light.type == "spot":
        inner, outer = math.degrees(light.spot.inner_cone_angle), math.degrees(light.spot.outer_cone_angle)
    return SceneLight(name, light.type, _vector(to_world[:3, 3]), direction, inner, outer)


def _axes(to_world: Float[HostArray, "4 4"]) -> tuple[Any, ...]:
    axes = to_world[:3, :3] / np.maximum(np.linalg.norm(to_world[:3, :3], axis=0), np.finfo(float).tiny)
    return tuple(axes.T)


def _all[T: BaseModel](model: type[T], entries: Sequence[Any], name: str) -> list[T]:
    found = []
    for i, entry in enumerate(entries):
        try:
            found.append(model.model_validate(entry))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"]))
            raise damaged(f"{name}.{i}.{where}: {first['msg']}") from error
    return found


def _vector(values: Any) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
