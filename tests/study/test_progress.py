"""What a run says of the work that is left."""

from io import StringIO

import pytest
from rich.console import Console

from diffshadow.console import Console as Named
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


@pytest.mark.parametrize(("asks", "is_terminal"), [(True, False), (False, False), (True, True)])
def test_a_pipe_has_a_line_for_each_stage_and_phase(asks, is_terminal):
    console = Named(file=StringIO(), names_stages=asks, force_terminal=is_terminal, width=80)
    progress = Progress(console)
    with progress.stage("tracing reference"):
        progress.show("tracing reference", "64 rays per pixel", 0.5)
    for phase in (1, 2):
        for step in range(3):
            progress.show("fitting", f"start 1 of 2, phase {phase} of 2, step {step}, RMSE 0.1", 0.1)
    for trial in (1, 2):
        progress.show("fitting", f"how sure, trial {trial}: bias.constant = 1")
    lines = [line.split(" s  ")[1] for line in console.file.getvalue().splitlines()]
    said = [f"fitting, start 1 of 2, phase {phase} of 2" for phase in (1, 2)]
    assert lines == (["tracing reference", *said, "fitting, how sure"] if asks and not is_terminal else [])
