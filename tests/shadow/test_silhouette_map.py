"""Shadow maps that know where within a texel casters end: areas, derivatives, and every filter."""

import dataclasses
import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image, ImageDraw
from scenes import filled, jacfwd_and_value, lookups_at, surface_at
from scipy import ndimage
from shadow_area_oracle import difference, lit_area

from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    OrthographicCamera,
    PointLight,
    Scene,
    SpotLight,
    library_mesh,
    merge,
)
from diffshadow.io import load_mesh
from diffshadow.raster import Surface, draw_surface
from diffshadow.raster._corners import _about_corners
from diffshadow.reference import trace_visibility
from diffshadow.shadow import (
    Bias,
    Bilinear,
    Castano,
    FourTap,
    HardCompare,
    MapSettings,
    Nearest,
    Pattern,
    PercentageCloser,
    PercentageCloserSoft,
    RandomDisk,
    ReceiverPlane,
    ShadowMapping,
    Tent,
    draw_shadow_map,
    plan_crossings,
    stratified,
)
from diffshadow.shadow._lookup import Lookup
from diffshadow.shadow.kernels import Footprint
from diffshadow.shadow.kernels._padded_silhouettes import BlockBounds
from diffshadow.shadow.silhouettes import WHOLE_TEXEL, HalfPlanes, Rectangle, cut_area

# Meshes of maps that are drawn under a trace are filled up to this, so that they share what is compiled.
SIZES = (1300, 2304, 3500)
# Enough memory for the silhouettes of any mesh that is drawn outside of a trace.
CROSSINGS = 512
POINTS = 160
"""A side of the square array of points that receive shadows."""
UP = (0, 1, 0)
TEXELS = 48
"""A side of most maps."""

BOX = (-0.75, 0.4, -0.8, 0.45)
"""Of the ground: its border crosses the shadows, so that moving them changes the area in light."""


def _spread(number: int, box=BOX) -> np.ndarray:
    """Points (number, 3) of the ground spread evenly, without a grid that texels could be in step with."""
    i = np.arange(number)
    x, z = i * 0.7548776662466927 % 1, i * 0.5698402909980532 % 1
    return np.stack([box[0] + x * (box[1] - box[0]), np.zeros(number), box[2] + z * (box[3] - box[2])], axis=1)


def _ground(box=BOX) -> Surface:
    return surface_at(_spread(POINTS**2, box).reshape(POINTS, POINTS, 3), UP)


def _lit(technique: ShadowMapping, shadow_map, box) -> float:
    """The area in light of `box`."""
    area = (box[1] - box[0]) * (box[3] - box[2])
    return float(np.mean(_visibility(technique, shadow_map, _ground(box)))) * area


def _caster(name: str, **options) -> Mesh:
    return _centred(library_mesh(name, **options))


def _centred(mesh: Mesh) -> Mesh:
    v = np.asarray(mesh.vertices, np.float64)
    v = (v - (v.min(0) + v.max(0)) / 2) / (v.max(0) - v.min(0)).max()
    # Turned, so that no edge runs along a border of the ground: as it crosses one, the area in light has a kink.
    c, s = np.cos(0.35), np.sin(0.35)
    v = v @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    return Mesh(jnp.asarray(v + np.array([0.02, 0.75, -0.03])), mesh.faces)


def _crumpled(seed: int, subdivisions: int, frequency: float) -> np.ndarray:
    """Vertices (v, 3) of a closed sphere whose folds hide each other, crumpled by waves of random directions."""
    rng, ball = np.random.default_rng(seed), library_mesh("sphere", subdivisions=subdivisions)
    at = np.asarray(ball.vertices, np.float64)
    at = at - (at.min(axis=0) + at.max(axis=0)) / 2
    for _ in range(20):
        wave = np.sin(2 * at @ rng.normal(scale=frequency, size=(3, 1)) + rng.uniform(0, 7))
        at = at + 0.08 * rng.normal(size=3) * wave
    return at


def _bunny() -> Mesh:
    path = Path(__file__).parents[3] / "shared" / "meshes" / "bunny.ply"
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
    return DirectionalLight(direction, np.array([0.0, 0.5, 0.0]), np.array([2.2, 2.2]), -3.0, 3.0)


