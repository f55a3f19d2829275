"""The search in the loop: an adversary that is planned anew while a planner drives (`drive --agents adversary`)."""
