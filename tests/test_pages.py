"""What README and the docs say to run: every block of Python, and every command at a small size."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import staying_in

from diffshadow import geometry
from diffshadow.cli import main

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.exhaustive


@pytest.fixture(autouse=True)
def apart(tmp_path):
    """Each test in a folder of its own, with a cache of its own."""
    with staying_in(tmp_path):
        yield


@pytest.fixture
def readme():
    """The Python of the README and of docs/usage.md, block by block."""
    shutil.copytree(ROOT / "configs", "configs")
    blocks = []
    for page in ("README.md", "docs/usage.md"):
        for block in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL):
            blocks.append(compile(block, page, "exec"))
    return blocks


def test_python_of_the_readme_runs_and_finds_the_sun_where_it_says(readme, capsys):
    names, (technique, sun, own, saved, traced, far, trimeshes, textured, training) = {}, readme
    exec(technique, names)
    assert "filter.radius" in capsys.readouterr().out
    exec(sun, names)
    found = ast.literal_eval(capsys.readouterr().out.splitlines()[-1])
    assert found == pytest.approx({"lights.0.azimuth": -60.0, "lights.0.elevation": 50.0}, abs=0.1)
    exec(own, names)
    assert "bias.constant" in capsys.readouterr().out
    exec(saved, names)
    assert Path("runs/absolute/report.html").is_file()
    capsys.readouterr()
    exec(traced, names)
    assert re.search(r"\[.*\d.*\]", capsys.readouterr().out)
    exec(far, names)
    assert names["scene"].origin == (6e5, 0, 3e6)
    exec(trimeshes, names)
    assert len(names["scene"].meshes) == 2
    assert len(names["back"].faces) == len(names["scene"].mesh.faces)
    exec(textured, names)
    assert names["card"].textures is not None
    exec(training, names)
    assert names["found"].loss <= names["found"].initial_loss
    assert "float shadow(" in capsys.readouterr().out


SMALL = (
    *(
        "scene.camera.resolution=[48, 48]",
        "shadow_map.resolution=[64, 64]",
        "reference.samples=4",
        "reference.supersampling=1",
    ),
    *("fit.solver.max_steps=2", "fit.anneal.phases=1", "fit.intervals=[]", "fit.front=0"),
)
# A fit of lights or meshes: its own phases, and several rays for each pixel.
SMALL_POSE = (
    "scene.camera.resolution=[32, 32]",
    "shadow_map.resolution=[64, 64]",
    "fit.solver.max_steps=2",
    "fit.blurs=[4]",
)
FEW = (
    "advise={biases: [{label: constant, bias: {constant: 1, slope: 0}, parameters: "
    "{bias.constant: {lower: 0, upper: 9}}}], filters: [{label: bilinear, filter: {type: bilinear}}], "
    "resolutions: [[64, 64]]}"
)
PAGES = ("README.md", "docs/usage.md", "docs/engines.md", "docs/viewer.md")


def commands_of(page):
    """The words of each command of the command-line program on a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    fenced = re.findall(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    blocks = [block for language, block in fenced if not language]
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("diffshadow ")]
    lines += re.findall(r"`(diffshadow (?:convert|init|fit|advise)[^`]*)`", text) if page == "README.md" else []
    # The page that `view` opens has tests of its own.
    return [shlex.split(line, comments=True)[1:] for line in lines if not line.startswith("diffshadow view")]


