"""Fits of lights and casters: what moves and how, that outlines are seen to move, and what is told of the result."""

import dataclasses
import functools
import gc
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
from scenes import LAMP, floor_camera, marked, quad, sun
from scipy.ndimage import gaussian_filter

from diffshadow.fit import (
    Anneal,
    Arrangement,
    MeshPose,
    Parameter,
    Parameters,
    PoseProblem,
    Search,
    Solver,
    cone_fraction,
    fit,
    parameter_names,
    resolve,
    with_values,
)
from diffshadow.fit._phases import Phase, phases_of
from diffshadow.fit._precision import on_grids, precision_of
from diffshadow.fit._programs import compiled
from diffshadow.fit._run import Run, Trajectory
from diffshadow.fit._starts import starts_within
from diffshadow.fit.problems import Joint, blurs_of
from diffshadow.fit.solvers import Adam, LevenbergMarquardt, Stop
from diffshadow.fit.solvers._adam import _Descent
from diffshadow.fit.solvers._levenberg_marquardt import NielsenDamping
from diffshadow.fit.solvers._levenberg_marquardt import _State as NielsenState
from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    OrthographicCamera,
    PointLight,
    RectangleLight,
    Scene,
    SpotLight,
    crease_normals,
    merge,
)
from diffshadow.raster import draw_surface, points_within_pixels
from diffshadow.reference import reference_from_image, trace_visibility
from diffshadow.shadow import Bias, Bilinear, Cascades, MapSettings, PerspectiveWarp, ShadowMapping, SingleMap

FLOOR, CARD = quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), quad((0, 1, 0), (0.5, 0, 0), (0, 0, -0.5))
POINTS = merge([FLOOR, CARD]).vertices
LIGHTS = {
    "directional": sun(merge([FLOOR, CARD]), angular_radius=1.5),
    "spot": SpotLight.around(jnp.asarray(LAMP), POINTS, radius=0.1),
    "point": PointLight.around(jnp.asarray(LAMP), POINTS, radius=0.2),
    "rectangle": RectangleLight.around(jnp.asarray(LAMP), POINTS, (0.3, 0.2)),
}
NARROW = Search(blurs=(3.0,))
TECHNIQUE = ShadowMapping(Bilinear(), Bias(0.5, 0.5, 0.0))
AZIMUTH, ELEVATION = "lights.0.azimuth", "lights.0.elevation"


def problem(light, *, moves=False, meshes=(FLOOR, CARD), camera=None, texels=64, silhouettes=True, pulled=()):
    """The card over the floor; nothing is known of its shadow yet."""
    camera = camera or floor_camera(1.5, (64, 64))
    poses = [MeshPose.of(mesh, pulled if mesh is meshes[-1] else ()) for mesh in meshes]
    shape = camera.resolution
    surface = None if moves else draw_surface(merge(meshes), camera)
    return PoseProblem(
        arrangement=Arrangement.of(TECHNIQUE, [light], poses),
        scene=Scene(meshes, camera, light),
        index=0,
        reference=jnp.ones(shape),
        weight=jnp.ones(shape),
        settings=MapSettings((texels, texels), silhouettes=silhouettes),
        surface=surface,
    )


@eqx.filter_jit
def _seen(technique, shadow_map, surface):
    return technique.visibility(shadow_map, surface) * cone_fraction(shadow_map.light, surface)


def image(problem, paths, values):
    """What `problem` makes of its arrangement with `values` at `paths`."""
    arrangement = with_values(problem.arrangement, paths, jnp.asarray(values, jnp.float32))
    return _seen(arrangement.technique, *problem.draw(arrangement))


def to_recover(problem, paths, truth):
    """With the shadow that it has with `truth` at `paths`."""
    return dataclasses.replace(problem, reference=image(problem, paths, truth))


def values(problem, paths):
    return [float(resolve(problem.arrangement, path)) for path in paths]


