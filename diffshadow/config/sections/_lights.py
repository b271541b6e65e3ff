"""Sections of the lights."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from ...settings import Limits, Unit, scene
from ...settings.quantities import Degrees, Direction, Distance, Position, Turn
from ._section import Conflict, Section, Variants, exclusive, fault, given

# Beyond this distance a mesh vanishes in the rounding of float32.
Radii = Annotated[float, Limits(0, 1e4, above_low=True), Unit("radii")]


class LightOrbit(Section):
    """A light placed by angles about the middle of the scene's first mesh."""

    azimuth: Annotated[Turn, "0 towards +z of the mesh, 90 towards +x, in degrees"] = 60.0
    elevation: Annotated[Degrees, Limits(-90, 90), "height above the horizon, in degrees"] = 60.0
    distance: Annotated[Radii, "distance from the mesh's middle, in radii of its bounding sphere"] = 4.0


class ShadowCamera(Section, scene.ShadowCamera):
    """The camera that a directional light's map is drawn with, by the names and defaults of three.js: a parallel one at
    `position`, which looks along the light with +y up."""

    position: Annotated[Position, "where near, far and the window are measured from, in world units"]


class DirectionalLightConfig(Section, scene.Sun):
    """Light from infinitely far away."""

    azimuth: Annotated[Turn | None, "where the light comes from: 0 from +z, 90 from +x, in degrees; default 60"] = None
    elevation: Annotated[
        Degrees | None, Limits(-90, 90), "angle above the horizon it comes from, in degrees; default 45"
    ] = None
    direction: Annotated[Direction | None, "direction of travel, of any length; instead of azimuth and elevation"] = (
        None
    )
    frame: Annotated[
        Literal["scene", "casters"], "what the map is fitted to; with casters, pixels outside the map do not count"
    ] = "scene"
    shadow_camera: Annotated[
        ShadowCamera | None, "camera of the map, instead of one that is fitted; pixels outside do not count"
    ] = None

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        if given(data, "direction"):
            return data
        angles = {"azimuth": 60.0, "elevation": 45.0}
        return {**data, **{key: value for key, value in angles.items() if data.get(key) is None}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from exclusive(data, "direction", "azimuth", "elevation")
        if data.get("frame") == "casters" and data.get("shadow_camera") is not None:
            yield ("frame",), fault("is casters, and shadow_camera is given", "one or the other", "remove one of them")


class _PlacedLightConfig(Section):
    """A light at a finite position."""

    orbit: Annotated[LightOrbit | None, "placement by angles about the first mesh, instead of position"] = None
    position: Annotated[Position | None, "position of the light, in world units"] = None
    near: Annotated[Distance | None, "near plane of the map, in world units; default: tight"] = None
    far: Annotated[Distance | None, "far plane of the map, in world units; default: tight"] = None
    ascending = (("near", "far"),)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if given(data, "orbit", "position") else {**data, "orbit": {}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from exclusive(data, "orbit", "position")


class _AimedLightConfig(_PlacedLightConfig):
    """A light with a direction."""

    target: Annotated[Position | None, "point the light is aimed at, in world units; default: the scene's middle"] = (
        None
    )
    outer_angle: Annotated[
        scene.OuterAngle | None, "half the map's field of view, in degrees; default: just wide enough for the scene"
    ] = None


class SpotLightConfig(_AimedLightConfig, scene.SpotLight):
    """Light from a point or a small disk, into a cone."""

    ascending = (*_AimedLightConfig.ascending, *scene.SpotLight.ascending)


class RectangleLightConfig(_AimedLightConfig, scene.RectangleLight):
    """Light from a rectangle, such as a panel or a window."""


class PointLightConfig(_PlacedLightConfig, scene.PointLight):
    """Light from a point or a sphere in all directions, with a cube map."""


LIGHTS = Variants(scene.Light, "directional", __name__)
LightConfig = Annotated[scene.Light, LIGHTS]
