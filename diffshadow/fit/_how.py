"""The settings of a fit's search, and of the uncertainty of its values."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

from .._checks import check_settings
from ..settings.fit import FEWEST_POINTS
from ..settings.fit import Search as SearchSettings
from ..settings.fit import Sureness as SurenessSettings
from ._profile import Bound
from .problems import Joint, check_falling


@dataclasses.dataclass(frozen=True)
class Search:
    """The region of a fit's search, and the number of pixels in a step.

    - `starts`: the number of starts: the initial values, and then a Sobol sequence over the bounds. After the first
      blurs, only the best start under the hard compare continues.
    - `seed`: seed of the starts.
    - `blurs`: for a fit of poses, the decreasing standard deviations, in pixels, of the Gaussian that blurs the
      compared images. All phases before the last move poses only. A phase under the best blur for the map's texels
      follows. By default, widths fall from an eighth of the images' shorter side to 3, each about a third of the
      previous width.
    - `evaluations`: the number of error evaluations, for each parameter, in the search for numbers that lay out the
      map.
    - `pixels`: the maximum number of pixels in a step of a fit of a technique. If more pixels count, a step evaluates a
      random sample. For a loss other than the mean, most of the sample comes from the worst problems. Their errors are
      rescaled to whole images when a phase starts. The judge, and a user's loss, see all pixels.
    - `devices`: the number of devices that share the images of a fit of a technique; 0 for all devices of JAX.

    **Raises** `ValueError` for an invalid value.
    """

    settings: ClassVar = SearchSettings

    starts: int = SearchSettings.multistart
    seed: int = 0
    blurs: Sequence[float] | None = SearchSettings.blurs
    evaluations: int = SearchSettings.evaluations
    pixels: int = SearchSettings.pixels
    devices: int = SearchSettings.devices

    def __post_init__(self):
        check_settings(self)
        if self.blurs is not None:
            check_falling(self.blurs)


@dataclasses.dataclass(frozen=True)
class Sureness:
    """The intervals and fronts around the best values that a fit computes.

    - `within`: for each of these fractions ε, finds the interval of every parameter in which the error stays below (1 +
      ε) times the best error. The other parameters are fitted again.
    - `prefer`, `tolerance`: the preferred parameters, by name, each with the bound to approach, `"lower"` or `"upper"`;
      and the tolerated increase of the error. The result is chosen among all values whose error is at most (1 +
      `tolerance`) times the best. The first parameter goes as far as possible, then the second, and so on. Like
      `within`, this is only for fits of a technique.
    - `front`: the number of settings on the front, 3 or more; each minimises a weighted sum of false shadow and false
        light. 0 for no front. This is only for fits of a technique, with a loss that has factors for both. **Raises**
        `ValueError` for an invalid value.
    """

    settings: ClassVar = SurenessSettings

    within: Sequence[float] = SurenessSettings.intervals
    prefer: Sequence[tuple[str, Bound]] = ()
    tolerance: float = SurenessSettings.tolerance
    front: int = SurenessSettings.front

    def __post_init__(self):
        check_settings(self)
        if 0 < self.front < FEWEST_POINTS:
            raise ValueError(f"Sureness.front is {self.front}; expected 0, or {FEWEST_POINTS} or more")

    def check(self, joint: Joint, names: list[str]) -> None:
        """**Raises** `ValueError` for intervals and fronts that are impossible in a fit of the parameters `names`."""
        if (self.within or self.prefer) and joint.moves:
            raise ValueError("intervals or preferences were requested for a fit of lights or meshes; expected none")
        for name, _ in self.prefer:
            if name not in names:
                raise ValueError(f"{name} is preferred and not fitted; expected one of {', '.join(names)}")
        if self.front and joint.moves:
            raise ValueError(
                f"a front of {self.front} points was requested for a fit of lights or meshes; expected no front"
            )
        if self.front and joint.own is not None:
            raise ValueError(
                f"a front of {self.front} points was requested with a loss of your own; expected a fit.Loss, which has "
                "factors of false shadow and of false light"
            )
