"""The configuration of another program's scene."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ... import geometry, io
from ...settings.engines import ImportedTechnique, ShadowType, ThreeJs
from ._lamp import HALF_ANGLE, distance_lit, lamp_size

# Pixels of the image's longer side.
_PIXELS = 512
# Bounds of a fit, as fractions of the diagonal of the scene's box: for the shift of a bias, and for a normal bias.
_SHIFT, _OFFSET = 0.04, 0.0125
_RADIUS = 6.0
# More digits than single precision has.
_DIGITS = 9


class _Remedies(NamedTuple):
    """How to change another program's scene so that its file has the missing parts."""

    light: str
    mesh: str


_THREE_JS = _Remedies(
    "set light.castShadow = true before scene.toJSON()",
    "set mesh.castShadow = true before scene.toJSON()",
)
_GLTF = _Remedies(
    "add a directional, spot or point light, and export the scene with its lights (KHR_lights_punctual)",
    "export the scene with its meshes, as triangles",
)


class Chosen(NamedTuple):
    """The parts of a scene's file that become a configuration."""

    meshes: list[io.SceneMesh]
    camera: io.SceneCamera
    light: io.SceneLight


def choose(scene: io.SceneFile, camera: str | None, light: str | None, remarks: list[str]) -> Chosen:
    """The camera and light with these names, or the first ones, with the visible and lit meshes. Adds a remark for each
    omitted part to `remarks`.

    **Raises** `ValueError` if there is no such camera or light, or no mesh.
    """
    remedies = _GLTF if scene.engine is None else _THREE_JS
    check_casters(scene, scene.meshes)
    seen = _named("camera", scene.cameras, camera, remarks)
    lit = [each for each in scene.lights if each.layers & seen.layers]
    casting = [each for each in lit if each.casts]
    if not casting and light is None:
        found = f"{len(lit)} without castShadow" if lit else "no directional, spot or point light that its camera sees"
        named = ", or name a light with --light" if lit else ""
        raise ValueError(f"the scene has no light that casts shadows ({found}); expected one: {remedies.light}{named}")
    remarks += [f"{each.name}: castShadow = false; left out" for each in lit if not each.casts and each.name != light]
    shining = _named("light", lit if light is not None else casting, light, remarks)
    meshes = [mesh for mesh in scene.meshes if mesh.layers & seen.layers]
    unseen = [mesh.name for mesh in scene.meshes if not mesh.layers & seen.layers]
    remarks += [f"{name}: not in the camera's layers; left out" for name in unseen]
    check_casters(scene, meshes)
    return Chosen(meshes, seen, shining)


def check_casters(scene: io.SceneFile, meshes: Sequence[io.SceneMesh]) -> None:
    """**Raises** `ValueError` unless one of `meshes`, which the camera of `scene` sees, casts shadows."""
    if not any(mesh.casts for mesh in meshes):
        remedies = _GLTF if scene.engine is None else _THREE_JS
        found = f"{len(meshes)} without castShadow" if meshes else "no triangles that its camera sees"
        mend = remedies.mesh
        if scene.left_out:
            found += f", and {scene.left_out} left out"
            mend = f"fix the omitted parts as in the notes, or {mend}"
        raise ValueError(f"the scene has no mesh that casts shadows ({found}); expected one: {mend}")


def _named[T: (io.SceneCamera, io.SceneLight)](
    what: str, entries: Sequence[T], name: str | None, remarks: list[str]
) -> T:
    """The entry with this name, or the first entry."""
    names = ", ".join(dict.fromkeys(each.name for each in entries))
    if name is None:
        remarks += [f"{each.name}: another {what}; left out; --{what} selects it" for each in entries[1:]]
        return entries[0]
    found = [each for each in entries if each.name == name]
    if not found:
        raise ValueError(
            f"--{what} is {name!r}, and the scene has {names or 'none'}; expected one of its {what}s' names"
        )
    return found[0]


