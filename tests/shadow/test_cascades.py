"""Cascades: their slices, what their maps contain, that they meet without seams, and that texels stay in place."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import floor_and_card, quad, seen_by, side_camera, sun, surface_at

from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    MatrixCamera,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    Scene,
    SpotLight,
    merge,
)
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    Bias,
    Bilinear,
    Cascades,
    Castano,
    MapSettings,
    Nearest,
    PercentageCloser,
    PercentageCloserSoft,
    RandomDisk,
    ReceiverPlane,
    ShadowMap,
    ShadowMapping,
    SingleMap,
    Tent,
    VarianceShadowMap,
    _draw_map,
    aliasing,
    draw_shadow_map,
    receiver,
)

_apart = _draw_map._apart
NEAR, FAR = 0.1, 100.0
SIZE = (64, 64)
TEXELS = 32
# Of 40² texels: cascades of 64, 16, 32 and 32 texels a side.
SHARES, SHARED_TEXELS = (16.0, 1.0, 4.0, 4.0), 40
RADIUS = 3.0
"""Of the filters, texels."""
MAX_BLEND = 0.3
BIAS = Bias(0.5, plane=ReceiverPlane())


def cascades(logarithmic=0.8, blend=0.0, select="map", **more) -> Cascades:
    """Four cascades, with all that a filter may read within them. They share what is compiled."""
    if more.get("shares") is not None:
        more["max_share"] = max(SHARES) / sum(SHARES)
    return Cascades(4, logarithmic, blend=blend, max_blend=MAX_BLEND, margin=RADIUS + 2, select=select, **more)


def mapping(layout, kernel=None, texels=None, **settings) -> ShadowMapping:
    """A technique whose maps have `TEXELS` a side, or `SHARED_TEXELS` on average if there are shares."""
    texels = texels or (TEXELS if getattr(layout, "shares", None) is None else SHARED_TEXELS)
    settings = MapSettings((texels, texels), **settings)
    return ShadowMapping(kernel or RandomDisk(RADIUS), BIAS, map=settings, layout=layout)


def along_corridor(resolution=SIZE, near=NEAR, far=FAR) -> PinholeCamera:
    return PinholeCamera((0, 1.7, 0), (0, 1.2, -10), fov_y=60.0, near=near, far=far, resolution=resolution)


@pytest.mark.parametrize(
    ("depths", "stabilize", "is_said"),
    [("surface", True, True), ("surface", False, False), ("camera", True, False), ("camera", False, False)],
)
def test_stabilized_cascades_of_what_the_camera_sees_say_that_they_are_not_stable(depths, stabilize, is_said):
    remarks = Cascades(3, depths=depths, stabilize=stabilize).remarks(sun(quad((0, 0, 0), (1, 0, 0), (0, 0, -1))))
    assert len(remarks) == is_said
    for remark in remarks:
        assert "not stable, although stabilize is true: with depths = surface" in remark
        assert "set depths to camera" in remark


def posts(count=8) -> Mesh:
    """Posts along both sides of a plane, the farther the larger, which runs from the eye to the far plane."""
    ground = quad((0, 0, -55), (60, 0, 0), (0, 0, -60))
    depths = [1.5 + 90 * (k / count) ** 2 for k in range(count)]
    size = lambda z: ((0.15 + 0.06 * z, 0, 0), (0, 1 + 0.15 * z, 0))
    return merge([ground, *(quad((x, 1, -z), *size(z)) for z in depths for x in (-1.5, 1.2))])


# --- Slices ---


@eqx.filter_jit
def _splits(layout, near, far):
    return layout.splits(near, far)


def splits(layout, near=NEAR, far=FAR) -> np.ndarray:
    return np.asarray(_splits(layout, jnp.asarray(near), jnp.asarray(far)), np.float64)


def test_slices_follow_the_practical_split_scheme():
    fraction = np.arange(5) / 4
    uniform, logarithmic = NEAR + (FAR - NEAR) * fraction, NEAR * (FAR / NEAR) ** fraction
    np.testing.assert_allclose(splits(Cascades(4, 0.0)), uniform, rtol=1e-6)
    np.testing.assert_allclose(splits(Cascades(4, 1.0)), logarithmic, rtol=1e-5)
    np.testing.assert_allclose(splits(Cascades(4, 0.3)), 0.3 * logarithmic + 0.7 * uniform, rtol=1e-6)
    for count in (1, 4, 8):
        assert splits(Cascades(count, 0.7))[[0, -1]].tolist() == [np.float32(NEAR), np.float32(FAR)]


@pytest.mark.exhaustive
def test_sample_distribution_splits_what_is_seen():
    mesh, camera = floor_and_card(), side_camera(SIZE)
    surface, sunlight = draw_surface(mesh, camera), sun(mesh)
    layout = lambda distance: cascades(1.0, depths="surface", shadow_distance=distance)
    # The camera's far is no bound.
    light = layout(camera.far).light(sunlight, camera, (TEXELS, TEXELS), surface)
    depth = np.asarray(light.depth(surface.position))[np.asarray(surface.mask)]
    assert depth.min() > float(camera.near) * 2
    np.testing.assert_allclose([light.begins[0], light.ends[-1]], [depth.min(), depth.max()], rtol=1e-5)
    ends = np.concatenate([light.begins[:1], light.ends])
    np.testing.assert_allclose(ends[1:] / ends[:-1], (depth.max() / depth.min()) ** (1 / 4), rtol=1e-4)
    # A shadow distance bounds them; one before all that is seen leaves nothing to shadow, and no NaN.
    for distance, begin in ((float(depth.max()) - 1, depth.min()), (float(camera.near) * 1.5, float(camera.near))):
        nearer = layout(distance).light(sunlight, camera, (TEXELS, TEXELS), surface)
        np.testing.assert_allclose([nearer.begins[0], nearer.ends[-1]], [begin, distance], rtol=1e-5)
    # It is drawn if it is not given.
    again = mapping(layout(camera.far)).prepare(Scene(mesh, camera, sunlight)).light
    np.testing.assert_array_equal(again.ends, light.ends)


# --- What the maps contain ---

CAMERAS = 200
POINTS = 64


@eqx.filter_jit
def _contained(layout, size, eye, target, fov, aside, direction, fractions):
    """How far inside the margin of their cascade points of the view lie, and of the next; and which are blended."""

    def of_one(eye, target, fov, aside, direction, fractions):
        axis = PinholeCamera(eye, target, fov_y=fov, near=NEAR, far=FAR, resolution=(48, 64))
        view, half = axis.view(), jnp.tan(jnp.deg2rad(fov) / 2) * jnp.array([axis.aspect, 1.0])
        # The axis passes beside the middle of the image.
        projection = view.eye_to_clip.at[:2, 2].add(aside)
        camera = MatrixCamera(view.world_to_eye, projection, axis.resolution, is_perspective=True)
        light = DirectionalLight(direction, jnp.zeros(3), jnp.array([900.0, 700.0]), -500.0, 500.0)
        cascaded = layout.light(light, camera, size)
        depth = NEAR * (FAR / NEAR) ** fractions[:, 0]
        across = depth[:, None] * half * (2 * fractions[:, 1:] - 1 + aside)
        local = jnp.concatenate([across, -depth[:, None]], axis=-1)
        points = axis.eye + jnp.sum(local[:, :, None] * view.world_to_eye[:3, :3], axis=1)
        layer = cascaded.layer(points)
        following = jnp.minimum(layer + 1, layout.count - 1)
        begins = jnp.concatenate([cascaded.begins[:1], cascaded.ends[:-1]])
        in_band = (cascaded.ends[layer] - depth) < layout.blend * (cascaded.ends - begins)[layer]
        within = 1 - 2 * layout.margin / layout.sides(size)
        inside = lambda layer: jnp.min(
            within[layer] - jnp.abs(cascaded.view().facing(layer).clip(points)[:, :2]), axis=-1
        )
        return inside(layer), inside(following), in_band

    return jax.vmap(of_one)(eye, target, fov, aside, direction, fractions)


@pytest.fixture
def large_maps(monkeypatch):
    """A function that returns what another one returns for maps of this side, drawn together and view by view."""

    def both(side, draw):
        together = draw()
        monkeypatch.setattr(_draw_map, "_MAX_TOGETHER", side * side - 1)
        return together, draw()

    return both


@pytest.mark.exhaustive
def test_cascades_of_large_maps_are_drawn_one_by_one(large_maps, monkeypatch):
    calls, mesh, size = [], floor_and_card(), (SHARED_TEXELS, SHARED_TEXELS)
    monkeypatch.setattr(_draw_map, "_apart", lambda views: calls.append(len(views[0])) or _apart(views))
    light = cascades(shares=SHARES).light(sun(mesh), side_camera(SIZE), size)
    draw = lambda: draw_shadow_map(mesh, light, size, depth_layer="midpoint").depth
    together, one_by_one = large_maps(SHARED_TEXELS, draw)
    assert calls == [4]
    assert 0.1 < np.mean(np.asarray(together) < 1) < 0.9
    np.testing.assert_array_equal(one_by_one, together)


@pytest.mark.exhaustive
def test_cascades_of_large_maps_have_the_same_derivatives(large_maps):
    mesh, size = floor_and_card(), (TEXELS, TEXELS)
    light = cascades().light(sun(mesh), side_camera(SIZE), size)

    def depth_and_gradient(vertices):
        moved = eqx.tree_at(lambda m: m.vertices, mesh, vertices)
        depth, pull = jax.vjp(lambda moved: draw_shadow_map(moved, light, size).depth, moved)
        return depth, pull(jnp.cos(depth))[0].vertices

    # JAX traces a new function again.
    together, one_by_one = large_maps(TEXELS, lambda: jax.jit(lambda v: depth_and_gradient(v))(mesh.vertices))
    np.testing.assert_array_equal(one_by_one[0], together[0])
    assert np.abs(together[1]).max() > 0.1
    np.testing.assert_allclose(one_by_one[1], together[1], rtol=1e-5, atol=1e-5 * np.abs(together[1]).max())


# Maps without shares are not square.
@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("stabilize", "select", "shares"),
    [
        (True, "interval", None),
        (False, "map", None),
        (False, "interval", SHARES),
        (True, "map", SHARES),
    ],
)
def test_every_point_of_the_view_lies_in_its_map_with_its_kernel(stabilize, select, shares):
    rng = np.random.default_rng(1)
    eye = rng.normal(size=(CAMERAS, 3)) * 20
    target, direction = eye + rng.normal(size=(CAMERAS, 3)), rng.normal(size=(CAMERAS, 3))
    fractions = rng.random((CAMERAS, POINTS, 3))
    # Corners of the view, too, at any depth.
    fractions[:, ::2, 1:] = rng.integers(0, 2, (CAMERAS, POINTS // 2, 2))
    layout = Cascades(4, 0.8, shares=shares, stabilize=stabilize, select=select, blend=0.2, margin=6.0)
    fov = rng.uniform(20, 100, CAMERAS)
    size, aside = (48, 64) if shares is None else (64, 64), rng.uniform(-1, 1, (CAMERAS, 2))
    inside, in_next, in_band = _contained(layout, size, eye, target, fov, aside, direction, fractions)
    # Rounding: a window is a few hundred units wide, in float32.
    assert np.asarray(inside).min() > -1e-4
    if select == "interval":
        assert np.asarray(in_band).mean() > 0.05
        assert np.asarray(in_next)[np.asarray(in_band)].min() > -1e-4


def one_cascade(blend=0.0) -> Cascades:
    return Cascades(1, stabilize=False, blend=blend, max_blend=MAX_BLEND)


@pytest.mark.parametrize("blend", [0.3, pytest.param(0.0, marks=pytest.mark.exhaustive)])
def test_one_cascade_over_the_whole_scene_is_the_plain_map_bit_for_bit(blend):
    # All of the light's map is in the camera's sight.
    mesh = floor_and_card()
    camera = PinholeCamera((6, 9, 7), (0, 0, 0), fov_y=60.0, near=0.1, far=40.0, resolution=SIZE)
    scene, surface = Scene(mesh, camera, sun(mesh)), seen_by(camera, mesh)
    plain = mapping(SingleMap(), Nearest())
    state = plain.prepare(scene, surface)
    visibility = np.asarray(plain.visibility(state, surface))
    assert 0.02 < (visibility[np.asarray(surface.mask)] < 0.5).mean() < 0.9
    one = mapping(one_cascade(blend), Nearest())
    map_of_one = one.prepare(scene, surface)
    np.testing.assert_array_equal(map_of_one.depth[0], state.depth)
    np.testing.assert_array_equal(one.visibility(map_of_one, surface), visibility)


# --- Shares ---


@eqx.filter_jit
def _seen(shadow_map, surface):
    """Of the surface as the light sees it: what a texel's size counts for, and the layer."""
    at = receiver(shadow_map, surface)
    return at.layer, (at.texel, at.depth, at.texel_size, at.depth_per_texel, at.rounding)


