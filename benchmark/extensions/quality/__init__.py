"""Video quality: subject consistency and imaging quality of driving videos (docs/extensions/quality.md)."""
