"""Configurations that come with the package, and files made from them."""

import os
import re
from importlib import resources
from pathlib import Path
from typing import Any

from .._errors import ConfigError, Location, Mistake, nearest
from ..sections._scene import BUILTIN
from ._dump import dump
from ._yaml import read_yaml

DEFAULT_TEMPLATE = "quickstart"
"""The template that is taken if none is named."""
# Numbers of engines' techniques in world units, which depend on the size of the scene.
_LENGTHS = re.compile(r"^ *(?:technique\.)?normal_bias:.*$", re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")
# Longest side of the meshes of these templates, world units.
_SIDE_OF_TEMPLATES = 2.0


def folder_of_templates() -> Path:
    """The folder of the templates: in the package where it was installed from a wheel, and beside it in a clone."""
    package = Path(str(resources.files(__name__.partition(".")[0])))
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def template_names() -> list[str]:
    """The names of all templates."""
    return sorted(file.stem for file in folder_of_templates().glob("*.yaml"))


def template_path(name: str, given: str) -> Path:
    """The file of the template `name`; `given` names it in errors.

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

    - `source`: names the template in errors.
    - `scene`: a section that replaces the template's, whose longest `side` is in world units.

    **Raises** `ConfigError` if there is no such template, or it lists its meshes outside of its section `scene`.
    """
    text = template_path(name, source).read_text(encoding="utf-8")
    text = text.replace(f"configs/{name}.yaml", file)
    # Its experiment is in the repository only.
    text = re.sub(r"^#   python experiments/.*\n", "", text, flags=re.MULTILINE)
    if scene is None:
        return text
    data, *_ = read_yaml(text, lambda line, column: Location(source, line, column))
    if "scene.meshes" in dump({key: part for key, part in data.items() if key != "scene"}):
        message = (
            f"the template {name} lists its meshes in the sections fit, sweep or advise; expected a template with one "
            "scene, such as quickstart; leave --mesh out, and edit the lists in the file"
        )
        raise ConfigError([Mistake(Location(source), "", message)])
    resolution = (data["scene"].get("camera") or {}).get("resolution", [512, 512])
    made = dump({"scene": {**scene, "camera": {"resolution": resolution, **scene.get("camera", {})}}})
    text = re.sub(r"^scene:\n(?:[ #].*\n|\n(?=[ #]))*", lambda _: made, text, count=1, flags=re.MULTILINE)
    text = re.sub(r"^name: .*$", f"name: {Path(file).stem}", text, count=1, flags=re.MULTILINE)
    # The first lines tell of the template's own scene.
    said = f"# Made from the template {name} for a mesh of one's own.\n#   diffshadow fit {file}\n"
    text = re.sub(r"\A(?:#.*\n)+", lambda _: said, text)
    factor = float(f"{side / _SIDE_OF_TEMPLATES:.2g}")
    scaled = lambda found: f"{float(found.group()) * factor:.3g}"
    return _LENGTHS.sub(lambda line: _scaled(line.group(), scaled), text)


def _scaled(line: str, scaled: Any) -> str:
    numbers, hash_, comment = line.partition("#")
    return _NUMBER.sub(scaled, numbers) + hash_ + comment
