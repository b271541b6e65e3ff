"""Sampling patterns: where the taps of a disk lie, one technique per file."""

from ._halton import halton as halton
from ._pattern import EARLY_SAMPLES as EARLY_SAMPLES
from ._pattern import Pattern as Pattern
from ._pattern import interleaved_gradient_noise as interleaved_gradient_noise
from ._poisson_disk import poisson_disk as poisson_disk
from ._sobol import sobol as sobol
from ._stratified import stratified as stratified
from ._uniform import uniform as uniform
from ._vogel import vogel as vogel
