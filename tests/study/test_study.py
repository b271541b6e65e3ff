"""Runs from a configuration to a folder: what is written, what is said, and what a failure leaves behind."""

import dataclasses
import html
import importlib.util
import io as text_io
import json
import re
import shutil
import subprocess
import sys
import types
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
from rich.console import Console
from scenes import staying_in
from stored_runs import TINY

from diffshadow import fit, io, metrics, reference, study
from diffshadow._arithmetic import as_array, as_float
from diffshadow.cli import main
from diffshadow.config import ConfigError, build_scene, build_technique, fit_paths, load_config, settings_file
from diffshadow.settings.engines import ENGINES
from diffshadow.shadow import Bias, Nearest, ShadowMapping, SoftCompare, ThreeJs, engine_code
from diffshadow.study.runs import _convert, _engine
from diffshadow.study.runs._engine import Lit
from diffshadow.study.runs._measure import perceptual_error
from diffshadow.study.runs._progress import Progress
from diffshadow.study.runs._setup import Loaded, _traced, draw

ROOT = Path(__file__).parents[2]
QUICKSTART = ROOT / "configs" / "quickstart.yaml"

FIT_FILES = {
    *("config.yaml", "fitted.yaml", "result.json", "arrays.npz", "report.html"),
    *("comparison.png", "shadow_map.png", "loss.png", "parameters.png", "shaded.png"),
}
RENDER_FILES = {
    *("config.yaml", "result.json", "arrays.npz", "report.html"),
    *("visibility.png", "reference.png", "difference.png", "shadow_map.png", "shaded.png"),
}
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(autouse=True)
def apart(tmp_path):
    """Each test in a folder of its own, with a cache of its own."""
    with staying_in(tmp_path):
        Path("tiny.yaml").write_text(TINY)
        yield


def tiny(*overrides: str):
    return load_config(Path("tiny.yaml"), list(overrides))


def console() -> tuple[Console, text_io.StringIO]:
    """A console that nobody watches, and what it was told."""
    out = text_io.StringIO()
    return Console(file=out, width=100, highlight=False), out


def run(*overrides: str) -> tuple[Path, str]:
    """The folder of a fit, and what was printed."""
    to, out = console()
    return study.run_fit(tiny(*overrides), console=to), out.getvalue()


