"""Configurations: the modules that they stand for."""

import json
import math
import re
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from diffshadow.config import (
    ConfigError,
    build_fit,
    build_scene,
    build_shading,
    build_technique,
    dump_resolved,
    fit_paths,
    load_config,
    parse_config,
    with_fitted,
)
from diffshadow.config.sections._technique import FILTERS
from diffshadow.fit import resolve
from diffshadow.geometry import face_normals
from diffshadow.io import MeshWarning
from diffshadow.settings import biases
from diffshadow.settings.maps import SoftCompare
from diffshadow.shadow import ThreeJs

TINY = "scene: {meshes: [{path: 'builtin:torus_knot'}]}\n"


def build(*overrides: str, text: str = TINY):
    return build_scene(parse_config(text, overrides))


TURN = [30, 50, 20]


def test_mesh_is_sized_dropped_scaled_turned_and_moved():
    text = "scene: {meshes: [{path: 'builtin:box', size: 2, drop_to_ground: true, scale: 0.5}]}"
    moved = build("scene.meshes.0.translate=[1, 2, 3]", "scene.meshes.0.rotate=[90, 0, 90]", text=text)
    # A unit cube on the ground; about x, up becomes +z; about z, +y becomes -x, and +z stays.
    assert np.allclose(moved.mesh.bounds, [[0.5, 1.5, 3], [1.5, 2.5, 4]], atol=1e-6)
    assert np.allclose(moved.mesh.corner_normals, face_normals(moved.mesh)[:, None], atol=1e-6)
    plain, turned = (build(f"scene.meshes.0.rotate={angles}", text=text).mesh.vertices for angles in ([0] * 3, TURN))
    np.testing.assert_allclose(turned, Rotation.from_euler("xyz", TURN, degrees=True).apply(plain), atol=1e-6)


FAR = (6e5, -8e3, 3e6)
LIGHTS = {
    "shadow camera": "{type: directional, shadow_camera: {position: [X1, Y4, Z2], near: 0.5, far: 9}}",
    "sun": "{type: directional, azimuth: 40}",
    "spot": "{type: spot, position: [X2, Y4, Z1], target: [X0.5, Y0, Z0]}",
    "point": "{type: point, orbit: {azimuth: 30}}",
    "rectangle": "{type: rectangle, position: [X2, Y4, Z1], target: [X0.5, Y0, Z0]}",
}


def placed_at(text, origin):
    """`text` with its coordinates, such as X1.5, counted from `origin`."""
    return re.sub(r"([XYZ])(-?[0-9.]+)", lambda m: repr(float(m[2]) + origin["XYZ".index(m[1])]), text)


@pytest.mark.parametrize("light", LIGHTS)
def test_a_scene_far_from_the_worlds_origin_is_the_same_one(light):
    text = (
        "scene:\n"
        "  meshes: [{path: 'builtin:box', rotate: [0, 20, 0], translate: [X0.3, Y0, Z0.1]},\n"
        "    {path: 'builtin:plane', options: {size: 6}, translate: [X0, Y0, Z0]}]\n"
        f"  light: {LIGHTS[light]}\n"
        "  camera: {eye: [X2.2, Y2.4, Z3], target: [X0, Y0.5, Z0]}\n"
    )
    near, far = (build_scene(parse_config(placed_at(text, origin))) for origin in ((0.0, 0.0, 0.0), FAR))
    assert near.origin == (0, 0, 0)
    assert far.origin == FAR
    # Coordinates in the millions have nine digits in double precision after the point.
    for ours, theirs in zip(jax.tree.leaves(near), jax.tree.leaves(far), strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=1e-6, atol=1e-6)


def test_a_mistake_in_a_far_scene_says_what_coordinates_are_counted_from():
    mesh, camera = "{path: 'builtin:box', translate: [X0, Y0, Z0]}", "{eye: [X1, Y1, Z1], target: [X1, Y1, Z1]}"
    text = f"scene: {{meshes: [{mesh}], camera: {camera}}}"
    with pytest.raises(ConfigError, match=r"\[1.0, 1.0, 1.0\].*relative to the scene's origin, \[600000.0, -8000.0"):
        build_scene(parse_config(placed_at(text, FAR)))


