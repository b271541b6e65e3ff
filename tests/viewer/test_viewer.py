"""What a page of `diffshadow view` shows: drawn in stages, from the settings as a render draws them."""

import dataclasses
import gc
import threading
import time

import jax
import numpy as np
import pytest
from rich.console import Console
from scenes import staying_in
from viewed import TINY

from diffshadow.config import ConfigError, fit_paths, parse_config
from diffshadow.study import read_run, run_fit, run_render
from diffshadow.viewer import _trace, _viewer
from diffshadow.viewer._drawing_cache import Recent
from diffshadow.viewer._pictures import figures_of, picture_of, views_of
from diffshadow.viewer._state import Camera, Look, State
from diffshadow.viewer._viewer import Viewer, overrides_of, settings_of

SPOT = "{type: spot, position: [1, 3, 1], radius: 0.1}"
POINT = "{type: point, position: [1, 3, 1], radius: 0.1}"


def viewer_of(*overrides):
    return Viewer(parse_config(TINY, overrides), "tiny.yaml")


@pytest.fixture(scope="module")
def viewer():
    return viewer_of()


def look(view="shaded", **state):
    return Look(state=State(**state), view=view)


def calls(viewer):
    cache = viewer.cache
    return {name: getattr(cache, name).calls for name in ("meshes", "surface", "state", "visibility")}


def added(viewer, *looks):
    """How often each stage draws for the pictures at rest of `looks`."""
    before = calls(viewer)
    for each in looks:
        viewer.show(each, at_rest=True)
    return {name: count - before[name] for name, count in calls(viewer).items()}


def test_only_what_depends_on_a_change_is_drawn_again(viewer):
    viewer.show(look(), at_rest=True)
    assert added(viewer, look()) == {"meshes": 0, "surface": 0, "state": 0, "visibility": 0}
    bias = look(numbers={"bias.constant": 1.25, "filter.radius": 2.5})
    assert added(viewer, bias) == {"meshes": 0, "surface": 0, "state": 0, "visibility": 1}
    light = look(numbers={"scene.light.azimuth": 12.0})
    assert added(viewer, light) == {"meshes": 0, "surface": 0, "state": 1, "visibility": 1}
    camera = look(camera=Camera(eye=(2.5, 2.0, 3.0), target=(0.0, 0.4, 0.0)))
    assert added(viewer, camera) == {"meshes": 0, "surface": 1, "state": 0, "visibility": 1}
    mesh = look(numbers={"scene.meshes.0.translate.0": 0.25})
    assert added(viewer, mesh) == {"meshes": 1, "surface": 1, "state": 1, "visibility": 1}
    # Another filter looks up the same map.
    assert added(viewer, look(structure={"filter": {"type": "bilinear"}})) == {
        **dict.fromkeys(("meshes", "surface", "state"), 0),
        "visibility": 1,
    }


def test_many_changes_keep_no_more_than_a_few(viewer):
    kept = []
    for i in range(16):
        numbers = {"bias.constant": 0.125 * i, "scene.light.azimuth": 1.5 * i, "scene.meshes.0.translate.0": 0.002 * i}
        camera = Camera(eye=(2.0 + 0.01 * i, 2.5, 3.0), target=(0.0, 0.4, 0.0))
        each = look(numbers=numbers, camera=camera)
        for at_rest in (False, True):
            viewer.show(each, at_rest=at_rest)
        if i >= 10:
            gc.collect()
            kept.append(len(jax.live_arrays()))
    assert kept[-1] <= kept[0] + 10, "one change makes more"
    caches = [each for each in vars(viewer.cache).values() if isinstance(each, Recent)]
    assert len(caches) == 9
    assert all(len(each._kept) <= each.most <= 8 for each in caches)


