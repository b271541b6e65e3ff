"""Exports a technique as a shader, with instructions for the renderer."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.text import Text

from ... import geometry, io, shadow
from ...config import Config, ConfigError, Mistake, build_scene, build_technique, printable
from ...settings.techniques import ShaderLanguage
from ..pages._page import write_page
from ._page import PAGE, Compared, check_page, write_shader_page

README, SCENE, MATRICES, BUFFERS = "README.md", "scene.glb", "light.json", "buffers.json"

# The names of each format in OpenGL, WebGPU and Direct3D.
_FORMATS = {
    "float32": ("`GL_DEPTH_COMPONENT32F`", "`depth32float`", "`DXGI_FORMAT_D32_FLOAT`"),
    "unorm24": ("`GL_DEPTH_COMPONENT24`", "`depth24plus`", "`DXGI_FORMAT_D24_UNORM_S8_UINT`"),
    "unorm16": ("`GL_DEPTH_COMPONENT16`", "`depth16unorm`", "`DXGI_FORMAT_D16_UNORM`"),
}
_CULLED = {
    "none": ("no `GL_CULL_FACE`", '`cullMode: "none"`', "`D3D11_CULL_NONE`"),
    "back": ("`glCullFace(GL_BACK)`", '`cullMode: "back"`', "`D3D11_CULL_BACK`"),
    "front": ("`glCullFace(GL_FRONT)`", '`cullMode: "front"`', "`D3D11_CULL_FRONT`"),
}
_LAYERS = {
    "second": "Store the second depth from the light, not the nearest. Draw twice. In the second pass, discard "
    "fragments at the first pass's depth or in front of it.",
    "midpoint": "Store the mean of the nearest and the second depth from the light. Draw both, and average them.",
}
_LANGUAGES = {
    "glsl": "GLSL (version 3.30, or ES 3.00 with `precision highp float; precision highp sampler2D;` above it)",
    "wgsl": "WGSL (WebGPU)",
    "hlsl": "HLSL (shader model 5)",
}
_CALLS = {
    "glsl": (
        "vec3 normal = normalize(cross(dFdx(position), dFdy(position)));",
        "vec2 pixel = floor(gl_FragCoord.xy);",
        "float lit = {call};",
    ),
    "wgsl": (
        "let normal = normalize(cross(dpdy(position), dpdx(position)));",
        "let pixel = vec2f(floor(at.x), height - 1 - floor(at.y));  // at is @builtin(position)",
        "let lit = {call};",
    ),
    "hlsl": (
        "float3 normal = normalize(cross(ddy(position), ddx(position)));",
        "float2 pixel = float2(floor(at.x), height - 1 - floor(at.y));  // at is SV_Position",
        "float lit = {call};",
    ),
}
# The texel that a pass draws, counted from the lower left texel of its target.
_TEXELS = {
    "glsl": "ivec2(gl_FragCoord.xy)",
    "wgsl": "vec2i(i32(at.x), height - 1 - i32(at.y))",
    "hlsl": "int2(int(at.x), height - 1 - int(at.y))",
}


def export_shader(
    config: Config,
    folder: Path,
    language: ShaderLanguage,
    *,
    console: Console,
    origin: str = "",
    compared: Compared | None = None,
) -> Path:
    """Writes the technique of `config` as a shader for each light, with the scene and instructions for the renderer.

    **Arguments:**

    - `folder`: created if it does not exist. Files of an earlier export are replaced.
    - `origin`: the source of the values, for the README.
    - `compared`: the second setting of the page; `None` for no page.

    **Returns** the folder.

    **Raises** `ConfigError` for a technique or a light that has no shader or that the page cannot draw, and `FileError`
    if a file cannot be written.
    """
    technique, scene = build_technique(config, fitting=False), build_scene(config)
    shaders, buffers = {}, {}
    try:
        for number, light in enumerate(scene.lights):
            name = "shadow" if len(scene.lights) == 1 else f"shadow_{number}"
            if isinstance(technique, shadow.ShadowMapping):
                light = technique.light_of_map(scene.lit_by(number))
            shaders[f"{name}.{language}"] = light, shadow.to_shader(technique, light, language, name, len(buffers))
            for variable, values in shadow.shader_buffers(technique, light, language, name).items():
                buffers[variable] = {"group": 1, "binding": len(buffers), "values": values.tolist()}
        assert isinstance(technique, shadow.ShadowMapping)
        if compared is not None:
            check_page(config, scene, technique)
    except ValueError as error:
        raise ConfigError([Mistake(config.origin.place(("technique",)), "technique", str(error))]) from error
    folder.mkdir(parents=True, exist_ok=True)
    title = f"{config.name}: {origin}" if origin else config.name
    matrices = {name: _matrices(light) for name, (light, _) in shaders.items()}
    texts = {name: f"// {title}\n{text}" for name, (_, text) in shaders.items()}
    texts[MATRICES] = json.dumps(matrices, indent=2) + "\n"
    if buffers:
        texts[BUFFERS] = json.dumps(buffers) + "\n"
    for name, text in texts.items():
        with io.atomic_path(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    write_page(
        folder / README,
        "export.md.j2",
        title=title,
        language=_LANGUAGES[language],
        suffix=language,
        call=[line.format(call=_call(technique, next(iter(shaders)))) for line in _CALLS[language]],
        rows=_rows(technique.layers, [light for light, _ in shaders.values()]),
        passes=_passes(technique, [light for light, _ in shaders.values()]),
        texel=_TEXELS[language],
        margin=_constant(technique, "BLUR_MARGIN"),
        layout=type(technique.layout).__name__,
        sides=_sides(next(iter(shaders.values()))[0]),
        function=Path(next(iter(shaders))).stem,
        constants=f"{Path(next(iter(shaders))).stem.upper()}_",
        buffers=BUFFERS if buffers else "",
        layer=_LAYERS.get(technique.map.depth_layer),
        ways={name: _way_of(light) for name, (light, _) in shaders.items()},
        origin=", ".join(f"{float(x):.9g}" for x in scene.origin) if np.any(scene.origin) else "",
        matrices=MATRICES,
        scene=SCENE,
    )
    io.write_gltf(folder / SCENE, scene)
    files = [*texts, README, SCENE]
    if compared is not None:
        for remark in write_shader_page(folder / PAGE, config, scene, technique, compared, title):
            console.print(Text(remark), soft_wrap=True)
        files.append(PAGE)
    console.print(Text(printable(f"wrote {', '.join(files[:-1])} and {files[-1]}")), soft_wrap=True)
    return folder


def _call(technique: shadow.ShadowMapping, file: str) -> str:
    """The name of this file's function."""
    maps = ["map", *technique.filter.shader().textures]
    warp = ["warp"] if isinstance(technique.layout, shadow.PerspectiveWarp) else []
    last = "0" if isinstance(technique.layout, shadow.SingleMap) else "depth"
    each = [*maps, "world_to_eye", "eye_to_clip", *warp, "position", "normal", "to_light", "pixel", last]
    return f"{Path(file).stem}({', '.join(each)})"


