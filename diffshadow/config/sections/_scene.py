"""Sections of the scene: meshes, camera and lights."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ...settings import Form, Limits, Unit, scene
from ...settings.quantities import FARTHEST, SMALLEST, Angles, Colour, Coordinate, Degrees, Distance, Position, Turn
from .._errors import KeyPath, listing, nearest
from ._lights import LightConfig, Radii
from ._section import Conflict, Section, Variants, exclusive, fault, given, value_at

BUILTIN = "builtin:"
"""The prefix of paths that name a mesh of the library."""

# The names in geometry.LIBRARY, kept here so that a misspelling is found without loading JAX.
BUILTIN_MESHES = (
    *("plane", "box", "sphere", "low_poly_sphere", "torus", "torus_knot"),
    *("fence", "thin_wall", "chair", "blob"),
)


class MeshConfig(Section):
    """A mesh and its placement: fitted to `size`, dropped to the ground, then scaled, rotated and translated."""

    path: str = Field(
        min_length=1,
        description="a mesh file, relative to this file (in an override: to the current folder), or builtin:NAME",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="keyword options of a builtin mesh")
    size: Annotated[float, Limits(SMALLEST, FARTHEST), Unit("world units")] | None = Field(
        default=None, description="longest side to scale the mesh to, in world units"
    )
    drop_to_ground: bool = Field(
        default=False, description="whether to move the mesh up or down until it stands on y = 0"
    )
    translate: Position = Field(
        default=(0.0, 0.0, 0.0), description="translation, after scale and rotate, in world units"
    )
    rotate: Angles = Field(
        default=(0.0, 0.0, 0.0), description="rotation about the x, then the y, then the z axis, in degrees"
    )
    # Enough to scale the largest scenes to the smallest, and back.
    scale: float = Field(default=1.0, ge=1e-15, le=1e15, description="scale factor about the origin")
    crease_angle: Degrees = Field(
        default=30.0, ge=0, le=180, description="edges of a mesh file bent by more are shaded sharp, in degrees"
    )
    normals: Literal["creases", "file"] = Field(
        default="creases", description="normals by crease_angle, or those of a mesh file's vertices (PLY, glTF)"
    )
    albedo: Colour = Field(default=(0.8, 0.8, 0.8), description="diffuse colour, each component in [0, 1]")
    casts: bool = Field(
        default=True,
        description="whether it casts shadows with the technique, or only receives them; in the reference all cast",
    )
    receives: bool = Field(
        default=True, description="whether an engine shows shadows on it; pixels of others count in no error"
    )

    @property
    def builtin(self) -> str | None:
        """The name of a library mesh, or `None` for a file."""
        return self.path.removeprefix(BUILTIN) if self.path.startswith(BUILTIN) else None

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        path, options = data.get("path"), data.get("options")
        if not isinstance(path, str):
            return
        name = path.removeprefix(BUILTIN)
        if path.startswith(BUILTIN) and name not in BUILTIN_MESHES:
            suggestion = nearest(name, BUILTIN_MESHES)
            mend = "name one of these" if suggestion is None else f"did you mean {BUILTIN + suggestion!r}?"
            yield ("path",), fault(f"is {path!r}", f"{BUILTIN} followed by {listing(BUILTIN_MESHES)}", mend)
        if not path.startswith(BUILTIN) and options:
            what = fault("are given with a mesh file", "options with a builtin mesh only", "remove the options")
            yield ("options",), what
        if path.startswith(BUILTIN) and data.get("normals") == "file":
            yield ("normals",), fault("is file with a builtin mesh", "creases", "remove it")


class CameraOrbit(Section):
    """A camera placed by angles about the middle of the scene's first mesh."""

    azimuth: Turn = Field(default=30.0, description="0 towards +z of the mesh, 90 towards +x, in degrees")
    elevation: Degrees = Field(default=30.0, ge=-90, le=90, description="height above the horizon, in degrees")
    distance: Radii = Field(default=2.5, description="distance from the mesh's middle, in radii of its bounding sphere")


class _CameraConfig(Section):
    orbit: CameraOrbit | None = Field(
        default=None, description="placement by angles about the first mesh, instead of eye"
    )
    eye: Position | None = Field(default=None, description="position, in world units")
    target: Position | None = Field(default=None, description="point in the middle of the image, in world units")
    ascending = (("near", "far"),)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if given(data, "orbit", "eye", "target") else {**data, "orbit": {}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from exclusive(data, "orbit", "eye", "target")
        if given(data, "target") and not given(data, "eye", "orbit"):
            yield ("target",), fault("is given without eye", "eye with it", "add eye: [x, y, z] in world units")


class PinholeCameraConfig(_CameraConfig, scene.PinholeCamera):
    """A perspective camera."""

    near: Distance | None = Field(
        default=None, description="distance of the near plane, in world units; default: tight"
    )
    far: Distance | None = Field(default=None, description="distance of the far plane, in world units; default: tight")


class OrthographicCameraConfig(_CameraConfig, scene.OrthographicCamera):
    """An orthographic camera."""

    height: Distance | None = Field(
        default=None, description="height of the view, in world units; default: the whole scene"
    )
    near: Coordinate | None = Field(
        default=None, description="distance of the near plane, in world units; default: tight"
    )
    far: Coordinate | None = Field(
        default=None, description="distance of the far plane, in world units; default: tight"
    )


CAMERAS = Variants(scene.Camera, "pinhole", __name__)
CameraConfig = Annotated[scene.Camera, CAMERAS]


class SceneConfig(Section):
    """Meshes, camera and lights."""

    meshes: Annotated[tuple[MeshConfig, ...], Form("a list of meshes, each with a path")] = Field(
        description="surfaces, each a caster and a receiver; cameras and lights orbit the first"
    )
    camera: CameraConfig = Field(default_factory=CAMERAS.make, description="camera of the image")
    light: LightConfig | None = Field(default=None, description="light that casts the shadows")
    lights: Annotated[tuple[LightConfig, ...], Form("a list of lights")] | None = Field(
        default=None, description="several lights instead of one"
    )

    @property
    def each_light(self) -> dict[KeyPath, LightConfig]:
        """All lights, by their key paths inside this section."""
        if self.lights is None:
            assert self.light is not None
            return {("light",): self.light}
        return {("lights", i): light for i, light in enumerate(self.lights)}

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        # `light: null` is reported in `conflicts`, unless `lights` is given instead.
        return data if "light" in data or given(data, "lights") else {**data, "light": {}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        meshes = data.get("meshes")
        if isinstance(meshes, list | tuple) and not meshes:
            yield ("meshes",), fault("is an empty list", "at least one mesh", "add '- path: builtin:torus_knot'")
        if isinstance(meshes, list | tuple) and meshes and all(value_at(mesh, "casts") is False for mesh in meshes):
            mend = "remove casts from one of them"
            yield ("meshes",), fault("hold no mesh that casts a shadow", "at least one mesh that casts", mend)
        yield from exclusive(data, "light", "lights")
        lights = data.get("lights")
        if isinstance(lights, list | tuple) and not lights:
            yield ("lights",), fault("is an empty list", "at least one light", "add '- type: directional'")
        if lights is None and "light" in data and data["light"] is None:
            yield ("light",), fault("is empty", "a light", "remove the key to get its default")