def test_a_large_picture_in_motion_is_of_half_the_size_and_keeps_its_reference(viewer, monkeypatch):
    seen = look(numbers={"scene.light.azimuth": 17.0})
    truth = traced(viewer, seen, 16)
    monkeypatch.setattr(_viewer, "_FAST_PIXELS", 32 * 48 - 1)
    viewer.show(seen, at_rest=True)
    biased = look(numbers={"scene.light.azimuth": 17.0, "bias.constant": 2.375})
    moving, still = (viewer.show(biased, at_rest=at_rest).about for at_rest in (False, True))
    assert (moving["size"], moving["rays"], moving["figures"]) == ((16, 24), truth.samples, {})
    assert (still["size"], still["rays"]) == ((32, 48), 16)
    assert still["figures"]["rmse"] > 0
    # An error has no other size, and is shown as it changes.
    error = look("error", numbers={"scene.light.azimuth": 17.0, "bias.constant": 2.625})
    shown = viewer.show(error, at_rest=False).about
    assert (shown["view"], shown["size"]) == ("error", (32, 48))


def test_a_picture_in_motion_is_of_half_the_size_only_if_surface_or_map_are_drawn(viewer):
    viewer.show(look(), at_rest=True)
    shown = viewer.show(look(numbers={"bias.constant": 2.125}), at_rest=False)
    assert shown.about["is_full"]
    assert shown.about["size"] == (32, 48)
    moving = look(numbers={"scene.light.azimuth": 33.0})
    rough = viewer.show(moving, at_rest=False)
    assert not rough.about["is_full"]
    assert rough.about["size"] == (16, 24)
    # The map is not drawn again for the full size.
    assert added(viewer, moving)["state"] == 0


def test_no_change_of_a_number_compiles_a_program(viewer):
    every = list(viewer.subject(State()).sliders.values())
    at = lambda share: [
        *(
            look(numbers={each.key: each.low + share * (each.high - each.low)})
            for each in every
            if ".scale" not in each.key
        ),
        look(camera=Camera(eye=(2.0 + share, 2.5, 3.0), target=(0.0, 0.4, 0.1))),
    ]
    draw = lambda looks: [viewer.show(each, at_rest=rest) for each in looks for rest in (False, True)]
    draw([look(), *at(0.4)[:1], at(0.4)[-1]])
    compiled = []
    watch = lambda name, *_, **__: compiled.append(name) if "backend_compile" in name else None
    jax.monitoring.register_event_duration_secs_listener(watch)
    try:
        draw(at(0.6))
    finally:
        jax.monitoring.unregister_event_duration_listener(watch)
    assert not compiled


