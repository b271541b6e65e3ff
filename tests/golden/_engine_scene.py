"""The meshes and the camera of the engines' goldens."""

from typing import Any

import numpy as np
from engines.engines import vertex_normals

from diffshadow.geometry import library_mesh

SIZE = {"width": 160, "height": 128}
CAMERA = {
    "position": [1.9, 1.9, 2.4],
    "target": [0.05, 0.25, 0.0],
    "up": [0, 1, 0],
    "fov": 33.0,
    "aspect": 1.25,
    "near": 0.5,
    "far": 20.0,
}


def geometry() -> dict[str, dict[str, np.ndarray]]:
    """The meshes by name: `vertices`, `normals` and `faces`.

    The blob is coarse, so that its interpolated normals are far from unit length; the fence has thin parts.
    """
    return {
        "ground": _placed("plane", (0.0, 0.0, 0.0), 0.0, size=3.2),
        "blob": _placed("blob", (-0.35, 0.02, 0.15), 0.0, radius=0.42, subdivisions=2),
        "box": _placed("box", (0.62, 0.0, 0.35), 0.5, size=(0.3, 0.5, 0.4)),
        "torus": _placed("torus", (0.45, 0.0, -0.5), 0.0, radius=0.3, tube=0.11, segments=24, sides=12),
    }


def _placed(name: str, at: tuple[float, float, float], turn: float, **options: Any) -> dict[str, np.ndarray]:
    mesh = library_mesh(name, **options)
    vertices, normals, faces = vertex_normals(mesh.vertices, mesh.faces, mesh.corner_normals)
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return {
        "vertices": (vertices @ matrix.T + at).astype(np.float32),
        "normals": (normals @ matrix.T).astype(np.float32),
        "faces": faces.astype(np.int16),
    }
