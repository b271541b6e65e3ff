"""Fits over views: what the folder, the page and the terminal say of views that the fit sees, and of others."""

import io as text_io
import json
import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from rich.console import Console
from scenes import free_port, staying_in
from stored_runs import TINY

from diffshadow import study
from diffshadow.config import ConfigError, build_fittable, parse_config
from diffshadow.fit import stack_of
from diffshadow.study.runs._measure import shaded
from diffshadow.study.runs._progress import Progress
from diffshadow.study.runs._setup import draw, load
from diffshadow.study.runs._views import draw_views
from diffshadow.study.runs._visibility import spaced

VIEWS = [
    "fit.views={grid: {scene.light.azimuth: [-150, -30]}}",
    "fit.validation={list: [{label: low, scene.light.elevation: 25}]}",
]
SETTINGS = [*VIEWS, "fit.intervals=[0.05]", "fit.front=3", "fit.prefer=least_bias"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a fit over two views, and what was printed."""
    out = text_io.StringIO()
    with staying_in(tmp_path_factory.mktemp("views")):
        folder = study.run_fit(parse_config(TINY, SETTINGS, fitting=True), console=Console(file=out, width=100))
        return folder.absolute(), out.getvalue()


@pytest.mark.exhaustive
def test_errors_of_views_add_up_and_those_of_the_validation_are_apart(run):
    folder, printed = run
    measured = json.loads((folder / "result.json").read_text())["metrics"]
    lights, masks = measured["lights"], np.load(folder / "arrays.npz")["mask"]
    assert [light["light"] for light in lights] == ["azimuth -150", "azimuth -30", "low"]
    assert [light["validation"] for light in lights] == [False, False, True]
    pixels = masks.sum(axis=(1, 2))
    assert measured["pixels"] == pixels.sum()
    for when in ("before", "after"):
        squares = [light[when]["rmse"] ** 2 for light in lights]
        assert measured[when]["rmse"] == pytest.approx(np.average(squares[:2], weights=pixels[:2]) ** 0.5, rel=1e-5)
        assert measured["validation"][when]["rmse"] == pytest.approx(squares[2] ** 0.5, rel=1e-6)
    assert measured["after"]["rmse"] < measured["before"]["rmse"]
    after = [light["after"]["rmse"] for light in lights]
    assert measured["shown"] == sorted(range(3), key=lambda i: -after[i])
    assert "1 view for validation" in printed


@pytest.mark.exhaustive
def test_the_page_shows_views_worst_first_and_how_sure_the_values_are(run):
    folder, printed = run
    page, measured = (folder / "report.html").read_text(), json.loads((folder / "result.json").read_text())
    names = [measured["metrics"]["lights"][i]["light"] for i in measured["metrics"]["shown"]]
    places = [page.index(f'<th scope="row">{name}</th>') for name in names]
    assert places == sorted(places)
    for heading in ("View by view, the worst first", "How sure the values are", "False shadow against false light"):
        assert heading in page
    for name in measured["fitted"]:
        interval = measured["profiles"][name]["intervals"][0]
        assert interval["lower"]["value"] <= measured["profiles"][name]["best"]["value"] <= interval["upper"]["value"]
    assert "within 5 %" in printed
    assert "knee" in printed
    # It can be made again, from the folder alone.
    before = page
    study.report(folder)
    assert (folder / "report.html").read_text() == before


@pytest.mark.exhaustive
def test_two_processes_share_a_fit_and_the_first_writes(run, tmp_path):
    one = json.loads((run[0] / "result.json").read_text())
    (tmp_path / "tiny.yaml").write_text(TINY)
    launched = {"SLURM_JOB_ID": "1", "SLURM_STEP_NODELIST": "localhost", "SLURM_NTASKS": "2"}
    launched |= {"JAX_COORDINATOR_ADDRESS": f"127.0.0.1:{free_port()}"}
    command = [sys.executable, "-m", "diffshadow", "fit", "tiny.yaml", *SETTINGS, "--distributed"]
    processes = [
        subprocess.Popen(
            command,
            cwd=tmp_path,
            env={**os.environ, **launched, "SLURM_PROCID": str(number), "SLURM_LOCALID": str(number)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for number in range(2)
    ]
    (first, errors), (second, _) = (process.communicate(timeout=300) for process in processes)
    assert [process.returncode for process in processes] == [0, 0], errors
    assert "knee" in first
    # Gloo itself prints in both.
    assert "knee" not in second
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["tiny"]
    two = json.loads((tmp_path / "runs" / "tiny" / "result.json").read_text())
    assert two["fitted"] == pytest.approx(one["fitted"], abs=0.02)
    assert two["metrics"]["after"]["rmse"] == pytest.approx(one["metrics"]["after"]["rmse"], rel=0.02)


def test_processes_that_cannot_share_a_fit_are_refused(monkeypatch):
    monkeypatch.setattr("jax.process_count", lambda: 2)
    with pytest.raises(ConfigError, match=r"fit\.devices: JAX has 2 processes; expected devices: 0"):
        study.run_fit(parse_config(TINY, fitting=True), console=Console(quiet=True))
    moving = TINY.replace("bias.constant:", "scene.light.azimuth:")
    with pytest.raises(ConfigError, match=r"fit: JAX has 2 processes; expected one"):
        study.run_fit(parse_config(moving, ["fit.devices=0"], fitting=True), console=Console(quiet=True))


def test_a_view_that_sees_nothing_is_named(tmp_path):
    away = "{label: away, scene.camera: {resolution: [64, 64], eye: [0, 5, 0], target: [0, 10, 1]}}"
    config = parse_config(TINY, [f"fit.views={{list: [{away}]}}"], fitting=True)
    with staying_in(tmp_path), pytest.raises(ConfigError, match=r"behind the camera.*\(in the view away\)"):
        study.run_fit(config, console=Console(quiet=True))
    assert not (tmp_path / "runs").exists()


def test_views_share_meshes_and_what_a_camera_sees_and_are_drawn_as_alone():
    cameras = ["{resolution: [64, 64], orbit: {distance: 3}}", "{resolution: [64, 64], orbit: {distance: 3.5}}"]
    grid = f"{{scene.camera: [{', '.join(cameras)}], scene.light.azimuth: [-150, -30]}}"
    config = parse_config(TINY, [f"fit.views={{grid: {grid}}}"], fitting=True)
    progress, technique = Progress(Console(quiet=True)), build_fittable(config)
    found = [view.drawn[0] for view in draw_views(config, load(config, progress), technique, progress).fitted]
    near, other, far, last = found
    assert near.surface is other.surface
    assert far.surface is last.surface
    assert len({id(mesh) for each in found for mesh in each.scene.meshes}) == 2
    for view, drawn in zip(config.views, found, strict=True):
        (alone,) = draw(view.config, load(view.config, progress), build_fittable(view.config), progress)
        for one, own in ((drawn.surface, alone.surface), (drawn.state, alone.state), (drawn.scene, alone.scene)):
            for array, expected in zip(jax.tree.leaves(one), jax.tree.leaves(own), strict=True):
                np.testing.assert_array_equal(array, expected)
        for name in ("visibility", "position", "normal", "face"):
            np.testing.assert_array_equal(getattr(drawn.reference, name), getattr(alone.reference, name))
    assert near.reference.position is other.reference.position


def test_many_views_are_in_memory_once_and_their_images_are_the_same(monkeypatch):
    grid = "{scene.light.azimuth: [-150, -30], scene.camera.orbit.azimuth: [10, 40]}"
    camera = "scene.camera={resolution: [64, 64], orbit: {distance: 3}}"
    config = parse_config(TINY, [camera, f"fit.views={{grid: {grid}}}"], fitting=True)
    progress, technique = Progress(Console(quiet=True)), build_fittable(config)
    found = []
    for many in (64, 4):
        monkeypatch.setattr("diffshadow.study.runs._views._MANY", many)
        views = draw_views(config, load(config, progress), technique, progress).fitted
        found.append([view.drawn[0] for view in views])
    for few, stored in zip(*found, strict=True):
        np.testing.assert_array_equal(few.state.depth, stored.state.depth)
        assert stored.stored.rest.depth is None
        np.testing.assert_array_equal(stored.stored.light.direction, few.state.light.direction)
        np.testing.assert_array_equal(few.surface.position, stored.surface.position)
        np.testing.assert_array_equal(few.reference.visibility, stored.reference.visibility)
        np.testing.assert_array_equal(few.mask, stored.mask)
        # Nothing that only pictures or rays need.
        assert (stored.surface.albedo, stored.surface.from_behind) == (None, None)
        assert stored.reference.position.strides == (0, 0, 0)
        # Such as are drawn again for a picture.
        pictures = [shaded(config, [each], [each.reference.visibility]) for each in (few, stored)]
        np.testing.assert_array_equal(*pictures)
    _, stored = found
    assert len({id(each.stored.atlas) for each in stored}) == 1
    # A stack of them shares their memory.
    for images in ([each.reference.visibility for each in stored], [each.mask for each in stored]):
        assert np.shares_memory(stack_of(images), images[0])
        np.testing.assert_array_equal(stack_of(images), np.stack(images))
        # In another order they are copied.
        assert not np.shares_memory(stack_of(images[::-1]), images[0])
        np.testing.assert_array_equal(stack_of(images[::-1]), np.stack(images[::-1]))
    surfaces = list({id(each.surface): each.surface.position for each in stored}.values())
    assert len(surfaces) == 2
    assert np.shares_memory(stack_of(surfaces), surfaces[0])


@pytest.mark.exhaustive
def test_a_fit_of_many_views_is_that_of_views_one_by_one(tmp_path, monkeypatch):
    arrays = []
    for many in (64, 2):
        monkeypatch.setattr("diffshadow.study.runs._views._MANY", many)
        with staying_in(tmp_path):
            folder = study.run_fit(parse_config(TINY, VIEWS, fitting=True), console=Console(quiet=True))
            arrays.append(dict(np.load(folder / "arrays.npz")))
    assert arrays[0].keys() == arrays[1].keys()
    for name, array in arrays[0].items():
        np.testing.assert_array_equal(array, arrays[1][name])


def test_flip_of_many_views_is_of_some_from_all_over():
    assert spaced(0, 3) == [0, 1, 2]
    assert spaced(3, 3) == []
    some = spaced(0, 1000)
    assert (some[0], some[-1], len(set(some))) == (0, 999, 32)
    assert max(np.diff(some)) <= 33
