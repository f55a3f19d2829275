"""123D logs (nuScenes, nuPlan, Argoverse 2, Waymo, ... in one Arrow form) as roots (docs/extensions/logs123d.md)."""
