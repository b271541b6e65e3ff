"""Draws one scene with every technique, and writes a page with the images, their errors and their times:

    python experiments/gallery.py configs/gallery.yaml
    python experiments/gallery.py configs/gallery.yaml --page docs/gallery.md --repeats 20

Each row of the page is the configuration with a few values replaced. To draw it again:

    diffshadow render configs/gallery.yaml KEY=VALUE ...

Errors are of visibility against the traced reference. Times are medians of runs after compilation: one of drawing
from the light, and one of computing visibility.
"""

import platform
import shutil
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import jax
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from matplotlib import colormaps
from rich.progress import track

from diffshadow import geometry, io, metrics, raster
from diffshadow.config import Config, build_scene, build_shading, build_technique, load_config
from diffshadow.console import Console
from diffshadow.reference import Reference

NO_SURFACE = 0.85
"""Grey of pixels that do not count."""
LEVELS = 32
"""Shades of visibility and of its difference in the images: few, so that their files are small."""
PLANE = "scene.meshes.4"
"""The ground, which must not cast with some techniques."""
WIDE = "bias={constant: 0.5, slope: 5}"
"""A bias for kernels of several texels."""


class Row(NamedTuple):
    """A technique: its name, the values to replace, and what to look at."""

    name: str
    overrides: tuple[str, ...]
    note: str


class Stage(NamedTuple):
    """The scene of a configuration as the camera sees it, and its truth."""

    config: Path
    settings: Config
    scene: geometry.Scene
    surface: raster.Surface
    truth: Reference

    @classmethod
    def of(cls, config: Path) -> "Stage":
        settings = load_config(config)
        scene = build_scene(settings)
        truth = common.truth_of(settings, scene)
        return cls(config, settings, scene, raster.draw_surface(scene.mesh, scene.camera), truth)


def disk(pattern: str, samples: int = 16, more: str = "") -> tuple[str, ...]:
    """Overrides for a random disk of 4 texels."""
    return f"filter={{type: random_disk, radius: 4, pattern: {pattern}, samples: {samples}{more}}}", WIDE


