"""How sure a fit is: intervals, preferences and the front, on errors in closed form and on a scene."""

import itertools
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import problem, technique

from diffshadow.fit import (
    Anneal,
    AtBound,
    End,
    Interval,
    Loss,
    Parameter,
    Parameters,
    Profile,
    Search,
    Solver,
    Sureness,
    fit,
)
from diffshadow.fit._bounds import at_bounds
from diffshadow.fit._front import front_of
from diffshadow.fit._judge import Judge
from diffshadow.fit._phases import phases_of
from diffshadow.fit._profile import Profiler
from diffshadow.fit._run import Run
from diffshadow.fit.problems import Joint
from diffshadow.shadow import RandomDisk, stratified

BOUNDS = [Parameter("a", 1.0, 0.0, 10.0), Parameter("b", 1.0, -4.0, 4.0)]
LEAST, SLANT = 0.2, 0.6
BEST = (3.0, 1.0)


class Bowl(Run):
    """A fit whose mean square error is LEAST² + u² + 2 SLANT u v + v², about `BEST`, in place of a scene's.

    The best v for a given u is -SLANT u, where it is LEAST² + (1 - SLANT²) u². A refit ends there, or, if it is
    `rough`, as far from there as its least gain lets it.
    """

    def __init__(self, jump=np.inf, rough=False):
        self.jump, self.rough, self.refits = jump, rough, 0

    def error(self, values):
        u, v = np.subtract(values, BEST)
        return float(np.sqrt(LEAST**2 + u * u + 2 * SLANT * u * v + v * v)) + (1.0 if values[0] > self.jump else 0.0)

    def refitted(self, values, kept, *, ratio=1.0, least_gain=0.0):
        self.refits += 1
        u, v = np.subtract(values, BEST)
        away = np.sqrt(self.rough * least_gain * (LEAST**2 + (1 - SLANT**2) * (u if 0 in kept else v) ** 2))
        if 0 not in kept:
            u = away - SLANT * v if 1 in kept else 0.0
        if 1 not in kept:
            v = away - SLANT * u
        return (float(np.float32(BEST[0] + u)), float(np.float32(BEST[1] + v)))


def half_width(within):
    """How far either parameter may go if the other follows."""
    return LEAST * np.sqrt(((1 + within) ** 2 - 1) / (1 - SLANT**2))


class Basin(Run):
    """A fit of one parameter without any error from -1 to 1."""

    def __init__(self):
        pass

    def error(self, values):
        return max(abs(values[0]) - 1, 0.0)

    def refitted(self, values, kept, *, ratio=1.0, least_gain=0.0):
        return values


def test_errors_of_rounding_count_as_equal():
    """Where the best error is 0, intervals reach as far as it stays so, and so do preferred values."""
    profiler = Profiler(Basin(), [Parameter("a", 0.0, -4.0, 4.0)], (0.0,))
    (interval,) = profiler.profiles([0.01])[0].intervals
    assert (interval.lower.value, interval.upper.value) == pytest.approx((-1, 1), abs=0.1)
    assert profiler.preferred([("a", "lower")], 0.01).values == pytest.approx((-1,), abs=0.1)


class Slope(Run):
    """A fit whose error falls along b without an end, with the best a at b. A refit moves a alone."""

    def __init__(self):
        pass

    def error(self, values):
        a, b = values
        return 1 - 0.05 * b + (a - b) ** 2

    def refitted(self, values, kept, *, ratio=1.0, least_gain=0.0):
        return values if 0 in kept else (values[1], values[1])


def test_all_intervals_are_about_the_best_where_better_fits_are_found_without_end():
    begun = (-4.0, -4.0)
    profiler = Profiler(Slope(), [Parameter("a", -4.0, -5.0, 5.0), Parameter("b", -4.0, -4.0, 4.0)], begun)
    profiles = profiler.profiles([0.01, 0.05])
    assert profiler.best.values[1] > -3.8
    for index, profile in enumerate(profiles):
        best = profiler.best.values[index]
        assert profile.best == (best, profiler.best.error)
        for each in profile.intervals:
            assert each.lower.value < best < each.upper.value
            assert max(each.lower.error, each.upper.error) <= (1 + each.within) * profiler.best.error
    # Where only a moves, the error is a parabola, whose ends are known.
    wide = profiles[0].intervals[1]
    half = np.sqrt(0.05 * profiler.best.error)
    assert (wide.upper.value - profiles[0].best[0]) == pytest.approx(half, rel=0.03)
    # What is preferred is within its limit of the same best.
    profiler = Profiler(Slope(), profiler.parameters, begun)
    end = profiler.preferred([("a", "upper"), ("b", "upper")], 0.01)
    assert end.error <= 1.01 * profiler.best.error


