"""The judge of a fit: the problems at full resolution under the hard compare."""

import dataclasses
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ._loss import Errors, Loss
from ._parameters import Parameters
from ._phases import Phase, enlarged
from .problems import Atlases, Joint, Losses, Samples, Together, copied_bytes, stacked_order

# Up to this many images are judged by their own program, unless its copies take more than this many bytes. The program
# takes two seconds to compile and copies all images.
_MANY, _MAX_COPIED = 64, 1 << 30


class _Stacks(NamedTuple):
    """Stacks of a judge's `problems`, with their `order`."""

    problems: tuple[Any, ...]
    order: list[int]
    joint: Joint


class Judge:
    """The problems of a fit of `parameters` under the hard compare. The judge evaluates the start and the end of every
    phase.

    - `joint`: the problems, with maps laid out for the values that were judged last.

    For a thousand images, every method of a joint problem takes at least a tenth of a second. Most functions here
    therefore call methods of stacks of problems.
    """

    def __init__(self, joint: Joint, parameters: Parameters):
        self.joint, self.parameters = joint, parameters
        self._errors: dict[Any, Errors] = {}
        self._samples: Samples = {}
        self._atlases: Atlases = {}
        self._stacks: dict[int | None, _Stacks] = {}

    @property
    def loss(self) -> Loss:
        """The exact loss of the fit."""
        return self.joint.loss

    def at(self, values: Float[Array, " p"]) -> Joint:
        """The problems with `values` (p,), and maps laid out for them."""
        self._lay_out(values)
        return self.joint.put(self.parameters, values)

    def losses(self, values: Float[Array, " p"], loss: Loss) -> Losses:
        """The losses at `values` (p,), from all devices if there are several."""
        self._lay_out(values)
        if self._is_stacked:
            found = self._together(values, loss).losses
        else:
            # Not one program, because its parts share the programs of all other drawings.
            judge = self.joint.put(self.parameters, values).with_loss(loss)
            found = judge.losses(judge.subject)
        if not found.overflow:
            self._errors[_key(values, loss)] = found.errors
        return found

    def sides(self, values: Float[Array, " p"]) -> tuple[float, float]:
        """The losses at `values` (p,) of pixels that are too dark, and of pixels that are too light."""
        self._lay_out(values)
        if self._is_stacked:
            dark, light = self._together(values, self.loss).sides
        else:
            judge = self.joint.put(self.parameters, values)
            dark, light = judge.sides(judge.subject)
        return float(dark), float(light)

    def errors(self, values: Float[Array, " p"], loss: Loss) -> Errors:
        """The errors of all images at `values` (p,), with the factors of `loss`."""
        key = _key(values, loss)
        return self._errors[key] if key in self._errors else self.losses(values, loss.exact()).errors

    def enlarge(self, values: Float[Array, " p"]) -> None:
        """Plans memory for more silhouettes."""
        self.joint = enlarged(self.joint, self.parameters, values[None])

    def seen_by(self, phase: Phase, values: Float[Array, " p"]) -> Joint:
        """The stacks of the pixels that a step of `phase` evaluates from `values` (p,) in a fit of a technique: all
        pixels or a sample."""
        self._lay_out(values)
        # A user's loss may compare neighbours, so it gets whole images.
        pixels = None if phase.joint.own is not None or self._count <= phase.pixels else phase.pixels
        if pixels is None or phase.joint.loss.over == "mean":
            return self._stacked(pixels).joint
        # A mean over part of the pixels is close to the mean over all. The maximum is not, because few images decide
        # it.
        errors = self.errors(values, phase.joint.loss)
        order = np.argsort(-np.asarray(errors), kind="stable").tolist()
        whole = dataclasses.replace(phase.joint.put(self.parameters, values), problems=self.joint.problems)
        sample = whole.sampled(pixels, order[: -(-len(order) // 4)], self._samples)
        return sample.corrected(errors, self._atlases).each(lambda p: p.padded()).stacked(self._atlases)

    @cached_property
    def _count(self) -> int:
        """The number of pixels that count, for any layout of the maps."""
        return self.joint.count

    @property
    def _is_stacked(self) -> bool:
        """Whether one program evaluates all images. Otherwise, the shared programs evaluate each image."""
        joint = self.joint
        if joint.moves or joint.own is not None:
            return False
        return joint.devices > 1 or (len(joint.problems) >= _MANY and self._copied <= _MAX_COPIED)

    @cached_property
    def _copied(self) -> int:
        """The size of the copies of all images in stacks, in bytes."""
        return copied_bytes(self.joint.problems)

    def _stacked(self, pixels: int | None = None) -> _Stacks:
        """All images as stacks, or about `pixels` pixels of them. They are kept until maps are drawn again."""
        kept, problems = self._stacks.get(pixels), self.joint.problems
        if kept is None or kept.problems is not problems:
            joint = self.joint if pixels is None else self.joint.sampled(pixels, (), self._samples)
            joint = joint.each(lambda p: p.padded())
            kept = _Stacks(problems, stacked_order(joint.problems), joint.stacked(self._atlases))
            self._stacks[pixels] = kept
        return kept

    def _together(self, values: Float[Array, " p"], loss: Loss) -> Together:
        """The losses of all images at `values` (p,), from one program."""
        stacks, subject = self._stacked(), self.parameters.put(self.joint.subject, values)
        return dataclasses.replace(stacks.joint, subject=subject, loss=loss).together(stacks.order)

    def _lay_out(self, values: Float[Array, " p"]) -> None:
        if self.joint.lays_out:
            self.joint = self.joint.laid_out(self.parameters, values)


def _key(values: Float[Array, " p"], loss: Loss) -> tuple[float, ...]:
    """The key of the images' errors."""
    return *values.tolist(), float(loss.false_shadow), float(loss.false_light)