def _spot(by) -> SpotLight:
    direction = jnp.array([-0.12, -1.0, -0.07]) + jnp.stack([by[3], jnp.zeros_like(by[3]), by[4]])
    return SpotLight(jnp.asarray(PLACE, by.dtype) + by[:3], direction, CONE, 1.0, 6.0)


def _point(by) -> PointLight:
    return PointLight(jnp.asarray(PLACE, by.dtype) + by[:3], 0.5, 6.0)


STILL = np.zeros(2, np.float32)
"""A sun in its place."""
LIGHTS = {
    "sun": (_sun, 2, lambda by: [*-(SUN + np.array([by[0], 0, by[1]])), 0]),
    "spot": (_spot, 5, lambda by: [*(PLACE + by[:3]), 1]),
    "point": (_point, 3, lambda by: [*(PLACE + by[:3]), 1]),
}


def _technique(filter_) -> ShadowMapping:
    return ShadowMapping(filter_, Bias(0, 0, 0, plane=ReceiverPlane(deepening=0)), HardCompare())


_visibility = eqx.filter_jit(lambda technique, shadow_map, surface: technique.visibility(shadow_map, surface))


def _draw(mesh: Mesh, light, **how):
    """The map of a mesh, of 48 texels."""
    return draw_shadow_map(mesh, light, (TEXELS, TEXELS), edges=Edges.of(mesh), crossings=CROSSINGS, **how)


# Rows of 256 points, at which derivatives are taken.
ROWS = 512


@eqx.filter_jit
def _follow(make, mesh: Mesh, edges: Edges, resolution: int, crossings: int, by, surface: Surface):
    """Visibility of points (h, w), and its derivative (h, w, p) by the light's pose and the caster's place."""

    def lit(by):
        shadow_map = draw_shadow_map(
            _moved(mesh, by[-3:]),
            make(by),
            (resolution, resolution),
            edges=edges,
            crossings=crossings,
        )
        return _technique(Bilinear()).visibility(shadow_map, surface)

    return jacfwd_and_value(lit)(by)


