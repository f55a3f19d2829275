"""NeuroNCAP's engine, scenarios and score, as its code has them and as its paper says.

Switches, and what was verified: docs/extensions/neuroncap.md.
"""
