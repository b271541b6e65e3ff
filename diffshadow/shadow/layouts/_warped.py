"""Light space perspective shadow maps (Wimmer, Scherzer & Purgathofer, "Light Space Perspective Shadow Maps", EGSR
2004), and other warps of the same family."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from ..._arithmetic import as_number, concrete, safe_divide, safe_norm
from ..._types import AsOptional, AsScalar, Resolution, Scalar, Vec2
from ...geometry import AbstractCamera, AbstractLight, View, Warp, transform_points, transform_vectors
from ...raster import Surface
from ...settings.techniques import DepthRange, WarpMethod
from ...settings.techniques import PerspectiveWarp as Settings
from .._shader import Constant, ShaderPart, number, text_of
from ._abstract import Choice
from ._fitted import AbstractFittedLayout, margin_of
from ._frustum import ViewFrustum, depths_of
from ._warped_light import WarpedLight

# The minimum sine of the angle between light and view at which the map is rotated towards the view.
_MIN_SINE = 1e-3
# The minimum size of the map, as a fraction of the light's own, for cameras that see no part of the light's map.
_MIN_SIZE = 1e-3
# Points count as nearest up to this multiple of the minimum depth, because corners of the near plane differ by
# rounding.
_NEARLY = 1.001
# The minimum height of the nearest point, as a fraction of the map's, because 1 / τ has to be finite.
_LOWEST = 1e-6
# The maximum fraction of the distance from the far end to infinity, at 1 / w above it, that a margin takes.
_MAX_MARGIN = 0.5
# The fraction of a trapezoidal map that shows the focus (Martin & Tan 2004).
_FOCUS_SHARE = 0.8
# Corners k of a box are numbered by bits. An edge joins two corners that differ in one bit.
_EDGES = np.array([(k, k | bit) for bit in (1, 2, 4) for k in range(8) if not k & bit], np.int32)


class PerspectiveWarp(AbstractFittedLayout):
    """One map for a directional light, warped by a perspective so that surfaces close to the camera get more texels.

    The map shows the part of the light's own map that the camera sees. The map's y axis follows the camera's view. A
    perspective along this axis enlarges the map's lower end, at the camera (`geometry.Warp`). Depth remains linear, so
    biases have the same meaning as in other maps. Their unit is the size of a texel at the receiver. Radii of filters
    are also in texels. Texels are longer or shorter along the view than across it, so a disk in the map is an ellipse
    on the surface. A map with silhouettes, or a polygon offset, cannot be warped.

    Let z₀ be the minimum depth that the map shows, γ the angle between light and view, d the height of the map in world
    units, and z₁ = `z₀ + d sin γ`. The strength w of the warp is

    - `"lispsm"`: `sqrt(z₁ / z₀) - 1`, which makes perspective aliasing along the view equal at both ends, and its
        maximum as small as possible (Wimmer, Scherzer & Purgathofer 2004, as revised in 2005);
    - `"perspective"`: `z₁ / z₀ - 1`, the strength of perspective shadow maps (Stamminger & Drettakis 2002). They warp
      space in the same way as the camera. Here the perspective runs along the map, so there are no singular cases;
    - `"trapezoidal"`: the region within the `focus` gets 80 % of the map (trapezoidal shadow maps, Martin & Tan 2004),
        with at most the warp of `"perspective"`.

    No strength exceeds `max(1 / τ - 2, 0)`, where τ in [0, 1] is the height of the nearest point in a map without a
    warp. A stronger warp would enlarge the texels at this point again. All strengths therefore tend to 0 as the light
    becomes parallel to the view, where no warp helps. Strengths are 0 for a parallel camera, whose images have no
    perspective aliasing. No strength exceeds `1 / (2 m)`, where m is the margin as a fraction of the map. The map ends
    at the height `1 + 1 / w`, so a stronger warp would leave no space for the margin.

    Along the view, the maximum error of a warp is at the far end. It is `(1 + w) z₀ / z₁` times the maximum without a
    warp. A strength of more than `z₁ / z₀ - 1` is therefore worse than no warp, and z₀ should be the minimum depth of
    the visible surface. A camera's near plane is often much nearer, so `"perspective"` follows the depths of the
    surface by default. `"lispsm"` grows only with the root of z₁ / z₀, and `"trapezoidal"` hardly depends on z₀. Both
    follow the camera's near and far by default, which do not change with the visible surface. On four scenes,
    `"lispsm"` had 0.75 to 1.26 times as large an error with the camera's depths as with the surface's.

    A plane's depth is linear over the map only to first order. A `ReceiverPlane` under a filter of radius r texels
    needs a `fudge` of up to `w (r + 1)² / h`, where h is the map's height in texels.

    - `method`: the rule for the strength.
    - `strength`: w itself, 0 or more, instead of the value from `method`; 0 for a map without a warp.
    - `focus`: for `"trapezoidal"`, the fraction of d at the camera's end that 80 % of the map shows, in (0, 1].
    - `shadow_distance`: the depth along the camera's axis, in world units, beyond which nothing is shadowed; by default
      the camera's far.
    - `depths`: the depths that the map shows. `"camera"`: from the camera's near to its far. `"surface"`: from the
      minimum to the maximum depth of the visible surface, so that no texels are spent on empty space in front of the
      surface. Defaults to `"surface"` for `"perspective"`, and to `"camera"` for the other methods.
    - `margin`: the margin of the map beyond the camera's view, in texels, so that filters read no texels beyond the
      border. It must be at least the maximum radius of the filter, plus half a texel if its look-ups are bilinear, plus
      any normal offset. At the far end, the margin is narrower if `strength` is set above `1 / (2 m)`.
    """

    settings: ClassVar = Settings

    method: WarpMethod = eqx.field(static=True, default=Settings.method)
    strength: AsOptional = eqx.field(converter=as_number, default=Settings.strength, kw_only=True)
    focus: AsScalar = eqx.field(converter=as_number, default=Settings.focus, kw_only=True)
    shadow_distance: AsOptional = eqx.field(converter=as_number, default=Settings.shadow_distance, kw_only=True)
    depths: DepthRange | None = eqx.field(static=True, default=Settings.depths, kw_only=True)
    margin: float = eqx.field(static=True, converter=margin_of, default=Settings.margin, kw_only=True)

    @property
    def needs_surface(self) -> bool:
        return self.depths == "surface" or (self.depths is None and self.method == "perspective")

    def light(
        self,
        light: AbstractLight,
        camera: AbstractCamera,
        resolution: Resolution,
        surface: Surface | None = None,
    ) -> WarpedLight:
        """`light` with the warped view; see `AbstractLayout.light`.

        The view follows the light's direction, but the placement of the map has no gradient with respect to the
        direction. It has a gradient with respect to `strength` and `focus`.

        **Raises** `ValueError` for a light that is not directional, a map too small for the margin, or a shadow
        distance outside of the camera's depths; for `depths` of a surface without one; and for a `strength` above 0 if
        the light shines along the camera's axis.
        """
        self.check(light, camera, resolution, surface)
        strength = None if self.strength is None else concrete(self.strength)
        if strength is not None and strength > 0:
            sine = concrete(_Axes.of(light.view(), camera.view()).sine)
            if sine is not None and sine < _MIN_SINE:
                raise ValueError(
                    f"the warp's strength is {float(strength):g}, and the light shines along the camera's axis, where "
                    'no warp helps; expected 0: leave strength out, and method "lispsm" finds it'
                )
        return _warped_light(self, light, camera, resolution, surface if self.needs_surface else None)

    def choose(self, light: AbstractLight, points: Float[Array, "h w 3"]) -> Choice:
        assert isinstance(light, WarpedLight)
        if self.shadow_distance is None:
            return Choice(None)
        return Choice(None, strength=jnp.where(light.reaches(points), 1.0, 0.0))

    def shader(self, light: AbstractLight) -> ShaderPart:
        assert isinstance(light, WarpedLight)
        ends = self.shadow_distance is not None
        constants = (
            Constant("ENDS_SHADOWS", ends, "whether there are no shadows beyond the shadow distance"),
            Constant("END", number(light.end), "the shadow distance, along the camera's axis in world units"),
        )
        return ShaderPart(constants, text_of("layouts/_warped.glsl"))


class _Axes(NamedTuple):
    """The orientation of the map relative to the view.

    - `up`: (2,), the direction of the camera's axis in the plane across the light, in the light's eye space; a unit
      vector.
    - `sine`: sine of the angle between light and view.
    """

    up: Vec2
    sine: Scalar

    @classmethod
    def of(cls, light: View, camera: View) -> "_Axes":
        across = transform_vectors(light.world_to_eye, -camera.world_to_eye[2, :3])[:2]
        sine = safe_norm(across)
        # If the light shines along the view, there is neither such a direction nor a warp.
        turns = sine >= _MIN_SINE
        return cls(jnp.where(turns, across / jnp.where(turns, sine, 1), jnp.array([0.0, 1.0])), sine)

    def __call__(self, view: View, points: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
        """x and y of `points` along the map's axes, in world units."""
        eye = transform_points(view.world_to_eye, points)
        (x, y), along = (eye[..., 0], eye[..., 1]), self.up
        return along[1] * x - along[0] * y, along[0] * x + along[1] * y


