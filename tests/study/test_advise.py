"""Advice: from a section of the configuration to fits, times, a verdict and a recommended configuration."""

import io as text_io
import json
import re
import shlex
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console
from scenes import BOX_OVER_PLANE, staying_in
from tables import cases, is_said

from diffshadow import study
from diffshadow.cli import main
from diffshadow.config import ConfigError, build_technique, load_advice, load_config, parse_config, with_fitted
from diffshadow.io import write_visibility
from diffshadow.study.advice import _advise as module
from diffshadow.study.advice._candidates import front, ranked, recommended
from diffshadow.study.advice._large import large_biases
from diffshadow.study.advice._measure import least_bias_for, unexplained_by
from diffshadow.study.advice._times import Watch, busy_remark, times_of, unevenness_of
from diffshadow.study.advice._verdict import Findings, verdict
from diffshadow.study.record._sweeps import Candidate, LeastBias, Load, Times
from diffshadow.study.runs._progress import Progress
from diffshadow.study.runs._setup import load
from diffshadow.study.runs._views import draw_views

pytestmark = pytest.mark.usefixtures("tiny_figures")


BASE = (
    BOX_OVER_PLANE
    + """
reference: {samples: 4}
fit: {solver: {max_steps: 2}, anneal: {phases: 1}}
"""
)
ADVISE = """
advise:
  biases:
    - label: constant
      bias: {constant: 0.5, slope: 0}
      parameters: {bias.constant: {lower: 0, upper: 8}}
    - label: slope
      bias: {constant: 0, slope: 0.5}
      parameters: {bias.slope: {lower: 0, upper: 4}}
  filters:
    - {label: bilinear, filter: {type: bilinear}}
  resolutions: [[64, 64]]
"""
# Two techniques whose fits share the program of the tests of fits.
SHARED = (
    BASE.replace("max_steps: 2}", "max_steps: 60, rtol: 1e-4, atol: 1e-7}")
    + """
advise:
  biases:
    - label: constant
      bias: {constant: 0.5, slope: 0}
      parameters: {bias.constant: {lower: 0, upper: 8}}
    - label: sloped
      bias: {constant: 0.5, slope: 0.5}
      parameters: {bias.constant: {lower: 0, upper: 4}}
  filters:
    - {label: disk, filter: {type: random_disk, samples: 4}, parameters: {filter.radius: {lower: 0, upper: 8}}}
  resolutions: [[64, 64]]
"""
)
QUIET = Progress(Console(quiet=True))
VALIDATION = "fit.validation={grid: {scene.light.azimuth: [30, 60]}}"


@pytest.fixture(autouse=True)
def apart(tmp_path):
    """Each test in a folder of its own, with a cache of its own."""
    with staying_in(tmp_path):
        Path("a.yaml").write_text(BASE + ADVISE)
        yield


def advice_of(section: str | None, *overrides: str):
    """The advice of `BASE` with this section."""
    Path("t.yaml").write_text(BASE + ("" if section is None else f"advise: {section}\n"))
    return load_advice(Path("t.yaml"), list(overrides))


def run(advice, **options) -> tuple[Path, str]:
    """The folder of `advice`, done in this process, and what was said."""
    out = text_io.StringIO()
    console = Console(file=out, width=120, highlight=False)
    return study.run_advise(advice, console=console, workers=0, **options), out.getvalue()


def result_of(folder: Path):
    return json.loads((folder / "result.json").read_text())


# From the file to the fits.


def test_every_bias_is_combined_with_every_filter_and_resolution():
    advice = load_advice(Path("a.yaml"), ["advise.resolutions=[[64, 64], [32, 16]]"])
    assert [tuple(each) for each in advice.techniques] == [
        ("constant", "bilinear", (64, 64)),
        ("constant", "bilinear", (32, 16)),
        ("slope", "bilinear", (64, 64)),
        ("slope", "bilinear", (32, 16)),
    ]
    for technique, each in zip(advice.techniques, advice.sweep.runs, strict=True):
        config = each.config
        assert config.shadow_map.resolution == technique.resolution
        fitted = "bias.constant" if technique.bias == "constant" else "bias.slope"
        assert list(config.fit.parameters) == [fitted]
        assert (config.bias.constant, config.bias.slope) == ((0.5, 0) if technique.bias == "constant" else (0, 0.5))
        assert config.filter.type == "bilinear"
        assert config.advise is None


