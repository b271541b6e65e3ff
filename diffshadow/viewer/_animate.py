"""Animations of a configuration whose numbers change, and of a stored fit."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .. import io, metrics, study
from .._checks import check_value
from ..config import CONFIG_FILE, Config, dump_resolved, load_config, numbers_of, parse_config, with_number
from ._drawing_cache import DrawingCache, Frame, Picture
from ._pictures import OF_TRUTH, as_picture, picture_of
from ._state import Look, State, View
from ._subject import Subject, at_most

ANIMATION = "animation.webp"
"""The name of the animation in a fit's folder."""
PIXELS = 384 * 288
"""The default limit of a frame's size, in pixels."""
# How long the last frame of a fit and each other frame are shown, in milliseconds.
_LAST, _STEP = 2000, 90
# The maximum number of frames of a fit.
_MOST_STEPS = 60
# The size of the text below the frames of a fit.
_CAPTION, _FONT = 18, 13
_AXES = re.compile(r"\.([xyz])$")


class Change(NamedTuple):
    """A number that goes from `first` to `last`. `key` is its dotted key."""

    key: str
    first: float
    last: float

    def at(self, part: float) -> float:
        """The number at the fraction `at` of the animation, from 0 to 1."""
        return self.first + part * (self.last - self.first)


class Animation(NamedTuple):
    """The file of an animation, and the flicker of its shadow (`metrics.flicker`) if a reference was traced."""

    path: Path
    flicker: float | None


