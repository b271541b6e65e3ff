"""The figures of a run. This file loads Matplotlib, so only a run's end imports it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .. import shadow
from .._types import HostArray
from ..fit import FitResult
from . import _style as style
from ._techniques import FromLight

Image = Float[HostArray, "h w"]
Colours = Float[HostArray, "h w 3"]
Pixels = Bool[HostArray, "h w"]
# The ways that the views of a point light look.
_FACES = ("+x", "−x", "+y", "−y", "+z", "−z")


def write_comparison(
    path: Path, reference: Image, images: Sequence[tuple[str, Image, float]], shaded: tuple[str, Colours], mask: Pixels
) -> None:
    """The reference, each of `images` (its title, visibility and RMSE), and below each its signed difference."""
    height, width = reference.shape
    panel = 2.9
    columns = 1 + len(images)
    figure, axes = style.figure(panel * columns + 0.9, 2 * panel * height / width + 0.9, 2, columns)
    top, bottom = axes[:columns], axes[columns:]
    _visibility(top[0], reference, mask)
    style.title(top[0], "Reference")
    style.picture(bottom[0], shaded[1])
    style.title(bottom[0], shaded[0])
    for above, below, (title, image, error) in zip(top[1:], bottom[1:], images, strict=True):
        _visibility(above, image, mask)
        style.title(above, title, f"RMSE {error:.4f}")
        _difference(below, image, reference, mask)
        style.title(below, f"{title} − reference")
    style.colour_bar(figure, bottom[-1].images[0], bottom[1:], "visibility: too dark (−), too light (+)")
    style.save(figure, path)


def write_visibility(path: Path, title: str, image: Image, mask: Pixels) -> None:
    """A visibility image alone."""
    figure, axes = single(image)
    shown = _visibility(axes, image, mask)
    style.title(axes, title)
    style.colour_bar(figure, shown, [axes], "visibility, 1 lit")
    style.save(figure, path)


def write_difference(path: Path, image: Image, reference: Image, mask: Pixels) -> None:
    """A signed difference alone."""
    figure, axes = single(image)
    shown = _difference(axes, image, reference, mask)
    style.title(axes, "Visibility − reference")
    style.colour_bar(figure, shown, [axes], "visibility: too dark (−), too light (+)")
    style.save(figure, path)


def write_shaded(path: Path, images: Sequence[tuple[str, Colours]]) -> None:
    """Shaded images side by side."""
    height, width = images[0][1].shape[:2]
    panel = 4.2
    figure, axes = style.figure(panel * len(images), panel * height / width + 0.3, 1, len(images))
    for one, (title, image) in zip(axes, images, strict=True):
        style.picture(one, image)
        style.title(one, title)
    style.save(figure, path)


def write_from_light(folder: Path, end: str, from_light: FromLight) -> None:
    """What a technique drew from a light: its map or its texture; edges have no picture."""
    match from_light:
        case shadow.ShadowMap():
            write_shadow_map(folder / f"shadow_map{end}.png", from_light)
        case shadow.ProjectiveTexture():
            write_texture(folder / f"texture{end}.png", from_light)


def write_shadow_map(path: Path, shadow_map: shadow.ShadowMap) -> None:
    """The shadow map's distances along the light's axis; empty texels stay blank."""
    view, depth = shadow_map.view, np.asarray(shadow_map.depth)
    distance = np.where(depth < 1, np.asarray(view.eye_depth(shadow_map.depth)), np.nan)
    near, far = float(view.near), float(view.far)
    title = f"Shadow map, near {near:.3g} to far {far:.3g}"
    label = "distance along the light's axis [world units]"
    write_map(path, title, distance, label, cmap=style.DISTANCE, vmin=near, vmax=far)


def write_texture(path: Path, texture: shadow.ProjectiveTexture) -> None:
    """The texture as it is projected."""
    margin = texture.margin
    inside = np.asarray(texture.coverage)[..., margin:-margin, margin:-margin]
    write_map(path, "Projective texture", 1 - inside, "light let through", vmin=0.0, vmax=1.0)


def write_map(path: Path, title: str, values: HostArray, label: str, *, cmap: str = "gray", **limits: float) -> None:
    """A light's map (h, w), or the maps of several views side by side, (l, h, w), with texels along the axes."""
    layers = values if values.ndim > 2 else values[None]
    height, width = values.shape[-2:]
    columns = min(len(layers), 3)
    rows = -(-len(layers) // columns)
    if len(layers) == 1:
        figure, one = single(values, ticks=True)
        axes = [one]
    else:
        figure, axes = style.figure(3.1 * columns + 0.9, 3.1 * rows * height / width + 0.6, rows, columns)
    shown = None
    for i, (each, layer) in enumerate(zip(axes, layers, strict=True)):
        each.set_facecolor(style.NO_SURFACE)
        shown = style.picture(each, layer, cmap=cmap, extent=(0, width, 0, height), **limits)
        style.chart(each, "x [texels]", "y [texels]")
        each.grid(False)
        each.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        each.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        style.title(each, title if len(layers) == 1 else f"{title if i == 0 else ''} {_FACES[i]}".strip())
    style.colour_bar(figure, shown, axes, label)
    style.save(figure, path)


def write_loss(path: Path, result: FitResult, hard_before: float) -> None:
    """The error over the fit: under the soft compare step by step, under the hard one at each phase's end.

    **Arguments:**

    - `hard_before`: RMSE at the start under the hard compare.
    """
    figure, (axes,) = style.figure(7.2, 3.6)
    error = np.sqrt([max(step.loss, 1e-16) for step in result.history])
    phase = np.asarray([step.phase for step in result.history])
    for number, outcome in enumerate(result.phases):
        steps = np.flatnonzero(phase == number)
        if not len(steps):
            continue
        first, last = float(steps[0]) - 0.5, float(steps[-1]) + 0.5
        axes.axvspan(first, last, color="#f3f5f8" if number % 2 == 0 else style.PAPER, linewidth=0, zorder=0)
        axes.plot(steps, error[steps], color=style.BLUE, linewidth=1.4, marker=".", markersize=4)
        axes.text(
            *((first + last) / 2, 1.01),
            f"{outcome.width:.2g}",
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=8,
            color=style.INK,
        )
        axes.plot(last, np.sqrt(outcome.hard_loss), marker="D", markersize=5, color=style.VERMILION, linestyle="none")
    axes.plot(-0.5, hard_before, marker="D", markersize=5, color=style.VERMILION, linestyle="none")
    axes.plot([], [], color=style.BLUE, marker=".", label="soft compare")
    axes.plot([], [], color=style.VERMILION, marker="D", linestyle="none", label="hard compare, start and phase ends")
    axes.set_yscale("log")
    axes.set_xlim(-1, len(error) + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.chart(axes, "evaluations of the loss", "RMSE [visibility]")
    axes.legend(fontsize=8, frameon=False)
    axes.set_title(
        "Width of the soft compare in each phase [texels]:", fontsize=8.5, color=style.INK, loc="left", pad=16
    )
    style.save(figure, path)


def single(image: Image, ticks: bool = False) -> tuple[Figure, Axes]:
    """A figure for one picture of the shape of `image`, and its axes."""
    height, width = image.shape
    figure, (axes,) = style.figure(5.4, min(max(4.3 * height / width, 1.6), 12.0) + (0.6 if ticks else 0.3))
    return figure, axes


def _visibility(axes: Axes, image: Image, mask: Pixels):
    axes.set_facecolor(style.NO_SURFACE)
    return style.picture(axes, np.where(mask, image, np.nan), cmap="gray", vmin=0, vmax=1)


def _difference(axes: Axes, image: Image, reference: Image, mask: Pixels):
    axes.set_facecolor(style.NO_SURFACE)
    return style.picture(axes, np.where(mask, image - reference, np.nan), cmap=style.DIFFERENCE, vmin=-1, vmax=1)