def test_default_techniques_are_fits_at_the_map_s_size_and_half_of_it():
    advice = advice_of(None, "shadow_map.resolution=[64, 48]")
    assert len(advice.techniques) == 5 * 3 * 2
    assert {each.resolution for each in advice.techniques} == {(64, 48), (32, 24)}
    labels = {(each.bias, each.filter) for each in advice.techniques}
    assert ("receiver plane", "16-tap disk") in labels
    for technique, each in zip(advice.techniques, advice.sweep.runs, strict=True):
        assert ("filter.radius" in each.config.fit.parameters) == (technique.filter != "nearest")
        assert any(name.startswith("bias.") for name in each.config.fit.parameters)
    assert len({run.id for run in advice.sweep.runs}) == 30


def test_section_does_not_change_runs_and_survives_in_their_files():
    config = load_config(Path("a.yaml"), ["advise.within=0.1"])
    assert config.advise is not None
    assert config.advise.within == 0.1
    ids = lambda *overrides: [run.id for run in load_advice(Path("a.yaml"), list(overrides)).sweep.runs]
    assert ids("advise.within=0.1", "name=other") == ids()
    assert ids("seed=1") != ids()


# Each fault: the section, the key with its line, and the remedy.
FAULTS = cases("""
{biases: [{label: a, parameters: {bias.constnat: {lower: 0, upper: 1}}}]}
    t.yaml:11: fit.parameters.bias.constnat: cannot be fitted…did you mean 'bias.constant'?
{filters: [{label: a, filter: {type: bilinear}, parameters: {filter.radius: {lower: 0, upper: 1}}}]}
    t.yaml:11: fit.parameters.filter.radius: cannot be fitted with filter type 'bilinear'…(first in the run with label
    = constant, a
{filters: []}
    t.yaml:11: advise.filters: is an empty list…remove the key to get the default
{biases: [{bias.slope: 1}]}
    advise.biases.0: has no label…add 'label: slope'
{filters: [{label: a}, {label: a}]}
    advise.filters.1.label: is 'a' again…change one
{bias: []}
    advise.bias: is not a key of advise…did you mean
{biases: [{label: a, scene.light.azimuth: 3}]}
    advise.biases.0.scene.light.azimuth: is the same for all techniques…remove it
{biases: [{label: a, parameters: {scene.light.azimuth: {lower: 0, upper: 3}}}]}
    advise.biases.0.parameters.scene.light.azimuth: moves the scene…remove it
{biases: [{label: a, filter.radius: 2}], filters: [{label: b, filter: {type: pcf}}]}
    advise.filters.0.filter: sets filter, and advise.biases.0.filter.radius sets filter.radius…remove one of them
{biases: [{label: a, shadow_map.resolution: [8, 8]}]}
    advise.biases.0.shadow_map.resolution: is set; expected maps of the sizes in advise.resolutions…set it there
{resolutions: [[8, 8], [8, 8]]}
    advise.resolutions.1: is [8, 8] again…remove one
{biases: [{label: a}], filters: [{label: b, filter: {type: nearest}}]}
    t.yaml:11: fit.parameters: is empty…add 'bias.constant
""")
MANY = f"{{resolutions: {[[n, n] for n in range(8, 80)]}}}"


@pytest.mark.parametrize(
    ("section", "said"),
    [*FAULTS, (MANY, "t.yaml:11: advise: makes 1,080 fits; expected at most 1,024…shorten its lists")],
)
def test_faults_are_reported_with_their_place_before_anything_runs(section, said):
    with pytest.raises(ConfigError) as caught:
        advice_of(section)
    assert is_said(said, str(caught.value))


def test_an_engine_has_no_biases_to_compare():
    with pytest.raises(ConfigError) as caught:
        advice_of(None, "technique={type: three.js}")
    (mistake,) = caught.value.mistakes
    assert mistake.key == "technique.type"
    assert mistake.message.startswith("is three.js, and advise compares biases and filters of shadow maps")


def test_sweeps_and_views_with_maps_of_their_own_are_refused():
    with pytest.raises(ConfigError, match=r"override 'sweep=.*sweep: makes this file a sweep; .*sweep=null"):
        advice_of(None, "sweep={repeats: 2}")
    with pytest.raises(ConfigError, match=r"fit\.views: changes shadow_map\.resolution.*advise\.resolutions"):
        advice_of(None, "fit.views={grid: {shadow_map.resolution: [[8, 8], [16, 16]]}}")


