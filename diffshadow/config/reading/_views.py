"""The views of a fit: configurations that differ in their scenes."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from .._errors import ConfigError, Mistake, Origin, show
from ..sections._axes import ViewsConfig
from ..sections._config import Config, FitView
from ..sections._scene import BUILTIN, MAX_PIXELS
from ..sections._section import is_number
from ._axes import Choice, levels_of, written
from ._draft import Draft

KINDS = ("views", "validation")
"""The sections of a fit that have views."""
_MAX_VIEWS = 4096
# The keys that distinguish views.
_COMPARED = {"scene", "reference", "shadow_map"}

Views = tuple[FitView, ...]


def views_of(config: Config, draft: Draft, check: Callable[[Draft], Config]) -> tuple[Views, Views]:
    """The views that a fit of `config` sees, and the views of its validation.

    **Arguments:**

    - `draft`: the draft of `config`.
    - `check`: makes a configuration from a draft.

    **Raises** `ConfigError` with the mistakes of all views, if there are too many views, or if a view is in both
    groups.
    """
    fit, places = dict(draft.data.get("fit") or {}), draft.origin.places
    for kind in KINDS:
        fit.pop(kind, None)
    kept = {path: place for path, place in places.items() if path[:2] not in [("fit", kind) for kind in KINDS]}
    base = draft._replace(data={**draft.data, "fit": fit}, origin=Origin(draft.origin.source, kept))
    seen, unseen = (
        _views(config, section, draft, base, check) for section in (config.fit.views, config.fit.validation)
    )
    described = [_described(view) for view in seen]
    for view in unseen:
        if _described(view) in described:
            message = f"holds the view {view.name}, which the fit sees; expected views apart from fit.views; change it"
            raise ConfigError([Mistake(draft.origin.place(("fit", "validation")), "fit.validation", message)])
    return seen, unseen


def _views(
    config: Config, section: ViewsConfig | None, draft: Draft, base: Draft, check: Callable[[Draft], Config]
) -> Views:
    if section is None:
        return ()
    levels, key = levels_of(section, draft), section.at
    place = draft.origin.place(tuple(key.split(".")))
    count = math.prod(map(len, levels))
    if count > _MAX_VIEWS:
        message = f"makes {count:,} views; expected at most {_MAX_VIEWS:,}; shorten its lists"
        raise ConfigError([Mistake(place, key, message)])
    views, mistakes = [], {}
    rows = list(itertools.product(*levels))
    for name, choices in zip(_names(rows), rows, strict=True):
        try:
            changed = base
            for choice in choices:
                changed = written(changed, choice, draft.origin)
            views.append(FitView(name, check(changed)))
        except ConfigError as error:
            named = [replace(each, message=f"{each.message} (in the view {name})") for each in error.mistakes]
            # A fault of all views is reported once, for the first view.
            mistakes |= {
                (each.key, each.message): full
                for each, full in zip(error.mistakes, named, strict=True)
                if (each.key, each.message) not in mistakes
            }
    if mistakes:
        raise ConfigError(mistakes.values())
    for view in views:
        if view.config.scene.camera.resolution != config.scene.camera.resolution:
            have, need = list(view.config.scene.camera.resolution), list(config.scene.camera.resolution)
            message = f"has images of {have} in the view {view.name}, and others have {need}; expected the same"
            raise ConfigError([Mistake(place, key, f"{message}; set scene.camera.resolution outside of the views")])
    pixels = sum(math.prod(view.config.scene.camera.resolution) for view in views)
    if pixels > MAX_PIXELS:
        message = f"has {pixels:,} pixels in {count:,} views; expected at most {MAX_PIXELS:,}, which take 5 GB"
        mend = "lower scene.camera.resolution, or use fewer views"
        raise ConfigError([Mistake(place, key, f"{message}; {mend}")])
    return tuple(views)


def _names(rows: Sequence[Sequence[Choice]]) -> list[str]:
    """A short name for each combination of choices, or the whole keys if short names are not unique."""
    for short in (True, False):
        names = [", ".join(_name(choice, short) for choice in row) for row in rows]
        if len(set(names)) == len(names):
            break
    return names


def _name(choice: Choice, short: bool) -> str:
    """The text that distinguishes a choice from others, on one line."""
    if choice.label is not None:
        return choice.label

    def shown(key: str, value: Any) -> str:
        if isinstance(value, str):
            return Path(value.removeprefix(BUILTIN)).stem if short else f"{key} = {value}"
        text = f"{value:.4g}" if is_number(value) and short else show(value)
        return f"{key.split('.')[-1]} {text}" if short else f"{key} = {text}"

    return ", ".join(shown(key, value) for key, value in choice.values.items())


def _described(view: FitView) -> Any:
    return view.config.model_dump(mode="json", include=_COMPARED, warnings=False)
