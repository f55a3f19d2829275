"""Tables of challenges on adversarial scenes."""
