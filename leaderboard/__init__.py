"""Tables and figures: a pure function of run records."""
