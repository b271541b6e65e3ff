"""A page that draws a scene with the exported shader. It is one file for any browser with WebGL 2."""

import base64
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import yaml
from markupsafe import Markup

from ... import geometry, raster, shading, shadow
from ..._arithmetic import normalize
from ...config import (
    CONFIG_FILE,
    FITTED_FILE,
    Config,
    build_shading,
    build_technique,
    describe,
    dump,
    dump_resolved,
    fit_paths,
    load_config,
    parse_config,
)
from ..pages._page import write_page

PAGE = "page.html"
# The signature of the function that the page calls. It takes one map of depths.
_FUNCTION = (
    "float shadow(sampler2D map, mat4 world_to_eye, mat4 eye_to_clip, vec3 position, vec3 normal, vec3 to_light, "
    "vec2 pixel, int layer) {"
)


class Compared(NamedTuple):
    """The names of the two settings that a page compares, and the configuration of the first."""

    start: str
    end: str
    config: Config


def compared_with(config: Config, file: Path, overrides: Sequence[str]) -> Compared:
    """The setting to compare with. For a fit, it is the setting before the fit. For any other configuration, the
    fittable numbers have their defaults.

    **Arguments:** `file`, `overrides`: the file and the overrides that `config` was loaded from.
    """
    if file.name == FITTED_FILE:
        before = load_config(file.parent / CONFIG_FILE, [])
        starts = {name: each.initial for name, each in before.fit.parameters.items() if name in fit_paths(before)}
        initial = [f"{name}={value!r}" for name, value in starts.items() if value is not None]
        return Compared("before the fit", "fitted", load_config(file.parent / CONFIG_FILE, [*initial, *overrides]))
    settings = yaml.safe_load(dump_resolved(config))
    for name in fit_paths(config):
        section, _, key = name.partition(".")
        settings[section].pop(key, None)
    return Compared("default", "this setting", parse_config(dump(settings), name=config.name))


def check_page(config: Config, scene: geometry.Scene, technique: shadow.ShadowMapping) -> None:
    """**Raises** `ValueError` for a technique or scene that has a shader but cannot be drawn by the page."""
    if not isinstance(technique.layout, shadow.SingleMap) or not all(
        _FUNCTION in shadow.to_shader(technique, light, "glsl") for light in scene.lights
    ):
        raise ValueError(
            f"the filter is {type(technique.filter).__name__} and the layout {type(technique.layout).__name__}, "
            "and their shader needs more than one depth map, which the page cannot draw: leave out --page"
        )
    if technique.map.depth_layer != "nearest":
        raise ValueError(
            f"the map's depth_layer is {technique.map.depth_layer!r}, which the page does not draw; expected "
            "'nearest': leave out --page"
        )
    if scene.mesh.alpha_test is not None:
        raise ValueError(
            "a mesh has an alpha test, which the page does not draw; expected surfaces without holes in their "
            "textures: leave out --page"
        )
    if len(scene.lights) > 1 and config.shading.type == "modulated":
        raise ValueError(
            f"the shading is modulated with {len(scene.lights)} lights, which the page does not draw; expected one "
            "light, or phong: leave out --page"
        )


