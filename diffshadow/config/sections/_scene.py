"""Sections of the scene: meshes, camera and lights."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ...settings import Form, Limits, Unit, scene
from ...settings.quantities import FARTHEST, SMALLEST, Angles, Colour, Coordinate, Degrees, Distance, Position, Turn
from ...settings.scene import PIECES
from .._errors import KeyPath, listing, nearest
from ._lights import LightConfig, Radii
from ._section import Conflict, Section, Variants, exclusive, fault, given, value_at

BUILTIN = "builtin:"
"""The prefix of paths that name a mesh of the library."""
_WRAPS = "repeat, clamp or mirror, or a list of two of them, along u and along v"


TEXTURE_KEYS = ("texture", "alpha_cutoff", "texture_wrap", "texture_filter")
"""The keys of a mesh that need a mesh file."""


class MeshConfig(Section):
    """A mesh and its placement: fitted to `size`, dropped to the ground, then scaled, rotated and translated."""

    path: str = Field(
        min_length=1,
        description="a mesh file, relative to this file (in an override: to the current folder), or builtin:NAME",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="keyword options of a builtin mesh")
    size: Annotated[
        Annotated[float, Limits(SMALLEST, FARTHEST), Unit("world units")] | None,
        "longest side to scale the mesh to, in world units",
    ] = None
    drop_to_ground: Annotated[bool, "whether to move the mesh up or down until it stands on y = 0"] = False
    translate: Annotated[Position, "translation, after scale and rotate, in world units"] = (0.0, 0.0, 0.0)
    rotate: Annotated[Angles, "rotation about the x, then the y, then the z axis, in degrees"] = (0.0, 0.0, 0.0)
    # Enough to scale the largest scenes to the smallest, and back.
    scale: Annotated[float, Limits(1e-15, 1e15), "scale factor about the origin"] = 1.0
    crease_angle: Annotated[
        Degrees, Limits(0, 180), "edges of a mesh file bent by more are shaded sharp, in degrees"
    ] = 30.0
    normals: Annotated[
        Literal["creases", "file"], "normals by crease_angle, or a mesh file's normals of vertices (PLY, glTF)"
    ] = "creases"
    albedo: Annotated[
        Colour, "diffuse colour, each component in [0, 1], times the colours and textures of a mesh file"
    ] = (0.8, 0.8, 0.8)
    texture: str | None = Field(
        default=None,
        min_length=1,
        description="an image file, in sRGB, relative like path; default: the textures of the mesh file",
    )
    alpha_cutoff: Annotated[
        Annotated[float, Limits(0, 1)] | None,
        "alpha, of the texture times that of a file's vertices, below which the mesh is cut out, 0 for none of it; "
        "default: as the mesh file says",
    ] = None
    texture_wrap: Annotated[
        Annotated[scene.Wraps, Form(_WRAPS)] | None,
        "what the texture shows beyond its image: the image again, its border, or its mirror image; default: as the "
        "mesh file says, or repeat",
    ] = None
    texture_filter: Annotated[
        scene.TexelFilter | None,
        "what the texture shows between texels: their bilinear mean, or the nearest; default: as the mesh file says, "
        "or linear",
    ] = None
    casts: Annotated[
        bool, "whether it casts shadows, or only receives them; reference.blockers can let it block rays"
    ] = True
    receives: Annotated[bool, "whether an engine shows shadows on it; pixels of others count in no error"] = True

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
        if path.startswith(BUILTIN) and name not in PIECES:
            suggestion = nearest(name, PIECES)
            mend = "name one of these" if suggestion is None else f"did you mean {BUILTIN + suggestion!r}?"
            yield ("path",), fault(f"is {path!r}", f"{BUILTIN} followed by {listing(PIECES)}", mend)
        if not path.startswith(BUILTIN) and options:
            what = fault("are given with a mesh file", "options with a builtin mesh only", "remove the options")
            yield ("options",), what
        for key in TEXTURE_KEYS:
            if path.startswith(BUILTIN) and data.get(key) is not None:
                yield (key,), fault("is given with a builtin mesh", "a mesh file, which may have UV", f"remove {key}")
        if path.startswith(BUILTIN) and data.get("normals") == "file":
            yield ("normals",), fault("is file with a builtin mesh", "creases", "remove it")


class CameraOrbit(Section):
    """A camera placed by angles about the middle of the scene's first mesh."""

    azimuth: Annotated[Turn, "0 towards +z of the mesh, 90 towards +x, in degrees"] = 30.0
    elevation: Annotated[Degrees, Limits(-90, 90), "height above the horizon, in degrees"] = 30.0
    distance: Annotated[Radii, "distance from the mesh's middle, in radii of its bounding sphere"] = 2.5


class _CameraConfig(Section):
    orbit: Annotated[CameraOrbit | None, "placement by angles about the first mesh, instead of eye"] = None
    eye: Annotated[Position | None, "position, in world units"] = None
    target: Annotated[Position | None, "point in the middle of the image, in world units"] = None
    antialias: Annotated[
        bool, "whether shaded pictures show the mean over each pixel along outlines and creases; errors ignore it"
    ] = False
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

    near: Annotated[Distance | None, "distance of the near plane, in world units; default: tight"] = None
    far: Annotated[Distance | None, "distance of the far plane, in world units; default: tight"] = None


class OrthographicCameraConfig(_CameraConfig, scene.OrthographicCamera):
    """An orthographic camera."""

    height: Annotated[Distance | None, "height of the view, in world units; default: the whole scene"] = None
    near: Annotated[Coordinate | None, "distance of the near plane, in world units; default: tight"] = None
    far: Annotated[Coordinate | None, "distance of the far plane, in world units; default: tight"] = None


CAMERAS = Variants(scene.Camera, "pinhole", __name__)
CameraConfig = Annotated[scene.Camera, CAMERAS]


class SceneConfig(Section):
    """Meshes, camera and lights."""

    meshes: Annotated[
        tuple[MeshConfig, ...],
        Form("a list of meshes, each with a path"),
        "surfaces, each a caster and a receiver; cameras and lights orbit the first",
    ]
    camera: CameraConfig = Field(
        default_factory=CAMERAS.make,
        description="camera of the image; without eye and orbit, or as auto, it frames the casters and their shadows",
    )
    light: Annotated[LightConfig | None, "light that casts the shadows; auto: a sun, or a lamp inside a room"] = None
    lights: Annotated[
        Annotated[tuple[LightConfig, ...], Form("a list of lights")] | None, "several lights instead of one"
    ] = None
    ground: Annotated[Literal["auto"] | None, "auto: adds a plane under meshes that stand on nothing"] = None

    @property
    def antialiases(self) -> bool:
        """Whether pictures are antialiased."""
        assert isinstance(self.camera, _CameraConfig)
        return self.camera.antialias

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
