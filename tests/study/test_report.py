"""Reports and comparisons of finished runs: what they say and show, and what they refuse."""

import dataclasses
import html.parser
import io as text_io
import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.image import imread
from rich.console import Console
from stored_runs import write_fit, write_render, write_sweep

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import parse_config
from diffshadow.settings import filters, rules
from diffshadow.study.pages._compare import _errors
from diffshadow.study.pages._table import ERRORS
from diffshadow.study.record._runs import Poses
from diffshadow.study.runs._measure import combined


class Parsed(html.parser.HTMLParser):
    """A page's text, its pictures' names, its ids, and what it would load."""

    def __init__(self, path: Path):
        super().__init__()
        self.words, self.names, self.loads, self.ids, self.open = [], [], [], [], []
        self.page = path.read_text(encoding="utf-8")
        self.feed(self.page)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.loads += [value for key, value in found.items() if key in ("src", "href", "xlink:href")]
        self.names += [found["data-name"]] if "data-name" in found else []
        self.ids += [found["id"]] if "id" in found else []
        self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open[-1:]):
            self.words.append(data)


def check_alone(parsed: Parsed) -> None:
    """That the page needs nothing but itself, and that what it refers to is there once."""
    assert all(value is None or value.startswith(("data:", "#")) for value in parsed.loads)
    assert "@import" not in parsed.page
    assert len(parsed.ids) == len(set(parsed.ids))
    referred = set(re.findall(r"url\(#([^)]*)\)", parsed.page)) | {v[1:] for v in parsed.loads if v and v[0] == "#"}
    assert referred
    assert referred <= set(parsed.ids)
    # Every colour that follows the theme is set for both.
    assert set(re.findall(r"var\(--([a-z]+)\)", parsed.page)) <= set(re.findall(r"--([a-z]+):", parsed.page))


def test_report_of_a_fit_tells_what_its_files_hold(tmp_path):
    folder = write_fit(tmp_path / "tiny")
    assert study.report(folder) == folder / "report.html"
    parsed = Parsed(folder / "report.html")
    check_alone(parsed)
    result = json.loads((folder / "result.json").read_text())
    for when in ("before", "after"):
        assert f"{result['metrics'][when]['rmse']:.4f}" in parsed.text
        assert f"{result['metrics'][when]['false_shadow_rate']:.3%}" in parsed.text
    assert "bias.constant 0.1 2.5 texels 0 to 10" in parsed.text
    assert "0.0123" in parsed.text
    assert f"diffshadow fit {folder}/config.yaml" in parsed.text
    # What the user wrote stays text.
    assert "the <i>solver</i> gave up" in parsed.text
    assert "<i>" not in parsed.page
    differences = ["Before − reference", "After − reference"]
    shaded = [f"{title}, shaded" for title in ("Reference", "Before", "After")]
    assert parsed.names == [*shaded, "Reference", "Before", "After", *differences]
    assert 'type="range"' in parsed.page
    assert len(parsed.page) < 400_000


def test_report_says_whether_flip_was_measured(tmp_path):
    folder = write_fit(tmp_path / "tiny")
    # As runs were before this error was measured.
    assert "FLIP was not measured" in Parsed(study.report(folder)).text
    result = json.loads((folder / "result.json").read_text())
    for when, value in (("before", 0.4321), ("after", 0.1234)):
        result["metrics"][when]["flip"] = value
    (folder / "result.json").write_text(json.dumps(result))
    text = Parsed(study.report(folder)).text
    assert "FLIP of the shaded picture 0.4321 0.1234" in text
    assert "not measured" not in text


def test_pictures_show_every_pixel_with_its_colour(tmp_path):
    from diffshadow.study.pages._page import picture
    from diffshadow.study.style import NO_SURFACE

    image = np.array([[0.0, 1.0, np.nan], [0.5, 0.25, 1.0]], np.float32)
    shown = picture("x", image)
    assert (shown.width, shown.height) == (3, 2)
    grey = read(shown.data)[::-1]
    np.testing.assert_allclose(grey[..., 0][~np.isnan(image)], [0, 1, 0.5, 0.25, 1], atol=2 / 255)
    assert "#" + bytes((grey[0, 2, :3] * 255).round().astype(np.uint8)).hex() == NO_SURFACE
    # Too dark is orange, too light is purple, and none is nearly white.
    low, none, high = read(picture("d", np.array([[-0.5, 0, 0.5]]), colours="PuOr", limit=0.5).data)[0, :, :3]
    assert low[0] > low[2] + 0.3
    assert high[2] > high[1] + 0.2
    assert none.min() > 0.9
    # A large picture is made smaller by whole factors.
    large = picture("large", np.tile(np.array([[0.0, 1.0]]), (1000, 500)))
    assert (large.width, large.height) == (500, 500)
    np.testing.assert_allclose(read(large.data)[..., 0], 0.5, atol=2 / 255)