def write_shader_page(
    path: Path,
    config: Config,
    scene: geometry.Scene,
    technique: shadow.ShadowMapping,
    compared: Compared,
    title: str,
) -> list[str]:
    """Writes the page of `scene` to `path`.

    **Arguments:**

    - `compared`: the second setting. If both settings give the same shader, the page shows one picture.

    **Returns** remarks on how the page differs from a render.
    """
    shown = {compared.start: compared.config, compared.end: config}
    texts = {
        name: [shadow.to_shader(build_technique(each, fitting=False), light, "glsl") for light in scene.lights]
        for name, each in shown.items()
    }
    if texts[compared.start] == texts[compared.end]:
        del texts[compared.start]
    # Most lines of the two shaders are the same.
    lines = list(dict.fromkeys(line for each in texts.values() for text in each for line in text.split("\n")))
    place = {line: number for number, line in enumerate(lines)}
    numbered = [[[place[line] for line in text.split("\n")] for text in each] for each in texts.values()]
    height, width = scene.camera.resolution
    data = {
        "width": width,
        "height": height,
        "mesh": _mesh_of(scene),
        "camera": _camera_of(scene),
        "map": _map_of(technique.map),
        "lights": [_light_of(light, each) for light, each in zip(scene.lights, _intensities(config), strict=True)],
        "shading": _shading_of(config),
        "lines": lines,
        "settings": [{"shaders": each} for each in numbered],
    }
    remarks = []
    if scene.mesh.textures is not None:
        remarks.append("The page has no textures. Each face has its mean colour.")
    if config.scene.antialiases:
        remarks.append("The page samples pixel centres. Outlines are not antialiased.")
    write_page(
        path,
        "shader_page.html.j2",
        title=title,
        # A "<" could end the script element.
        data=Markup(json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")),
        names=list(texts),
        rows=_rows([shown[name] for name in texts]),
        lights=len(scene.lights),
        remarks=remarks,
        width=width,
        height=height,
    )
    return remarks


def _rows(settings: Sequence[Config]) -> list[tuple[str, str, list[str]]]:
    """The fittable numbers: name, unit, and value in each setting."""
    each = [{row.key: row for row in describe(config)} for config in settings]
    names = [name for name in fit_paths(settings[-1]) if any(name in rows for rows in each)]
    unit = lambda name: next(rows[name].unit for rows in reversed(each) if name in rows)
    return [(name, unit(name), [rows[name].value if name in rows else "none" for rows in each]) for name in names]


def _mesh_of(scene: geometry.Scene) -> dict[str, Any]:
    """The scene's triangles, casters first: the vertices' positions, normals and colours, and the faces' vertices."""
    mesh, casts = scene.mesh, scene.casting_faces
    order = np.argsort(~casts, kind="stable")
    colours = np.repeat(geometry.face_colours(mesh)[:, None], 3, axis=1)
    if mesh.corner_colours is not None and mesh.textures is None:
        colours = np.asarray(mesh.albedo)[:, None] * np.asarray(mesh.corner_colours)
    corners = np.concatenate(
        [
            np.asarray(mesh.faces)[order].reshape(-1, 1),
            np.rint(np.asarray(mesh.corner_normals)[order].reshape(-1, 3) * 32767).astype(int),
            np.rint(colours[order].reshape(-1, 3) * 65535).astype(int),
        ],
        axis=1,
    )
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    arrays = [
        np.asarray(mesh.vertices, "<f4")[vertices[:, 0]],
        index.astype("<u4"),
        vertices[:, 1:4].astype("<i2"),
        vertices[:, 4:].astype("<u2"),
    ]
    packed = zlib.compress(b"".join(array.tobytes() for array in arrays), 9)
    numbers = {"vertices": len(vertices), "faces": len(order), "casters": int(casts.sum())}
    return {**numbers, "bytes": base64.b64encode(packed).decode("ascii")}


def _columns(matrix: Any) -> list[float]:
    """Matrices in column-major order, for WebGL."""
    return np.swapaxes(np.asarray(matrix, np.float64), -1, -2).ravel().tolist()


def _numbers(values: Any) -> list[float]:
    return np.asarray(values, np.float64).ravel().tolist()


def _camera_of(scene: geometry.Scene) -> dict[str, Any]:
    """The camera, the point that it orbits, and its limits."""
    camera, mesh = scene.camera, scene.mesh
    view = raster.drawn_view(camera.view(), mesh)
    to_eye, points = np.asarray(view.world_to_eye, np.float64), np.asarray(mesh.vertices, np.float64)
    middle = np.asarray(getattr(camera, "target", (points.min(axis=0) + points.max(axis=0)) / 2), np.float64)
    # On the camera's axis, in front of it.
    eye = np.linalg.inv(to_eye)[:3, 3]
    target = eye - to_eye[2, :3] * max((eye - middle) @ to_eye[2, :3], 2 * float(view.near))
    return {
        "world_to_eye": _columns(to_eye),
        "eye_to_clip": _columns(view.eye_to_clip),
        "perspective": bool(view.is_perspective),
        "target": target.tolist(),
        "near": float(camera.view().near),
        # The distance from the target to the farthest point, in world units.
        "reach": float(np.linalg.norm(points - target, axis=1).max()),
        # The camera's elevation above its target, in radians.
        "elevation": float(np.arcsin(np.clip(to_eye[2, 1], -1, 1))),
    }


def _map_of(settings: shadow.MapSettings) -> dict[str, Any]:
    height, width = settings.resolution
    offset = settings.polygon_offset
    size = {"width": width, "height": height}
    return {**size, "format": settings.depth_format, "cull": settings.cull, "offset": offset and _numbers(offset)}


def _light_of(light: geometry.AbstractLight, intensity: Any) -> dict[str, Any]:
    view = light.view()
    to_eye = np.asarray(view.world_to_eye, np.float64)
    if light.is_directional:
        place = [*_numbers(normalize(light.towards(jnp.zeros(3)))), 0.0]
    else:
        place = [*_numbers(np.linalg.inv(to_eye.reshape(-1, 4, 4)[0])[:3, 3]), 1.0]
    cone, has_cone = {"axis": [0.0, 0.0, -1.0], "cone_outer": 0.0, "cone_width": 1.0}, False
    if isinstance(light, geometry.SpotLight) and light.inner_angle is not None:
        inner, outer = (float(np.cos(np.deg2rad(float(angle)))) for angle in (light.inner_angle, light.outer_angle))
        axis, has_cone = np.asarray(light.direction, np.float64), True
        cone = {
            "axis": (axis / np.linalg.norm(axis)).tolist(),
            "cone_outer": outer,
            # If both angles are equal, the cone has a hard edge.
            "cone_width": max(inner - outer, 1e-6),
        }
    return {
        "world_to_eye": _columns(to_eye),
        "eye_to_clip": _columns(np.asarray(view.eye_to_clip).reshape(-1, 4, 4)[0]),
        "has_cone": has_cone,
        "numbers": {"light": place, "intensity": _numbers(intensity), **cone},
    }


def _phong(config: Config) -> tuple[shading.Phong, float]:
    """The lit shading, and the fraction of light that remains in shadow. The fraction is -1 if shadow removes each
    light's own contribution."""
    made = build_shading(config)
    if isinstance(made, shading.ModulatedShadow):
        assert isinstance(made.lit, shading.Phong)
        return made.lit, float(made.factor)
    assert isinstance(made, shading.Phong)
    return made, -1.0


def _intensities(config: Config) -> list[Any]:
    """One value for each light."""
    phong, _ = _phong(config)
    return list(phong.intensities or [phong.intensity] * len(config.scene.each_light))


def _shading_of(config: Config) -> dict[str, Any]:
    phong, kept = _phong(config)
    fall = phong.attenuation
    return {
        "ambient": _numbers(phong.ambient),
        "background": _numbers(phong.background),
        "flags": {"blinn": phong.model == "blinn_phong"},
        "numbers": {
            "specular": float(phong.specular),
            "shininess": float(phong.shininess),
            "kept_in_shadow": kept,
            "attenuation": _numbers([fall.constant, fall.linear, fall.quadratic]),
        },
    }
