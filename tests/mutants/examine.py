"""Puts mistakes into a copy of the repository, one at a time, and says which everyday test finds each.

make mutants                                        200 mutants of the whole package, drawn with seed 0
make mutants PATHS="diffshadow/fit" SAMPLE=50 SEED=7    50 of some files or folders
make mutants ARGS="--kept"                          the mistakes of kept.yaml, which no operator makes
make mutants PATHS=diffshadow/fit ARGS=--missing    the lines and branches that no everyday test enters

Which everyday tests enter each line is measured first, once for each state of a file: that takes longer than the tests
do. Then the tests that enter a mistake's line run, the cheapest first. The last lines list the survivors and give the
score.
"""

import argparse
import contextlib
import itertools
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from draw import Mutant, draw, first_difference
from entered import PACKAGE, Measured, measured, print_missing, tests_of
from kept import KEPT, Kept

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / ".cache" / "mutants"
"""What tests enter, as measured; ignored by git."""
LIBRARIES = (
    "OpenEXR",
    "PIL.Image",
    "beartype",
    "cyclopts",
    "embreex.mesh_construction",
    "equinox",
    "hypothesis",
    "jax.numpy",
    "jax.scipy.stats",
    "jaxtyping",
    "lineax",
    "manifold3d",
    "optimistix",
    "pydantic",
    "pytest",
    "scipy.ndimage",
    "scipy.sparse.csgraph",
    "scipy.spatial",
    "scipy.stats",
)
"""What is loaded once for all runs of tests; none of them may import the package."""
_HANGS = 60, 3
"""Tests hang that take more seconds than the first and the second times what they take without a mistake."""
# Libraries are loaded before pytest could rewrite their assertions.
_IGNORED = "ignore::pytest.PytestAssertRewriteWarning"
_OPTIONS = ["-n", "0", "-x", "-q", "-p", "no:cacheprovider", "--tb", "no", "-W", _IGNORED]

CAUGHT, AT_IMPORT, CRASHES, HANGS = "caught", "caught at import", "caught by a crash", "caught by a hang"
MISSED, NOT_THERE, UNKNOWN = "NOT CAUGHT", "does not apply", "no verdict"


Mistake = Mutant | Kept


class Verdict(NamedTuple):
    """What became of a mistake: one of the words above, the test that found it or another remark, and seconds."""

    mistake: Mistake
    verdict: str
    what: str
    seconds: float

    def __str__(self) -> str:
        by = self.what and f" ({self.what})"
        return f"{self.mistake.file}: {self.mistake.name}: {self.verdict}{by}, {self.seconds:.0f} s"


class _Run(NamedTuple):
    """How pytest ended: its code, none if it had to be killed, the tests that failed, seconds of each, and output."""

    code: int | None
    failed: list[str]
    seconds: dict[str, float]
    output: str