# An error within a tenth of the excess is close enough, which is a twentieth of the width; roughness adds to that.
@pytest.mark.parametrize(("rough", "close"), [(False, 0.05), (True, 0.06)], ids=["exact", "rough"])
def test_intervals_end_where_the_error_reaches_its_limit(rough, close):
    bowl, said = Bowl(rough=rough), []
    bowl.update = lambda text, done: said.append(text)
    profiles = Profiler(bowl, BOUNDS, BEST).profiles([0.05, 0.01])
    assert said[0] == "how sure, trial 1: a = 2.9"
    assert len(said) == bowl.refits
    for i, profile in enumerate(profiles):
        assert profile.best == (BEST[i], pytest.approx(LEAST))
        assert [each.within for each in profile.intervals] == [0.01, 0.05]
        for each in profile.intervals:
            for end, sign in ((each.lower, -1), (each.upper, 1)):
                assert end.value == pytest.approx(
                    BEST[i] + sign * half_width(each.within), abs=close * half_width(0.05)
                )
                least = 1 + each.within - min(0.002, 0.15 * each.within)
                assert least * LEAST <= end.error <= (1 + each.within) * LEAST
                assert not end.is_bound
        values = [value for value, _ in profile.points]
        assert values == sorted(values)
    # Some tries for each of eight ends.
    assert bowl.refits <= 60


class Misled(Bowl):
    """A bowl whose refits end far from the least error, as under a soft compare that is unlike the hard one."""

    def refitted(self, values, kept, *, ratio=1.0, least_gain=0.0):
        return tuple(value if index in kept else value + 1.0 for index, value in enumerate(values))


def test_values_stay_where_a_refit_is_worse():
    (profile, _) = Profiler(Misled(), BOUNDS, BEST).profiles([0.05])
    (interval,) = profile.intervals
    # Along a alone, the error is LEAST² + u².
    half = LEAST * np.sqrt(1.05**2 - 1)
    assert (interval.lower.value, interval.upper.value) == pytest.approx(
        (BEST[0] - half, BEST[0] + half), abs=0.03 * half
    )
    assert profile.best == (BEST[0], pytest.approx(LEAST))


def test_an_interval_ends_at_a_bound_or_at_a_jump():
    # 2.98 is no number of single precision, in which the others are fitted again.
    narrow = [Parameter("a", 3.0, 2.98, 10.0), BOUNDS[1]]
    (profile, _) = Profiler(Bowl(jump=3.02), narrow, BEST).profiles([0.05])
    (interval,) = profile.intervals
    assert interval.lower.value == narrow[0].lower
    assert interval.lower.is_bound
    assert interval.lower.error < 1.05 * LEAST
    # Just below the jump, where the error is still far from its limit.
    assert 3.01 < interval.upper.value <= 3.02
    assert not interval.upper.is_bound
    assert interval.upper.error < 1.01 * LEAST


def test_a_better_fit_found_on_the_way_becomes_the_best():
    begun = (BEST[0] + 0.2, BEST[1] - 0.1)
    profiler = Profiler(Bowl(), BOUNDS, begun)
    profiles = profiler.profiles([0.05])
    assert profiler.best.error == pytest.approx(LEAST, rel=2e-3)
    assert profiles[0].best[1] == profiler.best.error
    assert profiles[0].intervals[0].upper.error <= 1.05 * profiler.best.error


