"""The reason for a recommended bias that is far larger than usual, and the cost of a usual bias."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ... import fit
from ..._arithmetic import as_float
from ..._types import HostArray
from ..._words import counted
from ...config import Config, fit_paths, fit_units
from .._drawn import Drawn
from ..pages import _table as table
from ..runs._engine import bias_of_a_texel, lit_by
from ..runs._measure import combined, measured
from ..runs._progress import Progress
from ..runs._setup import visibility_of
from ._measure import judged

# Usual biases are one to three texels. A value above the second number causes a remark.
_USUAL, _LARGE = 3.0, 6.0
_OF_MAPS, _OF_ENGINES = ("bias.constant", "bias.normal_offset"), "technique.bias"
# A pixel counts as darker if it loses this much of its light.
_DARKER = 0.1
# A pixel of a reference is lit from this visibility on.
_LIT = 1 - 1e-6


class _Asking(NamedTuple):
    """The pixels that need a large bias: they are lit, and a smaller bias darkens them.

    - `darker`, `lit`: the numbers of darker and of lit pixels; `mesh`: the index of the mesh with most of the darker
      pixels.
    - `share`: this mesh's fraction of the lost light; `degrees`: the median angle between its darker surfaces and the
      light.
    """

    darker: int
    lit: int
    mesh: int
    share: float
    degrees: float


def large_biases(config: Config, noise: float) -> Iterator[str]:
    """A sentence for each bias of the fitted `config` that is far larger than usual. `noise` is the reference's
    noise."""
    for name in (*_OF_MAPS, _OF_ENGINES):
        if name in config.fit.parameters and (one := _of_a_texel(config, name)):
            value = config.initial(name)
            if value / one > _LARGE:
                yield _explained(config, name, value, one, noise)


def _of_a_texel(config: Config, name: str) -> float | None:
    """The value of a bias of one texel. `None` if that is unknown."""
    if name != _OF_ENGINES and (name == "bias.normal_offset" or config.bias.unit == "texels"):
        return 1.0
    lit = lit_by(config.views[0].config if config.views else config, Progress.quiet())
    return bias_of_a_texel(config.technique, lit) if name == _OF_ENGINES else lit[0].depth_per_texel


def _explained(config: Config, name: str, value: float, one: float, noise: float) -> str:
    technique, drawn = judged(config)

    def at(value: float) -> tuple[list[HostArray], dict[str, float]]:
        changed: Any = fit.with_values(technique, [fit_paths(config)[name]], as_float([value]))  # type: ignore[arg-type]
        images = [visibility_of(changed, each) for each in drawn]
        return images, combined([measured(*pair) for pair in zip(images, drawn, strict=True)], drawn)

    (as_fitted, fitted), (as_usual, usual) = at(value), at(_USUAL * one)
    unit = fit_units(config)[name]
    in_texels = "" if unit == "texels" else f", {value / one:.3g} texels,"
    given = f"{name} = {value:.3g} {unit}".rstrip() + in_texels
    texels = f"{_USUAL:g} texels" if one == 1 else f"{_USUAL:g} texels ({_USUAL * one:.3g})"
    says = (
        f"{given} is far more than the usual one to three texels. With {texels} and all else as fitted, the RMSE is "
        f"{usual['rmse']:.4f} instead of {fitted['rmse']:.4f}, false shadow (acne) "
        f"{table.number('_rate', usual['false_shadow_rate'])} instead of "
        f"{table.number('_rate', fitted['false_shadow_rate'])}, and false light "
        f"{table.number('_rate', usual['false_light_rate'])} instead of "
        f"{table.number('_rate', fitted['false_light_rate'])}."
    )
    if usual["rmse"] <= fitted["rmse"]:
        return f"{says} That is no worse, so use {texels}."
    if usual["rmse"] <= fitted["rmse"] + noise:
        return f"{says} That is as good within the reference's noise of {noise:.4f}, so use {texels}."
    asking = _asking(drawn, as_fitted, as_usual)
    if asking is None:
        return says
    path = config.scene.meshes[asking.mesh].path
    radius = getattr(config.filter, "radius", None) if name != _OF_ENGINES else None
    width = f"; the filter's radius of {radius:.3g} texels needs a larger one, too" if radius and radius > 1 else ""
    asks = "needs" if asking.darker == 1 else "need"
    return (
        f"{says} {counted(asking.darker, 'pixel')} of {asking.lit:,} in light {asks} a larger bias: with the usual "
        f"one, each would lose more than a tenth of its light, {asking.share:.0%} of it on "
        f"scene.meshes.{asking.mesh} ({path}), where the angle between the light and surfaces is "
        f"{asking.degrees:.0f}° (median){width}."
    )


def _asking(drawn: list[Drawn], as_fitted: list[HostArray], as_usual: list[HostArray]) -> _Asking | None:
    """The lit pixels that are darker under the usual bias than under the fitted bias. `None` if there are none."""
    lit = [each.mask & (np.asarray(each.reference.visibility) >= _LIT) for each in drawn]
    lost = [np.where(at, a - b, 0.0) for at, a, b in zip(lit, as_fitted, as_usual, strict=True)]
    darker = [each > _DARKER for each in lost]
    if not any(each.any() for each in darker):
        return None
    meshes = len(drawn[0].scene.meshes)
    by_mesh = np.zeros(meshes)
    for each, at, light in zip(drawn, darker, lost, strict=True):
        by_mesh += np.bincount(_mesh_of(each)[at], weights=light[at], minlength=meshes)
    worst = int(by_mesh.argmax())
    angles = [_degrees(each, at & (_mesh_of(each) == worst)) for each, at in zip(drawn, darker, strict=True)]
    return _Asking(
        sum(int(each.sum()) for each in darker),
        sum(int(each.sum()) for each in lit),
        worst,
        float(by_mesh[worst] / by_mesh.sum()),
        float(np.median(np.concatenate(angles))),
    )


def _mesh_of(drawn: Drawn) -> HostArray:
    """(h, w), the index of the mesh that each pixel sees."""
    counts = [mesh.faces.shape[0] for mesh in drawn.scene.meshes]
    return np.repeat(np.arange(len(counts)), counts)[np.asarray(drawn.surface.face)]


def _degrees(drawn: Drawn, at: Bool[HostArray, "h w"]) -> Float[HostArray, " n"]:
    """The angles between the light and the surfaces at some pixels; 0 at grazing incidence."""
    light: Any = drawn.scene.light
    normal, point = (np.asarray(each, np.float64)[at] for each in (drawn.surface.normal, drawn.surface.position))
    towards = np.asarray(light.direction, np.float64) if light.is_directional else np.asarray(light.position) - point
    sine = np.abs((normal * towards).sum(axis=-1)) / np.linalg.norm(towards, axis=-1)
    return np.degrees(np.arcsin(np.clip(sine, 0, 1)))