def test_every_number_that_can_be_fitted_has_a_slider_with_its_unit_and_the_bounds_of_its_fit(viewer):
    subject = viewer.subject(State())
    fittable = {name for name, slider in subject.sliders.items() if slider.is_fittable}
    # Some have no value, and are as good as absent.
    assert set(fit_paths(viewer.config)) - fittable == {"bias.slope_least", "bias.slope_most"}
    radius = subject.sliders["filter.radius"]
    assert (radius.low, radius.high, radius.value, radius.unit) == (0, 8, 1.5, "texels")
    for slider in subject.sliders.values():
        assert slider.low <= slider.value <= slider.high
        assert slider.low < slider.high
    assert subject.sliders["scene.light.azimuth"].low == -180
    assert {"technique.type", "filter.type", "shadow_map.cull", "bias.plane.type"} <= {p.key for p in subject.pickers}


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "overrides",
    [
        (),
        pytest.param((f"scene.light={SPOT}",), marks=pytest.mark.exhaustive),
        pytest.param((f"scene.light={POINT}",), marks=pytest.mark.exhaustive),
        pytest.param(("scene.light={direction: [0.5, -1, -0.3]}",), marks=pytest.mark.exhaustive),
        pytest.param(("technique={type: cascades, count: 2}", "filter.radius=1"), marks=pytest.mark.exhaustive),
        pytest.param(("technique={type: perspective_warp}",), marks=pytest.mark.exhaustive),
        pytest.param(("technique={type: resolution_matched, page: 32, finest: 512}",), marks=pytest.mark.exhaustive),
        pytest.param(("technique={type: three.js, bias: -0.01}",), marks=pytest.mark.exhaustive),
        pytest.param(("technique={type: babylon.js, filter: PCF}",), marks=pytest.mark.exhaustive),
        pytest.param(("technique={type: shadow_volumes}",), marks=pytest.mark.exhaustive),
        pytest.param(
            ("scene.camera={type: orthographic, resolution: [32, 48], eye: [2, 2.5, 3]}",), marks=pytest.mark.exhaustive
        ),
        pytest.param((f"scene.lights=[{SPOT}, {POINT}]", "scene.light=null"), marks=pytest.mark.exhaustive),
        pytest.param(("shading.type=modulated",), marks=pytest.mark.exhaustive),
        pytest.param(("scene.camera.antialias=true",), marks=pytest.mark.exhaustive),
    ],
)
def test_a_render_of_the_saved_settings_draws_what_the_page_shows(overrides, tmp_path):
    viewer = viewer_of(*overrides)
    numbers = {"scene.meshes.0.translate.0": 0.2}
    if "bias.constant" in viewer.subject(State()).sliders:
        numbers["bias.constant"] = 1.75
    height = {"height": 3.5} if any("orthographic" in each for each in overrides) else {}
    state = State(numbers=numbers, camera=Camera(eye=(2.2, 2.4, 2.9), target=(0.1, 0.4, 0.0), **height))
    shown = viewer.frame(Look(state=state), full=True)
    text = viewer.save(state)["yaml"]
    with staying_in(tmp_path):
        saved = parse_config(text)
        run = read_run(run_render(saved, console=Console(quiet=True)))
        stored = run.arrays["shaded_visibility"][::-1].astype(int)
        assert abs(shown.shaded().astype(int) - stored).max() <= 1
        mask = shown.covered(0) & run.lights[0].mask
        np.testing.assert_array_equal(np.asarray(shown.visibility(0))[mask], run.lights[0].images[0][1][mask])


def test_the_settings_as_overrides_are_the_saved_configuration(viewer):
    state = State(
        structure={"filter": {"type": "pcf"}, "shadow_map.cull": "back"},
        numbers={"filter.radius": 1.25, "scene.light.elevation": 40.0, "scene.meshes.0.translate.1": 0.5},
        camera=Camera(eye=(1.0, 2.0, 3.0), target=(0.0, 0.5, 0.0)),
    )
    saved = parse_config(viewer.save(state)["yaml"])
    by_command = parse_config(TINY, overrides_of(settings_of(state, viewer.config, saved)))
    for section in ("scene", "filter", "bias", "shadow_map", "technique"):
        assert getattr(saved, section) == getattr(by_command, section)
    assert viewer.save(state)["command"].startswith("diffshadow render tiny.yaml 'filter={")


@pytest.mark.exhaustive
def test_a_fit_from_the_page_is_the_commands(tmp_path):
    news, done = [], threading.Event()

    def fitted(each):
        news.append(each)
        if not each["running"]:
            done.set()

    viewer = Viewer(parse_config(TINY), "tiny.yaml", fitted=fitted)
    state = State(numbers={"bias.constant": 0.25, "scene.light.azimuth": -50.0})
    viewer.start_fit(state)
    assert done.wait(120)
    assert "error" not in news[-1]
    with staying_in(tmp_path):
        result = read_run(run_fit(parse_config(viewer.save(state)["yaml"]), console=Console(quiet=True))).record
    assert news[-1]["values"] == {name: float(f"{value:.8g}") for name, value in result.fitted.items()}
    assert sum(bool(each.get("step")) for each in news) == len(viewer.fit.state["steps"]) > 2
    assert viewer.fit.state["steps"][0]["error"] > viewer.fit.state["steps"][-1]["error"]


