"""Sweeps: from a section of the configuration to runs, tables and a figure, however often they are cut short."""

import contextlib
import errno
import gc
import importlib
import io as text_io
import json
import os
import shlex
import socket
import threading
import types
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from rich.console import Console
from scenes import BOX_OVER_PLANE, compiled_programs, staying_in
from tables import cases, is_said

from diffshadow import io, study
from diffshadow.config import Config, ConfigError, SweepConfig, load_config, load_sweep
from diffshadow.config.reading._axes import levels_of
from diffshadow.config.reading._draft import parse_draft
from diffshadow.metrics import flicker
from diffshadow.settings import filters, rules
from diffshadow.study.remarks._layout import frames_remarks
from diffshadow.study.sweeps import _table as tables
from diffshadow.study.sweeps._curves import curves_of
from diffshadow.study.sweeps._run import missing_runs
from diffshadow.study.sweeps._work import drawing_of

pytestmark = pytest.mark.usefixtures("tiny_figures")


BASE = (
    BOX_OVER_PLANE
    + """
filter: {samples: 4}
reference: {samples: 4}
output: runs
"""
)
SWEEP = """
sweep:
  grid:
    filter.pattern: [uniform, sobol]
    filter.radius: [1, 2.5]
  repeats: 2
  limit_samples: 256
  plot: {x: filter.radius, y: rmse_to_limit, lines: filter.pattern}
"""


@pytest.fixture(autouse=True)
def apart(tmp_path):
    """Each test in a folder of its own, with a cache of its own."""
    with staying_in(tmp_path):
        Path("s.yaml").write_text(BASE + SWEEP)
        yield


def sweep_of(section: str, *overrides: str):
    """The sweep of `BASE` with this section."""
    Path("t.yaml").write_text(f"{BASE}sweep: {section}\n")
    return load_sweep(Path("t.yaml"), list(overrides))


def values(sweep) -> list[tuple]:
    return [tuple(run.values.values()) for run in sweep.runs]


def run(sweep, **options) -> tuple[Path, str]:
    """The folder of `sweep`, done in this process, and what was said."""
    out = text_io.StringIO()
    console = Console(file=out, width=120, highlight=False)
    return study.run_sweep(sweep, console=console, workers=0, **options), out.getvalue()


def table(folder: Path):
    return pyarrow.parquet.read_table(folder / "results.parquet").to_pydict()


# From the file to the runs.


def test_axes_nest_in_their_order_and_the_last_changes_first():
    sweep = sweep_of(
        "{list: [{label: a, bias.slope: 1}, {label: b}], grid: {filter.samples: [8, 4]}, "
        "zip: {filter.radius: [1, 2], shadow_map.resolution: [[8, 8], [9, 9]]}, seeds: [7, 3]}"
    )
    axes = ("label", "bias.slope", "filter.samples", "filter.radius", "shadow_map.resolution", "seed")
    assert sweep.settings.axes == axes
    assert len(sweep.runs) == 2 * 2 * 2 * 2
    assert values(sweep)[:3] == [("a", 1, 8, 1, [8, 8], 7), ("a", 1, 8, 1, [8, 8], 3), ("a", 1, 8, 2, [9, 9], 7)]
    assert values(sweep)[-1] == ("b", None, 4, 2, [9, 9], 3)
    config = sweep.runs[2].config
    assert (config.bias.slope, config.filter.samples, config.filter.radius, config.seed) == (1.0, 8, 1 + 1, 7)
    assert config.shadow_map.resolution == (9, 9)
    assert config.sweep is None
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 1


@pytest.mark.parametrize("place", ["runs", "results.parquet"])
def test_a_full_disk_is_one_error_that_says_what_is_kept(place, monkeypatch):
    """Whether a run or a table does not fit: with its path, and how many runs need not be done again."""
    sweep, written = sweep_of("{grid: {filter.radius: [1, 2]}, repeats: 2}"), []
    original_bytes, original_open = Path.write_bytes, Path.open

    def full():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write_bytes(path, content):
        if place == "runs" and path.name == "result.json" and path.parent.parent.name == "runs":
            written.append(path)
            if len(written) > 3:
                full()
        return original_bytes(path, content)

    def opened(path, *mode, **how):
        return full() if path.suffix == ".parquet" and "w" in "".join(mode) else original_open(path, *mode, **how)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    if place != "runs":
        monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(io.FileError) as caught:
        run(sweep)
    said = str(caught.value)
    assert said.startswith(f"cannot write {Path('runs/t-sweep').absolute() / place}")
    assert "No space left on device; expected free space there" in said
    kept = "3 of 4 runs are kept in" if place == "runs" else "4 of 4 runs are kept in"
    assert f"{kept} {Path('runs/t-sweep').absolute()}, and not done again" in said
    # No run is to blame.
    assert all(run_of["status"] == "ok" for run_of in map(_outcome_of, Path("runs/t-sweep/runs").iterdir()))
    monkeypatch.undo()
    assert f"4 of 4 runs are done, {1 if place == 'runs' else 0} of them tried now" in run(sweep)[1]


def _outcome_of(folder: Path):
    return json.loads((folder / "result.json").read_text())


