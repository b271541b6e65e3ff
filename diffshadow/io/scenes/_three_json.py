"""Scenes of three.js: files of `Object3D.toJSON`."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..._types import HostArray
from ...settings.engines import Side
from .._errors import Faults, MeshError, damaged, some_of
from .._polygons import repeated
from ._parts import SceneCamera, SceneFile, SceneLight, SceneMesh, SceneShadow, Vector
from ._three_buffers import geometry_of, maybe_half_floats, values_of
from ._three_geometries import Geometry
from ._three_schema import Document, GeometryEntry, Material, Object, ShadowCamera, parse

_MESHES = ("Mesh", "SkinnedMesh", "InstancedMesh")
_CAMERAS = ("PerspectiveCamera", "OrthographicCamera")
_LIGHTS = {"DirectionalLight": "directional", "SpotLight": "spot", "PointLight": "point"}
# Objects that neither draw a surface nor cast a shadow here: their names in remarks.
_OTHERS = {
    "Line": "line",
    "LineSegments": "line",
    "LineLoop": "line",
    "Points": "cloud of points",
    "Sprite": "sprite",
    "BatchedMesh": "batched mesh",
    "AmbientLight": "ambient light, which casts no shadow",
    "HemisphereLight": "hemisphere light, which casts no shadow",
    "RectAreaLight": "area light, which casts no shadow in three.js",
    "LightProbe": "light probe, which casts no shadow",
    "ArrayCamera": "array camera",
    "CubeCamera": "cube camera",
    "StereoCamera": "stereo camera",
}
_SIDES: tuple[Side, Side, Side] = ("front", "back", "double")
_UNLIT = ("MeshBasicMaterial", "MeshNormalMaterial", "MeshDepthMaterial", "MeshDistanceMaterial", "MeshMatcapMaterial")
_OWN_SHADERS = ("ShaderMaterial", "RawShaderMaterial")


class _Placed(NamedTuple):
    """A drawn object, and its matrix to world space."""

    object: Object
    to_world: Float[HostArray, "4 4"]

    @property
    def name(self) -> str:
        return self.object.name or self.object.type

    @property
    def position(self) -> Vector:
        return _vector(self.to_world[:3, 3])


def read_three(content: Mapping[str, Any]) -> SceneFile:
    """Reads the meshes, cameras and lights of a file's content.

    **Raises** `MeshError` if it is damaged or cannot be read.
    """
    document = parse(content)
    remarks: list[str] = []
    everything = [*_walk(document.object, np.eye(4), visible=True)]
    if len(everything) > 1 and not any(_is_moved(entry) for entry, _ in everything):
        remarks.append("no object is moved: was scene.updateMatrixWorld() called before scene.toJSON()?")
    drawn = [_Placed(entry.object, entry.to_world) for entry, visible in everything if visible]
    unseen = [entry for entry, visible in everything if not visible]
    hidden = [entry.name for entry in unseen if entry.object.type in (*_MESHES, *_LIGHTS)]
    lost = sum(entry.object.type in _MESHES for entry in unseen)
    if hidden:
        remarks.append(f"{some_of(hidden)}: visible = false, here or in a group around; left out")
    others = Counter(_OTHERS[entry.object.type] for entry in drawn if entry.object.type in _OTHERS)
    remarks += [f"{count} × {name}: left out" for name, count in others.items()]
    # A camera works whether it is in the scene's visible part or not.
    cameras = [_camera(entry, remarks) for entry, _ in everything if entry.object.type in _CAMERAS]
    positions = {entry.object.uuid: entry.position for entry, _ in everything if entry.object.uuid}
    lights = [_light(entry, positions, remarks) for entry in drawn if entry.object.type in _LIGHTS]
    meshes, unread = _meshes(document, drawn, remarks)
    return SceneFile(meshes, cameras, lights, "three.js", remarks, lost + unread)


def _walk(entry: Object, parent: Float[HostArray, "4 4"], visible: bool) -> Iterator[tuple[_Placed, bool]]:
    """All objects, with parents before their children, and whether each is drawn."""
    to_world = parent @ _matrix(entry)
    visible = visible and entry.visible
    yield _Placed(entry, to_world), visible
    # Only the finest level of detail is drawn.
    finest = min(entry.levels, key=lambda level: level.distance).object if entry.levels else None
    coarser = {level.object for level in entry.levels} - {finest}
    for child in entry.children:
        yield from _walk(child, to_world, visible and child.uuid not in coarser)


def _matrix(entry: Object) -> Float[HostArray, "4 4"]:
    """The matrix from the object's space to its parent's."""
    if entry.matrix is not None:
        matrix = np.array(entry.matrix).reshape(4, 4).T
    else:
        try:
            turn = (
                Rotation.from_quat(entry.quaternion)
                if entry.quaternion
                else Rotation.from_euler("XYZ", entry.rotation[:3])
            )
            matrix = np.eye(4)
            matrix[:3, :3] = turn.as_matrix() * np.asarray(entry.scale)
            matrix[:3, 3] = entry.position
        except (ValueError, TypeError) as error:
            raise damaged(f"the placement of its object {entry.name or entry.uuid} cannot be read ({error})") from error
    if not np.isfinite(matrix).all():
        raise damaged(f"the matrix of its object {entry.name or entry.uuid} holds NaN or infinity")
    return matrix


def _is_moved(entry: _Placed) -> bool:
    # Lights are created at (0, 1, 0).
    own = _matrix(entry.object)
    return not (np.array_equal(own[:3, :3], np.eye(3)) and own[0, 3] == own[2, 3] == 0 and own[1, 3] in (0, 1))


def _meshes(document: Document, drawn: list[_Placed], remarks: list[str]) -> tuple[list[SceneMesh], int]:
    """The drawn meshes, and the number of parts that are unreadable or invisible.

    **Raises** `MeshError` if none of the meshes can be read.
    """
    stored = {entry.uuid: entry for entry in document.geometries}
    materials = {entry.uuid: entry for entry in document.materials}
    built: dict[str, Geometry] = {}
    faults = Faults()
    meshes: list[SceneMesh] = []
    found = 0
    for entry in drawn:
        if entry.object.type not in _MESHES:
            continue
        is_new = entry.object.geometry not in built
        try:
            geometry = _geometry(entry, stored, built)
            parts = [*_parts(entry, geometry, materials)]
            placed = [_instances(entry, geometry._replace(faces=faces)) for _, faces, _ in parts]
        except MeshError as fault:
            faults.add(entry.name, fault)
            continue
        of_mesh = stored[entry.object.geometry or ""]
        remarks += _half_floats(entry.name, of_mesh) if is_new else []
        _remark_geometry(entry, of_mesh, geometry, remarks)
        found += len(parts)
        for (name, _, material), whole in zip(parts, placed, strict=True):
            if not material.visible:
                remarks.append(f"{name}: its material is not visible; left out")
            elif material.wireframe:
                remarks.append(f"{name}: its material is a wireframe; left out")
            elif len(whole.faces):
                _remark_material(name, material, entry.object, remarks)
                meshes.append(_mesh(name, whole, material, entry.object))
            else:
                remarks.append(f"{name}: it has no triangles; left out")
    fault = faults.error()
    if fault is not None and not meshes:
        raise fault
    remarks += faults.remarks()
    return meshes, faults.count + found - len(meshes)


def _geometry(entry: _Placed, stored: Mapping[str, GeometryEntry], built: dict[str, Geometry]) -> Geometry:
    """The geometry of a mesh, cached in `built`."""
    uuid = entry.object.geometry or ""
    if uuid not in stored:
        raise damaged(f"its mesh {entry.name} refers to a geometry that the file lacks")
    if uuid not in built:
        built[uuid] = geometry_of(stored[uuid])
    return built[uuid]


def _half_floats(name: str, stored: GeometryEntry) -> list[str]:
    attributes = maybe_half_floats(stored)
    if not attributes:
        return []
    return [
        f"{name}: its attribute {' and '.join(attributes)} holds whole numbers of 16 bits, and is read as these, as "
        "ObjectLoader does; if they are the bits of a Float16BufferAttribute, which files do not say, make it a "
        "Float32BufferAttribute before toJSON()"
    ]


def _mesh(name: str, whole: Geometry, material: Material, object: Object) -> SceneMesh:
    return SceneMesh(
        name,
        whole.vertices,
        whole.faces,
        whole.normals,
        _SIDES[material.side],
        None if material.shadow_side is None else _SIDES[material.shadow_side],
        object.cast_shadow,
        object.receive_shadow,
        object.layers,
        _colour(material.color),
        material.type == "MeshBasicMaterial" or bool(material.emissive and material.emissive_intensity),
    )


def _parts(
    entry: _Placed, geometry: Geometry, materials: Mapping[str, Material]
) -> Iterator[tuple[str, Any, Material]]:
    """The faces of each material, and the names of these parts."""
    used = entry.object.material
    if not isinstance(used, list):
        yield entry.name, geometry.faces, materials.get(used or "", Material())
        return
    # With a list of materials, the engine draws only groups.
    for start, count, number in geometry.groups:
        if number < len(used):
            yield (
                f"{entry.name} {number}",
                geometry.faces[start : start + count],
                materials.get(used[number], Material()),
            )


def _instances(entry: _Placed, geometry: Geometry) -> Geometry:
    """The geometry in world space, once for each instance."""
    matrices = np.eye(4)[None]
    if entry.object.type == "InstancedMesh":
        stored = entry.object.instance_matrix
        if stored is None:
            raise damaged(f"its instanced mesh {entry.name} has no instanceMatrix")
        values = values_of(stored, None, "instanceMatrix")
        if values.shape[1] != 16 or len(values) < entry.object.count or not np.isfinite(values).all():
            raise damaged(f"its instanced mesh {entry.name} has no {entry.object.count} finite matrices")
        matrices = values[: entry.object.count].reshape(-1, 4, 4).swapaxes(1, 2)
    return Geometry(*repeated(*geometry[:3], entry.to_world @ matrices))


def _remark_geometry(entry: _Placed, stored: GeometryEntry, geometry: Geometry, remarks: list[str]) -> None:
    name = entry.name
    has_morphs = stored.data is not None and bool(stored.data.morph_attributes)
    if entry.object.type == "SkinnedMesh":
        remarks.append(f"{name}: its skin is left out; its size and position come from its vertices")
    if has_morphs and any(entry.object.morph_target_influences):
        remarks.append(f"{name}: its morph targets are left out; the mesh is its base")
    if geometry.normals is None:
        remarks.append(f"{name}: it has no normals, so normalBias does not move it, and its shading is dark")


def _remark_material(name: str, material: Material, object: Object, remarks: list[str]) -> None:
    cut = material.alpha_test > 0 or material.alpha_hash or material.alpha_map is not None
    if cut:
        remarks.append(f"{name}: its alpha test or alpha map is left out; the whole surface casts")
    if material.side == 1:
        remarks.append(f"{name}: its material shows back faces alone; the image shows its front faces as well")
    if material.displacement_map is not None:
        remarks.append(f"{name}: its displacement map is left out")
    if material.clipping_planes:
        remarks.append(f"{name}: its clipping planes are left out")
    if material.map is not None:
        remarks.append(f"{name}: its texture is left out; shadows do not depend on it")
    if material.transparent and material.opacity < 1:
        remarks.append(f"{name}: it is transparent, but opaque here; in shadow maps it is also opaque in three.js")
    if material.type in _OWN_SHADERS:
        remarks.append(f"{name}: its {material.type} is left out; the vertices are as they are stored")
    elif object.receive_shadow and material.type in _UNLIT:
        remarks.append(f"{name}: its {material.type} shows no shadows in three.js; here it shows them")


def _camera(entry: _Placed, remarks: list[str]) -> SceneCamera:
    object = entry.object
    # The engine ignores the scale.
    right, up, backward = (entry.to_world[:3, i] / np.linalg.norm(entry.to_world[:3, i]) for i in range(3))
    eye, far = entry.to_world[:3, 3], None if math.isinf(object.far) else object.far
    if object.view is not None and object.view.get("enabled", True):
        remarks.append(f"{entry.name}: its view offset is left out; the camera sees the whole view")
    if object.type == "PerspectiveCamera":
        if object.film_offset:
            remarks.append(f"{entry.name}: its filmOffset is left out")
        fov = 2 * math.degrees(math.atan(math.tan(math.radians(object.fov) / 2) / object.zoom))
        shape: dict[str, Any] = {"fov_y": fov, "aspect": object.aspect}
    else:
        width, height = (
            (high - low) / object.zoom for low, high in ((object.left, object.right), (object.bottom, object.top))
        )
        if not (width > 0 and height > 0):
            raise damaged(f"its camera {entry.name} has no width or height")
        eye = eye + (object.left + object.right) / 2 * right + (object.bottom + object.top) / 2 * up
        shape = {"height": height, "aspect": width / height}
    return SceneCamera(
        entry.name, _vector(eye), _vector(-backward), _vector(up), object.near, far, layers=object.layers, **shape
    )


def _light(entry: _Placed, positions: Mapping[str, Vector], remarks: list[str]) -> SceneLight:
    object = entry.object
    kind: Any = _LIGHTS[object.type]
    direction = None
    if kind != "point":
        if object.cast_shadow and object.target not in positions:
            remarks.append(f"{entry.name}: its target is not in the scene, so the origin is used")
        target = np.array(positions.get(object.target or "", (0.0, 0.0, 0.0)))
        direction = _vector(target - entry.position)
        if not any(direction):
            # The engine looks from a position at the same position.
            direction = (0.0, 0.0, -1.0)
            remarks.append(
                f"{entry.name}: its target is at its own position, so it has no direction; (0, 0, -1) is used, as in "
                "three.js' shadow camera"
            )
    inner = outer = None
    if kind == "spot":
        outer = math.degrees(object.angle)
        inner = math.degrees(object.angle * (1 - min(max(object.penumbra, 0.0), 1.0)))
    if object.cast_shadow and tuple(object.shadow.camera.up) != (0, 1, 0):
        remarks.append(f"{entry.name}: the up direction of its shadow camera is left out")
    return SceneLight(
        entry.name,
        kind,
        entry.position,
        direction,
        inner,
        outer,
        object.cast_shadow,
        _shadow(kind, object),
        object.layers,
    )


def _shadow(kind: str, object: Object) -> SceneShadow:
    shadow, camera = object.shadow, object.shadow.camera
    width, height = shadow.map_size
    half = None
    if kind == "spot":
        half = math.degrees(math.atan(math.tan(min(object.angle * shadow.focus, math.pi / 2 - 1e-9)) / camera.zoom))
    return SceneShadow(
        near=camera.near,
        # A light's range replaces its camera's far plane.
        far=(object.distance or camera.far) if kind != "directional" else camera.far,
        window=_window(camera),
        map_size=(width, height),
        bias=shadow.bias,
        normal_bias=shadow.normal_bias,
        radius=shadow.radius,
        intensity=shadow.intensity,
        blur_samples=shadow.blur_samples,
        half_angle=half,
        aspect=width / height * shadow.aspect,
    )


def _window(camera: ShadowCamera) -> tuple[float, float, float, float]:
    """Left, right, top and bottom, narrowed by the camera's zoom."""
    sides = []
    for low, high in ((camera.left, camera.right), (camera.bottom, camera.top)):
        middle, half = (low + high) / 2, (high - low) / 2 / camera.zoom
        sides += [middle - half, middle + half]
    left, right, bottom, top = sides
    return left, right, top, bottom


def _colour(value: int) -> Vector:
    return (value >> 16 & 255) / 255, (value >> 8 & 255) / 255, (value & 255) / 255


def _vector(values: Any) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
