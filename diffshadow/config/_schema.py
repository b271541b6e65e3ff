"""The whole configuration of a run."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr, Tag

from ._biases import BiasConfig
from ._errors import KeyPath, Place, dotted
from ._filters import FilterConfig, RandomDiskConfig
from ._fitted import outside, parameter_faults, start_of
from ._lights import DirectionalLightConfig, PointLightConfig
from ._poses import is_pose
from ._scene import SceneConfig
from ._section import Conflict, Form, Section, Texels, Unit, as_list, by_type, fault, is_number, look, ordered
from ._shading import PhongConfig, ShadingConfig
from ._sweep import SweepConfig
from ._technique import (
    CompareConfig,
    HardCompareConfig,
    Kernel,
    ProjectiveTextureConfig,
    ShadowMapConfig,
    ShadowMappingConfig,
    TechniqueConfig,
)


@dataclass(eq=False)
class Origin:
    """Where the keys of a configuration were written.

    All origins are equal: where a configuration was written is no part of what it says.
    """

    source: str = "configuration"
    places: Mapping[KeyPath, Place] = field(default_factory=dict)

    def place(self, path: KeyPath) -> Place:
        """Where `path` was written, or else the nearest section round it."""
        for length in range(len(path), -1, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return Place(self.source)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin)

    def __hash__(self) -> int:
        return hash(Origin)


class TracedReferenceConfig(Section):
    """Ray-traced truth."""

    type: Literal["traced"] = "traced"
    samples: Annotated[int, Unit("rays a pixel")] = Field(default=64, ge=1, le=65536, description="shadow rays a pixel")
    sampler: Literal["sobol", "stratified"] = Field(default="sobol", description="how points of the light are chosen")
    supersampling: Annotated[int, Unit("camera rays a pixel's side")] = Field(
        default=1,
        ge=1,
        le=8,
        description="4 gives each pixel the mean over 4 x 4 points; fits of poses want it",
    )


class ImageReferenceConfig(Section):
    """Truth from a file."""

    type: Literal["image"] = "image"
    path: str = Field(
        min_length=1,
        description="a visibility image, relative to this file (in an override: to the current folder)",
    )


ReferenceConfig = Annotated[
    Annotated[TracedReferenceConfig, Tag("traced")] | Annotated[ImageReferenceConfig, Tag("image")], by_type("traced")
]


class FitParameterConfig(Section):
    """A number to fit, in the unit of the key that it names, and its bounds.

    Of the scene's numbers, those that light and meshes have by `scene` are the truth, if the reference is traced.
    """

    initial: float | None = Field(
        default=None, description="where the fit starts; default: the value of the key it names"
    )
    lower: float = Field(description="least value")
    upper: float = Field(description="greatest value")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from ordered(data, "lower", "upper")
        initial, lower, upper = (data.get(key) for key in ("initial", "lower", "upper"))
        if is_number(initial) and is_number(lower) and is_number(upper) and lower < upper:
            yield from ((("initial",), what) for what in outside(initial, lower, upper))


class SolverConfig(Section):
    """The optimizer."""

    type: Literal["levenberg_marquardt", "dogleg", "bfgs", "lbfgs", "adam"] = Field(
        default="levenberg_marquardt", description="the method"
    )
    max_steps: Annotated[int, Unit("steps")] = Field(default=30, ge=1, description="most steps in a phase")
    rtol: float = Field(default=1e-4, gt=0, lt=1, description="relative change at which a phase ends")
    atol: float = Field(default=1e-6, gt=0, description="absolute change at which a phase ends")
    learning_rate: float = Field(
        default=0.05, gt=0, description="of adam alone: length of its first steps, where the bounds lie pi apart"
    )


class AnnealConfig(Section):
    """The soft compare's width during a fit: from `start` to `end` in geometric steps."""

    start: Texels = Field(default=2.0, gt=0, description="width in the first phase, in texels")
    end: Texels = Field(default=0.05, gt=0, description="width in the last phase, in texels")
    phases: int = Field(default=4, ge=1, le=100, description="number of phases")
    kernel: Kernel = Field(default="logistic", description="shape of the soft compare's step")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        start, end = data.get("start", 2.0), data.get("end", 0.05)
        if is_number(start) and is_number(end) and end > start:
            key = "end" if "end" in data else "start"
            what = fault(f"is {data[key]}, with start {start} and end {end}", "end at most start", "swap the two")
            yield (key,), what