def read(data: str) -> np.ndarray:
    """The pixels of a picture of a page, its top row first, from 0 to 1."""
    import base64

    return imread(text_io.BytesIO(base64.b64decode(data.partition(",")[2])))


def test_differences_share_the_least_scale_that_holds_nearly_all(tmp_path):
    from diffshadow.study.pages._figures import difference_limit
    from diffshadow.study.record._stored import read_run

    run = read_run(write_fit(tmp_path / "tiny"))
    # Of 640 pixels, 16 are wrong by 1 before, which is more than one in a hundred; after, none by more than 0.05.
    assert difference_limit(run.lights) == (1.0, "neither")
    assert difference_limit(run.lights, slice(-1, None)) == (0.05, "neither")
    (light,) = run.lights
    light.images[-1][1][0, 0] = 0
    assert difference_limit([light], slice(-1, None)) == (0.05, "both")


@pytest.mark.exhaustive
def test_several_lights_have_pictures_and_errors_each(tmp_path):
    folder = write_fit(tmp_path / "tiny", lights=2)
    parsed = Parsed(study.report(folder))
    check_alone(parsed)
    assert len(parsed.names) == len(set(parsed.names)) == 2 * 5 + 3
    assert "Visibility under scene.lights.1" in parsed.text
    assert "Light by light" in parsed.text


@pytest.mark.exhaustive
@pytest.mark.parametrize("form", ["svg", pytest.param("pdf", marks=pytest.mark.exhaustive)])
def test_figures_are_written_again_in_any_format(form, tmp_path):
    from diffshadow.study.pages._figures import write_figures
    from diffshadow.study.record._stored import read_run

    folder = write_fit(tmp_path / "tiny")
    made = {f"{name}.{form}" for name in ("comparison", "shaded", "loss", "parameters")}
    study.report(folder, form=form, dpi=60)
    first = {name: (folder / name).read_bytes() for name in made}
    assert made <= set(json.loads((folder / "result.json").read_text())["files"])
    if form == "svg":
        # Text stays text.
        assert b"evaluations of the loss</text>" in first["loss.svg"]
        again = write_figures(read_run(folder), tmp_path, form, 60)
        assert {path.name: path.read_bytes() for path in again} == first


def test_parameter_curves_mark_near_bounds_phases_and_truth(tmp_path):
    from matplotlib.colors import to_hex

    from diffshadow.study import style
    from diffshadow.study.pages._figures import parameters
    from diffshadow.study.record._stored import read_run

    run = read_run(write_fit(tmp_path / "tiny"))
    known = run.record.model_copy(update={"poses": Poses(truth={"filter.radius": 3.0})})
    bias, radius = parameters(dataclasses.replace(run, record=known)).axes
    level = lambda axes, colour: [line.get_ydata()[0] for line in axes.lines if to_hex(line.get_color()) == colour]
    assert level(bias, style.INK) == [0]
    assert level(radius, style.INK) == [0]
    assert level(bias, style.GREEN) == []
    assert level(radius, style.GREEN) == [3.0]
    assert level(bias, style.VERMILION) == [2.5]
    assert [text.get_text() for text in bias.texts] == ["width 2", "0.1"]
    assert bias.get_ylabel() == "[texels]"


def test_comparison_prints_and_shows_what_differs(tmp_path):
    first = write_fit(tmp_path / "a" / "tiny")
    second = write_fit(tmp_path / "b" / "tiny", "other", shift=2, settings="bias: {slope: 0.25}")
    out = text_io.StringIO()
    page = study.compare([first, second], tmp_path / "new" / "page.html", console=Console(file=out, width=200))
    parsed = Parsed(page)
    check_alone(parsed)
    printed = out.getvalue()
    (line,) = [line for line in printed.splitlines() if "bias.slope" in line]
    slope = rules.bias_of(filters.RandomDisk, 2.5).slope
    assert re.findall(r"\d\.\d+", line) == [f"{slope}", "0.25"]
    assert "filter.samples" not in printed
    assert f"bias.slope {slope} 0.25 texels" in parsed.text
    # The same shadow is one reference; folders of one name are told apart by their paths.
    assert parsed.names[:3] == [f"{first}, shaded", f"{second}, shaded", "Reference"]
    assert parsed.names[3:5] == [str(first), str(second)]
    assert "Reference of" not in parsed.text


