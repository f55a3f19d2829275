"""The view from above: a scene's road, agents and plans on a canvas of metres."""