@pytest.mark.exhaustive
def test_a_fit_stops_after_its_step_and_another_can_follow():
    ended, stepped = threading.Event(), threading.Event()

    def fitted(each):
        if each.get("step"):
            viewer.fit.stop()
            stepped.set()
        if not each["running"]:
            ended.set()

    viewer = Viewer(parse_config(TINY), "tiny.yaml", fitted=fitted)
    for _ in range(2):
        ended.clear()
        stepped.clear()
        viewer.start_fit(State())
        assert ended.wait(120)
        assert stepped.is_set()
        assert viewer.fit.state["note"].startswith("stopped")
        assert len(viewer.fit.state["steps"]) == 1


def traced(viewer, seen, enough):
    """The reference of `seen`, once it has `enough` rays per pixel."""
    key, until = viewer.trace(seen), time.monotonic() + 60
    while time.monotonic() < until:
        found = viewer.tracer.reference(key)
        if found is not None and found.samples >= enough:
            return found
        time.sleep(0.01)
    raise AssertionError("no reference came")


def test_references_get_better_and_give_the_figures_of_a_render(viewer, tmp_path):
    keys = []
    viewer.tracer.found = keys.append
    seen = look(numbers={"scene.light.elevation": 47.0})
    truth = traced(viewer, seen, 16)
    assert len(keys) == 2, "4 rays, then all 16"
    shown = viewer.show(seen, at_rest=True)
    assert shown.about["rays"] == 16
    with staying_in(tmp_path):
        saved = parse_config(viewer.save(seen.state)["yaml"])
        errors = read_run(run_render(saved, console=Console(quiet=True))).errors[0][1]
    for name in ("rmse", "false_shadow_rate", "false_light_rate"):
        assert shown.about["figures"][name] == pytest.approx(getattr(errors, name), rel=1e-5, abs=1e-7)
    frame = viewer.frame(seen, full=True)
    assert figures_of(frame, truth) == shown.about["figures"]
    lit = dataclasses.replace(truth, visibility=np.ones_like(truth.visibility))
    marks = picture_of(frame, "acne and leaks", lit).astype(int)
    dark = np.asarray(frame.visibility(0))[::-1] < 0.01
    # Where all should be lit, shadow is false: vermilion.
    assert (marks[dark & frame.covered(0)[::-1]] == (0xD5, 0x5E, 0x00)).all()
    error = picture_of(frame, "error", lit).astype(int)
    assert (error[dark & frame.covered(0)[::-1]][:, 0] > error[dark & frame.covered(0)[::-1]][:, 2]).all()


def test_what_is_no_longer_shown_is_not_traced_to_its_end(viewer):
    first = look(numbers={"scene.light.azimuth": 5.0})
    viewer.trace(first)
    viewer.tracer.rest(None)
    second = look(numbers={"scene.light.azimuth": 6.0})
    traced(viewer, second, 16)
    reached = viewer.tracer.reference(viewer.frame(first, full=True).truth_key)
    assert reached is None or reached.samples <= 16


def slow(monkeypatch, folder, traced=lambda samples: None):
    """Lets `traced` be called before each reference is traced. **Returns** the list of their rays per pixel."""
    # A folder without references.
    monkeypatch.setenv("DIFFSHADOW_CACHE", str(folder))
    asked, trace = [], _trace.reference.trace_visibility

    def tracing(scene, **how):
        asked.append(how["samples"])
        traced(how["samples"])
        how["progress"](0.5)
        return trace(scene, **how)

    monkeypatch.setattr(_trace.reference, "trace_visibility", tracing)
    return asked


def test_asking_again_for_the_same_reference_neither_abandons_nor_restarts_it(viewer, monkeypatch, tmp_path):
    seen = look(numbers={"scene.light.azimuth": 7.0})
    # As a page does with every picture; and so does another one, and it again after a look at something else.
    again = lambda samples: [viewer.trace(seen, page) for page in ("one", "other", "one")]
    asked = slow(monkeypatch, tmp_path, again)
    assert viewer.trace(seen, "one") == viewer.frame(seen, full=True).truth_key
    assert traced(viewer, seen, 16).samples == 16
    viewer.tracer.join()
    assert asked == [4, 16]
    # It is done: nothing more is traced.
    again(16)
    viewer.tracer.join()
    assert asked == [4, 16]


