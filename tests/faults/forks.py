"""Runs pytest in forks of a process that has loaded the libraries: loading them takes longer than most tests do.

Its arguments are the libraries' names. It reads a line for each run, the file that its output goes to and pytest's
arguments as a list in JSON, and answers with the exit code on a line.
"""

import gc
import importlib
import json
import os
import sys


def main() -> None:
    for name in sys.argv[1:]:
        importlib.import_module(name)
    # So that no fork looks through what all of them share.
    gc.freeze()
    for line in sys.stdin:
        output, *arguments = json.loads(line)
        child = os.fork()
        if child == 0:
            _run(output, arguments)
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def _run(output: str, arguments: list[str]) -> None:
    import pytest

    code = 3
    try:
        with open(output, "wb") as file, open(os.devnull, "rb") as nothing:
            for source, target in ((nothing, 0), (file, 1), (file, 2)):
                os.dup2(source.fileno(), target)
        code = int(pytest.main(arguments))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        # Without what the process that was forked would do at its end.
        os._exit(code)


if __name__ == "__main__":
    main()
