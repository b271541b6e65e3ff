"""The part of a glTF 2.0 file's JSON that describes its triangles.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 5. Defaults are the specification's.
"""

import json
import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from ..settings.scene import Cutout, LightKind
from ._errors import MeshError, damaged
from ._text import decode, excerpt, listed

_Index = Annotated[int, Field(ge=0)]
_Extensions = Mapping[str, Any]
DRACO = "KHR_draco_mesh_compression"
LIGHTS = "KHR_lights_punctual"
EXTRAS = "diffshadow"
"""The key of this package's values in the `extras` of a node."""
VISIBILITY = "KHR_node_visibility"
INSTANCES = "EXT_mesh_gpu_instancing"
UNLIT = "KHR_materials_unlit"
TEXTURE_TRANSFORM = "KHR_texture_transform"
TEXTURE_WEBP = "EXT_texture_webp"
TRANSMISSION = "KHR_materials_transmission"
# Supported extensions. The first allows integer positions.
_READ = ("KHR_mesh_quantization", DRACO, VISIBILITY, INSTANCES)
# Extensions that change neither the set of triangles nor their positions: looks, behaviour, descriptions, coarser
# levels of detail, and hints for drawing.
_WITHOUT_TRIANGLES = (
    *("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_animation_", "KHR_technique", "KHR_xmp", "KHR_audio"),
    *("KHR_interactivity", "KHR_node_hoverability", "KHR_node_selectability", "KHR_physics", "KHR_rigid_bodies"),
    *("EXT_texture_", "EXT_lights_", "EXT_mesh_features", "EXT_structural_metadata", "EXT_feature_metadata"),
    *("EXT_instance_features", "EXT_mesh_manifold", "EXT_mesh_primitive_edge_visibility"),
    *("MSFT_texture_", "MSFT_packing_", "MSFT_lod", "ADOBE_materials_", "NV_materials_", "OMI_", "AGI_"),
    *("FB_ngon_encoding", "CESIUM_primitive_outline", "GOOGLE_"),
)
# Compressed data may have a plain copy. The copy is read.
_COMPRESSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class _Part(BaseModel):
    # The validators are built when the first file is read, because this takes a tenth of a second.
    model_config = ConfigDict(alias_generator=to_camel, frozen=True, coerce_numbers_to_str=True, defer_build=True)


class Asset(_Part):
    version: str


class Header(_Part):
    """The file's version. It is read first, because everything else may differ between versions."""

    asset: Asset


class Buffer(_Part):
    byte_length: _Index
    uri: str | None = None


class BufferView(_Part):
    buffer: _Index
    byte_offset: _Index = 0
    byte_length: _Index
    byte_stride: Annotated[int, Field(ge=1)] | None = None
    extensions: _Extensions = {}


class SparseIndices(_Part):
    buffer_view: _Index
    byte_offset: _Index = 0
    component_type: Literal[5121, 5123, 5125]


class SparseValues(_Part):
    buffer_view: _Index
    byte_offset: _Index = 0


class Sparse(_Part):
    count: Annotated[int, Field(ge=1)]
    indices: SparseIndices
    values: SparseValues


class Accessor(_Part):
    buffer_view: _Index | None = None
    byte_offset: _Index = 0
    component_type: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    normalized: bool = False
    count: Annotated[int, Field(ge=1)]
    type: str
    sparse: Sparse | None = None


class Primitive(_Part):
    attributes: Mapping[str, _Index]
    material: _Index | None = None
    indices: _Index | None = None
    mode: Annotated[int, Field(ge=0, le=6)] = 4
    targets: list[Mapping[str, _Index]] = []
    extensions: _Extensions = {}


class Mesh(_Part):
    name: str = ""
    primitives: list[Primitive]
    weights: list[float] = []


class TextureInfo(_Part):
    index: _Index
    tex_coord: _Index = 0
    extensions: _Extensions = {}


class MetallicRoughness(_Part):
    base_color_factor: Annotated[list[float], Field(min_length=4, max_length=4)] = [1.0, 1.0, 1.0, 1.0]
    base_color_texture: TextureInfo | None = None


class TextureTransform(_Part):
    """The content of `TEXTURE_TRANSFORM`."""

    offset: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    rotation: float = 0.0
    scale: Annotated[list[float], Field(min_length=2, max_length=2)] = [1.0, 1.0]
    tex_coord: _Index | None = None


