"""Camera, sun and colours of a scene, recovered from one picture that another renderer made.

    python experiments/picture.py

The picture is ray traced: camera rays on a grid of 8 x 8 in each pixel, shadow rays, and shading, all without a shadow
map. From each of several random starts, a fit finds the camera (position, turn), the sun (azimuth, elevation) and the
colours of all meshes. At the start, the camera is off by 5 % of its distance and by 5 degrees, the sun by up to 10
degrees, and every component of a colour by up to 0.2. Prints the errors at the end of each fit.
"""

import dataclasses
import time
from typing import Any, NamedTuple

import _common as common
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from jaxtyping import Float
from rich.table import Table

from diffshadow import fit, geometry, shading, shadow, study
from diffshadow.console import Console

ALBEDO = {"plane": (0.7, 0.6, 0.5), "torus": (0.3, 0.5, 0.8), "box": (0.8, 0.3, 0.2), "sphere": (0.3, 0.7, 0.3)}
"""The colours of the meshes, by their names in the library."""
TEXELS, RAYS = 512, 8
"""Side of the shadow map, and camera rays along the side of a pixel."""
OFF, DEGREES_OFF, SUN_OFF, COLOUR_OFF = 0.05, 5.0, 10.0, 0.2
"""How far off a start is: the eye in distances of the camera, its turn, the sun's angles in degrees, and colours."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


class Outcome(NamedTuple):
    """The errors at the end of a fit: of the camera's position in per cent of its distance, of its turn and the sun's
    direction in degrees, and the largest of a colour; and how long it took, in seconds."""

    position: float
    turn: float
    sun: float
    colour: float
    rmse: float
    seconds: float


@app.default
def main(*, starts: int = 20, resolution: int = 128, seed: int = 0) -> list[Outcome]:
    """Recovers camera, sun and colours from one picture.

    Parameters
    ----------
    starts
        How many random starts.
    resolution
        Side of the picture, in pixels.
    seed
        Of the random starts.
    """
    common.expect("starts", str(starts), starts >= 1, "1 or more")
    common.expect("resolution", str(resolution), resolution >= 32, "32 or more")
    console, rng = Console(), np.random.default_rng(seed)
    scene = build(resolution)
    picture = study.traced_picture(scene, shading.Phong(), samples=1, supersampling=RAYS)
    outcomes = [recover(scene, picture, rng) for _ in common.progress(range(starts), "starts", console)]
    console.print(as_table(outcomes))
    return outcomes


def build(resolution: int) -> geometry.Scene:
    """The true scene."""
    placed = {"plane": (3.0, 0, 0, 0), "torus": (0.8, -0.5, 0.3, 0.3), "box": (0.5, 0.5, 0, 0.5)}
    placed["sphere"] = (0.5, 0.35, 0, -0.5)
    meshes = []
    for name, (size, *place) in placed.items():
        matrix = geometry.translation(jnp.asarray(place, float)) @ geometry.scaling(size)
        mesh = geometry.library_mesh(name).transformed(matrix)
        meshes.append(dataclasses.replace(mesh, albedo=np.broadcast_to(np.float32(ALBEDO[name]), mesh.faces.shape)))
    target = jnp.asarray([0, 0.2, 0])
    eye = geometry.orbit_eye(target, 3.5, azimuth=20.0, elevation=35.0)
    camera = geometry.PinholeCamera(eye, target, fov_y=40, near=0.5, far=10, resolution=(resolution,) * 2)
    points = jnp.concatenate([mesh.vertices for mesh in meshes])
    sun = geometry.DirectionalLight.around(jnp.asarray([-0.6, -1.0, -0.35]), points)
    return geometry.Scene(meshes, camera, sun)


def recover(scene: geometry.Scene, picture: Float[np.ndarray, "h w 3"], rng: np.random.Generator) -> Outcome:
    """Fits camera, sun and colours from a random start."""
    began = time.perf_counter()
    distance, truth = float(np.linalg.norm(scene.camera.eye - scene.camera.target)), scene.light.pose()
    away, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    pose = scene.camera.pose()
    moved = fit.with_values(
        pose,
        [f"{part}.{x}" for part in ("eye", "turn") for x in "xyz"],
        jnp.asarray(np.concatenate([np.asarray(pose.eye.array) + OFF * distance * away, DEGREES_OFF * axis])),
    )
    start = dataclasses.replace(scene, camera=scene.camera.at(moved))
    settings = shadow.MapSettings((TEXELS, TEXELS))
    technique = shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(constant=0.5, slope=1.0), map=settings)
    problem = fit.PictureProblem.of(start, technique, picture)
    parameters, reach, turn = [], 2 * OFF * distance, 2 * DEGREES_OFF
    for x, at in zip("xyz", np.asarray(start.camera.eye).tolist(), strict=True):
        parameters.append(fit.Parameter(f"camera.eye.{x}", at, at - reach, at + reach, "world units"))
        parameters.append(fit.Parameter(f"camera.turn.{x}", 0.0, -turn, turn, "degrees"))
    for name, value in (("azimuth", float(truth.azimuth)), ("elevation", float(truth.elevation))):
        first = value + rng.uniform(-SUN_OFF, SUN_OFF)
        parameters.append(fit.Parameter(f"lights.0.{name}", first, value - 25, value + 25, "degrees"))
    for i, colour in enumerate(ALBEDO.values()):
        for name, value in zip(("red", "green", "blue"), colour, strict=True):
            first = float(np.clip(value + rng.uniform(-COLOUR_OFF, COLOUR_OFF), 0.01, 0.99))
            parameters.append(fit.Parameter(f"meshes.{i}.albedo.{name}", first, 0.0, 1.0, ""))
    found = fit.fit(problem, parameters, on_step=lambda step: None)
    assert found.arrangement is not None
    end = found.arrangement.placed(problem.scene)
    colours = np.array([np.asarray(mesh.albedo[0]) for mesh in end.meshes])
    return Outcome(
        100 * float(np.linalg.norm(end.camera.eye - scene.camera.eye)) / distance,
        turn_between(end.camera, scene.camera),
        _between(end.light.pose().direction, truth.direction),
        float(np.abs(colours - np.array(list(ALBEDO.values()))).max()),
        found.errors[1],
        time.perf_counter() - began,
    )


def turn_between(a: geometry.AbstractCamera, b: geometry.AbstractCamera) -> float:
    """The angle between two cameras' axes, in degrees."""
    first, second = (np.asarray(camera.view().world_to_eye, float)[:3, :3] for camera in (a, b))
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(first - second) / 8**0.5)))


def _between(a: Any, b: Any) -> float:
    """The angle between two unit vectors, in degrees."""
    # By the chord, which stays accurate for small angles.
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(np.asarray(a, float) - np.asarray(b, float)) / 2)))


def as_table(outcomes: list[Outcome]) -> Table:
    """The errors of all starts, and how many fits are close."""
    table = Table("start", "position, %", "turn, deg", "sun, deg", "colour", "RMSE", "seconds")
    for i, outcome in enumerate(outcomes):
        table.add_row(str(i), *(f"{value:.3g}" for value in outcome))
    return table


if __name__ == "__main__":
    common.start(app)
