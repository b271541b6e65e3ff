"""Ray-traced reference visibility, independent of the rasterizer."""

from ..settings.reference import Blockers as Blockers
from ..settings.reference import Sampler as Sampler
from ._contribution import hidden_pixels as hidden_pixels
from ._contribution import hides_light as hides_light
from ._contribution import is_lit as is_lit
from ._embree import occluded as occluded
from ._exact import trace_visibility_exact
from ._hidden_points import HiddenPoints as HiddenPoints
from ._hidden_points import hidden_points as hidden_points
from ._key_parts import KeyedScene as KeyedScene
from ._key_parts import key_parts
from ._reference import Reference
from ._sampling import concentric_disk as concentric_disk
from ._visibility import reference_from_image, trace_visibility

__all__ = [
    "Reference",
    "key_parts",
    "reference_from_image",
    "trace_visibility",
    "trace_visibility_exact",
]


def __dir__() -> list[str]:
    return __all__