@pytest.mark.parametrize("kind", LIGHTS)
def test_light_pose_is_the_light_as_it_stands(kind):
    light = LIGHTS[kind]
    placed = light.at(light.pose())
    assert type(placed) is type(light)
    for field in ("position", "direction", "radius", "angular_radius"):
        if hasattr(light, field) and field != "direction":
            np.testing.assert_allclose(getattr(placed, field), getattr(light, field), rtol=1e-6)
    if kind == "directional":
        unit = lambda v: np.asarray(v) / np.linalg.norm(v)
        np.testing.assert_allclose(unit(placed.direction), unit(light.direction), atol=1e-6)
    clip = placed.refitted(POINTS).view()
    np.testing.assert_allclose(clip.near, light.near, rtol=1e-3)
    np.testing.assert_allclose(clip.far, light.far, rtol=1e-3)


def test_azimuth_and_elevation_go_over_the_pole():
    light = LIGHTS["directional"]
    at = lambda *angles: light.at(with_values(light.pose(), ("azimuth", "elevation"), jnp.array(angles)))
    way = lambda azimuth, elevation: np.asarray(at(azimuth, elevation).direction)
    np.testing.assert_allclose(way(90.0, 0.0), [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(way(0.0, 30.0), [0, -0.5, -np.sqrt(0.75)], atol=1e-6)
    np.testing.assert_allclose(way(20.0, 100.0), way(200.0, 80.0), atol=1e-6)


def test_mesh_pose_moves_turns_and_pulls():
    pose = MeshPose.of(CARD, vertices=(2,), home=(0.0, 5.0, 0.0))
    np.testing.assert_allclose(pose.placed(CARD).vertices, CARD.vertices)
    moved = with_values(pose, ("translate.y", "turn.y", "vertices.2.y"), jnp.array([6.0, 90.0, 1.5])).placed(CARD)
    # A quarter turn about +y takes x to -z and z to x.
    expected = np.asarray(CARD.vertices) @ np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]) + [0, 1, 0]
    expected[2, 1] += 0.5
    np.testing.assert_allclose(moved.vertices, expected, atol=1e-6)
    # Both triangles stay smooth with one another: the mean of their normals where they meet, by their angles there.
    normals = crease_normals(expected, np.asarray(CARD.faces), 180.0)
    np.testing.assert_allclose(moved.corner_normals, normals, atol=1e-6)
    with pytest.raises(ValueError, match="the mesh has no vertex 4; expected an index from 0 to 3"):
        MeshPose.of(CARD, vertices=(4,))


def test_vertices_in_one_place_move_together():
    split = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [3, 4, 5]])
    pose = with_values(MeshPose.of(split, vertices=(1,)), ("vertices.1.z",), jnp.array([2.0]))
    assert pose.placed(split).vertices[:, 2].tolist() == [0, 2, 0, 2, 0, 0]


def test_every_number_of_an_arrangement_has_a_path():
    arrangement = problem(LIGHTS["spot"], moves=True, pulled=(1,)).arrangement
    names = parameter_names(arrangement)
    assert {"technique.bias.constant", "lights.0.position.x", AZIMUTH, "meshes.1.vertices.1.z"} <= set(names)
    numbered = with_values(arrangement, names, jnp.arange(float(len(names))))
    assert [float(resolve(numbered, name)) for name in names] == list(range(len(names)))
    with pytest.raises(
        ValueError, match=r"no parameter 'lights.1.azimuth' in a Arrangement; expected one of technique"
    ):
        resolve(arrangement, "lights.1.azimuth")


