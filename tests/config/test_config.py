"""Configurations: what is read, and how faults are told. Nothing here needs JAX."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tables import cases

from diffshadow.config import (
    Config,
    ConfigError,
    describe,
    dump_resolved,
    fit_paths,
    input_files,
    load_config,
    parse_config,
)
from diffshadow.settings import filters, rules
from diffshadow.settings.biases import Terms
from diffshadow.settings.fit import widest_blur
from diffshadow.shadow.biases import FEATURES

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
QUICKSTART = next(path for path in CONFIGS if path.stem == "quickstart")
TINY = "scene: {meshes: [{path: 'builtin:torus_knot'}]}\n"
# The machine may be busy, and each example is small.
few = settings(max_examples=5, deadline=None)
JARGON = ("type=", "Input should", "pydantic", "http", "union", "tuple", "dict", "NoneType", "<", "extra")


def faults(text: str, *overrides: str) -> list[str]:
    """The lines of the error that `text` gives as a fit, one for each problem."""
    with pytest.raises(ConfigError) as caught:
        parse_config(text, overrides, source="file.yaml", fitting=True)
    said = str(caught.value).splitlines()
    assert len(said) == len(caught.value.mistakes)
    for line in said:
        assert not any(word in line for word in JARGON), line
    return said


def fault(text: str, *overrides: str) -> str:
    (only,) = faults(text, *overrides)
    return only


def test_tiny_config_is_complete_by_its_defaults():
    config = parse_config(TINY, name="tiny")
    assert config.name == "tiny"
    assert config.scene.camera.eye is not None
    assert config.scene.light.type == "directional"
    assert (config.scene.light.azimuth, config.scene.light.elevation) == (60, 45)
    assert isinstance(config.filter, filters.RandomDisk)
    assert config.filter.pattern == "stratified"
    assert config.technique.type == "shadow_map"
    assert config.initial("bias.constant") == config.bias.constant


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_configs_load_and_explain_themselves(path):
    config = load_config(path, ["sweep=null"])
    assert config.name == path.stem
    rows = {row.key: row for row in describe(config)}
    assert rows["bias.slope"].unit == "texels"
    bounds = {key: row for key, row in rows.items() if key.startswith("fit.parameters.") and key.endswith(".upper")}
    # Colours have none.
    assert all(bool(row.unit) != (".albedo." in key) for key, row in bounds.items())
    assert rows["scene.camera.resolution"].unit == "pixels"
    assert rows["scene.meshes.0.path"].value.startswith("builtin:")


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
    assert parse_config(TINY + f"shading: {{shininess: {text}}}").shading.shininess == value
    assert parse_config(TINY, [f"shading.shininess={text}"]).shading.shininess == value


@pytest.mark.parametrize("word", ["on", "yes", "no", "off", "2026-01-01", "1_000", "12:30:00"])
def test_yaml_1_1_specials_stay_text(word):
    assert parse_config(f"name: {word}\n{TINY}".replace(":30:", "-30-")).name == word.replace(":30:", "-30-")


def test_switch_words_are_refused_with_the_right_one():
    said = fault(TINY + "filter:\n  early_out: on\n")
    assert said == "file.yaml:3: filter.early_out: is 'on'; expected true or false; write true"


@few
@given(text=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12))
@example("1e-3")
@example("0o17")
def test_any_text_survives_dump_and_load(text):
    try:
        config = Config.model_validate({**yaml.safe_load(TINY), "output": text})
    except ValueError:
        return
    assert parse_config(dump_resolved(config)).output == text


@few
@given(
    constant=st.floats(0, 8000, width=32, allow_subnormal=False),
    seed=st.integers(0, 2**32 - 1),
    direction=st.tuples(*[st.floats(-1e9, 1e9).filter(lambda x: abs(x) > 1e-9)] * 3),
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
        problems = [str(problem) for problem in error.mistakes]
    else:
        problems = []
    assert all(problem.startswith("override ") for problem in problems)


@few
@given(text=st.text(max_size=40))
def test_no_text_ends_in_another_error(text):
    with pytest.raises(ConfigError):
        parse_config(text)


# One fault a row: its line, its key and the message. Rows on scenes contain no other section.
FAULTS = cases("""
filter:↵  radius: 2↵  sampels: 64
    4: filter.sampels: is not a key of filter (type: random_disk); expected type, radius, lookup, early_out, pattern,
    samples, pattern_size or rotated; did you mean 'samples'?
camera: {fov_y: 30}
    2: camera: is not a key of the top level; expected name, seed, scene, technique, shadow_map, bias, compare,
    filter, shading, reference, fit, sweep, advise or output; did you mean 'scene.camera'?
filter:↵  type: pcf↵  samples: 32
    4: filter.samples: is not a key of filter (type: pcf); expected type or radius; remove it, or set filter.type to
    random_disk or pcss
filter:↵  type: pfc
    3: filter.type: is 'pfc'; expected nearest, bilinear, four_tap, pcf, tent, castano, separable, random_disk, pcss,
    vsm, esm, evsm or msm; did you mean 'pcf'?
filter: {type: [1]}
    2: filter.type: is [1]; expected nearest, bilinear, four_tap, pcf, tent, castano, separable, random_disk, pcss,
    vsm, esm, evsm or msm; choose one of these
↵shadow_map:↵  cull: backk
    4: shadow_map.cull: is 'backk'; expected none, back or front; did you mean 'back'?
bias: {slope: steep}
    2: bias.slope: is 'steep'; expected a number at least 0 and at most 8192, in texels; give such a value (the
    default is 0.0)
bias: {slope: '1e-3'}
    2: bias.slope: is '1e-3'; expected a number at least 0 and at most 8192, in texels; write it without quotes, with
    a decimal point and without other characters between the digits
seed: true
    2: seed: is true; expected a whole number at least 0 and less than 4294967296; give such a value (the default is
    0)
fit: {solver: {max_steps: 30.0}}
    2: fit.solver.max_steps: is 30.0; expected a whole number at least 1 and at most 100000, in steps; write 30
output: 3
    2: output: is 3; expected text; put it in quotes
bias: {slope: .nan}
    2: bias.slope: is nan; expected a number at least 0 and at most 8192, in texels; give such a value (the default is
    0.0)
reference: {samples: 0}
    2: reference.samples: is 0; expected a whole number at least 1 and at most 65536, in rays per pixel; give such a
    value (the default is 64)
shadow_map: {resolution: [512]}
    2: shadow_map.resolution: is [512]; expected two whole numbers [height, width], in texels; write a list such as
    [512, 512]
shadow_map:↵  resolution: [512,↵    9000]
    4: shadow_map.resolution.1: is 9000; expected a whole number at least 1 and at most 8192, in texels; give such a
    value
compare:
    2: compare: is empty; expected a section with the keys type, operator; remove the key to get its default
filter: pcf
    2: filter: is 'pcf'; expected a section with the keys type, radius, lookup, early_out, pattern, samples,
    pattern_size, rotated; write {type: pcf}
bias: 3
    2: bias: is 3; expected a section with the keys constant, slope, slope_profile, slope_least, slope_most, unit,
    normal_offset, normal_offset_profile, factors, terms, network, plane; write its keys below it, indented
filter:↵  pattern: sobbol
    3: filter.pattern: is 'sobbol'; expected stratified, uniform, poisson, vogel, sobol or halton; did you mean
    'sobol'?
filter: {type: vsm, exponent: 40}
    2: filter.exponent: is not a key of filter (type: vsm); expected type, radius, kernel, light_bleeding or
    least_variance; remove it, or set filter.type to esm
filter: {type: castano, size: 4}
    2: filter.size: is 4; expected 3, 5 or 7; choose one of these
