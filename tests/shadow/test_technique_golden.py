"""Techniques against shadow factors that OpenGL drew, pixel by pixel.

Filters alone are fed with OpenGL's own shadow coordinates and map; then the whole column, from vertices to visibility,
is drawn from the same matrices. There rounding differs, and each pixel that comes out otherwise must show why.
"""

import functools
from collections import Counter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from golden_techniques import (
    GoldenFactor,
    GoldenLight,
    GoldenMap,
    GoldenView,
    golden_light,
    golden_lights,
    golden_scene,
)
from scenes import apply, map_of, shadows

from diffshadow.geometry import DirectionalLight, Mesh, PinholeCamera, SpotLight, View
from diffshadow.raster import Surface, draw_surface
from diffshadow.shadow import (
    AbstractFilter,
    Bias,
    Bilinear,
    FourTap,
    HardCompare,
    Lookup,
    Nearest,
    Pattern,
    RandomDisk,
    ShadowMap,
    ShadowMapping,
    SlopeBias,
    draw_shadow_map,
    look_up,
    receiver,
)

pytestmark = pytest.mark.optimized

SAME = 1e-4
"""Visibilities that differ by no more are equal."""
SHARE = 0.999
"""Of the covered pixels, those that must be equal."""
SUBPIXEL = 1 / 256
"""In pixels and texels: what OpenGL moves vertices by, and more than positions differ by."""
TIE = 4e-6
"""Window depth: by how much llvmpipe's depths are off in steep triangles (`golden/README.md`)."""
ROUNDING = 2e-5
"""In texels: of the sum of a position and a tap's offset, which each side forms in its own unit."""
EDGE_ON = 1e-6
"""Of the cosine to the light; its sign may be either."""
# For every view, so that maps share what is compiled, in one size of windows.
SCENE = golden_scene()
FACTORS = [(light, factor) for light in golden_lights() for factor in golden_light(light).factors]
# One compare of each map is enough for the whole column; of exact ties, both.
COLUMN = [
    (light, factor)
    for light, factor in FACTORS
    if light == "overhead" or (factor.compare == "less") == factor.map.startswith("float32")
]
names = lambda factors: [f"{light}-{factor.name}" for light, factor in factors]


def marked(factors, usual):
    """Test parameters of `factors`, of which some are for the usual run."""
    return [pytest.param(*f, marks=[] if usual(*f) else pytest.mark.exhaustive) for f in factors]


def is_usual(light, factor):
    """Whether a filter is tried in the usual run: every filter in every map, some with one compare alone."""
    return factor.compare != {"four_tap": "less", "random_disk": "less_equal"}.get(factor.technique)


def is_usual_column(light, factor):
    """Whether a column is: from float maps with nothing culled, which one program draws."""
    if light == "overhead":
        return factor.technique == "nearest"
    return "cull" not in factor.map and is_usual(light, factor) and factor.map.startswith("float32")


BOX = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(25, 1, 1, 2)
CORNERS = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]).reshape(4, 1, 1, 2)
# Technique: filter, offsets of its taps in texels (n, p, p, 2), and whether each blends four texels.
TECHNIQUES: dict[str, tuple[AbstractFilter, np.ndarray, bool]] = {
    "nearest": (Nearest(), np.zeros((1, 1, 1, 2)), False),
    "bilinear": (Bilinear(), np.zeros((1, 1, 1, 2)), True),
    "four_tap": (FourTap(1.0), CORNERS, True),
    "box": (RandomDisk(2.0, Pattern(jnp.asarray(BOX / 2, jnp.float32)), lookup="nearest"), BOX, False),
    "random_disk": (
        RandomDisk(SCENE.radius, Pattern(jnp.asarray(SCENE.offsets)), lookup="nearest", early_out=True),
        SCENE.offsets * SCENE.radius,
        False,
    ),
}


class StoredSun(DirectionalLight):
    """A directional light with the very matrices that OpenGL was given."""

    stored: View = eqx.field(kw_only=True)

    def view(self) -> View:
        return self.stored


