"""Textures of base colour and alpha.

The texels of all textures of a mesh are in one array, row by row. A table has the start and the size of each texture.
Any number of textures of any size is therefore read by one gather, meshes are merged by concatenation, and arrays are
padded to a few sizes.

By default, textures are read as by glTF's default sampler: bilinear between the four nearest texels, and repeated
beyond [0, 1]. There are no mipmaps: a texture that is finer than the pixels is sampled without averaging.
"""

import dataclasses
from typing import Any, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arithmetic import array_module, as_array, as_float, as_int, concrete, take
from .._checks import listed
from .._padding import padded_to, round_up_to_power_of_two, shared_size
from .._srgb import from_srgb
from .._types import HostArray
from ..settings import Setting
from ..settings.quantities import Fraction
from ..settings.scene import TexelFilter, Wrap, Wraps

NO_TEXTURE = -1
"""The index of the texture of a face that has none."""
_WRAPS: tuple[Wrap, ...] = get_args(Wrap)
_FILTERS: tuple[TexelFilter, ...] = get_args(TexelFilter)
_REPEAT, _CLAMP, _MIRROR = range(len(_WRAPS))
_NEAREST = _FILTERS.index("nearest")
# The minimum number of rows of a texture's table.
_FEWEST = 4


class Sampler(NamedTuple):
    """How a texture is read.

    - `wrap`: the wrapping beyond [0, 1] along u and along v: `"repeat"`, `"clamp"` or `"mirror"`.
    - `filter`: the filter between the centres of texels: `"linear"` or `"nearest"`.
    """

    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    filter: TexelFilter = "linear"

    @classmethod
    def of(cls, wrap: Wraps, filter: TexelFilter) -> "Sampler":
        """A sampler with one `wrap` for both axes, or one for each. **Raises** `ValueError` for an unknown word."""
        words = (wrap, wrap) if isinstance(wrap, str) else tuple(wrap)
        if len(words) != 2 or not all(word in _WRAPS for word in words):
            raise ValueError(f"the texture's wrap is {wrap!r}; expected {' or '.join(_WRAPS)}, or a pair of these")
        if filter not in _FILTERS:
            raise ValueError(f"the texture's filter is {filter!r}; expected {' or '.join(_FILTERS)}")
        return cls((words[0], words[1]), filter)

    @classmethod
    def of_codes(cls, codes: Any) -> "Sampler":
        """The sampler of a row of `Textures.samplers`."""
        u, v, filter = np.asarray(codes).tolist()
        return cls((_WRAPS[u], _WRAPS[v]), _FILTERS[filter])

    @property
    def codes(self) -> tuple[int, int, int]:
        """A row of `Textures.samplers`."""
        u, v = map(_WRAPS.index, self.wrap)
        return u, v, _FILTERS.index(self.filter)


def sampler_codes(samplers: list[Sampler]) -> Int[HostArray, "t 3"] | None:
    """`Textures.samplers` for textures with these samplers; `None` if all samplers are the default."""
    return None if all(one == Sampler() for one in samplers) else np.array([one.codes for one in samplers], np.int32)


