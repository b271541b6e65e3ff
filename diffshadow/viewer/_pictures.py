"""The pictures and the figures of a frame. There is one picture for each view that a page can choose."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

# `study`'s colours load Matplotlib on first use; shaded pictures do not need them.
from .. import geometry, metrics, shadow, study
from .._types import HostArray
from ..reference import Reference
from ._drawing_cache import Frame, Picture
from ._state import View

# The longer side of a picture of a map, in pixels, and the brightness of its farthest depth, where white is 1.
_MAP_SIDE, _FAR = 1024, 0.15


def picture_of(frame: Frame, view: View, truth: Reference | None) -> Picture | None:
    """The picture of `frame`, or `None` if its reference is not traced yet or there is nothing to show."""
    if view not in OF_TRUTH:
        return _PLAIN[view](frame)
    return None if truth is None else OF_TRUTH[view](frame, truth)


def views_of(frame: Frame) -> list[View]:
    """The views of the subject of `frame`."""
    state = frame.state(frame.light)
    has_map = isinstance(state, shadow.ShadowMap | shadow.EngineMap)
    has = {
        "shadow map": has_map,
        # A point light has six layers.
        "light's view": has_map and not isinstance(frame.lights[frame.light], geometry.PointLight),
        "layers of the map": _layers(frame) is not None,
    }
    every: list[View] = [*_PLAIN, *OF_TRUTH]
    return [view for view in every if has.get(view, True)]


def figures_of(frame: Frame, truth: Reference) -> dict[str, float]:
    """The errors of the shown light's visibility, as `diffshadow render` prints them. Empty if no pixel counts."""
    mask = frame.covered(frame.light) & truth.mask
    if not mask.any():
        return {}
    image = np.asarray(frame.visibility(frame.light))
    measures = metrics.rmse, metrics.false_shadow_rate, metrics.false_light_rate
    return {measure.__name__: measure(image, truth.visibility, mask) for measure in measures}


def as_picture(image: Float[HostArray, "h w 3"]) -> Picture:
    """Converts colours in [0, 1], with row 0 at the bottom, to bytes."""
    return np.rint(np.clip(image[::-1], 0, 1) * 255).astype(np.uint8)


def _visibility(frame: Frame) -> Picture:
    return as_picture(study.on_surface(np.asarray(frame.visibility(frame.light)), np.asarray(frame.surface.mask)))


def _reference(frame: Frame, truth: Reference) -> Picture:
    return as_picture(study.on_surface(truth.visibility, truth.mask))


def _difference(frame: Frame, truth: Reference) -> tuple[Float[HostArray, "h w"], Bool[HostArray, "h w"]]:
    """The signed error of each pixel, positive where it is too light, and a mask of the pixels that count."""
    mask = frame.covered(frame.light) & truth.mask
    return np.where(mask, np.asarray(frame.visibility(frame.light)) - truth.visibility, 0), mask


def _error(frame: Frame, truth: Reference) -> Picture:
    return as_picture(study.difference_colours(*_difference(frame, truth)))


def _marks(frame: Frame, truth: Reference) -> Picture:
    difference, mask = _difference(frame, truth)
    return as_picture(study.marked(frame.shaded()[::-1] / 255, difference, truth.visibility, mask))


def _map(frame: Frame) -> Picture:
    """The depths of all layers side by side. Near depths are light, and far depths are dark."""
    depth = np.asarray(frame.state(frame.light).depth)
    layers = depth if depth.ndim > 2 else depth[None]
    across = int(np.ceil(np.sqrt(len(layers))))
    empty = np.full((-len(layers) % across, *layers.shape[1:]), np.nan)
    rows = np.concatenate([layers, empty]).reshape(-1, across, *layers.shape[1:])
    depth = rows.transpose(0, 2, 1, 3).reshape(-1, across * layers.shape[2])
    step = -(-max(depth.shape) // _MAP_SIDE)
    depth = depth[::step, ::step]
    seen = depth < 1
    low, high = (depth[seen].min(), depth[seen].max()) if seen.any() else (0.0, 1.0)
    return as_picture(study.on_surface(1 - (1 - _FAR) * (depth - low) / max(high - low, 1e-6), seen))


def _layers(frame: Frame) -> shadow.LayerFigure | None:
    technique = frame.technique
    if not isinstance(technique, shadow.ShadowMapping):
        return None
    return technique.layout.layer_figure(frame.state(frame.light).light, frame.surface)


def _tinted(frame: Frame) -> Picture | None:
    """The shaded picture, tinted by the layer of the map that each pixel looks up."""
    layers = _layers(frame)
    return None if layers is None else as_picture(study.tinted(frame.shaded()[::-1] / 255, layers))


_PLAIN: Mapping[View, Callable[[Frame], Picture | None]] = {
    "shaded": Frame.shaded,
    "visibility": _visibility,
    "shadow map": _map,
    "light's view": Frame.from_light,
    "layers of the map": _tinted,
}
OF_TRUTH: Mapping[View, Callable[[Frame, Any], Picture]] = {
    "reference": _reference,
    "error": _error,
    "acne and leaks": _marks,
}
"""The views that need a reference."""
