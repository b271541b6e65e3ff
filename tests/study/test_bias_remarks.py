"""Remarks on casters that lose much of their shadow to the bias."""

import re

import pytest
from rich.console import Console

from diffshadow.config import build_technique, parse_config
from diffshadow.study.remarks._bias import bias_remarks
from diffshadow.study.runs._progress import Progress
from diffshadow.study.runs._setup import load, see

SCENE = """
scene:
  meshes:
    - {{path: builtin:plane, options: {{size: 100}}}}
    - {{path: builtin:box, options: {{size: [0.5, {height}, 0.4]}}, translate: [3, 0, 2]}}
    {more}
  camera: {{eye: [12, 8, 14], target: [3, 0, 2], resolution: [32, 32]}}
  light: {{type: directional, azimuth: 40, elevation: 45}}
shadow_map: {{resolution: [256, 256]}}
"""


def remarks(*overrides, height=1.8, more=""):
    config = parse_config(SCENE.format(height=height, more=more), overrides)
    technique = build_technique(config)
    with Progress(Console(quiet=True)) as stages:
        seen = see(config, load(config, stages).scene, technique, stages)
    return list(bias_remarks(config, technique, ["scene.light"], seen.lit, seen.states))


@pytest.mark.parametrize("height", [1.8, 2.4])
def test_a_bias_that_is_long_for_a_caster_is_remarked_on_with_lengths(height):
    (remark,) = remarks("bias={constant: 3, slope: 1, normal_offset: 0.5}", height=height)
    assert remark.startswith("scene.meshes.1 (builtin:box) loses much of the shadow of scene.light to the bias: ")
    number = r"([\d.]+)"
    found = re.search(rf"surfaces {number} world .* is {number} texels, .* is {number} world .* {number} wide", remark)
    assert found
    shift, texels, along, across = map(float, found.groups())
    # At 45 degrees the slope is 1: constant 3, slope 1, and an offset of 0.5 that counts by half. A texel of the map is
    # not square.
    assert texels == pytest.approx(4.1, abs=0.15)
    assert shift / texels == pytest.approx(0.47, abs=0.02)
    # Its height and its footprint's depth, both at 45 degrees.
    assert along == pytest.approx((height + 0.62) / 2**0.5, abs=0.03)
    assert across == pytest.approx(0.65, abs=0.03)
    assert (
        "raise shadow_map.resolution, narrow its map with scene.light.shadow_camera, or lower bias.constant" in remark
    )


def test_casters_that_keep_their_shadow_get_no_remark():
    assert remarks("shadow_map.resolution=[2048, 2048]") == []
    assert remarks("bias={constant: 0.5, slope: 0.5}") == []
    # A caster far above what it shadows, however thin.
    card = "- {path: builtin:box, options: {size: [2, 0.01, 2]}, translate: [3, 5, 2]}"
    assert remarks("scene.meshes.1.casts=false", more=card) == []
    # One whose shadow another caster casts as well.
    roof = "- {path: builtin:box, options: {size: [9, 0.5, 9]}, translate: [3, 6, 2]}"
    assert remarks("scene.light.elevation=90", more=roof) == []


def test_the_largest_part_of_the_bias_and_all_casters_are_named():
    other = "- {path: builtin:box, options: {size: [0.5, 1.5, 0.4]}, translate: [5, 0, 2]}"
    (remark,) = remarks("bias={constant: 0, slope: 9}", more=other)
    assert re.match(r"scene\.meshes\.[12] \(builtin:box\) and 1 other mesh lose much", remark)
    assert remark.endswith("or lower bias.slope")
    assert "about 100% of its shadow is lost" in remark
