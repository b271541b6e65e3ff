"""The collection of scenes, and the search for rules in what was measured over it."""

import dataclasses
import importlib
import json
from pathlib import Path

import numpy as np
import pytest
from scenes import staying_in

from diffshadow.config import parse_config

ROOT = Path(__file__).parent.parent


@pytest.fixture(autouse=True)
def apart(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "experiments"))
    with staying_in(tmp_path):
        yield


def test_scenes_are_configurations_and_depend_on_seed_and_number_alone():
    collection = importlib.import_module("_collection")
    drawn = collection.Collection(0)
    scenes = [drawn.scene(i, 32) for i in range(27)]
    assert scenes[7] == drawn.scene(7, 32)
    assert collection.Collection(1).scene(7, 32) != scenes[7]
    assert [each["name"].split("_")[0] for each in scenes[:9]] == list(collection.KINDS)
    for each in scenes:
        parse_config(json.dumps(each))
    lights = {each["scene"]["light"]["type"] for each in (drawn.scene(i, 32) for i in range(200))}
    assert lights == {"directional", "spot", "point"}
    sizes = [mesh["scale"] for each in scenes for mesh in each["scene"]["meshes"]]
    assert max(sizes) / min(sizes) > 1e3
    wide = [each for each in (drawn.scene(i, 32) for i in range(200)) if each["name"].startswith("crowd")]
    assert {each["shadow_map"]["resolution"][0] for each in wide} == {256, 512, 1024, 2048}


def test_mesh_files_bring_kinds_of_their_own(monkeypatch):
    collection, files = importlib.import_module("_collection"), importlib.import_module("_mesh_files")
    Path("chair.ply").write_text("")
    Path("notes.txt").write_text("")
    (path,) = files.in_folder(Path().absolute())
    drawn = collection.Collection(0, [str(path)])
    assert drawn.kinds[-2:] == ["scan", "yard"]
    for index, least in ((9, 1), (10, 3)):
        made = drawn.scene(index, 32)["scene"]["meshes"]
        assert sum(mesh["path"] == str(path) for mesh in made) >= least
        assert made[-1]["path"] == "builtin:plane"
    # Without a network they are left out by name.
    monkeypatch.setattr(files, "_download", lambda *_: None)
    found, missing = files.packaged(Path("meshes"))
    assert found == []
    assert len(missing) == sum(map(len, files.PACKAGES.values()))


