"""Resolution-matched shadow maps (Lefohn, Sengupta & Owens, "Resolution-Matched Shadow Maps", ACM TOG 26(4), 2007)."""

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from ..._arithmetic import as_float, as_number, dot, normalize
from ..._types import AsOptional, AsScalar, Mask, Resolution, Scalar
from ..._words import counted
from ...geometry import AbstractCamera, AbstractLight, Pages, cell_of, finest_of, side_of
from ...raster import Surface
from ...settings.techniques import MAX_ACROSS, MAX_LEVEL_BIAS, LevelNorm
from ...settings.techniques import ResolutionMatched as Settings
from .._jacobian import determinant, pixels_of, pixels_per_texel, singular_values
from ._abstract import Choice
from ._figures import LayerFigure, MapFigure
from ._fitted import AbstractFittedLayout, margin_of
from ._paged_light import PagedLight

# The fraction of a level by which the bias is raised until all pages fit.
_STEPS = 16
# Extents on the screen, in pixels, below which surfaces count as seen edge-on.
_MIN_EXTENT = 1e-12
# The share of points at too coarse a level that causes a remark.
_MANY = 0.01


class ResolutionMatched(AbstractFittedLayout):
    """A virtual shadow map for a directional light: only the pages that the camera's surface needs are drawn.

    The light's own map exists at several levels of resolution. Each point of the surface requests its page at the level
    where a texel is as large as a pixel. Let J be the motion of the point on the screen, in pixels, if it moves by a
    texel of level 0 along the map's axes. The level is `floor(-log₂ e)`, with e the greater singular value of J, or the
    root of its determinant. Adaptive shadow maps (Fernando, Fernandez, Bala & Greenberg 2001) find pages by iteration
    instead, and virtual shadow maps keep them from one image to the next.

    The map's `resolution` is the number of texels in memory, including gutters. If the requested pages have more
    texels, all levels are raised by the same bias, in steps of 1/16, until the pages fit (`PagedLight.raised`). Every
    part of the scene then still has a page, but texels get larger, and shadows narrower than a texel may be lost. At
    the limit, only the root is resident: a plain map with as many texels as a page.

    A point is looked up in the finest resident page that contains it. This is the page that the point requested, or a
    finer page that another point requested. Pages in which no point is looked up are not drawn. Points that the camera
    does not see are looked up in the same way, in the root if no other page contains them.

    Biases and radii of filters are in texels of the page. Shadows are therefore as sharp as the screen everywhere, and
    the width of filters changes with the level. A page is drawn with a gutter, so that filters meet no seam. A map with
    silhouettes cannot be resolution-matched.

    - `page`: side of a page, in texels, without its gutter; a power of two from 16 to 1024.
    - `finest`: side of the light's whole map at level 0, in texels; a power of two, at most 65536, and from 2 to 1024
        pages. Points that need a finer level are looked up at level 0.
    - `norm`: `"area"` matches the area of a texel to a pixel's area, `"worst"` matches the longest extent to a pixel's
      side, so that nothing is undersampled. It needs more texels.
    - `level_bias`: added to all levels before they are rounded down, -16 to 16: -1 halves the side of a texel on the
        screen. It is raised if pages do not fit, so a low value fills the available memory.
    - `shadow_distance`: the depth along the camera's axis, in world units, beyond which nothing is shadowed; `None` for
        the camera's far.
    - `margin`: the width of the gutter in texels, rounded up, at most half of `page`: at least the greatest radius of
        the filter, plus half a texel if its look-ups are bilinear, plus any normal offset.
    """

    settings: ClassVar = Settings

    page: int = eqx.field(static=True, default=Settings.page)
    finest: int = eqx.field(static=True, default=Settings.finest)
    norm: LevelNorm = eqx.field(static=True, default=Settings.norm, kw_only=True)
    level_bias: AsScalar = eqx.field(converter=as_number, default=Settings.level_bias, kw_only=True)
    shadow_distance: AsOptional = eqx.field(converter=as_number, default=Settings.shadow_distance, kw_only=True)
    margin: float = eqx.field(static=True, converter=margin_of, default=Settings.margin, kw_only=True)

    def _check_rules(self):
        for name, value in (("page", self.page), ("finest", self.finest)):
            if value & (value - 1):
                raise ValueError(f"ResolutionMatched.{name} is {value}; expected a power of two")
        if not 2 <= self.finest / self.page <= MAX_ACROSS:
            raise ValueError(
                f"ResolutionMatched.finest is {self.finest}, and pages are {self.page} texels wide; expected 2 to "
                f"{MAX_ACROSS} pages"
            )
        if not self.margin <= self.page // 2:
            raise ValueError(
                f"the pages' margin is {self.margin:g}, and pages are {self.page} texels wide; expected at most half "
                "of that: enlarge page, or lower margin"
            )

    @property
    def levels(self) -> int:
        """The number of levels."""
        return (self.finest // self.page).bit_length()

    @property
    def gutter(self) -> int:
        """The width of the gutter, in texels."""
        return math.ceil(self.margin)

    def layer_resolution(self, resolution: Resolution) -> Resolution:
        side = side_of(self.page, self.gutter)
        return side, side

    def capacity(self, resolution: Resolution) -> int:
        """The number of pages with gutters that fit into a map of `resolution`.

        **Raises** `ValueError` if there is no space for a page.
        """
        (height, width), side = resolution, side_of(self.page, self.gutter)
        if height * width < side * side:
            raise ValueError(
                f"the shadow map has {resolution} texels, (height, width), and a page with its gutter has {side}²; "
                "expected at least one page: enlarge the map, or lower page"
            )
        return height * width // (side * side)

    @property
    def needs_surface(self) -> bool:
        return True

    def light(
        self,
        light: AbstractLight,
        camera: AbstractCamera,
        resolution: Resolution,
        surface: Surface | None = None,
    ) -> PagedLight:
        """`light` with the views of the pages; see `AbstractLayout.light`. `resolution` is the memory for pages.

        The views follow the light's direction, but which pages are resident has no gradient.

        **Raises** `ValueError` for a light that is not directional, a map of less than a page, no surface, or a shadow
        distance outside of the camera's depths.
        """
        self.check(light, camera, self.layer_resolution(resolution), surface)
        assert surface is not None
        return _paged_light(self, light, camera, self.capacity(resolution), surface)

    def choose(self, light: AbstractLight, points: Float[Array, "h w 3"]) -> Choice:
        assert isinstance(light, PagedLight)
        layer = light.layer(points)
        if self.shadow_distance is None:
            return Choice(layer)
        return Choice(layer, strength=jnp.where(light.depth(points) <= light.end, 1.0, 0.0))

    def map_figure(self, light: AbstractLight) -> MapFigure:
        assert isinstance(light, PagedLight)
        count = int(light.pages.count)
        return MapFigure(f"{counted(count, 'page')}, from fine to coarse", None, count)

    def layer_figure(self, light: AbstractLight, surface: Surface) -> LayerFigure:
        """The level of each page as a colour. Neighbouring pages are slightly lighter or darker."""
        assert isinstance(light, PagedLight)
        layer, _, _, strength = self.choose(light, surface.position)
        pages, shown = light.pages, surface.mask if strength is None else surface.mask & (strength > 0)
        level, row, column = (values[layer] for values in (pages.level, pages.row, pages.column))
        sizes = np.asarray(pages.size(jnp.arange(pages.levels)))
        return LayerFigure(
            "levels",
            "Levels",
            f"{counted(int(pages.count), 'page')} of {pages.page}² texels, bias {float(light.bias):.3g}",
            {i: f"{i}: {sizes[i]}²" for i in np.unique(np.asarray(level)[np.asarray(shown)]).tolist()},
            level,
            None,
            None,
            jnp.where((row + column) % 2 == 0, 1.0, 0.75),
            shown,
        )

    def remarks(self, light: AbstractLight) -> tuple[str, ...]:
        """Remarks if pages did not fit, so that texels are larger than pixels, or if the finest level is too coarse."""
        assert isinstance(light, PagedLight)
        raised, bias, coarse = float(light.raised), float(light.bias), float(light.too_coarse)
        found = []
        if raised > 0 and bias > 0:
            count = int(light.pages.count)
            fit = f"{count} pages fit" if count > 1 else f"one page of {self.layer_resolution((1, 1))[0]}² shows all"
            found.append(
                f"requests {int(light.requested)} pages, and the shadow map has memory for {light.capacity}: "
                f"level_bias was raised to {bias:.3g}, where {fit}; enlarge the map's resolution"
            )
        if coarse > _MANY:
            found.append(
                f"has too large texels in {coarse:.0%} of the pixels, which need a finer level than finest = "
                f"{self.finest}: enlarge it, or raise level_bias"
            )
        return tuple(found)


@eqx.filter_jit
def _paged_light(
    layout: ResolutionMatched, light: AbstractLight, camera: AbstractCamera, capacity: int, surface: Surface
) -> PagedLight:
    # The choice of resident pages has no derivative.
    fixed_light, camera, surface = lax.stop_gradient((light, camera, surface))
    end = camera.far if layout.shadow_distance is None else lax.stop_gradient(layout.shadow_distance)
    needed, needs = levels_needed(layout, fixed_light, camera, surface)
    needs = needs & (camera.view().distance(surface.position) <= end)
    levels, across = layout.levels, 1 << (layout.levels - 1)
    window = fixed_light.view().clip(surface.position)[..., :2] * 0.5 + 0.5
    column, row = (cell_of(window[..., k], levels) for k in range(2))
    # For points over the same page of level 0, the finest level counts, because all of them are looked up in its page.
    cell = jnp.where(needs, row * across + column, across * across)
    bounded = jnp.clip(needed, -levels, levels)
    cells = jnp.full(across * across, jnp.inf, bounded.dtype).at[cell].min(bounded, mode="drop")
    cells = cells.reshape(across, across)

    own_bias = lax.stop_gradient(layout.level_bias)
    # The first step of the bias at which all pages fit. At the last step, only the root is left.
    resident_at = lambda step: _resident(cells, own_bias + step.astype(cells.dtype) / _STEPS, levels)
    fits = lambda step: jnp.sum(resident_at(step), dtype=jnp.int32) <= capacity
    most = math.ceil((2 * levels + MAX_LEVEL_BIAS) * _STEPS)

    def halve(bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) // 2
        enough = fits(middle)
        return jnp.where(enough, low, middle + 1), jnp.where(enough, middle, high)

    requested = jnp.sum(resident_at(jnp.int32(0)), dtype=jnp.int32)
    # Usually, no step is needed.
    bounds = jnp.int32(0), jnp.where(requested <= capacity, 0, most).astype(jnp.int32)
    _, step = lax.while_loop(lambda bounds: bounds[0] < bounds[1], halve, bounds)
    pages = Pages.of(resident_at(step), layout.page, layout.gutter, levels, capacity)
    raised = as_float(step) / _STEPS
    bias = own_bias + raised
    beyond = jnp.sum(needs & (needed + bias < 0)) / jnp.maximum(jnp.sum(needs), 1)
    return PagedLight(
        light, camera.view(), as_float(end), pages, pages.finest(), requested, bias, raised, as_float(beyond)
    )


def levels_needed(
    layout: ResolutionMatched, light: AbstractLight, camera: AbstractCamera, surface: Surface
) -> tuple[Float[Array, "h w"], Mask]:
    """The level at which a texel is as large as a pixel, (h, w), as a real number without bounds; and the points of the
    surface that the map may shadow, because they face the light and are within its map."""
    view = light.view()
    # Pixels without a surface have no position on the screen.
    points = jnp.where(surface.mask[..., None], surface.position, camera.target)
    window = lambda points: view.clip(points)[..., :2] * 0.5 + 0.5
    texel = lambda points: window(points) * layout.finest
    jacobian = pixels_per_texel(pixels_of(camera), texel, points, surface.normal[None])[0]
    mean = lambda jacobian: jnp.sqrt(jnp.abs(determinant(jacobian)))
    extent = singular_values(jacobian)[0] if layout.norm == "worst" else mean(jacobian)
    at, to_light = window(points), normalize(light.towards(points))
    inside = (at[..., 0] >= 0) & (at[..., 1] >= 0) & (at[..., 0] <= 1) & (at[..., 1] <= 1)
    mask = surface.mask & inside & (dot(surface.normal, to_light) > 0)
    return -jnp.log2(jnp.maximum(extent, _MIN_EXTENT)), mask


def _resident(cells: Float[Array, "c c"], bias: Scalar, levels: int) -> Bool[Array, " n"]:
    """The resident pages of all levels: the root, and all pages that a point is looked up in.

    **Arguments:**

    - `cells`: the finest level that is needed in each page of level 0; infinite if none is needed.
    """
    root = levels - 1
    level = jnp.clip(jnp.floor(cells + bias), 0, root).astype(jnp.int32)
    row, column = jnp.indices(cells.shape, jnp.int32)
    # Cells that need no page request the root.
    number = Pages.number(levels, level, row >> level, column >> level)
    requested = jnp.zeros(Pages.total(levels), bool).at[number].set(True)
    numbers = jnp.arange(requested.shape[0], dtype=jnp.int32)
    found = finest_of(jnp.where(requested, numbers, -1), levels)
    found = jnp.where(cells < jnp.inf, found, numbers[-1])
    return jnp.zeros_like(requested).at[found].set(True).at[-1].set(True)