def test_a_mesh_in_a_format_that_trimesh_reads_is_built_and_a_missing_package_named(tmp_path, monkeypatch):
    with zipfile.ZipFile(tmp_path / "part.zip", "w") as archive:
        archive.writestr("part.obj", "v 0 0 0\nv 2 0 0\nv 0 0 2\nf 1 3 2\n")
    text = "scene: {{meshes: [{{path: part.{}, size: 1}}]}}"
    with pytest.warns(MeshWarning, match="polygons as fans"):
        scene = build_scene(parse_config(text.format("zip"), folder=tmp_path))
    np.testing.assert_allclose(scene.mesh.bounds, [[-0.5, 0, -0.5], [0.5, 0, 0.5]], atol=1e-6)

    def fail(**_):
        raise ImportError("No module named 'lxml'")

    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, "3mf", fail)
    (tmp_path / "part.3mf").write_bytes(b"")
    with pytest.raises(ValueError, match=r"part\.3mf is in the format 3mf, which needs .* not installed: lxml"):
        build_scene(parse_config(text.format("3mf"), folder=tmp_path))


def test_poses_of_a_far_scene_are_fitted_from_its_origin_and_reported_in_the_world(tmp_path):
    poses = {
        "light.position.z": "{lower: Z0, upper: Z2}",
        "light.elevation": "{lower: 0, upper: 90}",
        "light.radius": "{lower: 0, upper: 1}",
        "meshes.0.translate.x": "{initial: X0.5, lower: X-1, upper: X1}",
        # Its file is where its vertices are.
        "meshes.1.translate.x": "{lower: -1, upper: 1}",
        "meshes.0.vertices.0.y": "{lower: Y-1, upper: Y1}",
    }
    text = (
        "scene: {meshes: [{path: 'builtin:box', translate: [X0.25, Y0, Z0]}, {path: far.obj}],\n"
        "  light: {type: spot, position: [X2, Y4, Z1], target: [X0, Y0, Z0]}, camera: {eye: [X3, Y3, Z3]}}\n"
        "filter: {type: pcss}\n"
        f"fit: {{parameters: {{{', '.join(f'scene.{name}: {bounds}' for name, bounds in poses.items())}}}}}\n"
    )

    def plan_at(origin):
        (tmp_path / "far.obj").write_text(placed_at("v X0 Y0 Z0\nv X1 Y0 Z0\nv X0 Y0 Z1\nf 1 2 3\n", origin))
        return build_fit(parse_config(placed_at(text, origin), folder=tmp_path))

    near, far = plan_at((0.0, 0.0, 0.0)), plan_at(FAR)
    x, y, z = FAR
    assert [p.offset for p in near.parameters] == [0] * len(poses)
    offsets = dict(zip(poses, (z, 0, 0, x, 0, y), strict=True))
    assert {p.name.removeprefix("scene."): p.offset for p in far.parameters} == offsets
    for ours, theirs in zip(near.parameters, far.parameters, strict=True):
        counted = theirs.counted()
        for end in ("initial", "lower", "upper"):
            assert getattr(counted, end) == pytest.approx(getattr(ours, end), rel=1e-6, abs=1e-6)
        assert far.truth[theirs.name] == pytest.approx(near.truth[ours.name] + theirs.offset, rel=1e-12)
        assert float(resolve(far.arrangement, theirs.where)) == pytest.approx(
            float(resolve(near.arrangement, ours.where)), rel=1e-6, abs=1e-6
        )


def test_camera_orbits_the_first_mesh_in_its_radii():
    text = "scene: {meshes: [{path: 'builtin:box', translate: [1, 0, 0]}, {path: 'builtin:plane', options: {size: 9}}]}"
    camera = build("scene.camera.orbit={azimuth: 90, elevation: 0, distance: 4}", text=text).camera
    radius = math.sqrt(3) / 2
    assert np.allclose(camera.target, [1, 0.5, 0], atol=1e-6)
    assert np.allclose(camera.eye, [1 + 4 * radius, 0.5, 0], atol=1e-5)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_near_and_far_hold_the_scene_tightly(kind):
    scene = build(f"scene.camera={{type: {kind}, eye: [0.2, 3, 4]}}")
    view = scene.camera.view()
    depth = -np.asarray(scene.mesh.vertices @ view.world_to_eye[2, :3] + view.world_to_eye[2, 3])
    near, far = float(scene.camera.near), float(scene.camera.far)
    assert near < depth.min()
    assert depth.max() < far
    assert far - near < 1.1 * (depth.max() - depth.min())


def test_orthographic_camera_holds_the_whole_scene_by_default():
    scene = build("scene.camera={type: orthographic, orbit: {}, resolution: [64, 32]}")
    clip = np.asarray(scene.camera.view().clip(scene.mesh.vertices))
    reach = np.abs(clip[:, :2]).max()
    assert 0.9 < reach <= 1


def test_camera_inside_the_scene_keeps_its_near_clear_of_zero():
    camera = build("scene.camera={eye: [0, 0.5, 0.05]}", text=TINY.replace("torus_knot", "sphere")).camera
    assert float(camera.near) == pytest.approx(1e-3 * float(camera.far), rel=1e-5)