def measured(best, scenes=40, noise=0.0):
    """Errors that are least at the bias `best(reach)`, with acne below its slope in the scenes with an odd number."""
    errors, rules = importlib.import_module("_rule_errors"), importlib.import_module("_rules")
    shipped = importlib.import_module("_rule_shipped")
    names = [*rules.filter_names(), *shipped.ENGINES]
    rng, found = np.random.default_rng(0), []
    for i in range(scenes):
        of = {}
        for name in names:
            reach = errors.FILTERS[name].reach if name in errors.FILTERS else 2.0
            grid = rules._grid_of(name)
            away = np.abs(grid - best(reach)) * (grid.max(axis=0) > 0)
            error = 0.05 + 0.02 * away.sum(axis=1) + noise * rng.random(len(grid))
            acne = 0.01 * (grid[:, 0] < best(reach)[0] - 0.1) * (i % 2)
            of[name] = np.stack([error, acne, 0 * error], axis=1)
        for name in shipped.ENGINES:
            of[f"shipped {name}"], of[f"units {name}"] = np.array([0.5, 0.2, 0.0]), np.array([0.01 * (1 + i % 3), 1.0])
        # Of two kinds and two maps, and casters that are 8 or 800 texels wide.
        numbers = {**dict.fromkeys(errors.DESCRIBED, 1.0), "across": (8.0, 800.0)[i // 2 % 2], "texels": 512 << (i % 2)}
        found.append(of | {"scene": np.array([numbers[key] for key in errors.DESCRIBED])})
    kinds = [("one", "other")[i // 4 % 2] for i in range(scenes)]
    return rules, rules.Measured.of(found, names, kinds, [i % 4 >= 2 for i in range(scenes)])


def test_the_best_bias_of_all_scenes_is_found_and_costs_nothing():
    rules, made = measured(lambda reach: np.array([2.0, 2.0, 0.0]))
    name = "random_disk, radius 4"
    bias = rules.rule_of(made, name, (True, True, False))
    np.testing.assert_allclose(bias, [2, 2, 0], atol=0.05)
    worth = rules.worth(made.at(name, bias), made.best(name), made.apart)
    assert worth["price"] == pytest.approx(1, abs=0.03)
    assert worth["acne"] == 0
    assert worth["scenes"] == 20
    # Too small a bias has acne in half of the scenes.
    assert rules.worth(made.at(name, np.array([0.5, 2.0, 0.0])), made.best(name), made.apart)["acne"] == 0.5


def test_rules_are_tested_on_kinds_that_they_were_not_searched_for_in():
    rules, made = measured(lambda reach: np.array([2.0, 2.0, 0.0]))
    name = "bilinear"
    # In one kind, the best bias is another one.
    values, other = made.errors[name].copy(), made.kinds == "other"
    values[other] = values[other][:, ::-1]
    shifted = dataclasses.replace(made, errors={**made.errors, name: values})
    found = rules.left_out(shifted, name)
    assert found["tested"]["price"] > 1.2 * found["searched"]["price"]
    assert set(found["kinds"]) == {"one", "other"}
    assert set(found["maps"]) == {"512", "1024"}
    assert found["tested"]["price"] == pytest.approx(np.mean(found["prices"]), abs=1e-3)
    same = rules.left_out(made, name)
    assert same["tested"]["price"] == pytest.approx(same["searched"]["price"], abs=1e-6)


def test_a_constant_is_at_most_a_part_of_a_casters_width():
    rules, made = measured(lambda reach: np.array([3.0, 2.0, 0.0]))
    capped = made.capped("nearest", np.array([3.0, 2.0, 1.0]), 0.25)
    np.testing.assert_allclose(capped[:4], [[2, 2, 1], [2, 2, 1], [3, 2, 1], [3, 2, 1]])
    # A kernel that is wider than a caster blurs its shadow away.
    wide = made.capped("random_disk, radius 4", np.array([3.0, 2.0, 1.0]), 0.25)
    np.testing.assert_allclose(wide[0], [2.25, 2, 1])
    free = made.capped("nearest", np.array([3.0, 2.0, 1.0]), rules.NO_CAP)
    assert (free[:, 0] == 3).all()


@pytest.mark.exhaustive
def test_a_bias_that_grows_with_the_kernel_has_a_better_formula_than_one_for_all():
    rules, made = measured(lambda reach: np.array([1.0, 0.5 + 0.4 * reach, 0.0]))
    grows = rules.formula_of(made, rules.FORMULAS["c, s + t r"])
    np.testing.assert_allclose(grows, [1, 0.5, 0.4], atol=0.15)
    price = lambda name, numbers: np.mean(
        [each["price"] for each in rules.worths(made, rules.FORMULAS[name], numbers, made.apart).values()]
    )
    one = rules.formula_of(made, rules.FORMULAS["c, s, n"])
    assert price("c, s + t r", grows) < 1.1 < price("c, s, n", one)


def test_errors_between_the_biases_that_were_tried_are_linear():
    _, made = measured(lambda reach: np.array([15.0, 3.0, 2.0]))
    errors, shipped = importlib.import_module("_rule_errors"), importlib.import_module("_rule_shipped")
    line = lambda c, s, n: 0.05 + 0.02 * (15 - c + 3 - s + 2 - n)
    for bias in ((0.2, 0.7, 0.1), (12.0, 2.9, 1.7), (15, 3, 2)):
        np.testing.assert_allclose(made.at("pcf, radius 1.5", np.array(bias))[:, 0], line(*bias), rtol=1e-5)
    each = np.linspace(0, 10, len(made.apart))[:, None] * [1, 0.3, 0.2]
    np.testing.assert_allclose(made.at("pcf, radius 1.5", each)[:, 0], [line(*row) for row in each], rtol=1e-5)
    # Beyond its ends the grid's last error counts.
    np.testing.assert_allclose(made.at("bevy", np.array([99.0, 9.0, 0.0]))[:, 0], 0.05 + 0.02 * 2, rtol=1e-5)
    assert len(shipped.grid_of("babylon.js")) == len(errors.CONSTANT)


@pytest.mark.exhaustive
def test_what_was_measured_is_kept_and_the_same_each_time(monkeypatch):
    script = importlib.import_module("rules_of_thumb")
    collection, errors = importlib.import_module("_collection"), importlib.import_module("_rule_errors")
    monkeypatch.setattr(errors, "FILTERS", {"bilinear": errors.FILTERS["bilinear"]})
    monkeypatch.setattr(errors, "WITH_PLANE", ())
    monkeypatch.setattr(errors, "LITTLE", {"vsm, radius 2.5": errors.LITTLE["vsm, radius 2.5"]})
    text, path = json.dumps(collection.Collection(0).scene(4, 32)), Path("biases/00004.npz")
    first = script.stored(path, text, "", errors.measure)
    written = path.read_bytes()
    assert first["bilinear"].shape == (len(errors.grid_of("bilinear")), 3)
    assert (first["bilinear"] >= 0).all()
    assert (first["bilinear"][:, 0] <= 1).all()
    # No bias has acne, and some bias has hardly any.
    assert first["bilinear"][0, 1] > 0.05 > 0.005 > first["bilinear"][:, 1].min()
    assert set(first) == {"bilinear", "vsm, radius 2.5", "scene"}

    def fail(settings):
        raise AssertionError("measured again")

    again = script.stored(path, text, "", fail)
    np.testing.assert_array_equal(again["bilinear"], first["bilinear"])
    path.unlink()
    script.stored(path, text, "", errors.measure)
    assert path.read_bytes() == written
    # Of another scene, it is measured again.
    with pytest.raises(AssertionError, match="measured again"):
        script.stored(path, text.replace("32", "33"), "", fail)


def test_tables_of_a_page_are_replaced_behind_their_marks():
    page = importlib.import_module("_rule_page")
    text = "before\n\n<!-- table: a -->\n\n| old |\n|---|\n| 1 |\n\nafter | here\n"
    made = page.with_tables(text, {"a": "| new |\n|---|\n| \\1 |"})
    assert made == text.replace("old", "new").replace("| 1 |", "| \\1 |")
    assert page.with_tables(made, {}) == made
    with pytest.raises(ValueError, match="0 marks <!-- table: b -->; expected one"):
        page.with_tables(text, {"b": ""})


def test_the_package_and_the_page_have_the_same_tables():
    page, script = importlib.import_module("_rule_page"), importlib.import_module("rules_of_thumb")
    text = script.PAGE.read_text(encoding="utf-8")
    packaged = json.loads(script.PACKAGED.read_text(encoding="utf-8"))
    assert page.as_text(packaged) == script.PACKAGED.read_text(encoding="utf-8")
    for name, found in packaged["filters"].items():
        assert f"| {name} | {' | '.join(f'{x:.3g}' for x in found['bias'])} | {found['worth'][0]:.2f} ±" in text


def test_intervals_are_those_of_the_sample():
    errors, rules = importlib.import_module("_rule_errors"), importlib.import_module("_rules")
    price = np.random.default_rng(0).uniform(1, 2, 40)
    found = np.stack([price * 1.0, np.r_[np.ones(4), np.zeros(36)], np.zeros(40)], axis=1)
    worth = rules.worth(found, np.ones(40), np.ones(40, bool))
    spread = 1.645 * errors.ratio(price, np.ones(40)).std() / np.sqrt(40)
    low, high = worth["intervals"]["price"]
    assert (high - low) / 2 == pytest.approx(spread, rel=0.1)
    assert low < worth["price"] < high
    low, high = worth["intervals"]["acne"]
    assert (low, high) == pytest.approx((0.045, 0.21), abs=0.01)
    assert worth["intervals"]["leaks"][0] == 0 < worth["intervals"]["leaks"][1] < 0.1
