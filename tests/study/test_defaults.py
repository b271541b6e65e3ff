"""Rules of thumb as the command prints them."""

import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import parse_config
from diffshadow.settings import rules
from diffshadow.settings.engines import ENGINES

PAGE = Path(__file__).parents[2] / "docs" / "rules_of_thumb.md"
MAP = study.LightOptions(map=2048, window=40.0, depth=100.0)
NEAR = ["--map", "9", "--near", "1", "--depth", "9", "--distance", "3"]


def printed(**options):
    console = Console(record=True, width=200)
    study.print_defaults(console=console, **options)
    return console.export_text()


def setting(text, name):
    """The number that a line of code gives a setting."""
    found = re.search(rf"{re.escape(name)}\s*=\s*(-?[\d.]+(?:e-?\d+)?)", text)
    assert found, text
    return float(found[1])


def test_all_rules_are_listed_with_what_they_are_worth():
    text = printed()
    for name, rule in rules.FILTER_RULES.items():
        line, by_map = [line for line in text.splitlines() if f"│ {name} " in line]
        found = [float(x) for x in re.findall(r"[\d.]+", line.split(name)[1])]
        assert found[:3] == [float(f"{value:.3g}") for value in rule.bias]
        assert found[3] == pytest.approx(rule.worth.price, abs=0.006)
        assert found[6] == pytest.approx(rule.own.price, abs=0.006)
        prices = [float(x) for x in re.findall(r"[\d.]+", by_map.split(name)[1])]
        assert prices == pytest.approx([*rule.maps.values()], abs=0.006)


@pytest.mark.parametrize(
    ("kind", "radius", "rule", "said"),
    [
        ("nearest", None, "nearest", "nearest"),
        ("bilinear", None, "bilinear", "bilinear"),
        ("pcf", 2.5, "pcf, radius 2.5", "pcf, radius 2.5"),
        ("random_disk", 4, "random_disk, radius 4", "random_disk, radius 4"),
        ("random_disk", 3, None, "random_disk, radius 2"),
        ("tent", 2.5, "pcf, radius 2.5", "pcf, radius 2.5"),
        ("vsm", 6, "vsm, radius 2.5", "vsm, radius 2.5"),
        ("pcss", None, "pcss", "pcss"),
    ],
)
def test_a_filters_bias_is_its_own_rule_or_the_formula(kind, radius, rule, said):
    text = printed(filter=kind, radius=radius)
    numbers, of_filter = (re.search(f"{key}: (\\{{[^}}]*\\}})", text)[1] for key in ("bias", "filter"))
    if rule is not None:
        constant, slope, offset = rules.FILTER_RULES[rule].bias
        of_scene = "scene: {meshes: [{path: 'builtin:box'}]}"
        found = parse_config(f"{of_scene}\nfilter: {of_filter}\nbias: {numbers}\n").bias
        expected = (float(f"{constant:.3g}"), float(f"{slope:.3g}"), float(f"{offset:.3g}"))
        assert (found.constant, found.slope, found.normal_offset) == expected
    assert f"{said}: price" in text
    assert ("receiver_plane" in text) == (radius is not None and kind != "vsm")
    assert f"type: {kind}" in text
    # What is printed is what a configuration without a bias has.
    found = re.search(r"filter: \{[^}]*\}", text)
    assert found
    section = f"scene: {{meshes: [{{path: 'builtin:box'}}]}}\n{found[0]}\n"
    assert parse_config(section).bias == parse_config(f"{section}bias: {numbers}").bias


def test_an_engines_settings_are_its_rule_in_its_units():
    texel, depth = 40 / 2048, 100
    of = rules.ENGINE_RULES
    three = printed(engine="three.js", of_map=MAP)
    assert setting(three, "light.shadow.bias") == pytest.approx(-of["three.js"].constant * texel / depth, rel=1e-3)
    assert setting(three, "light.shadow.normalBias") == pytest.approx(of["three.js"].normal_offset * texel, rel=1e-3)
    babylon = printed(engine="babylon.js", of_map=MAP)
    assert setting(babylon, "generator.bias") == pytest.approx(2 * of["babylon.js"].constant * texel / depth, rel=1e-3)
    godot = printed(engine="godot", of_map=MAP)
    # At the radius of Soft Low.
    assert setting(godot, "light.shadow_bias") == pytest.approx(50 * of["godot"].constant * texel / depth, rel=1e-3)
    assert setting(godot, "light.shadow_normal_bias") == pytest.approx(of["godot"].normal_offset, rel=1e-3)
    filament = printed(engine="filament", of_map=MAP)
    assert setting(filament, "options.normalBias") == pytest.approx(2 * of["filament"].normal_offset, rel=1e-3)
    unity = printed(engine="unity", of_map=MAP)
    assert setting(unity, "light.shadowBias") == pytest.approx(of["unity"].constant / 2.5, rel=1e-3)
    # Where cameras follow the view, rules are in the engine's own units.
    names = {
        "bevy": ("shadow_depth_bias", "shadow_normal_bias"),
        "playcanvas": ("shadowBias", "normalOffsetBias"),
        "godot_compatibility": ("shadow_bias", "shadow_normal_bias"),
    }
    for engine, (constant, normal) in names.items():
        text, rule = printed(engine=engine, of_map=MAP), of[engine]
        assert rule.is_own
        assert setting(text, f"light.{constant}") == pytest.approx(rule.constant, rel=1e-3)
        assert setting(text, f"light.{normal}") == pytest.approx(rule.normal_offset, rel=1e-3)
        assert "for scenes whose unit is a metre" in text
    assert not any(rule.is_own for name, rule in of.items() if name not in names)
    assert set(of) == set(ENGINES)


