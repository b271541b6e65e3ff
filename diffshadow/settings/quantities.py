"""Quantities that many settings share, with the reasons for their limits."""

from typing import Annotated

from ._settings import Form, Limits, LongerThan, Unit

MAX_TEXELS = 8192
"""The maximum side of a map or an image, in texels or pixels. No filter or bias needs to reach farther."""
MAX_VIRTUAL = 65536
"""The maximum side of a map that is drawn only in pages, in texels. The rasterizer's coordinates go no farther."""
FARTHEST = 1e9
"""The maximum coordinate and length, in world units. Normals are cross products of edges, and their lengths are
squared. The fourth power of a length must therefore be representable in float32, which ends at 3e38."""
SMALLEST = 1e-6
"""The minimum size of a mesh, in world units. The fourth power of an edge a thousandth as long must exceed 1e-38."""
MAX_DEGREES = 3600.0
"""The maximum angle: ten turns. Float32 resolves angles of this size to 0.0002 degrees."""
NARROWEST = 0.01
"""The minimum field of view, and the minimum distance of a field of view from 180 degrees, in degrees. The projection
matrix has the tangent of the half angle and its reciprocal."""
MAX_FACTOR = 1e6
"""The maximum factor. Colours are products of several factors, and must be representable in float32."""
MAX_LAYERS = 8
"""The maximum number of maps of a light: cascades, or the six faces of a point light."""

Degrees = Annotated[float, Unit("degrees")]
Turn = Annotated[Degrees, Limits(-MAX_DEGREES, MAX_DEGREES)]
# Penumbrae are finite here.
HalfAngle = Annotated[Degrees, Limits(0, 90 - NARROWEST)]
WorldUnits = Annotated[float, Limits(0, FARTHEST), Unit("world units")]
Distance = Annotated[float, Limits(0, FARTHEST, above_low=True), Unit("world units")]
Coordinate = Annotated[float, Limits(-FARTHEST, FARTHEST), Unit("world units")]
Texels = Annotated[float, Limits(0, MAX_TEXELS), Unit("texels")]
Fraction = Annotated[float, Limits(0, 1)]
Factor = Annotated[float, Limits(0, MAX_FACTOR)]

Position = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], Form("three numbers [x, y, z]", "[0, 1, 0]"), Unit("world units")
]
_Step = Annotated[float, Limits(-FARTHEST, FARTHEST)]
# Normalizing a direction squares its components.
Direction = Annotated[
    tuple[_Step, _Step, _Step], Form("three numbers [x, y, z]", "[0, -1, 0]"), LongerThan(1 / FARTHEST)
]
Angles = Annotated[tuple[Turn, Turn, Turn], Form("three angles [x, y, z]", "[0, 90, 0]"), Unit("degrees")]
Colour = Annotated[
    tuple[Fraction, Fraction, Fraction],
    Form("three numbers [red, green, blue] from 0 to 1", "[0.8, 0.8, 0.8]"),
]
Radiance = Annotated[
    tuple[Factor, Factor, Factor],
    Form("a number, or three [red, green, blue], at least 0", "[0.8, 0.8, 0.8]", repeats=True),
]
_Side = Annotated[int, Limits(1, MAX_TEXELS)]
Size = Annotated[tuple[_Side, _Side], Form("two whole numbers [height, width]", "[512, 512]")]
PixelPointCount = Annotated[int, Limits(1, 1024)]
"""The number of points within a pixel at which shadows are looked up."""
