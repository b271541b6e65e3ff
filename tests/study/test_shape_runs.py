"""Runs of fits of shapes: their folder, page and checkpoint, and mistakes of their configurations."""

import errno
import json
import os

import jax
import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from diffshadow import fit, io, study
from diffshadow.config import CONFIG_FILE, ConfigError, build_shape, load_config, parse_config
from diffshadow.geometry import Mesh, library_mesh
from diffshadow.raster import draw_surface
from diffshadow.study.record._runs import Overlap, ShapeMetrics
from diffshadow.study.remarks._fit import shape_remarks
from diffshadow.study.remarks._verdict import shape_verdict
from diffshadow.study.runs import _turntable
from diffshadow.study.runs._checkpoint import Checkpoint
from diffshadow.study.runs._progress import Progress
from diffshadow.study.runs._shape import shape_problem

TINY = """
name: tiny
scene:
  meshes:
    - {path: builtin:box, size: 1.0}
  lights: [{azimuth: 0, elevation: 20}, {azimuth: 90, elevation: 20}]
fit:
  shape:
    resolution: [32, 32]
    start: {path: builtin:sphere, size: 1.0, options: {subdivisions: 2}}
    unseen: [{azimuth: 45, elevation: 20}]
    phases: [{strength: 5, rate: 0.05, steps: 3}]
"""
QUIET = Console(quiet=True)