class StoredLamp(SpotLight):
    """A spot light with the very matrices that OpenGL was given."""

    stored: View = eqx.field(kw_only=True)

    def view(self) -> View:
        return self.stored


class StoredCamera(PinholeCamera):
    """A camera with the very matrices that OpenGL was given."""

    stored: View = eqx.field(kw_only=True)

    def view(self) -> View:
        return self.stored


def stored_view(view: GoldenView) -> View:
    near, far = (jnp.asarray(x, jnp.float32) for x in (view.near, view.far))
    return View(jnp.asarray(view.world_to_eye), jnp.asarray(view.eye_to_clip), near, far, view.is_perspective)


def stored_light(light: GoldenLight) -> StoredSun | StoredLamp:
    view, (x_scale, y_scale) = stored_view(light.view), np.diag(light.view.eye_to_clip)[:2]
    eye, forward = light.view.eye, light.view.forward
    if light.view.is_perspective:
        angle = np.rad2deg(np.arctan(1 / min(x_scale, y_scale)))
        return StoredLamp(eye, forward, angle, view.near, view.far, stored=view)
    return StoredSun(forward, eye, (2 / x_scale, 2 / y_scale), view.near, view.far, stored=view)


def bias_of(factor: GoldenFactor) -> Bias:
    constant, slope, least = SCENE.biases[factor.bias].tolist()
    return Bias(constant, SlopeBias(slope, profile="one_minus_cosine", least=least))


class Column:
    """Everything of our side that factors share, drawn once."""

    def __init__(self):
        self.mesh = Mesh(SCENE.vertices, SCENE.faces)
        view, eye = stored_view(SCENE.camera), SCENE.camera.eye
        fov_y = 2 * np.rad2deg(np.arctan(1 / SCENE.camera.eye_to_clip[1, 1]))
        self.camera = StoredCamera(
            eye,
            eye + SCENE.camera.forward,
            fov_y=fov_y,
            near=view.near,
            far=view.far,
            resolution=SCENE.face.shape,
            stored=view,
        )
        self.surface = draw_surface(self.mesh, self.camera)
        self.lights = {name: stored_light(golden_light(name)) for name in golden_lights()}

    @functools.cache  # noqa: B019 (there is but one column)
    def map(self, light: str, key: str) -> ShadowMap:
        return self._map(self.lights[light], golden_light(light).maps[key])

    def _map(self, light: StoredSun | StoredLamp, stored: GoldenMap) -> ShadowMap:
        return draw_shadow_map(
            self.mesh,
            light,
            stored.depth.shape,
            cull=stored.cull,
            depth_format="float32" if stored.bits == 32 else "unorm24",
            polygon_offset=stored.offset,
        )


@pytest.fixture(scope="module")
def column() -> Column:
    return Column()


@eqx.filter_jit
def looked(bias: Bias, shadow_map: ShadowMap, surface: Surface) -> tuple[Lookup, jax.Array]:
    """Where a technique looks, and the cosine to the light."""
    at = receiver(shadow_map, surface)
    return look_up(shadow_map, at, bias(at)), at.cosine


def seen(factor: GoldenFactor, shadow_map: ShadowMap, surface: Surface) -> tuple[np.ndarray, Lookup, np.ndarray]:
    """Visibility, where it looked, and the cosine to the light."""
    kernel, compare = TECHNIQUES[factor.technique][0], HardCompare(factor.compare)
    lookup, cosine = (jax.tree.map(np.asarray, x) for x in looked(bias_of(factor), shadow_map, surface))
    if factor.technique == "nearest":
        return np.asarray(shadows(ShadowMapping(kernel, bias_of(factor), compare), shadow_map, surface)), lookup, cosine
    # What a technique makes of a filter, so that each filter is compiled once, and not for each light and format.
    inside, position = lookup.inside & (cosine > 0), jax.tree.map(jnp.asarray, lookup)
    position = Lookup(position.texel, position.depth, jnp.ones(inside.shape), position.inside)
    lit = np.asarray(apply(kernel, map_of(shadow_map.depth), position, compare))
    mask = np.asarray(surface.mask)
    return np.where(inside & mask, lit, 1 - (mask & ~(cosine > 0))), lookup, cosine


