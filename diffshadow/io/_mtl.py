"""Materials of Wavefront OBJ files: https://paulbourke.net/dataformats/mtl/."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from .._types import HostArray
from ..geometry import Sampler
from ..settings.scene import Cutout
from ._errors import MeshError
from ._looks import Picture, Texture, read_texture
from ._paths import on_disk
from ._text import decode, is_number, split_lines

# The number of words after each option of a map. Options -o, -s and -t take up to three numbers.
_WORDS = {
    **dict.fromkeys(("-blendu", "-blendv", "-cc", "-clamp", "-bm", "-boost", "-texres", "-imfchan", "-type"), 1),
    "-mm": 2,
    **dict.fromkeys(("-o", "-s", "-t"), 3),
}
# Options that change nothing with these words.
_IDLE = {"-blendu": ["on"], "-blendv": ["on"], "-cc": ["off"], "-mm": ["0", "1"], "-t": ["0", "0", "0"]}
# The channel of an opacity map, among red, green, blue and alpha. The luminance uses all three colours.
_CHANNELS = {"r": 0, "g": 1, "b": 2, "m": 3}
_LUMINANCE = np.array([0.299, 0.587, 0.114])


class _Map(NamedTuple):
    """An image of a material, and the transform of its texture coordinates."""

    file: str
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamps: bool = False
    channel: str | None = None


class Material(NamedTuple):
    """A material.

    - `factor`: its diffuse colour, linear.
    - `texture`: texture of its base colour and opacity; `None` if there is no readable texture.
    - `scale`, `offset`: the factor and then the offset of texture coordinates.
    """

    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: Texture | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


class _Entry:
    """A material as its file defines it."""

    def __init__(self) -> None:
        self.factor = Material().factor
        self.opacity = 1.0
        self.colour_map: _Map | None = None
        self.opacity_map: _Map | None = None
        self.left_out: list[str] = []


class Materials:
    """The materials of the MTL files that an OBJ file names. Unreadable files are added to `left_out`.

    **Arguments:** `named`: the rest of each line `mtllib`.
    """

    def __init__(self, named: Iterable[str], folder: Path, left_out: Counter[str]):
        self._folder, self._left_out = folder, left_out
        self._entries: dict[str, _Entry] = {}
        self._pictures: dict[tuple[_Map | None, _Map | None], Picture | None] = {}
        for name, file in _files(named, folder):
            if file is None:
                left_out[f"material file {name} that cannot be read"] += 1
            else:
                self._entries = _read(file.content) | self._entries

    def of(self, name: str) -> Material | None:
        """The material with this name, or `None` if no file has it."""
        entry = self._entries.get(name)
        if entry is None:
            if self._entries:
                self._left_out[f"material {name} that is in no material file"] = 1
            return None
        self._left_out.update(entry.left_out)
        if entry.opacity < 1:
            self._left_out["transparent look of a material"] += 1
        place = entry.opacity_map or entry.colour_map
        if place is None:
            return Material(entry.factor)
        if (
            entry.opacity_map is not None
            and entry.colour_map is not None
            and not _are_alike(entry.opacity_map, entry.colour_map)
        ):
            self._left_out["placement of a map_Kd, which differs from that of its map_d"] += 1
        picture = self._picture(entry.colour_map, entry.opacity_map)
        if picture is None:
            return Material(entry.factor)
        cutoff = None
        if entry.opacity_map is not None:
            whole = Cutout.alpha_cutoff
            # A map that is nearly transparent everywhere still defines a shape.
            cutoff = whole / entry.opacity if entry.opacity > whole else whole
        wrap = "clamp" if place.clamps else "repeat"
        texture = Texture(picture, cutoff, Sampler.of(wrap, "linear"))
        return Material(entry.factor, texture, place.scale, place.offset)

    def _picture(self, colour: _Map | None, opacity: _Map | None) -> Picture | None:
        """The image with the colours of one map and the opacity of another. A missing map is opaque white."""
        plain = lambda each: None if each is None else _Map(each.file, channel=each.channel)
        key = plain(colour), plain(opacity)
        if key not in self._pictures:
            colours = None if colour is None else self._levels(colour)
            opacities = None if opacity is None else self._levels(opacity)
            self._pictures[key] = _joined(colours, None if opacities is None else _opacity(opacities, opacity))
        return self._pictures[key]

    def _levels(self, of: _Map) -> UInt8[HostArray, "h w 4"] | None:
        file = _found(self._folder, of.file)
        try:
            if file is not None:
                return read_texture(file.content, of.file).levels
        except MeshError:
            pass
        self._left_out[f"texture {of.file} that cannot be read"] += 1
        return None


def files_of_materials(named: Iterable[str], folder: Path) -> list[Path]:
    """The MTL files that an OBJ file names and the images that these name, if they exist."""
    files = [file for _, file in _files(named, folder) if file is not None]
    entries = [entry for file in files for entry in _read(file.content).values()]
    maps = [each for entry in entries for each in (entry.colour_map, entry.opacity_map) if each is not None]
    files += [file for each in maps if (file := _found(folder, each.file)) is not None]
    return list(dict.fromkeys(file.path for file in files))


class _File(NamedTuple):
    path: Path
    content: bytes


def _files(named: Iterable[str], folder: Path) -> Iterator[tuple[str, _File | None]]:
    """The names in lines `mtllib` with their files, or none where a file is missing.

    A line holds one name, which may contain spaces, or several names.
    """
    for rest in dict.fromkeys(named):
        whole = _found(folder, rest)
        yield from [(rest, whole)] if whole is not None else [(name, _found(folder, name)) for name in rest.split()]


def _found(folder: Path, name: str) -> _File | None:
    """A file at the path `name`, or with the same name in the OBJ file's folder, because many writers store paths of
    their own disks."""
    path = name.replace("\\", "/")
    for place in (folder / path, folder / path.rpartition("/")[2]):
        file = Path(os.path.normpath(place))
        try:
            return _File(file, on_disk(file).read_bytes())
        except (OSError, ValueError):
            continue
    return None


def _read(data: bytes) -> dict[str, _Entry]:
    """The materials of a file, by name. Lines that break the format are left out."""
    entries: dict[str, _Entry] = {}
    entry = _Entry()
    for line in split_lines(decode(data)):
        key, _, rest = line.partition(" ")
        key, rest = key.lower(), rest.strip()
        words = rest.split()
        if key == "newmtl":
            entry = entries.setdefault(rest, _Entry())
        elif key == "kd":
            numbers = [float(word) for word in words if is_number(word)]
            if len(numbers) != len(words) or len(numbers) not in (1, 3):
                entry.left_out.append("diffuse colour of a material, which is not given as red, green and blue")
                continue
            red, green, blue = np.clip(numbers * (3 // len(numbers)), 0, 1).tolist()
            entry.factor = red, green, blue
        elif key in ("d", "tr") and words and is_number(words[-1]):
            value = min(max(float(words[-1]), 0.0), 1.0)
            entry.opacity = value if key == "d" else 1 - value
        elif key == "map_kd":
            entry.colour_map = _map(words, "map_Kd", entry.left_out)
        elif key == "map_d":
            entry.opacity_map = _map(words, "map_d", entry.left_out)
        elif key == "disp":
            entry.left_out.append("displacement map")
    return entries


def _map(words: Sequence[str], key: str, left_out: list[str]) -> _Map | None:
    """A map from its options and its file's name. Adds ignored options to `left_out`."""
    given: dict[str, list[str]] = {}
    words = [*words]
    while words and words[0] in _WORDS:
        option = words.pop(0)
        count = _WORDS[option]
        if count == 3:
            count = next((i for i, word in enumerate(words[:3]) if not is_number(word)), min(3, len(words)))
        given[option], words = words[:count], words[count:]
    if not words:
        return None
    scale, offset = (_pair(given.get(option), missing) for option, missing in (("-s", 1.0), ("-o", 0.0)))
    clamps = given.get("-clamp") == ["on"]
    channel = next(iter(given.get("-imfchan", [])), None)
    obeyed = {"-s", "-o", "-clamp", "-bm", "-type", *(["-imfchan"] if channel in (*_CHANNELS, "l") else [])}
    left_out += [
        f"option {option} of a {key}" for option in given if option not in obeyed and not _is_idle(option, given)
    ]
    return _Map(" ".join(words), scale, offset, clamps, channel)