CASCADES = "technique={type: cascades, count: 2, depths: camera}"
NEAR_FAR = ("scene.camera.near=0.5", "scene.camera.far=9")


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ([CASCADES], "scene.camera.near and scene.camera.far are found again for each frame"),
        ([CASCADES, "technique.shadow_distance=5"], "scene.camera.near is found again for each frame"),
        ([CASCADES, *NEAR_FAR], None),
        ([CASCADES, "technique.stabilize=false"], None),
        ([], None),
    ],
)
def test_cascades_that_are_not_stable_from_frame_to_frame_are_remarked_on(overrides, said):
    moving = "{grid: {filter.radius: [1, 2]}, flicker: {count: 2, through: {AXIS: [0, 20]}}}"
    of_camera, of_light = (
        sweep_of(moving.replace("AXIS", axis), *overrides)
        for axis in ("scene.camera.orbit.azimuth", "scene.light.azimuth")
    )
    remarks = list(frames_remarks(of_camera.runs[0].frames))
    assert len(remarks) == (said is not None)
    assert all(said in remark for remark in remarks)
    # Near and far do not follow the light.
    assert list(frames_remarks(of_light.runs[0].frames)) == []


def test_whole_sections_and_their_keys_can_be_set_in_turn():
    sweep = sweep_of("{list: [{bias: {constant: 2}}, {bias: {slope: 3}}], grid: {bias.normal_offset: [0, 1]}}")
    found = [(run.config.bias.constant, run.config.bias.slope, run.config.bias.normal_offset) for run in sweep.runs]
    constant, slope, _ = rules.bias_of(filters.RandomDisk, 2.5)
    assert found == [(2, slope, 0), (2, slope, 1), (constant, 3, 0), (constant, 3, 1)]


@pytest.mark.parametrize("sequence", ["sobol", "halton"])
def test_quasi_random_points_fill_their_box(sequence):
    section = f"{{qmc: {{sequence: {sequence}, count: 32, axes: {{filter.radius: {{lower: 1, upper: 3}}, "
    section += (
        "bias.slope: {lower: 0.01, upper: 100, log: true}, filter.samples: {lower: 4, upper: 64, integer: true}}}}"
    )
    sweep = sweep_of(section)
    radius, slope, samples, _ = np.array(values(sweep)).T
    # As many on each side of the middle, that of the logarithm where that is what counts.
    for below in (radius < 2, slope < 1, samples < 34):
        assert abs(int(below.sum()) - 16) <= 2
    for column, least, most in ((radius, 1, 3), (slope, 0.01, 100), (samples, 4, 64)):
        assert least <= column.min() < column.max() <= most
    assert all(isinstance(run.config.filter.samples, int) for run in sweep.runs)
    assert values(sweep) == values(sweep_of(section))
    assert values(sweep) != values(sweep_of(section, "sweep.qmc.seed=1"))


def test_ids_are_of_what_a_run_computes_and_of_nothing_else(tmp_path):
    ids = lambda *overrides: [run.id for run in load_sweep(Path("s.yaml"), list(overrides)).runs]
    plain = ids()
    assert len(set(plain)) == 8
    assert ids("name=other", "output=elsewhere", "sweep.csv=true") == plain
    # Another order and other runs beside it.
    assert set(plain) < set(ids("sweep.grid={filter.radius: [4, 2.5, 1], filter.pattern: [sobol, uniform]}"))
    assert not set(plain) & set(ids("bias.slope=1.33"))
    assert not set(plain) & set(ids("sweep.limit_samples=512"))
    # A mesh counts by its content, not by its name.
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "b.obj").write_bytes((tmp_path / "a.obj").read_bytes())
    (tmp_path / "c.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n")
    a, b, c = (ids(f"scene.meshes.0={{path: {name}.obj}}") for name in "abc")
    assert a == b
    assert not set(a) & set(c)


# Each fault: the section, the line's key, what is said.
FAULTS = cases("""
{grid: {filter.sampels: [1]}}
    t.yaml:12: filter.sampels: is not a key of filter (type: random_disk)…did you mean 'samples'?
↵  grid:↵    filter.radius: [1,↵      -2]
    t.yaml:15: filter.radius: is -2; expected a number at least 0 and at most 8192, in texels…(first in the run with
    filter.radius = -2, seed = 0)
{zip: {filter.radius: [1, 2], filter.samples: [4]}}
    sweep.zip.filter.samples: has 1 values, and filter.radius has 2…make them equally long
{grid: {filter.radius: [1]}, zip: {filter.radius: [2]}}
    sweep.zip.filter.radius: sets filter.radius, and sweep.grid.filter.radius sets filter.radius…remove one of them
{list: [{filter.radius: 1}], grid: {filter: [{type: pcf}]}}
    sweep.grid.filter: sets filter, and sweep.list.0.filter.radius sets filter.radius…every value set once
{grid: {seed: [1]}, repeats: 2}
    sweep.repeats: sets seed…sweep.grid.seed sets seed
{grid: {filter.radius: [1, 1]}}
    sweep.grid.filter.radius: holds 1 twice…remove one
{grid: {output: [a, b]}}
    sweep.grid.output: is the same for all runs…set it outside of sweep
{figures: true}
    t.yaml:12: sweep: sweeps no key…add 'grid:
{gird: {}, repeats: 2}
    sweep.gird: is not a key of sweep…did you mean 'grid'?
{qmc: {count: 4, axes: {bias.slope: {lower: 0, upper: 1, log: true}}}}
    sweep.qmc.axes.bias.slope.lower: is 0 on a logarithmic scale…greater than 0
{repeats: 2, grid: {filter.radius: [1]}, plot: {x: filter.radus}}
    sweep.plot.x: is 'filter.radus', which is not swept…did you mean 'filter.radius'?
{repeats: 2, plot: {x: seed, y: rmse_to_limit}}
    sweep.plot.y: is 'rmse_to_limit'…rmse, mae
{limit_samples: 64, grid: {filter: [{type: pcf}]}}
    sweep.limit_samples: is given, but there are runs of technique shadow_map with filter pcf…expected shadow_map with
    random_disk
{repeats: 2, flicker: {count: 2, through: {bias.constant: [0, 1]}}}
    sweep.flicker.through.bias.constant: is neither the camera's nor a light's…keys within scene.camera, scene.light
{grid: {scene.light.azimuth: [0, 1]}, flicker: {count: 2, through: {scene.light.azimuth: [0, 1]}}}
    moves scene.light.azimuth, and sweep.grid.scene.light.azimuth sets it…remove one of them
{repeats: 2, flicker: {count: 3, through: {scene.light.elevation: [80, 100]}}}
    t.yaml:12: scene.light.elevation: is 100…expected a number
{list: [{label: a}, {bias.slope: 1}]}
    sweep.list.1: has no label…for all or none
""")