def scattered(seed=0):
    """Points on the plane, most of them near the posts, and some beside all maps."""
    rng = np.random.default_rng(seed)
    across = rng.normal(0, 2, SIZE) * np.where(rng.random(SIZE) < 0.2, 100, 1)
    points = np.stack([across, np.zeros(SIZE), -(NEAR * (FAR / NEAR) ** rng.random(SIZE))], axis=-1)
    return surface_at(points, (0, 1, 0))


@pytest.mark.exhaustive
def test_cascades_with_shares_are_those_of_maps_of_their_size():
    # 64² + 16² + 32² + 32² texels are four times 40².
    side, surface, mesh = TEXELS, scattered(), posts()
    shared, plain = mapping(cascades(0.7, shares=SHARES)), mapping(cascades(0.7))
    scene = Scene(mesh, along_corridor(), sun(mesh, (0.4, -1.0, 0.3)))
    state, expected = shared.prepare(scene), plain.prepare(scene)
    assert state.depth.shape == (4, 64, 64)
    assert np.asarray(state.light.sides).tolist() == [64, 16, side, side]
    depth = np.asarray(state.depth)
    np.testing.assert_array_equal(depth[2:, :side, :side], expected.depth[2:])
    assert np.ptp(depth[1, :16, :16]) > 0
    for layer, own in ((1, 16), (2, side), (3, side)):
        assert (depth[layer, own:] == 1).all()
        assert (depth[layer, :, own:] == 1).all()
    (layer, at), (layer_of_plain, of_plain) = _seen(state, surface), _seen(expected, surface)
    mine = np.isin(layer, (2, 3)) & (np.asarray(layer) == np.asarray(layer_of_plain))
    assert 0.2 < mine.mean() < 0.9
    for own, others in zip(at, of_plain, strict=True):
        np.testing.assert_array_equal(np.asarray(own)[mine], np.asarray(others)[mine])
    inside = np.asarray(plain.covered(expected, surface))[mine]
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(np.asarray(shared.covered(state, surface))[mine], inside)
    visibility = np.asarray(shared.visibility(state, surface))[mine]
    assert 0.01 < (visibility < 0.9).mean() < 0.9
    np.testing.assert_array_equal(visibility, np.asarray(plain.visibility(expected, surface))[mine])
    extent, extent_of_plain = shared.aliasing(state, surface, scene.camera), aliasing(expected, surface, scene.camera)
    np.testing.assert_array_equal(np.asarray(extent.mask)[mine], np.asarray(extent_of_plain.mask)[mine])
    np.testing.assert_allclose(np.asarray(extent.extent)[mine], np.asarray(extent_of_plain.extent)[mine], rtol=1e-4)


