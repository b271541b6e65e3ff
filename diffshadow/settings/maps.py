"""Settings of shadow maps, and of the compares with their depths."""

from typing import Annotated, Any, Literal

from ._settings import Form, Limits, Settings, Unit
from .quantities import MAX_FACTOR, MAX_TEXELS, Size

Cull = Literal["none", "back", "front"]
"""The faces that are not drawn."""
DepthFormat = Literal["float32", "unorm24", "unorm16"]
DepthLayer = Literal["nearest", "midpoint", "second"]
DepthOperator = Literal["less_equal", "less"]
SoftKernel = Literal["logistic", "linear", "smoothstep", "gaussian", "exponential"]
"""Shape of a soft compare's step."""

_Offset = Annotated[float, Limits(-MAX_FACTOR, MAX_FACTOR)]
# The minimum is far below the resolution of float32 depth, and 1 / width is finite.
Width = Annotated[float, Limits(1e-6, MAX_TEXELS), Unit("texels")]
"""Width of a soft compare."""


class ShadowMap(Settings):
    """The depth map drawn from the light."""

    resolution: Annotated[Size, Unit("texels"), "[height, width] in texels"] = (1024, 1024)
    depth_layer: Annotated[
        DepthLayer, "which depth is stored: of the nearest surface, the second, or midway between"
    ] = "nearest"
    cull: Annotated[Cull, "faces left out of the map; front works for closed casters only"] = "none"
    depth_format: Annotated[DepthFormat, "storage format of depth"] = "float32"
    polygon_offset: Annotated[
        tuple[_Offset, _Offset] | None,
        Form("two numbers [factor, units]", "[1.1, 4]"),
        "[factor, units] of a bias stored in the map, as in OpenGL; default: none",
    ] = None
    silhouettes: Annotated[
        bool | None,
        "whether texels store the silhouettes inside them; default: in fits that move lights or meshes",
    ] = None


class Compare(Settings):
    """How depths are compared."""

    type: Any


class HardCompare(Compare):
    """A binary compare: lit or shadowed."""

    type: Literal["hard"] = "hard"
    operator: Annotated[DepthOperator, "compare of receiver depth against stored depth"] = "less_equal"


class SoftCompare(Compare):
    """A compare with a smooth step, so that it has a gradient."""

    type: Literal["soft"] = "soft"
    width: Annotated[Width, "width of the step, in texels of depth"] = 0.5
    kernel: Annotated[SoftKernel, "shape of the step"] = "logistic"
