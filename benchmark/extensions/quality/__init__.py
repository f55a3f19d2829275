"""Video quality: subject consistency and imaging quality of driving videos (docs/quality.md)."""
