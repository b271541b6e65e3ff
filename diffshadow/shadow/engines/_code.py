"""Fitted settings as code to paste into a program that uses the engine."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ...geometry import WORLD, AbstractLight, Origin
from ._abstract import AbstractEngineShadows
from ._light import EngineLight, plain

if TYPE_CHECKING:
    from ._babylon import BabylonJs
    from ._three import ThreeJs


def engine_code(
    settings: AbstractEngineShadows,
    light: AbstractLight | EngineLight,
    distances: tuple[float, float],
    origin: Origin = WORLD,
) -> str:
    """Code in the engine's language that sets `settings` for `light`, with comments on its range of validity.

    **Arguments:**

    - `light`: a light of this library, or the engine's light.
    - `distances`: distances of the nearest and the farthest receiver along the light's axis, in world units.
    - `origin`: the world point that the coordinates of the light's scene are relative to.

    **Raises** the errors of `EngineLight.of`.
    """
    given = light if isinstance(light, EngineLight) else EngineLight.of(light, settings.resolution)
    return "\n".join([*settings.code(given, distances, origin), ""])


def three_js_code(settings: "ThreeJs", given: EngineLight, distances: tuple[float, float], origin: Origin) -> list[str]:
    height, width = settings.resolution
    bias, normal_bias = float(settings.bias), float(settings.normal_bias)
    lines = [
        "renderer.shadowMap.enabled = true;",
        f"renderer.shadowMap.type = THREE.{settings.shadow_type};",
        f"light.position.set({place(given.position, origin)});",
    ]
    if given.target is not None:
        lines += [f"light.target.position.set({place(given.target, origin)});"]
        lines += ["light.target.updateMatrixWorld();"]
    if given.angle is not None and given.aspect is not None:
        lines += [f"light.angle = {number(given.angle)};  // radians"]
        lines += [] if abs(given.aspect - 1) < 1e-6 else [f"light.shadow.aspect = {number(given.aspect)};"]
    camera: Mapping[str, float] = {**(given.window or {}), "near": given.near, "far": given.far}
    pairs = ", ".join(f"{name}: {number(value)}" for name, value in camera.items())
    lines += [
        "light.castShadow = true;",
        f"light.shadow.mapSize.set({width}, {height});",
        f"Object.assign(light.shadow.camera, {{ {pairs} }});",
        "light.shadow.camera.updateProjectionMatrix();",
        f"light.shadow.bias = {number(bias)};  // {in_world(given, bias, distances)}",
        f"light.shadow.normalBias = {number(normal_bias)};  // world units{in_texels(given, normal_bias, width)}",
    ]
    if settings.shadow_type != "BasicShadowMap":
        lines += [f"light.shadow.radius = {number(float(settings.radius))};  // texels of this map size"]
    if settings.shadow_type == "VSMShadowMap":
        lines += [f"light.shadow.blurSamples = {settings.blur_samples};"]
    if float(settings.intensity) != 1:
        lines += [f"light.shadow.intensity = {number(float(settings.intensity))};"]
    constants = {"front": "THREE.FrontSide", "back": "THREE.BackSide", "double": "THREE.DoubleSide"}
    for name, side in (("side", settings.side), ("shadowSide", settings.shadow_side)):
        if isinstance(side, str):
            lines += [f"material.{name} = {constants[side]};"]
        elif side is not None:
            each = ("null" if one is None else constants[one] for one in side)
            lines += [f"// material.{name} of each mesh: {', '.join(each)}"]
    if settings.reversed_depth:
        lines += ["// for a renderer with reversedDepthBuffer: true"]
    is_linear = given.type == "directional"
    if not is_linear:
        lines += ["light.distance = 0;  // another distance replaces the camera's far"]
    return [*_where_it_holds("three.js r187, WebGLRenderer", is_linear), *lines]


def babylon_js_code(
    settings: "BabylonJs", given: EngineLight, distances: tuple[float, float], origin: Origin
) -> list[str]:
    is_point = given.type == "point"
    # The other filters' bias is a fraction of a range that is linear in depth.
    by_depth = settings.filter in ("PCF", "PCSS") and not is_point
    bias, normal_bias = float(settings.bias), float(settings.normal_bias)
    if by_depth:
        # Half of it is window depth. It pushes casters, in the same way as a negative bias lifts receivers.
        amount = in_world(given, -bias / 2, distances)
    else:
        amount = f"{about(bias * (given.near + given.far if is_point else given.far - given.near))} world units"
    arguments = str(settings.resolution[0]), "light", flag(settings.float_maps)
    lines = [
        *_babylon_light(given, origin),
        f"const generator = new BABYLON.ShadowGenerator({', '.join(arguments)});",
        f"generator.bias = {number(bias)};  // {amount}",
        f"generator.normalBias = {number(normal_bias)};  // world units"
        f"{in_texels(given, normal_bias, settings.resolution[1])}",
        *(f"generator.{name} = {value};" for name, value in _babylon_filter(settings, is_point).items()),
    ]
    if settings.force_back_faces_only:
        lines += ["generator.forceBackFacesOnly = true;"]
    culling = settings.back_face_culling
    if isinstance(culling, tuple):
        lines += [f"// material.backFaceCulling of each mesh: {', '.join(map(flag, culling))}"]
    elif not culling:
        lines += ["material.backFaceCulling = false;"]
    if float(settings.darkness):
        lines += [f"generator.setDarkness({number(float(settings.darkness))});"]
    is_linear = given.type == "directional" or not by_depth
    return [*_where_it_holds("Babylon.js 9.34, ShadowGenerator on WebGL2", is_linear), *lines]


def _babylon_light(given: EngineLight, origin: Origin) -> list[str]:
    """The position of the light and its camera."""
    lines = [f"light.position = new BABYLON.Vector3({place(given.position, origin)});"]
    if given.direction is not None:
        lines += [f"light.direction = {_vector(given.direction)};"]
    if given.angle is not None:
        lines += [f"light.angle = {number(2 * given.angle)};  // radians, the full cone"]
    if given.window is not None:
        # The engine's camera is left-handed, so its x axis is reversed.
        left, right, top, bottom = (given.window[key] for key in ("left", "right", "top", "bottom"))
        window = {"orthoLeft": -right, "orthoRight": -left, "orthoTop": top, "orthoBottom": bottom}
        lines += ["light.autoUpdateExtends = false;", "light.shadowOrthoScale = 0;"]
        lines += [f"light.{key} = {number(value)};" for key, value in window.items()]
    return [*lines, f"light.shadowMinZ = {number(given.near)};", f"light.shadowMaxZ = {number(given.far)};"]


def _babylon_filter(settings: "BabylonJs", is_point: bool) -> dict[str, str]:
    """The generator's properties that the filter uses, and their values."""
    name, constants = settings.filter, "BABYLON.ShadowGenerator"
    used = {"filter": f"{constants}.FILTER_{name}"}
    if name in ("PCF", "PCSS"):
        used["filteringQuality"] = f"{constants}.QUALITY_{settings.quality}"
    if name == "PCSS":
        used["contactHardeningLightSizeUVRatio"] = number(float(settings.contact_hardening_light_size_uv_ratio))
    # Under a point light the engine draws PCF and PCSS as POISSONSAMPLING.
    if name == "POISSONSAMPLING" or name.startswith("BLUR") or (is_point and name in ("PCF", "PCSS")):
        used["blurScale"] = number(float(settings.blur_scale))
    if name.startswith("BLUR"):
        used["useKernelBlur"] = flag(settings.use_kernel_blur)
        key, value = (
            ("blurKernel", settings.blur_kernel)
            if settings.use_kernel_blur
            else ("blurBoxOffset", settings.blur_box_offset)
        )
        used[key] = str(value)
    if name.endswith("EXPONENTIALSHADOWMAP"):
        used["depthScale"] = number(float(settings.depth_scale))
    if float(settings.frustum_edge_falloff):
        used["frustumEdgeFalloff"] = number(float(settings.frustum_edge_falloff))
    return used


