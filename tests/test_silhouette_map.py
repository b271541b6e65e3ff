"""Shadow maps that know where within a texel casters end: areas, derivatives, and every filter."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import jacfwd_and_value, lookups_at
from shadow_area_oracle import difference, lit_area

from diffshadow._misc import normalize
from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    PinholeCamera,
    PointLight,
    SpotLight,
    library_mesh,
    merge,
)
from diffshadow.io import load_mesh
from diffshadow.raster import Surface, draw_surface
from diffshadow.shadow import (
    Bias,
    Bilinear,
    Castano,
    ConstantBias,
    FourTap,
    HardCompare,
    Nearest,
    PercentageCloser,
    PercentageCloserSoft,
    RandomDisk,
    ReceiverPlane,
    ShadowMapping,
    Tent,
    VarianceShadowMap,
    draw_shadow_map,
    plan_shadow_map,
    stratified,
)
from diffshadow.shadow._cut_rectangle import HalfPlane, Rectangle, cut_area
from diffshadow.shadow._map import _about_corners
from diffshadow.shadow._padded_map import _Pyramid

BOX = (-0.75, 0.4, -0.8, 0.45)
"""Of the ground: its border crosses the shadows, so that moving them changes the area in light."""


def _ground(size: int, box=BOX) -> Surface:
    """Points of the ground spread evenly, without a grid that texels could be in step with."""
    i = np.arange(size * size)
    share = np.stack([i * 0.7548776662466927, i * 0.5698402909980532], axis=1) % 1
    position = np.zeros((size, size, 3))
    position[..., 0] = (box[0] + share[:, 0] * (box[1] - box[0])).reshape(size, size)
    position[..., 2] = (box[2] + share[:, 1] * (box[3] - box[2])).reshape(size, size)
    up = jnp.broadcast_to(jnp.array([0.0, 1.0, 0.0]), position.shape)
    face = jnp.zeros((size, size), jnp.int32)
    return Surface(jnp.asarray(position), up, up, jnp.ones_like(up), face, face == 0)


def _area(surface: Surface, box=BOX):
    area = (box[1] - box[0]) * (box[3] - box[2])
    return lambda visibility: jnp.mean(visibility) * area


def _caster(name: str, **options) -> Mesh:
    return _centred(library_mesh(name, **options))


def _centred(mesh: Mesh) -> Mesh:
    v = np.asarray(mesh.vertices, np.float64)
    v = (v - (v.min(0) + v.max(0)) / 2) / (v.max(0) - v.min(0)).max()
    # Turned, so that no edge runs along a border of the ground: as it crosses one, the area in light has a kink.
    c, s = np.cos(0.35), np.sin(0.35)
    v = v @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    return Mesh(jnp.asarray(v + np.array([0.02, 0.75, -0.03])), mesh.faces)


def _bunny() -> Mesh:
    path = Path(__file__).parents[2] / "shared" / "meshes" / "bunny.ply"
    if not path.exists():
        pytest.skip(f"there is no {path}: the mesh is not part of the project")
    return load_mesh(path)


def _moved(mesh: Mesh, offset) -> Mesh:
    return Mesh(mesh.vertices + jnp.asarray(offset), mesh.faces)


SUN = np.array([-0.3, -1.0, 0.2])
PLACE = np.array([0.5, 4.0, 0.3])
CONE = 14.0
"""The spot light's outer angle, which holds all casters."""


def _sun(by) -> DirectionalLight:
    direction = jnp.asarray(SUN, by.dtype) + jnp.stack([by[0], jnp.zeros_like(by[0]), by[1]])
    return DirectionalLight(direction, jnp.array([0.0, 0.5, 0.0]), jnp.array([2.2, 2.2]), -3.0, 3.0)


def _spot(by) -> SpotLight:
    direction = jnp.array([-0.12, -1.0, -0.07]) + jnp.stack([by[3], jnp.zeros_like(by[3]), by[4]])
    return SpotLight(jnp.asarray(PLACE, by.dtype) + by[:3], direction, CONE, 1.0, 6.0)


def _point(by) -> PointLight:
    return PointLight(jnp.asarray(PLACE, by.dtype) + by[:3], 0.5, 6.0)


LIGHTS = {
    "sun": (_sun, 2, lambda by: [*-(SUN + np.array([by[0], 0, by[1]])), 0]),
    "spot": (_spot, 5, lambda by: [*(PLACE + by[:3]), 1]),
    "point": (_point, 3, lambda by: [*(PLACE + by[:3]), 1]),
}


