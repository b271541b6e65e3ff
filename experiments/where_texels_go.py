"""How does a shadow's error fall with the memory of its map, and how much better do cascades and warps use it?

    python experiments/where_texels_go.py configs/corridor.yaml configs/terrain.yaml configs/street.yaml \
        configs/hills.yaml
    python experiments/where_texels_go.py configs/corridor.yaml --sizes 256,1024 --only plain,cascades4 --frames 8

Draws each configuration's scene with one map, with 2, 3 and 4 cascades, with 4 cascades of several sizes, with maps
that are warped towards the camera (light space perspective shadow maps and perspective shadow maps), and with pages of
a virtual map, all with the same number of texels. Cascades cover the depths that the camera sees, not the empty space
before them. Light space perspective shadow maps are drawn for these depths, and for those from the camera's near to its
far. Every technique has its best settings: the spacing of its cascades and their shares are found by a bounded search,
since the error has no derivative with respect to them, and the bias is fitted by gradient.

The figure has texels along x and the root mean square error of visibility along y, both logarithmic. The grey area is
below the reference's own noise. The table also has the extent in pixels that 1 % of the texels exceed on the screen.
With `--frames`, it has the flicker too: the root mean square change of the error from frame to frame
(`metrics.flicker`), as the camera moves sideways.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import numpy as np
from cyclopts import App
from matplotlib.figure import Figure
from rich.table import Table

from diffshadow import metrics
from diffshadow.config import load_config
from diffshadow.console import Console
from diffshadow.fit import TechniqueProblem

NAME = "where_texels_go"
SPACING, SHARES = "technique.logarithmic", "technique.shares."
SIDEWAYS = 0.005
"""How far the camera moves from frame to frame, in parts of the distance to its target."""
CASCADES = "{type: cascades, depths: surface, stabilize: false"
FITTED = "bias.constant: {lower: 0, upper: 8}, bias.slope: {lower: 0, upper: 8}"


class Technique(NamedTuple):
    """A technique: its title, the section `technique`, the number of its maps, and whether their shares are fitted."""

    title: str
    section: str
    maps: int = 1
    shares: bool = False

    @property
    def parameters(self) -> str:
        """What is fitted: the bias, the spacing of several maps, and the shares of all but the last."""
        spacing = [f"{SPACING}: {{lower: 0, upper: 1}}"] if self.maps > 1 else []
        shares = [f"{SHARES}{i}: {{lower: 0.25, upper: 4}}" for i in range(self.maps - 1)] if self.shares else []
        return f"fit.parameters={{{', '.join([FITTED, *spacing, *shares])}}}"


TECHNIQUES = {
    "plain": Technique("one map", "{type: shadow_map}"),
    "lispsm": Technique("LiSPSM", "{type: perspective_warp}"),
    "lispsm_seen": Technique("LiSPSM, seen depths", "{type: perspective_warp, depths: surface}"),
    "perspective": Technique("perspective", "{type: perspective_warp, method: perspective}"),
    "pages": Technique("pages", "{type: resolution_matched, finest: 65536, level_bias: -8}"),
    **{
        f"cascades{count}": Technique(f"{count} cascades", f"{CASCADES}, count: {count}}}", count)
        for count in (2, 3, 4)
    },
    "shares4": Technique("4 with shares", f"{CASCADES}, count: 4, shares: [1, 1, 1, 1]}}", 4, True),
}

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    *configs: Path,
    sizes: str = "256,512,1024,2048",
    only: str = ",".join(TECHNIQUES),
    frames: int = 0,
    output: Path | None = None,
) -> dict[str, Any]:
    """Compares the techniques on the scenes of CONFIGS.

    Parameters
    ----------
    configs
        YAML files, each with a scene, a directional light, a bias and a filter.
    sizes
        Widths of a single square map, in texels, separated by commas. Several maps share its number of texels.
    only
        Which techniques, separated by commas.
    frames
        Number of frames of a moving camera over which flicker is measured; 0 for none.
    output
        Folder of the results' folder, instead of that of the first configuration.
    """
    console = Console()
    common.expect("configs", "no file", len(configs) > 0, "one or more configurations")
    widths = sorted(set(common.listed("sizes", sizes, int)))
    common.expect("sizes", sizes, widths[0] >= 64, "64 texels or more")
    names = common.chosen("only", only, TECHNIQUES)
    common.expect("frames", frames, frames == 0 or 2 <= frames <= 256, "0, or 2 to 256 frames")
    to = () if output is None else (f"output={output}",)
    cases = {path: common.draw(common.load(path, to)) for path in configs}
    floors = {path.stem: case.floor for path, case in cases.items()}
    summary = {"configs": [str(path) for path in configs], "reference_noise": floors}
    moved = {path: moves(path, case, frames) for path, case in cases.items()}
    rows, folder = [], None
    todo = [(path, size, name) for path in configs for size in widths for name in names]
    for path, size, name in common.progress(todo, "fitting", console):
        found = best(cases[path], moved[path], path, name, size)
        row = {"scene": path.stem, "technique": name, "texels": size**2, **found}
        rows.append(row)
        if name == names[-1]:
            # Results are written after each size. An interrupted run keeps all sizes that are done.
            folder = common.write(cases[configs[0]].settings, NAME, picture(rows, floors), rows, summary)
    show(console, rows)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def moves(path: Path, case: common.Case, frames: int) -> list[common.Case]:
    """The scene of a configuration, seen by a camera that moves sideways."""
    camera, origin = case.scene.camera, np.asarray(case.scene.origin)
    eye, target = (np.asarray(point, float) + origin for point in (camera.eye, camera.target))
    right = np.cross(target - eye, case.settings.scene.camera.up)
    step = SIDEWAYS * np.linalg.norm(target - eye) * right / np.linalg.norm(right)
    at = lambda point, i: [round(float(each), 6) for each in point + i * step]
    places = [[f"scene.camera.{k}={at(p, i)}" for k, p in (("eye", eye), ("target", target))] for i in range(frames)]
    return [common.draw(load_config(path, ["scene.camera.orbit=null", *place])) for place in places]


def flicker(frames: list[common.Case], technique: Any) -> float | None:
    """The change of a technique's error from frame to frame; none without frames."""
    if not frames:
        return None
    drawn = [TechniqueProblem.of(each.scene, technique, each.truth, surface=each.surface) for each in frames]
    images = np.stack([common.visibility(each) for each in drawn])
    truths = np.stack([each.truth.visibility for each in frames])
    return metrics.flicker(images, truths, np.stack([np.asarray(each.mask) for each in drawn]))


