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
from ._abstract import AbstractBias, BiasTerms
from ._features import FEATURES


class NormalOffset(AbstractBias):
    """Moves the look-up along the normal, by `value` texels times a profile of the angle θ to the light.

    - `profile`: `"sine"` sin θ, `"constant"` 1, or `"one_minus_cosine"` 1 - cos θ.
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
        profile = FEATURES["one" if self.profile == "constant" else self.profile].of(receiver)
        length = self.value * receiver.texel_size * profile
        return BiasTerms(jnp.zeros_like(length), receiver.normal * length[..., None])
