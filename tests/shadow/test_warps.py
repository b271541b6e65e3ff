"""Warped maps: what the warp is, where it puts texels, that depths and biases stay linear, and what is refused."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    drawn,
    floor_and_card,
    lamp,
    quad,
    side_camera,
    sun,
    surface_at,
)

from diffshadow._arithmetic import in_float64
from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    MatrixCamera,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    Warp,
    merge,
)
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    Bias,
    Lookup,
    Nearest,
    PercentageCloserSoft,
    PerspectiveWarp,
    ShadowMap,
    ShadowMapping,
    SoftCompare,
    aliasing,
    draw_shadow_map,
    receiver,
)
from diffshadow.shadow.layouts._frustum import depths_of
from diffshadow.shadow.layouts._warped import _strength

SIZE = (64, 64)
FAR = 100.0
CORRIDOR = PinholeCamera((0, 1, 0), (0, 1, -1), fov_y=60.0, near=1.0, far=FAR, resolution=(32, 32))
"""Looks along -z, from depth 1 to 100."""
NOON = DirectionalLight((0, -1, 0), (0, 0, -50), (400, 400), -200, 200)
"""Straight down on all that the camera sees."""
METHODS = ("lispsm", "perspective", "trapezoidal")
TIGHT = {method: PerspectiveWarp(method, depths="camera", margin=0.0) for method in METHODS}
"""Without a margin. A layout's numbers are data, and its method and margin are not."""


def at_angle(degrees, sideways=0.0):
    """A light at this angle to the corridor, and `sideways` to its vertical plane."""
    angle, turn = np.radians([degrees, sideways])
    across = np.array([np.sin(turn), -np.cos(turn), 0])
    direction = np.cos(angle) * np.array([0, 0, -1.0]) + np.sin(angle) * across
    return DirectionalLight(direction, (0, 0, -50), (400, 400), -200, 200)


def warped(layout, light=NOON, camera=CORRIDOR, size=SIZE):
    return layout.light(light, camera, size)


@eqx.filter_jit
def seen(shadow_map, surface):
    return receiver(shadow_map, surface)


def test_the_warp_is_a_perspective_that_starts_as_nothing():
    tau = np.linspace(0, 1, 11)
    clip = jnp.asarray(np.stack([0.5 + 0 * tau, 2 * tau - 1, 0 * tau, 1 + 0 * tau], axis=-1), jnp.float32)
    warp = lambda w: Warp(jnp.float32(w), jnp.float32(0.2))(clip)
    np.testing.assert_array_equal(warp(0.0), clip)
    for w in (0.01, 3.0):
        x, y, _, divisor = np.asarray(warp(w)).T
        height = (y / divisor + 1) / 2
        np.testing.assert_allclose(height, (1 + w) * tau / (1 + w * tau), atol=1e-6)
        np.testing.assert_allclose(x / divisor - 0.2, (0.5 - 0.2) / (1 + w * tau), atol=1e-6)
        found = Warp(jnp.float32(w), jnp.float32(0.2)).divisor(jnp.asarray(height))
        np.testing.assert_allclose(found, divisor, rtol=1e-5)
        assert (height - tau).max() <= w / 4
    _, slope = jax.jvp(lambda w: warp(w)[:, 1] / warp(w)[:, 3] / 2, (jnp.float32(0),), (jnp.float32(1),))
    np.testing.assert_allclose(slope, tau * (1 - tau), atol=1e-6)


@pytest.mark.exhaustive
def test_without_strength_the_map_is_the_box_around_what_the_camera_sees():
    layout = PerspectiveWarp(strength=0.0)
    y = np.tan(np.radians(30)) * np.array([-1, -1, 1, 1])
    corners = [np.stack([y[[0, 2, 1, 3]], y, -np.ones(4)], axis=-1) * z + [0, 1, 0] for z in (1, FAR)]
    view = warped(layout, at_angle(70, 20)).view()
    clip = np.asarray(view.clip(jnp.asarray(np.concatenate(corners), jnp.float32)))[:, :2]
    # With a margin of 8 texels.
    np.testing.assert_allclose([clip.min(axis=0), clip.max(axis=0)], [[-0.75] * 2, [0.75] * 2], atol=1e-5)
    # The camera's axis points up.
    ahead = np.asarray(view.clip(jnp.array([[0.0, 1.0, -10.0], [0.0, 1.0, -20.0]])))
    assert ahead[1, 0] == pytest.approx(ahead[0, 0], abs=1e-5)
    assert ahead[1, 1] > ahead[0, 1] + 0.1
    # And its map is that of the box, bit for bit.
    surface, _ = drawn("directional", 64, 64)
    surface = dataclasses.replace(surface, from_behind=None)
    mesh = floor_and_card()
    light = warped(layout, sun(mesh), side_camera((32, 32)))
    plain = eqx.tree_at(lambda one: one.warp, light, None)
    assert plain.view().warp is None
    maps = [draw_shadow_map(mesh, each, SIZE) for each in (light, plain)]
    np.testing.assert_array_equal(maps[0].depth, maps[1].depth)
    assert (np.asarray(maps[0].depth) < 1).mean() > 0.2
    receivers = [seen(each, surface) for each in maps]
    for one, other in zip(*map(jax.tree.leaves, receivers), strict=True):
        np.testing.assert_array_equal(one, other)


