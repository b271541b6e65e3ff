"""The whole configuration of a run."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from pydantic import PrivateAttr

from ...settings.quantities import MAX_TEXELS
from ..sections._fit import UPPER
from ..sections._fitted import misnamed
from ..sections._section import Conflict, is_number, value_at
from ._between import data_faults_of_fit, fit_faults, run_faults
from ._bias_rule import with_bias
from ._parts import Parts


class FitView(NamedTuple):
    """A scene that a fit sees, or that it is validated on.

    - `name`: what tells it from the others.
    - `config`: of a run of its own.
    """

    name: str
    config: "Config"


class Config(Parts):
    """The configuration of a run, with all checks across sections."""

    _views: tuple[FitView, ...] = PrivateAttr(default=())
    _validation: tuple[FitView, ...] = PrivateAttr(default=())

    @property
    def views(self) -> tuple[FitView, ...]:
        """The views of `fit.views`."""
        return self._views

    @property
    def validation(self) -> tuple[FitView, ...]:
        """The views of `fit.validation`."""
        return self._validation

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
        parameters = value_at(data, "fit", "parameters", default={})
        if isinstance(parameters, Mapping):
            yield from misnamed(data, parameters)

    def faults(self) -> Iterator[Conflict]:
        yield from run_faults(self)

    def fit_faults(self) -> Iterator[Conflict]:
        """Faults that only a fit has: a render does not use these keys."""
        yield from data_faults_of_fit(self)
        yield from fit_faults(self)
