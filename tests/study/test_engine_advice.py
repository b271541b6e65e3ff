"""Advice for one engine: what it has, in its own units, and the code to paste."""

import io as text_io
import json
import re
import shlex
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scenes import BOX_OVER_PLANE, marked, staying_in

from diffshadow import study
from diffshadow.config import ConfigError, load_config
from diffshadow.settings.engines import ENGINES, POLYGON_OFFSETS
from diffshadow.settings.rules import ENGINE_RULES
from diffshadow.shadow import ENGINE_TECHNIQUES
from diffshadow.study.advice import _advise as module
from diffshadow.study.advice._engines import engine_code
from diffshadow.study.advice._times import times_of
from diffshadow.study.record._sweeps import Load
from diffshadow.study.runs._engine import lit_by
from diffshadow.study.runs._progress import Progress
from diffshadow.study.sweeps._pace import Pace, saying_how_long

pytestmark = pytest.mark.usefixtures("tiny_figures")

BASE = (
    BOX_OVER_PLANE
    + """
reference: {samples: 4}
fit: {solver: {max_steps: 2}, anneal: {phases: 1}}
advise: {resolutions: [[64, 64]]}
"""
)
QUIET = Console(quiet=True)
POINT = "scene.light={type: point, position: [0.5, 3, 1], near: 0.5, far: 8, guard: 0.5}"
SPOT = "scene.light={type: spot, position: [0.5, 3, 1]}"


@pytest.fixture(autouse=True)
def apart(tmp_path):
    with staying_in(tmp_path):
        Path("a.yaml").write_text(BASE)
        yield


def advice(engine, *overrides):
    return study.engine_advice("a.yaml", overrides, engine, console=QUIET)


HAS = {
    "godot": (["shadow_bias", "shadow_normal_bias"], ["Hard", "Soft Low", "Soft High"]),
    "bevy": (["shadow_depth_bias", "shadow_normal_bias"], ["Hardware2x2", "Gaussian"]),
    "filament": (["constantBias", "normalBias"], ["PCF"]),
    "unity": (["shadowBias", "shadowNormalBias"], ["Hard", "Soft, Low", "Soft, Medium", "Soft, High"]),
    "three.js": (["bias", "normalBias"], ["BasicShadowMap", "PCFShadowMap", "VSMShadowMap"]),
    "babylon.js": (["bias", "normalBias"], ["NONE", "POISSONSAMPLING", "PCF", "PCSS"]),
    "godot_compatibility": (["shadow_bias", "shadow_normal_bias"], ["HARD", "SOFT_LOW", "SOFT_HIGH"]),
    "playcanvas": (["shadowBias", "normalOffsetBias"], ["PCF1_32F", "PCF3_32F", "PCF5_32F"]),
}


@pytest.mark.parametrize("engine", ENGINES)
def test_an_engines_filters_and_biases_are_combined(engine):
    found, ((bias, offset), filters) = advice(engine), HAS[engine]
    labels = [(each.bias, each.filter) for each in found.techniques]
    assert labels == [(each, kind) for each in (bias, offset, f"{bias} + {offset}") for kind in filters]
    assert found.engine == engine
    for technique, run in zip(found.techniques, found.sweep.runs, strict=True):
        config = run.config
        is_exact = engine in ENGINE_TECHNIQUES
        assert config.technique.type == (engine if is_exact else "shadow_map")
        own = [f"technique.{key}" for key in ENGINE_TECHNIQUES[engine].settings.biases] if is_exact else []
        names = own or ("bias.constant", "bias.normal_offset")
        fitted = [name for name, used in zip(names, (bias, offset), strict=True) if used in technique.bias.split(" + ")]
        assert [name for name in config.fit.parameters if name in names] == fitted
        # What is not fitted is 0.
        part = config.technique if is_exact else config.bias
        assert all(getattr(part, name.split(".")[1]) == 0 for name in names if name not in fitted)
        assert is_exact or (config.bias.slope, config.bias.plane.type) == (0, "none")


