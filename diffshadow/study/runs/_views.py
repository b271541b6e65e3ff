"""The views of a fit: its own scene, or the views in `fit.views` and `fit.validation`."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

from ... import shadow
from ...config import Config, ConfigError, FitView, Mistake, build_technique
from .._drawn import Drawn
from ..remarks._scene import scene_remarks
from ._progress import Progress
from ._setup import Loaded, draw, load

# The sections that what is loaded depends on.
_MESHES = ("meshes",)


class DrawnView(NamedTuple):
    """A view, drawn.

    - `name`: a unique name; empty for the configuration's own scene.
    - `config`: its configuration; none for a fit that was made in Python.
    - `technique`: the technique at the start; none for a fit that was made in Python.
    - `drawn`: its scene, for each of its lights.
    """

    name: str
    config: Config | None
    technique: shadow.AbstractTechnique | None
    drawn: list[Drawn]


class Views(NamedTuple):
    """All views of a fit.

    - `fitted`: the fit sees these; `validation`: its result is measured on these.
    """

    fitted: list[DrawnView]
    validation: list[DrawnView]

    @property
    def all(self) -> list[DrawnView]:
        """All views, the fitted ones first."""
        return [*self.fitted, *self.validation]

    @property
    def drawn(self) -> list[Drawn]:
        """The scenes and lights of all views."""
        return [each for view in self.all for each in view.drawn]

    @property
    def parts(self) -> list[tuple[DrawnView, slice]]:
        """Each view, and where its scenes and lights are among all."""
        ends = list(itertools.accumulate(len(view.drawn) for view in self.all))
        return [(view, slice(end - len(view.drawn), end)) for view, end in zip(self.all, ends, strict=True)]

    @property
    def seen(self) -> int:
        """How many of the scenes and lights the fit sees."""
        return sum(len(view.drawn) for view in self.fitted)

    @property
    def remarks(self) -> list[str]:
        """Sentences on all scenes, each once."""
        found: dict[str, None] = {}
        for view in self.all:
            lit = [each.scene for each in view.drawn]
            of_files = view.drawn[0].remarks
            found |= dict.fromkeys(of_files)
            if view.config is not None and view.technique is not None:
                found |= dict.fromkeys(scene_remarks(view.config, view.technique, lit, view.drawn[0].surface))
        return list(found)

    def of(self, index: int) -> int:
        """The index of the view that has the scene and light at `index` among all."""
        return next(i for i, (_, part) in enumerate(self.parts) if index < part.stop)


def draw_views(config: Config, loaded: Loaded, technique: shadow.AbstractTechnique, progress: Progress) -> Views:
    """Draws the views of `config` and finds their references. Each reference is cached, so that a changed view traces
    only its own reference again.

    **Arguments:**

    - `loaded`, `technique`: what `config` loads, and its technique.

    **Raises** `ConfigError` as `draw` does, for the first view that has a fault.
    """
    own = lambda: [DrawnView("", config, technique, draw(config, loaded, technique, progress, comparing=True))]
    fitted = _drawn_in_turn("view", config.views, config, technique, progress) or own()
    if not any(each.reference.visibility[each.mask].any() for view in fitted for each in view.drawn):
        what = "are dark in all pixels that count, so that there is nothing to compare; expected some in light"
        path = ("fit", "views")
        raise ConfigError([Mistake(config.origin.place(path), ".".join(path), f"{what}; change their lights")])
    return Views(fitted, _drawn_in_turn("view of validation", config.validation, config, technique, progress))


class _Kept(NamedTuple):
    """What views have in common, by the sections that it depends on, as JSON: their meshes, and what cameras see."""

    loaded: dict[str, Loaded]
    seen: dict[str, Drawn]


def _drawn_in_turn(
    what: str, views: Sequence[FitView], config: Config, technique: shadow.AbstractTechnique, progress: Progress
) -> list[DrawnView]:
    """Draws `views` of a fit of `config`, and shows how many there are."""
    found, kept = [], _Kept({}, {})
    for view in progress.counted(what, views):
        is_alike = view.config.shadow_map == config.shadow_map
        found.append(_drawn(view, technique if is_alike else None, kept, progress))
    return found


def _drawn(view: FitView, technique: shadow.AbstractTechnique | None, kept: _Kept, progress: Progress) -> DrawnView:
    name, config = view
    meshes, sight = (config.scene.model_dump_json(include=set(parts)) for parts in (_MESHES, (*_MESHES, "camera")))
    try:
        loaded = load(config, progress, kept.loaded.get(meshes))
        technique = build_technique(config) if technique is None else technique
        like = kept.seen.get(sight)
        drawn = draw(config, loaded, technique, progress, surface=None if like is None else like.surface)
    except ConfigError as error:
        named = [dataclasses.replace(each, message=f"{each.message} (in the view {name})") for each in error.mistakes]
        raise ConfigError(named) from error
    kept.loaded[meshes] = loaded
    like = kept.seen.setdefault(sight, drawn[0])
    # Rays through pixels' centres see the same, whatever the light. Many views would not fit into memory otherwise.
    seen = {name: getattr(like.reference, name) for name in ("position", "normal", "face")}
    drawn = [each._replace(reference=dataclasses.replace(each.reference, **seen)) for each in drawn]
    key = lambda each: name if len(drawn) == 1 else f"{name}, {each.key}"
    return DrawnView(name, config, technique, [each._replace(key=key(each)) for each in drawn])
