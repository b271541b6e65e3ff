"""The part of a three.js file (`Object3D.toJSON`, formats 4.x) that describes meshes, cameras, lights and shadows.

Defaults are the engine's own (three.js r187). Older releases leave them out of the file.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from ...settings import scene
from ...settings.engines import ThreeJs
from .._errors import MeshError, damaged
from .._text import excerpt

# JSON has no infinity, so JavaScript writes null.
_Far = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value)]
_Matrix = Annotated[list[float], Field(min_length=16, max_length=16)]


class _Part(BaseModel):
    model_config = ConfigDict(
        alias_generator=to_camel,
        frozen=True,
        coerce_numbers_to_str=True,
        allow_inf_nan=True,
        arbitrary_types_allowed=True,
        defer_build=True,
    )


class Metadata(_Part):
    version: float = 4.0
    type: str = ""


class Attribute(_Part):
    """A `BufferAttribute`, whose `array` may lie in an interleaved buffer."""

    item_size: Annotated[int, Field(ge=1, le=16)]
    type: str = "Float32Array"
    array: Any = None
    normalized: bool = False
    is_interleaved_buffer_attribute: bool = False
    data: str | None = None
    offset: Annotated[int, Field(ge=0)] = 0


class Interleaved(_Part):
    buffer: str
    type: str
    stride: Annotated[int, Field(ge=1)]


class Index(_Part):
    type: str
    array: Any


class Group(_Part):
    start: Annotated[int, Field(ge=0)]
    count: _Far
    material_index: Annotated[int, Field(ge=0)] = 0


class GeometryData(_Part):
    attributes: Mapping[str, Attribute]
    index: Index | None = None
    groups: list[Group] = []
    morph_attributes: Mapping[str, Any] = {}
    interleaved_buffers: Mapping[str, Interleaved] = {}
    array_buffers: Mapping[str, Any] = {}


class GeometryEntry(_Part):
    """A geometry: its data, or the parameters of a built-in shape, as keys next to `type`."""

    model_config = ConfigDict(extra="allow")

    uuid: str
    type: str
    data: GeometryData | None = None


class Material(_Part):
    uuid: str = ""
    type: str = "Material"
    name: str = ""
    color: Annotated[int, Field(ge=0, le=0xFFFFFF)] = 0xFFFFFF
    emissive: Annotated[int, Field(ge=0, le=0xFFFFFF)] = 0
    emissive_intensity: float = 1.0
    side: Annotated[int, Field(ge=0, le=2)] = 0
    shadow_side: Annotated[int, Field(ge=0, le=2)] | None = None
    visible: bool = True
    wireframe: bool = False
    transparent: bool = False
    opacity: float = 1.0
    alpha_test: float = 0.0
    alpha_hash: bool = False
    alpha_map: Any = None
    map: Any = None
    displacement_map: Any = None
    clipping_planes: Any = None


class ShadowCamera(_Part):
    left: float = scene.ShadowCamera.left
    right: float = scene.ShadowCamera.right
    top: float = scene.ShadowCamera.top
    bottom: float = scene.ShadowCamera.bottom
    near: float = scene.ShadowCamera.near
    far: float = scene.ShadowCamera.far
    zoom: Annotated[float, Field(gt=0)] = 1.0
    up: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 1.0, 0.0]


class Shadow(_Part):
    intensity: float = ThreeJs.intensity
    bias: float = ThreeJs.bias
    normal_bias: float = ThreeJs.normal_bias
    radius: Annotated[float, Field(ge=0)] = ThreeJs.radius
    blur_samples: int = ThreeJs.blur_samples
    map_size: Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=2, max_length=2)] = [512, 512]
    focus: Annotated[float, Field(gt=0)] = 1.0
    aspect: Annotated[float, Field(gt=0)] = 1.0
    camera: ShadowCamera = ShadowCamera()


class Level(_Part):
    object: str
    distance: float = 0.0


class Object(_Part):
    """An object of the scene graph. Its `type` may make it a mesh, camera or light."""

    uuid: str = ""
    type: str = "Object3D"
    name: str = ""
    matrix: _Matrix | None = None
    position: list[float] = [0.0, 0.0, 0.0]
    rotation: list[Any] = [0.0, 0.0, 0.0]
    quaternion: list[float] | None = None
    scale: list[float] = [1.0, 1.0, 1.0]
    visible: bool = True
    layers: int = 1
    cast_shadow: bool = False
    receive_shadow: bool = False
    geometry: str | None = None
    material: str | list[str] | None = None
    children: list["Object"] = []
    # Instances.
    count: Annotated[int, Field(ge=0)] = 0
    instance_matrix: Attribute | None = None
    # Levels of detail.
    levels: list[Level] = []
    # Cameras.
    fov: Annotated[float, Field(gt=0, lt=180)] = 50.0
    zoom: Annotated[float, Field(gt=0)] = 1.0
    near: float = 0.1
    far: _Far = 2000.0
    aspect: Annotated[float, Field(gt=0)] = 1.0
    left: float = -1.0
    right: float = 1.0
    top: float = 1.0
    bottom: float = -1.0
    view: Mapping[str, Any] | None = None
    film_offset: float = 0.0
    # Lights.
    target: str | None = None
    distance: float = 0.0
    angle: float = math.pi / 3
    penumbra: float = 0.0
    shadow: Shadow = Shadow()
    morph_target_influences: list[float] = []


class Document(_Part):
    """A whole file. Objects refer to geometries and materials by their identifiers."""

    metadata: Metadata = Metadata()
    geometries: list[GeometryEntry] = []
    materials: list[Material] = []
    object: Object


def parse(content: Mapping[str, Any]) -> Document:
    """The file's parts.

    **Raises** `MeshError` if it is not a file of three.js, or breaks the format, and `RecursionError` if its objects
    are nested too deeply.
    """
    # The editor's project file stores its scene and its camera separately.
    inner, camera = content.get("scene"), content.get("camera")
    if "object" not in content and isinstance(inner, Mapping) and "object" in inner:
        content = inner
        if isinstance(camera, Mapping) and isinstance(camera.get("object"), Mapping):
            whole = {"type": "Group", "children": [inner["object"], camera["object"]]}
            content = {**inner, "object": whole}
    metadata = content.get("metadata")
    if "object" not in content:
        kind = metadata.get("type") if isinstance(metadata, Mapping) else None
        found = f"its metadata.type is {excerpt(str(kind))}" if kind else "it has neither object nor asset"
        raise MeshError(
            f"holds no scene that can be read ({found}); expected the result of three.js' scene.toJSON(), or glTF 2.0"
        )
    try:
        document = Document.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "recursion_depth_exceeded":
            raise RecursionError from error
        where = ".".join(map(str, first["loc"]))
        raise damaged(f"{excerpt(where)}: {first['msg']}") from error
    if document.metadata.version < 4:
        raise MeshError(
            f"is of three.js' format {document.metadata.version:g}, which cannot be read; save it with a newer release"
        )
    return document
