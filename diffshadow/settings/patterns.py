"""Settings of sampling patterns."""

from typing import Annotated, Literal

from ._settings import At, Limits, Settings, Unit

PatternName = Literal["stratified", "uniform", "poisson", "vogel", "sobol", "halton"]
DiskMapping = Literal["concentric", "polar"]
"""The map from the unit square to the unit disk. Both preserve area; `"concentric"` has less distortion."""
MAX_TAPS = 1 << 20
"""The maximum number of taps in a tile of a filter's patterns, which take seconds to generate."""
MAX_PATTERN_TAPS = 16 * MAX_TAPS
"""The maximum number of taps in a tile of any patterns, which take 270 MB."""

Samples = Annotated[int, Limits(1, 4096), Unit("taps per pixel")]
# With more taps than a filter has, a sweep finds the limit of its runs.
PatternSamples = Annotated[int, Limits(1, MAX_TAPS), Unit("taps per pixel")]


class Pattern(Settings):
    """The positions of the taps on a disk, with a different set for each pixel of a tile."""

    pattern: Annotated[PatternName, At(), "distribution of the taps on a disk"] = "stratified"
    samples: Annotated[Samples, "taps per pixel"] = 32
    pattern_size: Annotated[
        int, Limits(1, 256), Unit("pixels"), "width of the tile of patterns, in pixels; default: 8, or 1 for vogel"
    ] = 8
    rotated: Annotated[bool, "whether each pixel also rotates its pattern; default: false, or true for vogel"] = False


class Vogel(Pattern):
    """The sunflower spiral. All pixels use one set, rotated for each."""

    pattern_size = 1
    rotated = True