filter: {type: pcss, min_radius: 3, max_radius: 2}
    2: filter.max_radius: is 2 and min_radius is 3; expected min_radius at most max_radius; make max_radius larger or
    min_radius smaller
bias: {plane: {type: reciever_plane}}
    2: bias.plane.type: is 'reciever_plane'; expected none, receiver_plane or adaptive; did you mean 'receiver_plane'?
bias: {slope_least: 2,↵  slope_most: 1}
    3: bias.slope_most: is 1 and slope_least is 2; expected slope_least at most slope_most; make slope_most larger or
    slope_least smaller
technique: {type: shadow_volume}
    2: technique.type: is 'shadow_volume'; expected shadow_map, cascades, perspective_warp, resolution_matched,
    shadow_volumes, irregular_z_buffer, projective_texture, three.js, babylon.js, playcanvas, bevy or
    godot_compatibility; did you mean 'shadow_volumes'?
technique: {method: z_fail}
    2: technique.method: is not a key of technique (type: shadow_map); expected type; remove it, or set technique.type
    to perspective_warp or shadow_volumes
technique:↵  type: projective_texture
    3: technique.type: projects shadows only onto meshes that do not cast, but all of scene.meshes cast; expected a mesh
    that does not cast; set casts: false for the receivers
shadow_map: {silhouettes: true, cull: front}
    2: shadow_map.cull: is front with silhouettes; expected none; remove it, or set shadow_map.silhouettes to false
shadow_map: {depth_layer: midpoint}↵fit: {parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}
    2: shadow_map.depth_layer: is midpoint in a fit of lights or meshes, with silhouettes; expected nearest; remove
    it, or set shadow_map.silhouettes to false
shadow_map: {polygon_offset: 2}
    2: shadow_map.polygon_offset: is 2; expected two numbers [factor, units]; write a list such as [1.1, 4]
shading: {ambient: [0, 0]}
    2: shading.ambient: is [0, 0]; expected a number, or three [red, green, blue], at least 0; write a list such as
    [0.8, 0.8, 0.8]
fit: {parameters: {bias.slope_most: {lower: 0, upper: 1}}}
    2: fit.parameters.bias.slope_most: has no start, because bias.slope_most is not set; expected an initial value
    within the bounds; add initial, or set bias.slope_most
filter: {type: esm}↵fit: {parameters: {filter.exponent: {lower: 0, upper: 90}}}
    3: fit.parameters.filter.exponent.upper: is 90; expected a number at most 80, as for filter.exponent; lower it
name: a/b
    2: name: is 'a/b'; expected text that can name a folder; use letters, digits, '-' and '_'
fit:↵  parameters:↵    bias.slope: {lower: 0}
    4: fit.parameters.bias.slope.upper: is missing; expected a number; add it: greatest value
fit:↵  parameters:↵    bias.slope:↵      lower: 2↵      upper: 1
    6: fit.parameters.bias.slope.upper: is 1 and lower is 2; expected lower less than upper; make upper larger or
    lower smaller
fit:↵  parameters:↵    bias.slope: {lower: 0, upper: 1,↵      initial: 2}
    5: fit.parameters.bias.slope.initial: is 2; expected a start from lower = 0 to upper = 1; move it inside, or widen
    the bounds
fit:↵  parameters:↵    filter.radius: {lower: 3, upper: 4}
    4: fit.parameters.filter.radius: starts at filter.radius = 2; expected a start from lower = 3 to upper = 4; give
    an initial value, change filter.radius, or widen the bounds
fit: {parameters: {bias.slope: {lower: -1, upper: 1}}}
    2: fit.parameters.bias.slope.lower: is -1; expected a number at least 0, as for bias.slope; raise it
bias: {terms: {tangent: 1}}
    2: bias.terms.tangent: is not a key of bias.terms; expected one, slope, sine, one_minus_cosine, texel_size,
    distance or blocker_distance; remove it
bias: {network: {hidden: [{weight: [[1]], bias: [0]}], last: [1]}}
    2: bias.network: is given without terms; expected the terms that it corrects; give terms, such as {slope: 0.5}
bias: {terms: {slope: null}, network: {hidden: [{weight: [[1]], bias: [0]}], last: [1]}}
    2: bias.network: is given without terms; expected the terms that it corrects; give terms, such as {slope: 0.5}
bias: {terms: {slope: 1}, network: {hidden: [{weight: 1, bias: [0]}], last: [1]}}
    2: bias.network.hidden.0.weight: is 1; expected a list of lists of numbers; give such a value
bias: {terms: {slope: 1}}↵fit: {parameters: {bias.terms.sine: {lower: 0, upper: 1}}}
    3: fit.parameters.bias.terms.sine: cannot be fitted with filter type 'random_disk'; expected bias.constant,
    bias.slope, bias.slope_least, bias.slope_most, bias.normal_offset, bias.terms.slope or filter.radius; did you mean
    'bias.terms.slope'?
fit: {points: 3}
    2: fit.points: is given, and nothing moves; expected a parameter of a light or mesh with it; remove the key, or add
    a parameter of the scene, such as scene.light.azimuth
fit: {parameters: {bias.constnat: {lower: 0, upper: 1}}}
    2: fit.parameters.bias.constnat: cannot be fitted with filter type 'random_disk'; expected bias.constant,
    bias.slope, bias.slope_least, bias.slope_most, bias.normal_offset or filter.radius; did you mean 'bias.constant'?
filter: {type: nearest}↵fit: {parameters: {filter.radius: {lower: 0, upper: 9}}}
    3: fit.parameters.filter.radius: cannot be fitted with filter type 'nearest'; expected bias.constant, bias.slope,
    bias.slope_least, bias.slope_most or bias.normal_offset; name one of these
filter: {type: pcss}↵fit: {parameters: {filter.radius: {lower: 0, upper: 9}}}
    3: fit.parameters.filter.radius: cannot be fitted with filter type 'pcss'; expected bias.constant, bias.slope,
    bias.slope_least, bias.slope_most, bias.normal_offset, filter.light_size or filter.min_radius; name one of these
technique: {type: cascades, count: 2}↵bias: {factors: [1, 1]}↵fit: {parameters: {bias.factors.2: {lower: 0, upper: 9}}}
    4: fit.parameters.bias.factors.2: cannot be fitted with filter type 'random_disk'; expected bias.constant,
    bias.slope, bias.slope_least, bias.slope_most, bias.normal_offset, bias.factors.0, bias.factors.1, filter.radius,
    technique.logarithmic or technique.blend; did you mean 'bias.factors.1'?
technique: {type: cascades, count: 2}↵bias: {factors: [1, 1, 1]}
    3: bias.factors: has 3 factors, for a light with 2 maps; expected as many; give one for each map
bias: {factors: [1]}
    2: bias.factors: has 1 factors, for a light with one map; expected a light with several maps; remove it, or use
    cascades
technique: {type: cascades, distances: [2, 5]}↵fit: {parameters: {technique.logarithmic: {lower: 0, upper: 1}}}
    3: fit.parameters.technique.logarithmic: changes nothing, since technique.distances is given; expected a number
    that the layout uses; remove it, or technique.distances
technique: {type: cascades, count: 4, shares: [2, 1, 1]}
    2: technique.shares: has 3 shares, for 4 cascades; expected as many; give one for each cascade
technique: {type: cascades, count: 2, shares: [2, 0]}
    2: technique.shares.1: is 0; expected a number at least 0.001 and at most 1000; give such a value
technique: {type: cascades, count: 2, shares: [2, 1]}↵shadow_map: {resolution: [64, 32]}
    3: shadow_map.resolution: is [64, 32], and technique.shares are given, whose maps are square; expected two equal
    numbers; change it, or remove technique.shares
