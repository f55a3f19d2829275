"""Driving scores of stored plans by the definition ``nuscenes-pdm``: sub-scores of NAVSIM, as far as nuScenes goes."""
