"""Judgement of whole scenes and splits by the instruments of `drivers`, `severity` and `realism`, and fault attribution."""