def test_command_says_one_line_and_no_traceback(capsys):
    with pytest.raises(SystemExit) as exit:
        main(["advise", "a.yaml", "advise.filters=[]"])
    assert exit.value.code == 2
    assert "advise.filters: is an empty list" in capsys.readouterr().err


def test_fitted_values_are_where_the_next_fit_starts_and_within_their_bounds():
    config = load_advice(Path("a.yaml")).sweep.runs[0].config
    with_value = with_fitted(config, {"bias.constant": 1.23456789123})
    assert with_value.bias.constant == pytest.approx(1.2345679)
    assert with_value.initial("bias.constant") == with_value.bias.constant
    assert with_fitted(config, {"bias.constant": 8.0000005}).bias.constant == 8


# What follows from errors and times.


def candidate(id: str, rmse: float, ratio: float, **fields) -> Candidate:
    own = {
        "bias": "constant",
        "filter": "tent",
        "resolution": (64, 64),
        "values": {"bias.constant": 1.5},
        "units": {"bias.constant": "texels"},
        "false_shadow": 0.01,
        "false_light": 0.02,
        "fit_rmse": rmse,
        "map_ms": 3.0,
        "lookup_ms": ratio,
    }
    return Candidate(id=id, rmse=rmse, ratio=ratio, **{**own, **fields})


def test_front_is_what_nothing_beats_in_error_and_time():
    all_of_them = [
        candidate("slow and good", 0.01, 3.0),
        candidate("beaten", 0.03, 2.5),
        candidate("middling", 0.02, 2.0),
        candidate("as fast, but worse", 0.021, 2.0),
        candidate("fast", 0.05, 1.0),
        candidate("equal", 0.05, 1.0),
    ]
    assert [each.id for each in front(all_of_them)] == ["fast", "equal", "middling", "slow and good"]
    assert [each.id for each in ranked(all_of_them)][:2] == ["slow and good", "middling"]


def test_recommended_is_the_fastest_of_the_good_and_the_best_of_the_equally_fast():
    best, near, equally_fast = candidate("a", 0.100, 2.0), candidate("b", 0.1025, 1.0), candidate("c", 0.102, 1.04)
    beyond, bad = candidate("d", 0.104, 0.5), candidate("e", 0.2, 0.1)
    everything = [bad, best, near, equally_fast, beyond]
    assert recommended(everything, 0.03).id == "c"
    assert recommended(everything, 0.0).id == "a"
    assert recommended(everything, 0.04).id == "d"


def test_the_cheapest_of_those_within_the_noise_is_recommended():
    """Several techniques have equal errors within the noise. The one that takes 2.91 times as long is not chosen."""
    dear, cheap, near = candidate("dear", 0.100, 2.91), candidate("cheap", 0.108, 1.27), candidate("near", 0.107, 1.3)
    bad = candidate("bad", 0.2, 1.0)
    everything = [dear, cheap, near, bad]
    assert recommended(everything, 0.03).id == "dear"
    assert recommended(everything, 0.03, 0.01).id == "cheap"
    # Times that may be off by much are no reason to take a dearer one.
    rough = [each.model_copy(update={"spread": 0.7}) for each in (dear, cheap, near)]
    assert recommended([*rough, bad], 0.03, 0.01).id == "cheap"
    # The noise is less than what counts.
    assert recommended(everything, 0.10, 0.0005).id == "near"
    found = Findings(everything, cheap, 0.03, "the scene", 0.01, {})
    said = verdict(found)
    assert "by this renderer on the CPU (a GPU may differ)" in said[0] or jax.default_backend() != "cpu"
    assert said[1] == (
        "It is as fast as any within the reference's noise of 0.0100 of the lowest RMSE. Constant with tent at 64² has "
        "0.1000, in 2.29 times the time; the recommended one has 8.0 % more. The difference is below the reference's "
        "noise of 0.0100, so the cheaper one is chosen."
    )
    noisy = verdict(found._replace(noise=0.02))[1]
    assert noisy.endswith("so the cheaper one is chosen. More reference.samples would tell more techniques apart.")
    assert verdict(found._replace(candidates=[cheap]))[1] == "It is the only candidate."