def test_pages_start_with_the_verdict_and_commands_and_pictures(tmp_path):
    """The verdict, commands that work as they are, the picture, the code, and the values."""
    folder = write_fit(tmp_path / "my runs" / "tiny")
    result = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(
        json.dumps(result | {"code": {"scene.light": "light.bias = 1 < 2;\nlight.on();"}})
    )
    (folder / "fitted.yaml").write_text((folder / "config.yaml").read_text())
    page = Parsed(study.report(folder)).page
    parts = [
        'class="summary',
        "<h2>What to do next</h2>",
        'class="frames"',
        "<pre>light.bias = 1 &lt; 2;\nlight.on();</pre>",
        "<h2>Results</h2>",
    ]
    assert sorted(parts, key=page.index) == parts
    # The slider shows the shaded pictures first.
    assert 'data-left="Before, shaded" data-right="After, shaded"' in page
    place = f"&#39;{folder}"
    for command in (
        f"render {place}/fitted.yaml&#39; --debug",
        f"convert {place}&#39;",
        f"advise {place}&#39; --engine three.js",
        f"view {place}&#39;",
        f"fit {place}/config.yaml&#39;",
        f"advise {place}/config.yaml&#39;",
    ):
        assert f"<pre>diffshadow {command}</pre>" in page
    sweep = Parsed(study.report(write_sweep(tmp_path / "radii-sweep"))).page
    assert sweep.index("<svg") < sweep.index("<table")
    assert f"<pre>diffshadow report {tmp_path}/radii-sweep --figures pdf</pre>" in sweep
    # Every block to copy has a button, and every table scrolls in a box of its own.
    for each in (page, sweep):
        assert each.count("<pre>") == each.count('class="copy"') > 1
        assert len(re.findall(r'<div class="wide[^>]*><table', each)) == each.count("<table")


def test_commands_of_a_draft_name_the_folder_that_it_becomes(tmp_path, monkeypatch):
    from diffshadow.study.pages._next import after_run
    from diffshadow.study.record._folder import final_folder, write_whole
    from diffshadow.study.record._stored import read_run

    seen = []
    write_whole(tmp_path / "a-run", seen.append)
    assert seen[0] != tmp_path / "a-run"
    assert final_folder(seen[0]) == final_folder(tmp_path / "a-run") == tmp_path / "a-run"
    record = read_run(
        write_render(
            tmp_path / "rendered",
            parse_config("scene: {meshes: [path: 'builtin:torus'], camera: {resolution: [6, 8]}}"),
        )
    ).record
    (draw, *_) = after_run(seen[0], record, "shadow_map")
    assert draw.text == f"diffshadow fit {tmp_path}/a-run/config.yaml"
    # The commands of a page work in any folder.
    monkeypatch.chdir(tmp_path)
    typed = after_run(Path("a-run"), record, "shadow_map")[0]
    assert typed.text == "diffshadow fit a-run/config.yaml"
    assert typed.anywhere().text == draw.text