def _technique(filter_) -> ShadowMapping:
    return ShadowMapping(filter_, ConstantBias(0.0), HardCompare())


_visibility = eqx.filter_jit(lambda technique, shadow_map, surface: technique.visibility(shadow_map, surface))


def _gradient(mesh: Mesh, light: str, resolution: int, size: int):
    """The area in light and its derivative by the light's pose and the caster's place: ours and exactly.

    Of `size`² points of the ground only those near the shadow's outline are asked for derivatives: elsewhere they are
    zero. Outlines that move without changing the area cancel to a thousandth, so there must be many.
    """
    make, parameters, towards = LIGHTS[light]
    edges, everywhere = Edges.of(mesh), _ground(size)
    start = jnp.zeros(parameters + 3)
    room = plan_shadow_map(mesh, make(start), (resolution, resolution), edges=edges)

    def draw(by):
        return draw_shadow_map(
            _moved(mesh, by[parameters:]),
            make(by),
            (resolution, resolution),
            edges=edges,
            capacity=room.triangles,
            silhouette_capacity=room.silhouettes,
        )

    whole = dataclasses.replace(eqx.filter_jit(draw)(start), silhouettes=None)
    rough = np.asarray(_visibility(_technique(PercentageCloser(4.0)), whole, everywhere)).ravel()
    near, box = np.flatnonzero((rough > 0) & (rough < 1)), (BOX[1] - BOX[0]) * (BOX[3] - BOX[2])
    rows = -(-len(near) // 256)
    counted = np.arange(rows * 256).reshape(rows, 256) < len(near)
    chosen = np.resize(near, (rows, 256))
    surface = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[chosen], everywhere)
    technique, rest = _technique(Bilinear()), (rough == 1).sum()

    def ours(by):
        lit = jnp.where(counted, technique.visibility(draw(by), surface), 0)
        return (jnp.sum(lit) + rest) / size**2 * box

    exact = lambda by: lit_area(_moved(mesh, by[parameters:]), towards(by[:parameters]), BOX)
    gradient, value = jax.jit(jacfwd_and_value(ours))(start)
    return value, exact(np.zeros(parameters + 3)), gradient, difference(exact, start)


@pytest.fixture
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("seed", range(4))
def test_cut_area_is_that_of_the_clipped_polygon(seed, float64):
    rng = np.random.default_rng(seed)
    angles, offsets = rng.uniform(0, 2 * np.pi, (2, 50)), rng.uniform(-0.5, 0.5, (2, 50))
    low, size = rng.uniform(-0.5, 0, (2, 50)), rng.uniform(0.1, 0.5, (2, 50))
    sides = [low[0], low[0] + size[0], low[1], low[1] + size[1]]

    def area_of(values):
        planes = [HalfPlane(jnp.cos(values[k]), jnp.sin(values[k]), values[k + 2]) for k in (4, 5)]
        return cut_area(Rectangle(*values[:4]), *planes)

    values = [jnp.asarray(value) for value in (*sides, *angles, *offsets)]
    area = area_of(values)
    for i in range(50):
        polygon = [(low[0, i], low[1, i]), (low[0, i] + size[0, i], low[1, i])]
        polygon += [(x, low[1, i] + size[1, i]) for x, _ in polygon[::-1]]
        for angle, offset in zip(angles[:, i], offsets[:, i], strict=True):
            polygon = _clip(polygon, np.array([np.cos(angle), np.sin(angle)]), offset)
        assert area[i] == pytest.approx(_shoelace(polygon), abs=1e-12)
    gradient = jax.grad(lambda values: jnp.sum(area_of(values)))(values)
    for k, value in enumerate(values):
        change = lambda h, k=k, value=value: area_of([*values[:k], value + h, *values[k + 1 :]])
        np.testing.assert_allclose(gradient[k], (change(1e-6) - change(-1e-6)) / 2e-6, atol=1e-5)


