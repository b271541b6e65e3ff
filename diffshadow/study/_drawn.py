"""A drawn scene. Runs pass it to pages and remarks."""

from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Bool

from .. import geometry, raster, reference, shadow
from .._types import HostArray


class Drawn(NamedTuple):
    """A scene as one of its lights and the camera see it, and its reference.

    - `key`: key of the light, such as `"scene.light"`.
    - `scene`: the scene with only that light.
    - `surface`: the surface that the camera sees; with many views, `without_looks`.
    - `stored`: the technique's state for the light, or its position in an atlas.
    - `mask`: (h, w), the pixels that count: raster and reference see a surface there, and the technique covers it.
    - `remarks`: remarks on the scene's files.
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
        """Noise floor of the reference, in visibility. `None` for a reference from a file, because its noise is
        unknown."""
        return self.reference.noise_floor if self.reference.samples else None

    @property
    def pixels(self) -> int:
        """The number of pixels that count."""
        return int(self.mask.sum())


def without_looks(surface: raster.Surface) -> raster.Surface:
    """The parts of a surface that shadow mapping reads. Pictures need the whole surface, which is then drawn again."""
    looks = lambda surface: (surface.interpolated_normal, surface.albedo, surface.from_behind)
    return eqx.tree_at(looks, surface, (None, None, None), is_leaf=lambda leaf: leaf is None)