SECTIONS: dict[str, tuple[Row, ...]] = {
    "Shadow maps without a filter": (
        Row("No bias", ("bias={constant: 0, slope: 0}",), "every lit surface shadows itself: acne"),
        Row("Too much bias", ("bias={constant: 30, slope: 0}",), "shadows leave their casters: Peter-panning"),
        Row("Nearest", (), "constant and slope bias"),
        Row("Bilinear", ("filter={type: bilinear}",), "four compares, blended"),
        Row("Small map", ("shadow_map.resolution=[256, 256]",), "the same with a sixteenth of the texels"),
        Row(
            "Silhouette map",
            (
                "shadow_map.resolution=[256, 256]",
                "shadow_map.silhouettes=true",
                "bias={constant: 1, plane: {type: receiver_plane, deepening: 0}}",
            ),
            "as small as the map above, with outlines stored within texels",
        ),
        Row("16-bit depths", ("shadow_map.depth_format=unorm16",), "fixed-point depths of 16 bits"),
        Row(
            "Polygon offset",
            ("bias={constant: 0, slope: 0}", "shadow_map.polygon_offset=[2, 4]"),
            "a bias that is stored in the map",
        ),
        Row(
            "Back faces only",
            ("bias={constant: 0, slope: 0}", "shadow_map.cull=front", f"{PLANE}.casts=false"),
            "no acne on closed casters without a bias",
        ),
        Row(
            "Midpoint",
            ("bias={constant: 0, slope: 0}", "shadow_map.depth_layer=midpoint"),
            "stores the middle between the two nearest surfaces",
        ),
    ),
    "Biases, with a box of 5 × 5 texels": (
        Row("Constant", ("filter={type: pcf, radius: 2.5}", "bias={constant: 4, slope: 0}"), ""),
        Row("Slope", ("filter={type: pcf, radius: 2.5}", "bias={constant: 0.5, slope: 2.5}"), ""),
        Row(
            "1 − cos",
            (
                "filter={type: pcf, radius: 2.5}",
                "bias={slope: 0.01, slope_least: 0.001, slope_profile: one_minus_cosine, unit: depth}",
            ),
            "in window depth, as in shader cookbooks",
        ),
        Row(
            "Normal offset",
            ("filter={type: pcf, radius: 2.5}", "bias={constant: 0.5, slope: 0, normal_offset: 3}"),
            "the look-up moves along the normal",
        ),
        Row(
            "Receiver plane",
            ("filter={type: pcf, radius: 2.5}", "bias={plane: {type: receiver_plane}}"),
            "taps follow the receiver's plane, which runs deep below steep walls",
        ),
        Row(
            "Receiver plane, kept shallow",
            ("filter={type: pcf, radius: 2.5}", "bias={plane: {type: receiver_plane, deepening: 0}}"),
            "the plane never runs deeper than the receiver",
        ),
        Row("Adaptive", ("bias={plane: {type: adaptive}}",), "with a single nearest look-up, as intended"),
    ),
    "Filters of compares": (
        Row("Four taps", ("filter={type: four_tap}", "bias.slope=2"), ""),
        Row("Box", ("filter={type: pcf, radius: 4}", WIDE), "percentage-closer filtering"),
        Row("Tent", ("filter={type: tent, radius: 6}", WIDE), ""),
        Row("Castaño 7 × 7", ("filter={type: castano, size: 7}", WIDE), "16 bilinear taps"),
        Row("Random disk, nearest", disk("stratified", 32, ", lookup: nearest"), "32 taps on a disk"),
        Row("Random disk, bilinear", disk("stratified", 32), ""),
        Row("Early-out", disk("stratified", 32, ", early_out: true"), "skips the other taps where the first 8 agree"),
        Row("Soft compare", (*disk("stratified", 32), "compare={type: soft, width: 0.5}"), "the compare that fits use"),
    ),
    "Patterns of a random disk, 16 taps": tuple(
        Row(name.capitalize(), disk(name), note)
        for name, note in (
            ("stratified", ""),
            ("uniform", "Monte Carlo"),
            ("poisson", "taps keep a distance"),
            ("vogel", "one spiral, turned for each pixel"),
            ("sobol", ""),
            ("halton", ""),
        )
    ),
    "Soft shadows, and maps that are filtered beforehand": (
        Row(
            "PCSS",
            (
                "filter={type: pcss, samples: 64, search_samples: 32, max_radius: 40}",
                "bias={plane: {type: receiver_plane, deepening: 0}}",
            ),
            "a penumbra as wide as the light makes it; the search is wide, so its taps must follow the plane",
        ),
        Row("Variance (VSM)", ("filter={type: vsm, radius: 4}",), "light bleeds where casters overlap"),
        Row("VSM, bleeding reduced", ("filter={type: vsm, radius: 4, light_bleeding: 0.3}",), ""),
        Row("Exponential (ESM)", ("filter={type: esm, radius: 4}",), ""),
        Row("Exponential variance (EVSM)", ("filter={type: evsm, radius: 4}",), ""),
        Row("Moments (MSM)", ("filter={type: msm, radius: 4, light_bleeding: 0.02}",), ""),
    ),
    "Without a depth map": (
        Row("Shadow volumes, z-fail", ("technique={type: shadow_volumes}",), "exact hard shadows"),
        Row("Shadow volumes, z-pass", ("technique={type: shadow_volumes, method: z_pass}",), "without caps"),
        Row("Irregular z-buffer", ("technique={type: irregular_z_buffer}",), "exact hard shadows, without a map"),
        Row(
            "Projective texture",
            ("technique={type: projective_texture, resolution: [1024, 1024], blur: 4}", f"{PLANE}.casts=false"),
            "casters do not shadow each other",
        ),
    ),
}

LAYOUTS = "Layouts of a map"
SECTIONS[LAYOUTS] = (
    Row("One map", (), "its texels are wider than the shadows"),
    Row(
        "Cascades",
        ("technique={type: cascades, logarithmic: 0.9}",),
        "four maps, whose texels stay in place as the camera moves",
    ),
    Row(
        "Cascades, unstable",
        ("technique={type: cascades, logarithmic: 0.9, stabilize: false}",),
        "fitted to the camera's view, with finer texels",
    ),
    Row(
        "Cascades, by map",
        ("technique={type: cascades, logarithmic: 0.9, select: map}",),
        "each receiver in the finest map that contains it",
    ),
    Row(
        "Sample distribution",
        ("technique={type: cascades, logarithmic: 1, depths: surface, stabilize: false}",),
        "fitted to what the camera sees",
    ),
    Row("LiSPSM", ("technique={type: perspective_warp}",), "one map, warped towards the camera"),
    Row("Perspective", ("technique={type: perspective_warp, method: perspective}",), "for the depths in view"),
    Row(
        "Perspective, from near",
        ("technique={type: perspective_warp, method: perspective, depths: camera}",),
        "too strong: the camera's near plane is much closer than anything in view",
    ),
    Row("Trapezoidal", ("technique={type: perspective_warp, method: trapezoidal}",), ""),
    Row(
        "Resolution-matched",
        ("technique={type: resolution_matched, finest: 65536, level_bias: -8}",),
        "only those pages of a virtual map of 65536² that the camera needs",
    ),
)

