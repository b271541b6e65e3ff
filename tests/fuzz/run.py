"""Runs random cases through the command's own entry, in this process, and says how they should not have ended.

make fuzz N=10000 SEED=0          many cases, in two processes; one that hangs or dies is started again
make fuzz SEED=0 CASE=17          one of them once more, with all that it prints
"""

import argparse
import contextlib
import importlib.util
import io
import json
import multiprocessing
import multiprocessing.connection
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import unicodedata
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cases
import jax
import mutate
import numpy as np
from cases import RUN, TEMPLATE, Case

from diffshadow.cli import main as command

SECONDS, SECONDS_TO_DRAW = 5.0, {"validate": 10.0, "render": 10.0, "fit": 20.0}
"""Longest that a command may take besides compiling; those that draw also trace what they compile."""
_GIVE_UP = {"validate": 120, "render": 120, "fit": 240}
"""Seconds of the processor after which a command is stopped, where 60 are too few."""
_HANGS = 300
"""Seconds after which a process counts as hanging."""
_MEMORY = 12 << 30
"""Bytes that a process may map; what asks for more fails at once."""
_CHUNK = 300
"""Cases that a process runs: what is compiled stays in memory as long as the process lives."""

# What follows the place in a message about no key: the file is no YAML, or overrides are none.
_NO_KEY = ("is not YAML: ", "holds ", "has the key ", "is not KEY=VALUE; ", "sections or lists are nested ")
_PLACE = re.compile(r"(?s:.*?\.yaml(?:'|\")?):\d+: |override .*?['\"]: ")
_RANGES = {"ssim": (-1.0, 1.0)}
_MEASURED = {"rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"}
if importlib.util.find_spec("flip_evaluator"):
    _MEASURED.add("flip")


class Overtime(BaseException):
    """The case was stopped; no handler of errors keeps it."""


class Outcome(NamedTuple):
    """How a command ended: by its exit code or a crash; what it printed; warnings; seconds but for compiling."""

    code: Any
    crash: str
    out: str
    err: str
    warned: list[str]
    seconds: float


_compiling = [0.0]
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **_: _compiling.append(seconds) if event.endswith("backend_compile_duration") else None
)


def call(arguments: Sequence[str]) -> Outcome:
    """Runs the command with `arguments`."""

    def stop(*_: Any) -> None:
        raise Overtime

    code, crash = None, ""
    _compiling.clear()
    clock, cpu = time.monotonic(), time.process_time()
    # The command has the other timer for itself.
    old = signal.signal(signal.SIGPROF, stop)
    with _streams() as (out, err), warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        signal.setitimer(signal.ITIMER_PROF, _GIVE_UP.get(arguments[0], 60))
        try:
            command(list(arguments))
        except SystemExit as ended:
            code = ended.code
        except Overtime:
            crash = f"stopped at {_where(sys.exc_info()[2])}"
        except BaseException as error:
            crash = f"{type(error).__name__}: {error} at {_where(error.__traceback__)}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, old)
        # A busy machine makes the clock run on; threads make the processor's time run ahead.
        passed, used = time.monotonic() - clock, time.process_time() - cpu
        seconds = (passed - sum(_compiling)) * min(1, used / passed)
        for stream in (out, err):
            stream.flush()
            stream.seek(0)
        remarks = [f"{each.category.__name__}: {each.message} at {each.filename}:{each.lineno}" for each in warned]
        return Outcome(code, crash, out.read(), err.read(), remarks, seconds)