def test_reference_is_kept_by_all_that_it_depends_on(monkeypatch):
    keys = []

    class KeyFoundError(Exception):
        pass

    def kept(parts, compute):
        keys.append(io.cache_key(parts))
        raise KeyFoundError

    monkeypatch.setattr(io, "cached_arrays", kept)
    scene = build_scene(tiny("scene.meshes.0.casts=false"))
    for override in (
        "name=other",
        "seed=1",
        "reference.samples=9",
        "reference.supersampling=2",
        "reference.blockers=all",
        "bias.constant=2",
    ):
        with pytest.raises(KeyFoundError):
            _traced(tiny(override), scene, Progress(console()[0]))
    # Neither the name nor a bias changes it.
    assert keys[0] == keys[-1]
    assert len(set(keys)) == len(keys) - 1


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One finished fit that several tests look at: its folder and what was printed."""
    folder = tmp_path_factory.mktemp("finished")
    with staying_in(folder):
        Path("tiny.yaml").write_text(TINY)
        made, said = run()
        return folder / made, said, folder


def leftovers(folder: Path, *inputs: str) -> list[str]:
    """Everything in `folder` but the configuration, the cache and other `inputs`."""
    return sorted(entry.name for entry in folder.iterdir() if entry.name not in ("tiny.yaml", "cache", *inputs))


def result_of(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text())


@pytest.mark.exhaustive
def test_a_render_with_the_fitted_values_has_the_error_of_the_fit():
    """Maps of cascades have a margin for all that the fit may try."""
    folder, _ = run("technique={type: cascades, count: 2}")
    result = result_of(folder)
    values = [f"{name}={value!r}" for name, value in result["fitted"].items()]
    for file, settings in (("config.yaml", [*values, "name=again"]), ("fitted.yaml", [])):
        config = load_config(folder / file, settings)
        errors = result_of(study.run_render(config, console=console()[0]))["metrics"]["errors"]
        assert errors["rmse"] == pytest.approx(result["metrics"]["after"]["rmse"], rel=1e-6)


def test_a_fit_leaves_a_configuration_with_the_fitted_values(finished):
    folder, _, _ = finished
    fitted, result = load_config(folder / "fitted.yaml", fitting=True), result_of(folder)
    assert fitted.name == "tiny-fitted"
    for name, value in result["fitted"].items():
        assert fitted.initial(name) == pytest.approx(value, rel=1e-7)
    start = load_config(folder / "config.yaml", fitting=True)
    assert [start.initial(name) for name in result["fitted"]] == pytest.approx([*result["initial"].values()])
    apart = {"name": start.name, "bias": start.bias, "filter": start.filter, "fit": start.fit}
    assert fitted.model_copy(update=apart) == start


def converted(config, origin: str = "") -> str:
    to, out = console()
    study.convert(config, console=to, origin=origin, source="tiny.yaml", overrides=["bias.slope=0"])
    return out.getvalue()


def test_a_finished_fit_is_converted_with_its_fitted_values(finished):
    folder, _, _ = finished
    file, origin = settings_file(folder / "config.yaml")
    config = load_config(file, ["bias.slope=0", "bias.normal_offset=0"])
    said = converted(config, origin)
    assert said.startswith(f"the values come from the fit, {folder / 'fitted.yaml'}")
    # Texels are its unit.
    (texels,) = re.findall(r"Unity URP[: ]+shadowBias \(depth\)\s+(\S+)", said)
    assert float(texels) == pytest.approx(result_of(folder)["fitted"]["bias.constant"], rel=1e-3)
    assert "valid where both sides of faces cast" in said


LACKING = {
    "bias.slope": "bias.slope=0.5",
    "bias.plane (receiver_plane)": "bias.plane={type: receiver_plane}",
    "bias.terms": "bias.terms={sine: 1}",
    "bias.factors": "bias.factors=[2, 1, 1, 1, 1, 1] scene.light={type: point, position: [0.5, 3, 1]}",
    "shadow_map.depth_layer (midpoint)": "shadow_map.depth_layer=midpoint",
    "shadow_map.polygon_offset": "shadow_map.polygon_offset=[1, 1]",
    "bias.normal_offset_profile (sine)": "bias.normal_offset=1",
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("what", LACKING)
def test_a_bias_that_engines_lack_is_fitted_instead(what, monkeypatch):
    """No constant is printed for an engine that lacks a part of the bias."""

    class FittingError(Exception):
        pass

    def fit_technique(config, progress):
        assert config.technique.type == "three.js"
        assert config.technique.shadow_side == "double"
        assert sorted(config.fit.parameters) == ["technique.bias", "technique.normal_bias", "technique.radius"]
        raise FittingError

    monkeypatch.setattr(_convert, "fit_technique", fit_technique)
    to, out = console()
    with pytest.raises(FittingError):
        study.convert(tiny("bias.slope=0", *re.split(" (?=scene)", LACKING[what])), console=to)
    said = out.getvalue()
    assert f" have no {what}" in said
    assert "light.shadow.bias" not in said
    # Babylon.js and Filament have such a normal offset.
    assert ("generator.bias" in said) == ("normal_offset" in what)


@pytest.mark.parametrize("kind", ["{}", "{type: spot, orbit: {distance: 6}}", "{type: point, position: [0, 4, 1]}"])
def test_fits_of_engines_start_within_their_bounds(kind):
    config = tiny(f"scene.light={kind}")
    lit = Lit(("scene", "light"), build_scene(config), 0.05, 0.01, 3.0)
    for overrides in _convert._fits(config, [lit], list(ENGINES.values())).values():
        made = load_config("tiny.yaml", [f"scene.light={kind}", *overrides], fitting=True)
        for name, bounds in made.fit.parameters.items():
            assert bounds.lower <= made.initial(name) <= bounds.upper


@pytest.mark.exhaustive
def test_a_bias_that_engines_lack_is_converted_and_measured():
    overrides = "bias.plane={type: receiver_plane}", "bias.slope=0", "scene.light.angular_radius=1"
    said = converted(tiny(*overrides))
    for name in ("this configuration", "three.js", "Babylon.js"):
        ((rmse, acne),) = re.findall(rf"{name} +RMSE (\S+), false shadow (\S+)%", said)
        assert 0 < float(rmse) < 0.15
        assert float(acne) < 3
    assert "light.shadow.bias = -" in said
    assert "generator.bias = " in said
    assert "Godot 4, Bevy, Filament, Unity URP are left out" in said
    assert "diffshadow advise tiny.yaml bias.slope=0 --engine godot" in said
    oblong = converted(tiny(*overrides, "shadow_map.resolution=[64, 32]"))
    assert "Babylon.js is left out, since its maps are square" in oblong


def test_a_fit_with_nothing_to_compare_is_refused_before_its_reference_is_traced(monkeypatch):
    monkeypatch.setattr("diffshadow.reference.trace_visibility", lambda *args, **options: pytest.fail("traced"))
    io.write_visibility("dark.png", np.zeros((64, 64)))
    for overrides, key in (
        (["scene.light.elevation=-60"], "scene: no light reaches the camera's view, so there is nothing"),
        (["reference={type: image, path: dark.png}"], "reference.path: is dark in all pixels that count"),
    ):
        for refuse in (
            lambda config: study.run_fit(config, console=console()[0]),
            lambda c: study.check(c, console=console()[0]),
        ):
            with pytest.raises(ConfigError, match=key):
                refuse(tiny(*overrides))
    assert leftovers(Path(), "dark.png") == []


def test_fit_writes_every_file_and_nothing_else(finished):
    folder, _, home = finished
    assert folder == home / "runs" / "tiny"
    assert {entry.name for entry in folder.iterdir()} == FIT_FILES
    assert [entry.name for entry in (home / "runs").iterdir()] == ["tiny"]
    for picture in folder.glob("*.png"):
        assert picture.read_bytes().startswith(PNG)
        assert picture.stat().st_size > 2000


def test_stored_errors_and_steps_are_what_they_say(finished):
    """Errors of the stored images, losses at the stored values, and the reference's noise."""
    folder, _, home = finished
    result = result_of(folder)
    with staying_in(home):
        config = load_config(folder / "config.yaml", [], fitting=True)
        scene, technique = build_scene(config), build_technique(config)
        (drawn,) = draw(config, Loaded(scene), technique, Progress(console()[0]))
        truth = reference.trace_visibility(scene, 8, config.reference.sampler, config.seed)
    with np.load(folder / "arrays.npz") as stored:
        arrays = dict(stored)
    by_name = {"rmse": metrics.rmse, "mae": metrics.mae, "ssim": metrics.ssim}
    by_name |= {name: getattr(metrics, name) for name in ("false_shadow_rate", "false_light_rate")}
    assert result["metrics"]["after"]["rmse"] < 0.8 * result["metrics"]["before"]["rmse"]
    for when in ("before", "after"):
        errors = result["metrics"][when]
        for name, metric in by_name.items():
            assert errors[name] == pytest.approx(metric(arrays[when], arrays["reference"], arrays["mask"]), abs=1e-6)
        (light,) = result["metrics"]["lights"]
        assert light[when] == {name: error for name, error in errors.items() if name != "flip"}
    noise = np.sqrt(np.mean(np.square(truth.standard_error, dtype=np.float64)[truth.mask]))
    assert result["metrics"]["reference_noise_floor"] == pytest.approx(noise, rel=1e-6)
    problem = fit.TechniqueProblem(
        technique, drawn.state, drawn.surface, as_array(arrays["reference"]), as_array(arrays["mask"])
    )
    loss = eqx.filter_jit(lambda at: problem.mean_square_error(at))
    paths = [fit_paths(config)[name] for name in result["fitted"]]
    at = lambda values: fit.with_values(technique, paths, as_float(values))
    for number, (phase, width) in enumerate(zip(result["solver"]["phases"], (2.0, 0.05), strict=True)):
        assert phase["hard_loss"] == pytest.approx(float(loss(at(list(phase["values"].values())))), rel=1e-4)
        assert (phase["width"], phase["blur"], phase["searched"]) == (pytest.approx(width), 0, 0)
        last = np.flatnonzero(arrays["history_phase"] == number)[-1]
        soft = dataclasses.replace(at(arrays["history_values"][last]), compare=SoftCompare(phase["width"]))
        assert arrays["history_loss"][last] == pytest.approx(float(loss(soft)), rel=2e-3)
        assert arrays["history_width"][last] == np.float32(phase["width"])


