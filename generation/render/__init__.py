"""Renderers: a scene in, six images per frame out; pictures of scenes for people."""