@pytest.mark.parametrize(
    ("bias", "bounds", "said", "asking"),
    [
        (
            "constant: 12.1, slope: 0",
            "bias.constant: {lower: 0, upper: 16}",
            "bias.constant = 12.1 texels is far more",
            "on scene.meshes.0 (builtin:box), where the angle between the light and surfaces is 30°",
        ),
        pytest.param(
            "constant: 0, slope: 0, normal_offset: 9",
            "bias.normal_offset: {lower: 0, upper: 16}",
            "bias.normal_offset = 9 texels is far more",
            "100% of it on scene.meshes.1 (builtin:plane), where the angle between the light and surfaces is 5°",
            marks=pytest.mark.exhaustive,
        ),
    ],
)
def test_a_bias_far_above_the_usual_is_explained(bias, bounds, said, asking):
    """By what a usual one costs, and by the pixels that ask for more: with a map that is too coarse for this light."""
    text = BASE.replace("fit: {", f"bias: {{{bias}}}\nfilter: {{type: bilinear}}\nfit: {{parameters: {{{bounds}}}, ")
    low = ["scene.light={azimuth: 60, elevation: 5, angular_radius: 0}", "scene.meshes.1.options.size=12"]
    (found,) = large_biases(parse_config(text, low, fitting=True), 0.0)
    assert found.startswith(said)
    numbers = re.search(r"With 3 texels and all else as fitted, the RMSE is ([\d.]+) instead of ([\d.]+)", found)
    assert numbers is not None
    usual, fitted = map(float, numbers.groups())
    assert usual > fitted
    assert re.search(r"[\d,]+ pixels of [\d,]+ in light need a larger bias: with the usual one", found)
    assert asking in found
    # A usual one that is as good is to be taken.
    (free,) = large_biases(parse_config(text, low, fitting=True), 1.0)
    assert free.endswith("as good within the reference's noise of 1.0000, so use 3 texels.")
    small = text.replace("12.1", "3.5").replace("normal_offset: 9", "normal_offset: 4")
    assert list(large_biases(parse_config(small, low, fitting=True), 0.0)) == []


def test_times_are_medians_and_techniques_of_one_program_share_them():
    rng = np.random.default_rng(0)
    true = np.array([[0.002, 0.001], [0.002, 0.001], [0.003, 0.006], [0.004, 0.002]])
    # The machine slows down and speeds up, and hiccups now and then.
    pace = rng.uniform(0.5, 2, (31, 1, 1))
    hiccup = np.where(rng.random((31, 4, 2)) < 0.1, 20, 1)
    times = times_of(true * pace * hiccup, ["p", "p", "q", "r"])
    assert times[0] == times[1]
    assert [time.ratio for time in times] == pytest.approx([1, 1, 3, 2], rel=1e-6)
    assert times[2].lookup_ms / times[2].map_ms == pytest.approx(2, rel=0.2)
    # Milliseconds have the same ratios.
    ms = [time.map_ms + time.lookup_ms for time in times]
    assert [each / ms[0] for each in ms] == pytest.approx([1, 1, 3, 2], rel=1e-6)
    steady = times_of(np.stack([true] * 3), ["p", "p", "q", "r"])
    assert (steady[3].map_ms, steady[3].lookup_ms) == pytest.approx((4, 2))
    # One of three that share a program hiccups in every round.
    shared = times_of(np.stack([true[[0, 0, 0, 2]] * [[1], [1], [50], [1]]] * 3), ["p", "p", "p", "q"])
    assert [time.ratio for time in shared] == pytest.approx([1, 1, 1, 3])


def test_the_spread_of_times_is_as_large_as_what_times_are_off_by():
    """Of 300 measurements under load, 95 in 100 ratios are within their spread of the true one."""
    rng, true, missed, spreads = np.random.default_rng(1), np.array([0.003, 0.0033]), 0, []
    for _ in range(300):
        noise = rng.lognormal(0, 0.15, (15, 2)) * rng.uniform(0.5, 2, (15, 1))
        totals = true * noise
        a, b = times_of(np.stack([totals / 2, totals / 2], axis=-1), ["a", "b"])
        spreads.append(a.spread + b.spread)
        missed += abs(b.ratio / a.ratio / 1.1 - 1) > a.spread + b.spread
    assert missed <= 30
    assert 0.03 < np.median(spreads) < 0.3
    assert times_of(np.ones((15, 2, 2)), ["a", "b"])[0] == Times(map_ms=1e3, lookup_ms=1e3, ratio=1.0, spread=0.0)


