"""Challenges: strangers' adversarial scenes held to the recordings that they were made from, and ranked."""