ENGINES = "Engines"
BIASED = "shadow_side: double, bias: -0.002, normal_bias: 0.01"
SECTIONS[ENGINES] = (
    Row("three.js, defaults", ("technique={type: three.js}",), "back faces cast, so a closed mesh needs no bias"),
    Row("three.js, both sides", ("technique={type: three.js, shadow_side: double}",), "lit faces cast too"),
    Row(
        "three.js, PCF", (f"technique={{type: three.js, radius: 2, {BIASED}}}",), "five bilinear taps, turned by noise"
    ),
    Row("three.js, VSM", (f"technique={{type: three.js, shadow_type: VSMShadowMap, radius: 3, {BIASED}}}",), ""),
    Row("Babylon.js, defaults", ("technique={type: babylon.js}",), "half floats are coarser than its bias"),
    Row("Babylon.js, PCF", ("technique={type: babylon.js, filter: PCF, bias: 0.006, float_maps: true}",), "5 × 5 tent"),
    Row(
        "Babylon.js, PCSS",
        ("technique={type: babylon.js, filter: PCSS, bias: 0.006, float_maps: true}",),
        "contact hardening",
    ),
    Row(
        "Babylon.js, ESM",
        ("technique={type: babylon.js, filter: BLURCLOSEEXPONENTIALSHADOWMAP, bias: 0.002, float_maps: true}",),
        "",
    ),
)
SCENES_FROM = Path(__file__).parent.parent
SCENES = {LAYOUTS: SCENES_FROM / "configs" / "corridor.yaml"}
"""The configurations of sections that have a scene of their own."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *, page: Path = Path("docs/gallery.md"), repeats: int = 15) -> None:
    """Draws all techniques, and writes the page and its images.

    Parameters
    ----------
    config
        YAML file with the scene.
    page
        The page to write; images go to the folder images/gallery beside it.
    repeats
        Number of runs per time, which is their median.
    """
    console = Console()
    stages = {
        path: Stage.of(path) for path in (config, *(SCENES[section] for section in SECTIONS if section in SCENES))
    }
    folder = page.parent / "images" / "gallery"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for path, stage in stages.items():
        write_reference(folder, stage, "" if path == config else f"{path.stem}-")
    rows = [(section, row) for section, of in SECTIONS.items() for row in of]
    results = []
    for section, row in track(rows, "drawing", console=console, disable=not console.is_terminal):
        result = draw(stages[SCENES.get(section, config)], row, folder, repeats)
        console.print(
            f"{section}: {row.name}: RMSE {result.errors['rmse']:.4f}, {result.shadow_ms:.1f} ms", soft_wrap=True
        )
        results.append((section, row, result))
    text = page_of(stages[config], stages, results, repeats)
    page.write_text(text, encoding="utf-8")
    console.print(str(page))


class Result(NamedTuple):
    """The result of a technique: its errors, its image's name, and milliseconds of drawing from the light and of
    computing visibility."""

    errors: dict[str, float]
    picture: str
    light_ms: float
    shadow_ms: float


def draw(stage: Stage, row: Row, folder: Path, repeats: int) -> Result:
    """Draws, measures and times one technique."""
    settings, surface, truth = load_config(stage.config, row.overrides), stage.surface, stage.truth
    scene, technique = build_scene(settings), build_technique(settings, fitting=False)
    state = technique.prepare(scene, surface)
    image = np.asarray(technique.visibility(state, surface))
    errors = metrics.measure_errors(image, truth.visibility, truth.mask).as_dict()
    picture = f"{slug(row.name)}.png"
    io.write_png(folder / picture, np.concatenate([grey(image, truth.mask), signed(image, truth)], axis=1))
    return Result(
        errors,
        picture,
        median_ms(lambda: technique.prepare(scene, surface), repeats),
        median_ms(lambda: technique.visibility(state, surface), repeats),
    )


def median_ms(run: Callable[[], Any], repeats: int) -> float:
    """The median time of a run that has been compiled, in milliseconds."""
    jax.block_until_ready(run())
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        jax.block_until_ready(run())
        seconds.append(time.perf_counter() - started)
    return 1e3 * statistics.median(seconds)


def write_reference(folder: Path, stage: Stage, start: str) -> None:
    """Writes two images, whose names begin with `start`: the reference, and the scene shaded with it."""
    truth, scene = stage.truth, stage.scene
    io.write_png(folder / f"{start}reference.png", grey(truth.visibility, truth.mask))
    linear = build_shading(stage.settings)(stage.surface, jnp.asarray(truth.visibility), scene.light, scene.camera)
    io.write_png(folder / f"{start}shaded.png", np.clip(np.asarray(linear), 0, 1) ** (1 / 2.2))


def grey(visibility: Any, mask: Any) -> np.ndarray:
    """A visibility image as grey colours, (h, w, 3)."""
    shades = np.rint(visibility * (LEVELS - 1)) / (LEVELS - 1)
    return np.repeat(np.where(mask, shades, NO_SURFACE)[..., None], 3, axis=-1)


def signed(visibility: Any, truth: Reference) -> np.ndarray:
    """The signed difference from the reference, (h, w, 3): orange too dark, purple too light."""
    difference = np.where(truth.mask, visibility - truth.visibility, 0)
    # An even number of steps, so that zero difference has the neutral middle colour.
    return colormaps["PuOr"](0.5 + 0.5 * np.rint(difference * LEVELS / 2) / (LEVELS / 2))[..., :3]


def page_of(stage: Stage, stages: dict[Path, Stage], results: list[tuple[str, Row, Result]], repeats: int) -> str:
    """The page in Markdown."""
    config, settings, scene, _, truth = stage
    height, width = settings.scene.camera.resolution
    rows, columns = settings.shadow_map.resolution
    device = jax.devices()[0]
    lines = [
        "# Gallery",
        "",
        f"This page draws one scene with every technique: {scene.mesh.faces.shape[0]:,} triangles under a spot light "
        f"with a size. `make gallery` makes the page from `{config}` and the values in each row. The left half of each "
        "picture shows visibility. The right half shows the difference from the reference: orange where the technique "
        "is too dark, purple where it is too light.",
        "",
        "![Reference](images/gallery/reference.png) ![Shaded with the reference](images/gallery/shaded.png)",
        "",
        f"The two pictures above are the reference, traced with {truth.samples} rays per pixel (its noise is "
        f"{truth.noise_floor:.4f} RMSE), and the scene shaded with the reference. All errors compare visibility with "
        "this reference. The light has a size in the reference, so a technique that draws hard shadows always has some "
        "error. False shadow is missing light outside shadows (acne). False light is light inside shadows (leaks, "
        "Peter-panning).",
        "",
        f"Times are medians of {repeats} runs in milliseconds, without compilation. *Light* is the time to draw the "
        "map, the texture or the table of edges. *Shadow* is the time to compute visibility from it. The pictures have "
        f"{width} × {height} pixels, and maps have {columns} × {rows} texels unless the row sets another size. Numbers "
        "are float32 (float64 for shadow volumes and the irregular z-buffer), with JAX "
        f"{jax.__version__} on {device.platform} ({platform.machine()}). Other programs ran on the machine, so compare "
        "times only with each other.",
        "",
    ]
    for section in SECTIONS:
        lines += [f"## {section}", ""]
        if section in SCENES:
            lines += [*own_scene(stages[SCENES[section]]), ""]
        lines += ["| | | RMSE | SSIM | false shadow | false light | light | shadow |"]
        lines += ["|---|---|---|---|---|---|---|---|"]
        for of, row, result in results:
            if of == section:
                lines.append(table_row(row, result))
        lines.append("")
    return "\n".join(lines)


def own_scene(stage: Stage) -> list[str]:
    """The pictures of a scene that one section alone uses, and a sentence on it."""
    rows, columns = stage.settings.shadow_map.resolution
    config, triangles = stage.config.relative_to(SCENES_FROM), stage.scene.mesh.faces.shape[0]
    start = f"images/gallery/{stage.config.stem}"
    return [
        f"![Reference]({start}-reference.png) ![Shaded with the reference]({start}-shaded.png)",
        "",
        f"These rows draw another scene, `{config}`: {triangles:,} triangles under a sun without a size. The camera's "
        "far plane is a thousand times as far away as its near plane. Each map has "
        f"{columns} × {rows} texels.",
    ]


def table_row(row: Row, result: Result) -> str:
    e = result.errors
    about = "<br>".join([f"**{row.name}**", *([row.note] if row.note else []), *(f"`{o}`" for o in row.overrides)])
    return (
        f"| {about} | ![{row.name}](images/gallery/{result.picture}) | {e['rmse']:.4f} | {e['ssim']:.4f} | "
        f"{e['false_shadow_rate']:.2%} | {e['false_light_rate']:.2%} | {result.light_ms:.1f} | {result.shadow_ms:.1f} |"
    )


def slug(name: str) -> str:
    """A file's name."""
    kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in name.lower().replace("ñ", "n"))
    return "-".join(filter(None, kept.split("-")))


if __name__ == "__main__":
    app()