def test_no_difference_of_times_within_their_spread_is_claimed():
    near = candidate("x", 0.06, 2.4, bias="slope", filter="disk")
    said = " ".join(verdict(findings(near)))
    assert "Disk instead of tent: an RMSE of 0.0600, 50 % more, in 1.20 times the time" in said
    said = " ".join(verdict(findings(near.model_copy(update={"spread": 0.21}))))
    assert "in the same time" in said
    fast = candidate("n", 0.08, 1.5, filter="nearest", resolution=(32, 32))
    assert "The fastest is constant with nearest" in " ".join(verdict(findings(fast)))
    assert "The fastest" not in " ".join(verdict(findings(fast.model_copy(update={"spread": 0.4}))))
    # Of the equally fast, the best is recommended.
    rough, best = candidate("r", 0.102, 1.0, spread=0.2), candidate("b", 0.1, 1.15)
    assert recommended([rough, best], 0.03).id == "b"
    assert recommended([rough.model_copy(update={"spread": 0.0}), best], 0.03).id == "r"
    assert rough.times == "1.00 ± 0.20"


@pytest.mark.parametrize(
    ("load", "said"),
    [
        (Load(others=0.05, unevenness=0.02), None),
        (Load(others=None, unevenness=0.02), None),
        (Load(others=0.48, unevenness=0.02), "so times are rough: other processes used 48% of its processors"),
        (Load(others=None, unevenness=0.3), "so times are rough: the time of equal work varied by ± 30%"),
        (Load(others=0.48, unevenness=0.3), "used 48% of its processors, and the time of equal work varied by ± 30%"),
    ],
)
def test_a_busy_machine_is_remarked_on(load, said):
    remark = busy_remark(load)
    assert remark is None if said is None else remark is not None and remark.endswith(said)


def test_rounds_that_take_twice_as_long_are_uneven():
    rounds = np.ones((16, 2, 2)) * np.repeat([1.0, 2.0], 8)[:, None, None]
    assert unevenness_of(rounds) == pytest.approx(1 / 3)
    assert unevenness_of(np.ones((15, 2, 2)) * np.array([1.0, 9.0])[:, None]) == 0


@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="the use of processors is read from Linux' /proc")
def test_processors_that_other_processes_use_are_counted_and_own_ones_are_not(monkeypatch):
    from diffshadow.study.advice import _times as times

    now = {"wall": 0.0, "own": 0.0, "busy": 0.0}
    monkeypatch.setattr(times.time, "perf_counter", lambda: now["wall"])
    monkeypatch.setattr(times.time, "process_time", lambda: now["own"])
    busy = times._busy_seconds
    assert busy() > 0
    monkeypatch.setattr(times, "_busy_seconds", lambda: now["busy"])
    monkeypatch.setattr(times.os, "cpu_count", lambda: 4)
    watch = Watch()
    now.update(wall=10.0, own=15.0, busy=25.0)
    assert watch.others() == pytest.approx(0.25)
    monkeypatch.setattr(times, "_busy_seconds", lambda: None)
    assert watch.others() is None


def findings(*others: Candidate, noise: float | None = 0.001, **least_biases: LeastBias) -> Findings:
    """About a chosen slope bias, and others."""
    chosen = candidate("s", 0.04, 2.0, bias="slope", false_shadow=0.001, false_light=0.002)
    in_texels = {bias: ("texels", each) for bias, each in least_biases.items()}
    return Findings([chosen, *others], chosen, 0.03, "4 views for validation", noise, in_texels)


def test_verdict_says_what_a_constant_bias_loses_to_have_as_little_acne():
    other = candidate("c", 0.05, 2.02, false_shadow=0.03, false_light=0.002)
    say = lambda each: " ".join(verdict(findings(other, constant=each)))
    lossy = say(LeastBias(value=4.2, false_shadow=0.001, false_light=0.021))
    assert "No constant bias removes acne to the 0.10 % of slope without 2.1 % of false light, at 4.2 texels" in lossy
    assert "slope has 0.20 %, in the same time." in lossy
    none = say(LeastBias(value=30.0, false_shadow=0.012, false_light=0.05))
    assert (
        "No constant bias within its bounds removes acne to the 0.10 % of slope: the lowest, 1.2 %, is at 30 texels"
        in none
    )
    free = say(LeastBias(value=2.5, false_shadow=0.001, false_light=0.00205))
    assert "The constant bias removes acne to the 0.10 % of slope at 2.5 texels, with as little false light" in free
    # With as little acne as it is, nothing is to be said.
    alike = candidate("c", 0.05, 2.0, false_shadow=0.00105, false_light=0.002)
    assert "removes acne" not in " ".join(
        verdict(findings(alike, constant=LeastBias(value=4.2, false_shadow=0.001, false_light=0.021)))
    )


