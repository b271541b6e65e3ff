"""The quantity that a fit minimises: the errors of several images as one number."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arithmetic import as_float, as_number, concrete
from .._checks import CheckedModule
from .._types import AsScalar, Scalar
from ..settings.fit import Loss as Settings
from ..settings.fit import Over

Errors = Float[Array, " v"]
"""A number for each image, (v,)."""

# The exponents of the mean that approximates the maximum, in the first phase of a fit and in the last.
_FIRST_POWER, _LAST_POWER = 4.0, 64.0
# The search for a threshold: its range, as a logarithm, and its number of steps.
_REACH, _HALVINGS = 7.0, 44


class Loss(CheckedModule):
    """How the mean square errors E of several images become the loss L of a fit.

    All losses are convex in E, and homogeneous: L(s E) = s L(E). Therefore L = Σ w E with the weights w = ∂L/∂E. Least
    squares of residuals with the weights √w have the loss L and its gradient.

    - `over`: `"mean"`, the mean over all pixels; `"worst"`, the greatest E; `"cvar"`, the mean of E over the worst
        `fraction` of pixels when images are sorted by E (conditional value at risk, Rockafellar & Uryasev 2000).
    - `fraction`: for `"cvar"`.
    - `false_shadow`, `false_light`: factors of the squared differences at pixels that are too dark, and at pixels that
      are too light.
    - `power`: the exponent p of a smooth loss; `None` for the loss itself. Let sₖ be image k's share of all pixels. The
      greatest E is replaced by the mean (Σ sₖ Eₖᵖ)^(1/p), and the mean over the worst fraction α by

            min over t of  t + t / (p α) Σ sₖ log(1 + exp(p (Eₖ / t - 1))),

        where the logarithm replaces Rockafellar's and Uryasev's max(0, p (Eₖ / t - 1)).

    **Raises** `ValueError` if both factors are 0.
    """

    settings: ClassVar = Settings

    over: Over = eqx.field(static=True, default=Settings.over)
    fraction: AsScalar = eqx.field(converter=as_number, default=Settings.fraction)
    false_shadow: AsScalar = eqx.field(converter=as_number, default=Settings.false_shadow)
    false_light: AsScalar = eqx.field(converter=as_number, default=Settings.false_light)
    power: Scalar | None = None

    def _check_rules(self):
        dark, light = concrete(self.false_shadow), concrete(self.false_light)
        if dark is not None and light is not None and dark == light == 0:
            raise ValueError("false_shadow and false_light are both 0; expected one of them greater than 0")

    def in_phase(self, part: float) -> "Loss":
        """The loss of a phase, with the phase's power. `part` is 0 for the first phase and 1 for the last."""
        if self.over == "mean":
            return self
        power = as_float(_FIRST_POWER * (_LAST_POWER / _FIRST_POWER) ** part)
        return Loss(self.over, self.fraction, self.false_shadow, self.false_light, power)

    def exact(self) -> "Loss":
        """The loss with the maximum itself."""
        return Loss(self.over, self.fraction, self.false_shadow, self.false_light)

    def reweighted(self, ratio: float) -> "Loss":
        """The loss with the ratio of its two factors, false shadow to false light, multiplied by `ratio`."""
        root, dark, light = ratio**0.5, float(self.false_shadow), float(self.false_light)
        factors = lambda loss: (loss.false_shadow, loss.false_light)
        # Unchecked, because a ratio may move a factor beyond its limit.
        return eqx.tree_at(factors, self, (as_float(dark * root), as_float(light / root)))

    def signed(self, difference: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """A difference of visibilities, times the square root of the factor for its sign."""
        factor = jnp.where(difference > 0, self.false_light, self.false_shadow)
        # The square root has no derivative at 0, and the factors do not need one.
        return difference * jnp.sqrt(jax.lax.stop_gradient(factor))

    def weights(self, errors: Errors, shares: Errors) -> Errors:
        """∂L/∂E at the `errors` E of images with `shares` of all pixels, which sum to 1."""
        if self.over == "mean":
            return shares
        errors = jnp.where(shares > 0, errors, 0)
        if self.over == "worst":
            if self.power is None:
                return jax.nn.one_hot(jnp.argmax(errors), errors.shape[0], dtype=errors.dtype)
            return shares * self._relative(errors, shares) ** (self.power - 1)
        if self.power is not None:
            return shares * jax.nn.sigmoid(self._excess(errors, shares)[0]) / self.fraction
        order = jnp.argsort(-errors)
        sorted_shares = shares[order]
        before = jnp.cumsum(sorted_shares) - sorted_shares
        taken = jnp.clip(self.fraction - before, 0, sorted_shares) / self.fraction
        return jnp.zeros_like(errors).at[order].set(taken)

    def curvature_rows(
        self, errors: Errors, shares: Errors, gradients: Float[Array, "v p"]
    ) -> Float[Array, "v p"] | None:
        """Rows B: The change of the weights adds BᵀB to the Gauss-Newton matrix.

        Because losses are homogeneous, it is to first order in E

            ½ ∂²L/∂E² ∇E ∇E = ½ Σₖ cₖ (gₖ - ḡ)(gₖ - ḡ)ᵀ,   gₖ = ∇Eₖ / Eₖ,   ḡ = Σ cₖ gₖ / Σ cₖ,

        with cₖ = (p - 1) wₖ Eₖ for the mean of power p, and cₖ = p sₖ σ'(zₖ) Eₖ² / (α t) for the worst fraction α,
        where σ is the logistic function and zₖ = p (Eₖ / t - 1).

        **Arguments:** `gradients`: (v, p), gradients of the errors. **Returns:** (v, p), or `None` if there is no such
        term.
        """
        if self.power is None:
            return None
        if self.over == "worst":
            curvature = (self.power - 1) * self.weights(errors, shares) * errors
        else:
            excess, threshold = self._excess(errors, shares)
            bend = jax.nn.sigmoid(excess) * jax.nn.sigmoid(-excess)
            curvature = self.power * shares * bend * errors**2 / (self.fraction * jnp.maximum(threshold, _TINY))
        relative = gradients / jnp.maximum(errors, _TINY)[:, None]
        parts = curvature / jnp.maximum(jnp.sum(curvature), _TINY)
        mean = jnp.matmul(parts, relative, precision="highest")
        return jnp.sqrt(curvature / 2)[:, None] * (relative - mean)

    def _excess(self, errors: Errors, shares: Errors) -> tuple[Errors, Scalar]:
        """zₖ = p (Eₖ / t - 1), and the t that minimises the smooth mean over the worst fraction."""
        power, most = self.power, jnp.maximum(jnp.max(errors), _TINY)
        assert power is not None

        def halved(_: Array, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            low, high = ends
            middle = (low + high) / 2
            above = power * (errors / (most * jnp.exp(middle)) - 1)
            slope = jax.nn.softplus(above) - (above + power) * jax.nn.sigmoid(above)
            falls = power * self.fraction + jnp.sum(shares * slope) < 0
            return jnp.where(falls, middle, low), jnp.where(falls, high, middle)

        # The range of the logarithm of t over the greatest error.
        ends = as_float(-_REACH), as_float(_REACH)
        threshold = most * jnp.exp(jax.lax.fori_loop(0, _HALVINGS, halved, ends)[1])
        return power * (errors / threshold - 1), threshold

    def _relative(self, errors: Errors, shares: Errors) -> Errors:
        """The errors divided by their mean of this power."""
        assert self.power is not None
        scaled = errors / jnp.maximum(jnp.max(errors), _TINY)
        mean = jnp.sum(shares * scaled**self.power) ** (1 / self.power)
        return scaled / jnp.maximum(mean, _TINY)


# No mean square error that matters is smaller.
_TINY = 1e-12