class Copy:
    """A copy of the repository's files in the folder `to`, tracked ones and new ones, in which tests are run."""

    _writes = itertools.count(int(time.time()) + 1)
    """Times of change in seconds, all different: else Python might take one version's byte code for another's."""

    def __init__(self, root: Path, to: Path):
        self.root = to
        self._forks: subprocess.Popen[str] | None = None
        list_files = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        listed = subprocess.run(list_files, cwd=root, check=True, capture_output=True, text=True)
        for name in filter(None, listed.stdout.split("\0")):
            # A file that was removed is still listed until that is committed.
            if os.path.lexists(root / name):
                (to / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, to / name, follow_symlinks=False)
        self._environment = {**os.environ, "PYTHONPATH": str(to)}

    def check_import(self) -> None:
        """**Raises** `RuntimeError` unless the package that Python imports here is the copy's, not an installed one."""
        done = self._python(f"import {PACKAGE}; print({PACKAGE}.__file__)")
        found = done.stdout.strip()
        if done.returncode != 0 or not Path(found).is_relative_to(self.root):
            raise RuntimeError(f"Python imports {found!r} in {self.root}; expected the package that lies there")

    def examine(self, mistake: Mistake, entered: Sequence[Measured], budget: float, whole: bool) -> Verdict:
        """What `budget` seconds of the tests that enter the mistake's line, or else the `whole` everyday suite, make of
        it; the file is then as before."""
        began = time.perf_counter()
        judged = lambda verdict, what="": Verdict(mistake, verdict, what, time.perf_counter() - began)
        file = self.root / PACKAGE / mistake.file
        before = file.read_text(encoding="utf-8") if file.is_file() else ""
        after = mistake.changed(before)
        if after is None:
            return judged(NOT_THERE, "its text is not in its place exactly once")
        line = first_difference(before, after)[0]
        tests = tests_of(entered, f"{PACKAGE}/{mistake.file}", before, line, budget)
        verdict, what = MISSED, "no test enters it"
        try:
            self._write(file, after)
            if tests:
                verdict, what = self._tested(mistake, tests)
            if verdict == MISSED and whole:
                verdict, what = self._tested(mistake, {name: s for each in entered for name, s in each.seconds.items()})
        finally:
            self._write(file, before)
        return judged(verdict, what)

    def seconds(self, *arguments: str) -> dict[str, float]:
        """What pytest's tests take that pass, by their identifiers."""
        done = self._pytest(*arguments)
        return {name: seconds for name, seconds in done.seconds.items() if name not in done.failed}

    def kill(self) -> None:
        """Ends the tests that run, and the process that they are forks of; from any thread."""
        forks = self._forks
        if forks is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(forks.pid, signal.SIGKILL)

    def close(self) -> None:
        """Ends all processes, from the thread that started them."""
        self.kill()
        if self._forks is not None:
            self._forks.communicate()
            self._forks = None

    def _tested(self, mistake: Mistake, tests: dict[str, float]) -> tuple[str, str]:
        code, failed, _, said = self._pytest(*tests, limit=_HANGS[0] + _HANGS[1] * sum(tests.values()))
        if code is None:
            return HANGS, ""
        if code < 0:
            return CRASHES, f"signal {-code}"
        if code == 0:
            return MISSED, f"{len(tests)} tests"
        # Or a file of tests could not be imported.
        if failed:
            return CAUGHT, failed[0]
        module = f"{PACKAGE}/{mistake.file}".removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        if self._python(f"import {module}").returncode != 0:
            return AT_IMPORT, ""
        return UNKNOWN, f"pytest ended with {code}: {said.strip().rpartition(chr(10))[2]}"

    def _pytest(self, *arguments: str, limit: float = 3600) -> _Run:
        """Pytest with some arguments, ended after `limit` seconds."""
        if self._forks is None:
            program = [sys.executable, str(Path(__file__).with_name("forks.py")), *LIBRARIES]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
            self._forks = subprocess.Popen(
                program, cwd=self.root, env=self._environment, text=True, start_new_session=True, **pipes
            )
        forks, output = self._forks, self.root.with_name(f"{self.root.name}.txt")
        asked = json.dumps([str(output), *_OPTIONS, *arguments])
        timer = threading.Timer(limit, self.kill)
        timer.start()
        try:
            print(asked, file=forks.stdin, flush=True)
            answer = forks.stdout.readline()
        finally:
            timer.cancel()
        if not answer:
            self.close()
            return _Run(None, [], {}, "")
        tests = output.with_suffix(".tests")
        seconds, failed = json.loads(tests.read_text()) if tests.exists() else ({}, [])
        tests.unlink(missing_ok=True)
        return _Run(int(answer), failed, seconds, output.read_text(encoding="utf-8", errors="replace"))

    def _python(self, program: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", program], cwd=self.root, env=self._environment, capture_output=True, text=True
        )

    def _write(self, file: Path, text: str) -> None:
        file.write_text(text, encoding="utf-8")
        changed = next(self._writes)
        os.utime(file, (changed, changed))