def test_flip_is_of_the_stored_pictures_over_the_pixels_that_count(finished):
    pytest.importorskip("flip_evaluator")
    folder, said, _ = finished
    measured = result_of(folder)["metrics"]
    assert 0 < measured["after"]["flip"] < measured["before"]["flip"] < 1
    with np.load(folder / "arrays.npz") as arrays:
        for when in ("before", "after"):
            pictures = (arrays[f"shaded_{name}"] / 255 for name in (when, "reference"))
            assert metrics.flip(*pictures, arrays["mask"])[0] == measured[when]["flip"]
    (line,) = (line for line in said.splitlines() if "FLIP" in line)
    assert re.findall(r"\d\.\d+", line) == [f"{measured[when]['flip']:.4f}" for when in ("before", "after")]


def test_flip_counts_what_any_light_counts_and_is_none_without_its_package(monkeypatch):
    truth = np.full((8, 12, 3), 200, np.uint8)
    picture, masks = truth.copy(), np.zeros((2, 8, 12), bool)
    picture[:, :6] = 20
    masks[0, :, :6] = masks[1, :, 6:] = True
    pictures = {"shaded_after": picture, "shaded_reference": truth}
    error = lambda lights: perceptual_error(pictures, "after", [types.SimpleNamespace(mask=mask) for mask in lights])
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert error(masks) is None
    monkeypatch.undo()
    pytest.importorskip("flip_evaluator")
    assert error(masks) == metrics.flip(picture / 255, truth / 255)[0]
    assert 0 < error(masks) < error(masks[:1])