def test_bounds_of_an_engines_bias_follow_from_the_scene():
    near, far = (advice("three.js", f"scene.meshes.{i}.scale={s}") for i, s in ((0, 1), (0, 4)))
    bounds = [each.sweep.runs[0].config.fit.parameters["technique.bias"] for each in (near, far)]
    config = load_config("a.yaml")
    (lit,) = lit_by(config, Progress(QUIET))
    assert bounds[0].lower == pytest.approx(-32 * lit.depth_per_texel)
    assert bounds[1].lower != pytest.approx(bounds[0].lower, rel=0.05)


LIT = [("unity", POINT, 1), ("godot", POINT, 1), ("bevy", POINT, 3), ("three.js", POINT, 3), ("godot", SPOT, 1)]


@pytest.mark.parametrize(
    ("engine", "light", "count"),
    [LIT[0], *(pytest.param(*each, marks=pytest.mark.exhaustive) for each in LIT[1:])],
)
def test_only_biases_that_an_engine_has_under_a_light_are_fitted(engine, light, count):
    found = advice(engine, light)
    assert len({each.bias for each in found.techniques}) == count
    assert "VSMShadowMap" not in {each.filter for each in found.techniques}


@pytest.mark.parametrize(
    ("engine", "overrides", "said"),
    [
        ("filament", [POINT], "scene: Filament has no bias for one of the lights"),
        ("godot", ["technique.type=cascades"], "technique.type: is cascades; expected a single map"),
        ("godot", ["advise.filters=[{label: a}]"], "advise.filters: is given, and --engine godot has its own"),
        ("babylon.js", ["advise.resolutions=[[64, 32]]"], "whose maps are square"),
    ],
)
def test_what_an_engine_cannot_have_is_one_error(engine, overrides, said):
    with pytest.raises(ConfigError, match=re.escape(said)):
        advice(engine, *overrides)


def test_advice_for_an_engine_may_start_from_its_own_configuration():
    found = advice("three.js", "technique={type: three.js, side: back, shadow_side: front, bias: -0.01}")
    assert {(run.config.technique.side, run.config.technique.shadow_side) for run in found.sweep.runs} == {
        ("back", "front")
    }


@pytest.fixture
def quick(monkeypatch):
    """Fits and measurements that take no time. The second bias with the last filter is the best."""
    from diffshadow.study.sweeps import _work as work

    def measure(config, batch, progress):
        errors = dict.fromkeys(("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"), 0.25)
        whole = {f"{when}.{key}": value for when in ("before", "after") for key, value in errors.items()}
        fitted = {f"fitted.{name}": config.initial(name) for name in config.fit.parameters}
        return {**whole, **fitted, "steps": 3, "reference_noise_floor": None, "pixels": 9}

    monkeypatch.setitem(work._MEASURES, "fit", measure)
    timed = lambda configs, progress: (
        times_of(np.ones((1, len(configs), 2)), range(len(configs))),
        Load(others=0.0, unevenness=0.0),
    )
    monkeypatch.setattr(module, "measure_times", timed)
    monkeypatch.setattr(module, "unexplained_by", lambda config: [])
    monkeypatch.setattr(module, "_least_biases", lambda *_: {})


@pytest.mark.parametrize(
    ("engine", "suffix"), [("godot", "gd"), pytest.param("three.js", "js", marks=pytest.mark.exhaustive)]
)
def test_the_code_to_paste_ends_the_output_and_is_on_the_page(quick, engine, suffix):
    out = text_io.StringIO()
    found = advice(engine, "output=out")
    folder = study.run_advise(found, console=Console(file=out, width=120, highlight=False), workers=0)
    said, stored = out.getvalue(), json.loads((folder / "result.json").read_text())
    assert folder.name == f"a-advise-{engine}"
    (code,) = stored["advice"]["code"].values()
    assert (folder / f"engine.{suffix}").read_text() == code
    assert said.endswith(code)
    page = (folder / "report.html").read_text()
    assert f"<h2>In {ENGINES[engine]}</h2>" in page
    assert code.splitlines()[-1] in page
    assert shlex.split(stored["command"]) == [
        "diffshadow",
        "advise",
        str(Path("a.yaml").absolute()),
        "output=out",
        "--engine",
        engine,
    ]
    # How many there are is said first, and after the first how long they take.
    said_first = r"9 fits to do; the first says how long they take\nthe first took \d+ s, with what all compile"
    assert re.match(said_first, said)
    assert "all 9 take about " in said
    # The page is made again of the folder's files.
    (folder / "report.html").unlink()
    assert study.report(folder).read_text() == page