def _passes(technique: shadow.ShadowMapping, lights: Sequence[geometry.AbstractLight]) -> tuple[str, ...]:
    """The sizes of the targets of the two blur passes, width x height in texels. Empty without a blur."""
    margin = _constant(technique, "BLUR_MARGIN")
    if margin is None:
        return ()
    height, width = technique.layers.resolution
    beyond = 2 * margin
    counts = sorted(set(map(_layers, lights)))
    return tuple(
        "; ".join(f"{width + beyond} x {count * high}" for count in counts) for high in (height, height + beyond)
    )


def _constant(technique: shadow.ShadowMapping, name: str) -> Any:
    """A constant of the filter's shader, or `None` if there is no such constant."""
    return next((each.value for each in technique.filter.shader().constants if each.name == name), None)


def _sides(light: geometry.AbstractLight) -> str:
    """The sides of cascades of different sizes, in texels."""
    tile = light.view().tile
    return "" if tile is None else ", ".join(str(int(side)) for side in tile.size)


def _layers(light: geometry.AbstractLight) -> int:
    """The number of layers of the light's map."""
    view = light.view()
    return max([len(matrix) for matrix in (view.world_to_eye, view.eye_to_clip) if matrix.ndim > 2], default=1)


def _matrices(light: geometry.AbstractLight) -> dict[str, list[Any]]:
    """The light's matrices, row by row, for column vectors. A point light and cascades have one matrix for each
    layer."""
    view = light.view()
    projection = np.asarray(view.eye_to_clip, np.float64)
    halved = np.diag([1.0, 1.0, 0.5, 1.0])
    halved[2, 3] = 0.5
    each = {
        "world_to_eye": np.asarray(view.world_to_eye, np.float64),
        "eye_to_clip, depths from -1 to 1": projection,
        "eye_to_clip, depths from 0 to 1": halved @ projection,
    }
    if view.warp is not None:
        each["warp"] = np.array([view.warp.strength, view.warp.center], np.float64)
    return {name: matrix.tolist() for name, matrix in each.items()}


def _rows(settings: shadow.MapSettings, lights: Sequence[geometry.AbstractLight]) -> dict[str, tuple[str, ...]]:
    """The renderer's settings for the map, in OpenGL, WebGPU and Direct3D 11."""
    height, width = settings.resolution
    sizes = "; ".join(
        f"{width} x {count * height}" + (f", {count} layers of {width} x {height}" if count > 1 else "")
        for count in sorted(set(map(_layers, lights)))
    )
    offset = ("none",) * 3
    if settings.polygon_offset is not None:
        factor, units = settings.polygon_offset
        offset = (
            f"`glPolygonOffset({factor:g}, {units:g})`",
            f"`depthBiasSlopeScale: {factor:g}, depthBias: {units:g}`",
            f"`SlopeScaledDepthBias = {factor:g}, DepthBias = {units:g}`",
        )
    return {
        "format": _FORMATS[settings.depth_format],
        "size in texels": (sizes,) * 3,
        "cleared to": ("1.0",) * 3,
        "depth test": ("`GL_LESS`", '`depthCompare: "less"`', "`D3D11_COMPARISON_LESS`"),
        "culled faces; front faces are counter-clockwise": _CULLED[settings.cull],
        "polygon offset": offset,
        "clip space's depths": ("-1 to 1", "0 to 1", "0 to 1"),
        "first row in memory": ("the lowest", "the highest", "the highest"),
        "the shader reads it as": (
            "`sampler2D`, with `GL_TEXTURE_COMPARE_MODE` `GL_NONE`, `GL_NEAREST`, without mipmaps",
            "`texture_depth_2d`, without a sampler",
            "`Texture2D<float>`, a view of the format `R32_FLOAT`, `R24_UNORM_X8_TYPELESS` or `R16_UNORM`",
        ),
    }


def _way_of(light: geometry.AbstractLight) -> str:
    known = lambda vector: ", ".join(f"{float(x):.7g}" for x in vector)
    if light.is_directional:
        towards = np.asarray(light.towards(jnp.zeros(3)), np.float64)
        return f"the unit vector ({known(towards / np.linalg.norm(towards))})"
    to_eye = np.asarray(light.view().world_to_eye, np.float64).reshape(-1, 4, 4)[0]
    return f"`normalize(light - position)`, where the light is at ({known(np.linalg.inv(to_eye)[:3, 3])})"