def test_light_comes_from_where_its_angles_say():
    light = build("scene.light={azimuth: 90, elevation: 0}").light
    assert np.allclose(light.direction, [-1, 0, 0], atol=1e-6)
    light = build("scene.light={direction: [0, -2, 0], angular_radius: 0.5}").light
    assert np.allclose(light.direction, [0, -2, 0])
    assert float(light.angular_radius) == 0.5


def test_spot_light_takes_its_overrides():
    light = build("scene.light={type: spot, position: [0, 5, 0], near: 1, far: 9, outer_angle: 30, radius: 0.1}").light
    assert (float(light.near), float(light.far), float(light.outer_angle)) == (1, 9, 30)
    orbit = build("scene.light={type: spot, orbit: {elevation: 90, distance: 9}}").light
    assert orbit.position[1] > 3
    assert 0 < float(orbit.near) < float(orbit.far)


def test_faults_found_while_building_name_line_and_key():
    text = """\
scene:
  meshes:
    - path: builtin:box
      options: {sise: 3}
    - path: builtin:plane
      options: {size: -3}
"""
    with pytest.raises(ConfigError) as caught:
        build(text=text)
    first, second = (str(problem) for problem in caught.value.mistakes)
    assert first == (
        "configuration:4: scene.meshes.0.options.sise: is not an option of box; expected size; did you mean 'size'?"
    )
    assert second == (
        "configuration:6: scene.meshes.1.options.size: is -3; expected world units from 1e-06 to 1e+09; change it"
    )


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("scene.camera={eye: [0, 3, 0], target: [0, 3, 0]}", "scene.camera: the camera's eye and target are both"),
        ("scene.camera={eye: [0, 3, 0], target: [0, 9, 0]}", "scene.camera: the whole scene is behind the camera"),
        ("scene.camera.near=1e6", "scene.camera: the camera has near = 1000000.0"),
        ("scene.light={type: spot, position: [0, 0.3, 0]}", "scene.light: the spot light at"),
    ],
)
def test_poses_that_cannot_be_are_reported_with_their_key(override, said):
    with pytest.raises(ConfigError) as caught:
        build(override)
    assert str(caught.value).startswith(f"override {override!r}: {said}")


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        ("{path: builtin:box, scale: 1e12}", "scene.meshes.0: reaches 1e+12 world units from the origin"),
        ("{path: big.obj, scale: 1e15}", "scene.meshes.0: reaches 1e+45 world units from the origin"),
        ("{path: builtin:torus, options: {name: 3}}", "scene.meshes.0.options.name: is not an option of torus"),
        ("{path: builtin:torus, options: {segments: 4294967296}}", "scene.meshes.0.options.segments: is 4294967296"),
    ],
)
def test_mesh_beyond_single_precision_or_memory_is_reported_with_its_key(mesh, said, tmp_path):
    (tmp_path / "big.obj").write_text("v 1e30 0 0\nv 0 0 0\nv 0 1e30 0\nf 1 2 3\n")
    with pytest.raises(ConfigError) as caught:
        build_scene(parse_config(f"scene: {{meshes: [{mesh}]}}", folder=tmp_path, source="file.yaml"))
    assert str(caught.value).startswith(f"file.yaml:1: {said}")


def test_scene_of_too_many_triangles_is_reported(monkeypatch):
    monkeypatch.setattr("diffshadow.config.building._scene._MAX_TRIANGLES", 20)
    with pytest.raises(ConfigError, match=r"scene\.meshes\.1: brings the scene to 24 triangles; expected at most 20"):
        build(text="scene: {meshes: [{path: builtin:box}, {path: builtin:box}, {path: builtin:box}]}")


def test_damaged_mesh_file_is_reported_with_line_and_key(tmp_path):
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    file = tmp_path / "c.yaml"
    file.write_text("scene:\n  meshes:\n    - path: nan.obj\n")
    with pytest.raises(ConfigError) as caught:
        build_scene(load_config(file))
    assert str(caught.value).startswith(f"{file}:3: scene.meshes.0: ")


def test_render_takes_no_number_from_the_section_fit():
    text = f"{TINY}fit: {{parameters: {{bias.slope_most: {{initial: 3, lower: 0, upper: 5}}}}}}\n"
    config = parse_config(text)
    assert float(build_technique(config).bias.slope.most) == 3
    assert build_technique(config, fitting=False).bias.slope.most is None
    without = parse_config(text.replace("initial: 3, ", ""))
    assert build_technique(without, fitting=False).bias.slope.most is None
    with pytest.raises(ConfigError, match="has no start"):
        build_fit(without)


