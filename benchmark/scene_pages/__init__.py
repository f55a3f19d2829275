"""Scene sheets: what pictures, films and the site show of a scene, as records beside the run records."""
