"""Base colours, their textures and alpha tests of a glTF file's materials.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.8 and 3.9.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from pydantic import BaseModel, ValidationError

from .._types import HostArray
from ..geometry import scaled_cutoff
from ._errors import MeshError
from ._gltf_data import Buffers, NoDataError
from ._gltf_schema import (
    TEXTURE_TRANSFORM,
    TEXTURE_WEBP,
    Document,
    Image,
    Material,
    Primitive,
    Texture,
    TextureInfo,
    TextureTransform,
)
from ._looks import Picture, read_texture

# Of a texture that is left out.
_UNREAD = "texture that cannot be read"


class BaseColour(NamedTuple):
    """What a primitive looks like.

    - `factor`: (3,), linear; none without a material.
    - `picture`: of its texture, or none; `uv`: (v, 2), texture coordinates of its vertices.
    - `colours`: (v, 3), linear colours of its vertices, or none.
    - `cutoff`: of its alpha test, or none.
    - `is_cut_out`: whether the alpha test leaves nothing of it.
    """

    factor: Float[HostArray, "3"] | None
    picture: Picture | None
    uv: Float[HostArray, "v 2"] | None
    colours: Float[HostArray, "v 3"] | None
    cutoff: float | None
    is_cut_out: bool

    def of_vertices(self, index: Int[HostArray, " n"]) -> "BaseColour":
        """For vertices that are these of the primitive's, (n,)."""
        rows = lambda values: None if values is None else values[index]
        return self._replace(uv=rows(self.uv), colours=rows(self.colours))

    def repeated(self, count: int) -> "BaseColour":
        """For the vertices of so many instances."""
        rows = lambda values: None if values is None else np.tile(values, (count, 1))
        return self._replace(uv=rows(self.uv), colours=rows(self.colours))


class Materials:
    """Reads a file's materials. An image is read when it is first needed, and once."""

    def __init__(self, document: Document, buffers: Buffers, left_out: Counter[str]):
        self._document, self._buffers, self._left_out = document, buffers, left_out
        self._pictures: dict[int, Picture | None] = {}

    def base_colour(self, primitive: Primitive, count: int) -> BaseColour:
        """The base colour of a primitive with `count` vertices. What cannot be read is left out."""
        colours = self._values(primitive, "COLOR_0", ("VEC3", "VEC4"), count)
        colours = None if colours is None else np.clip(colours[:, :3], 0, 1)
        number = primitive.material
        material = None if number is None else _entry(Material, self._document.materials, number)
        if material is None:
            return BaseColour(None, None, None, colours, None, False)
        look = material.pbr_metallic_roughness
        *factor, alpha = np.clip(look.base_color_factor, 0, 1).tolist()
        is_tested = material.alpha_mode == "MASK"
        info, picture, uv = look.base_color_texture, None, None
        if info is not None:
            picture, uv = self._picture(info.index), self._coordinates(primitive, info, count)
        if picture is None or uv is None:
            return BaseColour(np.array(factor), None, uv, colours, None, is_tested and alpha < material.alpha_cutoff)
        cutoff = scaled_cutoff(material.alpha_cutoff, alpha) if is_tested else None
        return BaseColour(np.array(factor), picture, uv, colours, cutoff, False)

    def _coordinates(self, primitive: Primitive, info: TextureInfo, count: int) -> Float[HostArray, "v 2"] | None:
        """Texture coordinates, with (0, 0) at an image's lower left corner instead of its upper left one."""
        stored = info.extensions.get(TEXTURE_TRANSFORM)
        moved = None if stored is None else _entry(TextureTransform, [stored], 0)
        number = info.tex_coord if moved is None or moved.tex_coord is None else moved.tex_coord
        uv = self._values(primitive, f"TEXCOORD_{number}", ("VEC2",), count)
        if uv is None:
            return None
        if moved is not None:
            cosine, sine = math.cos(moved.rotation), math.sin(moved.rotation)
            # Anticlockwise where v points down, as viewers do it.
            uv = uv * moved.scale @ np.array([[cosine, -sine], [sine, cosine]]) + moved.offset
        return uv * (1, -1) + (0, 1)

    def _values(
        self, primitive: Primitive, name: str, forms: Sequence[Any], count: int
    ) -> Float[HostArray, "v width"] | None:
        """An attribute of the vertices; none if the primitive has none, or one that cannot be read."""
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
        texture = _entry(Texture, self._document.textures, number)
        webp = None if texture is None else texture.extensions.get(TEXTURE_WEBP)
        source = webp.get("source") if isinstance(webp, dict) else None
        if not isinstance(source, int):
            source = None if texture is None else texture.source
        image = None if source is None else _entry(Image, self._document.images, source)
        if image is None:
            raise MeshError(f"has a texture {number} without an image")
        if image.buffer_view is not None:
            return read_texture(bytes(self._buffers.view(image.buffer_view)), f"image {source}")
        return read_texture(self._buffers.file(image.uri or ""), f"image {source}")


def _entry[T: BaseModel](model: type[T], entries: Sequence[Any], number: int) -> T | None:
    """An entry of the file; none if there is no such entry, or it breaks the specification."""
    try:
        return model.model_validate(entries[number]) if 0 <= number < len(entries) else None
    except ValidationError:
        return None
