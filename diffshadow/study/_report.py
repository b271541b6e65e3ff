"""Writes the page of a finished run, sweep or recommendation again, from its files."""

from pathlib import Path

from .. import io
from ..config import CONFIG_FILE, RESULT_FILE, load_config
from ..console import Command
from .pages._next import after_advice, after_run
from .record._files import read_record
from .record._runs import VisibilityRecord
from .record._stored import stored_run
from .record._sweeps import AdviseRecord, SweepRecord


def report(folder: Path, *, form: str | None = None, dpi: int = 150) -> Path:
    """Writes the page of the finished run, sweep or recommendation in `folder` again.

    **Arguments:**

    - `form`: `"png"`, `"svg"` or `"pdf"` also writes the run's figures to the folder again.
    - `dpi`: the figures' resolution, in pixels per inch.

    **Returns** the page.

    **Raises** `FileError` if `folder` is missing, has no finished run, sweep or recommendation, or cannot be written
    to; `ValueError` if `dpi` is out of range.
    """
    if not 10 <= dpi <= 2400:
        raise ValueError(f"dpi is {dpi}; expected 10 to 2400 pixels per inch, such as 300")
    record = read_record(folder)
    io.check_writable(folder)
    # Imported here because they load Matplotlib.
    if isinstance(record, SweepRecord):
        from .sweeps._report import report_sweep

        return report_sweep(folder, record, form)
    if isinstance(record, AdviseRecord):
        from .advice._report import report_advice

        return report_advice(folder, record, form, dpi)
    from .pages._report import write_report

    return write_report(stored_run(folder, record), form, dpi)


def next_after(folder: Path) -> list[Command]:
    """The next commands for the run, sweep or recommendation in `folder`, as on its page. Empty if `folder` is `None`,
    because only the first of several processes writes.

    **Raises** `FileError` if the folder is damaged.
    """
    if not (folder / RESULT_FILE).is_file():
        return []
    record = read_record(folder)
    if isinstance(record, SweepRecord):
        from .sweeps._report import commands_after

        return commands_after(folder, record)
    if isinstance(record, AdviseRecord):
        return after_advice(folder, None if record.advice is None else record.advice.engine, record.command)
    is_configured = isinstance(record, VisibilityRecord) and record.command is not None
    config = load_config(folder / CONFIG_FILE, [], files=False) if is_configured else None
    return after_run(folder, record, None if config is None else config.technique.type)
