"""Sections of the scene: meshes, camera and lights."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from ...settings import At, Form, InputFile, Limits, Setting, Unit, scene
from ...settings.quantities import (
    FARTHEST,
    SMALLEST,
    Angles,
    Colour,
    Coordinate,
    Degrees,
    Direction,
    Distance,
    Fraction,
    HalfAngle,
    Position,
    Turn,
    WorldUnits,
)
from ...settings.scene import PIECES
from .._errors import KeyPath, dotted, listing, nearest
from ._section import Conflict, Section, Variants, fault, given

if TYPE_CHECKING:
    from ._config import Config

AXES, CHANNELS = ("x", "y", "z"), ("red", "green", "blue")
_FACES_OF_A_CUBE = 6
# About 300 bytes each while an image is processed: 5 GB.
MAX_PIXELS = 1 << 24
"""The maximum number of pixels of an image, and of all views of a fit together."""


def _vector(key: str, kind: Any) -> dict[str, Setting]:
    return {f"{key}.{axis}": Setting.of(kind) for axis in AXES}


def colour_of(key: str, kind: Any) -> dict[str, Setting]:
    """The settings of the channels of a colour, by key."""
    return {f"{key}.{channel}": Setting.of(kind) for channel in CHANNELS}


_POSITION, _ANGLES = _vector("position", Coordinate), {key: Setting.of(Turn) for key in ("azimuth", "elevation")}
# Beyond this distance, float32 rounding destroys a mesh.
Radii = Annotated[float, Limits(0, 1e4, above_low=True), Unit("radii")]


class LightOrbit(Section):
    """A light placed by angles about the centre of the scene's first mesh."""

    azimuth: Annotated[Turn, "0 towards +z of the mesh, 90 towards +x, in degrees"] = 60.0
    elevation: Annotated[Degrees, Limits(-90, 90), "height above the horizon, in degrees"] = 60.0
    distance: Annotated[Radii, "distance from the mesh's middle, in radii of its bounding sphere"] = 4.0


class ShadowCamera(Section, scene.ShadowCamera):
    """The camera that draws a directional light's map, with the names and defaults of three.js: a parallel camera at
    `position` that looks along the light, with +y up."""

    position: Annotated[Position, "the origin of near, far and the window, in world units"]


class AnyLightConfig(Section, scene.Light):
    """A light. `moving`: the numbers of the section that can be fitted, by key, each with its path in the light's
    pose."""

    moving: ClassVar[Mapping[str, Setting]] = {}

    def maps(self, layers: int) -> int:
        """The number of its maps, if a light with one view has `layers` maps."""
        return layers


class DirectionalLightConfig(AnyLightConfig, scene.Sun):
    """Light from infinitely far away."""

    azimuth: Annotated[Turn | None, "azimuth of the light's source: 0 is +z, 90 is +x, in degrees; default 60"] = None
    elevation: Annotated[
        Degrees | None, Limits(-90, 90), "elevation of the light's source above the horizon, in degrees; default 45"
    ] = None
    direction: Annotated[Direction | None, "direction of travel, of any length; instead of azimuth and elevation"] = (
        None
    )
    frame: Annotated[
        Literal["scene", "casters"],
        "the objects that the map is fitted to; with casters, pixels outside the map do not count",
    ] = "scene"
    shadow_camera: Annotated[
        ShadowCamera | None, "camera of the map, instead of a fitted camera; pixels outside do not count"
    ] = None
    exclusive = (("direction", "azimuth", "elevation"),)
    moving: ClassVar[Mapping[str, Setting]] = {
        **_ANGLES,
        "angular_radius": Setting.of(HalfAngle, marks=(At("radius"),)),
    }

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        if given(data, "direction"):
            return data
        angles = {"azimuth": 60.0, "elevation": 45.0}
        return {**data, **{key: value for key, value in angles.items() if data.get(key) is None}}

    def faults(self) -> Iterator[Conflict]:
        if self.frame == "casters" and self.shadow_camera is not None:
            yield ("frame",), fault("is casters, and shadow_camera is given", "one or the other", "remove one of them")

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if config.moves and self.frame == "casters":
            message = "is casters in a fit of lights or meshes, whose shadows may move outside the initial frame"
            yield (*at, "frame"), fault(message, "scene", "remove it")
        if config.moves and self.shadow_camera is not None:
            message = "is given in a fit of lights or meshes, which fits the map to the scene at every step"
            yield (*at, "shadow_camera"), fault(message, "a map that is fitted", "remove it")


