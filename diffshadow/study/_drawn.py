"""A scene as it was drawn, which runs pass on to pages and remarks."""

from typing import Any, NamedTuple

from jaxtyping import Bool

from .. import geometry, raster, reference
from .._types import HostArray


class Drawn(NamedTuple):
    """A scene as one of its lights and the camera see it, and its reference.

    - `key`: key of the light, such as `"scene.light"`.
    - `scene`: the scene with only that light.
    - `state`: the technique's state for the light.
    - `mask`: (h, w), the pixels that count: where raster and reference see a surface, and the technique covers it.
    - `remarks`: on the scene's files.
    """

    key: str
    scene: geometry.Scene
    state: Any
    surface: raster.Surface
    reference: reference.Reference
    mask: Bool[HostArray, "h w"]
    remarks: tuple[str, ...] = ()

    @property
    def noise_floor(self) -> float | None:
        """Noise floor of the reference, in visibility; `None` for a reference from a file, since its noise is
        unknown."""
        return self.reference.noise_floor if self.reference.samples else None

    @property
    def pixels(self) -> int:
        """How many pixels count."""
        return int(self.mask.sum())