def test_report_is_one_page_that_needs_nothing_else(finished):
    page = (finished[0] / "report.html").read_text()
    # Reference, before, after, two differences, three shaded, and the shadow map.
    assert page.count("data:image/png;base64,") == 9
    assert not re.search(r"(?:src|href)=\"(?!data:|#)", page)
    assert "prefers-color-scheme: dark" in page
    for words in ("filter.radius", f"diffshadow fit {finished[0] / 'config.yaml'}", "Fitting bias.constant and filter"):
        assert words in page


def test_resolved_config_loads_to_the_same_settings(finished, monkeypatch):
    folder, _, home = finished
    monkeypatch.chdir(home)
    assert load_config(folder / "config.yaml", []) == load_config(home / "tiny.yaml", [])


@pytest.mark.exhaustive
def test_second_run_traces_nothing_and_finds_the_same(finished, monkeypatch, tmp_path):
    _, _, home = finished
    shutil.copytree(home, tmp_path, dirs_exist_ok=True)
    first = Path("runs/tiny")
    before = result_of(first)
    (first / "mine.txt").write_text("a note")
    (first / "loss.png").write_text("stale")

    def never(*args, **kwargs):
        raise AssertionError("the reference was traced again")

    monkeypatch.setattr("diffshadow.reference.trace_visibility", never)
    second, _ = run()
    after = result_of(second)
    assert second == first
    assert after["fitted"] == before["fitted"]
    assert after["metrics"] == before["metrics"]
    # A file of the user's own stays; the run's are all new.
    assert (second / "mine.txt").read_text() == "a note"
    assert (second / "loss.png").read_bytes().startswith(PNG)
    assert [entry.name for entry in Path("runs").iterdir()] == ["tiny"]


@pytest.mark.parametrize(
    "error",
    [KeyboardInterrupt, *(pytest.param(each, marks=pytest.mark.exhaustive) for each in (RuntimeError, OSError))],
)
def test_run_that_dies_while_writing_leaves_the_earlier_one(error, monkeypatch, tmp_path):
    earlier = tmp_path / "runs" / "tiny"
    earlier.mkdir(parents=True)
    (earlier / "result.json").write_text('{"files": ["result.json"]}')

    def dies(run, folder, *args):
        (folder / "loss.png").write_bytes(PNG)
        raise error

    monkeypatch.setattr("diffshadow.study.pages._figures.write_figures", dies)
    with pytest.raises(error):
        run()
    assert [entry.name for entry in (tmp_path / "runs").iterdir()] == ["tiny"]
    assert [entry.name for entry in earlier.iterdir()] == ["result.json"]


