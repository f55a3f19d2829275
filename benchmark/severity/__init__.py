"""How severe an encounter is, with and without contact, and what counts as a successful attack."""
