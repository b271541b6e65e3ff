"""What an engine's settings amount to: a shift, an offset and a radius without an engine's unit.

These are the inverse of the formulas in `_convert.py` and `_radius.py`.
"""

from ...geometry import AbstractLight
from ._abstract import AbstractEngineShadows
from ._convert import PlainBias, light_frame


def plain_bias(technique: AbstractEngineShadows, light: AbstractLight, distance: float) -> PlainBias:
    """The bias and the filter of an engine's shadows, at the `distance` along the light's axis, in world units.

    **Raises** what `engine_settings` raises.
    """
    return technique.plain(light_frame(light, technique.resolution, distance), distance)