@functools.cache
def far_floor():
    """A camera whose near is 1, and the floor that it sees from depth 20 on."""
    floor = quad((0, 0, -60), (60, 0, 0), (0, 0, -40))
    camera = PinholeCamera((0, 8, 0), (0, 8, -1), fov_y=60.0, near=1.0, far=FAR, resolution=(32, 32))
    return camera, draw_surface(floor, camera)


@pytest.mark.exhaustive
def test_a_warp_may_follow_the_depths_that_are_seen():
    camera, surface = far_floor()
    depth = -np.asarray(surface.position)[np.asarray(surface.mask), 2]
    assert 20 < depth.min() < 25
    layout = lambda depths: PerspectiveWarp(depths=depths, margin=0.0)
    strength = lambda depths: layout(depths).light(NOON, camera, SIZE, surface).warp.strength
    np.testing.assert_allclose(strength("surface"), np.sqrt(depth.max() / depth.min()) - 1, rtol=1e-3)
    np.testing.assert_allclose(strength("camera"), np.sqrt(FAR) - 1, rtol=1e-3)
    with pytest.raises(ValueError, match="expected a surface"):
        layout("surface").light(NOON, camera, SIZE)


@pytest.mark.exhaustive
def test_a_parallel_camera_needs_no_warp():
    camera = OrthographicCamera((0, 1, 0), (0, 1, -1), height=4.0, near=-1.0, far=FAR, resolution=(32, 32))
    assert float(warped(TIGHT["lispsm"], NOON, camera).warp.strength) == 0
    assert float(warped(PerspectiveWarp(strength=2.0, margin=0.0), NOON, camera).warp.strength) == 2


@eqx.filter_jit
def jacobians(light, surface):
    return aliasing(ShadowMap(jnp.zeros(SIZE), light), surface, CORRIDOR).jacobian


def errors_along(layout):
    """Perspective aliasing along the corridor's axis at depths from 1 to 100, for a map as high as one focal length."""
    depth = np.geomspace(1, FAR, 33)
    points = np.stack([0 * depth, 1 + 0 * depth, -depth], axis=-1)[None]
    # A surface that leans as much towards the camera as towards the light.
    surface = surface_at(points, np.array([0, 1, 1]) / np.sqrt(2))
    focal_length = 16 / np.tan(np.radians(30))
    found = np.asarray(jacobians(warped(layout), surface))[0]
    # The map's y axis follows the view; a step along it changes nothing across.
    np.testing.assert_allclose(found[:, 0, 1], 0, atol=1e-3)
    return np.abs(found[:, 1, 1]) * SIZE[0] / focal_length


@pytest.mark.parametrize(
    ("method", "nearest", "expected"),
    [
        ("lispsm", 0.1, 1),
        ("perspective", 0.1, 3),
        ("trapezoidal", 0.1, 5 / 3),
        ("lispsm", 0.4, 0.5),
        ("lispsm", 0.6, 0),
    ],
)
def test_strength_of_each_method_is_its_formula(method, nearest, expected):
    """Of depths from 2 to 8 that rise by 6 along the map; the strength is at most 1 / τ - 2 at the nearest."""
    layout, depth = PerspectiveWarp(method, focus=0.6), jnp.asarray([4.0, 2.0, 8.0])
    of = lambda camera: _strength(layout, camera.view(), depth, jnp.asarray([0.05, nearest, 0.9]), jnp.asarray(6.0))
    assert float(of(CORRIDOR)) == pytest.approx(expected, rel=1e-5)
    assert float(of(OrthographicCamera((0, 1, 0), (0, 1, -1), height=2.0, near=1.0, far=FAR))) == 0
    # Points before the near plane count from there: 6 / 4.
    late = dataclasses.replace(CORRIDOR, near=jnp.asarray(4.0))
    if method == "perspective":
        assert float(of(late)) == pytest.approx(1.5)


