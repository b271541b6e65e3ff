"""Point lights: six faces that meet without seams, and shadows that agree with rays."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import marked, quad, shadows, surface_at, technique
from scipy import ndimage

from diffshadow.geometry import Mesh, PinholeCamera, PointLight, Scene, SpotLight, library_mesh, merge
from diffshadow.raster import Surface, draw_surface
from diffshadow.reference import trace_visibility
from diffshadow.shadow import (
    Bilinear,
    Nearest,
    PercentageCloser,
    RandomDisk,
    ShadowMap,
    draw_shadow_map,
    stratified,
)

AXES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
PLACE = (0.3, -0.2, 0.1)
# Room for any of these scenes, so that those of one size share one compiled rasterizer.


def directions(n=500):
    """Random ones, and those to the middles of the cube's edges and to its corners."""
    whole = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
    return np.concatenate([np.random.default_rng(0).normal(size=(n, 3)), whole[np.any(whole != 0, axis=1)]])


def facing(points, light) -> Surface:
    """Surfaces at `points` (h, w, 3) that face the light."""
    normal = np.asarray(light.position) - points
    return surface_at(points, normal / np.linalg.norm(normal, axis=-1, keepdims=True))


# As many receivers for all look-ups, so that a kernel is compiled once.
RECEIVERS = (64, 64)


def lit(mapping, shadow_map, points) -> np.ndarray:
    """The visibility at points (..., 3) that face the light."""
    many, number = np.reshape(points, (-1, 3)), math.prod(np.shape(points)[:-1])
    surface = facing(many[np.resize(np.arange(number), RECEIVERS)], shadow_map.light)
    return np.asarray(shadows(mapping, shadow_map, surface)).ravel()[:number].reshape(np.shape(points)[:-1])


def percentage_closer(radius):
    return PercentageCloser(radius, 11.0)


_layer = eqx.filter_jit(lambda light, points: light.layer(points))


def layers(light, points):
    return np.asarray(_layer(light, jnp.asarray(points, jnp.float32)))


def cube(half=1.0, center=(0.0, 0.0, 0.0)) -> Mesh:
    box = library_mesh("box")
    return Mesh((np.asarray(box.vertices) - np.array([0, 0.5, 0])) * 2 * half + np.asarray(center), box.faces)


def draw(mesh, light, texels=128) -> ShadowMap:
    """The map of a mesh of four cubes at most, filled up to as many with faces that have no area."""
    vertices, faces = 32 - len(mesh.vertices), 48 - len(mesh.faces)
    pad = lambda values, n: np.pad(np.asarray(values), [(0, n), (0, 0)])
    full = Mesh(pad(mesh.vertices, vertices), pad(mesh.faces, faces), np.zeros((48, 3, 3)))
    return draw_shadow_map(full, light, (texels, texels))


# --- Faces ---


def test_every_point_falls_in_the_face_that_looks_along_its_largest_coordinate():
    light = PointLight(PLACE, 0.1, 10, guard=0.25)
    offset = directions()
    layer = layers(light, PLACE + offset)
    assert set(np.asarray(layer).tolist()) == set(range(6))
    along = np.sum(AXES[np.asarray(layer)] * offset, axis=-1)
    np.testing.assert_allclose(along, np.abs(offset).max(axis=-1), rtol=1e-5)
    clip = np.asarray(light.view().facing(jnp.asarray(layer)).clip(jnp.asarray(PLACE + offset, jnp.float32)))
    np.testing.assert_allclose(clip[:, 3], along, rtol=1e-5, atol=1e-6)
    # The 90 degrees are the inner 1 / (1 + guard) of the face.
    reach = np.abs(clip[:, :2] / clip[:, 3:]).max(axis=-1)
    assert reach.max() == pytest.approx(1 / 1.25, rel=1e-5)


