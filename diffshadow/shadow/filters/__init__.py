"""Filters: ways to turn a shadow map into visibility, one technique per file. `shadow` exports them."""

from ._abstract import AbstractFilter as AbstractFilter
