"""Images of a technique's intermediate results. This module loads Matplotlib, so it is imported at a run's end only."""

from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm
from matplotlib.ticker import MaxNLocator

from ... import geometry, metrics, raster, shadow
from ..._types import HostArray
from ...config import Config
from .. import style
from .._drawn import Drawn
from ..pages import _figures as figures
from ..pages._colours import colours_of, tinted
from ._measure import shade_lit
from ._setup import visibility_of

# Number of neighbouring pixels whose patterns are shown separately.
_FEW = 3
# The colours of extents end at 2 to this power, and its reciprocal.
_MAX_LOG = 4
# Higher counts of volumes all have the last colour.
_MAX_COLOURS = 12


def write_debug(folder: Path, end: str, config: Config, technique: shadow.AbstractTechnique, drawn: Drawn) -> None:
    """Writes all images that apply to `technique` for one light; their names end in `end`."""
    image = shade_lit(config, drawn.surface, [drawn.scene], [visibility_of(technique, drawn)])
    _write_silhouettes(folder / f"debug_silhouettes{end}.png", image, drawn)
    if isinstance(technique, shadow.ShadowVolumes):
        _write_counts(folder / f"debug_volumes{end}.png", technique, drawn)
    if not isinstance(technique, shadow.ShadowMapping):
        return
    _write_depths(folder / f"debug_depth{end}.png", technique, drawn.state)
    _write_aliasing(folder / f"debug_aliasing{end}.png", technique, drawn)
    layers = technique.layout.layer_figure(drawn.state.light, drawn.surface)
    if layers is not None:
        _write_layers(folder / f"debug_{layers.name}{end}.png", image, layers)
    if isinstance(technique.filter, shadow.PercentageCloserSoft):
        _write_blockers(folder / f"debug_blockers{end}.png", technique, drawn.state, drawn)
    pattern = getattr(technique.filter, "pattern", None)
    if isinstance(pattern, shadow.Pattern):
        _write_pattern(folder / f"debug_pattern{end}.png", pattern)


def _write_depths(path: Path, technique: shadow.ShadowMapping, shadow_map: shadow.ShadowMap) -> None:
    """The map's window depths, scaled to their range, since a perspective view's depths are all close to 1."""
    depth = np.asarray(shadow_map.depth)
    seen = depth[depth < 1]
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 1.0)
    high, shown = max(high, low + 1e-6), np.where(depth < 1, depth, np.nan)
    layers = figures.map_figure(technique, shadow_map)
    figures.write_map(path, "Window depth", shown, "window depth (0 near, 1 far)", layers, vmin=low, vmax=high)


def _write_aliasing(path: Path, technique: shadow.ShadowMapping, drawn: Drawn) -> None:
    """How large texels are on the screen, and which part of it is due to perspective."""
    found = technique.aliasing(drawn.state, drawn.surface, drawn.scene.camera)
    mask = np.asarray(found.mask)
    height, width = mask.shape
    panel = 4.0
    figure, axes = style.figure(2 * panel + 1.6, panel * height / width + 0.6, 1, 2)
    images = (
        ("Longest extent of a texel", found.extent),
        ("The same, due to perspective", found.perspective_extent),
    )
    picture = None
    for one, (title, extent) in zip(axes, images, strict=True):
        one.set_facecolor(style.NO_SURFACE)
        shown = np.where(mask, np.log2(np.maximum(np.asarray(extent), 1e-6)), np.nan)
        picture = style.picture(one, shown, cmap="RdBu_r", vmin=-_MAX_LOG, vmax=_MAX_LOG)
        figures_of = metrics.measure_aliasing(extent, mask) if mask.any() else None
        below = "" if figures_of is None else f"99 % at most {figures_of.percentile_99:.3g} pixels"
        style.title(one, title, below)
    label = "pixels to a texel: 1 is matched, more is undersampled"
    bar = style.colour_bar(figure, picture, axes, label, extend="both")
    ticks = range(-_MAX_LOG, _MAX_LOG + 1)
    bar.set_ticks(list(ticks), labels=[f"{2.0**tick:g}" for tick in ticks])
    style.save(figure, path)


