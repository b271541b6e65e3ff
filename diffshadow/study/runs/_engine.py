"""What a fit of an engine's shadows leaves: the code that sets the fitted values in the engine."""

from collections.abc import Sequence

import numpy as np

from ...geometry import PointLight
from ...shadow import FittableTechnique, ThreeJs, three_js_code
from ._setup import Drawn

CODE = "engine.js"
"""The file in a run's folder that holds the code."""


def engine_code(technique: FittableTechnique, drawn: Sequence[Drawn]) -> dict[str, str]:
    """The code for each light, by its key; none if the technique is no engine's."""
    if not isinstance(technique, ThreeJs):
        return {}
    return {each.key: three_js_code(technique, each.scene.light, _distances(each)) for each in drawn}


def _distances(drawn: Drawn) -> tuple[float, float]:
    """The least and greatest distance of what counts along the light's axis, or that of a point light's faces."""
    light, points = drawn.scene.light, drawn.surface.position[drawn.mask]
    if isinstance(light, PointLight):
        along = np.abs(np.asarray(points - light.position)).max(axis=-1)
    else:
        along = np.asarray(light.view().distance(points))
    return float(along.min()), float(along.max())
