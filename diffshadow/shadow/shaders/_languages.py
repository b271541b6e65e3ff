"""The languages that shaders are exported to.

Parts of shaders are written in GLSL. These rules allow a translation of each line into other languages:

- each declaration has its own line, and so does a function's head, which ends in ` {`;
- floats have a decimal point, and vectors are made from one number for each component;
- parameters are not assigned to, and vectors are assigned whole;
- `shadow_select(no, yes, condition)` replaces `?:`; matrices are multiplied by `shadow_times`;
- a map is a `sampler2D` argument, read by `shadow_fetch` and measured by `shadow_size`;
- another texture is a `ShadowTexture`, read by `shadow_texel`;
- `SHADOW_MAPS` expands to the parameters of the map and all other textures, and `shadow_maps` to the arguments;
- all global names begin with `shadow`, `SHADOW_` or `Shadow`, for `renamed`.
"""

import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

from .._shader import Constant, text_of

_TYPES = ("bool", "float", "int", "vec2", "vec3", "vec4", "ivec2", "mat4", "sampler2D", "ShadowTexture")
_NAME = r"[A-Za-z_]\w*"


class Language(NamedTuple):
    """A shading language.

    - `suffix`: suffix of its files.
    - `array`: the declaration of an array of floats, from its name, its length and its values.
    - `scalar`: the declaration of a number, from its type, its name and its value.
    - `translate`: functions of the parts of shaders in this language.
    - `texture`: the type of a texture that is not a map.
    """

    name: str
    suffix: str
    array: Callable[[str, int, str], str]
    scalar: Callable[[str, str, str], str]
    translate: Callable[[str], str]
    texture: str

    @property
    def prelude(self) -> str:
        """The functions that differ between languages."""
        return text_of(f"shaders/prelude.{self.suffix}").replace("ShadowTexture", self.texture)

    def constant(self, constant: Constant) -> str:
        """The declaration of a constant, with a comment."""
        name, value = f"SHADOW_{constant.name}", constant.value
        if isinstance(value, tuple):
            return f"// {constant.about}\n{self.array(name, len(value), ', '.join(map(_float, value)))}"
        kind = "bool" if isinstance(value, bool) else "int" if isinstance(value, int) else "float"
        text = str(value).lower() if kind == "bool" else str(value) if kind == "int" else _float(value)
        return f"{self.scalar(kind, name, text)}  // {constant.about}"

    def buffer(self, constant: Constant, binding: int) -> str:
        """The declaration of an array of WGSL as a storage buffer of group 1, with a comment."""
        return (
            f"// {constant.about}\n@group(1) @binding({binding}) var<storage, read> SHADOW_{constant.name}: array<f32>;"
        )


def renamed(text: str, name: str) -> str:
    """The text of a shader whose function has the name `name`. Its other names begin with `name`."""
    kinds = {"shadow": name, "SHADOW_": f"{name.upper()}_", "Shadow": "".join(map(str.capitalize, name.split("_")))}
    own = r"\b(shadow)(?=\(|_\w)|\b(SHADOW_)(?=\w)|\b(Shadow)(?=[A-Z])"
    return re.sub(own, lambda found: kinds[found[0]], text)


def _float(value: float) -> str:
    """Nine significant digits, the full precision of float32, and a decimal point."""
    text = f"{value:.9g}"
    return text if "." in text or "e" in text else f"{text}.0"


_HLSL = {
    **{f"vec{n}": f"float{n}" for n in (2, 3, 4)},
    "ivec2": "int2",
    "mat4": "float4x4",
    "sampler2D": "Texture2D<float>",
    "ShadowTexture": "Texture2D<float4>",
    "mix": "lerp",
    "fract": "frac",
}
_WGSL_TYPES = {
    "float": "f32",
    "int": "i32",
    "ivec2": "vec2i",
    "mat4": "mat4x4f",
    "sampler2D": "texture_depth_2d",
    "ShadowTexture": "texture_2d<f32>",
    **{f"vec{n}": f"vec{n}f" for n in (2, 3, 4)},
}


def _to_hlsl(text: str) -> str:
    return _renamed(text, _HLSL)


def _to_wgsl(text: str) -> str:
    structs = re.findall(rf"^struct ({_NAME}) ", text, re.MULTILINE)
    kind = "|".join((*_TYPES, *structs))
    of = lambda name: _WGSL_TYPES.get(name, name)
    of_length = lambda name, length: of(name) if length is None else f"array<{of(name)}, {length}>"

    def head(found: re.Match[str]) -> str:
        parameters = (re.fullmatch(r"(\w+) (\w+)(?:\[(\w+)\])?", each) for each in found[3].split(", "))
        typed = [f"{each[2]}: {of_length(each[1], each[3])}" for each in parameters if each is not None]
        return f"fn {found[2]}({', '.join(typed)}) -> {of(found[1])} {{"

    def declaration(found: re.Match[str]) -> str:
        indent, each, name, length, value = found.groups()
        return f"{indent}var {name}: {of_length(each, length)}{'' if value is None else f' = {value}'};"

    lines = []
    within_struct = False
    for line in text.splitlines():
        within_struct = within_struct or line.startswith("struct ")
        if within_struct:
            line = re.sub(rf"^    ({kind}) ({_NAME});", lambda found: f"    {found[2]}: {of(found[1])},", line)
            within_struct, line = (False, "}") if line.startswith("};") else (True, line)
        elif not line.lstrip().startswith("//"):
            line = re.sub(rf"^({kind}) ({_NAME})\((.*)\) {{$", head, line)
            line = re.sub(rf"^( +)({kind}) ({_NAME})(?:\[(\w+)\])?(?: = (.*))?;$", declaration, line)
            line = re.sub(rf"for \(int ({_NAME}) = ", r"for (var \1: i32 = ", line)
            line = _renamed(line, {**_WGSL_TYPES, "shadow_select": "select"}, followed_by=r"(?=\()")
        lines.append(line)
    return "\n".join([*lines, ""])


def _renamed(text: str, names: Mapping[str, str], followed_by: str = "") -> str:
    return re.sub(rf"\b({'|'.join(names)})\b{followed_by}", lambda found: names[found[0]], text)


LANGUAGES: Mapping[str, Language] = {
    "glsl": Language(
        "GLSL",
        "glsl",
        lambda name, length, values: f"const float {name}[{length}] = float[{length}]({values});",
        lambda kind, name, value: f"const {kind} {name} = {value};",
        lambda text: text.replace("ShadowTexture", "sampler2D"),
        "sampler2D",
    ),
    "wgsl": Language(
        "WGSL",
        "wgsl",
        lambda name, length, values: f"var<private> {name} = array<f32, {length}>({values});",
        lambda kind, name, value: f"const {name}: {_WGSL_TYPES.get(kind, kind)} = {value};",
        _to_wgsl,
        _WGSL_TYPES["ShadowTexture"],
    ),
    "hlsl": Language(
        "HLSL",
        "hlsl",
        lambda name, length, values: f"static const float {name}[{length}] = {{{values}}};",
        lambda kind, name, value: f"static const {kind} {name} = {value};",
        _to_hlsl,
        _HLSL["ShadowTexture"],
    ),
}
"""The languages by the names that `to_shader` takes: GLSL 3.30 and ES 3.00, WGSL, and HLSL of shader model 5."""
