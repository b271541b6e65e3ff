"""The reference tracer against closed forms, a float64 tracer and its own noise estimate."""

import dataclasses
import gc
import itertools
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import diffshadow.geometry as geometry
from diffshadow.geometry import (
    AbstractLight,
    DirectionalLight,
    Domain,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    PointLight,
    RectangleLight,
    Scene,
    SpotLight,
    View,
)
from diffshadow.reference import (
    Reference,
    concentric_disk,
    hidden_pixels,
    hides_light,
    key_parts,
    reference_from_image,
    trace_visibility,
    trace_visibility_exact,
)
from diffshadow.reference._embree import EmbreeTracer
from diffshadow.reference._sampling import LightSampler
from diffshadow.reference._visibility import _last, trace_with


def flat(vertices, faces):
    """A mesh shaded flat, whose normals take no compiling."""
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces)
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    return Mesh(vertices, faces, np.repeat(normals[:, None], 3, axis=1), np.full(faces.shape, 0.8))


def together(meshes):
    """Flat meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [np.asarray(mesh.faces) + start for mesh, start in zip(meshes, starts, strict=False)]
    return flat(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def quad(center, right, up):
    """Two triangles; `right` and `up` are half of its sides."""
    c, r, u = (np.asarray(x, dtype=float) for x in (center, right, up))
    return flat([c - r - u, c + r - u, c + r + u, c - r + u], [[0, 1, 2], [0, 2, 3]])


def floor(half=3.0, y=0.0):
    return quad((0, y, 0), (half, 0, 0), (0, 0, -half))


def sphere(radius=1.0, rows=8, columns=12, center=(0.0, 0.0, 0.0)):
    """Latitudes and longitudes, closed, the faces anticlockwise seen from outside."""
    polar = np.linspace(0, np.pi, rows + 1)[1:-1, None]
    around = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    x, z = np.sin(polar) * np.sin(around), np.sin(polar) * np.cos(around)
    rings = np.stack([x, np.cos(polar) + 0 * around, z], -1).reshape(-1, 3)
    vertices = np.concatenate([rings, [[0, 1, 0], [0, -1, 0]]]) * radius + np.asarray(center)
    top, bottom, faces = len(rings), len(rings) + 1, []
    for j in range(columns):
        k = (j + 1) % columns
        faces += [[top, j, k], [bottom, top - columns + k, top - columns + j]]
        for i in range(0, top - columns, columns):
            faces += [[i + j, i + columns + j, i + columns + k], [i + j, i + columns + k, i + k]]
    return flat(vertices, faces)


def moved(mesh, scale, offset):
    return flat(np.asarray(mesh.vertices) * np.float32(scale) + np.asarray(offset, np.float32), mesh.faces)


def from_above(half=1.0, resolution=(32, 32), target=(0.0, 0.0, 0.0)):
    """An orthographic camera that sees `half` world units each way on the plane y = 0; its rows run to -z."""
    eye = np.asarray(target) + np.array([0, 5, 0])
    return OrthographicCamera(
        eye, target, up=(0.0, 0.0, -1.0), height=2 * half, near=0.1, far=10.0, resolution=resolution
    )


def sun(direction=(0.0, -1.0, 0.0), angular_radius=0.0):
    return DirectionalLight(direction, (0, 0, 0), (10, 10), -10, 10, angular_radius)


def small_scene(camera_kind, light_kind, scale=1.0, offset=0.0, size=0.0, pixels=40):
    """A sphere and a leaning card over a floor, scaled and then moved."""
    offset = np.full(3, offset)
    card = quad((-1.2, 0.9, 0.3), (0.5, 0.1, 0.1), (0.1, 0.7, -0.3))
    mesh = moved(together([floor(), sphere(0.7, 7, 9, (0.5, 0.8, 0.1)), card]), scale, offset)
    place = lambda p: jnp.asarray(np.asarray(p) * scale + offset)
    pose = {"eye": place((2.0, 3.0, 4.0)), "target": place((0.0, 0.4, 0.0)), "resolution": (pixels, pixels + 3)}
    pose |= {"near": 0.5 * scale, "far": 20.0 * scale}
    camera = PinholeCamera(**pose) if camera_kind == "pinhole" else OrthographicCamera(**pose, height=5.0 * scale)
    if light_kind == "spot":
        light = SpotLight.around(place((1.5, 4.0, -1.0)), mesh.vertices, radius=size * scale)
    else:
        light = DirectionalLight.around(jnp.array([-0.7, -1.6, 0.5]), mesh.vertices, angular_radius=10 * size)
    return Scene(mesh, camera, light)


def distance_to_edges(scene, begin, end):
    """Least distance in float64 from the segment `begin`-`end` to any edge of the mesh."""
    corners = np.asarray(scene.mesh.vertices, dtype=np.float64)[np.asarray(scene.mesh.faces)]
    p, q = corners.reshape(-1, 3), np.roll(corners, -1, axis=1).reshape(-1, 3)
    d, e, r = end - begin, q - p, begin - p
    a, b, c = d @ d, e @ d, np.sum(e * e, -1)
    f, g = np.sum(e * r, -1), r @ d
    s = np.clip((b * f - g * c) / np.where(a * c - b * b == 0, 1, a * c - b * b), 0, 1)
    t = np.clip((b * s + f) / c, 0, 1)
    s = np.clip((b * t - g) / a, 0, 1)
    return np.linalg.norm(r + s[:, None] * d - t[:, None] * e, axis=-1).min()


# --- Against float64 ---


@pytest.mark.parametrize("camera_kind", ["pinhole", "orthographic"])
@pytest.mark.parametrize("light_kind", ["spot", "directional"])
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (0.01, 0.0), (100.0, 0.0), (1.0, 1000.0)])
def test_hard_shadows_agree_with_float64_but_for_rays_along_edges(camera_kind, light_kind, scale, offset):
    scene = small_scene(camera_kind, light_kind, scale, offset)
    fast, exact = trace_visibility(scene), trace_visibility_exact(scene)
    assert 0.05 < exact.visibility[exact.mask].mean() < 0.95
    differ = np.argwhere((fast.face != exact.face) | (fast.visibility != exact.visibility))
    assert len(differ) <= 0.002 * fast.mask.size
    # In the tracing frame a float32 ray strays by a few 1e-7; the scene spans 6 world units at scale 1.
    tolerance = 3e-6 * 3 * scale
    eye, towards = np.asarray(scene.camera.eye, dtype=np.float64), np.asarray(scene.camera.target - scene.camera.eye)
    for row, column in differ:
        point = exact.position[row, column].astype(np.float64)
        way = np.asarray(scene.light.towards(jnp.asarray(point)[None]), dtype=np.float64)[0]
        lamp = point + way * (10 * scale if scene.light.is_directional else 1)
        start = eye if isinstance(scene.camera, PinholeCamera) else point - towards
        # The point itself is stored in float32.
        near = tolerance + np.spacing(np.float32(np.abs(point).max())) * 2
        assert min(distance_to_edges(scene, start, point), distance_to_edges(scene, point, lamp)) < near
    same = fast.face == exact.face
    np.testing.assert_allclose(fast.position[same], exact.position[same], rtol=2e-7, atol=1e-12 * scale)
    np.testing.assert_array_equal(fast.normal[same], exact.normal[same])


@pytest.mark.parametrize(
    ("kind", "sampler"),
    [*itertools.product(["spot", "directional"], ["sobol", "stratified"]), ("sphere", "sobol"), ("rectangle", "sobol")],
)
def test_soft_shadows_agree_with_float64_in_nearly_every_ray(kind, sampler):
    scene = small_scene("pinhole", "directional" if kind == "directional" else "spot", size=0.5, pixels=24)
    place, corners = scene.light.position if kind != "directional" else None, scene.mesh.vertices
    if kind == "sphere":
        scene = Scene(scene.mesh, scene.camera, PointLight.around(place, corners, radius=0.5))
    if kind == "rectangle":
        panel = RectangleLight.around(place, corners, (1.2, 0.5), target=jnp.array([0.0, 0.4, 0.0]))
        scene = Scene(scene.mesh, scene.camera, panel)
    fast, exact = (trace(scene, 12, sampler, seed=3) for trace in (trace_visibility, trace_visibility_exact))
    assert np.mean((exact.visibility > 0) & (exact.visibility < 1)) > 0.05
    np.testing.assert_array_equal(fast.mask, exact.mask)
    rays = 12 * np.abs(fast.visibility - exact.visibility).sum()
    assert rays <= 3e-4 * 12 * fast.mask.sum()


def test_no_ray_meets_the_surface_that_it_leaves():
    # Flat triangles with an apex close to the middle of a long edge are where a float32 normal is worst.
    z, apex = np.linspace(-3, 2.98, 300), np.random.default_rng(0).uniform(-2, 2, 300)
    corner = lambda x, z: np.stack([x + 0 * z, 0 * z, z], -1)
    slivers = np.stack([corner(-3, z), corner(apex, z + 0.015), corner(3, z)], 1)
    caps = flat(slivers.reshape(-1, 3), np.arange(900).reshape(-1, 3))
    turn = geometry.rotation(jnp.array([0.3, 0.5, 0.8]), 0.9)
    turned = lambda v: np.asarray(turn)[:3, :3] @ np.asarray(v, dtype=np.float32)
    camera = OrthographicCamera(turned((0, 4, 1)), (0, 0, 0), height=4, near=0.1, far=20, resolution=(128, 128))
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    rim = np.stack([3 * np.cos(angle), 0 * angle, -3 * np.sin(angle)], -1)
    k = np.arange(300)
    fan = flat(np.concatenate([rim, [[0, 0, 0]]]), np.stack([0 * k + 300, k, np.roll(k, -1)], -1))
    for mesh in (caps, fan, floor()):
        for slope in (0.02, 1.0):
            leaning = flat(np.asarray(mesh.vertices) @ np.asarray(turn)[:3, :3].T, mesh.faces)
            scene = Scene(leaning, camera, sun(turned((-0.6, -slope, -0.7))))
            reference = trace_visibility(scene)
            assert reference.mask.mean() > 0.3
            assert reference.visibility[reference.mask].min() == 1


@pytest.mark.parametrize("seed", [0, 1])
def test_any_heap_of_triangles_agrees_with_float64(seed):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(60, 1, 3)) + rng.normal(size=(60, 3, 3)) * rng.choice([0.1, 1.0], (60, 1, 1))
    # Among them faces without area: a repeated corner, and three corners in a line.
    corners[0, 1] = corners[0, 0]
    corners[1, 2] = corners[1, 0] / 2 + corners[1, 1] / 2
    mesh = flat(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    camera = PinholeCamera((0, 1, 7), (0, 0, 0), near=4, far=9, resolution=(32, 32))
    light = SpotLight((1, 6, 2), (0, -1, 0), 60, 0.1, 9, radius=0.5)
    fast, exact = (
        trace(Scene(mesh, camera, light), 6, seed=seed) for trace in (trace_visibility, trace_visibility_exact)
    )
    assert np.sum(fast.face != exact.face) <= 1
    assert 6 * np.abs(fast.visibility - exact.visibility)[fast.face == exact.face].sum() <= 2.01
    for values in (fast.visibility, fast.position, fast.normal, fast.standard_error):
        assert np.isfinite(values).all()
    assert 0 <= fast.visibility.min() <= fast.visibility.max() <= 1


@pytest.mark.parametrize("light_kind", ["spot", "directional"])
def test_scaling_by_a_power_of_two_changes_nothing(light_kind):
    small, large = (
        trace_visibility(small_scene("pinhole", light_kind, scale, size=0.5, pixels=24), 8) for scale in (0.25, 16.0)
    )
    assert np.mean((small.visibility > 0) & (small.visibility < 1)) > 0
    np.testing.assert_array_equal(small.visibility, large.visibility)
    np.testing.assert_array_equal(64 * small.position, large.position)


def test_gap_of_a_hundred_thousandth_of_the_scene_is_seen():
    # What lies under a card that hovers 1e-5 above the floor is dark; the camera stands in the gap.
    caster = quad((0, 1e-5, 0), (0.5, 0, 0), (0, 0, -0.5))
    camera = OrthographicCamera((0, 5e-6, 0), (0, -1, 0), (0, 0, -1), height=2, near=1e-6, far=1, resolution=(16, 16))
    reference = trace_visibility(Scene(together([floor(1.0), caster]), camera, sun((0.1, -1.0, 0.2))))
    inside = np.zeros((16, 16), bool)
    inside[4:12, 4:12] = True
    np.testing.assert_array_equal(reference.visibility, np.where(inside, 0, 1))


# --- Closed forms ---


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_plane_alone_is_fully_lit(size):
    light = SpotLight((1, 3, 1), (-1, -3, -1), 60, 0.1, 10, radius=size)
    reference = trace_visibility(Scene(floor(), from_above(), light), samples=8)
    assert reference.mask.all()
    assert (reference.visibility == 1).all()
    assert reference.noise_floor == 0
    np.testing.assert_array_equal(reference.normal, np.broadcast_to(np.float32([0, 1, 0]), reference.normal.shape))
    # The camera's rows run to -z; pixel centres lie half a pixel inside its border.
    x = (np.arange(32) + 0.5) / 16 - 1
    np.testing.assert_allclose(reference.position[..., 0], np.broadcast_to(x, (32, 32)), atol=1e-7)
    np.testing.assert_allclose(reference.position[..., 2], np.broadcast_to(-x[:, None], (32, 32)), atol=1e-7)


def test_plane_is_dark_when_seen_from_the_side_away_from_the_light():
    scene = Scene(floor(), from_above(), sun((0.2, 1.0, 0.1), angular_radius=2.0))
    assert (trace_visibility(scene, 16).visibility == 0).all()


def test_square_over_plane_shadows_exactly_the_pixels_inside_its_projection():
    # The square, 1 above the plane, is thrown sideways by the light's slope: 0.3 along x, -0.2 along z.
    caster = quad((0, 1, 0), (0.31, 0, 0), (0, 0, -0.43))
    camera = OrthographicCamera((0, 0.5, 0), (0, 0, 0), (0, 0, -1), height=2, near=0.1, far=1, resolution=(40, 64))
    light = sun((0.3, -1.0, -0.2))
    reference = trace_visibility(Scene(together([floor(), caster]), camera, light))
    x = ((np.arange(64) + 0.5) / 32 - 1) * 1.6
    z = -((np.arange(40) + 0.5) / 20 - 1)
    inside = (np.abs(x - 0.3) < 0.31) & (np.abs(z + 0.2) < 0.43)[:, None]
    assert inside.any()
    np.testing.assert_array_equal(reference.visibility, np.where(inside, 0, 1))


@pytest.mark.parametrize("light_kind", ["spot", "directional"])
@pytest.mark.parametrize("sampler", ["sobol", "stratified"])
def test_penumbra_of_half_plane_is_the_segment_of_a_disk_cut_by_a_chord(light_kind, sampler):
    samples = 256
    # The occluder fills x < 0 at height 1; a disk of radius 0.5 at height 2 (or 0.5 at distance 1) shines down.
    occluder = quad((-20, 1, 0), (20, 0, 0), (0, 0, -20))
    camera = OrthographicCamera((0, 0.9, 0), (0, 0, 0), (0, 0, -1), height=0.5, near=0.1, far=2, resolution=(16, 64))
    if light_kind == "spot":
        light, cut = SpotLight((0, 2, 0), (0, -1, 0), 80, 0.1, 3, radius=0.5), lambda x: -x / 0.5
    else:
        light, cut = sun(angular_radius=float(np.rad2deg(np.arctan(0.5)))), lambda x: -x / 0.5
    reference = trace_visibility(Scene(together([floor(), occluder]), camera, light), samples, sampler, seed=1)
    # A ray from (x, 0, z) to the disk's point at X passes height 1 at (x + X) / 2, or at x + X for the sun; it is free
    # where X lies right of the chord at -x. Lit share of the disk: (arccos(h) - h sqrt(1 - h²)) / pi, with h = chord.
    x = (np.arange(64) + 0.5) / 32 - 1
    chord = np.clip(cut(x), -1, 1)
    expected = (np.arccos(chord) - chord * np.sqrt(1 - chord**2)) / np.pi
    assert 0.02 < expected[20] < 0.98
    error = reference.visibility - expected
    # Sixteen rows are independent draws of each column: their mean must lie within 4.5 standard errors.
    spread = error.std(axis=0, ddof=1) / 4
    assert (np.abs(error.mean(axis=0)) <= 4.5 * spread + 1e-3).all()
    # Far below the error of as many independent samples, which is up to 0.5 / sqrt(256) = 0.031.
    assert np.sqrt(np.mean(error**2)) < 0.006


def over_half_plane(light, samples=256):
    """Columns and visibility of a floor at heights 2 and 1 below the light and the edge of a half plane over x < 0."""
    occluder = quad((-20, 1, 0), (20, 0, 0), (0, 0, -20))
    camera = OrthographicCamera((0, 0.9, 0), (0, 0, 0), (0, 0, -1), height=0.5, near=0.1, far=2, resolution=(16, 64))
    reference = trace_visibility(Scene(together([floor(), occluder]), camera, light), samples, seed=1)
    return reference.position, reference.visibility


@pytest.mark.parametrize("turned", [False, True])
def test_penumbra_of_half_plane_is_a_ramp_under_a_rectangle(turned):
    size, up = ((0.2, 1.0), (1.0, 0.0, 0.0)) if turned else ((1.0, 0.2), (0.0, 0.0, -1.0))
    light = RectangleLight((0, 2, 0), (0, -1, 0), size, 80, 0.1, 3, up)
    position, visibility = over_half_plane(light)
    # A ray from x to the light's point at X passes the edge where X > -x: of X in [-1/2, 1/2] the share 1/2 + x.
    expected = np.clip(0.5 + position[..., 0], 0, 1)
    error = visibility - expected
    assert np.sqrt(np.mean(error**2)) < 2e-3
    assert np.abs(error).max() < 0.02


def test_penumbra_of_half_plane_under_a_sphere_is_that_of_its_outline():
    radius = 0.5
    position, visibility = over_half_plane(PointLight((0, 2, 0), 0.1, 3, radius=radius))
    # The plane through a point (x, 0, z) and the edge has the normal (1, x, 0), and what lies on its right is seen. It
    # cuts the outline's disk, which faces the point, along a chord.
    p = position.astype(np.float64)
    to_centre = np.array([0, 2, 0]) - p
    distance = np.linalg.norm(to_centre, axis=-1, keepdims=True)
    w = to_centre / distance
    normal = np.stack([1 + 0 * p[..., 0], p[..., 0], 0 * p[..., 0]], -1)
    centre = (distance - radius**2 / distance) * w
    rim = radius * np.sqrt(1 - (radius / distance[..., 0]) ** 2)
    across = np.linalg.norm(normal - np.sum(normal * w, -1, keepdims=True) * w, axis=-1)
    chord = np.clip(-np.sum(normal * centre, -1) / (rim * across), -1, 1)
    expected = (np.arccos(chord) - chord * np.sqrt(1 - chord**2)) / np.pi
    assert np.mean((expected > 0.05) & (expected < 0.95)) > 0.2
    assert np.sqrt(np.mean((visibility - expected) ** 2)) < 0.006
    assert np.abs(np.mean(visibility - expected)) < 1e-3


def test_what_stands_behind_a_spot_light_casts_no_shadow():
    ceiling = quad((0, 2.5, 0), (3, 0, 0), (0, 0, 3))
    camera = OrthographicCamera((0, 1.0, 0), (0, 0, 0), (0, 0, -1), height=2, near=0.1, far=2, resolution=(8, 8))
    light = lambda y: SpotLight((0, y, 0), (0, -1, 0), 60, 0.1, 4, radius=0.1)
    mesh = together([floor(), ceiling])
    below, on, above = (trace_visibility(Scene(mesh, camera, light(y)), 8).visibility for y in (2.0, 2.5, 3.0))
    assert (below == 1).all()
    assert (on == 1).all()
    assert (above == 0).all()


# --- Sampling and noise ---


def test_concentric_mapping_keeps_areas():
    side = (np.arange(400) + 0.5) / 400
    points = concentric_disk(np.stack(np.meshgrid(side, side), -1))
    radius = np.linalg.norm(points, axis=-1)
    assert radius.max() < 1
    for r in (0.2, 0.5, 0.9):
        assert np.mean(radius < r) == pytest.approx(r * r, abs=2e-3)
    assert np.mean(points[..., 0] + points[..., 1] > 0) == pytest.approx(0.5, abs=3e-3)
    np.testing.assert_array_equal(concentric_disk(np.array([[0.5, 0.5], [1.0, 0.5]])), [[0, 0], [1, 0]])


@pytest.mark.parametrize(("samples", "columns", "rows"), [(6, 3, 2), (9, 3, 3), (7, 7, 1)])
def test_stratified_samples_are_one_in_each_cell_anywhere_in_it(samples, columns, rows):
    square = (LightSampler("square", samples, "stratified", 3).points(0, 500) + 1) / 2
    cell = np.floor(square[..., 0] * columns) + columns * np.floor(square[..., 1] * rows)
    assert (np.sort(cell, axis=1) == np.arange(samples)).all()
    within = np.stack([square[..., 0] * columns % 1, square[..., 1] * rows % 1])
    assert (within.min(axis=(1, 2)) < 0.02).all()
    assert (within.max(axis=(1, 2)) > 0.98).all()


@pytest.mark.parametrize("sampler", ["sobol", "stratified"])
def test_noise_floor_foretells_the_error_and_errors_fall_faster_than_chance(sampler):
    scene = small_scene("pinhole", "spot", size=0.5, pixels=32)
    truth = trace_visibility(scene, 4096, seed=11)
    counts, errors = [4, 16, 64, 256], []
    for samples in counts:
        reference = trace_visibility(scene, samples, sampler)
        assert reference.samples == samples
        error = (reference.visibility - truth.visibility)[reference.mask]
        errors.append(np.sqrt(np.mean(error**2)))
        # Never below the error, and at most twice as high.
        assert 0.9 * errors[-1] < reference.noise_floor < 2 * errors[-1]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope < -0.62


def test_result_depends_on_seed_alone_and_not_on_batches(monkeypatch):
    scene = small_scene("pinhole", "spot", size=0.5, pixels=24)
    for sampler in ("sobol", "stratified"):
        first = trace_visibility(scene, 9, sampler, seed=5)
        with monkeypatch.context() as patch:
            patch.setattr("diffshadow.reference._visibility.BATCH", 700)
            again = trace_visibility(scene, 9, sampler, seed=5)
        other = trace_visibility(scene, 9, sampler, seed=6)
        np.testing.assert_array_equal(first.visibility, again.visibility)
        np.testing.assert_array_equal(first.standard_error, again.standard_error)
        assert (first.visibility != other.visibility).any()


def test_one_sample_of_a_light_with_size_owns_to_knowing_nothing():
    reference = trace_visibility(small_scene("pinhole", "spot", size=0.5, pixels=8), samples=1)
    assert set(np.unique(reference.visibility)) <= {0, 1}
    assert reference.noise_floor == 0.5


class CrossLight(AbstractLight):
    """A light bent like a bowl, which no flat disk describes."""

    position: Float[Array, "3"]

    def view(self) -> View:
        raise NotImplementedError

    def layer(self, points: Float[Array, "*n 3"]) -> None:
        return None

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        centre = self.position - points
        if sample is None:
            return centre
        bowl = jnp.stack([sample[..., 0], jnp.sum(sample**2, axis=-1), sample[..., 1]], axis=-1)
        return centre + 0.5 * bowl

    @property
    def domain(self) -> Domain:
        return "disk"

    @property
    def is_directional(self) -> bool:
        return False

    @property
    def has_size(self) -> bool:
        return True


def test_light_of_any_shape_is_traced_by_its_own_vectors():
    flat = small_scene("pinhole", "spot", pixels=24)
    scene = Scene(flat.mesh, flat.camera, CrossLight(flat.light.position))
    fast, exact = trace_visibility(scene, 8), trace_visibility_exact(scene, 8)
    assert 8 * np.abs(fast.visibility - exact.visibility).sum() <= 2
    spot = Scene(flat.mesh, flat.camera, SpotLight(flat.light.position, (0, -1, 0), 60, 0.1, 9, radius=0.5))
    assert (trace_visibility(spot, 8).visibility != fast.visibility).any()


# --- Use ---


def test_of_several_lights_each_is_traced_alone():
    flat = small_scene("pinhole", "spot", pixels=16)
    lights = [flat.light, sun()]
    both = Scene(flat.mesh, flat.camera, lights)
    for k, light in enumerate(lights):
        alone = trace_visibility(Scene(flat.mesh, flat.camera, light))
        np.testing.assert_array_equal(trace_visibility(both.lit_by(k)).visibility, alone.visibility)
    for refuse in (trace_visibility, trace_visibility_exact, key_parts):
        with pytest.raises(ValueError, match=r"has 2 lights.*lit_by\(index\)"):
            refuse(both)


def test_scenes_with_the_same_meshes_share_tracers_unless_other_meshes_cast():
    made = []
    tracer = lambda triangles: made.append(len(triangles.corners)) or EmbreeTracer(triangles)
    trace = lambda scene, blockers="casters": trace_with(tracer, scene, 1, "sobol", 0, None, 1, blockers).visibility
    card, floor = quad([0, 1, 0], [0.4, 0, 0], [0, 0, -0.4]), quad([0, 0, 0], [2, 0, 0], [0, 0, -2])
    camera = OrthographicCamera((0, 3, 0.1), (0, 0, 0), height=4.0, far=10.0, resolution=(16, 16))
    scene = Scene([card, floor], camera, DirectionalLight((0.3, -1, 0), (0, 0, 0), (4, 4), -5.0, 5.0))
    first = trace(scene)
    turned = dataclasses.replace(scene, lights=dataclasses.replace(scene.light, direction=jnp.array([-0.3, -1.0, 0.0])))
    assert (trace(turned) != first).any()
    assert made == [4]
    without = dataclasses.replace(scene, casts=(False, True))
    assert (trace(without) == 1).all()
    assert made == [4, 4, 2]
    np.testing.assert_array_equal(trace(without, "all"), first)
    higher = dataclasses.replace(scene, meshes=(quad([0, 2, 0], [0.4, 0, 0], [0, 0, -0.4]), floor))
    assert (trace(higher) != first).any()
    # Nothing is kept of meshes that are gone.
    del higher
    gc.collect()
    assert not _last


def test_progress_rises_to_one_in_the_calling_thread(monkeypatch):
    monkeypatch.setattr("diffshadow.reference._visibility.BATCH", 512)
    seen = []
    scene = small_scene("pinhole", "spot", size=0.5, pixels=24)
    trace_visibility(scene, 4, progress=lambda share: seen.append((share, threading.get_ident())))
    shares = [share for share, _ in seen]
    assert len(shares) > 2
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert {thread for _, thread in seen} == {threading.get_ident()}


def test_background_is_lit_and_has_no_surface():
    scene = Scene(sphere(0.5), from_above(), sun())
    reference = trace_visibility(scene)
    assert isinstance(reference, Reference)
    away = ~reference.mask
    assert 0.1 < away.mean() < 0.9
    assert (reference.visibility[away] == 1).all()
    assert (reference.face[away] == -1).all()
    assert (reference.position[away] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(reference.normal[reference.mask], axis=-1), 1, atol=1e-6)


# Where the eye of a parallel camera stands along its axis does not matter, nor whether behind what it sees.
@pytest.mark.parametrize("away", [0, 100, -100])
def test_camera_sees_nothing_before_near_or_beyond_far(away):
    mesh = together([floor(y=0.0), quad((0, 2, 0), (3, 0, 0), (0, 0, -3))])
    eye, target = (0, 5 + away, 0), (0, away, 0)
    camera = lambda near, far: OrthographicCamera(
        eye, target, (0, 0, -1), height=2, near=near + away, far=far + away, resolution=(4, 4)
    )
    height = lambda near, far: trace_visibility(Scene(mesh, camera(near, far), sun())).position[..., 1]
    np.testing.assert_allclose(height(0.1, 10), 2, atol=1e-5)
    np.testing.assert_allclose(height(3.5, 10), 0, atol=1e-5)
    with pytest.raises(ValueError, match="set near and far"):
        height(0.1, 2.5)


def test_camera_that_sees_nothing_says_where_the_scene_is():
    with pytest.raises(ValueError, match=r"sees no surface.*spans \[-0.5.*point its target at the scene"):
        trace_visibility(Scene(sphere(0.5), from_above(0.2, target=(2.0, 0.0, 0.0)), sun()))
    away = PinholeCamera((0, 0, 5), (0, 0, 9), resolution=(4, 4))
    with pytest.raises(ValueError, match="turn the camera round"):
        trace_visibility(Scene(sphere(0.5), away, sun()))


def test_scene_without_extent_is_refused():
    point = flat([[1, 2, 3]] * 3, [[0, 1, 2]])
    with pytest.raises(ValueError, match=r"single point \[1.0, 2.0, 3.0\]"):
        trace_visibility(Scene(point, from_above(), sun()))


@pytest.mark.parametrize("trace", [trace_visibility, trace_visibility_exact, key_parts])
def test_bad_sampling_is_refused(trace):
    scene = small_scene("pinhole", "spot", pixels=4)
    with pytest.raises(ValueError, match="samples is 0; expected a whole number at least 1"):
        trace(scene, 0)
    # The names are checked by type too, so ask the check itself.
    from diffshadow.reference._sampling import check_sampling

    with pytest.raises(ValueError, match="expected sobol or stratified; did you mean 'sobol'"):
        check_sampling(16, "sobel")
    for number in (0, 9, True):
        with pytest.raises(
            ValueError, match=f"supersampling is {number!r}; expected a whole number at least 1 and at most 8"
        ):
            check_sampling(16, "sobol", number)


@pytest.mark.parametrize("trace", [trace_visibility, trace_visibility_exact])
def test_supersampling_counts_the_part_of_a_pixel_that_is_lit(trace):
    # Pixels of 0.1 units, from -0.4 on; beneath the caster they are dark, to a place within the fifth.
    camera = OrthographicCamera((0, 0.5, 0), (0, 0, 0), (0, 0, -1), height=0.8, near=0.01, far=3, resolution=(8, 8))
    for edge, rays_lit in ((0.026, 3), (0.074, 1)):
        caster = quad(((edge - 1) / 2, 1, 0), ((edge + 1) / 2, 0, 0), (0, 0, -1))
        scene = Scene(together([floor(), caster]), camera, sun())
        found = trace(scene, supersampling=4)
        expected = np.array([0, 0, 0, 0, rays_lit / 4, 1, 1, 1])
        np.testing.assert_array_equal(found.visibility, np.broadcast_to(expected, (8, 8)))
        assert (found.samples, found.noise_floor) == (16, 0)
        centres = trace(scene)
        for field in ("mask", "position", "normal", "face"):
            np.testing.assert_array_equal(getattr(found, field), getattr(centres, field))


def test_supersampling_leaves_out_rays_that_see_nothing_and_averages_noise():
    scene = small_scene("pinhole", "spot", size=0.5, pixels=12)
    found = trace_visibility(scene, 64, supersampling=2)
    height, width = scene.camera.resolution
    finer = dataclasses.replace(scene.camera, resolution=(2 * height, 2 * width))
    fine = trace_visibility(dataclasses.replace(scene, camera=finer), 16)
    blocks = lambda image: image.reshape(height, 2, width, 2).swapaxes(1, 2).reshape(height, width, 4)
    seen = blocks(fine.mask)
    assert (found.mask & ~seen.all(axis=2)).any()
    for row, column in np.argwhere(found.mask):
        part = seen[row, column]
        mean = blocks(fine.visibility)[row, column][part].mean()
        assert found.visibility[row, column] == pytest.approx(mean, abs=1e-6)
        error = np.sqrt(np.sum(blocks(fine.standard_error)[row, column][part] ** 2)) / part.sum()
        assert found.standard_error[row, column] == pytest.approx(error, abs=1e-6)
    assert key_parts(scene, 64) != key_parts(scene, 64, supersampling=2)


def test_negative_seed_is_refused():
    with pytest.raises(ValueError, match="seed is -1"):
        trace_visibility(small_scene("pinhole", "spot", pixels=4), seed=-1)


def test_reference_from_image_keeps_the_image_and_finds_the_surface():
    scene = Scene(sphere(0.5), from_above(resolution=(20, 30)), sun())
    image = np.random.default_rng(0).uniform(size=(20, 30))
    given, traced = reference_from_image(image, scene), trace_visibility(scene)
    np.testing.assert_array_equal(given.mask, traced.mask)
    np.testing.assert_array_equal(given.position, traced.position)
    np.testing.assert_array_equal(given.visibility[given.mask], image.astype(np.float32)[given.mask])
    assert (given.visibility[~given.mask] == 1).all()
    assert (given.samples, given.noise_floor) == (0, 0)
    with pytest.raises(ValueError, match=r"shape \(30, 20\).*\(20, 30\)"):
        reference_from_image(image.T, scene)
    with pytest.raises(ValueError, match="divide 8-bit images by 255"):
        reference_from_image(image * 255, scene)


def flatten(key):
    return [leaf for part in key for leaf in flatten(part)] if isinstance(key, tuple) else [key]


def same_key(a, b):
    pairs = zip(flatten(a), flatten(b), strict=True)
    return all(type(x) is type(y) and np.array_equal(x, y) for x, y in pairs)


def test_cache_key_changes_with_all_that_matters_and_with_nothing_else():
    import equinox as eqx

    scene = small_scene("pinhole", "spot", size=0.5, pixels=8)
    key = key_parts(scene, 16, "sobol", 0)
    assert all(isinstance(leaf, bool | int | float | str | np.ndarray) for leaf in flatten(key))
    assert same_key(key, key_parts(small_scene("pinhole", "spot", size=0.5, pixels=8), 16, "sobol", 0))
    repainted = eqx.tree_at(lambda s: s.mesh.albedo, scene, scene.mesh.albedo * 0)
    assert same_key(key, key_parts(repainted, 16, "sobol", 0))
    for other in (
        key_parts(scene, 17, "sobol", 0),
        key_parts(scene, 16, "stratified", 0),
        key_parts(scene, 16, "sobol", 1),
        key_parts(eqx.tree_at(lambda s: s.light.radius, scene, scene.light.radius * 2), 16, "sobol", 0),
        key_parts(eqx.tree_at(lambda s: s.camera.eye, scene, scene.camera.eye + 1), 16, "sobol", 0),
        key_parts(eqx.tree_at(lambda s: s.mesh.vertices, scene, scene.mesh.vertices + 1), 16, "sobol", 0),
        key_parts(small_scene("pinhole", "spot", size=0.5, pixels=9), 16, "sobol", 0),
    ):
        assert not same_key(key, other)
    lit_by = lambda light: key_parts(Scene(scene.mesh, scene.camera, light), 16, "sobol", 0)
    place, near, far = scene.light.position, scene.light.near, scene.light.far
    bulb = PointLight(place, near, far, scene.light.radius)
    panel = RectangleLight(place, scene.light.direction, (0.5, 0.5), scene.light.outer_angle, near, far)
    wider = RectangleLight(place, scene.light.direction, (0.6, 0.5), scene.light.outer_angle, near, far)
    keys = [lit_by(light) for light in (scene.light, bulb, panel, wider)]
    assert not any(len(flatten(a)) == len(flatten(b)) and same_key(a, b) for i, a in enumerate(keys) for b in keys[:i])
    narrow = SpotLight(
        place, scene.light.direction, scene.light.outer_angle, near, far, scene.light.radius, inner_angle=1.0
    )
    assert same_key(key, lit_by(narrow))
    hard = small_scene("pinhole", "spot", pixels=8)
    assert same_key(key_parts(hard, 16, "sobol", 0), key_parts(hard, 64, "stratified", 7))


def lamp_in_its_bulb(*casts):
    """A lamp of some size over the floor of a small scene, inside a sphere, whose camera sees all three."""
    scene = small_scene("pinhole", "spot", pixels=24)
    bulb = sphere(0.3, 7, 9, (-0.8, 1.8, 0.8))
    lamp = PointLight((-0.8, 1.8, 0.8), 0.1, 20.0, radius=0.1)
    return Scene([scene.mesh, bulb], scene.camera, lamp, casts=casts or None)


@pytest.mark.parametrize("trace", [trace_visibility, trace_visibility_exact])
def test_rays_pass_through_a_mesh_that_does_not_cast(trace):
    given = lamp_in_its_bulb(True, False)
    found, closed = trace(given, 8), trace(given, 8, blockers="all")
    bare = trace(Scene(given.meshes[0], given.camera, given.light), 8)
    beside = found.face < len(given.meshes[0].faces)
    # The bulb is seen. Its outer side turns away from the lamp.
    assert (~beside).sum() > 5
    assert not found.visibility[~beside].any()
    np.testing.assert_array_equal(found.visibility[beside], bare.visibility[beside])
    assert 0.2 < found.visibility[beside & found.mask].mean() < 0.95
    assert not closed.visibility[closed.mask].any()
    np.testing.assert_array_equal(closed.visibility, trace(lamp_in_its_bulb(), 8).visibility)
    for field in ("face", "position", "normal"):
        np.testing.assert_array_equal(getattr(found, field), getattr(closed, field))


def test_cache_key_depends_on_what_blocks():
    closed, bare = lamp_in_its_bulb(), lamp_in_its_bulb(True, False)
    assert not same_key(key_parts(closed), key_parts(bare))
    assert same_key(key_parts(closed), key_parts(bare, blockers="all"))


# What matters to a picture's shadows


def half_of(scene, number):
    """The faces of one of a scene's parts, which have two triangles each."""
    return np.arange(scene.mesh.faces.shape[0]) // 2 == number


