"""The resolutions of a fit of poses, from coarse to fine."""

import itertools
from collections.abc import Sequence

# Downsampling factors of the first phase, in order of preference.
_LEVELS = (8, 4, 2)
_LEAST_SIDE = 16


def levels_of(levels: Sequence[int] | None, *sides: int) -> tuple[int, ...]:
    """The downsampling factors of a fit of poses: `levels`, or one that suits all `sides`, and 1.

    **Arguments:**

    - `sides`: of images and maps, in pixels and texels.

    **Raises** `ValueError` unless they fall, end with 1, and divide all sides.
    """
    if levels is None:
        # Two levels: each is a program to compile.
        suits = lambda level: all(side % level == 0 and side // level >= _LEAST_SIDE for side in sides)
        return (*[level for level in _LEVELS if suits(level)][:1], 1)
    levels = tuple(levels)
    if not levels or levels[-1] != 1 or any(a <= b for a, b in itertools.pairwise(levels)):
        raise ValueError(f"the levels are {list(levels)}; expected whole numbers that fall to 1, such as [8, 1]")
    for level in levels:
        bad = [side for side in sides if side % level]
        if bad:
            raise ValueError(
                f"level {level} makes one pixel of {level} x {level}, and image or map has a side of {bad[0]}; "
                "expected levels that divide all sides: leave it out, or change the resolution"
            )
    return levels
