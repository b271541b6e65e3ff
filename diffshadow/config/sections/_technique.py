"""Sections of the shadow technique, the shadow map and the compare."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from ..._words import counted
from ...settings import engines, maps, techniques
from ...settings.techniques import MAX_ACROSS
from ._section import Conflict, Section, Variants, exclusive, fault


class CascadesConfig(Section, techniques.Cascades):
    """Cascaded shadow maps: a map for each of several ranges of the camera's depth, under directional lights."""

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from exclusive(data, "distances", "shadow_distance")
        if data.get("distances") is not None and data.get("depths", "camera") != "camera":
            yield ("depths",), fault("is surface, and distances are given", "camera", "remove depths, or distances")

    def faults(self) -> Iterator[Conflict]:
        given = self.distances or ()
        for i, (before, after) in enumerate(itertools.pairwise(given)):
            if after <= before:
                message = f"is {after:g}, after {before:g}"
                yield ("distances", i + 1), fault(message, "increasing depths", "sort them, without repetitions")
        if self.shares is not None and len(self.shares) != self.layers:
            message = f"has {counted(len(self.shares), 'share')}, for {counted(self.layers, 'cascade')}"
            yield ("shares",), fault(message, "as many", "give one for each cascade")


class ResolutionMatchedConfig(Section, techniques.ResolutionMatched):
    """A virtual map under each directional light. Only the pages that the camera needs are drawn, at the resolution of
    the screen."""

    def faults(self) -> Iterator[Conflict]:
        for key, value in (("page", self.page), ("finest", self.finest)):
            if value & (value - 1):
                below = 1 << (value.bit_length() - 1)
                yield (key,), fault(f"is {value}", "a power of two", f"set it to {below} or {2 * below}")
        if not 2 <= self.finest / self.page <= MAX_ACROSS:
            message = f"is {self.finest}, and pages are {self.page} texels wide"
            yield ("finest",), fault(message, f"from 2 to {MAX_ACROSS} pages", "change it, or page")
        if self.margin is not None and self.margin > self.page // 2:
            message = f"is {self.margin:g}, and pages are {self.page} texels wide"
            yield ("margin",), fault(message, "at most half of that", "lower it, or enlarge page")


# The engines' techniques are defined in a file of their own, which must be loaded first.
_ENGINES = engines.Engine
TECHNIQUES = Variants(techniques.Technique, "shadow_map", __name__)
TechniqueConfig = Annotated[techniques.Technique, TECHNIQUES]


class ShadowMapConfig(Section, maps.ShadowMap):
    """The depth map drawn from the light."""


COMPARES = Variants(maps.Compare, "hard", __name__)
CompareConfig = Annotated[maps.Compare, COMPARES]
