"""Normal offset: the look-up moves along the receiver's normal (Holbert, "Saying Goodbye to Shadow Acne", 2011)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._arithmetic import as_number, concrete
from ..._types import AsScalar
from ...settings.biases import Bias as Settings
from ...settings.biases import OffsetProfile
from .._receiver import Receiver
from .._shader import Constant, ShaderBias, ShaderPart, number
from ._abstract import AbstractBias, BiasTerms
from ._features import FEATURES

_FEATURE_OF: dict[OffsetProfile, str] = {
    "sine": "sine",
    "constant": "one",
    "one_minus_cosine": "one_minus_cosine",
    "across": "one_minus_cosine",
}


class NormalOffset(AbstractBias):
    """Moves the look-up along the normal, by `value` texels times a profile of the angle θ to the light.

    - `profile`: `"sine"` sin θ, `"constant"` 1, `"one_minus_cosine"` 1 - cos θ, or `"across"` 1 - cos θ, where only the
      part of the shift across the light is applied, as in Godot. `"across"` is exact under directional lights, and
      close under others.
    """

    settings: ClassVar = Settings
    part: ClassVar = "normal_offset"

    value: AsScalar = eqx.field(converter=as_number)
    profile: OffsetProfile = eqx.field(static=True, default=Settings.normal_offset_profile)

    @property
    def reach(self) -> float:
        known = concrete(self.value)
        return 0.0 if known is None else float(np.max(known))

    def __call__(self, receiver: Receiver) -> BiasTerms:
        texels = self.value * FEATURES[_FEATURE_OF[self.profile]].of(receiver)
        moved = receiver.normal * (texels * receiver.texel_size)[..., None]
        if self.profile != "across":
            return BiasTerms(jnp.zeros_like(texels), moved)
        # Removes the part towards the light.
        return BiasTerms(-texels * jnp.clip(receiver.cosine, 0, 1) * receiver.depth_per_texel, moved)

    def shader(self, prefix: str = "") -> ShaderBias:
        about = f"along the normal, times the profile {self.profile}, in texels"
        constant = Constant(f"{prefix}NORMAL_OFFSET", number(self.value), about)
        length = f"SHADOW_{constant.name} * ({FEATURES[_FEATURE_OF[self.profile]].shader})"
        # Removes the part towards the light.
        back = f"-({length}) * clamp(at.cosine, 0.0, 1.0) * at.depth_per_texel"
        return ShaderBias(ShaderPart((constant,), ""), (back,) if self.profile == "across" else (), (length,))