WrapCode = Literal[10497, 33071, 33648]
"""`REPEAT`, `CLAMP_TO_EDGE` and `MIRRORED_REPEAT` of OpenGL."""


class Sampler(_Part):
    """OpenGL's constants for reading a texture between texels and beyond its image."""

    mag_filter: Literal[9728, 9729] = 9729
    wrap_s: WrapCode = 10497
    wrap_t: WrapCode = 10497


class Texture(_Part):
    sampler: _Index | None = None
    source: _Index | None = None
    extensions: _Extensions = {}


class Image(_Part):
    uri: str | None = None
    buffer_view: _Index | None = None


class Material(_Part):
    name: str = ""
    double_sided: bool = False
    pbr_metallic_roughness: MetallicRoughness = MetallicRoughness()
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: Annotated[float, Field(ge=0)] = Cutout.alpha_cutoff
    emissive_factor: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    extensions: _Extensions = {}


class Perspective(_Part):
    yfov: Annotated[float, Field(gt=0)]
    znear: Annotated[float, Field(gt=0)]
    zfar: float | None = None
    aspect_ratio: float | None = None


class Orthographic(_Part):
    xmag: float
    ymag: float
    znear: float
    zfar: float


class Camera(_Part):
    type: Literal["perspective", "orthographic"]
    name: str = ""
    perspective: Perspective | None = None
    orthographic: Orthographic | None = None


class Spot(_Part):
    inner_cone_angle: float = 0.0
    outer_cone_angle: float = math.pi / 4


class Light(_Part):
    """The content of `LIGHTS`."""

    type: LightKind
    name: str = ""
    spot: Spot = Spot()


class Node(_Part):
    name: str = ""
    camera: _Index | None = None
    children: list[_Index] = []
    mesh: _Index | None = None
    skin: _Index | None = None
    weights: list[float] | None = None
    matrix: Annotated[list[float], Field(min_length=16, max_length=16)] | None = None
    rotation: Annotated[list[float], Field(min_length=4, max_length=4)] = [0.0, 0.0, 0.0, 1.0]
    scale: Annotated[list[float], Field(min_length=3, max_length=3)] = [1.0, 1.0, 1.0]
    translation: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    extensions: _Extensions = {}
    extras: Any = None


class Skin(_Part):
    inverse_bind_matrices: _Index | None = None
    joints: list[_Index] = []


class Scene(_Part):
    nodes: list[_Index] = []


class Document(_Part):
    """A whole file. Its parts refer to one another by index."""

    accessors: list[Accessor] = []
    animations: list[Any] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    # Only scenes use these. They are optional, so that faults in them do not affect meshes.
    cameras: list[Any] = []
    extensions: _Extensions = {}
    extensions_required: list[str] = []
    extensions_used: list[str] = []
    images: list[Any] = []
    materials: list[Any] = []
    meshes: list[Mesh] = []
    nodes: list[Node] = []
    samplers: list[Any] = []
    scene: _Index | None = None
    scenes: list[Scene] = []
    skins: list[Any] = []
    textures: list[Any] = []


def parse(text: bytes) -> Document:
    """Parses a file's JSON.

    **Raises** `MeshError` if this is not JSON, breaks the specification, or requires an unsupported extension.
    """
    try:
        content = json.loads(decode(text))
    except (ValueError, RecursionError) as error:
        raise damaged(f"it is not JSON ({error})") from error
    try:
        version = Header.model_validate(content).asset.version
        if version.partition(".")[0] != "2":
            raise MeshError(f"is of glTF version {excerpt(version)}, which cannot be read; convert it to glTF 2.0")
        document = Document.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise damaged(f"{listed([where])}: {first['msg']}") from error
    needed = unknown(document.extensions_required)
    if needed:
        raise MeshError(f"requires {listed(needed)}, which cannot be read; export it without")
    return document


def unknown(extensions: Iterable[str]) -> list[str]:
    """The unsupported `extensions` that may affect geometry."""
    return [name for name in extensions if not name.startswith(_WITHOUT_TRIANGLES) and name not in _READ]


def not_obeyed(document: Document) -> list[str]:
    """The extensions that the file uses but does not require, and that may change its look."""
    return [name for name in unknown(dict.fromkeys(document.extensions_used)) if name not in _COMPRESSIONS]