@pytest.mark.exhaustive
def test_traced_references_are_dark_outside_the_cone_and_images_are_left_alone():
    light = SpotLight((0, 2, 0), (0, -1, 0), 30.0, 0.1, 9, inner_angle=15.0)
    scene = Scene([FLOOR, CARD], floor_camera(1.5, (64, 64)), light)
    traced = trace_visibility(scene, samples=1)
    surface = draw_surface(scene.mesh, scene.camera)
    expected = traced.visibility * np.asarray(cone_fraction(light, surface))
    assert expected.mean() < 0.9 * traced.visibility.mean()
    of = lambda truth: np.asarray(PoseProblem.of(scene, TECHNIQUE, truth, surface=surface).reference)
    np.testing.assert_allclose(of(traced), expected, atol=1e-6)
    np.testing.assert_array_equal(of(reference_from_image(expected, scene)), expected)


def test_a_fit_of_poses_looks_up_shadows_all_over_its_pixels():
    """At so many points as a pixel is wide in texels, and at the centre where texels are wide."""
    camera = floor_camera(1.5, (32, 48))
    scene = Scene([FLOOR, CARD], camera, LIGHTS["directional"])
    truth = reference_from_image(np.full(camera.resolution, 0.5, np.float32), scene)
    surface = draw_surface(scene.mesh, camera)
    of = lambda texels, **given: PoseProblem.of(
        scene, dataclasses.replace(TECHNIQUE, map=MapSettings((texels, texels))), truth, surface=surface, **given
    )
    counts = [of(texels).shadow_points for texels in (8, 64, 128, 1024)]
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (1, 21)
    problem = of(64, points=3)
    shadow_map, _ = problem.draw(problem.arrangement, raises=False)
    points = points_within_pixels(surface, camera, 3)
    expected = points.mean(TECHNIQUE.visibility(shadow_map, points.surface))
    np.testing.assert_allclose(problem.image(shadow_map, surface, TECHNIQUE), expected, atol=1e-6)
    assert np.abs(np.asarray(expected) - TECHNIQUE.visibility(shadow_map, surface)).max() > 0.05


def test_the_noise_of_a_solver_is_that_of_the_problem_unless_it_is_given():
    assert [Solver().for_problem(moves).noise for moves in (False, True)] == [0.0, 0.25]
    assert Solver(noise=0.1).for_problem(True).noise == 0.1


def test_blurs_fall_and_suit_the_images():
    np.testing.assert_allclose(blurs_of(None, 256, 512), (32, 96**0.5, 3))
    assert blurs_of(None, 20) == (3,)
    assert blurs_of([8.0, 0.0], 64, 96) == (8, 0)
    for wrong in ([], [3.0, 3.0], [2.0, 4.0]):
        with pytest.raises(ValueError, match="expected numbers that fall"):
            blurs_of(wrong, 64)
    with pytest.raises(ValueError, match="a blur of 9 pixels is too wide for an image with a side of 64; expected 8"):
        blurs_of([9.0, 1.0], 256, 64)


def test_phases_narrow_the_blur_and_only_the_last_fit_all_numbers():
    paths = ("technique.filter.radius", AZIMUTH)
    joint = Joint.of(problem(SUN))
    phases = phases_of(joint, paths, Anneal(), [8.0, 5.0, 2.0], 1 << 16)
    texel = phases[-1].blurs[0]
    assert [phase.blurs for phase in phases] == [(8,), (5,), (2,), (texel,)]
    assert 1 <= texel < 2
    assert [phase.active for phase in phases] == [(1,), (1,), (0, 1), (0, 1)]
    assert [phase.shared for phase in phases] == [True, True, False, False]
    assert [phase.stop.shortest > 0 for phase in phases] == [True, True, False, False]
    # Under one blur, all starts run to the end.
    assert all(phase.shared for phase in phases_of(joint, paths, Anneal(), [3.0], 1 << 16))
    # A bias hardens the compare in the last phases.
    phases = phases_of(joint, ("technique.bias.constant", AZIMUTH), Anneal(phases=2), [8.0, 3.0], 1 << 16)
    assert [phase.width for phase in phases] == [0, *Anneal(phases=2).widths, phases[-1].width]
    assert [phase.blurs for phase in phases[:3]] == [(8,), (3,), (3,)]