@pytest.mark.exhaustive
def test_faces_hold_what_spot_lights_that_look_the_same_way_hold():
    mesh = merge([cube(2.0), cube(0.3, (1.2, 0.4, 0.2)), cube(0.4, (-0.5, -1.3, -0.8)), cube(0.2, (0.2, 1.0, 0.5))])
    light = PointLight(PLACE, 0.05, 5.0)
    shadow_map = draw(mesh, light)
    assert shadow_map.depth.shape == (6, 128, 128)
    receivers = PLACE + 4 * directions(520)
    layer = layers(light, receivers)
    mapping = technique(Bilinear(), constant=1.0)
    visibility = lit(mapping, shadow_map, receivers)
    assert 0.05 < visibility.mean() < 0.95
    spots = [SpotLight(PLACE, axis, math.degrees(math.atan(1.1)), 0.05, 5.0) for axis in AXES]
    for k, spot in enumerate(spots):
        seen = draw(mesh, spot)
        np.testing.assert_allclose(shadow_map.depth[k], seen.depth, atol=2e-6)
        np.testing.assert_allclose(visibility[layer == k], lit(mapping, seen, receivers)[layer == k], atol=1e-3)


# --- Seams ---


@pytest.mark.parametrize(("resolution", "guard"), [((64, 64), 0.1), ((40, 64), 0.3)])
def test_guard_is_as_many_texels_wide_as_it_says(resolution, guard):
    light = PointLight((0, 0, 0), 0.1, 10, guard=guard)
    corner = light.view().facing(jnp.asarray(0)).clip(jnp.array([1.0, 1.0, 1.0]))
    height, width = resolution
    beyond = [(1 - abs(float(corner[k] / corner[3]))) / 2 * size for k, size in ((0, width), (1, height))]
    assert light.guard_texels(resolution) == pytest.approx(min(beyond), rel=1e-4)