def test_preferences_go_as_far_as_the_error_allows():
    within, reach = 0.05, half_width(0.05)
    least_a = Profiler(Bowl(), BOUNDS, BEST).preferred([("a", "lower")], within)
    assert least_a.values[0] == pytest.approx(BEST[0] - reach, rel=0.03)
    # The other follows.
    assert least_a.values[1] == pytest.approx(BEST[1] + SLANT * reach, rel=0.05)
    assert least_a.error <= (1 + within) * LEAST
    most_b = Profiler(Bowl(), BOUNDS, BEST).preferred([("b", "upper"), ("a", "upper")], within)
    assert most_b.values[1] == pytest.approx(BEST[1] + reach, rel=0.05)
    # Where b is as great as it can be, a has nearly no room left.
    assert most_b.values[0] == pytest.approx(BEST[0] - SLANT * reach, abs=0.4 * reach)
    assert most_b.error <= (1 + within) * LEAST


def test_what_is_preferred_first_stays_where_it_is_while_the_next_moves():
    # The first ends at its bound, so the error leaves room for the second.
    near = [Parameter("a", 3.0, BEST[0] - 0.02, 10.0), BOUNDS[1]]
    end = Profiler(Bowl(), near, BEST).preferred([("a", "lower"), ("b", "lower")], 0.05)
    assert end.values[0] == pytest.approx(near[0].lower, rel=1e-6)
    assert end.values[1] < BEST[1] - 0.3 * half_width(0.05)


def test_a_profile_is_told_with_the_offset_of_its_parameter():
    end = lambda value: End(value, 0.2, False)
    profile = Profile("a", (3.0, 0.1), [(2.0, 0.3), (3.0, 0.1)], [Interval(0.05, end(2.5), end(3.5))])
    far = Profile("a", (1003.0, 0.1), [(1002.0, 0.3), (1003.0, 0.1)], [Interval(0.05, end(1002.5), end(1003.5))])
    assert profile.shifted(1000.0) == far


def test_values_on_a_bound_say_whether_the_error_still_falls_there():
    # Beyond 2.5, a is better. So is b with this a, and with the best one it is best on its bound.
    narrow = [Parameter("a", 1.0, 0.0, 2.5), Parameter("b", 1.0, -4.0, BEST[1])]
    a, b = at_bounds(Bowl(), narrow, (2.4999, BEST[1] - 1e-4))
    assert a == AtBound("a", "upper", 2.5, True)
    assert b[:3] == ("b", "upper", BEST[1])
    assert b.falls
    # Values are counted from an offset, and told with it.
    far = [Parameter("a", 1001.0, 1000.0, 1002.5, offset=1000.0), narrow[1]]
    assert at_bounds(Bowl(), far, (2.4999, BEST[1] - 1e-4))[0] == AtBound("a", "upper", 1002.5, True)
    assert at_bounds(Bowl(), [narrow[0], BOUNDS[1]], (2.4, BEST[1])) == []
    flat = [Parameter("a", 3.0, BEST[0], 10.0), Parameter("b", 1.0, BEST[1], 4.0)]
    assert [(each.side, each.falls) for each in at_bounds(Bowl(), flat, BEST)] == [("lower", False), ("lower", False)]
    assert [each.falls for each in at_bounds(Basin(), [Parameter("a", 0.0, -0.5, 0.5)], (0.5,))] == [False]


class Trade(Run):
    """False shadow (1 - x)² and false light x², between which a fit chooses x by their weights."""

    def __init__(self):
        self.parameters, self.tried, self.settled = Parameters.of([Parameter("x", 0.5, 0.0, 1.0)]), {}, set()

    def errors(self, x):
        return 1 - x, x

    def sides(self, values):
        self.tried[values] = self.errors(*values)
        return self.tried[values]

    def rmse(self, values):
        return float(np.hypot(*self.tried[values]))

    def refitted(self, values, kept, *, ratio=1.0, least_gain=0.0):
        # √r (1 - x)² + x² / √r is least here.
        end = (ratio / (1 + ratio),)
        self.settled |= {values, end}
        return end


class Stuck(Trade):
    """Fits end where they begin, and false shadow falls once more at the upper bound, where no slope leads."""

    def errors(self, x):
        return (0.5 - 0.3 * x if x < 0.97 else 0.01), 0.1 + x**2

    def refitted(self, values, kept, *, ratio=1.0, least_gain=0.0):
        return values


def weighted(sides, ratio):
    return ratio**0.5 * sides[0] ** 2 + ratio**-0.5 * sides[1] ** 2


