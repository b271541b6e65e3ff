"""Biases and kernels as functions in GLSL, for shaders of version 3.30 (OpenGL) or 3.00 (OpenGL ES) and newer."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from .._types import HostArray
from .biases import (
    FEATURES,
    GLSL_INPUTS,
    AbstractBias,
    Bias,
    ConstantBias,
    LinearBias,
    NormalOffset,
    PerceptronBias,
    SlopeBias,
)
from .filters import AbstractFilter
from .filters._castano import Castano
from .filters._separable import Separable

_ARGUMENTS = ", ".join(f"{kind} {name}" for name, (kind, _) in GLSL_INPUTS.items())
_COSINE_OF = {"sine": "sine", "constant": "one", "one_minus_cosine": "one_minus_cosine"}


def to_glsl(part: AbstractBias | AbstractFilter) -> str:
    """A bias or a filter as a GLSL function that does the same.

    - Of a bias: `float shadow_bias(slope, cosine, texel_size, light_distance, blocker_distance)`, along the light's
        axis in texels; times the width of a texel at the receiver it is a length. If it has a normal offset, also
        `float shadow_normal_offset(cosine)`, in texels along the receiver's normal. Their comments say what each
        argument is, and where a receiver is compared.
    - Of a filter: `float shadow_visibility(map, texel, depth)`, 1 lit and 0 shadowed.

    Numbers have all digits of single precision.

    **Arguments:**

    - `part`: a `ConstantBias`, a `SlopeBias` or a `NormalOffset` in texels, a `LinearBias`, a `PerceptronBias`, a
        `Bias` of these, a `Separable` or a `Castano`.

    **Raises** `ValueError` for any other, or one in window depth.

    !!! Example

        ```python
        print(shadow.to_glsl(shadow.Bias(constant=0.5, slope=1.0)))
        ```
    """
    if isinstance(part, AbstractFilter):
        return _filter(part)
    lines, sums = [], []
    for each in _parts(part):
        if not isinstance(each, NormalOffset):
            before, total = _bias(each, str(len(sums)))
            lines, sums = [*lines, *before], [*sums, total]
    offsets = [each for each in _parts(part) if isinstance(each, NormalOffset)]
    along = "along the light's axis towards the light, in widths of a texel at the receiver."
    text = [
        f"// Bias {along} The map is compared with the receiver's depth less this.",
        *(f"// {name}: {what}" for name, (_, what) in GLSL_INPUTS.items()),
        f"float shadow_bias({_ARGUMENTS}) {{",
        *lines,
        f"    return {' + '.join(sums) or '0.0'};",
        "}",
    ]
    if offsets:
        text += [
            "// How far the receiver moves along its normal before it is projected, in widths of a texel at the\n"
            "// receiver. The arguments of shadow_bias belong to the receiver where it was.",
            "float shadow_normal_offset(float cosine) {",
            f"    return {' + '.join(map(_offset, offsets))};",
            "}",
        ]
    return "\n".join([*text, ""])


def _parts(bias: AbstractBias) -> list[AbstractBias]:
    """The biases that `bias` adds up, without zeros."""
    if not isinstance(bias, Bias):
        return [bias]
    if bias.plane is not None or bias.factors is not None:
        what = "a plane" if bias.plane is not None else "factors"
        raise ValueError(f"the bias has {what}, which has no GLSL; expected a bias without: leave it out")
    each = [bias.constant, bias.slope, bias.normal_offset, *([] if bias.terms is None else [bias.terms])]
    plain = lambda part: isinstance(part, ConstantBias | SlopeBias | NormalOffset) and float(part.value) == 0
    return [part for part in each if not plain(part) or getattr(part, "least", None) is not None]


def _bias(bias: AbstractBias, suffix: str) -> tuple[list[str], str]:
    """The lines before the sum, and a bias's term of it."""
    match bias:
        case ConstantBias(unit="texels"):
            return [], _text(bias.value)
        case SlopeBias(unit="texels"):
            feature = FEATURES["slope" if bias.profile == "tangent" else bias.profile]
            term = f"{_text(bias.value)} * ({feature.glsl})"
            term = term if bias.least is None else f"max({term}, {_text(bias.least)})"
            return [], term if bias.most is None else f"min({term}, {_text(bias.most)})"
        case LinearBias():
            return [], f"max({_linear(bias)}, 0.0)"
        case PerceptronBias():
            return _perceptron(bias, suffix)
    what = "in window depth" if getattr(bias, "unit", "texels") != "texels" else f"of type {type(bias).__name__}"
    raise ValueError(
        f"the bias is {what}, which has no GLSL; expected a constant, slope, linear or perceptron bias in texels"
    )


