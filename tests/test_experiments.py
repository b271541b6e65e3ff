"""Each experiment runs at a tiny size, and its numbers say what its description promises."""

import csv
import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import fit_section, staying_in

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import build_shape, build_technique, load_config, parse_config

ROOT = Path(__file__).parent.parent
SWEEPS = sorted(path for path in (ROOT / "configs").glob("*.yaml") if "\nsweep:" in path.read_text())
PNG = b"\x89PNG\r\n\x1a\n"

SCENE = """
scene:
  meshes:
    - {path: builtin:torus, size: 1, options: {segments: 24, sides: 12}, drop_to_ground: true, translate: [0, 0.2, 0]}
    - {path: builtin:plane, options: {size: 3}}
  camera: {resolution: [48, 48], orbit: {azimuth: 30, elevation: 35, distance: 4}}
  light: {azimuth: -60, elevation: 50, angular_radius: 2}
shadow_map: {resolution: [64, 64]}
bias: {constant: 0.2, slope: 0.2}
filter: {samples: 8, pattern_size: 4, radius: 2}
reference: {samples: 16}
"""
TINY = SCENE + fit_section(bias=6, radius=6, max_steps=8, anneal="{start: 1, end: 0.1, phases: 2}")


@pytest.fixture(autouse=True)
def apart(tmp_path, monkeypatch):
    """Each test in a folder of its own, with the experiments to import."""
    monkeypatch.syspath_prepend(str(ROOT / "experiments"))
    with staying_in(tmp_path):
        Path("tiny.yaml").write_text(TINY)
        yield