@pytest.mark.parametrize("initial", ["", "initial: 5, "])
def test_truth_that_no_fit_can_find_is_reported(initial):
    parameter = f"scene.meshes.0.translate.x: {{{initial}lower: 4, upper: 9}}"
    config = parse_config(f"{TINY}fit: {{parameters: {{{parameter}}}}}\n", source="file.yaml")
    with pytest.raises(ConfigError) as caught:
        build_fit(config)
    assert str(caught.value).startswith(
        "file.yaml:2: fit.parameters.scene.meshes.0.translate.x: is 0 in the scene, from which the reference is traced"
        "; expected a value within the fit's bounds, lower = 4 to upper = 9; widen the bounds"
    )


def test_fit_plan_is_what_the_config_says():
    overrides = ["bias.slope=2", "fit.parameters.bias.slope={lower: 0, upper: 3}", "fit.solver.max_steps=7"]
    overrides += ["fit.parameters.scene.meshes.0.turn.x={lower: -1, upper: 3, initial: 1.5}"]
    plan = build_fit(parse_config(TINY, [*overrides, "fit.anneal={start: 1, end: 0.1, phases: 2}"]))
    slope, turn = plan.parameters
    assert (turn.path, float(turn.initial)) == ("meshes.0.turn.x", 1.5)
    assert plan.truth == {"scene.meshes.0.turn.x": 0}
    assert (slope.name, float(slope.initial), float(slope.lower), float(slope.upper)) == ("bias.slope", 2, 0, 3)
    assert plan.solver.max_steps == 7
    assert (float(plan.anneal.start), float(plan.anneal.end), plan.anneal.phases) == (1, 0.1, 2)


def technique_of(*overrides: str):
    return build_technique(parse_config(TINY, overrides))


def at_the_limits(settings) -> list[dict[str, float]]:
    """The keys of `settings` that are numbers, all at their least values, and all at their greatest."""
    limits = {key: setting.limits for key, setting in settings.each().items() if not setting.choices}
    limits = {key: each for key, each in limits.items() if each.low is not None and key not in LARGE}
    return [{key: getattr(each, end) for key, each in limits.items()} for end in ("low", "high")]


# Patterns of so many taps take seconds to make.
LARGE = ("samples", "search_samples", "pattern_size")


@pytest.mark.exhaustive
def test_modules_take_what_their_keys_may_be_set_to():
    for kind, section in FILTERS.sections.items():
        for values in at_the_limits(section):
            technique_of(f"filter={json.dumps({'type': kind, **values})}")
    for holder in (biases.Bias, biases.ReceiverPlane, biases.AdaptiveBias):
        for values in at_the_limits(holder):
            bias = values if holder is biases.Bias else {"plane": {"type": holder.type, **values}}
            technique_of(f"bias={json.dumps(bias)}", "filter={type: nearest}")
    for values in at_the_limits(SoftCompare):
        technique_of(f"compare={json.dumps({'type': 'soft', **values})}")


@pytest.mark.parametrize("pattern", ["stratified", "uniform", "poisson", "vogel", "sobol", "halton"])
def test_patterns_are_those_of_the_config(pattern):
    small = "samples: 7, pattern_size: 2"
    disk = technique_of(f"filter={{pattern: {pattern}, {small}}}").filter
    assert disk.pattern.offsets.shape == (7, 2, 2, 2)
    assert disk.pattern.rotated == (pattern == "vogel")
    soft = technique_of(f"filter={{type: pcss, pattern: {pattern}, {small}, search_samples: 5, rotated: true}}").filter
    assert (soft.pattern.samples, soft.search.samples) == (7, 5)
    assert soft.search.rotated
    other = technique_of(f"filter={{pattern: {pattern}, {small}}}", "seed=1").filter
    assert not np.array_equal(other.pattern.offsets, disk.pattern.offsets)


def test_technique_follows_its_type():
    assert type(technique_of()).__name__ == "ShadowMapping"
    volumes = technique_of("technique={type: shadow_volumes, method: z_pass}")
    assert (type(volumes).__name__, volumes.method) == ("ShadowVolumes", "z_pass")
    assert type(technique_of("technique={type: irregular_z_buffer}")).__name__ == "IrregularZBuffer"
    text = "scene: {meshes: [{path: 'builtin:box'}, {path: 'builtin:plane', casts: false}]}"
    projected = build_technique(parse_config(text, ["technique={type: projective_texture}"]))
    assert type(projected).__name__ == "ProjectiveShadow"


