"""Pages as readers have them: with enough contrast in both themes, named controls, and no number cut off."""

import json
from pathlib import Path

import pytest
from in_browser import in_browser
from rich.console import Console
from scenes import BOX_OVER_PLANE, staying_in

from diffshadow import study
from diffshadow.config import load_config, load_sweep

QUIET = Console(quiet=True)

pytestmark = [pytest.mark.browser, pytest.mark.exhaustive]

TINY = (
    BOX_OVER_PLANE
    + """
bias: {constant: 0.5, slope: 0}
filter: {type: random_disk, samples: 4}
reference: {samples: 4}
fit:
  parameters: {bias.constant: {lower: 0, upper: 8}, filter.radius: {lower: 0, upper: 8}}
  solver: {max_steps: 4}
  anneal: {phases: 1}
"""
)
ENGINE = (
    "name=engine",
    "technique={type: three.js, shadow_side: double, bias: -0.001}",
    "fit.parameters={technique.bias: {lower: -0.05, upper: 0}, technique.radius: {lower: 0, upper: 6}}",
)
SURE = ("name=sure", "fit.intervals=[0.05]", "fit.front=3", "fit.validation={grid: {scene.light.azimuth: [30, 60]}}")
SWEEP = "sweep={grid: {bias.constant: [0, 1], filter.samples: [4, 8]}, plot: {x: filter.samples, y: rmse}}"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A page of each kind."""
    with staying_in(tmp_path_factory.mktemp("pages")):
        Path("tiny.yaml").write_text(TINY)
        load = lambda *overrides: load_config("tiny.yaml", overrides, fitting=True)
        fit, engine, sure = (study.run_fit(load(*each), console=QUIET) for each in ((), ENGINE, SURE))
        render = study.run_render(load(), console=QUIET, debug=True)
        sweep = study.run_sweep(load_sweep("tiny.yaml", [SWEEP]), console=QUIET, workers=0)
        advice = study.run_advise(
            study.engine_advice("tiny.yaml", ["advise={resolutions: [[64, 64]]}"], "bevy", console=QUIET),
            console=QUIET,
            workers=0,
        )
        compared = study.compare([fit, render], Path("compare.html"), console=QUIET)
        start = study.compared_with(load(), Path("tiny.yaml"), ())
        exported = study.export_shader(load(), Path("exported"), "glsl", console=QUIET, compared=start) / "page.html"
        folders = (fit, engine, sure, render, sweep, advice)
        return [*(folder.absolute() / "report.html" for folder in folders), compared.absolute(), exported.absolute()]


def look(*pages):
    """Looks at pages in the browser; the test is skipped where it lacks something."""
    return json.loads(in_browser("read_pages.mjs", *pages, packages=("playwright-core", "axe-core")))


@pytest.fixture(scope="module")
def seen(pages):
    """What the browser finds on the pages."""
    return look(*pages)


def test_pages_are_accessible_in_both_themes(seen):
    assert seen["violations"] == []


def test_no_page_scrolls_sideways_and_no_number_is_cut_off(seen):
    assert seen["wide"] == []
    assert seen["clipped"] == []


def test_buttons_copy_the_text_beside_them(seen, pages):
    assert [each["file"] for each in seen["copies"]] == [str(page) for page in pages if page.name != "page.html"]
    for each in seen["copies"]:
        assert each["copied"] == each["text"] != ""


BAD = """<!DOCTYPE html><html lang="en"><head><title>Bad</title></head><body><main><h1>Bad</h1>
<p style="color: #aaa; background: #fff">Pale</p><input type="text"><div class="number" style="width: 900px">12</div>
<div class="code"><pre>this</pre>
<button class="copy" onclick="navigator.clipboard.writeText('that'); textContent = 'Copied'">Copy</button></div>
</main></body></html>"""


def test_what_readers_could_not_use_is_found(tmp_path):
    (tmp_path / "bad.html").write_text(BAD)
    found = look(tmp_path / "bad.html")
    assert {each["id"] for each in found["violations"]} == {"color-contrast", "label"}
    assert {each["width"] for each in found["wide"]} == {each["width"] for each in found["clipped"]} == {360, 800}
    assert [(each["text"], each["copied"]) for each in found["copies"]] == [("this", "that")]
