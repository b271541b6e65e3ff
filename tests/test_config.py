"""Configurations: what is read, how faults are told, and what is built."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from diffshadow.config import (
    Config,
    ConfigError,
    MeshConfig,
    OrthographicCameraConfig,
    PercentageCloserConfig,
    RandomDiskConfig,
    SceneConfig,
    describe,
    dump_resolved,
    fit_names,
    load_config,
    parse_config,
    sample_grid,
)

CONFIGS = sorted((Path(__file__).parent.parent / "configs").glob("*.yaml"))
QUICKSTART = next(path for path in CONFIGS if path.stem == "quickstart")
TINY = "scene: {meshes: [{path: 'builtin:torus_knot'}]}\n"
# The machine may be busy, and each example is small.
few = settings(max_examples=50, deadline=None)
JARGON = ("type=", "Input should", "pydantic", "http", "union", "tuple", "dict", "NoneType", "<", "extra")


def faults(text: str, *overrides: str) -> list[str]:
    """What is said of `text`, a line for each problem."""
    with pytest.raises(ConfigError) as caught:
        parse_config(text, overrides, source="file.yaml")
    said = str(caught.value).splitlines()
    assert len(said) == len(caught.value.problems)
    for line in said:
        assert not any(word in line for word in JARGON), line
    return said


def fault(text: str, *overrides: str) -> str:
    (only,) = faults(text, *overrides)
    return only


def test_tiny_config_is_complete_by_its_defaults():
    config = parse_config(TINY, name="tiny")
    assert config.name == "tiny"
    assert config.scene.camera.orbit is not None
    assert config.scene.light.type == "directional"
    assert (config.scene.light.azimuth, config.scene.light.elevation) == (60, 45)
    assert isinstance(config.filter, RandomDiskConfig)
    assert config.filter.grid == (4, 8)
    assert config.initial("bias.constant") == config.bias.constant


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_configs_load_and_explain_themselves(path):
    config = load_config(path)
    assert config.name == path.stem
    rows = {row.key: row for row in describe(config)}
    assert rows["filter.radius"].unit == "texels"
    assert rows["fit.parameters.filter.radius.upper"].unit == "texels"
    assert rows["scene.camera.resolution"].unit == "pixels"
    assert rows["scene.meshes.0.path"].value.startswith("builtin:")


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_resolved_config_loads_again_to_an_equal_one(path, tmp_path):
    config = load_config(path)
    copy = tmp_path / "another_name.yaml"
    copy.write_text(dump_resolved(config))
    assert load_config(copy) == config


def test_resolved_config_keeps_what_its_paths_mean(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    for name in ("here/a.obj", "b.obj", "here/truth.npy"):
        (tmp_path / name).touch()
    (tmp_path / "here" / "c.yaml").write_text(
        "scene: {meshes: [{path: a.obj}, {path: x.obj}]}\nreference: {type: image, path: ./truth.npy}\n"
    )
    monkeypatch.chdir(tmp_path)
    config = load_config("here/c.yaml", ["scene.meshes.1.path=b.obj"])
    assert [mesh.path for mesh in config.scene.meshes] == [str(tmp_path / "here/a.obj"), str(tmp_path / "b.obj")]
    monkeypatch.chdir("/")
    assert parse_config(dump_resolved(config)) == config


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1E5", 1e5),
        ("2e+4", 2e4),
        ("1", 1.0),
        (".5", 0.5),
        ("+3.", 3.0),
        ("0x10", 16.0),
        ("0o17", 15.0),
    ],
)
def test_numbers_follow_yaml_1_2(text, value):
    assert parse_config(TINY + f"bias: {{constant: {text}}}").bias.constant == value
    assert parse_config(TINY, [f"bias.constant={text}"]).bias.constant == value


@pytest.mark.parametrize("word", ["on", "yes", "no", "off", "2026-01-01", "1_000", "12:30:00"])
def test_yaml_1_1_specials_stay_text(word):
    assert parse_config(f"name: {word}\n{TINY}".replace(":30:", "-30-")).name == word.replace(":30:", "-30-")


def test_switch_words_are_refused_with_the_right_one():
    said = fault(TINY + "filter:\n  early_out: on\n")
    assert said == "file.yaml:3: filter.early_out: is 'on'; expected true or false; write true"


@few
@given(text=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12))
def test_any_text_survives_dump_and_load(text):
    try:
        config = Config.model_validate({**yaml.safe_load(TINY), "output": text})
    except ValueError:
        return
    assert parse_config(dump_resolved(config)).output == text


@few
@given(
    constant=st.floats(0, 1e30),
    seed=st.integers(0, 2**32 - 1),
    direction=st.tuples(*[st.floats(-1e20, 1e20).filter(lambda x: x != 0)] * 3),
)
def test_any_numbers_survive_overrides_dump_and_load(constant, seed, direction):
    overrides = [f"bias.constant={constant!r}", f"seed={seed}", f"scene.light.direction={list(direction)}"]
    config = parse_config(TINY, [*overrides, f"fit.parameters.bias.constant={{lower: 0, upper: {constant + 1!r}}}"])
    assert (config.bias.constant, config.seed, config.scene.light.direction) == (constant, seed, direction)
    assert parse_config(dump_resolved(config)) == config


@few
@given(key=st.text("abcdefgh._0123 ", max_size=20), value=st.text(max_size=12))
def test_no_override_ends_in_another_error(key, value):
    try:
        parse_config(TINY, [f"{key}={value}"])
    except ConfigError as error:
        problems = [str(problem) for problem in error.problems]
    else:
        problems = []
    assert all(problem.startswith("override ") for problem in problems)


@few
@given(text=st.text(max_size=40))
def test_no_text_ends_in_another_error(text):
    with pytest.raises(ConfigError):
        parse_config(text)


# Each fault alone: the line it is on, the key, what is said.
BROKEN = {
    "misspelt key": (
        "filter:\n  radius: 2\n  sampels: 64\n",
        "4: filter.sampels: is no key of filter (type: random_disk); expected type, radius, samples, pattern_size, "
        "lookup or early_out; did you mean 'samples'?",
    ),
    "key of another section": (
        "camera: {fov_y: 30}\n",
        "2: camera: is no key of the top level; expected name, seed, scene, shadow_map, bias, compare, filter, "
        "reference, fit or output; did you mean 'scene.camera'?",
    ),
    "key of another variant": (
        "filter:\n  type: pcf\n  samples: 32\n",
        "4: filter.samples: is no key of filter (type: pcf); expected type or radius; "
        "remove it, or set filter.type to random_disk",
    ),
    "misspelt type": (
        "filter:\n  type: pfc\n",
        "3: filter.type: is 'pfc'; expected nearest, bilinear, four_tap, pcf or random_disk; did you mean 'pcf'?",
    ),
    "type that is no text": (
        "filter: {type: [1]}\n",
        "2: filter.type: is [1]; expected nearest, bilinear, four_tap, pcf or random_disk; choose one of these",
    ),
    "misspelt choice": (
        "\nshadow_map:\n  cull: backk\n",
        "4: shadow_map.cull: is 'backk'; expected none, back or front; did you mean 'back'?",
    ),
    "text for a number": (
        "bias: {slope: steep}\n",
        "2: bias.slope: is 'steep'; expected a number at least 0, in texels; give such a value (the default is 0.5)",
    ),
    "number in quotes": (
        "bias: {slope: '1e-3'}\n",
        "2: bias.slope: is '1e-3'; expected a number at least 0, in texels; "
        "write it without quotes, with a point for decimals and no other signs between the digits",
    ),
    "boolean for a number": (
        "seed: true\n",
        "2: seed: is true; expected a whole number at least 0 and less than 4294967296; "
        "give such a value (the default is 0)",
    ),
    "fraction for a count": (
        "fit: {solver: {max_steps: 30.0}}\n",
        "2: fit.solver.max_steps: is 30.0; expected a whole number at least 1, in steps; write 30",
    ),
    "number for text": ("output: 3\n", "2: output: is 3; expected text; put it in quotes"),
    "not a number": (
        "bias: {slope: .nan}\n",
        "2: bias.slope: is nan; expected a number at least 0, in texels; give such a value (the default is 0.5)",
    ),
    "out of range": (
        "reference: {samples: 0}\n",
        "2: reference.samples: is 0; expected a whole number at least 1 and at most 65536, in rays a pixel; "
        "give such a value (the default is 64)",
    ),
    "short list": (
        "shadow_map: {resolution: [512]}\n",
        "2: shadow_map.resolution: has 1 entries; expected two whole numbers [height, width]; "
        "write a list such as [512, 512]",
    ),
    "bad entry of a list": (
        "shadow_map:\n  resolution: [512,\n    9000]\n",
        "4: shadow_map.resolution.1: is 9000; expected a whole number at least 1 and at most 8192, in texels; "
        "give such a value",
    ),
    "empty section": (
        "compare:\n",
        "2: compare: is empty; expected a section with the keys type, operator; remove the key to have its default",
    ),
    "text for a section": (
        "filter: pcf\n",
        "2: filter: is 'pcf'; expected a section with the keys type, radius, samples, pattern_size, lookup, early_out; "
        "write {type: pcf}",
    ),
    "number for a section": (
        "bias: 3\n",
        "2: bias: is 3; expected a section with the keys constant, slope, normal_offset; "
        "write its keys below it, indented",
    ),
    "prime samples": (
        "filter: {samples: 31}\n",
        "2: filter.samples: is 31, a prime number; expected a product of two whole numbers, so that the taps fill a "
        "grid; take 30 (5 x 6) or 32 (4 x 8)",
    ),
    "name of no folder": (
        "name: a/b\n",
        "2: name: is 'a/b'; expected text that can name a folder; use letters, digits, '-' and '_'",
    ),
    "missing bound": (
        "fit:\n  parameters:\n    bias.slope: {lower: 0}\n",
        "4: fit.parameters.bias.slope.upper: is missing; expected a number; add it: greatest value",
    ),
    "bounds the wrong way round": (
        "fit:\n  parameters:\n    bias.slope:\n      lower: 2\n      upper: 1\n",
        "6: fit.parameters.bias.slope.upper: is 1 and lower is 2; expected lower less than upper; "
        "make upper larger or lower smaller",
    ),
    "initial out of bounds": (
        "fit:\n  parameters:\n    bias.slope: {lower: 0, upper: 1,\n      initial: 2}\n",
        "5: fit.parameters.bias.slope.initial: is 2; expected a start from lower = 0 to upper = 1; "
        "move it inside, or widen the bounds",
    ),
    "default initial out of bounds": (
        "fit:\n  parameters:\n    filter.radius: {lower: 3, upper: 4}\n",
        "4: fit.parameters.filter.radius: starts at filter.radius = 2.0; expected a start from lower = 3 to upper = 4; "
        "give an initial value, change filter.radius, or widen the bounds",
    ),
    "parameter below its range": (
        "fit: {parameters: {bias.slope: {lower: -1, upper: 1}}}\n",
        "2: fit.parameters.bias.slope.lower: is -1; expected a number at least 0, as for bias.slope; raise it",
    ),
    "misspelt parameter": (
        "fit: {parameters: {bias.constnat: {lower: 0, upper: 1}}}\n",
        "2: fit.parameters.bias.constnat: cannot be fitted with filter type 'random_disk'; expected bias.constant, "
        "bias.slope, bias.normal_offset or filter.radius; did you mean 'bias.constant'?",
    ),
    "parameter of another technique": (
        "filter: {type: nearest}\nfit: {parameters: {filter.radius: {lower: 0, upper: 9}}}\n",
        "3: fit.parameters.filter.radius: cannot be fitted with filter type 'nearest'; expected bias.constant, "
        "bias.slope or bias.normal_offset; name one of these",
    ),
    "nothing to fit": (
        "fit: {parameters: {}}\n",
        "2: fit.parameters: is empty; expected at least one parameter to fit; "
        "add 'bias.constant: {lower: 0, upper: 10}'",
    ),
    "annealing upwards": (
        "fit: {anneal: {end: 3}}\n",
        "2: fit.anneal.end: is 3, with start 2.0 and end 3; expected end at most start; swap the two",
    ),
    "key given twice": (
        "seed: 1\nbias: {}\nseed: 2\n",
        "4: seed: is given twice, first on line 2; expected one value; remove one of them",
    ),
    "key that is no text": (
        "bias:\n  1: 2\n",
        "3: bias: has the key 1; expected text; put the key in quotes",
    ),
    "tag": ("output: !path x\n", "2: output: has the tag '!path'; expected plain data; remove the tag"),
    "endless number": (
        f"seed: {'9' * 50}\n",
        "2: seed: is an integer of 50 digits; expected a smaller one; check the number",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_fault_is_told_with_line_key_and_remedy(name):
    text, expected = BROKEN[name]
    assert fault(TINY + text) == f"file.yaml:{expected}"


SCENES = {
    "no mesh": (
        "  meshes: []\n",
        "2: scene.meshes: is an empty list; expected at least one mesh; add '- path: builtin:torus_knot'",
    ),
    "meshes left out": (
        "  camera: {}\n",
        "1: scene.meshes: is missing; expected a list of meshes, each with a path; "
        "add it: surfaces, each a caster and a receiver; cameras and lights orbit the first",
    ),
    "no list": (
        "  meshes: builtin:box\n",
        "2: scene.meshes: is 'builtin:box'; expected a list of meshes, each with a path; give such a value",
    ),
    "misspelt builtin": (
        "  meshes:\n  - path: builtin:boxx\n",
        "3: scene.meshes.0.path: is 'builtin:boxx'; expected builtin: followed by plane, box, sphere, "
        "low_poly_sphere, torus, torus_knot, fence, thin_wall or blob; did you mean 'builtin:box'?",
    ),
    "orbit and eye": (
        "  meshes: [path: 'builtin:box']\n  camera:\n    orbit: {azimuth: 3}\n    eye: [1, 2, 3]\n",
        "5: scene.camera.eye: is given together with orbit; expected one or the other; "
        "remove eye or orbit, or set it to null",
    ),
    "target alone": (
        "  meshes: [path: 'builtin:box']\n  camera: {target: [1, 2, 3]}\n",
        "3: scene.camera.target: is given without eye; expected eye with it; add eye: [x, y, z] in world units",
    ),
    "near beyond far": (
        "  meshes: [path: 'builtin:box']\n  camera: {near: 2, far: 1}\n",
        "3: scene.camera.far: is 1 and near is 2; expected near less than far; make far larger or near smaller",
    ),
    "azimuth and direction": (
        "  meshes: [path: 'builtin:box']\n  light:\n    azimuth: 3\n    direction: [0, -1, 0]\n",
        "4: scene.light.azimuth: is given together with direction; expected one or the other; "
        "remove azimuth or direction, or set it to null",
    ),
    "no direction": (
        "  meshes: [path: 'builtin:box']\n  light: {direction: [0, 0.0, 0]}\n",
        "3: scene.light.direction: is [0, 0, 0]; expected a vector that is not zero; "
        "give the way the light travels, such as [0, -1, 0]",
    ),
    "orbit and position": (
        "  meshes: [path: 'builtin:box']\n  light: {type: spot, orbit: {},\n    position: [0, 3, 0]}\n",
        "4: scene.light.position: is given together with orbit; expected one or the other; "
        "remove position or orbit, or set it to null",
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_fault_of_a_scene_is_told_with_line_key_and_remedy(name):
    text, expected = SCENES[name]
    assert fault("scene:\n" + text) == f"file.yaml:{expected}"


def test_missing_mesh_file_names_the_nearest(tmp_path):
    (tmp_path / "bunny.obj").touch()
    file = tmp_path / "c.yaml"
    file.write_text("scene:\n  meshes:\n    - path: builtin:box\n    - path: buny.obj\n      options: {size: 1}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    first, second = str(caught.value).splitlines()
    assert first == (
        f"{file}:4: scene.meshes.1.path: there is no file {tmp_path / 'buny.obj'}; "
        "expected one that can be read; did you mean 'bunny.obj'?"
    )
    assert second == (
        f"{file}:5: scene.meshes.1.options: are given with a mesh file; "
        "expected options with a builtin mesh only; remove the options"
    )


def test_forgotten_builtin_is_suggested():
    assert "did you mean 'builtin:torus_knot'?" in fault("scene: {meshes: [path: torus_knot]}")


def test_every_problem_is_told_at_once_in_the_order_of_the_file():
    text = """\