@pytest.mark.parametrize(
    ("card", "hides"),
    [
        (quad((0, 1.5, 0), (0.3, 0, 0), (0, 0, -0.3)), True),
        # Beside what the camera sees, as is its shadow; beneath the floor; and as small as a wrong unit makes it.
        (quad((5, 1.5, 0), (0.3, 0, 0), (0, 0, -0.3)), False),
        (quad((0, -1.0, 0), (0.3, 0, 0), (0, 0, -0.3)), False),
        (quad((0, 1.5, 0), (1e-6, 0, 0), (0, 0, -1e-6)), False),
    ],
)
@pytest.mark.parametrize("light", ["sun", "lamp", "large lamp"])
def test_a_part_hides_light_if_its_shadow_is_seen(card, hides, light):
    camera = OrthographicCamera((0, 1, 0), (0, 0, 0), (0, 0, -1), height=2.0, near=0.1, far=2.0, resolution=(32, 32))
    lights = {
        "sun": DirectionalLight((0, -1, 0), (0, 1, 0), (9, 9), -3, 3),
        "lamp": PointLight((0, 4.0, 0), 0.1, 20.0),
        "large lamp": PointLight((0, 4.0, 0), 0.1, 20.0, radius=0.2),
    }
    scene = Scene(together([floor(half=1.0), card]), camera, lights[light])
    assert hides_light(scene, half_of(scene, 1)) == hides