@pytest.mark.parametrize(("section", "said"), FAULTS)
def test_faults_are_reported_with_their_place_before_anything_runs(section, said):
    with pytest.raises(ConfigError) as caught:
        sweep_of(section)
    assert is_said(said, str(caught.value))


def test_faults_of_the_plot_hide_none_of_the_runs():
    with pytest.raises(ConfigError) as caught:
        sweep_of("{grid: {filter.radus: [1]}, plot: {x: filter.radius}}")
    assert [problem.key for problem in caught.value.mistakes] == ["sweep.plot.x", "filter.radus"]


def test_faults_of_all_runs_are_reported_at_once_and_once_each():
    with pytest.raises(ConfigError) as caught:
        sweep_of("{grid: {filter.samples: [4, x], filter.radius: [-1, 1]}, repeats: 3}", "bias.slope=-1")
    assert [problem.key for problem in caught.value.mistakes] == ["filter.radius", "filter.samples", "bias.slope"]
    # What is wrong in every run is not said to be of one.
    assert "first in the run" not in caught.value.mistakes[-1].message


def test_overrides_reach_what_is_swept():
    section = "{list: [{label: a}, {label: b}], grid: {filter.radius: [1, 2]}, qmc: {count: 2, axes: {}}}"
    sweep = sweep_of(
        section,
        "sweep.grid.filter.samples=[4, 8]",
        "sweep.grid.filter.radius.1=3",
        "sweep.list.1.bias.slope=2",
        "sweep.qmc.axes.bias.constant={lower: 1, upper: 2}",
        "sweep.qmc.axes.bias.constant.upper=1.5",
        "sweep.zip.scene.camera.resolution=[[8, 8]]",
    )
    found = sweep.settings
    assert found.grid == {"filter.radius": (1, 3), "filter.samples": (4, 8)}
    assert found.list == ({"label": "a"}, {"label": "b", "bias.slope": 2})
    assert found.qmc is not None
    assert found.qmc.axes["bias.constant"].upper == 1.5
    assert sweep.runs[0].config.scene.camera.resolution == (8, 8)
    assert len(sweep.runs) == 2 * 2 * 2 * 2


def test_bounds_of_a_parameter_can_be_swept():
    pose = "fit.parameters.scene.light.azimuth"
    swept = f"{{run: fit, grid: {{{pose}.upper: [70, 80]}}}}"
    sweep = sweep_of(swept, f"{pose}={{initial: 55, lower: 50, upper: 65}}", "filter.lookup=bilinear")
    assert [run.config.fit.parameters["scene.light.azimuth"].upper for run in sweep.runs] == [70, 80]


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("sweep.grid.filter.sampels=[4, 8]", "filter.sampels: is not a key of filter (type: random_disk)"),
        ("sweep.gird.filter.samples=[4, 8]", "sweep.gird: is not a key of sweep"),
        ("sweep.grid.filter.samples=4", "sweep.grid.filter.samples: is 4; expected a list of values"),
        ("sweep.grid.filter.radius.9=4", "sweep.grid.filter.radius.9: index 9 is out of range"),
        (
            "sweep.qmc.axes.bias.slope.uper=3",
            "sweep.qmc.axes.bias.slope.uper: is not a key of sweep.qmc.axes.bias.slope",
        ),
    ],
)
def test_typo_in_an_override_of_what_is_swept_is_reported(override, said):
    section = "{grid: {filter.radius: [1]}, qmc: {count: 2, axes: {bias.slope: {lower: 1, upper: 2}}}}"
    with pytest.raises(ConfigError) as caught:
        sweep_of(section, override)
    assert f"override {override!r}: {said}" in str(caught.value)


