"""Comparison with golden numbers of other people's code: protocols, driving scores, drivers, severity, realism, fault."""
