"""Runs pytest in forks of a process that has loaded the libraries: loading them takes longer than most tests do.

Its arguments are the libraries' names. It reads a line for each run, the file that its output goes to and pytest's
arguments as a list in JSON, and answers with the exit code on a line. A file of the same name with the suffix `.tests`
then has the tests' seconds and a list of those that failed, in JSON.
"""

import gc
import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any


def main() -> None:
    for name in sys.argv[1:]:
        importlib.import_module(name)
    # The garbage collector of a fork then leaves alone what all forks share.
    gc.freeze()
    for line in sys.stdin:
        output, *arguments = json.loads(line)
        child = os.fork()
        if child == 0:
            _run(output, arguments)
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


class _Reports:
    """A plugin that gathers how long each test takes, and which fail or cannot be collected."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.failed: list[str] = []

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0) + report.duration
        self.pytest_collectreport(report)

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed and report.nodeid not in self.failed:
            self.failed.append(report.nodeid)


def _run(output: str, arguments: list[str]) -> None:
    import pytest

    code, reports = 3, _Reports()
    try:
        with open(output, "wb") as file, open(os.devnull, "rb") as nothing:
            for source, target in ((nothing, 0), (file, 1), (file, 2)):
                os.dup2(source.fileno(), target)
        code = int(pytest.main(arguments, plugins=[reports]))
    finally:
        Path(output).with_suffix(".tests").write_text(json.dumps([reports.seconds, reports.failed]))
        sys.stdout.flush()
        sys.stderr.flush()
        # Without what the process that was forked would do at its end.
        os._exit(code)


if __name__ == "__main__":
    main()
