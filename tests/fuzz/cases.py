"""Cases for the command line: files and arguments, each drawn from a seed and its number alone."""

import copy
import functools
import json
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import mutate
import numpy as np
import words
from mutate import SCHEMA

from diffshadow.config.reading._draft import load_draft

# Fits of shapes trace their targets before they are found valid, and fits to pictures compile for a minute.
SLOW = {"picture.yaml", "shadow_art.yaml", "shape_from_shadows.yaml"}
CONFIGS = sorted(path for path in (Path(__file__).parents[2] / "configs").glob("*.yaml") if path.name not in SLOW)
TEMPLATE, RUN = "template", "runs/damaged"
"""Folders beside a case's files: of a finished run, and of a copy of it that the case may spoil."""
DRAWN_EVERY = 60
"""One case in this many draws a technique; nearly all others end before anything is drawn."""

TINY = {
    "scene.camera.resolution": [12, 12],
    "shadow_map.resolution": [16, 16],
    "reference.samples": 2,
    "fit.solver.max_steps": 1,
    "fit.anneal.phases": 1,
}
BASE = {
    "name": "drawn",
    "scene": {
        "meshes": [
            {"path": "builtin:box", "size": 0.6, "drop_to_ground": True, "translate": [0, 0.2, 0]},
            {"path": "builtin:plane", "options": {"size": 3}, "casts": False},
        ],
        "camera": {"resolution": [12, 12], "orbit": {"distance": 4}},
    },
    "shadow_map": {"resolution": [16, 16]},
    "reference": {"type": "traced", "samples": 2},
    "fit": {"solver": {"max_steps": 1}, "anneal": {"phases": 1}},
}
"""A scene that is small enough to be drawn in milliseconds."""
_CASTER = b"v 0 0 0\nv 1 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n"


Drawn = tuple[str, dict[str, bytes], list[list[str]]] | tuple[str, dict[str, bytes], list[list[str]], bool]
"""The fields of a case but for its seed and number."""


class Case(NamedTuple):
    """Files by name, which begin a folder of their own, and command lines to run there one after the other.

    A command only follows if the one before ended well. The files are gone before a run is read again.

    - `damaged`: whether there is also a run in `RUN`, which `damage` has changed.
    """

    seed: int
    number: int
    kind: str
    files: dict[str, bytes]
    commands: list[list[str]]
    damaged: bool = False