def test_a_front_is_what_weighted_sums_make_least():
    trade, said = Trade(), []
    trade.update = lambda text, done: said.append(text)
    front = front_of(trade, (0.5,), 9)
    assert said == [f"front, setting {number}" for number in range(1, len(trade.tried) + 1)]
    assert len(front) == 9
    # No setting that was only tried is left: fits began or ended at each.
    assert {point.values for point in front} <= trade.settled
    shadow, light = ([getattr(point, side) for point in front] for side in ("false_shadow", "false_light"))
    assert shadow == sorted(shadow)
    assert light == sorted(light, reverse=True)
    for point in front:
        # Of all that was tried, none has a smaller sum.
        sides = point.false_shadow, point.false_light
        least = min(weighted(each, point.ratio) for each in trade.tried.values())
        assert weighted(sides, point.ratio) == pytest.approx(least)
        assert point.rmse == pytest.approx(np.hypot(*sides))
    assert [front[0].ratio, front[-1].ratio] == pytest.approx([256, 1 / 256])
    for ratio in (256, 16, 1, 1 / 16, 1 / 256):
        least = weighted(trade.errors(ratio / (1 + ratio)), ratio)
        assert min(weighted((p.false_shadow, p.false_light), ratio) for p in front) <= 1.1 * least
    assert sum(point.is_knee for point in front) == 1


def test_ends_of_a_front_are_found_where_no_slope_leads():
    stuck, grid = Stuck(), np.linspace(0, 1, 101)
    front = front_of(stuck, (0.3,), 5)
    for ratio in (256, 1 / 256):
        least = min(weighted(stuck.errors(x), ratio) for x in grid)
        assert min(weighted((p.false_shadow, p.false_light), ratio) for p in front) <= 1.02 * least
    assert front[0].values[0] >= 0.97


def test_a_front_has_no_settings_twice_and_a_knee_only_between_ends():
    class Flat(Trade):
        def errors(self, x):
            return 0.2, 0.1 + 1e-4 * x

    class Two(Trade):
        def errors(self, x):
            return (0.1, 0.3) if x > 0.5 else (0.3, 0.1)

    assert len(front_of(Flat(), (0.5,), 9)) == 1
    front = front_of(Two(), (0.5,), 9)
    assert [(point.false_shadow, point.false_light) for point in front] == [(0.1, 0.3), (0.3, 0.1)]
    assert not any(point.is_knee for point in front)


def test_a_refit_for_a_front_weighs_the_signs_of_errors(found):
    known, _ = found
    parameters = [Parameter("bias.constant", 1.6, 0.0, 6.0)]
    joint, of_all = Joint.of(known, Loss(false_shadow=2.0)), Parameters.of(parameters)
    (phase,) = phases_of(joint, of_all.paths, Anneal(1.0, 1.0, 1), None, 1 << 20)
    run, seen = Run(parameters, Judge(joint.hard(), of_all), [phase], Solver(), 1, None, None), []
    run._ran = lambda phase, arguments: seen.append(arguments[0].loss) or SimpleNamespace(value=np.full(1, np.nan))
    assert run.refitted((1.0,), (), ratio=4.0) == (1.0,)
    assert [(float(loss.false_shadow), float(loss.false_light)) for loss in seen] == [(4.0, 0.5)]


@pytest.fixture(scope="module")
def found():
    """A fit with everything, and its problem: the reference is the mean of two settings, which none is equal to."""
    disk = lambda radius, bias: technique(RandomDisk(radius, stratified((2, 2))), bias)
    known, other = (problem(disk(2.0, 1.6), target=disk(*target)) for target in ((3.2, 0.8), (1.0, 3.0)))
    known = eqx.tree_at(lambda p: p.reference, known, (known.reference + other.reference) / 2)
    parameters = [Parameter("bias.constant", 1.6, 0.0, 6.0), Parameter("filter.radius", 2.0, 0.0, 8.0)]
    settings = {"solver": Solver("levenberg_marquardt", 60, 1e-4, 1e-7), "anneal": Anneal(1.0, 0.1, 3)}
    prefer = [("bias.constant", "lower"), ("filter.radius", "lower")]
    return known, fit(known, parameters, **settings, sureness=Sureness([0.1], prefer, 0.1, front=3))


