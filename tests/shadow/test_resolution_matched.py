"""Resolution-matched maps: pages equal the plain map to the bit, requests follow a closed form, and texels get larger
where memory is short."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import floor_and_card, lamp, quad, side_camera, sun

from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    Pages,
    PinholeCamera,
    Scene,
    cell_of,
    library_mesh,
    merge,
    scaling,
    translation,
)
from diffshadow.raster import draw_surface, rasterize
from diffshadow.shadow import (
    Bias,
    Nearest,
    PercentageCloser,
    PercentageCloserSoft,
    ReceiverPlane,
    ResolutionMatched,
    ShadowMap,
    ShadowMapping,
    SingleMap,
    SoftCompare,
    Tent,
    VarianceShadowMap,
    draw_shadow_map,
)
from diffshadow.shadow.layouts import PagedLight
from diffshadow.shadow.layouts._resolution_matched import levels_needed


@pytest.fixture(scope="module", autouse=True)
def compiled_alike():
    """Pages are compared with whole maps bit for bit, so neither reuses a program of tests before that is optimized."""
    jax.clear_caches()


PAGE, GUTTER, WIDE = 16, 6, 64
"""Sides of a page and of the map at level 0, and the gutter, in texels."""
LEVELS = 3
SIDE = PAGE + 2 * GUTTER
LAYERS = 22
"""One more than there are pages at all levels."""


def pages_of(chosen) -> Pages:
    """The pages whose numbers are `chosen`, and the root."""
    resident = np.zeros(Pages.total(LEVELS), bool)
    resident[chosen], resident[-1] = True, True
    return Pages.of(jnp.asarray(resident), PAGE, GUTTER, LEVELS, LAYERS)


def paged(light, camera, chosen) -> PagedLight:
    pages, zero = pages_of(chosen), jnp.zeros(())
    return PagedLight(light, camera.view(), camera.far, pages, pages.finest(), pages.count, zero, zero, zero)


def scene_and_surface():
    # Large faces, and small ones, of which some touch a page's gutter alone.
    ball = library_mesh("sphere", subdivisions=1).transformed(translation(jnp.array([-1.2, 0.8, 0.8])) @ scaling(1.6))
    mesh, camera = merge([floor_and_card(), ball]), side_camera()
    return Scene(mesh, camera, sun(mesh)), draw_surface(mesh, camera)


FINEST = np.arange((WIDE // PAGE) ** 2)
SOME = [0, 5, 6, 10, 17, 19]
"""Some pages of levels 0 and 1."""


def window_of(whole, pages, layer) -> np.ndarray:
    (x, y), side = np.asarray(pages.tile.origin[layer]), pages.side
    return np.asarray(whole)[y : y + side, x : x + side]


@pytest.mark.parametrize("depth_layer", ["nearest", pytest.param("midpoint", marks=pytest.mark.exhaustive)])
def test_pages_are_parts_of_the_plain_map_bit_for_bit(depth_layer):
    scene, _ = scene_and_surface()
    settings = {"depth_layer": depth_layer, "polygon_offset": (1.5, 4.0)} if depth_layer == "midpoint" else {}
    plain = {
        side: draw_shadow_map(scene.mesh, scene.light, (side, side), **settings).depth
        for side in (WIDE, WIDE // 2, SIDE)
    }
    assert 0.2 < float(jnp.mean(plain[WIDE] < 1)) < 0.9
    for chosen in (FINEST, SOME):
        light = paged(scene.light, scene.camera, chosen)
        drawn = draw_shadow_map(scene.mesh, light, (SIDE, SIDE), **settings)
        assert int(light.pages.count) == len(chosen) + 1
        for layer in range(len(chosen) + 1):
            size = int(light.pages.tile.size[layer])
            assert size == {0: WIDE, 1: WIDE // 2, 2: SIDE}[int(light.pages.level[layer])]
            np.testing.assert_array_equal(drawn.depth[layer], window_of(plain[size], light.pages, layer))
        # Layers without a page stay empty.
        assert float(drawn.depth[len(chosen) + 1 :].min()) == 1


# Steps of these filters are whole texels. Other steps are rounded with the look-up's place in the map, or in the page.
WHOLE_STEPS = {"percentage closer": PercentageCloser(3.0), "tent": Tent(2.0)}
OTHER_STEPS = {
    "soft": PercentageCloserSoft(2.0, max_radius=3.0),
    "variance": VarianceShadowMap(radius=2.0),
}
ROUNDING = 1e-5
_FEW = ("percentage closer",)
BIASES = {"slope": Bias(0.5, 1.0), "plane": Bias(0.5, plane=ReceiverPlane(), normal_offset=0.7)}


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in _FEW else pytest.mark.exhaustive) for n in (*WHOLE_STEPS, *OTHER_STEPS)],
)
def test_lookups_in_pages_are_those_in_the_plain_map_bit_for_bit(name):
    scene, surface = scene_and_surface()
    kernel = {**WHOLE_STEPS, **OTHER_STEPS}[name]
    bias = BIASES["plane" if name == "percentage closer" else "slope"]
    layout = ResolutionMatched(PAGE, WIDE, margin=float(GUTTER))
    whole = draw_shadow_map(scene.mesh, scene.light, (WIDE, WIDE))
    of_pages = draw_shadow_map(scene.mesh, paged(scene.light, scene.camera, FINEST), (SIDE, SIDE))
    shadows = lambda layout, state: np.asarray(
        ShadowMapping(kernel, bias, SoftCompare(0.3), layout=layout).visibility(state, surface)
    )
    expected = shadows(SingleMap(), whole)
    assert 0.02 < (expected[np.asarray(surface.mask)] < 0.5).mean() < 0.9
    atol = 0 if name in WHOLE_STEPS else ROUNDING
    np.testing.assert_allclose(shadows(layout, of_pages), expected, rtol=0, atol=atol)


def test_points_are_looked_up_in_the_finest_page_that_contains_them():
    scene, surface = scene_and_surface()
    light = paged(scene.light, scene.camera, SOME)
    layer = np.asarray(light.layer(surface.position))
    window = np.asarray(scene.light.view().clip(surface.position))[..., :2] * 0.5 + 0.5
    column, row = (np.asarray(cell_of(jnp.asarray(window[..., k]), LEVELS)) for k in range(2))
    pages = light.pages
    layers = {tuple(int(part[k]) for part in (pages.level, pages.row, pages.column)): k for k in range(len(SOME) + 1)}
    expected = [
        next(layers[key] for level in range(3) if (key := (level, r >> level, c >> level)) in layers)
        for r, c in zip(row.flat, column.flat, strict=True)
    ]
    assert len(set(expected)) >= 4
    np.testing.assert_array_equal(layer.ravel(), expected)


def test_every_tap_within_the_gutter_is_in_the_page():
    scene, surface = scene_and_surface()
    light = paged(scene.light, scene.camera, SOME)
    layer = light.layer(surface.position)
    view, tile = light.view().facing(layer), light.pages.tile
    size = np.asarray(tile.size[layer])[..., None]
    texel = np.asarray(view.clip(surface.position))[..., :2] * 0.5 + 0.5
    at = texel * size - np.asarray(tile.origin[layer])
    inside = np.asarray(surface.mask)[..., None] & (texel >= 0) & (texel <= 1)
    is_root = size == SIDE
    # Beyond the border of the whole map there is nothing to read.
    left, right = np.minimum(texel * size, GUTTER), np.minimum((1 - texel) * size, GUTTER)
    assert (at - left >= -1e-3)[inside & ~is_root].all()
    assert (at + right <= SIDE + 1e-3)[inside & ~is_root].all()
    assert (inside & ~is_root).any()


# --- Requests ---

EYE_HEIGHT, HALF = 1.7, 60.0
SIZE = 64
FOCAL = SIZE / 2 / np.tan(np.radians(30))


def ground(zoom=1.0):
    """A ground that a level camera sees up to its far plane, and a vertical light on it."""
    mesh = quad((0, 0, 0), (HALF, 0, 0), (0, 0, -HALF))
    fov = 2 * np.degrees(np.arctan(SIZE / 2 / FOCAL / zoom))
    camera = PinholeCamera(
        (0, EYE_HEIGHT, 20), (0, EYE_HEIGHT, 0), fov_y=fov, near=0.1, far=200.0, resolution=(SIZE, SIZE)
    )
    light = DirectionalLight((0, -1, 0), (0, 0, 0), (2 * HALF, 2 * HALF), -5.0, 5.0)
    return Scene(mesh, camera, light), draw_surface(mesh, camera)


def layout_of(norm="worst", level_bias=0.0, distance=190.0) -> ResolutionMatched:
    """Of 4096² texels; all is nearer than the distance. With one norm, they share what is compiled."""
    return ResolutionMatched(32, 4096, norm=norm, margin=2.0, level_bias=level_bias, shadow_distance=distance)


def pages_for(scene, surface, layout, texels=1024) -> PagedLight:
    return layout.light(scene.light, scene.camera, (texels, texels), surface)


def dark_map(light, layout) -> ShadowMap:
    """A map of these pages that shadows all that it covers."""
    return ShadowMap(jnp.zeros((light.capacity, *layout.layer_resolution((1, 1)))), light)


@eqx.filter_jit
def needed_of(layout, scene, surface):
    return levels_needed(layout, scene.light, scene.camera, surface)


def test_levels_on_a_ground_follow_the_closed_form():
    scene, surface = ground()
    needed, mask = needed_of(layout_of(), scene, surface)
    area, _ = needed_of(layout_of("area"), scene, surface)
    mask = np.asarray(mask)
    assert mask.sum() > 1000
    z, texel = 20 - np.asarray(surface.position, np.float64)[mask][:, 2], 2 * HALF / 4096
    across, along = z / (texel * FOCAL), z**2 / (texel * FOCAL * EYE_HEIGHT)
    np.testing.assert_allclose(np.asarray(area)[mask], np.log2(across * along) / 2, atol=2e-3)
    # Beside the middle of the image, points that move away also move sideways on the screen.
    middle = np.nonzero(mask)[1] == SIZE // 2
    assert middle.sum() > 20
    expected = np.log2(np.minimum(across, along))
    np.testing.assert_allclose(np.asarray(needed)[mask][middle], expected[middle], atol=2e-3)
    assert (np.asarray(needed)[mask] <= expected + 2e-3).all()


@pytest.mark.exhaustive
def test_a_camera_that_shows_things_twice_as_large_lowers_levels_by_one():
    scene, surface = ground()
    finer = ground(2.0)
    light, light_of_finer = (pages_for(*each, layout_of()) for each in ((scene, surface), finer))
    points = finer[1].position
    level = lambda light: np.asarray(light.pages.level)[np.asarray(light.layer(points))][np.asarray(finer[1].mask)]
    assert float(light.raised) == float(light_of_finer.raised) == 0
    lower = level(light) - level(light_of_finer)
    # Near steps between levels, and at level 0, the change may be 0 or 2: pages are larger than bands of a level.
    assert (lower[level(light) > 0] == 1).mean() > 0.8


@pytest.mark.exhaustive
def test_a_bias_is_raised_until_all_pages_fit_and_every_point_has_a_page():
    scene, surface = ground()
    mask, points = np.asarray(surface.mask), surface.position
    lights = {bias: pages_for(scene, surface, layout_of(level_bias=bias)) for bias in (-2.0, -1.0, 0.0, 1.0, 2.0, 8.0)}
    requested = int(lights[0.0].requested)
    # Memory for just the pages that are requested, and for many more.
    side = layout_of().layer_resolution((1, 1))[0]
    exact = lambda bias: layout_of(level_bias=bias).light(scene.light, scene.camera, (side, requested * side), surface)
    for bias, light in (*lights.items(), (0.0, exact(0.0)), (-0.5, exact(-0.5))):
        count, raised, memory = int(light.pages.count), float(light.raised), light.capacity
        assert (raised == 0) == (int(light.requested) <= memory)
        assert float(light.bias) == bias + raised
        assert count <= memory
        assert raised > 0 or count == int(light.requested)
        # Every point is looked up in a resident page that contains it.
        layer = np.asarray(light.layer(points))[mask]
        assert 0 <= layer.min() <= layer.max() < count
    assert float(exact(-0.5).raised) > 0
    # Whole steps never need more pages.
    counts = [int(light.requested) for light in lights.values()]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0] / 10
    # At a bias of all levels, there is but the root.
    assert (counts[-1], int(lights[8.0].pages.level[0])) == (1, layout_of().levels - 1)
    # It is raised from a bias below 0 without a remark: such a bias asks for all the memory there is.
    assert layout_of().remarks(lights[0.0]) == layout_of().remarks(exact(-0.5)) == ()
    alone = layout_of().light(scene.light, scene.camera, (side, side), surface)
    assert int(alone.pages.count) == 1
    assert layout_of().remarks(alone) == (
        f"requests {requested} pages, and the shadow map has memory for 1: level_bias was raised to "
        f"{float(alone.bias):.3g}, where one page of {side}² shows all; enlarge the map's resolution",
    )


def test_figures_of_pages_show_levels_where_there_are_shadows():
    scene, surface = ground()
    layout = layout_of(distance=5.0)
    light = pages_for(scene, surface, layout)
    count = int(light.pages.count)
    assert layout.map_figure(light) == (f"{count} pages, from fine to coarse", None, count)
    figure = layout.layer_figure(light, surface)
    near = np.asarray(surface.mask) & (20 - np.asarray(surface.position)[..., 2] <= 5)
    np.testing.assert_array_equal(figure.shown, near)
    level = np.asarray(light.pages.level)[np.asarray(light.layer(surface.position))]
    np.testing.assert_array_equal(figure.colour, level)
    assert set(figure.labels) == set(level[near].tolist())
    assert figure.labels[int(level[near].min())].endswith(f"{4096 >> level[near].min()}²")
    # Neighbouring pages differ in brightness.
    assert np.unique(figure.brightness).tolist() == [0.75, 1.0]


@pytest.mark.exhaustive
def test_nothing_beyond_the_shadow_distance_is_requested_or_shadowed():
    scene, surface = ground()
    mask, depth = np.asarray(surface.mask), 20 - np.asarray(surface.position)[..., 2]
    requested = []
    for distance in (190.0, 5.0):
        layout = layout_of(distance=distance)
        light = pages_for(scene, surface, layout)
        requested.append(int(light.requested))
        found = ShadowMapping(Nearest(), Bias(0.0), layout=layout).visibility(dark_map(light, layout), surface)
        np.testing.assert_array_equal((np.asarray(found) == 0)[mask], depth[mask] <= distance)
    assert (depth[mask] <= 5).any()
    assert requested[1] < requested[0]


# --- Derivatives, and what is refused ---


@pytest.mark.exhaustive
def test_depths_of_pages_have_the_plain_maps_derivatives():
    scene, _ = scene_and_surface()
    light = paged(scene.light, scene.camera, FINEST)
    weights = np.random.default_rng(0).normal(size=(WIDE, WIDE))
    inner = np.zeros((LAYERS, SIDE, SIDE))
    for layer in FINEST:
        x, y = np.asarray(light.pages.tile.origin[layer])
        r, c = int(light.pages.row[layer]) * PAGE, int(light.pages.column[layer]) * PAGE
        inner[layer, r - y : r - y + PAGE, c - x : c - x + PAGE] = weights[r : r + PAGE, c : c + PAGE]

    def weighted(height, light, weights, side):
        moved = scene.mesh.vertices + height * jnp.array([0.0, 1.0, 0.0])
        shadow_map = draw_shadow_map(Mesh(moved, scene.mesh.faces), light, (side, side))
        return jnp.sum(shadow_map.depth * weights)

    zero, one = jnp.float32(0), jnp.float32(1)
    slope = lambda *given: jax.jvp(lambda height: weighted(height, *given), (zero,), (one,))[1]
    expected = slope(scene.light, weights, WIDE)
    assert abs(float(expected)) > 0.1
    np.testing.assert_allclose(slope(light, inner, SIDE), expected, rtol=1e-4)


def test_bad_settings_are_refused():
    mesh = floor_and_card()
    for arguments, message in (
        ({"page": 48}, r"page is 48; expected a power of two"),
        ({"finest": 3000}, r"finest is 3000; expected a power of two"),
        ({"page": 64, "finest": 64}, r"finest is 64, and pages are 64 texels wide; expected 2 to 1024 pages"),
        ({"page": 16, "finest": 32768}, r"finest is 32768, and pages are 16 texels wide"),
        ({"margin": 33.0}, r"margin is 33, and pages are 64 texels wide; expected at most half"),
    ):
        with pytest.raises(ValueError, match=message):
            ResolutionMatched(**arguments)
    scene, surface = scene_and_surface()
    layout = ResolutionMatched(margin=2.0)
    with pytest.raises(ValueError, match="expected a directional light"):
        layout.light(lamp(mesh), scene.camera, (256, 256), surface)
    with pytest.raises(ValueError, match=r"has \(64, 64\) texels.*a page with its gutter has 68².*at least one page"):
        layout.light(scene.light, scene.camera, (64, 64), surface)
    with pytest.raises(ValueError, match="expected a surface"):
        layout.light(scene.light, scene.camera, (256, 256))
    with pytest.raises(ValueError, match="shadow_distance is 50"):
        ResolutionMatched(shadow_distance=50.0).light(scene.light, scene.camera, (256, 256), surface)
    with pytest.raises(ValueError, match="edges were given for a map with pages"):
        draw_shadow_map(mesh, paged(scene.light, scene.camera, SOME), (SIDE, SIDE), edges=Edges.of(mesh), crossings=8)
    with pytest.raises(ValueError, match=r"expected the side of the pages' layers, 28"):
        rasterize(jnp.zeros((3, 4)), jnp.zeros((1, 3), jnp.int32), (32, 32), pages=pages_of(SOME))