def examined(
    mistakes: Sequence[Mistake], workers: int, entered: Sequence[Measured], budget: float, whole: bool
) -> Iterator[Verdict]:
    """The verdict on each mistake, as they come, from so many copies at once."""
    waiting: queue.SimpleQueue[Mistake] = queue.SimpleQueue()
    done: queue.SimpleQueue[Verdict | BaseException] = queue.SimpleQueue()
    stopped = threading.Event()
    for mistake in mistakes:
        waiting.put(mistake)

    def work(copy: Copy) -> None:
        try:
            copy.check_import()
            while not stopped.is_set():
                done.put(copy.examine(waiting.get_nowait(), entered, budget, whole))
        except queue.Empty:
            pass
        except BaseException as error:
            done.put(error)
        finally:
            copy.close()

    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copies = [Copy(ROOT, Path(folder).resolve() / str(i)) for i in range(min(workers, len(mistakes)))]
        threads = [threading.Thread(target=work, args=(copy,), daemon=True) for copy in copies]
        try:
            for thread in threads:
                thread.start()
            for _ in mistakes:
                found = done.get()
                if isinstance(found, BaseException):
                    raise found
                yield found
        finally:
            stopped.set()
            for copy in copies:
                copy.kill()
            for thread in threads:
                thread.join()


def _drawn(paths: Sequence[str], count: int, seed: int) -> list[Mutant]:
    files = [
        file for path in paths for file in ([ROOT / path] if path.endswith(".py") else (ROOT / path).rglob("*.py"))
    ]
    if not files:
        sys.exit(f"{' '.join(paths)}: no Python files; expected files or folders of {PACKAGE}/, such as {PACKAGE}/fit")
    try:
        return list(draw(ROOT / PACKAGE, files, count, seed))
    except ModuleNotFoundError as error:
        sys.exit(f"{error}; expected cosmic-ray: run make mutants, which installs it")


def _entered() -> list[Measured]:
    with (
        tempfile.TemporaryDirectory(prefix="mutants-") as folder,
        contextlib.closing(Copy(ROOT, Path(folder).resolve() / "0")) as copy,
    ):
        copy.check_import()
        return list(measured(copy.root, CACHE, copy.seconds))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", default=[PACKAGE], metavar="PATH", help="files or folders to mutate")
    parser.add_argument("--sample", type=int, default=200, metavar="N", help="how many mutants to draw")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the draw")
    parser.add_argument("--kept", action="store_true", help="the mistakes of kept.yaml in place of mutants")
    parser.add_argument("--list", action="store_true", help="only list them")
    parser.add_argument("--missing", action="store_true", help="only print what no everyday test enters")
    parser.add_argument("--budget", type=float, default=60, metavar="S", help="seconds of tests for each")
    parser.add_argument("--whole", action="store_true", help="run the whole everyday suite for what they miss")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="copies that work at once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all verdicts to this file")
    asked = parser.parse_args()
    if asked.missing:
        print_missing(_entered(), asked.paths)
        return
    mistakes = list(KEPT) if asked.kept else _drawn(asked.paths, asked.sample, asked.seed)
    if asked.list:
        print(*(f"{each.file}: {each.name}" for each in mistakes), sep="\n")
        return
    entered = _entered()
    verdicts: list[Verdict] = []
    try:
        for verdict in examined(mistakes, asked.workers, entered, asked.budget, asked.whole):
            verdicts.append(verdict)
            print(f"[{len(verdicts)}/{len(mistakes)}] {verdict}", flush=True)
    except KeyboardInterrupt:
        print("interrupted")
    if asked.json is not None:
        keys = ("file", "name", "verdict", "what", "seconds")
        rows = [(v.mistake.file, v.mistake.name, v.verdict, v.what, round(v.seconds, 1)) for v in verdicts]
        asked.json.write_text(json.dumps([dict(zip(keys, row, strict=True)) for row in rows], indent=1) + "\n")
    survivors = [each for each in verdicts if each.verdict in (MISSED, NOT_THERE, UNKNOWN)]
    print(*(f"{each.verdict}: {each.mistake.file}: {each.mistake.name}" for each in survivors), sep="\n")
    counts = Counter(verdict.verdict for verdict in verdicts)
    killed = len(verdicts) - len(survivors)
    print(f"{killed} of {len(verdicts)} killed, {killed / max(len(verdicts), 1):.0%}: {dict(counts)}")
    sys.exit(asked.kept and bool(survivors))


if __name__ == "__main__":
    main()