def test_maps_are_fitted_to_the_depths_that_are_seen_up_to_the_shadow_distance():
    position, mask = (
        jnp.asarray([[[5.0, 3.0, -7.0], [2.0, 0.0, -20.0], [0.0, 0.0, -60.0]]]),
        jnp.array([[1, 1, 0]], bool),
    )
    seen = dataclasses.replace(surface_at(position, jnp.asarray([0.0, 1.0, 0.0])), mask=mask)
    at = lambda surface, most: [*map(float, depths_of(CORRIDOR.view(), surface, most))]
    assert at(None, None) == [1, FAR]
    assert at(None, jnp.asarray(30.0)) == [1, 30]
    assert at(seen, None) == [7, 20]
    assert at(seen, jnp.asarray(9.0)) == [7, 9]
    # Without a surface within the distance: up to the distance.
    assert at(seen, jnp.asarray(5.0)) == [1, 5]
    assert at(dataclasses.replace(seen, mask=mask & False), None) == [1, FAR]


@pytest.mark.exhaustive
def test_errors_along_the_view_are_those_of_each_method():
    found = {method: errors_along(TIGHT[method]) for method in METHODS}
    length = FAR - 1
    for method, ends in (("perspective", (0.99, 99)), ("lispsm", (9.9, 9.9))):
        np.testing.assert_allclose(found[method][[0, -1]], ends, rtol=2e-3)
    np.testing.assert_allclose(
        errors_along(PerspectiveWarp(strength=0.0, margin=0.0))[[0, -1]], (length, 0.99), rtol=2e-3
    )
    # The least worst case: any other warp is worse.
    best = found["lispsm"].max()
    for factor in (0.25, 0.8, 0.95, 1.05, 1.25, 4):
        assert errors_along(PerspectiveWarp(strength=9.0 * factor, margin=0.0)).max() > 1.01 * best
    # Under a light from another angle, by what the map shows along its y axis.
    corners = np.array([[0, y * z * np.tan(np.radians(30)), -z] for y in (-1, 1) for z in (1, FAR)])
    length_at_60 = np.ptp(corners @ [0, np.cos(np.radians(60)), -np.sin(np.radians(60))])
    oblique = warped(TIGHT["lispsm"], at_angle(60)).warp.strength
    assert oblique == pytest.approx(np.sqrt(1 + length_at_60 * np.sin(np.radians(60))) - 1, rel=1e-4)
    # The focus, 0.3 of the way, lies at 80 % of the map.
    light = warped(PerspectiveWarp("trapezoidal", focus=0.3, margin=0.0))
    clip = np.asarray(light.view().clip(jnp.array([[0.0, 1.0, -1 - 0.3 * length]])))[0]
    assert clip[1] / clip[3] == pytest.approx(2 * 0.8 - 1, abs=1e-5)


def plane(slope_x, slope_z):
    """A quad with y = slope_x x + slope_z (z + 50), which reaches far behind the camera."""
    return quad((0, 0, -50), (300, 300 * slope_x, 0), (0, -300 * slope_z, -300))


def normal_of(slope_x, slope_z):
    normal = np.array([-slope_x, 1, -slope_z])
    return normal / np.linalg.norm(normal)


def plane_at_texels(light, slope_x, slope_z):
    """Window depth of the plane, and its points (h, w, 3), at the centres of the texels of a light at noon: found by
    the formulas of the warp, in double precision."""
    view = light.view()
    w, center = float(view.warp.strength), float(view.warp.center)
    rows, turn = (np.asarray(x, np.float64) for x in (view.eye_to_clip, view.world_to_eye))
    x, s = np.meshgrid((np.arange(64) + 0.5) / 32 - 1, (np.arange(64) + 0.5) / 64)
    tau = s / (1 + w - w * s)
    x, y = x * (1 + w * tau) - w * tau * center, 2 * tau - 1
    eye = np.stack([(x - rows[0, 3]) / rows[0, 0], (y - rows[1, 3]) / rows[1, 1]], axis=-1)
    # The light looks along -y, so its rows know nothing of height.
    ground = (eye - turn[:2, 3]) @ turn[:2, [0, 2]]
    height = slope_x * ground[..., 0] + slope_z * (ground[..., 1] + 50)
    points = np.stack([ground[..., 0], height, ground[..., 1]], axis=-1)
    return (-height - float(view.near)) / float(view.far - view.near), points


