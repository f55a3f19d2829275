"""Tables of reproduced numbers."""
