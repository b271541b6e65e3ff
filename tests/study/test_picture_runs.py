"""Runs of fits to pictures: their folder and page, and mistakes of their configurations."""

import json

import numpy as np
import pytest
from rich.console import Console

from diffshadow import fit, io, study
from diffshadow.config import CONFIG_FILE, ConfigError, build_fit, build_scene, load_config, parse_config
from diffshadow.study.runs._check import check
from diffshadow.study.runs._picture import picture_plan, picture_problem
from diffshadow.study.runs._progress import Progress

TINY = """
name: tiny
scene:
  meshes:
    - {path: builtin:plane, options: {size: 3}, albedo: [0.7, 0.6, 0.5]}
    - {path: builtin:box, scale: 0.6, albedo: [0.8, 0.3, 0.2]}
  camera: {eye: [1, 2.2, 2.7], target: [0, 0.2, 0], resolution: [32, 32]}
  light: {azimuth: 60, elevation: 55, angular_radius: 0}
shadow_map: {resolution: [64, 64]}
filter: {type: bilinear}
bias: {constant: 0.5, slope: 1.0}
reference: {type: picture, samples: 4, supersampling: 2}
fit:
  parameters:
    scene.light.azimuth: {initial: 50, lower: 30, upper: 90}
    shading.ambient.red: {initial: 0.5, lower: 0, upper: 1}
    reference.exposure: {initial: -0.3, lower: -1, upper: 1}
"""
QUIET = Console(quiet=True)


def config(*overrides):
    return parse_config(TINY, overrides, fitting=True)


def mistakes(*overrides):
    with pytest.raises(ConfigError) as caught:
        build_fit(config(*overrides))
    return str(caught.value)


@pytest.mark.parametrize(("given", "of_pictures", "of_shadows"), [((), 8, 8), (("fit.points=2",), 2, 2)])
def test_points_within_pixels_reach_the_problems(given, of_pictures, of_shadows):
    """By default, since a texel is half a pixel wide."""
    problem, _ = picture_problem(config(*given), Progress.quiet())
    assert problem.shadow_points == of_pictures
    parameters = "fit.parameters={scene.light.azimuth: {lower: 30, upper: 90}}"
    traced = config("reference={type: traced, samples: 1}", parameters, *given)
    scene = build_scene(traced)
    (problem,) = study.pose_problems(traced, build_fit(traced, scene), scene)
    assert problem.shadow_points == of_shadows


def test_every_number_of_a_picture_leads_to_its_place():
    """The initial value of each is that of its key, and its unit that of its kind."""
    names = {
        "scene.camera.eye.y": (2.2, "world units"),
        "scene.camera.turn.x": (0.0, "degrees"),
        "scene.camera.fov_y": (40.0, "degrees"),
        "scene.meshes.1.albedo.green": (0.3, ""),
        "shading.intensity.blue": (0.7, ""),
        "shading.specular": (0.15, ""),
        "shading.attenuation.linear": (0.0, ""),
        "reference.exposure": (0.0, "stops"),
    }
    reach = lambda value: f"{{lower: {value - 0.1 if value else 0}, upper: {value + 0.1}}}"
    plan = build_fit(config("fit.parameters={" + ", ".join(f"{n}: {reach(v)}" for n, (v, _) in names.items()) + "}"))
    for parameter in plan.parameters:
        value, unit = names[parameter.name]
        assert (parameter.initial, parameter.unit) == (pytest.approx(value, abs=1e-5), unit), parameter.name
        assert float(fit.resolve(plan.arrangement, parameter.where)) == pytest.approx(value, abs=1e-5)
    # The scene as it stands is the truth.
    assert set(plan.truth) == set(names)


def test_modulated_shading_has_its_numbers_too():
    given = config("shading={type: modulated}", "fit.parameters={shading.factor: {lower: 0, upper: 1}}")
    (parameter,) = build_fit(given).parameters
    assert parameter.where == "shading.factor"
    given = config("shading={type: modulated}", "fit.parameters={shading.ambient.red: {lower: 0, upper: 1}}")
    assert build_fit(given).parameters[0].where == "shading.lit.ambient.red"


TWO = ["scene.light=null", "scene.lights=[{azimuth: 60, elevation: 55}, {type: point, position: [0, 3, 1]}]"]


@pytest.mark.parametrize("shading", ["{}", "{type: modulated}", "{intensities: [[0.6, 0.5, 0.4], 0.3]}"])
def test_each_light_has_an_intensity_to_fit(shading):
    bounds = "{lower: 0, upper: 1}"
    named = f"shading.intensities.0.red: {bounds}, shading.intensities.1.blue: {bounds}"
    plan = build_fit(config(*TWO, f"shading={shading}", f"fit.parameters={{{named}}}"))
    expected = [0.6, 0.3] if "intensities" in shading else [0.35, 0.35]
    assert [p.initial for p in plan.parameters] == pytest.approx(expected)
    found = [float(fit.resolve(plan.arrangement, p.where)) for p in plan.parameters]
    assert found == pytest.approx(expected)
    assert set(plan.truth) == {"shading.intensities.0.red", "shading.intensities.1.blue"}


OF_ALL = (
    "shading.intensity.red: has no effect, because shading.intensities replace it; expected shading.intensities.0.red"
)


