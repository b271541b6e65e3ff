"""Converts a scene of another program to a configuration and its mesh files."""

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ... import geometry, io
from ..._words import counted
from ...config import ConfigError, Location, Mistake, dump, parse_config
from ...settings.engines import ImportedTechnique, ShadowType, ThreeJs
from ..pages import _table as table
from ._complete import completed
from ._lamp import mesh_of
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
    """Writes the configuration of a scene's file and its meshes. Prints the imported and the omitted parts.

    **Arguments:**

    - `path`: a JSON file of three.js, GLB, glTF 2.0, or any mesh file. A missing camera, light or ground is added.
    - `camera`, `light`: names; by default the first camera, and the first light that casts shadows. `camera` may also
      be the file of a scene with a camera.
    - `shadow_type`: `renderer.shadowMap.type`, which scene files do not store.
    - `output`: the folder to write to; by default a folder in the current folder, with the name of the file.

    **Returns** the path of the configuration.

    **Raises** `FileError` for a file that cannot be read or written, or a configuration that exists already. **Raises**
    `ValueError` for a scene without meshes or without a light that casts shadows, and `ConfigError` for a scene that no
    configuration can describe.
    """
    file = Path(path)
    if file.is_dir():
        raise io.FileError(
            f"{file} is a folder; expected the file of a scene or a mesh; to use a run's folder, give it to fit, "
            "render or convert"
        )
    name = _plain_name(file.stem)
    folder = Path(name) if output is None else Path(output)
    written = folder / f"{name}.yaml"
    if written.exists():
        raise io.FileError(
            f"{written} exists already; expected a new file, because it may have been edited; remove it, or give "
            "another folder with --output"
        )
    scene = io.read_scene(file)
    remarks = list(scene.remarks)
    if camera is not None and Path(camera).is_file():
        scene, camera = scene._replace(cameras=io.read_scene(camera).cameras), None
    try:
        chosen = _converted(scene, file, written, camera, light, technique, shadow_type, remarks)
    except ValueError:
        # An omitted part may be the cause.
        table.print_lines(console, [f"note: {line}" for line in remarks])
        raise
    _say(console, chosen, remarks)
    return written


def _converted(
    scene: io.SceneFile,
    file: Path,
    written: Path,
    camera: str | None,
    light: str | None,
    technique: ImportedTechnique,
    shadow_type: ShadowType,
    remarks: list[str],
) -> Chosen:
    """Writes the files of `import_scene`. **Returns** the imported parts. Adds to `remarks`."""
    folder = written.parent
    scene = completed(scene, camera, light, remarks)
    chosen = choose(scene, camera, light, remarks)
    if scene.engine is None:
        chosen = _with_lamp(chosen, remarks)
    files = _file_names(chosen)
    textures = _texture_names(chosen, files)
    # Far from the world's origin, files store the shapes of meshes, and the configuration stores their positions.
    origins = [geometry.origin_of(mesh.vertices) for mesh in chosen.meshes]
    remarks += [f"{mesh.name} {coarse}" for mesh in chosen.meshes if (coarse := io.coarse_steps(mesh.vertices))]
    settings = settings_of(chosen, files, textures, origins, scene.engine is not None, technique, shadow_type, remarks)
    if technique == "three.js" and scene.engine is None:
        remarks.append("the file has no settings of shadows: bias, radius, map size and sides are three.js' defaults")
    if technique == "three.js":
        remarks.append(f"renderer.shadowMap.type is not in the file; {shadow_type} is used (--shadow-type)")
    text = _text({"name": written.stem, **settings}, file.name)
    _check(text, file, folder)
    near = [
        mesh._replace(vertices=mesh.vertices - np.asarray(origin))
        for mesh, origin in zip(chosen.meshes, origins, strict=True)
    ]
    pictures = {
        name: mesh.texture.picture
        for name, mesh in zip(textures, chosen.meshes, strict=True)
        if name is not None and mesh.texture is not None and mesh.texture.picture is not None
    }
    _write(folder, written.name, text, dict(zip(files, near, strict=True)), pictures)
    return chosen


