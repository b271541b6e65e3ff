"""Which face each pixel sees, and depth and attributes there."""

from ._bins import Capacity as Capacity
from ._bins import Cull as Cull
from ._depth_test import DepthTest as DepthTest
from ._interpolate import Barycentrics as Barycentrics
from ._interpolate import barycentrics as barycentrics
from ._interpolate import interpolate as interpolate
from ._interpolate import interpolate_corners as interpolate_corners
from ._interpolate import interpolate_depth as interpolate_depth
from ._rasterize import NO_FACE as NO_FACE
from ._rasterize import Fragments as Fragments
from ._rasterize import plan as plan
from ._rasterize import rasterize as rasterize
from ._rasterize import rasterize_depth as rasterize_depth
from ._surface import Surface as Surface
from ._surface import draw_surface as draw_surface