def animate(
    config: Config,
    changes: Sequence[Change],
    output: Path,
    *,
    frames: int = 60,
    seconds: float = 3.0,
    view: Any = "shaded",
    pixels: int = PIXELS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> "Animation":
    """Writes an animation of `config` in which numbers change evenly from frame to frame.

    **Arguments:**

    - `changes`: any numbers of the schema. They all change at once.
    - `output`: an animated `.webp`, `.gif` or `.png` file.
    - `frames`, `seconds`: the number of frames, and the length of the animation.
    - `view`: the view to draw; `reference`, `error` and `acne and leaks` trace rays for each frame.
    - `pixels`: the maximum number of pixels in a frame.
    - `progress`: called with the number of finished frames and the number of all frames.

    **Raises** `ConfigError` for an unknown key or a value outside its limits, before anything is drawn. **Raises**
    `FileError` if the file cannot be written.
    """
    check_value("--view", view, View)
    text, cache = dump_resolved(config), DrawingCache()
    parsed = lambda at: parse_config(text, _settings(changes, at), source="the animation")
    first, last = parsed(0.0), parsed(1.0)
    # If the first and the last numbers are valid, so are the numbers between them.
    is_known = {change.key for change in changes} <= numbers_of(first).keys()
    between = [_between(first, changes, at) if is_known else parsed(at) for at in _steps_between(frames)]
    configs = [first, *between, last]
    ranges = {change.key: (min(change[1:]), max(change[1:])) for change in changes}
    subject = Subject(first, ranges)
    measured: list[tuple[Any, ...]] = []
    size = at_most(config.scene.camera.resolution, pixels)
    pictures = []
    for done, each in enumerate(configs):
        frame = Frame(cache, subject, Look(state=State(), view=view), size, each)
        truth = None
        if view in OF_TRUTH:
            truth = study.trace(frame.scene(frame.light), subject.how, lambda _: None)
            mask = frame.covered(frame.light) & truth.mask
            measured.append((np.asarray(frame.visibility(frame.light)), truth.visibility, mask))
        picture = picture_of(frame, view, truth)
        if picture is None:
            what = f"which {config.technique.type} does not have"
            raise ValueError(f"--view is {view!r}, {what}; expected another view, such as shaded; change it")
        pictures.append(picture)
        progress(done + 1, frames)
    _write(output, pictures, round(1000 * seconds / frames))
    return Animation(output, metrics.flicker(*map(np.stack, zip(*measured, strict=True))) if measured else None)


def animate_run(folder: Path, output: Path | None = None, *, pixels: int = PIXELS) -> Path:
    """Writes an animation of a stored fit. Each frame shows the shaded picture and the error of the visibility at one
    step.

    Nothing is fitted again. Without `output`, the animation is written to the run's folder, and the report of the run
    shows it.

    **Returns** the animation. **Raises** `FileError` for a folder without a fit, or for a fit that no configuration
    describes: turned meshes, shapes, and fits made in Python.
    """
    run = study.read_run(folder)
    if not study.is_fit(run) or run.record.command is None:
        raise io.FileError(
            f"{folder} holds a render or a fit made in Python; expected a fit by the command; give one, or a "
            "configuration with KEY=FROM:TO"
        )
    config = load_config(folder / CONFIG_FILE)
    config = config.views[0].config if config.views else config
    names = [_AXES.sub(lambda axis: f".{'xyz'.index(axis[1])}", name) for name in run.record.fitted]
    subject = Subject(config)
    if missing := [name for name in names if name not in subject.sliders]:
        what = f"holds a fit of {missing[0]}, which no configuration states"
        raise io.FileError(f"{folder} {what}; expected numbers of lights or of the technique; give another fit")
    light, cache, pictures = run.lights[0], DrawingCache(), []
    for number, values in _steps(run):
        state = State(numbers=dict(zip(names, values, strict=True)))
        frame = Frame(cache, subject, Look(state=state), light.reference.shape)
        image = np.asarray(frame.visibility(0))
        wrong = np.where(light.mask, image - light.reference, 0)
        both = np.concatenate([frame.shaded(), as_picture(study.difference_colours(wrong, light.mask))], axis=1)
        error = metrics.rmse(image, light.reference, light.mask)
        words = [f"step {number}", f"RMSE {error:.4f}", *(f"{n} {v:.3g}" for n, v in state.numbers.items())]
        pictures.append(_captioned(both, "   ".join(words), at_most((both.shape[0], both.shape[1]), pixels)))
    written = folder / ANIMATION if output is None else output
    _write(written, pictures, [*[_STEP] * (len(pictures) - 1), _LAST])
    if output is None:
        study.add_files(folder, [ANIMATION])
        study.report(folder)
    return written


def _settings(changes: Sequence[Change], at: float) -> list[str]:
    """The overrides of all changes at the fraction `at`."""
    return [f"{each.key}={each.at(at)!r}" for each in changes]


def _between(config: Config, changes: Sequence[Change], at: float) -> Config:
    """`config` with all changes at the fraction `at`."""
    for each in changes:
        config = with_number(config, each.key, each.at(at))
    return config


def _steps_between(frames: int) -> list[float]:
    """The fractions of all frames except the first and the last."""
    return np.linspace(0, 1, frames)[1:-1].tolist()


def _steps(run: study.VisibilityRun[Any]) -> list[tuple[int, list[float]]]:
    """The numbers and the values of the steps to show. There are at most `_MOST_STEPS`, and the last is the result."""
    values = study.history(run).values
    every = -(-len(values) // _MOST_STEPS)
    chosen = range(0, len(values), every)
    result = list(run.record.fitted.values())
    return [*((number, values[number].tolist()) for number in chosen), (len(values), result)]


def _captioned(picture: Picture, words: str, size: tuple[int, int]) -> Picture:
    """`picture` at another size, with a caption."""
    height, width = size
    shown = Image.new("RGB", (width, height + _CAPTION), "white")
    shown.paste(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX))
    ImageDraw.Draw(shown).text((4, height + 1), words, fill="black", font=ImageFont.load_default(_FONT))
    return np.asarray(shown)


def _write(output: Path, pictures: Sequence[Picture], milliseconds: int | list[int]) -> None:
    io.write_animation(output, np.stack(pictures)[:, ::-1], milliseconds)
