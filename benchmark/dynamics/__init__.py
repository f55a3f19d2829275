"""How vehicles move: paths, the LQR tracker, the kinematic bicycle."""
