"""A technique as a shader."""

import re
from collections.abc import Mapping

import numpy as np

from ..._types import HostArray
from ..._words import counted
from ...geometry import AbstractLight
from ...settings.techniques import ShaderLanguage
from .._irregular import IrregularZBuffer
from .._projective import ProjectiveShadow
from .._receiver import half_step
from .._shader import Constant, ShaderBias, ShaderPart, joined, number, text_of
from .._shadow_mapping import ShadowMapping
from .._technique import AbstractTechnique
from .._volumes import ShadowVolumes
from ..biases import Bias
from ..engines import AbstractEngineShadows
from ..filters._pcss import PercentageCloserSoft, half_width_of
from ..layouts import CascadedLight, Cascades, PerspectiveWarp, WarpedLight
from ._languages import LANGUAGES, renamed

# The reasons why techniques have no shader, and the most similar techniques that have one.
_REFUSED: Mapping[type[AbstractTechnique], str] = {
    ShadowVolumes: "it draws volumes into a stencil buffer, without a look-up; the most similar is ShadowMapping "
    "with a large map and the filter Nearest",
    IrregularZBuffer: "it stores a list of pixels for each texel; the most similar is ShadowMapping with Cascades",
    ProjectiveShadow: "it reads a texture and compares no depths; the most similar is ShadowMapping",
    AbstractEngineShadows: "its shader is the engine's own; `diffshadow convert` writes its settings",
}
# Longer arrays are buffers in languages whose compilers would take minutes.
_MAX_TABLE = 256
_NAME = r"(?!gl_)[A-Za-z](?:[A-Za-z0-9]|_(?!_))*"


def to_shader(
    technique: AbstractTechnique,
    light: AbstractLight,
    language: ShaderLanguage = "glsl",
    name: str = "shadow",
    first_binding: int = 0,
) -> str:
    """A technique as a shader function with the same result as `technique.visibility`. A comment describes its
    arguments. Its numbers are constants before it, with all digits of single precision. The constants `SHADOW_NEAR` and
    `SHADOW_FAR` belong to the light's matrices. For a filter that blurs the map, such as `VarianceShadowMap`, call the
    functions `shadow_blur_rows` and `shadow_blur_columns` in the fragment shaders of two passes.

    **Arguments:**

    - `technique`: a `ShadowMapping` without silhouettes, with a single map, cascades or a warp.
    - `light`: the light that the map was drawn from: a directional, spot or point light; for cascades or a warp,
        `technique.light_of_map(scene)`.
    - `language`: `"glsl"` (3.30 or ES 3.00), `"wgsl"`, or `"hlsl"` (shader model 5).
    - `name`: name of the function, in small letters. All other names begin with it, so that one program can have
      shaders with different names.
    - `first_binding`: for WGSL, the binding of the first array that is a buffer of group 1; see `shader_buffers`.

    **Raises** `ValueError` for a technique, a part or a light that has no shader, and for an invalid name.

    !!! Example

        ```python
        technique = shadow.ShadowMapping(shadow.PercentageCloser(1.5), shadow.Bias(constant=2.0))
        print(shadow.to_shader(technique, scene.light, "wgsl"))
        ```
    """
    if language not in LANGUAGES:
        raise ValueError(f"the language is {language!r}; expected one of {', '.join(LANGUAGES)}")
    if not re.fullmatch(_NAME, name) or name != name.lower():
        raise ValueError(
            f"the shader's name is {name!r}; expected small letters, digits and single underscores, with a letter first"
        )
    to, whole = LANGUAGES[language], _shader_of(technique, light)
    buffers = _buffers_of(whole, language)
    declared = [
        to.buffer(constant, first_binding + buffers.index(constant)) if constant in buffers else to.constant(constant)
        for constant in whole.constants
    ]
    textures = ("map", *whole.textures)
    kinds = ("sampler2D", *("ShadowTexture" for _ in whole.textures))
    parameters = ", ".join(f"{kind} {each}" for kind, each in zip(kinds, textures, strict=True))
    functions = whole.text.replace("SHADOW_MAPS", parameters).replace("shadow_maps", ", ".join(textures))
    return renamed("\n".join([*declared, "", to.prelude, to.translate(functions)]), name)


def shader_buffers(
    technique: AbstractTechnique, light: AbstractLight, language: ShaderLanguage, name: str = "shadow"
) -> dict[str, HostArray]:
    """The content of the buffers that `to_shader` declares with these arguments: float32 values by the variable's name,
    in the order of their bindings.

    Compilers of WGSL take minutes for a table of thousands of numbers, such as a pattern of 32 points for each of 8²
    pixels. In WGSL, tables of more than 256 numbers are therefore storage buffers. Other languages have none.

    **Raises** the errors of `to_shader`.
    """
    buffers = _buffers_of(_shader_of(technique, light), language)
    return {renamed(f"SHADOW_{each.name}", name): np.asarray(each.value, np.float32) for each in buffers}