def test_half_planes_that_end_on_a_side_of_the_rectangle():
    part = Rectangle(-0.5, 0.25, -0.125, 0.5)
    corners = [(part.left, part.below), (part.right, part.below), (part.right, part.above), (part.left, part.above)]
    on_sides = [(sign, 0, sign * side) for sign in (1, -1) for side in part[:2]]
    on_sides += [(0, sign, sign * side) for sign in (1, -1) for side in part[2:]]
    pairs = np.array([(one, other) for one in on_sides for other in [*on_sides, (0.6, 0.8, 0.125)]])
    areas = cut_area(part, *(HalfPlane(*jnp.asarray(pairs[:, k].T, jnp.float32)) for k in (0, 1)))
    for area, pair in zip(areas, pairs, strict=True):
        polygon = corners
        for x, y, offset in pair:
            polygon = _clip(polygon, np.array([x, y]), offset)
        assert area == pytest.approx(_shoelace(polygon), abs=1e-7), pair


def test_one_half_plane_twice():
    plane = HalfPlane(*map(jnp.float32, (0.6, 0.8, 0.0)))
    turned = HalfPlane(*(-value for value in plane))
    # A line through the middle halves a texel.
    assert cut_area(Rectangle(-0.5, 0.5, -0.5, 0.5), plane, plane) == pytest.approx(0.5, abs=1e-7)
    assert cut_area(Rectangle(-0.5, 0.5, -0.5, 0.5), plane, turned) == pytest.approx(0, abs=1e-7)


def _clip(polygon, normal, offset):
    """Sutherland and Hodgman's clipping."""
    kept = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        da, db = np.dot(normal, a) - offset, np.dot(normal, b) - offset
        if da >= 0:
            kept.append(a)
        if (da >= 0) != (db >= 0):
            kept.append(tuple(np.add(a, np.subtract(b, a) * (da / (da - db)))))
    return kept


def _shoelace(polygon) -> float:
    x, y = np.array(polygon).T if polygon else np.zeros((2, 1))
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


SQUARE = np.array([[-0.37, 1, -0.31], [-0.33, 1, 0.29], [0.41, 1, 0.36], [0.28, 1, -0.4]])
WIDE = (-0.65, 0.65, -0.65, 0.65)


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["sun", "spot"])
def test_a_vertex_moves_the_shadow_of_a_square(light, float64):
    make, parameters, towards = LIGHTS[light]
    square = lambda v: Mesh(v, jnp.array([[0, 1, 2], [0, 2, 3]]))
    mesh, none = square(jnp.asarray(SQUARE)), jnp.zeros(parameters)
    edges, box = Edges.of(mesh), (-0.8, 0.5, -0.4, 0.7)
    surface, resolution = _ground(192, box), (128, 128)
    room = plan_shadow_map(mesh, make(none), resolution, edges=edges)
    technique, area = _technique(PercentageCloser(1.5)), _area(surface, box)

    def ours(v):
        shadow_map = draw_shadow_map(
            square(v.reshape(4, 3)),
            make(none),
            resolution,
            edges=edges,
            capacity=room.triangles,
            silhouette_capacity=room.silhouettes,
        )
        return area(technique.visibility(shadow_map, surface))

    exact = lambda v: lit_area(square(jnp.asarray(v.reshape(4, 3))), towards(np.zeros(parameters)), box)
    flat = jnp.asarray(SQUARE.reshape(-1))
    # All in one program, so that what they share is compiled once.
    (forward, value), backward = jax.jit(lambda v: (jacfwd_and_value(ours)(v), jax.grad(ours)(v)))(flat)
    assert value == pytest.approx(exact(np.asarray(flat)), rel=1e-3)
    truth = difference(exact, flat)
    np.testing.assert_allclose(forward, truth, atol=0.01 * np.abs(truth).max())
    np.testing.assert_allclose(backward, forward, atol=1e-5 * np.abs(truth).max())


CASTERS = {"sphere": {"subdivisions": 3}, "torus": {}, "fence": {}}
USUAL = {("torus", "spot")}
"""What is tried every time; all others are for the patient."""


@pytest.mark.parametrize(
    ("caster", "light"),
    [
        pytest.param(caster, light, marks=[] if (caster, light) in USUAL else pytest.mark.exhaustive)
        for caster in (*CASTERS, "bunny")
        for light in LIGHTS
    ],
)
def test_poses_move_shadows(caster, light, float64):
    mesh = _caster(caster, **CASTERS[caster]) if caster in CASTERS else _centred(_bunny())
    # A point light's map spreads over six faces, and a bunny's triangles are small.
    resolution = 512 if light == "point" or caster == "bunny" else 256
    value, exact, gradient, truth = _gradient(mesh, light, resolution, 1536)
    assert value == pytest.approx(exact, rel=2e-3)
    np.testing.assert_allclose(gradient, truth, atol=0.03 * np.abs(truth).max())


