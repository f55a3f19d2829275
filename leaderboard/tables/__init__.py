"""Tables from records, one module a table."""
