"""What fits say in an engine's own units."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from ..._types import HostArray, VectorMap
from ...geometry import AbstractLight, PointLight
from ...shadow import BabylonJs, FittableTechnique, ThreeJs, engine_code
from ._setup import Drawn

CODE = "engine.js"
"""The file in a run's folder that holds the code."""


def code_of(technique: FittableTechnique, drawn: Sequence[Drawn]) -> dict[str, str]:
    """The code for each light, by its key; none if the technique is no engine's."""
    if not isinstance(technique, ThreeJs | BabylonJs):
        return {}
    return {each.key: engine_code(technique, each.scene.light, _distances(each)) for each in drawn}


def _distances(drawn: Drawn) -> tuple[float, float]:
    """The least and greatest distance of what counts along the light's axis, or that of a point light's faces."""
    distances = along(drawn.scene.light, drawn.surface.position)[drawn.mask]
    return float(distances.min()), float(distances.max())


def along(light: AbstractLight, points: VectorMap) -> Float32[HostArray, "h w"]:
    """The distance of `points` (h, w, 3) along the light's axis, or that of the face of a point light's map."""
    if isinstance(light, PointLight):
        return np.asarray(abs(points - light.position).max(axis=-1))
    return np.asarray(light.view().distance(points))