def make(seed: int, number: int) -> Case:
    """The case of `number` in the run of `seed`."""
    rng = Random(f"{seed}/{number}")
    if number % DRAWN_EVERY == 0:
        return Case(seed, number, *_technique(rng, number // DRAWN_EVERY))
    kinds = {_file: 60, _text: 25, _overrides: 25, _scratch: 15, _sweep: 10, _arguments: 8, _folder: 8}
    (kind,) = rng.choices(list(kinds), list(kinds.values()))
    return Case(seed, number, *kind(rng))


@functools.cache
def _data(path: Path) -> dict[str, Any]:
    data = load_draft(path).data
    # One shape for all, so that they share what is compiled.
    first, *_, last = data["scene"]["meshes"]
    data["scene"]["meshes"] = [{**first, "path": "builtin:box", "options": {}}, last]
    data["scene"].setdefault("camera", {})["resolution"] = TINY["scene.camera.resolution"]
    data.setdefault("shadow_map", {})["resolution"] = TINY["shadow_map.resolution"]
    data.setdefault("reference", {})["samples"] = TINY["reference.samples"]
    if "sweep" in data and "limit_samples" in data["sweep"]:
        data["sweep"]["limit_samples"] = 16
    return data


def _config(rng: Random) -> dict[str, Any]:
    """One of the shipped configurations, made small; without its sweep, for the most part."""
    data = copy.deepcopy(_data(rng.choice(CONFIGS)))
    if "sweep" in data and rng.random() < 0.8:
        del data["sweep"]
    return data


def _validated(rng: Random, kind: str, text: str | bytes, *overrides: str) -> Drawn:
    """A configuration that is validated; of those that pass, a few are also rendered."""
    name = rng.choice(words.FILES) if rng.random() < 0.02 else "case.yaml"
    given = [f"./{name}" if name.startswith("-") else name, *overrides]
    commands = [["validate", *given]]
    if rng.random() < 0.02:
        small = [f"{key}={json.dumps(value)}" for key, value in TINY.items()]
        commands += [[verb, *given, *small, "output=runs", "sweep=null"] for verb in ("validate", "render")]
    return kind, {name: _bytes(text)}, commands


def _bytes(text: str | bytes) -> bytes:
    return text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text


def _file(rng: Random) -> Drawn:
    """A shipped configuration with a few things changed."""
    data = _config(rng)
    for _ in range(rng.choice([1, 1, 1, 2, 2, 3, 5])):
        mutate.spoil(rng, data)
    return _validated(rng, "file", mutate.write(data))


def _text(rng: Random) -> Drawn:
    """A shipped configuration whose very letters are changed."""
    text = mutate.write(_config(rng)).encode() if rng.random() < 0.9 else rng.choice(CONFIGS).read_bytes()
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        text = mutate.garble(rng, text)
    return _validated(rng, "text", text)


def _scratch(rng: Random) -> Drawn:
    """A configuration of nothing but what the schema allows, section by section."""
    data = mutate.section(rng, SCHEMA, wild=rng.choice([0, 0.1]))
    if rng.random() < 0.9:
        # Each new scene that is valid costs seconds of compiling.
        data |= {"scene": copy.deepcopy(BASE["scene"]), "shadow_map": copy.deepcopy(BASE["shadow_map"])}
    return _validated(rng, "scratch", mutate.write(data))


def _overrides(rng: Random) -> Drawn:
    """A good configuration with overrides, good and bad."""
    data = _config(rng)
    overrides = [_override(rng, data) for _ in range(rng.choice([1, 1, 2, 3]))]
    return _validated(rng, "overrides", mutate.write(data), *overrides)


def _override(rng: Random, data: dict[str, Any]) -> str:
    path, schema = rng.choice(list(mutate.places(data, SCHEMA))[1:])
    key = ".".join(map(str, path))
    if rng.random() < 0.2:
        key = mutate.misspelt(rng, key)
    if rng.random() < 0.1:
        key = rng.choice(words.KEYS)
    value = mutate.valid(rng, schema, str(path[-1])) if schema and rng.random() < 0.5 else mutate.odd(rng)
    # A process gets no NUL among its arguments.
    return rng.choice([f"{key}={mutate.inline(value)}"] * 8 + [key, f"{key}:1", f" {key} = 2 "]).replace("\0", "\\0")


def _sweep(rng: Random) -> Drawn:
    """A sweep that is only listed."""
    data = copy.deepcopy(_data(rng.choice([path for path in CONFIGS if "sweep" in _data(path)])))
    data["sweep"] |= mutate.valid(rng, SCHEMA["$defs"]["SweepConfig"]) if rng.random() < 0.5 else {}
    for _ in range(rng.choice([0, 1, 2])):
        inner = {"sweep": data["sweep"]}
        mutate.spoil(rng, inner)
        data |= inner
    return "sweep", {"case.yaml": _bytes(mutate.write(data))}, [["sweep", "case.yaml", "--dry-run"]]


def _technique(rng: Random, turn: int) -> Drawn:
    """Any filter, bias, compare, light and technique, drawn; every eighth with a fit, and read again."""
    data = copy.deepcopy(BASE)
    for key in ("technique", "filter", "bias", "compare", "shading"):
        among = mutate.plain(SCHEMA["properties"][key])
        among = among.get("oneOf", [among])
        # Every filter has its turn.
        data[key] = mutate.valid(rng, among[turn % len(among)] if key == "filter" else rng.choice(among), wild=0)
    if rng.random() < 0.7:
        data["technique"] = {"type": "shadow_map"}
    lights = mutate.plain(SCHEMA["$defs"]["SceneConfig"]["properties"]["light"]["anyOf"][0])["oneOf"]
    drawn = [mutate.valid(rng, light, wild=0) for light in rng.sample(lights, 2)]
    # Most lights placed at random see nothing: two of three stand where they do by default.
    drawn = [light if rng.random() < 0.3 else {"type": light["type"]} for light in drawn]
    # Capacity for all but the widest filters.
    drawn = [{**light, "guard": 1} if light["type"] == "point" else light for light in drawn]
    data["scene"] |= {"lights": drawn} if rng.random() < 0.15 else {"light": drawn[0]}
    files = {}
    if rng.random() < 0.3:
        data["scene"]["meshes"][0]["path"] = "caster.obj"
        files = {"caster.obj": _CASTER}
    if rng.random() < 0.3:
        data["shadow_map"] |= mutate.section(rng, SCHEMA["$defs"]["ShadowMapConfig"], wild=0)
        data["shadow_map"]["resolution"] = [16, 16]
    verb = "fit" if turn % 8 == 7 and data["technique"]["type"] == "shadow_map" else "render"
    commands = [["validate", "case.yaml"], [verb, "case.yaml"]]
    folder = "runs/drawn" if verb == "fit" else "runs/drawn-render"
    commands += [["report", folder], ["compare", folder, TEMPLATE, "--output", "compare.html"]]
    return "technique", {"case.yaml": _bytes(mutate.write(data)), **files}, commands


def _arguments(rng: Random) -> Drawn:
    """Command lines that somebody mistyped."""
    first = rng.choice(["validate", "validate", "report", "compare", "fit", "render"])
    arguments = [first, *(rng.choice(words.ARGUMENTS) for _ in range(rng.choice([0, 1, 1, 2, 3])))]
    # What would draw does so in vain: the file is wrong.
    return "arguments", {"case.yaml": b"seed: -1\n"}, [arguments]


def _folder(rng: Random) -> Drawn:
    """A finished run of which something was changed."""
    return "folder", {}, [rng.choice([["report", RUN], ["compare", RUN, TEMPLATE, "--output", "compare.html"]])], True


def damage(case: Case, folder: Path) -> None:
    """Changes one file of the run in `folder`, or puts something else in its place."""
    rng = Random(f"damage {case.seed}/{case.number}")
    file = folder / rng.choice(["result.json", "result.json", "result.json", "config.yaml", "arrays.npz", "arrays.npz"])
    text, how = file.read_bytes(), rng.random()
    if how < 0.15:
        file.unlink()
        rng.choice([lambda: None, file.mkdir, lambda: file.symlink_to("nowhere"), lambda: file.symlink_to(file.name)])()
    elif how < 0.4:
        file.write_bytes(mutate.garble(rng, text))
    elif file.suffix == ".npz":
        _damage_arrays(rng, file)
    elif file.suffix == ".json":
        data = json.loads(text)
        mutate.spoil(rng, data, {})
        file.write_text(json.dumps(data))
    else:
        data = load_draft(file).data
        mutate.spoil(rng, data)
        file.write_bytes(_bytes(mutate.write(data)))


def _damage_arrays(rng: Random, file: Path) -> None:
    with np.load(file) as kept:
        arrays = dict(kept)
    name = rng.choice(list(arrays))
    array = arrays.pop(name)
    shapes = [None, array[:1], array[None], array[:0], array.T[:, :3], np.array(3)]
    kinds = [array.astype(kind) for kind in (str, complex, np.int8, object)]
    values = [np.full(array.shape, np.nan), np.full(array.shape, 1e30), array.astype(float) - 1]
    if (new := rng.choice(shapes + kinds + values)) is not None:
        arrays[name] = new
    np.savez(file, **arrays)
    if rng.random() < 0.3:
        # Headers that promise more than there is.
        huge = file.read_bytes().replace(b"(12, 12)", rng.choice([b"(-1, -1)", b"(99999999999, 99999999)"]))
        file.write_bytes(huge)
