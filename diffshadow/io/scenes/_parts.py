"""The content of a scene's file, in world space."""

from typing import Literal, NamedTuple

from jaxtyping import Float, Int

from ..._types import HostArray
from ...settings.engines import Side, ThreeJs
from ...settings.scene import LightKind, ShadowCamera, SpotLight
from .._looks import Texture

Vector = tuple[float, float, float]


class SceneMesh(NamedTuple):
    """Triangles with one material.

    - `vertices`, `normals`: (v, 3), world units and unit vectors; the normals are `None` if the file has no normals.
    - `faces`: (f, 3), indices into `vertices`.
    - `side`, `shadow_side`: the faces that are drawn, and the faces that are drawn into shadow maps; `None` if the
        engine chooses.
    - `casts`, `receives`: whether it casts and receives shadows.
    - `layers`: a bit for each layer that it is in.
    - `colour`: diffuse, each component in [0, 1].
    - `emits`: whether its material emits light, or is drawn as if it did.
    - `colours`: (v, 3), linear, of the vertices; `None` if they have no colours.
    - `uv`, `texture`: (v, 2), texture coordinates, and the texture that `colour` is multiplied by; or `None`.
    - `alpha`: (v,), the vertices' alpha, which the alpha test multiplies by the texture's alpha; `None` if all are 1.
    """

    name: str
    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "f 3"]
    normals: Float[HostArray, "v 3"] | None
    side: Side = "front"
    shadow_side: Side | None = None
    casts: bool = True
    receives: bool = True
    layers: int = 1
    colour: Vector = (0.8, 0.8, 0.8)
    emits: bool = False
    colours: Float[HostArray, "v 3"] | None = None
    uv: Float[HostArray, "v 2"] | None = None
    texture: Texture | None = None
    alpha: Float[HostArray, " v"] | None = None


class SceneCamera(NamedTuple):
    """A camera.

    - `eye`, `forward`, `up`: its position in world units, and unit vectors.
    - `fov_y`: full vertical field of view in degrees; `None` for a parallel camera.
    - `height`: the height of a parallel camera's view, world units.
    - `aspect`: width over height; `None` if the file does not say.
    - `near`, `far`: world units; `far` is `None` if there is no far plane.
    - `layers`: a bit for each layer that it sees.
    """

    name: str
    eye: Vector
    forward: Vector
    up: Vector
    near: float
    far: float | None
    fov_y: float | None = None
    height: float | None = None
    aspect: float | None = None
    layers: int = 1


class SceneShadow(NamedTuple):
    """The settings of a light's shadow, with the names, units and defaults of three.js.

    - `near`, `far`: distances of its camera's planes; `window`: left, right, top and bottom of a directional light's
        camera.
    - `map_size`: (width, height), texels.
    - `half_angle`: half the vertical angle of a spot light's camera, in degrees; `aspect`: its width over its height.
    """

    near: float
    far: float
    window: tuple[float, float, float, float] = (
        ShadowCamera.left,
        ShadowCamera.right,
        ShadowCamera.top,
        ShadowCamera.bottom,
    )
    map_size: tuple[int, int] = (512, 512)
    bias: float = ThreeJs.bias
    normal_bias: float = ThreeJs.normal_bias
    radius: float = ThreeJs.radius
    intensity: float = ThreeJs.intensity
    blur_samples: int = ThreeJs.blur_samples
    half_angle: float | None = None
    aspect: float = SpotLight.aspect


class SceneLight(NamedTuple):
    """A light.

    - `position`, `direction`: its position in world units, and the direction in which it shines, of any length but 0; a
        point light has no direction.
    - `inner_angle`, `outer_angle`: angles of a spot light's cone, in degrees.
    - `casts`: whether it casts shadows; `shadow`: the settings of its shadows, `None` if the file has no settings.
    - `layers`: a bit for each layer that it is in.
    """

    name: str
    type: LightKind
    position: Vector
    direction: Vector | None
    inner_angle: float | None = None
    outer_angle: float | None = None
    casts: bool = True
    shadow: SceneShadow | None = None
    layers: int = 1


class SceneFile(NamedTuple):
    """A scene.

    - `meshes`, `cameras`, `lights`: in the order of the file.
    - `engine`: the engine whose settings these are.
    - `remarks`: the omitted or changed parts, each as a sentence without a full stop.
    - `left_out`: the number of meshes, or parts of meshes, that were left out. `remarks` has the reasons.
    """

    meshes: list[SceneMesh]
    cameras: list[SceneCamera]
    lights: list[SceneLight]
    engine: Literal["three.js"] | None
    remarks: list[str]
    left_out: int = 0