def test_outlines_of_what_lies_on_the_ground_hardly_move_with_the_light():
    # Balls of a few texels, with several edges in each texel, at most `height` above the ground that they shadow. A
    # light at a distance of 4 that moves by 1 moves their shadows by so many texels, and no visibility changes faster.
    height, resolution = 0.07, 128
    ball = library_mesh("sphere", subdivisions=2, radius=0.03)
    places = [(x, 0.04, z) for x in (-0.3, -0.1, 0.1, 0.3) for z in (-0.25, -0.07, 0.12, 0.33)]
    mesh = merge([_moved(ball, place) for place in places])
    texel = 2 * 4 * np.tan(np.radians(CONE)) / resolution
    most = height / (4 - height) / texel
    edges, surface, technique = Edges.of(mesh), _ground(160, (-0.4, 0.4, -0.4, 0.4)), _technique(Bilinear())
    surface = jax.tree.map(lambda a: a.astype(jnp.float32) if a.dtype == np.float64 else a, surface)
    room = plan_shadow_map(mesh, _spot(jnp.zeros(5)), (resolution, resolution), edges=edges)

    def visibility(x):
        shadow_map = draw_shadow_map(
            mesh,
            _spot(jnp.zeros(5).at[0].set(x)),
            (resolution, resolution),
            edges=edges,
            capacity=room.triangles,
            silhouette_capacity=room.silhouettes,
        )
        return technique.visibility(shadow_map, surface)

    _, change = jax.jit(lambda x: jax.jvp(visibility, (x,), (jnp.ones(()),)))(jnp.zeros(()))
    assert np.sum(np.abs(change) > 0.1 * most) > 300
    # A chord turns as its ends move, so that parts of it go a little further.
    assert np.abs(change).max() < 2 * most, (np.abs(change).max(), most)


def _scene(resolution=(48, 48), light=None):
    """A tilted square over the ground, which fills neither texels nor the map evenly."""
    mesh, light = Mesh(jnp.asarray(SQUARE, jnp.float32), jnp.array([[0, 1, 2], [0, 2, 3]])), light or _sun(jnp.zeros(2))
    edges = Edges.of(mesh)
    return mesh, light, edges, draw_shadow_map(mesh, light, resolution, edges=edges)


FILTERS = {
    "nearest": Nearest(),
    "bilinear": Bilinear(),
    "four_tap": FourTap(1.0),
    "pcf": PercentageCloser(1.5),
    "tent": Tent(2.0),
    "castano": Castano(3),
    "random_disk": RandomDisk(2.0, stratified(8, 4)),
    "pcss": PercentageCloserSoft(1.0, stratified(4, 4), stratified(8, 4)),
}


FEW = ("nearest", "pcf", "random_disk")
"""Which are tried every time."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in FEW else pytest.mark.exhaustive) for name in FILTERS]
)
def test_every_filter_sees_the_outline(name):
    """The area in light is as large as it is, where the plain map's is off by parts of texels."""
    mesh, _, _, shadow_map = _scene()
    box = (-0.8, 0.5, -0.4, 0.7)
    surface, technique = _ground(160, box), _technique(FILTERS[name])
    surface = jax.tree.map(lambda a: a.astype(jnp.float32) if a.dtype == np.float64 else a, surface)
    exact = lit_area(mesh, [0.3, 1.0, -0.2, 0], box)
    fine = float(_area(surface, box)(_visibility(technique, shadow_map, surface)))
    # A spread of samples is as good as it is.
    allowed = {"random_disk": 4e-3, "pcss": 8e-3}.get(name, 2e-3)
    assert fine == pytest.approx(exact, abs=allowed)


