"""The pictures of a frame, one for each view that a page can choose, and its figures."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .. import metrics, shadow
from .._types import HostArray
from ..reference import Reference
from ..study import style, tinted
from ._stages import Frame, Picture
from ._state import View

# Differences of visibility at the ends of the colours of errors.
_LIMIT = 0.5
# The longer side of a picture of a map, in pixels.
_MAP_SIDE = 1024
_LIT, _DARK = 1 - 1e-6, 1e-6
# Of a shaded picture under colours.
_GREY = 0.75


def picture_of(frame: Frame, view: View, truth: Reference | None) -> Picture | None:
    """The picture of `frame`; none where it needs a reference that is not traced yet, or has nothing to show."""
    if view in OF_TRUTH and truth is None:
        return None
    if view in OF_TRUTH:
        return OF_TRUTH[view](frame, truth)
    return _PLAIN[view](frame)


def views_of(frame: Frame) -> list[View]:
    """The views that the subject of `frame` has."""
    state = frame.state(frame.light)
    has_map = isinstance(state, shadow.ShadowMap | shadow.EngineMap)
    has = {
        "shadow map": has_map,
        "light's view": has_map and np.ndim(frame.lights[frame.light].view().world_to_eye) == 2,
        "layers of the map": _layers(frame) is not None,
    }
    every: list[View] = [*_PLAIN, *OF_TRUTH]
    return [view for view in every if has.get(view, True)]


def figures_of(frame: Frame, truth: Reference) -> dict[str, float]:
    """The errors of the shown light's visibility, as a render prints them; empty if no pixel counts."""
    mask = frame.covered(frame.light) & truth.mask
    if not mask.any():
        return {}
    image = np.asarray(frame.visibility(frame.light))
    measures = metrics.rmse, metrics.false_shadow_rate, metrics.false_light_rate
    return {measure.__name__: measure(image, truth.visibility, mask) for measure in measures}


def _bytes(image: Float[HostArray, "h w 3"]) -> Picture:
    return np.rint(np.clip(image[::-1], 0, 1) * 255).astype(np.uint8)


def _grey(image: Any) -> Picture:
    return np.repeat(_bytes(np.asarray(image, np.float32)[..., None]), 3, axis=-1)


def _visibility(frame: Frame) -> Picture:
    return _on_surface(frame, _grey(frame.visibility(frame.light)))


def _reference(frame: Frame, truth: Reference) -> Picture:
    return _on_surface(frame, _grey(truth.visibility))


def _on_surface(frame: Frame, picture: Picture) -> Picture:
    """`picture` where there is a surface, and the colour of none elsewhere."""
    mask = np.asarray(frame.surface.mask)[::-1, :, None]
    return np.where(mask, picture, _NO_SURFACE)


def _difference(frame: Frame, truth: Reference) -> tuple[Float[HostArray, "h w"], Bool[HostArray, "h w"]]:
    """How much too light each pixel is, and which count."""
    mask = frame.covered(frame.light) & truth.mask
    return np.where(mask, np.asarray(frame.visibility(frame.light)) - truth.visibility, 0), mask


def _error(frame: Frame, truth: Reference) -> Picture:
    """Signed differences: orange is too dark, purple too light."""
    return error_colours(*_difference(frame, truth))


def error_colours(wrong: Float[HostArray, "h w"], mask: Bool[HostArray, "h w"]) -> Picture:
    """Differences of visibility as colours, where they count."""
    at = np.rint((np.clip(wrong / _LIMIT, -1, 1) + 1) / 2 * 255).astype(int)
    return np.where(mask[::-1, :, None], _COLOURS[at[::-1]], _NO_SURFACE)


def _marks(frame: Frame, truth: Reference) -> Picture:
    """The shaded picture in grey, with false shadow in vermilion and false light in blue, as `metrics` defines them."""
    wrong, mask = _difference(frame, truth)
    grey = np.repeat(frame.shaded().mean(axis=-1, keepdims=True) / 255 * _GREY, 3, axis=-1)[::-1]
    for there, amount, colour in (
        (truth.visibility >= _LIT, -wrong, style.VERMILION),
        (truth.visibility <= _DARK, wrong, style.BLUE),
    ):
        share = np.where(mask & there, np.clip(amount, 0, 1), 0)[..., None]
        grey = (1 - share) * grey + share * _rgb(colour)
    return _bytes(grey)


def _map(frame: Frame) -> Picture:
    """Depths, near light and far dark, of all layers side by side."""
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
    grey = 1 - 0.85 * (depth - low) / max(high - low, 1e-6)
    return _bytes(np.where(seen[..., None], grey[..., None], _rgb(style.NO_SURFACE)))


def _layers(frame: Frame) -> shadow.LayerFigure | None:
    technique = frame.technique
    if not isinstance(technique, shadow.ShadowMapping):
        return None
    return technique.layout.layer_figure(frame.state(frame.light).light, frame.surface)


def _tinted(frame: Frame) -> Picture | None:
    """The shaded picture, with a colour for the layer of the map that each pixel is looked up in."""
    layers = _layers(frame)
    return None if layers is None else _bytes(tinted(frame.shaded()[::-1] / 255, layers))


def _rgb(colour: str) -> Float[HostArray, "3"]:
    return np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255


_NO_SURFACE = np.rint(_rgb(style.NO_SURFACE) * 255).astype(np.uint8)
_COLOURS = np.rint(style.colours(style.DIFFERENCE) * 255).astype(np.uint8)
_PLAIN: Mapping[View, Callable[[Frame], Picture | None]] = {
    "shaded": Frame.shaded,
    "visibility": _visibility,
    "shadow map": _map,
    "light's view": Frame.from_light,
    "layers of the map": _tinted,
}
OF_TRUTH: Mapping[View, Callable[..., Picture]] = {
    "reference": _reference,
    "error": _error,
    "acne and leaks": _marks,
}