def _linear(bias: LinearBias) -> str:
    return " + ".join(
        _text(bias.weights[name]) if name == "one" else f"{_text(bias.weights[name])} * ({feature.glsl})"
        for name, feature in FEATURES.items()
        if name in bias.weights
    )


def _perceptron(bias: PerceptronBias, suffix: str) -> tuple[list[str], str]:
    x, features = f"x{suffix}", ", ".join(FEATURES[name].glsl for name in bias.inputs)
    lines = [
        f"    float {x}[{len(bias.inputs)}] = float[]({features});",
        f"    for (int i = 0; i < {len(bias.inputs)}; i++) {x}[i] /= 1.0 + {x}[i];",
    ]
    values = [f"{x}[{i}]" for i in range(len(bias.inputs))]
    for number, layer in enumerate(bias.hidden):
        name = f"h{suffix}_{number}"
        weight, offset = np.asarray(layer.weight), np.asarray(layer.bias)
        rows = [f"tanh({_product(row, values)} + {_text(b)})" for row, b in zip(weight, offset, strict=True)]
        lines += [f"    float {name}[{len(rows)}] = float[](", ",\n".join(f"        {row}" for row in rows), "    );"]
        values = [f"{name}[{i}]" for i in range(len(rows))]
    return lines, f"max({_linear(bias.linear)} + {_product(np.asarray(bias.last), values)}, 0.0)"


def _product(weights: Float[HostArray, " n"], values: Sequence[str]) -> str:
    return " + ".join(f"{_text(weight)} * {value}" for weight, value in zip(weights, values, strict=True))


def _offset(offset: NormalOffset) -> str:
    if offset.profile not in _COSINE_OF:
        expected = ", ".join(_COSINE_OF)
        raise ValueError(f"the normal offset has the profile {offset.profile}, which has no GLSL; expected {expected}")
    return f"{_text(offset.value)} * ({FEATURES[_COSINE_OF[offset.profile]].glsl})"


def _filter(kernel: AbstractFilter) -> str:
    if not isinstance(kernel, Separable | Castano):
        raise ValueError(
            f"the filter is of type {type(kernel).__name__}, which has no GLSL; expected Separable or Castano"
        )
    half = [float(weight) for weight in kernel.normalized]
    weights, texels = [0.0, *reversed(half[1:]), *half, 0.0], 2 * len(half)
    return "\n".join(
        [
            "// Visibility, 1 lit and 0 shadowed.",
            "// map: window depths, 1 where it is empty",
            "// texel: where the receiver falls in the map, in texels; the first texel's centre is at 0.5",
            "// depth: the receiver's window depth less its bias",
            "float shadow_visibility(sampler2D map, vec2 texel, float depth) {",
            f"    const float k[{len(weights)}] = float[]({_joined(weights)});",
            f"    ivec2 first = ivec2(floor(texel - 0.5)) - {len(half) - 1}, size = textureSize(map, 0);",
            "    vec2 s = fract(texel - 0.5);",
            "    float lit = 0.0;",
            f"    for (int j = 0; j < {texels}; j++)",
            f"        for (int i = 0; i < {texels}; i++) {{",
            "            ivec2 at = first + ivec2(i, j);",
            "            bool inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size));",
            "            float stored = inside ? texelFetch(map, at, 0).r : 1.0;",
            "            if (stored == 1.0 || depth <= stored)",
            "                lit += mix(k[i + 1], k[i], s.x) * mix(k[j + 1], k[j], s.y);",
            "        }",
            "    return clamp(lit, 0.0, 1.0);",
            "}",
            "",
        ]
    )


def _joined(values: Iterable[float]) -> str:
    return ", ".join(map(_text, values))


def _text(value: object) -> str:
    """Nine significant digits, which are all of single precision, and a decimal point."""
    text = f"{float(np.asarray(value)):.9g}"
    return text if "." in text or "e" in text else f"{text}.0"