@pytest.mark.exhaustive
def test_fixed_point_and_second_depths_are_those_without_the_warp():
    light = warped(TIGHT["lispsm"])
    mesh = merge([plane(0.0, 0.1), plane(0.0, 0.1)])
    lower = np.asarray(mesh.vertices) - np.array([0, 3.0, 0]) * (np.arange(8) >= 4)[:, None]
    mesh = Mesh(lower, mesh.faces)
    expected, _ = plane_at_texels(light, 0.0, 0.1)
    drawn_with = lambda **how: np.asarray(draw_shadow_map(mesh, light, SIZE, **how).depth)
    np.testing.assert_allclose(drawn_with(depth_layer="second"), expected + 3 / 400, atol=3e-6)
    np.testing.assert_allclose(drawn_with(depth_layer="midpoint"), expected + 1.5 / 400, atol=3e-6)
    steps = drawn_with(depth_format="unorm16") * 65535
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-2)
    np.testing.assert_allclose(steps, expected * 65535, atol=0.5 + 0.2)


@pytest.mark.parametrize("case", [((0.3, -0.8), 90, 0), ((0.6, 0.2), 60, 40)])
def test_receivers_know_texels_and_slopes_of_a_warped_map(case):
    """Against the projection itself: steps along the receiver's plane move as far into depth as the slope says, and
    texels are as large as the projection makes them."""
    slopes, angle, sideways = case
    light = warped(TIGHT["lispsm"], at_angle(angle, sideways))
    _, points = plane_at_texels(warped(TIGHT["lispsm"]), *slopes)
    # As seen from a light at noon, some of them lie beside the map.
    with jax.enable_x64(True):
        shadow_map, normal = in_float64(ShadowMap(jnp.zeros(SIZE), light)), normal_of(*slopes)
        surface = surface_at(points, normal)
        at = jax.tree.map(np.asarray, seen(shadow_map, surface))
        inside = ((at.texel > 0) & (at.texel < 64)).all(axis=-1) & at.in_front
        assert inside.mean() > 0.3
        across = np.cross(normal, [0.3, 0.5, -0.8])
        for way in (across, np.cross(normal, across)):
            moved = jax.tree.map(np.asarray, seen(shadow_map, surface_at(points + 1e-6 * way, normal)))
            step = moved.texel - at.texel
            expected = (at.slope * step).sum(axis=-1) * at.depth_per_texel
            np.testing.assert_allclose((moved.depth - at.depth)[inside], expected[inside], rtol=1e-3, atol=1e-12)
        # A square of one texel's area, in the plane across the light, covers a texel.
        x, y = (np.asarray(light.view().world_to_eye, np.float64)[k, :3] for k in range(2))
        moved = [seen(shadow_map, surface_at(points + 1e-5 * way, normal)).texel for way in (x, y)]
        (a, c), (b, d) = (np.moveaxis(np.asarray(m) - at.texel, -1, 0) / 1e-5 for m in moved)
        np.testing.assert_allclose((np.abs(a * d - b * c) * at.texel_size**2)[inside], 1, rtol=1e-3)


def random_views():
    rng = np.random.default_rng(5)
    for _ in range(24):
        eye, target = rng.normal(size=3) * 3, rng.normal(size=3) * 3
        near, far = 10 ** rng.uniform(-2, 0), 10 ** rng.uniform(0.5, 2.5)
        axis = PinholeCamera(
            eye, target, rng.normal(size=3), fov_y=rng.uniform(15, 100), near=near, far=far, resolution=(24, 32)
        )
        # The axis passes beside the middle of the image.
        view, aside = axis.view(), rng.uniform(-1, 1, 2)
        projection = np.array(view.eye_to_clip)
        projection[:2, 2] += aside
        camera = MatrixCamera(view.world_to_eye, projection, axis.resolution)
        center, extent = rng.normal(size=3), rng.uniform(1, 30, 2)
        light = DirectionalLight(rng.normal(size=3), center, extent, -rng.uniform(1, 20), rng.uniform(1, 20))
        yield rng, camera, light