@pytest.mark.exhaustive
def test_everything_that_can_be_fitted_is_in_the_module_and_has_its_unit():
    for kind in FILTERS.sections:
        for plane in ("none", "receiver_plane", "adaptive"):
            text = f"{TINY}filter: {{type: {kind}}}\nbias: {{plane: {{type: {plane}}}}}\n"
            names = fit_paths(parse_config(text))
            # Those that are not set get their start from the fit.
            bounds = "".join(f"    {name}: {{initial: {start(name)}, lower: 0.1, upper: 0.9}}\n" for name in names)
            config = parse_config(f"{text}fit:\n  parameters:\n{bounds}")
            technique, plan = build_technique(config), build_fit(config)
            assert [p.name for p in plan.parameters] == list(names)
            for parameter in plan.parameters:
                found = resolve(technique, parameter.where)
                assert jnp.shape(found) == ()
                assert parameter.unit == ("texels" if parameter.name in TEXELS else ""), parameter.name


def test_terms_and_their_network_are_built_and_terms_fitted():
    fitted = "fit: {parameters: {bias.terms.one: {lower: 0, upper: 2}}}"
    text = f"{TINY}bias: {{terms: {{one: 0.3, slope: 1}}}}\n{fitted}\n"
    network = "bias.network={hidden: [{weight: [[1], [-2]], bias: [0, 0.5]}], last: [0.5, -0.25]}"
    plain, corrected = (build_technique(parse_config(text, overrides)) for overrides in ([], [network]))
    assert (float(plain.bias.constant.value), float(plain.bias.slope.value)) == (0, 0)
    assert {name: float(weight) for name, weight in plain.bias.terms.weights.items()} == pytest.approx(
        {"one": 0.3, "slope": 1}
    )
    (parameter,) = build_fit(parse_config(text, [network])).parameters
    assert (parameter.unit, parameter.initial) == ("texels", 0.3)
    for technique in (plain, corrected):
        assert float(resolve(technique, parameter.where)) == pytest.approx(0.3)
    np.testing.assert_allclose(corrected.bias.terms.hidden[0].weight, [[1], [-2]])
    np.testing.assert_allclose(corrected.bias.terms.hidden[0].bias, [0, 0.5])
    np.testing.assert_allclose(corrected.bias.terms.last, [0.5, -0.25])
    with pytest.raises(ConfigError, match=r": bias: the perceptron has 2 inputs and layers of 2 x 1, 1 x 2 weights"):
        build_technique(parse_config(text, [network, "bias.terms.sine=1"]))


TEXELS = {
    *("bias.constant", "bias.slope", "bias.slope_least", "bias.slope_most", "bias.normal_offset"),
    *("bias.plane.limit", "bias.plane.deepening", "bias.plane.epsilon", "filter.radius", "filter.min_radius"),
}


def start(name: str) -> float:
    return 0.1 if name == "bias.slope_least" else 0.5


def test_position_of_a_rectangle_light_is_fitted_and_its_angles_are_not():
    light = "scene.light={type: rectangle, position: [1, 3, 0.5], size: [0.4, 0.2]}"
    bounds = lambda key: f"fit.parameters={{scene.light.{key}: {{lower: 0, upper: 4}}}}"
    plan = build_fit(parse_config(TINY, [light, bounds("position.y")]))
    assert (plan.parameters[0].where, plan.parameters[0].initial) == ("lights.0.position.y", 3)
    assert plan.truth == {"scene.light.position.y": 3}
    with pytest.raises(ConfigError, match="azimuth: cannot be fitted in this scene"):
        build_fit(parse_config(TINY, [light, bounds("azimuth")]))


def test_a_directional_light_frames_what_casts_if_set_to():
    ground = "scene.meshes=[{path: builtin:box}, {path: builtin:plane, options: {size: 9}, casts: false}]"
    wide = build(ground, "scene.light={}").light
    narrow = build(ground, "scene.light={frame: casters}").light
    assert (np.asarray(narrow.extent) < 0.3 * np.asarray(wide.extent)).all()
    assert float(narrow.far - narrow.near) == pytest.approx(float(wide.far - wide.near))


WINDOW = "position: [1, 4, 2], left: -1, right: 3, top: 1.5, bottom: -0.5, near: 1, far: 7"


