"""Matrices, views, cameras, lights, meshes and textures."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffshadow import geometry
from diffshadow._arithmetic import as_float, in_unit_range, safe_norm, with_gradient_of
from diffshadow.geometry import CameraPose, DirectionalLight, LightPose, PointLight, RectangleLight, SpotLight, Vector
from diffshadow.geometry._transforms import infinite_far, tangents
from diffshadow.geometry._warp import Warp

from . import numbers, row

POINTS = np.array([[0.3, 0.2, -0.4], [-0.5, 0.6, 0.2], [0.1, -0.3, 0.7]])
SAMPLES = np.array([[0.3, -0.6], [-0.2, 0.5], [0.7, 0.1]])


@row("a value with another derivative", [0.3, -1.7], backward=True)
def _():
    rounded = lambda x: (with_gradient_of(jnp.sin(x), jnp.round(x)), in_unit_range(1.5 * x))
    return rounded, lambda x: (jnp.sin(x), 1.5 * x)


@row(
    "matrices",
    [0.4, 0.9, -0.3, 0.7, -0.2, 0.5, 1.3, 0.6, 4.2, 1.7],
    "geometry.frame geometry.look_at geometry.orthographic geometry.perspective geometry.rotation geometry.scaling "
    "geometry.transform_points geometry.transform_vectors geometry.translation",
)
def _():
    def of(x):
        way, up, sides = x[:3], jnp.asarray([0.2, 1.0, 0.1]), jnp.stack([-x[6], x[9]])
        turn = geometry.look_at(x[3:6], way, up)
        return {
            "frame": geometry.frame(way, up),
            "look_at": turn,
            "perspective": geometry.perspective(sides, 0.7 * sides, x[7], x[8]),
            "infinite": infinite_far(jnp.eye(4), x[7]),
            "orthographic": geometry.orthographic(sides, 0.7 * sides, x[7], x[8]),
            "rotation": geometry.rotation(way, x[6]),
            "scaling": geometry.scaling(x[3:6]),
            "translation": geometry.translation(x[3:6]),
            "points": geometry.transform_points(turn, jnp.asarray(POINTS)),
            "vectors": geometry.transform_vectors(turn, jnp.asarray(POINTS)),
            "tangents": tangents(way / safe_norm(way)),
        }

    return of


@row("a rotation at rest", [0.0, 0.0, 0.0])
def _():
    return lambda x: geometry.rotation_less_one(x)


@row("a point on an orbit", [0.2, -0.4, 0.7, 2.3], "geometry.orbit_eye")
def _():
    return lambda x: geometry.orbit_eye(x[:3], x[3], 35.0, 20.0)


def _seen(view):
    points = jnp.asarray(POINTS)
    distance = view.distance(points)
    return {
        "clip": view.clip(points),
        "distance": distance,
        "slope": view.depth_slope(distance),
        "extent": view.texel_extent(distance, (16, 24)),
        "size": view.texel_size(distance, (16, 24)),
        "depth": view.eye_depth(0.3 + 0.1 * distance),
    }


@row(
    "a pinhole camera",
    [1.4, 1.8, 2.2, 4.0, -7.0, 9.0, 41.0],
    "camera.pinhole.eye.x camera.pinhole.eye.y camera.pinhole.eye.z camera.pinhole.turn.x camera.pinhole.turn.y "
    "camera.pinhole.turn.z camera.pinhole.fov_y geometry.PinholeCamera geometry.CameraPose geometry.View",
    step=1e-4,
)
def _():
    camera = geometry.PinholeCamera((1.2, 1.9, 2.5), (0.1, 0.2, 0), (0.1, 1, 0), 40, 0.3, 9, (12, 20))

    def of(x):
        moved = camera.at(CameraPose(Vector(*x[:3]), Vector(*x[3:6]), x[6]))
        return {**_seen(moved.view()), "pose": moved.pose(), "up": moved.up, "target": moved.target}

    return of


@row(
    "a parallel camera",
    [1.4, 1.8, 2.2, 4.0, -7.0, 9.0, 3.1],
    "camera.orthographic.eye.x camera.orthographic.eye.y camera.orthographic.eye.z camera.orthographic.turn.x "
    "camera.orthographic.turn.y camera.orthographic.turn.z camera.orthographic.height geometry.OrthographicCamera",
    step=1e-4,
)
def _():
    camera = geometry.OrthographicCamera((1.2, 1.9, 2.5), (0.1, 0.2, 0), (0.1, 1, 0), 3, 0.3, 9, (12, 20))
    return lambda x: _seen(camera.at(CameraPose(Vector(*x[:3]), Vector(*x[3:6]), None, x[6])).view())


@row(
    "a camera of matrices",
    [1.4, 1.8, 2.2, 4.0, -7.0, 9.0],
    "camera.matrix.eye.x camera.matrix.eye.y camera.matrix.eye.z camera.matrix.turn.x camera.matrix.turn.y "
    "camera.matrix.turn.z geometry.MatrixCamera",
    step=1e-4,
)
def _():
    view = geometry.PinholeCamera((1.2, 1.9, 2.5), (0.1, 0.2, 0), (0.1, 1, 0), 40, 0.3, 9, (12, 20)).view()
    camera = geometry.MatrixCamera(view.world_to_eye, view.eye_to_clip, (12, 20), True)

    def of(x):
        moved = camera.at(CameraPose(Vector(*x[:3]), Vector(*x[3:6])))
        return {**_seen(moved.view()), "pose": moved.pose(), "target": moved.target}

    return of


@row("a warped view", [1.3, 0.2, 0.4, -0.3, 0.6, 0.3, 0.7])
def _():
    own = DirectionalLight((0.4, -1, -0.3), (0, 0, 0), (3, 2), -2, 2).view()

    def of(x):
        warp = Warp(x[0], x[1])
        view = dataclasses.replace(own, warp=warp)
        texel = x[None, 5:] * jnp.asarray([24.0, 16.0])
        return {
            "clip": view.clip(x[None, 2:5]),
            "divisor": warp.divisor(x[5]),
            "extent": view.texel_extent(jnp.ones(1), (16, 24), texel),
            "along": view.along_axes(x[None, 3:5], texel, (16, 24)),
        }

    return of


@row("a view whose vertices are at whole steps, and one that is shifted", [0.4, -0.3, 0.6, 0.2, -0.7])
def _():
    own = DirectionalLight((0.4, -1, -0.3), (0, 0, 0), (3, 2), -2, 2).view()
    view = dataclasses.replace(own, steps=jnp.asarray([24.0, 16.0]))
    shifted = lambda x: own.shifted(x[3:], (16, 24)).clip(x[None, :3])
    of = lambda x: (view.clip_vertices(x[None, :3]), shifted(x))
    return of, lambda x: (own.clip(x[None, :3]), shifted(x))


SPOT = {"near": 0.7, "far": 6.0, "radius": 0.2, "inner_angle": 21.0, "up": (0.2, 1, 0.1), "aspect": 1.4}
UP = (0.2, 1, 0.1)


def spot(**more):
    return SpotLight((0.9, 2.1, 0.8), (-0.3, -1, -0.4), 33.0, **(SPOT | more))


def sun():
    return DirectionalLight((0.5, -1, -0.3), (0.1, 0.2, -0.1), (3, 2), -2, 2.5, 3.0, UP)


def lamp():
    return PointLight((0.2, 0.9, 0.1), 0.1, 4.0, 0.15, 0.1)


def panel():
    return RectangleLight((0.9, 2.1, 0.8), (-0.3, -1, -0.4), (0.5, 0.3), 33.0, 0.7, 6.0, UP)


def _lit(light):
    points = jnp.asarray(POINTS)
    return {
        "towards": light.towards(points),
        "sample": light.towards(points, jnp.asarray(SAMPLES)),
        "clip": light.view().facing(light.layer(points)).clip(points),
        "cone": light.cone_fraction(points),
        "pose": light.pose(),
    }


@row(
    "a spot light's pose",
    [0.9, 2.1, 0.8, 31.0, 62.0, 0.2],
    "lights.spot.position.x lights.spot.position.y lights.spot.position.z lights.spot.azimuth lights.spot.elevation "
    "lights.spot.radius geometry.SpotLight geometry.LightPose",
    step=1e-4,
)
def _():
    light = spot()
    return lambda x: _lit(light.at(LightPose(Vector(*x[:3]), *x[3:])))


@row("a spot light's cone and frustum", [-0.3, -1.0, -0.4, 33.0, 0.7, 6.0, 21.0, 1.4], step=1e-4)
def _():
    def of(x):
        light = SpotLight((0.9, 2.1, 0.8), x[:3], x[3], x[4], x[5], 0.2, x[6], UP, x[7])
        return {**_lit(light), **_seen(light.view())}

    return of


@row(
    "a sun's pose",
    [31.0, 62.0, 3.0],
    "lights.directional.azimuth lights.directional.elevation lights.directional.radius geometry.DirectionalLight",
    step=1e-4,
)
def _():
    light = sun()
    return lambda x: _lit(light.at(LightPose(None, *x)))


@row(
    "a point light's pose",
    [0.2, 0.9, 0.1, 0.15],
    "lights.point.position.x lights.point.position.y lights.point.position.z lights.point.radius geometry.PointLight",
)
def _():
    light = lamp()
    return lambda x: _lit(light.at(LightPose(Vector(*x[:3]), radius=x[3])))


@row(
    "a rectangle's pose",
    [0.9, 2.1, 0.8, -0.3, -1.0, -0.4, 0.5, 0.3],
    "lights.rectangle.position.x lights.rectangle.position.y lights.rectangle.position.z geometry.RectangleLight",
)
def _():
    light = panel()
    parts = lambda one: (one.direction, one.size)
    return lambda x: _lit(eqx.tree_at(parts, light.at(LightPose(Vector(*x[:3]))), (x[3:6], x[6:])))


@row("a light of matrices", [0.4, 0.9, -0.3, 0.7, -0.2, 0.5], "geometry.MatrixLight")
def _():
    plain = spot().view()

    def of(x):
        turn = geometry.look_at(x[3:], x[:3], jnp.asarray([0.2, 1.0, 0.1]))
        light = geometry.MatrixLight(turn, plain.eye_to_clip, True)
        parallel = geometry.MatrixLight(turn, sun().view().eye_to_clip, False)
        lit = lambda one: (one.towards(jnp.asarray(POINTS)), one.view().clip(jnp.asarray(POINTS)))
        return lit(light), lit(parallel)

    return of


CLOUD = np.concatenate([POINTS, [[-0.8, 0.1, -0.6], [0.7, -0.2, 0.3]]])


def _refitted(name, light, of_pose, fields, at, has_disk=True):
    """That a refitted frustum has no derivative, by the light's pose and by the size of what it contains; and that
    the light's own pose keeps its."""

    def fitted(x):
        return light().at(of_pose(x[:-1])).refitted(jnp.asarray(CLOUD) * x[-1])

    @row(f"the frustum of a refitted {name}", [*at, 0.9], is_still=True, step=1e-4)
    def _():
        return lambda x: [getattr(fitted(x), field) for field in fields]

    @row(f"the light of a refitted {name}", at, step=1e-4)
    def _():
        samples = lambda: jnp.asarray(SAMPLES) if has_disk else None
        return lambda x: light().at(of_pose(x)).refitted(jnp.asarray(CLOUD)).towards(jnp.asarray(POINTS), samples())


