"""Axes that views and sweeps share, and the views of a fit: what they hold, and what is refused."""

from pathlib import Path

import pytest
from scenes import staying_in

from diffshadow.config import ConfigError, dump_resolved, load_config, load_sweep, parse_config

TEXT = """
scene:
  meshes: [{path: builtin:torus}, {path: builtin:plane}]
  camera: {resolution: [32, 32]}
shadow_map: {resolution: [64, 64]}
"""
SUN = "{count: 3, latitude: 0, day: 80, first: 9, last: 15}"


SUN_IS_FITTED = "fit.parameters={scene.light.azimuth: {lower: -90, upper: 90}}"


@pytest.fixture(autouse=True)
def apart(tmp_path):
    with staying_in(tmp_path):
        yield


def views(axes, kind="views"):
    config = parse_config(TEXT, [f"fit.{kind}={axes}"], fitting=True)
    return config.views if kind == "views" else config.validation


def test_a_path_leads_through_its_values_at_equal_intervals():
    through = "{scene.camera.orbit.azimuth: [0, 90, 270], scene.light.elevation: [20, 40]}"
    found = views(f"{{path: {{count: 5, through: {through}}}}}")
    assert [view.config.scene.camera.orbit.azimuth for view in found] == pytest.approx([0, 45, 90, 180, 270])
    assert [view.config.scene.light.elevation for view in found] == pytest.approx([20, 25, 30, 35, 40])
    vectors = "{scene.camera.eye: [[0, 1, 4], [4, 1, 0]]}"
    eyes = [view.config.scene.camera.eye for view in views(f"{{path: {{count: 3, through: {vectors}}}}}")]
    assert eyes == [(0, 1, 4), (2, 1, 2), (4, 1, 0)]


def test_the_sun_stands_where_astronomy_has_it():
    lights = lambda axes: [view.config.scene.light for view in views(f"{{sun: {axes}}}")]
    # Near an equinox at the equator: 45° and 90° high at 9 and 12 hours, from due east to due west.
    morning, noon, afternoon = lights(SUN)
    assert morning.elevation == pytest.approx(45, abs=0.5)
    assert noon.elevation == pytest.approx(90, abs=0.6)
    assert morning.azimuth == pytest.approx(90, abs=1)
    assert afternoon.azimuth == pytest.approx(-90, abs=1)
    # At the solstice, noon at 45° north: 90 - 45 + 23.44, from the south, which is +z.
    (solstice,) = lights("{count: 1, latitude: 45, day: 172, first: 12, last: 13}")
    assert solstice.elevation == pytest.approx(68.4, abs=0.1)
    assert solstice.azimuth == pytest.approx(0, abs=0.5)
    # Symmetric about noon, and turned as asked for.
    first, last = lights("{count: 2, latitude: 50, day: 200, first: 8, last: 16}")
    assert first.elevation == pytest.approx(last.elevation)
    assert first.azimuth == pytest.approx(-last.azimuth)
    turned = lights("{count: 2, latitude: 50, day: 200, first: 8, last: 16, turn: 30}")
    assert turned[0].azimuth == pytest.approx(first.azimuth + 30)


