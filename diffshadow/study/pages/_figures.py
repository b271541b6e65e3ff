"""The figures of a run. This module loads Matplotlib, so import it only to draw figures."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ... import shadow
from ..._checks import text_within
from ..._types import HostArray, Scalar
from .. import style
from ..record._runs import Course, FitRecord, PictureRecord, RenderRecord, ShapeRecord
from ..record._stored import LightImages, StoredRun, VisibilityRun, is_fit

Image = Float[HostArray, "h w"]
Pixels = Bool[HostArray, "h w"]
# The directions of a point light's six views, in the order of its layers.
FACES = ("+x", "−x", "+y", "−y", "+z", "−z")
# The colour scale of differences ends at the smallest limit that at most this fraction of pixels exceeds (`_CLIPPED`).
_LIMITS = (0.05, 0.1, 0.2, 0.5, 1.0)
_CLIPPED = 0.01
DIFFERENCE_LABEL = "too dark (−), too light (+) [visibility]"
# The maximum number of parameters in the figure.
_MAX_PARAMETERS = 16
FEW_PARAMETERS = 6
"""Up to this many parameters are drawn in one column; more take two columns."""
# A phase with a smaller fraction of the steps is too narrow for a label.
_NARROW = 0.05


Fit = VisibilityRun[FitRecord]


def write_figures(run: StoredRun[Any], folder: Path, form: str = "png", dpi: int = style.DPI) -> list[Path]:
    """Writes to `folder`, in the format `form`, all figures that the arrays of `run` allow. **Returns** the figures."""
    written = []
    for name, made in _figures(run):
        written.append(folder / f"{name}.{form}")
        style.save(made, written[-1], dpi)
    return written


def _figures(run: StoredRun[Any]) -> Iterator[tuple[str, Figure]]:
    if not isinstance(run.record, RenderRecord):
        yield "loss", loss(run)
    if not isinstance(run, VisibilityRun):
        return
    for i, light in enumerate(run.shown):
        if is_fit(run):
            # If there are several views, only the first has a shaded picture.
            is_shaded = i == 0 or not run.is_of_views
            yield f"comparison{light.end}", comparison(light, run.shaded[-1:] if is_shaded else [])
            continue
        ((_, image),) = light.images
        yield f"visibility{light.end}", visibility("Visibility", image, light.mask)
        yield f"reference{light.end}", visibility("Reference", light.reference, light.mask)
        yield f"difference{light.end}", difference(light)
    if run.shaded:
        yield "shaded", shaded(run.shaded)
    if is_fit(run):
        yield "parameters", parameters(run)
        if run.record.front:
            yield "front", front(run)
        if run.record.profiles:
            yield "profiles", profiles(run)


def comparison(light: LightImages, result: Sequence[tuple[str, HostArray]]) -> Figure:
    """The reference and each state. Below each state is its signed difference, and below the reference the shaded
    `result`."""
    height, width = light.reference.shape
    panel = 2.9
    columns = 1 + len(light.images)
    figure, axes = style.figure(panel * columns + 0.9, 2 * panel * height / width + 0.9, 2, columns)
    top, bottom = axes[:columns], axes[columns:]
    limit, extend = difference_limit([light])
    _visibility(top[0], light.reference, light.mask)
    style.title(top[0], "Reference")
    bottom[0].axis("off")
    for title, image in result:
        bottom[0].axis("on")
        style.picture(bottom[0], image)
        style.title(bottom[0], f"{title}, shaded")
    shown = None
    for above, below, (title, image), errors in zip(top[1:], bottom[1:], light.images, light.errors, strict=True):
        _visibility(above, image, light.mask)
        style.title(above, title, "" if errors.rmse is None else f"RMSE {errors.rmse:.4f}")
        shown = _difference(below, image, light, limit)
        style.title(below, f"{title} − reference")
    style.colour_bar(figure, shown, bottom[1:], DIFFERENCE_LABEL, extend=extend)
    return figure


def visibility(title: str, image: Image, mask: Pixels) -> Figure:
    """A single visibility image."""
    figure, axes = single(image)
    shown = _visibility(axes, image, mask)
    style.title(axes, title)
    style.colour_bar(figure, shown, [axes], "visibility (0 shadowed, 1 lit)")
    return figure


def difference(light: LightImages) -> Figure:
    """The signed difference of the result."""
    limit, extend = difference_limit([light])
    title, image = light.images[-1]
    figure, axes = single(image)
    shown = _difference(axes, image, light, limit)
    style.title(axes, f"{title} − reference")
    style.colour_bar(figure, shown, [axes], DIFFERENCE_LABEL, extend=extend)
    return figure


def shaded(images: Sequence[tuple[str, HostArray]]) -> Figure:
    """Shaded images side by side."""
    height, width = images[0][1].shape[:2]
    panel = 3.6
    figure, axes = style.figure(panel * len(images), panel * height / width + 0.3, 1, len(images))
    for one, (title, image) in zip(axes, images, strict=True):
        style.picture(one, image)
        style.title(one, title)
    return figure


def difference_limit(lights: Sequence[LightImages], states: slice = slice(None)) -> tuple[float, str]:
    """The limit of the colour scale for all images of `lights`, and whether any difference exceeds it: `"both"`,
    `"neither"`."""
    differences = [np.abs(image - light.reference)[light.mask] for light in lights for _, image in light.images[states]]
    together = np.concatenate([*differences, np.zeros(1)])
    least = np.quantile(together, 1 - _CLIPPED)
    limit = next((limit for limit in _LIMITS if limit >= least), 1.0)
    return limit, "both" if together.max() > limit else "neither"


def write_from_light(folder: Path, end: str, technique: Any, from_light: Any) -> None:
    """Writes the image that `technique` drew from a light, such as a shadow map or a texture. Some techniques draw no
    image."""
    match from_light:
        case shadow.ShadowMap() | shadow.EngineMap():
            write_shadow_map(folder / f"shadow_map{end}.png", from_light, map_figure(technique, from_light))
        case shadow.ProjectiveTexture():
            write_texture(folder / f"texture{end}.png", from_light)


@eqx.filter_jit
def _distances(shadow_map: shadow.ShadowMap | shadow.EngineMap) -> tuple[Float[Array, "*l h w"], Scalar, Scalar]:
    """The distances of the map's depths along the light's axis, and of its near and far planes, in world units."""
    if isinstance(shadow_map, shadow.EngineMap):
        return shadow_map.distances
    view = shadow_map.view
    return view.eye_depth(shadow_map.depth), view.near, view.far


def map_figure(technique: Any, from_light: Any) -> shadow.MapFigure | None:
    """The layout's names for the layers of a map that `technique` drew. Empty if the layout has no names."""
    return technique.layout.map_figure(from_light.light) if isinstance(technique, shadow.ShadowMapping) else None