def _near_outlines(mesh: Mesh, towards, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Which of the ground's points (n, 3) lie within `reach` of a shadow's outline, and which in light."""
    v, light = np.asarray(mesh.vertices, np.float64), np.asarray(towards, np.float64)
    ray = v * light[3] - light[:3]
    shadow = (v - ray * (v[:, 1:2] / ray[:, 1:2]))[:, [0, 2]]
    pixel, low = reach / 8, np.array([BOX[0], BOX[2]]) - 2 * reach
    size = np.ceil((np.array([BOX[1], BOX[3]]) + 2 * reach - low) / pixel).astype(int)
    image = Image.new("L", tuple(size.tolist()))
    draw = ImageDraw.Draw(image)
    for corners in ((shadow[np.asarray(mesh.faces)] - low) / pixel).reshape(-1, 6):
        draw.polygon(corners.tolist(), fill=1)
    hidden = np.asarray(image) == 1
    column, row = ((points[:, [0, 2]] - low) / pixel).astype(int).T
    near = ndimage.maximum_filter(hidden, 19) != ndimage.minimum_filter(hidden, 19)
    return near[row, column], ~hidden[row, column]


def _gradient(mesh: Mesh, light: str, resolution: int, size: int):
    """The area in light and its derivative by the light's pose and the caster's place: ours and exactly.

    Of `size`² points of the ground only those near the shadow's outline are asked for derivatives: elsewhere they are
    zero. Outlines that move without changing the area cancel to a thousandth, so there must be many.
    """
    make, parameters, towards = LIGHTS[light]
    start, points = jnp.zeros(parameters + 3), _spread(size**2)
    edges = Edges.of(mesh)
    if len(mesh.faces) <= SIZES[1]:
        mesh, edges = filled(mesh, edges, *SIZES)
    # Of one number for small meshes, which then share what is compiled.
    crossings = max(2048, plan_crossings(mesh, make(start), (resolution, resolution), edges))
    # Texels of a point light are twice as wide as any other's.
    width = (2.2 if light == "point" else 1.1) * 2 * PLACE[1] * np.tan(np.radians(CONE)) / resolution
    near, lit = _near_outlines(mesh, towards(np.zeros(parameters)), points, 4 * width)
    chosen, box = np.flatnonzero(near), (BOX[1] - BOX[0]) * (BOX[3] - BOX[2])
    assert len(chosen) > 50_000
    values, slopes = 0.0, np.zeros(parameters + 3)
    for first in range(0, len(chosen), ROWS * 256):
        part = chosen[first : first + ROWS * 256]
        surface = surface_at(points[np.resize(part, (ROWS, 256))], UP)
        slope, value = _follow(make, mesh, edges, resolution, crossings, start, surface)
        values += np.asarray(value).ravel()[: len(part)].sum()
        slopes += np.asarray(slope).reshape(-1, parameters + 3)[: len(part)].sum(axis=0)

    exact = lambda by: lit_area(_moved(mesh, by[parameters:]), towards(by[:parameters]), BOX)
    value = (values + (lit & ~near).sum()) / size**2 * box
    return value, exact(np.zeros(parameters + 3)), slopes / size**2 * box, difference(exact, start)


@pytest.fixture
def float64():
    with jax.enable_x64(True):
        yield


_cut = jax.jit(cut_area)


@jax.jit
def _turned_cuts(values):
    """The area that two half-planes at angles leave of rectangles, and its derivatives, for each of many."""

    def area_of(values):
        angles, offsets = values[4:6], values[6:]
        return cut_area(Rectangle(*values[:4]), HalfPlanes(jnp.cos(angles), jnp.sin(angles), offsets))

    area, pull = jax.vjp(area_of, values)
    return area, pull(jnp.ones_like(area))[0]


@pytest.mark.parametrize("seed", range(4))
def test_cut_area_is_that_of_the_clipped_polygon(seed, float64):
    rng = np.random.default_rng(seed)
    angles, offsets = rng.uniform(0, 2 * np.pi, (2, 50)), rng.uniform(-0.5, 0.5, (2, 50))
    low, size = rng.uniform(-0.5, 0, (2, 50)), rng.uniform(0.1, 0.5, (2, 50))
    values = np.stack([low[0], low[0] + size[0], low[1], low[1] + size[1], *angles, *offsets])
    area, gradient = _turned_cuts(values)
    for i in range(50):
        polygon = [(low[0, i], low[1, i]), (low[0, i] + size[0, i], low[1, i])]
        polygon += [(x, low[1, i] + size[1, i]) for x, _ in polygon[::-1]]
        for angle, offset in zip(angles[:, i], offsets[:, i], strict=True):
            polygon = _clip(polygon, np.array([np.cos(angle), np.sin(angle)]), offset)
        assert area[i] == pytest.approx(_shoelace(polygon), abs=1e-12)
    for k, step in enumerate(np.eye(len(values))[..., None] * 1e-6):
        change = np.asarray(_turned_cuts(values + step)[0]) - np.asarray(_turned_cuts(values - step)[0])
        np.testing.assert_allclose(gradient[k], change / 2e-6, atol=1e-5)


def test_half_planes_that_end_on_a_side_of_the_rectangle():
    part = Rectangle(-0.5, 0.25, -0.125, 0.5)
    corners = [(part.left, part.below), (part.right, part.below), (part.right, part.above), (part.left, part.above)]
    on_sides = [(sign, 0, sign * side) for sign in (1, -1) for side in part[:2]]
    on_sides += [(0, sign, sign * side) for sign in (1, -1) for side in part[2:]]
    pairs = np.array([(one, other) for one in on_sides for other in [*on_sides, (0.6, 0.8, 0.125)]])
    areas = np.asarray(_cut(part, HalfPlanes(*pairs.T.astype(np.float32))))
    for area, pair in zip(areas, pairs, strict=True):
        polygon = corners
        for x, y, offset in pair:
            polygon = _clip(polygon, np.array([x, y]), offset)
        assert area == pytest.approx(_shoelace(polygon), abs=1e-7), pair


def test_one_half_plane_twice():
    # 72 pairs, as in the test above, so that both tests share a program.
    through_middle = np.float32([0.6, 0.8, 0.0])
    of_signs = lambda *signs: HalfPlanes(*np.multiply.outer(through_middle, np.tile(signs, (72, 1)).T))
    # A line through the middle halves a texel.
    assert _cut(WHOLE_TEXEL, of_signs(1, 1)) == pytest.approx(0.5, abs=1e-7)
    assert _cut(WHOLE_TEXEL, of_signs(1, -1)) == pytest.approx(0, abs=1e-7)


def test_two_half_planes_of_nearly_one_line():
    rng = np.random.default_rng(0)
    angles, offsets = rng.uniform(0, 2 * np.pi, 72), rng.uniform(-0.4, 0.4, 72)
    one = np.stack([np.cos(angles), np.sin(angles), offsets])
    pair = lambda other: HalfPlanes(*np.stack([one, other], axis=1).astype(np.float32))
    once = np.asarray(_cut(WHOLE_TEXEL, pair(np.broadcast_to([[0], [0], [-1e3]], one.shape))))
    # Lines of collinear edges differ by rounding.
    for noise in (0, 1e-7, 1e-6):
        twice = _cut(WHOLE_TEXEL, pair(one + rng.uniform(-noise, noise, one.shape)))
        np.testing.assert_allclose(twice, once, atol=1e-5)
    # The other side of the line has nothing in common with it.
    np.testing.assert_allclose(_cut(WHOLE_TEXEL, pair(-one)), 0, atol=1e-6)


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


CASTERS = {"sphere": {"subdivisions": 3}, "fence": {}}
# Each light once.
POSES = [("sphere", "sun"), ("fence", "point"), ("bunny", "spot")]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("caster", "light"), POSES)
def test_poses_move_shadows(caster, light, float64):
    mesh = _caster(caster, **CASTERS[caster]) if caster in CASTERS else _centred(_bunny())
    # A point light's map spreads over six faces, and a bunny's triangles are small.
    resolution = 512 if light == "point" or caster == "bunny" else 256
    value, exact, gradient, truth = _gradient(mesh, light, resolution, 1536)
    assert value == pytest.approx(exact, rel=2e-3)
    np.testing.assert_allclose(gradient, truth, atol=0.03 * np.abs(truth).max())


def _square() -> Mesh:
    """Tilted, over the ground: it fills neither texels nor the map evenly."""
    return Mesh(jnp.asarray(SQUARE, jnp.float32), jnp.array([[0, 1, 2], [0, 2, 3]]))


@functools.cache
def _scene():
    """The square's map under the sun."""
    return _draw(_square(), _sun(STILL))


def _without_silhouettes(shadow_map):
    """The map as if it had none, for the same programs."""
    slot = shadow_map.silhouettes.slot
    empty = dataclasses.replace(shadow_map.silhouettes, slot=jnp.asarray(np.full(slot.shape, -1, np.int32)))
    return dataclasses.replace(shadow_map, silhouettes=empty)


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


FEW = ("pcf",)
"""Which are tried every time. Others see the outline of the nearest texel."""


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in FEW else pytest.mark.exhaustive) for name in FILTERS]
)
def test_every_filter_sees_the_outline(name):
    """The area in light is as large as it is, where the plain map's is off by parts of texels."""
    box = (-0.8, 0.5, -0.4, 0.7)
    exact = lit_area(_square(), [0.3, 1.0, -0.2, 0], box)
    # A spread of samples is as good as it is.
    allowed = {"random_disk": 4e-3, "pcss": 8e-3}.get(name, 2e-3)
    assert _lit(_technique(FILTERS[name]), _scene(), box) == pytest.approx(exact, abs=allowed)