def config(*overrides, text=TINY):
    return parse_config(text, overrides, fitting=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    output = tmp_path_factory.mktemp("runs")
    return study.run_fit(config(f"output={output}"), console=QUIET)


@pytest.mark.exhaustive
def test_run_of_a_shape_has_the_mesh_the_numbers_and_a_page(folder):
    result = result_of(folder)
    assert sorted(entry.name for entry in folder.iterdir()) == result["files"]
    assert {"shape.ply", "turntable.webp", "progress.webp", "report.html", CONFIG_FILE} <= set(result["files"])
    measured = result["metrics"]
    assert [light["light"] for light in measured["lights"]] == ["scene.lights.0", "scene.lights.1"]
    assert all(light["rays"] > light["before"] - 0.02 for light in measured["lights"])
    assert measured["loss"] < measured["initial_loss"]
    assert 0.3 < measured["unseen"][0]["rays"] < 1
    assert 0 < measured["chamfer"] < 0.3 * measured["size"] == pytest.approx(0.3)
    mesh = io.load_mesh(folder / "shape.ply")
    assert (len(mesh.vertices), len(mesh.faces)) == (162, 320)
    page = (folder / "report.html").read_text()
    assert page.count("data:image/webp") == 2
    assert load_config(folder / CONFIG_FILE, fitting=True).fit.shape == config().fit.shape
    assert list(folder.parent.iterdir()) == [folder]


@pytest.mark.exhaustive
def test_page_of_a_shape_is_made_again_from_its_files(folder):
    page = (folder / "report.html").read_bytes()
    study.report(folder)
    assert (folder / "report.html").read_bytes() == page


@pytest.mark.exhaustive
def test_stopped_run_goes_on_from_its_checkpoint(folder, tmp_path, monkeypatch):
    class StopError(Exception):
        pass

    original = Checkpoint.at

    def at(self, state):
        original(self, state)
        if state.step == 2:
            raise StopError

    again = config(f"output={tmp_path}", "fit.shape.seconds=0")
    monkeypatch.setattr(Checkpoint, "at", at)
    with pytest.raises(StopError):
        study.run_fit(again, console=QUIET)
    kept = Checkpoint(again, tmp_path / "tiny").read()
    assert kept is not None
    assert (kept.phase, kept.step) == (0, 2)
    assert Checkpoint(config(f"output={tmp_path}", "seed=1"), tmp_path / "tiny").read() is None
    monkeypatch.setattr(Checkpoint, "at", original)
    resumed = study.run_fit(again, console=QUIET)
    once, twice = (np.asarray(io.load_mesh(each / "shape.ply").vertices) for each in (folder, resumed))
    before = lambda run: [light["before"] for light in result_of(run)["metrics"]["lights"]]
    assert before(resumed) == before(folder)
    # GPUs add up gradients in any order.
    np.testing.assert_allclose(twice, once, atol=0 if jax.default_backend() == "cpu" else 1e-5)
    assert list(tmp_path.iterdir()) == [resumed]


@pytest.mark.exhaustive
def test_run_with_a_light_that_moves_tells_how_far_it_is_off(tmp_path):
    moving = config(f"output={tmp_path}", "fit.shape.moves=[1]", "fit.shape.off=4", "fit.shape.phases=[{steps: 8}]")
    result = result_of(study.run_fit(moving, console=QUIET))
    (light,) = result["metrics"]["moved"]
    assert light["light"] == "scene.lights.1"
    assert light["before"] == pytest.approx(4, rel=0.02)
    assert light["after"] != light["before"]


def test_lights_start_as_far_off_as_asked():
    lights = "[{azimuth: 20, elevation: 60}, {type: point, position: [0, 3, 1]}, {azimuth: 70, elevation: 30}]"
    plan = build_shape(config(f"scene.lights={lights}", "fit.shape.moves=[0, 1]", "fit.shape.off=5"))
    (first, sun), (second, lamp), (third, still) = plan.starts
    assert (first, second, third) == (True, True, False)
    directions = [np.asarray(light.direction) for light in (sun, plan.seen[0].light)]  # type: ignore[attr-defined]
    assert np.degrees(np.arccos(directions[0] @ directions[1])) == pytest.approx(5, rel=0.03)
    middle = np.asarray(plan.truth.bounds).mean(axis=0)  # type: ignore[union-attr]
    places = [np.asarray(light.position) - middle for light in (lamp, plan.seen[1].light)]  # type: ignore[attr-defined]
    cosine = places[0] @ places[1] / np.prod(np.linalg.norm(places, axis=1))
    assert np.degrees(np.arccos(cosine)) == pytest.approx(5, abs=0.01)
    assert still is plan.seen[2].light


def test_a_checkpoint_that_does_not_fit_on_the_disk_keeps_the_last_one(tmp_path, monkeypatch):
    def state(step):
        shape = {name: np.zeros((step, 3)) for name in ("vertices", "faces", "free", "u", "mean", "square")}
        best = {name: np.zeros((1, 3)) for name in ("best_vertices", "best_faces", "lights", "light_mean")}
        rest = {"light_square": np.zeros(1), "best_lights": np.zeros(1), "losses": (), "crossings": 9}
        return fit.ShapeState(**shape, **best, **rest, phase=0, step=step, history=((0, 0.1),) * step)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    checkpoint = Checkpoint(config(), tmp_path / "tiny")
    checkpoint.write(state(2))
    monkeypatch.setattr(np, "savez", full)
    for again in (checkpoint, Checkpoint(config(), tmp_path / "tiny")):
        assert again is checkpoint or again.read() is not None
        with pytest.raises(io.FileError) as caught:
            again.write(state(3))
        assert str(caught.value).startswith(f"cannot write {checkpoint.file}: No space left on device")
        assert str(caught.value).endswith("; the fit then continues after step 2, which is kept")
    kept = checkpoint.read()
    assert kept is not None
    assert kept.step == 2


def test_damaged_checkpoints_are_ignored(tmp_path):
    checkpoint = Checkpoint(config(), tmp_path / "tiny")
    checkpoint.file.write_bytes(b"PK\x03\x04 and no more")
    assert checkpoint.read() is None


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["fit.shape.screen=below", "scene.lights.0.elevation=-20"], "expected light from above"),
        (["fit.shape.pinned=3"], "above all of the start's vertices"),
        (
            ["scene.lights=[{type: point, position: [0, 0.5, 0.1]}]"],
            "expected a position outside of the pictured square",
        ),
        (["scene.lights=[{type: rectangle, position: [0, 3, 0]}]"], "is a rectangle, whose shadows are soft"),
        (["fit.shape.symmetry=x", "fit.shape.start.path=builtin:blob"], "is not symmetric"),
    ],
)
def test_shapes_that_cannot_be_fitted_are_refused(overrides, words):
    with pytest.raises(ConfigError, match=words), Progress(QUIET) as progress:
        shape_problem(config(*overrides), progress)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["fit.shape.targets=[{path: builtin:box}]", "fit.shape.unseen=[]"],
            "has 1 entry, and the scene has 2 lights",
        ),
        (["fit.shape.targets=[{path: builtin:box}, {path: builtin:box}]"], "unseen: is given together with targets"),
        (["fit.parameters={bias.constant: {lower: 0, upper: 1}}"], "are given with fit.shape"),
        (["fit.shape.phases=[{blur: 9}]"], "at most 4 pixels, an eighth"),
        (["technique.type=shadow_volumes"], "fit.shape draws plain shadow maps"),
        (["fit.shape.images=[none.png]"], "there is no file"),
        (["fit.shape.start.path=none.ply"], "there is no file"),
        (["fit.shape.moves=[2]"], "is 2, and the scene has 2 lights"),
        (["fit.shape.off=5"], "is given without moves"),
    ],
)
def test_mistakes_between_keys_of_a_shape_are_named(overrides, words):
    with pytest.raises(ConfigError, match=words):
        config(*overrides)


