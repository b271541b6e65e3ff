"""The filters' benchmark runs, and its table holds what it promises."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "experiments" / "benchmark_filters.py"
COMPARISONS = {"filter", "visibility", "whole"}


JACOBIAN = "random disk, nearest, soft"


@pytest.mark.exhaustive
def test_benchmark_times_the_same_visibility_on_both_sides(tmp_path):
    file = tmp_path / "out.json"
    options = (
        "--pixels",
        "32",
        "--texels",
        "64",
        "--repeats",
        "2",
        "--only",
        "random disk, nearest",
        "--json",
        str(file),
    )
    done = subprocess.run([sys.executable, str(SCRIPT), *options], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "ours / OpenGL" in done.stdout

    report = json.loads(file.read_text())
    hard = {f"random disk, nearest, hard{more}" for more in ("", ", early-out")}
    assert report["cases"].keys() == hard | {JACOBIAN}
    for name, row in report["cases"].items():
        assert row["ours"].keys() == COMPARISONS, name
        assert all(0 < time < math.inf for time in row["ours"].values()), name
    (limit,) = report["limits"].values()
    assert limit["ratio"] == pytest.approx(limit["filter"] / limit["limit"])
    (jacobian,) = report["jacobians"].values()
    assert jacobian["primal"] > 0
    assert jacobian["ratio"] == pytest.approx(jacobian["jacobian"] / jacobian["primal"])

    pytest.importorskip("moderngl")
    if "ratio" not in report["cases"][JACOBIAN]:
        pytest.skip(f"there is no OpenGL here: {report['opengl']}")
    for name in hard:
        row = report["cases"][name]
        assert row["opengl"].keys() == row["ratio"].keys() == COMPARISONS, name
        assert row["agreement"] > 0.99, "both sides see the same picture"
        assert row["opengl"]["whole"] > 0, name
