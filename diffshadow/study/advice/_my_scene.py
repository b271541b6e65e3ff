"""The pictures of the user's scene on the page of advice for an engine: its defaults, the recommendation, and the
truth."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from ... import io, shadow
from ..._types import HostArray
from ...config import Config
from ...settings import MISSING
from ..pages._page import Picture, picture
from ..runs._measure import measured
from ..runs._setup import visibility_of
from ._measure import judged

FILE = "my_scene.npz"
"""The pictures in a recommendation's folder."""
DEFAULTS, RECOMMENDED, TRUTH = "the engine's defaults", "recommended", "ray-traced"


def store_pictures(folder: Path, best: Config) -> None:
    """Draws the first view's first light with the engine's defaults and with `best`, and stores both in `folder`.

    Engines whose settings are converted by formulas have no picture of their defaults.
    """
    technique, every = judged(best)
    drawn = every[0]
    images = {TRUTH: np.asarray(drawn.reference.visibility, np.float32)}
    if isinstance(technique, shadow.AbstractEngineShadows):
        own = _with_defaults(technique)
        images[DEFAULTS] = visibility_of(own, drawn._replace(stored=own.prepare(drawn.scene, drawn.surface)))
    images[RECOMMENDED] = visibility_of(technique, drawn)
    errors = {name: measured(image, drawn)["rmse"] for name, image in images.items() if name != TRUTH}
    seen = np.asarray(drawn.surface.mask)
    with io.atomic_path(folder / FILE) as temporary, temporary.open("wb") as file:
        stored: dict[str, Any] = {name: np.where(seen, image, 1) for name, image in images.items()}
        stored |= {f"rmse {name}": np.float64(error) for name, error in errors.items()}
        np.savez_compressed(file, **stored)


def _with_defaults(technique: shadow.AbstractEngineShadows) -> shadow.AbstractEngineShadows:
    """`technique` with the engine's filter and numbers. Its maps and its casting faces do not change."""
    settings = technique.settings
    changed: dict[str, Any] = {
        key: each.default
        for key, each in settings.each().items()
        if each.default is not MISSING and (key == settings.filter_key or each.is_fitted)
    }
    return dataclasses.replace(technique, **changed)


def scene_pictures(folder: Path) -> list[Picture]:
    """The stored pictures for a page. Empty if there are none."""
    if not (folder / FILE).is_file():
        return []
    with np.load(folder / FILE) as stored:
        found: dict[str, Float32[HostArray, "*n"]] = dict(stored)
    order = [name for name in (DEFAULTS, RECOMMENDED, TRUTH) if name in found]
    note = lambda name: f"RMSE {float(found[f'rmse {name}']):.4f}" if f"rmse {name}" in found else ""
    return [picture(name, found[name], note(name)) for name in order]
