"""What the engines' shadows have in common."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._checks import check_instance, check_value
from ..._misc import dot, normalize
from ..._types import Mask, Resolution, Scalar
from ...geometry import AbstractLight, DirectionalLight, MatrixLight, PointLight, Scene, SpotLight, View
from ...raster import Surface
from ...settings import maps
from ...settings.engines import Side
from .._compare import AbstractCompare
from .._technique import AbstractTechnique
from ._engine_map import Casters, EngineMap, map_of, per_face


class Place(eqx.Module):
    """Where receivers lie in the light's window.

    - `u`, `v`, `z`: (h, w), window coordinates from 0 to 1; z is the depth. u runs to the left if the map is mirrored.
    - `ahead`: (h, w), whether they are in front of the light; elsewhere the others are meaningless.
    - `depth_per_texel`: (h, w), window depth per width of a texel, the unit of a soft compare.
    """

    u: Float[Array, "h w"]
    v: Float[Array, "h w"]
    z: Float[Array, "h w"]
    ahead: Bool[Array, "h w"]
    depth_per_texel: Float[Array, "h w"]

    @classmethod
    def of(
        cls, points: Float[Array, "h w 3"], view: View, resolution: Resolution, is_mirrored: bool = False
    ) -> "Place":
        """Of `points` (h, w, 3), world units."""
        clip = view.clip(points)
        ahead = clip[..., 3] > 0
        w = jnp.where(ahead, clip[..., 3], 1)
        across = -0.5 if is_mirrored else 0.5
        u, v, z = (clip[..., k] / w * half + 0.5 for k, half in enumerate((across, 0.5, 0.5)))
        distance = jnp.maximum(view.distance(points), view.near) if view.is_perspective else view.distance(points)
        per_texel = view.texel_size(distance, resolution) * view.depth_slope(distance)
        return cls(u, v, z, ahead, per_texel)

    @property
    def in_window(self) -> Bool[Array, "h w"]:
        """Whether u and v are from 0 to 1, in front of the light."""
        return self.ahead & (self.u >= 0) & (self.u <= 1) & (self.v >= 0) & (self.v <= 1)


class AbstractEngineShadows(AbstractTechnique):
    """Shadows of a real-time engine, as it draws them.

    - `compare`: how depths are compared; the hard compare is the engine's own.
    - `resolution`: of the map, (height, width) in texels.
    - `subpixels`: steps to a texel at whole numbers of which the engine's rasterizer places vertices. 256 is what most
        graphics hardware does, 16 what Chromium's software rasterizer does.
    """

    compare: eqx.AbstractVar[AbstractCompare]
    resolution: eqx.AbstractVar[Resolution]
    subpixels: eqx.AbstractVar[int]

    def _check_rules(self):
        check_value(f"{type(self).__name__}.resolution", self.resolution, maps.ShadowMap.each()["resolution"])
        check_instance("the compare", self.compare, AbstractCompare, "a compare, such as HardCompare()")

    def lays_out(self, name: str) -> bool:
        """Whether the number at the dotted path `name` changes the map."""
        return False

    def drawn(
        self,
        scene: Scene,
        light: AbstractLight,
        sides: Sequence[Side],
        offset: Sequence[float],
        casts: Sequence[bool],
        is_mirrored: bool = False,
        push: Scalar | float = 0.0,
    ) -> EngineMap:
        """The map of `light`.

        **Arguments:**

        - `light`: as `engine_light` returns it.
        - `sides`: for each mesh, which of its faces cast.
        - `offset`: for each mesh, the factor of its normal bias.
        - `casts`: for each mesh, whether it casts.
        - `is_mirrored`, `push`: see `map_of`.
        """
        chosen = [(mesh, side) for mesh, side, does in zip(scene.meshes, sides, casts, strict=True) if does]
        casters = Casters.of(*zip(*chosen, strict=True))
        receives = [True] * len(scene.meshes) if scene.receives is None else scene.receives
        depth = map_of(casters, light, self.resolution, self.subpixels, is_mirrored, push)
        return EngineMap(depth, light, per_face(offset, scene), per_face(receives, scene))

    def covered(self, state: EngineMap, surface: Surface) -> Mask:
        """Pixels that the engine's shadow decides, (h, w): those that see a receiver within the light's frustum, on a
        face turned to the light. Faces turned away are dark in the engine's picture, whatever their shadow."""
        return _covered(state, surface)


@eqx.filter_jit
def _covered(state: EngineMap, surface: Surface) -> Mask:
    _, receives = state.of_pixels(surface)
    turned = dot(surface.normal, normalize(state.light.towards(surface.position))) > 0
    return receives & turned & within(state, surface)


def within(state: EngineMap, surface: Surface) -> Mask:
    """Pixels whose surface lies within the light's frustum, (h, w)."""
    if isinstance(state.light, PointLight):
        along = jnp.max(jnp.abs(surface.position - state.light.position), axis=-1)
        return (along >= state.light.near) & (along <= state.light.far)
    place = Place.of(surface.position, state.light.view(), state.resolution)
    return place.in_window & (place.z >= 0) & (place.z <= 1)


def engine_light(light: AbstractLight, nudge: float) -> AbstractLight:
    """`light` with the axes that an engine's camera at its place has, whose up direction is +y.

    **Arguments:**

    - `nudge`: what the engine adds to the z of the axis towards the light if the light looks straight up or down.

    **Raises** `ValueError` for an area light.
    """
    if isinstance(light, PointLight | MatrixLight):
        return light
    if not isinstance(light, DirectionalLight | SpotLight):
        raise ValueError(
            f"the light is a {type(light).__name__}; expected a directional, spot, point or matrix light, as in engines"
        )
    view = light.view()
    matrix = np.asarray(view.world_to_eye, np.float64)
    eye, backward = -matrix[:3, :3].T @ matrix[:3, 3], matrix[2, :3].copy()
    if np.hypot(backward[0], backward[2]) < 1e-9:
        backward[2] += nudge
    backward /= np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    rows = np.stack([right, np.cross(backward, right), backward])
    upright = np.eye(4)
    upright[:3, :3], upright[:3, 3] = rows, -rows @ eye
    return MatrixLight(upright, view.eye_to_clip, view.is_perspective)
