"""What of a network's boxes counts as what it expects."""

from typing import Final

FORECAST_SCORE: Final = 0.3
"""Boxes of a lower score are no forecasts, in all published networks: they always report a hundred or more."""
