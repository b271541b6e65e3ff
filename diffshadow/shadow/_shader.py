"""Parts of shaders: a bias, a compare or a filter in the common language of all exports.

This language is GLSL with a few rules that allow a translation to other languages line by line; see `shaders`. The text
of a part is in a file in the same folder as the part's Python module. Its numbers are constants before the text.
"""

from collections.abc import Iterable, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

Value = bool | int | float | tuple[float, ...]


class Constant(NamedTuple):
    """A number of a shader, or an array of numbers. Its name gets the prefix `SHADOW_`.

    - `about`: its description, with its unit.
    """

    name: str
    value: Value
    about: str


class ShaderPart(NamedTuple):
    """Functions of a shader, and their constants.

    - `textures`: names of the textures that `shadow_filter` reads in addition to the map.
    """

    constants: tuple[Constant, ...]
    text: str
    textures: tuple[str, ...] = ()


class ShaderBias(NamedTuple):
    """A bias in a shader. Its expressions may use `at`, a `ShadowReceiver`.

    - `depths`: expressions whose sum is subtracted from the receiver's window depth.
    - `offsets`: expressions whose sum is the shift of the receiver along its normal, in texels.
    - `follows_plane`: whether each texel is compared with the receiver's plane; `deepest`: the maximum distance of the
      plane behind the receiver, in window depth; `None` for no bound.
    """

    part: ShaderPart = ShaderPart((), "")
    depths: tuple[str, ...] = ()
    offsets: tuple[str, ...] = ()
    follows_plane: bool = False
    deepest: str | None = None


def constants_of(*each: tuple[str, Any, str]) -> tuple[Constant, ...]:
    """Constants, each from a name, a value and its description. Constants with the value `None` are left out."""
    return tuple(Constant(name, number(value), about) for name, value, about in each if value is not None)


def number(value: Any) -> float:
    """A setting as a number."""
    return float(np.asarray(value))


def numbers(values: Any) -> tuple[float, ...]:
    """An array as a row of numbers."""
    return tuple(float(value) for value in np.ravel(np.asarray(values)))


def text_of(*names: str) -> str:
    """The texts of these files of `shadow`, such as `"filters/_pcf.glsl"`."""
    folder = resources.files(__package__ or "")
    return "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)


def joined(parts: Iterable[ShaderPart]) -> ShaderPart:
    """Several parts combined."""
    each: Sequence[ShaderPart] = tuple(parts)
    constants = tuple(constant for part in each for constant in part.constants)
    textures = tuple(texture for part in each for texture in part.textures)
    return ShaderPart(constants, "\n".join(part.text for part in each if part.text), textures)
