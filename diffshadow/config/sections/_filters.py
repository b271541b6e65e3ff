"""Sections of the filters, which average compares."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from ...settings import filters
from ...settings.patterns import MAX_TAPS, Pattern, Vogel
from ._section import Conflict, Section, Variants, fault


class PatternedConfig(Section, Pattern):
    """A filter whose taps follow a pattern, a different one for each pixel of a tile."""

    def faults(self) -> Iterator[Conflict]:
        taps = self.samples * self.pattern_size**2
        if taps > MAX_TAPS:
            message = f"is {self.samples} with pattern_size {self.pattern_size}, which makes {taps:,} taps per tile"
            expected = f"at most {MAX_TAPS:,}, which take seconds to generate"
            yield ("samples",), fault(message, expected, "lower one of them")

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        if data.get("pattern") != "vogel":
            return data
        return {"pattern_size": Vogel.pattern_size, "rotated": Vogel.rotated, **data}


class RandomDiskConfig(PatternedConfig, filters.RandomDisk):
    """Taps on a disk."""


class PercentageCloserSoftConfig(PatternedConfig, filters.PercentageCloserSoft):
    """A disk as wide as the penumbra, which is estimated by a blocker search."""


FILTERS = Variants(filters.Filter, "random_disk", __name__)
FilterConfig = Annotated[filters.Filter, FILTERS]