@eqx.filter_jit
def _along_x(shadow_map, lookup, along):
    """The sum of all look-ups moved by so many texels, and its derivative."""

    def lit(along):
        moved = lookup.at(lookup.x + along, lookup.y)
        return jnp.sum(Bilinear()(shadow_map, moved, HardCompare()))

    return jacfwd_and_value(lit)(along)


@pytest.mark.exhaustive
def test_receivers_that_move_see_outlines_pass_and_no_steps_between_texels():
    """A light that moves takes texels along: what only depends on where these lie, such as acne, has no derivative."""
    shadow_map = _scene()
    rng = np.random.default_rng(0)
    # Half of the square: the border of what is looked at crosses it.
    x, y = rng.uniform(4, 24, (120, 120)), rng.uniform(4, 44, (120, 120))
    depths = np.asarray(shadow_map.depth)
    depths = depths[depths < 1]
    # Among the square's depths, which of its texels shadow changes from one to the next; beyond them, all do.
    among, beyond = float(np.median(depths)), float(depths.max()) + 0.01

    def slope_and_value(depth, of, along=0.0):
        return [float(found) for found in _along_x(of, lookups_at(x, y, depth), jnp.float32(along))]

    plain = dataclasses.replace(shadow_map, silhouettes=None)
    assert slope_and_value(among, _without_silhouettes(shadow_map))[0] == 0 != slope_and_value(among, plain)[0]
    step = 0.25
    ahead, behind = (slope_and_value(beyond, shadow_map, sign * step)[1] for sign in (1, -1))
    assert slope_and_value(beyond, shadow_map)[0] == pytest.approx((ahead - behind) / (2 * step), rel=0.05)


