"""Engines' own maps, matrices and interpolated receivers, as the library's states and surfaces."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from golden_engines import EngineGolden

from diffshadow.geometry import MatrixLight, Mesh, PinholeCamera, PointLight, Scene
from diffshadow.raster import Surface
from diffshadow.shadow import EngineMap


def matrix(values: list[float]) -> np.ndarray:
    """For column vectors, from the engine's list."""
    return np.reshape(values, (4, 4)).T


def light_of(golden: EngineGolden) -> Any:
    """The engine's light."""
    info = golden.info
    if golden.settings["light"]["type"] == "point":
        return PointLight(info["lightPosition"], info["near"], info["far"])
    near, far = info["near"], info["far"]
    projection = matrix(info["lightProjection"])
    if golden.engine == "babylon":
        return right_handed(matrix(info["lightView"]), projection)
    is_parallel = projection[3, 3] == 1
    # Without reversed depth, which the preset adds itself.
    projection[2] = (
        [0, 0, -2 / (far - near), -(far + near) / (far - near)]
        if is_parallel
        else [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)]
    )
    return MatrixLight(matrix(info["lightView"]), projection, not is_parallel)


def right_handed(view: np.ndarray, projection: np.ndarray) -> MatrixLight:
    """What sees the mirror image of a left-handed camera, whose eye looks along +z."""
    view, projection = view.copy(), projection.copy()
    view[[0, 2]] *= -1
    projection[0, 2:] *= -1
    projection[:, 2] *= -1
    return MatrixLight(view, projection, bool(projection[3, 3] == 0))


def surface_of(golden: EngineGolden) -> Surface:
    """What the engine's camera sees; faces are numbers of meshes."""
    arrays = {key: jnp.asarray(golden.arrays[key]) for key in ("position", "normal", "mesh")}
    position, normal, mesh = arrays.values()
    return Surface(position, normal, normal, normal, mesh, mesh >= 0)


def scene_of(golden: EngineGolden) -> Scene:
    """The engine's scene."""
    meshes = []
    for mesh in golden.settings["meshes"]:
        faces = mesh["faces"].astype(np.int32)
        normals = None if mesh["normals"] is None else mesh["normals"][faces]
        meshes.append(Mesh(mesh["vertices"], faces, normals))
    given = golden.settings["camera"]
    camera = PinholeCamera(
        given["position"],
        given["target"],
        given["up"],
        fov_y=given["fov"],
        near=given["near"],
        far=given["far"],
        resolution=(golden.settings["height"], golden.settings["width"]),
    )
    casts = tuple(mesh.get("casts", True) for mesh in golden.settings["meshes"])
    return Scene(meshes, camera, light_of(golden), casts)


def receives(golden: EngineGolden) -> np.ndarray:
    """Which meshes receive shadows, (m,)."""
    return np.array([mesh.get("receives", True) for mesh in golden.settings["meshes"]])


def read_back(golden: EngineGolden, depth: np.ndarray, offset: list[float]) -> EngineMap:
    """The engine's own map; `offset` are the factors of the meshes' normal biases."""
    return EngineMap(jnp.asarray(depth), light_of(golden), offset, receives(golden))


def agreement(golden: EngineGolden, visibility: Any) -> float:
    """The share of receivers whose visibility differs by at most 1/255."""
    mesh = golden.arrays["mesh"]
    counted = (mesh >= 0) & receives(golden)[mesh]
    return float((np.abs(np.asarray(visibility) - golden.arrays["visibility"]) <= 1 / 255)[counted].mean())
