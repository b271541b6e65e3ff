"""Fits of a technique alone: the map and the surface are drawn once."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._misc import as_float
from ..._types import Mask, Scalar, Visibility
from ...geometry import Scene
from ...raster import Surface, draw_surface
from ...reference import Reference
from ...shadow import EngineMap, FittableTechnique, Overflow, ShadowMap
from .._parameters import parameter_names, resolve
from ._abstract import AbstractProblem

# Of an image of sampled pixels. Taps repeat in tiles of 16 pixels at most.
_ROWS = 16


class TechniqueProblem(AbstractProblem):
    """A technique, what it is fitted to, and what stays as it is.

    - `technique`: whose numbers are fitted.
    - `shadow_map`, `surface`: what it looks at. Neither depends on bias or filter. The map is drawn again only where
        a number of its layout is fitted.
    - `reference`: (h, w), visibility in [0, 1].
    - `mask`: (h, w), the pixels that count.
    - `scene`: with one light; needed only if a number of the map's layout is fitted.
    - `weight`: how many pixels each stands for; more than 1 in a sample of them.
    """

    technique: FittableTechnique
    shadow_map: ShadowMap | EngineMap
    surface: Surface
    reference: Visibility
    mask: Mask
    scene: Scene | None = None
    weight: Scalar = eqx.field(converter=as_float, default=1.0)

    @classmethod
    def of(
        cls, scene: Scene, technique: FittableTechnique, truth: Reference, *, surface: Surface | None = None
    ) -> "TechniqueProblem":
        """`technique`, and its map and surface of a scene with one light, against that scene's reference.

        The pixels that count are those where the reference has a surface that lies within the light's frustum.

        **Arguments:**

        - `surface`: what the camera sees; drawn if left out.
        """
        surface = draw_surface(scene.mesh, scene.camera) if surface is None else surface
        shadow_map = technique.prepare(scene, surface)
        mask = technique.covered(shadow_map, surface) & jnp.asarray(truth.mask)
        return cls(technique, shadow_map, surface, jnp.asarray(truth.visibility), mask, scene)

    def residual(self, technique: FittableTechnique) -> Float[Array, "h w"]:
        """Visibility less reference at the pixels that count, 0 elsewhere.

        Scaled so that the sum of its squares is the mean square error.
        """
        return self.difference(technique) / jnp.sqrt(jnp.maximum(self.count, 1))

    def mean_square_error(self, technique: FittableTechnique) -> Scalar:
        """The mean square error over the pixels that count."""
        return jnp.sum(self.residual(technique) ** 2)

    def difference(self, subject: FittableTechnique, overflows: list[Overflow] | None = None) -> Float[Array, "h w"]:
        """Visibility less reference at the pixels that count, 0 elsewhere, times the square root of their weight.

        Nothing is drawn that could overflow.
        """
        visibility = subject.visibility(self.shadow_map, self.surface)
        return jnp.sqrt(self.weight) * jnp.where(self.mask, visibility - self.reference, 0)

    def compared(self, difference: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """All of a difference."""
        return difference

    def technique_of(self, subject: FittableTechnique) -> FittableTechnique:
        """The subject itself."""
        return subject

    def laid_out(self, subject: FittableTechnique) -> "TechniqueProblem":
        """With the map that `subject` draws, if it is another one. The pixels that count are the same.

        **Raises** `ValueError` if there is no scene to draw it from, or the technique does not suit it.
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
        """The problem itself: nothing is drawn again."""
        return self

    def sampled(self, count: int, seed: int) -> "TechniqueProblem":
        """With about `count` of the pixels that count, in an image of `_ROWS` rows.

        They are drawn at random, one from each of as many runs of equal length in the image's order. Where fewer pixels
        count, all are taken, and the rest of the image counts for nothing.
        """
        columns = -(-count // _ROWS)
        counting = np.flatnonzero(np.asarray(self.mask))
        taken = min(columns * _ROWS, len(counting))
        within = np.random.default_rng(seed).random(taken)
        chosen = counting[((np.arange(taken) + within) * (len(counting) / max(taken, 1))).astype(np.int64)]
        # A filter's taps vary in tiles of a few pixels. Down the columns first, few samples see them all.
        places = np.resize(chosen if taken else [0], columns * _ROWS).reshape(columns, _ROWS).T
        counts = (np.arange(columns * _ROWS) < taken).reshape(columns, _ROWS).T
        gathered = lambda image: jnp.asarray(np.asarray(image).reshape(-1, *image.shape[2:])[places])
        return TechniqueProblem(
            technique=self.technique,
            shadow_map=self.shadow_map,
            surface=jax.tree.map(gathered, self.surface),
            reference=gathered(self.reference),
            mask=jnp.asarray(counts),
            scene=self.scene,
            weight=float(self.weight) * len(counting) / max(taken, 1),
        )

    def padded(self) -> "TechniqueProblem":
        """Without the scene, of which programs need nothing."""
        return dataclasses.replace(self, scene=None)

    @property
    def moves(self) -> bool:
        """False: map and surface stay."""
        return False

    @property
    def subject(self) -> FittableTechnique:
        """What is fitted."""
        return self.technique

    @property
    def count(self) -> Scalar:
        """How many pixels count."""
        return self.weight * jnp.sum(self.mask)

    @property
    def blur_in_pixels(self) -> float:
        """None: images are compared as they are."""
        return 0.0
