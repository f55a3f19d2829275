"""Records on disk: what runs, quality measurements, ablation studies and scene sheets leave, and how they are read."""