_AT = (0.9, 2.1, 0.8)
_refitted(
    "spot light",
    spot,
    lambda x: LightPose(Vector(*x[:3]), *x[3:5], as_float(0.2)),
    ("near", "far"),
    (*_AT, 31.0, 62.0),
)
_refitted(
    "spot light without a cone",
    lambda: spot(inner_angle=None),
    lambda x: LightPose(Vector(*x[:3]), *map(as_float, (31.0, 62.0, 0.2))),
    ("direction", "outer_angle", "near", "far"),
    _AT,
    # Its disk faces along the frustum.
    has_disk=False,
)
_refitted(
    "sun",
    sun,
    lambda x: LightPose(None, *x[:2], as_float(3.0)),
    ("center", "extent", "near", "far"),
    (31.0, 62.0),
)
_refitted(
    "point light", lamp, lambda x: LightPose(Vector(0.9, x[0], 0.8), radius=as_float(0.15)), ("near", "far"), (2.1,)
)
_refitted("rectangle", panel, lambda x: LightPose(Vector(*x[:3])), ("outer_angle", "near", "far"), _AT)

PYRAMID = (
    np.array([(0.5, 0.1, 0), (-0.4, 0, 0.5), (-0.3, -0.1, -0.6), (0.1, 0.8, 0.1)]),
    np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]),
)
"""Vertices and faces of a pyramid whose faces are unequal."""


