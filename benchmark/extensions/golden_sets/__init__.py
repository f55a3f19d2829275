"""Comparison with golden numbers of others' code: protocols, driving scores, drivers, severity, realism, fault."""