def test_receivers_that_move_see_outlines_pass_and_no_steps_between_texels():
    """A light that moves takes texels along: what only depends on where these lie, such as acne, has no derivative."""
    shadow_map = _scene()[-1]
    rng = np.random.default_rng(0)
    # Half of the square: the border of what is looked at crosses it.
    x, y = rng.uniform(4, 24, (120, 120)), rng.uniform(4, 44, (120, 120))
    depths = np.asarray(shadow_map.depth)
    depths = depths[depths < 1]
    # Among the square's depths, which of its texels shadow changes from one to the next; beyond them, all do.
    among, beyond = float(np.median(depths)), float(depths.max()) + 0.01

    @eqx.filter_jit
    def lit(shadow_map, lookup, along):
        moved = dataclasses.replace(lookup, texel=lookup.texel + along * jnp.array([1.0, 0.0]))
        return jnp.sum(Bilinear()(shadow_map, moved, HardCompare()))

    at = lambda depth: lookups_at(x, y, depth)
    slope = lambda depth, of: float(jax.jacfwd(lambda along: lit(of, at(depth), along))(jnp.float32(0)))
    outlines = shadow_map.silhouettes
    none = dataclasses.replace(
        shadow_map, silhouettes=dataclasses.replace(outlines, slot=jnp.full_like(outlines.slot, -1))
    )
    plain = dataclasses.replace(shadow_map, silhouettes=None)
    assert slope(among, none) == 0 != slope(among, plain)
    step = 0.25
    ahead, behind = (float(lit(shadow_map, at(beyond), jnp.float32(sign * step))) for sign in (1, -1))
    assert slope(beyond, shadow_map) == pytest.approx((ahead - behind) / (2 * step), rel=0.05)


def test_hard_shadows_end_where_casters_do():
    _, _, _, shadow_map = _scene((32, 32))
    surface = _ground(200, WIDE)
    visibility = np.asarray(_visibility(_technique(Nearest()), shadow_map, surface))
    without = dataclasses.replace(shadow_map, silhouettes=None)
    plain = np.asarray(_visibility(_technique(Nearest()), without, surface))
    # Points of the ground are in shadow where the way to the light meets the square.
    to_light = np.array([0.3, 1.0, -0.2])
    at_caster = np.asarray(surface.position)[..., [0, 2]] + to_light[[0, 2]]
    hidden = np.ones(visibility.shape, bool)
    corners = SQUARE[:, [0, 2]]
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        way = b - a
        hidden &= way[0] * (at_caster[..., 1] - a[1]) - way[1] * (at_caster[..., 0] - a[0]) < 0
    assert 0.1 < hidden.mean() < 0.6
    wrong, wrong_plain = np.mean(visibility == hidden), np.mean(plain == hidden)
    assert wrong < 5e-4 < 0.01 < wrong_plain


def test_a_rim_does_not_shadow_itself():
    sphere = library_mesh("sphere", subdivisions=3)
    light = DirectionalLight.around(jnp.array([0.3, -1.0, 0.2]), sphere.vertices)
    surface = draw_surface(
        sphere, PinholeCamera((-1.5, 2, 1), (0, 0.5, 0), fov_y=40, near=0.1, far=10, resolution=(96, 96))
    )
    shadow_map = draw_shadow_map(sphere, light, (32, 32), edges=Edges.of(sphere))
    technique = ShadowMapping(Nearest(), Bias(0, 0, 0, plane=ReceiverPlane(deepening=0)))
    visibility = np.asarray(_visibility(technique, shadow_map, surface))
    cosine = -np.asarray(surface.normal) @ normalize(light.direction)
    facing = np.asarray(surface.mask) & (cosine > 0.02)
    assert facing.sum() > 1000
    assert (visibility[facing] == 1).all()


def test_a_thin_bar_between_texel_centres_casts_a_shadow():
    bar = np.array([[-0.9, 1, 0.03], [-0.9, 1, 0.045], [0.9, 1, 0.045], [0.9, 1, 0.03]])
    mesh = Mesh(jnp.asarray(bar, jnp.float32), jnp.array([[0, 1, 2], [0, 2, 3]]))
    light = DirectionalLight(jnp.array([0.0, -1.0, 0.0]), jnp.zeros(3), jnp.array([2.0, 2.0]), -2.0, 2.0)
    # Texels are 0.05 wide: the bar covers 0.3 of one row's height, and misses its texels' corners and centres.
    shadow_map = draw_shadow_map(mesh, light, (40, 40), edges=Edges.of(mesh))
    assert np.all(shadow_map.depth == 1)
    box = (-0.5, 0.5, -0.2, 0.2)
    surface = _ground(100, box)
    lit = _area(surface, box)(_visibility(_technique(PercentageCloser(1.0)), shadow_map, surface))
    assert lit == pytest.approx(0.4 - 0.015, abs=2e-4)


def test_point_lights_find_silhouettes_in_all_their_maps():
    mesh, _, _, shadow_map = _scene((96, 96), _point(jnp.zeros(3)))
    assert shadow_map.silhouettes.slot.shape == shadow_map.depth.shape == (6, 96, 96)
    box = (-1.1, 0.9, -1.0, 0.9)
    surface = _ground(160, box)
    lit = _area(surface, box)(_visibility(_technique(PercentageCloser(1.0)), shadow_map, surface))
    assert lit == pytest.approx(lit_area(mesh, [*PLACE, 1], box), abs=2e-3)