# --- Stable texels ---


def moved_maps(layout, moves, turn=0.0):
    """The maps, and their lights, of a camera in its place and of cameras moved and turned from there."""
    mesh = posts()
    technique, light = mapping(layout), sun(mesh, (0.4, -1.0, 0.3))
    heading = lambda angle: np.array([np.sin(angle), -0.05, -np.cos(angle)])
    cameras = [
        PinholeCamera(eye, eye + 10 * heading(angle), fov_y=60.0, near=NEAR, far=FAR, resolution=SIZE)
        for eye, angle in [
            (np.array([0.0, 1.7, 0.0]), 0.0),
            *((np.array([0.0, 1.7, 0.0]) + move, turn) for move in moves),
        ]
    ]
    return [technique.prepare(Scene(mesh, camera, light)) for camera in cameras]


def overlap(first, second, layer):
    """What both maps show of the scene, if one is the other moved by whole texels; and by how many."""
    side = TEXELS if first.light.sides is None else int(first.light.sides[layer])
    moved = (np.asarray(second.light.offset[layer]) - np.asarray(first.light.offset[layer])) * side / 2
    x, y = (int(k) for k in np.round(moved))
    np.testing.assert_allclose(moved, [x, y], atol=1e-4)
    span = lambda k: (slice(max(-k, 0), side - max(k, 0)), slice(max(k, 0), side - max(-k, 0)))
    (rows, rows_then), (columns, columns_then) = span(y), span(x)
    return np.asarray(first.depth[layer])[rows, columns], np.asarray(second.depth[layer])[rows_then, columns_then]