def test_run_that_dies_leaves_not_even_its_output_folder(monkeypatch, tmp_path):
    def dies(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("diffshadow.fit.fit", dies)
    with pytest.raises(KeyboardInterrupt):
        run("output=deep/er/runs")
    assert leftovers(tmp_path) == []


def test_folder_that_is_no_run_is_never_replaced(tmp_path):
    precious = tmp_path / "runs" / "tiny"
    precious.mkdir(parents=True)
    (precious / "thesis.tex").write_text("x")
    with pytest.raises(ConfigError, match="not a run's folder"):
        run()
    assert [entry.name for entry in precious.iterdir()] == ["thesis.tex"]


def before_work(monkeypatch) -> None:
    """Makes every long stage of a run an error."""

    def never(*args, **kwargs):
        raise AssertionError("long work was begun")

    for name in ("diffshadow.reference.trace_visibility", "diffshadow.fit.fit"):
        monkeypatch.setattr(name, never)


@pytest.mark.parametrize("command", ["fit", "render", "validate"])
@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("output=tiny.yaml/runs", "exists and is not a folder"),
        ("scene.meshes.0={path: nowhere.obj}", "scene.meshes.0.path: there is no file"),
        ("reference={type: image, path: nowhere.png}", "reference.path: there is no file"),
        ("reference={type: image, path: tiny.yaml}", "reference.path: the suffix of"),
        ("reference={type: image, path: text.png}", "reference.path: the image file"),
        ("reference={type: image, path: small.npy}", "reference.path: is an image of [8, 4] pixels"),
        (f"name={'x' * 240}", "name: has 240 bytes; expected at most 200"),
        (f"output={'/'.join(['x' * 99] * 40)}", "output: makes paths of files of"),
        ("scene.camera={eye: [0, 1, 9], target: [0, 9, 9]}", "camera"),
        (
            "scene.light={type: spot, position: [0, 3, 0], target: [9, 3, 0], outer_angle: 5}",
            "scene.light: and the camera see no common surface: of",
        ),
    ],
)
def test_mistakes_are_reported_before_any_work(command, override, said, monkeypatch, capsys, tmp_path):
    before_work(monkeypatch)
    Path("text.png").write_text("no image")
    np.save("small.npy", np.ones((8, 4), np.float32))
    with pytest.raises(SystemExit) as caught:
        main([command, "tiny.yaml", override])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    # Stages that have begun are named.
    assert {line.split(maxsplit=2)[2] for line in out.splitlines()} <= {"loading", "drawing"}
    assert said in err
    assert "Traceback" not in err
    assert err.startswith(f"error: override {override!r}: ")
    assert len(err.splitlines()) == 1
    assert leftovers(tmp_path, "text.png", "small.npy") == []


def test_validate_begins_what_a_run_does_and_writes_nothing(monkeypatch, capsys, tmp_path):
    before_work(monkeypatch)
    with pytest.raises(SystemExit) as caught:
        main(["validate", "tiny.yaml"])
    assert caught.value.code == 0
    said, _, after = capsys.readouterr().out.partition("next steps:\n")
    assert said.endswith("tiny.yaml is valid; its scene has 14 triangles\n")
    assert "diffshadow fit tiny.yaml" in after
    assert leftovers(tmp_path) == []


def test_the_verdict_comes_first_everywhere(finished, tiny_figures, tmp_path):
    """Of a fit that improves, and of one to a reference that is upside down."""
    folder, said, _ = finished
    read = lambda folder: html.unescape((folder / "report.html").read_text())
    result, page = result_of(folder), read(folder)
    sentence = result["verdict"]["sentence"]
    assert result["verdict"]["kind"] == "fitted"
    assert next(iter(result)) == "schema_version"
    assert list(result)[1] == "verdict"
    assert said.startswith(sentence)
    assert f'<p class="summary">{sentence[:1].upper()}{sentence[1:]}.</p>' in page
    with np.load(folder / "arrays.npz") as arrays:
        io.write_visibility(tmp_path / "truth.npy", arrays["reference"][::-1])
    made, said = run("reference={type: image, path: truth.npy}")
    found, page = result_of(made)["verdict"], read(made)
    assert found["kind"] == "unexplained"
    assert found["remedies"][0].startswith("flip the reference upside down: rays")
    assert said.startswith(f"warning: {found['sentence']}\nwarning: {found['remedies'][0]}")
    assert result_of(made)["warnings"] == []
    assert f'<p class="summary warning">{found["sentence"][:1].upper()}{found["sentence"][1:]}. Flip the' in page
    with np.load(made / "arrays.npz") as arrays:
        assert arrays["reference"][arrays["mask"]].std() == pytest.approx(found["constant_rmse"], rel=1e-4)
    # Whoever compares it is told, too.
    to, _ = console()
    assert found["sentence"] in study.compare([folder, made], tmp_path / "both.html", console=to).read_text()