technique: {type: cascades, count: 2, shares: [2, 1]}↵shadow_map: {silhouettes: true}
    3: shadow_map.silhouettes: is true, and technique.shares are given, whose maps have no silhouettes; expected false;
    change it, or remove technique.shares
technique: {type: cascades, count: 2, shares: [2, 1]}↵fit: {parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}
    2: technique.shares: is given in a fit of lights or meshes, which needs maps with silhouettes; expected cascades
    of one size; remove it
technique: {type: cascades, shares: [100, 1, 1, 1]}↵shadow_map: {resolution: [4096, 4096]}
    2: technique.shares: lets a cascade have 0.971 of all texels: 8,071², for which every map has memory; expected at
    most 4,096²; lower it, or shadow_map.resolution = [4096, 4096]
technique: {type: cascades, shares: [1, 1, 1, 1]}↵shadow_map: {resolution: [4096, 4096]}↵
fit: {parameters: {technique.shares.0: {lower: 0.25, upper: 40}}}
    4: fit.parameters: lets a cascade have 0.93 of all texels: 7,901², for which every map has memory; expected at
    most 4,096²; lower it, or shadow_map.resolution = [4096, 4096]
technique: {type: perspective_warp}↵fit: {parameters: {technique.focus: {lower: 0.1, upper: 1}}}
    3: fit.parameters.technique.focus: changes nothing, since technique.method is lispsm; expected a number that the
    layout uses; remove it, or set the method to trapezoidal
technique: {type: cascades, distances: [2, 5, 4]}
    2: technique.distances.2: is 4, after 5; expected increasing depths; sort them, without repetitions
technique: {type: cascades, distances: [2, 5], shadow_distance: 3}
    2: technique.shadow_distance: is given together with distances; expected one or the other; remove shadow_distance
    or distances, or set it to null
technique: {type: cascades, distances: [2, 5], depths: surface}
    2: technique.depths: is surface, and distances are given; expected camera; remove depths, or distances
technique: {type: cascades, count: 9}
    2: technique.count: is 9; expected a whole number at least 1 and at most 8; give such a value (the default is 4)
technique: {type: three.js}↵fit: {parameters: {bias.constant: {lower: 0, upper: 9}}}
    3: fit.parameters.bias.constant: cannot be fitted with technique type 'three.js'; expected technique.bias,
    technique.normal_bias or technique.radius; name one of these
technique: {type: three.js, shadow_side: [front, back, front]}
    2: technique.shadow_side: has 3 entries, and the scene has 1 mesh; expected one for each; give one for all, or one
    for each
technique: {type: perspective_warp}↵shadow_map: {silhouettes: true}
    3: shadow_map.silhouettes: is given, and technique.type is perspective_warp, whose maps cannot have it; expected a
    map without it; remove it, or choose another technique
technique: {type: resolution_matched}↵shadow_map: {silhouettes: true}
    3: shadow_map.silhouettes: is given, and technique.type is resolution_matched, whose maps cannot have it; expected
    a map without it; remove it, or choose another technique
technique: {type: resolution_matched, page: 48}
    2: technique.page: is 48; expected a power of two; set it to 32 or 64
technique: {type: resolution_matched, page: 64, finest: 64}
    2: technique.finest: is 64, and pages are 64 texels wide; expected from 2 to 1024 pages; change it, or page
technique: {type: resolution_matched, page: 16}↵filter: {type: pcf, radius: 9}
    3: filter.radius: lets the filter read 9 texels away, further than a gutter of technique.page = 16; expected at
    most 7; enlarge technique.page, or lower it
technique: {type: cascades, margin: 1}↵filter: {type: pcf, radius: 12}
    2: technique.margin: is 1, and the filter reads 12 texels away, where the map may end; expected at least 12; raise
    it, or remove it
technique: {type: resolution_matched, margin: 2}↵filter: {type: nearest}↵bias: {normal_offset: 3}↵
fit: {parameters: {bias.constant: {lower: 0, upper: 1}}}
    2: technique.margin: is 2, and the filter reads 3 texels away, where the map may end; expected at least 3; raise
    it, or remove it
technique: {type: perspective_warp, margin: 4}↵fit: {parameters: {filter.radius: {lower: 0, upper: 6}}}
    2: technique.margin: is 4, and fit.parameters.filter.radius.upper lets the filter read 6.5 texels away, where the
    map may end; expected at least 6.5; raise it, or remove it
fit: {parameters: {}}
    2: fit.parameters: is empty; expected at least one parameter to fit; add 'bias.constant: {lower: 0, upper: 10}'
fit: {anneal: {end: 3}}
    2: fit.anneal.end: is 3 and start is 2.0; expected end at most start; make start larger or end smaller
seed: 1↵bias: {}↵seed: 2
    4: seed: is given twice, first on line 2; expected one value; remove one of them
bias:↵  1: 2
    3: bias: has the key 1; expected text; put the key in quotes
output: !path x
    2: output: has the tag '!path'; expected plain data; remove the tag
seed: 99999999999999999999999999999999999999999999999999
    2: seed: is an integer of 50 digits; expected fewer digits; check the number
""")
SCENES = cases("""
scene:↵  meshes: []
    2: scene.meshes: is an empty list; expected at least one mesh; add '- path: builtin:torus_knot'
scene:↵  camera: {}
    1: scene.meshes: is missing; expected a list of meshes, each with a path; add it: surfaces, each a caster and a
    receiver; cameras and lights orbit the first
scene:↵  meshes: builtin:box
    2: scene.meshes: is 'builtin:box'; expected a list of meshes, each with a path; give such a value
scene:↵  meshes:↵  - path: builtin:boxx
    3: scene.meshes.0.path: is 'builtin:boxx'; expected builtin: followed by plane, box, sphere, low_poly_sphere,
    torus, torus_knot, fence, thin_wall, chair or blob; did you mean 'builtin:box'?
scene:↵  meshes: [{path: 'builtin:box', alpha_cutoff: 0.5}]
    2: scene.meshes.0.alpha_cutoff: is given with a builtin mesh; expected a mesh file, which may have UV; remove
    alpha_cutoff
scene:↵  meshes: [path: 'builtin:box']↵technique: {type: three.js, side: [front, bak]}
    3: technique.side: is ['front', 'bak']; expected front, back or double, or a list with one of them for each mesh;
    give such a value
scene:↵  meshes: [{path: 'builtin:box', texture_filter: nearest}]
    2: scene.meshes.0.texture_filter: is given with a builtin mesh; expected a mesh file, which may have UV; remove
    texture_filter
scene:↵  meshes: [path: 'builtin:box']↵  camera:↵    orbit: {azimuth: 3}↵    eye: [1, 2, 3]
    5: scene.camera.eye: is given together with orbit; expected one or the other; remove eye or orbit, or set it to
    null
scene:↵  meshes: [path: 'builtin:box']↵  camera: {target: [1, 2, 3]}
    3: scene.camera.target: is given without eye; expected eye with it; add eye: [x, y, z] in world units
scene:↵  meshes: [path: 'builtin:box']↵  camera: {near: 2, far: 1}
    3: scene.camera.far: is 1 and near is 2; expected near less than far; make far larger or near smaller
scene:↵  meshes: [path: 'builtin:box']↵  light:↵    azimuth: 3↵    direction: [0, -1, 0]
    4: scene.light.azimuth: is given together with direction; expected one or the other; remove azimuth or direction,
    or set it to null
scene:↵  meshes: [path: 'builtin:box']↵  light: {direction: [0, 0.0, 0]}
    3: scene.light.direction: is [0.0, 0.0, 0.0]; expected a vector at least 1e-09 long; give a vector such as [0, -1,
    0]
