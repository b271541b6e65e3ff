"""Which file states what a finished run found."""

import json
from pathlib import Path

import pytest
from scenes import staying_in

from diffshadow.config import ConfigError, parse_config, settings_file

SWEPT = {"id": "a", "status": "ok", "metrics": {"fitted.bias.constant": 2.0}}


@pytest.fixture(autouse=True)
def in_its_folder(tmp_path):
    with staying_in(tmp_path):
        yield


def run_of(result: object, *files: str) -> Path:
    """A folder `run` with this `result.json`, `config.yaml` and other files."""
    folder = Path("run")
    folder.mkdir()
    for name in ("config.yaml", *files):
        (folder / name).write_text("seed: 1\n")
    (folder / "result.json").write_text(result if isinstance(result, str) else json.dumps(result))
    return folder


@pytest.mark.parametrize(
    ("result", "file", "origin"),
    [
        ({"kind": "fit", "fitted": {"bias.constant": 2.0}}, "fitted.yaml", "the fit"),
        (SWEPT, "fitted.yaml", "the fit"),
        ({"kind": "advise"}, "recommended.yaml", "the recommended technique"),
        ({"kind": "render"}, "config.yaml", "the run"),
        ({"id": "a", "status": "ok", "metrics": {"rmse": 0.1}}, "config.yaml", "the run"),
    ],
)
def test_a_folder_and_its_config_name_what_the_run_found(result, file, origin):
    folder = run_of(result, file)
    for given in (folder, folder / "config.yaml"):
        assert settings_file(given) == (folder / file, f"{origin}, {folder / file}")


def test_any_other_file_is_taken_as_it_is():
    folder = run_of({"kind": "fit"}, "fitted.yaml", "mine.yaml")
    Path("config.yaml").write_text("")
    for given in (folder / "mine.yaml", folder / "fitted.yaml", Path("config.yaml"), Path("missing.yaml"), Path("\0")):
        assert settings_file(given) == (given, str(given))


@pytest.mark.parametrize(
    ("result", "message"),
    [
        ({"kind": "fit", "fitted": {}}, "it has no fitted.yaml; expected that file; run it again, because"),
        ({"kind": "advise"}, "it has no recommended.yaml"),
        ({"kind": "sweep"}, "holds a sweep; expected a single run"),
        ({**SWEPT, "status": "failed", "metrics": {}}, "holds a run that failed"),
        ({"kind": "fit", "fitted": {"scene.light.azimuth": 3.0}}, "holds a fit of lights or meshes"),
        (
            {"id": "a", "status": "ok", "metrics": {"fitted.scene.light.azimuth": 3.0}},
            "holds a fit of lights or meshes",
        ),
        ("[]", "holds a damaged result.json"),
        ("{", "holds a damaged result.json"),
    ],
)
def test_a_run_without_such_a_file_is_refused(result, message):
    folder = run_of(result)
    for given in (folder, folder / "config.yaml"):
        with pytest.raises(ConfigError, match=message) as caught:
            settings_file(given)
        assert str(caught.value).startswith(f"{given}: ")


def test_a_folder_without_a_run_is_refused():
    Path("empty").mkdir()
    with pytest.raises(ConfigError, match=r"empty: is a folder without result.json; expected a configuration in YAML"):
        settings_file("empty")


def test_a_name_with_a_suffix_can_name_a_folder():
    config = parse_config("scene: {meshes: [{path: 'builtin:box'}]}\nname: ä")
    assert config.named_with("-fitted").name == "ä-fitted"
    longest = config.model_copy(update={"name": "aa" + "ä" * 99}).named_with("-fitted").name
    assert longest.endswith("ä-fitted")
    assert len(longest.encode()) == 200 - 1
