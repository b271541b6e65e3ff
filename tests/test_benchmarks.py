"""Every benchmark runs at a tiny size, and stores and prints times that are possible."""

import json
import math
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from viewer.viewed import TINY

EXPERIMENTS = Path(__file__).parent.parent / "experiments"

# Options, and what is printed.
BENCHMARKS = {
    "raster": (
        ["--triangles", "100", "--sizes", "64", "128", "--repeats", "2", "--no-opengl"],
        "reverse / depth",
    ),
    "filters": (
        ["--pixels", "32", "--texels", "64", "--repeats", "2", "--only", "random disk, nearest"],
        "ours / OpenGL",
    ),
    "sweeps": (["--sizes", "16", "--runs", "10", "--turns", "1"], "│ 16"),
    # Its slider must not start at its end, where a key does nothing.
    "view": (["--config", "tiny.yaml", "--size", "32", "48", "--repeats", "2"], "medians of 2"),
    "views": (["--views", "4", "8", "--size", "32"], "slope"),
    "long": (["--shapes", "changing", "--fits", "2"], "changing shapes"),
}


def report_of(name: str, folder: Path, *more: str) -> tuple[dict[str, Any], str]:
    """What a benchmark stores, and what it prints."""
    options, said = BENCHMARKS[name]
    (folder / "tiny.yaml").write_text(f"{TINY}bias: {{constant: 1, slope: 1}}\n")
    command = [sys.executable, str(EXPERIMENTS / f"benchmark_{name}.py"), *options, *more, "--json", "out.json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=600)
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
    return json.loads((folder / "out.json").read_text()), done.stdout


def numbers(tree: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """All numbers of a report, with the key that each is below."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from numbers(value, key)
    elif isinstance(tree, list):
        for value in tree:
            yield from numbers(value, name)
    elif isinstance(tree, int | float) and not isinstance(tree, bool):
        yield name, tree


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_reports_times_that_are_possible(name, tmp_path):
    report, said = report_of(name, tmp_path)
    found = list(numbers(report))
    assert len(found) >= 4
    assert all(math.isfinite(number) for _, number in found)
    assert all(number > 0 for key, number in found if key in ("median", "least", "all", "setup", "fit"))
    if name == "raster":
        row, larger = report["rows"]
        assert row["measures"].keys() >= {"depth", "surface", "forward", "reverse", "cascades", "maps"}
        assert all(0 < times["least"] <= times["median"] for times in row["measures"].values())
        assert row["first_call"]["rasterize"] > row["measures"]["rasterize"]["median"]
        # Time grows with the power of the number of texels that the two medians give.
        medians = [each["measures"]["reverse"]["median"] for each in (row, larger)]
        assert report["growth"]["texels"]["reverse"] == pytest.approx(math.log(medians[1] / medians[0], 4))
    if name == "filters":
        (limit,) = report["limits"].values()
        assert limit["ratio"] == pytest.approx(limit["filter"] / limit["limit"])
        rows = [row for case, row in report["cases"].items() if ", hard" in case and "ratio" in row]
        assert all(row["agreement"] > 0.99 for row in rows), "both sides see the same picture"
    if name == "sweeps":
        (row,) = report["rows"]
        printed = next(line for line in said.splitlines() if line.startswith("│ 16"))
        assert float(printed.split("│")[5]) == pytest.approx(row["apart"][0][0] / row["shared"][0][0], abs=0.006)
    if name == "view":
        assert report["changes"].keys() == {"bias", "camera", "light"}
        assert all(change["compiled"] == 0 for change in report["changes"].values())
    if name == "views":
        few, more = report["rows"]
        assert few["all"] == pytest.approx(few["setup"] + few["fit"] + few["rest"])
        printed = next(line for line in said.splitlines() if "slope" in line)
        assert float(printed.split()[3]) == pytest.approx(math.log(more["setup"] / few["setup"], 2), abs=0.006)


@pytest.mark.browser
@pytest.mark.exhaustive
def test_the_benchmark_of_the_page_reports_the_time_from_key_to_picture(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXPERIMENTS)
    import benchmark_view

    if benchmark_view.browser() is None:
        pytest.skip("Chromium, node or playwright-core is missing; see experiments/engines")
    report, said = report_of("view", tmp_path, "--browser")
    taken = report["key_to_picture"]
    assert taken.keys() == {"bias", "camera", "light"}
    assert all(1 < row["least_ms"] <= row["median_ms"] < 60_000 for row in taken.values())
    assert "key to picture, medians of 2: bias" in said


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [("raster", ["--sizes", "0"], "0 is not positive"), ("views", ["--views", "30"], "30 is no multiple of 4")],
)
def test_impossible_options_are_refused(name, options, said, capsys, monkeypatch):
    monkeypatch.syspath_prepend(EXPERIMENTS)
    with pytest.raises(SystemExit):
        runpy.run_path(str(EXPERIMENTS / f"benchmark_{name}.py"))["main"](options)
    assert said in capsys.readouterr().err
