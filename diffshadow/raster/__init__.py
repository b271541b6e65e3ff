"""Rasterization: the visible face of each pixel, and its depth and attributes."""

from ..settings.maps import Cull
from ._antialias import AntialiasedSurface, AntialiasPlan, draw_antialiased, plan_antialiasing
from ._corners import rasterize_with_corners as rasterize_with_corners
from ._counts import count_fragments
from ._depth_test import DepthTest
from ._drawn_view import drawn_view as drawn_view
from ._fixed import SUBPIXELS
from ._fixed import at_steps as at_steps
from ._grid_crossings import grid_crossings as grid_crossings
from ._interpolate import Barycentrics, barycentrics, interpolate, interpolate_corners, interpolate_depth, visible_depth
from ._interpolate import Rows as Rows
from ._interpolate import by_bands as by_bands
from ._irregular import hidden_points as hidden_points
from ._irregular import seen_points as seen_points
from ._items import Items as Items
from ._rasterize import NO_FACE, Fragments, rasterize, rasterize_depth
from ._segments import Segments as Segments
from ._silhouettes import Silhouettes as Silhouettes
from ._silhouettes import light_sides as light_sides
from ._silhouettes import silhouettes_by_adjacency as silhouettes_by_adjacency
from ._surface import Surface, draw_surface
from ._within_pixels import PixelPoints, points_within_pixels

__all__ = [
    "NO_FACE",
    "SUBPIXELS",
    "AntialiasPlan",
    "AntialiasedSurface",
    "Barycentrics",
    "Cull",
    "DepthTest",
    "Fragments",
    "PixelPoints",
    "Surface",
    "barycentrics",
    "count_fragments",
    "draw_antialiased",
    "draw_surface",
    "interpolate",
    "interpolate_corners",
    "interpolate_depth",
    "plan_antialiasing",
    "points_within_pixels",
    "rasterize",
    "rasterize_depth",
    "visible_depth",
]


def __dir__() -> list[str]:
    return __all__