def test_million_runs_are_counted_without_making_them(monkeypatch):
    from diffshadow.config.reading import _sweep_runs as sweep_runs

    made = []
    check = sweep_runs.checked
    monkeypatch.setattr(sweep_runs, "checked", lambda *args, **options: made.append(1) or check(*args, **options))
    Path("t.yaml").write_text(f"{BASE}sweep: {{grid: {{filter.radius: [1, 2, 3, 4]}}, qmc: {QMC}, repeats: 4096}}\n")
    sweep = load_sweep(Path("t.yaml"), check=False)
    assert len(sweep.runs) == 4 * 64 * 4096 == 2**20
    out = text_io.StringIO()
    study.print_plan(Console(file=out, width=120), sweep)
    assert len(made) < 20
    assert "1,048,576 runs, too many to check each of them here" in out.getvalue()
    assert out.getvalue().endswith("The first are listed above\n")
    assert len([line for line in out.getvalue().splitlines() if "bias.slope = " in line]) == 8
    # Any of them can be had.
    last = sweep.runs[-1]
    assert (last.values["filter.radius"], last.values["seed"]) == (4, 4095)
    assert last.config.bias.slope == last.values["bias.slope"]
    with pytest.raises(ConfigError, match=r"t\.yaml:12: sweep: makes 2,097,152 runs; expected at most 1,048,576"):
        load_sweep(Path("t.yaml"), ["sweep.repeats=8192"])


QMC = "{count: 64, axes: {bias.slope: {lower: 0, upper: 4}}}"


def test_runs_of_a_large_sweep_are_those_of_a_small_one(monkeypatch):
    section = "{list: [{label: a, bias.slope: 1}, {label: b}], grid: {filter.radius: [1, 2, 3]}, repeats: 4}"
    small = sweep_of(section)
    monkeypatch.setattr("diffshadow.config.reading._sweep_runs._MAX_KEPT", 0)
    monkeypatch.setattr("diffshadow.config.reading._sweep_runs._MAX_PICKLED", 0)
    told = []
    Path("t.yaml").write_text(f"{BASE}sweep: {section}\n")
    large = load_sweep(Path("t.yaml"), progress=lambda done, total: told.append((done, total)))
    assert told == [(done, 24) for done in range(1, 25)]
    assert list(large.runs) == list(small.runs)
    assert large.runs[5] is not large.runs[5]
    assert large.runs[3:20:4] == small.runs[3:20:4]
    assert large.runs[20:3:-4] == small.runs[20:3:-4]
    assert list(large.runs.at([2, 3, 11, 23])) == [small.runs[i] for i in (2, 3, 11, 23)]
    assert [large.runs.id(i) for i in range(24)] == [run.id for run in small.runs]
    for axis in small.settings.axes:
        assert large.runs.column(axis) == [run.values[axis] for run in small.runs]
        assert large.runs.choices(axis) == list(dict.fromkeys(v for v in large.runs.column(axis) if v is not None))
    with pytest.raises(IndexError):
        large.runs[24]


def test_axes_without_a_choice_may_be_many():
    """They are one level, for each level is a call inside another."""
    settings = SweepConfig(grid={f"a{i}": (i, -i) if i == 700 else (i,) for i in range(1500)}, repeats=1)
    draft = parse_draft("seed: 5", [], source="s.yaml", folder=".", name="s")
    before, chosen, after = levels_of(settings, draft)
    assert [len(level) for level in (before, chosen, after)] == [1, 2, 1]
    assert dict(before[0].values) == {f"a{i}": i for i in range(700)}
    assert after[0].values == {**{f"a{i}": i for i in range(701, 1500)}, "seed": 5}
    assert after[0].paths["a800"] == ("sweep", "grid", "a800", 0)


def test_single_runs_refuse_a_sweep_unless_it_is_taken_away():
    with pytest.raises(
        ConfigError, match=r"s\.yaml:\d+: sweep: makes this file a sweep of many runs.*diffshadow sweep.*sweep=null"
    ):
        load_config(Path("s.yaml"))
    assert isinstance(load_config(Path("s.yaml"), ["sweep=null"]), Config)
    with pytest.raises(ConfigError, match=r"sweep: is missing; .*diffshadow render"):
        load_sweep(Path("s.yaml"), ["sweep=null"])