# Upper bounds of the biases of engines whose settings scene files do not store.
_MOST: dict[str, dict[str, float]] = {
    "playcanvas": {"shadow_bias": 1.0, "normal_offset_bias": 0.2},
    "bevy": {"shadow_depth_bias": 0.5, "shadow_normal_bias": 4.0},
    "godot_compatibility": {"shadow_bias": 10.0, "shadow_normal_bias": 4.0},
}


def settings_of(
    chosen: Chosen,
    files: Sequence[str],
    textures: Sequence[str | None],
    origins: Sequence[geometry.Origin],
    engine: bool,
    technique: ImportedTechnique,
    shadow_type: ShadowType,
    remarks: list[str],
) -> dict[str, Any]:
    """The configuration of `chosen`, with meshes in `files` and their `textures`. Adds differences from the scene to
    `remarks`.

    **Arguments:**

    - `origins`: for each mesh, the world point that is the origin of its file.
    - `engine`: whether the scene defines how shadows are drawn. If not, the technique has its defaults.
    """
    meshes, camera, light = chosen
    points = np.concatenate([mesh.vertices[np.unique(mesh.faces)] for mesh in meshes])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    shadow = light.shadow if engine else None
    distance = distance_lit(meshes, np.asarray(light.position))
    settings: dict[str, Any] = {
        "scene": {
            "meshes": [_mesh(*each) for each in zip(meshes, files, textures, origins, strict=True)],
            "camera": _camera(camera, middle, diagonal, remarks),
            "light": _light(chosen, shadow, middle, diagonal, remarks),
        }
    }
    if shadow is not None:
        settings["shadow_map"] = {"resolution": [*reversed(shadow.map_size)]}
    if technique == "three.js":
        settings["technique"] = _three_js(meshes, shadow, shadow_type)
        given = settings["technique"]
        fitted = _bounds(given, _depth_slope(light, shadow, distance, diagonal), diagonal)
        if shadow_type == "BasicShadowMap":
            del fitted["technique.radius"]
        settings["fit"] = {"parameters": fitted}
    elif technique != "shadow_map":
        # Scene files do not store their settings.
        settings["technique"] = {"type": technique}
        if shadow is not None:
            size = max(shadow.map_size)
            # Their maps are square, and Bevy's sides are powers of two.
            settings["shadow_map"] = {"resolution": [1 << (size - 1).bit_length()] * 2}
            remarks.append(f"bias, normalBias and radius of the light's shadow: left out with technique {technique}")
        bounds = {f"technique.{key}": {"lower": 0, "upper": most} for key, most in _MOST[technique].items()}
        settings["fit"] = {"parameters": bounds}
    else:
        settings["technique"] = {"type": technique}
        for mesh in settings["scene"]["meshes"]:
            if mesh.pop("receives", True) is False:
                remarks.append(f"{mesh['path']}: receiveShadow = false is left out with technique shadow_map")
        if shadow is not None:
            remarks.append("bias, normalBias and radius of the light's shadow: left out with technique shadow_map")
        settings["fit"] = {
            "parameters": {"bias.constant": {"lower": 0, "upper": 30}, "filter.radius": {"lower": 0, "upper": 16}}
        }
    settings["reference"] = {"samples": 64}
    settings["output"] = "runs"
    return settings


def _mesh(mesh: io.SceneMesh, file: str, texture: str | None, origin: geometry.Origin) -> dict[str, Any]:
    settings: dict[str, Any] = {"path": file, "normals": "file" if mesh.normals is not None else "creases"}
    if origin != geometry.WORLD:
        settings["translate"] = [*origin]
    if mesh.normals is None:
        settings["crease_angle"] = 0
    settings["albedo"] = _rounded(mesh.colour, 4)
    if mesh.texture is not None:
        settings |= {} if texture is None else {"texture": texture, **_sampler(mesh.texture.sampler)}
        if mesh.texture.cutoff is not None:
            settings["alpha_cutoff"] = _rounded([mesh.texture.cutoff])[0]
    return settings | ({} if mesh.casts else {"casts": False}) | ({} if mesh.receives else {"receives": False})


