"""Fits that were made in Python, saved as runs: folders, reports, comparisons, and what cannot be saved."""

import dataclasses
import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from scenes import floor_camera, quad, sun
from stored_runs import write_fit

from diffshadow import io, study
from diffshadow.config import ConfigError, settings_file
from diffshadow.fit import (
    Arrangement,
    FitResult,
    Outcome,
    Parameter,
    PoseProblem,
    Solver,
    Step,
    TechniqueProblem,
    with_values,
)
from diffshadow.geometry import Scene, merge
from diffshadow.reference import reference_from_image
from diffshadow.shadow import Bias, Bilinear, MapSettings, ShadowMapping

MESHES = quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), quad((0, 1, 0), (0.5, 0, 0), (0, 0, -0.5))
SCENE = Scene(MESHES, floor_camera(1.5, (64, 64)), sun(merge(MESHES)))
TECHNIQUE = ShadowMapping(Bilinear(), Bias(0.5, 0.5, 0.0), map=MapSettings((64, 64)))


def result_of(problem, name, initial, fitted, **more):
    """What a fit of one number may return, without a fit."""
    at = lambda value: (float(value),)
    subject = with_values(problem.subject, [name], jnp.asarray([fitted], jnp.float32))
    return FitResult(
        technique=problem.technique_of(subject),
        initial={name: initial},
        fitted={name: fitted},
        phases=[Outcome(1.0, 2, "successful", 0.1, 0.01, at(fitted))],
        chosen=0,
        history=[Step(0, k, 1.0, loss, at(value)) for k, (loss, value) in enumerate([(0.04, initial), (0.01, fitted)])],
        flat=[],
        seconds_compiling=2.0,
        seconds_running=1.0,
        arrangement=subject if problem.moves else None,
        problems=(problem,),
        best={name: fitted},
        errors=(0.2, 0.1),
        parameters=(Parameter(name, initial, initial - 50.0, initial + 50.0, "things"),),
        solver=Solver("dogleg"),
        **more,
    )


@pytest.fixture(scope="module")
def seen():
    """A technique's problem, whose reference is its own image under a bias of 0.5 texels."""
    lit = reference_from_image(np.ones((64, 64), np.float32), SCENE)
    problem = TechniqueProblem.of(SCENE, TECHNIQUE, lit)
    return dataclasses.replace(problem, reference=TECHNIQUE.visibility(problem.shadow_map, problem.surface))


@pytest.mark.exhaustive
def test_a_saved_fit_is_a_run_like_the_commands(seen, tmp_path):
    result = result_of(seen, "bias.constant", 40.0, 0.5)
    folder = study.save_fit(result, tmp_path / "mine", names=["the card"])
    stored = json.loads((folder / "result.json").read_text())
    assert (stored["name"], stored["kind"], stored["solver"]["name"]) == ("mine", "fit", "dogleg")
    assert stored["bounds"]["bias.constant"] == {"lower": -10.0, "upper": 90.0, "unit": "things"}
    assert stored["metrics"]["after"]["rmse"] == pytest.approx(0, abs=1e-5)
    assert stored["metrics"]["before"]["rmse"] > 0.01
    assert [light["light"] for light in stored["metrics"]["lights"]] == ["the card"]
    assert not {"seed", "command"} & stored.keys()
    written = {path.name for path in folder.iterdir()}
    assert written == set(stored["files"])
    assert {"arrays.npz", "comparison.png", "shaded.png", "loss.png", "report.html", "shadow_map.png"} <= written
    assert "config.yaml" not in written
    page = (folder / "report.html").read_text()
    assert "reduced the shadow&#39;s error" in page
    assert "Run it again" not in page
    assert ">Settings<" not in page
    (folder / "report.html").unlink()
    assert study.report(folder, form="svg").is_file()
    other = write_fit(tmp_path / "other")
    study.compare([folder, other], tmp_path / "page.html", console=Console(quiet=True))
    assert "shadow_map.resolution" not in (tmp_path / "page.html").read_text(), "only one of them has settings"
    with pytest.raises(ConfigError, match="holds a fit that was made in Python, which has no configuration"):
        settings_file(folder)


@pytest.mark.exhaustive
def test_a_saved_fit_of_poses_shows_the_way_of_a_light(tmp_path):
    """Of two suns, only the second has an image."""
    scene = Scene(MESHES, SCENE.camera, [SCENE.light, SCENE.light])
    arrangement = Arrangement.of(TECHNIQUE, scene.lights, scene.meshes)
    halved = np.float32(np.arange(64) < 32) * np.ones((64, 1), np.float32)
    lit = reference_from_image(halved, scene.lit_by(1))
    problem = PoseProblem.of(scene, TECHNIQUE, lit, light=1, arrangement=arrangement)
    azimuth = float(arrangement.lights[1].azimuth)
    folder = study.save_fit(result_of(problem, "lights.1.azimuth", azimuth + 40, azimuth), tmp_path / "mine")
    assert (folder / "paths.png").is_file()
    page, stored = (folder / "report.html").read_text(), json.loads((folder / "result.json").read_text())
    assert "How lights and meshes moved" in page
    # Its reference is no picture of this scene.
    assert stored["verdict"]["kind"] == "unexplained"
    assert any("fit.Search(starts=8)" in remedy for remedy in stored["verdict"]["remedies"])


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("file/mine", "file exists"),
        ("full", "full exists and is not a run's folder: it has no result.json; .*, or choose another folder"),
        ("x" * 300, "the folder .*makes names of folders of 3.. bytes; expected at most 255"),
        ("/", "the folder is '/'; expected a folder of the run's own, such as runs/mine"),
    ],
)
def test_a_fit_is_not_saved_where_it_cannot_be(seen, path, message, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("")
    with pytest.raises(io.FileError, match=message):
        study.save_fit(result_of(seen, "bias.constant", 40.0, 0.5), tmp_path / path)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["file", "full"]


def test_what_is_no_fit_to_be_saved_is_refused(seen, tmp_path):
    result = result_of(seen, "bias.constant", 40.0, 0.5)
    smaller = eqx.tree_at(lambda problem: problem.reference, seen, seen.reference[:32])
    with pytest.raises(ValueError, match=r"images of 64 x 64 and 32 x 64 pixels.*expected images of one size"):
        study.save_fit(dataclasses.replace(result, problems=(seen, smaller)), tmp_path / "mine")
    with pytest.raises(ValueError, match="the names are a, a; expected 2 different ones"):
        study.save_fit(dataclasses.replace(result, problems=(seen, seen)), tmp_path / "mine", names=["a", "a"])
    with pytest.raises(TypeError, match="what to save is of type dict; expected a FitResult"):
        study.save_fit({}, tmp_path / "mine")
    with pytest.raises(TypeError, match="the folder is of type int; expected a path"):
        study.save_fit(result, 7)
    assert list(tmp_path.iterdir()) == []