class Textures(eqx.Module):
    """The textures of the faces of a mesh.

    - `uv`: (f, 3, 2), texture coordinates of each corner of each face: (0, 0) is the image's lower left corner, and (1,
        1) the upper right corner.
    - `index`: (f,), the index of each face's texture, or `NO_TEXTURE`.
    - `texels`: (n, 4), linear red, green, blue and alpha in [0, 1], of all textures; row 0 of each image is its bottom
        row.
    - `table`: (t, 3), the first texel, the height and the width of each texture.
    - `cutoff`: (t,), alpha below which each texture's faces are cut out; 0 for none. `None` if no face is cut out.
    - `samplers`: (t, 3), the sampler of each texture: the wrapping along u and along v (0 repeat, 1 clamp, 2 mirror),
        and the filter between texels (0 bilinear, 1 nearest). `None` if all are zero.
    - `corner_alpha`: (f, 3), alpha in [0, 1] of each corner of each face. The interpolated alpha of the corners is
        multiplied by the texture's alpha, and the product is compared with `cutoff`. `None` if all are 1.

    Colours and `uv` are differentiable. An alpha test is binary, so it has no derivative with respect to texels, `uv`
    or `cutoff`. Its outlines do not move in a fit.

    **Raises** `ValueError` if an array has another shape, or if a texel, an index or a row of the table is out of
    range.

    !!! Example

        ```python
        checks = np.indices((8, 8)).sum(axis=0)[..., None] % 2 * np.ones(3)
        uv = np.array([[(0, 0), (1, 0), (1, 1)]])
        geometry.Textures.of(checks, uv).texels.shape  # (64, 4)
        ```
    """

    uv: Float[Array, "f 3 2"]
    index: Int[Array, " f"]
    texels: Float[Array, "n 4"]
    table: Int[Array, "t 3"]
    cutoff: Float[Array, " t"] | None = None
    samplers: Int[Array, "t 3"] | None = None
    corner_alpha: Float[Array, "f 3"] | None = None

    def __init__(
        self,
        uv: Any,
        index: Any,
        texels: Any,
        table: Any,
        cutoff: Any = None,
        samplers: Any = None,
        corner_alpha: Any = None,
    ):
        self.uv, self.index, self.texels, self.table = as_float(uv), as_int(index), as_float(texels), as_int(table)
        self.cutoff = None if cutoff is None else as_float(cutoff)
        self.samplers = None if samplers is None else as_int(samplers)
        self.corner_alpha = None if corner_alpha is None else as_float(corner_alpha)
        faces, count = self.index.shape, self.table.shape[:1]
        expected = {"uv": (*faces, 3, 2), "texels": (*self.texels.shape[:1], 4), "table": (*count, 3), "cutoff": count}
        expected |= {"samplers": (*count, 3), "corner_alpha": (*faces, 3)}
        for name, shape in expected.items():
            found = getattr(self, name)
            if found is not None and found.shape != shape:
                raise ValueError(f"the textures' {name} have shape {found.shape}; expected {shape}")

    def __check_init__(self):
        index, table, texels, uv = map(concrete, (self.index, self.table, self.texels, self.uv))
        limits = Setting.of(Fraction).limits
        if texels is not None and not ((texels >= limits.low) & (texels <= limits.high)).all():
            bad = texels[~((texels >= limits.low) & (texels <= limits.high)).all(axis=1)][0]
            raise ValueError(f"a texel is {listed(bad)}; expected red, green, blue and alpha, numbers {limits.words}")
        alpha = None if self.corner_alpha is None else concrete(self.corner_alpha)
        if alpha is not None and not ((alpha >= limits.low) & (alpha <= limits.high)).all():
            raise ValueError(
                f"the corners' alpha is from {alpha.min():g} to {alpha.max():g}; expected numbers {limits.words}"
            )
        samplers = None if self.samplers is None else concrete(self.samplers)
        most = len(_WRAPS) - 1, len(_WRAPS) - 1, len(_FILTERS) - 1
        if samplers is not None and ((samplers < 0) | (samplers > np.array(most))).any():
            raise ValueError(f"the textures' samplers are {samplers.tolist()}; expected rows from (0, 0, 0) to {most}")
        if uv is not None and not np.isfinite(uv).all():
            raise ValueError("texture coordinates are NaN or infinite; expected finite ones: repair the mesh's uv")
        if table is None or index is None:
            return
        first, height, width = table.T
        if len(table) == 0 or (table < (0, 1, 1)).any() or (first + height * width > self.texels.shape[0]).any():
            raise ValueError(
                f"the textures' table is {table.tolist()}; expected the first texel, height and width of at least one "
                f"texture within the {self.texels.shape[0]} texels"
            )
        if index.size and (index.min() < NO_TEXTURE or index.max() >= len(table)):
            raise ValueError(
                f"the faces' textures are {index.min()} to {index.max()}; expected {NO_TEXTURE} for none, or up to "
                f"{len(table) - 1}"
            )

    @classmethod
    def of(
        cls,
        image: Any,
        uv: Any,
        cutoff: Any = None,
        *,
        wrap: Wraps = "repeat",
        filter: TexelFilter = "linear",
        corner_alpha: Any = None,
    ) -> "Textures":
        """One texture for all faces.

        **Arguments:**

        - `image`: (h, w, 3) or (h, w, 4), linear colours in [0, 1], with alpha or opaque; row 0 is the bottom row.
        - `uv`: (f, 3, 2), texture coordinates of the corners of faces.
        - `cutoff`: alpha below which faces are cut out, like `discard` in a shader; `None` for no alpha test.
        - `wrap`: the wrapping beyond [0, 1]: `"repeat"`, `"clamp"` or `"mirror"`, or a pair of these, along u and along
            v.
        - `filter`: the filter between the centres of texels: `"linear"` or `"nearest"`.
        - `corner_alpha`: (f, 3), alpha of the corners of faces, which the alpha test multiplies by the image's alpha.

        **Raises** `ValueError` for another shape, values out of range, or an unknown word.
        """
        xp = array_module(image)
        texels = xp.asarray(image)
        if texels.ndim != 3 or texels.shape[-1] not in (3, 4) or texels.size == 0:
            raise ValueError(f"the texture's image has shape {texels.shape}; expected (h, w, 3) or (h, w, 4)")
        if texels.shape[-1] == 3:
            texels = xp.concatenate([texels, xp.ones((*texels.shape[:2], 1), texels.dtype)], axis=-1)
        height, width = texels.shape[:2]
        table = np.array([[0, height, width]])
        index = np.zeros(np.shape(uv)[:1], np.int32)
        cutoff = None if cutoff is None else as_float(cutoff)[None]
        samplers = sampler_codes([Sampler.of(wrap, filter)])
        return cls(uv, index, texels.reshape(-1, 4), table, cutoff, samplers, corner_alpha)

    def images(self) -> list[Float[HostArray, "h w 4"]]:
        """Each texture's texels, (h, w, 4), with row 0 at the bottom. The values must be known."""
        texels = np.asarray(self.texels)
        table = np.asarray(self.table).tolist()
        return [texels[first : first + rows * columns].reshape(rows, columns, 4) for first, rows, columns in table]

    def each_sampler(self) -> list[Sampler]:
        """The sampler of each texture; the values must be known."""
        samplers = np.zeros((self.table.shape[0], 3), int) if self.samplers is None else self.samplers
        return [Sampler.of_codes(row) for row in np.asarray(samplers)]

    def at(self, index: Int[Array, "*n"], uv: Float[Array, "*n 2"]) -> Float[Array, "*n 4"]:
        """The colours of textures at texture coordinates; 1 without a texture."""
        colours = read_texels(self.texels, self.table, self.samplers, index, uv)
        return jnp.where((index >= 0)[..., None], colours, 1)

    def for_faces(self, faces: Any) -> "Textures":
        """The textures of the mesh with only the faces `faces` (g,)."""
        xp = array_module(self.uv, self.index)
        return self._of_faces(*(None if each is None else as_array(xp.asarray(each)[faces]) for each in self._by_face))

    def turned(self, where: Any = True) -> "Textures":
        """The textures of faces with reversed corners, if `where` is true."""
        turn = lambda corners: None if corners is None else jnp.where(where, corners[:, ::-1], corners)
        return self._of_faces(turn(self.uv), self.index, turn(self.corner_alpha))

    def followed_by(self, other: "Textures") -> "Textures":
        """These textures, followed by the textures and faces of `other`. Both have the same texels."""
        xp = array_module(self.uv, other.uv, self.index)
        pairs = zip(self._by_face, other._by_face, strict=True)
        return self._of_faces(*(None if pair[0] is None else as_array(xp.concatenate(pair)) for pair in pairs))

    @property
    def whole_repetitions(self) -> Float[Array, "f 1 2"]:
        """A shift of each face's `uv` towards 0 by whole repetitions, so that `uv` keep their precision."""
        xp = array_module(self.uv, self.index)
        corner = self.uv[:, :1]
        if self.samplers is None:
            return xp.floor(corner)
        wrap = xp.asarray(self.samplers)[:, None, :2][xp.maximum(xp.asarray(self.index), 0)]
        # Every second repetition is a mirror image, and a border continues forever.
        length = xp.where(wrap == _MIRROR, 2, 1)
        return xp.where(wrap == _CLAMP, 0, length * xp.floor(corner / length))

    @property
    def _by_face(self) -> tuple[Array, Array, Array | None]:
        return self.uv, self.index, self.corner_alpha

    def _of_faces(self, uv: Any, index: Any, corner_alpha: Any) -> "Textures":
        return self._with(uv, index, self.texels, self.table, self.cutoff, self.samplers, corner_alpha)

    @property
    def _padded_size(self) -> tuple[int, int]:
        """The numbers of texels and of textures after padding."""
        texels, table = self.texels.shape[0], self.table.shape[0]
        return shared_size(texels), max(round_up_to_power_of_two(table), _FEWEST)

    @property
    def is_padded(self) -> bool:
        """Whether the texels and the table are padded to one of a few sizes."""
        return (self.texels.shape[0], self.table.shape[0]) == self._padded_size

    def padded(self, faces: int) -> "Textures":
        """The textures with added faces, texels and textures that are never visible, so that arrays have one of a few
        sizes."""
        size, count = self._padded_size
        more = [
            padded_to(self.uv, faces),
            padded_to(self.index, faces, NO_TEXTURE),
            padded_to(self.texels, size),
            padded_to(self.table, count, np.array([0, 1, 1])),
            None if self.cutoff is None else padded_to(self.cutoff, count),
            None if self.samplers is None else padded_to(self.samplers, count),
            None if self.corner_alpha is None else padded_to(self.corner_alpha, faces),
        ]
        return self._with(*more)

    def _with(self, *arrays: Any) -> "Textures":
        """Textures with these arrays as fields, in order, without the checks for users' textures."""
        fields = lambda one: [getattr(one, field.name) for field in dataclasses.fields(Textures)]
        return eqx.tree_at(fields, self, list(arrays), is_leaf=lambda leaf: leaf is None)


