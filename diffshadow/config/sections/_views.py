"""Sections of a fit over several views: the views, and the loss over them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar

from ...settings.fit import AnyLoss, Loss
from .._errors import KeyPath
from ._axes import AxesConfig, settings_of
from ._section import Conflict, Section, Variants, fault, is_number

_OF_A_VIEW = ("scene", "reference", "shadow_map.resolution")


class ViewsConfig(AxesConfig):
    """The views of a fit: every combination of values on the axes."""

    at: ClassVar[str] = "fit.views"

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        if not [*settings_of(data)] and not data.get("list"):
            mend = "add 'grid: {scene.light.azimuth: [0, 90, 180]}'"
            yield (), fault("changes no key", "list, grid, files, zip, path, sun or qmc", mend)
        yield from super().conflicts(data)

    @classmethod
    def fixed(cls, settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
        for path, key in settings:
            if not any(key == start or key.startswith(f"{start}.") for start in _OF_A_VIEW):
                expected = "keys of scene or reference, or shadow_map.resolution"
                yield path, fault("is shared by all views", expected, "set it outside of the views")


class ValidationConfig(ViewsConfig):
    """Views that the fit does not see, on which its result is measured."""

    at: ClassVar[str] = "fit.validation"


class LossConfig(Section, Loss):
    """What a fit minimises: the mean square errors of its views as one number."""

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        factors = [data.get(key, 1.0) for key in ("false_shadow", "false_light")]
        if all(is_number(factor) and factor == 0 for factor in factors):
            yield ("false_light",), fault("is 0, and so is false_shadow", "one greater than 0", "raise one of them")


LOSSES = Variants(AnyLoss, "squares", __name__)
AnyLossConfig = Annotated[AnyLoss, LOSSES]
