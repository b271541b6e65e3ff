"""Finished runs need their own files alone: whatever they were made from may have gone."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rich.console import Console
from scenes import marked, staying_in
from stored_runs import write_render

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import Config, ConfigError, describe, dump_resolved, fit_paths, load_config, parse_config
from diffshadow.study.record._stored import read_run

pytestmark = pytest.mark.usefixtures("tiny_figures")

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
TINY = ("sweep=null", "scene.camera.resolution=[16, 16]", "shadow_map.resolution=[32, 32]", "reference.samples=2")
OBJ = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv 0 1 0\nf 4 3 2 1\nf 1 2 5\n"
FILES = """
name: moved
scene:
  meshes: [path: roof.obj]
  camera: {resolution: [64, 64]}
shadow_map: {resolution: [64, 64]}
filter: {samples: 4}
reference: {type: image, path: truth.npy}
bias: {constant: 50}
"""


def run(*arguments: Any) -> int:
    with pytest.raises(SystemExit) as caught:
        main(list(map(str, arguments)))
    return caught.value.code


@pytest.mark.exhaustive
@pytest.mark.parametrize("folder", ["plain", "b\u65e5 \x1b[1m\n$x_^"])
def test_report_and_comparison_of_a_run_whose_inputs_have_gone(folder, tmp_path, monkeypatch, capsys):
    home = tmp_path / folder
    home.mkdir()
    with staying_in(home):
        Path("roof.obj").write_text(OBJ)
        np.save("truth.npy", np.ones((64, 64), np.float32))
        Path("moved.yaml").write_text(FILES)
        assert run("render", home / "moved.yaml") == 0
        for file in ("roof.obj", "truth.npy", "moved.yaml"):
            Path(file).unlink()
    shutil.move(home / "runs", tmp_path / "elsewhere")
    shutil.rmtree(home)
    made = tmp_path / "elsewhere" / "moved-render"
    (made / "report.html").unlink()
    other = shutil.copytree(made, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    assert run("report", made, "--figures", "svg") == 0
    assert run("compare", made, other) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert (out.replace("\n", "")).isprintable()
    for page in (made / "report.html", tmp_path / "compare.html"):
        assert page.read_text(encoding="utf-8").replace("\n", "").replace("\t", "").isprintable()
    # To draw it again, they are needed.
    with pytest.raises(ConfigError, match=r"roof\.obj.*\n.*truth\.npy"):
        load_config(made / "config.yaml")


def check_alone(config: Config, folder: Path) -> None:
    """That a render's folder holds all that its report says of `config`."""
    found = read_run(write_render(folder, config))
    assert list(found.settings) == describe(config)


@pytest.mark.parametrize("path", marked(CONFIGS, CONFIGS[6:]), ids=lambda path: path.stem)
def test_settings_of_every_shipped_configuration_are_read_from_the_run_alone(path, tmp_path):
    config = load_config(path, TINY, fitting=False)
    check_alone(config, tmp_path / "run")
    assert load_config(tmp_path / "run" / "config.yaml") == config


