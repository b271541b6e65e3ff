"""Cameras, lights and grounds that a configuration leaves out, meshes in its place, and templates."""

import re
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import staying_in

from diffshadow import geometry, io
from diffshadow.config import ConfigError, build_scene, dump_resolved, load_config, parse_config, settings_file
from diffshadow.config.reading._templates import folder_of_templates, template_names, write_template

AUTO = "scene: {meshes: [{path: builtin:box}], camera: auto, light: auto, ground: auto}"


@pytest.fixture(autouse=True)
def apart(tmp_path):
    with staying_in(tmp_path):
        yield


def write_mesh(path, name="chair", size=1.0, turn=lambda v: v):
    mesh = geometry.library_mesh(name)
    io.write_ply(path, size * turn(np.asarray(mesh.vertices)), np.asarray(mesh.faces))
    return Path(path)


def test_what_is_found_is_written_out_and_repeats():
    config = parse_config(AUTO)
    assert len(config.notes) == 4
    assert config.scene.camera.eye is not None
    assert config.scene.meshes[1].path == "builtin:plane"
    # The box stands on y = 0.
    assert config.scene.meshes[1].translate[1] == pytest.approx(0, abs=1e-6)
    assert 0 < config.scene.camera.target[1] < 1
    assert config.scene.ground is None
    again = parse_config(dump_resolved(config))
    assert again == config
    assert again.notes == ()


def test_keys_beside_auto_are_kept():
    given = ["scene.camera.resolution=[20, 10]", "scene.camera.fov_y=25", "scene.light.elevation=33"]
    config = parse_config(AUTO, given)
    assert config.scene.camera.resolution == (20, 10)
    assert config.scene.camera.fov_y == 25
    assert config.scene.light.elevation == 33


def test_a_parallel_camera_shows_the_caster_and_its_shadow_and_little_else():
    scene = build_scene(parse_config(AUTO, ["scene.camera={type: orthographic}", "scene.camera.resolution=[40, 60]"]))
    corners, (_, bottom, _) = np.asarray(scene.meshes[0].vertices), np.asarray(scene.meshes[1].vertices)[0]
    way = np.asarray(scene.light.direction)
    fallen = corners + ((bottom - corners[:, 1]) / way[1])[:, None] * way
    x, y = np.asarray(scene.camera.view().clip(jnp.asarray(np.concatenate([corners, fallen]))))[:, :2].T
    # Of the two sides, one is nearly filled, and nothing is cut off.
    assert 0.75 < max(np.abs(x).max(), np.abs(y).max()) < 1


def test_z_up_is_what_the_camera_says():
    config = parse_config(AUTO, ["scene.camera.up=[0, 0, 1]"])
    # The same as with y up, turned.
    azimuth, elevation = (np.deg2rad(getattr(parse_config(AUTO).scene.light, key)) for key in ("azimuth", "elevation"))
    x, y, z = -np.sin(azimuth) * np.cos(elevation), -np.sin(elevation), -np.cos(azimuth) * np.cos(elevation)
    assert config.scene.light.direction == pytest.approx((x, -z, y), abs=1e-5)
    plane = build_scene(config).meshes[1]
    assert np.ptp(np.asarray(plane.vertices)[:, 2]) == pytest.approx(0, abs=1e-5)
    np.testing.assert_allclose(plane.corner_normals[0, 0], (0, 0, 1), atol=1e-5)


def test_views_share_the_camera_unless_they_place_it():
    views = "fit.views={grid: {scene.light.elevation: [30, 60]}}"
    config = parse_config(AUTO, [views], fitting=True)
    assert {view.config.scene.camera.eye for view in config.views} == {config.scene.camera.eye}
    assert [len(view.config.scene.meshes) for view in config.views] == [2, 2]
    assert parse_config(dump_resolved(config), fitting=True).views == config.views
    placed = "fit.views={grid: {scene.camera.eye: [[0, 1, 4], [4, 1, 0]]}}"
    found = parse_config(AUTO, [placed], fitting=True).views
    assert [view.config.scene.camera.eye for view in found] == [(0, 1, 4), (4, 1, 0)]


def test_a_mesh_that_cannot_be_read_is_reported_by_its_key():
    Path("bad.ply").write_text("ply\n")
    with pytest.raises(ConfigError, match=r"scene\.meshes\.0"):
        build_scene(parse_config("scene: {meshes: [{path: bad.ply}], camera: auto}"))
    with pytest.raises(ConfigError, match=r"scene\.ground: is 'flat'; expected"):
        parse_config("scene: {meshes: [{path: builtin:box}], ground: flat}")


@pytest.mark.parametrize("size", [0.01, 1000.0])
def test_a_mesh_file_is_a_configuration(size):
    config = load_config(write_mesh("my mesh.ply", size=size), ["filter.samples=8"], fitting=True)
    assert config.name == "my mesh"
    assert config.filter.samples == 8
    assert [mesh.path for mesh in config.scene.meshes] == [str(Path("my mesh.ply").absolute()), "builtin:plane"]
    assert parse_config(dump_resolved(config), fitting=True) == config