def test_all_phases_get_the_memory_that_one_needs():
    phase = Phase(Joint.of(problem(SUN)), (0,), 0.0)
    larger = Joint.of(dataclasses.replace(phase.joint.problems[0], crossings=64, blur=1.0))
    (grown,) = phase.with_memory_of(larger).joint.problems
    assert (grown.crossings, float(grown.blur)) == (64, 3.0)


@pytest.mark.parametrize("deviation", [0, 3, 8])
def test_differences_are_compared_under_a_gaussian(deviation):
    """What is off counts for some way around, so that a shadow far from its place is seen to be off."""
    one = dataclasses.replace(problem(LIGHTS["directional"], moves=True), blur=deviation)
    sharp = np.random.default_rng(0).normal(size=(64, 80))
    blurred = gaussian_filter(sharp, deviation, mode="constant", truncate=8.0) if deviation else sharp
    np.testing.assert_allclose(one.compared(jnp.asarray(sharp[None], jnp.float32))[0], blurred, atol=1e-5)


def test_starts_are_the_first_and_an_even_spread():
    bounds = Parameters.of([Parameter("a", 1.0, 0.0, 4.0), Parameter("b", -1.0, -2.0, 0.0)])
    first = jnp.array([1.0, -1.0])
    starts = np.asarray(starts_within(bounds, first, 9, seed=3))
    assert starts[0].tolist() == [1, -1]
    shares = (starts[1:] - [0, -2]) / [4, 2]
    # A point in each eighth along each axis: a Sobol sequence's mark.
    assert sorted(np.floor(shares[:, 0] * 8)) == sorted(np.floor(shares[:, 1] * 8)) == list(range(8))
    np.testing.assert_array_equal(starts, starts_within(bounds, first, 9, seed=3))
    assert (starts[1:] != starts_within(bounds, first, 9, seed=4)[1:]).all()


def _gaussian(image, deviation):
    return gaussian_filter(image, deviation, mode="constant", truncate=4) if deviation else image


@pytest.mark.parametrize("grids", [1, 5])
@pytest.mark.parametrize("blur", [0.0, 0.5], ids=["sharp", "blurred"])
def test_precision_is_its_formula(blur, grids):
    """With sums over all pairs of pixels: A⁻¹ S A⁻¹ + δ₀ δ₀ᵀ + mean(δₖ δₖᵀ), A = JᵀB²J. Here δ is the step for the
    residual on each grid. The fit's own grid is the first, and S is of its residual alone."""
    rng, reach = np.random.default_rng(5), max(1, round(4 * blur))
    slopes, residuals = rng.normal(size=(2, 7, 9)), 0.05 * rng.normal(size=(grids, 7, 9))
    span = np.array([2.0, 5.0])
    once = np.stack([_gaussian(image, blur) for image in slopes])
    twice = np.stack([_gaussian(image, blur) for image in once])
    score = (twice * residuals[0]).reshape(2, -1)
    y, x = np.indices(residuals.shape[1:]).reshape(2, -1)
    near = lambda at: np.maximum(0, 1 - abs(at[:, None] - at) / reach)
    inverse = np.linalg.inv(np.einsum("phw,qhw->pq", once, once))
    covariance = inverse @ (score @ (near(x) * near(y)) @ score.T) @ inverse
    for number, residual in enumerate(residuals):
        step = inverse @ np.einsum("phw,hw->p", once, _gaussian(residual, blur))
        covariance += np.outer(step, step) / (1 if number == 0 else grids - 1)
    told = precision_of("ab", [residuals], [slopes], [blur], span)
    deviations = np.sqrt(np.diag(covariance))
    assert [told.deviations[name] for name in "ab"] == pytest.approx(deviations * span, rel=1e-6)
    np.testing.assert_allclose(told.correlations, covariance / np.outer(deviations, deviations), rtol=1e-6)