# From the runs to the table.


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One finished sweep that several tests look at: itself, its folder and what was printed."""
    with staying_in(tmp_path_factory.mktemp("finished")):
        Path("s.yaml").write_text(BASE + SWEEP)
        sweep = load_sweep(Path("s.yaml"), ["sweep.csv=true", "scene.camera.resolution=[64, 64]"])
        folder, said = run(sweep)
        return sweep, folder, said


def measured(config) -> dict[str, float | int]:
    """What a render that takes no time has measured."""
    errors = dict.fromkeys(("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"), 0.25)
    rmse = (config.filter.radius + config.seed) / 99
    return {**errors, "rmse": rmse, "rmse_to_limit": 1.0, "reference_noise_floor": 0.0, "pixels": 99}


@pytest.fixture
def quick(finished, monkeypatch):
    """Counts the runs that are done, which take no time here: their ids as they come."""
    from diffshadow.study.sweeps import _work as sweep_work

    done: list[str] = []

    def measure(config, batch, progress):
        done.append(next(run.id for run in batch.runs if run.config is config))
        return measured(config)

    monkeypatch.setitem(sweep_work._MEASURES, "render", measure)
    return done


def test_table_has_a_row_for_each_run_in_order(finished):
    sweep, folder, said = finished
    columns = table(folder)
    assert columns["run"] == list(range(8))
    assert columns["id"] == [run.id for run in sweep.runs]
    assert columns["status"] == ["ok"] * 8
    assert columns["error"] == [None] * 8
    assert columns["filter.pattern"] == ["uniform"] * 4 + ["sobol"] * 4
    assert columns["filter.radius"] == [1.0, 1.0, 2.5, 2.5] * 2
    assert columns["seed"] == [0, 1] * 4
    for name in ("rmse", "ssim", "rmse_to_limit", "reference_noise_floor"):
        assert all(isinstance(value, float) and value > 0 for value in columns[name])
    assert "8 of 8 runs are done, 8 of them tried now" in said
    assert (folder / "plot.png").read_bytes().startswith(b"\x89PNG")
    lines = (folder / "results.csv").read_text().splitlines()
    assert lines[0].replace('"', "").split(",") == list(columns)
    assert len(lines) == 9
    timings = pyarrow.parquet.read_table(folder / "timings.parquet").to_pydict()
    assert timings["id"] == columns["id"]
    assert all(seconds > 0 for seconds in timings["total"])
    assert not set(timings) & set(columns) - {"run", "id"}


def test_flicker_is_measured_along_a_path():
    """From frame to frame, as `metrics.flicker` of what renders of the frames show; a bias of 0 crawls most."""
    path = "{count: 2, through: {scene.light.azimuth: [-150, -148]}}"
    section = f"{{grid: {{bias.constant: [0, 4]}}, flicker: {path}, plot: {{x: bias.constant, y: flicker}}}}"
    sweep = sweep_of(section, "bias.slope=0.5")
    assert [frame.scene.light.azimuth for frame in sweep.runs[0].frames] == [-150, -148]
    assert sweep.runs[0].id != sweep_of("{grid: {bias.constant: [0, 4]}}", "bias.slope=0.5").runs[0].id
    found = table(study.run_sweep(sweep, console=Console(quiet=True), workers=0))["flicker"]
    render = lambda frame: study.read_run(study.run_render(frame, console=Console(quiet=True))).lights[0]
    lights = map(render, sweep.runs[0].frames)
    frames = zip(*((each.images[0][1], each.reference, each.mask) for each in lights), strict=True)
    assert found[0] == pytest.approx(flicker(*map(np.stack, frames)), rel=1e-5)
    assert found[0] > 2 * found[1] > 0


def test_run_folder_says_what_was_done_and_does_it_again(finished):
    sweep, folder, _ = finished
    record = json.loads((folder / "result.json").read_text())
    assert shlex.split(record["command"]) == [
        "diffshadow",
        "sweep",
        str(folder.parent.parent / "s.yaml"),
        *sweep.overrides,
    ]
    assert sorted(entry.name for entry in (folder / "runs").iterdir()) == sorted(run.id for run in sweep.runs)
    first = folder / "runs" / sweep.runs[3].id
    assert sorted(entry.name for entry in first.iterdir()) == ["config.yaml", "result.json"]
    assert sum(entry.stat().st_size for entry in first.iterdir()) < 6000
    assert load_config(first / "config.yaml") == sweep.runs[3].config
    result = json.loads((first / "result.json").read_text())
    assert result["metrics"]["rmse"] == table(folder)["rmse"][3]


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("kind", "where", "images", "end"), [("render", "_render", 1, "-render"), ("fit", "_visibility", 2, "")]
)
def test_figures_are_of_the_same_run_as_the_numbers(kind, where, images, end, monkeypatch):
    module = importlib.import_module(f"diffshadow.study.runs.{where}")
    drawn, draw = [], module.visibility_of
    monkeypatch.setattr(module, "visibility_of", lambda *args: drawn.append(draw(*args)) or drawn[-1])
    # By the programs of the tests of fits.
    solver = "{max_steps: 60, rtol: 1e-4, atol: 1e-7}"
    parameters = "{bias.constant: {lower: 0, upper: 8}, filter.radius: {lower: 0, upper: 8}}"
    brief = [f"fit={{parameters: {parameters}, solver: {solver}, anneal: {{phases: 1}}}}"]
    sweep = sweep_of(f"{{run: {kind}, figures: true, grid: {{filter.radius: [1]}}}}", *brief)
    folder, _ = run(sweep)
    assert table(folder)["status"] == ["ok"]
    assert len(drawn) == images
    (figures,) = (folder / "figures").iterdir()
    assert figures.name == sweep.runs[0].id + end
    assert (figures / "report.html").is_file()
    assert load_config(figures / "config.yaml").filter == sweep.runs[0].config.filter
    done = folder / "runs" / sweep.runs[0].id
    assert (done / "fitted.yaml").exists() == (kind == "fit")
    stored, columns = json.loads((figures / "result.json").read_text())["metrics"], table(folder)
    if kind == "render":
        assert columns["rmse"] == [stored["errors"]["rmse"]]
    else:
        assert columns["after.rmse"] == [stored["after"]["rmse"]]
        assert load_config(done / "fitted.yaml").bias == load_config(figures / "fitted.yaml").bias


@pytest.mark.exhaustive
def test_error_against_the_limit_is_that_of_the_same_filter(finished, monkeypatch):
    """Against the mean over 64 patterns of 1024 uniform taps, which is another estimate of the same integral."""
    from diffshadow.config import build_technique
    from diffshadow.study.runs import _setup as setup
    from diffshadow.study.runs._progress import Progress

    sweep, folder, _ = finished
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(folder.parent.parent / "cache"))
    config, progress = sweep.runs[2].config, Progress(Console(quiet=True))
    own = build_technique(config, fitting=False)
    (drawn,) = setup.draw(config, setup.load(config, progress), own, progress)
    many = config.filter.model_copy(update={"samples": 256, "pattern": "uniform"})
    of_seed = lambda s: build_technique(config.model_copy(update={"filter": many, "seed": s}), fitting=False)
    mean = np.mean([setup.visibility_of(of_seed(seed), drawn) for seed in range(64)], axis=0, dtype=np.float64)
    away = (setup.visibility_of(own, drawn) - mean)[drawn.mask]
    # The limit's own error, with 256 taps as against 4, is an eighth at most.
    assert table(folder)["rmse_to_limit"][2] == pytest.approx(np.sqrt(np.mean(away**2)), rel=0.03)


def test_runs_of_one_shape_share_programs_and_drawings(finished, monkeypatch):
    _, folder, _ = finished
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(folder.parent.parent / "cache"))
    with compiled_programs() as compiled:
        # Other seeds, patterns and radii than before.
        again = load_sweep(
            folder.parent.parent / "s.yaml",
            ["seed=5", "sweep.grid={filter.pattern: [halton, poisson], filter.radius: [0.7, 3]}"],
        )
        _, said = run(again)
    assert "8 of 8 runs are done, 8 of them tried now" in said
    assert compiled == []
    timings = pyarrow.parquet.read_table(Path("runs/s-sweep/timings.parquet")).to_pydict()
    # One drawing for each seed, since that is also the reference's.
    assert sum(seconds is not None for seconds in timings["drawing"]) == 2


@pytest.mark.parametrize(("technique", "count"), [("shadow_map", 1), ("cascades", 2)])
def test_a_map_is_drawn_again_only_if_its_margin_follows_the_filter(technique, count):
    sweep = sweep_of("{grid: {filter.radius: [1, 12], bias.constant: [0, 2]}}", f"technique={{type: {technique}}}")
    assert len({drawing_of(run.config) for run in sweep.runs}) == count


def test_sweep_that_is_started_again_does_only_what_is_missing(quick):
    sweep = load_sweep(Path("s.yaml"))
    folder, said = run(sweep, limit=3)
    assert sorted(quick) == sorted(run.id for run in sweep.runs[:3])
    assert "3 of 8 runs are done, 3 of them tried now" in said
    assert "run the same command again to do the rest" in said
    assert table(folder)["status"] == ["ok"] * 3 + ["missing"] * 5
    run(sweep)
    assert sorted(quick) == sorted(run.id for run in sweep.runs)
    before = {entry: entry.stat().st_mtime_ns for entry in (folder / "runs").rglob("*")}
    bytes_before = (folder / "results.parquet").read_bytes()
    run(sweep)
    assert len(quick) == 8
    assert {entry: entry.stat().st_mtime_ns for entry in (folder / "runs").rglob("*")} == before
    assert (folder / "results.parquet").read_bytes() == bytes_before
    # More seeds: those that are there count.
    run(load_sweep(Path("s.yaml"), ["sweep.repeats=3"]))
    assert len(quick) == 12


def test_sweep_in_parts_gives_the_same_table(quick, monkeypatch):
    whole, _ = run(load_sweep(Path("s.yaml")))
    monkeypatch.setattr("diffshadow.config.reading._sweep_runs._MAX_KEPT", 0)
    monkeypatch.setattr("diffshadow.study.sweeps._run._MAX_AT_ONCE", 3)
    parts, _ = run(load_sweep(Path("s.yaml"), ["output=other"]))
    assert len(quick) == 16
    assert (parts / "results.parquet").read_bytes() == (whole / "results.parquet").read_bytes()


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_columns_are_read_as_they_were_written(suffix, monkeypatch):
    """Whole numbers, gaps, and text that looks like numbers."""
    monkeypatch.setattr(tables, "_has_arrow", lambda: suffix == ".parquet")
    grid = "filter.radius: [2, 1.5], shadow_map.resolution: [[8, 8], [9, 9]]"
    labels = """[{label: "0.10", seed: 7}, {label: 'say "1", 2'}]"""
    sweep = sweep_of(f"{{list: {labels}, grid: {{{grid}}}}}")
    found = tables.gather(sweep, Path())
    tables.write_tables(Path(), sweep, found)
    assert tables.table_of(Path()) == Path(f"results{suffix}")
    rows = tables.rows_of(tables.read_columns(Path(f"results{suffix}")))
    assert rows == tables.rows_of(found.results)
    columns = ("run", "label", "filter.radius", "shadow_map.resolution", "status", "error")
    assert [rows[5][name] for name in columns] == [5, 'say "1", 2', 2, "[9, 9]", "missing", None]


def test_sweep_without_pyarrow_has_the_same_page(quick, monkeypatch):
    folder, _ = run(load_sweep(Path("s.yaml")))
    page, rows = (folder / "report.html").read_text(), table(folder)
    monkeypatch.setattr(tables, "_has_arrow", lambda: False)
    assert "all are in results.csv" in run(load_sweep(Path("s.yaml")))[1]
    # An outdated table would be read where pyarrow is installed.
    assert sorted(path.name for path in folder.glob("*.[cp]*")) == ["plot.png", "results.csv", "timings.csv"]
    assert (folder / "report.html").read_text() == page
    header, first, *_ = (folder / "results.csv").read_text().splitlines()
    assert header.startswith('"run","id","status","error","filter.pattern","filter.radius"')
    assert first.startswith(f'0,"{rows["id"][0]}","ok","","{rows["filter.pattern"][0]}",{rows["filter.radius"][0]}')
    (folder / "results.csv").write_text(header + "\n" + first.replace('"ok"', "7") + "\n")
    with pytest.raises(io.FileError, match="its column status holds 7; expected text"):
        study.report(folder)
    (folder / "results.csv").rename(folder / "results.parquet")
    with pytest.raises(io.FileError, match=r"results.parquet needs the package pyarrow.*pip install pyarrow"):
        study.report(folder)


def test_failed_run_stops_no_other_and_is_tried_again(quick, monkeypatch):
    from diffshadow.study.sweeps import _work as sweep_work

    sweep, well = load_sweep(Path("s.yaml")), sweep_work._MEASURES["render"]

    def ill(config, batch, progress):
        measured = well(config, batch, progress)
        if config.seed == 1 and config.filter.radius == 1:
            raise RuntimeError("out of luck")
        return measured

    monkeypatch.setitem(sweep_work._MEASURES, "render", ill)
    folder, said = run(sweep)
    columns = table(folder)
    assert columns["status"] == ["ok", "failed", "ok", "ok"] * 2
    assert columns["error"][1] == "RuntimeError: out of luck"
    assert columns["rmse"][1] is None
    assert "2 runs failed; the same command tries them again: RuntimeError: out of luck" in said
    monkeypatch.setitem(sweep_work._MEASURES, "render", well)
    del quick[:]
    run(sweep)
    assert quick == [sweep.runs[1].id, sweep.runs[5].id]
    assert table(folder)["status"] == ["ok"] * 8


def test_drafts_of_killed_runs_are_cleared_away(quick):
    sweep = load_sweep(Path("s.yaml"))
    draft = Path("runs/s-sweep/runs") / f".{sweep.runs[0].id}-0123456789ab"
    run(sweep, limit=1)
    draft.mkdir()
    (draft / "config.yaml").write_text("half")
    # Half of a result, as a disk that ran full leaves it, is none.
    (Path("runs/s-sweep/runs") / sweep.runs[0].id / "result.json").write_text('{"id": ')
    assert missing_runs(sweep, Path("runs/s-sweep")) == list(range(8))
    run(sweep)
    assert len(quick) == 9
    assert not draft.exists()


def test_one_sweep_is_done_by_one_process_at_a_time(quick):
    import fcntl

    sweep = load_sweep(Path("s.yaml"))
    run(sweep)
    with Path("runs/s-sweep/.lock").open("w") as lock:
        # The weaker lock, which only an exclusive one minds.
        fcntl.flock(lock, fcntl.LOCK_SH)
        with pytest.raises(ValueError, match="another process is doing the sweep"):
            run(sweep)


def test_folder_that_is_no_sweep_is_left_alone(quick):
    Path("runs/s-sweep").mkdir(parents=True)
    Path("runs/s-sweep/precious.txt").write_text("mine")
    with pytest.raises(ConfigError, match="is not a run's folder"):
        run(load_sweep(Path("s.yaml")))
    assert quick == []


def test_plan_is_printed_and_nothing_written(finished):
    out = text_io.StringIO()
    study.print_plan(Console(file=out, width=120), load_sweep(Path("s.yaml")), 2)
    assert "filter.pattern = uniform, filter.radius = 1, seed = 1" in out.getvalue()
    assert "8 runs; 0 are done; 2 would be done now" in out.getvalue()
    assert not Path("runs").exists()


def test_a_plan_shows_labels_instead_of_their_sections():
    section = "{list: [{label: a, bias: {slope: 1}}, {label: b}], grid: {filter: [{type: nearest}, {type: tent}]}}"
    out = text_io.StringIO()
    study.print_plan(Console(file=out, width=120), sweep_of(section))
    lines = [line for line in out.getvalue().splitlines() if " = " in line]
    assert len(lines) == 4
    assert all("bias" not in line for line in lines)
    assert 'label = a, filter = {"type": "nearest"}, seed = 0' in lines[0]


# Curves.


def columns_of(slopes: dict[str, float], seeds: int = 3) -> dict[str, list]:
    """A table of errors that fall with these slopes, scattered about them by seed."""
    rows = [(line, n, seed) for line in slopes for n in (4, 16, 64) for seed in range(seeds)]
    return {
        "line": [line for line, _, _ in rows],
        "n": [n for _, n, _ in rows],
        "seed": [seed for _, _, seed in rows],
        "rmse": [n ** (slopes[line] + 0.01 * (seed - 1)) for line, n, seed in rows],
        "mae": [float(seed) for _, _, seed in rows],
    }


def test_slopes_are_those_of_the_errors():
    from diffshadow.config import PlotConfig

    curves = curves_of(columns_of({"a": -0.5, "b": -0.75}), PlotConfig(x="n", y="rmse", lines="line"))
    assert [curve.line for curve in curves] == ["a", "b"]
    for curve, slope in zip(curves, (-0.5, -0.75), strict=True):
        assert curve.slope == pytest.approx(slope, abs=2e-3)
        # Slopes of the seeds are 0.01 apart.
        assert curve.error == pytest.approx(0.01 / np.sqrt(3), rel=1e-6)
    # The mean over seeds is that of squares for an RMSE, and plain for others.
    np.testing.assert_allclose(curves[0].y[0], np.sqrt(np.mean([4.0 ** (-1 + 0.02 * k) for k in (-1, 0, 1)])))
    (flat,) = curves_of(columns_of({"a": -0.5}), PlotConfig(x="n", y="mae"))
    np.testing.assert_allclose(flat.y, 1.0)
    with pytest.raises(ValueError, match="no run has the metric 'ssim'"):
        curves_of(columns_of({"a": -0.5}), PlotConfig(x="n", y="ssim"))


# Workers.


@pytest.fixture
def cluster():
    """A Dask cluster of one worker in this process, which has all programs."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0") as made:
        yield made.scheduler_address


