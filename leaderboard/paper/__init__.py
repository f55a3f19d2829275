"""The paper's tables and its chart in the paper's own layout, our numbers beside the published ones."""
