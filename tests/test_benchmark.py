"""The rasterizer's benchmark runs, and its table holds what it promises."""

import json
import math
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "experiments" / "benchmark_raster.py"
MEASURES = {"plan", "rasterize", "rasterize_counting", "attributes", "gradient"}


@pytest.mark.exhaustive
def test_benchmark_reports_times_and_memory_without_opengl(tmp_path):
    file = tmp_path / "out.json"
    options = ("--triangles", "100", "--sizes", "64", "--repeats", "2", "--no-opengl", "--json", str(file))
    command = [sys.executable, str(SCRIPT), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "depth + index" in done.stdout
    assert "64²" in done.stdout

    report = json.loads(file.read_text())
    assert {"cpu", "cores", "python", "jax", "jaxlib", "numpy", "diffshadow"} <= report["machine"].keys()
    assert report["machine"]["cores"] >= 1
    (row,) = report["rows"]
    assert row["size"] == 64
    assert 80 <= row["triangles"] <= 200
    assert row["dtype"] == "float32"
    assert row["opengl"] == "left out"
    assert "agreement" not in row
    assert 0.5 < row["seen"] <= 1, "the ground fills more than half of the light's view"

    assert row["measures"].keys() >= MEASURES
    for name, times in row["measures"].items():
        assert times.keys() == {"median", "least"}, name
        assert 0 < times["least"] <= times["median"] < math.inf, name
    # Compilation is what a first call has beside the run.
    assert row["first_call"]["rasterize"] > row["measures"]["rasterize"]["median"]
    assert 0 < row["memory"]["loaded"] <= row["memory"]["peak"]


def test_benchmark_refuses_a_size_of_nothing(capsys):
    with pytest.raises(SystemExit):
        runpy.run_path(str(SCRIPT))["main"](["--sizes", "0"])
    assert "0 is not positive" in capsys.readouterr().err
