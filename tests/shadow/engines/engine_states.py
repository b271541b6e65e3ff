"""Engines' own maps, matrices and interpolated receivers, as the library's states and surfaces."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from golden_engines import EngineGolden

from diffshadow.geometry import MatrixLight, Mesh, PinholeCamera, PointLight, Scene
from diffshadow.raster import Surface


def matrix(values: list[float]) -> np.ndarray:
    """For column vectors, from the engine's list."""
    return np.reshape(values, (4, 4)).T


def light_of(golden: EngineGolden) -> Any:
    """The light of the engine's matrices."""
    info = golden.info
    if golden.settings["light"]["type"] == "point":
        return PointLight(info["lightPosition"], info["near"], info["far"])
    is_babylon = golden.engine == "babylon"
    return MatrixLight.from_engine(
        matrix(info["lightView"]),
        matrix(info["lightProjection"]),
        left_handed=is_babylon,
        depth=(1.0, 0.0) if golden.settings.get("reversedDepthBuffer") else (-1.0, 1.0),
    )


def surface_of(golden: EngineGolden) -> Surface:
    """What the engine's camera sees; faces are the first ones of meshes."""
    meshes = golden.settings["meshes"]
    position, normal, mesh = (golden.arrays[key] for key in ("position", "normal", "mesh"))
    # three.js turns the normals of back sides.
    is_three = golden.engine == "three"
    turned = np.array([is_three and mesh.get("side") == "back" for mesh in meshes])[mesh]
    normal = jnp.asarray(np.where(turned[..., None], -normal, normal))
    first = np.cumsum([0, *(len(mesh["faces"]) for mesh in meshes)])[mesh]
    face = jnp.asarray(np.where(mesh >= 0, first, -1), jnp.int32)
    return Surface(jnp.asarray(position), normal, normal, normal, face, jnp.asarray(mesh >= 0))


def scene_of(golden: EngineGolden, light: Any = None) -> Scene:
    """The engine's scene, with its light, or with the `light` given."""
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
    return Scene(meshes, camera, light_of(golden) if light is None else light, casts, receives(golden))


def receives(golden: EngineGolden) -> tuple[bool, ...]:
    """Which meshes receive shadows."""
    return tuple(mesh.get("receives", True) for mesh in golden.settings["meshes"])


def agreement(golden: EngineGolden, visibility: Any) -> float:
    """The share of receivers whose visibility differs by at most 1/255."""
    mesh = golden.arrays["mesh"]
    counted = (mesh >= 0) & np.array(receives(golden))[mesh]
    return float((np.abs(np.asarray(visibility) - golden.arrays["visibility"]) <= 1 / 255)[counted].mean())
