"""Whether a fit explains its references, and what would explain them if it does not."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ... import fit, reference
from ..._types import HostArray
from ...geometry import Scene
from .._drawn import Drawn
from ..remarks._verdict import Change, Unexplained
from ._views import Views

# Above this part of a reference's variance, rays decide whether what a fit leaves is an error of the technique.
_DOUBTFUL = 0.1
# An image of this scene from this light differs from rays by noise and by pixels at outlines. Beyond these, rays leave
# no more than this part of its variance. A sun that is 6 degrees off, another mesh or a flipped file leave more.
_MUCH = 0.2
# Pixels differ by how they are sampled. The mean square difference between rays at their centres and all over them,
# times this, is added to what rays may leave: two images at points half a pixel apart differ by twice as much.
_SAMPLED = 2.0
# A changed reference is the answer if it leaves no more than this part of what the reference leaves as it is.
_FAR_BETTER = 0.5
# The camera rays along each side of a pixel.
_SUPERSAMPLING = 4
# Of many views, only the worst are traced.
_MAX_TRACED = 8

Image = Float[HostArray, "h w"]
Mask = Bool[HostArray, "h w"]


class Fitted(NamedTuple):
    """A fitted image and its reference.

    - `drawn`: the scene and its reference; `image`: (h, w), after the fit.
    - `scene`: the fitted scene; `None` if nothing in the scene was fitted.
    - `given`: whether the reference was given as a file, rather than traced.
    - `cone`: (h, w), the fraction of the light that its cone lets through, with which a fit of lights compares.
    """

    drawn: Drawn
    image: Image
    scene: Scene | None
    given: bool
    cone: Image | float = 1.0


def unexplained(images: Sequence[Fitted]) -> Unexplained | None:
    """What the fit leaves unexplained; none if it explains its references.

    A fit fails if constant images in place of its own have no larger error. It also fails if neither the fit nor rays
    in the fitted scene explain most of a reference's variance: then the reference is not a picture of the scene.
    """
    counted = [each for each in images if each.drawn.pixels]
    pixels = np.asarray([each.drawn.pixels for each in counted], np.float64)
    left = np.asarray([_mean_square(each.image, *_truth(each.drawn)) for each in counted])
    variance = np.asarray([_variance(*_truth(each.drawn)) for each in counted])
    total, constant = (float(np.average(each, weights=pixels)) for each in (left, variance))
    doubtful = [i for i in np.argsort(-left * pixels, kind="stable") if left[i] > _DOUBTFUL * variance[i] > 0]
    alien = list(_alien([counted[i] for i in doubtful[:_MAX_TRACED]]))
    if not alien and not total >= constant > 0:
        return None
    found = Unexplained(math.sqrt(total), math.sqrt(constant), [each.drawn.key for each, *_ in alien])
    if not alien:
        return found
    worst, seen, by_rays = alien[0]
    change = None
    if worst.given:
        # A fit may have moved the scene away from where the reference shows it.
        configured = [] if worst.scene is None else _traced(worst.drawn.scene)
        change = best_change([*seen, *configured], *_truth(worst.drawn))
    return found._replace(by_rays=by_rays, given=worst.given, change=change)


def best_change(seen: Sequence[Image], truth: Image, mask: Mask) -> Change | None:
    """The change after which a reference is a picture of the scene; none if no flip or inversion makes it one.

    **Arguments:** `seen`: images (h, w) of the scene by rays, in one or several states.
    """
    changes = [
        _compared(image, turned, kept & mask, words)
        for image in seen
        for words, turned, kept in zip(_TURNS, _turned(truth), _turned(mask), strict=True)
        if (kept & mask).any()
    ]
    as_it_is = min((each for each in changes if not each.turn), key=lambda each: each.left)
    best = min(changes, key=lambda each: each.left)
    if not best.turn or best.left > _FAR_BETTER * as_it_is.left:
        best = as_it_is
    return best if best.left <= _MUCH else None


_TURNS = (
    "",
    "flip the reference upside down",
    "mirror the reference left to right",
    "turn the reference by 180 degrees",
)


def _turned(image: Any) -> tuple[Any, ...]:
    """`image` after each of `_TURNS`."""
    return image, image[::-1], image[:, ::-1], image[::-1, ::-1]


def _compared(image: Image, truth: Image, mask: Mask, words: str) -> Change:
    """How well `truth`, which was turned as `words` say, agrees with what rays see."""
    ours, theirs = image[mask].astype(np.float64), truth[mask].astype(np.float64)
    if not ours.std() or not theirs.std():
        return Change(words, False, 0.0, 1.0, 1.0, 1.0)
    slope, low = np.polyfit(ours, theirs, 1)
    correlation = float(np.corrcoef(ours, theirs)[0, 1])
    upright = 1 - theirs if slope < 0 else theirs
    rmse = float(np.sqrt(np.mean((ours - upright) ** 2)))
    return Change(words, slope < 0, float(low), float(low + slope), rmse, 1 - correlation**2)


def _alien(images: Sequence[Fitted]) -> Iterator[tuple[Fitted, Sequence[Image], float]]:
    """The images whose given references are no pictures of the scene, what rays see, and the references'
    error."""
    for each in images:
        if not each.given and each.scene is None:
            # Rays are the reference.
            continue
        truth, mask = _truth(each.drawn)
        seen = smooth, sharp = _traced(each.scene or each.drawn.scene)
        # A given reference may be of the light without its cone.
        left = min(_mean_square(image * cone, truth, mask) for image in seen for cone in (1.0, each.cone))
        if left > _MUCH * _variance(truth, mask) + _SAMPLED * _mean_square(smooth, sharp, mask):
            yield each, seen, math.sqrt(left)


def _traced(scene: Scene) -> tuple[Image, Image]:
    """What rays see all over the pixels, and at their centres."""
    # A run shows its own progress.
    how: Any = {"samples": _SUPERSAMPLING**2, "progress": lambda _: None}
    trace = lambda side: reference.trace_visibility(scene, **how, supersampling=side).visibility
    return trace(_SUPERSAMPLING), trace(1)


def _truth(drawn: Drawn) -> tuple[Image, Mask]:
    return np.asarray(drawn.reference.visibility), drawn.mask


def _mean_square(image: Image, truth: Image, mask: Mask) -> float:
    return float(np.mean((image[mask].astype(np.float64) - truth[mask]) ** 2))


def _variance(truth: Image, mask: Mask) -> float:
    """The mean square error of the best constant image."""
    return float(np.var(truth[mask].astype(np.float64)))


def fitted_images(
    views: Views,
    drawn: Sequence[Drawn],
    after: Sequence[Image],
    seen: Sequence[Drawn],
    result: fit.FitResult | None = None,
) -> list[Fitted]:
    """The images that a fit has seen.

    **Arguments:** the references of all views and lights, their images after the fit, and the fitted scenes; and the
    fit's `result`, if lights or meshes may have moved.
    """
    found, arrangement = [], None if result is None else result.arrangement
    configs = [view.config for view in views.fitted for _ in view.drawn]
    for i, (config, each, image, left) in enumerate(zip(configs, drawn, after, seen, strict=False)):
        given = config is not None and config.reference.type == "image"
        one = Fitted(each, image, None, given)
        if result is not None and arrangement is not None:
            problem: Any = result.problems[i]
            scene = _arranged(arrangement, each.scene, problem.index)
            one = one._replace(scene=scene, cone=np.asarray(fit.cone_fraction(scene.light, left.surface)))
        found.append(one)
    return found


def _arranged(arrangement: fit.Arrangement, scene: Scene, light: int) -> Scene:
    """The scene with one of its lights, and the meshes, where `arrangement` puts them."""
    meshes = [pose.placed(mesh) for pose, mesh in zip(arrangement.meshes, scene.meshes, strict=True)]
    return dataclasses.replace(scene, meshes=meshes, lights=scene.light.at(arrangement.lights[light]))
