"""Rules for biases, searched for in the errors that were measured over a collection of scenes."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import _rule_errors as errors
import _rule_shipped as shipped
import numpy as np
from rich.table import Table
from scipy import stats
from scipy.optimize import differential_evolution, minimize

from diffshadow.console import Console
from diffshadow.settings.rules import PART

SHARE = 0.08
"""The share of scenes with acne that a rule should stay below."""
# What a share of scenes with acne beyond it costs, in prices.
_PENALTY = 3.0
NO_CAP = np.inf
PARTS = (NO_CAP, 1.0, PART, 0.25)
"""The parts of a typical caster's width that a constant is at most, which are compared."""
CONFIDENCE = 0.9
"""How likely the stated intervals contain what would be found in all scenes that the collection could have."""

FAMILIES = {
    "constant": (True, False, False),
    "normal offset": (False, False, True),
    "constant + slope": (True, True, False),
    "constant + normal offset": (True, False, True),
    "all three": (True, True, True),
}
"""Which of constant, slope and normal offset a rule sets."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """What was measured in all scenes.

    - `errors`: by filter and engine, (scenes, constants, slopes, offsets, 3), NaN where an engine lacks the light.
    - `shipped`: by engine, (scenes, 3); `units`: by engine, (scenes, 2).
    - `described`: (scenes, numbers); `kinds`: (scenes,), their names; `apart`: which of them rules are only tested on.
    """

    errors: Mapping[str, np.ndarray]
    shipped: Mapping[str, np.ndarray]
    units: Mapping[str, np.ndarray]
    described: np.ndarray
    kinds: np.ndarray
    apart: np.ndarray

    @classmethod
    def of(
        cls,
        found: Sequence[Mapping[str, np.ndarray]],
        names: Sequence[str],
        kinds: Sequence[str],
        apart: Sequence[bool],
    ) -> "Measured":
        """What was `found` in each scene for the filters or engines with these `names`."""
        stacked = lambda key, shape: np.stack([each.get(key, np.full(shape, np.nan)) for each in found])
        grids = {name: stacked(name, (len(_grid_of(name)), 3)) for name in names}
        engines = [name for name in names if name in shipped.ENGINES]
        return cls(
            {name: values.reshape(len(found), *_shape(name), 3) for name, values in grids.items()},
            {name: stacked(f"shipped {name}", (3,)) for name in engines},
            {name: stacked(f"units {name}", (2,)) for name in engines},
            np.stack([each["scene"] for each in found]),
            np.asarray(kinds),
            np.asarray(apart),
        )

    @property
    def named(self) -> Mapping[str, np.ndarray]:
        """What describes the scenes, by name: (scenes,)."""
        return dict(zip(errors.DESCRIBED, self.described.T, strict=True))

    def in_texels(self, name: str, own: np.ndarray) -> np.ndarray:
        """An engine's two settings as biases in texels, (scenes, 3)."""
        constant, offset = (_ratio(own[i], self.units[name][:, i]) for i in range(2))
        return np.stack([constant, np.zeros(len(constant)), offset], axis=1)

    def capped(self, name: str, bias: np.ndarray, part: float = PART) -> np.ndarray:
        """A filter's bias for each scene, (scenes, 3): its constant is at most a part of a typical caster's width
        there, or of the kernel's if that is wider."""
        width = np.maximum(self.named["across"], 2 * _reach(name))
        constant = np.minimum(bias[0], part * width)
        return np.stack([constant, *(np.full(len(constant), each) for each in bias[1:])], axis=1)

    def best(self, name: str) -> np.ndarray:
        """The least error of each scene, over all biases of a filter."""
        return self.errors[name][..., 0].min(axis=(1, 2, 3))

    def at(self, name: str, bias: np.ndarray) -> np.ndarray:
        """The errors of all scenes, (scenes, 3), with one bias or one for each scene, between the ones measured."""
        grid, scene = self.errors[name], slice(None) if bias.ndim == 1 else np.arange(len(self.described))
        cells = [_cell(axis, bias[..., i]) for i, axis in enumerate(_axes(name))]
        found = np.zeros((len(grid), 3))
        for corner in np.ndindex(2, 2, 2):
            index, weight = [], 1.0
            for (low, part, last), upper in zip(cells, corner, strict=True):
                index.append(np.minimum(low + upper, last))
                weight = weight * (part if upper else 1 - part)
            if np.any(weight):
                found += np.reshape(weight, (-1, 1)) * grid[scene, index[0], index[1], index[2]]
        return found


