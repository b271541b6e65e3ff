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
from ..geometry import NO_TEXTURE, Sampler, Textures, linear_colours, sampler_codes
from ..settings.scene import MAX_TEXTURE, TexelFilter, Wraps
from ._errors import MeshError

# Formats of textures: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 3.8, and common others.
_FORMATS = ("PNG", "JPEG", "WEBP", "TGA", "BMP", "TIFF")


class Picture:
    """The image of a texture: `levels` (h, w, 4), sRGB colours and alpha as bytes. Row 0 is the bottom row."""

    def __init__(self, levels: UInt8[HostArray, "h w 4"]):
        self.levels = levels

    @functools.cached_property
    def texels(self) -> Float[Array, "n 4"]:
        """The linear texels in single precision. All meshes with the same image share one array."""
        with jax.enable_x64(False):
            return as_float(linear_colours(self.levels.reshape(-1, 4) / np.float32(255)))


# The texture of a material without a picture, if the alpha of its vertices cuts it out.
_PLAIN = Picture(np.full((1, 1, 4), 255, np.uint8))


class Texture(NamedTuple):
    """The base-colour texture of a material.

    - `picture`: its picture; `None` if only the alpha of vertices cuts out the material.
    - `cutoff`: the alpha below which it cuts out faces; `None` without an alpha test.
    - `sampler`: how the picture is read.
    """

    picture: Picture | None
    cutoff: float | None = None
    sampler: Sampler = Sampler()

    @property
    def whole(self) -> Picture:
        """The picture, or an opaque white one."""
        return self.picture or _PLAIN


class GivenTexture(NamedTuple):
    """A user's replacements for a file's textures. `None` leaves a property as in the file."""

    picture: Picture | None = None
    cutoff: float | None = None
    wrap: Wraps | None = None
    filter: TexelFilter | None = None

    def instead_of(self, texture: Texture) -> Texture:
        """A texture of the file with the user's changes."""
        of_file = texture.sampler
        sampler = Sampler.of(self.wrap or of_file.wrap, self.filter or of_file.filter)
        return Texture(texture.picture, texture.cutoff if self.cutoff is None else self.cutoff, sampler)


class Looks(NamedTuple):
    """The look of a file's polygons.

    - `colours`: (v, 3), linear colours of the vertices; `None` if the file has none.
    - `alpha`: (v,), the vertices' alpha, which an alpha test multiplies by the textures' alpha; `None` if the file has
      none.
    - `uv`: (v, 2), texture coordinates of the vertices, with (0, 0) at an image's lower left corner; `None` if the file
      has none.
    - `factor`: (f, 3), the diffuse colour of each polygon.
    - `texture`: (f,), the index of each polygon's texture in `textures`, or -1.
    """

    colours: Float[HostArray, "v 3"] | None = None
    uv: Float[HostArray, "v 2"] | None = None
    factor: Float[HostArray, "f 3"] | None = None
    texture: Int[HostArray, " f"] | None = None
    textures: Sequence[Texture] = ()
    alpha: Float[HostArray, " v"] | None = None


class MeshLooks(NamedTuple):
    """The last arguments of a `Mesh`."""

    albedo: HostArray | None
    corner_colours: Float[HostArray, "t 3 3"] | None
    textures: Textures | None


def looks_of_triangles(
    looks: Looks, triangles: Int[HostArray, "t 3"], polygon: Int[HostArray, " t"], given: GivenTexture
) -> MeshLooks:
    """The look of triangles of a file's vertices. Each triangle is a part of a `polygon`.

    **Raises** `MeshError` if a picture is given and there are no texture coordinates.
    """
    factor = None if looks.factor is None else looks.factor[polygon]
    colours = None if looks.colours is None else np.clip(looks.colours, 0, 1)[triangles]
    if given.picture is not None:
        if looks.uv is None:
            raise MeshError(
                "has no texture coordinates, and a texture was given; expected coordinates: export it with its UV"
            )
        textures = [Texture(given.picture)]
        index = np.zeros(len(triangles), np.int32)
    else:
        textures = [*looks.textures]
        index = np.full(len(triangles), NO_TEXTURE) if looks.texture is None else looks.texture[polygon]
        if given.cutoff and looks.alpha is not None:
            # Faces without a texture are cut out by the alpha of vertices alone.
            index = np.where(index < 0, len(textures), index)
            textures.append(Texture(None))
    if not (index >= 0).any():
        return MeshLooks(factor, colours, None)
    uv = np.zeros((*triangles.shape, 2)) if looks.uv is None else looks.uv[triangles]
    if not np.isfinite(uv).all():
        raise MeshError("has texture coordinates that are NaN or infinite; export it again")
    textures = [given.instead_of(one) for one in textures]
    alpha = None if looks.alpha is None else np.clip(looks.alpha, 0, 1)[triangles]
    return MeshLooks(factor, colours, _flattened(textures, uv, index, alpha))


def _flattened(
    textures: Sequence[Texture],
    uv: Float[HostArray, "t 3 2"],
    index: Int[HostArray, " t"],
    alpha: Float[HostArray, "t 3"] | None,
) -> Textures:
    used, index = np.unique(index, return_inverse=True)
    some = [textures[number] for number in used[used >= 0]]
    index = index - (len(used) - len(some))
    sizes = np.array([one.whole.levels.shape[:2] for one in some])
    first = np.cumsum([0, *sizes.prod(axis=1)])[:-1]
    texels = [one.whole.texels for one in some]
    is_tested = any(one.cutoff for one in some)
    cutoff = np.array([one.cutoff or 0.0 for one in some]) if is_tested else None
    table = np.concatenate([first[:, None], sizes], axis=1)
    # Single precision, even if a mesh's vertices have double precision.
    with jax.enable_x64(False):
        return Textures(
            uv,
            np.maximum(index, NO_TEXTURE),
            texels[0] if len(texels) == 1 else np.concatenate(texels),
            table,
            cutoff,
            sampler_codes([one.sampler for one in some]),
            alpha if is_tested else None,
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
    except Exception as error:  # Pillow's readers raise many types.
        raise MeshError(
            f"has a texture, {what}, that cannot be read ({' '.join(str(error).split())}); expected a PNG, JPEG or "
            "WebP image: convert it"
        ) from error
    raise MeshError(f"has a texture, {what}, of {size} texels per side; expected at most {MAX_TEXTURE}: scale it down")


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