def run(experiment: str, *overrides: str, **options: Any) -> dict[str, Any]:
    """What an experiment finds, after a look at its files."""
    found = importlib.import_module(experiment).main(Path("tiny.yaml"), *overrides, **options)
    folder = Path("runs") / f"tiny-{experiment}"
    assert Path(found["folder"]) == folder
    assert {file.name for file in folder.iterdir()} == {f"{experiment}.{end}" for end in ("png", "csv", "json")}
    assert (folder / f"{experiment}.png").read_bytes().startswith(PNG)
    with (folder / f"{experiment}.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row.keys() for row in table] == [row.keys() for row in found["rows"]]
    summary = json.loads((folder / f"{experiment}.json").read_text())
    assert summary["overrides"] == list(overrides)
    assert summary["machine"]["cores"] >= 1
    return found


@pytest.mark.exhaustive
@pytest.mark.parametrize("config", SWEEPS, ids=lambda config: config.stem)
def test_every_sweep_is_valid(config, capsys):
    with pytest.raises(SystemExit) as exit:
        main(["sweep", str(config), "--dry-run"])
    out, err = capsys.readouterr()
    assert exit.value.code == 0, err
    assert "would be done now" in " ".join(out.split())


def by(found, key):
    """A column of what an experiment finds."""
    return np.array([row[key] for row in found["rows"]])


def falls_as_a_seam_does(found):
    errors = dict(zip(by(found, "resolution").tolist(), by(found, "rmse"), strict=True))
    assert found["reference_noise"] == 0, "a hard light's truth is exact"
    assert 0 < errors[128] < errors[64] < 0.5
    assert -1 < found["slopes"]["bilinear"] < -0.2, "about -1/2"


def ends_where_the_landscape_is_lowest(found):
    assert found["ratio"] < 1.03
    assert found["fit"]["rmse"] < 0.9 * found["start"]["rmse"]
    # Over the bias, at every radius.
    acne, leaks = (by(found, key).reshape(7, 7) for key in ("false_shadow", "false_light"))
    assert (np.diff(acne, axis=0) <= 1e-6).all()
    assert (np.diff(leaks, axis=0) >= -1e-6).all()
    assert acne[0].min() > 2 * acne[-1].max()


def nears_the_hard_compare_and_its_gradient(found):
    narrow, middle, wide = found["rows"]
    assert narrow["rmse_to_hard"] < middle["rmse_to_hard"] < wide["rmse_to_hard"]
    assert narrow["rmse_to_truth"] == pytest.approx(found["hard_rmse"], rel=0.1)
    # The radius has a gradient without any softness; that of the bias is right up to the taps' number.
    assert narrow["gradient_error_radius"] < 0.1 < wide["gradient_error_radius"]
    assert middle["gradient_error_bias"] < 0.6 < wide["gradient_error_bias"]


def fits_before_it_times(found):
    nearest, disk = found["rows"]
    assert disk["rmse"] < nearest["rmse"], "a soft shadow wants a filter"
    assert all(row["rmse"] <= row["rmse_before"] and row["milliseconds"] > 0 for row in found["rows"])
    assert (disk["pareto"], nearest["pareto"]) == (True, nearest["milliseconds"] < disk["milliseconds"])


def does_best_where_it_was_fitted(found):
    errors = by(found, "rmse").reshape(2, 2)
    assert found["worst"]["light"] == pytest.approx((errors / errors.diagonal()).max())
    assert (errors >= 0.97 * errors.diagonal()).all()
    assert len(set(by(found, "bias.constant").tolist())) == 2, "suns of different heights want different biases"


def is_measured_on_a_grid_and_on_other_views(found):
    assert set(found["fits"]) == {"mean", "worst"}
    for fitted in found["fits"].values():
        assert fitted["ratio"] == pytest.approx(fitted["fit"]["rmse"] / fitted["grid"]["rmse"])
        assert fitted["ratio"] < 1.1, "a coarse grid is no better"
    single = by(found, "rmse_unseen").mean()
    assert found["validation"]["single view"]["mean"] == pytest.approx(single)
    assert found["gain"]["mean"] == pytest.approx(found["validation"]["joint, mean"]["mean"] / single)


def does_not_change_with_the_scale(found):
    assert by(found, "scale").tolist() == [0.01, 1, 100]
    most = {"picture": 0.01, "rmse before": 1e-3, "rmse after": 1e-2, "bias.constant": 0.05, "filter.radius": 0.05}
    assert all(found["worst"][name] < limit for name, limit in most.items())


def lies_within_the_deviations_that_fits_report(found):
    covered = found["covered"]["directional"]
    assert (covered["fits"], covered["values"] + covered["without"]) == (16, 32)
    # Four of a binomial's standard deviations below 68 % and 95 % of 32.
    assert covered["one"] >= 0.35
    assert covered["two"] >= 0.79
    assert len(set(by(found, "error").tolist())) == 32, "every draw is another"


def is_closer_than_a_visual_hull_and_than_plain_steps(found):
    large, plain, hull = found["rows"]
    assert [row["method"] for row in found["rows"]] == ["large steps", "plain steps", "visual hull"]
    assert large["chamfer"] < min(plain["chamfer"], hull["chamfer"])
    assert large["unseen"] > plain["unseen"]
    assert hull["seen"] > 0.95


FITTED_SUN = (
    "scene.camera={resolution: [48, 48], eye: [0.6, 2.9, 2.4], target: [0.2, 0.1, -0.1], fov_y: 42}",
    "bias={constant: 0.5, plane: {type: receiver_plane, deepening: 0.5}}",
    "scene.meshes=[{path: builtin:torus, size: 1, drop_to_ground: true}, {path: builtin:plane, options: {size: 4}}]",
    *("scene.light.angular_radius=0", "filter={type: bilinear}", "reference={supersampling: 4}"),
    # The draws replace what is fitted.
    "fit={parameters: {scene.light.azimuth: {lower: -95, upper: -15}}, blurs: [3]}",
)
SHAPE = (
    "scene={meshes: [{path: builtin:blob, size: 1.6, options: {subdivisions: 3}}], lights: [{}, {}, {}]}",
    "fit={shape: {screen: below, resolution: [32, 32], unseen: [{azimuth: 57, elevation: 25}, {azimuth: 195, "
    "elevation: 59}], phases: [{strength: 10, rate: 0.1, steps: 40}, {strength: 3, rate: 0.04, steps: 30}], "
    "start: {path: builtin:sphere, size: 1.2, translate: [0, 0.2, 0], options: {subdivisions: 3}}}}",
)
VIEWS = (
    "fit.views={grid: {scene.light.azimuth: [-150, -60, 30]}}",
    "fit.validation={grid: {scene.light.azimuth: [-100, 80]}}",
)
# Overrides, options, and what must be true of what is found.
RUNS: dict[str, tuple[tuple[str, ...], dict[str, Any], Callable[[dict[str, Any]], None]]] = {
    "error_vs_resolution": (
        ("scene.light.angular_radius=0",),
        {"sizes": "64,128", "only": "bilinear"},
        falls_as_a_seam_does,
    ),
    "bias_landscape": ((), {"size": 7}, ends_where_the_landscape_is_lowest),
    "soft_width": (
        (),
        {"kernels": "linear", "widths": 3, "least": 0.02, "most": 8.0, "points": 2, "scale": 0.5},
        nears_the_hard_compare_and_its_gradient,
    ),
    "shootout": ((), {"only": "nearest,disk", "repeats": 3, "most": 1}, fits_before_it_times),
    "generalisation": ((), {"over": "light", "count": 2}, does_best_where_it_was_fitted),
    "many_views": (VIEWS, {"size": 7}, is_measured_on_a_grid_and_on_other_views),
    "scale_invariance": ((), {"scales": "0.01,100"}, does_not_change_with_the_scale),
    "coverage": (
        FITTED_SUN,
        {"lights": "directional", "meshes": "builtin:blob", "draws": 16},
        lies_within_the_deviations_that_fits_report,
    ),
    "shapes": (SHAPE, {"suns": "3", "sizes": "32"}, is_closer_than_a_visual_hull_and_than_plain_steps),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("experiment", RUNS)
def test_an_experiment_finds_what_its_description_promises(experiment):
    overrides, options, holds = RUNS[experiment]
    if experiment == "shapes":
        Path("tiny.yaml").write_text("\n".join(line.replace("=", ": ", 1) for line in overrides))
        overrides = ()
    holds(run(experiment, *overrides, **options))


@pytest.mark.exhaustive
def test_cascades_warps_and_pages_put_texels_where_they_are_seen():
    script, corridor = importlib.import_module("where_texels_go"), (ROOT / "configs" / "corridor.yaml").read_text()
    Path("corridor.yaml").write_text(corridor.replace("resolution: [256, 256]", "resolution: [64, 64]"))
    found = script.main(Path("corridor.yaml"), sizes="512", only="plain,lispsm,perspective,pages,cascades4", frames=2)
    plain, lispsm, perspective, pages, cascades = by(found, "rmse")
    assert perspective < lispsm < 0.8 * plain
    assert cascades < 0.6 * plain
    assert pages < 0.9 * min(lispsm, cascades), "where memory suffices"
    assert by(found, "percentile_99")[1:].max() < 0.5 * found["rows"][0]["percentile_99"]
    assert 0 < by(found, "flicker")[1:].max() < 0.8 * found["rows"][0]["flicker"], "finer texels crawl less"


def test_visual_hull_of_a_box_from_three_sides_is_the_box():
    script = importlib.import_module("shapes")
    lights = "[{azimuth: 0, elevation: 0}, {azimuth: 90, elevation: 0}, {azimuth: 0, elevation: 90}]"
    scene = f"scene: {{meshes: [{{path: builtin:box, size: 1}}], lights: {lights}}}\n"
    plan: Any = build_shape(parse_config(scene + "fit: {shape: {resolution: [64, 64]}}", fitting=True))
    targets = [study.shadow_on(screen, plan.truth) for screen in plan.seen]
    views = [SimpleNamespace(surface=screen.surface()) for screen in plan.seen]
    hull = script.visual_hull(script.Case(plan, SimpleNamespace(views=views), targets))
    np.testing.assert_allclose(hull.bounds, plan.truth.bounds, atol=0.02)


def test_border_of_worchel_and_alexas_target_is_dark():
    script = importlib.import_module("worchel_alexa")
    border = script.their_border()
    # Of their picture, which shows nothing else there: 8-bit values along the diagonal, and along a side.
    np.testing.assert_allclose(255 * border[[0, 1, 2], [0, 1, 2]], [205, 249, 255], atol=1)
    np.testing.assert_allclose(255 * border[128, :3], [240, 253, 255], atol=1)


@pytest.mark.parametrize(
    ("experiment", "arguments", "said"),
    [
        ("bias_landscape", ["tiny.yaml", "--size", "1"], "--size: is 1; expected 2 or more"),
        ("bias_landscape", ["tiny.yaml", "fit.parameters={bias.constant: {lower: 0, upper: 9}}"], "filter.radius"),
        (
            "error_vs_resolution",
            ["tiny.yaml", "--only", "nearest,pfc"],
            "expected some of nearest,silhouettes,bilinear",
        ),
        ("error_vs_resolution", ["tiny.yaml", "--sizes", "64,big"], "expected whole numbers"),
        ("where_texels_go", ["tiny.yaml", "--sizes", "8"], "expected 64 texels or more"),
        ("soft_width", ["tiny.yaml", "--least", "3", "--most", "2"], "less than most, 2.0"),
        ("shootout", ["missing.yaml"], "there is no such file"),
        ("shootout", ["tiny.yaml", "--repeat", "3"], "see --help"),
        ("generalisation", ["tiny.yaml", "scene.camera={eye: [1, 2, 3]}"], "expected an orbit"),
        ("learned_bias", ["tiny.yaml", "--views", "0"], "expected 1 to 10"),
        ("learned_bias", ["tiny.yaml", "scene.camera={eye: [1, 2, 3]}"], "expected an orbit"),
        ("many_views", ["tiny.yaml"], "fit.views: is missing"),
        ("shapes", ["tiny.yaml"], "fit.shape: is missing"),
        ("worchel_alexa", ["."], "expected a clone"),
        ("picture", ["--starts", "0"], "--starts: is 0; expected 1 or more"),
        ("scale_invariance", ["tiny.yaml", "scene.lights=[{}, {}]", "scene.light=null"], "expected one light"),
    ],
)
def test_mistakes_are_reported_in_one_message_and_leave_nothing(experiment, arguments, said, monkeypatch, capsys):
    script = importlib.import_module(experiment)
    monkeypatch.setattr(sys, "argv", [f"{experiment}.py", *arguments])
    with pytest.raises(SystemExit) as exit:
        script.common.start(script.app)
    assert exit.value.code == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert said in told
    assert "Traceback" not in told
    assert not Path("runs").exists()


@pytest.mark.exhaustive
def test_learned_bias_is_measured_exported_and_drawn_again_from_its_configuration():
    script = importlib.import_module("learned_bias")
    few = {name: script.MODELS[name] for name in ("classical, tent", "classical, separable", script.LAST)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(script, "MODELS", few)
        patch.setattr(script, "VALIDATION", script.VALIDATION[:2])
        found = script.main(Path("tiny.yaml"), views=2, steps=5)
    folder = Path(found["folder"])
    assert {file.suffix for file in folder.iterdir()} == {".png", ".csv", ".json", ".glsl", ".yaml"}
    assert [row["numbers"] for row in found["rows"]] == [4, 6, 75]
    assert found["rows"][0]["training"] >= 0
    assert found["rows"][2]["training"] <= found["rows"][1]["training"], "it starts there"
    glsl = (folder / "learned_bias.glsl").read_text()
    assert all(f"float shadow_{name}(" in glsl for name in ("bias", "normal_offset", "filter"))
    # The configuration holds what was trained.
    again = build_technique(load_config(folder / "learned_bias.yaml"))
    problem = found["problems"][0]
    np.testing.assert_allclose(
        script.common.visibility(problem, again), script.common.visibility(problem, found["technique"]), atol=1e-4
    )


@pytest.mark.exhaustive
def test_light_is_recovered_from_its_shadow():
    recover = importlib.import_module("recover_light").main
    # Odd sides cannot be made coarser, which spares a program.
    (row,) = recover("builtin:sphere", lights=["directional"], starts=2, pixels=25, texels=65)
    assert row["median"] == pytest.approx(np.mean(row["errors"]))
    assert max(row["errors"]) == row["greatest"] < 3, "they start 20 degrees off"
    assert row["median"] < 4 * row["deviation"] < 8


@pytest.mark.exhaustive
def test_gallery_shows_each_technique(monkeypatch):
    gallery = importlib.import_module("gallery")
    (name, rows), *_ = gallery.SECTIONS.items()
    shown = [row for row in rows if row.name in ("Nearest", "Silhouette map")]
    monkeypatch.setattr(gallery, "SECTIONS", {name: shown})
    Path("scene.yaml").write_text(SCENE)
    gallery.main(Path("scene.yaml"), page=Path("gallery.md"), repeats=1)
    page = Path("gallery.md").read_text()
    assert [row.name in page for row in shown] == [True, True]
    pictures = list(Path("images/gallery").glob("*.png"))
    assert len(pictures) >= 3, "the reference is one"
    assert all(str(picture) in page for picture in pictures)


@pytest.mark.exhaustive
def test_exact_benchmark_times_every_technique(monkeypatch, capsys):
    options = ["--triangles", "100", "--pixels", "32", "--texels", "64", "--repeats", "1", "--lights", "spot"]
    monkeypatch.setattr(sys, "argv", ["benchmark_exact.py", *options])
    monkeypatch.setenv("COLUMNS", "150")
    importlib.import_module("benchmark_exact").main()
    told = capsys.readouterr().out
    for part in ("spot, 104, 32²", "irregular", "volumes", "reference", "0.0e+00"):
        assert part in told