@pytest.mark.parametrize(("name", "factor"), marked(FACTORS, is_usual), ids=names(FACTORS))
def test_filter_finds_what_opengl_finds_at_its_own_coordinates(name, factor):
    covered = SCENE.face >= 0
    lit = looked_up(golden_light(name), factor, TECHNIQUES[factor.technique][0])
    equal = np.abs(lit - factor.visibility)[covered] <= SAME
    assert equal.mean() >= SHARE, f"{np.sum(~equal)} of {covered.sum()} pixels differ"


def looked_up(light: GoldenLight, factor: GoldenFactor, kernel: AbstractFilter) -> np.ndarray:
    """(h, w), what our filter finds at OpenGL's coordinates in its map."""
    shadow_map = light.maps[factor.map]
    height, width = shadow_map.depth.shape
    texel = light.coordinate[..., :2] * np.array([width, height], np.float32)
    inside = light.coordinate[..., 2] <= 1
    lookup = Lookup(
        jnp.asarray(texel), jnp.asarray(reference(light, factor)), jnp.ones(inside.shape), jnp.asarray(inside)
    )
    lit = np.asarray(apply(kernel, map_of(shadow_map.depth), lookup, HardCompare(factor.compare)))
    return np.where(inside, lit, 1)


@pytest.mark.parametrize(("name", "factor"), marked(COLUMN, is_usual_column), ids=names(COLUMN))
def test_visibility_from_vertices_is_opengls(name, factor, column):
    light = golden_light(name)
    shadow_map = column.map(name, factor.map)
    visibility, lookup, cosine = seen(factor, shadow_map, column.surface)
    error = np.abs(visibility - np.where(light.facing, factor.visibility, 0))
    covered = SCENE.face >= 0
    face = np.asarray(column.surface.face)

    def reason(pixel: tuple[int, ...]) -> str | None:
        """Why visibility may differ at `pixel` (row, column), or none if it may not."""
        if face[pixel] != SCENE.face[pixel]:
            centre = np.array(pixel[::-1]) + 0.5
            return "outline in the image" if outline_distance(SCENE.camera, face.shape, centre) < SUBPIXEL else None
        if (cosine[pixel] > 0) != light.facing[pixel]:
            return "edge-on" if abs(cosine[pixel]) < EDGE_ON else None
        stored = light.maps[factor.map].depth
        position = light.coordinate[pixel][:2] * np.array(stored.shape[::-1], np.float32)
        theirs = Side(position, reference(light, factor)[pixel], light.coordinate[pixel][2] <= 1, stored)
        depth = np.asarray(shadow_map.depth)
        ours = Side(lookup.texel[pixel], lookup.depth[pixel], bool(lookup.inside[pixel]), depth)
        return difference(light.view, factor, theirs, ours, pixel, error[pixel])

    reasons = {pixel: reason(pixel) for pixel in map(tuple, np.argwhere(covered & (error > SAME)).tolist())}
    found = f"{len(reasons)} of {covered.sum()} pixels differ: {dict(Counter(reasons.values()))}\n{reasons}"
    assert None not in reasons.values(), found
    assert len(reasons) <= (1 - SHARE) * covered.sum(), found


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "factor"), COLUMN[::2], ids=names(COLUMN[::2]))
def test_a_technique_is_its_look_ups_and_its_filter(name, factor, column):
    shadow_map = column.map(name, factor.map)
    mapping = ShadowMapping(TECHNIQUES[factor.technique][0], bias_of(factor), HardCompare(factor.compare))
    pieces, _, _ = seen(factor, shadow_map, column.surface)
    np.testing.assert_allclose(shadows(mapping, shadow_map, column.surface), pieces, atol=1e-6)


