"""All sections of a configuration."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, PrivateAttr

from ...settings.techniques import SPARE, Cascades, FittedLayout
from .._errors import Origin, show
from ..sections._advise import AdviseConfig
from ..sections._biases import BiasConfig
from ..sections._filters import FILTERS, FilterConfig
from ..sections._fit import FitConfig, FitParameterConfig
from ..sections._fitted import start_of
from ..sections._paths import path_of
from ..sections._poses import is_pose
from ..sections._reference import REFERENCES, ReferenceConfig
from ..sections._scene import SceneConfig
from ..sections._section import Section, changed, fault
from ..sections._shading import SHADINGS, ShadingConfig
from ..sections._sweep import SweepConfig
from ..sections._technique import COMPARES, TECHNIQUES, CompareConfig, ShadowMapConfig, TechniqueConfig

# File systems allow names of up to 255 bytes. A run's draft folder has up to 25 more than its name.
_LONGEST_NAME = 200


def _file_name(name: str) -> str:
    if not name.strip() or name in (".", "..") or any(c in "/\\" or not c.isprintable() for c in name):
        raise fault(f"is {show(name)}", "text that can name a folder", "use letters, digits, '-' and '_'")
    size = len(name.encode())
    if size > _LONGEST_NAME:
        expected = f"at most {_LONGEST_NAME}, since file systems allow 255 and a run adds to the name"
        raise fault(f"has {size} bytes", expected, "shorten it")
    return name


def _folder(output: str) -> str:
    path_of(output)
    if not output.isprintable():
        raise fault(f"is {show(output)}", "text that can name a folder", "remove the unprintable characters")
    return output


class Parts(Section):
    """All sections of a run, each valid on its own."""

    name: Annotated[str, AfterValidator(_file_name)] = Field(
        default="unnamed", description="name of the run's folder; default: the file's name without its suffix"
    )
    seed: int = Field(default=0, ge=0, lt=2**32, description="seed of everything random")
    scene: SceneConfig = Field(description="meshes, camera and lights")
    technique: TechniqueConfig = Field(default_factory=TECHNIQUES.make, description="how shadows are drawn")
    shadow_map: ShadowMapConfig = Field(default_factory=ShadowMapConfig, description="the map drawn from the light")
    bias: BiasConfig = Field(default_factory=BiasConfig, description="bias of receivers towards the light")
    compare: CompareConfig = Field(default_factory=COMPARES.make, description="how depths are compared")
    filter: FilterConfig = Field(default_factory=FILTERS.make, description="how compares are averaged")
    shading: ShadingConfig = Field(default_factory=SHADINGS.make, description="how images are shaded")
    reference: ReferenceConfig = Field(default_factory=REFERENCES.make, description="visibility to fit to")
    fit: FitConfig = Field(default_factory=FitConfig, description="parameters and settings of the fit")
    sweep: SweepConfig | None = Field(default=None, description="what changes from run to run; default: a single run")
    advise: AdviseConfig | None = Field(
        default=None, description="techniques that diffshadow advise compares; default: biases and filters of all kinds"
    )
    output: Annotated[str, AfterValidator(_folder)] = Field(
        default="runs", min_length=1, description="folder of the runs' folders, relative to the current folder"
    )

    _origin: Origin = PrivateAttr(default_factory=Origin)

    @property
    def origin(self) -> Origin:
        """Where the keys were written, for errors found after loading."""
        return self._origin

    @property
    def notes(self) -> tuple[str, ...]:
        """What was found for parts of the scene that were left to the program, each a sentence without a full stop."""
        return self._origin.notes

    def initial(self, name: str) -> float:
        """The start of the fit of the parameter `name`."""
        initial = self.fit.parameters[name].initial
        return float(start_of(self, name) if initial is None else initial)

    @property
    def moves(self) -> bool:
        """Whether the fit draws maps again at every step: it changes lights or meshes, or is to a picture."""
        return self.reference.type == "picture" or any(is_pose(name) for name in self.fit.parameters)

    @property
    def has_silhouettes(self) -> bool:
        """Whether the maps of the fit store silhouettes."""
        return self.moves if self.shadow_map.silhouettes is None else self.shadow_map.silhouettes

    def reach(self, bounds: Mapping[str, FitParameterConfig]) -> tuple[float, str | None]:
        """How far from a receiver the filter reads texels, in texels, with the normal offset.

        **Arguments:**

        - `bounds`: by name, of fitted numbers, which may have any value within them.

        **Returns** it, and the last of the names whose bounds made it larger.
        """
        keys = ("bias.normal_offset", *(f"bias.factors.{i}" for i in range(len(self.bias.factors or ()))))
        reach, name, given = self._reach({}), None, {}
        for key in (*keys, f"filter.{self.filter.radius_key}"):
            if key in bounds:
                given[key] = bounds[key].upper
                further = self._reach(given)
                reach, name = (further, key) if further > reach else (reach, name)
        return reach, name

    def _reach(self, greatest: Mapping[str, float]) -> float:
        """How far the filter reads, in texels, with numbers that may be as great as the `greatest` of their names."""
        section, most = self.filter, lambda key, now: max(now, greatest.get(key, now))
        offset = most("bias.normal_offset", self.bias.normal_offset)
        factor = max((most(f"bias.factors.{i}", now) for i, now in enumerate(self.bias.factors or ())), default=1.0)
        radius = getattr(section, section.radius_key, None)
        further = 0.0 if radius is None else most(f"filter.{section.radius_key}", radius) - radius
        return section.reach + further + offset * factor

    def laid_out(self, bounds: Mapping[str, FitParameterConfig]) -> TechniqueConfig:
        """`technique` with the margin of its maps, and cascades with the blend that they are drawn for, where these are
        not given: as much as fitted numbers within `bounds` need."""
        section, given = self.technique, {}
        if isinstance(section, FittedLayout) and section.margin is None:
            given["margin"] = self.reach(bounds)[0] + SPARE
        if isinstance(section, Cascades) and section.max_blend is None and "technique.blend" in bounds:
            given["max_blend"] = max(section.blend, bounds["technique.blend"].upper)
        return changed(section, **given)

    def named_with(self, suffix: str) -> Self:
        """The configuration with `suffix` behind its name, which is cut where both are too long for a folder."""
        name = self.name.encode()[: _LONGEST_NAME - len(suffix.encode())].decode(errors="ignore")
        return self.model_copy(update={"name": f"{name}{suffix}"})

    def with_layout_of_fit(self) -> Self:
        """The configuration with the layout that its fit draws, so that a render with fitted values draws the same."""
        return self.model_copy(update={"technique": self.laid_out(self.fit.parameters)})

    def max_share(self, bounds: Mapping[str, FitParameterConfig]) -> float | None:
        """The greatest part of all texels that a cascade may have, in (0, 1]; none unless cascades have shares.

        **Arguments:** as for `reach`.
        """
        shares = self.technique.shares if isinstance(self.technique, Cascades) else None
        if shares is None:
            return None
        ends = [bounds.get(f"technique.shares.{i}") for i in range(len(shares))]
        low = [min(share, end.lower) if end else share for share, end in zip(shares, ends, strict=True)]
        high = [max(share, end.upper) if end else share for share, end in zip(shares, ends, strict=True)]
        return max(most / (most + sum(low) - least) for least, most in zip(low, high, strict=True))

    @property
    def output_folder(self) -> Path:
        """The folder `output`, with `~` expanded to the current user's home folder."""
        return path_of(self.output)
