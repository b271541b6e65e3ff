"""What the settings of three.js and Babylon.js amount to: a shift, an offset and a radius without an engine's unit.

These are the inverse of the formulas in `_convert.py` and `_radius.py`.
"""

import math
from typing import NamedTuple

from ...geometry import AbstractLight
from ..biases import OffsetProfile
from ..filters._castano import CASTANO_KERNELS
from ._babylon import TENTS, BabylonJs
from ._convert import OFFSET_PROFILES, LightFrame, light_frame
from ._radius import POISSON_RADIUS
from ._three import ThreeJs

# The radius of a disk with the same standard deviation as a box from -1 to 1.
_BOX = 2 / math.sqrt(3)


class PlainBias(NamedTuple):
    """A bias without an engine's unit.

    - `shift`: towards the light, in world units; `power`: of the distance with which it grows.
    - `offset`: along normals, in texels; `offset_power`: of the distance with which its length grows; `profile`: how it
        grows with the angle to the light.
    - `radius`: of a disk of taps that is as wide as the filter, in texels; None for a filter without such a width.
    """

    shift: float
    power: int
    offset: float
    offset_power: int
    profile: OffsetProfile
    radius: float | None


def plain_bias(technique: ThreeJs | BabylonJs, light: AbstractLight, distance: float) -> PlainBias:
    """The bias and the filter of an engine's shadows, at the `distance` along the light's axis, in world units.

    **Raises** what `engine_settings` raises.
    """
    frame = light_frame(light, technique.resolution, distance)
    offset = float(technique.normal_bias) / frame.texel
    if isinstance(technique, ThreeJs):
        shift = -float(technique.bias) / _slope(frame, distance)
        return PlainBias(shift, 2, offset, 0, OFFSET_PROFILES["three.js"], _three_radius(technique, frame))
    is_point = frame.kind == "point"
    bias = float(technique.bias)
    if technique.filter in ("PCF", "PCSS") and not is_point:
        shift, power = bias / 2 / _slope(frame, distance), 2
    else:
        # Linear in the distance.
        shift, power = bias * (frame.near + frame.far if is_point else frame.far - frame.near), 0
    return PlainBias(shift, power, offset, 0, OFFSET_PROFILES["Babylon.js"], _babylon_radius(technique, frame))


def _slope(frame: LightFrame, distance: float) -> float:
    """Window depth per world unit."""
    depth = frame.far - frame.near
    return 1 / depth if frame.kind == "directional" else frame.far * frame.near / (depth * distance**2)


def _three_radius(technique: ThreeJs, frame: LightFrame) -> float:
    radius = float(technique.radius)
    match technique.shadow_type:
        case "BasicShadowMap":
            return 0.0
        case "VSMShadowMap":
            return radius * _BOX
    # Under a point light, a unit is half a texel at the centre of a face.
    return radius / 2 if frame.kind == "point" else radius


def _babylon_radius(technique: BabylonJs, frame: LightFrame) -> float | None:
    kind = technique.filter
    if frame.kind == "point" and kind in ("PCF", "PCSS"):
        kind = "POISSONSAMPLING"
    match kind:
        case "NONE":
            return 0.0
        case "POISSONSAMPLING":
            return float(technique.blur_scale) * (1.0 if frame.kind == "point" else POISSON_RADIUS)
        case "PCF":
            return castano_radius(TENTS[technique.quality])
    return None


def castano_radius(size: int) -> float:
    """The radius in texels of a disk with the same standard deviation as Castaño's kernel of `size` texels."""
    weights = CASTANO_KERNELS.get(size, (1,))
    squares = sum(weight * (i - size // 2) ** 2 for i, weight in enumerate(weights))
    # A disk's standard deviation along an axis is half its radius.
    return 2 * math.sqrt(squares / sum(weights))
