"""Configurations of the package, and configurations for a mesh file."""

import os
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from ...settings.scene import GLTF_SUFFIXES, MESH_SUFFIXES, NO_MESH_SUFFIXES
from .._errors import ConfigError, Location, Mistake, nearest
from ..sections._scene import BUILTIN
from ._dump import dump
from ._yaml import read_yaml

DEFAULT_TEMPLATE = "quickstart"
"""The default template."""
# Numbers of engines' techniques in world units, which depend on the size of the scene.
_LENGTHS = re.compile(r"^ *(?:technique\.)?normal_bias:.*$", re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")
# The longest side of the meshes of these templates, in world units.
_SIDE_OF_TEMPLATES = 2.0


def folder_of_templates() -> Path:
    """The folder of the templates: inside the package if it was installed from a wheel, and next to it in a clone."""
    package = Path(str(resources.files(__name__.partition(".")[0])))
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def template_names() -> list[str]:
    """The names of all templates."""
    return sorted(file.stem for file in folder_of_templates().glob("*.yaml"))


def template_path(name: str, given: str) -> Path:
    """The file of the template `name`; `given` is the template's name in errors.

    **Raises** `ConfigError` if there is none.
    """
    names = template_names()
    if name in names:
        return folder_of_templates() / f"{name}.yaml"
    suggestion = nearest(name, names)
    mend = f"did you mean {suggestion!r}?" if suggestion else "name one of these"
    message = f"there is no template {name!r}; expected one of {', '.join(names)}; {mend}"
    raise ConfigError([Mistake(Location(given), "", message)])


def resolved_path(path: str | os.PathLike[str]) -> Path:
    """`path`, or the template's file if it is `builtin:NAME`."""
    text = os.fspath(path)
    return template_path(text.removeprefix(BUILTIN), text) if text.startswith(BUILTIN) else Path(path)


def template_text(name: str, *, source: str, file: str, scene: dict[str, Any] | None = None, side: float = 0.0) -> str:
    """The text of the template `name`, for the configuration's file `file`.

    **Arguments:**

    - `source`: the name of the template in errors.
    - `scene`: a section that replaces the template's `scene`. The scene's longest `side` is in world units.

    **Raises** `ConfigError` if there is no such template, or if its meshes are listed outside of its section `scene`.
    """
    text = template_path(name, source).read_text(encoding="utf-8")
    text = text.replace(f"configs/{name}.yaml", file)
    # The experiment of the template is only in the repository.
    text = re.sub(r"^#   python experiments/.*\n", "", text, flags=re.MULTILINE)
    if scene is None:
        return text
    data = read_yaml(text, lambda line, column: Location(source, line, column)).data
    if "scene.meshes" in dump({key: part for key, part in data.items() if key != "scene"}):
        message = (
            f"the template {name} lists its meshes in the sections fit, sweep or advise; expected a template with one "
            "scene, such as quickstart; leave --mesh out, and edit the lists in the file"
        )
        raise ConfigError([Mistake(Location(source), "", message)])
    made = dump({"scene": _in_place_of(data["scene"], scene)})
    text = re.sub(r"^scene:\n(?:[ #].*\n|\n(?=[ #]))*", lambda _: made, text, count=1, flags=re.MULTILINE)
    text = re.sub(r"^name: .*$", f"name: {Path(file).stem}", text, count=1, flags=re.MULTILINE)
    # The first lines describe the template's own scene.
    said = f"# Made from the template {name} for your own mesh.\n#   diffshadow fit {file}\n"
    text = re.sub(r"\A(?:#.*\n)+", lambda _: said, text)
    factor = float(f"{side / _SIDE_OF_TEMPLATES:.2g}")

    def scaled(line: re.Match[str]) -> str:
        numbers, hash_, comment = line.group().partition("#")
        return _NUMBER.sub(lambda found: f"{float(found.group()) * factor:.3g}", numbers) + hash_ + comment

    return _LENGTHS.sub(scaled, text)


def template_of_mesh(file: Path) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The default template's data for a mesh file, and notes on the mesh.

    **Raises** `ConfigError` if the file cannot be read.
    """
    made = scene_of_mesh(file)
    text = template_path(DEFAULT_TEMPLATE, str(file)).read_text(encoding="utf-8")
    data = read_yaml(text, lambda line, column: Location(str(file))).data
    # Engines have no slope-scaled bias, so a fit without it converts to all of them.
    changed = {"name": file.stem.strip() or "mesh", "bias": {**data.get("bias", {}), "slope": 0}}
    return {**data, **changed, "scene": _in_place_of(data["scene"], made.scene)}, made.notes


def _in_place_of(old: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, Any]:
    """The section `scene` with the image size of the `old` one."""
    resolution = (old.get("camera") or {}).get("resolution", [512, 512])
    return {**scene, "camera": {"resolution": resolution, **scene.get("camera", {})}}


def write_template(name: str, mesh: Path | None = None, output: Path | None = None) -> tuple[Path, tuple[str, ...]]:
    """Writes the template `name` as a configuration, with its comments.

    **Arguments:**

    - `mesh`: a mesh file that replaces the template's scene.
    - `output`: the file to write; by default named like the mesh and the template, in the current folder.

    **Returns** the file, and notes on the mesh.

    **Raises** `ConfigError` if there is no such template or mesh, or the file exists already or cannot be written.
    """
    name = name.removeprefix(BUILTIN)
    # A run has the name of its file. The mesh alone and each template have separate runs.
    stem = name if mesh is None else mesh.stem if name == DEFAULT_TEMPLATE else f"{mesh.stem}_{name}"
    file = Path(f"{stem}.yaml") if output is None else output
    notes: tuple[str, ...] = ()
    if mesh is None:
        text = template_text(name, source=name, file=str(file))
    else:
        # The template is checked before the mesh is read.
        template_text(name, source=name, file=str(file), scene={})
        made = scene_of_mesh(mesh)
        text, notes = template_text(name, source=name, file=str(file), scene=made.scene, side=made.side), made.notes
    if file.exists():
        mend = "remove it, or give another with --output"
        raise _mistake(file, f"exists already; expected a new file, because it may have been edited; {mend}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        message = f"cannot be written ({error.strerror}); expected a path that can be; give another with --output"
        raise _mistake(file, message) from error
    return file, notes


def _mistake(file: Path, message: str) -> ConfigError:
    return ConfigError([Mistake(Location(str(file)), "", message)])


class MeshScene(NamedTuple):
    """A section `scene` with a mesh file, its longest side in world units, and notes, each a sentence without a full
    stop."""

    scene: dict[str, Any]
    side: float
    notes: tuple[str, ...]


def is_mesh(file: Path) -> bool:
    """Whether the name of `file` is that of a mesh."""
    suffix = file.suffix.lower()
    if suffix in MESH_SUFFIXES:
        return True
    if suffix in NO_MESH_SUFFIXES or not file.is_file():
        return False
    from ... import io

    return io.suffix_of_others(file) is not None


def scene_of_mesh(file: Path) -> MeshScene:
    """The scene of a mesh file, rotated if its `z` is up. Camera, light and ground are set to auto.

    **Raises** `ConfigError` if the file cannot be read.
    """
    # These imports load JAX.
    from ... import geometry, io
    from ..framing._find import corners_of
    from ..sections._scene import MeshConfig

    path = str(file.absolute())
    try:
        io.existing_file(file, "mesh")
        corners = corners_of(MeshConfig(path=path))
    except (ValueError, OSError) as error:
        raise ConfigError([Mistake(Location(str(file)), "", str(error))]) from error
    is_gltf = file.suffix.lower() in GLTF_SUFFIXES
    notes: list[str] = []
    mesh: dict[str, Any] = {"path": path}
    if geometry.up_of(corners, is_gltf) == "z":
        mesh["rotate"] = [-90.0, 0.0, 0.0]
        notes.append("z is up, because the mesh is flat across z; if y is, set scene.meshes.0.rotate=[0, 0, 0]")
    elif is_gltf and geometry.stands_on_z(corners):
        notes.append(
            "y is up, as in glTF, and the mesh has a flat foot across z; if z is up, set "
            "'scene.meshes.0.rotate=[-90, 0, 0]'"
        )
    if is_gltf and (left_out := _left_out(file)):
        notes.append(f"the file's {left_out} are not used; to use them: diffshadow import {file}")
    side = float((corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max())
    return MeshScene({"meshes": [mesh], "ground": "auto", "light": "auto"}, side, tuple(notes))


def _left_out(file: Path) -> str:
    """The cameras and lights of a glTF file, in words; empty if it has none."""
    from ... import io

    try:
        scene = io.read_scene(file)
    except io.FileError:
        return ""
    parts = (("cameras", scene.cameras), ("lights", scene.lights))
    return " and ".join(name for name, entries in parts if entries)