def test_cluster_gives_the_same_table(finished, cluster):
    _, folder, _ = finished
    sweep = load_sweep(Path("s.yaml"))
    there = study.run_sweep(sweep, console=Console(quiet=True), scheduler=cluster)
    assert (there / "results.parquet").read_bytes() == (folder / "results.parquet").read_bytes()


def test_cluster_is_given_only_as_many_batches_as_keep_it_busy(cluster, monkeypatch):
    from distributed import Client

    from diffshadow.study.sweeps import _pool as sweep_pool
    from diffshadow.study.sweeps._work import Batch

    taken = []

    def batches():
        for number in range(40):
            taken.append(number)
            yield Batch("", *[None] * (len(Batch._fields) - 1))

    monkeypatch.setattr(sweep_pool, "work", lambda batch: [batch])
    with Client(cluster) as client:
        for done, _ in enumerate(sweep_pool.OnCluster(client).outcomes(batches())):
            assert len(taken) - done <= sweep_pool._BATCHES_AHEAD
    assert len(taken) == 40


def test_run_that_kills_its_worker_is_distinguished_from_the_others(quick, cluster, monkeypatch):
    from distributed import KilledWorker

    from diffshadow.study.sweeps import _apart as sweep_apart
    from diffshadow.study.sweeps._work import do

    sweep = load_sweep(Path("s.yaml"))

    def deadly(batch, run):
        if run.id == sweep.runs[5].id:
            raise KilledWorker("work", types.SimpleNamespace(address="tcp://there"), 3)
        return do(batch, run)

    monkeypatch.setattr(sweep_apart, "do", deadly)
    monkeypatch.setattr("diffshadow.study.sweeps._run._BATCHES_PER_WORKER", 2)
    folder = study.run_sweep(sweep, console=Console(quiet=True), scheduler=cluster)
    columns = table(folder)
    assert columns["status"] == ["ok"] * 5 + ["failed"] + ["ok"] * 2
    assert "its worker died" in columns["error"][5]