def test_precision_tells_how_far_the_grid_of_texels_moves_a_fit():
    """Without residuals on its own grid, the fit has the mean square of the steps on the others."""
    slopes = np.random.default_rng(4).normal(size=(1, 20, 20))
    residuals = np.array([0.0, 0.3, -0.3, 0.1, -0.1])[:, None, None] * slopes
    told = precision_of("a", [residuals], [slopes], [0.0], np.full(1, 10.0))
    assert told.deviations["a"] == pytest.approx(10 * np.sqrt(0.05))


GRIDS = {
    "sun": ("directional", SingleMap(), True),
    "point": ("point", SingleMap(), True),
    "cascades": ("directional", Cascades(2, margin=2.0), True),
    "warped": ("directional", PerspectiveWarp(), False),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", marked(GRIDS, {"cascades", "point", "warped"}))
def test_other_grids_have_their_texels_elsewhere(name):
    kind, layout, is_even = GRIDS[name]
    one = problem(LIGHTS[kind], silhouettes=is_even)
    technique = dataclasses.replace(TECHNIQUE, layout=layout)
    one = dataclasses.replace(one, arrangement=dataclasses.replace(one.arrangement, technique=technique)).planned()
    joint = Joint.of(one)
    own, _ = joint.differences(joint.subject)
    (found,) = on_grids(joint, tuple(3 * each for each in own), np.array([3.0]))
    assert found.shape == (5, 64, 64)
    np.testing.assert_array_equal(found[0], 3 * own[0][0])
    off = np.abs(found[1:] - found[0]).sum(axis=(1, 2)) / np.abs(found[0]).sum()
    if is_even:
        # Only pixels at the outline see another texel.
        assert 0 < off.min() <= off.max() < 0.06, off
    else:
        np.testing.assert_allclose(found[1:], found[:1].repeat(4, axis=0), atol=1e-6)


@pytest.mark.exhaustive
def test_a_grid_whose_silhouettes_exceed_their_memory_is_left_out():
    joint = Joint.of(dataclasses.replace(problem(SUN), crossings=1))
    own, _ = joint.differences(joint.subject)
    assert [images.shape for images in on_grids(joint, own, np.ones(1))] == [(1, 64, 64)]


def test_precision_counts_the_step_that_a_fit_has_left():
    rng = np.random.default_rng(3)
    slopes, left = rng.normal(size=(2, 20, 20)), np.array([0.3, -0.2])
    residual = 1e-6 * rng.normal(size=(20, 20)) + np.einsum("p,phw->hw", left, slopes)
    told = precision_of("ab", [residual[None]], [slopes], [0.0], np.ones(2))
    assert min(told.deviations["a"] / 0.3, told.deviations["b"] / 0.2) > 1


def test_what_an_image_cannot_tell_apart_is_named():
    a, b = np.random.default_rng(1).normal(size=(2, 20, 20))
    # b and c do the same, a is by itself, d does nothing.
    slopes = np.stack([a, b, b, 0 * a])
    told = precision_of("abcd", [np.full((1, 20, 20), 0.01)], [slopes], [0.0], np.ones(4))
    assert told.names == ("a", "b", "c")
    assert told.undetermined == [("b", "c")]
    assert told.deviations["a"] < 1 < min(told.deviations["b"], told.deviations["c"])


def test_of_losses_within_the_noise_the_last_phase_is_chosen():
    path = lambda *losses: Trajectory([], [], list(losses), [], [])
    # Where pixels jump, a start may have a lower loss than the place that the slopes lead to.
    assert path(1.0, 1.2).chosen(0.25) == 1
    assert path(1.0, 1.2, 1.3).chosen(0.25) == 1
    assert path(1.0, 1.2).chosen(0.0) == 0


def test_the_start_with_the_least_loss_runs_the_remaining_phases():
    losses, runs = {(1.0,): 0.7, (2.0,): 0.2, (3.0,): 0.4}, []

    def along(phases, path):
        runs.append((phases, path.values[0]))
        return Trajectory([], path.values, [losses[path.values[0]]], [], [])

    solving = SimpleNamespace(
        phases=[SimpleNamespace(shared=shared) for shared in (True, False, False)],
        reporter=SimpleNamespace(start=None),
        _along=along,
        _start=lambda initial: Trajectory([], [(float(initial[0]),)], [], [], []),
    )
    path, tried = Run.through(solving, jnp.array(list(losses)))
    assert [start.loss for start in tried] == [0.7, 0.2, 0.4]
    assert runs == [*(([0], start) for start in losses), ([1, 2], (2.0,))]
    assert (path.values[0], solving.reporter.start) == ((2.0,), 1)


def test_fits_of_other_numbers_share_a_program():
    scaled = eqx.filter_jit(lambda x, by: x * by)
    one = compiled(scaled, (jnp.ones(3), 2.0))
    assert compiled(scaled, (jnp.zeros(3), 2.0)) is one
    np.testing.assert_array_equal(one(jnp.arange(3.0), 2.0), [0, 2, 4])
    assert compiled(scaled, (jnp.ones(3), 3.0)) is not one, "a Python number is part of the program"
    assert compiled(scaled, (jnp.ones(4), 2.0)) is not one
    with pytest.raises(TypeError):
        compiled(scaled, (jnp.ones(5), "a word"))
    assert gc.isenabled(), "the garbage collector pauses only while programs are traced"


def test_meshes_of_like_size_share_a_program():
    def padded(*meshes, pulled=()):
        plain = problem(LIGHTS["spot"], moves=True, meshes=meshes, pulled=pulled)
        return dataclasses.replace(plain, edges=Edges.of(plain.scene.casters), crossings=8).padded()

    kind = lambda leaf: (jnp.shape(leaf), jnp.result_type(leaf))
    one, other = padded(CARD, FLOOR, CARD), padded(merge([CARD, FLOOR]), CARD, FLOOR)
    assert jax.tree.flatten(jax.tree.map(kind, one)) == jax.tree.flatten(jax.tree.map(kind, other))
    for each in (one, other):
        # The edges are those of the meshes as they are filled up.
        found = Edges.of(each.scene.casters)
        for name in ("vertices", "faces", "directions"):
            rows = np.asarray(getattr(each.edges, name))
            np.testing.assert_array_equal(rows[: len(found.faces)], getattr(found, name))
        assert not np.asarray(each.edges.directions)[len(found.faces) :].any()
    pulled = padded(FLOOR, CARD, pulled=(1,)).scene.meshes[1]
    assert len(pulled.vertices) == len(CARD.vertices), "what fills it up would not move with its vertex"


def test_steps_of_adam_are_as_long_as_its_rate():
    """Under one gradient, however small: the means are corrected for their start from 0."""
    y, found = jnp.array([3.0, -1.0]), SimpleNamespace(f=jnp.float32(0), grad=jnp.array([1e-3, -50.0]))
    descent = _Descent(lambda **_: None, 1_000_000)
    state = descent.init(y, None)
    for _ in range(3):
        state = descent.query(y, found, state)
        step, _ = descent.step(jnp.float32(0.1), state)
        np.testing.assert_allclose(step, [-0.1, 0.1], rtol=1e-3)


def test_adam_finds_the_bottom_of_a_valley():
    reports = []
    adam = Adam(0.1, 200, 1e-9, 1e-9, lambda **told: reports.append(set(told)))
    loss = lambda y, _: jnp.sum(jnp.array([1.0, 30.0]) * (y - jnp.array([0.3, -0.2])) ** 2)
    options = {"autodiff_mode": "fwd"}
    found = optx.minimise(loss, adam, jnp.zeros(2), options=options, max_steps=200, throw=False)
    np.testing.assert_allclose(found.value, [0.3, -0.2], atol=1e-3)
    assert len(reports) >= 1
    assert all(told == {"loss_this_step", "y"} for told in reports)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_damping_follows_nielsens_formula(noise):
    """Of the residual y², from 1 to y, where the model is 1 + 2 (y - 1)."""
    damping = NielsenDamping(noise)
    info = lambda y: optx.FunctionInfo.ResidualJac(y[None] ** 2, lx.MatrixLinearOperator(2 * y[None, None]))
    start, state = jnp.asarray(1.0), NielsenState(jnp.asarray(0.3), jnp.asarray(4.0))
    for y in (0.8, 0.6, 0.4, -0.2, 1.2):
        given = start, jnp.asarray(y), info(start), info(jnp.asarray(y)), state
        size, accepted, _, after = damping.step(jnp.asarray(False), *given)
        change = lambda end: noise / 2 + (1 - end**2) / 2
        model, rise = change(2 * y - 1), change(y**2)
        assert bool(accepted) == (model > 0 and rise > 0)
        slower = max(1 / 3, 1 - (2 * rise / model - 1) ** 3)
        np.testing.assert_allclose(size, 0.3 / (slower if accepted else 4), rtol=1e-5)
        np.testing.assert_allclose(after.shrink, 2 if accepted else 8)
        # The first step is taken as it is.
        size, accepted, _, _ = damping.step(jnp.asarray(True), *given)
        assert accepted
        np.testing.assert_allclose(size, 1 / (0.01 * 4 * y**2), rtol=1e-5)


def test_levenberg_marquardt_ends_where_the_loss_is_least_at_a_jump():
    # Its derivative leads over the edge, and no step over it is ever accepted.
    over_the_edge = lambda y, _: jnp.stack([1 - y[0], jnp.where(y[0] > 0.5, 2.0, 0.0)])
    solvers = (LevenbergMarquardt(1e-4, 1e-6, lambda **_: None, stop=Stop(shortest=size)) for size in (0.0, 0.05))
    exact, rough = (
        optx.least_squares(over_the_edge, solver, jnp.zeros(1), max_steps=60, throw=False) for solver in solvers
    )
    assert exact.result == rough.result == optx.RESULTS.successful
    assert 0.49 < float(exact.value[0]) <= 0.5
    assert 0.4 < float(rough.value[0]) <= 0.5
    assert int(rough.stats["num_steps"]) < int(exact.stats["num_steps"]) < 40


@pytest.mark.exhaustive
def test_levenberg_marquardt_follows_its_model_through_noise():
    # It begins in a dip that no derivative knows of, and whose bottom lies lower than the best of all else.
    noisy = lambda y, _: jnp.concatenate([jnp.where(jnp.abs(y) < 0.05, 0.9, 1.0), 0.3 * (y - 1)])
    found = {}
    for noise in (0.0, 0.25):
        solver = LevenbergMarquardt(1e-4, 1e-6, lambda **_: None, noise)
        found[noise] = optx.least_squares(noisy, solver, jnp.zeros(1), max_steps=60, throw=False)
        assert found[noise].result == optx.RESULTS.successful
    assert float(found[0.25].value[0]) == pytest.approx(1, abs=0.05)
    assert abs(float(found[0.0].value[0])) < 0.05


SUN = LIGHTS["directional"]


def absolute(predicted, reference, mask):
    """The mean absolute error."""
    return jnp.sum(jnp.abs(predicted - reference), where=mask) / jnp.sum(mask)


@pytest.mark.exhaustive
def test_a_users_loss_of_poses_sees_images_and_their_blur():
    paths = (AZIMUTH, ELEVATION)
    one = problem(SUN)
    azimuth, elevation = values(one, paths)
    one = to_recover(one, paths, [azimuth + 9, elevation - 7])
    joint = Joint.of(one, absolute)
    found = joint.losses(joint.subject)
    shown, reference = np.asarray(image(one, paths, [azimuth, elevation])), np.asarray(one.reference)
    blur = functools.partial(gaussian_filter, sigma=one.blur_in_pixels, mode="constant")
    assert float(found.whole) == pytest.approx(float(np.mean(np.abs(shown - reference))), rel=1e-4)
    assert float(found.compared) == pytest.approx(float(np.mean(np.abs(blur(shown) - blur(reference)))), rel=0.02)
    assert 0 < float(found.compared) < 0.95 * float(found.whole)


@pytest.fixture(scope="module")
def recovered():
    """The sun of a known shadow, found with memory for too few silhouettes at first; the truth, the problem and the
    result."""
    paths = (AZIMUTH, ELEVATION)
    one = problem(SUN)
    truth = values(one, paths)
    one = to_recover(one, paths, truth)
    spans = [(truth[0] + 9, truth[0] - 25, truth[0] + 25), (truth[1] - 7, truth[1] - 20, truth[1] + 20)]
    parameters = [Parameter(path, *span, unit="degrees") for path, span in zip(paths, spans, strict=True)]
    planned = PoseProblem.planned
    tight = lambda p: dataclasses.replace(p, crossings=1, edges=p.edges_of_casters())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PoseProblem, "planned", lambda p: tight(p) if p.crossings is None else planned(p))
        result = fit(one, parameters, search=NARROW)
    assert result.enlargements >= 1
    return truth, one, result