seed: -1
scene:
  meshes:
    - path: builtin:box
      sise: 1
    - path: builtin:spere
      albedo: [2, 0, 0]
  camera: {type: pinhol}
  light: {type: spot, radius: -1, orbit: {azimut: 3}, position: [0, 1, 0]}
filter: {type: pcf, radius: big}
fit:
  parameters:
    bias.slop: {lower: 0, upper: 1}
    filter.radius: {lower: 1, upper: 1}
seed: 3
"""
    said = faults(text, "bias.slope=x", "fit.solver.kind=lm", "scene.meshes.2.path=builtin:box")
    assert [line.split(": ")[:2] for line in said] == [
        ["file.yaml:1", "seed"],
        ["file.yaml:5", "scene.meshes.0.sise"],
        ["file.yaml:6", "scene.meshes.1.path"],
        ["file.yaml:7", "scene.meshes.1.albedo.0"],
        ["file.yaml:8", "scene.camera.type"],
        ["file.yaml:9", "scene.light.position"],
        ["file.yaml:9", "scene.light.orbit.azimut"],
        ["file.yaml:9", "scene.light.radius"],
        ["file.yaml:10", "filter.radius"],
        ["file.yaml:13", "fit.parameters.bias.slop"],
        ["file.yaml:14", "fit.parameters.filter.radius.upper"],
        ["file.yaml:15", "seed"],
        ["override 'scene.meshes.2.path=builtin:box'", "scene.meshes.2"],
        ["override 'bias.slope=x'", "bias.slope"],
        ["override 'fit.solver.kind=lm'", "fit.solver.kind"],
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: [1, 2\nb: 3\n", "2: is not YAML: expected ',' or ']', but got ':' (column 2); close the list with ']'"),
        ("a: 1\n\tb: 2\n", "2: is not YAML: found character '\\t' that cannot start any token (column 1); indent"),
        ("a: b: c\n", "1: is not YAML: mapping values are not allowed here (column 5); check the indentation"),
        ("a: 'x\n", "2: is not YAML: found unexpected end of stream (column 1); close the quotes"),
        ("a: 1\n---\nb: 2\n", "2: is not YAML: but found another document (column 1); keep one document a file"),
        ("a: *x\n", "1: is not YAML: found undefined alias 'x' (column 4); quote text that begins with '*'"),
        ("a: 1\nb: \x07\n", "2: holds the character U+0007; expected printable text; remove it"),
        ("[" * 5000, "1: sections or lists are nested hundreds deep; expected a handful of levels"),
        ("- a\n", "1: holds ['a']; expected a section with keys; write 'key: value' lines"),
        ("", "1: scene: is missing; expected a section with the keys meshes, camera, light"),
        ("# nothing\n", "1: scene: is missing; expected a section with the keys meshes, camera, light"),
        ("a: &x [*x]\n", "1: a.0: contains itself; expected plain data"),
    ],
)
def test_what_is_no_configuration_is_told_with_its_line(text, expected):
    assert faults(text)[0].startswith(f"file.yaml:{expected}")


def test_aliases_cannot_blow_up():
    bomb = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 9))
    assert any("10,001th value" in line for line in faults(bomb))


def test_aliases_stand_for_what_they_repeat():
    text = "scene: {meshes: [&box {path: 'builtin:box'}, *box]}\n"
    first, second = parse_config(text).scene.meshes
    assert first == second


def test_unreadable_files_are_told(tmp_path):
    (tmp_path / "quick.yaml").write_bytes(b"name: x\nseed: \xff\n")
    for name, expected in {
        "quick.yaml": "quick.yaml:2: holds the byte 0xff; expected UTF-8 text; save the file as UTF-8",
        "quik.yaml": "quik.yaml: there is no such file; expected a configuration in YAML; did you mean 'quick.yaml'?",
        "no/c.yaml": f"c.yaml: there is no such file; expected a configuration in YAML; check the path: there is no "
        f"folder {tmp_path / 'no'}",
        ".": "cannot be read (Is a directory)",
    }.items():
        with pytest.raises(ConfigError) as caught:
            load_config(tmp_path / name)
        assert expected in str(caught.value)


def test_byte_order_mark_and_windows_line_ends_are_fine(tmp_path):
    file = tmp_path / "c.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + f"{TINY}\nseed: 7\n".replace("\n", "\r\n").encode())
    assert load_config(file).seed == 7


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("filter.sampels=64", "filter.sampels: is no key of filter (type: random_disk)"),
        ("filter.type=pcf4", "filter.type: is 'pcf4'"),
        ("bias.slope=-1", "bias.slope: is -1"),
        ("bias.slope", "is no KEY=VALUE; expected a dotted key; write it like filter.radius=2"),
        ("=3", "is no KEY=VALUE"),
        ("bias..slope=3", "is no KEY=VALUE"),
        ("bias.slope=[1", "is not YAML: expected ',' or ']', but got the end; close the list with ']'"),
        ("bias={slope: 1, slope: 2}", "bias.slope: is given twice"),
        ("seed.x=3", "seed.x: leads into seed, which is 0; expected a section; set seed as a whole"),
        ("scene.meshes.7.size=3", "scene.meshes.7: index 7 is out of range: the list scene.meshes has 2 entries"),
        ("scene.meshes.one.size=3", "scene.meshes.one: 'one' is no index of the list scene.meshes; expected a number"),
        ("scene.meshes.-1.size=3", "scene.meshes.-1: '-1' is no index of the list scene.meshes"),
        ("scene.camera.resolution.2=3", "scene.camera.resolution.2: index 2 is out of range"),
        ("scene.meshes.0.path=no.obj", "scene.meshes.0.path: there is no file"),
        ("fit.parameters.bias.slpe.upper=3", "fit.parameters.bias.slpe: cannot be fitted"),
        ("fit.parameters.bias.slope.uper=3", "fit.parameters.bias.slope.uper: is no key of fit.parameters.bias.slope"),
        ("scene=", "scene: is empty; expected a section with the keys meshes, camera, light; give it a value"),
    ],
)
def test_fault_of_an_override_is_told_with_the_override(override, expected):
    with pytest.raises(ConfigError) as caught:
        load_config(QUICKSTART, [override])
    assert any(line.startswith(f"override {override!r}: {expected}") for line in str(caught.value).splitlines())


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("filter.samples=64", "filter.samples", "64"),
        ("fit.anneal.kernel=gaussian", "fit.anneal.kernel", "gaussian"),
        ("bias.normal_offset=1e-1", "bias.normal_offset", "0.1"),
        ("scene.meshes.1.options.segments=3", "scene.meshes.1.options", "size = 3, segments = 3"),
        ("scene.camera.up=[0, 0, 1]", "scene.camera.up", "[0.0, 0.0, 1.0]"),
        ("scene.camera.resolution.1=64", "scene.camera.resolution", "[512, 64]"),
        ("fit.parameters.bias.constant.upper=5", "fit.parameters.bias.constant.upper", "5.0"),
        ("fit.parameters.bias.slope={lower: 0, upper: 3}", "fit.parameters.bias.slope.upper", "3.0"),
        ("name=a=b", "name", "a=b"),
    ],
)
def test_override_replaces_one_value(override, key, value):
    before, after = ({row.key: row.value for row in describe(load_config(QUICKSTART, o))} for o in ([], [override]))
    assert after[key] == value
    assert before.get(key) != value
    changed = {k for k in before.keys() & after.keys() if before[k] != after[k]}
    assert changed <= {key}


def test_override_can_null_what_excludes_another_and_the_last_one_wins():
    overrides = ["scene.camera.orbit=null", "scene.camera.eye=[1, 1, 1]", "scene.camera.eye=[0, 1, 5]"]
    camera = load_config(QUICKSTART, overrides).scene.camera
    assert camera.orbit is None
    assert camera.eye == (0, 1, 5)


def test_override_of_a_type_tells_how_to_replace_the_section():
    with pytest.raises(ConfigError) as caught:
        load_config(QUICKSTART, ["filter.type=nearest"])
    assert "override the whole section: filter={type: nearest, …}" in str(caught.value)


@pytest.mark.parametrize(
    ("samples", "grid"), [(1, (1, 1)), (2, (1, 2)), (3, (1, 3)), (12, (3, 4)), (64, (8, 8)), (62, (2, 31))]
)
def test_samples_factor_into_the_grid_nearest_to_a_square(samples, grid):
    assert sample_grid(samples) == grid
    assert RandomDiskConfig(samples=samples).grid == grid


@few
@given(st.integers(4, 4096))
def test_suggested_sample_counts_are_accepted(samples):
    try:
        u, v = RandomDiskConfig(samples=samples).grid
    except ValueError:
        assert all(samples % n for n in range(2, math.isqrt(samples) + 1))
    else:
        assert u * v == samples
        assert 2 <= u <= v


def test_python_users_get_the_same_checks():
    scene = SceneConfig(meshes=(MeshConfig(path="builtin:box"),), camera=OrthographicCameraConfig())
    config = Config(scene=scene, filter=PercentageCloserConfig(radius=3.0))
    assert parse_config(dump_resolved(config)) == config
    with pytest.raises(ValueError, match="cannot be fitted"):
        Config.model_validate({"scene": scene, "fit": {"parameters": {"x": {"lower": 0.0, "upper": 1.0}}}})
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 3


def test_fit_names_follow_the_filter():
    assert "filter.radius" in fit_names("pcf")
    assert "filter.radius" not in fit_names("bilinear")


# From here on JAX is needed.


def build(*overrides: str, text: str = TINY):
    from diffshadow.config import build_scene

    return build_scene(parse_config(text, overrides))


def test_builtin_names_are_those_of_the_library():
    from diffshadow.config._scene import BUILTIN_MESHES
    from diffshadow.geometry import LIBRARY

    assert set(BUILTIN_MESHES) == set(LIBRARY)


def test_mesh_is_sized_dropped_scaled_turned_and_moved():
    text = "scene: {meshes: [{path: 'builtin:box', size: 2, drop_to_ground: true, scale: 0.5}]}"
    moved = build("scene.meshes.0.translate=[1, 2, 3]", "scene.meshes.0.rotate=[90, 0, 90]", text=text)
    # A unit cube on the ground; about x, up becomes +z; about z, +y becomes -x, and +z stays.
    assert np.allclose(moved.mesh.bounds, [[0.5, 1.5, 3], [1.5, 2.5, 4]], atol=1e-6)


def test_albedo_is_that_of_the_mesh():
    text = "scene: {meshes: [{path: 'builtin:box', albedo: [1, 0, 0]}, {path: 'builtin:plane'}]}"
    albedo = np.asarray(build(text=text).mesh.albedo)
    assert np.array_equal(albedo[0], [1, 0, 0])
    assert np.allclose(albedo[-1], 0.8)


def test_camera_orbits_the_first_mesh_in_its_radii():
    text = "scene: {meshes: [{path: 'builtin:box', translate: [1, 0, 0]}, {path: 'builtin:plane', options: {size: 9}}]}"
    camera = build("scene.camera.orbit={azimuth: 90, elevation: 0, distance: 4}", text=text).camera
    radius = math.sqrt(3) / 2
    assert np.allclose(camera.target, [1, 0.5, 0], atol=1e-6)
    assert np.allclose(camera.eye, [1 + 4 * radius, 0.5, 0], atol=1e-5)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_near_and_far_hold_the_scene_tightly(kind):
    scene = build(f"scene.camera={{type: {kind}, eye: [0.2, 3, 4]}}")
    view = scene.camera.view()
    depth = -np.asarray(scene.mesh.vertices @ view.world_to_eye[2, :3] + view.world_to_eye[2, 3])
    near, far = float(scene.camera.near), float(scene.camera.far)
    assert near < depth.min()
    assert depth.max() < far
    assert far - near < 1.1 * (depth.max() - depth.min())


def test_orthographic_camera_holds_the_whole_scene_by_default():
    scene = build("scene.camera={type: orthographic, resolution: [64, 32]}")
    clip = np.asarray(scene.camera.view().clip(scene.mesh.vertices))
    reach = np.abs(clip[:, :2]).max()
    assert 0.9 < reach <= 1


def test_camera_inside_the_scene_keeps_its_near_clear_of_zero():
    camera = build("scene.camera={eye: [0, 0.5, 0.05]}", text=TINY.replace("torus_knot", "sphere")).camera
    assert float(camera.near) == pytest.approx(1e-3 * float(camera.far), rel=1e-5)


def test_light_comes_from_where_its_angles_say():
    light = build("scene.light={azimuth: 90, elevation: 0}").light
    assert np.allclose(light.direction, [-1, 0, 0], atol=1e-6)
    light = build("scene.light={direction: [0, -2, 0], angular_radius: 0.5}").light
    assert np.allclose(light.direction, [0, -2, 0])
    assert float(light.angular_radius) == 0.5


def test_spot_light_takes_its_overrides():
    light = build("scene.light={type: spot, position: [0, 5, 0], near: 1, far: 9, outer_angle: 30, radius: 0.1}").light
    assert (float(light.near), float(light.far), float(light.outer_angle)) == (1, 9, 30)
    orbit = build("scene.light={type: spot, orbit: {elevation: 90, distance: 9}}").light
    assert orbit.position[1] > 3
    assert 0 < float(orbit.near) < float(orbit.far)


def test_faults_found_while_building_name_line_and_key():
    text = """\
