"""How a fit searches, and what it says about how sure its values are."""

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
    """Where a fit looks, and at how much of the images.

    - `starts`: how many starts are tried: the initial values, and a Sobol sequence over the bounds. The best of them
        under the first blurs, by the hard compare, goes on.
    - `seed`: of the starts.
    - `blurs`: for a fit of poses, the standard deviations in pixels of the Gaussian under which images are compared,
        which fall. Phases before the last move poses only; a phase under the best blur for the map's texels follows. If
        left out, widths fall from an eighth of the images' shorter side to 3, each about a third of the previous width.
    - `evaluations`: how often the error is evaluated, for each parameter, in the search for numbers that lay out the
        map.
    - `pixels`: the most pixels that a step of a fit of a technique evaluates. If more pixels count, a step evaluates a
        random sample. For a loss other than the mean, most of the sample comes from the worst problems. Their errors
        are rescaled to whole images when a phase starts. The judge, and a user's loss, see all.
    - `devices`: how many devices share the images of a fit of a technique; 0 for all that JAX sees.

    **Raises** `ValueError` for a value that is not allowed.
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
    """What a fit finds out about the values near the best.

    - `within`: for each of these fractions ε, finds the interval of every parameter in which the error stays below
        (1 + ε) times the best, while the others are fitted again.
    - `prefer`, `tolerance`: names of parameters, and the bound, `"lower"` or `"upper"`, that they should come close to.
        The result is chosen among all values whose error is at most (1 + `tolerance`) times the best: the first
        parameter goes as far as possible, then the second, and so on. For fits of a technique, as `within` is.
    - `front`: how many weighted sums of false shadow and false light are made least, 3 or more; 0 for none. For fits
        of a technique, with a loss that has factors of both.

    **Raises** `ValueError` for a value that is not allowed.
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
        """**Raises** `ValueError` for what a fit of the parameters with these `names` cannot find."""
        if (self.within or self.prefer) and joint.moves:
            raise ValueError("intervals or preferences are asked for in a fit of lights or meshes; expected none there")
        for name, _ in self.prefer:
            if name not in names:
                raise ValueError(f"{name} is preferred and not fitted; expected one of {', '.join(names)}")
        if self.front and joint.moves:
            raise ValueError(
                f"a front of {self.front} points is asked for in a fit of lights or meshes; expected none there"
            )
        if self.front and joint.own is not None:
            raise ValueError(
                f"a front of {self.front} points is asked for with a loss of your own; expected a fit.Loss, which has "
                "factors of false shadow and of false light"
            )
