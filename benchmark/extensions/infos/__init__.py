"""Info files: what the official code of UniAD, VAD and SparseDrive reads in place of the nuScenes tables.

Every value is what the repositories' own converters compute, their slips included; what is done otherwise, and why, is
in ``repairs.py`` and stands in a file beside each export.
"""