class _PlacedLightConfig(AnyLightConfig):
    """A light at a finite position."""

    orbit: Annotated[LightOrbit | None, "placement by angles about the first mesh, instead of position"] = None
    position: Annotated[Position | None, "position of the light, in world units"] = None
    near: Annotated[Distance | None, "near plane of the map, in world units; default: tight"] = None
    far: Annotated[Distance | None, "far plane of the map, in world units; default: tight"] = None
    ascending = (("near", "far"),)
    exclusive = (("orbit", "position"),)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if given(data, "orbit", "position") else {**data, "orbit": {}}


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
    moving: ClassVar[Mapping[str, Setting]] = {**_POSITION, **_ANGLES, "radius": Setting.of(WorldUnits)}


class RectangleLightConfig(_AimedLightConfig, scene.RectangleLight):
    """Light from a rectangle, such as a panel or a window."""

    moving: ClassVar[Mapping[str, Setting]] = _POSITION


class PointLightConfig(_PlacedLightConfig, scene.PointLight):
    """Light from a point or a sphere in all directions, with a cube map."""

    moving: ClassVar[Mapping[str, Setting]] = {**_POSITION, "radius": Setting.of(WorldUnits)}

    def maps(self, layers: int) -> int:
        return _FACES_OF_A_CUBE

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from self._beyond_guards(config, at, {})

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from self._beyond_guards(config, at, config.fit.parameters)

    def _beyond_guards(self, config: "Config", at: KeyPath, bounds: Mapping[str, Any]) -> Iterator[Conflict]:
        """A fault of a filter that reads beyond the faces of the map, with fitted numbers at their `bounds`."""
        reach, half, allowed = (
            config.reach(bounds),
            min(config.shadow_map.resolution) / 2,
            self.guard / (1 + self.guard),
        )
        # A reach that does not depend on the bounds is a fault of the run.
        if not config.technique.is_mapped or reach.texels <= allowed * half or (bounds and not reach.is_of_fit):
            return
        path, guard = reach.path, dotted((*at, "guard"))
        mends = [f"raise {guard} to {_rounded_up(reach.texels / (half - reach.texels)):g}"] * (reach.texels <= half / 2)
        mends += ["raise shadow_map.resolution", f"lower {dotted(path)}" if len(path) > 1 else "choose another filter"]
        what = fault(
            f"lets the filter read {reach.texels:g} texels away, beyond the edge of a face of a point light's map",
            f"at most {allowed * half:.3g} texels, which {guard} = {self.guard:g} allows",
            f"{', '.join(mends[:-1])}, or {mends[-1]}",
        )
        yield path, what