def best(case: common.Case, frames: list[common.Case], path: Path, name: str, size: int) -> dict[str, Any]:
    """The error of a technique with its best settings, those settings, and how large its texels are on the screen."""
    technique = TECHNIQUES[name]
    side = int(size / math.sqrt(technique.maps))
    overrides = [f"technique={technique.section}", f"shadow_map.resolution=[{side}, {side}]", technique.parameters]
    settings = load_config(path, overrides)
    found = common.run_fit(settings, common.problem_of(case, settings))
    made: Any = found.problems[0]
    extents = found.technique.aliasing(made.shadow_map, case.surface, case.scene.camera)
    return {
        "rmse": common.rmse(made, found.technique),
        "spacing": found.fitted.get(SPACING),
        "shares": parts(getattr(made.technique.layout, "shares", None)),
        **{key.replace(".", "_"): value for key, value in found.fitted.items() if key.startswith("bias.")},
        "percentile_99": metrics.measure_aliasing(extents.extent, extents.mask).percentile_99,
        "flicker": flicker(frames, found.technique),
    }


def parts(shares: tuple[Any, ...] | None) -> str | None:
    """Which part of all texels each cascade has, from the nearest to the farthest; none without shares."""
    if shares is None:
        return None
    total = sum(map(float, shares))
    return " ".join(f"{float(share) / total:.2f}" for share in shares)


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """Prints the errors, the settings, and the extent in pixels that 1 % of the texels exceed."""
    table = Table()
    for title in ("scene", "texels", "technique"):
        table.add_column(title, no_wrap=True)
    for title in ("RMSE", "spacing", "bias", "slope", "99 %", "flicker", "shares"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in rows:
        digits = {"rmse": 4, "spacing": 2, "bias_constant": 2, "bias_slope": 2, "percentile_99": 1, "flicker": 4}
        cells = ("" if row[key] is None else f"{row[key]:.{n}f}" for key, n in digits.items())
        title = TECHNIQUES[row["technique"]].title
        table.add_row(row["scene"], f"{math.isqrt(row['texels'])}²", title, *cells, row["shares"] or "")
    console.print(table)


def picture(rows: list[dict[str, Any]], floors: dict[str, float]) -> Figure:
    """A chart for each scene that has rows, of error against texels."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    figure, axes = common.figure(3.4 * len(scenes) + 1.6, 3.4, 1, len(scenes), sharey=True)
    names = list(dict.fromkeys(row["technique"] for row in rows))
    for one, scene in zip(axes, scenes, strict=True):
        common.chart(one, scene, "texels", "RMSE [visibility]" if one is axes[0] else "")
        for i, name in enumerate(names):
            line = [(row["texels"], row["rmse"]) for row in rows if (row["scene"], row["technique"]) == (scene, name)]
            one.plot(*np.array(line).T, label=TECHNIQUES[name].title, **common.curve(i))
        one.set_xscale("log")
        one.set_yscale("log")
        if floors[scene] > 0:
            one.axhspan(one.get_ylim()[0], floors[scene], color=common.FAINT, alpha=0.25, linewidth=0)
    common.legend(axes[-1], loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


if __name__ == "__main__":
    common.start(app)