def linear_colours(encoded: Float[HostArray, "*n c"]) -> Float[HostArray, "*n c"]:
    """Colours in [0, 1] that are stored as sRGB (IEC 61966-2-1), converted to linear. A fourth channel, alpha, does not
    change."""
    colours = encoded[..., :3]
    linear = from_srgb(colours)
    return np.concatenate([linear, encoded[..., 3:]], axis=-1)


def scaled_cutoff(cutoff: float, factor: float) -> float:
    """The cutoff for texels whose alpha is multiplied by `factor` before the comparison with `cutoff`."""
    return cutoff / factor if factor > 0 else (0.0 if cutoff <= 0 else 2.0)


def read_texels(
    texels: Float[Array, "n c"],
    table: Int[Array, "t 3"],
    samplers: Int[Array, "t 3"] | None,
    index: Int[Array, "*m"],
    uv: Float[Array, "*m 2"],
) -> Float[Array, "*m c"]:
    """The colours of the textures `index` at `uv`. Without a texture, the first texture's colour."""
    of = jnp.maximum(index, 0)
    first, height, width = (take(table[:, k], of) for k in range(3))
    codes = (None, None, None) if samplers is None else [take(samplers[:, k], of) for k in range(3)]
    (left, right, across), (below, above, up) = (
        _neighbours(uv[..., axis], size, codes[axis], codes[2]) for axis, size in enumerate((width, height))
    )
    across, up = across[..., None], up[..., None]
    read = lambda row, column: take(texels, first + row * width + column)
    lower = read(below, left) * (1 - across) + read(below, right) * across
    upper = read(above, left) * (1 - across) + read(above, right) * across
    return lower * (1 - up) + upper * up