def _buffers_of(whole: ShaderPart, language: ShaderLanguage) -> list[Constant]:
    long = lambda constant: isinstance(constant.value, tuple) and len(constant.value) > _MAX_TABLE
    return [constant for constant in whole.constants if long(constant)] if language == "wgsl" else []


def _shader_of(technique: AbstractTechnique, light: AbstractLight) -> ShaderPart:
    """The whole shader."""
    if not isinstance(technique, ShadowMapping):
        reason = next((reason for kind, reason in _REFUSED.items() if isinstance(technique, kind)), None)
        raise ValueError(
            f"the technique is {type(technique).__name__}, which has no shader: {reason}"
            if reason
            else f"the technique is {type(technique).__name__}, which has no shader; expected ShadowMapping"
        )
    if technique.map.silhouettes:
        raise ValueError(
            "map.silhouettes is true, which has no shader; expected false, because shaders compare only stored depths: "
            "the most similar is a map of more texels"
        )
    layout = technique.layout
    expected = {Cascades: CascadedLight, PerspectiveWarp: WarpedLight}.get(type(layout))
    if expected is not None and not isinstance(light, expected):
        raise ValueError(
            f"the light is a {type(light).__name__}, and the layout is {type(layout).__name__}; expected the light "
            "that the map is drawn from: technique.light_of_map(scene)"
        )
    view, lays_out = light.view(), layout.shader(light)
    count = max([len(matrix) for matrix in (view.world_to_eye, view.eye_to_clip) if matrix.ndim > 2], default=1)
    if expected is None and ((count > 1) != ("shadow_layer" in lays_out.text) or view.warp is not None):
        raise ValueError(
            f"the light is a {type(light).__name__}, which has no shader; expected a directional, a spot or a point "
            "light"
        )
    factors = technique.bias.factors if isinstance(technique.bias, Bias) else None
    if factors is not None and count != len(factors):
        raise ValueError(
            f"the bias has {counted(len(factors), 'factor')}, and the map has {counted(count, 'layer')}; expected one "
            "for each layer: leave factors out, or give this number of factors"
        )
    bias, filter = technique.bias.shader(), technique.filter.shader()
    fixed = technique.map.depth_format != "float32"
    constants = (
        Constant("NEAR", number(view.near), "distance of window depth 0 along the light's axis, in world units"),
        Constant("FAR", number(view.far), "of window depth 1"),
        Constant("PERSPECTIVE", bool(view.is_perspective), "whether the light is a spot light or a point light"),
        Constant("WARPED", view.warp is not None, "whether a perspective warps the map"),
        Constant("LAYERS", count, "of the map, one above the other"),
        Constant("FIXED_POINT", fixed, "whether the map stores whole numbers, such as DEPTH_COMPONENT24"),
        Constant(
            "HALF_STEP", number(half_step(technique.map.depth_format)), "half the difference of two of its depths"
        ),
        Constant("HAS_NORMAL_OFFSET", bool(bias.offsets), "whether the receiver moves along its normal"),
        Constant("FOLLOWS_PLANE", bias.follows_plane, "whether each texel is compared with the receiver's plane"),
    )
    if isinstance(technique.filter, PercentageCloserSoft):
        size = number(half_width_of(light, technique.filter.light_size))
        constants += (Constant("LIGHT_SIZE", size, "half its width in world units; a sun's, at a distance of 1"),)
    return joined(
        (
            ShaderPart(constants, text_of("_receiver.glsl")),
            bias.part,
            ShaderPart((), _bias_functions(bias)),
            technique.compare.shader(),
            ShaderPart((), text_of("_lookup.glsl")),
            filter,
            ShaderPart((), text_of("_shadow_mapping.glsl")),
            lays_out,
        )
    )


def _bias_functions(bias: ShaderBias) -> str:
    deepening = "1000000.0" if bias.deepest is None else bias.deepest
    functions = {
        "// The bias, in window depth.\nfloat shadow_bias": " + ".join(bias.depths) or "0.0",
        "// How far the receiver moves along its normal, in texels.\nfloat shadow_normal_offset": (
            " + ".join(bias.offsets) or "0.0"
        ),
        "// How much deeper than the receiver its plane may be at a tap, in window depth.\nfloat shadow_deepening": (
            deepening
        ),
    }
    return "\n".join(f"{head}(ShadowReceiver at) {{\n    return {value};\n}}\n" for head, value in functions.items())