MOVES = [np.array(move) for move in ((0.003, 0.0, 0.001), (1.37, 0.2, -2.9), (-7.7, 1.1, 5.3))]


@pytest.mark.exhaustive
@pytest.mark.parametrize("shares", [None, (9.0, 4.0, 4.0, 1.0)])
def test_texels_stay_in_place_as_the_camera_moves(shares):
    first, *others = moved_maps(cascades(0.5, shares=shares), MOVES)
    sides = [TEXELS] * 4 if shares is None else [56, 37, 37, 18]
    for other in others:
        np.testing.assert_array_equal(other.light.scale, first.light.scale)
        for layer, side in enumerate(sides):
            before, after = overlap(first, other, layer)
            assert before.size > 0.3 * side**2
            assert np.ptp(before) > 1e-3
            # Triangles are the same. Where a texel's centre lies on one is rounded, unless sides are powers of two.
            np.testing.assert_allclose(before, after, rtol=0, atol=0 if shares is None else 4e-7)


# --- No seams ---

EXHAUSTIVE = pytest.mark.exhaustive
FILTERS = {
    "nearest": Nearest(),
    "bilinear": Bilinear(),
    "box": PercentageCloser(RADIUS),
    "tent": Tent(RADIUS),
    "castano": Castano(7),
    "random_disk": RandomDisk(RADIUS),
    "soft": PercentageCloserSoft(max_radius=RADIUS),
    "variance": VarianceShadowMap(RADIUS),
}


