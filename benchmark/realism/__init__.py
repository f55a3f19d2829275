"""How real the motion of adversaries is, against recordings; never one number alone."""
