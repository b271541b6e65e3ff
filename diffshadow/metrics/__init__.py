"""Error metrics of a visibility image, or a picture, against its reference."""

from ._aliasing import AliasingFigures, measure_aliasing
from ._errors import ShadowErrors, false_light_rate, false_shadow_rate, mae, measure_errors, psnr, rmse, ssim
from ._flicker import flicker
from ._flip import flip
from ._penumbra import penumbra_width
from ._shapes import chamfer_distance, count_self_intersections, intersection_over_union

__all__ = [
    "AliasingFigures",
    "ShadowErrors",
    "chamfer_distance",
    "count_self_intersections",
    "false_light_rate",
    "false_shadow_rate",
    "flicker",
    "flip",
    "intersection_over_union",
    "mae",
    "measure_aliasing",
    "measure_errors",
    "penumbra_width",
    "psnr",
    "rmse",
    "ssim",
]


def __dir__() -> list[str]:
    return __all__
