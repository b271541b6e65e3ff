"""Commands for what is looked at: view, animate, report and compare."""

import os
import re
import sys
from pathlib import Path
from typing import Any, Literal

from ..config import is_mesh, load_config
from ..console import Console
from ..settings.quantities import MAX_TEXELS
from ._app import SUCCESS, app, check_count, counting, file_of, loaded, print_end, to_try
from ._jax import start_jax

# More frames would take gigabytes.
_MAX_FRAMES = 1000
# A number that changes, as KEY=FROM:TO.
_CHANGE = re.compile(r"([^=]+)=([-+.\deE]*\d\.?):([-+.\deE]*\d\.?)")


@app.command
def view(config: Path, /, *overrides: str, port: int = 0, browser: bool = True) -> None:
    """Opens a page in the browser that shows CONFIG and redraws it while you drag its settings. Ctrl-C ends it.

    Example: `diffshadow view configs/quickstart.yaml`

    Parameters
    ----------
    config
        YAML file, mesh file, folder of a finished run or builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    port
        Port to listen on, on this machine only; 0 is any free one.
    browser
        Whether to open the page in a browser.
    """
    file = file_of(config)
    # Mistakes are reported before the address. What is left out is found once the page is there, since that loads
    # meshes. A mesh file alone has no mistakes in keys.
    if overrides or not is_mesh(file) or not file.is_file():
        load_config(file, overrides, finding=is_mesh(file))
    from ..viewer import run

    settings = lambda: loaded(file, overrides)
    run(settings, name=str(config), console=Console(), port=port, browser=browser, start=start_jax)
    to_fit, _, to_render = to_try(config, overrides)
    print_end(None, [to_fit, to_render])
    # Threads that draw or trace would delay an ordinary exit.
    sys.stdout.flush()
    os._exit(SUCCESS)


@app.command
def animate(
    source: Path,
    /,
    *settings: str,
    output: Path | None = None,
    frames: int = 60,
    seconds: float = 3.0,
    view: str = "shaded",
    pixels: int = 384 * 288,
) -> None:
    """Writes an animation of a configuration whose numbers change, or of a finished fit.

    The animation of a fit is written to the fit's folder and shown in its report. The path of the animation is the last
    line printed.

    Example: `diffshadow animate configs/quickstart.yaml scene.light.azimuth=-150:-70`

    Example: `diffshadow animate runs/quickstart`

    Parameters
    ----------
    source
        YAML file, mesh file or builtin:NAME with changing numbers, or the folder of a fit without.
    settings
        KEY=FROM:TO of numbers that change, all at once, and KEY=VALUE of others.
    output
        Path of the animation: .webp, .gif or .png. By default NAME.webp in the current folder, or the fit's folder.
    frames
        Number of frames.
    seconds
        Seconds that they take.
    view
        What is shown, such as shaded, visibility, error or "shadow map".
    pixels
        Most pixels of a frame, which keeps the camera's aspect.
    """
    check_count("--frames", frames, 2, _MAX_FRAMES)
    check_count("--pixels", pixels, 1, MAX_TEXELS**2)
    if not 0 < seconds < _MAX_FRAMES:
        raise ValueError(f"--seconds is {seconds:g}; expected more than 0 and less than {_MAX_FRAMES}; change it")
    changes = [found.groups() for each in settings if (found := _CHANGE.fullmatch(each))]
    overrides = [each for each in settings if not _CHANGE.fullmatch(each)]
    if not changes and not source.is_dir():
        raise ValueError(
            f"no number of {source} changes; expected KEY=FROM:TO, such as scene.light.azimuth=-150:-70, or the folder "
            "of a fit"
        )
    if not changes:
        if overrides:
            raise ValueError(f"{overrides[0]} sets a value of a finished fit; expected its folder alone; leave it out")
        start_jax()
        from .. import study, viewer

        made_of = viewer.animate_run(source, output, pixels=pixels)
        print_end(made_of, study.next_after(source))
        return
    settled = loaded(source, overrides)
    start_jax()
    from .. import viewer

    with counting("drawing frames") as progress:
        file = Path(f"{settled.name}.webp") if output is None else output
        moving = [viewer.Change(key, float(first), float(last)) for key, first, last in changes]
        how: Any = {"frames": frames, "seconds": seconds, "view": view, "pixels": pixels}
        made = viewer.animate(settled, moving, file, **how, progress=progress)
    if made.flicker is not None:
        Console().print(f"flicker {made.flicker:.4f}: the error's RMS change from frame to frame", soft_wrap=True)
    print_end(made.path, to_try(source, overrides))


@app.command
def report(folder: Path, /, *, figures: Literal["png", "svg", "pdf"] | None = None, dpi: int = 150) -> None:
    """Rewrites the page of a finished run, sweep or recommendation from the files in FOLDER.

    The path of the page is the last line printed.

    Example: `diffshadow report runs/quickstart --figures pdf`

    Parameters
    ----------
    folder
        Folder of a fit, a render, a sweep or a recommendation.
    figures
        Also rewrite the run's figures, in this format; the shadow map and debug views are kept.
    dpi
        Pixels per inch in these figures.
    """
    from .. import study

    page = study.report(folder, form=figures, dpi=dpi)
    print_end(page, study.next_after(folder))


@app.command
def compare(first: Path, second: Path, /, *more: Path, output: Path = Path("compare.html")) -> None:
    """Prints the differences between finished runs, and writes a page with their images side by side.

    The path of the page is the last line printed.

    Example: `diffshadow compare runs/quickstart runs/spot --output comparison.html`

    Parameters
    ----------
    first
        Folder of a fit or a render.
    second
        Folder of another one.
    more
        Folders of further ones.
    output
        Path of the page. An existing file is replaced.
    """
    if output.is_dir():
        raise ValueError(
            f"--output is {output}, a folder; expected the path of a page; name a file such as compare.html"
        )
    from .. import study

    folders = [first, second, *more]
    print_end(study.compare(folders, output, console=Console()), study.after_comparison(folders, output))