@contextlib.contextmanager
def _streams() -> Iterator[tuple[Any, Any]]:
    """Files in the places of stdout and stderr; also what libraries in C write to stderr."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        texts = (
            io.TextIOWrapper(out, "utf-8", newline=""),
            io.TextIOWrapper(err, "utf-8", "backslashreplace", newline=""),
        )
        kept = os.dup(2)
        os.dup2(err.fileno(), 2)
        try:
            with contextlib.redirect_stdout(texts[0]), contextlib.redirect_stderr(texts[1]):
                yield texts
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _where(trace: Any) -> str:
    """The innermost line of this project in a traceback."""
    frames = [frame for frame in traceback.extract_tb(trace) if "/diffshadow/" in frame.filename]
    return f"{frames[-1].filename.rpartition('/diffshadow/')[2]}:{frames[-1].lineno}" if frames else "nowhere"


def faults_of(case: Case, arguments: Sequence[str], ended: Outcome) -> Iterator[str]:
    """What is wrong with how a command of `case` ended."""
    yield from ended.warned
    if ended.crash:
        yield ended.crash
        return
    if ended.code not in (0, 2):
        yield f"exit {ended.code}"
    if ended.seconds > SECONDS_TO_DRAW.get(arguments[0], SECONDS):
        yield f"took {ended.seconds:.1f} s"
    for name, text in (("stdout", ended.out), ("stderr", ended.err)):
        raw = {f"U+{ord(c):04X}" for c in text if c != "\n" and unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp")}
        if raw:
            yield f"raw control characters on {name}: {sorted(raw)}"
    if ended.code == 0:
        if ended.err:
            yield f"success with words on stderr: {ended.err}"
        return
    if not ended.err.startswith("error: "):
        yield f"no 'error: ' before {ended.err}"
        return
    lines = ended.err.removeprefix("error: ").removesuffix("\n").split("\n")
    if case.kind in ("arguments", "folder") or (arguments[0] not in ("validate", "render", "fit", "sweep")):
        if len(lines) > 1 and any(map(wrong_with_line, lines)):
            yield f"{len(lines)} lines: {ended.err}"
        return
    for line in lines:
        if fault := wrong_with_line(line):
            yield f"{fault}: {line}"


def wrong_with_line(line: str) -> str:
    """What a problem's line lacks."""
    place = _PLACE.match(line)
    if place is None:
        return "no place"
    said = line[place.end() :]
    if said.startswith(_NO_KEY):
        return ""
    key, colon, message = said.partition(": ")
    if not colon or "; expected" in key:
        return "no key"
    return "" if "expected" in message else "not said what was expected"


def wrong_with_run(folder: Path) -> Iterator[str]:
    """Numbers of a finished run that are not finite, or out of range."""
    metrics = json.loads((folder / "result.json").read_text())["metrics"]
    for key, value in _errors(metrics):
        low, high = _RANGES.get(key, (0.0, 1.0))
        if value is None or not low <= value <= high:
            yield f"metrics: {key} is {value}"
    with np.load(folder / "arrays.npz") as arrays:
        for name in {"visibility", "reference", "before", "after"}.intersection(arrays):
            image = arrays[name]
            if not (np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1):
                yield f"{name} runs from {image.min()!r} to {image.max()!r}, {np.isnan(image).sum()} not a number"


def _errors(value: Any) -> Iterator[tuple[str, Any]]:
    """Every error in `metrics`, but for those of lights for which no pixel counts."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ()):
        if key in _MEASURED:
            yield key, inner
        elif not (isinstance(inner, dict) and inner.get("pixels") == 0):
            yield from _errors(inner)


def run_case(case: Case, told: Callable[[Outcome], None] = lambda ended: None) -> list[str]:
    """Runs `case` in the current folder, which holds nothing but `TEMPLATE`; tells `told` of each command's end.

    **Returns** the faults.
    """
    with contextlib.ExitStack() as after:
        after.callback(_clear)
        for name, data in case.files.items():
            Path(name).write_bytes(data)
        if case.damaged:
            shutil.copytree(TEMPLATE, RUN)
            cases.damage(case, Path(RUN))
        before = _all_files()
        for i, arguments in enumerate(case.commands):
            if i and arguments[0] in ("report", "compare"):
                for name in case.files:
                    Path(name).unlink(missing_ok=True)
            ended = call(arguments)
            told(ended)
            faults = [*faults_of(case, arguments, ended)]
            if i and ended.code == 2 and not faults:
                faults = [f"{case.commands[i - 1][0]} passed it: {ended.err}"]
            if ended.code == 0 and arguments[0] in ("render", "fit") and case.kind != "arguments":
                faults += wrong_with_run(Path(ended.out.splitlines()[-1]))
            elif arguments[0] in ("validate", "sweep") and i == 0 and _all_files() != before:
                faults.append(f"wrote {_all_files() - before}")
            if faults or ended.code != 0:
                return [f"{arguments[0]}: {fault}" for fault in faults]
    return []


def _all_files() -> set[str]:
    return {str(path) for path in Path().rglob("*")} - {"cache"}


def _clear() -> None:
    for path in Path().iterdir():
        if path.name not in (TEMPLATE, "cache"):
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def make_template() -> None:
    """A finished render in the current folder's `TEMPLATE`; loads all libraries on the way."""
    Path("template.yaml").write_text(mutate.write(cases.BASE))
    ended = call(["render", "template.yaml"])
    assert ended.code == 0, ended
    shutil.move(ended.out.splitlines()[-1], TEMPLATE)
    _clear()