@pytest.mark.parametrize("direction", [(0.3, -1.0, -0.4), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_shadow_camera_looks_along_the_light_from_its_position(direction):
    away = -1 if direction[1] > 0 else 1
    camera = WINDOW.replace("4", str(4 * away))
    ground = "scene.meshes.0={path: builtin:plane, options: {size: 60}}"
    light = build(ground, f"scene.light={{direction: {list(direction)}, shadow_camera: {{{camera}}}}}").light
    # three.js: x is across +y and the direction; looking straight up or down, it is the world's.
    backward = -np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0, 1, 0] if direction[0] else [0, 0, -backward[1]], backward)
    right /= np.linalg.norm(right)
    assert right[0] > 0.7
    up, position = np.cross(backward, right), np.array([1, 4 * away, 2])
    corners = {(-1, -0.5, 1): (-1, -1, -1), (3, 1.5, 7): (1, 1, 1), (1, 0.5, 4): (0, 0, 0)}
    for (x, y, distance), clip in corners.items():
        point = position + x * right + y * up - distance * backward
        # Looking straight up or down, three.js tilts its camera by 1e-4, which the middle of the window allows for.
        found = light.view().clip(jnp.asarray(point, jnp.float32))[:3]
        np.testing.assert_allclose(found, clip, atol=1e-6 if direction[0] else 3e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("position: [0.2, 40, 0.2]", "near and far are 1 and 7"),
        ("position: [30, 4, 0.2]", "left and right are -1 and 3"),
        ("position: [0.2, 4, -30]", "bottom and top are -0.5 and 1.5"),
    ],
)
def test_a_shadow_camera_that_sees_nothing_is_reported(change, words):
    camera = f"{change}{WINDOW.removeprefix('position: [1, 4, 2]')}"
    with pytest.raises(ConfigError, match=r"scene\.light: shadow_camera sees nothing of the scene") as caught:
        build(f"scene.light={{direction: [0, -1, 0], shadow_camera: {{{camera}}}}}")
    assert words in str(caught.value)


def test_point_light_inside_the_scene_is_fine():
    light = build("scene.light={type: point, position: [0, 0.3, 0], near: 50, far: 60}").light
    assert float(light.near) == 50


def test_mistakes_of_one_of_several_lights_name_it():
    lights = "scene.lights=[{}, {type: spot, position: [0, 5, 0], near: 3, far: 9}, {type: spot, position: [0, 0, 0]}]"
    with pytest.raises(ConfigError, match=r"scene\.lights\.2: the spot light"):
        build("scene.light=null", lights)


CASTING = """\
scene:
  meshes:
    - path: builtin:plane
    - path: builtin:box
      casts: {box}
shadow_map: {{cull: front}}
"""


def test_open_caster_is_refused_where_back_faces_cast_for_it():
    with pytest.raises(ConfigError) as caught:
        build_scene(parse_config(CASTING.format(box="true"), source="file.yaml"))
    assert str(caught.value).startswith(
        "file.yaml:3: scene.meshes.0: is an open mesh that casts shadows, while shadow_map.cull is front; expected "
        "closed meshes, because only back faces cast: set casts: false if it only receives"
    )
    volumes = parse_config(CASTING.format(box="true"), ["technique.type=shadow_volumes"])
    assert build_scene(volumes).receivers is None


def test_casters_and_receivers_are_distinguished():
    scene = build_scene(parse_config(CASTING.format(box="false"), ["shadow_map.cull=none"]))
    assert scene.casters.faces.shape == (2, 3)
    assert scene.receivers is not None
    assert scene.receivers.faces.shape == (12, 3)
    assert scene.mesh.faces.shape == (14, 3)
    assert scene.casting_faces.tolist() == [True] * 2 + [False] * 12


@pytest.mark.parametrize("kind", ["shadow_volumes", "irregular_z_buffer"])
def test_fit_of_a_technique_without_a_gradient_is_refused(kind):
    config = parse_config(f"technique:\n  type: {kind}\n{TINY}", source="file.yaml")
    with pytest.raises(ConfigError) as caught:
        build_fit(config)
    assert str(caught.value).startswith(
        f"file.yaml:2: technique.type: is {kind}, whose visibility has no gradient; expected a technique that"
    )


