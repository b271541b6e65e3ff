"""The rasterizer's benchmark runs, and its table holds what it promises."""

import json
import math
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "experiments" / "benchmark_raster.py"
MEASURES = {"depth", "rasterize", "attributes", "surface", "forward", "reverse", "cascades", "maps"}


@pytest.mark.exhaustive
def test_benchmark_reports_times_and_memory_without_opengl(tmp_path):
    file = tmp_path / "out.json"
    options = ("--triangles", "100", "--sizes", "64", "128", "--repeats", "2", "--no-opengl", "--json", str(file))
    command = [sys.executable, str(SCRIPT), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "reverse / depth" in done.stdout
    assert "64²" in done.stdout

    report = json.loads(file.read_text())
    assert {"cpu", "cores", "python", "jax", "jaxlib", "numpy", "diffshadow"} <= report["machine"].keys()
    assert report["machine"]["cores"] >= 1
    row, larger = report["rows"]
    assert (row["size"], larger["size"]) == (64, 128)
    assert 80 <= row["triangles"] <= 200
    assert row["dtype"] == "float32"
    assert row["opengl"] == "left out"
    assert "agreement" not in row
    assert 0.5 < row["seen"] <= 1, "the ground fills more than half of the light's view"

    assert row["comparisons"].keys() == {"face", "interpolation", "forward", "reverse", "cascades"}
    assert row["comparisons"]["interpolation"]["limit"] == 35
    assert row["comparisons"]["forward"]["limit"] is None, "it has one at 1024 x 1024 alone"
    # From 64 x 64 to 128 x 128 pixels, time grows with the power that the two medians say.
    medians = [r["measures"]["reverse"]["median"] for r in (row, larger)]
    assert report["growth"]["texels"]["reverse"] == pytest.approx(math.log(medians[1] / medians[0], 4))
    assert "triangles" not in report["growth"]

    assert row["measures"].keys() == MEASURES
    for name, times in row["measures"].items():
        assert times.keys() == {"median", "least"}, name
        assert 0 < times["least"] <= times["median"] < math.inf, name
    # Compilation is what a first call has beside the run.
    assert row["first_call"]["rasterize"] > row["measures"]["rasterize"]["median"]
    assert 0 < row["memory"]["loaded"] <= row["memory"]["peak"]


def test_benchmark_refuses_a_size_of_nothing(capsys, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    with pytest.raises(SystemExit):
        runpy.run_path(str(SCRIPT))["main"](["--sizes", "0"])
    assert "0 is not positive" in capsys.readouterr().err
