"""Rules of thumb as the command prints them."""

import re
from pathlib import Path

import pytest
from rich.console import Console

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import parse_config
from diffshadow.settings import rules
from diffshadow.settings.engines import ENGINES

PAGE = Path(__file__).parents[2] / "docs" / "rules_of_thumb.md"
MAP = {"size": 2048, "window": 40.0, "depth": 100.0}


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
        (line,) = [line for line in text.splitlines() if f"│ {name} " in line]
        found = [float(x) for x in re.findall(r"[\d.]+", line.split(name)[1])]
        assert found[:3] == [float(f"{value:.3g}") for value in rule.bias]
        assert found[3] == pytest.approx(rule.worth.price, abs=0.006)


@pytest.mark.parametrize(
    ("kind", "radius", "numbers", "worth"),
    [
        ("nearest", None, "constant: 2, slope: 0.5", "nearest: price 1.06"),
        ("bilinear", None, "constant: 3, slope: 0.5", "bilinear: price 1.10"),
        ("pcf", 2.5, "constant: 7, slope: 1, normal_offset: 0.5", "pcf, radius 2.5: price 1.10"),
        ("random_disk", 3, "constant: 6.5, slope: 1, normal_offset: 0.75", "random_disk, radius 2: price 1.10"),
        ("tent", 2.5, "constant: 8.9, slope: 1.5", "the formula for any filter: price 1.14"),
    ],
)
def test_a_filters_bias_is_its_own_rule_or_the_formula(kind, radius, numbers, worth):
    text = printed(filter=kind, radius=radius)
    assert f"bias: {{{numbers}}}" in text
    assert worth in text
    assert ("receiver_plane" in text) == (radius is not None)
    assert f"type: {kind}" in text
    # What is printed is what a configuration without a bias has.
    found = re.search(r"filter: \{[^}]*\}", text)
    assert found
    section = f"scene: {{meshes: [{{path: 'builtin:box'}}]}}\n{found[0]}\n"
    assert parse_config(section).bias == parse_config(f"{section}bias: {{{numbers}}}").bias


def test_an_engines_settings_are_its_rule_in_its_units():
    texel, depth = 40 / 2048, 100
    of = rules.ENGINE_RULES
    three = printed(engine="three.js", **MAP)
    assert setting(three, "light.shadow.bias") == pytest.approx(-of["three.js"].constant * texel / depth, rel=1e-3)
    assert setting(three, "light.shadow.normalBias") == pytest.approx(of["three.js"].normal_offset * texel, rel=1e-3)
    babylon = printed(engine="babylon.js", **MAP)
    assert setting(babylon, "generator.bias") == pytest.approx(2 * of["babylon.js"].constant * texel / depth, rel=1e-3)
    godot = printed(engine="godot", **MAP)
    # At the radius of Soft Low.
    assert setting(godot, "light.shadow_bias") == pytest.approx(50 * of["godot"].constant * texel / depth, rel=1e-3)
    assert setting(godot, "light.shadow_normal_bias") == pytest.approx(of["godot"].normal_offset, rel=1e-3)
    bevy = printed(engine="bevy", **MAP)
    assert setting(bevy, "shadow_depth_bias") == pytest.approx(of["bevy"].constant * texel, rel=1e-3)
    filament = printed(engine="filament", **MAP)
    assert setting(filament, "options.normalBias") == pytest.approx(2 * of["filament"].normal_offset, rel=1e-3)
    unity = printed(engine="unity", **MAP)
    assert setting(unity, "light.shadowBias") == pytest.approx(of["unity"].constant / 2.5, rel=1e-3)
    assert set(of) <= set(ENGINES)


def test_without_a_map_an_engines_own_is_taken_and_said():
    text = printed(engine="three.js")
    assert "for a map of 512², 10 wide and 499.5 deep (--map, --window, --depth: three.js's own" in text
    assert "a texel is 0.01953 world units wide" in text
    assert "--map" not in printed(engine="three.js", size=512, window=10.0, depth=499.5).splitlines()[0]
    # What is given stays.
    text = printed(engine="bevy", size=1024)
    assert "for a map of 1024²" in text
    assert "(--window, --depth: Bevy's own" in text


@pytest.mark.parametrize("engine", sorted(set(ENGINES) - set(rules.ENGINE_RULES)))
def test_an_engine_without_a_rule_says_what_it_ships(engine):
    text = printed(engine=engine)
    shipped = {"playcanvas": "shadowBias = 0.05, normalOffsetBias = 0", "godot_compatibility": "shadow_bias = 0.1,"}
    assert f"{ENGINES[engine]} ships {shipped[engine]}" in text
    assert "no rule has been measured for it" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--filter", "pfc"], "did you mean pcf?"),
        (["--filter", "vsm"], "which has no rule"),
        (["--filter", "bilinear", "--radius", "2"], "given with bilinear, which has none"),
        (["--filter", "pcf", "--radius", "-1"], "expected 0 to"),
        (["--filter", "pcf", "--radius", "nan"], "expected 0 to"),
        (["--radius", "2"], "--radius is given without --filter"),
        (["--map", "512"], "--map is given without --engine"),
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
    for name, rule in rules.FILTER_RULES.items():
        numbers = " ".join(rf"{value:.3g} \|" for value in rule.bias)
        row = rf"\| {re.escape(name)} \| {numbers} {rule.worth.price:.2f} ± 0\.\d+ \| {rule.worth.acne:.0%} \|"
        assert re.search(row, page), name
    for name, rule in rules.ENGINE_RULES.items():
        shipped = rf"{rule.shipped.price:.2f} \| {rule.shipped.acne:.0%} \| {rule.shipped.leaks:.0%} \|"
        row = rf"\| {re.escape(ENGINES[name])} \|.*\| {shipped} {rule.constant:.3g} \| {rule.normal_offset:.3g} \|"
        assert re.search(row, page), name
    formula = f"constant {rules.CONSTANT:g}, slope {rules.SLOPE_PER_TEXEL:g} r"
    assert formula in page
    assert f"constant {rules.PLANE_CONSTANT:g} (1 + r)" in page
    assert f"searched for in {rules.SEARCHED} of them, and tested on the other {rules.SCENES}" in page