def _rounded_up(value: float) -> float:
    """`value` rounded up to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / step) * step


LIGHTS = Variants(scene.Light, "directional", __name__)
LightConfig = Annotated[AnyLightConfig, LIGHTS]


BUILTIN = "builtin:"
"""The prefix of paths that name a mesh of the library."""
_WRAPS = "repeat, clamp or mirror, or a list of two of them, along u and along v"


TEXTURE_KEYS = ("texture", "alpha_cutoff", "texture_wrap", "texture_filter")
"""The keys of a mesh that need a mesh file."""


def _known_piece(path: str) -> str:
    name = path.removeprefix(BUILTIN)
    if name != path and name not in PIECES:
        suggestion = nearest(name, PIECES)
        mend = "name one of these" if suggestion is None else f"did you mean {BUILTIN + suggestion!r}?"
        raise fault(f"is {path!r}", f"{BUILTIN} followed by {listing(PIECES)}", mend)
    return path


class MeshConfig(Section):
    """A mesh and its placement: fitted to `size`, dropped to the ground, then scaled, rotated and translated."""

    path: Annotated[str, AfterValidator(_known_piece), InputFile(BUILTIN)] = Field(
        min_length=1,
        description="a mesh file, relative to this file (in an override: to the current folder), or builtin:NAME",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="keyword options of a builtin mesh")
    size: Annotated[
        Annotated[float, Limits(SMALLEST, FARTHEST), Unit("world units")] | None,
        "longest side to scale the mesh to, in world units",
    ] = None
    drop_to_ground: Annotated[bool, "whether to move the mesh up or down to rest on y = 0"] = False
    translate: Annotated[Position, "translation, after scale and rotate, in world units"] = (0.0, 0.0, 0.0)
    rotate: Annotated[Angles, "rotation about the x, then the y, then the z axis, in degrees"] = (0.0, 0.0, 0.0)
    # Enough to scale the largest scenes to the smallest, and back.
    scale: Annotated[float, Limits(1e-15, 1e15), "scale factor about the origin"] = 1.0
    crease_angle: Annotated[
        Degrees, Limits(0, 180), "edges of a mesh file with a larger angle are shaded as sharp, in degrees"
    ] = 30.0
    normals: Annotated[
        Literal["creases", "file"], "creases: normals from crease_angle; file: a mesh file's vertex normals (PLY, glTF)"
    ] = "creases"
    albedo: Annotated[
        Colour, "diffuse colour, each component in [0, 1], times the colours and textures of a mesh file"
    ] = (0.8, 0.8, 0.8)
    texture: Annotated[str | None, InputFile()] = Field(
        default=None,
        min_length=1,
        description="an image file, in sRGB, relative like path; default: the textures of the mesh file",
    )
    alpha_cutoff: Annotated[
        Annotated[float, Limits(0, 1)] | None,
        "alpha (the texture's times the vertices') below which the mesh is cut out; 0 for no alpha test; default: as "
        "in the mesh file",
    ] = None
    texture_wrap: Annotated[
        Annotated[scene.Wraps, Form(_WRAPS)] | None,
        "wrapping of the texture beyond its image: repeat, clamp or mirror; default: as in the mesh file, or repeat",
    ] = None
    texture_filter: Annotated[
        scene.TexelFilter | None,
        "filter between texels: linear (bilinear) or nearest; default: as in the mesh file, or linear",
    ] = None
    casts: Annotated[
        bool, "whether it casts shadows, or only receives them; reference.blockers can let it block rays"
    ] = True
    receives: Annotated[bool, "whether an engine shows shadows on it; pixels of others count in no error"] = True
    moving: ClassVar[Mapping[str, Setting]] = {**_vector("translate", Coordinate), **_vector("turn", Turn)}
    # For a fit to a picture.
    coloured: ClassVar[Mapping[str, Setting]] = colour_of("albedo", Fraction)

    @property
    def builtin(self) -> str | None:
        """The name of a library mesh, or `None` for a file."""
        return self.path.removeprefix(BUILTIN) if self.path.startswith(BUILTIN) else None

    def faults(self) -> Iterator[Conflict]:
        if self.builtin is None:
            if self.options:
                what = fault("are given with a mesh file", "options with a builtin mesh only", "remove the options")
                yield ("options",), what
            return
        for key in TEXTURE_KEYS:
            if getattr(self, key) is not None:
                yield (key,), fault("is given with a builtin mesh", "a mesh file, which may have UV", f"remove {key}")
        if self.normals == "file":
            yield ("normals",), fault("is file with a builtin mesh", "creases", "remove it")

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if not self.receives and not config.technique.is_selective:
            message = f"is false, and technique.type is {config.technique.type}, which shows shadows on all meshes"
            yield (*at, "receives"), fault(message, "true, or an engine's technique", "remove it")


class CameraOrbit(Section):
    """A camera placed by angles about the centre of the scene's first mesh."""

    azimuth: Annotated[Turn, "0 towards +z of the mesh, 90 towards +x, in degrees"] = 30.0
    elevation: Annotated[Degrees, Limits(-90, 90), "height above the horizon, in degrees"] = 30.0
    distance: Annotated[Radii, "distance from the mesh's middle, in radii of its bounding sphere"] = 2.5