@pytest.mark.parametrize("name", ["directional", "spot"])
def test_projections_are_those_that_opengl_was_given(name, column):
    light, camera = column.lights[name], column.camera
    # As their own classes have them.
    views = (super(type(light), light).view(), light.stored), (super(StoredCamera, camera).view(), camera.stored)
    for ours, stored in views:
        np.testing.assert_allclose(ours.world_to_eye, stored.world_to_eye, atol=2e-6)
        # The spot light's frustum is square and holds the stored one, which has the shape of its map.
        rows = slice(2 if stored is light.stored and name == "spot" else 0, None)
        np.testing.assert_allclose(ours.eye_to_clip[rows], stored.eye_to_clip[rows], rtol=2e-6, atol=1e-6)


class Side(NamedTuple):
    """One pixel's look-up, OpenGL's or ours.

    `position` in texels (2,); the depth it compares; whether it lies before the far plane; the map (h, w).
    """

    position: np.ndarray
    reference: np.ndarray
    inside: bool
    depth: np.ndarray

    def looked_up(self, technique: str, pixel: tuple[int, ...]) -> np.ndarray:
        """(k, 2), where the technique's taps look into the map, in texels: all four points of those that blend."""
        _, offsets, linear = TECHNIQUES[technique]
        row, column = np.array(pixel) % offsets.shape[1]
        corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) - 0.5 if linear else np.zeros((1, 2))
        return (self.position + offsets[:, row, column][:, None] + corners).reshape(-1, 2)

    def gaps(self, texels: np.ndarray) -> np.ndarray:
        """(k,), by how much each texel is deeper than the receiver; beyond the border the map is clear."""
        height, width = self.depth.shape
        x, y = np.clip(texels, 0, (width - 1, height - 1)).T
        on_map = (texels == np.stack([x, y], axis=1)).all(axis=1)
        return np.where(on_map, self.depth[y, x], 1) - self.reference


def difference(
    view: GoldenView, factor: GoldenFactor, theirs: Side, ours: Side, pixel: tuple[int, ...], error: float
) -> str | None:
    """Why two look-ups from the same face may come out with visibilities `error` apart, or none if they may not."""
    moved = np.abs(ours.position - theirs.position).astype(np.float64)
    if moved.max() > SUBPIXEL or abs(ours.reference - theirs.reference) > TIE:
        return None
    if theirs.inside != ours.inside:
        return "depth tie with the far plane"
    points = [side.looked_up(factor.technique, pixel) for side in (theirs, ours)]
    to_border = np.abs(points[0] - np.round(points[0])).min()
    if to_border <= moved.max() + ROUNDING:
        return "tap at a texel's border"
    texels = np.floor(points[0]).astype(int)
    gaps = np.stack([side.gaps(texels) for side in (theirs, ours)])
    lit = gaps > 0 if factor.compare == "less" else gaps >= 0
    flipped = lit[0] != lit[1]
    if flipped.any():
        sure = flipped & (np.abs(gaps).max(axis=0) > TIE)
        distances = [outline_distance(view, ours.depth.shape, texel + 0.5) for texel in texels[sure]]
        if any(distance > SUBPIXEL for distance in distances):
            return None
        return "outline in the map" if distances else "depth tie"
    # The weights of four texels move with the position.
    _, _, linear = TECHNIQUES[factor.technique]
    return "weights of a blend" if linear and error <= moved.sum() + SAME else None


def outline_distance(view: GoldenView, resolution: tuple[int, int], point: np.ndarray) -> float:
    """Distance in pixels of `point` (2,) from the nearest edge of a face, drawn to an image of `resolution`."""
    corners = view.window(SCENE.vertices, resolution)[SCENE.faces]
    start, end = corners, np.roll(corners, -1, axis=1)
    along = end - start
    length = np.maximum(np.sum(along**2, axis=-1), 1e-12)
    share = np.clip(np.sum((point - start) * along, axis=-1) / length, 0, 1)
    return float(np.linalg.norm(start + share[..., None] * along - point, axis=-1).min())


def reference(light: GoldenLight, factor: GoldenFactor) -> np.ndarray:
    """(h, w), the depth that OpenGL compared: with 24 bits it is clamped."""
    depth = light.references[factor.bias]
    return depth if light.maps[factor.map].bits == 32 else np.clip(depth, 0, 1)