def test_a_mesh_that_lies_across_z_is_turned():
    write_mesh("flat.ply", "box", turn=lambda v: np.stack([v[:, 0], -v[:, 2], v[:, 1] * 0.2], axis=-1))
    assert load_config(write_mesh("box.ply", "box")).scene.meshes[0].rotate == (0, 0, 0)
    mesh = geometry.merge([geometry.library_mesh("chair"), geometry.library_mesh("plane", size=4.0)])
    v = np.asarray(mesh.vertices)
    io.write_ply("standing.ply", np.stack([v[:, 0], -v[:, 2], v[:, 1]], axis=-1), np.asarray(mesh.faces))
    config = load_config("standing.ply")
    assert config.scene.meshes[0].rotate == (-90, 0, 0)
    assert "z is up" in config.notes[0]
    assert len(config.scene.meshes) == 1


def test_a_flat_foot_across_z_is_a_remark_on_gltf():
    """Which has y up by definition."""
    column = geometry.library_mesh("box", size=(1.0, 1.0, 3.0))
    v = np.asarray(column.vertices) - [0, 0.5, 0]
    # It tapers, so that no side is level.
    lying = v * np.where(v[:, 2:] > 0, [0.3, 0.3, 1], 1)
    geometry.Mesh(lying, column.faces).to_trimesh().export("lying.glb")
    config = load_config("lying.glb")
    assert config.scene.meshes[0].rotate == (0, 0, 0)
    assert "if z is up, set 'scene.meshes.0.rotate=[-90, 0, 0]'" in config.notes[0]
    assert load_config("lying.glb", ["scene.meshes.0.rotate=[-90, 0, 0]"]).scene.meshes[0].rotate == (-90, 0, 0)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("builtin:quikstart", "did you mean 'quickstart'"),
        ("none.glb", "there is no mesh file"),
        ("bad.glb", "is not JSON"),
        (("quickstart",), "exists already; expected a new file"),
        (("quikstart",), "did you mean 'quickstart'"),
        (("many_views", Path("none.obj")), "lists its meshes in the sections"),
    ],
)
def test_what_stands_for_no_configuration_gets_one_message(given, expected):
    Path("bad.glb").write_text("x")
    Path("quickstart.yaml").write_text("")
    take = (lambda: load_config(given)) if isinstance(given, str) else lambda: write_template(given[0], *given[1:])
    with pytest.raises(ConfigError, match=re.escape(expected)) as caught:
        take()
    assert len(caught.value.mistakes) == 1


@pytest.mark.parametrize("name", template_names())
def test_every_template_is_written_as_it_is_but_for_its_path(name):
    path, notes = write_template(name)
    assert path == Path(f"{name}.yaml")
    assert notes == ()
    text = path.read_text(encoding="utf-8")
    assert "configs/" not in text
    assert "python experiments" not in text
    assert (
        text.partition("\nname:")[2]
        == (folder_of_templates() / path).read_text(encoding="utf-8").partition("\nname:")[2]
    )


@pytest.mark.parametrize("name", ["quickstart", "three_js", "babylon_js", "spot"])
def test_a_template_takes_a_mesh_of_any_size(name):
    write_mesh("my_chair.ply", size=1000.0)
    path, _ = write_template(f"builtin:{name}", Path("my_chair.ply"))
    assert "# " in path.read_text(encoding="utf-8")
    config = load_config(path, fitting=True)
    assert config.name == ("my_chair" if name == "quickstart" else f"my_chair_{name}")
    assert config.scene.camera.resolution == load_config(f"builtin:{name}").scene.camera.resolution
    if name != "quickstart" and "technique.normal_bias" in config.fit.parameters:
        # A length, which has grown with the mesh: its longest side is 1000 instead of 2.
        assert config.fit.parameters["technique.normal_bias"].upper == pytest.approx(50)


def test_a_sweep_s_folder_is_its_configuration():
    folder = Path("swept")
    folder.mkdir()
    (folder / "config.yaml").write_text("seed: 1\n")
    (folder / "result.json").write_text('{"kind": "sweep"}')
    assert settings_file(folder, sweep=True).path == folder / "config.yaml"
    with pytest.raises(ConfigError, match="holds a sweep"):
        settings_file(folder)


def test_a_camera_and_a_bias_that_are_given_need_no_jax():
    text = "scene: {meshes: [{path: builtin:box}], camera: {eye: [1, 2, 3]}}\nbias: {constant: 1}"
    program = (
        f"import sys; from diffshadow.config import parse_config; parse_config({text!r}); print('jax' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "False"


def test_without_finding_all_keys_are_checked_and_no_mesh_is_read(tmp_path):
    (tmp_path / "broken.obj").write_text("v 1 2\n")
    file = tmp_path / "found.yaml"
    file.write_text("scene: {meshes: [path: broken.obj], camera: auto, light: auto}\n")
    settings = load_config(file, ["filter.radius=2.5"], finding=False)
    assert settings.filter.radius == 2.5
    with pytest.raises(ConfigError, match=r"filter\.typ: is not a key of filter"):
        load_config(file, ["filter.typ=pcf"], finding=False)
    with pytest.raises(ConfigError, match=r"scene\.light\.elevaton"):
        load_config(file, ["fit.views={grid: {scene.light.elevaton: [30, 60]}}"], finding=False)
