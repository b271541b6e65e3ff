"""What a run says of the work that is left."""

import pytest
from rich.console import Console

from diffshadow.study.runs import _progress
from diffshadow.study.runs._progress import Progress


@pytest.mark.parametrize(
    ("pace", "left"), [(0.5, ["", "", ""]), (30.0, [", about 90 s left", ", about 60 s left", ", about 30 s left"])]
)
def test_counted_items_say_how_long_the_rest_takes(pace, left, monkeypatch):
    now, said = 0.0, []
    progress = Progress(Console(quiet=True))
    monkeypatch.setattr(_progress.time, "perf_counter", lambda: now)
    monkeypatch.setattr(progress._progress, "update", lambda task, **shown: said.append(shown["detail"]))
    for item in progress.counted("view", "abcde"):
        # The first also compiles.
        now += 600.0 if item == "a" else pace
        assert progress.part == said[-1]
    assert progress.part == ""
    assert said == [f"view {i} of 5{text}" for i, text in enumerate(["", "", *left], start=1)]
