"""Meshes in other formats, which trimesh reads."""

import io
import re
import warnings
from pathlib import Path

import numpy as np

from ._errors import MeshError, damaged
from ._polygons import Polygons

# Formats whose faces are all triangles. trimesh cuts other faces as fans, which is wrong for concave faces.
_TRIANGLES_ONLY = {"3mf", "ctm", "drc", "stl_ascii"}
# The message of trimesh's error names the required package in one of these forms.
_PACKAGE = re.compile(r"No module named '([^']+)'|pip install ([\w.-]+)")


def suffix_of_others(file: Path) -> str | None:
    """The suffix of `file` without its dot, which is trimesh's name for the format. `None` if trimesh does not read
    it."""
    # trimesh is slow to load, and few files need it.
    from trimesh.exchange import load

    known = {*load.mesh_loaders, *load.compressed_loaders}
    name = file.name.lower()
    # Prefers `tar.gz` to `gz`.
    return max((suffix for suffix in known if name.endswith(f".{suffix}")), key=len, default=None)


def read_others(data: bytes, suffix: str, name: str) -> Polygons:
    """Reads the triangles of all meshes of a file, at their positions in its scene. Normals are not read.

    **Arguments:**

    - `suffix`: the format, from `suffix_of_others`; `name`: the file's name, which tells trimesh the compression.

    **Raises** `MeshError` if the file is damaged, or if a package for its format is missing.
    """
    import trimesh

    stream = io.BytesIO(data)
    stream.name = name
    try:
        with warnings.catch_warnings():
            # Libraries warn about other libraries.
            warnings.simplefilter("ignore")
            # Unprocessed, because processing drops vertices that are not finite.
            scene = trimesh.load_scene(stream, file_type=suffix, process=False)
        meshes = [each for each in scene.dump() if isinstance(each, trimesh.Trimesh)]
    except ImportError as error:
        found = _PACKAGE.search(str(error))
        package = next(filter(None, found.groups())) if found else str(error)
        raise MeshError(
            f"is in the format {suffix}, which needs a package that is not installed: {package}; install it "
            "(pip install 'diffshadow[meshes]' adds 3MF and COLLADA), or convert the file to OBJ, PLY or glTF"
        ) from error
    except Exception as error:  # trimesh's readers raise many types.
        raise damaged(f"trimesh cannot read it ({error or type(error).__name__})") from error
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    none = np.zeros((0, 3))
    vertices = np.concatenate([none, *(np.asarray(mesh.vertices, np.float64) for mesh in meshes)])
    faces = np.concatenate([none, *(mesh.faces + start for mesh, start in zip(meshes, starts, strict=False))])
    left_out = {"point": 0, "line": 0}
    for each in scene.geometry.values():
        if not isinstance(each, trimesh.Trimesh):
            left_out["point"] += 0 if hasattr(each, "entities") else len(each.vertices)
            left_out["line"] += len(getattr(each, "entities", ()))
    corners, sizes = faces.astype(np.int64).ravel(), np.full(len(faces), 3)
    return Polygons(vertices, corners, sizes, left_out, are_fans=suffix not in _TRIANGLES_ONLY)