@eqx.filter_jit
def _warped_light(
    layout: PerspectiveWarp,
    light: AbstractLight,
    camera: AbstractCamera,
    resolution: Resolution,
    surface: Surface | None,
) -> WarpedLight:
    # A map's texels have no derivative with respect to its position.
    from_camera, from_light = lax.stop_gradient((camera.view(), light.view()))
    near, end = lax.stop_gradient(depths_of(from_camera, surface, layout.shadow_distance))
    from_camera = eqx.tree_at(lambda view: (view.near, view.far), from_camera, (near, end))
    axes, frustum = _Axes.of(from_light, from_camera), ViewFrustum.of(from_camera)
    points, valid = _common_points(from_light, from_camera, frustum)
    x, y = axes(from_light, points)
    smallest = _MIN_SIZE / jnp.maximum(from_light.eye_to_clip[0, 0], from_light.eye_to_clip[1, 1])
    low, high = _range(y, valid, smallest)
    # Margins in texels, as fractions of the content between them.
    across, along = layout.margin / (np.array(resolution[::-1], float) - 2 * layout.margin)
    strength = layout.strength
    if strength is None:
        depth = jnp.where(valid, from_camera.distance(points), end)
        strength = _strength(layout, from_camera, depth, (y - low) / (high - low), (high - low) * axes.sine)
        strength = strength if along == 0 else jnp.minimum(strength, float(_MAX_MARGIN / along))
    low, high, strength = _with_margin(low, high, strength, float(along))
    scale_y, offset_y = _window(low, high)

    center, _ = axes(from_light, frustum.eye)
    away = strength * (y - low) / (high - low)
    # As in `Warp`: x' = (x + w τ center) / (1 + w τ)
    least, most = _range((x + away * center) / (1 + away), valid, smallest)
    beyond = (most - least) * float(across)
    scale_x, offset_x = _window(least - beyond, most + beyond)
    return WarpedLight(
        light,
        camera.view(),
        end,
        axes.up,
        jnp.stack([scale_x, scale_y]),
        jnp.stack([offset_x, offset_y]),
        Warp(strength, scale_x * center + offset_x),
    )