def lit_plane(kernel, layout):
    """A plane and a lid that does not reach over it, from the eye to the far plane."""
    ground = quad((0, 0, -55), (60, 0, 0), (0, 0, -60))
    lid = quad((200, 3, -55), (60, 0, 0), (0, 0, -60))
    mesh, camera = merge([ground, lid]), along_corridor()
    light = DirectionalLight.around((0.1, -1.0, 0.3), mesh.vertices, 0.5)
    technique, surface = mapping(layout, kernel), seen_by(camera, mesh)
    state = technique.prepare(Scene(mesh, camera, light), surface)
    return np.asarray(technique.visibility(state, surface)), np.asarray(surface.mask)


WAYS = [("map", True), ("interval", False), ("interval", True), ("map", False)]
OTHERS = ("box", "castano", "soft")
LIT_PLANES = [
    ("random_disk", *WAYS[0], None),
    ("random_disk", *WAYS[0], SHARES),
    *(pytest.param("random_disk", *way, SHARES, marks=EXHAUSTIVE) for way in WAYS[1:]),
    *(pytest.param(name, *WAYS[0], None, marks=EXHAUSTIVE) for name in OTHERS),
    pytest.param("variance", *WAYS[0], SHARES, marks=EXHAUSTIVE),
]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "select", "stabilize", "shares"), LIT_PLANES)
def test_a_lit_plane_is_lit_at_every_split(name, select, stabilize, shares):
    layout = cascades(shares=shares, select=select, stabilize=stabilize, blend=0.2)
    visibility, mask = lit_plane(FILTERS[name], layout)
    assert mask.mean() > 0.3
    assert visibility[mask].min() > (0.99 if name == "variance" else 1 - 1e-6)