KERNELS = {
    "nearest": lambda texels: Nearest(),
    "bilinear": lambda texels: Bilinear(),
    "percentage closer": percentage_closer,
    "random disk": lambda texels: RandomDisk(texels - 0.5, stratified(4, 8), "bilinear", False),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("kernel", marked(KERNELS, ("percentage closer", "random disk")))
def test_no_light_leaks_between_faces_while_taps_stay_within_the_guard(kernel):
    # The light is boxed in, so that every tap on a face is dark and every tap beyond its border is lit.
    box, light = cube(0.5), PointLight((0.1, -0.05, 0.2), 0.05, 8, guard=0.2)
    texels = light.guard_texels((128, 128))
    assert texels == pytest.approx(64 / 6)
    w = np.linspace(-1, 1, 41)
    along_edges = np.stack([np.stack([s + 0 * w, np.full_like(w, t), w], -1) for s in (-1, 1) for t in (-1, 1)])
    receivers = np.concatenate([np.roll(along_edges, k, axis=-1) for k in range(3)]) * 3 + np.asarray(light.position)
    mapping = technique(KERNELS[kernel](texels))
    greatest = lambda light: lit(mapping, draw(box, light), receivers).max()
    assert greatest(light) < 1e-6
    if kernel in ("percentage closer", "random disk"):
        bare = eqx.tree_at(lambda light: light.guard, light, jnp.asarray(0.0))
        assert greatest(bare) > 0.3


# --- Against rays ---


@pytest.fixture(scope="module")
def room() -> Scene:
    """A closed room with three things in it, one of which a border between faces crosses."""
    things = [
        cube(0.3, (0.9, 0.9, 0.1)),
        cube(0.25, (-0.7, -0.9, -0.5)),
        cube(0.2, (0.9, -0.6, -0.9)),
    ]
    mesh = merge([cube(2.0), *things])
    camera = PinholeCamera((1.7, -0.1, 1.8), (-0.5, -0.2, -0.6), fov_y=100, near=0.05, far=12, resolution=(128, 128))
    return Scene(mesh, camera, PointLight.around(jnp.array(PLACE), mesh.vertices))


@pytest.fixture(scope="module")
def room_images(room):
    surface = draw_surface(room.mesh, room.camera)
    assert np.asarray(surface.mask).all()
    # Every other pixel is enough.
    surface = jax.tree.map(lambda values: jnp.asarray(np.asarray(values)[::2, ::2]), surface)
    return surface, draw(room.mesh, room.light), trace_visibility(room).visibility[::2, ::2]


def near_outline(truth, pixels):
    """Pixels within so many of a change of `truth`."""
    window = 2 * pixels + 1
    return ndimage.maximum_filter(truth, window) != ndimage.minimum_filter(truth, window)


@pytest.mark.exhaustive
def test_hard_shadows_in_a_closed_room_agree_with_rays(room, room_images):
    surface, shadow_map, truth = room_images
    assert 0.7 < truth.mean() < 0.95
    assert len(np.unique(layers(room.light, surface.position))) == 6
    visibility = np.asarray(shadows(technique(Nearest(), constant=1.0, slope=1.0), shadow_map, surface))
    wrong = visibility != truth
    assert wrong.mean() < 0.01
    assert not wrong[~near_outline(truth, 2)].any()


# --- Fit of near and far ---


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("position", [(0, 0, 0), (5, 1, -2), (0.9, 0.2, 0.3), (3, 3, 3)])
def test_point_light_around_holds_all_points(scale, position):
    box = np.random.default_rng(1).uniform(-1, 1, (200, 3))
    light = PointLight.around(scale * jnp.array(position, float), jnp.asarray(scale * box, jnp.float32))
    reach = np.abs(box - np.array(position)).max(axis=-1) * scale
    assert 0 < float(light.near) <= reach.min()
    assert reach.max() <= float(light.far) <= 1.03 * reach.max()
    outside = max(np.abs(position)) > 1
    assert float(light.near) >= (0.9 * reach.min() if outside else 0.0099 * reach.max())


def test_walls_nearer_than_their_corners_stay_within_near_and_far():
    floor = quad((0, -1, 0), (30, 0, 0), (0, 0, -30))
    light = PointLight.around(jnp.zeros(3), floor.vertices)
    seen = draw(floor, light).depth
    assert (np.asarray(seen[3]) < 1).all()
    nearest = light.view().eye_depth(seen[3, 63, 63])
    assert float(nearest) == pytest.approx(1, rel=1e-4)


# --- Derivatives ---


def test_projection_follows_the_light_and_its_guard():
    with jax.enable_x64(True):
        light, points = PointLight(PLACE, 0.1, 5.0), jnp.asarray(PLACE) + jnp.asarray(directions(20)) * 1.3

        def window(x, guard):
            moved = eqx.tree_at(lambda light: light.position, light, light.position.at[0].set(x))
            moved = eqx.tree_at(lambda light: light.guard, moved, guard)
            clip = moved.view().facing(light.layer(points)).clip(points)
            return clip[..., :3] / clip[..., 3:]

        both = jax.jit(lambda x, dx, guard, dguard: jax.jvp(window, (x, guard), (dx, dguard)))
        x, guard, step = PLACE[0], 0.1, 1e-6
        for dx, dguard in ((1.0, 0.0), (0.0, 1.0)):
            ahead, behind = (both(x + sign * step * dx, dx, guard + sign * step * dguard, dguard) for sign in (1, -1))
            slope = both(x, dx, guard, dguard)[1]
            assert float(jnp.abs(slope).max()) > 0.1
            np.testing.assert_allclose(slope, (ahead[0] - behind[0]) / (2 * step), rtol=1e-6, atol=1e-8)


# --- Refusals ---


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"position": (math.nan, 0, 0)}, r"position\[0\] is nan; expected a number"),
        ({"near": 0.0}, "expected 0 < near < far"),
        ({"near": 3.0, "far": 2.0}, "near = 3.0 and far = 2.0"),
    ],
)
def test_bad_point_lights_are_refused(bad, said):
    with pytest.raises(ValueError, match=said):
        PointLight(**({"position": (0, 0, 0), "near": 0.1, "far": 1.0} | bad))