@pytest.mark.exhaustive
@pytest.mark.parametrize("really", [False, True])
def test_flat_gradient_is_reported_with_its_cause(really, tiny_figures, monkeypatch):
    def flat(problems, *arguments, **settings):
        # By the program of other tests.
        bilinear = dataclasses.replace(problems[0].technique.filter, lookup="bilinear")
        problems = [eqx.tree_at(lambda p: p.technique.filter, each, bilinear) for each in problems]
        return dataclasses.replace(found(problems, *arguments, **settings), flat=["filter.radius"])

    found = fit.fit
    if not really:
        monkeypatch.setattr(fit, "fit", flat)
    folder, said = run("filter.lookup=nearest")
    assert result_of(folder)["solver"]["flat"] == ["filter.radius"]
    assert "warning: filter.radius was not fitted: its gradient is zero throughout, because nearest look-ups" in said
    assert "filter.radius was not fitted" in (folder / "report.html").read_text()


FIRST = "(blur 24 pixels)"


def ended(blur: float, result: str = "successful") -> fit.Outcome:
    return fit.Outcome(0.0, 8, result, 1e-9, 0.01, (5.0,), blur)


@pytest.mark.parametrize(
    ("last", "losses", "said"),
    [
        # The error still fell by four fifths in the last quarter of the steps.
        ("successful", [1, 0.9, 0.8, 0.7, 0.6, 0.5, 0.3, 0.1], [FIRST, "by 80% in its last 2 steps: raise"]),
        # By no more than the loss jumps; a step that was taken back is none that helped.
        ("successful", [1, 0.3, 0.2, 0.1, 0.1, 0.1, 0.08, 0.9], []),
        ("max_steps reached", [1, 0.3, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1], [FIRST, "ended at max_steps, too"]),
        ("successful", [], []),
    ],
)
def test_first_phase_that_was_cut_short_is_reported_where_it_matters(last, losses, said):
    from diffshadow.study.remarks._fit import remarks

    history = [fit.Step(0, i, 0.0, loss, (5.0,), start=1) for i, loss in enumerate(losses)]
    # Another start's steps, and those of the phase that converged, count for nothing.
    history = [fit.Step(0, 0, 0.0, 9.0, (5.0,), start=0), *history, fit.Step(1, 0, 0.0, 0.01, (5.0,), start=1)]
    cut, whole = ended(24.0, "max_steps reached"), ended(3.0, last)
    at, asked = {"bias.constant": 5.0}, (fit.Parameter("bias.constant", 5.0, 0.0, 10.0),)
    technique = ShadowMapping(Nearest(), Bias())
    known = {"technique": technique, "initial": at, "fitted": at, "flat": [], "parameters": asked}
    known |= {"phases": [cut, whole], "chosen": 1, "seconds_compiling": 0.0, "seconds_running": 0.0}
    found = fit.FitResult(**known, history=history)
    earlier = [remark for remark in remarks(tiny(), found) if "earlier phase" in remark]
    assert len(earlier) == bool(said)
    assert all(part in remark for remark in earlier for part in said)
    # Where the result comes from none of the phases, or from the first one itself, there is nothing to say.
    for chosen in (-1, 0):
        assert not any("earlier phase" in each for each in remarks(tiny(), dataclasses.replace(found, chosen=chosen)))


def test_render_writes_its_images_beside_the_fit_s():
    to, out = console()
    folder = study.run_render(tiny(), console=to)
    assert folder == Path("runs/tiny-render")
    # Debug views are written only when asked for.
    assert {entry.name for entry in folder.iterdir()} == RENDER_FILES
    result = result_of(folder)
    assert result["kind"] == "render"
    assert result["metrics"]["errors"]["rmse"] > 0
    assert result["command"] == "diffshadow render runs/tiny-render/config.yaml"
    assert "SSIM" in out.getvalue()
    if importlib.util.find_spec("flip_evaluator"):
        with np.load(folder / "arrays.npz") as arrays:
            pictures = (arrays[f"shaded_{name}"] / 255 for name in ("visibility", "reference"))
            perceived, _ = metrics.flip(*pictures, arrays["mask"])
        assert result["metrics"]["errors"]["flip"] == perceived > 0
        assert f"{perceived:.4f}" in out.getvalue()
    # How large texels are on the screen, by definition.
    config = tiny()
    technique = build_technique(config, fitting=False)
    (drawn,) = draw(config, Loaded(build_scene(config)), technique, Progress(console()[0]))
    found = technique.aliasing(drawn.state, drawn.surface, drawn.scene.camera)
    (light,) = result["metrics"]["lights"]
    for part, extent in (("extent", found.extent), ("perspective", found.perspective_extent)):
        values = np.asarray(extent, np.float64)[np.asarray(found.mask)]
        figures = light["aliasing"][part]
        assert figures["worst"] == pytest.approx(values.max())
        assert (values > figures["percentile_99"]).mean() == pytest.approx(0.01, abs=1 / len(values))
        assert 2 ** figures["mean_log2"] == pytest.approx(np.exp(np.mean(np.log(values))))
        assert figures["undersampled"] == np.mean(values > 1)
    assert light["aliasing"]["extent"] != light["aliasing"]["perspective"]


