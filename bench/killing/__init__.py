"""Commands that are killed, and what they leave compared with what undisturbed ones leave."""