def test_shading_is_that_of_the_config():
    phong = build_shading(parse_config(TINY, ["shading={ambient: 0.1, model: phong, attenuation: {quadratic: 0.5}}"]))
    assert phong.model == "phong"
    assert np.allclose(phong.ambient, 0.1)
    assert np.allclose(phong.intensity, 0.7)
    assert float(phong.attenuation.quadratic) == 0.5
    lights = ["scene.light=null", "scene.lights=[{}, {}]"]
    modulated = build_shading(parse_config(TINY, ["shading={type: modulated, factor: 0.25}", *lights]))
    assert float(modulated.factor) == 0.25
    # Two lights share what one would have.
    assert np.allclose(modulated.lit.intensity, 0.35)
    coloured = build_shading(parse_config(TINY, ["shading.intensity=[1, 0.5, 0]"]))
    assert np.allclose(coloured.intensity, [1, 0.5, 0])
    each = build_shading(parse_config(TINY, ["shading.intensities=[0.5, [0.3, 0.2, 0.1]]", *lights]))
    assert np.allclose([np.asarray(own) for own in each.intensities], [[0.5] * 3, [0.3, 0.2, 0.1]])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("{intensities: [0.5, 1, 1]}", "shading.intensities: has 3 entries, and the scene has 1 light; expected one"),
        ("{intensities: [0.5], intensity: 1}", "shading.intensity: is given together with intensities"),
        ("{intensities: [-1]}", "shading.intensities.0.0: is -1"),
    ],
)
def test_intensities_that_lights_cannot_have_are_reported(given, words):
    with pytest.raises(ConfigError) as caught:
        parse_config(TINY, [f"shading={given}"])
    assert words in str(caught.value)


def test_cascades_extend_as_far_as_the_filter_may_read():
    text = TINY + "technique: {type: cascades, count: 3, blend: 0.2}\nbias: {factors: [1, 2, 3], normal_offset: 1}\n"
    built = build_technique(parse_config(text), fitting=False)
    # The filter's radius, half a texel for its look-ups, the offset times its greatest factor, and one to spare.
    assert (built.layout.count, built.layout.margin, built.layout.max_blend) == (
        3,
        2 + 0.5 + 1 * 3 + 1,
        pytest.approx(0.2),
    )
    assert [float(factor) for factor in built.bias.factors] == [1, 2, 3]
    parameters = "filter.radius: {lower: 0, upper: 6}, technique.blend: {lower: 0, upper: 0.5}"
    fitted = parse_config(f"{text}fit: {{parameters: {{{parameters}, bias.factors.2: {{lower: 0, upper: 4}}}}}}\n")
    built = build_technique(fitted)
    assert (built.layout.margin, built.layout.max_blend) == (6 + 0.5 + 1 * 4 + 1, 0.5)
    # What a fit stores is rendered with the same layout, whatever its values are.
    stored = parse_config(dump_resolved(fitted.with_layout_of_fit()), ["filter.radius=1", "technique.blend=0.1"])
    layout = build_technique(stored, fitting=False).layout
    assert (layout.margin, layout.max_blend) == (built.layout.margin, built.layout.max_blend)
    chosen = build_technique(with_fitted(fitted, {"filter.radius": 1, "technique.blend": 0.1}), fitting=False).layout
    assert (chosen.margin, chosen.max_blend) == (layout.margin, layout.max_blend)
    paths = {parameter.name: parameter.where for parameter in build_fit(fitted).parameters}
    assert paths["technique.blend"] == "layout.blend"
    assert [float(resolve(built, path)) for path in paths.values()] == [2.0, np.float32(0.2), 3.0]


def test_shares_have_memory_for_all_values_of_a_fit():
    text = TINY + "technique: {type: cascades, shares: [2, 1, 1, 0.5]}\n"
    built = build_technique(parse_config(text), fitting=False).layout
    assert [float(share) for share in built.shares] == [2, 1, 1, 0.5]
    assert built.max_share == 2 / 4.5
    parameters = "technique.shares.0: {lower: 0.5, upper: 4}, technique.shares.3: {lower: 0.25, upper: 8}"
    fitted = parse_config(f"{text}fit: {{parameters: {{{parameters}}}}}\n", fitting=True)
    built = build_technique(fitted)
    # The last at its greatest, the first at its least.
    assert built.layout.max_share == 8 / (0.5 + 1 + 1 + 8)
    paths = {parameter.name: parameter.where for parameter in build_fit(fitted).parameters}
    assert paths["technique.shares.3"] == "layout.shares.3"
    assert [float(resolve(built, path)) for path in paths.values()] == [2, 0.5]
    assert parse_config(dump_resolved(fitted), fitting=True) == fitted


def test_ends_of_slices_can_be_fitted():
    text = TINY + "technique: {type: cascades, distances: [2, 5]}\n"
    fitted = parse_config(text + "fit: {parameters: {technique.distances.0: {lower: 1, upper: 4}}}\n", fitting=True)
    (parameter,) = build_fit(fitted).parameters
    assert parameter.where == "layout.distances.0"
    assert float(resolve(build_technique(fitted), parameter.where)) == 2


@pytest.mark.parametrize("kind", ["cascades", "perspective_warp", "resolution_matched"])
def test_cascades_and_warps_need_a_directional_light(kind):
    with pytest.raises(ConfigError, match=rf"scene\.light\.type: is spot, while technique\.type is {kind}"):
        parse_config(TINY + f"technique: {{type: {kind}}}\n", ["scene.light={type: spot}"])


