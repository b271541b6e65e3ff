"""Animations: the same bytes each time, of settings that change and of stored fits."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console
from scenes import staying_in
from viewed import TINY

from diffshadow.config import ConfigError, build_scene, parse_config
from diffshadow.io import FileError
from diffshadow.metrics import flicker
from diffshadow.reference import trace_visibility
from diffshadow.study import run_fit, run_render
from diffshadow.viewer import Change, animate, animate_run
from diffshadow.viewer._drawing_cache import DrawingCache, Frame
from diffshadow.viewer._state import Look, State
from diffshadow.viewer._subject import Subject

AZIMUTH, BIAS = Change("scene.light.azimuth", -60.0, 0.0), Change("bias.constant", 1.0, 2.0)


def frames_of(path):
    with Image.open(path) as file:
        found = []
        for number in range(file.n_frames):
            file.seek(number)
            found.append(np.asarray(file.convert("RGB")).astype(int))
        return found


def test_frames_are_those_of_the_settings_between_and_the_same_each_time(tmp_path):
    config, path = parse_config(TINY), tmp_path / "turn.png"
    assert animate(config, [AZIMUTH, BIAS], path, frames=3) == (path, None)
    drawn = frames_of(path)
    for frame, (azimuth, bias) in zip(drawn, ((-60, 1), (-30, 1.5), (0, 2)), strict=True):
        at = parse_config(TINY, [f"scene.light.azimuth={azimuth}", f"bias.constant={bias}"])
        alone = Frame(DrawingCache(), Subject(at), Look(state=State()), (32, 48)).shaded()
        # Animated PNG is lossless.
        assert abs(frame - alone).max() <= 1
    animate(config, [AZIMUTH, BIAS], tmp_path / "again.png", frames=3)
    assert path.read_bytes() == (tmp_path / "again.png").read_bytes()


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_the_suffix_chooses_the_format(suffix, tmp_path):
    path = animate(parse_config(TINY), [AZIMUTH], tmp_path / f"turn{suffix}", frames=2).path
    with Image.open(path) as file:
        assert (file.format, file.n_frames) == (suffix[1:].upper(), 2)


def test_an_animation_against_rays_says_how_much_the_shadow_shimmers(tmp_path):
    small = Change("scene.light.azimuth", -60.0, -59.0)
    made = animate(parse_config(TINY), [small], tmp_path / "a.png", frames=2, view="error")
    measured = []
    for azimuth in (-60, -59):
        at = parse_config(TINY, [f"scene.light.azimuth={azimuth}"])
        image = Frame(DrawingCache(), Subject(at), Look(state=State()), (32, 48)).visibility(0)
        truth = trace_visibility(build_scene(at), at.reference.samples, at.reference.sampler, at.seed)
        measured.append((np.asarray(image), truth.visibility, truth.mask))
    # The map covers all that the camera sees, which is less than the picture.
    assert 0.3 < np.mean(measured[0][2]) < 0.95
    assert made.flicker == pytest.approx(flicker(*map(np.stack, zip(*measured, strict=True))), rel=1e-5)
    assert made.flicker > 0.01
    still = Change("shading.specular", 0.1, 0.2)
    assert animate(parse_config(TINY), [still], tmp_path / "b.png", frames=2, view="error").flicker == 0


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (Change("scene.light.azimut", 0, 1), ConfigError, "did you mean 'azimuth'"),
        (Change("bias.constant", 0, -1), ConfigError, "at least 0"),
        (Change("scene.light", 0, 1), ConfigError, "scene.light"),
    ],
)
def test_changes_that_cannot_be_are_refused_before_anything_is_drawn(change, error, said, tmp_path):
    with pytest.raises(error, match=said):
        animate(parse_config(TINY), [change], tmp_path / "a.webp")
    assert not list(tmp_path.iterdir())


def test_other_views_and_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match="--view is 'x-ray'; expected shaded"):
        animate(parse_config(TINY), [AZIMUTH], tmp_path / "a.webp", view="x-ray")
    with pytest.raises(ValueError, match="'layers of the map', which shadow_map does not have"):
        animate(parse_config(TINY), [AZIMUTH], tmp_path / "a.webp", frames=2, view="layers of the map")
    with pytest.raises(FileError, match=r"the suffix '\.mp4'; expected \.webp, \.gif, \.png"):
        animate(parse_config(TINY), [AZIMUTH], tmp_path / "a.mp4", frames=2)


@pytest.mark.exhaustive
def test_a_stored_fit_is_shown_step_by_step_in_its_report(tmp_path):
    with staying_in(tmp_path):
        folder = run_fit(parse_config(TINY), console=Console(quiet=True))
        path = animate_run(folder)
        assert path == folder / "animation.webp"
        frames = frames_of(path)
        assert 3 <= len(frames) <= 61
        with Image.open(path) as file:
            file.seek(len(frames) - 1)
            file.load()
            assert file.info["duration"] == 2000
        assert frames[0].shape[1] > frames[0].shape[0]
        assert abs(frames[0] - frames[-1]).max() > 100
        page = (folder / "report.html").read_text()
        assert "How the fit went" in page
        assert "data:image/webp" in page
        first = path.read_bytes()
        assert animate_run(folder, Path("again.webp")).read_bytes() == first


@pytest.mark.exhaustive
def test_a_folder_without_a_fit_is_refused(tmp_path):
    with staying_in(tmp_path):
        folder = run_render(parse_config(TINY), console=Console(quiet=True))
        with pytest.raises(FileError, match=r"holds a render or a fit made in Python; expected a fit by the command"):
            animate_run(folder)
        with pytest.raises(FileError, match="does not exist"):
            animate_run(Path("nowhere"))