def test_a_page_that_leaves_does_not_end_what_another_asks_for_and_steps_are_not_repeated(
    viewer, monkeypatch, tmp_path
):
    seen = look(numbers={"scene.light.azimuth": 8.0})
    went, on = threading.Event(), threading.Event()

    def traced_to(samples):
        if samples == 16 and not on.is_set():
            went.set()
            on.wait(60)

    asked = slow(monkeypatch, tmp_path, traced_to)
    viewer.trace(seen, "one")
    assert went.wait(60)
    viewer.trace(seen, "other")
    viewer.tracer.rest("one")
    on.set()
    assert traced(viewer, seen, 16).samples == 16
    assert asked == [4, 16]
    # Abandoned after 4 rays, it goes on with 16.
    went.clear()
    on.clear()
    other = look(numbers={"scene.light.azimuth": 9.0})
    viewer.trace(other, "one")
    assert went.wait(60)
    viewer.tracer.rest("one")
    on.set()
    viewer.tracer.join()
    assert viewer.tracer.reference(viewer.frame(other, full=True).truth_key).samples == 4
    traced(viewer, other, 16)
    assert asked == [4, 16, 4, 16, 16]


def test_why_there_is_no_reference_is_said_once(viewer, monkeypatch, tmp_path):
    away = look(camera=Camera(eye=(0.0, 1.5, 0.0), target=(0.0, 3.5, 3.0)))
    asked = slow(monkeypatch, tmp_path)
    for _ in range(2):
        viewer.trace(away)
        viewer.tracer.join()
        assert "sees no surface" in viewer.show(away, at_rest=True).about["untraced"]
    assert asked == [4]
    assert viewer.show(look(), at_rest=True).about["untraced"] == ""


def test_a_fit_of_nothing_is_refused_and_a_saved_page_cannot_be_fitted_either(viewer):
    nothing = State(fitted=(), numbers={"bias.constant": 1.5})
    # Nor does the radius of another filter count.
    bilinear = State(fitted=("filter.radius",), structure={"filter": {"type": "bilinear"}})
    for state in (nothing, bilinear):
        with pytest.raises(
            ValueError, match=r"^nothing is chosen to be fitted; expected .*box beside .* bias\.constant"
        ):
            viewer.start_fit(state)
    assert not viewer.fit.state["running"]
    text = viewer.save(nothing)["yaml"]
    saved = parse_config(text)
    assert (saved.bias.constant, saved.fit.parameters) == (1.5, {})
    with pytest.raises(ConfigError, match=r"fit\.parameters: is empty; expected at least one parameter to fit"):
        parse_config(text, fitting=True)


def test_a_fit_of_a_part_of_the_configurations_numbers_keeps_the_preferences_among_these():
    viewer = viewer_of("fit.prefer=[bias.constant, filter.radius]")
    subject = viewer.subject(State())
    of_one = subject.saved(State(fitted=("filter.radius",)), fitting=True).fit
    assert (list(of_one.parameters), of_one.prefer) == (["filter.radius"], ("filter.radius",))
    whole = subject.saved(State(), fitting=True).fit
    assert (list(whole.parameters), whole.prefer) == (
        ["bias.constant", "filter.radius"],
        ("bias.constant", "filter.radius"),
    )
    least = viewer_of("fit.prefer=least_bias").subject(State())
    assert least.saved(State(fitted=("filter.radius",)), fitting=True).fit.prefer == ()
    assert least.saved(State(fitted=("bias.constant",)), fitting=True).fit.prefer == ("least_bias",)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ({"numbers": {"bias.foo": 1}}, r"^bias\.foo is not a number of this configuration; expected .* such as bias\."),
        ({"fitted": ("bias.foo",)}, r"^bias\.foo is not a number of this configuration"),
        ({"numbers": {"bias.constant": 8.5}}, r"^bias\.constant is 8\.5; expected a number from 0 to 8, in texels"),
        (
            {"numbers": {"scene.light.azimuth": -200}},
            r"azimuth is -200; expected a number from -180 to 180, in degrees",
        ),
        ({"scene": "another"}, r"^scene is another; expected null"),
    ],
)
def test_what_a_configuration_does_not_have_is_neither_saved_nor_converted_nor_fitted(viewer, state, said):
    state = State(**state)
    for ask in (viewer.save, viewer.start_fit, lambda state: viewer.code(Look(state=state))):
        with pytest.raises(ValueError, match=said):
            ask(state)
    # The rest is drawn.
    assert viewer.show(Look(state=state), at_rest=True).about["is_full"]