scene:
  meshes:
    - path: builtin:box
      options: {sise: 3}
    - path: builtin:plane
      options: {size: -3}
"""
    with pytest.raises(ConfigError) as caught:
        build(text=text)
    first, second = (str(problem) for problem in caught.value.problems)
    assert first.startswith("configuration:3: scene.meshes.0: box has no option 'sise'")
    assert second.startswith("configuration:5: scene.meshes.1: plane: size is -3")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("scene.camera={eye: [0, 3, 0], target: [0, 3, 0]}", "scene.camera: the camera's eye and target are both"),
        ("scene.camera={eye: [0, 3, 0], target: [0, 9, 0]}", "scene.camera: the whole scene lies behind the camera"),
        ("scene.camera.near=1e6", "scene.camera: the camera has near = 1000000.0"),
        ("scene.light={type: spot, position: [0, 0.3, 0]}", "scene.light: the spot light at"),
    ],
)
def test_poses_that_cannot_be_are_told_with_their_key(override, said):
    with pytest.raises(ConfigError) as caught:
        build(override)
    assert str(caught.value).startswith(f"override {override!r}: {said}")


def test_damaged_mesh_file_is_told_with_line_and_key(tmp_path):
    from diffshadow.config import build_scene

    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    file = tmp_path / "c.yaml"
    file.write_text("scene:\n  meshes:\n    - path: nan.obj\n")
    with pytest.raises(ConfigError) as caught:
        build_scene(load_config(file))
    assert str(caught.value).startswith(f"{file}:3: scene.meshes.0: ")


@pytest.mark.parametrize(
    ("override", "filter_name", "compare_name"),
    [
        ("filter={type: nearest}", "Nearest", "HardCompare"),
        ("filter={type: bilinear}", "Bilinear", "HardCompare"),
        ("filter={type: four_tap, radius: 1.5}", "FourTap", "HardCompare"),
        ("filter={type: pcf, radius: 3}", "PercentageCloser", "HardCompare"),
        ("filter={samples: 6, lookup: nearest, early_out: true}", "RandomDisk", "HardCompare"),
        ("compare={type: soft, width: 0.2, kernel: gaussian}", "RandomDisk", "SoftCompare"),
    ],
)
def test_technique_is_what_the_config_says(override, filter_name, compare_name):
    from diffshadow.config import build_technique

    technique = build_technique(parse_config(TINY, [override, "bias.slope=2"]))
    assert type(technique.filter).__name__ == filter_name
    assert type(technique.compare).__name__ == compare_name
    assert float(technique.bias.slope.value) == 2


def test_box_filter_has_room_for_the_radii_of_its_fit():
    from diffshadow.config import build_technique

    config = parse_config(
        TINY, ["filter={type: pcf, radius: 2}", "fit.parameters={filter.radius: {lower: 0, upper: 7}}"]
    )
    assert build_technique(config).filter.max_radius == 7
    assert build_technique(config, fitting=False).filter.max_radius == 2


def test_fit_plan_is_what_the_config_says():
    from diffshadow.config import build_fit

    overrides = ["bias.slope=2", "fit.parameters.bias.slope={lower: 0, upper: 3}", "fit.solver.max_steps=7"]
    plan = build_fit(parse_config(TINY, [*overrides, "fit.anneal={start: 1, end: 0.1, phases: 2}"]))
    (slope,) = plan.parameters
    assert (slope.name, float(slope.initial), float(slope.lower), float(slope.upper)) == ("bias.slope", 2, 0, 3)
    assert plan.solver.max_steps == 7
    assert (float(plan.anneal.start), float(plan.anneal.end), plan.anneal.phases) == (1, 0.1, 2)