def test_images_are_targets_and_masks_their_weights(tmp_path):
    dark = np.ones((32, 32), np.float32)
    dark[8:24, 8:20] = 0
    for name, image in (("dark", dark), ("light", np.ones((32, 32))), ("large", np.ones((64, 32)))):
        io.write_visibility(tmp_path / f"{name}.png", image)
    given = lambda first, *others: config(
        f"fit.shape.images=[{tmp_path}/{first}.png, {tmp_path}/dark.png]", "fit.shape.unseen=[]", *others
    )
    plan = build_shape(given("dark"))
    np.testing.assert_allclose(plan.images[0], dark, atol=1e-4)
    assert plan.targets == []
    assert plan.truth is None
    with pytest.raises(ConfigError, match=r"is an image of \[64, 32\] pixels"):
        build_shape(given("large"))
    with pytest.raises(ConfigError, match="is light in all pixels that count"):
        build_shape(given("light"))
    masked = f"fit.shape.masks=[{tmp_path}/dark.png, {tmp_path}/light.png]"
    with pytest.raises(ConfigError, match="is light in all pixels that count"):
        build_shape(given("dark", masked))


def test_images_that_look_wrong_are_remarked_on_or_refused(tmp_path, capsys):
    """An inverted image is dark at its border; an image of one colour has nothing to fit."""
    dark = np.ones((32, 32), np.float32)
    dark[8:24, 8:20] = 0
    frame = np.ones((32, 32))
    frame[:4] = frame[-4:] = frame[:, :4] = frame[:, -4:] = 0
    for name, image in (("dark", dark), ("inverted", 1 - dark), ("black", 0 * dark), ("frame", frame)):
        io.write_visibility(tmp_path / f"{name}.png", image)
    with Image.open(tmp_path / "dark.png") as image:
        Image.fromarray((np.asarray(image) / 257).astype(np.uint8)).save(tmp_path / "dark.jpg", quality=95)
    given = lambda first, *more: config(
        f"fit.shape.images=[{tmp_path}/{first}, {tmp_path}/dark.jpg]", "fit.shape.unseen=[]", *more
    )
    plan = build_shape(given("dark.png"))
    assert plan.remarks == []
    np.testing.assert_allclose(plan.images[0], plan.images[1], atol=0.1)
    # Where the border does not count, the border of what counts tells.
    masked = f"fit.shape.masks=[{tmp_path}/frame.png, {tmp_path}/frame.png]"
    for more in ([], [masked]):
        (said,) = build_shape(given("inverted.png", *more)).remarks
        assert said.startswith(f"fit.shape.images.0 ({tmp_path}/inverted.png) is dark in 100% of the pixels at its")
        assert "invert the image" in said
    with pytest.raises(ConfigError, match=r"black\.png, which is dark in all pixels that count"):
        build_shape(given("black.png"))