@pytest.mark.parametrize(
    ("names", "overrides", "said"),
    [
        (["shading.intensities.2.red"], [], "is of light 2, and the scene has 2 lights; expected a light from 0 to 1"),
        (["scene.lights.5.azimuth"], [], "is of light 5, and the scene has 2 lights; expected a light from 0 to 1"),
        (["shading.intensities.1.rad"], [], "cannot be fitted in this scene"),
        (["shading.intensity.red"], ["shading.intensities=[0.5, 0.2]"], OF_ALL),
        (["shading.intensity.red", "shading.intensities.1.green"], [], OF_ALL),
    ],
)
def test_intensities_of_lights_that_are_not_there_are_reported(names, overrides, said):
    parameters = ", ".join(f"{name}: {{lower: 0, upper: 1}}" for name in names)
    message = mistakes(*TWO, f"fit.parameters={{{parameters}}}", *overrides)
    assert said in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["reference={type: traced}", "fit.parameters={scene.camera.turn.x: {lower: -1, upper: 1}}"],
            "cannot be fitted to visibility, which does not show it; expected a fit to a picture",
        ),
        (["fit.parameters={scene.camera.eye.w: {lower: -1, upper: 1}}"], "cannot be fitted in this scene"),
        (["fit.parameters={scene.camera.height: {lower: 1, upper: 2}}"], "cannot be fitted in this scene"),
        (["fit.parameters={scene.meshes.1.albedo.red: {lower: 0, upper: 2}}"], "a number at most 1"),
        (["fit.parameters={shading.ambient.red: {lower: -1, upper: 1}}"], "a number at least 0"),
    ],
)
def test_numbers_that_cannot_be_fitted_are_reported(overrides, said):
    assert said in mistakes(*overrides)


def test_pictures_of_other_sizes_and_masks_without_pixels_are_reported(tmp_path):
    np.save(tmp_path / "small.npy", np.zeros((16, 32, 3), np.float32))
    np.save(tmp_path / "picture.npy", np.zeros((32, 32, 3), np.float32))
    io.write_visibility(tmp_path / "none.png", np.zeros((32, 32)))
    for path, mask, said in (
        ("small.npy", None, "is an image of [16, 32] pixels, [height, width], and scene.camera.resolution is [32, 32]"),
        ("picture.npy", "none.png", "has no pixel above 0.5"),
    ):
        given = [f"reference.path={tmp_path / path}", *([f"reference.mask={tmp_path / mask}"] if mask else [])]
        with Progress(QUIET) as progress, pytest.raises(ConfigError) as caught:
            picture_plan(config(*given), progress)
        assert said in str(caught.value)
    assert "there is no file" in mistakes("reference.path=missing.png")


def test_devices_that_are_not_there_are_reported_before_anything_is_drawn():
    with Progress(QUIET) as progress, pytest.raises(ConfigError, match=r"fit\.devices: devices is 400, and JAX sees"):
        picture_plan(config("fit.devices=400"), progress)


def test_a_photograph_has_no_truth(tmp_path):
    np.save(tmp_path / "picture.npy", np.zeros((32, 32, 3), np.float32))
    given = config(f"reference.path={tmp_path / 'picture.npy'}")
    assert build_fit(given).truth == {}
    assert check(given, console=QUIET).triangles == 14


@pytest.mark.exhaustive
def test_a_render_compares_visibility_with_rays(tmp_path):
    folder = study.run_render(config(f"output={tmp_path}"), console=QUIET)
    assert json.loads((folder / "result.json").read_text())["kind"] == "render"
    with np.load(folder / "arrays.npz") as arrays:
        assert np.sqrt(np.mean((arrays["visibility"] - arrays["reference"])[arrays["mask"]] ** 2)) < 0.2


def test_a_sweep_of_pictures_is_refused():
    with pytest.raises(ConfigError, match=r"sweep: is given with reference\.type picture"):
        config("sweep={grid: {bias.constant: [1, 2]}}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return study.run_fit(config(f"output={tmp_path_factory.mktemp('runs')}"), console=QUIET)


@pytest.mark.exhaustive
def test_run_of_a_picture_has_its_pictures_the_numbers_and_a_page(folder):
    result = json.loads((folder / "result.json").read_text())
    assert sorted(entry.name for entry in folder.iterdir()) == result["files"]
    assert {"reference.png", "before.png", "after.png", "fitted.glb", "report.html", CONFIG_FILE} <= set(
        result["files"]
    )
    measured = result["metrics"]
    assert measured["after"]["rmse"] < 0.3 * measured["before"]["rmse"]
    assert result["fitted"]["scene.light.azimuth"] == pytest.approx(60, abs=1)
    assert result["truth"]["shading.ambient.red"] == pytest.approx(0.3)
    assert result["camera"]["eye"] == pytest.approx([1, 2.2, 2.7], abs=1e-5)
    assert list(io.read_scene(folder / "fitted.glb").meshes)
    page = (folder / "report.html").read_text()
    assert "scene.light.azimuth" in page
    assert page.count("data:image/png") >= 5
    assert load_config(folder / CONFIG_FILE, fitting=True).reference == config().reference
    before = (folder / "report.html").read_bytes()
    assert study.report(folder, form="svg") == folder / "report.html"
    assert (folder / "report.html").read_bytes() == before
    assert list(folder.parent.iterdir()) == [folder]