def _neighbours(coordinate: Array, size: Array, wrap: Array | None, filter: Array | None) -> tuple[Array, Array, Array]:
    """The two texels next to a texture coordinate, and its position between the first and the second. Without `wrap`
    and `filter`, the texture repeats and is read bilinearly."""
    # Within one repetition before it is scaled, which keeps the digits.
    within = coordinate - jnp.floor(coordinate)
    before, behind = size - 1, 0
    if wrap is not None:
        in_two = coordinate - 2 * jnp.floor(coordinate / 2)
        within = jnp.where(wrap == _MIRROR, jnp.minimum(in_two, 2 - in_two), within)
        within = jnp.where(wrap == _CLAMP, jnp.clip(coordinate, 0, 1), within)
        # Beyond the border is the texel of the other end, or the border itself.
        before, behind = jnp.where(wrap == _REPEAT, before, 0), jnp.where(wrap == _REPEAT, behind, size - 1)
    place = within * size - 0.5
    first = jnp.floor(place)
    index = first.astype(jnp.int32)
    following = index + 1
    left, right = jnp.where(index < 0, before, index), jnp.where(following >= size, behind, following)
    if filter is None:
        return left, right, place - first
    nearest = jnp.minimum((within * size).astype(jnp.int32), size - 1)
    return jnp.where(filter == _NEAREST, nearest, left), right, jnp.where(filter == _NEAREST, 0, place - first)


