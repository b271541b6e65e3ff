"""Shadow that darkens the lit image, as in the fixed-function pipeline of OpenGL 1.4."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from .._arithmetic import as_number
from .._types import AsScalar, VectorMap
from ..geometry import AbstractCamera
from ..raster import Surface
from ..settings.shading import ModulatedShadow as Settings
from ._abstract import AbstractShading, Lights, Visibilities, each_light
from ._phong import Phong


class ModulatedShadow(AbstractShading):
    """The lit colour, multiplied by a constant where it is in shadow.

        image = (factor + (1 - factor) · visibility) · lit image

    In OpenGL 1.4 a depth texture is compared with the texture coordinate R (`GL_COMPARE_R_TO_TEXTURE`), and the texture
    environment `GL_MODULATE` multiplies the vertices' lit colour by the result: 1 if lit, `factor` if not. `factor` is
    the compare fail value of the extension ARB_shadow_ambient (section 3.8.14; 0 without the extension). Several lights
    each have a texture unit, and their factors multiply.

    In contrast to `Phong`, shadow also darkens ambient light and the light of other sources. It keeps a part of the
    shadowed light's own diffuse and specular reflection, including highlights. With a single light, a factor of 0 makes
    shadows black.

    - `lit`: shading of the scene without shadows.
    - `factor`: fraction of the colour that remains in shadow: 0 is black, 1 is no shadow.
    """

    settings: ClassVar = Settings

    lit: AbstractShading = eqx.field(default_factory=Phong)
    factor: AsScalar = eqx.field(converter=as_number, default=Settings.factor)

    def __call__(self, surface: Surface, visibility: Visibilities, light: Lights, camera: AbstractCamera) -> VectorMap:
        """The image of `surface`. Arguments, result and errors are as for `AbstractShading`. Pixels without a surface
        keep their colour."""
        pairs = each_light(visibility, light)
        image = self.lit(surface, [jnp.ones_like(seen) for seen, _ in pairs], [light for _, light in pairs], camera)
        for seen, _ in pairs:
            weight = self.factor + (1 - self.factor) * seen
            image = image * jnp.where(surface.mask, weight, 1)[..., None]
        return image

    def of_light(self, index: int) -> "ModulatedShadow":
        """The shading of the scene with only one of its lights, at `index`."""
        return dataclasses.replace(self, lit=self.lit.of_light(index))
