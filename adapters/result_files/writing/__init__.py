"""Result files as planners' own repositories write them, from the plans of a run record."""
