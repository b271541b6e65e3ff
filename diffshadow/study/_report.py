"""Reports: one page of a finished run, sweep or recommendation, made again from its files."""

from pathlib import Path

from .. import io
from .files._stored import ADVISE, PICTURE, SHAPE, SWEEP, add_files, read_result, read_run
from .pages._report import write_report


def report(folder: Path, *, form: str | None = None, dpi: int = 150) -> Path:
    """Writes the page of the finished run, sweep or recommendation in `folder` again.

    **Arguments:**

    - `form`: `"png"`, `"svg"` or `"pdf"` writes the run's figures again, too, beside the page.
    - `dpi`: of these figures, in pixels per inch.

    **Returns** the page.

    **Raises** `FileError` if `folder` is missing, holds no run, sweep or recommendation, or an unfinished one, or
    cannot be written to, and `ValueError` if `dpi` is out of range.
    """
    if not 10 <= dpi <= 2400:
        raise ValueError(f"dpi is {dpi}; expected 10 to 2400 pixels per inch, such as 300")
    kind = read_result(folder)["kind"]
    io.check_writable(folder)
    if kind == SWEEP:
        # Here, since only sweeps need it.
        from .sweeps._report import report_sweep

        return report_sweep(folder, form)
    if kind == ADVISE:
        from .advice._report import report_advice

        return report_advice(folder, form, dpi)
    if kind == SHAPE:
        # Here, since it loads Matplotlib.
        from .pages._shape import report_shape

        return report_shape(folder, form, dpi)
    if kind == PICTURE:
        from .pages._picture import report_picture

        return report_picture(folder, form, dpi)
    run = read_run(folder)
    if form is not None:
        # Here, since it loads Matplotlib.
        from .pages._figures import write_figures

        add_files(folder, [path.name for path in write_figures(run, folder, form, dpi)])
    return write_report(run)
