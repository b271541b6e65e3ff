"""Turns a scene that another program stored into a configuration and its mesh files."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from ... import io
from ...config import dump, load_config
from ...settings.engines import ImportedTechnique, ShadowType, ThreeJs
from ..pages import _table as table
from ._settings import Chosen, choose, settings_of

_MESHES = "meshes"


def import_scene(
    path: str | os.PathLike[str],
    *,
    console: Console,
    camera: str | None = None,
    light: str | None = None,
    technique: ImportedTechnique = "three.js",
    shadow_type: ShadowType = ThreeJs.shadow_type,
    output: str | os.PathLike[str] | None = None,
) -> Path:
    """Writes the configuration of a scene's file, and its meshes beside it. Says what is taken over and what is not.

    **Arguments:**

    - `path`: a JSON file of three.js, GLB or glTF 2.0.
    - `camera`, `light`: names; by default the first camera, and the first light that casts shadows. `camera` may also
        be a scene's file that holds a camera.
    - `shadow_type`: `renderer.shadowMap.type`, which no scene's file holds.
    - `output`: the folder to write to; by default one named like the file, in the current folder.

    **Returns** the path of the configuration.

    **Raises** `FileError` for a file that cannot be read or written, or a configuration that exists already,
    `ValueError` for a scene without camera, light or meshes, and `ConfigError` for one that no configuration can hold.
    """
    file = Path(path)
    name = _plain_name(file.stem)
    folder = Path(name) if output is None else Path(output)
    written = folder / f"{name}.yaml"
    if written.exists():
        raise io.FileError(
            f"{written} exists already; expected no such file, since it may have been edited; remove it, or give "
            "another folder with --output"
        )
    scene = io.read_scene(file)
    remarks = list(scene.remarks)
    if camera is not None and Path(camera).is_file():
        scene, camera = scene._replace(cameras=io.read_scene(camera).cameras), None
    chosen = choose(scene, camera, light, remarks)
    io.check_writable(folder)
    files = _file_names(chosen)
    settings = settings_of(chosen, files, scene.engine is not None, technique, shadow_type, remarks)
    if technique == "three.js" and scene.engine is None:
        remarks.append("glTF has no settings of shadows: bias, radius, map size and sides are three.js' defaults")
    if technique == "three.js":
        remarks.append(f"renderer.shadowMap.type is not in the file; {shadow_type} is taken (--shadow-type)")
    (folder / _MESHES).mkdir(parents=True, exist_ok=True)
    for mesh, of in zip(chosen.meshes, files, strict=True):
        io.write_ply(folder / of, mesh.vertices, mesh.faces, mesh.normals)
    text = _text({"name": name, **settings}, file.name)
    with io.atomic_path(written) as temporary:
        temporary.write_text(text, encoding="utf-8")
    # A scene may lie beyond the limits of configurations.
    load_config(written, fitting=True)
    _say(console, chosen, remarks)
    return written


def _file_names(chosen: Chosen) -> list[str]:
    """A file for each mesh, named like it."""
    names: list[str] = []
    for mesh in chosen.meshes:
        plain = _plain_name(mesh.name)
        name, count = plain, 2
        while name in names:
            name, count = f"{plain}_{count}", count + 1
        names.append(name)
    return [f"{_MESHES}/{name}.ply" for name in names]


def _plain_name(name: str) -> str:
    """`name` without what file names and the names of runs cannot have."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()[:60] or "scene"


def _text(settings: dict[str, Any], source: str) -> str:
    header = f"# Taken from {source!r} by diffshadow import. Lengths are in its world units.\n"
    return header + dump(settings)


def _say(console: Console, chosen: Chosen, remarks: Sequence[str]) -> None:
    meshes, camera, light = chosen
    triangles = sum(len(mesh.faces) for mesh in meshes)
    taken = [
        f"{len(meshes)} mesh{'' if len(meshes) == 1 else 'es'}, {triangles:,} triangles: "
        + ", ".join(mesh.name for mesh in meshes[:8])
        + (" and others" if len(meshes) > 8 else ""),
        f"camera {camera.name}: {'parallel' if camera.fov_y is None else f'{camera.fov_y:.4g} degrees'}",
        f"{light.type} light {light.name}"
        + (
            ""
            if light.shadow is None
            else f": map of {light.shadow.map_size[0]} × {light.shadow.map_size[1]} texels, "
            f"bias {light.shadow.bias:g}, normalBias {light.shadow.normal_bias:g}, radius {light.shadow.radius:g}, "
            f"intensity {light.shadow.intensity:g}"
        ),
    ]
    table.print_lines(console, [*(f"taken: {line}" for line in taken), *(f"note: {line}" for line in remarks)])