@pytest.mark.exhaustive
def test_texels_are_corrected_where_each_pixel_of_a_tile_taps():
    """A pixel in a tile of four sees what it sees where all pixels have its own offsets."""
    shadow_map, rng = _scene(), np.random.default_rng(0)
    # Behind the square, whose outline all taps are near.
    x, y = rng.uniform(8, 40, (2, 32, 64))
    lookup = lookups_at(x, y, 0.9)
    offsets = rng.uniform(-0.7, 0.7, (3, 2, 2, 2)).astype(np.float32)
    lit = lambda own: np.asarray(_disk(shadow_map, lookup, RandomDisk(2.0, Pattern(jnp.asarray(own)))))
    together = lit(offsets)
    assert np.sum((together % (1 / 3) > 0.01) & (together % (1 / 3) < 0.32)) > 100
    for i in range(2):
        for j in range(2):
            alone = lit(offsets[:, i : i + 1, j : j + 1])
            np.testing.assert_allclose(together[i::2, j::2], alone[i::2, j::2], atol=1e-5)


_disk = eqx.filter_jit(lambda shadow_map, lookup, filter_: filter_(shadow_map, lookup, HardCompare()))


@pytest.mark.exhaustive
def test_a_silhouettes_texel_holds_the_depth_of_what_lies_behind():
    """Of the square over a ground that reaches beyond the map."""
    found = _draw(merge([_square(), library_mesh("plane", size=6, segments=10)]), _sun(STILL))
    depth, slot = np.asarray(found.depth), np.asarray(found.silhouettes.slot)
    both = np.stack([found.silhouettes.inner, found.silhouettes.outer])[:, slot[slot >= 0]]
    assert both.shape[1] > 40
    assert both.max() <= depth.max() < 1
    # The square hovers by a sixth of the light's depths.
    assert (np.ptp(both, axis=0) > 0.1).all()


