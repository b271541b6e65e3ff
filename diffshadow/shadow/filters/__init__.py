"""Filters: ways to turn a shadow map into visibility, one technique a file."""

from ._abstract import AbstractFilter as AbstractFilter
from ._four_tap import FourTap as FourTap
from ._pcf import PercentageCloser as PercentageCloser
from ._random_disk import RandomDisk as RandomDisk
from ._random_disk import offset_table as offset_table
from ._single import Bilinear as Bilinear
from ._single import Nearest as Nearest