def _is_idle(option: str, given: Mapping[str, list[str]]) -> bool:
    return given[option] == _IDLE.get(option)


def _pair(words: Sequence[str] | None, missing: float) -> tuple[float, float]:
    """The first two numbers of `words`. `missing` replaces an omitted number."""
    first, second, *_ = [*map(float, words or ()), missing, missing]
    return first, second


def _are_alike(one: _Map, other: _Map) -> bool:
    return (one.scale, one.offset, one.clamps) == (other.scale, other.offset, other.clamps)


def _opacity(levels: UInt8[HostArray, "h w 4"], of: _Map | None) -> UInt8[HostArray, "h w"]:
    """The opacity of an image: the channel that the map names, or by default alpha if the image has it, and luminance
    otherwise."""
    channel = None if of is None else of.channel
    if channel in _CHANNELS:
        return levels[..., _CHANNELS[channel]]
    if channel is None and (levels[..., 3] < 255).any():
        return levels[..., 3]
    return np.rint(levels[..., :3] @ _LUMINANCE).astype(np.uint8)


def _joined(colours: UInt8[HostArray, "h w 4"] | None, opacity: UInt8[HostArray, "h2 w2"] | None) -> Picture | None:
    """An image with these colours and this opacity. It has the size of the opacity, because its outlines cast
    shadows."""
    if opacity is None:
        return None if colours is None else Picture(colours)
    if colours is None:
        colours = np.full((*opacity.shape, 4), 255, np.uint8)
    elif colours.shape[:2] != opacity.shape:
        scaled = Image.fromarray(np.ascontiguousarray(colours[..., :3])).resize(opacity.shape[::-1])
        colours = np.asarray(scaled)
    return Picture(np.concatenate([colours[..., :3], opacity[..., None]], axis=-1))