# With the least margin that the filter allows, and windows that are fitted tightly.
TIGHT = Cascades(4, 0.8, blend=0.0, stabilize=False, margin=RADIUS + 0.5)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "layout",
    [
        cascades(),
        cascades(blend=0.3),
        cascades(blend=0.3, shares=SHARES),
        pytest.param(TIGHT, marks=EXHAUSTIVE),
    ],
    ids=["sharp", "blended", "shares", "tight"],
)
def test_everything_under_a_lid_is_dark(layout):
    ground, lid = quad((0, 0, -55), (60, 0, 0), (0, 0, -60)), quad((0, 60, -55), (300, 0, 0), (0, 0, -300))
    mesh, camera = merge([ground, lid]), along_corridor()
    technique, surface = mapping(layout), seen_by(camera, mesh)
    state = technique.prepare(Scene(mesh, camera, DirectionalLight.around((0.1, -1.0, 0.3), mesh.vertices)), surface)
    assert np.asarray(technique.covered(state, surface))[np.asarray(surface.mask)].all()
    assert np.asarray(technique.visibility(state, surface))[np.asarray(surface.mask)].max() < 1e-6


# --- Blending and fading ---


GRID_TEXELS = 64


def given_slices(*ends, blend=0.0, fade=0.5) -> Cascades:
    """Cascades that end there. They share what is compiled."""
    return Cascades(distances=ends, blend=blend, max_blend=0.25, fade=fade)


def in_grid(layout) -> ShadowMapping:
    return mapping(layout, Bilinear(), GRID_TEXELS)


def across_a_split(technique, state, end, length):
    """Visibility along the view's axis over the last part of a slice that ends at `end`, and a little beyond."""
    depth = np.linspace(end - 0.5 * length, end + 0.2 * length, SIZE[0] * SIZE[1])
    points = np.stack([np.zeros(depth.shape), np.zeros(depth.shape), -depth], axis=-1).reshape(*SIZE, 3)
    return depth, np.asarray(technique.visibility(state, surface_at(points, (0, 1, 0)))).ravel()


@pytest.fixture(scope="module")
def grid():
    """A lattice above the ground, whose shadow differs from map to map."""
    bars = [quad((0, 1, -0.35 * k), (20, 0, 0), (0, 0, -0.1)) for k in range(1, 63)]
    mesh = merge([quad((0, 0, -55), (60, 0, 0), (0, 0, -60)), *bars])
    camera = PinholeCamera((0, 0.0, 0), (0, 0.0, -10), fov_y=60.0, near=1.0, far=30.0, resolution=SIZE)
    return Scene(mesh, camera, sun(mesh, (0.05, -1, 0.2)))


@pytest.fixture(scope="module")
def grid_map(grid):
    return in_grid(given_slices(8.0, 30.0)).prepare(grid)


@pytest.mark.exhaustive
def test_a_blend_leads_from_one_map_to_the_next(grid_map):
    depth, blended = across_a_split(in_grid(given_slices(8.0, 30.0, blend=0.25)), grid_map, 8.0, 7.0)
    _, sharp = across_a_split(in_grid(given_slices(8.0, 30.0)), grid_map, 8.0, 7.0)
    # The finer map ends where the band does: only there does the next one start without a blend.
    onwards = eqx.tree_at(lambda s: s.light.ends, grid_map, jnp.asarray([1.5, 30.0]))
    _, following = across_a_split(in_grid(given_slices(1.5, 30.0)), onwards, 8.0, 7.0)
    weight = np.clip((8.0 - depth) / 7.0 / 0.25, 0, 1)
    assert np.abs(sharp - following)[depth < 8].max() > 0.2
    np.testing.assert_allclose(blended, weight * sharp + (1 - weight) * following, atol=1e-5)


