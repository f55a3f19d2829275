"""From recorded scenes to a split on disk: which scenes are kept, what is said of them, the ablation."""
