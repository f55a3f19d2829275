"""How UniAD's miniature learns."""
