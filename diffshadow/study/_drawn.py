"""A scene as it was drawn, which runs pass on to pages and remarks."""

from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Bool

from .. import geometry, raster, reference, shadow
from .._types import HostArray


class Drawn(NamedTuple):
    """A scene as one of its lights and the camera see it, and its reference.

    - `key`: key of the light, such as `"scene.light"`.
    - `scene`: the scene with only that light.
    - `surface`: what the camera sees; of many views, `without_looks`.
    - `stored`: the technique's state for the light, or where an atlas has it.
    - `mask`: (h, w), the pixels that count: where raster and reference see a surface, and the technique covers it.
    - `remarks`: on the scene's files.
    """

    key: str
    scene: geometry.Scene
    stored: Any
    surface: raster.Surface
    reference: reference.Reference
    mask: Bool[HostArray, "h w"]
    remarks: tuple[str, ...] = ()

    @property
    def state(self) -> Any:
        """The technique's state for the light."""
        return self.stored.whole() if isinstance(self.stored, shadow.StoredMap) else self.stored

    @property
    def noise_floor(self) -> float | None:
        """Noise floor of the reference, in visibility; `None` for a reference from a file, since its noise is
        unknown."""
        return self.reference.noise_floor if self.reference.samples else None

    @property
    def pixels(self) -> int:
        """How many pixels count."""
        return int(self.mask.sum())


def without_looks(surface: raster.Surface) -> raster.Surface:
    """What shadow mapping reads of a surface. Pictures need the whole one, which is then drawn again."""
    looks = lambda surface: (surface.interpolated_normal, surface.albedo, surface.from_behind)
    return eqx.tree_at(looks, surface, (None, None, None), is_leaf=lambda leaf: leaf is None)
