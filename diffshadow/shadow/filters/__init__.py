"""Filters, which turn a shadow map into visibility. Each technique has its own file. `shadow` exports them."""

from ._abstract import AbstractFilter as AbstractFilter
