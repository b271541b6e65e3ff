"""Lights: what their shadow maps hold, where they lie, and what they refuse."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.geometry import (
    DirectionalLight,
    PinholeCamera,
    PointLight,
    RectangleLight,
    Scene,
    SpotLight,
    library_mesh,
)

SCALES = [0.01, 1.0, 100.0]


def divided(clip):
    clip = np.asarray(clip, np.float64)
    return clip[..., :3] / clip[..., 3:]


@eqx.filter_jit
def clip_of(light, points):
    return light.view().clip(points)


def cloud(scale, n=200):
    """Points of a box about as large as `scale`, off the origin."""
    rng = np.random.default_rng(0)
    return jnp.asarray(scale * (rng.uniform(-1, 1, (n, 3)) * [1, 0.5, 2] + [0.3, 0.5, -0.2]), jnp.float32)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("direction", [(0.3, -1, 0.2), (0, -1, 0), (1, 0, 0), (-0.5, -0.1, 3)])
def test_directional_light_around_holds_all_points_tightly(scale, direction):
    points = cloud(scale)
    light = DirectionalLight.around(jnp.array(direction, float), points)
    reach = np.abs(divided(clip_of(light, points))).max(axis=0)
    assert (reach <= 1).all()
    assert (reach >= 0.97).all()
    low, high = (f(divided(clip_of(light, points)), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose(low, -high, atol=1e-4)


def test_directional_light_around_casters_reaches_on_to_the_receivers():
    casters, receivers = cloud(1.0), cloud(4.0)
    direction = jnp.array([0.3, -1.0, 0.2])
    light = DirectionalLight.around(direction, casters, receivers=receivers)
    np.testing.assert_array_equal(light.extent, DirectionalLight.around(direction, casters).extent)
    np.testing.assert_allclose(np.abs(divided(clip_of(light, casters))[:, :2]).max(axis=0), 1, atol=0.03)
    depth = divided(clip_of(light, receivers))[:, 2]
    np.testing.assert_allclose([depth.min(), depth.max()], [-1, 1], atol=0.03)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("position", [(3, 5, 4), (0.3, 6, -0.2), (-20, 1, 0), (1.8, 1.2, 2.2)])
def test_spot_light_around_holds_all_points_tightly(scale, position):
    points = cloud(scale)
    light = SpotLight.around(scale * jnp.array(position, float), points)
    clip = divided(clip_of(light, points))
    assert np.abs(clip).max() <= 1
    assert np.abs(clip[:, :2]).max() >= 0.97
    depth = np.asarray(light.view().eye_depth(jnp.asarray((clip[:, 2] + 1) / 2, jnp.float32)))
    span = float(light.far - light.near)
    assert depth.min() - float(light.near) <= 0.02 * span
    assert float(light.far) - depth.max() <= 0.02 * span


def test_spot_light_around_holds_points_close_to_it():
    points = jnp.array([[0.0, -10.0, 0.0], [0.0, -0.05, 0.0], [0.01, -2.0, 0.0]])
    light = SpotLight.around(jnp.zeros(3), points)
    assert np.abs(divided(clip_of(light, points))).max() <= 1


@pytest.mark.parametrize("scale", SCALES)
def test_lights_around_a_flat_scene_hold_it(scale):
    points = scale * library_mesh("plane", segments=2).vertices
    for light in (
        DirectionalLight.around(jnp.array([0.0, -1.0, 0.0]), points),
        DirectionalLight.around(jnp.array([1.0, 0.0, 0.0]), points),
        SpotLight.around(scale * jnp.array([0.0, 2.0, 0.0]), points),
    ):
        clip = divided(clip_of(light, points))
        assert np.isfinite(clip).all()
        assert np.abs(clip).max() <= 1


def test_spot_light_inside_the_scene_needs_an_angle():
    points = cloud(1.0)
    inside = jnp.array([0.3, 0.5, 0.3])
    with pytest.raises(ValueError, match=r"is inside the scene.*move the light or give the angle"):
        SpotLight.around(inside, points)
    light = SpotLight.around(inside, points, outer_angle=40.0)
    assert 0 < float(light.near) < float(light.far)
    assert float(light.outer_angle) == 40


@pytest.mark.parametrize("behind", [0.0, -1e4])
def test_spot_light_of_a_given_angle_holds_what_lies_ahead_of_it(behind):
    points = jnp.array([[0.0, -0.5, 0.0], [0.0, -2.0, 0.0], [0.0, -behind, 0.0]])
    light = SpotLight.around(jnp.zeros(3), points, target=jnp.array([0.0, -1.0, 0.0]), outer_angle=30.0)
    assert np.abs(divided(clip_of(light, points[:2]))).max() <= 1
    assert float(light.far) < 2.1


def test_spot_light_that_looks_away_from_the_scene_has_a_frustum():
    points = cloud(1.0)
    light = SpotLight.around(jnp.array([0.0, 9.0, 0.0]), points, target=jnp.array([0.0, 20.0, 0.0]), outer_angle=30.0)
    assert 0 < float(light.near) < float(light.far)
    assert np.isfinite(light.view().matrix).all()


@pytest.mark.parametrize("aspect", [0.5, 2.0])
def test_an_oblong_spot_light_holds_all_points_tightly(aspect):
    points = cloud(1.0)
    light = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, aspect=aspect)
    reach = np.abs(divided(clip_of(light, points))[:, :2]).max(axis=0)
    assert reach.max() == pytest.approx(1 / 1.02, rel=1e-3)
    projection = np.asarray(light.view().eye_to_clip)
    assert projection[1, 1] == pytest.approx(aspect * projection[0, 0], rel=1e-5)


def test_a_directional_lights_map_stands_as_its_up_says():
    light = DirectionalLight((0, -1, 0), (0, 0, 0), (4, 2), -1, 1, up=(0, 0, -1))
    np.testing.assert_allclose(light.view().clip(jnp.array([[2.0, 0, 0], [0, 0, -1]]))[:, :2], np.eye(2), atol=1e-6)


def test_spot_light_around_looks_at_its_target():
    points = cloud(1.0)
    light = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, target=jnp.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(light.direction, [-2, -5, -4])
    assert np.abs(divided(clip_of(light, points))).max() <= 1


def test_lights_lie_where_towards_says():
    points = cloud(1.0, n=5)
    sun = DirectionalLight.around(jnp.array([0.0, -2.0, 0.0]), points)
    np.testing.assert_allclose(sun.towards(points), np.broadcast_to([0, 1, 0], (5, 3)), atol=1e-6)
    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points)
    np.testing.assert_allclose(points + lamp.towards(points), np.broadcast_to([3, 5, 4], (5, 3)), rtol=1e-6)
    assert sun.is_directional
    assert not lamp.is_directional
    assert not sun.has_size
    assert not lamp.has_size


def test_points_of_a_lights_disk_lie_on_it():
    points, rim = cloud(1.0, n=8), np.linspace(0, 2 * np.pi, 8, endpoint=False)
    disk = jnp.asarray(np.stack([np.cos(rim), np.sin(rim)], axis=-1), jnp.float32)
    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, radius=0.25)
    offset = np.asarray(lamp.towards(points, disk) - lamp.towards(points))
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), 0.25, rtol=1e-4)
    np.testing.assert_allclose(offset @ np.asarray(lamp.direction), 0, atol=1e-5)
    np.testing.assert_allclose(offset.sum(axis=0), 0, atol=1e-5)
    sun = DirectionalLight.around(jnp.array([1.0, -2.0, 0.5]), points, angular_radius=20.0)
    ways, axis = np.asarray(sun.towards(points, disk)), -np.asarray(sun.direction)
    cosine = ways @ axis / np.linalg.norm(ways, axis=-1) / np.linalg.norm(axis)
    np.testing.assert_allclose(np.rad2deg(np.arccos(cosine)), 20.0, rtol=1e-4)
    assert sun.has_size
    assert lamp.has_size


def test_points_of_a_rectangle_light_fill_its_rectangle():
    points = cloud(1.0, n=4)
    corners = jnp.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    light = RectangleLight.around(jnp.array([3.0, 5.0, 4.0]), points, (0.6, 0.2), up=jnp.array([0.0, 0.0, 1.0]))
    offset = np.asarray(light.towards(points, corners) - light.towards(points))
    np.testing.assert_allclose(offset @ np.asarray(light.direction), 0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(offset[1] - offset[0]), 0.6, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(offset[2] - offset[1]), 0.2, rtol=1e-5)
    np.testing.assert_allclose(np.dot(offset[1] - offset[0], offset[2] - offset[1]), 0, atol=1e-6)
    # Its width lies level with respect to `up`, and its height rises along it.
    assert abs(offset[1, 2] - offset[0, 2]) < 1e-5
    assert offset[2, 2] - offset[1, 2] > 0.05
    assert light.domain == "square"
    assert light.has_size
    assert not RectangleLight.around(jnp.array([3.0, 5.0, 4.0]), points, (0.0, 0.0)).has_size


def test_rectangle_light_has_the_shadow_map_of_a_spot_light_at_its_centre():
    points, place = cloud(1.0), jnp.array([3.0, 5.0, 4.0])
    spot, panel = SpotLight.around(place, points), RectangleLight.around(place, points, (1.0, 0.5))
    np.testing.assert_array_equal(panel.view().matrix, spot.view().matrix)
    up = jnp.array([1.0, 0.0, 0.0])
    on_its_side = RectangleLight.around(place, points, (1.0, 0.5), up=up)
    assert np.abs(divided(clip_of(on_its_side, points))).max() <= 1
    turned = SpotLight.around(place, points, up=up)
    np.testing.assert_array_equal(on_its_side.view().matrix, turned.view().matrix)
    assert np.abs(np.asarray(turned.view().matrix - spot.view().matrix)).max() > 0.1
    # The topmost point of a disk that shines is the one that lies upwards in the map.
    lamp = SpotLight.around(place, points, radius=0.1, up=up)
    offset = lamp.towards(points[:1], jnp.array([[0.0, 1.0]])) - lamp.towards(points[:1])
    np.testing.assert_allclose(offset[0], 0.1 * lamp.view().world_to_eye[1, :3], atol=1e-5)


def test_samples_of_a_sphere_lie_on_the_cone_that_touches_it():
    light, points = PointLight((0.3, 0.5, -0.2), 0.1, 10, radius=0.4), 2 + cloud(1.0, n=50)
    rim = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    outline = jnp.asarray(np.stack([np.cos(rim), np.sin(rim)], axis=-1), jnp.float32)
    towards = eqx.filter_jit(lambda light, sample: light.towards(points, sample))
    centre, ways = np.asarray(light.towards(points)), np.asarray(towards(light, outline))
    distance = np.linalg.norm(centre, axis=-1)
    # Each vector to the outline ends on the sphere, where it is at right angles to the radius.
    np.testing.assert_allclose(np.linalg.norm(ways - centre, axis=-1), 0.4, rtol=1e-4)
    np.testing.assert_allclose(np.sum(ways * (ways - centre), axis=-1), 0, atol=1e-5)
    cosine = np.sum(ways * centre, axis=-1) / np.linalg.norm(ways, axis=-1) / distance
    np.testing.assert_allclose(np.arccos(cosine), np.arcsin(0.4 / distance), rtol=1e-3)
    # The samples of the whole disk lie in the plane of its rim, and opposite ones on opposite sides of its centre.
    opposite = np.asarray(towards(light, jnp.asarray(-np.asarray(outline))))
    middle = (1 - (0.4 / distance) ** 2)[:, None] * centre
    np.testing.assert_allclose((ways + opposite) / 2, middle, atol=1e-5)
    np.testing.assert_allclose(towards(light, jnp.zeros_like(outline)), middle, atol=1e-5)


def test_vectors_to_a_sphere_are_finite_within_it_and_on_it_and_so_are_their_derivatives():
    light = PointLight((0, 0, 0), 0.1, 10, radius=1.0)
    points = jnp.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0], [0, 0, -1], [0, 1, 0], [0, 0, -3]])
    sample = jnp.full((6, 2), 0.5)
    towards = eqx.filter_jit(lambda both: both[0].towards(both[1], sample))
    total = eqx.filter_jit(eqx.filter_grad(lambda both: jnp.sum(towards(both) ** 2)))
    for gradient in jax.tree.leaves(total((light, points))):
        assert np.isfinite(np.asarray(gradient)).all()
    # From within, the disk is the section through the centre.
    within = (np.asarray(towards((light, points))) + np.asarray(points))[:2]
    np.testing.assert_allclose(np.linalg.norm(within, axis=-1), math.sqrt(0.5), rtol=1e-5)
    np.testing.assert_allclose(within[1, 0], 0, atol=1e-6)


def test_cone_is_full_inside_and_obeyed_only_where_an_inner_angle_is_given():
    fraction = eqx.filter_jit(lambda light, points: light.cone_fraction(points))
    down = lambda inner: SpotLight((0, 2, 0), (0, -1, 0), 30, 0.1, 10, inner_angle=inner)
    way = lambda degrees: [math.sin(math.radians(degrees)), math.cos(math.radians(degrees)), 0.0]
    ways = [way(degrees) for degrees in (0, 9.9, 20, 30.1, 80)]
    # Points that see the light along these ways.
    at = lambda ways: np.float32([0.0, 2.0, 0.0]) - 1.5 * np.float32(ways)
    np.testing.assert_array_equal(fraction(down(None), at(ways)), 1)
    np.testing.assert_array_equal(fraction(PointLight((0, 2, 0), 0.1, 10), at(ways)), 1)
    share = np.asarray(fraction(down(10), at(ways)))
    np.testing.assert_allclose(share[[0, 1, 3, 4]], [1, 1, 0, 0], atol=1e-6)
    assert 0 < share[2] < 1
    outer, inner = (math.cos(math.radians(degrees)) for degrees in (30, 10))
    quarter = math.degrees(math.acos(outer + (inner - outer) / 4))
    np.testing.assert_allclose(fraction(down(10), at([way(quarter)])), 3 / 16 - 2 / 64, rtol=1e-3)
    # With both angles alike the rim is hard.
    np.testing.assert_array_equal(fraction(down(30), at([way(29.9), way(30.1)])), [1, 0])


def test_scene_holds_one_light_or_several():
    mesh, camera = library_mesh("box"), PinholeCamera((0, 1, 5), (0, 0, 0))
    sun, lamp = DirectionalLight((0, -1, 0), (0, 0, 0), (4, 4), -4, 4), PointLight((0, 3, 0), 0.1, 10)
    one, two = Scene(mesh, camera, sun), Scene(mesh, camera, [sun, lamp])
    assert one.lights == (sun,)
    assert one.light is sun
    assert two.lights == (sun, lamp)
    assert [two.lit_by(k).light for k in range(2)] == [sun, lamp]
    with pytest.raises(ValueError, match=r"has 2 lights; expected one.*lit_by\(index\)"):
        _ = two.light
    for index in (-1, 2):
        with pytest.raises(ValueError, match=f"no light {index}; expected an index from 0 to 1"):
            two.lit_by(index)
    with pytest.raises(ValueError, match="no light; expected a light"):
        Scene(mesh, camera, [])
    brighter = eqx.tree_at(lambda scene: scene.light.angular_radius, one, jnp.asarray(2.0))
    assert float(brighter.light.angular_radius) == 2


def test_bad_lights_are_refused():
    points = cloud(1.0)
    sun = DirectionalLight.around(jnp.array([0.0, -1.0, 0.0]), points)
    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points)
    sun_options = {name: getattr(sun, name) for name in ("direction", "center", "extent", "near", "far")}
    lamp_options = {name: getattr(lamp, name) for name in ("position", "direction", "outer_angle", "near", "far")}
    panel_options = lamp_options | {"size": (1.0, 0.5)}
    for kind, options, bad, message in [
        (
            DirectionalLight,
            sun_options,
            {"direction": (0, 0, 0)},
            r"direction is \[0\.0, 0\.0, 0\.0\]; expected a vector at least",
        ),
        (DirectionalLight, sun_options, {"direction": (math.nan, 0, 0)}, r"direction\[0\] is nan; expected a number"),
        (DirectionalLight, sun_options, {"near": 5.0, "far": 5.0}, "near = 5.0 and far = 5.0"),
        (DirectionalLight, sun_options, {"extent": (1.0, 0.0)}, "expected positive world units"),
        (DirectionalLight, sun_options, {"angular_radius": 90.0}, "at least 0 and at most 89.99, in degrees"),
        (SpotLight, lamp_options, {"direction": (0, 0, 0)}, "spot light's direction"),
        (SpotLight, lamp_options, {"near": 0.0}, "expected 0 < near < far"),
        (SpotLight, lamp_options, {"near": 9.0, "far": 1.0}, "near = 9.0 and far = 1.0"),
        (SpotLight, lamp_options, {"outer_angle": 90.0}, "outer_angle is 90.0; expected a number"),
        (SpotLight, lamp_options, {"radius": -1.0}, "SpotLight.radius is -1.0; expected a number at least 0"),
        (SpotLight, lamp_options, {"position": (0, math.inf, 0)}, "spot light's position"),
        (SpotLight, lamp_options, {"inner_angle": 89.0}, r"inner_angle is 89\.0 and outer_angle is"),
        (SpotLight, lamp_options, {"inner_angle": -1.0}, r"inner_angle is -1\.0"),
        (SpotLight, lamp_options, {"up": (0, 0, 0)}, r"spot light's up is \[0\.0, 0\.0, 0\.0\]; expected a vector"),
        (RectangleLight, panel_options, {"size": (1.0, -1.0)}, r"size\[1\] is -1\.0; expected a number at least 0"),
        (RectangleLight, panel_options, {"up": (0, 0, 0)}, r"up is \[0\.0, 0\.0, 0\.0\]; expected a vector"),
        (RectangleLight, panel_options, {"outer_angle": 0.0}, "rectangle light's outer_angle"),
        (RectangleLight, panel_options, {"far": 0.0}, "rectangle light has near"),
    ]:
        with pytest.raises(ValueError, match=message):
            kind(**(options | bad))
    with pytest.raises(ValueError, match="direction is"):
        DirectionalLight.around(jnp.zeros(3), points)
    with pytest.raises(ValueError, match="eye and target are both"):
        SpotLight.around(jnp.ones(3), points, target=jnp.ones(3))
    with pytest.raises(ValueError, match=r"rectangle light at .* is inside the scene"):
        RectangleLight.around(jnp.array([0.3, 0.5, 0.3]), points, (1.0, 1.0))


def test_lights_and_cameras_can_be_traced():
    def depth_of_origin(height):
        camera = PinholeCamera(jnp.array([0.0, height, 3.0]), jnp.zeros(3))
        light = eqx.tree_at(lambda x: x.position, lamp, jnp.array([3.0, height, 4.0]))
        return camera.view().clip(jnp.zeros(3))[3] + light.view().clip(jnp.zeros(3))[3]

    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), cloud(1.0))
    gradient = jax.jit(jax.grad(depth_of_origin))(5.0)
    # The camera turns to the origin, at distance √(h² + 3²); the light only moves along its direction's slope.
    slope = -float(lamp.direction[1] / jnp.linalg.norm(lamp.direction))
    assert float(gradient) == pytest.approx(5 / math.hypot(5, 3) + slope, rel=1e-4)


REFITTED = {
    "directional": lambda points: DirectionalLight.around(jnp.array([0.3, -1.0, 0.2]), points, 1.0),
    "spot": lambda points: SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, radius=0.1),
    "cone": lambda points: SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, outer_angle=30.0, inner_angle=20.0),
    "turned": lambda points: SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, up=jnp.array([1.0, 2.0, 0.0])),
    "turned sun": lambda points: DirectionalLight.around(
        jnp.array([0.3, -1.0, 0.2]), points, up=jnp.array([1.0, 2.0, 0.0])
    ),
    "oblong": lambda points: SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, aspect=1.5),
    "point": lambda points: PointLight.around(jnp.array([3.0, 5.0, 4.0]), points, radius=0.1, guard=0.2),
    "rectangle": lambda points: RectangleLight.around(
        jnp.array([3.0, 5.0, 4.0]), points, (0.4, 0.2), up=jnp.array([1.0, 2.0, 0.0])
    ),
}


@pytest.mark.parametrize("under", [lambda f: f, pytest.param(eqx.filter_jit, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("kind", REFITTED)
def test_refitted_light_is_as_if_made_for_its_points(kind, under):
    points = cloud(1.0)
    far_off = REFITTED[kind](10 * points + 100)
    light = REFITTED[kind](points)
    # From another frustum: the same pose has the same frustum again.
    pose = [
        name for name in ("position", "direction", "outer_angle", "inner_angle", "size", "up") if hasattr(light, name)
    ]
    other = eqx.tree_at(
        lambda one: [getattr(one, n) for n in pose if getattr(one, n) is not None],
        far_off,
        [getattr(light, n) for n in pose if getattr(light, n) is not None],
    )
    found = under(lambda light, points: light.refitted(points))(other, points)
    for name, value in vars(light).items():
        if value is not None:
            np.testing.assert_allclose(getattr(found, name), value, rtol=1e-4, atol=1e-5, err_msg=name)


def test_light_that_moves_into_the_scene_still_has_a_frustum():
    points = cloud(1.0)
    for kind in ("spot", "cone", "point", "rectangle"):
        inside = eqx.tree_at(lambda one: one.position, REFITTED[kind](points), points.mean(axis=0))
        found = inside.refitted(points)
        assert 0 < float(found.near) < float(found.far), kind
        assert np.isfinite(found.view().matrix).all()