class AnyCameraConfig(Section, scene.Camera):
    """A camera."""

    orbit: Annotated[CameraOrbit | None, "placement by angles about the first mesh, instead of eye"] = None
    eye: Annotated[Position | None, "position, in world units"] = None
    target: Annotated[Position | None, "point in the middle of the image, in world units"] = None
    antialias: Annotated[
        bool, "whether shaded pictures show the mean over each pixel along outlines and creases; errors ignore it"
    ] = False
    ascending = (("near", "far"),)
    exclusive = (("orbit", "eye", "target"),)
    # For a fit to a picture.
    moving: ClassVar[Mapping[str, Setting]] = {**_vector("eye", Coordinate), **_vector("turn", Turn)}

    @property
    def pixels(self) -> int:
        """The number of pixels of the image."""
        return math.prod(self.resolution)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if given(data, "orbit", "eye", "target") else {**data, "orbit": {}}

    def faults(self) -> Iterator[Conflict]:
        if self.pixels > MAX_PIXELS:
            message = f"is {list(self.resolution)}, which makes {self.pixels:,} pixels"
            expected = f"at most {MAX_PIXELS:,}, which take 5 GB"
            yield ("resolution",), fault(message, expected, "make it smaller, such as [4096, 4096]")
        if self.target is not None and self.eye is None and self.orbit is None:
            yield ("target",), fault("is given without eye", "eye with it", "add eye: [x, y, z] in world units")


class PinholeCameraConfig(AnyCameraConfig, scene.PinholeCamera):
    """A perspective camera."""

    near: Annotated[Distance | None, "distance of the near plane, in world units; default: tight"] = None
    far: Annotated[Distance | None, "distance of the far plane, in world units; default: tight"] = None
    moving: ClassVar[Mapping[str, Setting]] = {**AnyCameraConfig.moving, "fov_y": scene.PinholeCamera.each()["fov_y"]}


class OrthographicCameraConfig(AnyCameraConfig, scene.OrthographicCamera):
    """An orthographic camera."""

    height: Annotated[Distance | None, "height of the view, in world units; default: the whole scene"] = None
    near: Annotated[Coordinate | None, "distance of the near plane, in world units; default: tight"] = None
    far: Annotated[Coordinate | None, "distance of the far plane, in world units; default: tight"] = None
    moving: ClassVar[Mapping[str, Setting]] = {**AnyCameraConfig.moving, "height": Setting.of(Distance)}


CAMERAS = Variants(scene.Camera, "pinhole", __name__)
CameraConfig = Annotated[AnyCameraConfig, CAMERAS]


class SceneConfig(Section):
    """Meshes, camera and lights."""

    meshes: Annotated[
        tuple[MeshConfig, ...],
        Form("a list of meshes, each with a path"),
        "surfaces, each a caster and a receiver; cameras and lights orbit the first",
    ]
    camera: CameraConfig = Field(
        default_factory=CAMERAS.make,
        description="camera of the image; as auto, or without eye and orbit, it frames the casters and their shadows",
    )
    light: Annotated[LightConfig | None, "light that casts the shadows; auto: a sun, or a lamp inside a room"] = None
    lights: Annotated[
        Annotated[tuple[LightConfig, ...], Form("a list of lights")] | None, "several lights instead of one"
    ] = None
    ground: Annotated[Literal["auto"] | None, "auto: adds a plane under meshes that have no ground"] = None
    exclusive = (("light", "lights"),)

    @property
    def antialiases(self) -> bool:
        """Whether pictures are antialiased."""
        return self.camera.antialias

    @property
    def each_light(self) -> dict[KeyPath, LightConfig]:
        """All lights, by their key paths in this section."""
        if self.lights is None:
            return {} if self.light is None else {("light",): self.light}
        return {("lights", i): light for i, light in enumerate(self.lights)}

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        # `light: null` is reported in `faults`, unless `lights` is given instead.
        return data if "light" in data or given(data, "lights") else {**data, "light": {}}

    def faults(self) -> Iterator[Conflict]:
        if not self.meshes:
            yield ("meshes",), fault("is an empty list", "at least one mesh", "add '- path: builtin:torus_knot'")
        elif not any(mesh.casts for mesh in self.meshes):
            mend = "remove casts from one of them"
            yield ("meshes",), fault("hold no mesh that casts a shadow", "at least one mesh that casts", mend)
        if self.lights == ():
            yield ("lights",), fault("is an empty list", "at least one light", "add '- type: directional'")
        if self.lights is None and self.light is None:
            yield ("light",), fault("is empty", "a light", "remove the key to get its default")

    def cut_out(self, why: str, mend: str) -> Iterator[Conflict]:
        """Faults of alpha tests in methods that use the outlines of casters."""
        for i, mesh in enumerate(self.meshes):
            if mesh.alpha_cutoff:
                message = f"is {mesh.alpha_cutoff:g} {why}, whose outlines follow whole faces"
                what = fault(message, "meshes without an alpha test", f"remove it, or {mend}")
                yield ("scene", "meshes", i, "alpha_cutoff"), what
