"""Ctrl-C, as a terminal sends it: to every process of the command at once."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import staying_in

from diffshadow._interrupts import repeated_interrupts
from diffshadow.cli import main
from diffshadow.study.sweeps._interrupts import deferred_interrupts, out_of_reach

pytestmark = pytest.mark.usefixtures("interrupts")


SWEEP = """
name: s
scene: {meshes: [path: 'builtin:box'], camera: {resolution: [8, 8]}}
sweep: {grid: {filter.radius: [1, 2]}, repeats: 200}
"""
# The command, whose runs take no time; the workers load this script too.
COMMAND = """
import sys
import time
from pathlib import Path
from diffshadow.cli import main
from diffshadow.study.sweeps import _run as sweep_run
from diffshadow.study.sweeps import _work as sweep_work

def measure(config, batch, stages):
    time.sleep(0.03)
    errors = dict.fromkeys(("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"), 0.25)
    return {**errors, "reference_noise_floor": 0.0, "pixels": 9}

def gather(*args):
    Path("gathering").touch()
    time.sleep(100)

sweep_work._MEASURES["render"] = measure
sweep_run.gather = gather
if __name__ == "__main__":
    Path("started").touch()
    main(["sweep", "s.yaml", *sys.argv[1:]])
"""


def group_of(leader: int) -> list[int]:
    """The processes of a group that are still alive."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            state, _, group = (each / "stat").read_text().rpartition(")")[2].split()[:3]
        except OSError:  # It has ended meanwhile.
            continue
        if int(group) == leader and state != "Z":
            found.append(int(each.name))
    return found


def has_worker(leader: int) -> bool:
    return any(b"spawn_main" in Path(f"/proc/{each}/cmdline").read_bytes() for each in group_of(leader))


def has_results(leader: int) -> bool:
    return len(list(Path("runs/s-sweep/runs").glob("[!.]*/result.json"))) >= 3


def is_gathering(leader: int) -> bool:
    return Path("gathering").exists()


def is_checking(leader: int) -> bool:
    time.sleep(0.2)
    return Path("started").exists()


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("moment", "presses", "arguments"),
    [
        pytest.param(is_checking, 1, ["sweep.repeats=65536"], id="while it is checked"),
        pytest.param(has_worker, 1, ["--workers", "2"], id="while workers start"),
        pytest.param(has_worker, 2, ["--workers", "1"], id="twice"),
        pytest.param(has_results, 1, ["--workers", "2"], id="while they work"),
        pytest.param(has_results, 1, ["--workers", "0"], id="in one process"),
        pytest.param(is_gathering, 1, ["--workers", "0", "--limit", "1"], id="while results are gathered"),
    ],
)
def test_interrupted_sweep_ends_with_one_line_and_all_its_processes(moment, presses, arguments, tmp_path):
    check: Callable[[int], bool] = moment
    with staying_in(tmp_path):
        Path("s.yaml").write_text(SWEEP)
        Path("command.py").write_text(COMMAND)
        process = subprocess.Popen(
            [sys.executable, "command.py", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            while process.poll() is None and not check(process.pid):
                time.sleep(0.02)
            assert process.poll() is None, process.communicate()
            for _ in range(presses):
                os.killpg(process.pid, signal.SIGINT)
                time.sleep(0.3)
            out, err = process.communicate(timeout=100)
            deadline = time.monotonic() + 20
            while group_of(process.pid) and time.monotonic() < deadline:
                time.sleep(0.1)
            assert group_of(process.pid) == []
        finally:
            for each in group_of(process.pid):
                os.kill(each, signal.SIGKILL)
        assert (err, out) == ("error: interrupted\n", "")
        # A process may also end by the very signal, which a shell shows as the same number.
        assert process.returncode in (130, -signal.SIGINT)
        assert not list(Path("runs").glob("**/.*-*"))


def test_interrupt_that_is_dropped_is_repeated(capsys):
    class Dropped:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)
            # Python drops what is raised here.
            time.sleep(0.01)

    def wait():
        with repeated_interrupts():
            made = Dropped()
            del made
            time.sleep(5)

    state = lambda: ([signal.getsignal(number) for number in (signal.SIGINT, signal.SIGALRM)], sys.unraisablehook)
    before = state()
    with pytest.raises(KeyboardInterrupt):
        wait()
    assert capsys.readouterr().err == ""
    assert state() == before
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_interrupt_is_not_repeated_while_the_first_is_heeded():
    ended = []

    def end():
        with repeated_interrupts():
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                time.sleep(0.5)
                ended.append(True)

    with pytest.raises(KeyboardInterrupt):
        end()
    assert ended


def test_interrupts_that_are_ignored_stay_so():
    """A shell starts the background jobs of a script like this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with repeated_interrupts(), deferred_interrupts() as interrupted:
        signal.raise_signal(signal.SIGINT)
        interrupted()
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_an_error_that_jax_makes_of_an_interrupt_is_reported_where_interrupts_are_ignored_too(monkeypatch, capsys):
    def stopped(*args, **options):
        raise RuntimeError("INTERNAL: CpuCallback error: KeyboardInterrupt")

    monkeypatch.setattr("diffshadow.cli._sweeps.load_sweep", stopped)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with pytest.raises(SystemExit) as caught:
        main(["sweep", "s.yaml"])
    assert caught.value.code == 130
    assert capsys.readouterr() == ("", "error: interrupted\n")


def test_main_tells_of_an_interrupt(monkeypatch, capsys):
    monkeypatch.setattr(
        "diffshadow.cli._sweeps.load_sweep", lambda *args, **options: signal.raise_signal(signal.SIGINT)
    )
    with pytest.raises(SystemExit) as caught:
        main(["sweep", "s.yaml"])
    assert caught.value.code == 130
    assert capsys.readouterr() == ("", "error: interrupted\n")


def test_deferred_interrupt_is_raised_where_it_is_looked_for():
    before, passed = signal.getsignal(signal.SIGINT), []

    def press(look: bool):
        with deferred_interrupts() as interrupted:
            interrupted()
            signal.raise_signal(signal.SIGINT)
            passed.append(look)
            if look:
                interrupted()
            passed.append("on")

    with pytest.raises(KeyboardInterrupt):
        press(True)
    # Where nobody looks, at the end.
    with pytest.raises(KeyboardInterrupt):
        press(False)
    assert passed == [True, False, "on"]
    assert signal.getsignal(signal.SIGINT) == before


def test_what_cannot_be_opened_out_of_reach_is_reported_here():
    def opened():
        raise ValueError("there is nothing")

    with pytest.raises(ValueError, match="there is nothing"), out_of_reach(opened, lambda: None):
        pytest.fail("nothing was opened")