def test_without_a_map_an_engines_own_is_taken_and_said():
    text = printed(engine="three.js")
    assert "for a map of 512², 10 wide and 499.5 deep (--map, --window, --depth: three.js's own" in text
    assert "a texel is 0.01953 world units wide" in text
    given = study.LightOptions(map=512, window=10.0, depth=499.5)
    assert "--map" not in printed(engine="three.js", of_map=given).splitlines()[0]
    # What is given stays.
    text = printed(engine="bevy", of_map=study.LightOptions(map=1024))
    assert "for a map of 1024²" in text
    assert "(--window, --depth: Bevy's own" in text


def test_settings_of_spot_and_point_lights_hold_at_their_distance():
    of = rules.ENGINE_RULES
    near, depth, distance = 0.5, 19.5, 4.0
    spot = study.LightOptions("spot", map=1024, angle=30.0, near=near, depth=depth, distance=distance)
    texel = 2 * np.tan(np.radians(30)) * distance / 1024
    # Of window depth, whose slope is f n / ((f - n) d²).
    slope = 20 * near / (depth * distance**2)
    babylon = printed(engine="babylon.js", of_map=spot)
    assert setting(babylon, "generator.bias") == pytest.approx(2 * of["babylon.js"].constant * texel * slope, rel=1e-3)
    unity = printed(engine="unity", of_map=spot)
    assert setting(unity, "light.shadowNormalBias") == pytest.approx(of["unity"].normal_offset / 2.5, rel=1e-3)
    assert "at the distance 4" in unity
    assert "at other distances, only settings" in unity
    godot = printed(engine="godot", of_map=spot)
    expected = 2.5 * of["godot"].constant * texel / distance
    assert setting(godot, "light.shadow_bias") == pytest.approx(expected, rel=1e-3)
    point = study.LightOptions("point", map=512, near=near, depth=depth, distance=distance)
    face = 2 * distance / 512
    babylon = printed(engine="babylon.js", of_map=point)
    assert setting(babylon, "generator.bias") == pytest.approx(of["babylon.js"].constant * face / 20.5, rel=1e-3)
    bevy = printed(engine="bevy", of_map=point)
    assert setting(bevy, "shadow_depth_bias") == pytest.approx(of["bevy"].constant, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--filter", "pfc"], "did you mean pcf?"),
        (["--filter", "separable"], "which has no rule"),
        (["--filter", "bilinear", "--radius", "2"], "given with bilinear, which has no radius"),
        (["--filter", "pcf", "--radius", "-1"], "expected 0 to"),
        (["--filter", "pcf", "--radius", "nan"], "expected 0 to"),
        (["--radius", "2"], "--radius is given without --filter"),
        (["--map", "512"], "--map is given without --engine"),
        (
            ["--engine", "godot", "--light", "spot", "--map", "9"],
            "without --angle and --near and --depth and --distance",
        ),
        (["--engine", "godot", "--light", "point", *NEAR, "--window", "9"], "--window is given for a point light"),
        (["--engine", "godot", "--light", "spot", *NEAR, "--angle", "90"], "--angle is 90; expected more than 0"),
        (["--distance", "3"], "--distance is given without --engine"),
        (
            ["--engine", "godot", "--map", "0"],
            "--map is 0; expected more than 0 and at most 8192; change it, as in diffshadow defaults --engine",
        ),
        (["--engine", "godot", "--filter", "pcf"], "given with a filter"),
        (["--engine", "gdot"], "Choose from"),
    ],
)
def test_options_that_say_nothing_are_refused_in_one_line(arguments, said, capsys):
    with pytest.raises(SystemExit) as exit:
        main(["defaults", *arguments])
    error = " ".join(capsys.readouterr().err.split())
    assert exit.value.code == 2
    assert said in error
    assert error.count("error: ") == 1


def test_the_page_has_the_numbers_that_the_command_prints():
    page = PAGE.read_text()
    text = " ".join(page.split())
    for name, rule in rules.FILTER_RULES.items():
        numbers = " ".join(rf"{value:.3g} \|" for value in rule.bias)
        row = rf"\| {re.escape(name)} \| {numbers} {rule.worth.price:.2f} ± 0\.\d+ \| {rule.worth.acne:.0%} \|"
        assert re.search(row, page), name
    for name, rule in rules.ENGINE_RULES.items():
        worth = lambda of: rf"{of.price:.2f} \| {of.acne:.0%} \| {of.leaks:.0%} \|"
        stated = rf"[^|]*{rule.constant:g}[^|]*{rule.normal_offset:g}[^|]*"
        row = rf"\| {re.escape(ENGINES[name])} \|[^|]*\| {worth(rule.shipped)} {stated}\| {worth(rule.worth)}"
        assert re.search(row, page), name
    formula = f"constant of {rules.CONSTANT:g} + {rules.CONSTANT_PER_TEXEL:g} r and a slope of {rules.SLOPE:g} + "
    formula += f"{rules.SLOPE_PER_TEXEL:g} r"
    assert formula in text
    assert f"constant of {rules.PLANE_CONSTANT:g} (1 + r)" in text
    assert f"a collection of {rules.SCENES} scenes of {rules.KINDS} kinds" in text
    assert f"at most {rules.PART:.0%} of" in text