def test_variance_maps_hold_the_mean_over_a_texel():
    mesh, _, _, shadow_map = _scene()
    share = shadow_map.silhouettes.mean_of(lambda depth: jnp.where(depth < 1, 1.0, 0.0), shadow_map.depth)
    # Seen along the light, the square is as large as its shadow times the sine of the light's elevation.
    whole = (-2.0, 2.0, -2.0, 2.0)
    shadow = 16 - lit_area(mesh, [0.3, 1.0, -0.2, 0], whole)
    seen = shadow / np.sqrt(1 + 0.3**2 + 0.2**2)
    assert float(jnp.sum(share)) * (2.2 / 48) ** 2 == pytest.approx(seen, rel=1e-3)
    surface = _ground(64, WIDE)
    _, slope = jax.jvp(lambda m: _technique(VarianceShadowMap(1.5)).visibility(m, surface), *_shifted(shadow_map))
    assert float(jnp.max(jnp.abs(slope))) > 0.01


def _shifted(shadow_map):
    """A map, and the change of it by which the first half-plane of each silhouette moves a texel."""
    still = jax.tree.map(
        lambda a: np.zeros(a.shape, a.dtype if a.dtype == np.float32 else jax.dtypes.float0), shadow_map
    )
    where = lambda m: m.silhouettes.planes[0].offset
    return (shadow_map,), (eqx.tree_at(where, still, jnp.ones_like(where(shadow_map))),)


def test_without_edges_nothing_is_kept_or_changed():
    mesh, light, _, shadow_map = _scene()
    plain = draw_shadow_map(mesh, light, (48, 48))
    assert plain.silhouettes is None
    np.testing.assert_array_equal(plain.depth, shadow_map.depth)


def test_corners_of_texels_become_the_centres_of_pixels():
    height, width = 3, 7
    column, row = np.meshgrid(np.arange(width + 1), np.arange(height + 1))
    clip = np.stack([2 * column / width - 1, 2 * row / height - 1, 0 * row, 0 * row + 1], axis=-1).reshape(-1, 4)
    about = np.asarray(_about_corners(jnp.asarray(clip, jnp.float32), (height, width)))
    window = (about[:, :2] + 1) / 2 * [width + 1, height + 1]
    np.testing.assert_allclose(window, np.stack([column, row], axis=-1).reshape(-1, 2) + 0.5, atol=1e-5)


def test_no_marked_texel_within_reach_is_overlooked():
    marked = np.zeros((9, 14), bool)
    marked[2, 11] = marked[7, 3] = True
    x, y = (v.ravel() for v in np.meshgrid(np.arange(-3, 17, 0.7), np.arange(-3, 12, 0.7)))
    row, column = np.nonzero(marked)
    for reach in (0.0, 0.4, 0.5, 0.9, 1.5, 2.5, 4.0, 20.0):
        found = _Pyramid.of(jnp.asarray(marked)).any_within(
            jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32), None, jnp.float32(reach)
        )
        across = np.maximum(column - x[:, None], x[:, None] - column - 1)
        upwards = np.maximum(row - y[:, None], y[:, None] - row - 1)
        within = (np.maximum(across, upwards) < reach - 1e-3).any(axis=1)
        assert np.asarray(found)[within].all()
        assert reach > 1.5 or not np.asarray(found).all()


def test_too_little_room_is_told():
    mesh, light, edges, _ = _scene()
    with pytest.raises(Exception, match=r"silhouette capacity of 4 is too small.*plan_shadow_map"):
        draw_shadow_map(mesh, light, (48, 48), edges=edges, silhouette_capacity=4).silhouettes.slot.block_until_ready()
    overflows = []
    draw_shadow_map(mesh, light, (48, 48), edges=edges, silhouette_capacity=4, overflows=overflows)
    assert list(map(bool, overflows)) == [False, False, True]


@pytest.mark.parametrize("settings", [{"layer": "second"}, {"cull": "front"}])
def test_silhouettes_are_of_the_nearest_surface(settings):
    mesh, light, edges, _ = _scene()
    with pytest.raises(ValueError, match=r"silhouettes were asked for.*leave edges out"):
        draw_shadow_map(mesh, light, (48, 48), edges=edges, **settings)
