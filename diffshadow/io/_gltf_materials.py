"""Base colours, their textures and alpha tests of a glTF file's materials.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.8 and 3.9.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ..geometry import Sampler, scaled_cutoff
from ..settings.scene import TexelFilter, Wrap
from ._errors import MeshError
from ._gltf_data import Buffers, NoDataError, entry_of
from ._gltf_schema import (
    TEXTURE_TRANSFORM,
    TEXTURE_WEBP,
    Document,
    Image,
    Material,
    Primitive,
    TextureInfo,
    TextureTransform,
)
from ._gltf_schema import Sampler as SamplerEntry
from ._gltf_schema import Texture as TextureEntry
from ._looks import Picture, Texture, read_texture

# The description of a texture that is left out.
_UNREAD = "texture that cannot be read"
WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
FILTERS: dict[int, TexelFilter] = {9728: "nearest", 9729: "linear"}
"""OpenGL's constants in the samplers of glTF."""
# The maximum of each integer type that colours may have.
_GREATEST = {5121: 255, 5123: 65535}


class BaseColour(NamedTuple):
    """The look of a primitive.

    - `factor`: (3,), linear; `None` without a material.
    - `texture`: with its alpha test, or `None`; `uv`: (v, 2), texture coordinates of its vertices, or `None`.
    - `colours`: (v, 3), linear colours of its vertices, and `alpha`: (v,), their alpha; or `None`.
    - `is_cut_out`: whether the alpha test removes all of it.
    """

    factor: Float[HostArray, "3"] | None = None
    texture: Texture | None = None
    uv: Float[HostArray, "v 2"] | None = None
    colours: Float[HostArray, "v 3"] | None = None
    alpha: Float[HostArray, " v"] | None = None
    is_cut_out: bool = False

    def of_vertices(self, index: Int[HostArray, " n"]) -> "BaseColour":
        """The look of a selection (n,) of the primitive's vertices."""
        rows = lambda values: None if values is None else values[index]
        return self._replace(uv=rows(self.uv), colours=rows(self.colours), alpha=rows(self.alpha))

    def repeated(self, count: int) -> "BaseColour":
        """The look of the vertices of several instances."""
        some = (values for values in (self.uv, self.colours, self.alpha) if values is not None)
        index = np.tile(np.arange(len(next(some, ()))), count)
        return self.of_vertices(index)


class Materials:
    """Reads a file's materials. An image is read once, on first use."""

    def __init__(self, document: Document, buffers: Buffers, left_out: Counter[str]):
        self._document, self._buffers, self._left_out = document, buffers, left_out
        self._pictures: dict[int, Picture | None] = {}

    def base_colour(self, primitive: Primitive, count: int) -> BaseColour:
        """The base colour of a primitive with `count` vertices. Unreadable parts are left out."""
        colours, alpha = self._colours(primitive, count)
        number = primitive.material
        material = None if number is None else entry_of(Material, self._document.materials, number)
        if material is None:
            return BaseColour(colours=colours, alpha=alpha)
        look = material.pbr_metallic_roughness
        *factor, opacity = np.clip(look.base_color_factor, 0, 1).tolist()
        is_tested = material.alpha_mode == "MASK"
        cutoff = scaled_cutoff(material.alpha_cutoff, opacity) if is_tested else None
        info, picture, uv = look.base_color_texture, None, None
        if info is not None:
            picture, uv = self._picture(info.index), self._coordinates(primitive, info, count)
        texture = None
        if info is not None and picture is not None and uv is not None:
            texture = Texture(picture, cutoff, self._sampler(info.index))
        elif is_tested and alpha is not None:
            texture = Texture(None, cutoff)
        is_cut_out = is_tested and opacity < material.alpha_cutoff
        return BaseColour(np.array(factor), texture, uv, colours, alpha, is_cut_out)

    def _colours(
        self, primitive: Primitive, count: int
    ) -> tuple[Float[HostArray, "v 3"] | None, Float[HostArray, " v"] | None]:
        """The colours of the vertices, and their alpha. Each is `None` if the primitive has none."""
        values = self._values(primitive, "COLOR_0", ("VEC3", "VEC4"), count)
        if values is None:
            return None, None
        accessor = self._document.accessors[primitive.attributes["COLOR_0"]]
        # Integers are fractions of the maximum, whether the file says so or not.
        if not accessor.normalized:
            values = values / _GREATEST.get(accessor.component_type, 1)
        values = np.clip(values, 0, 1)
        return values[:, :3], values[:, 3] if values.shape[1] == 4 else None

    def _sampler(self, number: int) -> Sampler:
        """How a texture is read. The default is used if the file's sampler breaks the specification."""
        texture = entry_of(TextureEntry, self._document.textures, number)
        if texture is None or texture.sampler is None:
            return Sampler()
        entry = entry_of(SamplerEntry, self._document.samplers, texture.sampler)
        if entry is None:
            self._left_out["sampler of a texture that cannot be read"] += 1
            return Sampler()
        return Sampler((WRAPS[entry.wrap_s], WRAPS[entry.wrap_t]), FILTERS[entry.mag_filter])

    def _coordinates(self, primitive: Primitive, info: TextureInfo, count: int) -> Float[HostArray, "v 2"] | None:
        """Texture coordinates, with (0, 0) at an image's lower left corner instead of its upper left corner."""
        stored = info.extensions.get(TEXTURE_TRANSFORM)
        moved = None if stored is None else entry_of(TextureTransform, [stored], 0)
        number = info.tex_coord if moved is None or moved.tex_coord is None else moved.tex_coord
        uv = self._values(primitive, f"TEXCOORD_{number}", ("VEC2",), count)
        if uv is None:
            return None
        if moved is not None:
            cosine, sine = math.cos(moved.rotation), math.sin(moved.rotation)
            # Anticlockwise where v points down, as in viewers.
            uv = uv * moved.scale @ np.array([[cosine, -sine], [sine, cosine]]) + moved.offset
        return uv * (1, -1) + (0, 1)

    def _values(
        self, primitive: Primitive, name: str, forms: Sequence[Any], count: int
    ) -> Float[HostArray, "v width"] | None:
        """An attribute of the vertices, or `None` if it is missing or unreadable."""
        index = primitive.attributes.get(name)
        if index is None:
            return None
        try:
            form = self._buffers.form(index)
            rows = np.zeros((0, 1))
            if form is not None and form in forms:
                rows = self._buffers.values(index, form).astype(np.float64)
        except (MeshError, NoDataError):
            rows = np.zeros((0, 1))
        if len(rows) == count and np.isfinite(rows).all():
            return rows
        self._left_out[f"attribute {name} that cannot be read"] += 1
        return None

    def _picture(self, number: int) -> Picture | None:
        if number not in self._pictures:
            try:
                self._pictures[number] = self._read(number)
            except (MeshError, NoDataError):
                self._pictures[number] = None
                self._left_out[_UNREAD] += 1
        return self._pictures[number]

    def _read(self, number: int) -> Picture:
        texture = entry_of(TextureEntry, self._document.textures, number)
        webp = None if texture is None else texture.extensions.get(TEXTURE_WEBP)
        source = webp.get("source") if isinstance(webp, dict) else None
        if not isinstance(source, int):
            source = None if texture is None else texture.source
        image = None if source is None else entry_of(Image, self._document.images, source)
        if image is None:
            raise MeshError(f"has a texture {number} without an image")
        if image.buffer_view is not None:
            return read_texture(bytes(self._buffers.view(image.buffer_view)), f"image {source}")
        return read_texture(self._buffers.file(image.uri or ""), f"image {source}")