def test_missing_scheduler_is_reported(quick, monkeypatch):
    monkeypatch.setattr("diffshadow.study.sweeps._pool._CONNECT_TIMEOUT", 1)
    with pytest.raises(ValueError, match=r"no Dask scheduler at 'tcp://127\.0\.0\.1:1'.*dask scheduler"):
        study.run_sweep(load_sweep(Path("s.yaml")), console=Console(quiet=True), scheduler="tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    ("answer", "said"), [(b"HTTP/1.1 400 Bad Request\r\n\r\n", ""), (b"", "the server there does not answer")]
)
def test_what_is_no_scheduler_is_reported(answer, said, quick, monkeypatch):
    from distributed import Client

    monkeypatch.setattr("diffshadow.study.sweeps._pool._ANSWER_TIMEOUT", 60 if answer else 1)
    monkeypatch.setattr("diffshadow.study.sweeps._interrupts._EXIT_TIMEOUT_INTERRUPTED", 0.1)
    kept = []

    def serve(server):
        with contextlib.suppress(OSError):
            while True:
                kept.append(server.accept()[0])
                kept[-1].sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, args=(server,), daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ValueError, match=f"there is no Dask scheduler at '{address}'.*{said}.*dask scheduler"):
            study.run_sweep(load_sweep(Path("s.yaml")), console=Console(quiet=True), scheduler=address)
    for each in kept:
        each.close()
    for thread in threading.enumerate():
        if thread.name == "diffshadow pool":
            thread.join()
    # A client that is left open waits for a lock when it is garbage collected.
    assert {each.status for each in gc.get_objects() if isinstance(each, Client)} <= {"closed"}


def test_sweep_whose_workers_are_gone_ends_with_what_to_do(quick, monkeypatch):
    from distributed import Client, LocalCluster

    from diffshadow.study.sweeps import _pool as sweep_pool
    from diffshadow.study.sweeps._work import Batch

    monkeypatch.setattr(sweep_pool, "_WORKERS_TIMEOUT", 0.2)
    batch = Batch(*[None] * len(Batch._fields))
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address="127.0.0.1:0") as none,
        Client(none) as client,
        pytest.raises(ConnectionError, match=r"all Dask workers are gone.*start the sweep again"),
    ):
        next(sweep_pool.OnCluster(client).outcomes([batch]))


def children(process: int) -> list[int]:
    return [
        int(child)
        for task in Path(f"/proc/{process}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