@pytest.mark.exhaustive
def test_shadows_end_or_fade_at_the_shadow_distance(grid):
    technique = in_grid(given_slices(6.0, 11.0))
    state = technique.prepare(grid)
    depth, faded = across_a_split(technique, state, 11.0, 5.0)
    assert faded[depth > 11].min() == 1
    # Where the slice is said to end further off, so that nothing fades yet.
    further = eqx.tree_at(lambda s: s.light.ends, state, jnp.asarray([6.0, 30.0]))
    _, unfaded = across_a_split(in_grid(given_slices(6.0, 30.0)), further, 11.0, 5.0)
    assert unfaded.min() == 0
    strength = np.clip((11.0 - depth) / 5.0 / 0.5, 0, 1)
    np.testing.assert_allclose(faded, 1 - strength * (1 - unfaded), atol=1e-5)
    points = jnp.asarray(np.stack([0 * depth, 0 * depth, -depth], axis=-1)[None], jnp.float32)
    choose = eqx.filter_jit(lambda layout, light, points: layout.choose(light, points))
    ending = choose(given_slices(6.0, 11.0, fade=0.0), state.light, points).strength
    np.testing.assert_array_equal(np.asarray(ending)[0], np.float32(depth) <= 11)
    # Only the last of several slices fades.
    ends = jnp.asarray([2.0, 6.0, 11.0])
    third = eqx.tree_at(lambda light: (light.begins, light.ends), state.light, (jnp.asarray([0.1, 2.0, 6.0]), ends))
    fading = choose(given_slices(2.0, 6.0, 11.0), third, points).strength
    np.testing.assert_allclose(np.asarray(fading)[0], strength, atol=1e-6)


def test_figures_of_cascades_show_what_receivers_are_looked_up_in(grid):
    layout = given_slices(6.0, 11.0, blend=0.25)
    light = layout.light(grid.light, grid.camera, (GRID_TEXELS, GRID_TEXELS))
    assert layout.map_figure(light) == ("Cascades", ("up to 6 deep", "up to 11 deep"), 2)
    depth = np.linspace(1, 20, SIZE[0] * SIZE[1]).reshape(SIZE)
    surface = surface_at(np.stack([0 * depth, 0 * depth, -depth], axis=-1), (0, 1, 0))
    figure = layout.layer_figure(light, surface)
    assert figure.labels == {0: "1: up to 6 deep", 1: "2: up to 11 deep"}
    np.testing.assert_array_equal(figure.colour, depth > 6)
    np.testing.assert_array_equal(figure.shown, depth < 11)
    assert (np.asarray(figure.weight)[(depth > 5) & (depth < 6)] < 1).all()
    assert SingleMap().map_figure(grid.light) is SingleMap().layer_figure(grid.light, surface) is None


@eqx.filter_jit
def _biases(shadow_map, surface, factors):
    """What constant, slope and normal offset add up to, and what a receiver plane does, with factors; and without."""
    at = receiver(shadow_map, surface)
    scaled = lambda given: Bias(0.5, 1.0, 0.25, factors=given)(at)
    return scaled(factors), Bias(plane=ReceiverPlane(), factors=factors)(at), scaled(None), ReceiverPlane()(at)


@pytest.mark.exhaustive
def test_factors_scale_the_bias_of_each_cascade(grid_map):
    factors, depth = (2.0, 0.5), np.linspace(5, 11, SIZE[0] * SIZE[1]).reshape(SIZE)
    points = np.stack([np.zeros(SIZE), np.zeros(SIZE), -depth], axis=-1)
    surface = surface_at(points, (0, 1, 0))
    scaled, plane, plain, plain_plane = _biases(grid_map, surface, factors)
    factor = np.where(depth <= 8, *factors)
    np.testing.assert_allclose(scaled.depth, factor * np.asarray(plain.depth), rtol=1e-6)
    np.testing.assert_allclose(scaled.displacement, factor[..., None] * np.asarray(plain.displacement), rtol=1e-6)
    # What follows from rounding is not scaled.
    np.testing.assert_array_equal(plane.depth, plain_plane.depth)
    single = ShadowMap(jnp.ones(SIZE), grid_map.light.light)
    with pytest.raises(ValueError, match="2 factors, one for each layer, and the map has no layers"):
        eqx.filter_eval_shape(_biases, single, surface, factors)
    with pytest.raises(ValueError, match=r"factors\[1\] is -1\.0"):
        Bias(0.5, factors=(1.0, -1.0))