def test_a_part_that_does_not_cast_hides_no_light():
    scene = lamp_in_its_bulb(True, False)
    bulb = np.arange(scene.mesh.faces.shape[0]) >= len(scene.meshes[0].faces)
    assert not hides_light(scene, bulb)
    assert hides_light(scene, bulb, "all")
    assert hides_light(scene, ~bulb)


@pytest.mark.parametrize("radius", [0.0, 0.2])
def test_hidden_pixels_are_the_dark_ones_on_what_is_turned_to_the_lights_centre(radius):
    camera = OrthographicCamera((1, 2, 3), (0, 0, 0), (0, 1, 0), height=3.0, near=0.1, far=9.0, resolution=(24, 32))
    card = quad((0, 0.6, 0), (0.4, 0, 0), (0, 0.3, 0.2))
    scene = Scene(together([floor(half=1.0), card]), camera, PointLight((0.5, 2, 1.0), 0.1, 20.0, radius=radius))
    hard = trace_visibility(Scene(scene.meshes, camera, PointLight((0.5, 2, 1.0), 0.1, 20.0)))
    towards = np.array([0.5, 2, 1.0]) - hard.position
    turned = hard.mask & ((hard.normal * towards).sum(axis=-1) > 0)
    expected = turned & (hard.visibility == 0)
    assert 0 < expected.sum() < turned.sum()
    np.testing.assert_array_equal(hidden_pixels(scene, half_of(scene, 1)), expected)
    assert not hidden_pixels(scene, half_of(scene, 0)).any()
    assert not hidden_pixels(scene, np.zeros(4, bool)).any()


