"""Layouts that are fitted to a camera's view."""

from collections.abc import Sequence

import equinox as eqx

from ..._arithmetic import concrete
from ..._checks import check_again
from ..._types import Resolution, Scalar
from ...geometry import AbstractCamera, AbstractLight
from ...raster import Surface
from ...settings.techniques import MARGIN
from ._abstract import AbstractLayout

# Relative rounding error of a radius in single precision.
_ROUNDING = 1e-6


class AbstractFittedLayout(AbstractLayout):
    """A layout for directional lights that is fitted to a camera's view.

    - `shadow_distance`: the depth along the camera's axis, in world units, beyond which nothing is shadowed; `None` for
        the camera's far.
    - `margin`: the margin of maps beyond the camera's view, in texels.
    """

    shadow_distance: eqx.AbstractVar[Scalar | None]
    margin: eqx.AbstractVar[float]

    def check_reach(self, reach: float) -> None:
        if self.margin < reach * (1 - _ROUNDING):
            raise ValueError(
                f"the layout's margin is {self.margin:g} texels, and the filter and the normal offset read up to "
                f"{reach:g} texels from a receiver, beyond the map's end; expected at least this margin: raise "
                "margin, or "
                "lower the radius"
            )

    def check(
        self, light: AbstractLight, camera: AbstractCamera, resolution: Resolution, surface: Surface | None
    ) -> None:
        """**Raises** `ValueError` unless the layout's numbers are in range, the light is directional, maps of
        `resolution` have texels within their margin, the shadow distance is within the camera's depths, and there is a
        surface if the layout needs one."""
        # Numbers may have been replaced since the layout was made.
        check_again(self)
        if not light.is_directional:
            raise ValueError(
                f"the light is a {type(light).__name__}, whose map cannot be fitted to a camera; expected a "
                "directional light: use a single map for this one"
            )
        if not min(resolution) > 2 * self.margin + 1:
            raise ValueError(
                f"the layout has a margin of {self.margin:g} texels on each side, and maps of {resolution} texels, "
                f"(height, width); expected more than {2 * self.margin + 1:g}: enlarge the maps, or lower margin"
            )
        if self.needs_surface and surface is None:
            raise ValueError(
                "the layout follows the depths of the surface, but no surface was given; expected a surface"
            )
        if self.shadow_distance is not None:
            check_depths("shadow_distance is", [self.shadow_distance], camera)


def margin_of(margin: float | None) -> float:
    """`margin`, or the default for a layout without a filter."""
    return MARGIN if margin is None else margin


def check_depths(what: str, depths: Sequence[Scalar], camera: AbstractCamera) -> None:
    """**Raises** `ValueError` if `depths` are known and not within the camera's near and far. `what` names them."""
    near, far = concrete(camera.near), concrete(camera.far)
    known = [float(depth) for depth in map(concrete, depths) if depth is not None]
    if near is not None and far is not None and known and not (near < min(known) and max(known) <= far):
        raise ValueError(
            f"the layout's {what} {', '.join(f'{depth:g}' for depth in known)}; expected depths from the camera's "
            f"near, {float(near):g}, to its far, {float(far):g}: lower what lies beyond, or raise the camera's far"
        )
