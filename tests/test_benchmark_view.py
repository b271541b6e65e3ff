"""The benchmark of the page runs, and says what a picture costs."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from viewer.viewed import TINY

SCRIPT = Path(__file__).parent.parent / "experiments" / "benchmark_view.py"


def report_of(folder, *options):
    """What the benchmark stores, and what it prints."""
    # Its slider must not start at its end, where a key does nothing.
    (folder / "tiny.yaml").write_text(f"{TINY}bias: {{constant: 1, slope: 1}}\n")
    file = folder / "out.json"
    given = ("--config", "tiny.yaml", "--size", "32", "48", "--repeats", "2", "--json", str(file), *options)
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *given], capture_output=True, text=True, cwd=folder, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return json.loads(file.read_text()), done.stdout


@pytest.mark.exhaustive
def test_benchmark_reports_the_cost_of_each_change(tmp_path):
    report, said = report_of(tmp_path)
    assert report["size"] == [32, 48]
    assert report["changes"].keys() == {"bias", "camera", "light"}
    for change in report["changes"].values():
        assert change["compiled"] == 0
        assert all(0 < change[size]["least_cpu_ms"] <= change[size]["cpu_ms"] for size in ("full", "half"))
    assert "medians of 2" in said
    assert "key_to_picture" not in report


@pytest.mark.browser
@pytest.mark.exhaustive
def test_benchmark_reports_the_time_from_key_to_picture(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    import benchmark_view

    if benchmark_view.browser() is None:
        pytest.skip("Chromium, node or playwright-core is missing; see experiments/engines")
    report, said = report_of(tmp_path, "--browser")
    taken = report["key_to_picture"]
    assert taken.keys() == {"bias", "camera", "light"}
    assert all(1 < row["least_ms"] <= row["median_ms"] < 60_000 for row in taken.values())
    assert "key to picture, medians of 2: bias" in said