@pytest.mark.exhaustive
def test_a_rim_does_not_shadow_itself():
    sphere = library_mesh("sphere", subdivisions=1)
    direction = np.array([0.3, -1.0, 0.2])
    light = DirectionalLight.around(jnp.asarray(direction, jnp.float32), sphere.vertices)
    shadow_map = _draw(sphere, light)
    # Points all over the faces turned to the light that are seen from one side.
    rng, corners = np.random.default_rng(0), np.asarray(sphere.vertices, np.float64)[np.asarray(sphere.faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    turned = -normals @ direction > 0.02 * np.linalg.norm(direction)
    seen = np.sum(normals * (np.array([-1.5, 2, 1]) - corners[:, 0]), axis=1) > 0
    facing = np.flatnonzero(turned & seen)
    own = facing[rng.integers(0, len(facing), (POINTS, POINTS))]
    points = np.einsum("hwk,hwkc->hwc", rng.dirichlet(np.ones(3), own.shape), corners[own])
    visibility = np.asarray(_visibility(_technique(Nearest()), shadow_map, surface_at(points, normals[own])))
    assert (visibility == 1).all()


@pytest.mark.exhaustive
def test_no_light_leaks_into_the_shadows_of_60_crumpled_spheres():
    """On a wall behind them, more than two pixels from what rays find to be the outline."""
    size, way = 128, np.array([0.0, 0.0, -1.0])
    wall = Mesh(np.array([[-2, -2, -2], [2, -2, -2], [2, 2, -2], [-2, 2, -2]]), np.array([[0, 1, 2], [0, 2, 3]]))
    camera = OrthographicCamera(1.5 * way, 2 * way, UP, height=2.0, near=0.1, far=1.0, resolution=(size, size))
    light = DirectionalLight(way, np.zeros(3), (2.0, 2.0), -3.5, 3.5)
    settings = MapSettings((size, size), silhouettes=True)
    technique = ShadowMapping(Bilinear(), Bias(0), map=settings)
    faces = library_mesh("sphere", subdivisions=4).faces
    for seed in range(60):
        vertices = _crumpled(seed, 4, (2.0, 4.0, 8.0, 20.0)[seed % 4])
        mesh = Mesh(vertices / np.abs(vertices).max(axis=0) * [0.7, 0.7, 1.0], faces)
        scene = Scene([mesh, wall], camera, light, casts=(True, False))
        surface = draw_surface(scene.mesh, camera)
        found = np.asarray(technique.visibility(technique.prepare(scene), surface))
        traced = np.asarray(trace_visibility(scene, samples=1, supersampling=4).visibility)
        deep = ndimage.maximum_filter(traced, 5) == ndimage.minimum_filter(traced, 5)
        assert np.sum(deep & (traced == 0)) > 100
        np.testing.assert_allclose(found[deep], traced[deep], atol=0.02, err_msg=f"seed {seed}")


@pytest.mark.exhaustive
def test_a_thin_bar_between_texel_centres_casts_a_shadow():
    bar = np.array([[-0.7, 1, 0.03], [-0.7, 1, 0.045], [0.7, 1, 0.045], [0.7, 1, 0.03]])
    mesh = Mesh(jnp.asarray(bar, jnp.float32), jnp.array([[0, 1, 2], [0, 2, 3]]))
    light = DirectionalLight(jnp.array([0.0, -1.0, 0.0]), jnp.zeros(3), jnp.array([2.4, 2.4]), -2.0, 2.0)
    # Texels are 0.05 wide: the bar covers 0.3 of one row's height, and misses its texels' corners and centres.
    shadow_map = _draw(mesh, light)
    assert np.all(np.asarray(shadow_map.depth) == 1)
    lit = _lit(_technique(FILTERS["pcf"]), shadow_map, (-0.5, 0.5, -0.2, 0.2))
    assert lit == pytest.approx(0.4 - 0.015, abs=2e-4)


@pytest.mark.exhaustive
def test_point_lights_find_silhouettes_in_all_their_maps():
    light, size, edges = _point(np.zeros(3, np.float32)), (2 * TEXELS, 2 * TEXELS), Edges.of(_square())
    shadow_map = draw_shadow_map(_square(), light, size, edges=edges, crossings=CROSSINGS)
    assert shadow_map.silhouettes.slot.shape == shadow_map.depth.shape == (6, *size)
    box = (-1.1, 0.9, -1.0, 0.9)
    exact = lit_area(_square(), [*PLACE, 1], box)
    assert _lit(_technique(Bilinear()), shadow_map, box) == pytest.approx(exact, abs=2e-3)


def test_without_edges_nothing_is_kept_or_changed():
    plain = draw_shadow_map(_square(), _sun(STILL), (TEXELS, TEXELS))
    assert plain.silhouettes is None
    np.testing.assert_array_equal(plain.depth, _scene().depth)


@pytest.mark.exhaustive
def test_crossings_are_planned_if_they_are_not_given():
    planned = draw_shadow_map(_square(), _sun(STILL), (TEXELS, TEXELS), edges=Edges.of(_square()))
    np.testing.assert_array_equal(planned.silhouettes.slot >= 0, _scene().silhouettes.slot >= 0)


def test_corners_of_texels_become_the_centres_of_pixels():
    height, width = 3, 7
    column, row = np.meshgrid(np.arange(width + 1), np.arange(height + 1))
    clip = np.stack([2 * column / width - 1, 2 * row / height - 1, 0 * row, 0 * row + 1], axis=-1).reshape(-1, 4)
    about = np.asarray(_about_corners(jnp.asarray(clip, jnp.float32), (height, width)))
    window = (about[:, :2] + 1) / 2 * [width + 1, height + 1]
    np.testing.assert_allclose(window, np.stack([column, row], axis=-1).reshape(-1, 2) + 0.5, atol=1e-5)


@pytest.mark.parametrize("bound", [None, 0.6, 0.4])
def test_depths_within_reach_are_those_of_the_receiver_plane(bound):
    rng, count, reach = np.random.default_rng(4), 200, 1.5
    texel, slope = rng.uniform(3, 9, (count, 2)), rng.normal(scale=0.05, size=(count, 2))
    depth = np.full(count, 0.5)
    deepest = None if bound is None else jnp.full(count, bound)
    at = Lookup(*map(jnp.asarray, (texel, depth, depth, depth > 0, slope)), deepest=deepest)
    low, high = map(np.asarray, at.depths_within(jnp.float32(reach)))
    first = np.floor(texel - reach)
    footprint = Footprint(*jnp.asarray(first.T), [], [])
    across = [(i, j) for i in range(4) for j in range(4)]
    depths = np.array([footprint.depth(at, i, j) for i, j in across])
    reached = np.array([np.all(first + np.array(step) < texel + reach, axis=1) for step in across])
    assert reached.any(axis=0).all()
    assert ((low <= depths) & (depths <= high))[reached].all()
    if bound is None:
        assert np.median((high - low) / np.ptp(depths, axis=0)) < 2
    else:
        assert high.max() <= np.float32(bound)


@jax.jit
def _blocks_may_part(bounds, x, y, reach, depths):
    at = Lookup(jnp.stack([x, y], axis=-1), x, x, x > 0)
    return BlockBounds.of(bounds).may_part(at, reach, depths)


@pytest.mark.parametrize("depths", [None, (0.3, 0.3), (0.1, 0.9), (0.65, 0.8)])
def test_no_silhouette_within_reach_is_overlooked(depths):
    """Nor are silhouettes found that are out of reach, beyond a block or two, or whose parts compare alike."""
    size, parts = (9, 14), {(2, 11): (0.2, 0.5), (7, 3): (0.6, 0.7)}
    bounds = np.full(size, 65535 << 16, np.uint32)
    for texel, (near, far) in parts.items():
        bounds[texel] = int(near * 65535) << 16 | int(far * 65535)
    low, high = (0, 1) if depths is None else depths
    seen = [texel for texel, (near, far) in parts.items() if near <= high and low <= far]
    x, y = (np.float32(v.ravel()) for v in np.meshgrid(np.arange(-3, 17, 0.7), np.arange(-3, 12, 0.7)))
    row, column = np.array(seen).T
    on_map = (x >= 0) & (x <= size[1]) & (y >= 0) & (y <= size[0])
    given = depths and tuple(np.full(x.shape, depth, np.float32) for depth in depths)
    for reach in (0.0, 0.4, 0.5, 0.9, 1.5, 2.5, 4.0, 20.0):
        found = np.asarray(_blocks_may_part(bounds, x, y, np.float32(reach), given))
        across = np.maximum(column - x[:, None], x[:, None] - column - 1)
        upwards = np.maximum(row - y[:, None], y[:, None] - row - 1)
        away = np.maximum(across, upwards).min(axis=1)
        assert found[away < reach - 1e-3].all()
        assert not found[on_map & (away > reach + max(1, 4 * reach / 3))].any()


def test_too_little_memory_for_crossings_is_an_error():
    # Twenty squares have more outline than there is memory for.
    mesh = merge([_moved(_square(), (0, 0.01 * k, 0)) for k in range(20)])
    with pytest.raises(Exception, match=rf"memory for {CROSSINGS} crossings.*plan_crossings"):
        jax.block_until_ready(_draw(mesh, _sun(STILL)))
    overflows = [_draw(each, _sun(STILL), raises=False).overflow for each in (mesh, _square())]
    assert list(map(bool, overflows)) == [True, False]


@pytest.mark.parametrize("settings", [{"depth_layer": "second"}, {"cull": "front"}])
def test_silhouettes_are_of_the_nearest_surface(settings):
    with pytest.raises(ValueError, match=r"edges were given with depth_layer.*leave edges out"):
        draw_shadow_map(_square(), _sun(STILL), (TEXELS, TEXELS), edges=Edges.of(_square()), **settings)


def test_silhouettes_need_room_for_the_corners_of_texels():
    with pytest.raises(ValueError, match=r"map of \(8192, 16\) texels.*expected at most 8191 per side"):
        draw_shadow_map(_square(), _sun(STILL), (8192, 16), edges=Edges.of(_square()))