scene:↵  meshes: [path: 'builtin:box']↵  light: {azimuth: 3}↵  lights:↵    - type: spot
    4: scene.lights: is given together with light; expected one or the other; remove lights or light, or set it to
    null
scene:↵  meshes: [path: 'builtin:box']↵  lights: []
    3: scene.lights: is an empty list; expected at least one light; add '- type: directional'
scene:↵  meshes: [path: 'builtin:box']↵  light:
    3: scene.light: is empty; expected a light; remove the key to get its default
scene:↵  meshes: [path: 'builtin:box']↵  light:↵    shadow_camera: {position: [0, 3, 0], right: -6}
    4: scene.light.shadow_camera.right: is -6 and left is -5.0; expected left less than right; make right larger or
    left smaller
scene:↵  meshes: [path: 'builtin:box']↵  light:↵    shadow_camera: {position: [0, 3, 0], near: 2, far: 1}
    4: scene.light.shadow_camera.far: is 1 and near is 2; expected near less than far; make far larger or near smaller
scene:↵  meshes: [path: 'builtin:box']↵  light: {frame: casters, shadow_camera: {position: [0, 3, 0]}}
    3: scene.light.frame: is casters, and shadow_camera is given; expected one or the other; remove one of them
scene:↵  meshes: [{path: 'builtin:box', normals: file}]
    2: scene.meshes.0.normals: is file with a builtin mesh; expected creases; remove it
scene:↵  meshes: [{path: 'builtin:box', receives: false}]
    2: scene.meshes.0.receives: is false, and technique.type is shadow_map, which shows shadows on all meshes;
    expected true, or an engine's technique; remove it
scene:↵  meshes: [path: 'builtin:box']↵  lights:↵    - type: point↵    - {type: spot, radios: 1}
    5: scene.lights.1.radios: is not a key of scene.lights.1 (type: spot); expected type, inner_angle, radius, aspect,
    orbit, position, near, far, target or outer_angle; did you mean 'radius'?
scene:↵  meshes: [path: 'builtin:box']↵  light: {type: spot, inner_angle: 30, outer_angle: 20}
    3: scene.light.outer_angle: is 20 and inner_angle is 30; expected inner_angle at most outer_angle; make
    outer_angle larger or inner_angle smaller
scene:↵  meshes: [path: 'builtin:box']↵  light: {type: rectangle, size: 1}
    3: scene.light.size: is 1; expected two numbers [width, height], each at least 0, in world units; write a list
    such as [0.5, 0.5]
scene:↵  meshes: [{path: 'builtin:box', casts: false}]
    2: scene.meshes: hold no mesh that casts a shadow; expected at least one mesh that casts; remove casts from one of
    them
scene:↵  meshes: [path: 'builtin:box']↵  light: {type: spot, orbit: {},↵    position: [0, 3, 0]}
    4: scene.light.position: is given together with orbit; expected one or the other; remove position or orbit, or set
    it to null
