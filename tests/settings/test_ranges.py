"""Modules refuse what their settings do not allow, and take all that they allow."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest

from diffshadow import fit, geometry, shading, shadow
from diffshadow.fit import Anneal, Solver


@pytest.fixture(scope="module")
def said():
    """What a process of its own finds, in two parts: tests check the types of arguments, and users do not."""
    command = [sys.executable, str(Path(__file__).parent / "ranges.py"), json.dumps([*NAMED])]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_values_beyond_a_range_are_refused_by_name_and_all_within_are_taken(said):
    assert said["complaints"] == []


NAMED = {
    "shadow.BabylonJs(darkness=2)": "darkness is 2.0",
    "shadow.ThreeJs(intensity=2)": "intensity is 2.0",
    "shadow.ThreeJs(subpixels=0)": "subpixels is 0",
    "shadow.ThreeJs(bias=float('nan'))": "bias is nan",
    "shadow.ConstantBias(float('nan'))": "value is nan",
    "shadow.ThreeJs(shadow_side='sideways')": "shadow_side is 'sideways'; expected front, back or double",
    "shadow.ThreeJs(side='sideways')": "side is 'sideways'; expected front, back or double",
    "shadow.BabylonJs(back_face_culling=[True, 'no'])": "back_face_culling is [True, 'no']",
    "shadow.BabylonJs(resolution=512)": "resolution is 512; expected two whole numbers",
    "shadow.ThreeJs(resolution=512)": "resolution is 512; expected two whole numbers",
    "shadow.MapSettings(512)": "resolution is 512; expected two whole numbers",
    "geometry.PinholeCamera((0, 0, 1), (0, 0, 0), resolution=512)": "resolution is 512; expected two whole numbers",
    "shadow.PercentageCloser(1, float('inf'))": "max_radius is inf",
    "shadow.RandomDisk(lookup='biliner')": "did you mean 'bilinear'?",
    "shadow.Bias(factors=[1, -2])": "factors[1] is -2.0",
    "shadow.LinearBias({'one': 1e9})": "weights['one'] is 1e+09",
    "shadow.sobol(0)": "samples is 0",
    "shadow.stratified((4, 0))": "samples is 0",
    "shadow.uniform(pattern_size=1000)": "pattern_size is 1000",
    "shadow.halton(1 << 20, 256)": "taps per tile",
    "shadow.SoftCompare(0)": "width is 0.0; expected a number at least 1e-06",
    "fit.Solver('newton')": "name is 'newton'; expected levenberg_marquardt",
    "fit.Anneal(0.1, 2.0)": "end is 2.0 and start is 0.1; expected end at most start",
    "fit.Loss(false_shadow=0, false_light=0)": "both 0",
    "geometry.DirectionalLight((0, 1e-12, 0), (0, 0, 0), (1, 1), 0, 1)": "expected a vector at least 1e-09 long",
    "geometry.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], albedo=2.0)": "albedo",
    # Lists are taken as tuples, which compiled programs need.
    "shadow.BabylonJs(back_face_culling=[True, False]).back_face_culling": "(True, False)",
    "shadow.ThreeJs(side=['front', 'back'], resolution=[64, 64]).side": "('front', 'back')",
    "shadow.MapSettings([64, 32]).resolution": "(64, 32)",
    "geometry.PinholeCamera((0, 0, 1), (0, 0, 0), resolution=[8, 8]).resolution": "(8, 8)",
}


def test_each_mistake_has_one_clear_error(said):
    for line, expected in zip(said["values"], NAMED.values(), strict=True):
        assert expected in line


def test_replaced_settings_are_checked():
    for module, changes in {
        Solver(): {"rtol": 2.0},
        Anneal(): {"phases": 0},
        shadow.MapSettings(): {"cull": "x"},
    }.items():
        with pytest.raises((ValueError, TypeError), match=next(iter(changes))):
            dataclasses.replace(module, **changes)


def test_help_names_the_range_of_each_setting():
    assert "- `radius`: a number at least 0 and at most 128, in texels" in str(shadow.Tent.__doc__)
    assert "- `inner_angle`: a number at least 0 and at most 89.99, in degrees" in str(geometry.SpotLight.__doc__)
    assert "- `model`: blinn_phong or phong" in str(shading.Phong.__doc__)
    assert "- `false_light`" in str(fit.Loss.__doc__)
