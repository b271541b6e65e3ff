"""Writes a configuration to start from."""

from pathlib import Path

from .._errors import ConfigError, Location, Mistake
from ..sections._scene import BUILTIN
from ._of_mesh import scene_of_mesh
from ._templates import DEFAULT_TEMPLATE, template_text


def write_template(name: str, mesh: Path | None = None, output: Path | None = None) -> tuple[Path, tuple[str, ...]]:
    """Writes the template `name` as a configuration, with its comments.

    **Arguments:**

    - `mesh`: a mesh file that replaces the template's scene.
    - `output`: the file to write; by default named like the mesh and the template, in the current folder.

    **Returns** the file, and notes on the mesh.

    **Raises** `ConfigError` if there is no such template or mesh, or the file exists already or cannot be written.
    """
    name = name.removeprefix(BUILTIN)
    # A run is named like its file: the mesh alone and each template have runs of their own.
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
        raise _mistake(file, f"exists already; expected no such file, since it may have been edited; {mend}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        message = f"cannot be written ({error.strerror}); expected a path that can be; give another with --output"
        raise _mistake(file, message) from error
    return file, notes


def _mistake(file: Path, message: str) -> ConfigError:
    return ConfigError([Mistake(Location(str(file)), "", message)])