@pytest.mark.exhaustive
@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_configuration_renders_and_is_reported_from_its_folder(path, tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    with staying_in(home):
        made = study.run_render(load_config(path, TINY), console=Console(quiet=True)).absolute()
    shutil.move(made, tmp_path / "away")
    shutil.rmtree(home)
    assert study.report(tmp_path / "away") == tmp_path / "away" / "report.html"


# What any configuration may have beside a scene; those that contradict each other are thrown again.
SECTIONS: dict[str, list[Any]] = {
    "scene.light": [
        {"azimuth": 30.0, "elevation": 60.0, "angular_radius": 0.5},
        {"type": "spot", "position": [1, 3, 2], "outer_angle": 20.0, "inner_angle": 10.0},
        {"type": "point", "position": [1, 3, 2], "radius": 0.1, "guard": 0.5},
        {"type": "rectangle", "position": [1, 3, 2], "size": [0.5, 0.25]},
    ],
    "scene.meshes.0": [
        {"path": "gone/from here.obj", "crease_angle": 30.0, "size": 2.0},
        {"path": "gone/\u00e4 \u65e5.ply", "rotate": [0, 90, 0], "albedo": [0.1, 0.2, 0.3]},
        {"path": "builtin:sphere", "casts": False},
        {"path": "builtin:torus", "options": {"segments": 12}, "drop_to_ground": True},
    ],
    "scene.camera": [
        {"type": "orthographic", "height": 3.0, "resolution": [16, 24]},
        {"eye": [0, 2, 5], "target": [0, 0, 0], "fov_y": 30.0, "resolution": [24, 16]},
        {"orbit": {"azimuth": 1e-3, "elevation": 1e1, "distance": 3}, "near": 0.1, "far": 100, "resolution": [8, 8]},
    ],
    "technique": [
        {},
        {"type": "shadow_volumes"},
        {"type": "irregular_z_buffer"},
        {"type": "projective_texture", "resolution": [64, 64], "blur": 1.5},
    ],
    "shadow_map": [{"resolution": [32, 48], "depth_layer": "midpoint"}, {"cull": "front"}, {"silhouettes": True}],
    "bias": [
        {"constant": 50},
        {"constant": 0, "slope": 1e-3, "slope_most": 4},
        {"plane": {"type": "receiver_plane"}},
        {"normal_offset": 2.5},
    ],
    "compare": [{"type": "soft", "width": 0.25}, {"operator": "less"}, {"type": "soft", "kernel": "gaussian"}],
    "filter": [
        {"type": "nearest"},
        {"type": "pcf", "radius": 2.5},
        {"type": "tent", "radius": 1.5},
        {"type": "pcss", "light_size": 1.5},
        {"type": "evsm", "radius": 2},
        {"type": "vsm"},
        {"type": "random_disk", "samples": 17, "pattern": "halton", "lookup": "nearest"},
    ],
    "shading": [{}, {"type": "modulated"}],
    "reference": [{"type": "image", "path": "gone.png"}, {"samples": 3, "sampler": "stratified"}],
    "fit": [
        {"multistart": 3, "solver": {"type": "adam", "learning_rate": 1e-3}},
        {"anneal": {"start": 4.0, "end": 1e-2, "phases": 2}},
    ],
    "name": ["0x1F", "no", "1e-3", "\u65e5\u672c", "a: b # c", "- x", "'", '"'],
    "output": ["1e5", "~/runs", "a b/\u00e9", "-"],
    "seed": [0, 2**32 - 1],
}


def random_config(rng: np.random.Generator) -> Config | None:
    """A configuration of some of these sections, or `None` if they cannot go together."""
    data: dict[str, Any] = {"scene": {"meshes": [{"path": "builtin:box"}, {"path": "builtin:plane"}]}}
    chosen = [key for key in SECTIONS if rng.random() < 0.6]
    for key in chosen:
        section = SECTIONS[key][rng.integers(len(SECTIONS[key]))]
        if key == "scene.meshes.0":
            data["scene"]["meshes"][0] = section
        elif key.startswith("scene."):
            data["scene"][key.removeprefix("scene.")] = section
        else:
            data[key] = section
    try:
        config = parse_config(yaml.safe_dump(data), files=False)
        if "fit" in data and rng.random() < 0.5:
            names = list(fit_paths(config))
            fitted = {names[rng.integers(len(names))]: {"initial": 1.0, "lower": 0.5, "upper": 7.5}}
            config = parse_config(yaml.safe_dump({**data, "fit": {"parameters": fitted}}), files=False)
    except ConfigError:
        return None
    return config


@pytest.mark.exhaustive
def test_random_configurations_are_read_from_the_run_as_they_were(tmp_path):
    rng, checked, kinds = np.random.default_rng(17), 0, set()
    for turn in range(1000):
        config = random_config(rng)
        if config is None:
            continue
        checked += 1
        kinds |= {config.filter.type, config.technique.type, config.scene.camera.type, config.reference.type}
        kinds |= {light.type for light in config.scene.each_light.values()}
        again = parse_config(dump_resolved(config), files=False)
        assert again == config
        assert describe(again) == describe(config)
        if checked % 10 == 0:
            check_alone(config, tmp_path / str(turn))
        if checked == 50:
            break
    assert checked == 50
    assert len(kinds) >= 15