def test_faces_seen_from_behind_have_another_colour(monkeypatch):
    """Inside an open box, but nowhere on a closed one, whichever way its faces are wound."""
    monkeypatch.setattr(_turntable, "_SIDE", 24)
    monkeypatch.setattr(_turntable, "_FRAMES", 1)
    box = library_mesh("box")
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    top = (vertices[faces][..., 1] > vertices[:, 1].max() - 1e-6).all(axis=1)
    is_blue = lambda mesh: (lambda frame: frame[..., 2] > frame[..., 0] + 0.1)(_turntable.turntable(mesh)[0])
    assert not is_blue(box).any()
    assert not is_blue(Mesh(vertices, faces[:, ::-1])).any()
    assert is_blue(Mesh(vertices, faces[~top])).mean() > 0.05
    assert is_blue(Mesh(vertices, faces[~top][:, ::-1])).mean() > 0.05


def result_of(folder):
    return json.loads((folder / "result.json").read_text())


def shape_result(losses, chosen=0):
    history = [(0, loss) for loss in losses]
    return fit.FittedShape(None, [], 0.4, losses[-1], [losses[-1]], chosen, history, [], [], None)


def test_the_verdict_of_a_shape_names_crossing_faces_and_a_start_that_was_best():
    lights = [Overlap(light="scene.light", before=0.4, map=0.9, rays=0.8)]
    measured = ShapeMetrics(initial_loss=0.4, loss=0.1, lights=lights, self_intersections=779)
    crossing = lambda pairs: measured.model_copy(update={"self_intersections": pairs})
    said = shape_verdict(shape_result([0.1] * 8), measured)
    assert said.kind == "fitted"
    assert (
        "to 80.0% by rays, from 40.0%, in 8 steps; the surface intersects itself in 779 pairs of faces" in said.sentence
    )
    assert "normal_consistency" in said.remedies[0]
    one = shape_verdict(shape_result([0.1] * 8), crossing(1))
    assert one.sentence.endswith("in 1 pair of faces")
    none = shape_verdict(shape_result([0.1] * 8), crossing(0))
    assert ("intersects" in none.sentence, none.remedies) == (False, [])
    start = shape_verdict(shape_result([0.1] * 8, -1), measured)
    assert (start.kind, start.sentence.startswith("no phase ended better than the start")) == ("best already", True)


def test_a_shape_whose_error_still_fell_asks_for_more_steps():
    assert list(shape_remarks(shape_result([0.4, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]))) == []
    (said,) = shape_remarks(shape_result([0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1]))
    assert "still fell when phase 1 ended, which gave the result, by 67% in its last 2 steps" in said
    assert said.endswith("fit.shape.phases.0.steps")


def test_lights_of_all_kinds_have_screens_that_show_the_shape():
    lights = "[{azimuth: 20, elevation: 60}, {type: spot, position: [1, 4, 1]}, {type: point, position: [0, 3, 1]}]"
    for screen in ("facing", "below"):
        plan = build_shape(config(f"scene.lights={lights}", f"fit.shape.screen={screen}"))
        assert plan.truth is not None
        middle = np.asarray(plan.truth.bounds).mean(axis=0)
        for each in plan.seen:
            place = getattr(each.light, "position", None)
            way = np.asarray(getattr(each.light, "direction", None)) if place is None else middle - np.asarray(place)
            eye, target = (np.asarray(point) for point in (each.camera.eye, each.camera.target))
            drawn, surface = draw_surface(each.mesh, each.camera), each.surface()
            np.testing.assert_array_equal(surface.mask, drawn.mask)
            np.testing.assert_allclose(surface.position, drawn.position, atol=2e-5)
            np.testing.assert_allclose(surface.normal, drawn.normal, atol=1e-5)
            # The light's ray through the middle meets the screen where the camera looks.
            np.testing.assert_allclose(np.cross(target - middle, way), 0, atol=1e-5)
            assert (target - eye) @ way > 0
