"""Which biases hold over many scenes, for each filter and engine, and what do they cost against fits?

    python experiments/rules_of_thumb.py --scenes 16       # 15 minutes on two cores
    python experiments/rules_of_thumb.py --scenes 104      # an hour

Measures a collection of scenes, which is drawn from a seed, with all combinations of constant bias, slope bias and
normal offset, for each filter and engine. Rules are then searched for in one half of the scenes, and tested on the
other. A price is the error of a rule over that of the best bias for each scene. In half of the scenes, it also measures
layouts of maps with the same number of texels, and in an eighth patterns of taps.

The folder keeps what was measured of each scene. A run that was stopped goes on from there, and ends with the same
bytes.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import _collection as collection
import _common as common
import _rule_engines as engines
import _rule_errors as errors
import _rule_figures as figures
import _rule_layouts as layouts
import _rule_page as page
import _rules as rules
import numpy as np
from cyclopts import App
from engines.engines import missing

from diffshadow import io
from diffshadow.config import Config, ConfigError, Location, Mistake, parse_config
from diffshadow.console import Console

NAME = "rules_of_thumb"
_MOST, _DPI = 10_000, 110
ROOT = Path(__file__).parent.parent
PAGE, PACKAGED = ROOT / "docs" / "rules_of_thumb.md", ROOT / "diffshadow" / "settings" / "rules.json"
"""What `--publish` writes, with the figures."""
# The rule with which taps are measured.
_DISK, _FAMILY = "random_disk, radius 4", "all three"

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    *,
    scenes: int = 16,
    seed: int = 0,
    pixels: int = 160,
    in_engines: int = 0,
    publish: bool = False,
    output: Path = Path("runs"),
) -> dict[str, Any]:
    """Measures a collection of scenes and finds rules.

    Parameters
    ----------
    scenes
        How many scenes, half of them to test rules on.
    seed
        Of the collection.
    pixels
        The side of an image, in pixels.
    in_engines
        How many of the scenes that rules are tested on three.js and Babylon.js draw themselves.
    publish
        Also write the tables and figures of docs/rules_of_thumb.md, and the rules that the package ships.
    output
        Where the folder rules_of_thumb is made.
    """
    kinds = len(collection.KINDS)
    common.expect("scenes", scenes, 2 * kinds <= scenes <= _MOST, f"{2 * kinds} to {_MOST}, two or more of each kind")
    common.expect("pixels", pixels, 16 <= pixels <= 1024, "16 to 1024")
    common.expect("seed", seed, seed >= 0, "0 or more")
    common.expect("in_engines", in_engines, 0 <= in_engines <= scenes // 2, f"0 to {scenes // 2}, the test scenes")
    lack = missing() if in_engines else None
    if lack is not None:
        raise ConfigError([Mistake(Location("--in-engines"), "", lack)])
    console, folder = Console(), output / NAME
    io.check_writable(folder)

    def each(part: str, count: int, measure: Callable[[Config], dict[str, np.ndarray]], key: str = "") -> Iterator[Any]:
        for index in common.progress(range(count), part, console):
            text = json.dumps(collection.scene(seed, index, pixels))
            yield stored(folder / part / f"{index:05}.npz", text, key, measure)

    every = [collection.kind_of(i) for i in range(scenes)]
    apart = [i // kinds % 2 == 1 for i in range(scenes)]
    sizes = [collection.size_of(seed, i) for i in range(scenes)]
    measured = rules.Measured.of(list(each("biases", scenes, errors.measure)), sizes, apart)
    result = rules.search(measured)
    bias = np.array(result["filters"][_DISK]["rules"][_FAMILY]["bias"])
    by_layout = list(each("layouts", scenes // 2, layouts.layout_errors))
    by_taps = list(each("taps", scenes // 8, lambda settings: layouts.tap_errors(settings, bias), str(bias)))
    result |= {"layouts": layouts.compared(by_layout, every), "taps": layouts.taps_compared(by_taps)}
    if in_engines:
        tested = [i for i in range(scenes) if apart[i]][:in_engines]
        drawn = [parse_config(json.dumps(collection.scene(seed, i, pixels))) for i in tested]
        result["in_engines"] = engines.checked(drawn, result["engines"], console)
    rules.show(console, result)
    layouts.show(console, result)
    if in_engines:
        engines.show(console, result["in_engines"])
    _write(folder, {"scenes": scenes, "seed": seed, "pixels": pixels, **result}, measured.described, publish=publish)
    console.print(str(folder), soft_wrap=True)
    return {**result, "folder": str(folder)}


def _write(folder: Path, about: Mapping[str, Any], described: np.ndarray, *, publish: bool) -> None:
    """Writes the results and their figures into the folder, and what the page and the package take from them."""
    made = {
        f"{NAME}.png": figures.of_rules(about),
        "collection.png": figures.of_collection(about["seed"], about["pixels"], described),
    }
    for name, figure in made.items():
        for to in (folder, PAGE.parent / "images") if publish else (folder,):
            with io.atomic_path(to / name) as path:
                figure.savefig(path, format="png", dpi=_DPI, metadata={"Software": "diffshadow"})
    texts = {folder / f"{NAME}.json": json.dumps(about, indent=1, allow_nan=False) + "\n"}
    if publish:
        texts[PAGE] = page.with_tables(PAGE.read_text(encoding="utf-8"), page.tables(about))
        texts[PACKAGED] = page.as_text(page.packaged(about))
    for to, text in texts.items():
        with io.atomic_path(to) as path:
            path.write_text(text, encoding="utf-8")


def stored(
    path: Path, text: str, key: str, measure: Callable[[Config], Mapping[str, np.ndarray]]
) -> Mapping[str, np.ndarray]:
    """What `measure` finds in the scene of a configuration's text, from its file if that is of the same scene and
    `key`."""
    of = f"{text}\n{key}"
    if path.exists():
        with np.load(path) as file:
            arrays = dict(file)
        if str(arrays.pop("of")) == of:
            return arrays
    found = measure(parse_config(text, source=f"scene {path.stem}"))
    path.parent.mkdir(parents=True, exist_ok=True)
    with io.atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **{"of": np.array(of), **found})  # pyright: ignore[reportArgumentType]
    return found


if __name__ == "__main__":
    common.start(app)
