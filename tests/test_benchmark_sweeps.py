"""The benchmark of sweeps on workers that share no files runs, and compares times of both ways."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "experiments" / "benchmark_sweeps.py"


@pytest.mark.exhaustive
def test_benchmark_reports_times_of_both_ways(tmp_path):
    file = tmp_path / "out.json"
    command = [sys.executable, str(SCRIPT), "--sizes", "16", "--runs", "10", "--turns", "1", "--json", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(file.read_text())["rows"]
    assert (row["size"], row["runs"]) == (16, 10)
    (shared,), (apart,) = row["shared"], row["apart"]
    assert all(seconds > 0 for seconds in (*shared, *apart))
    printed = next(line for line in done.stdout.splitlines() if line.startswith("│ 16"))
    assert float(printed.split("│")[5]) == pytest.approx(apart[0] / shared[0], abs=0.006)
