"""Tables of video quality."""
