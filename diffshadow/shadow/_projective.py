"""Projective texture shadows: the casters' silhouette as a texture (Blinn 1988; Segal et al. 1992).

The casters are drawn as seen from the light, black on white, and this texture is projected onto all other surfaces like
a slide. No depth is compared, so there is no acne and no bias, and the texture can be blurred freely.

    visibility = 1 - coverage(where the light sees the receiver)

The technique ignores depth order: casters shadow neither themselves nor each other, and a receiver in front of a caster
is shadowed like one behind it.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import as_array, as_float, as_number, dot, in_unit_range, normalize
from .._checks import as_tuple
from .._types import AsScalar, Mask, Resolution, TexelMap, Visibility
from ..geometry import AbstractLight, Scene
from ..raster import NO_FACE, Surface, rasterize
from ..settings.filters import Shape
from ..settings.techniques import ProjectiveShadow as Settings
from ._receiver import project
from ._technique import AbstractTechnique
from .kernels import Blur, bilinear_fetch, check_radius, limit_radius

LayerMap = Int[Array, "h w"]


class ProjectiveTexture(eqx.Module):
    """The casters' silhouette as a light sees it.

    - `coverage`: (h, w), coverage by the casters in [0, 1], sampled at texel centres and blurred. Row 0 is the bottom
        row. (l, h, w) for a light with several views.
    - `light`: the light it was drawn from.
    - `casts`: (f,), whether each face of the scene's mesh belongs to a caster.
    - `margin`: the number of texels on each side outside the light's frustum. They contain only coverage that the blur
      spreads there.
    """

    coverage: Float[Array, "*l h w"]
    light: AbstractLight
    casts: Bool[Array, " f"] = eqx.field(converter=as_array)
    margin: int = eqx.field(static=True)

    @property
    def resolution(self) -> Resolution:
        """(height, width) of the light's frustum in texels."""
        height, width = self.coverage.shape[-2:]
        return height - 2 * self.margin, width - 2 * self.margin


class ProjectiveShadow(AbstractTechnique):
    """Shadows by a projected texture, with bilinear look-ups.

    - `resolution`: resolution of the texture, (height, width) in texels.
    - `blur`: radius of the blur kernel, in texels. Up to 0.5, nothing is blurred.
    - `max_blur`: upper bound on `blur`, in texels. Defaults to `blur`, or to 8 if `blur` is traced.
    - `kernel`: `"box"`, whose radius is half its width, `"tent"` or `"gaussian"`, cut off at three standard deviations.

    Differentiable with respect to the blur and to the receivers' positions in the texture. Coverage is sampled at texel
    centres, so it has no derivative with respect to casters or light. Do not rely on gradients of their poses.

    **Raises** `ValueError` if `blur` is above `max_blur`.
    """

    settings: ClassVar = Settings

    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=Settings.resolution)
    blur: AsScalar = eqx.field(converter=as_number, default=Settings.blur)
    max_blur: float | Any = eqx.field(static=True, default=None, kw_only=True)
    kernel: Shape = eqx.field(static=True, default=Settings.kernel, kw_only=True)

    def __post_init__(self):
        limit_radius(self, "blur")

    def _check_rules(self):
        check_radius(self, "blur")

    def prepare(self, scene: Scene, surface: Surface | None = None) -> ProjectiveTexture:
        """The silhouette of the scene's casters under its only light. It does not depend on `surface`."""
        casters, light = scene.casters.padded(), scene.light
        clip = light.view().clip_vertices(casters.vertices)
        face = rasterize(clip, casters.faces, self.resolution, alpha_test=casters.alpha_test).face
        blurring = Blur(self.blur, self.max_blur, self.kernel)
        coverage = _blurred(as_float(face != NO_FACE), blurring)
        return ProjectiveTexture(coverage, light, scene.casting_faces, blurring.margin)

    @eqx.filter_jit
    def visibility(self, state: ProjectiveTexture, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        Casters are lit, and so is everything outside the texture or behind the light. Surfaces that face away from the
        light's centre are dark, even on casters. Pixels without a surface are lit.
        """
        light = state.light
        cosine = dot(surface.normal, normalize(light.towards(surface.position)))
        seen = _seen(state, *_project(state, surface))
        lit = in_unit_range(jnp.where(state.casts[jnp.maximum(surface.face, 0)], 1, 1 - seen))
        return jnp.where(surface.mask, jnp.where(cosine > 0, lit, 0), 1)

    @eqx.filter_jit
    def covered(self, state: ProjectiveTexture, surface: Surface) -> Mask:
        """Pixels whose surface is within the light's frustum, (h, w). The texture is projected onto them."""
        texel, in_front, _ = _project(state, surface)
        height, width = state.resolution
        inside = jnp.all((texel >= 0) & (texel <= jnp.array([width, height])), axis=-1)
        return surface.mask & in_front & inside


@eqx.filter_jit
def _blurred(silhouette: Float[Array, "*l h w"], blur: Blur) -> Float[Array, "*l H W"]:
    return blur(silhouette, jnp.zeros((), silhouette.dtype))


def _project(texture: ProjectiveTexture, surface: Surface) -> tuple[TexelMap, Mask, LayerMap | None]:
    """The position of each surface point in the light's view, in texels; whether it is in front of the light; and the
    index of the view."""
    layer = texture.light.layer(surface.position)
    texel, _, in_front = project(texture.light.view().facing(layer), texture.resolution, surface.position)
    return texel, in_front, layer


def _seen(texture: ProjectiveTexture, texel: TexelMap, in_front: Mask, layer: LayerMap | None) -> Visibility:
    """Bilinear coverage at `texel` (h, w, 2); 0 beyond the border."""
    fetch = bilinear_fetch(texture.resolution, texel, layer, texture.margin)
    return jnp.where(in_front, fetch(texture.coverage), 0)
