"""The benchmark of fits to many views runs, and says how time and memory grow."""

import json
import math
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "experiments" / "benchmark_views.py"


@pytest.mark.exhaustive
def test_benchmark_reports_times_and_memory_and_how_they_grow(tmp_path):
    file = tmp_path / "out.json"
    command = [sys.executable, str(SCRIPT), "--views", "4", "8", "--size", "32", "--json", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    few, more = json.loads(file.read_text())["rows"]
    assert (few["views"], more["views"]) == (4, 8)
    for row in (few, more):
        assert row["all"] == pytest.approx(row["setup"] + row["fit"] + row["rest"])
        assert 0 < row["step"] < row["fit"] < row["all"] < row["with_compiling"] < math.inf
        assert 0.1 < row["peak"] < 8
    slope = math.log(more["setup"] / few["setup"], 2)
    printed = next(line for line in done.stdout.splitlines() if "slope" in line)
    assert float(printed.split()[3]) == pytest.approx(slope, abs=0.006)


def test_benchmark_refuses_views_that_meshes_do_not_divide(capsys, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    with pytest.raises(SystemExit):
        runpy.run_path(str(SCRIPT))["main"](["--views", "30"])
    assert "30 is no multiple of 4" in capsys.readouterr().err
