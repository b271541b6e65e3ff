"""Shadow mapping: from a map and a surface to visibility."""

import dataclasses
import math
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._arithmetic import in_unit_range, is_traced
from .._checks import check_instance
from .._types import Mask, Visibility
from ..geometry import AbstractCamera, AbstractLight, Edges, Scene
from ..raster import Cull, Surface, draw_surface
from ._aliasing import Aliasing, aliasing
from ._compare import AbstractCompare, HardCompare
from ._draw_map import MapPlan, MapSettings, plan_crossings
from ._lookup import Lookup, look_up, within_frustum
from ._map import ShadowMap
from ._receiver import receiver
from ._technique import AbstractTechnique, Side, of_casters
from .biases import AbstractBias
from .filters import AbstractFilter
from .layouts import AbstractLayout, SingleMap

# A texel position so far outside the map that no filter reaches the map.
_NOWHERE = -1e6
# The faces that remain with each `MapSettings.cull`.
_LEFT: Mapping[Cull, Side] = {"none": "double", "back": "front", "front": "back"}


class ShadowMapping(AbstractTechnique):
    """Shadow mapping (Williams 1978).

    - `filter`: the positions and the weights of the taps.
    - `bias`: keeps surfaces from shadowing themselves (acne).
    - `compare`: how depths are compared.
    - `map`: how the map is drawn.
    - `layout`: how the map's texels are laid out over the scene.

    **Raises** `ValueError` if the filter and the bias read further than the layout's margin, and `TypeError` for parts
    of another kind.

    !!! Example

        ```python
        settings = shadow.MapSettings((64, 64))
        technique = shadow.ShadowMapping(shadow.PercentageCloser(2.5), shadow.Bias(1.0), map=settings)
        state = technique.prepare(scene)  # a ShadowMap, which no bias and no filter changes
        technique.visibility(state, surface).shape  # (32, 32)
        ```
    """

    filter: AbstractFilter
    bias: AbstractBias
    compare: AbstractCompare = HardCompare()
    map: MapSettings = eqx.field(static=True, default=MapSettings())
    layout: AbstractLayout = SingleMap()

    def __check_init__(self):
        check_instance("the filter", self.filter, AbstractFilter, "a filter, such as RandomDisk(2.0)")
        check_instance("the bias", self.bias, AbstractBias, "a bias, such as Bias(constant=1.0)")
        check_instance("the compare", self.compare, AbstractCompare, "a compare, such as HardCompare()")
        check_instance("the map", self.map, MapSettings, "MapSettings, such as MapSettings((512, 512))")
        check_instance("the layout", self.layout, AbstractLayout, "a layout, such as SingleMap()")
        if self.reach is not None:
            self.layout.check_reach(self.reach)

    @property
    def reach(self) -> float | None:
        """The distance from a receiver to the farthest texel that is read, in texels, including the normal offset.
        `None` if unknown."""
        return None if self.filter.reach is None else self.filter.reach + self.bias.reach

    @property
    def layers(self) -> MapSettings:
        """`map` with the resolution of a layer of the layout."""
        return dataclasses.replace(self.map, resolution=self.layout.layer_resolution(self.map.resolution))

    def plan(
        self, scene: Scene, surface: Surface | None = None, *, margin: float = 2.0, raises: bool = True
    ) -> MapPlan:
        """The plan for `prepare` inside `jax.jit`, for scenes with the same faces, which may move or be lit by other
        lights.

        **Arguments:**

        - `surface`: as for `prepare`.
        - `margin`: the memory, as a multiple of the memory for the silhouettes of this scene.
        - `raises`: whether a map with more silhouettes is an error. If not, `ShadowMap.overflow` says whether a map has
          more.

        **Raises** `ValueError` inside `jax.jit`, and the errors of the layout.
        """
        if not self.map.silhouettes:
            return MapPlan()
        casters, light = scene.casters, self.light_of_map(scene, surface)
        edges = Edges.of(casters)
        crossings = plan_crossings(casters, light, self.layers.resolution, edges)
        return MapPlan(edges, math.ceil(margin * crossings), raises)

    def prepare(self, scene: Scene, surface: Surface | None = None, plan: MapPlan | None = None) -> ShadowMap:
        """The shadow map of the scene's casters under its only light.

        It depends on `surface` only if the layout does.

        **Arguments:**

        - `plan`: the result of `plan`, computed outside. Required inside `jax.jit`, `grad` or `vmap` for a map with
          silhouettes. **Raises** the errors of `draw_shadow_map` and of the layout, and `ValueError` if a required plan
          is missing.
        """
        if self.map.silhouettes and plan is None and is_traced(scene):
            raise ValueError(
                "ShadowMapping.prepare was called inside jax.jit (or grad, or vmap) for a map with silhouettes, and no "
                "plan was given; expected one: call plan = technique.plan(scene) outside, and "
                "prepare(scene, plan=plan) inside"
            )
        if plan is not None and (plan.edges is not None) != bool(self.map.silhouettes):
            raise ValueError(
                f"the plan has {'no edges' if plan.edges is None else 'edges'}, and map.silhouettes is "
                f"{self.map.silhouettes}; expected a plan for this map: make it with technique.plan(scene)"
            )
        casters, light = scene.casters, self.light_of_map(scene, surface)
        plan = MapPlan(Edges.of(casters) if self.map.silhouettes else None) if plan is None else plan
        return self.layers.draw(casters, light, edges=plan.edges, crossings=plan.crossings, raises=plan.raises)

    def light_of_map(self, scene: Scene, surface: Surface | None = None) -> AbstractLight:
        """The light that the map is drawn from: the scene's only light, with the views of the layout.

        **Arguments:**

        - `surface`: as for `prepare`.

        **Raises** the errors of the layout.
        """
        if self.layout.needs_surface and surface is None:
            surface = draw_surface(scene.mesh, scene.camera)
        return self.layout.light(scene.light, scene.camera, self.map.resolution, surface)

    def visibility(self, state: ShadowMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        A receiver outside the map or beyond its far plane is lit. A surface that faces away from the light's centre is
        dark. Pixels without a surface are lit.
        """
        return _visibility(self.layout, self.filter, self.bias, self.compare, state, surface)

    def covered(self, state: ShadowMap, surface: Surface) -> Mask:
        """Pixels whose surface is within the light's frustum, (h, w). The map covers them."""
        return _covered(self.layout, self.bias, state, surface)

    def shift(self, state: ShadowMap, surface: Surface) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
        """The distance by which the bias moves the surface at each pixel along the light's axis, (h, w), 0 outside the
        map; and the width of a texel there, (h, w). Both are in world units."""
        return _shift(self.layout, self.bias, state, surface)

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        return of_casters([_LEFT[self.map.cull] for _ in scene.meshes], scene)

    def lays_out(self, name: str) -> bool:
        """Whether the number at the dotted path `name` lays out the map."""
        part, _, number = name.partition(".")
        return part == "layout" and number not in self.layout.differentiable

    def aliasing(self, state: ShadowMap, surface: Surface, camera: AbstractCamera) -> Aliasing:
        """The size of the map's texels on the screen of `camera`, which sees `surface`."""
        return _aliasing(self.layout, state, surface, camera)


@eqx.filter_jit
def _aliasing(layout: AbstractLayout, shadow_map: ShadowMap, surface: Surface, camera: AbstractCamera) -> Aliasing:
    return aliasing(shadow_map, surface, camera, layout.choose(shadow_map.light, surface.position))


# These take no map settings, so the compiled programs do not depend on them.
@eqx.filter_jit
def _visibility(
    layout: AbstractLayout,
    filter: AbstractFilter,
    bias: AbstractBias,
    compare: AbstractCompare,
    shadow_map: ShadowMap,
    surface: Surface,
) -> Visibility:
    layer, other, weight, strength = layout.choose(shadow_map.light, surface.position)

    def visibility_in(layer: Int[Array, "h w"] | None) -> tuple[Visibility, Mask]:
        lookup, cosine = _look_up(bias, shadow_map, surface, layer)
        faces_away = surface.mask & ~(cosine > 0)
        active = surface.mask & lookup.inside & ~faces_away
        # Inactive pixels look far outside the map, where no work is done.
        place = lambda lookup: (lookup.x, lookup.y)
        lookup = eqx.tree_at(place, lookup, [jnp.where(active, at, _NOWHERE) for at in place(lookup)])
        # Without the barrier, XLA recomputes the projection for every tap. There is one barrier per array, so that
        # arrays without a derivative do not get one.
        lookup = jax.tree.map(lax.optimization_barrier, lookup)
        lit = in_unit_range(filter(shadow_map, lookup, compare))
        return jnp.where(active, lit, 1), faces_away

    if layer is None or other is None or weight is None:
        lit, faces_away = visibility_in(layer)
    else:
        # A loop, so that the filter is compiled once.
        both, (faces_away, _) = lax.map(visibility_in, jnp.stack([layer, other]))
        lit = both[1] + weight * (both[0] - both[1])
    if strength is not None:
        lit = 1 - strength * (1 - lit)
    return jnp.where(faces_away, 0, lit)


@eqx.filter_jit
def _covered(layout: AbstractLayout, bias: AbstractBias, shadow_map: ShadowMap, surface: Surface) -> Mask:
    choice = layout.choose(shadow_map.light, surface.position)
    lookup, _ = _look_up(bias, shadow_map, surface, choice.layer)
    covered = surface.mask & within_frustum(lookup, shadow_map)
    return covered if choice.strength is None else covered & (choice.strength > 0)


@eqx.filter_jit
def _shift(
    layout: AbstractLayout, bias: AbstractBias, shadow_map: ShadowMap, surface: Surface
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    at = receiver(shadow_map, surface, layout.choose(shadow_map.light, surface.position).layer)
    terms, view = bias(at), shadow_map.view.facing(at.layer)
    shift = terms.depth * at.texel_size / at.depth_per_texel
    if terms.displacement is not None:
        shift = shift + view.distance(at.position) - view.distance(at.position + terms.displacement)
    inside = within_frustum(look_up(shadow_map, at, terms), shadow_map)
    return jnp.where(surface.mask & inside, shift, 0), at.texel_size


@eqx.filter_checkpoint
def _look_up(
    bias: AbstractBias, shadow_map: ShadowMap, surface: Surface, layer: Int[Array, "h w"] | None
) -> tuple[Lookup, Visibility]:
    # Reverse mode recomputes this, which is faster than storing residuals for every pixel.
    at = receiver(shadow_map, surface, layer)
    return look_up(shadow_map, at, bias(at)), at.cosine
