"""A benchmark's case in a process of its own."""

import json
import os
import subprocess
import sys
import tempfile
from typing import Any


def rows_of_child(script: str, case: str, *arguments: str) -> list[dict[str, Any]]:
    """Runs `script --child` with more arguments in a separate process, with an empty cache of programs.

    **Arguments:** `case`: the subject of the error's message.

    **Returns** what the process prints as lines of JSON.

    **Raises** `RuntimeError` with the end of the process's error output if it fails.
    """
    command = [sys.executable, script, "--child", *arguments]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "DIFFSHADOW_CACHE": folder}
        child = subprocess.run(command, capture_output=True, text=True, env=environment)
    rows = [json.loads(line) for line in child.stdout.splitlines() if line.startswith("{")]
    if child.returncode:
        how = f"exit code {child.returncode} after {len(rows)} results (-9 means that memory ran out)"
        raise RuntimeError(f"{case} ended with {how}:\n{child.stderr[-2000:]}")
    return rows
