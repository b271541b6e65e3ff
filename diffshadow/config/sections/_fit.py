"""Sections of a fit: its parameters, solver, annealing, loss and preferences, and the fit of a shape."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import Len
from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from ..._words import counted
from ...settings import Form, InputFile, fit
from .._errors import KeyPath, listing, plain
from ._axes import ValidationConfig, ViewsConfig
from ._fitted import fittable_of, is_pose, name_faults, of_technique
from ._scene import LightConfig, MeshConfig
from ._section import Conflict, Section, Variants, fault

if TYPE_CHECKING:
    from ._config import Config


class FitParameterConfig(Section):
    """The bounds and the start of a number to fit, in the unit of its key.

    For numbers of the scene with a traced reference, the values in `scene` are the truth.
    """

    initial: Annotated[float | None, "where the fit starts; default: the value of the key it names"] = None
    lower: Annotated[float, "least value"]
    upper: Annotated[float, "greatest value"]
    ascending = (("lower", "upper"),)

    def faults(self) -> Iterator[Conflict]:
        # Bounds in the wrong order are reported separately.
        if self.initial is not None and self.lower < self.upper and not self.lower <= self.initial <= self.upper:
            yield ("initial",), self._outside(f"is {plain(self.initial)}", "move it inside")

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        name = str(at[-1])
        yield from ((at, what) for what in name_faults(config, name))
        number = fittable_of(config, name)
        if number is None:
            return
        limits, start = number.setting.limits, number.value
        if limits.undercut_by(self.lower):
            yield (
                (*at, "lower"),
                fault(f"is {plain(self.lower)}", f"a number {limits.least}, as for {name}", "raise it"),
            )
        if limits.exceeded_by(self.upper):
            expected = f"a number {limits.most}, as for {name}"
            yield (*at, "upper"), fault(f"is {plain(self.upper)}", expected, "lower it")
        if self.initial is not None or is_pose(name):
            return
        if start is None:
            message = f"has no start, because {name} is not set"
            yield at, fault(message, "an initial value within the bounds", f"add initial, or set {name}")
        elif not self.lower <= start <= self.upper:
            yield at, self._outside(f"starts at {name} = {plain(start)}", f"give an initial value, change {name}")

    def _outside(self, given: str, mend: str) -> PydanticCustomError:
        expected = f"a start from lower = {plain(self.lower)} to upper = {plain(self.upper)}"
        return fault(given, expected, f"{mend}, or widen the bounds")


class SolverConfig(Section, fit.Solver):
    """The optimizer."""


class AnnealConfig(Section, fit.Anneal):
    """The width of the soft compare during a fit: from `start` to `end` in geometric steps."""


class LossConfig(Section, fit.Loss):
    """The quantity that a fit minimises: the mean square errors of its views as one number."""

    def faults(self) -> Iterator[Conflict]:
        if self.false_shadow == 0 and self.false_light == 0:
            yield ("false_light",), fault("is 0, and so is false_shadow", "one greater than 0", "raise one of them")


LOSSES = Variants(fit.AnyLoss, "squares", __name__)
AnyLossConfig = Annotated[fit.AnyLoss, LOSSES]


class ShapePhaseConfig(Section, fit.ShapePhase):
    """A phase of a fit of a shape."""


def _default_phases() -> tuple[ShapePhaseConfig, ...]:
    return tuple(ShapePhaseConfig(**phase) for phase in fit.PHASES)


_Files = Annotated[tuple[str, ...], InputFile(), Form("a list of files", "[first.png, second.png]")]


class ShapeConfig(Section, fit.Shape):
    """A fit of all vertices of a mesh to its shadows on screens. Each light has one screen, behind the mesh.

    Lights count as points, whatever their size. The shadows are images, or are traced from meshes: from the target of
    each light, or from the casters of the scene.
    """

    start: Annotated[
        MeshConfig | None,
        "mesh at the start of the fit; default: the scene's casters with images or targets, otherwise the shrunk "
        "visual hull of the shadows",
    ] = None
    images: Annotated[_Files, "the shadow under each light, as the light sees it: dark on white"] = ()
    masks: Annotated[_Files, "weight of each pixel of an image, from 0 (black) to 1 (white)"] = ()
    targets: Annotated[
        Annotated[tuple[MeshConfig, ...], Form("a list of meshes, each with a path")],
        "a mesh for each light; its shadow under this light is traced",
    ] = ()
    unseen: Annotated[
        Annotated[tuple[LightConfig, ...], Form("a list of lights")],
        "lights that only measure the result; the fit does not use them",
    ] = ()
    phases: Annotated[
        tuple[ShapePhaseConfig, ...], Len(1, 100), Form("a list of phases", "[{strength: 20, rate: 0.1, steps: 150}]")
    ] = Field(default_factory=_default_phases, description="the phases of the fit, in their order")

    def faults(self) -> Iterator[Conflict]:
        if self.images and self.targets:
            yield ("targets",), fault("are given together with images", "one or the other", "remove one of them")
        if self.masks and not self.images:
            yield ("masks",), fault("are given without images", "images with them", "add images, or remove the masks")
        if self.off and not self.moves:
            yield ("off",), fault("is given without moves", "lights that move", "add moves, or remove off")
        if self.off and self.images:
            expected = "shadows traced under known lights"
            yield (
                ("off",),
                fault("is given together with images", expected, "remove it: lights start at their scene position"),
            )
        for key, others in (("images", self.images), ("targets", self.targets)):
            if others and self.unseen:
                expected = "shadows traced from the scene, because other shadows do not show a single shape"
                yield ("unseen",), fault(f"is given together with {key}", expected, f"remove unseen or {key}")
        for i, phase in enumerate(self.phases):
            most = fit.widest_blur(*self.resolution)
            if phase.blur > most:
                message = f"is {phase.blur:g}, and fit.shape.resolution is {list(self.resolution)}"
                expected = f"at most {most:g} pixels, an eighth of its shorter side"
                yield ("phases", i, "blur"), fault(message, expected, "make it narrower")

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        lights = len(config.scene.each_light)
        for key, entries in (("images", self.images), ("masks", self.masks), ("targets", self.targets)):
            if entries and len(entries) != lights:
                message = f"has {counted(len(entries), 'entry')}, and the scene has {counted(lights, 'light')}"
                yield (*at, key), fault(message, "one for each light", "add or remove some")
        for i, number in enumerate(self.moves):
            if not 0 <= number < lights or number in self.moves[:i]:
                message = f"is {number}, and the scene has {counted(lights, 'light')}"
                expected = f"each number from 0 to {lights - 1} at most once"
                yield (*at, "moves", i), fault(message, expected, "change or remove it")
        if config.technique.type != "shadow_map":
            message = f"is {config.technique.type}, and fit.shape draws plain shadow maps"
            yield ("technique", "type"), fault(message, "shadow_map", "remove the technique")
        for key, section in (("sweep", config.sweep), ("advise", config.advise)):
            if section is not None:
                yield (key,), fault("is given together with fit.shape", "one or the other", "remove one of them")
        for key, views in (("views", config.fit.views), ("validation", config.fit.validation)):
            if views is not None:
                mend = "remove it; fit.shape.unseen has lights for measuring"
                yield ("fit", key), fault("is given together with fit.shape", "one or the other", mend)


_as_names = BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)
MIN_BIAS = "least_bias"
"""The preference for the smallest biases, then the smallest radii."""
_RADII = ("radius", "light_size", "blur_scale")
# Float32 entries of the Jacobian, one per pixel and parameter: 1 GB.
_MAX_DERIVATIVES = 1 << 28

UPPER = 10.0
"""The upper bound of the constant bias in a fit that names no parameters, in texels. A large start raises it."""


def _default_parameters() -> dict[str, FitParameterConfig]:
    return {"bias.constant": FitParameterConfig(lower=0.0, upper=UPPER)}


class FitConfig(Section, fit.Fit):
    """The parameters of a fit, and its settings."""

    parameters: dict[str, FitParameterConfig] = Field(
        default_factory=_default_parameters, description="numbers to fit, by the key that sets them"
    )
    solver: SolverConfig = Field(default_factory=SolverConfig, description="the optimizer")
    anneal: AnnealConfig = Field(default_factory=AnnealConfig, description="the soft compare's width during the fit")
    views: Annotated[ViewsConfig | None, "scenes to fit together, instead of the configuration's own"] = None
    validation: Annotated[ValidationConfig | None, "scenes to measure the result on; the fit does not use them"] = None
    prefer: Annotated[
        tuple[str, ...],
        _as_names,
        Form("least_bias, or a list of parameters"),
        "parameters to bring as close to 0 as tolerance allows, in this order; least_bias: all biases, then radii",
    ] = ()
    loss: AnyLossConfig = Field(default_factory=LOSSES.make, description="the quantity that the fit minimises")
    shape: Annotated[ShapeConfig | None, "a fit of all vertices of a mesh to its shadows, instead of parameters"] = None

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if data.get("shape") is None or "parameters" in data else {**data, "parameters": {}}

    def faults(self) -> Iterator[Conflict]:
        if 0 < self.front < fit.FEWEST_POINTS:
            expected = f"0 for none, or at least {fit.FEWEST_POINTS} points"
            yield ("front",), fault(f"is {self.front}", expected, "raise it, such as to 9")
        if self.shape is not None and self.parameters:
            mend = "remove the parameters, or fit.shape"
            yield ("parameters",), fault("are given with fit.shape", "one or the other", mend)
        if not any(map(is_pose, self.parameters)):
            mend = "remove the key, or add a parameter of the scene, such as scene.light.azimuth"
            for key in (key for key in ("blurs", "points") if getattr(self, key) is not None):
                yield (key,), fault("is given, and nothing moves", "a parameter of a light or mesh with it", mend)
        elif self.blurs is not None and (not self.blurs or any(a <= b for a, b in itertools.pairwise(self.blurs))):
            message = "does not fall" if self.blurs else "is empty"
            yield ("blurs",), fault(message, "numbers of pixels that fall", "write a list such as [24, 3]")

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if not self.parameters and self.shape is None:
            mend = "add 'bias.constant: {lower: 0, upper: 10}'"
            yield ("fit", "parameters"), fault("is empty", "at least one parameter to fit", mend)
        pixels, count = config.scene.camera.pixels * len(config.scene.each_light), len(self.parameters)
        if pixels * count > _MAX_DERIVATIVES:
            message = f"has {count} parameters, whose derivatives at {pixels:,} pixels are {pixels * count:,} numbers"
            mend = "fit fewer, or lower scene.camera.resolution"
            yield ("fit", "parameters"), fault(message, f"at most {_MAX_DERIVATIVES:,}, which take 1 GB", mend)
        known = of_technique(config)
        searched = [name for name in self.parameters if name in known and known[name].is_searched]
        sizes = self.views is not None and "shadow_map.resolution" in self.views.axes
        if sizes and (searched or config.technique.is_selective):
            given = f"change shadow_map.resolution, with technique.type {config.technique.type} and its parameters"
            yield ("fit", "views"), fault(given, "one size for all", "set it outside of the views")
        yield from self._faults_of_poses(config, searched) if config.moves else self._faults_of_preferences()

    def _faults_of_poses(self, config: "Config", searched: Sequence[str]) -> Iterator[Conflict]:
        """Faults of a fit of lights or meshes."""
        given = {"intervals": self.intervals, "prefer": self.prefer, "front": self.front}
        given |= {"validation": self.views is None and self.validation}
        for key in (key for key, value in given.items() if value):
            yield ("fit", key), fault("is given in a fit of lights or meshes", "a fit of a technique", "remove it")
        if self.views is not None:
            what = fault("are given in a fit of lights or meshes", "a fit of a technique", "remove them")
            yield ("fit", "views"), what
        for name in searched:
            what = fault("lays out the map in a fit of lights or meshes", "a fit of one or the other", "remove it")
            yield ("fit", "parameters", name), what
        resolution = config.scene.camera.resolution
        most = fit.widest_blur(*resolution)
        for i, blur in enumerate(self.blurs or ()):
            if blur > most:
                message = f"is {blur:g}, and scene.camera.resolution is {list(resolution)}"
                expected = f"at most {most:g} pixels, an eighth of its shorter side"
                yield ("fit", "blurs", i), fault(message, expected, "make it narrower, or the image larger")

    def _faults_of_preferences(self) -> Iterator[Conflict]:
        for name in self.prefer:
            if name == MIN_BIAS:
                if not preferences(self):
                    given, mend = "is least_bias, and no bias is fitted", "add bias.constant, or remove the preference"
                    yield ("fit", "prefer"), fault(given, "one among fit.parameters", mend)
            elif name not in self.parameters:
                what = fault(f"names {name}, which is not fitted", listing((MIN_BIAS, *self.parameters)), "change it")
                yield ("fit", "prefer"), what


def preferences(fit: FitConfig) -> list[str]:
    """The parameters that should come as close to 0 as possible, in their order."""
    biases = [name for name in fit.parameters if name.startswith("bias.") or "bias" in name.rpartition(".")[2]]
    radii = [name for name in fit.parameters if name.rpartition(".")[2] in _RADII and name not in biases]
    found: dict[str, None] = {}
    for name in fit.prefer:
        found |= dict.fromkeys([*biases, *(radii if biases else ())] if name == MIN_BIAS else [name])
    return list(found)