""")


@pytest.mark.parametrize(("text", "said"), [*((TINY + text, said) for text, said in FAULTS), *SCENES])
def test_fault_is_reported_with_line_key_and_remedy(text, said):
    assert fault(text) == f"file.yaml:{said}"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("shadow_map: {silhouettes: true}\n", "with silhouettes"),
        (
            "fit: {parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}\nfilter: {type: bilinear}\n",
            "in a fit of lights or meshes, with silhouettes",
        ),
        ("technique: {type: shadow_volumes}\n", "with shadow volumes"),
    ],
)
def test_alpha_tests_are_reported_where_outlines_of_whole_faces_matter(text, why, tmp_path):
    for name in ("tree.obj", "leaves.png"):
        (tmp_path / name).touch()
    file = tmp_path / "c.yaml"
    file.write_text("scene:\n  meshes: [{path: tree.obj, texture: leaves.png, alpha_cutoff: 0.5}]\n" + text)
    with pytest.raises(ConfigError) as caught:
        load_config(file, fitting=True)
    assert str(caught.value).startswith(
        f"{file}:2: scene.meshes.0.alpha_cutoff: is 0.5 {why}, whose outlines follow whole faces; expected "
        "meshes without an alpha test; remove it, or "
    )


def test_missing_mesh_file_names_the_nearest(tmp_path):
    (tmp_path / "bunny.obj").touch()
    file = tmp_path / "c.yaml"
    file.write_text("scene:\n  meshes:\n    - path: builtin:box\n    - path: buny.obj\n      options: {size: 1}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    first, second = str(caught.value).splitlines()
    assert first == (
        f"{file}:4: scene.meshes.1.path: there is no file {tmp_path / 'buny.obj'}; "
        "expected a readable file; did you mean 'bunny.obj'?"
    )
    assert second == (
        f"{file}:5: scene.meshes.1.options: are given with a mesh file; "
        "expected options with a builtin mesh only; remove the options"
    )


def test_settings_are_read_without_the_files_that_they_name(tmp_path):
    file = tmp_path / "c.yaml"
    file.write_text("scene: {meshes: [path: gone.obj]}\nreference: {type: image, path: gone.npy}\n")
    with pytest.raises(ConfigError, match="there is no file"):
        load_config(file)
    config = load_config(file, files=False)
    assert config.scene.meshes[0].path == str(tmp_path / "gone.obj")
    assert parse_config(dump_resolved(config), files=False) == config


def test_forgotten_builtin_is_suggested():
    assert "did you mean 'builtin:torus_knot'?" in fault("scene: {meshes: [path: torus_knot]}")


def test_every_problem_is_reported_at_once_in_the_order_of_the_file():
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
        ["file.yaml:9", "scene.light.radius"],
        ["file.yaml:9", "scene.light.orbit.azimut"],
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
        ("a: 1\n---\nb: 2\n", "2: is not YAML: but found another document (column 1); keep one document per file"),
        ("a: *x\n", "1: is not YAML: found undefined alias 'x' (column 4); quote text that begins with '*'"),
        ("a: 1\nb: \x07\n", "2: holds the character U+0007; expected printable text; remove it"),
        ("[" * 5000, "1: sections or lists are nested hundreds deep; expected a handful of levels"),
        ("- a\n", "1: holds ['a']; expected a section with keys; write 'key: value' lines"),
        ("", "1: scene: is missing; expected a section with the keys meshes, camera, light, lights"),
        ("# nothing\n", "1: scene: is missing; expected a section with the keys meshes, camera, light, lights"),
        ("a: &x [*x]\n", "1: a.0: contains itself; expected plain data"),
    ],
)
def test_what_is_no_configuration_is_reported_with_its_line(text, expected):
    assert faults(text)[0].startswith(f"file.yaml:{expected}")


def test_aliases_cannot_blow_up():
    bomb = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 9))
    assert any("10,001th value" in line for line in faults(bomb))


def test_aliases_stand_for_what_they_repeat():
    text = "scene: {meshes: [&box {path: 'builtin:box'}, *box]}\n"
    first, second = parse_config(text).scene.meshes
    assert first == second


def test_unreadable_files_are_reported(tmp_path):
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
        ("filter.sampels=64", "filter.sampels: is not a key of filter (type: random_disk)"),
        ("filter.type=pcf4", "filter.type: is 'pcf4'"),
        ("bias.slope=-1", "bias.slope: is -1"),
        ("bias.slope", "is not KEY=VALUE; expected a dotted key; write filter.radius=2"),
        ("=3", "is not KEY=VALUE"),
        ("bias..slope=3", "is not KEY=VALUE"),
        ("bias.slope=[1", "is not YAML: expected ',' or ']', but got the end; close the list with ']'"),
        ("bias={slope: 1, slope: 2}", "bias.slope: is given twice"),
        ("seed.x=3", "seed.x: is inside seed, which is 0; expected a section; set seed as a whole"),
        ("scene.meshes.7.size=3", "scene.meshes.7: index 7 is out of range: the list scene.meshes has 2 entries"),
        (
            "scene.meshes.one.size=3",
            "scene.meshes.one: 'one' is not an index of the list scene.meshes; expected a number",
        ),
        ("scene.meshes.-1.size=3", "scene.meshes.-1: '-1' is not an index of the list scene.meshes"),
        ("scene.camera.resolution.2=3", "scene.camera.resolution.2: index 2 is out of range"),
        ("scene.meshes.0.path=no.obj", "scene.meshes.0.path: there is no file"),
        ("fit.parameters.bias.slpe.upper=3", "fit.parameters.bias.slpe: cannot be fitted"),
        (
            "fit.parameters.bias.slope.uper=3",
            "fit.parameters.bias.slope.uper: is not a key of fit.parameters.bias.slope",
        ),
        (
            "fit.parameters.scene.light.azimuth.uper=3",
            "fit.parameters.scene.light.azimuth.uper: is not a key of fit.parameters.scene.light.azimuth; "
            "expected initial, lower or upper; did you mean 'upper'?",
        ),
        (
            "bias.plane=null",
            "bias.plane: is empty; expected a section with the key type; write {type: none}, or remove the key to get "
            "its default",
        ),
        ("scene=", "scene: is empty; expected a section with the keys meshes, camera, light, lights, ground; give it"),
    ],
)
def test_fault_of_an_override_is_reported_with_the_override(override, expected):
    with pytest.raises(ConfigError) as caught:
        load_config(QUICKSTART, [override])
    assert any(line.startswith(f"override {override!r}: {expected}") for line in str(caught.value).splitlines())


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("filter.samples=64", "filter.samples", "64"),
        ("fit.anneal.kernel=gaussian", "fit.anneal.kernel", "gaussian"),
        ("bias.normal_offset=1e-1", "bias.normal_offset", "0.1"),
        ("scene.meshes.1.options.segments=3", "scene.meshes.1.options", "size = 4, segments = 3"),
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


def test_python_users_get_the_same_checks():
    scene = {"meshes": ({"path": "builtin:box"},), "camera": {"type": "orthographic"}}
    config = Config.model_validate({"scene": scene, "filter": {"type": "pcf", "radius": 3.0}})
    assert parse_config(dump_resolved(config)) == config
    with pytest.raises(ValueError, match="cannot be fitted"):
        Config.model_validate({"scene": scene, "fit": {"parameters": {"x": {"lower": 0.0, "upper": 1.0}}}})
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 3


POINT = "scene: {meshes: [{path: 'builtin:box'}], light: {type: point}}\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "filter:\n  type: pcf\n  radius: 50\n",
            "4: filter.radius: lets the filter read 50 texels away, beyond the edge of a face of a point light's map; "
            "expected at most 46.5 texels, which scene.light.guard = 0.1 allows; raise scene.light.guard to 0.11, "
            "raise shadow_map.resolution, or lower filter.radius",
        ),
        (
            "filter: {type: vsm, radius: 2}\nbias: {normal_offset: 45}\n",
            "3: bias.normal_offset: lets the filter read 47.5 texels away, beyond the edge of a face of a point "
            "light's map; expected at most 46.5 texels, which scene.light.guard = 0.1 allows; raise "
            "scene.light.guard to 0.11, raise shadow_map.resolution, or lower bias.normal_offset",
        ),
        (
            "fit: {parameters: {filter.radius: {lower: 0, upper: 60}}}\n",
            "2: fit.parameters.filter.radius.upper: lets the filter read 60.5 texels away",
        ),
        ("filter: {type: pcss, max_radius: 47}\n", "2: filter.max_radius: lets the filter read 47.5 texels away"),
    ],
)
def test_filter_wider_than_a_point_light_s_guard_is_reported(text, expected):
    assert fault(POINT + text).startswith(f"file.yaml:{expected}")


def test_guard_that_is_named_as_the_remedy_is_wide_enough():
    for radius in (46.6, 50, 100, 128):
        text = f"{POINT}filter: {{type: pcf, radius: {radius}}}\n"
        guard = fault(text).split("raise scene.light.guard to ")[1].split(",")[0]
        assert parse_config(text, [f"scene.light.guard={guard}"]).scene.light.guard <= 1


@pytest.mark.parametrize(
    ("text", "key", "mend"),
    [
        ("filter: {type: nearest}\nbias: {normal_offset: 60}\n", "bias.normal_offset", "lower bias.normal_offset"),
        ("filter: {type: castano}\nshadow_map: {resolution: [32, 32]}\n", "filter.size", "lower filter.size"),
        ("filter: {type: bilinear}\nshadow_map: {resolution: [8, 8]}\n", "filter", "choose another filter"),
        (
            "bias: {normal_offset: 1}\nfit: {parameters: {bias.normal_offset: {lower: 0, upper: 60}}}\n",
            "fit.parameters.bias.normal_offset.upper",
            "lower fit.parameters.bias.normal_offset.upper",
        ),
    ],
)
def test_what_reaches_beyond_a_guard_is_named_by_a_key_that_there_is(text, key, mend):
    said = fault(POINT + text)
    assert said.split(": ")[1] == key
    assert said.endswith(f"or {mend}")


# Faults of a fit alone: what a render does not use keeps it from nothing.
FOR_FITS = {
    "start beyond bounds": "fit: {parameters: {filter.radius: {lower: 3, upper: 4}}}\n",
    "number without a value": "fit: {parameters: {bias.slope_most: {lower: 0, upper: 1}}}\n",
    "number of another filter": "filter: {type: nearest}\nfit: {parameters: {filter.radius: {lower: 0, upper: 4}}}\n",
    "bounds beyond limits": "fit: {parameters: {bias.slope: {lower: -1, upper: 1}}}\n",
    "pose beyond limits": "fit: {parameters: {scene.light.azimuth: {lower: 0, upper: 1e6}}}\n",
    "vertex of no mesh": "fit: {parameters: {scene.meshes.7.vertices.0.x: {lower: 0, upper: 1}}}\n",
    "silhouettes of midpoints": (
        "shadow_map: {depth_layer: midpoint}\nfit: {parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}\n"
    ),
    "blur too wide": "fit: {blurs: [90, 3], parameters: {scene.light.azimuth: {lower: 0, upper: 90}}}\n",
    "least radius beyond the greatest": (
        "filter: {type: pcss, max_radius: 4}\nfit: {parameters: {filter.min_radius: {lower: 0, upper: 9}}}\n"
    ),
    "too many derivatives": (
        "scene: {meshes: [path: builtin:box], camera: {resolution: [4096, 4096]}}\nfit: {parameters: {"
        + ", ".join(f"scene.meshes.0.vertices.{i}.x: {{lower: 0, upper: 1}}" for i in range(20))
        + "}}\n"
    ),
}


@pytest.mark.parametrize("text", FOR_FITS.values(), ids=FOR_FITS)
def test_fault_of_a_fit_keeps_no_render_from_its_work(text):
    text = text if text.startswith("scene") else TINY + text
    config = parse_config(text, source="file.yaml")
    said = fault(text)
    assert " fit.parameters" in said or " fit.blurs" in said or " shadow_map" in said
    # The same faults, of a configuration that was built in Python.
    (what,) = (what for _, what in config.fit_faults())
    assert what.message().split(";")[-1] == said.split(";")[-1]
    assert describe(config)


def test_name_that_no_scene_has_is_reported_in_a_render_too():
    for name in ("bias.slop", "scene.lihgt.azimuth", "scene.meshes.0.vertices.99999999999999999999.x"):
        with pytest.raises(ConfigError, match="cannot be fitted"):
            parse_config(TINY + f"fit: {{parameters: {{{name}: {{lower: 0, upper: 1}}}}}}\n")


# Each number alone, or with another, that would take more memory, time or precision than there is.
TOO_MUCH = {
    "filter={type: esm, radius: 1e308}": ("filter.radius", "at most 128"),
    "filter.radius=3000000": ("filter.radius", "at most 8192"),
    "filter={samples: 4096, pattern_size: 256}": ("filter.samples", "at most 1,048,576"),
    "scene.meshes.0.translate=[1e39, 0, 0]": ("scene.meshes.0.translate.0", "at most 1e+09, in world units"),
    "scene.meshes.0.size=1e-30": ("scene.meshes.0.size", "at least 1e-06"),
    "shading.shininess=1e-39": ("shading.shininess", "a magnitude from 1.2e-38 to 3.4e+38"),
    "scene.meshes.0.options={size: 1e39}": ("scene.meshes.0.options.size", "a magnitude from"),
    "scene.light={direction: [1e-12, 0, 0]}": ("scene.light.direction", "a vector at least 1e-09 long"),
    "scene.camera.fov_y=1e-30": ("scene.camera.fov_y", "at least 0.01"),
    "scene.camera.resolution=[8192, 8192]": ("scene.camera.resolution", "at most 16,777,216"),
    "scene.light={type: point}": ("shadow_map.resolution", "at most 67,108,864"),
    "reference.supersampling=8": ("reference.supersampling", "at most 67,108,864"),
    "reference.samples=65536": ("reference.samples", "at most 68,719,476,736"),
    "fit.solver.max_steps=1000000000": ("fit.solver.max_steps", "at most 100000"),
    "seed=0x1" + "0" * 400: ("seed", "expected fewer digits"),
    "bias.constant=0x1" + "0" * 400: ("bias.constant", "expected fewer digits"),
}
# Just within the limits by itself.
AT_THE_LIMITS = "scene: {meshes: [path: builtin:box], camera: {resolution: [2048, 2048]}, light: {}}\n"


@pytest.mark.parametrize("override", TOO_MUCH)
def test_number_that_asks_for_too_much_is_refused_with_the_limit(override):
    key, expected = TOO_MUCH[override]
    limits = ["shadow_map.resolution=[8192, 8192]", "filter.pattern_size=4", "filter.samples=2048"]
    if override.startswith("filter={"):
        limits = limits[:1]
    assert parse_config(AT_THE_LIMITS, limits)
    said = fault(AT_THE_LIMITS, *limits, override)
    assert said.startswith("override ")
    assert f": {key}: " in said
    assert expected in said


@pytest.mark.parametrize(
    ("word", "shown"),
    [
        ("\x1b[31m", "\\x1b[31m"),
        ("a\nb", "a\\nb"),
        ("\0", "\\x00"),
        ("\x85", "\\x85"),
        ("\u202etxt", "\\u202etxt"),
        ("\x7f", "\\x7f"),
    ],
)
def test_problem_is_one_line_that_no_terminal_obeys(word, shown):
    quoted = json.dumps(word)
    texts = [
        f"{TINY}{quoted}: 1\n",
        f"{TINY}bias: {{{quoted}: 1}}\n",
        f"{TINY}bias: {{slope: {quoted}}}\n",
        f"{TINY}bias: {{slope: {{{quoted}: 1}}}}\n",
        f"{TINY}name: {quoted}\n",
        f"{TINY}output: {quoted}\n",
        f"{TINY}reference: {{type: {quoted}}}\n",
        f"scene: {{meshes: [path: {quoted}]}}\n",
        f"scene: {{meshes: [path: {json.dumps('builtin:' + word)}]}}\n",
        f"{TINY}fit: {{parameters: {{{quoted}: {{lower: 0, upper: 1}}}}}}\n",
    ]
    for text in texts:
        (line,) = {str(problem) for problem in caught(text).mistakes}
        assert line.isprintable()
        assert shown in line.replace("\\\\", "\\")


def caught(text: str, *overrides: str) -> ConfigError:
    with pytest.raises(ConfigError) as error:
        parse_config(text, overrides, source="file.yaml")
    return error.value


@pytest.mark.parametrize("sides", [(16, 64), (96, 72)])
def test_blurs_are_as_wide_as_a_fit_allows(sides):
    text = f"scene: {{meshes: [path: builtin:box], camera: {{resolution: {list(sides)}}}}}\n"
    most = widest_blur(*sides)
    blurred = lambda blur: (
        f"{text}fit: {{blurs: [{blur}], parameters: {{scene.light.azimuth: {{lower: 0, upper: 90}}}}}}"
    )
    assert not list(parse_config(blurred(most), source="file.yaml").fit_faults())
    assert f"expected at most {most:g} pixels" in fault(blurred(most + 0.01))


@pytest.mark.parametrize("parameters", ["3", "0.5", "true", "[1]"])
def test_parameters_that_are_no_section_are_reported_beside_blurs(parameters):
    problems = caught(TINY + f"fit: {{blurs: [3], parameters: {parameters}}}\n").mistakes
    assert any(p.key == "fit.parameters" and "expected a section" in p.message for p in problems)


def test_half_a_character_is_reported():
    assert "file.yaml:2: output: is '\\ud800', with an invalid character" in str(caught(f'{TINY}output: "\\ud800"\n'))


@pytest.mark.parametrize("override", ["\ud800=1", "scene.\udcff.path=x"])
def test_half_a_character_in_the_key_of_an_override_is_reported(override):
    (problem,) = caught(TINY, override).mistakes
    assert "has an invalid character in its key; expected UTF-8 text" in str(problem)


def test_folder_whose_name_is_no_text_is_reported(tmp_path):
    folder = tmp_path / "\udcff"
    folder.mkdir()
    (folder / "a.obj").touch()
    (folder / "c.yaml").write_text("scene: {meshes: [path: a.obj]}\n")
    with pytest.raises(ConfigError, match=r"1: scene.meshes.0.path: is .*\\udcff/a.obj, whose name is not UTF-8"):
        load_config(folder / "c.yaml")


def test_empty_key_has_a_name():
    assert fault(f"{TINY}'': 1\n").startswith("file.yaml:2: '': is not a key of the top level")


@pytest.mark.parametrize("name", ["a" * 201, "é" * 101])
def test_name_too_long_for_a_folder_is_reported(name):
    size = len(name.encode())
    assert fault(f"name: {name}\n{TINY}").startswith(f"file.yaml:1: name: has {size} bytes; expected at most 200")
    assert parse_config(f"name: {'é' * 100}\n{TINY}").name == "é" * 100


def test_home_is_the_present_user_s_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "a.obj").touch()
    config = parse_config("scene: {meshes: [path: ~/a.obj]}\noutput: ~/runs\n")
    assert config.scene.meshes[0].path == str(tmp_path / "a.obj")
    assert (config.output, config.output_folder) == ("~/runs", tmp_path / "runs")
    assert parse_config(f"{TINY}output: ./~odd\n").output_folder == Path("~odd")
    for text, key in {
        f"{TINY}output: ~nobody/x\n": "2: output",
        "scene: {meshes: [path: ~root/a.obj]}\n": "1: scene.meshes.0.path",
        f"{TINY}reference: {{type: image, path: ~root/a.npy}}\n": "2: reference.path",
    }.items():
        said = fault(text)
        assert said.startswith(f"file.yaml:{key}: is '~")
        assert "which begins with the home folder of another user; expected a path, in which ~/ is the current" in said


def test_path_that_cannot_be_looked_up_is_reported():
    assert "scene.meshes.0.path: cannot be read (File name too long)" in fault(
        f"scene: {{meshes: [path: {'x' * 300}.obj]}}\n"
    )


def test_a_light_that_is_fitted_frames_the_scene():
    scene = "scene: {meshes: [{path: builtin:box}], light: {frame: casters}}\n"
    assert fault(f"{scene}fit: {{parameters: {{scene.light.azimuth: {{lower: 0, upper: 90}}}}}}\n") == (
        "file.yaml:1: scene.light.frame: is casters in a fit of lights or meshes, whose shadows may move outside "
        "the initial frame; expected scene; remove it"
    )
    assert parse_config(scene, source="file.yaml").scene.light.frame == "casters"


def test_a_light_that_is_fitted_has_no_camera_of_its_own():
    scene = "scene: {meshes: [{path: builtin:box}], light: {shadow_camera: {position: [0, 3, 0]}}}\n"
    assert fault(f"{scene}fit: {{parameters: {{scene.light.azimuth: {{lower: 0, upper: 90}}}}}}\n") == (
        "file.yaml:1: scene.light.shadow_camera: is given in a fit of lights or meshes, which fits the map to the "
        "scene at every step; expected a map that is fitted; remove it"
    )


def test_filter_within_a_point_light_s_guard_is_fine():
    assert parse_config(POINT + "filter: {type: pcf, radius: 46}\n").filter.reach == 46
    assert parse_config(POINT.replace("point", "spot") + "filter: {type: pcf, radius: 90}\n").filter.reach == 90
    volumes = POINT + "filter: {type: pcf, radius: 90}\ntechnique: {type: shadow_volumes}\n"
    assert parse_config(volumes).technique.type == "shadow_volumes"


def test_one_image_is_no_reference_for_several_lights(tmp_path):
    (tmp_path / "truth.npy").touch()
    text = "scene: {meshes: [{path: 'builtin:box'}], lights: [{type: spot}, {}]}\n"
    said = fault(f"{text}reference: {{type: image, path: {tmp_path / 'truth.npy'}}}")
    assert "reference.type: is a single image, for 2 lights; expected one light, or a traced reference" in said


def test_lights_are_one_or_several():
    assert [*parse_config(TINY).scene.each_light] == [("light",)]
    several = parse_config(TINY, ["scene.light=null", "scene.lights=[{}, {type: spot}]"])
    assert [(key, light.type) for key, light in several.scene.each_light.items()] == [
        (("lights", 0), "directional"),
        (("lights", 1), "spot"),
    ]
    assert parse_config(dump_resolved(several)) == several


# What may be fitted, and where it is in the module.
FITTED = {
    "filter: {type: nearest}": {
        "bias.constant": "bias.constant.value",
        "bias.slope": "bias.slope.value",
        "bias.slope_least": "bias.slope.least",
        "bias.slope_most": "bias.slope.most",
        "bias.normal_offset": "bias.normal_offset.value",
    },
    "filter: {type: pcss}": {"filter.light_size": "filter.light_size", "filter.min_radius": "filter.min_radius"},
    "filter: {type: evsm}": {f"filter.{x}_exponent": f"filter.{x}_exponent" for x in ("positive", "negative")},
    "bias: {plane: {type: adaptive}}": {"bias.plane.epsilon": "bias.plane.epsilon"},
    "bias: {terms: {slope: 1}}": {"bias.terms.slope": "bias.terms.weights.slope"},
    "filter: {type: separable}": {f"filter.weights.{i}": f"filter.weights.{i}" for i in range(2)},
}


@pytest.mark.parametrize("text", FITTED)
def test_numbers_with_a_gradient_can_be_fitted(text):
    found = fit_paths(parse_config(TINY + text))
    assert FITTED[text].items() <= found.items()
    if "nearest" in text:
        assert found == FITTED[text]


def test_override_reaches_a_parameter_of_the_plane():
    text = TINY + "bias: {plane: {type: adaptive}}\nfit: {parameters: {bias.plane.epsilon: {lower: 0, upper: 3}}}"
    config = parse_config(text, ["fit.parameters.bias.plane.epsilon.upper=2"])
    assert config.fit.parameters["bias.plane.epsilon"].upper == 2
    assert {row.key: row.unit for row in describe(config)}["fit.parameters.bias.plane.epsilon.upper"] == "texels"


NETWORK = "network: {hidden: [{weight: [[1], [-2]], bias: [0, 0.5]}], last: [0.5, -0.25]}"


def test_a_bias_of_terms_needs_no_other_by_default():
    terms = parse_config(TINY + "bias: {terms: {one: 0.5, blocker_distance: -0.1}}").bias
    assert (terms.constant, terms.slope) == (0, 0)
    assert parse_config(TINY + "bias: {slope: 2, terms: {one: 0.5}}").bias.slope == 2
    for none in ("{}", "{slope: null}"):
        assert parse_config(TINY + f"bias: {{terms: {none}}}").bias.constant > 0
    assert Terms.each().keys() == FEATURES.keys()
    text = f"{TINY}bias: {{terms: {{one: 0.3, slope: 1}}, {NETWORK}}}\n"
    assert parse_config(dump_resolved(parse_config(text))) == parse_config(text)


def test_a_bias_that_knows_the_plane_needs_little_else_by_default():
    plane = parse_config(TINY + "bias: {plane: {type: receiver_plane}}").bias
    assert (plane.constant, plane.slope) == (rules.plane_constant_for(2.5), 0)
    for other in ("{type: adaptive}", "{type: receiver_plane, deepening: 1}"):
        assert parse_config(TINY + f"bias: {{plane: {other}}}").bias.constant == 0
    assert parse_config(TINY + "bias: {slope: 2, plane: {type: adaptive}}").bias.slope == 2


def rule(name):
    return np.array(rules.FILTER_RULES[name].bias)


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("{}", rule("random_disk, radius 2")),
        ("{type: nearest}", rule("nearest")),
        ("{type: bilinear}", rule("bilinear")),
        ("{type: pcf, radius: 1.5}", rule("pcf, radius 1.5")),
        ("{type: pcf}", rule("pcf, radius 2.5")),
        ("{radius: 4}", rule("random_disk, radius 4")),
        # Between what was measured, narrower and wider.
        ("{radius: 3}", (rule("random_disk, radius 2") + rule("random_disk, radius 4")) / 2),
        ("{type: pcf, radius: 1}", (rule("bilinear") + rule("pcf, radius 1.5")) / 2),
        ("{type: pcf, radius: 0}", rule("bilinear")),
        ("{type: pcf, radius: 4}", rule("pcf, radius 2.5") + np.array([0, 1.5 * rules.SLOPE_PER_TEXEL, 0])),
        # Not measured.
        ("{type: tent, radius: 2.5}", rule("pcf, radius 2.5")),
        ("{type: tent, radius: 2}", (rule("pcf, radius 1.5") + rule("pcf, radius 2.5")) / 2),
    ],
)
def test_without_a_bias_there_is_the_one_that_holds_over_many_scenes(section, expected):
    text = f"{TINY}filter: {section}\n"
    bias = parse_config(text).bias
    assert (bias.constant, bias.slope, bias.normal_offset) == pytest.approx(tuple(expected), abs=0.006)
    own = parse_config(f"{text}bias: {{constant: 1}}").bias
    assert (own.slope, own.normal_offset) == (bias.slope, bias.normal_offset)
    # To a constant and a slope of one's own, no normal offset is added.
    assert parse_config(f"{text}bias: {{constant: 1, slope: 1}}").bias.normal_offset == 0
    assert parse_config(f"{text}bias: {{slope_most: 9}}").bias.normal_offset == bias.normal_offset
    # Nor where a map's borders limit how far a filter reads.
    for tight in ("technique: {type: resolution_matched}", "technique: {type: cascades, margin: 9}"):
        assert parse_config(f"{text}{tight}").bias.normal_offset == 0
    lamp = parse_config(
        f"{text}scene: {{light: {{type: point, position: [0, 3, 0]}}, meshes: [path: builtin:box]}}".replace(TINY, "")
    )
    assert (lamp.bias.constant, lamp.bias.normal_offset) == (bias.constant, 0)
    assert parse_config(f"{text}bias: {{slope: 0}}").bias.slope == 0
    for own in ("{terms: {slope: 1}}", "{unit: depth}"):
        given = parse_config(f"{text}bias: {own}").bias
        assert (given.slope, given.normal_offset) == (0, 0)
    fitted = "fit: {parameters: {bias.constant: {lower: 0, upper: 2}, bias.slope: {lower: 4, upper: 9}}}"
    bias = parse_config(text + fitted).bias
    assert (bias.constant, bias.slope) == (min(2, expected[0]), max(4, expected[1]))
    assert parse_config(dump_resolved(parse_config(text))) == parse_config(text)


def test_filters_that_compare_no_taps_have_a_rule_for_all_radii():
    expected = tuple(rule("vsm, radius 2.5"))
    for radius in (2.5, 6):
        bias = parse_config(TINY + f"filter: {{type: vsm, radius: {radius}}}").bias
        assert (bias.constant, bias.slope, bias.normal_offset) == expected
    assert parse_config(TINY + "filter: {type: vsm}\nbias: {plane: {type: receiver_plane}}").bias.constant == 0
    # Not measured.
    assert parse_config(TINY + "filter: {type: separable}").bias.constant == 0.5


CASTER = "{path: 'builtin:box', options: {size: [3, 1, 2]}}"
WIDE = "{path: 'builtin:plane', options: {size: 40}}"


@pytest.mark.parametrize(
    ("light", "width"),
    [
        # The ground from above; half of it, as of what casts alone; a window; cones; a face with its guard.
        ("{elevation: 90}", 40),
        ("{elevation: 90, frame: casters}", np.sqrt(6)),
        ("{elevation: 90, shadow_camera: {position: [0, 9, 0], left: -3, right: 1, bottom: -2, top: 7}}", 6),
        ("{type: spot, position: [0, 10.5, 0], target: [0, 0, 0], outer_angle: 45}", 20),
        ("{type: point, position: [0, 10.5, 0], guard: 0.5}", 30),
    ],
)
def test_a_constant_bias_by_default_is_a_part_of_a_casters_width(light, width):
    casts = ", casts: false}" if "casters" in light else "}"
    text = f"scene: {{meshes: [{CASTER}, {WIDE[:-1]}{casts}], light: {light}}}\nfilter: {{type: nearest}}\n"
    least = rule("nearest")[0]
    for side in (32, 64, 2048):
        bias = parse_config(f"{text}shadow_map: {{resolution: [{side}, {side}]}}").bias
        assert bias.constant == pytest.approx(min(least, rules.PART * 2 * side / width), rel=0.02, abs=0.006)
        assert bias.slope == pytest.approx(rule("nearest")[1], abs=0.006)
    # What is given stays, and so does a rule where the camera lays out the map.
    few = f"{text}shadow_map: {{resolution: [32, 32]}}\n"
    assert parse_config(f"{few}bias: {{constant: 7}}").bias.constant == 7
    if "type" not in light and "shadow_camera" not in light and "frame" not in light:
        assert parse_config(f"{few}technique: {{type: cascades}}").bias.constant == pytest.approx(least, abs=0.006)
    assert parse_config(dump_resolved(parse_config(few))) == parse_config(few)


def test_override_reaches_a_parameter_of_the_scene():
    spot = QUICKSTART.with_name("fit_light_spot.yaml")
    names = "scene.light.position.x", "scene.meshes.0.translate.y", "scene.meshes.1.vertices.3.z"
    added = [f"fit.parameters.{name}={{initial: 0.5, lower: -1, upper: 1}}" for name in names[1:]]
    found = load_config(spot, [*added, *(f"fit.parameters.{name}.upper=1.5" for name in names)]).fit.parameters
    assert [found[name].upper for name in names] == [1.5] * 3
    assert found["scene.light.position.x"].lower == -2.8
    for typo in ("scene.light.position.w", "scene.lihgt.azimuth"):
        with pytest.raises(ConfigError) as caught:
            load_config(spot, [f"fit.parameters.{typo}.upper=1.5"])
        said = str(caught.value)
        assert f"override 'fit.parameters.{typo}.upper=1.5': fit.parameters.{typo}" in said
    assert "did you mean 'scene.light.azimuth'?" in said


def test_biases_in_window_depth_are_so_called():
    config = parse_config(TINY + "bias: {slope: 0.05, slope_least: 0.005, unit: depth}")
    rows = {row.key: row for row in describe(config)}
    assert rows["bias.slope_least"].unit == rows["bias.constant"].unit == "window depth"
    assert rows["bias.normal_offset"].unit == "texels"
    assert rows["bias.constant"].value == "0.0"


def test_a_vogel_spiral_is_turned_for_each_pixel_by_default():
    vogel = parse_config(TINY + "filter: {pattern: vogel}").filter
    assert (vogel.rotated, vogel.pattern_size) == (True, 1)
    other = parse_config(TINY + "filter: {pattern: vogel, rotated: false, pattern_size: 4}").filter
    assert (other.rotated, other.pattern_size) == (False, 4)


def test_files_are_found_by_the_marks_on_their_keys(tmp_path):
    names = {"a.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"} | dict.fromkeys(["t.png", "i.png", "m.png", "p.npy"], "")
    for name, content in names.items():
        (tmp_path / name).write_text(content)
    scene = "scene: {meshes: [{path: a.obj, texture: t.png}, {path: builtin:box}]}\n"
    shape = "fit: {shape: {start: {path: a.obj}, images: [i.png], masks: [m.png]}}\n"
    found = parse_config(scene + shape, folder=tmp_path)
    assert input_files(found) == [tmp_path / name for name in ("a.obj", "t.png", "i.png", "m.png")]
    views = "fit: {views: {list: [{reference: {type: image, path: p.npy}}, {reference.samples: 2}]}}\n"
    found = parse_config(scene + views, folder=tmp_path)
    assert found.fit.model_dump()["views"]["list"][0]["reference"]["path"] == str(tmp_path / "p.npy")
    assert input_files(found) == [tmp_path / name for name in ("a.obj", "t.png", "p.npy")]


def test_rules_between_keys_are_told_beside_faults_of_single_keys():
    text = "scene: {meshes: [], camera: {nears: 1}}\nsweep: {run: fit, limit_samples: 16, flicker: {count: 1}}\n"
    said = [line.split(": ")[1] for line in faults(text)]
    assert said == [
        *("scene.meshes", "scene.camera.nears", "sweep", "sweep.limit_samples", "sweep.flicker"),
        *("sweep.flicker.count", "sweep.flicker.through"),
    ]


def test_meshes_and_lights_of_a_fit_of_a_shape_are_no_part_of_the_scene():
    # With faults if they were: a mesh that shows no shadows, a map's frame that a fit cannot have, and a narrow guard.
    target = "targets: [{path: builtin:sphere, receives: false}]"
    assert parse_config(f"{TINY}fit: {{shape: {{{target}}}}}\n", fitting=True).fit.shape is not None
    lights = "[{frame: casters}, {type: point, guard: 0.0, position: [0, 3, 0]}]"
    settings = parse_config(f"{TINY}fit: {{shape: {{unseen: {lights}}}}}\nfilter: {{type: pcf}}\n", fitting=True)
    assert settings.fit.shape is not None
    assert fault(TINY.replace("'}", "', receives: false}")).startswith("file.yaml:1: scene.meshes.0.receives: is false")
