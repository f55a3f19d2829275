"""Result files that planners' own repositories write: read, matched with samples, checked, written."""