# --- Against rays ---


# --- Mistakes ---


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: Cascades(distances=(5.0, 2.0)), r"\[5.0, 2.0\]; expected each to be greater"),
        (lambda: Cascades(distances=(5.0,), shadow_distance=3.0), "remove the others"),
        (
            lambda: Cascades(blend=0.3, max_blend=0.2),
            "blend is 0.3.* and max_blend is 0.2; expected blend at most max_blend",
        ),
        (lambda: Cascades(margin=-1.0), "margin is -1.0; expected a number at least 0"),
        (
            lambda: mapping(Cascades(margin=1.0)),
            "margin is 1 texels, .* read up to 3.5 texels .*: raise margin",
        ),
        (
            lambda: mapping(Cascades(margin=8.0), PercentageCloserSoft(max_radius=16.0)),
            "is 8 texels, .* read up to 16.5",
        ),
        (
            lambda: ShadowMapping(
                Nearest(), Bias(normal_offset=3.0, factors=(1.0, 2.0)), layout=Cascades(2, margin=5.0)
            ),
            "margin is 5 texels, .* read up to 6 texels",
        ),
        (lambda: Cascades(3, shares=(1.0, 2.0)), "2 shares, and their count is 3; .* one share for each"),
        (lambda: Cascades(2, shares=(1.0, 0.0)), r"shares\[1\] is 0.0; expected a number at least 0.001"),
        (lambda: Cascades(2, shares=(1.0, 3.0), max_share=0.6), "greatest 0.75 of all texels, and max_share is 0.6"),
        (lambda: Cascades(2, shares=(1.0, 1.0), max_share=0.0), "max_share is 0.0; expected more than 0"),
        (lambda: Cascades(2, shares=(1.0, 1.0)).layer_resolution((64, 32)), r"\(64, 32\) .* expected square maps"),
        (lambda: Cascades(2, shares=(3.0, 1.0)).layer_resolution((8192, 8192)), "10033²; expected at most 8192²"),
        (lambda: fitted(Cascades(4, shares=(99.0, 1.0, 1.0, 1.0))), r"maps of \(12, 12\) texels.* more than 17"),
        (
            lambda: draw_shadow_map(
                floor_and_card(),
                fitted(cascades(shares=SHARES), size=(SHARED_TEXELS, SHARED_TEXELS)),
                SIZE,
                edges=Edges.of(floor_and_card()),
                crossings=64,
            ),
            "edges were given for a map with cascades of several sizes",
        ),
        (lambda: fitted(Cascades(shadow_distance=200.0)), "shadow_distance is 200; .* to its far, 100"),
        (lambda: fitted(Cascades(distances=(1.0, 200.0))), "distances are 1, 200; .* to its far, 100"),
        (lambda: fitted(Cascades(margin=40.0)), "margin of 40 texels .* expected more than 81"),
        (lambda: fitted(Cascades(), SpotLight((0, 3, 0), (0, -1, 0), 40.0, 0.1, 9.0)), "light is a SpotLight"),
        (lambda: fitted(Cascades(), camera=OrthographicCamera((0, 1, 0), (0, 0, 0), (0, 0, 1), near=-1)), "near is -1"),
        (lambda: fitted(Cascades(depths="surface")), "expected a surface"),
    ],
)
def test_mistakes_are_named(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()


def fitted(layout, light=None, camera=None, size=SIZE):
    return layout.light(light or sun(floor_and_card()), camera or along_corridor(), size)
