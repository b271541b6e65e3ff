"""Settings of cameras and lights. A class has the name of its module in `geometry`."""

from typing import Annotated, Any, ClassVar, Literal

from ._settings import Form, Limits, Settings, Unit
from .quantities import FARTHEST, NARROWEST, Coordinate, Degrees, Direction, HalfAngle, Size, WorldUnits

UP = (0.0, 1.0, 0.0)
"""The default up direction of images and shadow maps."""
OuterAngle = Annotated[Degrees, Limits(NARROWEST, 90 - NARROWEST)]
"""Half the field of view of a shadow map."""
_Length = Annotated[float, Limits(0, FARTHEST)]


PIECES = (
    *("plane", "box", "sphere", "low_poly_sphere", "torus", "torus_knot"),
    *("fence", "thin_wall", "chair", "blob"),
)
"""The meshes of the library: names of functions in `geometry/_library.py`."""
GLTF_SUFFIXES = (".glb", ".gltf")
"""The suffixes of files that may have cameras and lights in addition to meshes."""
MESH_SUFFIXES = (*GLTF_SUFFIXES, ".obj", ".off", ".ply", ".stl")
"""The suffixes of mesh files that the package reads itself."""
NO_MESH_SUFFIXES = ("", ".yaml", ".yml", ".json", ".txt")
"""Suffixes that never name a mesh in the position of a configuration."""
MAX_TEXTURE = 8192
"""The maximum side of a texture, in texels."""
Wrap = Literal["repeat", "clamp", "mirror"]
"""The wrapping of a texture beyond its image along an axis: the image again, its border, or alternately its mirror
image. In OpenGL and glTF, `REPEAT`, `CLAMP_TO_EDGE` and `MIRRORED_REPEAT`."""
Wraps = Wrap | tuple[Wrap, Wrap]
"""Along both axes, or along u and along v."""
TexelFilter = Literal["linear", "nearest"]
"""The filter of a texture between the centres of its texels: their bilinear mean, or the value of the nearest texel."""
LightKind = Literal["directional", "spot", "point"]
"""The kinds of lights of engines and files."""


class Cutout(Settings):
    """The alpha test of a mesh."""

    alpha_cutoff: Annotated[
        float, Limits(0, 1), "alpha of the texture below which the mesh is cut out, as in foliage and fences"
    ] = 0.5


class Camera(Settings):
    """The camera of an image."""

    type: Any
    resolution: Annotated[Size, Unit("pixels"), "[height, width] in pixels"] = (512, 512)
    up: Annotated[Direction, "direction that is upright in the image"] = UP


class PinholeCamera(Camera):
    """A perspective camera."""

    type: Literal["pinhole"] = "pinhole"
    fov_y: Annotated[Degrees, Limits(NARROWEST, 180 - NARROWEST), "full vertical field of view, in degrees"] = 40.0


class OrthographicCamera(Camera):
    """An orthographic camera."""

    type: Literal["orthographic"] = "orthographic"


class Light(Settings):
    """What casts the shadows."""

    type: Any
    size_key: ClassVar[str] = "radius"

    @property
    def has_size(self) -> bool:
        """Whether its shadows have penumbrae."""
        return getattr(self, self.size_key) > 0


class DirectionalLight(Light):
    """Light from infinitely far away."""

    type: Literal["directional"] = "directional"
    size_key: ClassVar[str] = "angular_radius"
    angular_radius: Annotated[HalfAngle, "half the light's angular diameter, in degrees; 0 casts hard shadows"] = 0.0


class Sun(DirectionalLight):
    """The light of a configuration. By default it has a size, so that there is a penumbra to fit."""

    angular_radius = 1.0


class ShadowCamera(Settings):
    """The camera that draws a directional light's map, with the names and defaults of three.js."""

    left: Annotated[Coordinate, "left side of the window, in world units"] = -5.0
    right: Annotated[Coordinate, "right side of the window, in world units"] = 5.0
    top: Annotated[Coordinate, "upper side of the window, in world units"] = 5.0
    bottom: Annotated[Coordinate, "lower side of the window, in world units"] = -5.0
    near: Annotated[Coordinate, "start of the map's depth, in world units"] = 0.5
    far: Annotated[Coordinate, "end of the map's depth, in world units"] = 500.0
    ascending = (("left", "right"), ("bottom", "top"), ("near", "far"))


class SpotLight(Light):
    """Light from a point or a small disk, into a cone."""

    type: Literal["spot"] = "spot"
    inner_angle: Annotated[
        HalfAngle | None, "half angle of the cone's fully lit part, in degrees; default: shading ignores the cone"
    ] = None
    radius: Annotated[WorldUnits, "radius of the disk, in world units; 0 is a point"] = 0.0
    aspect: Annotated[float, Limits(0.01, 100), "width of the map's field of view over its height"] = 1.0
    ascending = (("inner_angle", "outer_angle", True),)


class RectangleLight(Light):
    """Light from a rectangle, such as a panel or a window."""

    type: Literal["rectangle"] = "rectangle"
    size: Annotated[
        tuple[_Length, _Length],
        Form("two numbers [width, height], each at least 0", "[0.5, 0.5]"),
        Unit("world units"),
        "[width, height], in world units",
    ] = (0.5, 0.5)
    up: Annotated[Direction, "direction of its height"] = UP

    @property
    def has_size(self) -> bool:
        return max(self.size) > 0


class PointLight(Light):
    """Light from a point or a sphere in all directions, with a cube map."""

    type: Literal["point"] = "point"
    radius: Annotated[WorldUnits, "radius of the sphere, in world units; 0 is a point"] = 0.0
    guard: Annotated[
        float,
        Limits(0, 1),
        "margin for filters round each face of the map, as a fraction of half the face's width",
    ] = 0.1