def test_verdict_claims_no_difference_below_the_noise():
    shares = {"false_shadow": 0.00104, "false_light": 0.00204}
    alike = [candidate("c", 0.0405, 2.0, **shares), candidate("d", 0.0409, 2.0, bias="plane", **shares)]
    said = " ".join(verdict(findings(*alike)))
    assert "All 3 biases are equal with tent at 64²: their RMSEs, from 0.0400 to 0.0409" in said
    assert "2 of them are as good within the reference's noise of 0.0010" in said
    apart = " ".join(verdict(findings(candidate("c", 0.0415, 2.0, **shares))))
    assert "are equal" not in apart
    assert "constant 0.10 % and 0.20 %" in apart
    # So are filters and sizes.
    wide = candidate("w", 0.0405, 4.0, bias="slope", resolution=(128, 128))
    disk = candidate("x", 0.06, 3.0, bias="slope", filter="disk")
    said = " ".join(verdict(findings(wide, disk)))
    assert "of 128² instead of 64² texels: an RMSE of 0.0405, the same within the reference's noise of 0.0010" in said
    assert "in 2.00 times the time" in said
    assert "Disk instead of tent: an RMSE of 0.0600, 50 % more, in 1.50 times the time" in said
    # The fastest is named once.
    assert "The fastest" not in said
    nearest = candidate("n", 0.08, 1.0, filter="nearest", resolution=(32, 32))
    said = " ".join(verdict(findings(wide, disk, nearest)))
    assert "The fastest is constant with nearest at 32²: an RMSE of 0.0800, 100 % more, in 0.50 times" in said
    # Of unknown noise, nothing is said.
    assert "noise" not in " ".join(verdict(findings(wide, disk, *alike, noise=None)))


def test_verdict_names_what_the_recommended_one_loses_against_the_best():
    best = candidate("b", 0.0392, 3.0, bias="plane")
    said = verdict(findings(best, noise=0.0001))
    assert said[0].startswith("Recommended: slope with tent at 64², with bias.constant 1.5 texels. Its RMSE is 0.0400")
    assert "5.0 ms per view, 3.0 ms of them for the map" in said[0]
    assert said[1] == (
        "It is as fast as any within 3 % of the lowest RMSE. Plane with tent at 64² has 0.0392, in 1.50 times the "
        "time; the recommended one has 2.0 % more."
    )
    assert "The difference is below the reference's noise" in verdict(findings(best))[1]


