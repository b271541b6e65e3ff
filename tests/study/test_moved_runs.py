"""Finished runs need their own files alone: whatever they were made from may have gone."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scenes import marked, staying_in
from stored_runs import write_render

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import Config, ConfigError, describe, load_config
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
