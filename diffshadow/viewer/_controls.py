"""The controls of a page, made from the schema of the configuration."""

from typing import Any, NamedTuple

from ..config import Config, Number, choices_of, numbers_of

# The largest value of a slider by unit, if neither the value nor the limits suggest one.
_SPANS = {"texels": 4.0, "degrees": 5.0, "window depth": 0.01, "parts of the depth range": 0.01}
# The end of a slider is this factor times its present value.
_FACTOR = 4.0
_HALF_TURN = 180.0
# Significant digits of the ends of a slider.
_DIGITS = 3
_ROUNDING = 1e-5


class Slider(NamedTuple):
    """A number of the page, from `low` to `high`. `is_fittable` says whether a fit can find it."""

    key: str
    value: float
    low: float
    high: float
    unit: str
    hint: str
    is_fittable: bool

    def holds(self, value: float) -> bool:
        """Whether `value` is between the ends. Pages round to six digits, so the check allows that error."""
        slack = _ROUNDING * max(abs(self.low), abs(self.high))
        return self.low - slack <= value <= self.high + slack

    def reaching(self, low: float, high: float) -> "Slider":
        """This slider, widened to include `low` and `high`."""
        return self._replace(low=min(self.low, low), high=max(self.high, high))


class Picker(NamedTuple):
    """A choice on the page: one of `options`, or a whole number from `low` to `high`. It sets the key `sets`."""

    key: str
    value: Any
    options: tuple[tuple[str, Any], ...]
    sets: str
    hint: str
    low: int | None
    high: int | None


def sliders_of(config: Config, size: float) -> dict[str, Slider]:
    """A slider for each number of `config`.

    **Arguments:** `size`: the size of the scene, in world units.
    """
    return {key: _slider(config, key, number, size) for key, number in numbers_of(config).items()}


def pickers_of(config: Config) -> list[Picker]:
    """A picker for each choice of `config`."""
    return [
        Picker(
            key,
            _json(choice.value),
            tuple((_label(option), _setting(choice.sets, key, option)) for option in choice.options),
            choice.sets,
            choice.meaning,
            choice.limits.low,  # type: ignore[arg-type]
            choice.limits.high,  # type: ignore[arg-type]
        )
        for key, choice in choices_of(config).items()
    ]


def _slider(config: Config, key: str, number: Number, size: float) -> Slider:
    value, limits, bounds = number.value, number.limits, config.fit.parameters.get(key)
    if bounds is not None:
        low, high = bounds.lower, bounds.upper
    elif number.unit == "degrees" and (limits.low or 0) < 0:
        # These numbers are a direction or a rotation.
        low, high = -_HALF_TURN, _HALF_TURN
    else:
        span = max(_FACTOR * abs(value), _SPANS.get(number.unit, size if number.unit == "world units" else 1.0))
        low, high = (0.0 if limits.low is not None and limits.low >= 0 else -span), span
    low, high = (float(f"{end:.{_DIGITS}g}") for end in (low, high))
    low = min(value, low if limits.low is None else max(low, limits.low))
    high = max(value, high if limits.high is None else min(high, limits.high))
    return Slider(key, value, low, high, number.unit, number.meaning, number.is_fittable)


def _setting(sets: str, key: str, option: Any) -> Any:
    """What a picker sets for an option: a section of that type, or the value itself."""
    return _json(option) if sets == key else {"type": option}


def _label(option: Any) -> str:
    if isinstance(option, bool):
        return "yes" if option else "no"
    return " × ".join(map(str, option)) if isinstance(option, tuple) else str(option)


def _json(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
