"""Fits of a technique alone. The map and the surface are drawn once."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_array, as_float
from ..._checks import check_instance
from ..._types import Mask, Resolution, Scalar, Visibility
from ...geometry import Scene
from ...raster import Surface, draw_surface
from ...reference import Reference
from ...shadow import EngineMap, FittableTechnique, ShadowMap, StoredMap
from .._own_loss import Seen
from .._parameters import parameter_names, resolve
from ._abstract import AbstractProblem

# The side of a tile of pixels, a multiple of the side of most patterns of taps.
_TILE = 16


class TechniqueProblem(AbstractProblem):
    """A technique, its target, and everything that the fit does not change.

    - `technique`: the technique whose numbers are fitted.
    - `shadow_map`, `surface`: the inputs of the technique. Neither depends on bias or filter. The map is drawn again
        only if a number of its layout is fitted.
    - `reference`: (h, w), visibility in [0, 1].
    - `mask`: (h, w), the pixels that count.
    - `scene`: a scene with one light; needed only if a number of the map's layout is fitted.
    - `weight`: the number of pixels that each pixel represents, one number or (h, w); more than 1 in a sample.
    - `factor`: a factor of all squared differences; in a sample, it corrects their sum.

    !!! Example

        ```python
        problem = fit.TechniqueProblem.of(scene, technique, truth)
        ```
    """

    technique: FittableTechnique
    shadow_map: ShadowMap | EngineMap | StoredMap
    surface: Surface
    reference: Visibility
    mask: Mask
    scene: Scene | None = None
    weight: Scalar | Float[Array, "h w"] = eqx.field(converter=as_float, default=1.0)
    factor: Scalar = eqx.field(converter=as_float, default=1.0)

    @classmethod
    def of(
        cls, scene: Scene, technique: FittableTechnique, truth: Reference, *, surface: Surface | None = None
    ) -> "TechniqueProblem":
        """A problem that compares `technique` in a scene with one light with the reference of this scene.

        A pixel counts if the reference has a surface there and the surface is within the light's frustum.

        **Arguments:**

        - `surface`: the surface that the camera sees; by default it is drawn.
        """
        check_instance("the truth", truth, Reference, "a Reference, such as trace_visibility(scene)")
        surface = draw_surface(scene.mesh, scene.camera) if surface is None else surface
        if truth.mask.shape != surface.mask.shape:
            raise ValueError(
                f"the reference has {truth.mask.shape} pixels, (height, width), and the camera {surface.mask.shape}; "
                "expected the same: trace it with this camera"
            )
        shadow_map = technique.prepare(scene, surface)
        mask = technique.covered(shadow_map, surface) & as_array(truth.mask)
        return cls(technique, shadow_map, surface, as_float(truth.visibility), mask, scene)

    def residual(self, technique: FittableTechnique) -> Float[Array, "h w"]:
        """Visibility minus reference at the pixels that count, 0 elsewhere.

        Scaled so that the sum of its squares is the mean square error.
        """
        return self.difference(technique) / jnp.sqrt(jnp.maximum(self.count, 1))

    def mean_square_error(self, technique: FittableTechnique) -> Scalar:
        """The mean square error over the pixels that count."""
        return jnp.sum(self.residual(technique) ** 2)

    def difference(self, subject: FittableTechnique) -> Float[Array, "h w"]:
        """Visibility minus reference at the pixels that count, 0 elsewhere, times the square root of weight and
        factor."""
        return _weighted(self._visibility(subject), self.reference, self.mask, self.weight, self.factor)

    def _visibility(self, subject: FittableTechnique) -> Visibility:
        own = self.shadow_map
        return subject.visibility(own.whole() if isinstance(own, StoredMap) else own, self.surface)

    def seen(self, subject: FittableTechnique) -> tuple[Seen, None]:
        """The images that a user's loss compares. Nothing that could overflow is drawn."""
        return _seen(self._visibility(subject), self.reference, self.mask), None

    def compared(self, differences: Float[Array, "n h w"]) -> Float[Array, "n h w"]:
        """All of them."""
        return differences

    def technique_of(self, subject: FittableTechnique) -> FittableTechnique:
        """The subject itself."""
        return subject

    def laid_out(self, subject: FittableTechnique) -> "TechniqueProblem":
        """This problem with the map that `subject` draws, if it differs. The pixels that count are the same.

        **Raises** `ValueError` if there is no scene to draw it from, or if the technique does not suit it.
        """
        numbers = lambda technique: [
            resolve(technique, name) for name in parameter_names(technique) if technique.lays_out(name)
        ]
        if all(ours == theirs for ours, theirs in zip(numbers(self.technique), numbers(subject), strict=True)):
            return self
        if self.scene is None:
            raise ValueError(
                "a number that lays out the map is fitted, and the problem has no scene to draw the map from; expected "
                "one: use TechniqueProblem.of, or pass scene"
            )
        return dataclasses.replace(self, technique=subject, shadow_map=subject.prepare(self.scene, self.surface))

    def planned(self) -> "TechniqueProblem":
        """The problem itself, because nothing is drawn again."""
        return self

    def sampled(self, count: int, seed: int) -> "TechniqueProblem":
        """This problem with about `count` of the pixels that count, and at least one for each position in a tile of
        `_TILE` x `_TILE`.

        A pixel keeps its position in the tile, and so its taps, unless the filter rotates its pattern at each pixel or
        its tile does not divide these. For each position, the pixels in the image's order are divided into runs of
        equal length, and one pixel is drawn at random from each run. Each pixel represents its run, so the expected
        mean square error equals the error of the whole image. If fewer pixels count, all of them are used.
        """
        runs, places = _runs(count / _TILE**2), _TILE**2
        counting = np.flatnonzero(np.asarray(self.mask))
        y, x = np.divmod(counting, self.mask.shape[1])
        place = y % _TILE * _TILE + x % _TILE
        sizes = np.bincount(place, minlength=places)[:, None]
        taken = np.minimum(sizes, runs)
        # Pixels with the same position follow one another. The last entry is for positions without any.
        sorted_by_place = np.append(counting[np.argsort(place, kind="stable")], 0)
        ends = np.arange(runs + 1) * sizes // np.maximum(taken, 1)
        lengths = np.diff(ends)
        within = ends[:, :-1] + (np.random.default_rng(seed).random((places, runs)) * lengths).astype(np.int64)
        chosen = np.cumsum(sizes)[:, None] - sizes + np.minimum(within, np.maximum(sizes - 1, 0))
        in_tiles = lambda values: values.reshape(_TILE, _TILE, runs).transpose(0, 2, 1).reshape(_TILE, -1)
        pixels, weight = in_tiles(sorted_by_place[chosen]), np.broadcast_to(np.asarray(self.weight), self.mask.shape)
        gathered = lambda image: np.asarray(image).reshape(-1, *image.shape[2:])[pixels]
        return TechniqueProblem(
            technique=self.technique,
            shadow_map=self.shadow_map,
            surface=jax.tree.map(lambda image: as_array(gathered(image)), self.surface),
            reference=as_float(gathered(self.reference)),
            mask=as_array(in_tiles(np.arange(runs) < taken)),
            scene=self.scene,
            weight=gathered(weight) * in_tiles(lengths),
        )

    def padded(self) -> "TechniqueProblem":
        """This problem without the scene, which no program reads."""
        return dataclasses.replace(self, scene=None)

    @property
    def moves(self) -> bool:
        """Always false, because map and surface do not change."""
        return False

    @property
    def subject(self) -> FittableTechnique:
        """What is fitted."""
        return self.technique

    @property
    def shape(self) -> Resolution:
        """Height and width of its images, in pixels."""
        height, width = self.reference.shape
        return height, width

    @property
    def count(self) -> Scalar:
        """The number of pixels that count."""
        return _counted(self.mask, self.weight)

    @property
    def blur_in_pixels(self) -> float:
        """Always 0, because images are compared without a blur."""
        return 0.0


def _runs(about: float) -> int:
    """A number of runs near `about`. XLA vectorizes stacks of samples with 1, 4 or a multiple of 8 of them. Other
    stacks take two to three times as long per pixel."""
    return 1 if about < 2 else 4 if about < 8 else int(about // 8) * 8


@eqx.filter_jit
def _counted(mask: Mask, weight: Array) -> Scalar:
    return jnp.sum(jnp.where(mask, weight, 0))


@eqx.filter_jit
def _seen(image: Visibility, reference: Visibility, mask: Mask) -> Seen:
    return Seen.of(image, reference, mask)


@eqx.filter_jit
def _weighted(
    visibility: Visibility, reference: Visibility, mask: Mask, weight: Array, factor: Scalar
) -> Float[Array, "h w"]:
    return jnp.sqrt(weight * factor) * jnp.where(mask, visibility - reference, 0)
