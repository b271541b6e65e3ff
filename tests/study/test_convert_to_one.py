"""Finished code for one engine, from a configuration with a bias that it has, or lacks."""

import math
import re
from pathlib import Path

import pytest
from rich.console import Console
from scenes import BOX_OVER_PLANE, staying_in

from diffshadow import study
from diffshadow.config import load_config
from diffshadow.settings.engines import ENGINES
from diffshadow.study.runs._engine import lit_by, preset
from diffshadow.study.runs._progress import Progress

BASE = (
    BOX_OVER_PLANE
    + """
bias: {constant: 0.5, slope: 0, normal_offset: 1.5, normal_offset_profile: constant}
filter: {type: random_disk, radius: 2}
"""
)


@pytest.fixture(autouse=True)
def apart(tmp_path):
    with staying_in(tmp_path):
        Path("a.yaml").write_text(BASE)
        yield


def printed(engine, *overrides):
    console = Console(record=True, width=200)
    config = load_config("a.yaml", overrides)
    study.convert(config, console=console, source="a.yaml", overrides=overrides, fits=False, engine=engine)
    return console.export_text()


def number(text, name):
    found = re.search(rf"{re.escape(name)}\W+(-?[\d.]+(?:e-?\d+)?)", text)
    assert found, text
    return float(found[1])


def test_code_amounts_to_the_same_shift_and_offset_in_world_units():
    config = load_config("a.yaml", ())
    (lit,) = lit_by(config, Progress(Console(quiet=True)))
    shift, offset = 0.5 * lit.texel, 1.5 * lit.texel
    three = printed("three.js")
    assert number(three, "light.shadow.normalBias") == pytest.approx(offset, rel=1e-5)
    assert number(three, "light.shadow.radius") == 2
    bevy, frame = printed("bevy"), preset("bevy", config).frame(lit.scene, lit.distance)
    assert number(bevy, "// shadow_depth_bias") == pytest.approx(shift, rel=1e-3)
    # In diagonals of a texel of its own camera, which follows the view.
    assert frame.texel > 2 * lit.texel
    assert number(bevy, "// shadow_normal_bias") == pytest.approx(offset / frame.texel, rel=1e-3)
    (normal,) = re.findall(r"shadow_normal_bias: ([\d.]+), \.\.default", bevy)
    assert float(normal) == pytest.approx(offset / frame.texel / math.sqrt(2), rel=1e-5)
    godot = preset("godot_compatibility", config).frame(lit.scene, lit.distance)
    text = printed("godot_compatibility")
    assert number(text, "light.shadow_normal_bias") == pytest.approx(offset / godot.texel, rel=1e-5)
    assert "SHADOW_QUALITY_SOFT_HIGH" in text


def test_the_bias_of_one_engine_is_another_ones():
    given = "technique={type: bevy, shadow_depth_bias: 0.01, shadow_normal_bias: 0}"
    text = printed("three.js", given)
    assert "0.01 world units towards the light" in text
    assert "valid where front faces cast, as in bevy" in text


def test_what_an_engine_lacks_is_said_with_the_command_that_fits_it():
    text = printed("playcanvas")
    assert "PlayCanvas has no constant bias under directional and spot lights" in text
    assert "diffshadow advise a.yaml --engine playcanvas" in text
    text = printed("godot_compatibility", "bias.slope=1")
    assert "Godot 4 Compatibility does not have what this configuration has: bias.slope" in text


@pytest.mark.parametrize("engine", ["godot", "filament", "unity"])
def test_an_engine_that_is_not_drawn_has_finished_code_too(engine):
    text = printed(engine, "bias.normal_offset=0")
    assert f"{ENGINES[engine]}, for scene.light:" in text
    assert "not verified against the engine" in text
    if engine == "godot":
        # The bias is divided by the blur that the radius asks for, which nobody does by hand.
        assert number(text, "light.shadow_blur") == 1