@pytest.mark.exhaustive
@pytest.mark.parametrize("strength", [None, 30.0])
def test_nothing_that_the_camera_sees_lies_beside_the_map(strength):
    used = []
    for rng, camera, light in random_views():
        layout = PerspectiveWarp(strength=strength, shadow_distance=camera.far)
        view, own = warped(layout, light, camera, (48, 64)).view(), light.view()
        # Points of the camera's frustum, as many at each scale of depth, that the light's own map shows.
        depth = np.geomspace(float(camera.near), float(camera.far), 4000)
        clip = np.asarray(camera.eye_to_clip)
        x, y = (depth * (rng.uniform(-1, 1, 4000) + clip[k, 2]) / clip[k, k] for k in range(2))
        eye = np.stack([x, y, -depth], axis=-1)
        rows = np.asarray(camera.view().world_to_eye, np.float64)
        points = jnp.asarray((eye - rows[:3, 3]) @ rows[:3, :3], jnp.float32)
        shown = (np.abs(np.asarray(own.clip(points))[:, :3]) < 1).all(axis=-1)
        clip = np.asarray(view.clip(points))[shown]
        if not len(clip):
            continue
        assert (clip[:, 3] > 0).all()
        # With the margin in texels; at the far side, a given strength may leave less.
        place = clip[:, :2] / clip[:, 3:] * np.array([32, 24])
        assert np.abs(place[:, 0]).max() < 32 - 7.9
        assert place[:, 1].min() > -24 + 7.9
        assert place[:, 1].max() < (24 - 7.9 if strength is None else 24)
        used.append((np.ptp(place, axis=0) / [64, 48]).max())
    assert len(used) > 10
    assert np.median(used) > 0.6


@eqx.filter_jit
def _blockers(shadow_map, lookup):
    return PercentageCloserSoft(max_radius=400.0).find_blockers(shadow_map, lookup, SoftCompare(1e-3))


@pytest.mark.exhaustive
def test_penumbrae_are_as_wide_as_the_texels_at_the_receiver_say():
    light = warped(PerspectiveWarp(strength=5.0), eqx.tree_at(lambda one: one.angular_radius, NOON, jnp.float32(1.0)))
    shadow_map = ShadowMap(jnp.full(SIZE, np.float32(0.5)), light)
    _, points = plane_at_texels(light, 0.0, 0.0)
    at = seen(shadow_map, surface_at(points, (0, 1, 0)))
    lookup = Lookup(at.texel, jnp.full(SIZE, 0.51), at.depth_per_texel, at.in_front)
    inner = (slice(20, 44),) * 2
    found = _blockers(shadow_map, lookup)
    size = np.asarray(at.texel_size)[inner]
    assert np.ptp(size) > 0.5 * size.min()
    radius = np.sqrt(np.prod(found.radius, axis=0))[inner]
    np.testing.assert_allclose(radius * size, 0.01 * 400 * np.tan(np.radians(1)), rtol=1e-3)


@pytest.mark.exhaustive
def test_nothing_is_shadowed_beyond_the_shadow_distance():
    layout = PerspectiveWarp(shadow_distance=20.0)
    camera = PinholeCamera((0, 1, 0), (0, 1, -1), fov_y=60.0, near=1.0, far=FAR, resolution=(24, 32))
    # A map that shadows all that it covers.
    state = ShadowMap(jnp.zeros(SIZE), warped(layout, NOON, camera))
    technique = ShadowMapping(Nearest(), Bias(0.5, 0.75), layout=layout)
    # Points that the camera sees, before and beyond the distance.
    depth = np.geomspace(2, 90, 64) * np.ones((64, 1))
    points = np.stack([depth * np.linspace(-0.5, 0.5, 64)[:, None], 0 * depth, -depth], axis=-1)
    surface = surface_at(points, (0, 1, 0))
    np.testing.assert_array_equal(np.asarray(technique.visibility(state, surface)) == 0, depth <= 20)
    np.testing.assert_array_equal(technique.covered(state, surface), depth <= 20)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: warped(PerspectiveWarp(), lamp(floor_and_card())), "SpotLight, whose map cannot be fitted"),
        (lambda: warped(PerspectiveWarp(), size=(64, 17)), r"margin of 8 texels.*\(64, 17\).*expected more than 17"),
        (lambda: warped(PerspectiveWarp(shadow_distance=101.0)), "shadow_distance is 101; expected depths from"),
        (lambda: warped(PerspectiveWarp(strength=2.0), at_angle(0)), "strength is 2, and the light shines along"),
        (lambda: drawn_with(polygon_offset=(1.0, 1.0)), "is warped, and polygon_offset was given; expected none"),
        (
            lambda: drawn_with(edges=Edges.of(floor_and_card()), crossings=8),
            "edges were given for a map with a warp",
        ),
    ],
)
def test_what_a_warp_cannot_do_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def drawn_with(**how):
    return draw_shadow_map(floor_and_card(), warped(TIGHT["lispsm"]), SIZE, **how)