def _with_lamp(chosen: Chosen, remarks: list[str]) -> Chosen:
    """`chosen`, without shadows from the light's own mesh if the file has no settings of shadows."""
    mesh = None if chosen.light.type == "directional" else mesh_of(chosen.meshes, np.asarray(chosen.light.position))
    if mesh is None:
        return chosen
    remarks.append(f"{mesh.name}: it is the mesh of the light {chosen.light.name}, and casts no shadow here")
    return chosen._replace(meshes=[each._replace(casts=False) if each is mesh else each for each in chosen.meshes])


def _check(text: str, file: Path, folder: Path) -> None:
    """**Raises** `ConfigError` if the scene exceeds the limits of configurations. Checked before anything is
    written."""
    try:
        parse_config(text, folder=folder, fitting=True, files=False)
    except ConfigError as error:
        said = "it comes from the scene: change it there"
        raise ConfigError(
            [Mistake(Location(str(file)), each.key, f"{each.message} ({said})") for each in error.mistakes]
        ) from error


def _write(
    folder: Path, name: str, text: str, meshes: Mapping[str, io.SceneMesh], pictures: Mapping[str, io.Picture]
) -> None:
    """Writes the configuration, its meshes and their textures, or nothing.

    **Raises** `FileError` if that is not possible.
    """
    io.check_writable(folder / _MESHES)
    made = [level for level in (folder / _MESHES, folder, *folder.parents) if not level.exists()]
    draft = folder / f".{name}-{secrets.token_hex(6)}"
    try:
        (draft / _MESHES).mkdir(parents=True)
        for of, mesh in meshes.items():
            io.write_ply(draft / of, mesh.vertices, mesh.faces, mesh.normals, mesh.colours, mesh.uv, mesh.alpha)
        for of, picture in pictures.items():
            (draft / of).write_bytes(io.png_of(picture.levels))
        (draft / name).write_text(text, encoding="utf-8")
        (folder / _MESHES).mkdir(exist_ok=True)
        # The configuration comes last, so it exists only if all other files do.
        for each in (*meshes, *pictures, name):
            os.replace(draft / each, folder / each)
    except OSError as error:
        raise io.FileError(f"cannot write to {folder.absolute()}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if not (folder / name).exists():
            for level in made:
                with contextlib.suppress(OSError):
                    level.rmdir()


def _file_names(chosen: Chosen) -> list[str]:
    """A file for each mesh, with the name of the mesh."""
    names: list[str] = []
    for mesh in chosen.meshes:
        plain = _plain_name(mesh.name)
        name, count = plain, 2
        while name in names:
            name, count = f"{plain}_{count}", count + 1
        names.append(name)
    return [f"{_MESHES}/{name}.ply" for name in names]


def _texture_names(chosen: Chosen, files: Sequence[str]) -> list[str | None]:
    """A file for each mesh's picture, with the name of the first mesh that has it. `None` for a mesh without a
    picture."""
    names: dict[int, str] = {}
    pictures = [None if mesh.texture is None else mesh.texture.picture for mesh in chosen.meshes]
    return [
        None if picture is None else names.setdefault(id(picture), file.removesuffix(".ply") + ".png")
        for picture, file in zip(pictures, files, strict=True)
    ]


def _plain_name(name: str) -> str:
    """`name` without characters that files and runs cannot have in their names."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()[:60] or "scene"


def _text(settings: dict[str, Any], source: str) -> str:
    header = f"# Taken from {source!r} by diffshadow import. Lengths are in its world units.\n"
    return header + dump(settings)


def _say(console: Console, chosen: Chosen, remarks: Sequence[str]) -> None:
    meshes, camera, light = chosen
    triangles = sum(len(mesh.faces) for mesh in meshes)
    taken = [
        f"{counted(len(meshes), 'mesh')}, {counted(triangles, 'triangle')}: "
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