def made_small(command, words):
    """A command of a page at a size that a test can afford, and whether its output is the page's own."""
    name = words[0] if words else ""
    if command in ("fit", "render", "convert", "validate"):
        return SMALL_POSE if "configs/fit_" in name else SMALL
    if command == "animate" and len(words) > 1:
        return (*SMALL, "--frames", "2")
    if command == "sweep":
        return (*SMALL, "sweep.seeds=null", "--workers", "0") if "--dry-run" not in words else ()
    if command == "advise" and "--dry-run" not in words:
        # Other lists, or an engine's, make as many fits as they take.
        is_small = "quickstart" in name and "--engine" not in words
        return (*SMALL, FEW, "--workers", "0") if is_small else ("--dry-run",)
    return ()


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_a_page_run_as_they_stand_there(page, capsys):
    shutil.copytree(ROOT / "configs", "configs", dirs_exist_ok=True)
    chair = geometry.library_mesh("chair").to_trimesh()
    for name in ("your_mesh.glb", "bunny.obj"):
        chair.export(name)
    shutil.copy(ROOT / "tests" / "golden" / "imports" / "yard.json", "scene.json")
    for command, words in (("fit", ["configs/quickstart.yaml"]), ("render", ["configs/quickstart.yaml"])):
        # What pages take for granted: the runs of README's first commands.
        with pytest.raises(SystemExit):
            main([command, *words, *SMALL])
    commands, printed = commands_of(page), ""
    assert len(commands) >= 2
    for command, *words in commands:
        if command == "init":
            # Pages write the same file for several readers.
            Path("your_mesh_three_js.yaml").unlink(missing_ok=True)
        if command == "import":
            shutil.rmtree("scene", ignore_errors=True)
        capsys.readouterr()
        run_by = [command, *words, *made_small(command, words)]
        with pytest.raises(SystemExit) as caught:
            main(run_by)
        out, error = capsys.readouterr()
        printed += out
        assert caught.value.code == 0, (run_by, error)
        assert "Traceback" not in error
        if "--preview" in words:
            assert Path("runs/your_mesh-preview.png").is_file()
            assert "of the picture is in shadow" in out
    # What the page shows of their output. Numbers of a fit are of its full size.
    assert [line for line in shown_on(page) if line not in printed] == []


def shown_on(page):
    """The lines of output on a page: what an import says, and the names that code to paste sets."""
    text = (ROOT / page).read_text(encoding="utf-8")
    said = re.findall(r"^(?:taken|note): .*$", text, re.MULTILINE)
    return [*said, *re.findall(r"^(light\.shadow\.\w+(?: = |\.\w+\())", text, re.MULTILINE)]


@pytest.fixture
def engines_page():
    """The Python of docs/engines.md, block by block."""
    text = (ROOT / "docs" / "engines.md").read_text(encoding="utf-8")
    return [compile(block, "docs/engines.md", "exec") for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL)]


def test_python_of_the_engines_page_runs_and_takes_the_engines_maps(engines_page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names, (three, three_map, babylon, babylon_map) = {}, engines_page
    exec(three, names)
    own = np.asarray(names["technique"].prepare(names["scene"]).depth)
    assert own.min() < 0.9
    np.save("three_map.npy", own)
    exec(three_map, names)
    np.testing.assert_array_equal(names["visibility_in_three_js"], names["visibility"])
    assert 0 < np.mean(names["visibility"]) < 1
    exec(babylon, names)
    depth = np.asarray(names["technique"].prepare(names["scene"]).depth)
    near, far, bias = 0.8, 7.0, 0.004
    # (d - n) / (f - n) at the distance d = f n / (f - z (f - n)), pushed by the bias.
    distance = far * near / (far - depth * (far - near))
    np.save("babylon_map.npy", np.where(depth < 1, (distance - near) / (far - near) + bias, 1))
    exec(babylon_map, names)
    off = np.abs(np.asarray(names["visibility_in_babylon_js"]) - names["visibility"])
    assert (off < 1 / 255).mean() > 0.999
    assert 0 < np.mean(names["visibility"]) < 1


def test_the_first_technique_works_as_its_page_prints_it():
    page = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
    for folder in ("diffshadow", "tests", "configs"):
        shutil.copytree(ROOT / folder, folder, ignore=shutil.ignore_patterns("__pycache__", "*.npz"))
    shutil.copy(ROOT / "pyproject.toml", ".")
    # Each file follows the words "this as" and its name.
    files = re.findall(r"this\sas `([\w/.]+)`:\n\n```\w+\n(.*?)```", page, re.DOTALL)
    assert [Path(name).name for name, _ in files] == ["_cross.py", "cross.yaml", "test_cross.py"]
    for name, text in files:
        Path(name).write_text(text, encoding="utf-8")
    changes = "".join(re.findall(r"```diff\n(.*?)```", page, re.DOTALL))
    # It refuses a change whose lines are no longer there.
    subprocess.run(["git", "apply", "-"], input=changes, text=True, check=True)
    here = {**os.environ, "PYTHONPATH": os.getcwd()}
    for command in (
        *(["pytest", "-n", "0", "-q", "tests/shadow/test_cross.py"], ["diffshadow", "fit", "cross.yaml", *SMALL]),
        ["pytest", "-n", "0", "-q", "tests/test_derivatives.py", "-k", "cross or each_public or each_fitted"],
        ["pytest", "-n", "0", "-q", "tests/config/test_config.py", "-k", "fault_is_reported"],
    ):
        done = subprocess.run([sys.executable, "-m", *command], env=here, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        assert str(ROOT / "diffshadow") not in done.stdout