def _sampler(sampler: geometry.Sampler) -> dict[str, Any]:
    """The keys of a texture that is not read in the default way."""
    default = geometry.Sampler()
    wrap = {"texture_wrap": _each([*sampler.wrap])} if sampler.wrap != default.wrap else {}
    return wrap | ({"texture_filter": sampler.filter} if sampler.filter != default.filter else {})


def _camera(camera: io.SceneCamera, middle: Any, diagonal: float, remarks: list[str]) -> dict[str, Any]:
    aspect = camera.aspect
    if aspect is None:
        remarks.append(f"{camera.name}: it has no aspect ratio; its image is made square")
        aspect = 1.0
    height, width = (_PIXELS, _PIXELS * aspect) if aspect < 1 else (_PIXELS / aspect, _PIXELS)
    eye, forward = np.asarray(camera.eye), np.asarray(camera.forward)
    # The point on its axis closest to the centre of the scene, which is easy to read.
    reach = max(float((middle - eye) @ forward), 1e-3 * float(np.abs(middle - eye).max()), camera.near or 1e-3)
    settings: dict[str, Any] = {
        "type": "orthographic" if camera.fov_y is None else "pinhole",
        "eye": _place(eye, diagonal),
        "target": _place(eye + reach * forward, diagonal),
        "up": _rounded(camera.up),
    }
    if camera.fov_y is None:
        assert camera.height is not None
        settings["height"] = _rounded([camera.height])[0]
    else:
        settings["fov_y"] = _rounded([camera.fov_y])[0]
    settings["near"] = _rounded([camera.near])[0]
    if camera.far is not None:
        settings["far"] = _rounded([camera.far])[0]
    return settings | {"resolution": [max(1, round(height)), max(1, round(width))]}


def _light(
    chosen: Chosen, shadow: io.SceneShadow | None, middle: Any, diagonal: float, remarks: list[str]
) -> dict[str, Any]:
    light, position = chosen.light, np.asarray(chosen.light.position)
    settings: dict[str, Any] = {"type": light.type}
    if light.type == "directional":
        settings |= {"direction": _rounded(light.direction), "angular_radius": HALF_ANGLE}
        size = f"its light's angular_radius is {HALF_ANGLE:g} degrees"
        if shadow is not None:
            sides = dict(zip(("left", "right", "top", "bottom"), _rounded(shadow.window), strict=True))
            near, far = _rounded([shadow.near, shadow.far])
            settings["shadow_camera"] = {"position": _place(position, diagonal), **sides, "near": near, "far": far}
    else:
        settings["position"] = _place(position, diagonal)
        size, taken_from = lamp_size(chosen.meshes, position)
        radius = _rounded([size], 2)[0]
        if light.type == "spot":
            settings |= _cone(light, shadow, position, middle, diagonal, remarks)
        settings["radius"] = radius
        size = f"its light's radius is {radius:g} world units, {taken_from}"
        if shadow is not None:
            settings["near"], settings["far"] = _rounded([shadow.near, shadow.far])
    remarks.append(
        f"{light.name}: engines' lights have no size; {size}; radius is fitted to the penumbrae of this light"
    )
    return settings


