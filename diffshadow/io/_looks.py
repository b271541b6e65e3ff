"""Colours and textures of mesh files, and the images of textures."""

import functools
import io
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int, UInt8
from PIL import Image

from .._arithmetic import as_float
from .._srgb import to_srgb
from .._types import HostArray
from ..geometry import NO_TEXTURE, Textures, linear_colours
from ..settings.scene import MAX_TEXTURE
from ._errors import MeshError

# Formats of textures: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 3.8, and common others.
_FORMATS = ("PNG", "JPEG", "WEBP", "TGA", "BMP", "TIFF")


class Picture:
    """The image of a texture: `levels` (h, w, 4), sRGB colours and alpha, bytes; row 0 is the bottom row."""

    def __init__(self, levels: UInt8[HostArray, "h w 4"]):
        self.levels = levels

    @functools.cached_property
    def texels(self) -> Float[Array, "n 4"]:
        """Linear, in single precision: one array for all meshes that share the image."""
        with jax.enable_x64(False):
            return as_float(linear_colours(self.levels.reshape(-1, 4) / np.float32(255)))


class Texture(NamedTuple):
    """The texture of base colour of a material.

    - `cutoff`: alpha below which it cuts out faces; none without an alpha test.
    """

    picture: Picture
    cutoff: float | None = None


class Looks(NamedTuple):
    """How the polygons of a file look.

    - `colours`: (v, 3), linear colours of the vertices; none if the file has none.
    - `uv`: (v, 2), texture coordinates of the vertices, (0, 0) at an image's lower left corner; none likewise.
    - `factor`: (f, 3), the diffuse colour of each polygon.
    - `texture`: (f,), the number of each polygon's texture in `textures`, -1 for none.
    """

    colours: Float[HostArray, "v 3"] | None = None
    uv: Float[HostArray, "v 2"] | None = None
    factor: Float[HostArray, "f 3"] | None = None
    texture: Int[HostArray, " f"] | None = None
    textures: Sequence[Texture] = ()


class MeshLooks(NamedTuple):
    """The last arguments of a `Mesh`."""

    albedo: HostArray | None
    corner_colours: Float[HostArray, "t 3 3"] | None
    textures: Textures | None


def looks_of_triangles(
    looks: Looks,
    triangles: Int[HostArray, "t 3"],
    polygon: Int[HostArray, " t"],
    texture: Texture | None,
    cutoff: float | None,
) -> MeshLooks:
    """How triangles of a file's vertices look, each a part of a `polygon`; `texture` and `cutoff`, if given, take the
    place of the file's own.

    **Raises** `MeshError` if a texture is given and there are no texture coordinates.
    """
    factor = None if looks.factor is None else looks.factor[polygon]
    colours = None if looks.colours is None else np.clip(looks.colours, 0, 1)[triangles]
    if texture is not None:
        if looks.uv is None:
            raise MeshError("has no texture coordinates, and a texture was given; expected some: export it with its UV")
        textures: Sequence[Texture] = (texture,)
        index = np.zeros(len(triangles), np.int32)
    else:
        textures = looks.textures
        index = np.full(len(triangles), NO_TEXTURE) if looks.texture is None else looks.texture[polygon]
    if looks.uv is None or not len(textures) or not (index >= 0).any():
        return MeshLooks(factor, colours, None)
    uv = looks.uv[triangles]
    if not np.isfinite(uv).all():
        raise MeshError("has texture coordinates that are NaN or infinite; export it again")
    if cutoff is not None:
        textures = [one._replace(cutoff=cutoff) for one in textures]
    return MeshLooks(factor, colours, _flattened(textures, uv, index))


def _flattened(textures: Sequence[Texture], uv: Float[HostArray, "t 3 2"], index: Int[HostArray, " t"]) -> Textures:
    used, index = np.unique(index, return_inverse=True)
    some = used[used >= 0]
    index = index - (len(used) - len(some))
    sizes = np.array([textures[number].picture.levels.shape[:2] for number in some])
    first = np.cumsum([0, *sizes.prod(axis=1)])[:-1]
    texels = [textures[number].picture.texels for number in some]
    cutoffs = [textures[number].cutoff for number in some]
    cutoff = None if not any(cutoffs) else np.array([one or 0.0 for one in cutoffs])
    table = np.concatenate([first[:, None], sizes], axis=1)
    # In single precision even where a mesh's vertices are not.
    with jax.enable_x64(False):
        return Textures(
            uv, np.maximum(index, NO_TEXTURE), texels[0] if len(texels) == 1 else np.concatenate(texels), table, cutoff
        )


def read_texture(data: bytes, what: str) -> Picture:
    """Reads an image file.

    **Raises** `MeshError` if it is damaged, of an unknown format or too large; `what` names it there.
    """
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=_FORMATS) as image:
            size = max(image.size)
            if size <= MAX_TEXTURE:
                return Picture(np.asarray(image.convert("RGBA"))[::-1])
    except Exception as error:  # Pillow's readers raise many types
        raise MeshError(
            f"has a texture, {what}, that cannot be read ({' '.join(str(error).split())}); expected a PNG, JPEG or "
            "WebP image: convert it"
        ) from error
    raise MeshError(f"has a texture, {what}, of {size} texels a side; expected at most {MAX_TEXTURE}: scale it down")


def png_of(levels: UInt8[HostArray, "h w 4"]) -> bytes:
    """A PNG file of the levels of a `Picture`."""
    written = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(levels[::-1])).save(written, "PNG")
    return written.getvalue()


def levels_of(image: Float[HostArray, "h w 4"]) -> UInt8[HostArray, "h w 4"]:
    """The levels of linear texels in [0, 1], whose colours are stored as sRGB."""
    colours = image[..., :3]
    encoded = to_srgb(colours)
    return np.rint(255 * np.concatenate([encoded, image[..., 3:]], axis=-1)).astype(np.uint8)