@pytest.mark.exhaustive
def test_sun_is_recovered_from_its_shadow(recovered):
    truth, one, result = recovered
    # A tenth of a pixel is 0.3 degrees here.
    np.testing.assert_allclose(list(result.fitted.values()), truth, atol=0.4)
    found = values(dataclasses.replace(one, arrangement=result.arrangement), tuple(result.fitted))
    np.testing.assert_allclose(found, list(result.fitted.values()), rtol=1e-6)
    assert result.phases[-1].hard_loss < 1e-3
    assert result.phases[0].blur == 3.0
    # A texel is two to three pixels wide.
    assert 1.2 < result.phases[1].blur < 2.2
    assert result.flat == []


@pytest.mark.exhaustive
def test_what_overflowed_is_not_remembered_as_a_step(recovered):
    _, _, result = recovered
    for phase in range(len(result.phases)):
        numbers = [step.step for step in result.history if step.phase == phase]
        assert numbers == list(range(len(numbers)))


VERTEX = ("meshes.1.vertices.2.x", "meshes.1.vertices.2.y")
BELOW = OrthographicCamera((0, 0, 0), (0, 0, -1), (0, 1, 0), height=1.0, near=0.5, far=3.0, resolution=(64, 64))


def minimal_plane(silhouettes=True):
    """A square over a square, whose vertex 2 is to be found where it has half its x and y.

    Worchel & Alexa, "Differentiable shadow mapping for efficient inverse graphics", CVPR 2023, figure 5.
    """
    meshes = quad((0, 0, -2), (0.5, 0, 0), (0, 0.5, 0)), quad((0, 0, 1), (0.375, 0, 0), (0, 0.375, 0))
    light = DirectionalLight.around(jnp.array([0.0, 0.0, -1.0]), merge(meshes).vertices)
    one = problem(light, meshes=meshes, camera=BELOW, texels=32, silhouettes=silhouettes, pulled=(2,))
    # The camera stands below the caster and sees the receiver alone; only the map is drawn anew.
    one = dataclasses.replace(one, surface=draw_surface(meshes[0], BELOW))
    return to_recover(one, VERTEX, [0.1875, 0.1875])


def pull(one):
    parameters = [Parameter(path, 0.375, 0.0, 0.5, "world units") for path in VERTEX]
    return fit(one, parameters, solver=Solver("levenberg_marquardt", 60, 1e-6, 1e-7), search=NARROW)


@pytest.mark.exhaustive
def test_vertex_of_the_minimal_plane_is_recovered():
    result = pull(minimal_plane())
    assert all(phase.steps <= 60 for phase in result.phases)
    assert result.phases[-1].hard_loss < 1e-6
    np.testing.assert_allclose(list(result.fitted.values()), 0.1875, atol=2e-3)
