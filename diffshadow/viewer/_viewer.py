"""Answers a page's requests: pictures with figures, configurations and code. This module is independent of browsers."""

import io
import json
import shlex
import time
from base64 import b64encode
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from rich.console import Console

from .. import shadow, study
from ..config import Config, changed, dump_resolved, parse_config, printable
from ._drawing_cache import DrawingCache, Frame, Picture, Recent
from ._fits import Fit
from ._pictures import OF_TRUTH, figures_of, picture_of, views_of
from ._state import Look, State
from ._subject import Subject, value_at
from ._trace import Tracer

_QUALITY = 90
# The largest full picture that is fast enough while a slider moves, in pixels, even with many taps.
_FAST_PIXELS = 256 * 256
_ANGLES = ("azimuth", "elevation")


class Shown(NamedTuple):
    """A picture for a page: a JPEG and its description."""

    jpeg: bytes
    about: dict[str, Any]


class Viewer:
    """A configuration and everything that pages show of it.

    - `name`: the configuration's name on the command line, for commands that can be pasted.
    - `traced`: called in another thread with the key of each new reference. `fitted` is called with the news of a fit.

    Several threads may call its methods. They share the drawn results.
    """

    def __init__(
        self,
        config: Config,
        name: str,
        traced: Callable[[Hashable], None] = lambda key: None,
        fitted: Callable[[dict[str, Any]], None] = lambda news: None,
    ):
        self.config, self.name = config, name
        self.cache = DrawingCache()
        self.tracer, self.fit = Tracer(traced), Fit(fitted)
        self._subjects = Recent()
        self.subject(State())

    @property
    def scenes(self) -> list[str]:
        """The names of the views of the configuration's fit."""
        return [view.name for view in self.config.views]

    def subject(self, state: State) -> Subject:
        """The configuration with the structure of `state`.

        **Raises** `ConfigError` if it is invalid or cannot be built.
        """
        key = json.dumps([state.scene, list(state.structure.items())])
        return self._subjects(key, lambda: Subject(self._structured(state)))

    def misfits(self, state: State) -> list[str]:
        """The errors in `state`, except in its structure, one sentence each. Pictures ignore them."""
        wrong = []
        if state.scene is not None and state.scene not in self.scenes:
            among = ", ".join(self.scenes)
            wrong = [
                f"scene is {printable(state.scene)}; expected {f'{among} or ' if among else ''}null, which is the "
                "configuration's own scene; choose another"
            ]
        return [*wrong, *self.subject(state).misfits(state)]

    def _checked(self, state: State) -> State:
        """`state` without numbers that its subject does not have.

        **Raises** `ValueError` if `state` has errors.
        """
        for sentence in self.misfits(state):
            raise ValueError(sentence)
        known = self.subject(state).sliders
        return state.model_copy(update={"numbers": {k: value for k, value in state.numbers.items() if k in known}})

    def close(self) -> None:
        """Stops tracing and fitting permanently."""
        self.tracer.close()
        self.fit.stop()

    def join(self) -> None:
        """Waits until nothing is traced or fitted."""
        self.tracer.join()
        self.fit.join()

    def _structured(self, state: State) -> Config:
        chosen = [view.config for view in self.config.views if view.name == state.scene]
        config = _alone(chosen[0] if chosen else self.config)
        if not state.structure:
            return config
        return parse_config(dump_resolved(config), overrides_of(state.structure), source="the page's settings")

    def frame(self, look: Look, *, full: bool) -> Frame:
        """The picture of `look`, at full or half size."""
        subject = self.subject(look.state)
        height, width = subject.full_size
        size = (height, width) if full else (max(height // 2, 1), max(width // 2, 1))
        return Frame(self.cache, subject, look, size)

    def show(self, look: Look, *, at_rest: bool) -> Shown:
        """A picture of `look`. While it moves, large pictures and pictures with a new surface or map have half the
        size. Views of the reference always have full size."""
        return self.shown(look, full=at_rest or self._is_fast(look))

    def _is_fast(self, look: Look) -> bool:
        """Whether a full picture of `look` is fast enough while it moves."""
        frame = self.frame(look, full=True)
        if frame.moves:
            return False
        of_truth = look.view in OF_TRUTH and self.tracer.reference(frame.truth_key) is not None
        return of_truth or frame.size[0] * frame.size[1] <= _FAST_PIXELS

    def shown(self, look: Look, *, full: bool) -> Shown:
        """A picture of `look` at full or half size."""
        started = time.perf_counter()
        frame = self.frame(look, full=full)
        known = self.tracer.known(self.frame(look, full=True).truth_key)
        truth = known.reference if full else None
        picture, view = picture_of(frame, look.view, truth), look.view
        if picture is None:
            picture, view = frame.shaded(), "shaded"
        if look.split:
            picture = np.concatenate([picture, self._before(frame, look, picture)])
        about = {
            "view": view,
            "is_full": full,
            "figures": {} if truth is None else figures_of(frame, truth),
            "rays": 0 if known.reference is None else known.reference.samples,
            "untraced": known.reason,
            "size": frame.size,
            "views": views_of(frame),
            "light": frame.light,
            "split": look.split,
            "milliseconds": round(1e3 * (time.perf_counter() - started)),
        }
        return Shown(_jpeg(picture), about)

    def trace(self, look: Look, page: Hashable = None) -> Hashable:
        """Starts to trace the reference of `look`, which `page` shows at rest. **Returns** its key."""
        frame = self.frame(look, full=True)
        self.tracer.want(page, frame.truth_key, frame.scene(frame.light), frame.subject.how)
        return frame.truth_key

    def controls(self, state: State) -> dict[str, Any]:
        """The data for a page's controls."""
        subject = self.subject(state)
        camera: Any = subject.config.scene.camera
        return {
            "name": subject.config.name,
            "sliders": [slider._asdict() for slider in subject.sliders.values()],
            "pickers": [picker._asdict() for picker in subject.pickers],
            "lights": [".".join(map(str, ("scene", *key))) for key in subject.config.scene.each_light],
            "scenes": self.scenes,
            "camera": {"eye": camera.eye, "target": camera.target, "height": getattr(camera, "height", None)},
            "up": camera.up,
            "size": subject.size,
            "engines": [*shadow.ENGINE_TECHNIQUES],
            "middle": subject.middle,
            "radius": subject.radius,
            "box": {"low": subject.box[0], "high": subject.box[1]},
            "resolution": subject.config.scene.camera.resolution,
            "fitted": subject.fitted,
            "fit": self.fit.state,
        }

    def save(self, state: State) -> dict[str, Any]:
        """The configuration of `state` as YAML, and the command that draws it.

        **Raises** `ValueError` if `state` has errors.
        """
        state = self._checked(state)
        config = self.subject(state).saved(state)
        command = ["diffshadow", "render", self.name, *overrides_of(settings_of(state, self.config, config))]
        return {"yaml": dump_resolved(config), "name": f"{config.name}-view.yaml", "command": shlex.join(command)}

    def png(self, look: Look) -> str:
        """The full picture of `look` as a PNG in base64, without a second picture to compare with."""
        frame = self.frame(look, full=True)
        picture = picture_of(frame, look.view, self.tracer.reference(frame.truth_key))
        out = io.BytesIO()
        Image.fromarray(frame.shaded() if picture is None else picture).save(out, "PNG")
        return b64encode(out.getvalue()).decode()

    def start_fit(self, state: State) -> int | None:
        """Starts a fit from `state`, unless one is running. **Returns** its number.

        **Raises** `ConfigError` for settings that cannot be fitted, and `ValueError` if nothing is chosen to be fitted.
        """
        state = self._checked(state)
        return self.fit.start(self.subject(state).saved(state, fitting=True))

    def code(self, look: Look) -> str:
        """The settings of `look` for engines: code, or a table of biases and radii.

        **Raises** `ConfigError` for settings that no engine has, and `ValueError` if `state` has errors.
        """
        state = self._checked(look.state)
        config = self.subject(state).saved(state)
        text = Console(file=io.StringIO(), width=100)
        changes = overrides_of(settings_of(state, self.config, config))
        study.convert(config, console=text, source=self.name, overrides=changes, fits=False)
        return text.file.getvalue()  # type: ignore[attr-defined]

    def _before(self, frame: Frame, look: Look, like: Picture) -> Picture:
        """The same view with the configuration's own technique, or with the defaults of an engine."""
        scene = {key: value for key, value in look.state.structure.items() if key.startswith("scene.")}
        if isinstance(look.split, str):
            scene["technique"] = {"type": look.split}
        own = self.subject(look.state.model_copy(update={"structure": scene}))
        numbers = {name: value for name, value in look.state.numbers.items() if name.startswith(("scene.", "shading."))}
        state = look.state.model_copy(update={"structure": scene, "numbers": numbers})
        before = Frame(self.cache, own, look.model_copy(update={"state": state}), frame.size)
        truth = self.tracer.reference(before.truth_key)
        picture = picture_of(before, look.view, truth)
        same = picture is not None and picture.shape == like.shape
        return picture if same else before.shaded()  # type: ignore[return-value]


def settings_of(state: State, given: Config, now: Config) -> dict[str, Any]:
    """All changes of `state`, by dotted key, in the order in which they can be set.

    **Arguments:** `given`: the original configuration. `now`: the changed configuration.
    """
    settings: dict[str, Any] = dict(state.structure)
    for name in state.numbers:
        key, _, entry = name.rpartition(".")
        # A list that the file does not have is set as a whole.
        settings |= {key: list(value_at(now, key))} if entry.isdigit() else {name: value_at(now, name)}
    for key in (".".join(map(str, ("scene", *each))) for each in given.scene.each_light):
        moved = any(name.startswith(f"{key}.") for name in state.numbers)
        if moved and getattr(value_at(given, key), "direction", None) is not None:
            settings |= {f"{key}.direction": None, **{f"{key}.{a}": value_at(now, f"{key}.{a}") for a in _ANGLES}}
    if any(name.partition(".")[0] == "filter" for name in settings):
        # Without this value, they would follow the filter.
        settings |= {name: value_at(now, name) for name in ("bias.constant", "bias.slope", "bias.normal_offset")}
    if state.camera is not None:
        if getattr(given.scene.camera, "orbit", None) is not None:
            settings["scene.camera.orbit"] = None
        settings |= {f"scene.camera.{key}": value for key, value in state.camera if value is not None}
    return settings


def overrides_of(settings: dict[str, Any]) -> list[str]:
    """`settings` as KEY=VALUE."""
    return [f"{key}={json.dumps(value)}" for key, value in settings.items()]


def _alone(config: Config) -> Config:
    """`config` without other views, sweeps and advice."""
    return changed(config, fit=changed(config.fit, views=None, validation=None, shape=None), sweep=None, advise=None)


def _jpeg(picture: Picture) -> bytes:
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=_QUALITY, subsampling=0)
    return out.getvalue()