def _where_it_holds(engine: str, is_linear: bool) -> list[str]:
    if is_linear:
        scale = "With another depth range (far - near), multiply the bias by the old range over the new one."
    else:
        scale = "Bias is window depth, which depends on near and far: fit it again for others."
    return [
        f"// {engine}.",
        f"// Valid for this map size, near and far. {scale}",
        "// With another map size, normalBias is proportional to the size of a texel.",
    ]


def flag(value: bool) -> str:
    return "true" if value else "false"


def _vector(values: Sequence[float]) -> str:
    return f"new BABYLON.Vector3({', '.join(map(number, values))})"


def in_world(light: EngineLight, bias: float, distances: tuple[float, float]) -> str:
    """The shift towards the light that a bias causes."""
    depth = light.far - light.near
    if light.type == "directional":
        return f"{about(-bias * depth)} world units towards the light"
    # z' = f n / ((f - n) d²)
    shifts = [-bias * depth * d * d / (light.far * light.near) for d in distances]
    near, far = (about(distance) for distance in distances)
    return f"{about(shifts[0])} world units at the distance {near}, {about(shifts[1])} at {far}"


def in_texels(light: EngineLight, length: float, width: int) -> str:
    if light.window is None or length == 0:
        return ""
    return f", {about(length / (light.window['right'] - light.window['left']) * width)} texels"


def about(value: float) -> str:
    """The effect of a setting in world units."""
    return f"{value + 0.0:.5g}"


def place(position: Sequence[float], origin: Origin) -> str:
    """A point of the world as text. `position` is relative to `origin`, in single precision."""
    if origin == WORLD:
        return ", ".join(map(number, position))
    return ", ".join(f"{float(number(at)) + start:.15g}" for at, start in zip(position, origin, strict=True))


def number(value: float) -> str:
    """`value` with the fewest digits that read back as the same number in single precision; never -0."""
    (number,) = plain([value])
    return f"{number:.9g}"
