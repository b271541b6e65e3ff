"""The verdict in words. Each sentence has its figures. No sentence claims a difference that may be noise."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import jax

from ..record._sweeps import Candidate, LeastBias
from ._candidates import front, ranked, same_time, tolerated

# The smallest difference of rates that counts: 26 pixels of 512 × 512. The reference's noise hardly affects rates,
# because they only count pixels where all of its rays agree.
_SAME_RATE = 1e-4
# Above this fraction of the lowest RMSE, the reference's noise hides differences that matter.
_NOISY = 0.1


class Findings(NamedTuple):
    """The subject of a verdict.

    - `candidates`: all candidates; `chosen`: the recommended candidate; `within`: the fraction by which its error may
      exceed the lowest.
    - `over`: the views that errors are measured over, in words.
    - `noise`: the reference's own RMSE; `None` if unknown.
    - `large`: sentences about recommended biases that are far larger than usual.
    - `least_biases`: for other biases with a single fitted number, by label: the number's unit, and the value at which
      the bias has no more false shadow than the chosen bias.
    """

    candidates: Sequence[Candidate]
    chosen: Candidate
    within: float
    over: str
    noise: float | None
    least_biases: Mapping[str, tuple[str, LeastBias]]
    large: Sequence[str] = ()

    @property
    def same_rmse(self) -> float:
        """The smallest difference of RMSEs that counts as a difference."""
        return self.noise or 0.0

    def like_chosen(self, *same: str) -> list[Candidate]:
        """The candidates that have the same values of these fields as the chosen candidate, which comes first."""
        key = lambda each: [getattr(each, name) for name in same]
        others = [each for each in self.candidates if key(each) == key(self.chosen) and each.id != self.chosen.id]
        return [self.chosen, *others]


def verdict(found: Findings) -> list[str]:
    """The verdict, one sentence each."""
    parts = (_choice, lambda found: iter(found.large), _against_best, _biases, _less_acne, _filters, _sizes, _fastest)
    return [sentence for part in parts for sentence in part(found)]


def _choice(found: Findings) -> Iterator[str]:
    chosen = found.chosen
    values = ", ".join(f"{name} {value:.3g} {chosen.units[name]}".rstrip() for name, value in chosen.values.items())
    yield (
        f"Recommended: {chosen.name}, with {values}. Its RMSE is {chosen.rmse:.4f} over {found.over}, and it takes "
        f"{chosen.ms:.1f} ms per view, {chosen.map_ms:.1f} ms of them for the map, by this renderer {_device()}."
    )


def _against_best(found: Findings) -> Iterator[str]:
    best, chosen = min(found.candidates, key=lambda each: each.rmse), found.chosen
    if len(found.candidates) == 1:
        yield "It is the only candidate."
        return
    if best.id == chosen.id:
        others = [each for each in found.candidates if each.id != chosen.id]
        equal = [each for each in others if each.rmse - chosen.rmse <= found.same_rmse]
        yield f"No other of the {len(found.candidates)} candidates has a smaller error" + (
            f"; {len(equal)} of them {'is' if len(equal) == 1 else 'are'} as good within the reference's noise of "
            f"{found.same_rmse:.4f}, and none of these is faster."
            if equal and found.noise
            else "."
        )
        return
    more = chosen.rmse / best.rmse - 1 if best.rmse else 0.0
    noise, margin = "", tolerated(best.rmse, found.within, found.same_rmse)
    if found.noise is not None and chosen.rmse - best.rmse <= found.noise:
        noise = f" The difference is below the reference's noise of {found.noise:.4f}, so the cheaper one is chosen."
    if margin > found.within * best.rmse:
        good = f"the reference's noise of {margin:.4f} of the lowest RMSE"
        # Techniques that only more rays could tell apart count as equal.
        if margin > _NOISY * best.rmse:
            noise += " More reference.samples would tell more techniques apart."
    else:
        good = f"{100 * found.within:g} % of the lowest RMSE"
    yield (
        f"It is as fast as any within {good}. {_upper(best.name)} has {best.rmse:.4f}, {_time(best, chosen)}; the "
        f"recommended one has {_percent(more)} more.{noise}"
    )


def _biases(found: Findings) -> Iterator[str]:
    peers = found.like_chosen("filter", "resolution")
    if len(peers) < 2:
        return
    where = f"with {found.chosen.filter} at {found.chosen.size}"
    spread = lambda name: max(getattr(p, name) for p in peers) - min(getattr(p, name) for p in peers)
    if spread("rmse") <= found.same_rmse and max(spread("false_shadow"), spread("false_light")) <= _SAME_RATE:
        least, most = min(p.rmse for p in peers), max(p.rmse for p in peers)
        yield (
            f"All {len(peers)} biases are equal {where}: their RMSEs, from {least:.4f} to {most:.4f}, differ by no "
            f"more than the reference's noise of {found.same_rmse:.4f}, and false shadow and false light by no more "
            f"than {_percent(_SAME_RATE)} of the light."
        )
        return
    each = "; ".join(
        f"{p.bias} {_percent(p.false_shadow)} and {_percent(p.false_light)}"
        for p in sorted(peers, key=lambda p: p.false_shadow + p.false_light)
    )
    yield f"False shadow (acne) and false light (leaks, lost contact shadows) {where}: {each} of the light."


def _less_acne(found: Findings) -> Iterator[str]:
    """The cost of other biases that are raised until they have no more acne than the recommended bias."""
    chosen = found.chosen
    for peer in found.like_chosen("filter", "resolution")[1:]:
        if peer.bias not in found.least_biases or peer.false_shadow <= chosen.false_shadow + _SAME_RATE:
            continue
        unit, least = found.least_biases[peer.bias]
        value = f"{least.value:.3g} {unit}".rstrip()
        rest = f"{chosen.bias} has {_percent(chosen.false_light)}, {_time(chosen, peer)}."
        if least.false_shadow > chosen.false_shadow + _SAME_RATE:
            yield (
                f"No {peer.bias} bias within its bounds removes acne to the {_percent(chosen.false_shadow)} of "
                f"{chosen.bias}: the lowest, {_percent(least.false_shadow)}, is at {value}, with "
                f"{_percent(least.false_light)} of false light; {rest}"
            )
        elif least.false_light > chosen.false_light + _SAME_RATE:
            yield (
                f"No {peer.bias} bias removes acne to the {_percent(chosen.false_shadow)} of {chosen.bias} without "
                f"{_percent(least.false_light)} of false light, at {value}; {rest}"
            )
        else:
            yield (
                f"The {peer.bias} bias removes acne to the {_percent(chosen.false_shadow)} of {chosen.bias} at "
                f"{value}, with as little false light, {_percent(least.false_light)}."
            )


def _filters(found: Findings) -> Iterator[str]:
    for other in found.like_chosen("bias", "resolution")[1:]:
        yield f"{_upper(other.filter)} instead of {found.chosen.filter}: {_change(found, other)}."


def _sizes(found: Findings) -> Iterator[str]:
    for other in found.like_chosen("bias", "filter")[1:]:
        yield f"A map of {other.size} instead of {found.chosen.size} texels: {_change(found, other)}."


def _fastest(found: Findings) -> Iterator[str]:
    least = front(found.candidates)[0]
    fastest = ranked([each for each in found.candidates if same_time(each, least)])[0]
    near = same_time(fastest, found.chosen)
    told = [*found.like_chosen("bias", "resolution"), *found.like_chosen("bias", "filter")]
    if not near and fastest not in told:
        yield f"The fastest is {fastest.name}: {_change(found, fastest)}."


def _change(found: Findings, other: Candidate) -> str:
    """The effect of another candidate."""
    chosen = found.chosen
    if abs(other.rmse - chosen.rmse) <= found.same_rmse:
        noise = f" within the reference's noise of {found.noise:.4f}" if found.noise else ""
        return f"an RMSE of {other.rmse:.4f}, the same{noise}, {_time(other, chosen)}"
    more = other.rmse / chosen.rmse - 1
    which = f"{_percent(abs(more))} {'more' if more > 0 else 'less'}"
    return f"an RMSE of {other.rmse:.4f}, {which}, {_time(other, chosen)}"


def _time(of: Candidate, than: Candidate) -> str:
    """The time of one candidate compared with another."""
    return "in the same time" if same_time(of, than) else f"in {of.ratio / than.ratio:.2f} times the time"


def _device() -> str:
    """The device of the times, in words."""
    kind = jax.default_backend()
    return "on the CPU (a GPU may differ)" if kind == "cpu" else f"on the {kind.upper()}"


def _percent(fraction: float) -> str:
    """A fraction in percent, with two digits, or at least a thousandth of a percent."""
    percent = 100 * fraction
    return f"{percent:.3f} %" if percent < 0.1 else f"{percent:#.2g} %" if percent < 10 else f"{percent:.0f} %"


def _upper(words: str) -> str:
    return words[:1].upper() + words[1:]