def _default_parameters() -> dict[str, FitParameterConfig]:
    return {"bias.constant": FitParameterConfig(lower=0.0, upper=10.0)}


class FitConfig(Section):
    """What is fitted, and how."""

    parameters: dict[str, FitParameterConfig] = Field(
        default_factory=_default_parameters, description="numbers to fit, by the key they are set with"
    )
    solver: SolverConfig = Field(default_factory=SolverConfig, description="the optimizer")
    anneal: AnnealConfig = Field(default_factory=AnnealConfig, description="the soft compare's width during the fit")
    levels: Annotated[tuple[int, ...], as_list, Form("a list of whole numbers that fall to 1")] | None = Field(
        default=None,
        description="of lights and meshes: how many pixels a side make one, phase by phase; default: [8, 1]",
    )
    multistart: Annotated[int, Unit("starts")] = Field(
        default=1, ge=1, le=1024, description="starts that are tried: the initial values, and others over the bounds"
    )

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        parameters, levels = data.get("parameters"), data.get("levels")
        if parameters == {}:
            mend = "add 'bias.constant: {lower: 0, upper: 10}'"
            yield ("parameters",), fault("is empty", "at least one parameter to fit", mend)
        if isinstance(levels, list | tuple) and all(isinstance(n, int) for n in levels):
            if not levels or levels[-1] != 1 or any(a <= b for a, b in itertools.pairwise(levels)):
                said = "does not fall to 1" if levels else "is empty"
                yield ("levels",), fault(said, "whole numbers that do", "write a list such as [8, 1]")
            elif not any(is_pose(str(name)) for name in parameters or ()):
                mend = "remove the key, or name a number of the scene, such as scene.light.azimuth"
                yield ("levels",), fault("is given, and nothing moves", "a parameter of light or mesh with it", mend)


def _file_name(name: str) -> str:
    if not name.strip() or name in (".", "..") or any(c in "/\\" or not c.isprintable() for c in name):
        raise fault(f"is {name!r}", "text that can name a folder", "use letters, digits, '-' and '_'")
    return name