# From the fits to the page.


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One finished advice that several tests look at: itself, its folder and what was printed."""
    with staying_in(tmp_path_factory.mktemp("finished")):
        Path("a.yaml").write_text(SHARED)
        advice = load_advice(Path("a.yaml"), ["output=out"])
        folder, said = run(advice)
        return advice, folder, said


def test_folder_has_ranking_verdict_page_and_recommended_configuration(finished):
    advice, folder, said = finished
    result = result_of(folder)
    stored = result["advice"]
    assert folder.name == "a-advise"
    assert shlex.split(result["command"]) == [
        "diffshadow",
        "advise",
        str(folder.parent.parent / "a.yaml"),
        "output=out",
    ]
    errors = [each["rmse"] for each in stored["candidates"]]
    assert errors == sorted(errors)
    assert {each["id"] for each in stored["candidates"]} == {run.id for run in advice.sweep.runs}
    assert all(each["map_ms"] > 0 and each["lookup_ms"] > 0 for each in stored["candidates"])
    assert min(each["ratio"] for each in stored["candidates"]) == 1
    # Both biases are looked up by the same program.
    assert stored["candidates"][0]["ratio"] == stored["candidates"][1]["ratio"]
    page = (folder / "report.html").read_text()
    for words in (*stored["verdict"], "bias.constant", "filter.radius"):
        assert words.replace("'", "&#39;") in page
    assert stored["verdict"][0] in said
    assert "the recommended configuration is in recommended.yaml" in said


def test_page_is_written_again_from_the_files_alone(finished):
    _, folder, _ = finished
    before = (folder / "report.html").read_text()
    (folder / "report.html").unlink()
    assert study.report(folder, form="svg").read_text() == before
    assert (folder / "front.svg").is_file()


def test_damaged_and_incomplete_folders_are_reported(finished, tmp_path):
    from diffshadow.io import FileError

    _, folder, _ = finished
    result = result_of(folder)
    for change, said in (
        ({"advice": {**result["advice"], "recommended": "x"}}, "advice.recommended|recommended: is x"),
        ({"advice": {**result["advice"], "candidates": []}}, "advice.candidates"),
        ({"advice": None}, "incomplete recommendation|expected"),
    ):
        (tmp_path / "result.json").write_text(json.dumps({**result, **change}))
        with pytest.raises(FileError, match=said):
            study.report(tmp_path)


def test_advice_that_is_started_again_fits_and_times_nothing_twice(finished, monkeypatch):
    from diffshadow.study.sweeps import _work as work

    advice, folder, _ = finished
    before = result_of(folder)["advice"]
    for name in ("measure_times", "least_bias_for"):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("measured again"))
    monkeypatch.setitem(work._MEASURES, "fit", lambda *_: pytest.fail("fitted again"))
    with staying_in(folder.parent.parent):
        run(advice)
    assert result_of(folder)["advice"] == before
    # Other techniques are timed again.
    empty = {"ids": [], "times": [], "load": {"others": None, "unevenness": 0.0}, "least_biases": {}}
    (folder / "measured.json").write_text(json.dumps(empty))
    with staying_in(folder.parent.parent), pytest.raises(pytest.fail.Exception, match="measured again"):
        run(advice)


def test_advice_on_a_reference_that_is_upside_down_says_so(finished, tmp_path):
    _, folder, _ = finished
    config = load_config(folder / "recommended.yaml", [], fitting=True)
    assert unexplained_by(config) == []
    (drawn,) = draw_views(config, load(config, QUIET), build_technique(config), QUIET).drawn
    write_visibility(tmp_path / "truth.npy", drawn.reference.visibility[::-1])
    turned = [f"reference={{type: image, path: {tmp_path / 'truth.npy'}}}"]
    first, then, *_ = unexplained_by(load_config(folder / "recommended.yaml", turned, fitting=True))
    assert first.startswith("the fit does not explain its image: ")
    assert then.startswith("flip the reference upside down: ")


def test_what_is_wrong_is_said_first(quick, monkeypatch):
    busy = lambda configs, progress: (
        times_of(np.ones((1, len(configs), 2)), range(len(configs))),
        Load(others=0.5, unevenness=0.0),
    )
    monkeypatch.setattr(module, "measure_times", busy)
    monkeypatch.setattr(module, "unexplained_by", lambda config: ["it explains nothing"])
    folder, said = run(load_advice(Path("a.yaml"), ["output=out"]))
    assert said.partition("then they are timed\n")[2].startswith(
        "warning: it explains nothing\nwarning: the machine was busy while techniques were timed, so"
    )
    page = (folder / "report.html").read_text()
    assert (
        page.index("it explains nothing")
        < page.index("other processes used 50% of its processors")
        < page.index("Recommended: ")
    )
    # The load is kept with the times.
    assert "the machine was busy" in run(load_advice(Path("a.yaml"), ["output=out"]))[1]


@pytest.fixture
def quick(monkeypatch):
    """Fits and measurements that take no time: errors by the bias' name."""
    from diffshadow.study.sweeps import _work as work

    def measure(config, batch, progress):
        (name,) = config.fit.parameters
        errors = dict.fromkeys(("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate"), 0.25)
        whole = {f"{when}.{key}": value for when in ("before", "after") for key, value in errors.items()}
        validated = {f"validation.{key}": value / 2 for key, value in whole.items()} if config.validation else {}
        return {
            **whole,
            **validated,
            f"fitted.{name}": 1.0,
            "after.rmse": 0.1 if name == "bias.slope" else 0.2,
            "steps": 3,
            "reference_noise_floor": None,
            "pixels": 9,
        }

    monkeypatch.setitem(work._MEASURES, "fit", measure)
    timed = lambda configs, progress: (
        times_of(np.ones((1, len(configs), 2)), range(len(configs))),
        Load(others=0.0, unevenness=0.0),
    )
    monkeypatch.setattr(module, "measure_times", timed)
    monkeypatch.setattr(module, "unexplained_by", lambda config: [])
    monkeypatch.setattr(module, "least_bias_for", lambda *_: LeastBias(value=2.0, false_shadow=0.0, false_light=0.0))
    return measure