def pyramid(angle=180.0):
    vertices, faces = PYRAMID
    return geometry.Mesh(vertices, faces, geometry.crease_normals(vertices, faces, angle))


@row(
    "a mesh's pose",
    [0.3, -0.2, 0.6, 20.0, -35.0, 12.0, 0.15, 0.75, 0.05, 0.3, 0.5, 0.7],
    "meshes.translate.x meshes.translate.y meshes.translate.z meshes.turn.x meshes.turn.y meshes.turn.z "
    "meshes.vertices.x meshes.vertices.y meshes.vertices.z meshes.albedo.red meshes.albedo.green meshes.albedo.blue "
    "fit.MeshPose",
    step=1e-4,
)
def _():
    from diffshadow.fit import MeshPose
    from diffshadow.shading import Colour

    mesh = pyramid()
    start = MeshPose.of(mesh, [3], (0.1, 0.2, 0.3), coloured=True)

    def of(x):
        vectors = Vector(*x[:3]), Vector(*x[3:6]), {"3": Vector(*x[6:9])}
        parts = lambda pose: (pose.translate, pose.turn, pose.vertices, pose.albedo)
        placed = eqx.tree_at(parts, start, (*vectors, Colour(*x[9:]))).placed(mesh)
        return placed.vertices, placed.corner_normals, placed.albedo, geometry.face_normals(placed)

    return of


