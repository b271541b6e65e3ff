"""Ray-traced reference visibility, independent of the rasterizer."""

from ..settings.reference import Blockers as Blockers
from ..settings.reference import Sampler as Sampler
from ._cache_key import cache_key as cache_key
from ._contribution import hidden_pixels as hidden_pixels
from ._contribution import hides_light as hides_light
from ._contribution import is_lit as is_lit
from ._exact import trace_visibility_exact as trace_visibility_exact
from ._reference import Reference as Reference
from ._sampling import concentric_disk as concentric_disk
from ._visibility import reference_from_image as reference_from_image
from ._visibility import trace_visibility as trace_visibility
