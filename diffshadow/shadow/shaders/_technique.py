"""A technique as a shader."""

from ...geometry import AbstractLight, PointLight
from ...settings.techniques import ShaderLanguage
from .._receiver import half_step
from .._shader import Constant, ShaderBias, ShaderPart, joined, number, text_of
from .._shadow_mapping import ShadowMapping
from .._technique import AbstractTechnique
from ..filters._pcss import PercentageCloserSoft, half_width_of
from ..layouts import SingleMap
from ._languages import LANGUAGES


def to_shader(technique: AbstractTechnique, light: AbstractLight, language: ShaderLanguage = "glsl") -> str:
    """A technique as a function `shadow` of a shader, which finds what `technique.visibility` finds.

    Its comment says what its arguments are. Its numbers are constants above it, with all digits of single precision.
    The constants `SHADOW_NEAR` and `SHADOW_FAR` belong to the light's matrices.

    **Arguments:**

    - `technique`: a `ShadowMapping` with a single map without silhouettes.
    - `light`: a directional, a spot or a point light, as the map was drawn from.
    - `language`: `"glsl"` (3.30 or ES 3.00), `"wgsl"`, or `"hlsl"` (shader model 5).

    **Raises** `ValueError` for a technique, a part or a light that has no shader.

    !!! Example

        ```python
        technique = shadow.ShadowMapping(shadow.PercentageCloser(1.5), shadow.Bias(constant=2.0))
        print(shadow.to_shader(technique, scene.light, "wgsl"))
        ```
    """
    if language not in LANGUAGES:
        raise ValueError(f"the language is {language!r}; expected one of {', '.join(LANGUAGES)}")
    if not isinstance(technique, ShadowMapping):
        raise ValueError(f"the technique is {type(technique).__name__}, which has no shader; expected ShadowMapping")
    if not isinstance(technique.layout, SingleMap):
        raise ValueError(
            f"the layout is {type(technique.layout).__name__}, which has no shader; expected SingleMap: export each "
            "map's technique on its own"
        )
    if technique.map.silhouettes:
        raise ValueError("map.silhouettes is true, which has no shader; expected false: shaders compare stored depths")
    view = light.view()
    is_cube = isinstance(light, PointLight)
    if max(view.world_to_eye.ndim, view.eye_to_clip.ndim) > 2 and not is_cube:
        raise ValueError(
            f"the light is a {type(light).__name__}, which has no shader; expected a directional, a spot or a point "
            "light"
        )
    to, bias, filter = LANGUAGES[language], technique.bias.shader(), technique.filter.shader()
    fixed = technique.map.depth_format != "float32"
    constants = (
        Constant("NEAR", number(view.near), "distance of window depth 0 along the light's axis, in world units"),
        Constant("FAR", number(view.far), "of window depth 1"),
        Constant("PERSPECTIVE", bool(view.is_perspective), "whether the light is a spot light or a point light"),
        Constant("LAYERS", 6 if is_cube else 1, "of the map, one above the other"),
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
    parts = (
        ShaderPart(constants, text_of("_receiver.glsl")),
        bias.part,
        ShaderPart((), _bias_functions(bias)),
        technique.compare.shader(),
        ShaderPart((), text_of("_lookup.glsl")),
        filter,
        ShaderPart((), text_of("_cube.glsl") if is_cube else ""),
        ShaderPart((), text_of("_shadow_mapping.glsl")),
    )
    whole = joined(parts)
    declared = "\n".join(map(to.constant, whole.constants))
    return "\n".join([declared, "", to.prelude, to.translate(whole.text)])


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