@row("shading normals of a vertex between creases", [0.15, 0.75, 0.05])
def _():
    from diffshadow.geometry import Smoothing

    vertices, faces = PYRAMID
    mesh = geometry.Mesh(vertices, faces, geometry.crease_normals(vertices, faces, 95.0))
    smoothing = Smoothing.of(mesh, [3])
    return lambda x: smoothing.corner_normals(mesh, mesh.vertices.at[3].set(x))


@row(
    "meshes that are moved and scaled",
    [0.4, 1.3, 0.7, 0.2, 1.7, 0.4],
    "geometry.Mesh geometry.MeshLike geometry.as_mesh geometry.face_normals geometry.fit_to_size "
    "geometry.drop_to_ground geometry.merge",
)
def _():
    plain = pyramid()

    def of(x):
        matrix = geometry.rotation(jnp.asarray([0.3, 1.0, 0.2]), x[0]) @ geometry.scaling(x[1:4])
        moved = plain.transformed(matrix)
        dropped = geometry.drop_to_ground(geometry.fit_to_size(moved, x[4]), x[5])
        both = geometry.merge([moved, dropped])
        return both.vertices, both.corner_normals, geometry.face_normals(both), both.bounds

    return of


@row("textures", [0.31, 0.82, 1.13, -0.27, 0.4, 0.6, 0.2, 0.9], "geometry.Textures geometry.NO_TEXTURE")
def _():
    texels, uv = numbers(1, 12, 4), np.zeros((3, 3, 2))
    table = np.array([[0, 2, 3], [6, 3, 2]])

    def of(x):
        textures = geometry.Textures(
            uv, [0, 1, -1], texels.at[jnp.array([3, 9])].set(x[4:].reshape(2, 2)[:, [0, 1, 0, 1]]), table
        )
        place = jnp.concatenate([x[:4].reshape(2, 2), x[None, :2]])
        return textures.at(jnp.array([0, 1, -1]), place)

    return of