def write_shadow_map(
    path: Path, shadow_map: shadow.ShadowMap | shadow.EngineMap, layers: shadow.MapFigure | None
) -> None:
    """Writes the shadow map as distances along the light's axis; empty texels are blank."""
    distance, near, far = _distances(shadow_map)
    is_drawn = shadow_map.is_drawn if isinstance(shadow_map, shadow.EngineMap) else shadow_map.depth < 1
    distance = np.where(np.asarray(is_drawn), np.asarray(distance), np.nan)
    near, far = float(near), float(far)
    title, label = f"Shadow map, near {near:.3g}, far {far:.3g}", "distance along the light's axis [world units]"
    limits = {"cmap": style.DISTANCE, "vmin": near, "vmax": far}
    write_map(path, title if layers is None else layers.title, distance, label, layers, **limits)


def _atlas(layers: Float[HostArray, "l h w"], count: int) -> Float[HostArray, "H W"]:
    """The first `count` layers in one image, row by row from the bottom."""
    across = math.ceil(math.sqrt(count))
    height, width = layers.shape[1:]
    missing = np.full((-count % across, height, width), np.nan)
    rows = np.concatenate([layers[:count], missing]).reshape(-1, across, height, width)
    return rows.transpose(0, 2, 1, 3).reshape(-1, across * width)


def write_texture(path: Path, texture: shadow.ProjectiveTexture) -> None:
    """Writes the texture as the light projects it."""
    margin = texture.margin
    inside = np.asarray(texture.coverage)[..., margin:-margin, margin:-margin]
    write_map(path, "Projective texture", 1 - inside, "light let through (0 none, 1 all)", vmin=0.0, vmax=1.0)


