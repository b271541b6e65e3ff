"""Sections of the lights."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from ._section import (
    NARROWEST,
    Conflict,
    Coordinate,
    Degrees,
    Direction,
    Extent,
    Position,
    Radii,
    Section,
    Turn,
    Unit,
    WorldUnits,
    by_type,
    exclusive,
    fault,
    given,
    is_number,
    ordered,
)


class LightOrbit(Section):
    """A light placed by angles about the middle of the scene's first mesh."""

    azimuth: Turn = Field(default=60.0, description="0 towards +z of the mesh, 90 towards +x, in degrees")
    elevation: Degrees = Field(default=60.0, ge=-90, le=90, description="height above the horizon, in degrees")
    distance: Radii = Field(
        default=4.0, gt=0, description="distance from the mesh's middle, in radii of its bounding sphere"
    )


class ShadowCamera(Section):
    """The camera that a directional light's map is drawn with, by the names and defaults of three.js: a parallel one at
    `position`, which looks along the light with +y up."""

    position: Position = Field(description="where near, far and the window are measured from, in world units")
    left: Coordinate = Field(default=-5.0, description="left side of the window, in world units")
    right: Coordinate = Field(default=5.0, description="right side of the window, in world units")
    top: Coordinate = Field(default=5.0, description="upper side of the window, in world units")
    bottom: Coordinate = Field(default=-5.0, description="lower side of the window, in world units")
    near: Coordinate = Field(default=0.5, description="where the map's depth begins, in world units")
    far: Coordinate = Field(default=500.0, description="where the map's depth ends, in world units")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        for low, high in (("left", "right"), ("bottom", "top"), ("near", "far")):
            yield from ordered(cls, data, low, high)


class DirectionalLightConfig(Section):
    """Light from infinitely far away."""

    type: Literal["directional"] = "directional"
    azimuth: Turn | None = Field(
        default=None, description="where the light comes from: 0 from +z, 90 from +x, in degrees; default 60"
    )
    elevation: Degrees | None = Field(
        default=None, ge=-90, le=90, description="angle above the horizon it comes from, in degrees; default 45"
    )
    direction: Direction | None = Field(
        default=None, description="direction of travel, of any length; instead of azimuth and elevation"
    )
    angular_radius: Degrees = Field(
        default=1.0,
        ge=0,
        le=90 - NARROWEST,
        description="half the angular diameter of the light, in degrees; 0 casts hard shadows",
    )
    frame: Literal["scene", "casters"] = Field(
        default="scene", description="what the map is fitted to; with casters, pixels outside the map do not count"
    )
    shadow_camera: ShadowCamera | None = Field(
        default=None, description="camera of the map, instead of one that is fitted; pixels outside do not count"
    )

    @property
    def has_size(self) -> bool:
        """Whether its shadows have penumbrae."""
        return self.angular_radius > 0

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

    orbit: LightOrbit | None = Field(
        default=None, description="placement by angles about the first mesh, instead of position"
    )
    position: Position | None = Field(default=None, description="position of the light, in world units")
    near: WorldUnits | None = Field(
        default=None, gt=0, description="near plane of the map, in world units; default: tight"
    )
    far: WorldUnits | None = Field(
        default=None, gt=0, description="far plane of the map, in world units; default: tight"
    )

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if given(data, "orbit", "position") else {**data, "orbit": {}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from exclusive(data, "orbit", "position")
        yield from ordered(cls, data, "near", "far")


class _AimedLightConfig(_PlacedLightConfig):
    """A light with a direction."""

    target: Position | None = Field(
        default=None, description="point the light is aimed at, in world units; default: the scene's middle"
    )
    outer_angle: Degrees | None = Field(
        default=None,
        ge=NARROWEST,
        le=90 - NARROWEST,
        description="half the map's field of view, in degrees; default: just wide enough for the scene",
    )


class SpotLightConfig(_AimedLightConfig):
    """Light from a point or a small disk, into a cone."""

    type: Literal["spot"] = "spot"
    inner_angle: Degrees | None = Field(
        default=None,
        ge=0,
        le=90 - NARROWEST,
        description="half angle of the cone's fully lit part, in degrees; default: shading ignores the cone",
    )
    radius: WorldUnits = Field(default=0.0, ge=0, description="radius of the disk, in world units; 0 is a point")
    aspect: float = Field(default=1.0, ge=0.01, le=100, description="width of the map's field of view over its height")

    @property
    def has_size(self) -> bool:
        """Whether its shadows have penumbrae."""
        return self.radius > 0

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from super().conflicts(data)
        inner, outer = data.get("inner_angle"), data.get("outer_angle")
        if is_number(inner) and is_number(outer) and inner > outer:
            message = f"is {inner} and outer_angle is {outer}"
            yield ("inner_angle",), fault(message, "inner_angle at most outer_angle", "make it smaller")


class RectangleLightConfig(_AimedLightConfig):
    """Light from a rectangle, such as a panel or a window."""

    type: Literal["rectangle"] = "rectangle"
    size: Annotated[Extent, Unit("world units")] = Field(
        default=(0.5, 0.5), description="[width, height], in world units"
    )
    up: Direction = Field(default=(0.0, 1.0, 0.0), description="direction of its height")

    @property
    def has_size(self) -> bool:
        """Whether its shadows have penumbrae."""
        return max(self.size) > 0


class PointLightConfig(_PlacedLightConfig):
    """Light from a point or a sphere in all directions, with a cube map."""

    type: Literal["point"] = "point"
    radius: WorldUnits = Field(default=0.0, ge=0, description="radius of the sphere, in world units; 0 is a point")
    guard: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="margin for filters round each face of the map, as a fraction of half the face's width",
    )

    @property
    def has_size(self) -> bool:
        """Whether its shadows have penumbrae."""
        return self.radius > 0


LightConfig = Annotated[
    Annotated[DirectionalLightConfig, Tag("directional")]
    | Annotated[SpotLightConfig, Tag("spot")]
    | Annotated[PointLightConfig, Tag("point")]
    | Annotated[RectangleLightConfig, Tag("rectangle")],
    by_type("directional"),
]
