"""How VAD's miniature learns."""