def filter_names() -> list[str]:
    """All filters, with and without a receiver plane."""
    return [*errors.FILTERS, *errors.LITTLE, *(name + errors.PLANE for name in errors.WITH_PLANE)]


def _reach(name: str) -> float:
    """Half the width of a filter's kernel in texels; 0 if it compares no taps one by one."""
    filtered = errors.FILTERS.get(name.removesuffix(errors.PLANE))
    return 0.0 if filtered is None else filtered.reach


def _grid_of(name: str) -> np.ndarray:
    """The biases that are tried with a filter or an engine, (n, 3)."""
    return shipped.grid_of(name) if name in shipped.ENGINES else errors.grid_of(name)


@functools.cache
def _axes(name: str) -> list[tuple[float, ...]]:
    grid = _grid_of(name)
    return [tuple(float(x) for x in np.unique(grid[:, i])) for i in range(3)]


def _shape(name: str) -> tuple[int, ...]:
    return tuple(len(axis) for axis in _axes(name))


def _cell(axis: Sequence[float], value: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The cell of an axis that values lie in, how far along, and the last point of the axis. Values beyond are moved to
    its ends."""
    last = len(axis) - 1
    if last == 0:
        return np.zeros(np.shape(value), int), np.zeros(np.shape(value)), 0
    points = np.asarray(axis)
    value = np.clip(value, points[0], points[-1])
    low = np.clip(np.searchsorted(points, value, side="right") - 1, 0, last - 1)
    return low, (value - points[low]) / (points[low + 1] - points[low]), last


# --- What a rule is worth ---


def worth(found: np.ndarray, best: np.ndarray, chosen: np.ndarray) -> dict[str, Any]:
    """What errors (scenes, 3) are worth over the `chosen` scenes: prices against the `best` error of each scene, and
    shares of scenes, each with its interval."""
    counted = chosen & np.isfinite(found[:, 0])
    price, acne, leaks = errors.ratio(found[counted, 0], best[counted]), *(found[counted, 1:] > errors.ACNE).T
    return {
        "price": float(price.mean()),
        "worst_decile": float(np.quantile(price, 0.9)),
        "acne": float(np.mean(acne)),
        "leaks": float(np.mean(leaks)),
        "scenes": int(counted.sum()),
        "intervals": {"price": _interval_of_mean(price), "acne": _interval_of_share(acne)}
        | {"leaks": _interval_of_share(leaks)},
    }


def _interval_of_mean(values: np.ndarray) -> list[float]:
    """The interval of a mean, from means of values that are drawn again with replacement."""
    if np.ptp(values) == 0:
        return [float(values[0])] * 2
    of = stats.bootstrap((values,), np.mean, confidence_level=CONFIDENCE, method="percentile", rng=0)
    return [float(end) for end in of.confidence_interval]


def _interval_of_share(has: np.ndarray) -> list[float]:
    """Wilson's interval of a share."""
    of = stats.binomtest(int(has.sum()), has.size).proportion_ci(CONFIDENCE, method="wilson")
    return [float(of.low), float(of.high)]


def _cost(found: np.ndarray, best: np.ndarray, chosen: np.ndarray) -> float:
    """What a search makes least: the mean price, while at most `SHARE` of the scenes have acne."""
    price = np.nanmean(errors.ratio(found[chosen, 0], best[chosen]))
    acne = np.mean(found[chosen, 1] > errors.ACNE)
    return float(price + _PENALTY * max(0.0, acne - SHARE))


def _refined(cost: Callable[[np.ndarray], float], starts: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The least of `cost` from the best of some starts, within bounds."""
    ranked = starts[np.argsort([cost(start) for start in starts], kind="stable")[:3]]
    ends = [minimize(cost, start, method="Nelder-Mead", options={"maxiter": 400}).x for start in ranked]
    best = np.array(min([*ends, *ranked], key=cost))
    # Nobody types a third figure.
    rounded = np.clip(np.round(best, 1), low, high)
    return rounded if cost(rounded) <= cost(best) + 0.01 else np.clip(np.round(best, 2), low, high)


def rule_of(measured: Measured, name: str, family: tuple[bool, ...], part: float = NO_CAP) -> np.ndarray:
    """The bias of a family that is best over the scenes that are searched, where its constant is at most a part of a
    typical caster's width."""
    best, free = measured.best(name), np.flatnonzero(family)

    def cost(numbers: np.ndarray) -> float:
        bias = measured.capped(name, _placed(np.maximum(numbers, 0), free), part)
        return _cost(measured.at(name, bias), best, ~measured.apart) + 10 * _below(numbers)

    grid = np.unique(_grid_of(name)[:, free], axis=0).astype(float)
    return _placed(_refined(cost, grid, grid.min(axis=0), grid.max(axis=0)), free)


def _placed(numbers: np.ndarray, free: np.ndarray) -> np.ndarray:
    bias = np.zeros(3)
    bias[free] = numbers
    return bias


def _below(numbers: np.ndarray) -> float:
    return float(np.sum(np.maximum(-numbers, 0)))


# --- Formulas over the filters' reach ---


class Formula(NamedTuple):
    """A bias by half the width of a kernel in texels, and by what describes a scene.

    - `bounds`: of its numbers; `bias`: constant, slope and normal offset by the numbers, the reach and the descriptions
      by name: one for all scenes, or one for each.
    """

    bounds: Sequence[tuple[float, float]]
    bias: Callable[[np.ndarray, float, Mapping[str, np.ndarray]], np.ndarray]


def _raised(bias: Sequence[float], by: np.ndarray) -> np.ndarray:
    """A bias with a constant that differs from scene to scene."""
    return np.stack([np.maximum(bias[0] + by, 0), *(np.full(len(by), each) for each in bias[1:])], axis=1)


_CONSTANT, _SLOPE, _OFFSET = (0.0, 12.0), (0.0, 4.0), (0.0, 3.0)
_GROWTH = (0.0, 1.5)
_TWO, _THREE = [_CONSTANT, _GROWTH], [_CONSTANT, _GROWTH, _OFFSET]
FORMULAS: dict[str, Formula] = {
    "c, s, n": Formula([_CONSTANT, _SLOPE, _OFFSET], lambda p, r, of: np.array([p[0], p[1], p[2]])),
    "c r, s, n": Formula([_GROWTH, _SLOPE, _OFFSET], lambda p, r, of: np.array([p[0] * r, p[1], p[2]])),
    "c, s r": Formula(_TWO, lambda p, r, of: np.array([p[0], p[1] * r, 0.0])),
    "c, s r, n": Formula(_THREE, lambda p, r, of: np.array([p[0], p[1] * r, p[2]])),
    "c, s + t r": Formula([_CONSTANT, _SLOPE, _GROWTH], lambda p, r, of: np.array([p[0], p[1] + p[2] * r, 0.0])),
    "c + d r, s + t r": Formula(
        [_CONSTANT, _GROWTH, _SLOPE, _GROWTH], lambda p, r, of: np.array([p[0] + p[1] * r, p[2] + p[3] * r, 0.0])
    ),
    "c, s r; c other under lamps": Formula(
        [*_TWO, (-8.0, 8.0)], lambda p, r, of: _raised([p[0], p[1] * r, 0.0], p[2] * of["perspective"])
    ),
    "c, s r; c by texels on the screen": Formula(
        [*_TWO, (-2.0, 2.0)],
        lambda p, r, of: _raised([p[0], p[1] * r, 0.0], p[2] * np.log2(of["pixels_per_texel"])),
    ),
    "c, s r; c by the slope of receivers": Formula(
        [*_TWO, (-4.0, 4.0)], lambda p, r, of: _raised([p[0], p[1] * r, 0.0], p[2] * of["steepness"])
    ),
}
"""Formulas by how constant, slope and normal offset follow from the reach r, and from the scene. The first one ignores
both."""


PLANE_FORMULA = Formula([(0.0, 5.0)], lambda p, r, of: np.array([p[0] * (1 + r), 0.0, 0.0]))
"""The formula beside a bias from the receiver's plane."""
_REACHES = {name: each.reach for name, each in errors.FILTERS.items()}
PLANE_REACHES = {name + errors.PLANE: _REACHES[name] for name in errors.WITH_PLANE}
"""The reach of the filters with a bias from the receiver's plane."""


def formula_of(measured: Measured, formula: Formula, reaches: Mapping[str, float] = _REACHES) -> np.ndarray:
    """The numbers of a formula that are best over all filters of `reaches` and the scenes that are searched."""
    bests = {name: measured.best(name) for name in reaches}

    def cost(numbers: np.ndarray) -> float:
        costs = [
            _cost(measured.at(name, formula.bias(numbers, reach, measured.named)), bests[name], ~measured.apart)
            for name, reach in reaches.items()
        ]
        return float(np.mean(costs)) + 10 * _below(numbers[:2])

    found = differential_evolution(cost, formula.bounds, rng=0, popsize=8, maxiter=25, tol=1e-4, polish=False).x
    return _refined(cost, found[None], *np.array(formula.bounds).T)


def worths(
    measured: Measured,
    formula: Formula,
    numbers: np.ndarray,
    chosen: np.ndarray,
    reaches: Mapping[str, float] = _REACHES,
) -> dict[str, dict[str, Any]]:
    """What a formula is worth for each filter over the `chosen` scenes."""
    return {
        name: worth(measured.at(name, formula.bias(numbers, reach, measured.named)), measured.best(name), chosen)
        for name, reach in reaches.items()
    }


# --- Engines ---


def own_of(measured: Measured, name: str) -> tuple[np.ndarray, dict[str, float]]:
    """The best pair of an engine's two settings for all scenes, in its own units, with its price and its shares of
    scenes."""
    best, one = measured.best(name), measured.in_texels(name, np.ones(2))
    most = _grid_of(name).max(axis=0)

    def cost(own: np.ndarray) -> float:
        bias = measured.in_texels(name, own)
        # Nothing is known beyond the biases that were tried.
        return _cost(measured.at(name, bias), best, ~measured.apart) + float(np.nanmean(bias[~measured.apart] > most))

    # What is some texels in some of the scenes.
    spread = lambda column: np.nanquantile(1 / np.where(one[:, column], one[:, column], np.nan), np.linspace(0, 1, 9))
    constants = np.outer((0.5, 1, 2, 4, 7), spread(0)).ravel()
    offsets = np.append(0, np.outer((0.5, 1, 2), spread(2)).ravel())
    starts = np.array([(c, n) for c in np.unique(constants) for n in np.unique(offsets[np.isfinite(offsets)])])
    own = starts[np.argmin([cost(start) for start in starts])]
    return own, worth(measured.at(name, measured.in_texels(name, own)), best, measured.apart)


def _ratio(value: float, units: np.ndarray) -> np.ndarray:
    return np.where(units != 0, value / np.where(units != 0, units, 1), 0.0)


# --- All together ---


def search(measured: Measured) -> dict[str, Any]:
    """All rules for filters and what they are worth, as JSON can store them."""
    apart, names = measured.apart, filter_names()
    filters: dict[str, Any] = {}
    for name in names:
        families = families_of(name)
        best = measured.best(name)
        chosen = measured.errors[name].reshape(len(apart), -1, 3)
        fitted = chosen[np.arange(len(apart)), chosen[..., 0].argmin(axis=1)]
        plain = measured.best(name.removesuffix(errors.PLANE))
        filters[name] = {
            # The error of the best bias for each scene, over that of the best one without a receiver plane.
            "against_plain": float(np.mean(errors.ratio(best, plain)[apart])),
            "fitted": worth(fitted, best, apart),
            "none": worth(measured.at(name, np.zeros(3)), best, apart),
            "rules": {
                family: _rule(measured, name, rule_of(measured, name, free)) for family, free in families.items()
            },
        }
    formulas = {label: _formula(measured, formula) for label, formula in FORMULAS.items()}
    with_plane = _formula(measured, PLANE_FORMULA, PLANE_REACHES)
    rules = {name: left_out(measured, name) for name in names}
    found = {"filters": filters, "formulas": formulas, "plane": with_plane, "rules": rules}
    return found | {"casters": _of_casters(measured, rules)}


def search_engines(measured: Measured) -> dict[str, Any]:
    """What engines ship, and rules for them, as JSON can store them."""
    found = {}
    for name in measured.shipped:
        best, has_offset = measured.best(name), len(_axes(name)[2]) > 1
        own, own_worth = own_of(measured, name)
        found[name] = {
            "shipped": worth(measured.shipped[name], best, measured.apart),
            "own": own.tolist(),
            "own_worth": own_worth,
            "is_own": shipped.follows_view(name),
            **_rule(measured, name, rule_of(measured, name, (True, False, has_offset))),
        }
    return found


def families_of(name: str) -> Mapping[str, tuple[bool, ...]]:
    """Which numbers the rules of a filter set."""
    if name.endswith(errors.PLANE):
        return {"constant": FAMILIES["constant"]}
    return {key: free for key, free in FAMILIES.items() if not (name in errors.LITTLE and free[2])}


def _of_casters(measured: Measured, rules: Mapping[str, Any]) -> dict[str, Any]:
    """The cap of constants, the share of casters that are thin, and for each cap the mean price and the share of scenes
    with acne over the filters that compare taps one by one: in all scenes, and in those whose typical caster is
    thin."""
    few = measured.named["across"] < errors.FEW
    table = {}
    for part in PARTS:
        capped = {name: measured.capped(name, np.array(rules[name]["bias"]), part) for name in errors.FILTERS}
        found = {name: measured.at(name, bias) for name, bias in capped.items()}
        price = np.mean([errors.ratio(of[:, 0], measured.best(name)) for name, of in found.items()], axis=0)
        acne = np.mean([of[:, 1] > errors.ACNE for of in found.values()])
        of_few = float(price[few].mean()) if few.any() else 1.0
        table["none" if np.isinf(part) else f"{part:g}"] = [float(price.mean()), of_few, float(acne)]
    return {"part": PART, "thin": float(measured.named["thin"].mean()), "few": int(few.sum()), "caps": table}


def left_out(measured: Measured, name: str) -> dict[str, Any]:
    """A filter's rule: the bias that is best over all scenes.

    `searched` is its price there. `tested` is the price of rules in kinds of scenes that they were not searched for
    in, with the mean price by kind and by the side of the map, and the price of each scene."""
    *_, free = families_of(name).values()
    best, everything = measured.best(name), np.ones(len(measured.kinds), bool)
    found = np.zeros((len(best), 3))
    for kind in np.unique(measured.kinds):
        of_kind = measured.kinds == kind
        bias = rule_of(dataclasses.replace(measured, apart=of_kind), name, free, PART)
        found[of_kind] = measured.at(name, measured.capped(name, bias))[of_kind]
    bias = rule_of(dataclasses.replace(measured, apart=~everything), name, free, PART)
    price, sides = errors.ratio(found[:, 0], best), measured.named["texels"]
    mean = lambda chosen: float(price[chosen].mean())
    return {
        "bias": bias.tolist(),
        "searched": worth(measured.at(name, measured.capped(name, bias)), best, everything),
        "tested": worth(found, best, everything),
        "kinds": {str(kind): mean(measured.kinds == kind) for kind in np.unique(measured.kinds)},
        "maps": {f"{side:g}": mean(sides == side) for side in np.unique(sides)},
        "prices": [round(float(each), 4) for each in price],
    }


def _formula(measured: Measured, formula: Formula, reaches: Mapping[str, float] = _REACHES) -> dict[str, Any]:
    numbers = formula_of(measured, formula, reaches)
    by_filter = worths(measured, formula, numbers, measured.apart, reaches)
    means = {key: float(np.mean([each[key] for each in by_filter.values()])) for key in ("price", "acne", "leaks")}
    return {"numbers": numbers.tolist(), **means, "filters": by_filter}


def _rule(measured: Measured, name: str, bias: np.ndarray) -> dict[str, Any]:
    found, best = measured.at(name, bias), measured.best(name)
    return {
        "bias": bias.tolist(),
        "searched": worth(found, best, ~measured.apart),
        "tested": worth(found, best, measured.apart),
    }


def show(console: Console, result: Mapping[str, Any]) -> None:
    """Prints each rule with its price and its shares of the test scenes that have acne or leaks."""
    table = Table("filter", "rule", "constant", "slope", "offset", "price", "worst tenth", "acne", "leaks")
    for name, found in result["filters"].items():
        rows = {"none": {"bias": (0, 0, 0), "tested": found["none"]}, **found["rules"]}
        rows["fitted"] = {"bias": ("", "", ""), "tested": found["fitted"]}
        for family, rule in rows.items():
            table.add_row(name, family, *map(str, rule["bias"]), *_worth_cells(rule["tested"]))
    console.print(table)
    table = Table("filter", "constant", "slope", "offset", "own price", "left out", "acne", "by map")
    for name, rule in result["rules"].items():
        maps = ", ".join(f"{side}: {price:.2f}" for side, price in rule["maps"].items())
        prices = (f"{rule[key]['price']:.3f}" for key in ("searched", "tested"))
        table.add_row(name, *map(str, rule["bias"]), *prices, f"{rule['tested']['acne']:.0%}", maps)
    console.print(table)
    table = Table("constant is at most", "price", "thin casters", "acne")
    for part, (price, few, acne) in result["casters"]["caps"].items():
        table.add_row(f"{part} of a caster's width", f"{price:.3f}", f"{few:.3f}", f"{acne:.1%}")
    console.print(table)
    table = Table("formula", "numbers", "price", "acne", "leaks")
    for label, found in {**result["formulas"], "c (1 + r), with a receiver plane": result["plane"]}.items():
        numbers = ", ".join(f"{x:.2f}" for x in found["numbers"])
        table.add_row(label, numbers, f"{found['price']:.2f}", f"{found['acne']:.0%}", f"{found['leaks']:.0%}")
    console.print(table)


def show_engines(console: Console, found: Mapping[str, Any]) -> None:
    """Prints what engines ship, and the rules for them."""
    table = Table("engine", "rule", "settings", "price", "worst tenth", "acne", "leaks")
    for name, of in found.items():
        values = shipped.ENGINES[name].shipped
        table.add_row(name, "shipped", ", ".join(f"{x:g}" for x in values), *_worth_cells(of["shipped"]))
        table.add_row(name, "best", ", ".join(f"{x:.3g}" for x in of["own"]), *_worth_cells(of["own_worth"]))
        in_texels = ", ".join(f"{x:g}" for x in (of["bias"][0], of["bias"][2]))
        table.add_row(name, "rule", in_texels, *_worth_cells(of["tested"]))
    console.print(table)


def _worth_cells(found: Mapping[str, float]) -> list[str]:
    return [f"{found['price']:.2f}", f"{found['worst_decile']:.2f}", f"{found['acne']:.0%}", f"{found['leaks']:.0%}"]
