"""The engines draw their golden pictures again, what a fit predicts, and scenes as their own files hold them."""

import dataclasses
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from golden_engines import engine_golden
from rich.console import Console
from scenes import staying_in

from diffshadow.config import build_scene, build_technique, load_config
from diffshadow.raster import draw_surface
from diffshadow.study import import_scene

ROOT = Path(__file__).parent.parent

pytestmark = [pytest.mark.browser, pytest.mark.optimized, pytest.mark.exhaustive]

TINY = """
scene:
  meshes:
    - {path: builtin:torus, size: 1, options: {segments: 24, sides: 12}, drop_to_ground: true, translate: [0, 0.2, 0]}
    - {path: builtin:plane, options: {size: 3}}
  camera: {resolution: [64, 64], orbit: {azimuth: 30, elevation: 35, distance: 4}}
  light: {azimuth: -60, elevation: 50, angular_radius: 2}
shadow_map: {resolution: [128, 128]}
technique: {type: three.js, shadow_side: double, bias: -0.001, radius: 2}
fit:
  parameters: {technique.bias: {lower: -0.05, upper: 0}, technique.radius: {lower: 0, upper: 6}}
reference: {samples: 16}
"""


@pytest.fixture(autouse=True)
def engines(monkeypatch):
    """The driver; the test is skipped where it lacks something."""
    monkeypatch.syspath_prepend(str(ROOT / "experiments"))
    from engines import engines

    lack = engines.missing()
    if lack is not None:
        pytest.skip(lack)
    return engines


@pytest.mark.parametrize(
    ("engine", "name"),
    [
        ("three", "directional_pcf_radius_4"),
        ("babylon", "directional_pcf_high"),
        ("playcanvas", "spot_pcf1_bias"),
        ("godot", "directional_four_splits"),
    ],
)
def test_a_golden_is_drawn_again(engines, engine, name):
    lack = engines.missing([engine])
    if lack is not None:
        pytest.skip(lack)
    golden = engine_golden(engine, name)
    (drawing,) = engines.draw([{"outputs": [], **golden.settings}])
    if engine == "godot":
        # Of bytes.
        np.testing.assert_array_equal(drawing.arrays["picture"], golden.arrays["picture"])
        return
    off = np.abs(drawing.arrays["visibility"].clip(0, 1) - golden.arrays["visibility"])
    assert (off < 1e-4).mean() > 0.999


# PlayCanvas and Godot draw the fitted setting as predicted, with the camera and the light of `TINY`.
OTHERS = {
    "playcanvas": (
        "{type: playcanvas, shadow_distance: 8}",
        "technique.shadow_bias: {lower: 0, upper: 1}, technique.normal_offset_bias: {lower: 0, upper: 0.2}",
    ),
    "godot": (
        "{type: godot_compatibility, directional_shadow_mode: SHADOW_ORTHOGONAL, directional_shadow_max_distance: 8}",
        "technique.shadow_bias: {lower: 0, upper: 4}, technique.shadow_normal_bias: {lower: 0, upper: 4}",
    ),
}


@pytest.mark.parametrize("engine", OTHERS)
def test_a_fit_of_other_engines_holds_in_them(engines, engine, tmp_path):
    lack = engines.missing([engine])
    if lack is not None:
        pytest.skip(lack)
    import _common as common
    from _engine_jobs import engine_job

    technique, parameters = OTHERS[engine]
    settings = TINY.split("technique:")[0] + f"technique: {technique}\nreference: {{samples: 16}}\n"
    with staying_in(tmp_path):
        Path("tiny.yaml").write_text(f"{settings}fit: {{parameters: {{{parameters}}}}}\n")
        config = common.load(Path("tiny.yaml"), ("technique.subpixels=16", "scene.camera.resolution=[128, 128]"))
        case = common.draw(config)
        problem = common.problem_of(case)
        fitted = common.run_fit(config, problem).technique
    (drawing,) = engines.draw([engine_job(case, fitted, [fitted] if engine == "playcanvas" else [])])
    predicted = np.asarray(common.visibility(problem.laid_out(fitted), fitted))
    if engine == "godot":
        picture = drawing.arrays["picture"] / 255
        picture = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
    else:
        picture = drawing.arrays["grid"][0]
    truth, mask = np.asarray(case.truth.visibility), np.asarray(problem.mask)
    error = lambda image: float(np.sqrt(np.mean((image - truth)[mask] ** 2)))
    assert error(picture) == pytest.approx(error(predicted), rel=0.02)


def test_a_fit_holds_in_the_engine(tmp_path):
    import in_the_engine

    with staying_in(tmp_path):
        Path("tiny.yaml").write_text(TINY)
        found = in_the_engine.main(Path("tiny.yaml"), grid=3)
    rows = {row["state"]: row for row in found["rows"]}
    assert min(row["within_1_255_at_engine"] for row in rows.values()) >= 0.9997
    assert rows["after"]["rmse_engine"] < min(rows["before"]["rmse_engine"], rows["defaults"]["rmse_engine"])
    assert found["ratio"] <= 1.03


def agreement(technique, state, surface, picture, counted):
    """The part of the counted pixels that are equal to the engine's."""
    return float((np.abs(np.asarray(technique.visibility(state, surface)) - picture)[counted] <= 1 / 255).mean())


@pytest.mark.parametrize("shadow_type", ["PCFShadowMap", "BasicShadowMap", "VSMShadowMap"])
def test_an_imported_scene_is_drawn_as_the_engine_draws_its_file(engines, tmp_path, shadow_type):
    width, height = 160, 128
    # three.js draws no VSM of the room's point light.
    names = ("yard", "stage") if shadow_type == "VSMShadowMap" else ("yard", "stage", "room")
    files = [ROOT / "tests" / "golden" / "imports" / f"{name}.json" for name in names]
    job = {"engine": "three_file", "width": width, "height": height, "outputs": ["mesh", "position", "normal"]}
    job["shadowType"] = shadow_type.removesuffix("ShadowMap")
    drawings = engines.draw([{**job, "scene": json.loads(file.read_text())} for file in files])
    for file, drawing in zip(files, drawings, strict=True):
        made = import_scene(file, console=Console(quiet=True), shadow_type=shadow_type, output=tmp_path)
        config = load_config(made, [f"scene.camera.resolution=[{height}, {width}]", "technique.subpixels=16"])
        scene, technique = build_scene(config), build_technique(config, fitting=False)
        own, seen = draw_surface(scene.mesh, scene.camera), drawing.arrays["mesh"] >= 0
        counted = np.asarray(own.mask) & seen
        assert (np.asarray(own.mask) == seen).mean() > 0.999
        # At the engine's receivers, as Chromium's camera places vertices at coarser steps than ours.
        position, normal = (jnp.asarray(drawing.arrays[key]) for key in ("position", "normal"))
        surface = dataclasses.replace(own, position=position, interpolated_normal=normal)
        there = technique.prepare(scene), surface, drawing.arrays["visibility"], counted
        assert agreement(technique, *there) >= 0.999, file.stem
        assert agreement(dataclasses.replace(technique, bias=technique.bias * 0.7), *there) < 0.999, file.stem