def test_files_come_in_order_from_beside_the_configuration(tmp_path):
    folder = tmp_path / "inner"
    (folder / "meshes").mkdir(parents=True)
    for name in ("b", "a", "c"):
        (folder / "meshes" / f"{name}.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    axes = "fit:\n  views: {files: {scene.meshes.0.path: meshes/*.obj}}\n"
    (folder / "some.yaml").write_text(TEXT + axes)
    config = load_config(folder / "some.yaml", fitting=True)
    assert [Path(view.config.scene.meshes[0].path).stem for view in config.views] == ["a", "b", "c"]
    assert [view.name for view in config.views] == ["a", "b", "c"]
    # What is written out can be read elsewhere.
    again = parse_config(dump_resolved(config), folder="/", fitting=True)
    assert [view.config for view in again.views] == [view.config for view in config.views]
    # In an override, from the current folder.
    given = "fit.views.files.scene.meshes.0.path=inner/meshes/[ab].obj"
    assert len(load_config(folder / "some.yaml", [given], fitting=True).views) == 2
    (folder / "sweep.yaml").write_text(
        TEXT + "sweep: {files: {scene.meshes.0.path: meshes/*.obj}, grid: {seed: [1, 2]}}\n"
    )
    assert len(load_sweep(folder / "sweep.yaml").runs) == 6
    given = "sweep.files={scene.meshes.0.path: 'inner/meshes/[ab].obj'}"
    assert len(load_sweep(folder / "sweep.yaml", [given]).runs) == 4


def test_what_is_written_out_has_the_same_views():
    axes = [
        "fit.views={grid: {scene.meshes.0.path: ['builtin:box', 'builtin:torus']}, sun: {count: 2, turn: 30}}",
        "fit.validation={path: {count: 2, through: {scene.camera.orbit.azimuth: [100, 200]}}}",
        "fit.loss={over: cvar, fraction: 0.25, false_light: 2}",
    ]
    config = parse_config(TEXT, axes, fitting=True)
    again = parse_config(dump_resolved(config), fitting=True)
    assert again == config
    assert (len(again.views), len(again.validation)) == (4, 2)
    assert (again.views, again.validation) == (config.views, config.validation)


def test_runs_of_a_sweep_are_distinguished_by_their_views_and_the_content_of_their_meshes():
    sweep = "\nsweep: {run: fit, grid: {seed: [1, 2]}}\n"

    def ids(axes):
        Path("s.yaml").write_text(TEXT + sweep + f"fit: {{views: {axes}}}\n")
        return [run.id for run in load_sweep(Path("s.yaml")).runs]

    write = lambda x: Path("a.obj").write_text(f"v 0 0 0\nv {x} 0 0\nv 0 1 0\nf 1 2 3\n")
    own, files = "{grid: {scene.light.azimuth: [0, 10]}}", "{files: {scene.meshes.0.path: '*.obj'}}"
    write(1)
    first, other, of_file = ids(own), ids("{grid: {scene.light.azimuth: [0, 11]}}"), ids(files)
    assert ids(own) == first
    assert len({*first, *other, *of_file}) == 6
    Path("a.obj").rename("b.obj")
    assert ids(files) == of_file, "the content counts, not the name"
    # The content is read once per path and process.
    Path("b.obj").rename("c.obj")
    with Path("c.obj").open("a") as file:
        file.write("v 0 0 1\n")
    assert not {*ids(files)} & {*of_file}


def test_views_have_short_names_where_these_tell_them_apart():
    grid = "{grid: {scene.meshes.0.path: ['builtin:box', 'builtin:torus'], scene.light.azimuth: [0, 33.33333]}}"
    assert [view.name for view in views(grid)] == [
        *("box, azimuth 0", "box, azimuth 33.33"),
        *("torus, azimuth 0", "torus, azimuth 33.33"),
    ]
    close = "{grid: {scene.light.azimuth: [33.33333, 33.33334]}}"
    assert [view.name for view in views(close)] == [f"scene.light.azimuth = 33.3333{end}" for end in (3, 4)]
    labels = "{list: [{label: left, scene.light.azimuth: 0}, {label: right, scene.light.azimuth: 9}]}"
    assert [view.name for view in views(labels)] == ["left", "right"]


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ("{}", "fit.views: changes no key"),
        ("{grid: {bias.constant: [0, 1]}}", "is shared by all views"),
        ("{grid: {scene.light.azimut: [0, 1]}}", "azimut"),
        ("{files: {scene.meshes.0.path: none/*.obj}}", "no file in"),
        ("{sun: {count: 3, first: 1, last: 12}}", "below the horizon at 1 hours, at latitude 45"),
        ("{sun: {count: 3, first: 12, last: 9}}", "first"),
        ("{path: {count: 3, through: {scene.light.azimuth: [1]}}}", "two or more numbers"),
        ("{path: {count: 3, through: {}}}", "through: is empty"),
        ("{grid: {scene.light.azimuth: [0, 1]}, sun: {count: 3}}", "fit.views.grid.scene.light.azimuth sets"),
        ("{grid: {scene.camera.resolution: [[32, 32], [16, 16]]}}", "has images of [16, 16] in the view"),
        ("{qmc: {count: 5000, axes: {scene.light.azimuth: {lower: 0, upper: 9}}}}", "makes 5,000 views"),
        ("{grid: {scene.light.elevation: [30, 200]}}", "(in the view elevation 200)"),
    ],
)
def test_impossible_views_are_refused(axes, message):
    with pytest.raises(ConfigError) as caught:
        views(axes)
    assert message in str(caught.value)


def test_a_validation_view_that_the_fit_sees_is_refused():
    both = ["fit.views={grid: {scene.light.azimuth: [0, 10, 20]}}"]
    assert parse_config(TEXT, [*both, "fit.validation={grid: {scene.light.azimuth: [5]}}"], fitting=True).validation
    with pytest.raises(ConfigError, match="holds the view azimuth 10, which the fit sees"):
        parse_config(TEXT, [*both, "fit.validation={grid: {scene.light.azimuth: [5, 10]}}"], fitting=True)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([SUN_IS_FITTED, "fit.views={grid: {scene.light.elevation: [20, 40]}}"], "are given in a fit of lights"),
        ([SUN_IS_FITTED, "fit.validation={grid: {scene.light.elevation: [20]}}"], "is given in a fit of lights"),
        (["fit.prefer=bias.slope"], "names bias.slope, which is not fitted"),
        (["fit.prefer=least_bias", "fit.parameters={filter.radius: {lower: 0, upper: 4}}"], "no bias is fitted"),
        (["fit.front=2"], "fit.front: is 2"),
        (["fit.intervals=[0.0]"], "fit.intervals"),
        (["fit.loss={false_shadow: 0, false_light: 0}"], "is 0, and so is false_shadow"),
        (["fit.loss.over=median"], "fit.loss.over"),
    ],
)
def test_impossible_settings_of_a_fit_are_refused(overrides, message):
    with pytest.raises(ConfigError) as caught:
        parse_config(TEXT, overrides, fitting=True)
    assert message in str(caught.value)


def test_a_preference_in_a_fit_of_lights_is_one_fault_with_one_remedy():
    with pytest.raises(ConfigError) as caught:
        parse_config(TEXT, [SUN_IS_FITTED, "fit.prefer=least_bias"], fitting=True)
    assert [mistake.key for mistake in caught.value.mistakes] == ["fit.prefer"]
    assert "remove it" in str(caught.value)
