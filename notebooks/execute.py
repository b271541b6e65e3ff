"""Executes the notebooks' texts, and writes each with its outputs to the `.ipynb` of the same name.

    python notebooks/execute.py                # all of them
    python notebooks/execute.py first_look     # some

Neither times nor random numbers are written, so that a notebook changes only where its text or its outputs do.
"""

import os
import sys
from pathlib import Path

import jupytext
import nbformat
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
_KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}
# Of kernels: the lines that show progress would stay as empty outputs.
os.environ["DIFFSHADOW_PROGRESS"] = "0"
_SECONDS = 600
"""That a cell may take."""


def text_of(path: Path) -> nbformat.NotebookNode:
    """The notebook that the text at `path` stands for, without outputs."""
    notebook = jupytext.read(path, fmt="py:percent")
    for number, cell in enumerate(notebook.cells):
        tags = cell.metadata.get("tags")
        cell["id"], cell["metadata"] = f"cell-{number}", {"tags": tags} if tags else {}
    notebook.metadata = {"kernelspec": _KERNEL}
    return notebook


def executed(path: Path, kernel: KernelManager | None = None) -> nbformat.NotebookNode:
    """The notebook of the text at `path` with its outputs.

    **Arguments:**

    - `kernel`: one that runs already, and forgets all names first; by default a new one.

    **Raises** `nbclient.exceptions.CellExecutionError` if a cell does.
    """
    notebook = text_of(path)
    if kernel is not None:
        notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))
    where = {"metadata": {"path": FOLDER}}
    client = NotebookClient(notebook, kernel, timeout=_SECONDS, record_timing=False, resources=where)
    notebook = client.execute()
    if kernel is not None:
        # The client leaves a kernel that it did not start as it is, and its own sockets too.
        assert client.kc is not None
        client.kc.stop_channels()
        del notebook.cells[0]
    # The version of Python that happened to run it.
    notebook.metadata.pop("language_info", None)
    return notebook


def main(names: list[str]) -> None:
    """Executes the notebooks with these `names`, or all."""
    texts = [FOLDER / f"{name}.py" for name in names] or sorted(
        file.with_suffix(".py") for file in FOLDER.glob("*.ipynb")
    )
    for text in texts:
        nbformat.write(executed(text), text.with_suffix(".ipynb"))
        print(text.with_suffix(".ipynb").name)


if __name__ == "__main__":
    main(sys.argv[1:])
