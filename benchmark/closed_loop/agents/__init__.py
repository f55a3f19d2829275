"""Who else is on the road, and how they answer: one Protocol, and a module for each policy."""