def write_map(
    path: Path,
    title: str,
    values: HostArray,
    label: str,
    named: shadow.MapFigure | None = None,
    *,
    cmap: str = "gray",
    **limits: float,
) -> None:
    """Writes a light's map (h, w), or the layers of a map (l, h, w), with axes in texels. `named` has the names of the
    layers. By default, they are the names of the faces of a point light's map."""
    names = FACES
    if named is not None and named.layers is None:
        values = _atlas(values, named.used)
    elif named is not None and named.layers is not None:
        names = named.layers
    layers = values if values.ndim > 2 else values[None]
    height, width = values.shape[-2:]
    columns = 2 if len(layers) == 4 else min(len(layers), 3)
    rows = -(-len(layers) // columns)
    if len(layers) == 1:
        figure, one = single(layers[0], ticks=True)
        axes = [one]
    else:
        size = (3.1 * columns + 0.9, 3.1 * rows * height / width + 0.6)
        figure, axes = style.figure(*size, rows, columns, sharex=True, sharey=True)
    shown = None
    for each in axes[len(layers) :]:
        each.set_visible(False)
    for i, (each, layer) in enumerate(zip(axes, layers, strict=False)):
        shown = style.picture(each, layer, cmap=cmap, extent=(0, width, 0, height), **limits)
        style.chart(each, "x [texels]" if i + columns >= len(layers) else "", "y [texels]" if i % columns == 0 else "")
        each.set_facecolor(style.NO_SURFACE)
        style.frame(each)
        each.grid(False)
        each.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        each.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        style.title(each, title if len(layers) == 1 else f"{title}: {names[i]}" if i == 0 else names[i])
    style.colour_bar(figure, shown, axes, label)
    style.save(figure, path)


def loss(run: StoredRun[Any]) -> Figure:
    """The error over a fit."""
    draw = {"fit": _loss, "picture": _picture_loss, "shape": _shape_loss}[run.record.kind]
    return draw(run)


def _loss(run: Fit) -> Figure:
    """The solver's loss at each evaluation, and the hard compare's error between phases."""
    figure, (axes,) = style.figure(5.2, 3.1)
    style.chart(axes, "evaluations of the loss", error_label([run]))
    recorded = history(run)
    ends = _mark_phases(axes, run.record.solver, recorded)
    for steps in _by_phase(recorded):
        axes.plot(steps, recorded.error[steps], color=style.BLUE, linewidth=1.4, marker="o", markersize=2.5)
    hard = _hard_errors(run.record)
    chosen = run.record.solver.chosen_phase + 1
    marks = {"color": style.VERMILION, "marker": "D", "markersize": 5, "linestyle": "none", "zorder": 3}
    axes.plot([], [], color=style.BLUE, marker="o", markersize=2.5, label="solver's loss")
    axes.plot(ends, hard, markerfacecolor=style.PAPER, label="hard compare", **marks)
    axes.plot(ends[chosen], hard[chosen], label="result", **marks)
    style.log_scale(axes)
    style.legend(axes)
    return figure


def convergence(runs: Sequence[tuple[str, Fit]]) -> Figure:
    """The error over several fits. Lines show the solver's loss, and diamonds show the hard compare between phases."""
    figure, (axes,) = style.figure(6.4, 3.6)
    style.chart(axes, "evaluations of the loss", error_label([run for _, run in runs]))
    for i, (label, run) in enumerate(runs):
        colour, recorded = style.CYCLE[i % len(style.CYCLE)], history(run)
        ends = [-0.5, *(steps[-1] + 0.5 for steps in _by_phase(recorded))]
        axes.plot(recorded.error, color=colour, linestyle=style.dashes(i), linewidth=1.4, label=style.label(label))
        hard = _hard_errors(run.record)[: len(ends)]
        axes.plot(ends[: len(hard)], hard, color=colour, marker="D", markersize=4.5, linestyle="none")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.log_scale(axes)
    style.legend(axes)
    return figure


def error_label(runs: Sequence[Fit]) -> str:
    """The axes for the errors in `history` of these fits."""
    own = {run.record.solver.is_own_loss for run in runs}
    return "loss" if own == {True} else "RMSE [visibility]" if own == {False} else "RMSE [visibility], or loss"


class History(NamedTuple):
    """The evaluations of a fit for its best start. The `error` is the root of the loss, or a user's loss."""

    phase: HostArray
    error: HostArray
    values: HostArray


def history(run: Fit) -> History:
    """The evaluations of a fit."""
    arrays = run.arrays
    # Only the best start is continued to the last phase.
    start = arrays.get("history_start", np.zeros_like(arrays["history_phase"]))
    best = start == start[-1:]
    error = np.maximum(arrays["history_loss"][best], 1e-16)
    error = error if run.record.solver.is_own_loss else np.sqrt(error)
    return History(arrays["history_phase"][best], error, arrays["history_values"][best])


def _hard_errors(record: FitRecord) -> list[float]:
    """RMSE under the hard compare, or a user's loss, at the start and after each phase."""
    losses = [record.solver.initial_loss, *(phase.hard_loss for phase in record.solver.phases)]
    known = [np.nan if loss is None else loss for loss in losses]
    return known if record.solver.is_own_loss else [record.metrics.before.rmse, *np.sqrt(known[1:]).tolist()]


def parameters(run: Fit) -> Figure:
    """Every parameter over a fit, with the result, nearby bounds, and the truth if it is known."""
    record, recorded = run.record, history(run)
    names, truth = list(record.fitted)[:_MAX_PARAMETERS], record.truth
    columns = 1 if len(names) <= FEW_PARAMETERS else 2
    rows = -(-len(names) // columns)
    figure, axes = style.figure(5.2 * columns, max(1.4 * rows + 0.7, 2.2), rows, columns, sharex=True)
    for i, (one, name) in enumerate(zip(axes, names, strict=False)):
        bounds, values, final = record.bounds[name], recorded.values[:, i], record.fitted[name]
        is_last = i >= len(names) - columns
        style.chart(one, "evaluations of the loss" if is_last else "", f"[{bounds.unit}]")
        one.tick_params(labelbottom=is_last)
        ends = _mark_phases(one, record.solver, recorded, widths=i < columns)
        for steps in _by_phase(recorded):
            one.plot(steps, values[steps], color=style.BLUE, linewidth=1.4, marker="o", markersize=2.5)
        one.plot(ends[record.solver.chosen_phase + 1], final, color=style.VERMILION, marker="D", markersize=5)
        known_truth = [truth[name]] if name in truth else []
        for value in known_truth:
            one.axhline(value, color=style.GREEN, linewidth=1.4, linestyle=":", zorder=1)
        _show_bounds(one, [*values.tolist(), final, *known_truth], bounds.lower, bounds.upper)
        value = text_within(final, bounds.lower, bounds.upper)
        style.heading(one, f"{name} = {value}", above=16 if i < columns else 4)
    for one in axes[len(names) :]:
        one.axis("off")
    return figure


def profiles(run: Fit) -> Figure:
    """The error along each parameter divided by the minimum error, with intervals and the result."""
    record = run.record
    found, fractions = list(record.profiles.items())[:_MAX_PARAMETERS], record.widths
    columns = min(len(found), 3)
    rows = -(-len(found) // columns)
    figure, axes = style.figure(3.4 * columns, 2.7 * rows, rows, columns)
    for one, (name, profile) in zip(axes, found, strict=False):
        best, unit = profile.best.error, record.bounds[name].unit
        points = np.asarray([(x, 100 * (y / max(best, 1e-12) - 1)) for x, y in profile.points if y is not None])
        style.chart(one, f"{name} [{unit}]", "error above the best [%]")
        for interval in reversed(profile.intervals):
            one.axvspan(interval.lower.value, interval.upper.value, color=style.BAND, linewidth=0, zorder=0)
            one.axhline(100 * interval.within, color=style.INK, linewidth=0.7, linestyle=":")
        one.plot(*points.T, color=style.BLUE, marker="o", markersize=3, linewidth=1.3)
        one.axvline(record.fitted[name], color=style.VERMILION, linewidth=1.2, linestyle="--")
        one.plot(profile.best.value, 0, color=style.VERMILION, marker="D", markersize=5)
        wide = profile.intervals[-1]
        margin = 0.25 * (wide.upper.value - wide.lower.value) + 1e-9
        one.set_xlim(wide.lower.value - margin, wide.upper.value + margin)
        one.set_ylim(-8 * max(fractions), 160 * max(fractions))
    for one in axes[len(found) :]:
        one.axis("off")
    return figure


def front(run: Fit) -> Figure:
    """The front of false shadow against false light."""
    figure, (axes,) = style.figure(4.6, 3.4)
    style.chart(axes, "false shadow, RMS [visibility]", "false light, RMS [visibility]")
    along = np.asarray([(point.false_shadow, point.false_light) for point in run.record.front])
    axes.plot(*along.T, color=style.BLUE, marker="o", markersize=4, linewidth=1.3, label="front")
    for (x, y), point in zip(along, run.record.front, strict=True):
        if point.is_knee:
            axes.plot(x, y, color=style.VERMILION, marker="D", markersize=6, linestyle="none", label="knee")
    style.legend(axes)
    return figure


def _show_bounds(axes: Axes, values: Sequence[float], lower: float, upper: float) -> None:
    """Marks the bounds near `values`, and sets the limits of the y-axis."""
    low, high = float(np.min(values)), float(np.max(values))
    margin = max(high - low, 1e-3 * (upper - lower)) * 0.5
    for bound, near in ((lower, lower >= low - margin), (upper, upper <= high + margin)):
        if near:
            axes.axhline(bound, color=style.INK, linewidth=0.9, linestyle=(0, (4, 3)))
    bottom, top = max(lower, low - margin), min(upper, high + margin)
    axes.set_ylim(bottom - 0.06 * (top - bottom), top + 0.06 * (top - bottom))
    axes.yaxis.set_major_locator(MaxNLocator(4))


def _picture_loss(run: StoredRun[PictureRecord]) -> Figure:
    """The error of a fit to a picture at each evaluation, with one colour for each phase."""
    figure, (axes,) = style.figure(6.4, 3.1)
    style.chart(axes, "evaluation", "RMSE under the blur")
    error, phase = np.sqrt(np.maximum(run.arrays["history_loss"], 0)), run.arrays["history_phase"]
    for number in np.unique(phase):
        at = np.flatnonzero(phase == number)
        axes.plot(at, error[at], linewidth=1.4, marker="o", markersize=3, label=f"phase {number + 1}")
    style.log_scale(axes)
    style.legend(axes)
    return figure


def _shape_loss(run: StoredRun[ShapeRecord]) -> Figure:
    """The loss of a fit of a shape at each step, and the loss of the judge at the ends of phases."""
    figure, (axes,) = style.figure(6.4, 3.1)
    style.chart(axes, "step", "RMSE [visibility]")
    error, phase = np.sqrt(np.maximum(run.arrays["history_loss"], 0)), run.arrays["history_phase"]
    axes.plot(error, color=style.BLUE, linewidth=1.4, label="blurred")
    phases = run.record.phases
    ends = [0, *np.cumsum([int((phase == k).sum()) for k in range(len(phases))])]
    judged = [run.record.metrics.initial_loss, *(each.loss for each in phases)]
    marks: Any = {"color": style.VERMILION, "marker": "D", "markersize": 5, "linestyle": "none", "zorder": 3}
    axes.plot(ends[: len(judged)], np.sqrt(judged), label="judge, without a blur", markerfacecolor=style.PAPER, **marks)
    style.log_scale(axes)
    style.legend(axes)
    return figure


def _mark_phases(axes: Axes, course: Course, recorded: History, *, widths: bool = True) -> list[float]:
    """Shades every second phase, and writes the width of its compare or the blur of its images above it.

    **Returns** the x-coordinates of the start of the fit and the end of each phase.
    """
    ends, named = [-0.5], ""
    count = max(len(recorded.phase), 1)
    axes.set_xlim(-0.5 - 0.02 * count, count - 0.5 + 0.02 * count)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    for number, phase in enumerate(course.phases):
        first = ends[-1]
        ends.append(first + int((recorded.phase == number).sum()))
        if number % 2 == 0:
            axes.axvspan(first, ends[-1], color=style.BAND, linewidth=0, zorder=0)
        if widths and ends[-1] - first > _NARROW * count:
            kind = "width" if phase.width else "blur" if phase.blur else ""
            label = f"{phase.width or phase.blur:.2g}" if kind else "search" if phase.searched else "hard"
            # Says only once what the numbers mean.
            style.text(axes, (first + ends[-1]) / 2, label if kind in ("", named) else f"{kind} {label}")
            named = kind or named
    return ends


def _by_phase(recorded: History) -> list[HostArray]:
    """The indices of the evaluations of each phase."""
    return [np.flatnonzero(recorded.phase == number) for number in np.unique(recorded.phase)]


def single(image: HostArray, ticks: bool = False) -> tuple[Figure, Axes]:
    """A figure for one image with the shape of `image`, and its axes."""
    height, width = image.shape
    figure, (axes,) = style.figure(5.4, min(max(4.3 * height / width, 1.6), 12.0) + (0.6 if ticks else 0.3))
    return figure, axes


def _visibility(axes: Axes, image: Image, mask: Pixels):
    axes.set_facecolor(style.NO_SURFACE)
    return style.picture(axes, np.where(mask, image, np.nan), cmap="gray", vmin=0, vmax=1)


def _difference(axes: Axes, image: Image, light: LightImages, limit: float):
    axes.set_facecolor(style.NO_SURFACE)
    shown = np.where(light.mask, image - light.reference, np.nan)
    return style.picture(axes, shown, cmap=style.DIFFERENCE, vmin=-limit, vmax=limit)