def test_numbers_of_other_choices_are_left_out_without_a_word(viewer):
    state = State(numbers={"filter.light_size": 2.0, "bias.constant": 1.5, "filter.radius": 8.00001}, fitted=None)
    assert viewer.misfits(state) == []
    assert viewer.save(state)["command"].startswith(
        "diffshadow render tiny.yaml bias.constant=1.5 filter.radius=8.0 bias.slope="
    )


def test_views_are_those_that_the_technique_has(viewer):
    frame = viewer.frame(look(), full=True)
    assert "layers of the map" not in views_of(frame)
    assert {"shadow map", "light's view", "error", "acne and leaks"} <= set(views_of(frame))
    for view in ("visibility", "shadow map", "light's view"):
        picture = picture_of(frame, view, None)
        assert picture.dtype == np.uint8
        assert len(np.unique(picture)) > 3
    assert picture_of(frame, "reference", None) is None
    # The light sees no shadow with enough bias.
    biased = viewer.frame(look(numbers={"bias.constant": 8.0, "bias.slope": 4.0}), full=True)
    assert biased.from_light().mean() > frame.from_light().mean()


@pytest.mark.exhaustive
def test_before_is_the_configurations_own_technique(viewer):
    from PIL import Image

    state = {"numbers": {"bias.constant": 8.0, "scene.light.azimuth": 70.0}, "structure": {"filter": {"type": "pcf"}}}
    seen = Look(state=State(**state), split=True)
    shown = viewer.show(seen, at_rest=True)
    import io

    both = np.asarray(Image.open(io.BytesIO(shown.jpeg))).astype(int)
    assert both.shape == (64, 48, 3)
    own = viewer.frame(look(numbers={"scene.light.azimuth": 70.0}), full=True).shaded()
    # A JPEG loses a little.
    assert abs(both[32:] - own).mean() < 4
    assert abs(both[:32] - own).mean() > abs(both[32:] - own).mean()


def test_numbers_stay_within_their_sliders_and_foreign_ones_are_left_out(viewer):
    subject = viewer.subject(State())
    config = subject.at(State(numbers={"bias.constant": 1e9, "filter.light_size": 3.0}))
    assert config.bias.constant == 8
    assert config.filter == subject.config.filter


def test_structure_that_does_not_fit_together_is_refused_with_its_key(viewer):
    with pytest.raises(ConfigError, match=r"filter\.type"):
        viewer.subject(State(structure={"filter": {"type": "pfc"}}))
    with pytest.raises(ConfigError, match=r"box"):
        viewer.subject(State(structure={"scene.meshes.0.path": "builtin:bax"}))


@pytest.mark.exhaustive
def test_a_view_of_the_fit_can_be_chosen(tmp_path):
    config = parse_config(TINY, ["fit.views={grid: {scene.light.elevation: [30, 60]}}"])
    viewer = Viewer(config, "tiny.yaml")
    assert len(viewer.scenes) == 2
    chosen = viewer.subject(State(scene=viewer.scenes[0])).config
    assert chosen.scene.light.elevation == 30
    assert parse_config(viewer.save(State(scene=viewer.scenes[1]))["yaml"]).scene.light.elevation == 60
