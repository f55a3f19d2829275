"""NeuroNCAP's engine, scenarios and score by code or by paper; switches and checks: docs/extensions/neuroncap.md."""