def _cone(
    light: io.SceneLight,
    shadow: io.SceneShadow | None,
    position: Any,
    middle: Any,
    diagonal: float,
    remarks: list[str],
) -> dict[str, Any]:
    assert light.direction is not None
    assert light.inner_angle is not None
    assert light.outer_angle is not None
    axis = np.asarray(light.direction) / np.linalg.norm(light.direction)
    reach = max(float((middle - position) @ axis), 1e-3 * float(np.abs(middle - position).max()), 1e-3)
    half = light.outer_angle if shadow is None or shadow.half_angle is None else shadow.half_angle
    limited = min(half, 89.9)
    if limited < half:
        remarks.append(f"{light.name}: its cone of {half:.4g} degrees is narrowed to {limited:g}")
    if abs(limited - light.outer_angle) > 1e-6 * limited:
        remarks.append(f"{light.name}: the shading's cone ends at the shadow camera's angle, {limited:.4g} degrees")
    settings: dict[str, Any] = {
        "target": _place(position + reach * axis, diagonal),
        "outer_angle": _rounded([limited])[0],
        "inner_angle": _rounded([min(light.inner_angle, limited)])[0],
    }
    aspect = 1.0 if shadow is None else shadow.aspect
    return settings if abs(aspect - 1) < 1e-9 else settings | {"aspect": _rounded([aspect])[0]}


def _three_js(meshes: Sequence[io.SceneMesh], shadow: io.SceneShadow | None, shadow_type: ShadowType) -> dict[str, Any]:
    settings: dict[str, Any] = {"type": "three.js", "shadow_type": shadow_type, "side": _each([m.side for m in meshes])}
    if any(mesh.shadow_side is not None for mesh in meshes):
        settings["shadow_side"] = _each([mesh.shadow_side for mesh in meshes])
    if shadow is None:
        return settings
    bias, normal_bias, radius, intensity = _rounded([shadow.bias, shadow.normal_bias, shadow.radius, shadow.intensity])
    settings |= {"bias": bias, "normal_bias": normal_bias, "radius": radius}
    settings |= {} if intensity == 1 else {"intensity": intensity}
    return settings | ({"blur_samples": shadow.blur_samples} if shadow_type == "VSMShadowMap" else {})


def _depth_slope(light: io.SceneLight, shadow: io.SceneShadow | None, distance: float, diagonal: float) -> float:
    """Window depth per world unit at `distance`, the median distance of the lit surfaces. A map that is fitted to the
    scene is as deep as the scene, or extends from half this distance to one and a half times it."""
    is_directional = light.type == "directional"
    fitted = (0, diagonal) if is_directional else (0.5 * distance, 1.5 * distance)
    near, far = fitted if shadow is None else (shadow.near, shadow.far)
    if not far > near:
        # Configurations do not have these properties; the check of the configuration says so.
        return 0.0
    if is_directional:
        return 1 / (far - near)
    return far * near / ((far - near) * min(max(distance, near), far) ** 2)


def _bounds(given: dict[str, Any], slope: float, diagonal: float) -> dict[str, Any]:
    """Bounds of the numbers to fit, which contain the given numbers."""
    bias, normal_bias, radius = (given.get(key, getattr(ThreeJs, key)) for key in ("bias", "normal_bias", "radius"))
    (shift,), (offset,) = _rounded([min(_SHIFT * diagonal * slope, 1.0)], 2), _rounded([_OFFSET * diagonal], 2)
    return {
        "technique.bias": {"lower": max(-1.0, min(-shift, 2 * bias)), "upper": min(1.0, max(0.0, 2 * bias))},
        "technique.normal_bias": {"lower": min(0.0, 2 * normal_bias), "upper": max(offset, 2 * normal_bias)},
        "technique.radius": {"lower": 0.0, "upper": max(_RADIUS, 2 * radius)},
    }


def _each[T: (str, str | None)](values: list[T]) -> T | list[T]:
    return values[0] if len(set(values)) == 1 else values


def _place(point: Any, diagonal: float) -> list[float]:
    """A point of the world with nine digits. Far from the world's origin, at more than a hundred times the scene's
    `diagonal`, it has more."""
    beyond = float(np.abs(point).max()) / (100 * max(diagonal, np.finfo(np.float32).tiny))
    return _rounded(point, min(_DIGITS + (math.ceil(math.log10(beyond)) if beyond > 1 else 0), 17))


def _rounded(values: Any, digits: int = _DIGITS) -> list[float]:
    """`values` with this many digits, more than single precision has."""
    return [float(f"{value:.{digits}g}") + 0.0 for value in values]
