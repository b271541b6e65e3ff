"""The command line: exit codes, messages, and how soon they come."""

import os
import re
import shlex
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from rich.table import Table
from scenes import marked

import diffshadow.study
from diffshadow.cli import main
from diffshadow.cli._jax import join_processes
from diffshadow.config import Config, load_config
from diffshadow.console import WIDTH_OF_FILES, Command, Console, print_next, print_table, source
from diffshadow.shadow import EngineSetting
from diffshadow.study.pages._table import print_rows, print_settings
from diffshadow.study.runs._check import Checked

QUICKSTART = Path(__file__).parent.parent / "configs" / "quickstart.yaml"


def run(*arguments: object) -> int:
    """The exit code of the command, run in this process."""
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    assert isinstance(caught.value.code, int)
    return caught.value.code


def process(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, in `folder`."""
    command = [sys.executable, "-m", "diffshadow", *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def runner(monkeypatch):
    """Stands in for `run_fit` and `run_render`; holds the configurations it was given, and `debug` after one."""
    seen: list[Config | str] = []

    def work(config, *, console, debug=False):
        console.print("working")
        seen.append(config)
        seen.extend(["debug"] if debug else [])
        return Path("runs/a folder of a name so long that a terminal of eighty columns would have to wrap it somewhere")

    monkeypatch.setattr(diffshadow.study, "run_fit", work, raising=False)
    monkeypatch.setattr(diffshadow.study, "run_render", work, raising=False)
    return seen


@pytest.mark.parametrize("command", ["fit", "render"])
def test_command_runs_the_config_with_its_overrides(command, runner, capsys):
    assert run(command, QUICKSTART, "filter.samples=64", "bias.slope=1e-1") == 0
    assert runner == [load_config(QUICKSTART, ["filter.samples=64", "bias.slope=0.1"])]
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == "working"
    assert out.splitlines()[-1].endswith("somewhere")
    assert err == ""


@pytest.mark.parametrize("command", ["fit", "render"])
def test_a_run_s_folder_stands_for_what_the_run_found(command, runner, tmp_path, capsys):
    folder = tmp_path / "run"
    folder.mkdir()
    for name, bias in (("config", 1), ("fitted", 2)):
        (folder / f"{name}.yaml").write_text(QUICKSTART.read_text().replace("constant: 0.5", f"constant: {bias}"))
    (folder / "result.json").write_text('{"kind": "fit", "fitted": {"bias.constant": 2.0}}')
    assert run(command, folder) == 0
    assert runner[0].bias.constant == 2
    assert f"note: the values are taken from the fit, {folder / 'fitted.yaml'}" in capsys.readouterr().out
    # A file is meant as it is.
    assert run(command, folder / "config.yaml") == 0
    assert runner[1].bias.constant == 1


def test_commands_that_follow_are_relative_or_absolute_alike_and_no_options(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    commands = [Command("Fit it.", ["fit", Path("-a b.glb"), "bias.slope=1"]), Command("See it.", ["view", Path("c")])]
    for more, place in ([], ""), ([Command("Write it.", ["report", tmp_path / "d"])], f"{tmp_path}/"):
        console = Console(file=StringIO())
        print_next(console, [*commands, *more])
        lines = console.file.getvalue().splitlines()
        first, second, *_ = (line for line in lines if line.startswith("  diffshadow"))
        assert shlex.split(first) == ["diffshadow", "fit", f"{place or './'}-a b.glb", "bias.slope=1"]
        assert second == f"  diffshadow view {place}c"


def test_a_configuration_of_the_package_is_no_path():
    assert source(Path("builtin:quickstart")) == "builtin:quickstart"
    assert (
        Command("", ["fit", source(Path("builtin:quickstart"))]).anywhere().text == "diffshadow fit builtin:quickstart"
    )


def test_init_names_its_file_in_the_commands_that_follow(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("init", "three_js", "--output", "my x.yaml") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "  diffshadow" in line] == [
        f"  diffshadow {verb} 'my x.yaml'" for verb in ("fit", "view", "render")
    ]
    assert lines[-1] == "my x.yaml"


def test_render_writes_debug_views_on_request(runner):
    assert run("render", QUICKSTART, "seed=1", "--debug") == 0
    assert runner == [load_config(QUICKSTART, ["seed=1"]), "debug"]


def test_the_cache_is_measured_and_cleared(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(tmp_path))
    monkeypatch.setattr("diffshadow.io.programs_folder", lambda: tmp_path / "xla")
    (tmp_path / "xla").mkdir()
    for place in (tmp_path / f"{'0' * 64}.npz", tmp_path / "xla" / f"jit_draw-{'0' * 64}-cache", tmp_path / "mine.npz"):
        place.write_bytes(bytes(1 << 20))
    assert run("cache") == 0
    out = capsys.readouterr().out
    assert out.count("1.0") == 2
    assert "diffshadow cache --clear" in out
    assert run("cache", "--clear") == 0
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["mine.npz"]


@pytest.mark.parametrize("command", ["fit", "render", "validate"])
def test_mistakes_are_reported_on_stderr_before_any_work(command, runner, capsys):
    assert run(command, QUICKSTART, "filter.sampels=64") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: override 'filter.sampels=64': filter.sampels: is not a key of filter")
    assert len(err.splitlines()) == 1
    assert runner == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fit"], "CONFIG"),
        (["fti", QUICKSTART], 'Did you mean "fit"?'),
        (["fit", "--fast", QUICKSTART], "--fast"),
        (["fit", "nowhere.yaml"], "nowhere.yaml: there is no such file"),
        (["fit", "."], "is a folder without result.json"),
    ],
)
def test_wrong_arguments_are_reported_on_one_line(arguments, said, runner, capsys):
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert len(err.splitlines()) == 1
    assert runner == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["report", ".", "--dpi", "0"], "dpi is 0; expected 10 to 2400 pixels per inch"),
        (["report", ".", "--dpi=-1"], "dpi is -1; expected 10 to 2400 pixels per inch"),
        (["report", ".", "--dpi", "1000000000"], "dpi is 1000000000; expected 10 to 2400 pixels per inch"),
        (["report", ".", "--dpi", "fine"], "--dpi"),
        (["report", ".", "--figures", "bmp"], "--figures"),
        (["compare", ".", "..", "--output", "."], "--output is ., a folder; expected the path of a page; name a file"),
        (["sweep", QUICKSTART, "--workers", "1000000"], "--workers is 1000000; expected a whole number at least 0"),
        (["sweep", QUICKSTART, "--limit", "0"], "--limit is 0; expected a whole number at least 1"),
    ],
)
def test_options_beyond_their_limits_are_reported_by_name(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "\x1b[1m.yaml"],
        ["fit", "two\nlines.yaml"],
        ["fit", "\udcff.yaml"],
        ["fit", QUICKSTART, "\x1b[1m"],
        ["fit", QUICKSTART, "name=\u202eexe"],
        ["fit", QUICKSTART, "bias.\x1b[1m=3"],
        ["\x1b[1m"],
        ["report", "\x1b]0;x\x07"],
        ["compare", "\x1b[1m", "\udcff"],
    ],
)
def test_what_a_terminal_would_obey_is_printed_as_escapes(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.isprintable()
    assert "\\" in line


def test_console_prints_control_characters_of_any_text_as_escapes(capsys):
    Console().print("a\x1b[2J\nb\u202e")
    assert capsys.readouterr().out == "a\\x1b[2J\nb\\u202e\n"


def test_files_and_pipes_are_wide_enough_for_tables(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "70")
    table = Table("setting", "value", "unit")
    table.add_row("fit.parameters.bias.constant.lower", "0.00012824447365262966", "window depth, a pixel's side")
    Console().print(table)
    assert "…" not in capsys.readouterr().out
    assert Console().width == WIDTH_OF_FILES
    assert Console(width=50).width == 50
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert Console().width == 70


def test_table_of_settings_obeys_no_control_characters(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(diffshadow.study, "check", lambda config, *, console, preview: Checked(12))
    (tmp_path / "\x1b[1m\n").mkdir()
    file = tmp_path / "\x1b[1m\n" / "\x85\udcff.yaml"
    file.write_text("scene: {meshes: [path: a.obj]}\n")
    (file.parent / "a.obj").touch()
    assert run("validate", file, "name=x") == 0
    out = capsys.readouterr().out
    assert out.replace("\n", "").isprintable()
    assert "/\\x1b[1m\\n/\\x85\\udcff.yaml is valid; its scene has 12 triangles\n" in out


def test_disk_trouble_is_reported_without_a_traceback(monkeypatch, capsys):
    def full(config, *, console):
        raise OSError(28, "No space left on device", "runs/x")

    monkeypatch.setattr(diffshadow.study, "run_fit", full, raising=False)
    assert run("fit", QUICKSTART) == 2
    assert "No space left on device: 'runs/x'" in capsys.readouterr().err


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes")])
def test_lack_of_memory_is_reported_without_a_traceback(error, monkeypatch, capsys):
    def large(config, *, console):
        raise error

    monkeypatch.setattr(diffshadow.study, "run_fit", large, raising=False)
    assert run("fit", QUICKSTART) == 2
    assert capsys.readouterr().err.startswith("error: ran out of memory; expected enough for all images")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("INTERNAL: CpuCallback error: KeyboardInterrupt")])
def test_interrupt_exits_with_130_and_without_a_traceback(error, monkeypatch, capsys):
    """JAX makes an error of its own of an interrupt in a callback."""

    def stopped(config, *, console):
        raise error

    monkeypatch.setattr(diffshadow.study, "run_fit", stopped, raising=False)
    assert run("fit", QUICKSTART) == 130
    assert capsys.readouterr().err == "error: interrupted\n"


def test_platforms_without_a_plugin_are_reported_without_a_traceback():
    root = Path(diffshadow.__file__).parents[1]
    environment = {**os.environ, "PYTHONPATH": str(root), "JAX_PLATFORMS": "nonesuch"}
    command = [sys.executable, "-m", "diffshadow", "render", str(QUICKSTART)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith(
        "error: JAX cannot run on JAX_PLATFORMS=nonesuch; expected platforms whose plugins are"
    )


def test_value_error_of_this_package_is_a_mistake_of_the_user(monkeypatch, capsys):
    def strict(config, *, console):
        from diffshadow.geometry import merge

        merge([])

    monkeypatch.setattr(diffshadow.study, "run_fit", strict, raising=False)
    assert run("fit", QUICKSTART) == 2
    assert capsys.readouterr().err.startswith("error: got no meshes to merge")


@pytest.mark.parametrize(
    "error", [ValueError("from a library"), TypeError("a bug"), AssertionError("a bug"), RuntimeError("a bug")]
)
def test_internal_errors_keep_their_traceback(error, monkeypatch):
    def broken(config, *, console):
        raise error

    monkeypatch.setattr(diffshadow.study, "run_fit", broken, raising=False)
    with pytest.raises(type(error), match=str(error)):
        main(["fit", str(QUICKSTART)])


def test_validate_lists_settings_with_units(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.chdir(tmp_path)
    small = "scene.camera.resolution=[64, 64]", "shadow_map.resolution=[64, 64]", "scene.meshes.0.path=builtin:box"
    assert run("validate", QUICKSTART, "filter.radius=3", *small) == 0
    out = capsys.readouterr().out
    (radius,) = (line for line in out.splitlines() if " filter.radius " in line)
    assert radius.split()[1::2] == ["filter.radius", "3.0", "texels"]
    assert "is valid; its scene has 14 triangles" in out
    assert list(tmp_path.iterdir()) == []
    assert run("validate", QUICKSTART, *small, "--preview") == 0
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == str(Path("runs") / "quickstart-preview.png")
    assert re.search(r"[1-9][0-9.]*% of the picture is in shadow", out)
    assert (tmp_path / "runs" / "quickstart-preview.png").read_bytes().startswith(b"\x89PNG")


def test_validate_finds_what_only_building_shows(tmp_path, capsys):
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    file = tmp_path / "c.yaml"
    file.write_text("scene:\n  meshes:\n    - path: empty.obj\n")
    assert run("validate", file) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"error: {file}:3: scene.meshes.0: ")


def test_convert_speaks_the_units_of_engines(capsys):
    small = "scene.camera.resolution=[64, 64]", "shadow_map.resolution=[64, 64]", "scene.meshes.0.path=builtin:box"
    bias = "bias={constant: 0.01, unit: depth, slope: 0}"
    assert run("convert", QUICKSTART, bias, *small) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"the values come from {QUICKSTART}, with {bias} ")
    assert re.search(r"three\.js +light\.shadow\.bias +-0\.01 ", out)
    assert re.search(r"Babylon\.js +generator\.bias \(PCF\) +0\.02 ", out)
    assert re.search(r"Bevy .*not verified against the engine", out)
    # The default disk has a radius of 2 texels.
    assert re.search(r"three\.js +light\.shadow\.radius +2 ", out)
    assert re.search(r"Bevy +ShadowFilteringMethod +– +no counterpart", out)
    assert run("convert", QUICKSTART, "scene.light={type: rectangle, position: [0, 3, 0]}", *small) == 2
    assert "scene.light: the light is a RectangleLight; expected a directional" in capsys.readouterr().err
    assert run("convert", QUICKSTART, "technique.type=shadow_volumes", *small) == 2
    assert (
        "technique.type: is shadow_volumes; expected shadow_map, three.js, babylon.js, playcanvas, bevy or"
        in capsys.readouterr().err
    )


def test_convert_speaks_of_one_engine_in_the_units_of_another(capsys):
    small = "scene.camera.resolution=[64, 64]", "shadow_map.resolution=[64, 64]", "scene.meshes.0.path=builtin:box"
    engine = "technique={type: three.js, bias: -0.01, radius: 3, shadow_side: double}"
    assert run("convert", QUICKSTART, engine, *small) == 0
    out = capsys.readouterr().out
    # A hundredth of the depth range.
    assert re.search(r"Godot 4 +shadow_bias +1 ", out)
    assert re.search(r"Babylon\.js +generator\.bias \(PCF\) +0\.02 ", out)
    assert re.search(r"Godot 4 +shadow_blur +1\.5 ", out)
    assert "the filter PCFShadowMap, as wide as a disk with a radius of 3 texels" in out
    assert "valid where both sides of faces cast, as in three.js" in out


def test_an_unknown_engine_is_answered_with_the_names(capsys):
    assert run("advise", QUICKSTART, "--engine", "unreal") == 2
    err = capsys.readouterr().err
    assert all(name in err for name in ("unreal", "godot", "bevy", "filament", "unity", "three.js", "babylon.js"))
    assert "Traceback" not in err


def test_validate_takes_techniques_that_cannot_be_fitted(capsys):
    small = "scene.camera.resolution=[64, 64]", "scene.meshes.0.path=builtin:box"
    assert run("validate", QUICKSTART, "technique.type=shadow_volumes", *small) == 0
    assert "technique.method" in capsys.readouterr().out


def test_help_tells_of_commands_and_overrides_with_examples(capsys):
    assert run("--help") == 0
    out = capsys.readouterr().out
    for word in (
        "fit",
        "render",
        "validate",
        "KEY=VALUE",
        "diffshadow fit builtin:quickstart filter.samples=64",
        "init",
    ):
        assert word in out
    for command in ("fit", "render", "validate"):
        assert run(command, "--help") == 0
        assert f"diffshadow {command} configs/quickstart.yaml" in capsys.readouterr().out


def test_version_is_the_package_s(capsys):
    from importlib.metadata import version

    assert run("--version") == 0
    assert capsys.readouterr().out.strip() == version("diffshadow")


@pytest.mark.parametrize(
    "arguments",
    marked(
        [["--help"], ["fit", "--help"], ["--version"], ["validate", "broken.yaml"], ["fit", "broken.yaml"]],
        [["--help"], ["--version"], ["validate", "broken.yaml"]],
    ),
)
def test_help_and_mistakes_come_without_loading_jax(arguments, tmp_path):
    (tmp_path / "broken.yaml").write_text("scene: {meshes: [path: builtin:box]}\nsead: 3\n")
    check = "import sys; print(sorted({'jax', 'trimesh', 'matplotlib', 'scipy'} & set(sys.modules)), file=sys.stderr)"
    program = f"import atexit; atexit.register(lambda: exec({check!r})); from diffshadow.cli import main; main()"
    before = os.times()
    result = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    after = os.times()
    assert result.stderr.splitlines()[-1] == "[]"
    assert result.returncode == (2 if "broken.yaml" in arguments else 0)
    # Seconds of the processor, about 0.6 of which are needed: those of the clock depend on what else the machine does.
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    assert spent < 1.5


@pytest.mark.parametrize("number", [0, 1])
def test_of_several_processes_the_first_prints(number, monkeypatch, capsys):
    import jax

    monkeypatch.setattr(jax.distributed, "initialize", lambda: None)
    monkeypatch.setattr(jax, "process_index", lambda: number)
    monkeypatch.setattr(sys, "stdout", sys.stdout)
    join_processes()
    print("printed")
    if number:
        sys.stdout.close()
    assert capsys.readouterr().out == ("" if number else "printed\n")


def of_width(width, show, *arguments):
    console = Console(file=StringIO(), width=width)
    show(console, *arguments)
    return console.file.getvalue()


def numbered():
    table = Table("bias", "filter", "map", "RMSE [visibility]", "fitted", title="ranked")
    table.columns[2].justify = table.columns[3].justify = "right"
    table.add_row("constant and a normal offset", "random_disk", "1024²", "0.0407", "16.25 to 30.5 (bound)")
    table.add_row("scene/of/a/path_that_is_long_and_has_no_digit", "", "512²", "0.1234", "-1.5")
    return table


@pytest.mark.parametrize("width", [200, 100, 80, 60, 40, 24])
def test_tables_cut_no_number_and_no_word_on_narrow_consoles(width):
    out = of_width(width, print_table, numbered())
    assert "…" not in out
    for number in ("1024²", "0.0407", "16.25 to 30.5 (bound)" if width > 40 else "(bound)", "512²", "0.1234", "-1.5"):
        assert number in out
    # A path is whole in a block.
    assert max(map(len, out.splitlines())) <= max(width, 47)
    # A table as long as its numbers fit, and blocks below that.
    assert ("┏" in out) == (width >= 80)
    if width >= 80:
        assert max(map(len, out.splitlines())) <= width
    else:
        assert "  fitted: 16.25 to 30.5" in out
        assert "filter: \n" not in out


@pytest.mark.parametrize(("width", "lines"), [(120, 1), (60, 2), (30, 3)])
def test_settings_of_engines_have_their_value_whole_on_narrow_consoles(width, lines):
    setting = EngineSetting("Babylon.js", "generator.bias (NONE, POISSON, ESM)", 0.020471, "window depth", True)
    title, *out = of_width(width, print_settings, "of the light", [setting]).splitlines()
    assert title == "of the light"
    assert len(out) == lines
    assert max(map(len, out)) <= width
    assert out[-1].split()[-3] == "0.02047"


@pytest.mark.parametrize("width", [100, 50])
def test_errors_of_techniques_are_whole_on_narrow_consoles(width):
    errors = {"rmse": 0.0407, "false_shadow_rate": 0.00123, "false_light_rate": 0.5}
    out = of_width(width, print_rows, {"this configuration": errors})
    assert max(map(len, out.splitlines())) <= width
    for number in ("RMSE 0.0407", "false shadow 0.123%", "50.000%"):
        assert number in out
