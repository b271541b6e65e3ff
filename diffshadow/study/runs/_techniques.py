"""What each technique draws from a light, and the visibility it makes of it."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float32

from ... import geometry, raster, shadow
from ..._types import HostArray
from ...config import Casting, Config, ProjectiveTextureConfig, Technique

FromLight = shadow.ShadowMap | shadow.ProjectiveTexture | geometry.Edges
"""What a technique makes once for each light: a map, a texture, or, for volumes, the edges to extrude."""


def draw_from_light(config: Config, technique: Technique, casting: Casting) -> FromLight:
    """What `technique` needs of the scene's only light."""
    match technique:
        case shadow.ShadowVolumes():
            return geometry.Edges.of(casting.casters)
        case shadow.ProjectiveShadow():
            settings = config.technique
            assert isinstance(settings, ProjectiveTextureConfig)
            return shadow.draw_projective_texture(
                casting.casters, casting.scene.light, settings.resolution, settings.blur, kernel=settings.kernel
            )
        case shadow.ShadowMapping():
            return draw_map(config, casting)


def draw_map(config: Config, casting: Casting) -> shadow.ShadowMap:
    """The shadow map of the scene's only light."""
    settings = config.shadow_map
    edges = geometry.Edges.of(casting.casters) if settings.silhouettes else None
    how = settings.model_dump(exclude={"silhouettes"})
    return shadow.draw_shadow_map(casting.casters, casting.scene.light, **how, edges=edges)


def covered(
    technique: Technique, from_light: FromLight, casting: Casting, surface: raster.Surface
) -> Bool[HostArray, "h w"]:
    """The pixels whose surface the technique can say something of."""
    if isinstance(technique, shadow.ShadowVolumes):
        return np.asarray(surface.mask)
    return np.asarray(_covered(technique, from_light, surface))


def visibility(
    technique: Technique, from_light: FromLight, casting: Casting, surface: raster.Surface
) -> Float32[HostArray, "h w"]:
    """The technique's visibility of the scene's only light."""
    return np.asarray(draw_visibility(technique, from_light, casting, surface), dtype=np.float32)


def draw_visibility(technique: Technique, from_light: FromLight, casting: Casting, surface: raster.Surface) -> Any:
    """As `visibility`, in the device's memory."""
    scene = casting.scene
    match technique:
        case shadow.ShadowVolumes():
            assert isinstance(from_light, geometry.Edges)
            return technique.visibility(casting.casters, scene.light, scene.camera, casting.receivers, edges=from_light)
        case shadow.ProjectiveShadow():
            return _visibility(technique, from_light, surface, casting.casts)
        case shadow.ShadowMapping():
            return _visibility(technique, from_light, surface)


_covered = eqx.filter_jit(lambda technique, from_light, surface: technique.covered(from_light, surface))
_visibility = eqx.filter_jit(lambda technique, from_light, *args: technique.visibility(from_light, *args))
