"""Gradients of pictures against differences of pictures by rays: five scenes, by all that moves."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import quad, sun

from diffshadow import fit, geometry, raster, reference, shadow

pytestmark = pytest.mark.exhaustive
SIDE, RAYS, TEXELS = 64, 8, 256
CAMERA = geometry.PinholeCamera((1.1, 3.0, 4.2), (0.05, 0.3, 0), fov_y=40, near=1, far=12, resolution=(SIDE, SIDE))
TECHNIQUE = shadow.ShadowMapping(
    shadow.Bilinear(), shadow.Bias(constant=0.5, slope=1.0), map=shadow.MapSettings((TEXELS, TEXELS))
)
# By how much each moves for differences of pictures by rays: so far that the rays' own error is small.
MOVES = {
    "camera.eye.x": 0.02,
    "camera.turn.y": 0.4,
    "camera.turn.z": 0.8,
    "lights.0.azimuth": 2.0,
    "lights.0.elevation": 2.0,
    "meshes.1.translate.x": 0.02,
    "meshes.1.translate.y": 0.02,
    "meshes.1.turn.y": 2.0,
    "vertices": 0.02,
}
PATHS = tuple(path for path in MOVES if path != "vertices")


def placed(name, size, at, axis, angle, **options):
    matrix = geometry.translation(jnp.asarray(at)) @ geometry.rotation(jnp.asarray(axis, float), angle)
    return geometry.fit_to_size(geometry.library_mesh(name, **options), size).transformed(matrix)


BOX = placed("box", 1.0, (0.1, 0.2, 0.15), (0, 1, 0), 0.0)
CASTERS = {
    "a box in the air": placed("box", 0.8, (0.1, 0.9, 0.15), (1, 0.3, 0.2), 0.8),
    "a torus in the air": placed("torus", 1.2, (0.1, 0.8, 0.1), (1, 0.2, 0.3), 0.9, segments=12, sides=10),
    "a ball in the air": placed("sphere", 1.0, (0.0, 0.8, 0.1), (1, 0.2, 0.3), 0.4, subdivisions=1),
    "a box that crosses the floor": BOX,
    "two boxes that cross": geometry.merge([BOX, placed("box", 0.8, (0.55, 0.5, 0.4), (1, 0.4, 0.2), 0.7)]),
}

# The median and the most of the relative errors. A ball and a torus that turn hardly change their pictures.
LIMITS = {
    "a box in the air": (0.04, 0.13),
    "a torus in the air": (0.06, 0.28),
    "a ball in the air": (0.02, 0.2),
    "a box that crosses the floor": (0.03, 0.05),
    "two boxes that cross": (0.06, 0.2),
}


def painted(mesh, colour):
    return dataclasses.replace(mesh, albedo=jnp.broadcast_to(jnp.asarray(colour), mesh.faces.shape))


def scene_of(name):
    meshes = [painted(quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), (0.7, 0.6, 0.5)), painted(CASTERS[name], (0.8, 0.3, 0.2))]
    return geometry.Scene(meshes, CAMERA, sun(geometry.merge(meshes), direction=(-0.55, -1, -0.3)))


def bent(scene, by):
    """With the caster's vertices moved to the side, the more the higher they lie."""
    meshes = list(scene.meshes)
    height = meshes[1].vertices[:, 1:2]
    moved = meshes[1].vertices + by * height**2 * jnp.asarray([0.8, 0.0, 0.6])
    meshes[1] = dataclasses.replace(meshes[1], vertices=moved)
    return dataclasses.replace(scene, meshes=meshes)


def problem_of(scene):
    """Its problem, with the memory of all others, so that one program serves them."""
    given = fit.PictureProblem.of(scene, TECHNIQUE, np.zeros((SIDE, SIDE, 3))).planned()
    assert given.plan is not None
    assert given.edges is not None
    assert given.crossings is not None
    assert given.plan.pieces <= 2048
    assert given.plan.crossings <= 512
    assert given.crossings[0] <= 8192
    plan = dataclasses.replace(given.plan, pieces=2048, crossings=512)
    edges = given.edges.padded(512, 1024)
    return dataclasses.replace(given, plan=plan, edges=edges, crossings=(8192,))


@eqx.filter_jit
def pushed(given, values, by, way, way_by):
    """The picture, and its derivative along a way."""

    def at(values, by):
        moved = dataclasses.replace(given, scene=bent(given.scene, by))
        return moved.difference(fit.with_values(given.arrangement, PATHS, values))

    return jax.jvp(at, (values, by), (way, way_by))


def traced(scene):
    fine = dataclasses.replace(scene.camera, resolution=(RAYS * SIDE, RAYS * SIDE))
    truth = reference.trace_visibility(dataclasses.replace(scene, camera=fine), samples=1)
    return fine, raster.draw_surface(scene.mesh, fine), jnp.asarray(truth.visibility)


def by_rays(given, values, by):
    """The picture by rays, channel by channel."""
    arrangement = fit.with_values(given.arrangement, PATHS, values)
    scene = arrangement.placed(bent(given.scene, by))
    fine, seen, visibility = traced(scene)
    image = np.asarray(arrangement.shading(seen, visibility, scene.light, fine), float)
    return np.moveaxis(image.reshape(SIDE, RAYS, SIDE, RAYS, 3).mean(axis=(1, 3)), -1, 0)


def weights():
    """Of three smooth losses."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    losses = np.stack([np.sin(5 * x + 3 * y), np.cos(4 * x - 6 * y), x])
    return losses[:, None] * np.reshape([1, 0.5, 0.3], (3, 1, 1))


def losses_of(picture):
    return np.sum(np.asarray(picture, float) * weights(), axis=(1, 2, 3))


def moved(values, path, step):
    """The values and the bend after a step, and the way there."""
    way = jnp.asarray([float(each == path) for each in PATHS])
    return values + step * way, jnp.asarray(step * (path == "vertices")), way, jnp.asarray(float(path == "vertices"))


@pytest.mark.parametrize("name", CASTERS)
def test_gradients_of_pictures_match_differences_of_traced_ones(name):
    """Of smooth losses; and differences of the picture itself, by small steps."""
    given = problem_of(scene_of(name))
    values = jnp.asarray([float(fit.resolve(given.arrangement, path)) for path in PATHS])
    off, own = {}, {}
    for path, step in MOVES.items():
        here, by, way, way_by = moved(values, path, 0.0)
        found = losses_of(pushed(given, here, by, way, way_by)[1])
        ends = [losses_of(by_rays(given, *moved(values, path, sign * step)[:2])) for sign in (1, -1)]
        truth = (ends[0] - ends[1]) / (2 * step)
        off[path] = np.linalg.norm(found - truth) / np.linalg.norm(truth)
        for small in (0.0005, 0.001, 0.002, 0.004):
            scale = small * (57.3 if step > 0.1 else 1.0)
            ends = [losses_of(pushed(given, *moved(values, path, sign * scale))[0]) for sign in (1, -1)]
            change = (ends[0] - ends[1]) / (2 * scale)
            own[path, small] = np.linalg.norm(found - change) / np.linalg.norm(found)
    print(name, given.shadow_points)
    for path in MOVES:
        steps = [f"{100 * value:.1f}" for (which, _), value in own.items() if which == path]
        print(f"  {path:22} {100 * off[path]:.2f} %   own differences {' '.join(steps)} %")
    middle, most = LIMITS[name]
    assert np.median([*off.values()]) < middle
    assert max(off.values()) < most
    assert np.median([value for (path, _), value in own.items() if path.startswith("lights")]) < 0.05