def _strength(
    layout: PerspectiveWarp, camera: View, depth: Float[Array, " k"], height: Float[Array, " k"], rise: Scalar
) -> Scalar:
    """The strength w of the layout's method.

    **Arguments:**

    - `depth`, `height`: depth and height of the points that the map shows, along the camera's axis in world units, and
      in a map without a warp.
    - `rise`: z₁ - z₀, world units.
    """
    least = jnp.maximum(jnp.min(depth), camera.near)
    nearest = jnp.max(jnp.where(depth <= _NEARLY * least, height, 0))
    # z₁ / z₀ - 1
    growth = rise / least if camera.is_perspective else jnp.zeros_like(rise)
    match layout.method:
        case "lispsm":
            strength = jnp.sqrt(1 + growth) - 1
        case "perspective":
            strength = growth
        case "trapezoidal":
            # The share s = (1 + w) τ / (1 + w τ) at τ = focus.
            strength = (_FOCUS_SHARE - layout.focus) / ((1 - _FOCUS_SHARE) * layout.focus)
            strength = jnp.clip(strength, 0, growth)
    # A texel's height (1 + w τ)² / (1 + w) has its minimum at w = 1 / τ - 2.
    is_below = nearest < 0.5
    most = jnp.where(is_below, 1 / jnp.where(is_below, jnp.maximum(nearest, _LOWEST), 1) - 2, 0)
    return jnp.minimum(strength, most)


