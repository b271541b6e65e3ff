"""The views of a fit: its own scene, or the views in `fit.views` and `fit.validation`."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ... import fit, raster, shadow
from ..._types import HostArray
from ...config import Config, ConfigError, FitView, Mistake, build_technique
from .._drawn import Drawn, without_looks
from ..remarks._scene import scene_remarks
from ._progress import Progress
from ._setup import Loaded, draw, load

# The sections that what is loaded depends on.
_MESHES = ("meshes",)
# So many views are kept in little memory.
_MANY = 64


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


class _Kept:
    """What views have in common, by the sections that it depends on, as JSON; and the memory of many views.

    - `loaded`: their meshes; `seen`: what cameras see, and what rays see at the centres of pixels.
    - `surfaces`, `truths`, `maps`: where the surfaces, references with masks, and maps of many views are, each once;
        else none.
    """

    def __init__(self, maps: int | None):
        self.loaded: dict[str, Loaded] = {}
        self.seen: dict[str, tuple[raster.Surface, dict[str, HostArray]]] = {}
        self.maps = None if maps is None else _Maps(maps)
        self.surfaces, self.truths = fit.Rows(maps or 0), fit.Rows(maps or 0)

    def see(self, sight: str, drawn: Drawn) -> tuple[raster.Surface, dict[str, HostArray]]:
        """The surface that is kept for a camera, and what rays see; of many views, nothing of the rays."""
        if sight not in self.seen:
            truth, surface = drawn.reference, drawn.surface
            by_rays = {"position": truth.position, "normal": truth.normal, "face": truth.face}
            if self.maps is not None:
                surface = self.surfaces.put(without_looks(surface))
                by_rays = {name: np.broadcast_to(own.dtype.type(0), own.shape) for name, own in by_rays.items()}
            self.seen[sight] = surface, by_rays
        return self.seen[sight]

    def keep(self, drawn: Drawn) -> Drawn:
        """The view; if there are many, with its map, reference and mask in the memory that they share."""
        if self.maps is None:
            return drawn
        visibility, mask = self.truths.put((drawn.reference.visibility, drawn.mask))
        truth = dataclasses.replace(drawn.reference, visibility=visibility)
        return self.maps.take(drawn._replace(reference=truth, mask=mask))


def _drawn_in_turn(
    what: str, views: Sequence[FitView], config: Config, technique: shadow.AbstractTechnique, progress: Progress
) -> list[DrawnView]:
    """Draws `views` of a fit of `config`, and shows how many there are."""
    are_many = len(views) >= _MANY and isinstance(technique, shadow.ShadowMapping) and config.fit.devices == 1
    maps = sum(len(view.config.scene.each_light) for view in views)
    found, kept = [], _Kept(maps if are_many else None)
    for view in progress.counted(what, views):
        is_alike = view.config.shadow_map == config.shadow_map
        found.append(_drawn(view, technique if is_alike else None, kept, progress))
    return found if kept.maps is None else kept.maps.placed(found)


class _Maps:
    """The maps of views, moved into one atlas as they are drawn: memory then holds each once.

    - `count`: how many there are.
    """

    def __init__(self, count: int):
        self.count, self.taken = count, 0
        self.atlas: shadow.Atlas | None = None

    def take(self, drawn: Drawn) -> Drawn:
        """With its map moved, if that has no silhouettes and is as large as the first."""
        own = drawn.stored
        if own.silhouettes is not None or (self.atlas is not None and own.depth.shape != self.atlas.shape):
            return drawn
        atlas = shadow.Atlas.of_none(self.count, own) if self.atlas is None else self.atlas
        self.atlas, self.taken = atlas.holding(own, self.taken), self.taken + 1
        return drawn._replace(stored=_Place(self.taken - 1, shadow.without_depths(own)))

    def placed(self, views: list[DrawnView]) -> list[DrawnView]:
        """The views with their maps in the atlas."""
        atlas = self.atlas
        if atlas is None:
            return views
        in_atlas = lambda own: shadow.StoredMap(atlas, *own) if isinstance(own, _Place) else own
        placed = lambda view: [each._replace(stored=in_atlas(each.stored)) for each in view.drawn]
        return [view._replace(drawn=placed(view)) for view in views]


class _Place(NamedTuple):
    """The number of a map in an atlas, and the map without depths."""

    number: int
    rest: shadow.ShadowMap


def _drawn(view: FitView, technique: shadow.AbstractTechnique | None, kept: _Kept, progress: Progress) -> DrawnView:
    name, config = view
    meshes, sight = (config.scene.model_dump_json(include=set(parts)) for parts in (_MESHES, (*_MESHES, "camera")))
    try:
        loaded = load(config, progress, kept.loaded.get(meshes))
        technique = build_technique(config) if technique is None else technique
        surface, _ = kept.seen.get(sight, (None, {}))
        drawn = draw(config, loaded, technique, progress, surface=surface)
    except ConfigError as error:
        named = [dataclasses.replace(each, message=f"{each.message} (in the view {name})") for each in error.mistakes]
        raise ConfigError(named) from error
    kept.loaded[meshes] = loaded
    # Rays through pixels' centres see the same, whatever the light. Many views would not fit into memory otherwise.
    surface, by_rays = kept.see(sight, drawn[0])
    drawn = [each._replace(reference=dataclasses.replace(each.reference, **by_rays), surface=surface) for each in drawn]
    drawn = [kept.keep(each) for each in drawn]
    key = lambda each: name if len(drawn) == 1 else f"{name}, {each.key}"
    return DrawnView(name, config, technique, [each._replace(key=key(each)) for each in drawn])
