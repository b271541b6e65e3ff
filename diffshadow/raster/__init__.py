"""Rasterization: the face that each pixel sees, and its depth and attributes."""

from ._bins import Cull as Cull
from ._counts import count_fragments as count_fragments
from ._depth_test import DepthTest as DepthTest
from ._fixed import MOST_VIRTUAL as MOST_VIRTUAL
from ._fixed import SUBPIXELS as SUBPIXELS
from ._grid_crossings import Crossings as Crossings
from ._grid_crossings import count_crossings as count_crossings
from ._grid_crossings import grid_crossings as grid_crossings
from ._interpolate import Barycentrics as Barycentrics
from ._interpolate import Rows as Rows
from ._interpolate import barycentrics as barycentrics
from ._interpolate import by_bands as by_bands
from ._interpolate import interpolate as interpolate
from ._interpolate import interpolate_corners as interpolate_corners
from ._interpolate import interpolate_depth as interpolate_depth
from ._interpolate import visible_depth as visible_depth
from ._rasterize import NO_FACE as NO_FACE
from ._rasterize import Fragments as Fragments
from ._rasterize import rasterize as rasterize
from ._rasterize import rasterize_depth as rasterize_depth
from ._silhouettes import Silhouettes as Silhouettes
from ._silhouettes import light_sides as light_sides
from ._silhouettes import silhouettes_by_adjacency as silhouettes_by_adjacency
from ._silhouettes import silhouettes_by_cancelling as silhouettes_by_cancelling
from ._surface import Surface as Surface
from ._surface import draw_surface as draw_surface
