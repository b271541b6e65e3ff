"""Remarks on virtual shadow maps: what they have no memory or no level for."""

from collections.abc import Iterator, Sequence

from ... import geometry
from ...config import Config
from ._setup import Drawn

# A share of the pixels that is worth a remark.
_MANY = 0.01


def page_remarks(config: Config, drawn: Sequence[Drawn]) -> Iterator[str]:
    """A sentence for each light whose pages did not fit, so that texels are larger than pixels, or whose finest level
    is too coarse."""
    for each in drawn:
        light = getattr(each.state, "light", None)
        if not isinstance(light, geometry.PagedLight):
            continue
        raised, bias = float(light.raised), float(light.bias)
        if raised > 0 and bias > 0:
            yield (
                f"{each.key} requests {int(light.requested)} pages, and shadow_map.resolution = "
                f"{list(config.shadow_map.resolution)} has memory for {light.capacity}: technique.level_bias was "
                f"raised to {bias:.3g}, where {int(light.pages.count)} pages fit; enlarge shadow_map.resolution"
            )
        share = float(light.too_coarse)
        if share > _MANY:
            yield (
                f"{each.key} has too large texels in {share:.0%} of the pixels, which need a finer level than "
                f"technique.finest = {light.pages.page * light.pages.across}: enlarge it, or raise technique.level_bias"
            )