def test_an_engines_numbers_are_its_own():
    text = (
        TINY
        + "technique: {type: three.js, bias: -0.002, radius: 3, side: double}\nshadow_map: {resolution: [64, 64]}\n"
    )
    text += "fit: {parameters: {technique.bias: {lower: -0.01, upper: 0}, technique.radius: {lower: 0, upper: 4}}}\n"
    config = parse_config(text)
    built = build_technique(config)
    assert isinstance(built, ThreeJs)
    assert (built.resolution, built.side, built.shadow_type) == ((64, 64), "double", "PCFShadowMap")
    assert [p.where for p in build_fit(config).parameters] == ["bias", "radius"]
    assert [float(resolve(built, path)) for path in fit_paths(config).values()] == [np.float32(-0.002), 0, 3]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "scene.light={type: rectangle, position: [0, 3, 0]}",
            "is rectangle, which no engine has; expected directional",
        ),
        ("scene.light={type: point, position: [0, 3, 0]}", "is point, for which three.js draws no VSMShadowMap"),
        ("fit.parameters={scene.light.position.x: {lower: 0, upper: 1}}", r"is three\.js in a fit of lights or meshes"),
        (
            "technique={type: three.js, shadow_type: PCFShadowMap}",
            r"shadow_map.resolution: is \[32, 64\], and a light is point, and engines draw its map as a cube's faces",
        ),
    ],
)
def test_what_an_engine_lacks_is_refused(override, words):
    text = TINY + "technique: {type: three.js, shadow_type: VSMShadowMap}\n"
    kind = "point" if "PCFShadowMap" in override else "spot"
    light = [] if "scene.light=" in override else [f"scene.light={{type: {kind}, position: [0, 3, 0]}}"]
    size = ["shadow_map.resolution=[32, 64]"] if kind == "point" else []
    with pytest.raises(ConfigError, match=words):
        build_fit(parse_config(text, [*light, *size, override]))


def test_virtual_maps_are_built_as_they_are_set():
    section = "{type: resolution_matched, page: 32, finest: 4096, norm: worst, level_bias: -2, shadow_distance: 9}"
    config = parse_config(TINY + f"technique: {section}\n")
    layout = build_technique(config).layout
    assert (layout.page, layout.finest, layout.norm, layout.levels) == (32, 4096, "worst", 8)
    assert (float(layout.level_bias), float(layout.shadow_distance)) == (-2, 9)
    assert layout.margin == config.reach({})[0] + 1
    wide = parse_config(TINY + "technique: {type: resolution_matched, margin: 5}\n")
    assert build_technique(wide).layout.gutter == 5
    moving = "technique: {type: resolution_matched}\nfit: {parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}\n"
    with pytest.raises(ConfigError, match=r"technique\.type: is resolution_matched in a fit of lights"):
        build_fit(parse_config(TINY + moving))


def test_warped_maps_are_built_as_they_are_set():
    built = build_technique(parse_config(TINY + "technique: {type: perspective_warp, strength: 2, margin: 3}\n"))
    assert (float(built.layout.strength), built.layout.margin) == (2, 3)
    built = build_technique(
        parse_config(TINY + "technique: {type: perspective_warp, method: trapezoidal, focus: 0.2}\n")
    )
    assert (built.layout.method, float(built.layout.focus)) == ("trapezoidal", np.float32(0.2))
    depths = lambda *settings: parse_config(
        TINY, ["technique={type: perspective_warp, method: perspective}", *settings]
    )
    assert build_technique(depths()).layout.needs_surface
    assert not build_technique(depths("technique.depths=camera")).layout.needs_surface
    assert built.layout.strength is None
    moving = parse_config(
        TINY + "technique: {type: perspective_warp}\nfit: {parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}\n"
    )
    with pytest.raises(ConfigError, match=r"technique\.type: is perspective_warp in a fit of lights"):
        build_fit(moving)


def test_parameters_by_default_need_not_suit_a_file_that_is_not_fitted():
    text = "scene: {meshes: [{path: builtin:box}]}\ntechnique: {type: three.js}\n"
    settings = parse_config(text, fitting=True)
    with pytest.raises(ConfigError, match=r"fit.parameters.bias.constant: cannot be fitted with technique type 'three"):
        build_fit(settings)
    with pytest.raises(ConfigError, match=r"bias.constant: cannot be fitted with technique type 'three"):
        parse_config(f"{text}fit: {{parameters: {{bias.constant: {{lower: 0, upper: 20}}}}}}\n", fitting=True)