SMALL = ("fit.parameters={bias.constant: {lower: 0, upper: 10}}",)
LIGHTS = ("scene.light=null", "scene.lights=[{angular_radius: 1.5}, {type: point, radius: 0.1, guard: 0.5}]")


def render(*overrides: str, debug: bool = False) -> tuple[Path, str]:
    """The folder of a small render, and what was printed."""
    to, out = console()
    return study.run_render(tiny(*SMALL, *overrides), console=to, debug=debug), out.getvalue()


@pytest.mark.exhaustive
def test_render_of_several_lights_tells_them_apart():
    folder, said = render(*LIGHTS, debug=True)
    per_light = (
        "visibility",
        "reference",
        "difference",
        "shadow_map",
        "debug_aliasing",
        "debug_depth",
        "debug_silhouettes",
        "debug_pattern",
    )
    names = {f"{name}_{i}.png" for name in per_light for i in range(2)}
    assert {entry.name for entry in folder.glob("*.png")} == {*names, "shaded.png"}
    metrics = result_of(folder)["metrics"]
    assert [light["light"] for light in metrics["lights"]] == ["scene.lights.0", "scene.lights.1"]
    assert metrics["pixels"] == sum(light["pixels"] for light in metrics["lights"])
    with np.load(folder / "arrays.npz") as arrays:
        assert arrays["visibility"].shape == arrays["mask"].shape == (2, 64, 64)
        assert arrays["shadow_map_depth_1"].shape == (6, 64, 64)
        difference = (arrays["visibility"].astype(np.float64) - arrays["reference"])[arrays["mask"]]
    # The errors of all lights together are those over all their pixels.
    assert metrics["errors"]["rmse"] == pytest.approx(np.sqrt(np.mean(difference**2)), rel=1e-6)
    assert metrics["errors"]["mae"] == pytest.approx(np.mean(np.abs(difference)), rel=1e-6)
    assert "scene.lights.1" in said


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("overrides", "more"),
    [
        pytest.param(("technique.type=shadow_volumes",), {"debug_volumes.png"}, marks=pytest.mark.exhaustive),
        (
            (),
            {"shadow_map.png", "debug_aliasing.png", "debug_depth.png", "debug_pattern.png"},
        ),
        pytest.param(
            ("technique={type: projective_texture, resolution: [64, 64], blur: 1}", "scene.meshes.1.casts=false"),
            {"texture.png"},
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            ("filter={type: pcss, samples: 4, pattern_size: 2, pattern: vogel, rotated: false}",),
            {"shadow_map.png", "debug_aliasing.png", "debug_depth.png", "debug_blockers.png", "debug_pattern.png"},
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            ("technique={type: cascades, count: 4, depths: surface}", "filter={type: nearest}", "bias.constant=1"),
            {"shadow_map.png", "debug_aliasing.png", "debug_cascades.png", "debug_depth.png"},
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            (
                "technique={type: resolution_matched, page: 16, finest: 512}",
                "filter={type: nearest}",
                "bias.constant=1",
            ),
            {"shadow_map.png", "debug_aliasing.png", "debug_levels.png", "debug_depth.png"},
            marks=pytest.mark.exhaustive,
        ),
    ],
    ids=["volumes", "map", "projective", "pcss", "cascades", "pages"],
)
def test_every_technique_renders_with_its_debug_views(overrides, more):
    folder, _ = render(*overrides, debug=True)
    always = {"visibility.png", "reference.png", "difference.png", "shaded.png", "debug_silhouettes.png"}
    assert {entry.name for entry in folder.glob("*.png")} == always | more
    for picture in folder.glob("*.png"):
        assert picture.read_bytes().startswith(PNG)
        assert picture.stat().st_size > 2000
    result = result_of(folder)
    assert result["metrics"]["technique"] == tiny(*SMALL, *overrides).technique.type
    assert 0 < result["metrics"]["errors"]["rmse"] < 0.5