def merged(textures: list["Textures | None"], counts: list[int]) -> Textures | None:
    """The merged textures of meshes with these numbers of faces. `None` if no mesh has textures."""
    given = [each for each in textures if each is not None]
    if not given:
        return None
    xp = array_module(*jax.tree.leaves(given))
    is_given = lambda name: any(getattr(each, name) is not None for each in given)
    has_alpha = is_given("corner_alpha")
    uv, index, texels, table, cutoff, samplers, alpha = ([] for _ in range(7))
    number = texel = 0
    # Meshes that share an array of texels also share it here.
    starts: dict[int, int] = {}
    for each, count in zip(textures, counts, strict=True):
        if has_alpha:
            own = None if each is None else each.corner_alpha
            alpha.append(xp.ones((count, 3), np.float32) if own is None else own)
        if each is None:
            uv.append(xp.zeros((count, 3, 2), given[0].uv.dtype))
            index.append(xp.full(count, NO_TEXTURE, np.int32))
            continue
        uv.append(each.uv)
        index.append(xp.where(xp.asarray(each.index) >= 0, xp.asarray(each.index) + number, np.int32(NO_TEXTURE)))
        start = starts.setdefault(id(each.texels), texel)
        if start == texel:
            texels.append(each.texels)
            texel += each.texels.shape[0]
        table.append(xp.asarray(each.table) + np.array([start, 0, 0], np.int32))
        size = each.table.shape[0]
        cutoff.append(xp.zeros(size, each.texels.dtype) if each.cutoff is None else each.cutoff)
        samplers.append(xp.zeros((size, 3), np.int32) if each.samplers is None else each.samplers)
        number += size
    joined = [xp.concatenate(parts) for parts in (uv, index, texels, table)]
    for name, parts in (("cutoff", cutoff), ("samplers", samplers), ("corner_alpha", alpha)):
        joined.append(xp.concatenate(parts) if is_given(name) else None)
    # Each mesh was checked before.
    return given[0]._with(*(None if array is None else as_array(array) for array in joined))
