"""Settings of shading. A class has the name of its module in `shading`."""

from typing import Annotated, Any, Literal

from ._settings import Form, Limits, Settings
from .quantities import MAX_FACTOR, Factor, Fraction, Radiance

Highlight = Literal["blinn_phong", "phong"]
INTENSITY = 0.7
"""Default intensity of all lights together."""


class Attenuation(Settings):
    """Attenuation of light with the distance d: 1 / (constant + linear d + quadratic d²)."""

    # Light attenuated below a millionth is black, and light amplified beyond a million is white.
    constant: Annotated[float, Limits(1 / MAX_FACTOR, MAX_FACTOR), "constant term"] = 1.0
    linear: Annotated[Factor, "linear term, per world unit"] = 0.0
    quadratic: Annotated[Factor, "quadratic term, per squared world unit"] = 0.0


class Shading(Settings):
    """How images are shaded."""

    type: Any


class Lit(Shading):
    """Ambient, diffuse and specular light."""

    model: Annotated[Highlight, "shape of the highlight"] = "blinn_phong"
    ambient: Annotated[Radiance, "ambient light, which casts no shadows"] = (0.3, 0.3, 0.3)
    intensity: Annotated[
        Radiance | None, f"intensity of each light; default: {INTENSITY}, divided among the lights"
    ] = None
    intensities: Annotated[
        tuple[Radiance, ...] | None,
        Form("a list with one intensity for each light", "[0.5, [0.2, 0.2, 0.1]]"),
        "an intensity for each light, instead of intensity",
    ] = None
    specular: Annotated[Factor, "specular reflectance"] = 0.15
    shininess: Annotated[float, Limits(0, MAX_FACTOR, above_low=True), "specular exponent"] = 32.0
    background: Annotated[Radiance, "colour of pixels without a surface"] = (0.9, 0.9, 0.9)


class Phong(Lit):
    """Shadow removes diffuse and specular light; ambient light remains."""

    type: Literal["phong"] = "phong"


class ModulatedShadow(Shading):
    """Shadow multiplies the shaded image by a constant."""

    type: Literal["modulated"] = "modulated"
    factor: Annotated[Fraction, "factor on the image in full shadow"] = 0.5