def test_fit_of_what_has_no_gradient_is_refused_before_any_work(monkeypatch, capsys, tmp_path):
    before_work(monkeypatch)
    with pytest.raises(SystemExit) as caught:
        main(["fit", "tiny.yaml", "technique.type=shadow_volumes"])
    assert caught.value.code == 2
    assert "technique.type: is shadow_volumes, whose visibility has no gradient" in (capsys.readouterr().err)
    assert leftovers(tmp_path) == []


@pytest.mark.exhaustive
def test_fits_of_an_engine_leave_its_code():
    made, said = run(
        "technique={type: three.js, shadow_side: double, radius: 2}",
        "fit.parameters={technique.bias: {lower: -0.05, upper: 0}, technique.radius: {lower: 0, upper: 4}}",
        "fit.solver.max_steps=3",
    )
    result = result_of(made)
    code = (made / "engine.js").read_text()
    assert result["code"] == {"scene.light": code}
    fitted = {name.removeprefix("technique."): value for name, value in result["fitted"].items()}
    assert f"light.shadow.bias = {np.float32(fitted['bias'])!s};" in code
    assert f"light.shadow.radius = {np.float32(fitted['radius'])!s};" in code
    assert all(line in said for line in code.splitlines())
    assert "material.shadowSide = THREE.DoubleSide;" in (made / "report.html").read_text()
    assert result["metrics"]["after"]["rmse"] < 0.9 * result["metrics"]["before"]["rmse"]
    assert (made / "shadow_map.png").exists()


@pytest.mark.parametrize("where", ["direction: [1.3, -2.4, -1.2]", "azimuth: 20, elevation: 50"])
def test_code_of_an_engine_has_the_lights_own_camera(where):
    window = {"left": -1.9, "right": 2.3, "top": 1.7, "bottom": -2.1}
    camera = f"position: [-1.3, 2.6, 1.2], near: 0.3, far: 8, {', '.join(f'{k}: {v}' for k, v in window.items())}"
    config = tiny(f"scene.light={{{where}, shadow_camera: {{{camera}}}}}")
    given = _engine._as_given(config.scene.light, build_scene(config).light)
    assert given[:4] == ("directional", [-1.3, 2.6, 1.2], 0.3, 8)
    assert given.window == window
    if "direction" in where:
        assert given.target == pytest.approx([0, 0.2, 0], abs=1e-12)
    code = engine_code(ThreeJs(), given, (1.0, 5.0))
    assert "left: -1.9, right: 2.3, top: 1.7, bottom: -2.1, near: 0.3, far: 8 }" in code


def test_progress_is_shown_to_a_terminal_only(finished, tiny_figures):
    out = text_io.StringIO()
    watched = Console(file=out, width=100, force_terminal=True, force_interactive=True, color_system=None)
    study.run_render(tiny(), console=watched)
    assert "tracing reference" in out.getvalue()
    assert "tracing reference" not in finished[1]


@pytest.mark.exhaustive
def test_validating_loads_no_matplotlib():
    check = "import atexit, sys; atexit.register(lambda: print('matplotlib' in sys.modules, file=sys.stderr))"
    program = f"{check}\nimport diffshadow.study\nfrom diffshadow.cli import main\nmain(['validate', 'tiny.yaml'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr.splitlines()[-1] == "False"


# Runs the command, and tells the most memory it held; the kernel's figure for children would count a forked parent's.
WATCHED = """
import atexit, re, sys
from pathlib import Path

peak = lambda: re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]
atexit.register(lambda: print(peak(), file=sys.stderr))
from diffshadow.cli import main

main(sys.argv[1:])
"""


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from Linux' /proc")
def test_quickstart_fits_within_its_memory(monkeypatch):
    # As users have it.
    monkeypatch.delenv("JAX_DISABLE_MOST_OPTIMIZATIONS")
    command = [sys.executable, "-c", WATCHED, "fit", str(QUICKSTART)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.splitlines()[-1])
    result = result_of(folder)
    assert result["metrics"]["after"]["rmse"] < 0.4 * result["metrics"]["before"]["rmse"]
    assert result["metrics"]["after"]["false_shadow_rate"] < 1e-3
    assert result["warnings"] == []
    assert int(done.stderr.splitlines()[-1]) < 2 << 20
