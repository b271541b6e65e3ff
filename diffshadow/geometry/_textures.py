"""Textures of base colour and alpha.

The texels of all textures of a mesh lie in one array, one row of texels after the other, and a table says where each
texture begins and how large it is. So any number of textures of any size is read by one gather, meshes are merged by
concatenation, and arrays are filled up to a few sizes.

Textures are read as by glTF's default sampler: bilinear between the four nearest texels, and repeated beyond [0, 1].
There are no mipmaps: a texture that is finer than the pixels is sampled, and not averaged.
"""

from typing import Any

import equinox as eqx
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

NO_TEXTURE = -1
"""The index of the texture of a face that has none."""
# A texture's table has rows for so many textures, at least.
_FEWEST = 4


class Textures(eqx.Module):
    """The textures of the faces of a mesh.

    - `uv`: (f, 3, 2), texture coordinates of each corner of each face: (0, 0) is the image's lower left corner, and
        (1, 1) its upper right one. The image repeats beyond.
    - `index`: (f,), which texture each face has; `NO_TEXTURE` for none.
    - `texels`: (n, 4), linear red, green, blue and alpha in [0, 1], of all textures; row 0 of each image is its bottom
        row.
    - `table`: (t, 3), of each texture its first texel, its height and its width.
    - `cutoff`: (t,), alpha below which each texture's faces are cut out; 0 for none. `None` if no face is cut out.

    Colours and `uv` are differentiable. What an alpha test cuts out is a yes or no, and so has no derivative by texels,
    `uv` or `cutoff`: the outlines that it cuts do not move in a fit.

    **Raises** `ValueError` if an array has another shape, a texel is out of its range, or an index or a place in the
    table is.

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

    def __init__(self, uv: Any, index: Any, texels: Any, table: Any, cutoff: Any = None):
        self.uv, self.index, self.texels, self.table = as_float(uv), as_int(index), as_float(texels), as_int(table)
        self.cutoff = None if cutoff is None else as_float(cutoff)
        faces, count = self.index.shape, self.table.shape[:1]
        expected = {"uv": (*faces, 3, 2), "texels": (*self.texels.shape[:1], 4), "table": (*count, 3), "cutoff": count}
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
    def of(cls, image: Any, uv: Any, cutoff: Any = None) -> "Textures":
        """One texture for all faces.

        **Arguments:**

        - `image`: (h, w, 3) or (h, w, 4), linear colours in [0, 1], with alpha or opaque; row 0 is the bottom row.
        - `uv`: (f, 3, 2), texture coordinates of the corners of faces.
        - `cutoff`: alpha below which faces are cut out, as by `discard` in a shader; none for no alpha test.

        **Raises** `ValueError` for another shape, or values out of range.
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
        return cls(uv, index, texels.reshape(-1, 4), table, None if cutoff is None else as_float(cutoff)[None])

    def images(self) -> list[Float[HostArray, "h w 4"]]:
        """Each texture's texels, (h, w, 4), row 0 the bottom row; the values must be known."""
        texels = np.asarray(self.texels)
        table = np.asarray(self.table).tolist()
        return [texels[first : first + rows * columns].reshape(rows, columns, 4) for first, rows, columns in table]

    def at(self, index: Int[Array, "*n"], uv: Float[Array, "*n 2"]) -> Float[Array, "*n 4"]:
        """The colours of textures at texture coordinates; 1 where there is no texture."""
        colours = bilinear(self.texels, self.table, index, uv)
        return jnp.where((index >= 0)[..., None], colours, 1)

    def for_faces(self, faces: Any) -> "Textures":
        """The textures of a mesh that has these `faces` (g,) of the mesh."""
        xp = array_module(self.uv, self.index)
        kept = as_float(xp.asarray(self.uv)[faces]), as_int(xp.asarray(self.index)[faces])
        return eqx.tree_at(lambda one: (one.uv, one.index), self, kept)

    def turned(self) -> "Textures":
        """The textures of faces whose corners go the other way round."""
        return eqx.tree_at(lambda one: one.uv, self, self.uv[:, ::-1])

    def followed_by(self, other: "Textures") -> "Textures":
        """These textures with the faces of `other` added behind their own. Both have the same texels."""
        xp = array_module(self.uv, other.uv, self.index)
        pairs = (self.uv, other.uv), (self.index, other.index)
        joined = [as_array(xp.concatenate(pair)) for pair in pairs]
        return eqx.tree_at(lambda one: (one.uv, one.index), self, joined)

    @property
    def _padded_size(self) -> tuple[int, int]:
        """The numbers of texels and of textures after padding."""
        texels, table = self.texels.shape[0], self.table.shape[0]
        return shared_size(texels), max(round_up_to_power_of_two(table), _FEWEST)

    @property
    def is_padded(self) -> bool:
        """Whether the texels and the table have one of few sizes."""
        return (self.texels.shape[0], self.table.shape[0]) == self._padded_size

    def padded(self, faces: int) -> "Textures":
        """With further faces, texels and textures, none of them seen, so that arrays have one of few sizes."""
        size, count = self._padded_size
        more = [
            padded_to(self.uv, faces),
            padded_to(self.index, faces, NO_TEXTURE),
            padded_to(self.texels, size),
            padded_to(self.table, count, np.array([0, 1, 1])),
            None if self.cutoff is None else padded_to(self.cutoff, count),
        ]
        return self._with(*more)

    def _with(self, *arrays: Any) -> "Textures":
        """With these arrays as fields, in their order, without the checks of textures from outside."""
        fields = lambda one: [one.uv, one.index, one.texels, one.table, one.cutoff]
        return eqx.tree_at(fields, self, list(arrays), is_leaf=lambda leaf: leaf is None)