def _with_margin(low: Scalar, high: Scalar, strength: Scalar, margin: float) -> tuple[Scalar, Scalar, Scalar]:
    """The range from `low` to `high` and the strength of its warp, with a margin at each end.

    **Arguments:**

    - `margin`: as a fraction of the height that the range has in the map.
    """
    length = high - low
    # The positions where s is -margin and 1 + margin. At s = 1 + 1 / w, the map would extend to infinity.
    before = length * margin / (1 + strength * (1 + margin))
    is_strong = strength * margin > _MAX_MARGIN
    margin_after = jnp.where(is_strong, _MAX_MARGIN / jnp.where(is_strong, strength, 1), margin)
    after = length * margin_after * (1 + strength) / (1 - strength * margin_after)
    whole = length + before + after
    # The centre of projection, length / strength below the range, does not move.
    return low - before, high + after, strength * (whole / length) / (1 - strength * before / length)


def _window(low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
    """Scale and offset that map `low` to -1 and `high` to 1."""
    half = (high - low) / 2
    return 1 / half, -(low + high) / 2 / half


def _range(values: Float[Array, " k"], valid: Bool[Array, " k"], least: Scalar) -> tuple[Scalar, Scalar]:
    """The minimum and maximum of the valid values, at least `least` on each side of their middle."""
    low, high = jnp.min(jnp.where(valid, values, jnp.inf)), jnp.max(jnp.where(valid, values, -jnp.inf))
    middle, half = (low + high) / 2, (high - low) / 2
    narrow = half < least
    return jnp.where(narrow, middle - least, low), jnp.where(narrow, middle + least, high)


def _common_points(light: View, camera: View, frustum: ViewFrustum) -> tuple[Float[Array, "k 3"], Bool[Array, " k"]]:
    """The corners of the camera's view, between its near and far, within the light's frustum. All points count if there
    are none.

    Each corner of the intersection of two convex bodies is an end of an edge of one body, clipped by the other.
    """
    of_camera = frustum.corners_at(jnp.stack([camera.near, camera.far])).reshape(8, 3)[_EDGES]
    of_light = ViewFrustum.of(light).corners_at(jnp.stack([light.near, light.far])).reshape(8, 3)[_EDGES]
    parts = (
        _cut(of_camera, _to_planes(light, of_camera)),
        _cut(of_light, _to_planes(camera, of_light)),
    )
    points, valid = (jnp.concatenate(each) for each in zip(*parts, strict=True))
    return points.reshape(-1, 3), jnp.repeat(valid | ~jnp.any(valid), 2)


def _to_planes(view: View, points: Float[Array, "*n 3"]) -> Float[Array, "*n 6"]:
    """The distance of `points` inside the planes of a view's frustum. It is linear along lines."""
    clip, depth = view.clip(points), view.distance(points)
    x, y, w = clip[..., 0], clip[..., 1], clip[..., 3]
    return jnp.stack([w + x, w - x, w + y, w - y, depth - view.near, view.far - depth], axis=-1)


def _cut(
    edges: Float[Array, "e 2 3"], inside: Float[Array, "e 2 p"]
) -> tuple[Float[Array, "e 2 3"], Bool[Array, " e"]]:
    """The parts of `edges` within planes (Cyrus & Beck 1978), and whether each edge has such a part.

    **Arguments:**

    - `inside`: the distances of the two ends inside each plane, negative outside.
    """
    first, second = inside[:, 0], inside[:, 1]
    crossing = safe_divide(first, first - second)
    begin = jnp.max(jnp.where(first < 0, crossing, 0), axis=-1)
    end = jnp.min(jnp.where(second < 0, crossing, 1), axis=-1)
    valid = (begin <= end) & jnp.all((first >= 0) | (second >= 0), axis=-1)
    share = jnp.clip(jnp.stack([begin, end], axis=-1), 0, 1)[..., None]
    return edges[:, :1] + share * (edges[:, 1:] - edges[:, :1]), valid
