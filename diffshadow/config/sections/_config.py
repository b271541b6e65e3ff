"""The whole configuration of a run: all sections, and values that depend on several sections."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from pydantic import AfterValidator, Field, PrivateAttr

from ...settings.quantities import MAX_TEXELS
from .._errors import KeyPath, Origin, show
from ._advise import AdviseConfig
from ._fit import UPPER, FitConfig, FitParameterConfig
from ._fitted import could_be_fitted, is_pose, misnamed, of_technique
from ._images import REFERENCES, SHADINGS, ReferenceConfig, ShadingConfig
from ._scene import SceneConfig
from ._section import Conflict, Section, fault, is_number, unchecked, value_at
from ._sweep import SweepConfig
from ._technique import (
    COMPARES,
    FILTERS,
    TECHNIQUES,
    BiasConfig,
    CompareConfig,
    FilterConfig,
    ShadowMapConfig,
    TechniqueConfig,
    with_bias,
)


def path_of(text: str) -> Path:
    """The path `text`, with a leading `~` expanded to the current user's home folder.

    **Raises** `PydanticCustomError`, a `ValueError`, if `text` names another user's home folder or contains U+0000.
    """
    if "\0" in text:
        raise fault(f"is {show(text)}, which holds the character U+0000", "a path", "remove it")
    first, _, _ = text.partition("/")
    if first == "~":
        home = os.path.expanduser("~")
        if home == "~":
            message = f"is {show(text)}, and the current user has no home folder"
            raise fault(message, "a path without ~", "write the folder out, or set the variable HOME")
        return Path(home + text[1:])
    if first.startswith("~"):
        message = f"is {show(text)}, which begins with the home folder of another user"
        mend = f"write that folder out, or ./{first} for a folder of that name"
        raise fault(message, "a path, in which ~/ is the current user's home folder", mend)
    return Path(text)


# File systems allow names of up to 255 bytes. The name of a run's draft folder is up to 25 bytes longer than the run's
# name.
_LONGEST_NAME = 200


def _file_name(name: str) -> str:
    if not name.strip() or name in (".", "..") or any(c in "/\\" or not c.isprintable() for c in name):
        raise fault(f"is {show(name)}", "text that can name a folder", "use letters, digits, '-' and '_'")
    size = len(name.encode())
    if size > _LONGEST_NAME:
        expected = f"at most {_LONGEST_NAME}, because file systems allow 255 and a run adds to the name"
        raise fault(f"has {size} bytes", expected, "shorten it")
    return name


def _folder(output: str) -> str:
    path_of(output)
    if not output.isprintable():
        raise fault(f"is {show(output)}", "text that can name a folder", "remove the unprintable characters")
    return output


class FitView(NamedTuple):
    """A scene of a fit or of its validation.

    - `name`: its unique name.
    - `config`: its configuration, as for a separate run.
    """

    name: str
    config: "Config"


class Reach(NamedTuple):
    """The distance from a receiver to the farthest texel that the filter reads, in `texels`, with the normal offset.

    - `path`: path of the key with the largest contribution; `is_of_fit`: whether it is a bound of a fitted number.
    """

    texels: float
    path: KeyPath
    is_of_fit: bool


class Config(Section):
    """The configuration of a run."""

    name: Annotated[str, AfterValidator(_file_name)] = Field(
        default="unnamed", description="name of the run's folder; default: the file's name without its suffix"
    )
    seed: int = Field(default=0, ge=0, lt=2**32, description="seed of all random numbers")
    scene: SceneConfig = Field(description="meshes, camera and lights")
    technique: TechniqueConfig = Field(default_factory=TECHNIQUES.make, description="how shadows are drawn")
    shadow_map: ShadowMapConfig = Field(default_factory=ShadowMapConfig, description="the map drawn from the light")
    bias: BiasConfig = Field(default_factory=BiasConfig, description="bias of receivers towards the light")
    compare: CompareConfig = Field(default_factory=COMPARES.make, description="how depths are compared")
    filter: FilterConfig = Field(default_factory=FILTERS.make, description="how compares are averaged")
    shading: ShadingConfig = Field(default_factory=SHADINGS.make, description="how images are shaded")
    reference: ReferenceConfig = Field(default_factory=REFERENCES.make, description="visibility to fit to")
    fit: FitConfig = Field(default_factory=FitConfig, description="parameters and settings of the fit")
    sweep: SweepConfig | None = Field(
        default=None, description="the values that change between runs; default: a single run"
    )
    advise: AdviseConfig | None = Field(
        default=None, description="techniques that diffshadow advise compares; default: biases and filters of all kinds"
    )
    output: Annotated[str, AfterValidator(_folder)] = Field(
        default="runs", min_length=1, description="folder of the runs' folders, relative to the current folder"
    )

    _origin: Origin = PrivateAttr(default_factory=Origin)
    _views: tuple[FitView, ...] = PrivateAttr(default=())
    _validation: tuple[FitView, ...] = PrivateAttr(default=())

    @property
    def origin(self) -> Origin:
        """The places of the keys, for errors found after loading."""
        return self._origin

    @property
    def notes(self) -> tuple[str, ...]:
        """The program's choices for parts of the scene that the configuration leaves out, as sentences without a full
        stop."""
        return self._origin.notes

    @property
    def views(self) -> tuple[FitView, ...]:
        """The views of `fit.views`."""
        return self._views

    @property
    def validation(self) -> tuple[FitView, ...]:
        """The views of `fit.validation`."""
        return self._validation

    def initial(self, name: str) -> float:
        """The start of the fit of the parameter `name` of the technique."""
        initial = self.fit.parameters[name].initial
        start: Any = of_technique(self)[name].value if initial is None else initial
        return float(start)

    @property
    def moves(self) -> bool:
        """Whether the fit draws maps again at every step, because it changes lights or meshes or because its reference
        is a picture."""
        return self.reference.type == "picture" or any(is_pose(name) for name in self.fit.parameters)

    @property
    def has_silhouettes(self) -> bool:
        """Whether the maps of the fit store silhouettes."""
        return self.moves if self.shadow_map.silhouettes is None else self.shadow_map.silhouettes

    def reach(self, bounds: Mapping[str, FitParameterConfig]) -> Reach:
        """The distance from a receiver to the farthest texel that the filter reads, in texels.

        **Arguments:**

        - `bounds`: the bounds of fitted numbers, by name.
        """
        section, factors = self.filter, self.bias.factors or ()
        radius = getattr(section, section.radius_key, None)
        now = {"bias.normal_offset": self.bias.normal_offset}
        now |= {f"bias.factors.{i}": factor for i, factor in enumerate(factors)}
        now |= {} if radius is None else {f"filter.{section.radius_key}": radius}

        def texels() -> float:
            factor = max((most[f"bias.factors.{i}"] for i in range(len(factors))), default=1.0)
            further = 0.0 if radius is None else most[f"filter.{section.radius_key}"] - radius
            return section.reach + further + most["bias.normal_offset"] * factor

        most = dict(now)
        reach, name = texels(), None
        for key in now:
            if key in bounds:
                most[key] = max(now[key], bounds[key].upper)
                further = texels()
                reach, name = (further, key) if further > reach else (reach, name)
        if name is not None:
            return Reach(reach, ("fit", "parameters", name, "upper"), True)
        if self.bias.normal_offset > section.reach:
            return Reach(reach, ("bias", "normal_offset"), False)
        keys = [key for key in (section.radius_key, "size", "weights") if hasattr(section, key)]
        return Reach(reach, ("filter", *keys[:1]), False)

    def laid_out(self, bounds: Mapping[str, FitParameterConfig]) -> TechniqueConfig:
        """`technique` with a size for its layout, if none is given, that suffices for all fitted numbers within
        `bounds`."""
        return self.technique.laid_out(self, bounds)

    def named_with(self, suffix: str) -> Self:
        """The configuration with `suffix` appended to its name. The name is cut if the result is too long for a
        folder."""
        name = self.name.encode()[: _LONGEST_NAME - len(suffix.encode())].decode(errors="ignore")
        return self.model_copy(update={"name": f"{name}{suffix}"})

    def with_layout_of_fit(self) -> Self:
        """The configuration with the layout that its fit draws, so that a render with fitted values draws the same
        picture."""
        return self.model_copy(update={"technique": self.laid_out(self.fit.parameters)})

    def with_starts(self) -> Self:
        """The configuration with values for the starts of fitted numbers that are not set."""
        config = self
        for name, number in of_technique(self).items():
            bounds = self.fit.parameters.get(name)
            if number.value is None and bounds is not None:
                config = config.with_value(name.split("."), bounds.initial)
        return config

    @property
    def output_folder(self) -> Path:
        """The folder `output`, with `~` expanded to the current user's home folder."""
        return path_of(self.output)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        data = with_bias(data)
        section = data.get("fit", {})
        if not isinstance(section, Mapping) or "parameters" in section or section.get("shape") is not None:
            return data
        # The default bounds contain the start.
        start = value_at(data, "bias", "constant", default=0)
        upper = min(max(UPPER, 2 * start), MAX_TEXELS) if is_number(start) else UPPER
        return {**data, "fit": {**section, "parameters": {"bias.constant": {"lower": 0.0, "upper": float(upper)}}}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        parameters = value_at(data, "fit", "parameters")
        odd = [name for name in parameters if not could_be_fitted(name)] if isinstance(parameters, Mapping) else []
        if odd:
            yield from misnamed(unchecked(cls, data), odd)

    def faults(self) -> Iterator[Conflict]:
        for at, section in self._with_rules():
            yield from section.faults_of_run(self, at)

    def fit_faults(self, *, named: bool = True) -> Iterator[Conflict]:
        """Faults that concern only a fit. A render does not use these keys.

        **Arguments:**

        - `named`: whether the file names the parameters. The default parameters may not suit a file that is only
          rendered.
        """
        for at, section in self._with_rules():
            if named or at[:2] != ("fit", "parameters"):
                yield from section.faults_of_fit(self, at)

    def _with_rules(self) -> Iterator[tuple[KeyPath, Section]]:
        """The sections with rules between sections. Meshes and lights in `fit.shape` are not parts of the scene."""
        return ((at, each) for at, each in self.sections() if at[:2] != ("fit", "shape") or len(at) == 2)
