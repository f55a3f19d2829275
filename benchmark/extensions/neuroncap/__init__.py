"""NeuroNCAP's engine, scenarios and score, as its code has them and as its paper says (docs/closed-loop.md)."""
