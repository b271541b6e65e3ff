"""Checks of layouts that are fitted to what a camera sees."""

from collections.abc import Sequence

from ..._misc import concrete
from ..._types import Resolution, Scalar
from ...geometry import AbstractCamera, AbstractLight
from ...raster import Surface


def check_light(light: AbstractLight) -> None:
    """**Raises** `ValueError` unless `light` is directional."""
    if not light.is_directional:
        raise ValueError(
            f"the light is a {type(light).__name__}, whose map cannot be fitted to a camera; expected a directional "
            "light: use a single map for this one"
        )


def check_margin(margin: float, resolution: Resolution) -> None:
    """**Raises** `ValueError` unless maps of `resolution` have texels within their `margin`."""
    if not min(resolution) > 2 * margin + 1:
        raise ValueError(
            f"the layout has a margin of {margin:g} texels on each side, and maps of {resolution} texels, (height, "
            f"width); expected more than {2 * margin + 1:g}: enlarge the maps, or lower margin"
        )


def check_depths(what: str, depths: Sequence[Scalar], camera: AbstractCamera) -> None:
    """**Raises** `ValueError` if `depths`, which `what` names, are known and not within the camera's near and far."""
    near, far = concrete(camera.near), concrete(camera.far)
    known = [float(depth) for depth in map(concrete, depths) if depth is not None]
    if near is not None and far is not None and known and not (near < min(known) and max(known) <= far):
        raise ValueError(
            f"the layout's {what} {', '.join(f'{depth:g}' for depth in known)}; expected depths from the camera's "
            f"near, {float(near):g}, to its far, {float(far):g}: lower what lies beyond, or raise the camera's far"
        )


def check_surface(needs_surface: bool, surface: Surface | None) -> None:
    """**Raises** `ValueError` if a layout needs a surface and has none."""
    if needs_surface and surface is None:
        raise ValueError("the layout follows the depths of the surface, and none was given; expected a surface")
