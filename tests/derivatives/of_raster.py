"""What pixels see, and the lines along which colours jump."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffshadow import geometry, raster
from diffshadow._arithmetic import normalize
from diffshadow.geometry import CameraPose, Vector
from diffshadow.raster import points_within_pixels
from diffshadow.raster._antialias import AntialiasedSurface, _antialiased, _boundaries, _edges_of, _Seen
from diffshadow.raster._boundaries import Boundaries, Pieces
from diffshadow.raster._drawn_view import drawn_view
from diffshadow.raster._interpolate import _depth_planes, _from_far
from diffshadow.raster._plane_crossings import plane_crossings
from diffshadow.raster._segments import Segments
from diffshadow.raster._surface import surface_at_centres

from . import centres, faces_at, numbers, row, surface_of

SIZE = 5, 8
CORNERS = np.array([(-0.9, -0.6, 0.1), (1.0, -0.7, 0.4), (0.9, 0.8, -0.5), (-0.8, 0.5, -0.2)])
FACES = np.array([(0, 1, 2), (0, 2, 3)], np.int32)


def camera():
    return geometry.PinholeCamera((0.3, 0.5, 2.6), (0.05, 0.1, 0), (0.1, 1, 0), 41, 0.7, 6, SIZE)


def _clip(x, moved=(0, 2)):
    vertices = jnp.asarray(CORNERS).at[jnp.asarray(moved)].add(x.reshape(2, 3))
    return vertices, camera().view().clip_vertices(vertices)


_STILL = (0.03, -0.02, 0.05, -0.04, 0.02, -0.03)


@row(
    "interpolated attributes and depth",
    (*_STILL, 0.4, 0.9),
    "raster.barycentrics raster.interpolate raster.interpolate_corners raster.interpolate_depth raster.visible_depth "
    "raster.Barycentrics",
)
def _():
    face = jnp.asarray(faces_at(_clip(np.array(_STILL))[1], FACES, centres(*SIZE)))
    faces, values, of_corners = jnp.asarray(FACES), numbers(1, 4, 2), numbers(2, 2, 3, 2)

    def of(x):
        _, clip = _clip(x[:6])
        at = raster.barycentrics(face, clip, faces)
        # The depth of fewer pixels than there are faces is found in another way.
        few = face[2:3, 3:4]
        return {
            "weights": at.weights,
            "vertices": raster.interpolate(at, values.at[1].set(x[6:]), faces),
            "corners": raster.interpolate_corners(at, of_corners.at[1, 2].set(x[6:])),
            "depth": raster.interpolate_depth(at, clip, faces),
            "visible": raster.visible_depth(face, clip, faces),
            "of few": raster.visible_depth(few, clip, faces),
        }

    return of


@row("the depth of pixels that are pulled back onto their face", _STILL)
def _():
    faces = jnp.asarray(FACES)
    beside = jnp.where(jnp.arange(40).reshape(SIZE) == 0, jnp.int32(0), jnp.int32(-1))
    of = lambda x: raster.visible_depth(beside, _clip(x)[1], faces)
    smooth = lambda x: jnp.where(beside < 0, 1, 0.5 * _depth_planes(_from_far(_clip(x)[1]), faces).middle[0])
    return of, smooth


@row("a surface", (*_STILL, 0.3, 0.5, 2.6, 0.7, 0.4, 0.6, 0.03), "raster.Surface raster.draw_surface")
def _():
    from diffshadow.geometry import Textures

    face = jnp.asarray(faces_at(_clip(np.array(_STILL))[1], FACES, centres(*SIZE)))
    textures = Textures.of(numbers(3, 3, 4, 3), numbers(4, 2, 3, 2))
    plain = geometry.Mesh(CORNERS, FACES, numbers(5, 2, 3, 3), (0.5, 0.6, 0.7), numbers(6, 2, 3, 3), textures)

    def of(x):
        own = dataclasses.replace(camera(), eye=x[6:9])
        vertices, _ = _clip(x[:6])
        parts = lambda mesh: [mesh.vertices, mesh.albedo, mesh.corner_colours, mesh.textures.texels, mesh.textures.uv]
        scales = [plain.albedo * x[9], plain.corner_colours * x[10], textures.texels * x[11], textures.uv + x[12]]
        moved = eqx.tree_at(parts, plain, [vertices, *scales])
        view = own.view()
        seen = surface_at_centres(moved, own.eye, view, face, view.clip_vertices(vertices))
        return seen, seen.shading_normal

    return of


@row("the view that a camera with a small near distance is drawn with", [0.3, 0.5, 2.6])
def _():
    mesh = geometry.Mesh(CORNERS, FACES)

    def of(x):
        near = dataclasses.replace(camera(), eye=x, near=jnp.asarray(1e-6))
        view = drawn_view(near.view(), mesh)
        clip = view.clip(mesh.vertices)
        return clip[:, :2], view.eye_depth(clip[:, 2] / clip[:, 3] * 0.5 + 0.5)

    return of


def _far_from(start, end, point):
    """How far a point lies to the left of lines: it does not depend on where on the lines their ends are."""
    along = normalize(end - start)
    return along[..., 0] * (point[1] - start[..., 1]) - along[..., 1] * (point[0] - start[..., 0])


CROSSING = np.array([(-0.7, -0.5, 0.5), (0.9, -0.3, -0.6), (-0.2, 0.9, -0.4)])


@row("lines in which meshes cross", _STILL)
def _():
    faces = np.array([(0, 1, 2), (3, 4, 5)], np.int32)
    both = lambda x: (
        camera()
        .view()
        .clip_vertices(
            jnp.concatenate([jnp.asarray(CORNERS[:3]), jnp.asarray(CROSSING)])
            .at[jnp.array([1, 5])]
            .add(x.reshape(2, 3))
        )
    )
    start = both(np.array(_STILL))
    seen = [faces_at(start, faces[[number]], centres(*SIZE)) for number in (0, 1)]
    centre = faces_at(start, faces, centres(*SIZE))
    other = jnp.asarray(np.where((seen[0] == 0) & (seen[1] == 0), 1 - centre, -1), jnp.int32)

    def of(x):
        found = plane_crossings(other, jnp.asarray(centre), both(x), jnp.asarray(faces), 12)
        far = [_far_from(found.start, found.end, point) for point in ((0.3, 0.4), (7.1, 2.2))]
        return [jnp.where(found.used, each, 0) for each in far]

    return of


def _from_centre(pixel, nearest, right, width):
    """How far to the left of a line its pixel's centre is, where the line's nearest point is its foot. There it does
    not depend on how the line turns; 0 where that point is an end."""
    away = nearest - jnp.stack([pixel % width, pixel // width], axis=1) - 0.5
    distance = jnp.sum(right * away, axis=1)
    return jnp.where(jnp.sum((away - distance[:, None] * right) ** 2, axis=1) < 1e-9, distance, 0)


def _square(x, size):
    """Edges of a quadrangle in the window, in clip coordinates with two unequal w."""
    places = (
        jnp.asarray([[-0.63, -0.52], [0.71, -0.41], [0.57, 0.66], [-0.44, 0.38]])
        .at[jnp.array([1, 3])]
        .add(x.reshape(2, 2))
    )
    w = jnp.asarray([1.0, 1.3, 0.8, 1.1])
    clip = jnp.concatenate([places, 0.2 + 0.1 * places[:, :1], jnp.ones((4, 1))], axis=1) * w[:, None]
    ends = clip[jnp.array([[0, 1], [1, 2], [2, 3], [3, 0]])]
    return Segments.of(ends, jnp.ones(4, bool), size)


@row("edges in the window", [0.02, -0.03, 0.04, 0.01], step=1e-6)
def _():
    def of(x):
        inside = _square(x, SIZE)
        # Far beyond the window, where they are clipped.
        outside = _square(30 * x, SIZE)
        return inside.start, inside.end, inside.depth, _far_from(outside.start, outside.end, (2.2, 3.1))

    return of


@row("areas beside edges within pixels", [0.02, -0.03, 0.04, 0.01], step=1e-6)
def _():
    def pieces(x):
        segments = _square(x, SIZE)
        none = jnp.full((4, 2), -1, jnp.int32)
        found = Boundaries(segments, none, none[:, 0], jnp.zeros(4, bool))
        return Pieces.of(found, SIZE, 40, jnp.ones(4))

    def of(x):
        found = pieces(x)
        image = jnp.zeros(41).at[found.pixel].add(found.beyond)[:40]
        return image, jnp.where(found.pixel < 40, _from_centre(found.pixel, found.nearest, found.right, SIZE[1]), 0)

    return of


@row(
    "points within pixels",
    [0.3, 0.5, 2.6, 4.0, -7.0, 9.0, 0.4, -0.2, 0.3],
    "raster.PixelPoints raster.points_within_pixels",
)
def _():
    start, normal = numbers(7, 2, 3, 3, low=-0.5, high=0.5), numbers(8, 2, 3, 3, low=0.2)
    own = dataclasses.replace(camera(), resolution=(2, 3))

    def of(x):
        moved = own.at(CameraPose(Vector(*x[:3]), Vector(*x[3:6]), own.fov_y))
        unit = geometry.frame(jnp.asarray([0.0, 0.0, -1.0]), jnp.asarray([0.0, 1.0, 0.0]))
        surface = surface_of(start + x[6:], normal / jnp.linalg.norm(normal, axis=-1, keepdims=True) @ unit)
        within = points_within_pixels(surface, moved, 3)
        return within.surface.position, within.mean(jnp.sin(within.surface.position))

    return of


def _made(x):
    """An antialiased surface of 2 x 3 pixels, with 3 boundaries."""
    places = numbers(9, 4, 3, 3)
    surface = surface_of(places, (0.0, 0.0, 1.0))
    return AntialiasedSurface(surface, jnp.asarray([1, 4, 6]), x[:3], x[3:6], (2, 3))


@row("means over pixels with boundaries", [0.3, -0.2, 0.4, 0.2, 0.6, 0.1, 0.5, 0.8], "raster.AntialiasedSurface")
def _():
    image, several = numbers(10, 4, 3, 2), numbers(11, 8, 3)

    def of(x):
        # The last boundary is that of no pixel.
        seen = _made(jnp.concatenate([x[:2], jnp.zeros(1), x[2:4], jnp.zeros(1)]))
        own = image.at[0, 1, 0].set(x[4]).at[2, 0, 1].set(x[5])
        values = several.at[1, 1].set(x[6]).at[4, 2].set(x[7])
        return seen.resolve(own), seen.mean_within(values, 2), seen.extend(own[:2])

    return of


@row(
    "an antialiased picture of meshes that cross",
    [0.05, -0.03, 0.08, 1.4, 1.8, 2.2],
    "raster.draw_antialiased raster.plan_antialiasing raster.AntialiasPlan",
    step=1e-6,
    tolerance=1e-4,
)
def _():
    from .of_geometry import pyramid

    floor = geometry.Mesh([(-2, 0.15, -2), (-2, 0.1, 2), (2, 0.2, 2.2), (2, 0.1, -2)], FACES)
    whole = geometry.merge([floor, pyramid(0.0)])
    colours = jnp.asarray([(0.2, 0.9, 0.4), (0.5, 0.1, 0.8), *[(0.9, 0.6, 0.1)] * 4])
    whole = eqx.tree_at(lambda mesh: mesh.albedo, whole, colours)
    own = geometry.PinholeCamera((1.4, 1.8, 2.2), (0.1, 0.2, 0), (0.1, 1, 0), 41, 0.7, 6, (12, 20))
    edges, creases = _edges_of(whole)

    def moved(x):
        mesh = eqx.tree_at(lambda mesh: mesh.vertices, whole, whole.vertices.at[7].add(x[:3]))
        camera = dataclasses.replace(own, eye=x[3:])
        return mesh, camera, camera.view(), camera.view().clip_vertices(mesh.vertices)

    # What pixels see is found here: that has no derivative, and drawing takes long to compile.
    clip = moved(jnp.asarray([0.05, -0.03, 0.08, 1.4, 1.8, 2.2]))[-1]
    at_centres = jnp.asarray(faces_at(clip, whole.faces, centres(12, 20)))
    corners = np.stack(np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 13)), axis=-1)
    at_corners = jnp.asarray(faces_at(clip, whole.faces, corners))

    def of(x):
        mesh, camera, view, clip = moved(x)
        found = _boundaries(clip, mesh.faces, edges, creases, "none", at_centres, at_corners)
        seen, _ = _antialiased(mesh, camera.eye, _Seen(view, clip, at_centres, at_corners, *found), edges, 128, 32)
        # The points on both sides of lines follow the lines.
        count = seen.pixel.shape[0]
        sides = lambda values: values[12:].reshape(2, -1, *values.shape[2:])[:, :count]
        place = view.clip(sides(seen.surface.position))
        left, right = (place[..., :2] / place[..., 3:] + 1) * jnp.asarray([10.0, 6.0])
        far = _from_centre(seen.pixel, (left + right) / 2, normalize(right - left), 20)
        far = jnp.where(jnp.all(sides(seen.surface.mask), axis=0), far, 0)
        return seen.resolve(seen.surface.albedo), jnp.zeros(241).at[seen.pixel].add(far)

    return of