def test_a_fit_reports_what_is_preferred_and_how_sure_it_is(found):
    known, result = found
    error = lambda technique: float(known.mean_square_error(technique)) ** 0.5
    best = min(profile.best[1] for profile in result.profiles)
    assert error(result.technique) <= 1.1 * best * (1 + 1e-5)
    assert result.fitted["bias.constant"] <= result.best["bias.constant"]
    (interval,) = result.profiles[0].intervals
    assert interval.lower.value == pytest.approx(result.fitted["bias.constant"], abs=0.02)
    assert interval.lower.value <= result.best["bias.constant"] <= interval.upper.value


def test_the_parts_of_a_front_are_parts_of_the_error(found):
    known, result = found
    whole, names = Joint.of(known), Parameters.of([Parameter(name, 0.0, 0.0, 8.0) for name in result.fitted])
    for point in result.front:
        subject = whole.put(names, jnp.asarray(point.values)).hard()
        both = point.false_shadow**2 + point.false_light**2
        assert both == pytest.approx(point.rmse**2, rel=1e-5)
        assert both == pytest.approx(float(subject.mean_square_error(subject.subject)), rel=1e-4)
    shadow, light = ([getattr(point, side) for point in result.front] for side in ("false_shadow", "false_light"))
    assert shadow == sorted(shadow)
    assert light == sorted(light, reverse=True)
    # Too little bias makes false shadow, so the end without it has the most bias.
    bias = [point.values[0] for point in result.front]
    assert bias == sorted(bias, reverse=True)
    assert bias[0] > bias[-1] + 0.1
    assert shadow[0] < 0.7 * shadow[-1]
    # No coarse grid over the bounds does better at the ends.
    grid = itertools.product(np.linspace(0, 6, 7).tolist(), np.linspace(0, 8, 9).tolist())
    errors = [whole.put(names, jnp.asarray(values)).hard() for values in grid]
    errors = [tuple(float(side) ** 0.5 for side in each.sides(each.subject)) for each in errors]
    for ratio in (256, 1 / 256):
        least = min(weighted(each, ratio) for each in errors)
        assert min(weighted(each, ratio) for each in zip(shadow, light, strict=True)) <= 1.02 * least


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Sureness(within=(0.0,)), r"within\[0\] is 0.0; expected a number greater than 0"),
        (lambda: Sureness(front=2), "front is 2; expected 0, or 3 or more"),
        (lambda: Search(starts=0), "starts is 0; expected a whole number at least 1"),
        (lambda: Sureness(tolerance=11.0), "tolerance is 11.0; expected a number"),
        (lambda: Search(blurs=(1.0, -1.0)), r"blurs\[1\] is -1.0; expected a number"),
        (lambda: Search(pixels=0), "pixels is 0; expected a whole number at least 1"),
    ],
)
def test_impossible_choices_are_refused(made, message):
    with pytest.raises(ValueError, match=message):
        made()


def test_a_preference_for_what_is_not_fitted_is_refused(found):
    with pytest.raises(ValueError, match=r"bias\.slope is preferred and not fitted"):
        fit(
            found[0],
            [Parameter("bias.constant", 1.6, 0.0, 6.0)],
            sureness=Sureness(prefer=(("bias.slope", "lower"),)),
        )


def test_tilted_losses_keep_the_product_of_their_factors():
    loss = Loss("worst", false_shadow=2.0, false_light=0.5).in_phase(1.0).reweighted(16.0)
    assert float(loss.false_shadow) == pytest.approx(8.0)
    assert float(loss.false_light) == pytest.approx(0.125)
    assert loss.power is not None


class Laid:
    """A joint problem whose maps are laid out for the values that it is judged at."""

    def __init__(self, problems):
        self.problems = problems

    def each(self, change):
        return self

    def stacked(self, atlases):
        return "stacks of", self.problems


def test_stacks_are_kept_until_maps_are_laid_out_again(monkeypatch):
    monkeypatch.setattr("diffshadow.fit._judge.stacked_order", list)
    judge = Judge.__new__(Judge)
    judge.joint, judge._stacks, judge._atlases = Laid(("first",)), {}, {}
    kept = judge._stacked()
    assert kept.joint == ("stacks of", ("first",))
    assert judge._stacked() is kept
    judge.joint = Laid(("second",))
    assert judge._stacked().joint == ("stacks of", ("second",))
    assert judge._stacked().order == ["second"]