def show(case: Case) -> str:
    """`case` for a reader, and how to run it again."""
    files = "\n".join(f"--- {name!r}\n{data.decode('utf-8', 'backslashreplace')}" for name, data in case.files.items())
    commands = "\n".join(f"--- diffshadow {' '.join(map(repr, arguments))}" for arguments in case.commands)
    return f"make fuzz SEED={case.seed} CASE={case.number}  ({case.kind})\n{commands}\n{files}"


def _work(seed: int, numbers: Sequence[int], cache: str, pipe: Any) -> None:
    """Runs the cases of `numbers` in a process of its own, and tells `pipe` of each as it begins and ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with _apart(cache):
        pipe.send(None)
        for number in numbers:
            pipe.send((number, None))
            pipe.send((number, run_case(cases.make(seed, number))))


@contextlib.contextmanager
def _apart(cache: str) -> Iterator[None]:
    """A folder of its own for the process, with a finished run, and a limit on memory."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        os.environ |= {"DIFFSHADOW_CACHE": cache, "HOME": folder, "COLUMNS": "100"}
        make_template()
        yield


class _Worker:
    """A process that runs a chunk of cases, one after the other."""

    def __init__(self, seed: int, numbers: Sequence[int], cache: str):
        context = multiprocessing.get_context("spawn")
        self.pipe, end = context.Pipe(duplex=False)
        self.process = context.Process(target=_work, args=(seed, numbers, cache, end), daemon=True)
        self.process.start()
        end.close()
        self.left, self.since, self.ready = list(numbers), time.monotonic(), False

    def receive(self) -> list[tuple[int, list[str]]]:
        """Cases that ended since, and their faults; of a process that hangs or died, the one that it was at."""
        ended = []
        try:
            while self.pipe.poll():
                told, self.since, self.ready = self.pipe.recv(), time.monotonic(), True
                if told is not None and told[1] is not None:
                    number, faults = told
                    self.left.remove(number)
                    ended.append((number, faults))
        except EOFError:
            self.process.join()
            if not self.ready:
                raise SystemExit("a good case failed; see above") from None
            if self.left:
                ended.append((self.left.pop(0), [f"the process died with {self.process.exitcode}"]))
            self.pipe.close()
        if not self.pipe.closed and time.monotonic() - self.since > _HANGS:
            self.process.kill()
            ended.append((self.left.pop(0), [f"the process hung for {_HANGS} s"]))
            self.pipe.close()
        return ended


def fuzz(seed: int, numbers: Sequence[int], workers: int, cache: str) -> dict[int, list[str]]:
    """Runs the cases of `numbers`. **Returns** the faults of those that have some."""
    chunks = [list(numbers[i : i + _CHUNK]) for i in range(0, len(numbers), _CHUNK)]
    found, done, running, began = {}, 0, [], time.monotonic()
    while chunks or running:
        while chunks and len(running) < workers:
            running.append(_Worker(seed, chunks.pop(0), cache))
        multiprocessing.connection.wait([worker.pipe for worker in running], timeout=5)
        for worker in list(running):
            for number, faults in worker.receive():
                done += 1
                if faults:
                    found[number] = faults
                    print(f"case {number}: {faults[0][:300]!r}", flush=True)
                if done % 500 == 0:
                    print(f"{done} cases in {time.monotonic() - began:.0f} s, {len(found)} with faults", flush=True)
            if worker.pipe.closed:
                running.remove(worker)
                if worker.left:
                    chunks.insert(0, worker.left)
    return found


def _cause(fault: str) -> str:
    """`fault` without what differs from case to case."""
    return re.sub(r"'[^']*'|\"[^\"]*\"|-?\d[\d.e+-]*", "…", fault)[:160]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--step", type=int, default=1, help=f"{cases.DRAWN_EVERY}: only those that draw techniques")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, help="only this one, with all that it prints")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    numbers = range(given.first, given.first + given.cases * given.step, given.step)
    with tempfile.TemporaryDirectory() as cache:
        if given.case is not None:
            case = cases.make(given.seed, given.case)
            print(show(case), flush=True)
            told = lambda ended: print(f"--- exit {ended.code} {ended.crash}\n{ended.out}{ended.err}", flush=True)
            with _apart(cache):
                found = {given.case: run_case(case, told)}
        else:
            found = fuzz(given.seed, numbers, given.workers, cache)
    causes = defaultdict(list)
    for number, faults in found.items():
        for fault in faults:
            causes[_cause(fault)].append((number, fault))
    for group in sorted(causes.values(), key=len, reverse=True):
        print(f"\n{len(group)} x {group[0][1][:500]!r}\n    make fuzz SEED={given.seed} CASE={group[0][0]}")
    wrong = sum(map(bool, found.values()))
    print(f"\n{wrong} of {1 if given.case is not None else given.cases} cases have faults")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
