"""What docs/rules_of_thumb.md and the package take from the measured rules: tables, and the numbers to type."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import _rule_engines as engines
import _rule_errors as errors
import _rule_shipped as shipped

from diffshadow.settings.engines import ENGINES

FORMULA = "c + d r, s + t r"
"""The formula that the package uses for all filters that have no rule."""
_STARTS = "random_disk, radius 2"
# The families of the page's comparison, as it names them.
_FAMILIES = {
    "constant": "constant",
    "constant + slope": "constant, slope",
    "constant + normal offset": "constant, offset",
    "all three": "all three",
}
_PARTS = {"none": "anything", "1": "a caster's width", "0.5": "1/2 of it", "0.25": "1/4 of it"}
# How the page writes what an engine ships.
_SETTINGS = {
    "three.js": "`bias` {:g}, `normalBias` {:g}",
    "babylon.js": "`bias` {:g} (PCF)",
    "godot": "`shadow_bias` {:g}, `shadow_normal_bias` {:g}",
    "playcanvas": "`shadowBias` {:g}, `normalOffsetBias` {:g}",
    "bevy": "`shadow_depth_bias` {:g}, `shadow_normal_bias` {:g}",
    "godot_compatibility": "`shadow_bias` {:g}, `shadow_normal_bias` {:g}",
    "filament": "`constantBias` {:g}, `normalBias` {:g}",
    "unity": "depth {:g}, normal {:g}",
}


def packaged(result: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """The rules as `diffshadow.settings.rules` reads them. Rules that were not measured are kept from `before`."""
    found = {**before, **(_of_filters(result) if "rules" in result else {})}
    if "engines" in result:
        found["engines"] = {
            name: {
                "bias": _rule_of(each),
                "own": each["is_own"],
                "worth": _worth(each["own_worth" if each["is_own"] else "tested"]),
                "shipped": _worth(each["shipped"]),
            }
            for name, each in result["engines"].items()
        }
    return found


def _rule_of(found: Mapping[str, Any]) -> list[float]:
    """The two biases of an engine's rule: in texels, or to two figures the settings of an engine whose cameras follow
    the view."""
    if not found["is_own"]:
        return [found["bias"][0], found["bias"][2]]
    return [float(f"{value:.2g}") for value in found["own"]]


def _of_filters(result: Mapping[str, Any]) -> dict[str, Any]:
    formula = result["formulas"][FORMULA]
    return {
        "scenes": result["scenes"],
        "kinds": result["kinds"],
        "casters": {"part": result["casters"]["part"]},
        "reach": max(each.reach for each in errors.FILTERS.values()),
        "formula": {"numbers": formula["numbers"], "worth": _worth(formula)},
        "plane": {"number": result["plane"]["numbers"][0], "worth": _worth(result["plane"])},
        "filters": {name: _packaged_rule(rule) for name, rule in result["rules"].items()},
        "starts": {name: rule["bias"] for name, rule in result["filters"][_STARTS]["rules"].items()},
    }


def _packaged_rule(rule: Mapping[str, Any]) -> dict[str, Any]:
    maps = {side: round(price, 4) for side, price in rule["maps"].items()}
    return {"bias": rule["bias"], "worth": _worth(rule["tested"]), "own": _worth(rule["searched"]), "maps": maps}


def _worth(found: Mapping[str, float]) -> list[float]:
    return [round(found[key], 4) for key in ("price", "acne", "leaks")]


def tables(result: Mapping[str, Any]) -> dict[str, str]:
    """The tables of the page, in Markdown, by name."""
    worth = ("price", "acne", "leaks")
    made = _filter_tables(result) if "rules" in result else {}
    if "engines" in result:
        head = ("engine", "default", *worth, "rule", *worth)
        made["engines"] = _table(head, _engine_rows(result))
    if "layouts" in result:
        layouts = result["layouts"]
        compared = list(next(iter(layouts.values())))
        pair = lambda of: f"{of['wins']:.0%}, {of['ratio']:.2f}"
        made["layouts"] = _table(
            ("texels", "scenes", *compared),
            [(label.replace(", ", "² | "), *(pair(of[name]) for name in compared)) for label, of in layouts.items()],
        )
    if "taps" in result:
        taps = result["taps"]
        made["taps"] = _table(
            ("pattern", *(f"{count} taps" for count in next(iter(taps.values())))),
            [(name, *(f"{error:.3f}, {noise:.4f}" for error, noise in of.values())) for name, of in taps.items()],
        )
    if "in_engines" in result:
        made["in engines"] = _table(
            engines.HEAD,
            [
                (ENGINES[name], state, *engines.cells_of(of[state]))
                for name, of in result["in_engines"].items()
                for state in engines.STATES
            ],
        )
    return made


def _filter_tables(result: Mapping[str, Any]) -> dict[str, str]:
    worth = ("price", "acne", "leaks")
    biases = ("none", *_FAMILIES.values(), "the formula", "best for each scene")
    rules, caps = result["rules"], result["casters"]["caps"]
    maps, kinds = ([*next(iter(rules.values()))[key]] for key in ("maps", "kinds"))
    by_kind = _means(rules, "kinds")
    return {
        "filters": _table(("filter", "constant", "slope", "normal offset", *worth, "own price"), _filter_rows(result)),
        "maps": _table(
            ("filter", *(f"{side}²" for side in maps)),
            [(name, *(f"{rule['maps'][side]:.2f}" for side in maps)) for name, rule in rules.items()],
        ),
        "kinds": _table(kinds, [[f"{by_kind[kind]:.2f}" for kind in kinds]]),
        "caps": _table(
            ("constant at most", "price", "where casters are thin", "acne"),
            [(_PARTS[part], f"{price:.3f}", f"{few:.3f}", f"{acne:.1%}") for part, (price, few, acne) in caps.items()],
        ),
        "biases": _table(("filter", *biases), _bias_rows(result)),
        "formulas": _table(
            ("formula", "numbers", *worth),
            [(label, _numbers(found["numbers"]), *_cells(found)) for label, found in result["formulas"].items()],
        ),
    }


def _means(rules: Mapping[str, Any], key: str) -> dict[str, float]:
    """The mean price over the filters that compare taps one by one, by `key`."""
    found = [rules[name][key] for name in errors.FILTERS]
    return {name: sum(each[name] for each in found) / len(found) for name in found[0]}


def _filter_rows(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    for name, rule in result["rules"].items():
        low, high = rule["tested"]["intervals"]["price"]
        price, *shares = _cells(rule["tested"])
        numbers = (f"{x:.3g}" for x in rule["bias"])
        yield name, *numbers, f"{price} ± {(high - low) / 2:.2f}", *shares, f"{rule['searched']['price']:.2f}"


def _bias_rows(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    short = lambda found: ", ".join(_cells(found)[:2])
    for name, formula in result["formulas"][FORMULA]["filters"].items():
        found = result["filters"][name]
        none = f"{found['none']['price']:.1f}, {found['none']['acne']:.0%}"
        by_family = (short(found["rules"][family]["tested"]) for family in _FAMILIES)
        yield name, none, *by_family, short(formula), f"{found['fitted']['acne']:.0%}"


def _engine_rows(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    for name, found in result["engines"].items():
        pattern, rule = _SETTINGS[name], _rule_of(found)
        in_texels = "{:.3g} {}, offset {:.3g}".format(rule[0], "texel" if rule[0] == 1 else "texels", rule[1])
        tested = found["own_worth" if found["is_own"] else "tested"]
        stated = pattern.format(*rule) if found["is_own"] else in_texels
        default = pattern.format(*shipped.ENGINES[name].shipped)
        yield ENGINES[name], default, *_cells(found["shipped"]), stated, *_cells(tested)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{x:.3g}" for x in values)


def _cells(found: Mapping[str, Any]) -> list[str]:
    return [f"{found['price']:.2f}", f"{found['acne']:.0%}", f"{found['leaks']:.0%}"]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    line = lambda cells: f"| {' | '.join(cells)} |"
    return "\n".join([line(head), "|" + "---|" * len(head), *map(line, rows)])


def with_tables(page: str, made: Mapping[str, str]) -> str:
    """A page with each table behind its mark, `<!-- table: NAME -->`, as it is `made`.

    **Raises** `ValueError` for a table without a mark.
    """
    for name, table in made.items():
        mark = f"<!-- table: {name} -->\n"
        if page.count(mark) != 1:
            raise ValueError(f"the page has {page.count(mark)} marks {mark.strip()}; expected one: add it")
        page = re.sub(re.escape(mark) + r"\n(\|.*\n)*", lambda _, text=f"{mark}\n{table}\n": text, page)
    return page


def as_text(rules: Mapping[str, Any]) -> str:
    """Packaged rules as a file has them."""
    return json.dumps(rules, indent=1, ensure_ascii=False) + "\n"
