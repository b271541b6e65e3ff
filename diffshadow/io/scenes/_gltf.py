"""Scenes of glTF 2.0 files: meshes, cameras, and the lights of KHR_lights_punctual.

https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_lights_punctual
"""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ValidationError

from ..._types import HostArray
from .._errors import damaged
from .._gltf import nodes_of, parts_of
from .._gltf_data import Buffers, chunks, item
from .._gltf_schema import LIGHTS, Camera, Document, Light, Material, parse
from .._text import excerpt
from ._parts import SceneCamera, SceneFile, SceneLight, SceneMesh, Vector


def read_gltf_scene(data: bytes, folder: Path) -> SceneFile:
    """Reads the meshes, cameras and lights of a file's scene.

    **Arguments:**

    - `data`: the file's bytes.
    - `folder`: the file's folder, where the files it refers to are looked up.

    **Raises** `MeshError` if it is damaged, or holds what cannot be read.
    """
    text, binary = chunks(data)
    document = parse(text)
    remarks: list[str] = []
    left_out: Counter[str] = Counter()
    materials = _all(Material, document.materials, "materials")
    meshes = []
    for part in parts_of(document, Buffers(document, binary, folder), left_out):
        if not len(part.faces):
            continue
        number = part.primitive.material
        material = Material() if number is None else item(materials, number, "material")
        name = part.node.name or item(document.meshes, part.node.mesh or 0, "mesh").name or "mesh"
        side = "double" if material.double_sided else "front"
        meshes.append(SceneMesh(name, part.vertices, part.faces, part.normals, side))
        if material.alpha_mode == "MASK":
            remarks.append(f"{name}: its alpha test is left out; the whole surface casts")
        if part.normals is None:
            remarks.append(f"{name}: it has no normals; it gets those of its faces")
    remarks += [f"{count} × {name}: left out" for name, count in left_out.items() if count]
    cameras, lights = _placed(document, remarks)
    return SceneFile(meshes, cameras, lights, None, remarks)


def _placed(document: Document, remarks: list[str]) -> tuple[list[SceneCamera], list[SceneLight]]:
    """The cameras and lights of the nodes."""
    cameras, lights = _all(Camera, document.cameras, "cameras"), _lights(document)
    seen, lit = [], []
    for node, to_world in nodes_of(document):
        if node.camera is not None:
            camera = item(cameras, node.camera, "camera")
            seen.append(_camera(camera, node.name or camera.name or "camera", to_world))
        of_node = node.extensions.get(LIGHTS)
        if isinstance(of_node, dict):
            number = of_node.get("light")
            if not isinstance(number, int) or number < 0:
                raise damaged(f"a node refers to the light {excerpt(str(number))}")
            light = item(lights, number, "light")
            lit.append(_light(light, node.name or light.name or light.type, to_world))
    return seen, lit


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