def test_a_fit_ends_with_the_commands_that_follow_and_its_path(monkeypatch, tmp_path, capsys):
    (tmp_path / "my runs").mkdir()
    folder = write_fit(tmp_path / "my runs" / "tiny")
    (folder / "fitted.yaml").write_text((folder / "config.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    for given in (Path("my runs/tiny"), folder):
        monkeypatch.setattr(study, "run_fit", lambda config, *, console, of=given: of)
        with pytest.raises(SystemExit):
            main(["fit", "builtin:quickstart"])
        lines = capsys.readouterr().out.splitlines()
        typed = [shlex.split(line) for line in lines if line.startswith("  diffshadow")]
        # All paths are as the path of the run: relative or absolute.
        assert [words[1:3] for words in typed] == [[verb, str(given)] for verb in ("convert", "advise", "view")]
        assert typed[1][3:] == ["--engine", "three.js"]
        assert lines[-1] == str(given)


def test_comparison_of_different_scenes_is_remarked(tmp_path):
    first, second = (write_fit(tmp_path / name, shift=i) for i, name in enumerate("ab", 1))
    stored = dict(np.load(second / "arrays.npz"))
    said = "warning: the runs are of different scenes or references (scene.camera.fov_y)"

    def compared() -> tuple[str, str]:
        out = text_io.StringIO()
        page = study.compare([first, second], tmp_path / "page.html", console=Console(file=out, width=300))
        return out.getvalue(), Parsed(page).text

    # Noise makes another reference of the same scene.
    np.savez(second / "arrays.npz", **stored | {"reference": np.clip(stored["reference"] + 0.01, 0, 1)})
    assert not any("different scenes" in text for text in compared())
    config = (second / "config.yaml").read_text()
    (second / "config.yaml").write_text(config.replace("fov_y: ", "fov_y: 1"))
    printed, shown = compared()
    assert said in printed
    assert said.removeprefix("warning: ") in shown
    # With the same references, errors are of the same shadow.
    np.savez(second / "arrays.npz", **stored)
    assert not any("different scenes" in text for text in compared())


def test_comparison_marks_the_greatest_ssim_and_the_least_of_the_other_errors():
    errors = [dict.fromkeys(ERRORS, value) for value in (0.3, 0.2, 0.4)]
    lines = _errors([SimpleNamespace(errors=[("", SimpleNamespace(**each))]) for each in errors])
    ssim = list(ERRORS).index("ssim")
    assert [line.best for line in lines] == [{2} if i == ssim else {1} for i in range(len(lines))]


def test_errors_of_several_lights_are_those_of_all_their_pixels():
    errors = [{"mae": 0.1, "rmse": 0.3}, {"mae": 0.4, "rmse": 0.1}, {"mae": np.nan, "rmse": np.nan}]
    drawn = [SimpleNamespace(pixels=pixels) for pixels in (30, 10, 0)]
    assert combined(errors, drawn) == pytest.approx({"mae": 0.175, "rmse": np.sqrt(0.07)})


def test_report_of_a_sweep_has_means_spreads_and_failures(tmp_path):
    folder = write_sweep(tmp_path / "radii-sweep")
    (folder / "mine.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(8) + (32).to_bytes(4) + (16).to_bytes(4))
    parsed = Parsed(study.report(folder, form="pdf"))
    check_alone(parsed)
    assert (folder / "plot.pdf").read_bytes().startswith(b"%PDF")
    assert "A sweep of 6 renders: 4 are done, 1 failed, 1 are missing" in parsed.text
    assert "1 2 0.110 ± 0.010 2 2 0.3 Means" in parsed.text
    assert "ValueError: <nothing> was seen 1 filter.radius = 4, seed = 0" in parsed.text
    assert "mine" in parsed.text


def damage(name: str, content: str | bytes | None) -> Callable[[Path], None]:
    """What removes a file of a run, or writes something else to it."""

    def apply(folder: Path) -> None:
        if content is None:
            (folder / name).unlink()
        else:
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())

    return apply


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (shutil.rmtree, "tiny does not exist; expected the folder of a finished run"),
        (damage("result.json", None), "tiny holds no run: it has no result.json"),
        (damage("result.json", '{"kind": "f'), "result.json is damaged"),
        (damage("result.json", '{"status": "ok"}'), "result.json is not the record of a fit"),
        (
            damage("result.json", '{"kind": "fit"}'),
            "result.json is damaged: name is missing; expected a file of a run",
        ),
        (damage("result.json", "[" * 100_000), "result.json is damaged (recursion limit exceeded"),
        (
            damage("result.json", '{"kind": "sweep", "name": "s", "settings": {"repeats": 2}}'),
            "an incomplete sweep: it has no results.parquet",
        ),
        (
            damage("result.json", '{"kind": "sweep", "name": "s", "settings": {}}'),
            "settings: sweeps no key",
        ),
        (damage("arrays.npz", None), "holds an incomplete run: it has no arrays.npz"),
        (damage("arrays.npz", b"PK\x03\x04 and no more"), "arrays.npz is damaged (File is not a zip file)"),
        (damage("config.yaml", None), "holds an incomplete run: it has no config.yaml"),
        (damage("config.yaml", "sede: 1"), "sede: is not a key"),
    ],
)
def test_what_is_no_whole_run_is_reported_in_one_message(harm, said, tmp_path, capsys):
    folder = write_fit(tmp_path / "tiny")
    harm(folder)
    there = sorted(folder.glob("*"))
    with pytest.raises(SystemExit) as caught:
        main(["report", str(folder)])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert "Traceback" not in err
    assert sorted(folder.glob("*")) == there


def test_mistakes_of_a_comparison_are_reported(tmp_path, capsys):
    run, sweep = write_fit(tmp_path / "tiny"), write_sweep(tmp_path / "radii-sweep")
    (tmp_path / "file").touch()
    for arguments, said in (
        ([run, run], "expected two or more, each once"),
        ([run, sweep], "radii-sweep holds a sweep; expected the folder of a fit or a render"),
        ([run, tmp_path / "none"], "none does not exist"),
        ([run, tmp_path / "file", "--output", tmp_path / "file" / "page.html"], "exists and is not a folder"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(["compare", *map(str, arguments)])
        assert caught.value.code == 2
        out, err = capsys.readouterr()
        assert (out, said in err, len(err.splitlines())) == ("", True, 1), err
    with pytest.raises(ValueError, match="dpi is 1"):
        study.report(run, form="png", dpi=1)
