"""Error metrics of a visibility image, or a picture, against its reference."""

from ._aliasing import AliasingFigures as AliasingFigures
from ._aliasing import measure_aliasing as measure_aliasing
from ._differences import mae as mae
from ._differences import psnr as psnr
from ._differences import rmse as rmse
from ._false_rates import false_light_rate as false_light_rate
from ._false_rates import false_shadow_rate as false_shadow_rate
from ._flip import flip as flip
from ._penumbra import penumbra_width as penumbra_width
from ._shapes import chamfer_distance as chamfer_distance
from ._shapes import intersection_over_union as intersection_over_union
from ._ssim import ssim as ssim
from ._summary import ShadowErrors as ShadowErrors
from ._summary import measure_errors as measure_errors