@pytest.mark.exhaustive
def test_bias_is_no_worse_than_its_special_cases(quick, monkeypatch):
    """Whatever its own fit found: one of constant and slope has the better constant, and not that without a slope."""
    from diffshadow.study.sweeps import _work as work

    errors = {("bias.constant",): 0.1, ("bias.slope",): 0.3, ("bias.constant", "bias.slope"): 0.2}

    def measure(config, batch, progress):
        names = tuple(sorted(config.fit.parameters))
        alone = config.model_copy(update={"fit": config.fit.model_copy(update={"parameters": {names[0]: None}})})
        found = {f"fitted.{name}": 1.5 for name in names}
        return {**quick(alone, batch, progress), **found, "after.rmse": errors[names], "after.mae": errors[names] / 2}

    monkeypatch.setitem(work._MEASURES, "fit", measure)
    both = "{label: both, bias: {constant: 1, slope: LEAST}, parameters: {bias.constant: {lower: 0, upper: 8}, "
    both += "bias.slope: {lower: LEAST, upper: 4}}}"
    for least, expected in ((0, 0.1), (0.5, 0.2)):
        section = ADVISE.replace("  filters:", f"    - {both.replace('LEAST', str(least))}\n  filters:")
        Path("b.yaml").write_text(BASE + section)
        folder, _ = run(load_advice(Path("b.yaml"), [f"output=of{least}"]))
        candidates = {each["bias"]: each for each in result_of(folder)["advice"]["candidates"]}
        assert candidates["both"]["rmse"] == expected
        assert candidates["both"]["values"] == {"bias.constant": 1.5, "bias.slope": 1.5 if least else 0}
        assert candidates["slope"]["rmse"] == 0.3


@pytest.mark.exhaustive
def test_errors_are_those_of_the_validation_if_there_is_one(quick):
    plain, _ = run(load_advice(Path("a.yaml"), ["output=plain"]))
    stored = result_of(plain)["advice"]
    assert [each["rmse"] for each in stored["candidates"]] == [0.1, 0.2]
    assert stored["over"] == "the scene"
    apart, _ = run(load_advice(Path("a.yaml"), ["output=apart", VALIDATION]))
    stored = result_of(apart)["advice"]
    assert [each["rmse"] for each in stored["candidates"]] == [0.125, 0.125]
    assert {each["fit_rmse"] for each in stored["candidates"]} == {0.1, 0.2}
    assert stored["over"] == "2 views for validation"
    assert "RMSE, fitted views" in (apart / "report.html").read_text()


def test_failed_fit_is_left_out_and_reported(quick, monkeypatch):
    from diffshadow.study.sweeps import _work as work

    def ill(config, batch, progress):
        if "bias.slope" in config.fit.parameters or all_fail:
            raise RuntimeError("out of luck")
        return quick(config, batch, progress)

    monkeypatch.setitem(work._MEASURES, "fit", ill)
    all_fail = True
    with pytest.raises(ValueError, match=r"no technique could be fitted.*out of luck"):
        run(load_advice(Path("a.yaml"), ["output=out"]))
    all_fail = False
    folder, said = run(load_advice(Path("a.yaml"), ["output=out"]))
    assert [each["bias"] for each in result_of(folder)["advice"]["candidates"]] == ["constant"]
    assert "1 run failed" in said
    assert "out of luck" in (folder / "report.html").read_text()


def test_bias_for_less_acne_is_the_least_that_has_it():
    """On a map too coarse for its small bias, where acne falls as the bias grows."""
    text = BASE.replace("fit: {", "bias: {constant: 0, slope: 0}\nfilter: {type: bilinear}\nfit: {")
    text = text.replace("fit: {", "fit: {parameters: {bias.constant: {lower: 0, upper: 16}}, ")
    config = parse_config(text, fitting=True)
    found = least_bias_for(config, "bias.constant", 0.01)
    assert 0 < found.value < 16
    assert found.false_shadow <= 0.01
    just_less = with_fitted(config, {"bias.constant": found.value - 16 / 2**9})
    assert least_bias_for(just_less, "bias.constant", 1.0).false_shadow > 0.01
    # No bias has less than none, so the search returns the one with the least. Any bias has at most all.
    least = least_bias_for(config, "bias.constant", -1.0)
    greatest = least_bias_for(with_fitted(config, {"bias.constant": 16}), "bias.constant", 1.0)
    assert greatest.value == 16
    assert least.false_shadow <= min(greatest.false_shadow, found.false_shadow)
    assert found.value < least.value <= 16
    assert least_bias_for(config, "bias.constant", 1.0).value == 0