class Config(Section):
    """Everything that a run depends on."""

    name: Annotated[str, AfterValidator(_file_name)] = Field(
        default="unnamed", description="names the run's folder; default: the file's name without its ending"
    )
    seed: int = Field(default=0, ge=0, lt=2**32, description="of everything random")
    scene: SceneConfig = Field(description="what is drawn, from where, and lit by what")
    technique: TechniqueConfig = Field(default_factory=ShadowMappingConfig, description="how shadows are drawn")
    shadow_map: ShadowMapConfig = Field(default_factory=ShadowMapConfig, description="the map drawn from the light")
    bias: BiasConfig = Field(default_factory=BiasConfig, description="how far receivers move towards the light")
    compare: CompareConfig = Field(default_factory=HardCompareConfig, description="how depths are compared")
    filter: FilterConfig = Field(default_factory=RandomDiskConfig, description="how compares are averaged")
    shading: ShadingConfig = Field(default_factory=PhongConfig, description="how the pictures are shaded")
    reference: ReferenceConfig = Field(default_factory=TracedReferenceConfig, description="the truth to fit to")
    fit: FitConfig = Field(default_factory=FitConfig, description="what is fitted, and how")
    sweep: SweepConfig | None = Field(default=None, description="what changes from run to run; default: a single run")
    output: str = Field(
        default="runs", min_length=1, description="folder for the runs' folders, from the current folder"
    )

    _origin: Origin = PrivateAttr(default_factory=Origin)

    @property
    def origin(self) -> Origin:
        """Where the keys were written, for errors that are found later."""
        return self._origin

    def initial(self, name: str) -> float:
        """Where the fit of the parameter `name` starts."""
        initial = self.fit.parameters[name].initial
        return float(start_of(self, name) if initial is None else initial)

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        parameters = look(data, "fit", "parameters", default={})
        if isinstance(parameters, Mapping):
            yield from parameter_faults(data, parameters)

    def faults(self) -> Iterator[Conflict]:
        if isinstance(self.technique, ShadowMappingConfig):
            yield from self._beyond_guards()
            yield from self._silhouettes_of_others()
        if isinstance(self.technique, ProjectiveTextureConfig) and all(mesh.casts for mesh in self.scene.meshes):
            said = "projects shadows on meshes that cast none, and all of scene.meshes cast"
            yield ("technique", "type"), fault(said, "one that does not", "set casts: false for those that receive")
        for key, light in self.scene.each_light.items():
            if isinstance(light, DirectionalLightConfig) and light.frame == "casters" and self.moves:
                said = "is casters in a fit of lights or meshes, whose shadows may leave what they cast at the start"
                yield ("scene", *key, "frame"), fault(said, "scene", "remove it")
        if isinstance(self.reference, ImageReferenceConfig) and len(self.scene.each_light) > 1:
            said = f"is one image, for {len(self.scene.each_light)} lights"
            yield ("reference", "type"), fault(said, "one light, or a traced reference", "set it to traced")

    @property
    def moves(self) -> bool:
        """Whether its fit moves lights or meshes."""
        return any(is_pose(name) for name in self.fit.parameters)

    @property
    def has_silhouettes(self) -> bool:
        """Whether the maps of its fit hold silhouettes."""
        return self.moves if self.shadow_map.silhouettes is None else self.shadow_map.silhouettes

    def _silhouettes_of_others(self) -> Iterator[Conflict]:
        """Faults of a map with silhouettes that does not hold the nearest of all faces."""
        section = self.shadow_map
        for key, value, plain in (("layer", section.layer, "nearest"), ("cull", section.cull, "none")):
            if self.has_silhouettes and value != plain:
                why = "with silhouettes" if section.silhouettes else "in a fit of lights or meshes, with silhouettes"
                mend = "remove it, or set shadow_map.silhouettes to false"
                yield ("shadow_map", key), fault(f"is {value} {why}", plain, mend)

    def _beyond_guards(self) -> Iterator[Conflict]:
        """Faults of a filter that reads further than the faces of a point light's map go."""
        path, reach = ("filter", self.filter.radius_key), self.filter.reach
        bounds = self.fit.parameters.get("filter.radius")
        if bounds is not None and bounds.upper - getattr(self.filter, "radius", 0.0) > 0:
            path = ("fit", "parameters", "filter.radius", "upper")
            reach += bounds.upper - getattr(self.filter, "radius", 0.0)
        reach += self.bias.normal_offset
        half = min(self.shadow_map.resolution) / 2
        for key, light in self.scene.each_light.items():
            if not isinstance(light, PointLightConfig) or reach <= light.guard / (1 + light.guard) * half:
                continue
            name = dotted(("scene", *key, "guard"))
            raised = f"raise {name} to {reach / (half - reach):.2g}, " if reach <= half / 2 else ""
            yield (
                path,
                fault(
                    f"lets the filter read {reach:g} texels away, across a face's edge of a point light's map",
                    f"at most {light.guard / (1 + light.guard) * half:.3g} texels, which {name} = {light.guard} allows",
                    f"{raised}raise shadow_map.resolution, or make the filter smaller",
                ),
            )