def test_time_of_all_fits_follows_from_the_first(monkeypatch):
    """What all fits share is done once. The workers take turns at the rest. If they take longer, that is said again."""
    clock = iter([0.0, 53.0, 60.0, 73.0, 120.0, 400.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    out = text_io.StringIO()
    pace = Pace(Console(file=out, width=200, highlight=False), "fits", "; then they are timed")
    pace.begin(18, 2)
    stages = {"total": 48.0, "drawing": 28.0, "compiling": 7.5}
    pace.done(1, stages)
    pace.done(2, stages)
    pace.done(3, {"total": 20.0})
    pace.done(4, {"total": 80.0})
    pace.done(18, {"total": 20.0})
    assert out.getvalue() == (
        "18 fits to do, 2 at a time; the first says how long they take\n"
        # 53 + 17 × 20 / 2 seconds
        "the first took 53 s, with what all compile and trace once; all 18 take about 4 min if the others compile as "
        "long; then they are timed\n"
        # 120 + 14 × 35 / 2 seconds
        "4 of 18 are done; all take about 6 min; then they are timed\n"
    )


def test_how_long_timing_takes_is_said_once(monkeypatch):
    clock = iter([0.0, 12.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    out, seen = text_io.StringIO(), []
    step = saying_how_long(Console(file=out, width=200), "timing them", 45, seen.append)
    for done in range(1, 6):
        step(done)
    assert seen == [1, 2, 3, 4, 5]
    assert out.getvalue() == "timing them takes about 3 min\n"


def values_of(code):
    """The numbers that code sets, by name."""
    return {name: float(value) for name, value in re.findall(r"(\w+) = (-?[\d.e-]+)f?", code)}


LINES = {
    "godot": ["SHADOW_QUALITY_SOFT_HIGH", "directional_shadow_atlas_set_size(64, false)"],
    "filament": ["options.mapSize = 64;", "View::ShadowType::PCF"],
    "unity": ["LightShadows.Soft", "SoftShadowQuality.High", "asset: 64"],
}


@pytest.mark.parametrize("engine", marked(LINES, ("filament",)))
def test_code_of_a_formula_has_the_engines_units(engine):
    """The bias and the offset that fits start at, in texels, and a radius of the engine's own."""
    (bias, offset), filters = HAS[engine]
    both, rule = advice(engine).sweep.runs[-1].config, ENGINE_RULES[engine]
    assert both.shadow_map.polygon_offset == POLYGON_OFFSETS.get(engine)
    code = engine_code(engine, both, filters[-1])["scene.light"]
    (lit,) = lit_by(both, Progress(QUIET))
    shift, depth = rule.constant * lit.texel, lit.texel / lit.depth_per_texel
    expected = {
        # A radius of 3 texels is a blur of 1, and divides the bias by 3.
        "godot": {bias: 100 * shift / depth / 3, offset: rule.normal_offset, "shadow_blur": 1},
        "filament": {bias: shift, offset: 2 * rule.normal_offset},
        "unity": {bias: rule.constant / 3.5, offset: rule.normal_offset / 3.5},
    }[engine]
    found = values_of(code)
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-4)
    assert all(line in code for line in LINES[engine])
    assert "not verified against the engine" in code
    assert ("beside the polygon offset" in code) == (engine in POLYGON_OFFSETS)
    hard = engine_code(engine, advice(engine).sweep.runs[0].config, filters[0])["scene.light"]
    assert values_of(hard)[offset] == 0


@pytest.mark.exhaustive
def test_the_page_shows_the_scene_with_the_engines_defaults_and_as_recommended(tmp_path):
    found = advice("bevy")
    folder = study.run_advise(found, console=QUIET)
    with np.load(folder / "my_scene.npz") as stored:
        images = dict(stored)
    assert {"the engine's defaults", "recommended", "ray-traced"} <= set(images)
    assert images["rmse recommended"] < images["rmse the engine's defaults"]
    page = (folder / "report.html").read_text()
    assert "Your scene in Bevy" in page
    assert f"RMSE {float(images['rmse recommended']):.4f}" in page
    assert (folder / "engine.rs").read_text().startswith("// Bevy 0.19.")