def linear_colours(encoded: Float[HostArray, "*n c"]) -> Float[HostArray, "*n c"]:
    """Colours in [0, 1] that are stored as sRGB (IEC 61966-2-1), linear; a fourth channel, alpha, stays as it is."""
    colours = encoded[..., :3]
    linear = from_srgb(colours)
    return np.concatenate([linear, encoded[..., 3:]], axis=-1)


def scaled_cutoff(cutoff: float, factor: float) -> float:
    """The cutoff of texels whose alpha is multiplied by `factor` before it is compared with `cutoff`."""
    return cutoff / factor if factor > 0 else (0.0 if cutoff <= 0 else 2.0)


def bilinear(
    texels: Float[Array, "n c"], table: Int[Array, "t 3"], index: Int[Array, "*m"], uv: Float[Array, "*m 2"]
) -> Float[Array, "*m c"]:
    """The textures `index` at `uv`; where there is none, what the first has there."""
    first, height, width = (take(table[:, k], jnp.maximum(index, 0)) for k in range(3))
    (left, right, across), (below, above, up) = (
        _neighbours(uv[..., axis], size) for axis, size in enumerate((width, height))
    )
    across, up = across[..., None], up[..., None]
    read = lambda row, column: take(texels, first + row * width + column)
    lower = read(below, left) * (1 - across) + read(below, right) * across
    upper = read(above, left) * (1 - across) + read(above, right) * across
    return lower * (1 - up) + upper * up


def _neighbours(coordinate: Array, size: Array) -> tuple[Array, Array, Array]:
    """The two texels beside a texture coordinate, and how far it lies from the first to the second."""
    # Within one repetition before it is scaled, which keeps the digits.
    place = (coordinate - jnp.floor(coordinate)) * size - 0.5
    first = jnp.floor(place)
    index = first.astype(jnp.int32)
    following = index + 1
    return jnp.where(index < 0, size - 1, index), jnp.where(following >= size, 0, following), place - first


def merged(textures: list["Textures | None"], counts: list[int]) -> Textures | None:
    """The textures of meshes, merged, given how many faces each mesh has; none if no mesh has any."""
    given = [each for each in textures if each is not None]
    if not given:
        return None
    arrays = [leaf for each in given for leaf in (each.uv, each.index, each.texels, each.table, each.cutoff)]
    xp = array_module(*(leaf for leaf in arrays if leaf is not None))
    is_tested = any(each.cutoff is not None for each in given)
    uv, index, texels, table, cutoff = [], [], [], [], []
    number = texel = 0
    # Meshes that share an array of texels share it here, too.
    starts: dict[int, int] = {}
    for each, count in zip(textures, counts, strict=True):
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
        cutoff.append(xp.zeros(each.table.shape[0], each.texels.dtype) if each.cutoff is None else each.cutoff)
        number += each.table.shape[0]
    joined = [xp.concatenate(parts) for parts in (uv, index, texels, table)]
    joined.append(xp.concatenate(cutoff) if is_tested else None)
    # Each was checked before.
    return given[0]._with(*(None if array is None else as_array(array) for array in joined))