def test_a_part_hides_light_behind_another_part_and_of_any_of_several_lights():
    camera = OrthographicCamera((0, 1, 0), (0, 0, 0), (0, 0, -1), height=2.0, near=0.1, far=2.0, resolution=(16, 16))
    over, under = (quad((0, y, 0), (0.5, 0, 0), (0, 0, -0.5)) for y in (2.0, 1.5))
    away, down = (DirectionalLight(d, (0, 1, 0), (9, 9), -3, 3) for d in ((0, 1, 0), (0, -1, 0)))
    scene = Scene(together([floor(half=1.0), over, under]), camera, [away, down])
    assert hides_light(scene, half_of(scene, 1))
    assert hides_light(scene, half_of(scene, 2))
    assert not hides_light(scene.lit_by(0), half_of(scene, 2))


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("trace_visibility", lambda scene, x: trace_visibility(scene, samples=1)),
        ("trace_visibility", lambda scene, x: trace_visibility_exact(scene, samples=1)),
        ("reference_from_image", lambda scene, x: reference_from_image(jnp.full((8, 8), x), scene)),
        ("key_parts", lambda scene, x: key_parts(scene)),
    ],
)
def test_a_traced_scene_is_refused_by_name(name, call):
    scene = Scene([floor()], from_above(resolution=(8, 8)), sun())

    @jax.jit
    def traced(x):
        moved = eqx.tree_at(lambda one: one.meshes[0].vertices, scene, scene.meshes[0].vertices + x)
        call(moved, x)
        return x

    with pytest.raises(ValueError, match=rf"{name} was called inside jax.jit .or grad, or vmap.*trace outside"):
        traced(0.5)
