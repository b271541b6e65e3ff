"""Projective texture shadows: the casters' silhouette as a texture (Blinn 1988; Segal et al. 1992).

The light sees the casters black on white, and that picture is projected onto what does not cast, as a slide would be.
No depth is compared, so there is no acne and no bias, and the picture may be blurred at will.

    visibility = 1 - coverage at the place in the texture that the light sees the receiver at

It knows nothing of order: casters do not shadow themselves or one another, and a receiver in front of a caster is
shadowed as well as one behind it.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._misc import as_float, dot, in_unit_range, normalize
from .._types import Mask, Resolution, Scalar, TexelMap, Visibility
from ..geometry import AbstractLight, Scene
from ..raster import NO_FACE, Capacity, Surface, rasterize
from ._map import clip_vertices
from ._technique import AbstractTechnique
from .filters._prefilter import Blur, bilinear_fetch, check_kernel, check_radius, radius_limit
from .kernels import Shape

LayerMap = Int[Array, "h w"]


class ProjectiveTexture(eqx.Module):
    """The casters' silhouette as a light sees it.

    - `coverage`: (h, w), how much of each texel's surroundings the casters cover, 0 to 1. Row 0 is the bottom row. Of a
        light that looks several ways, (l, h, w).
    - `light`: the light that sees it.
    - `casts`: (f,), which faces of the scene's mesh are the casters'.
    - `margin`: how many texels at each side lie beyond the light's frustum. There is nothing there but what the blur
        spreads out.
    """

    coverage: Float[Array, "*l h w"]
    light: AbstractLight
    casts: Bool[Array, " f"] = eqx.field(converter=jnp.asarray)
    margin: int = eqx.field(static=True)

    @property
    def resolution(self) -> Resolution:
        """(height, width) of the light's frustum in texels."""
        height, width = self.coverage.shape[-2:]
        return height - 2 * self.margin, width - 2 * self.margin


class ProjectiveShadow(AbstractTechnique):
    """Shadows by a projected texture, with bilinear look-ups.

    - `resolution`: of the texture, (height, width) in texels.
    - `blur`: radius of the kernel that the silhouette is averaged over, in texels; up to 0.5 nothing is blurred.
    - `max_blur`: the largest blur that can be asked for; defaults to `blur`, and is needed if that is traced.
    - `kernel`: `"box"`, whose radius is half its width, `"tent"` or `"gaussian"`, which ends at three of its standard
        deviations.

    Differentiable by what moves receivers within the texture, their positions and the light, while the texture stays,
    and by its blur. A texel is covered or not by its centre, so how the silhouette moves with casters and light has no
    gradient: those of their poses are not to be trusted.

    **Raises** `ValueError` if `blur` is negative or above `max_blur`, or `kernel` is unknown.
    """

    resolution: Resolution = eqx.field(static=True)
    blur: Scalar
    max_blur: float = eqx.field(static=True)
    kernel: Shape = eqx.field(static=True)

    def __init__(
        self,
        resolution: Resolution = (512, 512),
        blur: float | Scalar = 0.0,
        *,
        max_blur: float | None = None,
        kernel: Shape = "box",
    ):
        self.resolution, self.blur, self.kernel = resolution, as_float(blur), kernel
        self.max_blur = radius_limit(blur, max_blur)

    def __check_init__(self):
        check_kernel("projective texture", self.kernel)
        check_radius("projective texture", self.blur, self.max_blur)

    def prepare(
        self, scene: Scene, surface: Surface | None = None, *, capacity: Capacity | None = None
    ) -> ProjectiveTexture:
        """The silhouette of the scene's casters under its only light. It does not depend on `surface`.

        **Arguments:** `capacity` as for `rasterize`; needed under a trace.
        """
        casters, light = scene.casters, scene.light
        face = rasterize(clip_vertices(casters, light), casters.faces, self.resolution, capacity=capacity).face
        blurring = Blur(self.blur, self.max_blur, self.kernel)
        coverage = _blurred(as_float(face != NO_FACE), blurring)
        return ProjectiveTexture(coverage, light, scene.casting_faces, blurring.margin)

    @eqx.filter_jit
    def visibility(self, state: ProjectiveTexture, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        What the texture does not show is lit, as is what lies behind the light, and every caster. A surface that faces
        away from the light's centre is dark, the casters' too. Pixels without a surface are lit.
        """
        light = state.light
        cosine = dot(surface.normal, normalize(light.towards(surface.position)))
        seen = _seen(state, *_project(state, surface))
        lit = in_unit_range(jnp.where(state.casts[jnp.maximum(surface.face, 0)], 1, 1 - seen))
        return jnp.where(surface.mask, jnp.where(cosine > 0, lit, 0), 1)

    @eqx.filter_jit
    def covered(self, state: ProjectiveTexture, surface: Surface) -> Mask:
        """Pixels whose surface the texture is projected on, (h, w): those within the light's frustum."""
        texel, in_front, _ = _project(state, surface)
        height, width = state.resolution
        inside = jnp.all((texel >= 0) & (texel <= jnp.array([width, height])), axis=-1)
        return surface.mask & in_front & inside


@eqx.filter_jit
def _blurred(silhouette: Float[Array, "*l h w"], blur: Blur) -> Float[Array, "*l H W"]:
    return blur(silhouette, jnp.zeros((), silhouette.dtype))


def _project(texture: ProjectiveTexture, surface: Surface) -> tuple[TexelMap, Mask, LayerMap | None]:
    """Where the light sees each surface point, in texels, whether it lies in front of the light, and in which view."""
    view = texture.light.view()
    layer = texture.light.layer(surface.position)
    clip = (view if layer is None else view.facing(layer)).clip(surface.position)
    w = clip[..., 3:]
    in_front = w > (1e-3 * view.near if view.is_perspective else 0)
    window = jnp.where(in_front, clip[..., :2] / jnp.where(in_front, w, 1), 2.0) * 0.5 + 0.5
    height, width = texture.resolution
    return window * jnp.array([width, height], window.dtype), in_front[..., 0], layer


def _seen(texture: ProjectiveTexture, texel: TexelMap, in_front: Mask, layer: LayerMap | None) -> Visibility:
    """The coverage at `texel` (h, w, 2), blended from the four texels round it; nothing lies beyond the border."""
    fetch = bilinear_fetch(texture.resolution, texel, layer, texture.margin)
    return jnp.where(in_front, fetch(texture.coverage), 0)