def _write_layers(path: Path, image: Float[HostArray, "h w 3"], layers: shadow.LayerFigure) -> None:
    """Which layers of the map the camera's image is looked up in, in colours."""
    height, width = image.shape[:2]
    figure, axes = figures.single(image[..., 0])
    style.picture(axes, tinted(image, layers), extent=(0, width, 0, height))
    for number, label in layers.labels.items():
        axes.plot([], [], color=colours_of(np.asarray(number)), linewidth=5, label=label)
    style.legend(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    style.title(axes, layers.title, layers.subtitle)
    style.save(figure, path)


def _write_silhouettes(path: Path, image: Float[HostArray, "h w 3"], drawn: Drawn) -> None:
    """The casters' silhouettes as the light sees them, drawn over the camera's image."""
    height, width = image.shape[:2]
    lines = _silhouettes(drawn.scene)
    figure, axes = figures.single(image[..., 0])
    style.picture(axes, image, extent=(0, width, 0, height))
    axes.add_collection(LineCollection(list(lines), colors=style.VERMILION, linewidths=0.9))
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    style.title(axes, "Silhouettes seen from the light", f"{len(lines)} edges, including those hidden from the camera")
    style.save(figure, path)


def _silhouettes(scene: geometry.Scene) -> Float[HostArray, "n 2 2"]:
    """The ends of every silhouette edge that is in front of the camera, in pixels."""
    casters = scene.casters
    edges = geometry.Edges.of(casters)
    found = raster.silhouettes_by_adjacency(edges, raster.light_sides(casters, scene.light))
    ends = np.asarray(found.vertices)[np.asarray(found.multiplicity) != 0]
    clip = np.asarray(scene.camera.view().clip(casters.vertices), np.float64)[ends]
    clip = clip[(clip[..., 2] > -clip[..., 3]).all(axis=1)]
    return (clip[..., :2] / clip[..., 3:] * 0.5 + 0.5) * np.asarray(scene.camera.resolution[::-1])


def _write_counts(path: Path, technique: shadow.ShadowVolumes, drawn: Drawn) -> None:
    """How many shadow volumes each surface point lies in."""
    counts = np.asarray(technique.counts(drawn.state))
    shown = np.where(np.asarray(drawn.surface.mask), counts, np.nan).astype(np.float64)
    figure, axes = figures.single(shown)
    axes.set_facecolor(style.NO_SURFACE)
    low, high = _range(counts[np.asarray(drawn.surface.mask)])
    bounds = np.arange(low, high + 2) - 0.5
    extend = "max" if counts.max() > high else "neither"
    picture = style.picture(axes, shown, cmap=style.DISTANCE, norm=BoundaryNorm(bounds, 256, extend=extend))
    style.title(
        axes, f"Shadow volumes, by {technique.method.replace('_', '-')}", f"counts from {low} to {counts.max()}"
    )
    bar = style.colour_bar(figure, picture, [axes], "volumes around the surface point; 0 is lit")
    bar.locator = MaxNLocator(integer=True)
    bar.update_ticks()
    style.save(figure, path)


def _range(counts: Int[HostArray, " n"]) -> tuple[int, int]:
    low = min(int(counts.min(initial=0)), 0)
    return low, min(max(int(counts.max(initial=1)), 1), low + _MAX_COLOURS)


def _write_blockers(path: Path, technique: shadow.ShadowMapping, shadow_map: shadow.ShadowMap, drawn: Drawn) -> None:
    """The blocker search of soft shadows: distance of the blockers, and width of the penumbra."""
    found = _find_blockers(technique, shadow_map, drawn.surface)
    blocked = np.asarray(found.some & drawn.surface.mask)
    distance = shadow_map.view.eye_depth(found.depth)
    # Where texels are not square, the geometric mean.
    radius = np.sqrt(np.asarray(found.radius[0]) * np.asarray(found.radius[1]))
    height, width = blocked.shape
    panel = 4.0
    figure, axes = style.figure(2 * panel + 1.6, panel * height / width + 0.6, 1, 2)
    images = (
        ("Mean distance of blockers", distance, style.DISTANCE, "from the light, along its axis [world units]"),
        ("Half width of the penumbra", radius, "viridis", "radius of the filter [texels]"),
    )
    for one, (title, image, colours, label) in zip(axes, images, strict=True):
        one.set_facecolor(style.NO_SURFACE)
        picture = style.picture(one, np.where(blocked, np.asarray(image), np.nan), cmap=colours)
        style.title(one, title, "" if blocked.any() else "the search found no blockers")
        style.colour_bar(figure, picture, [one], label)
    style.save(figure, path)


@eqx.filter_jit
def _find_blockers(technique: shadow.ShadowMapping, shadow_map: shadow.ShadowMap, surface: raster.Surface) -> Any:
    assert isinstance(technique.filter, shadow.PercentageCloserSoft)
    at = shadow.receiver(shadow_map, surface)
    lookup = shadow.look_up(shadow_map, at, technique.bias(at))
    return technique.filter.find_blockers(shadow_map, lookup, technique.compare)


def _write_pattern(path: Path, pattern: shadow.Pattern) -> None:
    """Positions of the taps: of a few neighbouring pixels, and of all pixels of a tile together."""
    offsets = np.asarray(pattern.offsets)
    size = offsets.shape[1]
    sets = [(f"Pixel ({x}, 0)", offsets[:, 0, x]) for x in range(min(_FEW, size))]
    if size > 1:
        sets.append((f"{size} × {size} pixels", offsets.reshape(-1, 2)))
    figure, axes = style.figure(2.5 * len(sets) + 0.9, 2.9, 1, len(sets), sharex=True, sharey=True)
    dots = None
    for one, (title, points) in zip(axes, sets, strict=True):
        order = 1 + np.repeat(np.arange(pattern.samples), len(points) // pattern.samples)
        _disk(one)
        dots = one.scatter(*points.T, c=order, cmap="viridis", s=14 if len(points) == pattern.samples else 2)
        style.title(one, f"{title}: {len(points)} taps")
    axes[0].set_ylabel("offset [filter radii]", fontsize=8.5, color=style.INK)
    bar = style.colour_bar(figure, dots, axes, "tap, in order" + (", before the pixel's rotation" * pattern.rotated))
    bar.locator = MaxNLocator(6, integer=True, min_n_ticks=1)
    bar.update_ticks()
    style.save(figure, path)


def _disk(axes: style.Axes) -> None:
    """The unit disk, whose radius is the filter's."""
    style.chart(axes, "offset [filter radii]", "")
    style.frame(axes)
    axes.grid(False)
    angle = np.linspace(0, 2 * np.pi, 128)
    axes.plot(np.cos(angle), np.sin(angle), color=style.FAINT, linewidth=0.8)
    axes.set_aspect("equal")
    axes.set_xticks([-1, 0, 1])
    axes.set_yticks([-1, 0, 1])
