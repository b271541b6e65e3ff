"""Shadow that darkens the finished picture, as the fixed-function pipeline of OpenGL 1.4 draws it."""

import equinox as eqx
import jax.numpy as jnp

from .._misc import as_float, concrete
from .._types import Scalar, VectorMap
from ..geometry import AbstractCamera
from ..raster import Surface
from ._abstract import AbstractShading, Lights, Visibilities, each_light
from ._phong import Phong


class ModulatedShadow(AbstractShading):
    """The lit colour, multiplied by a constant where it is in shadow.

        image = (factor + (1 - factor) · visibility) · lit image

    A depth texture is compared with the texture coordinate R (`GL_COMPARE_R_TO_TEXTURE`), and the texture environment
    `GL_MODULATE` multiplies what lighting made of the vertices by the result: 1 where lit, and `factor` where not,
    which is the compare fail value of the extension ARB_shadow_ambient (OpenGL 1.4, section 3.8.14; without the
    extension it is 0). Of several lights, each with its own texture unit, the factors multiply.

    So here, other than in `Phong`, shadow darkens ambient light and what other lights add, and leaves some of the
    shadowed light's own diffuse and specular reflection, highlights included. Where all light comes from one source,
    a factor of 0 makes shadows black.

    - `lit`: shading of the scene without shadows.
    - `factor`: what shadow leaves, 0 to 1.

    **Raises** `ValueError` for a factor outside [0, 1].
    """

    lit: AbstractShading = eqx.field(default_factory=Phong)
    factor: Scalar = eqx.field(converter=as_float, default=0.5)

    def __check_init__(self):
        factor = concrete(self.factor)
        if factor is not None and not 0 <= factor <= 1:
            raise ValueError(f"the shadow's factor is {factor}; expected 0 (black) to 1 (no shadow)")

    def __call__(self, surface: Surface, visibility: Visibilities, light: Lights, camera: AbstractCamera) -> VectorMap:
        """The image of `surface`; arguments, result and errors are those of `AbstractShading`. Pixels without a surface
        keep their colour."""
        pairs = each_light(visibility, light)
        image = self.lit(surface, [jnp.ones_like(seen) for seen, _ in pairs], [light for _, light in pairs], camera)
        for seen, _ in pairs:
            share = self.factor + (1 - self.factor) * seen
            image = image * jnp.where(surface.mask, share, 1)[..., None]
        return image
