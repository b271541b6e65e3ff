"""What can be fitted: a technique, or an arrangement of lights and meshes as well."""

from ._abstract import AbstractProblem as AbstractProblem
from ._arranged import ArrangedProblem as ArrangedProblem
from ._blur import REACH_OF_BLUR as REACH_OF_BLUR
from ._blur import blurs_of as blurs_of
from ._blur import check_falling as check_falling
from ._devices import compressed as compressed
from ._devices import devices_of as devices_of
from ._devices import on_host as on_host
from ._joint import Images as Images
from ._joint import Joint as Joint
from ._joint import Losses as Losses
from ._joint import Samples as Samples
from ._joint import check_problem as check_problem
from ._joint import multiplied as multiplied
from ._joint import products as products
from ._joint import squares as squares
from ._picture import PictureProblem as PictureProblem
from ._pose import PoseProblem as PoseProblem
from ._pose import cone_fraction as cone_fraction
from ._shape import ShapeProblem as ShapeProblem
from ._shape import ShapeView as ShapeView
from ._stack import Atlases as Atlases
from ._stack import of_one_structure as of_one_structure
from ._stack import together as together
from ._technique import TechniqueProblem as TechniqueProblem
