"""Judgement of scenes and splits by the instruments of `drivers`, `severity` and `realism`; fault of contacts."""
